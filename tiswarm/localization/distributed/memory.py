"""What a robot holds of robots, itself included."""

from dataclasses import dataclass, field

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.localization.distributed import wire

_AXES = 3


@dataclass
class Record:
    """What a robot holds of one robot, itself included."""

    line: bytes = b""
    """What it sensed, as sent; empty if unknown."""

    place: wire.Whereabouts | None = None
    """Where it is; None if unknown."""

    candidates: Reals = field(default_factory=lambda: np.empty((0, _AXES)))
    """Where else it may be, relative to the mean of those it shares rows with [R], (k, 3)."""

    sharing: set[int] = field(default_factory=set)
    """Robots that are known to share rows with it."""

    span: tuple[int, int] | None = None
    """When the last walk came to the robot, and left it: those between hang on it."""

    since: int = 0
    """Robot that joined as it was asked last; it has said who shares rows with it until then."""

    is_surprising: bool = False
    """Whether chance does not explain its rows and overlaps, as the one that solved for it says."""

    is_current: bool = False
    """Whether it lets the robot that holds this know as it moves."""

    @property
    def body(self) -> int:
        """First robot of the body in which it is placed; -1 if it is not."""
        return -1 if self.place is None else self.place.body
