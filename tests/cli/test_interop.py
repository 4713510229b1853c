"""Structures are imported from and exported to other programs."""

import json
import re

import numpy as np
import pandas as pd
import pytest
import trimesh

from tests.runs import REPOSITORY
from tiswarm.interop.exports import export_case
from tiswarm.progress import Progress
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.report.figure_style import JOIN_COLORS, rgb

EXAMPLE = REPOSITORY / "scenarios" / "examples" / "foreign-poses.csv"


@pytest.fixture(scope="module")
def exported(small_run, tmp_path_factory):
    """Folder with the first case of the small run in every format."""
    out = tmp_path_factory.mktemp("exported")
    for form in ("csv", "gltf", "parquet", "ply"):
        export_case(small_run, form, out, None, Progress())
    return out


@pytest.fixture(scope="module")
def robots(small_run):
    """The robots of that case."""
    return pd.read_csv(small_run / "cases" / "0-baseline" / "robots.csv")


def test_somebody_elses_poses_are_localized(tiswarm, tmp_path):
    """Units, dock size and order differ from ours; results are in the unit of the file."""
    imported = tiswarm(
        "import", EXAMPLE, "--dock-radius", 0.5, "--dock-offset", 1, "--out", tmp_path
    )
    done = tiswarm("localize", tmp_path / "sensing.jsonl", "--out", tmp_path / "estimate.csv")

    assert imported.returncode == 0, imported.stderr
    assert "no column join" in imported.stderr
    assert "36 robots, 64 contacts" in imported.stderr
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
    csv = pd.read_csv(exported / f"{name}.csv", float_precision="round_trip")

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
def test_meshes_are_where_the_robots_are(exported, robots, name, columns):
    """Both formats contain the same closed solid, at the positions of the robots."""
    ply = trimesh.load(exported / f"{name}.ply")
    scene = trimesh.load(exported / "case.glb")
    turn, _ = scene.graph.get(name)
    solid = scene.geometry[name]

    low, high = _docks_and_hubs(robots, columns)
    assert (ply.bounds[0] >= low).all()
    assert (ply.bounds[1] <= high).all()
    assert ply.is_watertight
    # Spheres of ten sides hold nearly nine tenths of their volume; arms and hubs add to it.
    assert ply.volume == pytest.approx(len(robots) * 3 * 4.19, rel=0.25)
    np.testing.assert_allclose(solid.bounds, ply.bounds, atol=1e-5)
    up = turn[:3, :3] @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(up, [0.0, 1.0, 0.0], atol=1e-6)
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
def test_contacts_are_lines_between_centers(exported, robots, file):
    """Each line runs from the true center of a robot to that of the other."""
    contacts = pd.read_csv(exported / "contacts.csv")
    center = robots.set_index("robot")[["x_R", "y_R", "z_R"]]

    ends = _lines(exported / file).reshape(-1, 6)

    pairs = contacts[["other_robot", "robot"]].to_numpy()
    expected = center.to_numpy()[pairs].reshape(-1, 6)
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
