"""Scores measure the accuracy of an estimate and the calibration of its uncertainty."""

import dataclasses

import numpy as np
import pytest

from tiswarm.base.errors import InputError
from tiswarm.base.robot import RobotGeometry
from tiswarm.evaluation.tables import (
    by_join,
    by_robot,
    outlier_scores,
    score,
    score_files,
    totals,
)
from tiswarm.localization.methods import localize
from tiswarm.localization.settings import VirtualForceParams
from tiswarm.measurements.cues import measure
from tiswarm.records.error_law import sure_ratio
from tiswarm.records.estimate import HALF_WITHIN, MOST_WITHIN, Convergence
from tiswarm.records.frames import read_frame, write_frame
from tiswarm.records.positions import Truth, write_positions
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.params import BridgeParams, CantileverParams, TowerParams
from tiswarm.world.strength import StrengthParams

SHAPE = np.random.default_rng(1).normal(size=(6, 3)) * [1.0, 2.0, 6.0]


def test_coverage_is_the_share_of_robots_in_their_interval(towers):
    """Robots count if their error is within the interval; the anchor does not count."""
    history = towers[0]
    log = observe(history, SensingParams())
    pose = {"position": history.position, "orientation_wxyz": history.orientation_wxyz}
    truth = Truth(robot_id=log.robot_id, **pose)
    estimate = localize(log, VirtualForceParams())
    count = history.robot_count
    error = np.linalg.norm(estimate.position - history.position, axis=1)
    within = np.where(np.arange(count) % 2, 0.9 * MOST_WITHIN, 0.9 * HALF_WITHIN)
    within[1] = 1.1 * MOST_WITHIN
    sure = dataclasses.replace(estimate, sd=error / within)

    rows = measure(log, [])
    silent, calibrated = (score(truth, log, e, history.robot, rows=rows) for e in (estimate, sure))

    assert {"coverage_50", "expected_rmse_R", "sure_1R", "sure_off_1R"} & {*silent} == set()
    is_sure = sure_ratio() * (error / within)[1:] <= 1.0
    assert 0.0 < calibrated["sure_1R"] == is_sure.mean()
    assert calibrated["sure_off_1R"] == (error[1:] >= 1.0)[is_sure].mean() == 0.0
    assert calibrated["coverage_50"] == np.mean(within[1:] < HALF_WITHIN)
    expected = np.sqrt(np.mean((error / within)[1:] ** 2))
    assert calibrated["expected_rmse_R"] == pytest.approx(expected)
    assert calibrated["coverage_90"] == 1.0 - 1.0 / (count - 1)


def test_the_share_of_joins_that_one_robot_solves_is_its_largest(towers):
    """Algorithm 1, in which no robot solves for others, has none."""
    history = towers[0]
    log = observe(history, SensingParams())
    pose = {"position": history.position, "orientation_wxyz": history.orientation_wxyz}
    truth = Truth(robot_id=log.robot_id, **pose)
    silent = localize(log, VirtualForceParams(iterations=1))
    counts = ("sent", "heard", "memory", "messages", "rounds", "operations")
    published = {name: np.ones(history.robot_count) for name in counts}
    rows = measure(log, [])
    joins = np.bincount([3] * 6 + [5] * 23, minlength=history.robot_count)

    alone, shared = (
        score(truth, log, dataclasses.replace(silent, traffic=traffic), history.robot, rows=rows)
        for traffic in (published, published | {"joins": joins})
    )

    assert "solved_share" not in alone
    assert shared["solved_share"] == pytest.approx(23 / 29)


def test_robots_that_were_located_have_an_error_of_their_own(towers):
    """The root mean square of their distances from the truth, without the anchor."""
    history = towers[0]
    log = observe(history, SensingParams())
    pose = {"position": history.position, "orientation_wxyz": history.orientation_wxyz}
    truth = Truth(robot_id=log.robot_id, **pose)
    off = np.outer(np.arange(30.0), [0.0, 0.6, 0.8])
    estimate = dataclasses.replace(
        localize(log, VirtualForceParams(iterations=1)),
        position=history.position + off,
        undetermined=np.tile(np.arange(30) >= 4, (3, 1)).T,
    )  # fmt: skip

    scores = score(truth, log, estimate, history.robot, rows=measure(log, []))

    assert scores["located"] == pytest.approx(3.0 / 29.0)
    assert scores["rmse_located_R"] == pytest.approx(((1.0 + 4.0 + 9.0) / 3.0) ** 0.5)


def test_robots_within_a_dock_diameter_are_counted_in_the_world_and_from_their_neighbors(towers):
    """A shift of all robots but the anchor spares pairs in contact that leave the anchor out."""
    history = towers[0]
    log = observe(history, SensingParams())
    pose = {"position": history.position, "orientation_wxyz": history.orientation_wxyz}
    truth = Truth(robot_id=log.robot_id, **pose)
    off = np.zeros((30, 3))
    off[1:, 0] = np.where(np.arange(1, 30) < 12, 1.9, 2.1)
    estimate = dataclasses.replace(
        localize(log, VirtualForceParams(iterations=1)), position=history.position + off
    )

    scores = score(truth, log, estimate, history.robot, rows=measure(log, []))

    assert scores["within_dock"] == pytest.approx(11.0 / 29.0)
    far = [i == 0 and j >= 12 for i, j in log.contacts[:, [0, 2]]]
    assert scores["contacts_within_dock"] == pytest.approx(1.0 - np.mean(far))
    assert 0 < sum(far) < len(far)


def test_scores_have_both_verdicts_and_the_count_of_mirrored_robots(towers):
    """Tables of a run show which estimates to trust."""
    history = towers[0]
    log = observe(history, SensingParams())
    pose = {"position": history.position, "orientation_wxyz": history.orientation_wxyz}
    truth = Truth(robot_id=log.robot_id, **pose)
    estimate = dataclasses.replace(
        localize(log, VirtualForceParams(iterations=1)), convergence=None, mirrored=None
    )
    at_odds = Convergence(
        converged=True, consistent=False, spare=900, misfit_sd=27.0, sd_factor=3.1, chains=8,
        restarted=0,
    )  # fmt: skip
    mirrored = np.isin(np.arange(30), [1, 2, 3, 4])
    judged = dataclasses.replace(estimate, convergence=at_odds, mirrored=mirrored)
    blind = dataclasses.replace(judged, observability=None)
    naming = dataclasses.replace(judged, outlier_robots=np.array([7, 12]))

    rows = measure(log, [])
    silent, found, named, open_to_all = (
        score(truth, log, each, history.robot, rows=rows)
        for each in (estimate, judged, naming, blind)
    )

    assert {"converged", "consistent", "mirrored", "suspects"} & set(silent) == set()
    names = ("converged", "consistent", "testable", "misfit_sd", "sd_factor", "mirrored")
    assert [found[name] for name in names] == [True, False, True, 27.0, 3.1, 4]
    assert (found["spare_measurements"], found["suspects"]) == (900, 0)
    assert named["suspects"] == 2
    known = estimate.observability
    assert found["open_robots"] == (known.floppy & ~known.disconnected).sum() > 0
    assert "open_robots" not in open_to_all


def test_ranges_are_not_judged_as_contacts(towers):
    """Nor is a touch, of which one dock is known: both, among the outliers, are no contacts."""
    log = observe(towers[0], SensingParams(range_reach=8.0, false_contacts=0.05))
    robot, other = log.ranges[0, :2].astype(int)
    wrong = {tuple(row) for row in log.contacts.tolist()}
    wrong -= {tuple(row) for row in towers[0].contacts.tolist()}
    i, a, j, b = min(wrong)
    last = [len(walk.pivot_dock) for walk in towers[0].walks]
    range_row, touch = [robot, last[robot], -1, other, -1], [j, last[j], b, i, -2]
    outliers = np.array([[j, last[j], b, i, a], range_row, touch])
    estimate = localize(log, VirtualForceParams(iterations=1))
    judged = dataclasses.replace(estimate, outlier_contacts=outliers)

    scores = outlier_scores(towers[0], judged, rows=measure(log, ["contacts", "ranges"]))

    assert (scores["outliers"], scores["outlier_precision"]) == (1, 1.0)
    assert scores["wrong_contacts"] == len(wrong)


def test_every_dock_of_a_contact_counts_from_number_0_on(towers):
    """If all contacts are judged wrong, precision is the share that is; recall is complete."""
    log = observe(towers[0], SensingParams(false_contacts=0.05))
    rows = measure(log, ["contacts"])
    estimate = localize(log, VirtualForceParams(iterations=1))
    judged = dataclasses.replace(estimate, outlier_contacts=rows.sensed_contacts)

    scores = outlier_scores(towers[0], judged, rows=rows)

    assert (rows.sensed_contacts[:, [2, 4]] == 0).any()
    assert scores["outliers"] == len(log.contacts)
    assert scores["outlier_precision"] == scores["wrong_contacts"] / len(log.contacts)
    assert scores["outlier_recall"] == 1.0


def _connected(history, count):
    """Robots that contacts of the first `count` connect to robot 0, by following them."""
    pairs = {(i, j) for i, _, j, _ in history.contacts.tolist() if j < count}
    pairs |= {(j, i) for i, j in pairs}
    found, new = {0}, {0}
    while new := {j for i, j in pairs if i in new} - found:
        found |= new
    return found


@pytest.mark.parametrize("kind", ["cantilever", "bridge"])
def test_tables_state_which_robots_touch_the_anchor_or_are_beyond_the_edge(kind):
    """By slow recount; before a bridge meets, the far side is not connected to the anchor."""
    params = {
        "cantilever": CantileverParams(anchor=3.5, founders=2, spawn_behind="placed"),
        "bridge": BridgeParams(),
    }[kind]
    gaps = 0
    for history in grow(params, robots=60, seeds=[0, 3], robot=RobotGeometry()):
        on_anchor = [j for j in range(60) if [0, j] in history.contacts[:, [0, 2]].tolist()]
        table, counts = by_join(history), range(1, history.robot_count + 1)

        assert table["on_anchor"].tolist() == [sum(j < n for j in on_anchor) for n in counts]
        assert table["anchored"].tolist() == [len(_connected(history, n)) for n in counts]
        found = totals(history)
        indices = [found[f"{place}_on_anchor"] for place in ("first", "second", "third")]
        np.testing.assert_equal(indices, [*on_anchor, np.nan, np.nan, np.nan][:3])
        x = history.position[:, 0]
        assert found["beyond_edge"] == np.mean((x > 0.0) & (x < history.terrain.right_edge))
        gaps += (table["anchored"] < table["robots"]).sum()
        if kind == "bridge":
            near = history.position[:, 0] < 0.5 * params.gap
            assert table["anchored"].iloc[-2] == near[:-1].sum()
            assert table["anchored"].iloc[-1] == history.robot_count
    assert gaps > 10


def test_tables_state_which_share_of_a_tower_stands_above_the_crowd():
    """A heap of many robots is as high as a slender tower of few; their shares differ."""
    cantilever = grow(CantileverParams(), robots=4, seeds=[1], robot=RobotGeometry())[0]
    tower = grow(TowerParams(force_threshold=40.0), robots=30, seeds=[1], robot=RobotGeometry())[0]

    share = totals(tower)["above_crowd"]

    assert 0.0 < share < 1.0
    assert share == np.mean([place[2] - tower.ground_z > 20.0 for place in tower.position])
    assert np.isnan(totals(cantilever)["above_crowd"])


def test_robots_are_matched_by_name(tmp_path):
    """Rows may have any order; yaw alignment removes a turn about the vertical."""
    order = np.array([3, 1, 4, 0, 5, 2])
    turned = SHAPE @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    write_positions(tmp_path / "truth.csv", np.arange(6), SHAPE, length_unit="mm")
    write_positions(tmp_path / "estimate.csv", order, turned[order], length_unit="mm")

    scores = score_files(tmp_path / "truth.csv", tmp_path / "estimate.csv")

    assert scores.unit == "mm"
    assert scores["RMSE"] > 1.0
    assert scores["RMSE, yaw and place aligned"] == pytest.approx(0.0, abs=1e-9)
    assert scores["Procrustes disparity"] == pytest.approx(0.0, abs=1e-12)


def test_robots_that_left_are_not_scored(tmp_path):
    """However far off they are; rows may have any order, and the scores say how many left."""
    order, off = np.array([3, 1, 4, 0, 5, 2]), np.zeros_like(SHAPE)
    off[:, 0] = [0.0, 0.3, 90.0, -0.4, 70.0, 0.0]
    gone = np.where(off[:, 0] > 1.0, "yes", "no")
    write_positions(tmp_path / "truth.csv", np.arange(6), SHAPE)
    moved = (SHAPE + off)[order]
    write_positions(tmp_path / "estimate.csv", order, moved, {"gone": gone[order].tolist()})

    scores = score_files(tmp_path / "truth.csv", tmp_path / "estimate.csv")

    assert scores["RMSE"] == pytest.approx(0.25)
    assert scores["largest error"] == pytest.approx(0.4)
    assert scores["RMSE, yaw and place aligned"] < 0.5
    assert scores["Procrustes disparity"] < 0.1
    assert scores.left == 2
    assert str(scores).splitlines()[-1] == "robots that left, not scored 2"
    for errors in scores.errors.values():
        assert len(errors) == 4


@pytest.mark.parametrize(
    ("robots", "unit", "problem"),
    [([0, 1], "R", "robot 2 is in one of the two tables only"), ([0, 1, 2], "cm", "rename them")],
)
def test_what_does_not_match_is_refused(tmp_path, robots, unit, problem):
    """Missing robots and another unit are input errors."""
    write_positions(tmp_path / "truth.csv", np.arange(3), SHAPE[:3])
    path = tmp_path / "estimate.csv"
    write_positions(path, np.array(robots), SHAPE[: len(robots)], length_unit=unit)

    with pytest.raises(InputError, match=problem):
        score_files(tmp_path / "truth.csv", path)


def test_exchanged_tables_are_refused(tmp_path):
    """Errors would be the same, and the picture would lie beside the truth."""
    truth = tmp_path / "truth.csv"
    estimate = tmp_path / "estimate.csv"
    write_positions(truth, np.arange(6), SHAPE)
    write_positions(estimate, np.arange(6), SHAPE, {"sd_R": [0.1] * 6})

    assert score_files(truth, estimate)["RMSE"] == 0.0
    with pytest.raises(InputError, match=r"estimate.csv:1: sd_R is a column of an estimate"):
        score_files(estimate, truth)


def test_a_table_without_a_unit_is_refused(tmp_path):
    """The message shows what the columns should be."""
    (tmp_path / "truth.csv").write_text("robot,x,y,z\n0,0,0,0\n")

    with pytest.raises(InputError, match="write them like robot,x_R,y_R,z_R"):
        score_files(tmp_path / "truth.csv", tmp_path / "truth.csv")


def test_tables_have_no_margin_where_no_contact_has_load(tmp_path):
    """Docks of two robots on the ground press, which the law of tension does not count."""
    params = TowerParams(strength=StrengthParams(law="tension", limit=69.0))
    [history] = grow(params, robots=2, seeds=[0], robot=RobotGeometry())
    log = observe(history, SensingParams())
    truth = Truth(
        robot_id=log.robot_id,
        position=history.position,
        orientation_wxyz=history.orientation_wxyz,
    )

    robots = by_robot(truth, log, localize(log, VirtualForceParams()), history)
    write_frame(robots, tmp_path / "robots.csv")

    assert np.isinf(history.margin).all()
    assert np.isnan(totals(history)["least_margin"])
    assert read_frame(tmp_path / "robots.csv", gaps=["margin"])["margin"].isna().all()
