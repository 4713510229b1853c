"""Leaves out poses that no motion of a robot explains: errors of tracking, such as swapped markers.

A robot moves by flips, during which one dock stays where it is. So from a sample to the next some
dock stays. A few samples in a row are an error if no dock stays from the one before to them, none
stays from them to the one after, and one does from the one before to the one after. The last
samples are an error if the robot rested before them: a robot leaves a rest by one flip.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.interop.assumptions import Assumptions
from tiswarm.interop.poses import Poses, Samples, some
from tiswarm.interop.stances import motion_limits
from tiswarm.records.messages import counted, percent

_FINE = 0.5
"""Samples follow a motion if the dock that moves most moves by less than this part of the distance
between two docks, in the median: by less than 30 degrees of a flip."""

_GAP = 1.5
"""A time between two samples that is longer than the median by this factor is a gap."""

_RARE = 0.05
"""Larger share of poses that no flip explains is noise, not errors of tracking."""


class _Motion(NamedTuple):
    """The samples of one robot."""

    docks: Reals
    """Centers of docks, shape (S, D, 3)."""

    time: Reals
    """Time of each sample, shape (S,)."""

    stays: Bools
    """Whether some dock stays from a sample to the next, shape (S - 1,)."""


def without_glitches(poses: Poses, assumed: Assumptions) -> tuple[Poses, list[str]]:
    """Leave out poses over time that are errors of tracking, and say so in a note.

    Args:
        poses: Robots, whose docks are known.
        assumed: Limits of contacts, and most samples in a row that are one error.
    """
    samples, most = poses.samples, assumed.glitch_frames
    if samples is None or most == 0:
        return poses, []
    docks = samples.docks(poses.dock_offset_body)
    still, put = motion_limits(samples, docks, assumed)
    start = np.searchsorted(samples.robot, np.arange(len(poses.robot_id) + 1))
    step = np.linalg.norm(np.diff(docks, axis=0), axis=2)
    same = np.diff(samples.robot) == 0
    stays = step.min(axis=1) <= put
    moving = step.max(axis=1)[same & stays & (step.max(axis=1) > still)]
    arm = _least_distance(poses.dock_offset_body)
    follows = bool(len(moving) and np.median(moving) < _FINE * arm)
    bad = np.zeros(len(docks), np.bool_)
    for first, after in pairwise(start.tolist()):
        motion = _Motion(docks[first:after], samples.time[first:after], stays[first : after - 1])
        bad[first:after] = _between(motion, put, most)
        if follows:
            bad[first:after] |= _at_end(motion, bad[first:after], still, most)
    if bad.mean() > _RARE:
        share = f"{percent(float(bad.mean()))} % of the poses are where no flip leads"
        return poses, [
            f"{share}: they are noisier than the limits of contacts; give a larger --gap"
        ]
    return (_kept(poses, samples, bad), [_note(poses, samples, bad)]) if bad.any() else (poses, [])


def _least_distance(offset: Reals) -> float:
    """Return the least distance of two docks of a robot; 0 if it has one."""
    apart = np.linalg.norm(offset[:, None] - offset, axis=2)
    return float(apart[np.triu_indices(len(offset), 1)].min(initial=np.inf)) * (len(offset) > 1)


def _between(motion: _Motion, put: float, most: int) -> Bools:
    """Mark samples that a robot leaves for where it was before, shape (S,)."""
    docks, stays = motion.docks, motion.stays
    bad, resume = np.zeros(len(docks), np.bool_), 0
    for before in np.flatnonzero(~stays).tolist():
        if before < resume:
            continue
        ahead = docks[before + 2 : before + 2 + most]
        back = np.linalg.norm(ahead - docks[before], axis=2).min(axis=1) <= put
        back &= ~stays[before + 1 : before + 1 + len(ahead)]
        if back.any():
            resume = before + 2 + int(back.argmax())
            bad[before + 1 : resume] = True
    return bad


def _at_end(motion: _Motion, bad: Bools, still: float, most: int) -> Bools:
    """Mark the last samples if they are not where a robot goes from its rest, shape (S,)."""
    found = np.zeros(len(bad), np.bool_)
    good: Ints = np.flatnonzero(~bad)
    docks, time = motion.docks[good], motion.time[good]
    tail = np.flatnonzero(~motion.stays)
    tail = tail[tail >= len(bad) - 1 - most]
    # The first jump counts: what follows it within the error may jump on.
    if not len(tail) or bad[tail[0]] or bad[tail[0] + 1]:
        return found
    k = int(np.searchsorted(good, tail[0]))
    if k == 0 or k + 1 >= len(good):
        return found
    rested = np.linalg.norm(docks[k] - docks[k - 1], axis=1).max() <= still
    in_time = time[k + 1] - time[k] <= _GAP * np.median(np.diff(time))
    found[tail[0] + 1 :] = rested and in_time
    return found


def _kept(poses: Poses, samples: Samples, bad: Bools) -> Poses:
    """Return the poses without bad samples; each robot ends at its last good one."""
    left = Samples(
        samples.robot[~bad],
        samples.time[~bad],
        samples.position[~bad],
        samples.orientation_wxyz[~bad],
    )
    last = np.searchsorted(left.robot, np.arange(len(poses.robot_id)), side="right") - 1
    return poses._replace(
        samples=left,
        position=left.position[last],
        orientation_wxyz=left.orientation_wxyz[last],
    )


def _note(poses: Poses, samples: Samples, bad: Bools) -> str:
    """Count the poses that are left out, and name their robots and times."""
    first = np.flatnonzero(bad & ~np.append(False, bad[:-1] & (np.diff(samples.robot) == 0)))
    names = poses.robot_id[samples.robot[first]].tolist()
    places = [
        f"robot {name} at time {time:g}"
        for name, time in zip(names, samples.time[first].tolist(), strict=True)
    ]
    return (
        f"{counted(int(bad.sum()), 'pose')} left out, {some(places)}: no flip about a dock leads "
        "there (keep them with --glitch-frames 0)"
    )
