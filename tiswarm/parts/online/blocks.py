"""What one robot brings as it joins: its rows, and how their noise depends on where it is.

Rows of a robot are about itself and earlier robots. They are those of a log in which the anchor and
the robots that it names only stand, and it alone sensed anything. Noise of its earlier stances is
in several of its rows at once; the covariance of two rows is d N e, with d and e the derivatives of
the rows by its center and N a matrix that no position changes. Lengths in R.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Ints, Reals
from tiswarm.localization.joint.problem import chosen_rows
from tiswarm.localization.params import OnlineParams
from tiswarm.measurements.model import Measurements
from tiswarm.measurements.odometry import Odometry
from tiswarm.parts.online.arrays import (
    ARM,
    AXIS,
    COORDINATE,
    DISTANCE,
    FIRST,
    HINGE,
    KIND,
    MEMBER,
    OFFSET,
    OTHER_ARM,
    OWN_VARIANCE,
    REALS,
    SEEN,
    TAIL,
    VALUE,
    VARIANCE,
    Scratch,
    Table,
)
from tiswarm.records.sensing_log import SensingLog

_AXES = 3
_PARTS = 6
"""Unknowns of a robot: its shift and its turn."""


@dataclass(frozen=True, kw_only=True)
class Block:
    """The m rows of one robot."""

    rows: Measurements
    """The rows, about robots numbered as in `members`, the robot itself last."""

    members: Ints
    """Index of each robot that the block knows in the whole structure: the anchor, robots named by
    the rows, and the robot itself, shape (M,)."""

    number: NDArray[np.int32]
    """The rows as kernels take them: columns of `Table.number`, shape (m, 3)."""

    real: Reals
    """The same: columns of `Table.real`, shape (m, REALS)."""

    noise: Reals
    """N: covariance of rows a and b by noise of earlier stances, for unit derivatives along axes
    i and j [R^2], at [b, j, a, i], shape (m, 3, m, 3)."""

    about: Ints
    """Which of the members rows are about, ascending, shape (k,)."""

    turn_sd: Reals
    """Standard deviation of the robot's final orientation about each axis [rad], shape (3,)."""

    arm: Reals
    """Center to dock at the final stance [R], shape (docks, 3)."""

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.rows)

    @property
    def partners(self) -> Ints:
        """Earlier robots that rows are about, ascending, shape (k,)."""
        return self.members[self.about]

    def with_final_noise(self) -> Reals:
        """Return `noise` with that of the robot's final orientation, shape (m, 3, m, 3)."""
        tail = self.real[:, TAIL : TAIL + _AXES]
        return self.noise + _products(_turns(tail, self.turn_sd)[:, :, None])


def block_of(log: SensingLog, params: OnlineParams, members: Ints) -> Block:
    """Measure the rows of the last robot of a log, the only one that sensed anything.

    Args:
        log: The robot, after the anchor and those that it names; the anchor is at the origin.
        params: Settings.
        members: Index of each robot in the whole structure, shape (M,).
    """
    odometry = Odometry(log)
    last = log.robot_count - 1
    rows, _ = chosen_rows(log, params, odometry)
    # Where other robots were measured to be is in the blocks of their own.
    rows = rows.select((rows.robot == last) & (rows.robot > 0))
    row, stance, part = rows.noisy_arms()[0]
    # The final orientation is an unknown beside the position; earlier ones are noise.
    is_final = stance == odometry.final[last]
    tail = np.zeros((len(rows), _AXES))
    tail[row[is_final]] = part[is_final]
    sd = odometry.turn_sd[:, [0, 0, 1]]
    row, stance, part = row[~is_final], stance[~is_final], part[~is_final]
    # Three columns for each earlier stance, whose turn is in all rows sensed before it.
    which, column = np.unique(stance, return_inverse=True)
    turns = np.zeros((len(rows), _AXES, len(which), _AXES))
    turns[row, :, column] = _turns(part, sd[stance])
    about, place = np.unique(rows.other, return_inverse=True)
    number, real = _columns(rows, place, tail)
    return Block(
        rows=rows,
        members=members,
        number=number,
        real=real,
        noise=_products(turns),
        about=about,
        turn_sd=sd[odometry.final[last]],
        arm=odometry.arm[odometry.final[last]],
    )


def _columns(rows: Measurements, place: Ints, tail: Reals) -> tuple[NDArray[np.int32], Reals]:
    """Write rows as `Table` has them; the other robot of each pair has a place among partners."""
    d, o, p = rows.distances, rows.offsets, rows.places
    first, pairs = len(d.stance), len(place)
    number, real = np.zeros((len(rows), 3), np.int32), np.zeros((len(rows), REALS))
    number[:, KIND] = COORDINATE
    number[:first, KIND] = np.where(d.is_hinge, HINGE, DISTANCE)
    number[first:pairs, KIND] = OFFSET
    number[:pairs, MEMBER] = 1 + place
    number[:, FIRST] = np.arange(len(rows))
    number[first:pairs, FIRST] -= np.arange(pairs - first, dtype=np.int32) % _AXES
    real[first:, AXIS : AXIS + _AXES] = np.concatenate([o.axis, p.direction])
    real[:, ARM : ARM + _AXES], real[:, TAIL : TAIL + _AXES] = rows.arm, tail
    real[:pairs, OTHER_ARM : OTHER_ARM + _AXES] = rows.other_arm
    real[:first, VALUE], real[pairs:, VALUE] = d.length, p.value
    real[:, OWN_VARIANCE], real[:, VARIANCE] = rows.own_variance, rows.variance()
    return number, real


def _turns(part: Reals, sd: Reals) -> Reals:
    """Derivatives of d . (w x part), with w in sd: rows for each axis of d, (n, 3, 3)."""
    turns: Reals = np.cross(np.eye(_AXES), part[:, None]) * np.broadcast_to(sd, part.shape)[:, None]
    return turns


def _products(turns: Reals) -> Reals:
    """Multiply derivatives by all turns, shape (m, 3, turns, 3), in pairs, (m, 3, m, 3)."""
    rows = len(turns)
    flat = turns.reshape(_AXES * rows, turns[0].size // _AXES if rows else 0)
    return (flat @ flat.T).reshape(rows, _AXES, rows, _AXES)


def table_of(blocks: list[Block]) -> Table:
    """Put the rows of blocks one after the other, as kernels take them."""
    member = [[b.members[-1:], b.partners] for b in blocks]
    size = [(len(b), b.noise.size, 1 + len(b.about)) for b in blocks]
    return Table(
        block=np.cumsum([(0, 0, 0), *size], axis=0, dtype=np.int32),
        member=np.concatenate([each for pair in member for each in pair]).astype(np.int32),
        number=np.concatenate([b.number for b in blocks]),
        real=np.concatenate([b.real for b in blocks]),
        noise=np.concatenate([b.noise.ravel() for b in blocks]),
    )


def scratch_for(blocks: list[Block]) -> Scratch:
    """Make room for the largest of some blocks."""
    rows = max(map(len, blocks))
    # An overlap has two members.
    values = _PARTS * max(2, *(1 + len(b.about) for b in blocks)) + 1 + _AXES
    return Scratch(
        covariance=np.empty((rows, rows)),
        row=np.empty((rows, SEEN)),
        value=np.empty((values, rows)),
        place=np.empty(values, np.int32),
    )
