"""Bodies as sections of a scenario: what they take, and what is wrong with a file, in a line."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from tiswarm.base.errors import InputError
from tiswarm.scenario.expansion import load_scenario
from tiswarm.scenario.model import scenario_schema
from tiswarm.world.ground.bodies import HeightsParams, MeshParams
from tiswarm.world.ground.solid import SolidGround
from tiswarm.world.params import structure_ground


def _structure(terrain, kind="tower", **more):
    section = {"kind": kind, "terrain": terrain, **more}
    given = {"name": "ground", "structure": section, "localization": {"method": "joint"}}
    return load_scenario(given).structure


def test_one_body_needs_no_list():
    """It stands for a list of it."""
    body = {"kind": "sphere", "position": [0.0, 0.0, -50.0], "radius": 60.0}

    assert _structure(body).terrain == _structure([body]).terrain


def test_the_schema_takes_one_body_and_a_list_of_them():
    """Editors accept what scenarios accept."""
    settings = scenario_schema()["$defs"]["TowerParams"]["properties"]

    forms = [settings[key]["anyOf"] for key in ("terrain", "no_entry")]

    for form in forms:
        assert any("discriminator" in choice for choice in form)
        assert any(choice.get("type") == "array" for choice in form)


def test_rows_of_heights_run_from_the_greatest_y(tmp_path):
    """A field is centered at its position; numbers of a CSV file are heights."""
    (tmp_path / "field.csv").write_text("0, 0, 9\n0, 0, 0\n0, 0, 0\n")
    field = HeightsParams(file=str(tmp_path / "field.csv"), cell=2.0)

    height = field.height()

    assert height.shape == (3, 3)
    assert height[2, 2] == 9.0
    assert height.sum() == 9.0


def test_a_picture_has_heights_between_those_of_black_and_white(tmp_path):
    """Of 8 and of 16 bits."""
    gray = np.array([[0, 255], [0, 51]], np.uint8)
    Image.fromarray(gray).save(tmp_path / "8.png")
    Image.fromarray(gray.astype(np.uint16) * 257).save(tmp_path / "16.png")

    fields = [
        HeightsParams(file=str(tmp_path / name), cell=1.0, heights=(-2.0, 8.0)).height()
        for name in ("8.png", "16.png")
    ]

    for height in fields:
        np.testing.assert_allclose(height, [[-2.0, -2.0], [0.0, 8.0]], atol=1e-12)


def test_results_state_the_content_of_a_file_and_refuse_another(tmp_path):
    """The digest is filled in; with that of another content the file is refused."""
    file = tmp_path / "field.csv"
    file.write_text("0,0\n0,1\n")
    digest = HeightsParams(file=str(file), cell=1.0).digest
    file.write_text("0,0\n0,2\n")

    with pytest.raises(ValueError, match=r"field.csv has changed"):
        HeightsParams(file=str(file), cell=1.0, digest=digest)

    assert HeightsParams(file=str(file), cell=1.0).digest != digest


def _open_boulder(folder):
    boulder = trimesh.creation.icosphere(subdivisions=1)
    boulder.update_faces(np.arange(len(boulder.faces)) > 0)
    boulder.export(folder / "open.stl")


def _fields(folder):
    """Write files, each with a mistake."""
    (folder / "words.csv").write_text("1,2\n3,high\n")
    (folder / "ragged.csv").write_text("1,2\n3\n")
    (folder / "row.csv").write_text("1,2,3\n")
    (folder / "far.csv").write_text("1,2\n3,1e9\n")
    (folder / "empty.csv").write_text("\n")
    (folder / "no.png").write_text("no picture")
    (folder / "no.stl").write_text("no mesh")
    _open_boulder(folder)


WRONG = {
    "words.csv": ({"kind": "heightfield", "cell": 1.0}, "words.csv:2: 'high' is no number"),
    "ragged.csv": ({"kind": "heightfield", "cell": 1.0}, "ragged.csv:2: 1 heights, 2 in the"),
    "row.csv": ({"kind": "heightfield", "cell": 1.0}, "3 x 1 heights; give 2 to 4096"),
    "far.csv": ({"kind": "heightfield", "cell": 1.0}, "far.csv:2: heights are numbers within"),
    "empty.csv": ({"kind": "heightfield", "cell": 1.0}, "has no heights; give rows"),
    "missing.csv": ({"kind": "heightfield", "cell": 1.0}, "cannot be read: No such file"),
    "no.png": (
        {"kind": "heightfield", "cell": 1.0, "heights": [0.0, 1.0]}, "is no picture that can"
    ),
    "no.stl": ({"kind": "mesh"}, "no.stl"),
    "open.stl": ({"kind": "mesh"}, "open.stl is not closed: it has holes"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_with_a_file_is_a_line(tmp_path, name):
    """It names the key, the file and, where it has lines, the line."""
    _fields(tmp_path)
    body, problem = WRONG[name]

    with pytest.raises(InputError) as caught:
        _structure([{"kind": "plane"}, {**body, "file": str(tmp_path / name)}])

    assert caught.value.key == "structure.terrain[1].file"
    assert problem in caught.value.problem
    assert "\n" not in caught.value.problem


REFUSED = {
    "round": (
        {"kind": "box", "size": [4.0, 4.0, 1.0], "edge_radius": 0.6},
        "structure.terrain[0].edge_radius", "0.6 is more than half of 1",
    ),
    "kind": ({"kind": "bax"}, "structure.terrain[0].kind", "did you mean box?"),
    "key": ({"kind": "sphere", "radios": 1.0}, "structure.terrain[0].radios", "radius"),
    "empty": ([], "structure.terrain", "at least 1"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_wrong_bodies_are_refused_with_their_key(name):
    """As all keys of a scenario."""
    terrain, key, problem = REFUSED[name]

    with pytest.raises(InputError) as caught:
        _structure(terrain)

    assert key in str(caught.value)
    assert problem in str(caught.value)


def test_a_picture_without_heights_is_refused(tmp_path):
    """Black and white say none."""
    Image.new("L", (3, 3)).save(tmp_path / "flat.png")

    with pytest.raises(InputError, match=r"terrain\[0\].heights: a PNG has no heights"):
        _structure({"kind": "heightfield", "file": str(tmp_path / "flat.png"), "cell": 1.0})


def test_a_plane_is_no_region_to_keep_out_of():
    """Nor is any body without an end."""
    with pytest.raises(InputError, match="plane is no region; use box, cylinder, sphere"):
        _structure(None, no_entry={"kind": "plane"})


def test_a_bridge_needs_a_body_for_each_bank():
    """Else nobody could say when it is closed."""
    bank = {"kind": "box", "size": [90.0, 90.0, 2.0], "position": [0.0, 0.0, -1.0]}

    with pytest.raises(InputError, match="both sides start on body 0"):
        _structure(bank, "bridge")


def test_robots_need_ground_where_they_start():
    """A tower's robots start around its axis."""
    pit = {"kind": "box", "size": [1.0, 1.0, 1.0], "position": [500.0, 0.0, 0.0]}

    with pytest.raises(InputError, match="there is no ground at"):
        _structure(pit)


def test_an_anchor_beside_the_ground_is_refused():
    """It would fall."""
    slab = {"kind": "box", "size": [60.0, 20.0, 2.0], "position": [0.0, 0.0, -1.0]}

    with pytest.raises(InputError, match=r"anchor 1 at .* is off the ground"):
        _structure(slab, anchors=[[0.0, 0.0], [0.0, 40.0]])


def test_a_mesh_has_the_size_that_its_scale_says(tmp_path):
    """Corners are in R."""
    trimesh.creation.box([2.0, 4.0, 6.0]).export(tmp_path / "box.stl")

    vertex, _ = MeshParams(file=str(tmp_path / "box.stl"), scale=0.5).triangles()

    np.testing.assert_allclose(np.ptp(vertex, axis=0), [1.0, 2.0, 3.0])


def test_too_fine_a_grid_is_refused(tmp_path):
    """Before its memory is taken."""
    trimesh.creation.box([500.0, 500.0, 500.0]).export(tmp_path / "box.stl")

    with pytest.raises(
        InputError, match=r"terrain\[0\]\.resolution: .* distances, .* at most; give more R"
    ):
        _structure({"kind": "mesh", "file": str(tmp_path / "box.stl")})


def test_a_turned_plane_is_ground_of_bodies():
    """Only a level one has the closed form."""
    ground = structure_ground(_structure({"kind": "plane", "pitch_deg": 1.0}))

    assert isinstance(ground, SolidGround)
