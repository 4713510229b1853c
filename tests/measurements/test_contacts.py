"""Chains of contacts to the anchor, and counts of contacts."""

import numpy as np
import pytest

from tiswarm.measurements.contacts import contact_count, earlier_contact_count, located
from tiswarm.records.sensing_log import SensingLog


def log_with(robots, contacts):
    """Make a log of which only the contacts matter."""
    return SensingLog(
        robot_id=np.arange(robots),
        dock_radius=1.0,
        dock_offset_body=np.eye(3),
        anchor_position=np.zeros(3),
        orientation_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (robots, 1)),
        contacts=np.array(contacts, dtype=np.int32).reshape(-1, 4),
        ground_docks=np.zeros((0, 2), dtype=np.int32),
        flip_height=np.full(robots, np.nan),
        spawn_position=np.full((robots, 3), np.nan),
    )


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
def test_located_means_a_chain_of_contacts_to_the_anchor(robots, contacts, expected):
    """Robots without such a chain are not located, whatever else they touch."""
    tied = located(log_with(robots, contacts))

    assert tied.tolist() == expected


def test_contacts_are_counted_at_both_ends_and_at_the_joiner():
    """Two docks that touch the same neighbor are two contacts."""
    log = log_with(6, CHAIN_AND_PAIR)

    assert contact_count(log).tolist() == [1, 3, 2, 1, 1, 0]
    assert earlier_contact_count(log).tolist() == [0, 1, 2, 0, 1, 0]
