"""Estimates by joint: how near they are, with and without noise, and what wrong logs do to them."""

import dataclasses
from itertools import compress
from types import SimpleNamespace

import numpy as np
import pytest

from tests.localization.test_problem import true_yaw
from tests.structures import NOISY, grown
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.math import dock_offsets
from tiswarm.evaluation.tables import outlier_scores
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.chains.views import ANNEALING, place_disconnected
from tiswarm.localization.methods import localize, localize_many
from tiswarm.localization.settings import SWITCHES, Cues, JointParams
from tiswarm.measurements.cues import measure
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.mechanics import MechanicsParams
from tiswarm.world.params import CantileverParams

pytestmark = pytest.mark.unchecked

SHORT = JointParams(chains=2, steps=300, hold_steps=100)
BIASED = dataclasses.replace(NOISY, yaw_bias_deg=15.0, spawn_noise=0.2)


@pytest.fixture(scope="module")
def log(towers) -> SensingLog:
    """What the robots of a small tower sensed, with noise."""
    return observe(towers[0], NOISY)


def _rmse(position, history):
    return np.sqrt(((position - history.position) ** 2).sum(axis=1).mean())


def test_robots_are_found_without_noise(towers):
    """Where walks leave next to nothing unknown, robots are where they truly are.

    In one tower two places of some robots fit: roundings decide between them and their mean. The
    spread of the chains states what is unknown.
    """
    logs = [observe(history, SensingParams()) for history in towers]
    params = dataclasses.replace(SHORT, steps=2000)

    estimates = localize_many(logs, [params] * len(logs))

    error, sd = (np.concatenate(each) for each in zip(*[
        (np.linalg.norm(e.position - h.position, axis=1)[1:], e.sd[1:])
        for e, h in zip(estimates, towers, strict=True)
    ], strict=True))  # fmt: skip
    assert np.median(error) < 0.15
    assert np.mean(error < 1.55 * sd) > 0.5
    for estimate in estimates:
        assert estimate.residual[-1] < 0.3 * estimate.residual[0]
        np.testing.assert_array_equal(estimate.trace[-1], estimate.position)


def test_a_large_structure_is_annealed_fewer_times_and_quicker():
    """Unless the settings say how often, in how many steps."""
    assert [JointParams().chains_for(robots) for robots in (2, 3000, 3001)] == [8, 8, 4]
    steps = [JointParams().steps_for(robots) for robots in (100, 3000, 3001, 30_000, 100_000)]
    assert steps == [1200, 3000, 2000, 2000, 4934]
    chosen = JointParams(chains=9, steps=70)
    assert (chosen.chains_for(3001), chosen.steps_for(3001)) == (9, 70)


@pytest.mark.parametrize("robots", [200, pytest.param(1000, marks=pytest.mark.trial)])
def test_a_long_arm_is_not_torn_from_its_anchor(robots):
    """All robots come to the one that stands still, whose contacts are not given up."""
    params = CantileverParams(movers=10, solve_every=100, mechanics=MechanicsParams(model="rigid"))
    history = grown(params, robots=robots, seed=1000)
    log = observe(history, SensingParams())

    estimate = localize(log, JointParams(chains=1, cues=Cues(walk_contacts=False)))

    assert _rmse(estimate.position, history) < 2.5
    assert not (estimate.outlier_contacts[:, 3] == 0).any()


def test_company_names_and_order_do_not_change_a_byte(towers):
    """Alone or together, renamed and shuffled: the same bits."""
    logs = [observe(h, n) for h, n in zip(towers, [NOISY, BIASED, BIASED], strict=True)]
    params = [
        SHORT,
        dataclasses.replace(SHORT, cues=Cues(height=False, walk_contacts=False)),
        SHORT,
    ]
    shuffled = [_renamed_and_shuffled(log) for log in logs]

    together = localize_many(logs, params)
    alone = [localize(log, p) for log, p in zip(shuffled, params, strict=True)]
    reverse = localize_many(logs[::-1], params[::-1])[::-1]

    for a, b, c in zip(together, alone, reverse, strict=True):
        assert a.trace.tobytes() == b.trace.tobytes() == c.trace.tobytes()
        assert a.sd.tobytes() == b.sd.tobytes() == c.sd.tobytes()
    assert together[2].yaw.tobytes() == alone[2].yaw.tobytes() == reverse[2].yaw.tobytes()


@pytest.mark.program(precision="f32")
def test_single_precision_is_precise_enough(towers):
    """Other bits make other chains, but robots are found."""
    log = observe(towers[0], SensingParams())

    estimate = localize(log, dataclasses.replace(SHORT, steps=1000))

    assert np.median(np.linalg.norm(estimate.position - towers[0].position, axis=1)) < 0.3


def test_wrong_contacts_are_given_up(towers):
    """Contacts that are none ruin a trusting estimate and hardly touch a robust one.

    Where the search failed, which short settings allow for one of three towers, it names none.
    """
    noise = dataclasses.replace(NOISY, false_contacts=0.05)
    logs = [observe(history, noise) for history in towers]
    params = dataclasses.replace(SHORT, steps=2000)

    robust = localize_many(logs, [params] * 3)
    trusting = localize_many(logs, [dataclasses.replace(params, robust=False)] * 3)

    def total(estimates):
        return sum(_rmse(e.position, h) for e, h in zip(estimates, towers, strict=True))

    assert total(robust) < 0.7 * total(trusting)
    taken, right, wanted = 0, 0, 0
    named = [estimate.outlier_contacts is not None for estimate in robust]
    assert named == [estimate.convergence.converged for estimate in robust]
    assert sum(named) >= 2
    for log, history, estimate in compress(zip(logs, towers, robust, strict=True), named):
        judged = outlier_scores(history, estimate, rows=measure(log, params.used_cues))
        true = _touched(history)
        felt = [tuple(row) for row in measure(log, SWITCHES).sensed_contacts.tolist()]
        doubted = [tuple(row) for row in estimate.outlier_contacts.tolist()]
        wrong = [row for row in felt if row not in true]
        hits = [row for row in doubted if row in wrong]
        assert set(doubted) <= set(felt)
        assert judged["wrong_contacts"] == len(wrong) > log.robot_count / 6
        assert judged["outlier_precision"] == len(hits) / len(doubted)
        assert judged["outlier_recall"] == len(hits) / len(wrong) > 0.5
        taken, right, wanted = taken + len(doubted), right + len(hits), wanted + len(wrong)
    assert right / taken > 0.95
    assert right / wanted > 0.85


def _touched(history):
    """Every contact there truly was, as a log would tell it."""
    return {
        (robot, *row) for robot, walk in enumerate(history.walks) for row in walk.contacts.tolist()
    }


def test_a_bias_of_yaw_is_found(towers):
    """Robots that are turned back are found better; only a bias that the log states is solved."""
    logs = [observe(history, BIASED) for history in towers]
    params = dataclasses.replace(SHORT, steps=1000)

    solved = localize_many(logs, [params] * 3, with_observability=True)
    fixed = [dataclasses.replace(params, solve_yaw=False)] * 3
    taken = localize_many(logs, fixed, with_observability=True)

    bias = [true_yaw(*each) for each in zip(logs, towers, strict=True)]
    left = [estimate.yaw - each for estimate, each in zip(solved, bias, strict=True)]
    assert np.square(left).mean() < 0.5**2 * np.square(bias).mean()
    errors = [
        [_rmse(estimate.position, history) for estimate, history in zip(each, towers, strict=True)]
        for each in (solved, taken)
    ]
    assert sum(errors[0]) < 0.6 * sum(errors[1])
    for s, t in zip(solved, taken, strict=True):
        assert t.yaw is None
        assert (s.observability.yaw_unknown, t.observability.yaw_unknown) == (True, False)
    assert localize(observe(towers[0], NOISY), SHORT).yaw is None


def test_a_log_of_bare_contacts_is_enough(log):
    """One dock, no flips, no heights, no ground, a robot that nothing ties: all get a place."""
    bare = dataclasses.replace(
        log,
        dock_offset_body=log.dock_offset_body[:1],
        contacts=np.array([[0, 0, 1, 0], [1, 0, 2, 0]], np.int32),
        robot_id=np.array([70, -3, 12, 9]),
        orientation_wxyz=log.orientation_wxyz[:4],
        ground_z=None,
        ground_docks=np.empty((0, 2), np.int32),
        flip_height=np.full(4, np.nan),
        spawn_position=np.full((4, 3), np.nan),
        stances=None,
        noise=None,
    )

    estimate = localize(bare, SHORT)

    assert estimate.disconnected.tolist() == [False, False, False, True]
    assert np.isfinite(estimate.position).all()
    assert (estimate.sd[1:] > 0.4).all()  # on a sphere, and not all around it in so few steps
    silent = dataclasses.replace(bare, contacts=np.empty((0, 4), np.int32))
    alone = localize(silent, SHORT)
    assert np.isfinite(alone.position).all()
    assert (alone.sd[1:] >= 2.0 * silent.dock_radius).all()  # each touched a robot before it


@pytest.mark.parametrize("before", [0, 300])
def test_each_part_that_nothing_ties_is_put_where_its_first_robot_may_have_joined(before):
    """Along axes that nothing tells, amid earlier robots; its shape and its heights stay.

    It may be off as far as these are from there, and more; at least by docks in contact, 2 R.
    """
    chain = np.random.default_rng(0).normal(0.0, 5.0, (2, before + 6, 3))
    part = np.pad([0, 0, 2, 0, 1, 2], (before, 0))
    untied = part > 0
    loose = untied[:, None, None] * np.diag([1.0, 1.0, 0.0])
    known = SimpleNamespace(part=part, untied=untied, loose=loose)

    put, square = place_disconnected(chain, known)

    np.testing.assert_array_equal(put[:, ~untied], chain[:, ~untied])
    np.testing.assert_array_equal(put[..., 2], chain[..., 2])
    shape = put[:, -1] - put[:, -4]
    np.testing.assert_allclose(shape, chain[:, -1] - chain[:, -4], atol=1e-12)
    for first in (before + 2, before + 4):
        likely = [np.exp((i - first) / ANNEALING.join_memory) for i in range(first)]
        place = sum(w * put[:, i, :2] for i, w in enumerate(likely)) / sum(likely)
        np.testing.assert_allclose(put[:, first, :2], place, atol=1e-12)
        away = [((put[:, i, :2] - place) ** 2).sum(axis=1) for i in range(first)]
        off = [ANNEALING.join_variance * a + square[:, i] for i, a in enumerate(away)]
        off = sum(w * o for w, o in zip(likely, off, strict=True)) / sum(likely)
        np.testing.assert_allclose(square[:, first], np.maximum(off, 4.0), rtol=1e-12)
    np.testing.assert_array_equal(square[:, ~untied], 0.0)
    np.testing.assert_array_equal(square[:, -1], square[:, -4])


def _renamed_and_shuffled(log: SensingLog) -> SensingLog:
    rng = np.random.default_rng(0)
    stances = dataclasses.replace(
        log.stances,
        contacts=rng.permutation(log.stances.contacts),
        ground_docks=rng.permutation(log.stances.ground_docks),
    )
    return dataclasses.replace(
        log,
        robot_id=rng.permutation(log.robot_count) - 7,
        contacts=rng.permutation(log.contacts),
        ground_docks=rng.permutation(log.ground_docks),
        stances=stances,
    )


@pytest.mark.parametrize("robots", [20, pytest.param(40, marks=pytest.mark.trial)])
def test_touches_of_a_rounded_edge_that_a_log_takes_for_flat_ground_are_outliers(robots):
    """They are listed, and cost hardly any accuracy; without the robust loss they cost much."""
    histories = grow(CantileverParams(), robots=robots, seeds=[1000, 1001], robot=RobotGeometry())
    logs = [observe(history, NOISY) for history in histories]
    edged = [_edge_as_ground(*each) for each in zip(histories, logs, strict=True)]
    params = JointParams(chains=4, steps=1500)

    right, robust, trusting = (
        localize_many(sensed, [chosen] * 2)
        for sensed, chosen in (
            (logs, params), (edged, params), (edged, dataclasses.replace(params, robust=False)),
        )
    )  # fmt: skip

    def error(estimates):
        off = [e.position - h.position for e, h in zip(estimates, histories, strict=True)]
        return np.sqrt(np.mean(np.square(np.concatenate(off)).sum(axis=1)))

    assert error(robust) < 1.5 * error(right) < 0.7 * error(trusting)
    for log, edge, estimate in zip(logs, edged, robust, strict=True):
        true = {tuple(row) for row in measure(log, SWITCHES).sensed_places.tolist()}
        added = {tuple(row) for row in measure(edge, SWITCHES).sensed_places.tolist()} - true
        listed = {tuple(row) for row in estimate.outlier_places.tolist()}
        assert len(listed) > 3
        assert listed <= added


def _edge_as_ground(history, log):
    """List every dock that touches the rounded edge at any stance as one on flat ground."""
    final, earlier = [], []
    for j, walk in enumerate(history.walks):
        arm = dock_offsets(walk.orientation_wxyz, history.robot.dock_offset_body)
        dock = walk.center[:, None] + arm
        gap = -history.terrain.depth(dock.reshape(-1, 3), 1.0).reshape(dock.shape[:2])
        for stance, own in np.argwhere(gap < 0.02).tolist():
            last = stance == len(dock) - 1
            row = (j if last else log.stances.start[j] + stance, own)
            (final if last else earlier).append(row)
    ground, before = (np.array(rows, np.int32).reshape(-1, 2) for rows in (final, earlier))
    stances = dataclasses.replace(log.stances, ground_docks=before)
    return dataclasses.replace(log, ground_docks=ground, stances=stances)


def test_the_residual_of_each_frame_uses_the_yaw_of_that_frame(towers):
    """The first frame has robots as they were sensed, the last as they are estimated.

    In sd, the last residual counts the heat that chains end in.
    """
    log = observe(towers[0], dataclasses.replace(NOISY, yaw_bias_deg=20.0))
    params = dataclasses.replace(SHORT, end_sigma=0.05)
    known = pose_problem(log, params)

    estimate = localize(log, params)

    for frame, yaw in ((0, np.zeros(log.robot_count)), (-1, estimate.yaw)):
        gap = known.residual(estimate.trace[frame], yaw)
        assert estimate.residual[frame] == pytest.approx(np.sqrt(np.mean(gap**2)), rel=1e-9)
    width = np.sqrt(known.variance + params.end_sigma**2)
    assert estimate.residual_sd == pytest.approx(np.sqrt(np.mean((gap / width) ** 2)), rel=1e-9)
