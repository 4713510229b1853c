"""An outlier may be right: then the anchor, or the contact, that it contradicts is wrong."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.structures import Rule, structure, with_heights
from tiswarm.compute.chi_square import binomial_chance
from tiswarm.localization.methods import localize
from tiswarm.localization.mixture.verdict import Evidence, judge
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.cues import measure
from tiswarm.records.sensing_log import KNOWN_SD, SensingLog, SensingNoise

ROBOTS = 16
ANCHOR = 2
JOINT = JointParams(chains=4)


@pytest.fixture(scope="module")
def ball() -> tuple[SensingLog, NDArray]:
    """Sixteen robots of six docks whose contacts and heights determine where most of them are."""
    log, truth = structure(Rule(kind="ball", docks=6, offset=2.4), ROBOTS, 100_000)
    noise = SensingNoise(tilt_deg=1.0, yaw_deg=1.0)
    return replace(with_heights(log, truth), noise=noise), truth


def anchored(ball: tuple[SensingLog, NDArray], off: NDArray) -> SensingLog:
    """Know the places of two further robots, the last one shifted [R]."""
    log, truth = ball
    rows = [
        [robot, *axis, float(axis @ (truth[robot] + shift)), KNOWN_SD, -1]
        for robot, shift in [(5, np.zeros(3)), (ANCHOR, off)]
        for axis in np.eye(3)
    ]
    return replace(log, fixes=np.array(rows))


def test_an_anchor_that_is_off_by_a_dock_is_an_outlier(ball):
    """Its contacts are right, and costlier to leave out than its known position."""
    _, truth = ball
    log = anchored(ball, np.array([1.2, -1.4, 0.8]))

    found = localize(log, JOINT)

    assert not found.convergence.trusted
    assert f"known position of robot {ANCHOR} and contacts" in found.convergence.reason
    assert (found.outlier_places[:, 0] == ANCHOR).any()
    assert np.linalg.norm(found.position[ANCHOR] - truth[ANCHOR]) < 1.0


def test_anchors_that_are_right_are_believed(ball):
    """Nothing is exchanged where nothing is an outlier."""
    log = anchored(ball, np.zeros(3))

    found = localize(log, JOINT)

    assert found.convergence.trusted
    assert not len(found.outlier_places)


def evidence(log: SensingLog, outliers: list[int], anchors: list[int]) -> Evidence:
    """Gather what a method knows that leaves out some contacts; some robots are anchors."""
    rows = measure(log, ["contacts"])
    fixes = [[k, *axis, 0.0, KNOWN_SD, -1] for k in anchors for axis in np.eye(3)]
    outlier = np.zeros(len(rows), np.bool_)
    outlier[outliers] = True
    return Evidence(
        log=replace(log, fixes=np.array(fixes).reshape(-1, 7)),
        rows=rows,
        outlier=outlier,
        is_guess=np.zeros(log.robot_count, np.bool_),
        chi_square=9.0,
        unknowns=10,
        freedom=9,
    )


@pytest.mark.parametrize("is_named", [True, False])
def test_an_outlier_at_an_anchor_names_both(ball, is_named):
    """Unless most of the anchor's contacts agree with it."""
    log, _ = ball
    rows = measure(log, ["contacts"])
    of_anchor = np.flatnonzero((rows.robot == ANCHOR) | (rows.neighbor == ANCHOR))
    assert len(of_anchor) > 2

    found = judge(evidence(log, of_anchor[: None if is_named else 1].tolist(), [ANCHOR]))

    assert found.consistent is not is_named
    assert (f"robot {ANCHOR}" in found.reason) == is_named


@pytest.mark.parametrize(("stated", "is_consistent"), [(None, False), (0.1, True)])
def test_more_outliers_than_a_log_states_are_no_chance(ball, stated, is_consistent):
    """Five of 30 are rarer than 1 in 10,000 at a rate of .01, and usual at .1."""
    log, _ = ball
    log = replace(log, noise=replace(log.noise, false_contacts=stated))
    count = len(measure(log, ["contacts"]))
    outliers = [*range(5)]

    found = judge(evidence(log, outliers, []))

    assert (binomial_chance(5, count, stated or 0.01) > 1e-4) == is_consistent
    assert found.consistent is is_consistent


def test_the_chance_of_successes_is_the_sum_over_more():
    """By hand: two or three of three at a rate of .5 have chances 3 / 8 and 1 / 8."""
    chance = binomial_chance(2, 3, 0.5)

    assert chance == pytest.approx(0.5)
