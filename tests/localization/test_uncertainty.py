"""How far off an estimate may be follows from how much its chains stray and disagree."""

from types import SimpleNamespace

import numpy as np
import pytest

from tiswarm.localization.joint.uncertainty import between_chains, deviation

ROBOTS = 4000


def _known(*, noise, shortage=0.0):
    return SimpleNamespace(variance=np.full(10, noise), underdetermination=shortage)


@pytest.mark.parametrize("chains", [2, 3, 8])
def test_chains_that_are_draws_like_the_truth_tell_how_far_off_their_mean_is(chains):
    """However few there are: by what they differ, and how many they are."""
    draw = np.random.default_rng(chains).normal(0.0, 0.5, (chains + 1, ROBOTS, 3))
    truth, mean = draw[0], draw[1:]

    told = between_chains(mean, np.ones(chains, bool))

    error = ((mean.mean(axis=0) - truth) ** 2).sum(axis=1)
    assert told.mean() == pytest.approx(error.mean(), rel=0.05)


def test_of_one_sound_chain_the_others_tell_how_much_chains_differ():
    """And nobody does where it is the only one."""
    mean = np.random.default_rng(0).normal(0.0, 0.5, (3, ROBOTS, 3))
    sound = np.array([True, False, False])

    told = between_chains(mean, sound)

    expected = ((mean[1:] - mean[0]) ** 2).sum(axis=(0, 2)) / 3.0
    np.testing.assert_allclose(told, expected, rtol=1e-12)
    np.testing.assert_array_equal(between_chains(mean[:1], sound[:1]), 0.0)


@pytest.mark.parametrize("noise", [1e-9, 1.0])
def test_the_tolerance_alone_makes_no_error(noise):
    """A robot that strays as little as the tolerance makes it is sure to be where it is.

    Unless noise makes it stray. More straying never means less error, more unknowns more.
    """
    mean = np.zeros((2, 4, 3))
    spread = np.tile([0.0, 0.0, 1e-3, 1.0], (2, 1))

    _, still, tied, free = deviation(_known(noise=noise), mean, spread, np.ones(2, bool), 0.025)
    short = deviation(_known(noise=noise, shortage=0.5), mean, spread, np.ones(2, bool), 0.025)

    assert still == 0.0
    assert 0.0 < tied < free
    assert (tied < 0.2 * np.sqrt(1e-3)) == (noise < 1.0)
    assert short[-1] > 1.2 * free


def test_the_colder_chains_end_the_surer_is_what_they_tell():
    """Where they stray, without noise, as much all the same."""
    mean, spread, sound = np.zeros((2, 2, 3)), np.ones((2, 2)), np.ones(2, bool)

    cold, warm = (
        deviation(_known(noise=1e-12), mean, spread, sound, tolerance)[1]
        for tolerance in (0.01, 0.025)
    )

    assert 0.8 * warm < cold < 0.9 * warm


def _told(mean):
    """What chains tell of each robot that do nothing but disagree, in what they disagree by."""
    sound = np.ones(len(mean), bool)
    sd = deviation(_known(noise=1e-9), mean, np.zeros(mean.shape[:2]), sound, 0.025)
    return sd[1:] / np.sqrt(between_chains(mean, sound)[1:])


def test_what_all_robots_do_at_once_counts_more_than_what_each_does_alone():
    """Of equal disagreement, whatever the number of robots but two: these share nothing."""
    side = np.array([-1.0, 1.0, -1.0, 1.0])
    for robots in (2, 100):
        alone = np.random.default_rng(robots).choice([-1.0, 1.0], (4, robots, 3))
        shared = np.tile(side[:, None, None], (1, robots, 3))
        assert _told(shared)[0] == _told(shared)[-1]
        assert (_told(shared).min() > 1.8 * _told(alone).max()) == (robots == 100)


def test_the_anchor_is_where_it_is():
    """Even where all others move at once."""
    mean = np.random.default_rng(1).normal(0.0, 1.0, (4, 1, 3)) * np.array([0.0, 1.0, 1.0])[:, None]

    spread = np.full((4, 3), 1e-9)  # as sums of squares leave
    sd = deviation(_known(noise=1.0), mean, spread, np.ones(4, bool), 0.025)

    assert sd[0] == 0.0
    assert (sd[1:] > 0.0).all()
