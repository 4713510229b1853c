"""`least-squares` goes from the positions of `hop-by-hop` to a minimum of chi-square."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.localization.peers.test_hop_by_hop import fixed, ranging
from tests.localization.test_problem import true_yaw
from tests.structures import NOISY, silent
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.methods import localize
from tiswarm.localization.peers import least_squares as least_squares_method
from tiswarm.localization.peers.settings import HopByHopParams, LeastSquaresParams
from tiswarm.localization.settings import Cues, CuesOfNamedDocks, JointParams
from tiswarm.sensing import SensingParams, observe

APART = LeastSquaresParams(cues=Cues(non_overlap=False))


def noisy_ranges(seed, sd=0.05):
    """Make a log of 20 robots with noisy ranges, of which four are known."""
    log, truth = ranging(seed)
    log.ranges[:, 2] += sd * np.random.default_rng(seed).normal(size=len(log.ranges))
    return log, truth


def chi_square(log, params, position):
    """Sum squared residuals of all rows in variances, where yaw is as sensed."""
    rows = pose_problem(log, params).rows
    return float((rows.residual(position) ** 2 / rows.variance()).sum())


@pytest.mark.parametrize("seed", range(3))
def test_the_minimum_is_that_of_a_general_optimizer(seed):
    """From the true positions, scipy's trust region ends at the same ones."""
    log, truth = noisy_ranges(seed)
    rows = pose_problem(log, APART).rows
    width = np.sqrt(rows.variance())

    def residual(unknowns):
        return rows.residual(np.vstack([truth[:1], unknowns.reshape(-1, 3)])) / width

    close = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    expected = least_squares(residual, truth[1:].ravel(), x_scale="jac", **close)

    found = localize(log, APART)

    # Rounds end once the cost falls by less than 0.01.
    np.testing.assert_allclose(found.position[1:].ravel(), expected.x, atol=3e-5)
    assert found.solutions[0].chi_square == pytest.approx(2.0 * expected.cost, rel=1e-6)
    covariance = np.linalg.inv(expected.jac.T @ expected.jac)
    sd = np.sqrt(np.diag(covariance).reshape(-1, 3).sum(axis=1))
    # `sd` is computed from 64 draws of all errors, and scaled by a fitted factor.
    np.testing.assert_allclose(found.sd[1:], sd, rtol=0.35)


def test_hop_by_hop_is_never_nearer_to_the_measurements(towers):
    """The start counts as one of the minima, so that nothing is lost by going on."""
    logs = [noisy_ranges(seed)[0] for seed in range(3)]
    logs += [observe(history, SensingParams()) for history in towers]

    for log in logs:
        hops = localize(log, HopByHopParams(cues=CuesOfNamedDocks(non_overlap=False)))
        found = localize(log, APART)  # overlaps are no part of the chi-square of the rows

        # Positions are means of draws, which lie beside the minimum where robots are floppy.
        least = chi_square(log, APART, found.solutions[0].position)
        assert least <= chi_square(log, APART, hops.position) + 1e-3


def test_errors_are_smaller_than_those_of_hop_by_hop(towers):
    """All rows count, not those of earlier hops alone."""
    errors = []
    for history in towers:
        log = observe(history, replace(NOISY, suite="freesn"))

        found = [localize(log, params) for params in (HopByHopParams(), LeastSquaresParams())]

        errors.append([((e.position - history.position) ** 2).sum(axis=1).mean() for e in found])
    hops, least = np.sqrt(np.mean(errors, axis=0))
    assert least < 0.9 * hops


def test_a_bias_of_yaw_is_solved_for(towers):
    """Where walks determine it, yaw and positions come out; as it is sensed, it ruins places."""
    history = towers[0]
    log = observe(history, SensingParams(spawn_noise=0.0, yaw_bias_deg=15.0))

    solved, taken = (
        localize(log, LeastSquaresParams(solve_yaw=choice, spawn_sd=0.05))
        for choice in (True, False)
    )

    bias = true_yaw(log, history)
    off = np.linalg.norm([e.position - history.position for e in (solved, taken)], axis=2)
    assert np.abs(bias).max() > 0.3
    assert np.quantile(np.abs(solved.yaw - bias), 0.7) < 0.05
    assert taken.yaw is None
    # Taken as noise, the bias costs a factor of nine here; taken as exact, it cost more.
    assert np.median(off[0]) < 0.15 * np.median(off[1])


def test_several_starts_find_both_images_of_a_ceiling():
    """Each has half of the weight, the robot is mirrored, and sd covers both."""
    truth = np.array([[0, 0, 9.0], [12, 0, 9], [0, 12, 9], [12, 12, 9], [5, 4, 2], [7, 9, 3]])
    log = fixed(silent(truth), truth, [1, 2, 3], sd=0.05)
    pair = np.array([[i, j] for i in (4, 5) for j in range(i)])
    length = np.linalg.norm(truth[pair[:, 0]] - truth[pair[:, 1]], axis=1)
    known = np.tile([0.05, -1.0], (len(pair), 1))

    found = localize(replace(log, ranges=np.column_stack([pair, length, known])), APART)

    assert [round(s.weight, 2) for s in found.solutions] == [0.5, 0.5]
    assert found.mirrored.tolist() == [False] * 4 + [True] * 2
    image = truth * [1, 1, -1] + [0, 0, 18]
    both = [truth[4:], image[4:]]
    for solution in found.solutions:
        assert min(np.abs(solution.position[4:] - one).max() for one in both) < 0.05
    np.testing.assert_allclose(found.sd[4:], [7.0, 6.0], atol=0.1)


def test_a_wrong_range_is_named_and_left_out():
    """The estimate is that of the other ranges."""
    log, _ = noisy_ranges(0)
    row = np.flatnonzero(log.ranges[:, 0] > 10)[5]
    wrong = replace(log, ranges=log.ranges.copy())
    wrong.ranges[row, 2] += 20.0
    without = replace(log, ranges=np.delete(log.ranges, row, axis=0))

    found, expected = localize(wrong, APART), localize(without, APART)

    assert found.outlier_contacts[:, [0, 3]].tolist() == [log.ranges[row, :2].astype(int).tolist()]
    np.testing.assert_allclose(found.position, expected.position, atol=1e-3)
    assert found.convergence.trusted


def test_squares_count_without_robust(monkeypatch):
    """Then no measurement gives way at first, and the estimate is not to be trusted."""
    log, _ = noisy_ranges(0)
    log.ranges[-1, 2] += 20.0

    params = replace(APART, robust=False)
    found = localize(log, params)

    assert not found.convergence.trusted
    # A search from few starts may miss the least minimum, so that sd is wider than that of its own.
    monkeypatch.setattr(least_squares_method, "_CAUTION", 1.0)
    alone = localize(log, params)
    small = alone.sd < 1.0
    assert small.any()
    np.testing.assert_allclose(found.sd[small], 3.0 * alone.sd[small])
    assert found.convergence.sd_factor == 3.0 * alone.convergence.sd_factor
    trusted = localize(noisy_ranges(0)[0], APART)
    assert trusted.convergence.trusted
    assert trusted.convergence.sd_factor == 1.0


def test_touches_count(towers):
    """Their docks are those that are nearest where the robots are."""
    history = towers[0]
    log = observe(history, replace(NOISY, suite="freesn", contact_docks="own"))

    found = localize(log, LeastSquaresParams())

    assert "touches" in found.observability.cues


def test_parts_that_nothing_ties_do_not_push_others(towers):
    """Where they are is a guess, and robots that are known do not give way to it."""
    history = towers[0]
    log = observe(history, replace(NOISY, suite="freesn"))
    robots = log.robot_count
    last = [robots - 2, robots - 1]
    cut = np.isin(log.contacts[:, [0, 2]], last).any(axis=1)
    directed = np.isin(log.directions[:, [0, 2]], last).any(axis=1)
    loose = replace(
        log,
        contacts=log.contacts[~cut],
        directions=log.directions[~directed],
        flip_height=np.full(robots, np.nan),
        stances=None,
    )

    found = localize(loose, LeastSquaresParams())

    assert found.disconnected[last].all()
    assert not found.disconnected[: robots - 2].any()
    assert found.convergence.trusted
    assert found.sd[last].min() > 3.0 * found.sd[1 : robots - 2].max()


def test_more_starts_and_another_seed_change_starts_alone():
    """Where one minimum is found from all of them, the estimate stays."""
    log, _ = noisy_ranges(0)

    estimates = [
        localize(log, replace(APART, **change))
        for change in ({}, {"starts": 7}, {"seed": 5}, {"starts": 1})
    ]

    for other in estimates[1:]:
        np.testing.assert_allclose(other.position, estimates[0].position, atol=1e-5)
    # Starts of hops, those from directions, and both images of scaled distances: most lead there.
    chains = [estimate.convergence.chains for estimate in estimates]
    assert chains[3] < chains[0] < chains[1]


def test_an_estimate_repeats_bit_for_bit(towers):
    """Twice the same log, twice the same bytes."""
    log = observe(towers[0], NOISY)

    once, again = localize(log, LeastSquaresParams()), localize(log, LeastSquaresParams())

    assert once.position.tobytes() == again.position.tobytes()
    assert once.sd.tobytes() == again.sd.tobytes()


def test_settings_of_chi_square_are_shared_with_joint():
    """One name, one meaning, one default."""
    shared = ("robust", "solve_yaw", "seed", "contact_sd", "height_sd", "spawn_sd")

    for name in shared:
        assert getattr(LeastSquaresParams(), name) == getattr(JointParams(), name)
    assert LeastSquaresParams().used_cues == JointParams().used_cues
