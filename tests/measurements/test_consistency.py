"""Contacts that cannot be are found and told with their line; those that can are let be."""

import dataclasses
import tracemalloc

import numpy as np
import pytest

from tests.structures import NOISY, silent
from tiswarm.measurements.cues import measure
from tiswarm.measurements.model import inconsistent_places
from tiswarm.measurements.units import contradictions
from tiswarm.records.sensing_log import SensingNoise, Stances
from tiswarm.sensing import SensingParams, observe

CUES = ("ground", "height", "walk_contacts")
UPRIGHT = [1.0, 0.0, 0.0, 0.0]


def _log(contacts, heights=(0.0, 0.0, 0.0), noise=0.0):
    """Three robots, named 10, 11 and 12, turned alike."""
    return silent(
        np.zeros((3, 3)),
        robot_id=np.array([10, 11, 12]),
        contacts=contacts,
        flip_height=np.array(heights),
        noise=SensingNoise(tilt_deg=noise, yaw_deg=noise),
    )


@pytest.mark.parametrize(
    "params",
    [SensingParams(), SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0, yaw_bias_deg=5.0)],
)
def test_what_was_truly_felt_is_no_contradiction(towers, params):
    """Neither grown structures nor the noise that a log states give a false alarm."""
    for history in towers:
        log = observe(history, params)

        assert contradictions(log) == []
        assert contradictions(dataclasses.replace(log, stances=None)) == []


@pytest.mark.parametrize(
    ("log", "line", "problem"),
    [
        # Docks 0 and 1 lie 2.6 R apart: on another's docks 1 and 0 they would need 5.2 R of 4 R.
        (
            _log([[0, 1, 1, 0], [0, 0, 1, 1]]),
            3,
            "robot 11's contact [0, 10, 1] and robot 11's contact [1, 10, 0] are inconsistent",
        ),
        # From 10 by 11 to 12 and back are 7.8 R, and three contacts make up for 6 R.
        (
            _log([[0, 0, 1, 1], [0, 1, 2, 0], [1, 0, 2, 1]]),
            4,
            "robot 12's contact [0, 10, 1] and robot 12's contact [1, 11, 0] and robot 11's",
        ),
        (
            _log([[0, 0, 1, 1]], heights=(0.0, 2.5, 0.0)),
            3,
            "robot 11's contact [1, 10, 0] is inconsistent: by their flips the docks are 2.5",
        ),
    ],
)
def test_what_cannot_be_is_told_with_its_line(log, line, problem):
    """Two contacts of a pair, three around a triangle, one against the heights."""
    found = contradictions(log)

    assert [entry.line for entry in found] == [line]
    assert found[0].problem.startswith(problem)


def test_noise_may_excuse_a_contradiction():
    """What is impossible for perfect senses is not for poor ones."""
    contacts = [[0, 1, 1, 0], [0, 0, 1, 1]]

    assert contradictions(_log(contacts, noise=0.1))
    assert not contradictions(_log(contacts, noise=15.0))


def test_most_false_contacts_of_a_noiseless_log_are_found(towers):
    """A contact with anybody at all seldom agrees with the heights and the neighbors."""
    for history in towers:
        log = observe(history, SensingParams(false_contacts=0.05))
        false = {tuple(row) for row in log.contacts} - {tuple(row) for row in history.contacts}

        assert len(contradictions(log)) >= len(false) // 2


def test_a_ground_contact_that_its_robots_flips_contradict_is_found(towers):
    """One that is taken for flat ground at a height where there is none; no right one is."""
    for history in towers:
        for noise in (SensingParams(), NOISY):
            log = observe(history, noise)
            high = np.flatnonzero(history.position[:, 2] > 4.0)
            wrong = np.column_stack([high, np.zeros_like(high)])
            ground = np.concatenate([log.ground_docks, wrong.astype(np.int32)])
            rows = measure(log, CUES)
            mistaken = measure(dataclasses.replace(log, ground_docks=ground), CUES)

            found = mistaken.select(inconsistent_places(mistaken)).sensed_places

            assert not inconsistent_places(rows).any()
            flips = np.diff(log.stances.start)
            expected = [[robot, flips[robot], 0] for robot in high.tolist()]
            assert found.tolist() == expected


def test_a_long_walk_takes_memory_in_proportion():
    """A robot of 10,000 stances compares a sample of its coordinates with all."""
    stances = 10_000
    standing = np.column_stack([np.arange(stances), np.zeros(stances)]).astype(np.int32)
    walked = Stances(
        start=np.array([0, 0, stances, stances]),
        orientation_wxyz=np.tile(UPRIGHT, (stances, 1)),
        pivot_dock=np.ones(stances, np.int32),
        contacts=np.empty((0, 4), np.int32),
        ground_docks=standing,
    )
    log = dataclasses.replace(
        _log([], heights=(np.nan, 9.0, np.nan), noise=1e-3), stances=walked, ground_z=0.0
    )
    rows = measure(log, CUES)

    tracemalloc.start()
    found = inconsistent_places(rows)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()

    assert len(rows) == stances + 1
    assert rows.select(found).places.value.tolist() == [9.0]
    assert peak < 300e6  # 2.5 GB before
