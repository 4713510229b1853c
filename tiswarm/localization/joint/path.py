"""Walks, seen from where they ended, and what noise of orientations does to that.

A flip moves a center by what the orientations before and after say, so the noise of one stance is
in all that was felt there and before.
"""

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute.math import dock_offsets
from tiswarm.measurements.odometry import displacements, owners
from tiswarm.records.sensing_log import SensingLog, SensingNoise, Stances

CENTER = -1
"""In place of a dock: the center."""


class Path:
    """Every stance of every robot, the final one last, seen from the final center."""

    def __init__(self, log: SensingLog, stances: Stances, noise: SensingNoise) -> None:
        size = np.diff(stances.start)
        robots = len(size)
        self.owner = np.concatenate([owners(stances), np.arange(robots)])
        order = np.argsort(self.owner, kind="stable")
        self.owner = self.owner[order]
        self.row = np.empty(len(order), np.int64)
        """Where each of the log's stances, and then each final one, stands among all."""
        self.row[order] = np.arange(len(order))
        self.final = self.row[len(order) - robots :]
        self.first = np.r_[0, self.final[:-1] + 1]
        self.tilt, self.yaw, self.bias = np.radians(
            [noise.tilt_deg, noise.yaw_deg, noise.yaw_bias_deg or 0.0]
        )
        wxyz = np.concatenate([stances.orientation_wxyz, log.orientation_wxyz])[order]
        self.arm = dock_offsets(wxyz, log.dock_offset_body) / log.dock_radius
        still = np.zeros((robots, 3))
        self.shift = np.concatenate([displacements(log, stances), still])[order] / log.dock_radius
        pivot = np.r_[stances.pivot_dock, np.zeros(robots, np.int32)][order]
        # The dock that a robot leaves a stance by stays put; a final stance is measured from the
        # center itself.
        self.held = self.arm[np.arange(len(order)), pivot]
        self.held[self.final] = 0.0
        self.reached = self.arm[np.arange(len(order)), np.roll(pivot, 1)] - self.held
        """From the dock held by to the one that the stance was reached on, shape (stances, 3)."""
        self.reached[self.first] = 0.0
        summed = np.cumsum(self._turned(self.reached)[::-1], axis=0)[::-1]
        later = np.concatenate([summed[1:], np.zeros((1, 3))])
        self.walked = later - later[self.final][self.owner]
        """Variance of what lies between a stance and the final center, shape (stances, 3)."""

    def _turned(self, arm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Variance of each coordinate of arms whose orientation is noisy, shape (n, 3)."""
        x, y, z = arm.T**2
        tilt, yaw = self.tilt**2, self.yaw**2
        return np.column_stack([tilt * z + yaw * y, tilt * z + yaw * x, tilt * (x + y)])

    def docks(
        self, row: NDArray[np.int64], dock: NDArray[np.int32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """From final centers to docks at some stances, and the variance, both of shape (n, 3)."""
        at = self.shift[row] + self.arm[row, dock]
        variance = self.walked[row] + self._turned(self.arm[row, dock] - self.held[row])
        return at, variance + self._biased(at)

    def starts(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """From final centers to where walks began, and the variance, both of shape (N, 3)."""
        at = self.shift[self.first]
        return at, self.walked[self.first] + self._turned(self.held[self.first]) + self._biased(at)

    def _biased(self, arm: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y, _ = self.bias**2 * arm.T**2
        return np.column_stack([y, x, np.zeros(len(arm))])

    def noisy_arms(
        self, row: NDArray[np.int64], dock: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Arms by which noise of orientations shifts docks, or centers, seen from final centers.

        A shift is the sum over a dock's arms of w x arm, w being the noise of the arm's stance.

        Returns:
            Which of the docks, at which stance, and the arm, shape (n, 3); stances of each dock in
            a row, from the one at which it is on.
        """
        last = self.final[self.owner[row]]
        count = last - row + 1
        which = np.repeat(np.arange(len(row)), count)
        start = np.cumsum(count) - count
        stance = np.arange(len(which)) - (start - row)[which]
        arm = self.reached[stance]
        at = np.where((dock == CENTER)[:, None], 0.0, self.arm[row, dock])
        arm[start] = at - self.held[row]
        return which, stance, arm
