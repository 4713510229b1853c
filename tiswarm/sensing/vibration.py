"""Names of the robots in contact, which robots learn from vibrations in time slots."""

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Ints
from tiswarm.compute.math import uniform
from tiswarm.sensing.params import Vibration
from tiswarm.world.history import History


def named_contacts(
    history: History, contacts: NDArray[np.int32], params: Vibration
) -> NDArray[np.int32]:
    """Name the robots in contact by their vibrations: leave out some contacts, and rename others.

    A robot that vibrates senses nothing, so it never learns the name of a neighbor of its own slot.
    Where several robots in reach vibrate in one slot, it may take another one for the neighbor.
    A vibration says which dock it comes from, by its place in the slot.

    Args:
        history: True history of the whole structure.
        contacts: Contacts, rows of (robot, stance, own dock, other robot, other dock), (K, 5).
        params: Slots, and how far vibrations are sensed.

    Returns:
        Sensed contacts of the same form, sorted and unique.
    """
    if not len(contacts):
        return contacts
    robot, _, _, neighbor, _ = contacts.T.astype(np.int64)
    # A number for each contact; other measurements do not change it.
    docks = len(history.robot.dock_offset_body)
    robots = history.robot_count
    shape = (int(contacts[:, 1].max(initial=0)) + 1, docks, robots, docks)
    number = np.ravel_multi_index(tuple(contacts[:, 1:].T), shape)
    slots = params.slots
    is_sensed = uniform(history.seed, "missed vibration", robot, number) >= params.missed
    is_sensed &= robot % slots != neighbor % slots
    draw = uniform(history.seed, "vibration", robot, number)
    heard_contacts = contacts.copy()
    neighbors = _neighbors(history)
    _, begins = np.unique(contacts[:, :2], axis=0, return_index=True)
    for rows in np.split(np.arange(len(contacts)), begins[1:]):  # of each stance
        touched = set(neighbor[rows].tolist())
        listener = int(robot[rows[0]])
        hops = _heard(neighbors, touched, params.hearing, listener, history.left_after)
        for row in rows[is_sensed[rows]].tolist():
            rivals = sorted(rival for rival in hops if rival % slots == neighbor[row] % slots)
            strength = np.cumsum([params.fading ** (hops[rival] - 1) for rival in rivals])
            heard = np.searchsorted(strength, draw[row] * strength[-1], "right")
            heard_contacts[row, 3] = rivals[int(heard)]
    sensed: NDArray[np.int32] = np.unique(heard_contacts[is_sensed], axis=0)
    return sensed


def _neighbors(history: History) -> list[list[int]]:
    """List the robots that each robot of a structure touched as they joined."""
    neighbors: list[list[int]] = [[] for _ in range(history.robot_count)]
    for i, j in history.contacts_at_join[:, ::2].tolist():
        neighbors[i].append(j)
        neighbors[j].append(i)
    return neighbors


def _heard(
    neighbors: list[list[int]], touched: set[int], reach: int, robot: int, left_after: Ints
) -> dict[int, int]:
    """Count the contacts from a robot to each earlier robot within reach, breadth first.

    Args:
        neighbors: Robots that each robot touches.
        touched: Robots that the robot touches.
        reach: Most contacts that a vibration passes.
        robot: The robot.
        left_after: Robots that had joined when each left, shape (N,).
    """
    hops = dict.fromkeys(touched, 1)
    edge = touched
    for count in range(2, reach + 1):
        edge = {k for j in edge for k in neighbors[j] if k < robot < left_after[k]} - hops.keys()
        hops |= dict.fromkeys(edge, count)
    return hops
