"""Exports keep their precision where the anchor is far from the origin, as on a map."""

import json
import re
from dataclasses import replace
from xml.etree import ElementTree as ET

import gsd.hoomd
import numpy as np
import pandas as pd
import pytest
import trimesh
from mcap.reader import make_reader

from tests.structures import Rule, exact_estimate, structure
from tiswarm.app.formats import export_view
from tiswarm.base.progress import Progress
from tiswarm.base.registry import BUILT_IN
from tiswarm.report.swarm_view import view_log

RADIUS = 0.0329
ANCHOR = np.array([4.5e5, 5.2e6, 100.0])
"""An anchor in meters east and north, as UTM has it, of robots whose docks have 32.9 mm."""
CENTER = ["x_m", "y_m", "z_m"]


def _view(anchor):
    """A structure of eight robots at an anchor, and an estimate that is 0.1 m off."""
    log, truth = structure(Rule(kind="loops"), robots=8, seed=1)
    place = anchor + RADIUS * (truth - truth[0])
    log = replace(
        log,
        dock_radius=RADIUS,
        dock_offset_body=RADIUS * log.dock_offset_body,
        anchor_position=anchor,
        length_unit="m",
    )
    estimate = exact_estimate(
        log, place + np.array([0.1, 0.0, 0.0]), trace=place[None], length_unit="m"
    )
    return view_log(log, estimate, place)


def _of_table(path):
    read = pd.read_parquet if path.suffix == ".parquet" else pd.read_csv
    options = {} if path.suffix == ".parquet" else {"engine": "pyarrow"}  # reads every bit
    return read(path, **options)[CENTER].to_numpy()


def _of_gltf(path):
    scene = trimesh.load(path)
    parts = []
    for name in sorted(scene.graph.nodes_geometry):
        turn, of = scene.graph.get(name)
        points = np.array(scene.geometry[of].vertices, float)
        parts.append((points @ turn[:3, :3].T + turn[:3, 3]) @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    return np.concatenate(parts)


def _of_ply(path):
    header, _, body = path.read_bytes().partition(b"end_header\n")
    origin = re.search(rb"comment origin (\S+) (\S+) (\S+)\n", header).groups()
    if path.stem == "contacts":
        count = int(re.search(rb"element vertex (\d+)", header)[1])
        points = np.frombuffer(body, "<f4", 3 * count).reshape(-1, 3).astype(float)
    else:
        points = np.array(trimesh.load(path).vertices, float)
    return points + np.array(origin, float)


def _of_gsd(path):
    with gsd.hoomd.open(path) as file:
        last = file[-1]
    return last.particles.position.astype(float) + last.log["origin"]


def _of_mcap(path):
    with path.open("rb") as file:
        messages = [json.loads(m.data) for _, _, m in make_reader(file).iter_messages()]
    return np.array([[each[c] for c in CENTER] for each in messages if CENTER[0] in each])


def _of_pyfg(path):
    rows = [line.split() for line in path.read_text().splitlines()]
    start = {"VERTEX_SE3:QUAT": 3, "VERTEX_XYZ": 2}
    return np.array([row[start[row[0]] :][:3] for row in rows if row[0] in start], float)


def _of_mjcf(path):
    root = ET.parse(path)  # noqa: S314 - ours
    origin = np.array(root.find("custom/numeric[@name='origin']").get("data").split(), float)
    return origin + np.array([each.get("pos").split() for each in root.iter("body")], float)


def _of_wbt(path):
    text = path.read_text()
    origin = np.array(re.search(r'"origin: (\S+) (\S+) (\S+)"', text).groups(), float)
    places = re.findall(r"^Robot {\n  translation (\S+) (\S+) (\S+)$", text, re.MULTILINE)
    return origin + np.array(places, float)


READERS = {
    "csv": _of_table, "parquet": _of_table, "gltf": _of_gltf, "ply": _of_ply, "gsd": _of_gsd,
    "mcap": _of_mcap, "mjcf": _of_mjcf, "pyfg": _of_pyfg, "wbt": _of_wbt,
    "tum": lambda path: np.loadtxt(path)[:, 1:4],
}  # fmt: skip
PICTURES = {"png", "gif", "mp4", "webp"}


def test_formats_are_read_here_or_are_pictures():
    """A new format needs a reader."""
    assert READERS.keys() | PICTURES == BUILT_IN["export_format"].keys()


@pytest.mark.parametrize("form", READERS)
def test_every_format_resolves_robots_at_map_coordinates(form, tmp_path):
    """All points of each file move with the anchor, exact to 1e-6 R: float32 steps 0.5 m there."""
    read = READERS[form]
    export_view(_view(np.zeros(3)), form, tmp_path / "near", Progress())
    export_view(_view(ANCHOR), form, tmp_path / "far", Progress())

    files = sorted(path.name for path in (tmp_path / "far").glob("[!.]*"))
    for file in files:
        near, far = (read(tmp_path / place / file) for place in ("near", "far"))
        # Sums with 5.2e6 m round to 9e-10 m, 3e-8 R.
        np.testing.assert_allclose(far - ANCHOR, near, rtol=0.0, atol=1e-6 * RADIUS)

    assert files
