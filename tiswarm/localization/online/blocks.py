"""What one robot brings as it joins: its rows, and how their noise depends on where it is.

Rows of a robot are about itself and earlier robots. They are those of a log in which the anchor and
the robots that it names only stand, and it alone sensed anything. Noise of its earlier stances is
in several of its rows at once; the covariance of two rows is d N e, with d and e the derivatives of
the rows by its center and N a matrix that no position changes. Lengths in R.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.localization.joint.problem import chosen_rows
from tiswarm.localization.params import OnlineParams
from tiswarm.measurements.model import Measurements
from tiswarm.measurements.odometry import Odometry
from tiswarm.measurements.rows import Coordinates, Distances, Offsets
from tiswarm.records.sensing_log import SensingLog

_AXES = 3


@dataclass(frozen=True, kw_only=True)
class Block:
    """The m rows of one robot."""

    rows: Measurements
    """The rows, about robots numbered as in `members`, the robot itself last."""

    members: Ints
    """Index of each robot that the block knows in the whole structure: the anchor, robots named by
    the rows, and the robot itself, shape (M,)."""

    tail: Reals
    """Part of each row's arm that the robot's final orientation turns [R], shape (m, 3)."""

    noise: Reals
    """N: covariance of rows a and b by noise of earlier stances, for unit derivatives along axes
    i and j [R^2], at [b, j, a, i], shape (m, 3, m, 3)."""

    turn_sd: Reals
    """Standard deviation of the robot's final orientation about each axis [rad], shape (3,)."""

    arm: Reals
    """Center to dock at the final stance [R], shape (docks, 3)."""

    variance: Reals
    """Variance of each row, of the noise of all orientations too [R^2], shape (m,)."""

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.rows)

    @property
    def partners(self) -> Ints:
        """Earlier robots that rows are about, ascending, shape (k,)."""
        return np.unique(self.members[self.rows.other])

    def with_final_noise(self) -> Reals:
        """Return `noise` with that of the robot's final orientation, shape (m, 3, m, 3)."""
        return self.noise + _products(_turns(self.tail, self.turn_sd)[:, :, None])


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
    return Block(
        rows=rows,
        members=members,
        tail=tail,
        noise=_products(turns),
        turn_sd=sd[odometry.final[last]],
        arm=odometry.arm[odometry.final[last]],
        variance=rows.variance(),
    )


def _turns(part: Reals, sd: Reals) -> Reals:
    """Derivatives of d . (w x part), with w in sd: rows for each axis of d, (n, 3, 3)."""
    turns: Reals = np.cross(np.eye(_AXES), part[:, None]) * np.broadcast_to(sd, part.shape)[:, None]
    return turns


def _products(turns: Reals) -> Reals:
    """Multiply derivatives by all turns, shape (m, 3, turns, 3), in pairs, (m, 3, m, 3)."""
    rows = len(turns)
    flat = turns.reshape(_AXES * rows, turns[0].size // _AXES if rows else 0)
    return (flat @ flat.T).reshape(rows, _AXES, rows, _AXES)


class Gathered(NamedTuple):
    """The rows of B blocks side by side, E in all, about robots of the whole structure."""

    rows: Measurements
    """All rows, by table and then by block."""

    tail: Reals
    """As in `Block`, shape (E, 3)."""

    variance: Reals
    """As in `Block`, shape (E,)."""

    slot: Ints
    """Place of each row in arrays that have m places a block, shape (E,)."""

    noise: Reals
    """As in `Block`, 0 beyond the rows of a block, shape (B, m, 3, 3 m)."""

    members: Ints
    """The robot of each block, then its partners, then itself again, shape (B, k)."""

    member: Ints
    """Place among these of the other robot of each pair, shape (P,)."""


def gather(blocks: list[Block]) -> Gathered:
    """Put the rows of blocks side by side; none may be without rows."""
    every = [block.rows for block in blocks]
    table = [(rows.distances, rows.offsets, rows.places) for rows in every]
    cuts = [
        np.cumsum([0, len(d.stance), len(o.stance), len(p.stance)]).tolist() for d, o, p in table
    ]

    def by_table(columns: list[Any]) -> Any:  # noqa: ANN401 - an array
        parts = [
            column[cut[kind] : cut[kind + 1]]
            for kind in range(len(table[0]))
            for column, cut in zip(columns, cuts, strict=True)
        ]
        return np.concatenate(parts)

    # Blocks have as many places as the largest, so that one call treats all.
    most = max(map(len, blocks))
    noise = np.zeros((len(blocks), most, _AXES, most, _AXES))
    for k, block in enumerate(blocks):
        noise[k, : len(block), :, : len(block)] = block.noise
    # A robot repeated has no derivatives of its own, and so adds nothing.
    partners = [block.partners for block in blocks]
    count = 1 + max(map(len, partners))
    members = np.array(
        [
            [int(b.members[-1]), *k.tolist(), *[int(b.members[-1])] * (count - 1 - len(k))]
            for b, k in zip(blocks, partners, strict=True)
        ]
    )
    distances, offsets, places = (
        [np.concatenate(column) for column in zip(*kind, strict=True)]
        for kind in zip(*table, strict=True)
    )
    rows = Measurements(
        odometry=every[0].odometry,  # only unknown docks are looked up in it, and there are none
        distances=Distances(*distances),
        offsets=Offsets(*offsets),
        places=Coordinates(*places),
        robot=by_table([block.members[block.rows.robot] for block in blocks]),
        other=by_table([block.members[block.rows.other] for block in blocks]),
        arm=by_table([rows.arm for rows in every]),
        other_arm=by_table([rows.other_arm for rows in every]),
        shared_sd=every[0].shared_sd,
    )
    return Gathered(
        rows=rows,
        tail=by_table([block.tail for block in blocks]),
        variance=by_table([block.variance for block in blocks]),
        slot=by_table([most * k + np.arange(len(block)) for k, block in enumerate(blocks)]),
        noise=noise.reshape(len(blocks), most, _AXES, _AXES * most),
        members=members,
        member=by_table(
            [
                1 + np.searchsorted(k, b.members[b.rows.other])
                for b, k in zip(blocks, partners, strict=True)
            ]
        ),
    )
