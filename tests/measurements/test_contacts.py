"""Chains of contacts to the anchor, and counts of contacts."""

import dataclasses

import numpy as np
import pytest

from tests.structures import silent
from tiswarm.evaluation.metrics import earlier_contact_count
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.settings import Cues, JointParams
from tiswarm.measurements.contacts import contact_count, disconnected, nearest_overlap, overlaps
from tiswarm.measurements.cues import measure

CHAIN_AND_PAIR = [(0, 0, 1, 1), (1, 0, 2, 1), (1, 2, 2, 2), (3, 0, 4, 0)]


@pytest.mark.parametrize(
    ("robots", "contacts", "expected"),
    [
        (1, [], [True]),
        (3, [], [True, False, False]),
        (6, CHAIN_AND_PAIR, [True, True, True, False, False, False]),
        (4, [(1, 0, 2, 0), (2, 1, 3, 0), (0, 0, 3, 1)], [True] * 4),
    ],
)
def test_a_robot_is_connected_by_a_chain_of_contacts_to_the_anchor(robots, contacts, expected):
    """Robots without such a chain are disconnected, whatever else they touch."""
    tied = ~disconnected(
        measure(silent(np.zeros((robots, 3)), contacts=contacts), ["contacts", "height"])
    )

    assert tied.tolist() == expected


def test_odometry_connects_whoever_knows_where_it_started_and_all_it_touches():
    """With or without stances, for the annealer and for the analysis; a height does not."""
    log = silent(np.zeros((6, 3)), contacts=CHAIN_AND_PAIR)
    spawn = log.spawn_position.copy()
    spawn[4] = [9.0, 0.0, 1.0]
    log = dataclasses.replace(log, spawn_position=spawn, flip_height=np.ones(6))

    for cues, lost in ((["contacts", "height"], [3, 4, 5]), (["contacts", "odometry"], [5])):
        params = JointParams(cues=Cues(height="height" in cues, odometry="odometry" in cues))
        assert np.flatnonzero(disconnected(measure(log, cues))).tolist() == lost
        assert np.flatnonzero(pose_problem(log, params).untied).tolist() == lost


def test_contacts_are_counted_at_both_ends_and_at_the_joiner():
    """Two docks that touch the same neighbor are two contacts."""
    log = silent(np.zeros((6, 3)), contacts=CHAIN_AND_PAIR)

    assert contact_count(log).tolist() == [1, 3, 2, 1, 1, 0]
    assert earlier_contact_count(log).tolist() == [0, 1, 2, 0, 1, 0]


def test_overlaps_are_of_docks_nearer_than_two_radii() -> None:
    """A pair at a distance of D, one beyond it and one at the same point do not count."""
    point = np.zeros((5, 1, 3))
    point[1:4, 0, 0] = [1.5, 2.0, 3.0]
    docks = np.array([[1, 0, 0, 0], [2, 0, 0, 0], [3, 0, 0, 0], [4, 0, 0, 0]])

    overlapping = overlaps(point, docks)

    assert overlapping.docks.tolist() == [[1, 0, 0, 0]]
    assert overlapping.depth.tolist() == [0.5]
    assert overlapping.direction.tolist() == [[1.0, 0.0, 0.0]]


def test_the_nearest_dock_is_the_one_that_overlaps_most() -> None:
    """Of two docks in the way, the nearer one sets the depth."""
    obstacles = np.array([[1.5, 0.0, 0.0], [-1.0, 0.0, 0.0]])

    depth = nearest_overlap(np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]]), obstacles)

    assert depth.tolist() == [1.0, 0.0]
