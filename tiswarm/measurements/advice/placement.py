"""How measurements narrow the places that one robot may have, one after the other.

Robots that joined earlier stay where they were estimated. Where a robot touches one of them, it is
anywhere within reach; its orientation, the docks in contact, further contacts and its height each
leave less. The places are drawn at random, with a fixed seed. Lengths in R.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.compute.math import dock_offsets
from tiswarm.measurements.contacts import nearest_overlap
from tiswarm.measurements.cues import Measured
from tiswarm.measurements.model import SPACING
from tiswarm.records.sensing_log import SensingLog

_DRAWS = 200_000
_WIDTH = 0.1
"""How far from its equation a place may be, beside what the estimate misses that by [R]."""

_FIXED_PLACES = ("ground", "height", "plane", "anchors", "fixes")


class Narrowed(NamedTuple):
    """What is known after one more measurement."""

    name: str
    """What was measured."""

    places: Reals
    """Places of the center that remain [R], shape (n, 3)."""

    @property
    def spread(self) -> float:
        """Root mean square distance of the places from their mean [R]; 0 without places."""
        if not len(self.places):
            return 0.0
        off = self.places - self.places.mean(axis=0)
        return float(np.sqrt((off**2).sum(axis=1).mean()))


def narrow(log: SensingLog, robot: int, position: Reals) -> list[Narrowed]:
    """Say which places of a robot remain after each of its measurements.

    Args:
        log: What was sensed.
        robot: Its join index, from 1 on.
        position: Estimated centers of all robots [R], shape (N, 3).

    Raises:
        InputError: there is no such robot, or it touches none that joined earlier.
    """
    name = log.robot_id[robot] if 0 <= robot < log.robot_count else robot
    if not 0 < robot < log.robot_count:
        problem = f"{name} is the anchor, or no robot of the log; choose one that joined later"
        raise InputError(problem, argument="robot")
    measured = Measured(log)
    contacts = measured.rows(("contacts",))
    robot_contacts = np.flatnonzero(contacts.robot == robot)
    if not len(robot_contacts):
        problem = f"{name} touches no robot that joined earlier; choose another"
        raise InputError(problem, argument="robot")
    return [*_steps(measured, robot, position, robot_contacts)]


def _steps(
    measured: Measured, robot: int, position: Reals, robot_contacts: Ints
) -> Iterator[Narrowed]:
    log = measured.log
    contacts = measured.rows(("contacts",))
    draw = np.random.default_rng(0)
    arms = dock_offsets(log.orientation_wxyz, log.dock_offset_body / log.dock_radius)
    partner = int(contacts.neighbor[robot_contacts[0]])
    # Any of its docks, whose places are known, and any of ours, turned at random: all within reach.
    partner_dock = position[partner] + arms[partner, draw.integers(arms.shape[1], size=_DRAWS)]
    reach = np.linalg.norm(log.dock_offset_body, axis=1) / log.dock_radius
    dock = draw.integers(arms.shape[1], size=_DRAWS)
    apart = SPACING * _directions(draw)
    yield Narrowed(
        f"touches robot {log.robot_id[partner]}",
        partner_dock + apart - reach[dock, None] * _directions(draw),
    )
    yield Narrowed("orientation", partner_dock + apart - arms[robot, dock])
    first, *further_contacts = robot_contacts
    center = position[partner] + contacts.neighbor_arm[first] - contacts.arm[first]
    remaining = center + apart
    yield Narrowed(_docks(measured, first), remaining)
    for row in further_contacts:
        partner_of_row = int(contacts.neighbor[row])
        end = position[partner_of_row] + contacts.neighbor_arm[row] - contacts.arm[row]
        off = np.linalg.norm(remaining - end, axis=1) - contacts.distances.length[row]
        missed = np.linalg.norm(position[robot] - end) - contacts.distances.length[row]
        # Noise must not exclude the estimate itself, so the band is wider by what that misses.
        remaining = remaining[abs(off) <= _WIDTH + abs(missed)]
        yield Narrowed(_docks(measured, row), remaining)
    for cue in _FIXED_PLACES:
        rows = measured.rows((cue,))
        of_robot = np.flatnonzero(rows.robot[len(rows.neighbor) :] == robot)
        for row in of_robot:
            normal = rows.places.direction[row]
            arm = rows.arm[len(rows.neighbor) + row]
            value = rows.places.value[row] - normal @ arm
            missed = normal @ position[robot] - value
            remaining = remaining[abs(remaining @ normal - value) <= _WIDTH + abs(missed)]
        if len(of_robot):
            yield Narrowed(cue, remaining)
    yield Narrowed("no overlap", remaining[_is_free(log, arms, robot, position, remaining)])


def _docks(measured: Measured, row: int) -> str:
    """Name the docks of a contact."""
    contacts = measured.rows(("contacts",))
    dock = contacts.distances.dock[row]
    partner_dock = contacts.distances.other_dock[row]
    return f"dock {dock} to {partner_dock} of robot {measured.log.robot_id[contacts.neighbor[row]]}"


def _directions(draw: np.random.Generator) -> Reals:
    """Draw unit vectors, evenly over the sphere, shape (_DRAWS, 3)."""
    vector = draw.normal(size=(_DRAWS, 3))
    unit: Reals = vector / np.linalg.norm(vector, axis=1, keepdims=True)
    return unit


def _is_free(log: SensingLog, arms: Reals, robot: int, position: Reals, places: Reals) -> Bools:
    """Find the places where docks that do not touch keep D from all earlier ones, shape (n,)."""
    free = np.ones(len(places), np.bool_)
    if log.is_gone[robot]:
        return free
    touched = log.contacts[log.contacts[:, 2] == robot]
    for dock in range(arms.shape[1]):
        earlier_docks = position[:robot, None] + arms[:robot]
        is_apart = np.repeat(~log.is_gone[:robot, None], earlier_docks.shape[1], axis=1)
        # Docks in contact may be a little nearer than D, by noise.
        is_apart[tuple(touched[touched[:, 3] == dock, :2].T)] = False
        if is_apart.any():
            at = np.concatenate([position[robot, None], places]) + arms[robot, dock]
            deep = nearest_overlap(at, earlier_docks[is_apart])
            free &= deep[1:] <= _WIDTH + deep[0]
    return free
