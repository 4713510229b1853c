"""Where robots are, and what no estimate changes of them. Lengths in R."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Reals
from tiswarm.measurements.rows import SPACING
from tiswarm.parts.online.arrays import (
    GONE,
    POSITION,
    STATE,
    STAYS,
    TURN,
    TURN_SD,
    BelievedRobots,
)

_AXES = 3


class Configuration(NamedTuple):
    """Where N robots are, and by how much their final orientations are off."""

    position: Reals
    """Centers [R], shape (N, 3)."""

    turn: Reals
    """Error of each final orientation as a rotation vector in standard deviations, shape (N, 3)."""


class Shapes(NamedTuple):
    """What no estimate changes of N robots."""

    arm: Reals
    """Center to dock at the final stance, as sensed [R], shape (N, docks, 3)."""

    turn_sd: Reals
    """Standard deviation of each final orientation about each axis [rad], shape (N, 3)."""

    touch: NDArray[np.int32]
    """Contacts by the later robot: its dock, an earlier robot, the dock of that one, (T, 3)."""

    touch_start: NDArray[np.int32]
    """First contact of each robot, shape (N + 1,)."""

    gone: set[int]
    """Robots that have left, whose docks are in nobody's way."""

    @classmethod
    def of_none(cls, docks: int) -> "Shapes":
        """Begin without robots; each is to have so many docks."""
        return cls(
            arm=np.empty((0, docks, _AXES)),
            turn_sd=np.empty((0, _AXES)),
            touch=np.empty((0, 3), np.int32),
            touch_start=np.zeros(1, np.int32),
            gone=set(),
        )

    def with_robot(
        self, arm: Reals, turn_sd: Reals, touching: set[tuple[int, int, int]]
    ) -> "Shapes":
        """Append a robot; arguments are as the fields."""
        touch = np.array(sorted(touching), np.int32).reshape(-1, 3)
        return Shapes(
            np.concatenate([self.arm, arm[None]]),
            np.concatenate([self.turn_sd, turn_sd[None]]),
            np.concatenate([self.touch, touch]),
            np.append(self.touch_start, np.int32(len(self.touch) + len(touch))),
            self.gone,
        )

    @property
    def reach(self) -> float:
        """Distance of two centers beyond which no docks overlap [R]."""
        # All robots have the same docks.
        return 2.0 * float(np.linalg.norm(self.arm[0], axis=1).max()) + SPACING


def robots_at(state: Configuration, shapes: Shapes, stays: Reals | float = 0.0) -> BelievedRobots:
    """Put robots where they are, as kernels take them.

    Args:
        state: Where they are.
        shapes: All N robots.
        stays: Standard deviation of each coordinate of those that do not move [R], shape (N,).
    """
    columns = np.empty((len(shapes.arm), STATE))
    columns[:, POSITION:TURN], columns[:, TURN:TURN_SD] = state
    columns[:, TURN_SD:STAYS], columns[:, STAYS] = shapes.turn_sd, stays
    columns[:, GONE] = 0.0
    columns[[*shapes.gone], GONE] = 1.0
    return BelievedRobots(columns, shapes.arm, shapes.touch, shapes.touch_start)
