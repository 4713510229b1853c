"""How far off an estimate may be follows from how much its chains stray and disagree."""

from types import SimpleNamespace

import numpy as np
import pytest

from tiswarm.localization.joint import deviation

ROBOTS = 4000


def _known(*, noise, shortage=0.0):
    return SimpleNamespace(variance=np.full(10, noise), shortage=shortage)


@pytest.mark.parametrize("chains", [2, 3, 8])
def test_chains_that_are_draws_like_the_truth_tell_how_far_off_their_mean_is(chains):
    """However few there are: by what they differ, and how many they are."""
    draw = np.random.default_rng(chains).normal(0.0, 0.5, (chains + 1, ROBOTS, 3))
    truth, mean = draw[0], draw[1:]

    told = deviation.disagreement(mean, np.ones(chains, bool))

    error = ((mean.mean(axis=0) - truth) ** 2).sum(axis=1)
    assert told.mean() == pytest.approx(error.mean(), rel=0.05)


def test_of_one_sound_chain_the_others_tell_how_much_chains_differ():
    """And nobody does where it is the only one."""
    mean = np.random.default_rng(0).normal(0.0, 0.5, (3, ROBOTS, 3))
    sound = np.array([True, False, False])

    told = deviation.disagreement(mean, sound)

    expected = ((mean[1:] - mean[0]) ** 2).sum(axis=(0, 2)) / 3.0
    np.testing.assert_allclose(told, expected, rtol=1e-12)
    np.testing.assert_array_equal(deviation.disagreement(mean[:1], sound[:1]), 0.0)


@pytest.mark.parametrize("noise", [1e-9, 1.0])
def test_the_tolerance_alone_makes_no_error(noise):
    """A robot that strays as little as the tolerance makes it is sure to be where it is.

    Unless noise makes it stray. More straying never means less error, more unknowns more.
    """
    mean = np.zeros((2, 3, 3))
    spread = np.tile([0.0, 1e-3, 1.0], (2, 1))

    still, tied, free = deviation.deviation(
        _known(noise=noise), mean, spread, np.ones(2, bool), 0.025
    )
    short = deviation.deviation(
        _known(noise=noise, shortage=0.5), mean, spread, np.ones(2, bool), 0.025
    )

    assert still == 0.0
    assert 0.0 < tied < free
    assert (tied < 0.2 * np.sqrt(1e-3)) == (noise < 1.0)
    assert short[2] > 1.2 * free
