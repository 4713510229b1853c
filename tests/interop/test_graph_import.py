"""A factor graph of range-aided SLAM becomes a log that `joint` localizes."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.interop.test_stances import BODY
from tests.structures import exact_estimate
from tiswarm.base.errors import InputError
from tiswarm.base.progress import Progress
from tiswarm.evaluation.metrics import rmse
from tiswarm.interop.assumptions import Assumptions
from tiswarm.interop.exports import export_view
from tiswarm.interop.graph_lines import read_graph
from tiswarm.interop.graph_turns import find_turns
from tiswarm.interop.imports import import_poses, write_import
from tiswarm.localization.params import JointParams
from tiswarm.localization.registry import localize
from tiswarm.measurements.cues import cue_names, measure
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.report.swarm_view import view_log
from tiswarm.sensing import SensingParams, observe

BEACONS = np.array([[0.0, 0.0, 0.2], [9.0, 0.0, 2.5], [9.0, 8.0, 0.2], [0.0, 8.0, 2.5]])
RANGE_SD, STEP_SD = 0.05, 0.02


def triangle(matrix):
    """Upper triangle of a covariance as text."""
    return " ".join(map(repr, matrix[np.triu_indices(len(matrix))].tolist()))


def graph_lines(*, seed=0, exact=False):
    """Lines of a trajectory of twelve poses among four beacons, each of which has a prior."""
    rng, noise = np.random.default_rng(seed), 0.0 if exact else 1.0
    steps = rng.uniform([0.2, -0.5, -0.1], [0.9, 0.9, 0.2], (12, 3))
    place = np.ones(3) + np.cumsum(steps, axis=0)
    turn = Rotation.from_euler("z", np.cumsum(rng.normal(scale=0.4, size=12)))
    lines = []
    for k, at in enumerate(place):
        quaternion = " ".join(map(repr, turn[k].as_quat().tolist()))
        lines.append(f"VERTEX_SE3:QUAT {k}.0 A{k} {' '.join(map(repr, at.tolist()))} {quaternion}")
    for k, at in enumerate(BEACONS):
        lines.append(f"VERTEX_XYZ L{k} {' '.join(map(repr, at.tolist()))}")
        prior = triangle(1e-4 * np.eye(3) * (1 + k))
        lines.append(f"VERTEX_XYZ:PRIOR 0.0 L{k} {' '.join(map(repr, at.tolist()))} {prior}")
    spread = np.diag([STEP_SD**2] * 3 + [0.01**2] * 3)
    for k in range(11):
        step = turn[k].inv().apply(place[k + 1] - place[k])
        step += rng.normal(0.0, noise * STEP_SD, 3)
        way = (turn[k].inv() * turn[k + 1]).as_quat()
        numbers = " ".join(map(repr, [*step.tolist(), *way.tolist()]))
        lines.append(f"EDGE_SE3:QUAT {k}.0 A{k} A{k + 1} {numbers} {triangle(spread)}")
    for k, at in enumerate(place):
        for b, beacon in enumerate(BEACONS):
            length = np.linalg.norm(at - beacon) + rng.normal(0.0, noise * RANGE_SD)
            lines.append(f"EDGE_RANGE {k}.0 A{k} L{b} {float(length)!r} {RANGE_SD**2!r}")
    return lines


def bring_in(folder, lines, **known):
    """Import the lines of a graph."""
    path = folder / "slam.pyfg"
    path.write_text("\n".join(lines) + "\n")
    return import_poses(path, Assumptions(length_unit="m", **known))[""]


def test_a_graph_of_ranges_localizes(tmp_path):
    """The positions of a trajectory among beacons are as precise as its ranges allow."""
    imported = bring_in(tmp_path, graph_lines())
    write_import(imported, tmp_path / "in")

    log = read_sensing_log(tmp_path / "in" / "sensing.jsonl")
    found = localize(log, JointParams(chains=8))

    # Ranges alone give each coordinate to about 5 cm; steps of 2 cm tie poses to each other.
    assert rmse(found.position, imported.position) < 1.5 * RANGE_SD
    assert found.convergence.converged
    assert imported.notes[-1] == "16 robots, 0 contacts, 48 ranges, 9 fixes, 11 displacements"


def test_every_row_agrees_with_an_exact_graph(tmp_path):
    """At the vertices, residuals of all ranges and fixes are zero."""
    imported = bring_in(tmp_path, graph_lines(exact=True))

    rows = measure(imported.log, cue_names())
    residual = rows.residual(imported.position / imported.log.dock_radius)

    assert len(rows) == 48 + 9 + 3 * 11
    np.testing.assert_allclose(residual, 0.0, atol=1e-6)


def test_what_a_log_has_no_place_for_is_counted(tmp_path):
    """Covariances of turns, unknown lines and vectors of unknown direction are listed by line."""
    lines = [*graph_lines(), "EDGE_LOOP 0 A1 A2 1", "# a comment"]

    notes = bring_in(tmp_path, lines).notes

    first = 12 + 8 + 1
    where = f"11 lines ({first}-{first + 10})"
    assert f"left out: lines EDGE_LOOP, which are unknown, 1 line ({len(lines) - 1})" in notes
    assert f"left out: covariances of relative orientations, which are chained, {where}" in notes
    assert not any("directions" in note for note in notes)


def _left(lines, kept):
    """Leave out the ranges of a graph but for those of some names."""
    return [line for line in lines if "EDGE_RANGE" not in line or line.split()[2:4] in kept]


@pytest.mark.parametrize("why", ["few", "on-a-line", "straight"])
def test_directions_are_left_out_where_no_line_determines_an_orientation(tmp_path, why):
    """Four ranges are too few; two places, or poses in a row, leave a turn about their line."""
    lines = graph_lines(exact=True)
    if why == "few":
        lines = _left(lines, [["A1", "L0"], *([f"A{k}", f"L{k}"] for k in range(1, 4))])
    elif why == "on-a-line":
        lines = [line for line in lines if " L2 " not in line and " L3 " not in line]
    else:
        lines = _straight()

    imported = bring_in(tmp_path, lines)

    what = "directions of relative translations from poses whose orientation no line determines"
    assert any(note.startswith(f"left out: {what}") for note in imported.notes)
    assert len(imported.log.displacements) == 0
    residual = measure(imported.log, cue_names()).residual(
        imported.position / imported.log.dock_radius
    )
    np.testing.assert_allclose(residual, 0.0, atol=1e-6)


def _straight():
    """Lines of twelve poses in a row among the beacons, without noise."""
    place = [np.array([0.5 * k, 1.0, 1.0]) for k in range(12)]
    spread, prior = triangle(np.diag([STEP_SD**2] * 3 + [0.01**2] * 3)), triangle(1e-4 * np.eye(3))
    words = [" ".join(map(repr, at.tolist())) for at in [*place, *BEACONS]]
    poses, beacons = words[:12], words[12:]
    return [
        *(f"VERTEX_SE3:QUAT 0 A{k} {at} 0 0 0 1" for k, at in enumerate(poses)),
        *(f"VERTEX_XYZ L{k} {at}" for k, at in enumerate(beacons)),
        *(f"VERTEX_XYZ:PRIOR 0 L{k} {at} {prior}" for k, at in enumerate(beacons)),
        *(f"EDGE_SE3:QUAT 0 A{k} A{k + 1} 0.5 0 0 0 0 0 1 {spread}" for k in range(11)),
        *(
            f"EDGE_RANGE 0 A{k} L{b} {float(np.linalg.norm(at - to))!r} {RANGE_SD**2!r}"
            for k, at in enumerate(place)
            for b, to in enumerate(BEACONS)
        ),
    ]


def test_orientations_are_fitted_to_ranges_as_precisely_as_stated(tmp_path):
    """Over graphs, squared errors of the first orientation average to its variance."""
    error, variance = [], []
    for seed in range(12):
        lines = graph_lines(seed=seed)
        bring_in(tmp_path, lines)
        graph = read_graph(tmp_path / "slam.pyfg")
        places = {line.names[0]: line for line in graph.lines if line.kind == "prior"}
        vertex = {line.names[0]: line for line in graph.lines if line.kind == "vertex"}

        found = find_turns(graph, {}, places)["A0"]

        true = Rotation.from_quat(vertex["A0"].wxyz, scalar_first=True)
        error.append((found.rotation * true.inv()).magnitude() ** 2 / 3.0)
        variance.append(found.variance)
    # 36 squares of normal errors have a standard deviation of 24 % about their mean.
    assert 0.4 < np.mean(error) / np.mean(variance) < 2.0
    assert np.sqrt(np.mean(variance)) < np.radians(5.0)


def test_a_prior_of_one_pose_turns_all_others(tmp_path):
    """Poses before and after it; its uncertainty and theirs add to what displacements have."""
    wide = triangle(np.diag([1e12] * 3 + [0.02**2] * 3))
    lines = graph_lines(exact=True)
    at = next(line for line in lines if " A5 " in line).split()
    lines.append(f"VERTEX_SE3:QUAT:PRIOR 0 A5 0 0 0 {' '.join(at[6:])} {wide}")

    imported = bring_in(tmp_path, lines)

    rows = measure(imported.log, ["displacements"])
    residual = rows.residual(imported.position / imported.log.dock_radius)
    np.testing.assert_allclose(residual, 0.0, atol=1e-6)
    # From A5 to A6 the turn of A5 counts; that of A0 has five relative poses more.
    vectors = {int(row[0]): row for row in imported.log.displacements}
    length = np.linalg.norm(vectors[6 + 1][2:5])
    expected = np.sqrt(STEP_SD**2 + 2.0 / 3.0 * (length * 0.02) ** 2)
    assert vectors[6 + 1][5] == pytest.approx(expected, rel=1e-6)
    length = np.linalg.norm(vectors[1 + 1][2:5])
    turned = 0.02**2 + 5 * 0.01**2
    assert vectors[2][5] == pytest.approx(np.sqrt(STEP_SD**2 + 2 / 3 * length**2 * turned))


def test_vectors_from_the_anchor_keep_their_directions(tmp_path):
    """A pose with a prior is the anchor; a relative translation from it is three fixes."""
    half = float(np.sqrt(0.5))
    spread = triangle(np.diag([0.01, 0.04, 0.09, 1e-6, 1e-6, 1e-6]))
    firm = triangle(1e-8 * np.eye(6))
    lines = [
        f"VERTEX_SE3:QUAT 0 A0 1 2 3 0 0 {half} {half}",
        f"VERTEX_SE3:QUAT 1 A1 1 6 3 0 0 {half} {half}",
        f"VERTEX_SE3:QUAT:PRIOR 0 A0 1 2 3 0 0 {half} {half} {firm}",
        f"EDGE_SE3:QUAT 0 A0 A1 4 0 0 0 0 0 1 {spread}",
    ]

    log = bring_in(tmp_path, lines).log

    np.testing.assert_array_equal(log.anchor_position, [1, 2, 3])
    place = np.linalg.solve(log.fixes[:, 1:4], log.fixes[:, 4])
    np.testing.assert_allclose(place, [1, 6, 3], atol=1e-9)
    along = np.abs(log.fixes[:, 1:4]).argmax(axis=1)
    # Body x, with 0.1 m, is world y; turns of the anchor add 4 m x 0.1 mrad across.
    np.testing.assert_allclose(log.fixes[along.argsort(), 5], [0.2, 0.1, 0.3], atol=1e-6)
    np.testing.assert_allclose(log.orientation_wxyz, [[half, 0, 0, half]] * 2, atol=1e-12)
    assert len(log.ranges) == 0


def test_a_prior_of_an_orientation_is_no_anchor(tmp_path):
    """Its position is unknown; without any other, the first pose is at its vertex."""
    wide = triangle(np.diag([1e12] * 3 + [1e-4] * 3))
    lines = [
        "VERTEX_XYZ L0 3 0 0",
        "VERTEX_SE3:QUAT 0 A0 1 2 3 0 0 0 1",
        f"VERTEX_SE3:QUAT:PRIOR 0 A0 0 0 0 0 0 1 0 {wide}",
        "EDGE_RANGE 0 A0 L0 2 0.01",
    ]

    imported = bring_in(tmp_path, lines)

    np.testing.assert_array_equal(imported.log.anchor_position, [3, 0, 0])
    np.testing.assert_array_equal(imported.log.orientation_wxyz[1], [0, 0, 0, 1])
    assert "no prior of a position: the anchor L0 is at its vertex" in imported.notes


def test_a_planar_graph_stays_in_its_plane(tmp_path):
    """Each robot has a fix along z; angles are about z."""
    lines = [
        "VERTEX_SE2 0 A0 0 0 0",
        "VERTEX_SE2 1 A1 3 0 1.5707963267948966",
        "VERTEX_XY L0 0 4",
        "VERTEX_XY:PRIOR 0 L0 0 4 0.01 0 0.01",
        "VERTEX_SE2:PRIOR 0 A0 0 0 0 1e-8 0 0 1e-8 0 1e-8",
        "EDGE_SE2 0 A0 A1 3 0 1.5707963267948966 0.01 0 0 0.01 0 1e-4",
        "EDGE_RANGE 1 A1 L0 5 0.01",
    ]

    imported = bring_in(tmp_path, lines)

    log = imported.log
    level = log.fixes[np.abs(log.fixes[:, 3]) == 1.0]
    assert {*level[:, 0]} == {1, 2}
    np.testing.assert_array_equal(level[:, 4], 0.0)
    np.testing.assert_allclose(log.orientation_wxyz[1], [0.5**0.5, 0, 0, 0.5**0.5], atol=1e-12)
    residual = measure(log, cue_names()).residual(imported.position / log.dock_radius)
    np.testing.assert_allclose(residual, 0.0, atol=1e-6)


def test_an_exported_graph_comes_back(towers, tmp_path):
    """Points that all poses have at the same places are docks, and ranges between them contacts."""
    sensed = observe(towers[0], SensingParams())
    apart = float(np.linalg.norm(towers[0].position[20] - towers[0].position[5]))
    log = replace(sensed, ranges=np.array([[20.0, 5.0, apart, 0.1, -1.0]]))
    estimate = exact_estimate(log, towers[0].position)
    view = view_log(log, estimate, towers[0].position)
    export_view(view, "pyfg", tmp_path, Progress())

    imported = import_poses(tmp_path / "case.pyfg", Assumptions(length_unit="R"))[""]

    found = imported.log
    np.testing.assert_array_equal(found.contacts, log.contacts)
    np.testing.assert_array_equal(found.ranges, log.ranges)
    np.testing.assert_allclose(found.dock_offset_body, BODY, atol=1e-12)
    turn = Rotation.from_quat(found.orientation_wxyz, scalar_first=True)
    true = Rotation.from_quat(log.orientation_wxyz, scalar_first=True)
    assert (turn * true.inv()).magnitude().max() < 1e-9
    np.testing.assert_array_equal(imported.position, towers[0].position)
    assert len(found.fixes) == 0
    assert not any(note.startswith("left out") for note in imported.notes)


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        ([], "slam.pyfg:1: there are no variables; start with lines VERTEX_..."),
        (["VERTEX_XYZ L0 0 0"], "slam.pyfg:1: VERTEX_XYZ should have its name, then 3 numbers"),
        (["VERTEX_XYZ L0 0 0 nan"], "slam.pyfg:1: VERTEX_XYZ should have its name, then 3 numbers"),
        (["VERTEX_XYZ L0 0 0 0"] * 2, "slam.pyfg:2: L0 is a variable already; give it another"),
        (["VERTEX_XYZ L0 0 0 0", "EDGE_RANGE 0 L0 A1 2 1"], "slam.pyfg:2: there is no variable A1"),
        (["VERTEX_XYZ L0 0 0 0", "EDGE_RANGE 0 L0 L0 2 1"], "slam.pyfg:2: L0 is measured from"),
        (
            ["VERTEX_XYZ L0 0 0 0", "VERTEX_XYZ L1 0 0 1", "EDGE_RANGE 0 L0 L1 -2 1"],
            "slam.pyfg:3: the distance -2 should be positive; correct it",
        ),
        (["VERTEX_SE3:QUAT 0 A0 0 0 0 0 0 0 2"], "slam.pyfg:1: the quaternion has length 2; scale"),
        (
            ["VERTEX_XYZ L0 0 0 0", "VERTEX_XYZ:PRIOR 0 L0 0 0 0 -1 0 0 1 0 1"],
            "slam.pyfg:2: the covariance has negative variances; correct it",
        ),
    ],
)
def test_malformed_graphs_are_refused(tmp_path, lines, problem):
    """The message names file and line, or the option that does not apply."""
    with pytest.raises(InputError, match=re.escape(problem)):
        bring_in(tmp_path, lines)

    with pytest.raises(InputError, match="heights: a factor graph states its measurements; leave"):
        bring_in(tmp_path, ["VERTEX_XYZ L0 0 0 0"], heights=True)
