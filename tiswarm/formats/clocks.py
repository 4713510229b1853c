"""Clocks of robots that contradict one another, by what holds the pivot of each flip.

A robot stands on its pivot while it flips, so the robot whose dock it touches there has arrived
before. A final pose does not change, so it says nothing of when it was reached: no time shift is
seen beyond this order, and one that keeps it changes no log. So each flip states a bound: the clock
of one robot is ahead, or that of the other behind, by at least the time by which the holder arrives
too late. We name the robot that most of them share, and go on with the flips that are left. Between
two robots alone, either clock may be the wrong one.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.formats.motion import Rests
from tiswarm.formats.poses import Assumptions, Poses


class ClockShift(NamedTuple):
    """A robot whose clock contradicts those of others."""

    robot: int
    others: Ints  # robots with which its flips, or theirs, state so, (n,)
    least: float  # least time by which its clock is ahead of theirs; behind if negative
    flips: int  # number of these flips


class _Late(NamedTuple):
    """Flips that begin before what holds their pivot has arrived."""

    holder: Ints  # robot that holds the pivot, (n,)
    mover: Ints  # robot that flips, (n,)
    late: Reals  # time from the beginning of the flip to the arrival, (n,)


def shifted_clocks(rests: Rests, poses: Poses, assumed: Assumptions) -> list[ClockShift]:
    """Name the robots whose clocks are ahead or behind, by what their flips and others' say.

    Where a join order is given, times of different robots are not compared, so there are none.

    Args:
        rests: Poses at rest.
        poses: Final poses.
        assumed: Limits of contacts, and the ground.
    """
    if poses.join is not None:
        return []
    late = _late_holders(rests, poses, assumed)
    shifts = []
    while len(late.late):
        robots = len(poses.robot_id)
        ahead = np.bincount(late.holder, minlength=robots)
        behind = np.bincount(late.mover, minlength=robots)
        robot = int(np.maximum(ahead, behind).argmax())
        is_ahead = ahead[robot] >= behind[robot]
        states = (late.holder if is_ahead else late.mover) == robot
        least = float(late.late[states].max())
        others = np.unique((late.mover if is_ahead else late.holder)[states])
        shifts.append(ClockShift(robot, others, least if is_ahead else -least, int(states.sum())))
        late = _Late(*(column[~states] for column in late))
    return shifts


def _late_holders(rests: Rests, poses: Poses, assumed: Assumptions) -> _Late:
    """List the flips whose pivots only robots touch that arrive later, the first of them."""
    row = np.flatnonzero(rests.pivot >= 0)
    robot = np.searchsorted(rests.start, row, side="right") - 1
    arm = dock_offsets(rests.orientation_wxyz[row], poses.dock_offset_body)
    pivot = rests.position[row] + arm[np.arange(len(row)), rests.pivot[row]]
    docks = poses.docks.reshape(-1, 3)
    number = poses.docks.shape[1]
    least, greatest = assumed.spacing
    lowest, highest = assumed.level
    stands = (pivot[:, 2] >= lowest) & (pivot[:, 2] <= highest)
    arrived = rests.begin[rests.last]
    late: list[tuple[int, int, float]] = []
    for k, near in enumerate(cKDTree(docks).query_ball_point(pivot, greatest)):
        distance = np.linalg.norm(docks[near] - pivot[k], axis=1)
        holders = np.unique(np.array(near, np.int64)[distance >= least] // number)
        holders = holders[holders != robot[k]]
        if len(holders) and not stands[k]:
            first = holders[arrived[holders].argmin()]
            late.append((int(first), int(robot[k]), float(arrived[first] - rests.end[row[k]])))
    late = [one for one in late if one[2] > 0.0]
    holder, mover, time = np.array(late).reshape(-1, 3).T
    return _Late(holder.astype(np.int64), mover.astype(np.int64), time)
