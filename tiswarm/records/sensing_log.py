"""What the swarm sensed while it grew: the localizer's whole world."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class SensingNoise:
    """How wrong the senses are, as the log states it; None where it does not.

    Orientations are off by a standard deviation at each stance anew, but for the bias.
    """

    tilt_deg: float
    """Standard deviation about a horizontal axis [deg]."""

    yaw_deg: float
    """Standard deviation about the vertical [deg]."""

    yaw_bias_deg: float | None = None
    """Standard deviation about the vertical that a robot keeps at all its stances [deg]."""

    spawn: float | None = None
    """Standard deviation of each coordinate of a spawn position [log unit]."""

    missed_contacts: float | None = None
    """Fraction of contacts that are not felt [1]."""

    wrong_docks: float | None = None
    """Fraction of contacts that name the wrong dock of the other robot [1]."""

    false_contacts: float | None = None
    """Contacts that are none, per contact [1]."""


@dataclass(frozen=True, kw_only=True)
class Stances:
    """Every stance of every robot before its final one, robot after robot, in time order.

    M stances in all; those of robot i are rows `start[i]` to `start[i + 1]`.
    """

    start: NDArray[np.int64]
    """First stance of each robot, shape (N + 1,)."""

    orientation_wxyz: NDArray[np.float64]
    """Sensed orientation, body to world, unit quaternion, shape (M, 4)."""

    pivot_dock: NDArray[np.int32]
    """Dock that stays put while the robot flips out of the stance, shape (M,)."""

    contacts: NDArray[np.int32]
    """Contacts felt, rows of (stance, own dock, other robot, other dock), shape (K, 4)."""

    ground_docks: NDArray[np.int32]
    """Docks on flat ground, rows of (stance, own dock), shape (G, 2)."""


@dataclass(frozen=True, kw_only=True)
class SensingLog:
    """Everything a swarm of N robots sensed.

    Robots are numbered 0 to N - 1 in join order; robot 0 is the anchor. A log holds no true
    position but the anchor's, so no localizer can peek at the answer. Rows of `contacts`,
    `ground_docks` and their counterparts in `stances` are sorted and unique, so that two logs
    that say the same thing are equal.
    """

    robot_id: NDArray[np.int64]
    """Name of each robot in the file it came from: distinct integers, shape (N,)."""

    dock_radius: float
    """Radius of a dock sphere, in the log's own unit (R when it is 1)."""

    dock_offset_body: NDArray[np.float64]
    """Center to dock in the body frame, shape (docks, 3)."""

    anchor_position: NDArray[np.float64]
    """Known center of robot 0, shape (3,)."""

    orientation_wxyz: NDArray[np.float64]
    """Sensed final orientation, body to world, unit quaternion, shape (N, 4)."""

    contacts: NDArray[np.int32]
    """Docked pairs, rows of (robot i, dock of i, robot j, dock of j), i < j, shape (C, 4).

    Sorted by (j, dock of j, i, dock of i): the joiner j felt them as it joined.
    """

    ground_z: float | None = None
    """Height of the flat ground, or None where there is none."""

    ground_docks: NDArray[np.int32]
    """Docks on flat ground at the final stance, rows of (robot, dock), shape (G, 2)."""

    flip_height: NDArray[np.float64]
    """Height of the center inferred from the flip history; NaN where missing, shape (N,)."""

    spawn_position: NDArray[np.float64]
    """Where a robot knows that it started; a row of NaN where it does not, shape (N, 3)."""

    stances: Stances | None = None
    """Flip history, or None where the log has none."""

    noise: SensingNoise | None = None
    """Orientation noise as the log states it, or None where it does not."""

    length_unit: str = "R"
    """Name of the log's unit of length."""

    @property
    def robot_count(self) -> int:
        """N."""
        return len(self.robot_id)

    @property
    def spacing(self) -> float:
        """D: distance between the centers of two docks that touch."""
        return 2.0 * self.dock_radius

    @property
    def yaw_bias(self) -> float:
        """Standard deviation of the robots' biases of yaw [rad]; 0 where the log states none."""
        return math.radians((self.noise and self.noise.yaw_bias_deg) or 0.0)


def canonical_contacts(contacts: NDArray[np.int32]) -> NDArray[np.int32]:
    """Put rows of `SensingLog.contacts` into their order and drop repeated ones, shape (C, 4)."""
    joiner_first = np.unique(contacts.reshape(-1, 4)[:, [2, 3, 0, 1]], axis=0)
    return np.ascontiguousarray(joiner_first[:, [2, 3, 0, 1]])
