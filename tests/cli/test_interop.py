"""Structures are imported from and exported to other programs."""

import json
import re

import numpy as np
import pandas as pd
import pytest
import trimesh

from tests.runs import REPOSITORY
from tiswarm.app.formats import export_view
from tiswarm.base.progress import Progress
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.report.figure_style import JOIN_COLORS, rgb
from tiswarm.report.run_data import load_run
from tiswarm.report.swarm_view import read_case_view

EXAMPLE = REPOSITORY / "scenarios" / "examples" / "foreign-poses.csv"


@pytest.fixture(scope="module")
def exported(small_run, tmp_path_factory):
    """Folder with the first case of the small run in every format."""
    out = tmp_path_factory.mktemp("exported")
    view = read_case_view(load_run(small_run).choose(None))
    for form in ("csv", "gltf", "gsd", "mcap", "mjcf", "parquet", "ply", "pyfg", "tum", "wbt"):
        export_view(view, form, out, Progress())
    return out


@pytest.fixture(scope="module")
def robots(small_run):
    """The robots of that case."""
    return pd.read_csv(small_run / "cases" / "0-baseline" / "robots.csv")


@pytest.fixture(scope="module")
def anchor(small_run):
    """Place of the anchor of that case, from which solids have their coordinates, shape (3,)."""
    return read_sensing_log(small_run / "cases" / "0-baseline" / "sensing.jsonl").anchor_position


def test_somebody_elses_poses_are_localized(tiswarm, tmp_path):
    """Units, dock size and order differ from ours; results are in the unit of the file."""
    imported = tiswarm("import", EXAMPLE, "--dock-radius", 0.5, "--out", tmp_path)
    log, files = tmp_path / "sensing.jsonl", [tmp_path / "estimate.csv", tmp_path / "truth.csv"]
    page, seen = tmp_path / "page.html", tmp_path / "view.html"
    done = tiswarm("localize", log, "--out", files[0], "--report", page)
    advised = tiswarm("advise", log, files[0], "--budget", 2, "--kinds", "height, contact")
    viewed = tiswarm("view", log, files[0], "--truth", files[1], "--out", seen)

    assert imported.returncode == 0, imported.stderr
    assert imported.stderr == ""
    assert imported.stdout.startswith("dock offset 1.000000 +- ")
    assert imported.stdout.endswith(f"36 robots, 64 contacts -> {tmp_path}\n")
    assert done.returncode == 0, done.stderr
    truth = pd.read_csv(tmp_path / "truth.csv")
    estimate = pd.read_csv(tmp_path / "estimate.csv")
    assert truth.columns.tolist() == ["robot", "x_cm", "y_cm", "z_cm"]
    assert sorted(truth["robot"]) == sorted(pd.read_csv(EXAMPLE)["robot"])
    assert estimate["robot"].tolist() == truth["robot"].tolist()
    scored = tiswarm("score", tmp_path / "truth.csv", tmp_path / "estimate.csv")
    places = ["x_cm", "y_cm", "z_cm"]
    rmse = np.sqrt(((truth[places] - estimate[places]) ** 2).sum(axis=1).mean())
    assert f"{rmse:.4g} cm" in scored.stdout.splitlines()[0]
    assert advised.returncode == 0, advised.stderr
    assert "expected RMSE [cm]" in advised.stdout
    assert re.search(r"\ntogether, [12] \w+( and 1 \w+)?: expected RMSE ", advised.stdout)
    assert viewed.returncode == 0, viewed.stderr
    assert done.stdout.partition(" -> ")[0] in page.read_text()
    assert f"The RMSE is {rmse:.3g} cm." in seen.read_text()


def test_a_recording_is_checked_without_a_file(tiswarm, tmp_path):
    """--check prints what an import would, and writes nothing; one of both options is needed."""
    files = sorted(tmp_path.iterdir())

    checked = tiswarm("import", EXAMPLE, "--dock-radius", 0.5, "--check", cwd=tmp_path)
    both = tiswarm("import", EXAMPLE, "--check", "--out", tmp_path / "out")
    neither = tiswarm("import", EXAMPLE)

    assert (checked.returncode, both.returncode, neither.returncode) == (0, 2, 2)
    assert "36 robots, " in checked.stdout
    assert "->" not in checked.stdout
    assert "--check: writes nothing; leave --out and --report away" in both.stderr
    assert "--out: give a folder for the log, or --check" in neither.stderr
    assert sorted(tmp_path.iterdir()) == files


def test_each_run_of_a_table_has_a_folder(tiswarm, tmp_path):
    """Docks, limits of contacts, heights and anchors come from options."""
    docks, poses = tmp_path / "docks.csv", tmp_path / "poses.csv"
    docks.write_text("dock,x,y,z\n0,1,0,0\n1,-1,0,0\n")
    row = "{},{},{},0,0,1,0,0,0\n".format
    rows = [row(run, robot, x) for run in "ab" for robot, x in enumerate([0.0, 4.1, 20.0])]
    poses.write_text("run,robot,x,y,z,qw,qx,qy,qz\n" + "".join(rows))
    arguments = ["import", poses, "--docks", docks, "--gap", 0.2, "--heights"]
    arguments.append("--drop-disconnected")

    done = tiswarm(*arguments, "--anchor", "1,0", "--out", tmp_path / "in")
    refused = tiswarm(*arguments, "--anchor", "1,x", "--out", tmp_path / "no")

    assert done.returncode == 0, done.stderr
    assert "\n2 robots, 1 contact -> " in done.stdout
    for run in "ab":
        log = read_sensing_log(tmp_path / "in" / run / "sensing.jsonl")
        assert log.robot_id.tolist() == [1, 0]
        assert log.flip_height.tolist() == [0.0, 0.0]
        assert log.fixes[:, 0].tolist() == [1, 1, 1]
    assert refused.returncode == 2
    assert refused.stderr == (
        "tiswarm: error: --anchor: '1,x' is not a list of robots; write it like 0,5\n"
    )
    assert not (tmp_path / "no").exists()


def test_what_is_exported_can_be_imported(tiswarm, small_run, exported, tmp_path):
    """The log made of exported poses has the contacts of the original log, in their order."""
    done = tiswarm("import", exported / "structure.csv", "--out", tmp_path, "--quiet")

    assert done.returncode == 0, done.stderr
    original = read_sensing_log(small_run / "cases" / "0-baseline" / "sensing.jsonl")
    log = read_sensing_log(tmp_path / "sensing.jsonl")
    np.testing.assert_array_equal(log.contacts, original.contacts)
    assert log.length_unit == "R"


@pytest.mark.parametrize("name", ["structure", "estimate", "contacts"])
def test_parquet_holds_the_same_as_csv(exported, name):
    """Names and values are equal."""
    csv = pd.read_csv(exported / f"{name}.csv", engine="pyarrow")  # reads every bit

    parquet = pd.read_parquet(exported / f"{name}.parquet")

    assert parquet.columns.tolist() == csv.columns.tolist()
    np.testing.assert_array_equal(parquet.to_numpy(), csv.to_numpy())


def _docks_and_hubs(robots, columns):
    """How far the spheres of robots reach [R]: lowest and highest corner."""
    places = robots[columns].to_numpy()
    reach = 1.506 + 1.0
    return places.min(axis=0) - reach, places.max(axis=0) + reach


@pytest.mark.parametrize(
    ("name", "columns"),
    [("structure", ["x_R", "y_R", "z_R"]), ("estimate", ["x_est_R", "y_est_R", "z_est_R"])],
)
def test_meshes_are_where_the_robots_are(exported, robots, anchor, name, columns):
    """Both formats contain the same closed solid, at the positions of the robots."""
    ply = trimesh.load(exported / f"{name}.ply")
    scene = trimesh.load(exported / "case.glb")
    turn, _ = scene.graph.get(name)
    solid = scene.geometry[name]

    low, high = _docks_and_hubs(robots, columns)
    assert (ply.bounds[0] + anchor >= low).all()
    assert (ply.bounds[1] + anchor <= high).all()
    assert ply.is_watertight
    # Spheres of ten sides hold nearly nine tenths of their volume; arms and hubs add to it.
    assert ply.volume == pytest.approx(len(robots) * 3 * 4.19, rel=0.25)
    np.testing.assert_allclose(solid.bounds, ply.bounds, atol=1e-5)
    up = turn[:3, :3] @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(up, [0.0, 1.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(turn[:3, 3], anchor[[0, 2, 1]] * [1.0, 1.0, -1.0], atol=1e-12)
    assert len(np.unique(ply.visual.vertex_colors, axis=0)) > 5


def test_colors_read_back(exported, robots):
    """Docks of the first robot have the first color, in sRGB in PLY and linear in glTF."""
    color = 255.0 * rgb(JOIN_COLORS[0])

    ply = trimesh.load(exported / "structure.ply").visual.vertex_colors
    glb = (
        trimesh.load(exported / "case.glb").geometry["structure"].visual.vertex_attributes["color"]
    )

    assert (np.abs(ply[:, :3] - color).max(axis=1) <= 1).any()
    linear = 255.0 * (color / 255.0) ** 2.2
    assert (np.abs(glb[:, :3] - linear).max(axis=1) <= 1).any()


@pytest.mark.parametrize("file", ["case.glb", "contacts.ply"])
def test_contacts_are_lines_between_centers(exported, robots, anchor, file):
    """Each line runs from the true center of a robot to that of the other."""
    contacts = pd.read_csv(exported / "contacts.csv")
    center = robots.set_index("robot")[["x_R", "y_R", "z_R"]]

    ends = _lines(exported / file).reshape(-1, 6)

    pairs = contacts[["other_robot", "robot"]].to_numpy()
    expected = (center.to_numpy()[pairs] - anchor).reshape(-1, 6)
    np.testing.assert_allclose(ends, expected, atol=1e-5)


def _lines(path):
    """Read the ends of each line of a file, shape (lines, 2, 3)."""
    data = path.read_bytes()
    if path.suffix == ".ply":
        header, _, body = data.partition(b"end_header\n")
        count = int(re.search(rb"element vertex (\d+)", header)[1])
        vertex = np.frombuffer(body, "<f4", 3 * count).reshape(-1, 3)
        return vertex[np.frombuffer(body[12 * count :], "<i4").reshape(-1, 2)]
    size = int.from_bytes(data[12:16], "little")
    document, binary = json.loads(data[20 : 20 + size]), data[28 + size :]
    mesh = next(mesh for mesh in document["meshes"] if mesh["name"] == "contacts")
    lines = mesh["primitives"][0]
    accessor = document["accessors"][lines["attributes"]["POSITION"]]
    start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    start += accessor.get("byteOffset", 0)
    assert lines["mode"] == 1
    assert document["scenes"][0]["extras"] == {"length_unit": "R"}
    return np.frombuffer(binary, "<f4", 3 * accessor["count"], start).reshape(-1, 2, 3)
