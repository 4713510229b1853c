"""Weights of minima and the standard deviation of their mean, against their rules written out."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from tiswarm.localization.chains.views import ANNEALING
from tiswarm.localization.mixture import MIXTURE, SD_CALIBRATION
from tiswarm.localization.mixture.ends import _weights
from tiswarm.localization.mixture.mixture import deviation


def _weighed(cost, heat):
    """Likelihoods of ends at a temperature, which add up to 1, and the effective number of ends."""
    chance = [math.exp(-(c - min(cost)) / (2.0 * heat)) for c in cost]
    share = [c / sum(chance) for c in chance]
    return share, 1.0 / sum(s * s for s in share)


def _weights_slowly(cost, measurements):
    """Weights at the lowest of some temperatures that leaves enough ends, without dust."""
    hottest = max(1.0, math.sqrt(2 * measurements) / MIXTURE.chance)
    heats = [hottest ** (k / (MIXTURE.heats - 1)) for k in range(MIXTURE.heats)]
    enough = [heat for heat in heats if _weighed(cost, heat)[1] >= MIXTURE.fewest - 1e-9]
    share, _ = _weighed(cost, (enough or heats[-1:])[0])
    counted = [s if s >= MIXTURE.least_weight else 0.0 for s in share]
    return [c / sum(counted) for c in counted]


def test_weights_are_those_of_the_coldest_mixture_with_enough_ends():
    """Costs count in units of a temperature, which rises until enough ends have weight.

    Some chains failed. In one case of seven a temperature between the extremes is the first.
    """
    draw = np.random.default_rng(0)
    for _ in range(400):
        excess = 10.0 ** draw.uniform(-1.0, 3.0) * draw.random(draw.integers(1, 17))
        cost = np.append(1000.0 + excess, np.full(draw.integers(3), math.inf))
        measurements = int(draw.integers(5000))

        weight = _weights(cost, measurements)

        slow = _weights_slowly(cost, measurements)
        np.testing.assert_allclose(weight, slow, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("measurements", [50, 200, 1000, 5000])
def test_mixtures_of_many_measurements_are_hotter(measurements):
    """Of ends whose costs differ by ten each, the chi-square's width decides how many count."""
    cost = 10.0 * np.arange(9)

    weight = _weights(cost, measurements)

    slow = _weights_slowly(cost.tolist(), measurements)
    np.testing.assert_allclose(weight, slow, rtol=1e-9)
    assert weight[0] < _weights(cost, measurements // 5)[0]


def _deviation_slowly(known, mean, within, weight, sigma):
    """Standard deviation of each robot, robot by robot."""
    fit, warmest = SD_CALIBRATION, ANNEALING.warmest
    chains, robots = mean.shape[:2]
    noise = np.mean([v / (v + warmest**2) for v in known.variance])
    many = 1.0 / sum(w**2 for w in weight)

    def between(place):
        center = sum(w * p for w, p in zip(weight, place, strict=True))
        apart = sum(w * ((p - center) ** 2).sum() for w, p in zip(weight, place, strict=True))
        return apart * (many + 1.0) / (many - 1.0)

    found = [0.0]
    for robot in range(1, robots):
        rest = [k for k in range(1, robots) if k != robot]
        others = mean[:, rest].mean(axis=1)
        strays = sum(weight[c] * within[c, robot] for c in range(chains))
        square = strays + between(mean[:, robot]) + fit.shared * between(others)
        square = square**2 / (square + fit.thermal_variance * (1.0 - noise) * sigma**2)
        power = fit.shared_noise_power * noise
        sd = math.sqrt(square) ** (1.0 - power) * (fit.shared_noise_at * sigma) ** power
        sd *= (fit.sharp * (sigma / warmest) ** fit.sharp_power) ** (1.0 - noise)
        found.append(sd * (1.0 + fit.underdetermined * known.underdetermination))
    return found


@pytest.mark.parametrize("noise", [1e-9, 2e-4, 1.0])
@pytest.mark.parametrize("sigma", [0.01, 0.04])
def test_sd_of_a_mean_of_chains_is_its_rule_written_out(noise, sigma):
    """Of chains of unlike weight that stray and differ, with noise, heat and unknowns at once."""
    draw = np.random.default_rng(3)
    known = SimpleNamespace(variance=noise * np.array([0.5, 1.0, 2.0]), underdetermination=0.3)
    mean, within = draw.normal(0.0, 0.1, (3, 5, 3)), draw.uniform(0.001, 0.02, (3, 5))
    weight = np.array([0.5, 0.3, 0.2])

    sd = deviation(known, mean, within, weight, sigma)

    slow = _deviation_slowly(known, mean, within, weight, sigma)
    np.testing.assert_allclose(sd, slow, rtol=1e-9)
