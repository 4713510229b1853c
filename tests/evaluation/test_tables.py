"""One row says how good an estimate is, and how good it says it is."""

import dataclasses

import numpy as np

from tiswarm.evaluation.tables import score
from tiswarm.localization.params import VirtualForceParams
from tiswarm.localization.registry import localize
from tiswarm.records.estimate import HALF_WITHIN, MOST_WITHIN
from tiswarm.records.positions import Truth
from tiswarm.sensing import SensingParams, observe


def test_intervals_cover_whom_they_cover(towers):
    """A robot counts where it is within so many standard deviations; the anchor does not."""
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

    silent, told = (score(truth, log, e, history.robot, cues=[]) for e in (estimate, sure))

    assert "coverage_50" not in silent
    assert told["coverage_50"] == np.mean(within[1:] < HALF_WITHIN)
    assert told["coverage_90"] == 1.0 - 1.0 / (count - 1)
