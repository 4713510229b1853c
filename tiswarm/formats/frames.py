"""Trees of frames over time, as ROS has them: composes poses up to the root of their tree.

A frame has a pose in its parent, which may change, and may have another parent at another time. A
pose at time t is turned and moved by each frame above it at t (REP 105; tf2).
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError

DEEPEST = 64
"""Most frames above one another; a tree with more goes around in a circle."""


class FrameTrack(NamedTuple):
    """S poses of a frame, or of a body, in other frames, by time."""

    time: Ints  # rising [ns], (S,)
    parent: Sequence[str]  # frame of each pose, (S,)
    position: Reals  # (S, 3)
    orientation_wxyz: Reals  # body to parent, of length 1, (S, 4)

    def merged(self, track: "FrameTrack") -> "FrameTrack":
        """Add poses of the same frame, by time."""
        time = np.concatenate([self.time, track.time])
        order = np.argsort(time, kind="stable")
        parents = [*self.parent, *track.parent]
        return FrameTrack(
            time[order],
            [parents[row] for row in order],
            np.concatenate([self.position, track.position])[order],
            np.concatenate([self.orientation_wxyz, track.orientation_wxyz])[order],
        )

    def at(self, time: Ints) -> "FrameTrack":
        """Return the poses at times (n,) [ns]: between two poses of one parent by interpolation.

        Before the first pose, after the last, and where the parent changes, the pose before holds.
        """
        before = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, None)
        after = np.minimum(before + 1, len(self.time) - 1)
        parents = [self.parent[row] for row in before]
        same = np.array([self.parent[row] for row in after]) == parents
        span = self.time[after] - self.time[before]
        is_between = same & (span > 0) & (time > self.time[before])
        share = np.zeros(len(time))
        share[is_between] = ((time - self.time[before]) / np.maximum(span, 1))[is_between]
        step = self.position[after] - self.position[before]
        start = Rotation.from_quat(self.orientation_wxyz[before], scalar_first=True)
        end = Rotation.from_quat(self.orientation_wxyz[after], scalar_first=True)
        turn = Rotation.from_rotvec(share[:, None] * (start.inv() * end).as_rotvec())
        position = self.position[before] + share[:, None] * step
        wxyz = (start * turn).as_quat(scalar_first=True)
        return FrameTrack(time, parents, position, wxyz)


def to_root(track: FrameTrack, frames: Mapping[str, FrameTrack]) -> FrameTrack:
    """Compose the poses of a track up to the roots of their trees, which become their parents.

    Args:
        track: Poses in any frames.
        frames: Poses of frames in their parents, by name; a frame without one is a root.

    Raises:
        InputError: frames stand in a circle.
    """
    for _ in range(DEEPEST):
        above = {name for name in track.parent if name in frames}
        if not above:
            return track
        parents = np.array(track.parent, dtype=object)
        position = track.position.copy()
        wxyz = track.orientation_wxyz.copy()
        for name in above:
            rows = np.array(track.parent, dtype=object) == name
            frame = frames[name].at(track.time[rows])
            turn = Rotation.from_quat(frame.orientation_wxyz, scalar_first=True)
            position[rows] = frame.position + turn.apply(track.position[rows])
            inner = Rotation.from_quat(track.orientation_wxyz[rows], scalar_first=True)
            wxyz[rows] = (turn * inner).as_quat(scalar_first=True)
            parents[rows] = frame.parent
        track = FrameTrack(track.time, parents.tolist(), position, wxyz)
    problem = f"the frame {min(above)} is above itself; record transforms that form a tree"
    raise InputError(problem)
