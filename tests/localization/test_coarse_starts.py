"""Coarse starts: centers and directions of contacts in turn, all robots at once."""

import numpy as np
import pytest

from tests.foreign import silent, with_places
from tests.structures import NOISY, Rule, structure
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.methods import localize
from tiswarm.localization.mixture import coarse
from tiswarm.localization.mixture.coarse import coarse_starts
from tiswarm.localization.peers import least_squares
from tiswarm.localization.peers.settings import LeastSquaresParams
from tiswarm.localization.settings import JointParams
from tiswarm.sensing import SensingParams, observe


def squares_of(log):
    """Return the sum of squares of a log, and its anchor [R]."""
    anchor = log.anchor_position / log.dock_radius
    return coarse._Sum(pose_problem(log, JointParams()), anchor), anchor  # noqa: SLF001


def columns(position):
    """Lay centers (N, 3) out as one start, (3 (N - 1), 1)."""
    return position[1:].reshape(-1, 1)


def lengths(vector):
    """Lengths of vectors (C, 3, K), shape (C, 1, K)."""
    return np.linalg.norm(vector, axis=1, keepdims=True)


def test_true_centers_stay_where_they_are(tall_towers, monkeypatch):
    """They meet all links and planes, and so do the directions that follow from them."""
    squares, _ = squares_of(observe(tall_towers[0], SensingParams()))
    squares.extension = 0.0 * squares.extension
    monkeypatch.setattr(coarse, "_LEAST", 1e-12)
    truth = columns(tall_towers[0].position)
    vector = squares.vectors(truth)

    after = squares.lowered(truth, vector / lengths(vector), 0.1, np.zeros(len(vector)))

    np.testing.assert_allclose(after, truth, atol=0.02)  # docks touch to 0.006 R


def test_more_rounds_never_raise_the_sum_of_squares(monkeypatch):
    """Each of both steps is the least of the sum, as long as none looks ahead."""
    log, _ = structure(Rule(kind="loops"), 20, 3)
    squares, anchor = squares_of(log)
    squares.extension = 0.0 * squares.extension
    monkeypatch.setattr(coarse, "_AHEAD", 0.0)
    begin = np.repeat(np.tile(anchor, 19)[:, None], 3, axis=1)
    draw = np.random.default_rng(2).normal(size=(len(squares.length), 3, 3))
    sums = []
    for rounds in (1, 2, 4, 8, 16):
        monkeypatch.setattr(coarse, "_ROUNDS", rounds)
        after = squares.lowered(begin, draw / lengths(draw), 0.5, np.zeros(len(draw)))
        gap = lengths(squares.vectors(after)) - squares.length
        of_planes = (squares.jacobian @ after + squares.constant[:, None])[3 * len(gap) :]
        weight = 1.0 / (squares.variance + 0.25)
        plane_weight = 1.0 / (squares.plane_variance + 0.25)
        sums.append((weight[:, None, None] * gap**2).sum() + plane_weight @ (of_planes**2))

    sums = np.array([total.sum() for total in sums])
    assert (np.diff(sums) <= 1e-9 * sums[0]).all()
    assert sums[-1] < 0.2 * sums[0]


@pytest.mark.parametrize("is_held", [True, False])
def test_starts_meet_contacts_and_differ_where_these_do_not_suffice(tall_towers, is_held):
    """Without overlaps, all contacts can be met; walk contacts hold all robots of a tower."""
    loops, _ = structure(Rule(kind="loops"), 40, 0)
    log = observe(tall_towers[1], NOISY) if is_held else loops
    known = pose_problem(log, JointParams())
    anchor = log.anchor_position / log.dock_radius

    starts = coarse_starts(known, anchor, 0, 4)

    gap = known.residual(starts, np.zeros((4, log.robot_count)))
    np.testing.assert_array_equal(starts[:, 0], np.tile(anchor, (4, 1)))
    assert np.sqrt((gap**2).mean()) < 0.2
    away = np.linalg.norm(starts[1:] - starts[0], axis=2).max()
    assert (away < 0.2) == is_held


def test_robots_that_nothing_links_stay_with_planes_alone():
    """Without a link there is no direction, and without another robot nothing to place."""
    truth = np.array([[0.0, 0.0, 0.1], [0.5, 0.0, 0.1], [0.0, 0.7, 0.4]])
    log = with_places(silent(truth), truth, [1, 2])
    anchor = truth[0] / log.dock_radius

    starts = coarse_starts(pose_problem(log, JointParams()), anchor, 0, 2)
    alone = coarse_starts(pose_problem(silent(truth[:1]), JointParams()), anchor, 0, 2)

    np.testing.assert_allclose(starts[0], truth / log.dock_radius, atol=1e-3)
    np.testing.assert_array_equal(starts[0], starts[1])
    np.testing.assert_array_equal(alone, np.tile(anchor, (2, 1, 1)))


def test_least_squares_finds_lower_costs_from_them(monkeypatch):
    """Final contacts leave open what `hop-by-hop` decides robot by robot."""
    logs = [structure(Rule(kind="loops"), 40, seed)[0] for seed in range(3)]
    estimates = [localize(log, LeastSquaresParams()) for log in logs]
    monkeypatch.setattr(least_squares, "coarse_starts", lambda *_: np.empty((0, 40, 3)))

    before = [localize(log, LeastSquaresParams()) for log in logs]

    cost, cost_before = (
        sum(estimate.solutions[0].chi_square for estimate in of_all)
        for of_all in (estimates, before)
    )
    assert cost < 0.5 * cost_before
