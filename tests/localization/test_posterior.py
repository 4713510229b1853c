"""Exact posteriors are exact, and `joint` states their standard deviations."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from benchmarks.estimates import assembly
from benchmarks.estimates.posterior import compared
from tests.oracle import matrix
from tests.oracle_posterior import CONTACT_SD, OVERLAP_SD, posterior
from tests.structures import silent
from tiswarm.records.sensing_log import SensingNoise

ARM = 1.5
ROUGH_DEG = 4.0
TURNS = SensingNoise(tilt_deg=2.0, yaw_deg=2.0)


def _one_dock(robots, **sensed):
    """Log robots of one dock each, at distance `ARM` from the center, whose noise is `TURNS`."""
    return silent(
        np.zeros((robots, 3)), dock_offset_body=np.array([[ARM, 0.0, 0.0]]), noise=TURNS, **sensed
    )


def _length_variance():
    """Write out the variance of the distance of two docks: a sphere's cross section is 2 / 3."""
    return CONTACT_SD**2 + 2.0 * np.radians(2.0) ** 2 * ARM**2 * 2.0 / 3.0


def test_a_robot_on_one_contact_is_on_a_shell():
    """Its center is 2 R from the other dock less its arm, in all directions alike."""
    log = _one_dock(2, contacts=[[0, 0, 1, 0]])
    variance = _length_variance()

    drawn = posterior(log, seed=0, particles=2_000, levels=30)

    # Moments of r^2 N(r; 2, s^2) over r in closed form: a shell has more room outside.
    fourth = 2.0**4 + 6.0 * 2.0**2 * variance + 3.0 * variance**2
    square = fourth / (2.0**2 + variance)
    assert drawn.sd[1] == pytest.approx(np.sqrt(square), rel=0.02)
    # Four standard deviations of a mean of 2,000 draws.
    assert_allclose(drawn.mean[1], 0.0, atol=4.0 * 2.0 / np.sqrt(3.0 * 2_000))


def test_a_height_weighs_directions():
    """The height of a robot on one contact is uniform, times the density of what it measured."""
    height, sd = 1.0, 0.5
    fix = [1, 0.0, 0.0, 1.0, height, sd, -1]
    log = _one_dock(2, contacts=[[0, 0, 1, 0]], fixes=np.array([fix]))

    drawn = posterior(log, seed=1, particles=2_000, levels=30)

    # By quadrature over a shell without width, which s = 0.06 R changes by (s / 2)^2.
    z = np.linspace(-2.0, 2.0, 4_001)
    density = np.exp(-0.5 * ((z - height) / sd) ** 2)
    density /= density.sum()
    mean = float(density @ z)
    assert drawn.mean[1, 2] == pytest.approx(mean, abs=0.05)
    square = float(density @ (4.0 - z**2)) + float(density @ (z - mean) ** 2)
    assert drawn.sd[1] == pytest.approx(np.sqrt(square), rel=0.03)


@pytest.fixture(scope="module")
def ring():
    """Log three robots of four docks that touch in a ring, with more noise than they have."""
    random = np.random.default_rng(4)
    log, _ = assembly.built(assembly.ring(3, random), 4, random)
    return replace(log, noise=SensingNoise(tilt_deg=ROUGH_DEG, yaw_deg=ROUGH_DEG))


def _by_force(log, draws, seed):
    """Draw both centers around the anchor, and weigh them by the third contact and overlaps."""
    random = np.random.default_rng(seed)
    arm = np.array([log.dock_offset_body @ matrix(q).T for q in log.orientation_wxyz])
    length = np.linalg.norm(log.dock_offset_body, axis=1)[0]
    sd = np.sqrt(CONTACT_SD**2 + 2.0 * np.radians(ROUGH_DEG) ** 2 * length**2 * 2.0 / 3.0)
    touching = {(i, j): (a, b) for i, a, j, b in log.contacts.tolist()}
    assert {*touching} == {(0, 1), (0, 2), (1, 2)}
    center = [np.zeros((draws, 3))]
    log_weight = np.zeros(draws)
    for robot in (1, 2):
        from_dock, to_dock = touching[0, robot]
        unit = random.normal(size=(draws, 3))
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        away = 2.0 + sd * random.normal(size=draws)
        center.append(arm[0, from_dock] + away[:, None] * unit - arm[robot, to_dock])
        log_weight += np.log(away**2)
    point = np.array(center)[:, None] + arm[:, :, None]
    docks = arm.shape[1]
    for (i, j), (from_dock, to_dock) in touching.items():
        for a in range(docks):
            for b in range(docks):
                distance = np.linalg.norm(point[i, a] - point[j, b], axis=1)
                if (a, b) != (from_dock, to_dock):
                    log_weight -= 0.5 * (np.minimum(distance - 2.0, 0.0) / OVERLAP_SD) ** 2
                elif i:
                    log_weight -= 0.5 * ((distance - 2.0) / sd) ** 2
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    place = np.array(center)
    mean = np.einsum("k,nkc->nc", weight, place)
    square = np.einsum("k,nkc->n", weight, (place - mean[:, None]) ** 2)
    return mean, np.sqrt(square), 1.0 / (weight**2).sum()


def test_a_ring_of_three_is_as_brute_force_says(ring):
    """Two centers on shells are drawn without any chain; the last contact weighs them."""
    mean, sd, effective = _by_force(ring, 400_000, seed=5)
    assert effective > 1_000.0

    drawn = posterior(ring, seed=2, particles=1_000)

    # Four standard deviations of means of 1,000 draws, which are related, are 0.2 sd.
    assert_allclose(drawn.mean, mean, atol=0.2 * sd.max())
    assert_allclose(drawn.sd[1:], sd[1:], rtol=0.1)


@pytest.fixture(scope="module")
def stated():
    """Compare what `joint` states of a ring of robots with two runs of the oracle."""
    return pd.DataFrame([*compared(14, "joint")])


def test_two_runs_agree(stated):
    """Means are within a third of the sd of each other, and sd within a quarter."""
    square = (stated[["runs_apart_R", "exact_sd_R"]] ** 2).mean()

    assert stated["one_run_sd_R"].to_numpy() == pytest.approx(stated["other_run_sd_R"], rel=0.25)
    assert square["runs_apart_R"] < square["exact_sd_R"] / 9.0


def _median_ratio(table):
    return (table["sd_R"] / table["exact_sd_R"]).groupby(table["number"]).median().median()


def test_joint_states_the_deviation_of_the_posterior(stated):
    """Of one log, the median ratio of its sd to the exact one is within 15 % of 1."""
    ratio = _median_ratio(stated)

    assert ratio == pytest.approx(1.0, abs=0.15)


@pytest.mark.slow
def test_joint_states_deviations_and_errors_of_posteriors():
    """Of 30 logs that is within 10 %, and its law scores at most 1.15 times what is attainable."""
    table = pd.concat([pd.DataFrame([*compared(number, "joint")]) for number in range(30)])

    ratio = _median_ratio(table)
    score = table.groupby("number")[["crps_law_R", "crps_exact_R"]].mean().mean()
    assert ratio == pytest.approx(1.0, abs=0.1)
    assert score["crps_law_R"] <= 1.15 * score["crps_exact_R"]
