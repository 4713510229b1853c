"""Chains that cannot be right are annealed again, and an estimate that failed says so."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.structures import Rule, structure
from tiswarm.localization import joint
from tiswarm.localization.chains.annealer import anneal, annealer_of
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.methods import localize
from tiswarm.localization.mixture import CONVERGENCE
from tiswarm.localization.mixture.ends import failed, squares
from tiswarm.localization.mixture.mixture import between_chains, deviation
from tiswarm.localization.settings import Cues, JointParams
from tiswarm.measurements.contacts import reach

SHORT = JointParams(chains=4, steps=1500, hold_steps=200)
KINDS = ["tree", "loops", "ball", "chain"]


@pytest.mark.parametrize("kind", KINDS)
def test_no_chain_gains_energy(kind):
    """From the step on in which docks are grown the kinetic temperature is near its target.

    Docks are tangent and a third of the robots are not tied to the anchor, as in the structures
    that made chains fly apart: docks overlapped in a heap, and pushed robots and all branches that
    hold them.
    """
    log, _ = structure(Rule(kind=kind, offset=1.1547, untied=0.3), 60, 0)
    params = JointParams(steps=3000)
    annealer = annealer_of([log], [params], [pose_problem(log, params)])
    heat = []

    for step in (200, 300, 500, 800, 1200, 1800, 2500, 3000):
        annealer.advance(step)
        heat.append(annealer.temperatures(step - 1)[:, 0])

    assert np.array(heat).shape == (8, params.chains_for(60))
    assert 0.5 < np.min(heat) <= np.max(heat) < 2.0


def test_contacts_that_cannot_hold_do_not_heat_a_chain():
    """Docks that are pulled through each other at every step gain nothing: their energy is smooth.

    Each contact's fixed vector is a tenth of what it is, so that docks of a tree lie in each other.
    """
    log, _ = structure(Rule(docks=2), 12, 1)
    tolerance = {"start_sigma": 0.05, "end_sigma": 0.05}
    params = JointParams(
        steps=2000, chains=16, cues=Cues(non_overlap=False), robust=False, **tolerance
    )
    known = pose_problem(log, params)
    rows = known.rows
    short = dataclasses.replace(rows, arm=0.1 * rows.arm, neighbor_arm=0.1 * rows.neighbor_arm)
    again = dataclasses.replace(known, rows=short)  # nowhere can all of these hold
    annealer = annealer_of([log], [params], [again])
    annealer.advance(1500)
    heat = []

    for step in range(1500, 2000, 50):
        annealer.advance(step)
        heat.append(annealer.temperatures(step - 1)[:, 0])

    assert np.mean(heat, axis=0).max() < CONVERGENCE.runaway


@settings(max_examples=25)
@given(kind=st.sampled_from(KINDS), docks=st.integers(2, 5), seed=st.integers(0, 99))
def test_no_robot_is_farther_from_the_anchor_than_contacts_reach(kind, docks, seed):
    """In truth; and the bound is that of the shortest chain of contacts."""
    log, truth = structure(Rule(kind=kind, docks=docks, offset=2.0), 10, seed)
    known = pose_problem(log, JointParams())
    longest = np.linalg.norm(known.shift, axis=1) + 2.0
    slow = np.full(10, np.inf)
    slow[0] = 0.0
    for _ in range(10):
        for i, j, far in zip(known.robot, known.neighbor, longest, strict=True):
            slow[i] = min(slow[i], slow[j] + far)
            slow[j] = min(slow[j], slow[i] + far)

    bound = reach(np.column_stack([known.robot, known.neighbor]), longest, known.part)

    tied = np.isfinite(slow)
    np.testing.assert_allclose(bound[tied], slow[tied], rtol=1e-12)
    assert np.isfinite(bound).all()
    assert (np.linalg.norm(truth - truth[0], axis=1)[tied] <= bound[tied] + 1e-2).all()


def _anneal_by(monkeypatch, call):
    """Have a call anneal instead in `joint`, at first and again."""
    monkeypatch.setattr(joint, "anneal", call)


def test_a_chain_that_lost_a_robot_is_annealed_again_and_never_averaged(monkeypatch):
    """One whose robot is out of reach, or that ran hot; all others stay as they are."""
    log, _ = structure(Rule(kind="loops"), 30, 2)
    known = pose_problem(log, SHORT)
    sound = anneal([log], [SHORT], [known])[0]
    away, hot = np.zeros((2, 4))
    away[1], hot[2] = 1e3, 1e3
    last = sound.last.copy()
    last[:, -1] += away[:, None]
    torn = dataclasses.replace(sound, last=last, temperature=sound.temperature + hot)
    asked = []

    def annealed_again(*_args, halvings=0, **_):
        asked.append(halvings)
        return [torn if halvings < 2 else sound]

    _anneal_by(monkeypatch, annealed_again)

    estimate = localize(log, SHORT)

    _anneal_by(monkeypatch, lambda *_args, **_: [sound])
    assert failed(known, torn).tolist() == [False, True, True, False]
    assert not failed(known, sound).any()
    assert asked == [0, 1, 2]
    assert (estimate.convergence.restarted, estimate.convergence.converged) == (4, True)
    np.testing.assert_array_equal(estimate.position, localize(log, SHORT).position)


def test_chains_that_fail_again_and_again_do_not_count(monkeypatch):
    """Those that are left make the estimate; if none is, it says that it did not converge."""
    log, _ = structure(Rule(kind="loops"), 30, 2)
    known = pose_problem(log, SHORT)
    sound = anneal([log], [SHORT], [known])[0]
    one = dataclasses.replace(sound, temperature=np.array([9.0, 1.0, 1.0, 1.0]))
    every = dataclasses.replace(sound, temperature=np.full(4, 9.0))

    verdicts = []
    for chains in (one, every):
        _anneal_by(monkeypatch, lambda *_args, found=chains, **_: [found])
        verdicts.append(localize(log, SHORT).convergence)

    assert [found.converged for found in verdicts] == [True, False]
    assert [found.restarted for found in verdicts] == [2, 8]
    assert verdicts[0].chains <= 3
    assert verdicts[1].reason.startswith("all chains ended out of reach")


def _nonsense(log):
    """Name contacts at random, so that they cannot all hold."""
    shuffled = log.contacts.copy()
    shuffled[:, 1] = (shuffled[:, 1] + 1) % 3
    shuffled[10:, 0] = shuffled[10:, 0] // 2
    return dataclasses.replace(log, contacts=np.unique(shuffled, axis=0))


def test_an_estimate_that_misses_its_measurements_says_so():
    """And where they cannot all hold, no robot is said to be near where it is shown."""
    log, _ = structure(Rule(kind="loops"), 40, 3)

    good, bad = localize(log, SHORT), localize(_nonsense(log), SHORT)

    assert good.convergence.converged
    assert abs(good.convergence.misfit_sd) < 5.0
    # A mean over floppy motions misses contacts, the likeliest configuration does not.
    assert good.solutions[0].residual_sd < 0.1 < good.residual_sd
    assert good.outlier_contacts is not None
    assert not bad.convergence.trusted
    assert bad.convergence.reason
    assert (bad.within(log.dock_radius)[1:] < 0.5).all()


def test_no_contact_is_called_wrong_where_chains_did_not_converge():
    """Of contacts that contradict each other, the wrong ones may have been met."""
    log, _ = structure(Rule(kind="loops"), 40, 3)

    bad = localize(_nonsense(log), SHORT)

    assert not bad.convergence.converged
    assert bad.outlier_contacts is None


def test_squares_are_those_of_residuals_in_standard_deviations():
    """Of contacts, and of every coordinate that is measured: no anchor, no place of our making."""
    log, truth = structure(Rule(kind="loops", untied=0.3), 20, 4)
    heights = dataclasses.replace(log, flip_height=truth[:, 2].copy())
    known = pose_problem(heights, SHORT)
    found = anneal([heights], [SHORT], [known])[0]

    missed, away = np.split(squares(known, found), [len(known.neighbor)], axis=1)

    square = found.sigma**2
    for chain in range(SHORT.chains):
        x = found.last[chain]
        gap = np.linalg.norm(x[known.robot] + known.shift - x[known.neighbor], axis=1) - 2.0
        np.testing.assert_allclose(missed[chain], gap**2 / (known.variance + square))
        off = x[1:, 2] - truth[1:, 2]
        variance = known.rows.variance()[len(known.neighbor) :]
        np.testing.assert_allclose(away[chain], off**2 / (variance + square))


def test_parts_that_nothing_ties_are_kept_out_of_each_others_way():
    """Whatever is in them, and whoever of a part joined first without touching anybody."""
    log, _ = structure(Rule(kind="tree", untied=0.5), 60, 5)

    for seed in range(3):
        found = localize(log, dataclasses.replace(SHORT, seed=seed))
        known = pose_problem(log, SHORT)
        bound = known.reach() + 5.0
        annealer = annealer_of([log], [SHORT], [known])
        start = annealer.by_robot(annealer.swarm.position)[0]
        first = np.unique(known.part, return_index=True)[1]
        apart = np.linalg.norm(start[first][:, None] - start[first], axis=2)
        size = np.zeros(len(first))
        np.maximum.at(size, known.part, bound)
        np.fill_diagonal(apart, np.inf)
        assert (apart > size[:, None] + size).all()
        assert found.convergence.converged


ROBOTS = 4000


def _known(*, noise, shortage=0.0):
    return SimpleNamespace(variance=np.full(10, noise), underdetermination=shortage)


def _equal(chains):
    """Weights of chains that count alike."""
    return np.full(chains, 1.0 / chains)


@pytest.mark.parametrize("chains", [2, 3, 8])
def test_chains_that_are_draws_like_the_truth_show_how_far_off_their_mean_is(chains):
    """However few there are: by what they differ, and how many they are."""
    draw = np.random.default_rng(chains).normal(0.0, 0.5, (chains + 1, ROBOTS, 3))
    truth, mean = draw[0], draw[1:]

    square = between_chains(mean, _equal(chains))

    error = ((mean.mean(axis=0) - truth) ** 2).sum(axis=1)
    assert square.mean() == pytest.approx(error.mean(), rel=0.05)


@pytest.mark.parametrize("weights", [[0.6, 0.4], [0.5, 0.3, 0.2], [0.4, 0.4, 0.1, 0.1]])
def test_chains_that_count_unlike_each_other_still_show_it(weights):
    """Draws of which some have more weight make a mean that is off by more."""
    weight = np.array(weights)
    draw = np.random.default_rng(1).normal(0.0, 0.5, (len(weight) + 1, ROBOTS, 3))
    truth, mean = draw[0], draw[1:]

    square = between_chains(mean, weight)

    error = ((np.tensordot(weight, mean, 1) - truth) ** 2).sum(axis=1)
    assert square.mean() == pytest.approx(error.mean(), rel=0.05)


@given(
    chains=st.integers(2, 8),
    ends=st.integers(0, 3),
    times=st.integers(1, 4),
    seed=st.integers(0, 9),
)
def test_equal_chains_count_as_often_as_they_are(chains, ends, times, seed):
    """Mean squares are (n + 1) / n times the variance, and chains without weight are not there."""
    rng = np.random.default_rng(seed)
    mean, none = rng.normal(size=(chains, 5, 3)), rng.normal(size=(ends, 5, 3))
    weight = np.concatenate([_equal(chains), np.zeros(ends)])

    square = between_chains(np.concatenate([mean, none]), weight)
    repeated = between_chains(np.repeat(mean, times, axis=0), _equal(chains * times))
    order = rng.permutation(chains)

    variance = mean.var(axis=0, ddof=1).sum(axis=1)
    np.testing.assert_allclose(square, (chains + 1) / chains * variance, rtol=1e-9)
    n = chains * times
    np.testing.assert_allclose(
        repeated, (n + 1) / (n - 1) * mean.var(axis=0).sum(axis=1), rtol=1e-9
    )
    np.testing.assert_allclose(between_chains(mean[order], _equal(chains)), square, rtol=1e-9)


def test_of_one_chain_that_counts_the_others_show_how_much_chains_differ():
    """And none does where it is the only one."""
    mean = np.random.default_rng(0).normal(0.0, 0.5, (3, ROBOTS, 3))
    weight = np.array([1.0, 0.0, 0.0])

    square = between_chains(mean, weight)

    np.testing.assert_allclose(square, between_chains(mean, _equal(3)), rtol=1e-12)
    np.testing.assert_array_equal(between_chains(mean[:1], weight[:1]), 0.0)


@pytest.mark.parametrize("noise", [1e-9, 1.0])
def test_the_temperature_alone_makes_no_error(noise):
    """A robot that strays as little as the temperature makes it is sure to be where it is.

    Unless noise makes it stray. More straying never means less error, more unknowns more.
    """
    mean = np.zeros((2, 4, 3))
    spread = np.tile([0.0, 0.0, 1e-3, 1.0], (2, 1))

    _, still, tied, free = deviation(_known(noise=noise), mean, spread, _equal(2), 0.025)
    short = deviation(_known(noise=noise, shortage=0.5), mean, spread, _equal(2), 0.025)

    assert still == 0.0
    assert 0.0 < tied < free
    assert (tied < 0.2 * np.sqrt(1e-3)) == (noise < 1.0)
    assert short[-1] > 1.2 * free


def test_the_colder_chains_end_the_smaller_is_sd():
    """Where they stray, without noise, as much all the same."""
    mean, spread = np.zeros((2, 2, 3)), np.ones((2, 2))

    cold, warm = (
        deviation(_known(noise=1e-12), mean, spread, _equal(2), sigma)[1] for sigma in (0.01, 0.025)
    )

    assert 0.8 * warm < cold < 0.9 * warm


def test_a_chain_without_weight_does_not_stray():
    """Its variance is not in the mean of those that count."""
    mean = np.random.default_rng(0).normal(size=(3, 6, 3))
    spread, weight = np.array([[1.0], [2.0], [99.0]]) * np.ones(6), np.array([0.5, 0.5, 0.0])

    every = deviation(_known(noise=0.1), mean, spread, weight, 0.025)

    two = deviation(_known(noise=0.1), mean[:2], spread[:2], weight[:2], 0.025)
    np.testing.assert_allclose(every, two, rtol=1e-12)


def _relative(mean):
    """Standard deviations of chains that do nothing but disagree, in what they disagree by."""
    weight = _equal(len(mean))
    sd = deviation(_known(noise=1e-9), mean, np.zeros(mean.shape[:2]), weight, 0.025)
    return sd[1:] / np.sqrt(between_chains(mean, weight)[1:])


def test_what_all_robots_do_at_once_counts_more_than_what_each_does_alone():
    """Of equal disagreement, for any number of robots but two: these share nothing."""
    side = np.array([-1.0, 1.0, -1.0, 1.0])
    for robots in (2, 100):
        alone = np.random.default_rng(robots).choice([-1.0, 1.0], (4, robots, 3))
        shared = np.tile(side[:, None, None], (1, robots, 3))
        assert _relative(shared)[0] == _relative(shared)[-1]
        assert (_relative(shared).min() > 1.8 * _relative(alone).max()) == (robots == 100)


def test_the_anchor_is_where_it_is():
    """Even where all others move at once."""
    mean = np.random.default_rng(1).normal(0.0, 1.0, (4, 1, 3)) * np.array([0.0, 1.0, 1.0])[:, None]

    spread = np.full((4, 3), 1e-9)  # as sums of squares leave
    sd = deviation(_known(noise=1.0), mean, spread, _equal(4), 0.025)

    assert sd[0] == 0.0
    assert (sd[1:] > 0.0).all()
