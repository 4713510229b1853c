"""What a log cannot tell, whatever the method: said before and after localizing."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tiswarm.compute.math import normal
from tiswarm.records.freedom import floppy_modes, loose, weld
from tiswarm.records.rigidity import Equations, equations
from tiswarm.records.sensing_log import SensingLog

TYING = ("contacts", "walk_contacts", "odometry")
"""Cues that tie a robot to another, or to the world, in every direction they need."""

LEVEL = ("ground", "height")
"""Cues that tell a height only."""


@dataclass(frozen=True, kw_only=True)
class Certainty:
    """What some cues can tell of N robots."""

    cues: tuple[str, ...]
    turning: bool
    """Whether each robot's yaw is unknown."""

    unknowns: int
    """What there is to be known: coordinates of all robots but the anchor, and where yaw is unknown
    how far each robot is turned, seen from the mean of all."""

    swing: float | None
    """Where yaw is unknown and nothing but the mean of all compasses holds the swarm as a whole
    against turning about the anchor, the standard deviation of that [rad]; else None."""

    floppy_modes: int | None
    """Independent motions of the swarm that nothing sensed would notice, or None where there are
    too many robots to count them."""

    loose: NDArray[np.bool_] | None
    """Whether such motions shift each robot, shape (N,), or None likewise."""

    apart: NDArray[np.bool_]
    """Whether nothing but a height ties each robot to the anchor, shape (N,)."""

    @property
    def known(self) -> list[str]:
        """Say of each robot whether its place can be known: "yes", "loose" or "apart".

        Nothing is said where there are too many robots to find out.
        """
        tied = "" if self.loose is None else np.where(self.loose, "loose", "yes")
        words = np.where(self.apart, "apart", tied)
        return [str(word) for word in words]


def certainty(
    log: SensingLog,
    cues: Collection[str],
    position: NDArray[np.float64] | None = None,
    *,
    turning: bool = False,
) -> Certainty:
    """Find what some cues leave unknown.

    Args:
        log: What was sensed.
        cues: Cues in use; those that add no equation are passed over.
        position: Where the robots are thought to be, shape (N, 3). Without it they are put
            anywhere at random, for what can be known hardly depends on where they are.
        turning: Whether each robot's yaw is unknown too.
    """
    counting = tuple(cue for cue in (*TYING, *LEVEL) if cue in cues)
    if position is None:
        robot = np.arange(log.robot_count)[:, None]
        spread = 10.0 * log.dock_radius
        position = spread * normal(0, "anywhere", robot, np.arange(3))
    bodies = weld(equations(position, log, counting, turning=turning))
    tied = equations(position, log, [cue for cue in counting if cue in TYING])
    return Certainty(
        cues=counting,
        turning=turning,
        unknowns=bodies.ways * (log.robot_count - 1),
        swing=float(log.yaw_bias / np.sqrt(log.robot_count)) if bodies.swings else None,
        floppy_modes=floppy_modes(bodies),
        loose=loose(bodies),
        apart=_apart(tied),
    )


def by_cue(log: SensingLog) -> Iterator[Certainty]:
    """Find what is left unknown by a log's contacts, and then with each further cue it has.

    Where the log states that yaw is biased it counts as unknown, and at last as known once more.
    """
    stances = log.stances
    has = {
        "contacts": True,
        "ground": len(log.ground_docks) > 0,
        "height": bool(np.isfinite(log.flip_height).any()),
        "walk_contacts": stances is not None and len(stances.contacts) > 0,
        "odometry": stances is not None and bool(np.isfinite(log.spawn_position).any()),
    }
    cues = [cue for cue, there in has.items() if there]
    turning = log.yaw_bias > 0.0
    for count in range(1, len(cues) + 1):
        yield certainty(log, cues[:count], turning=turning)
    if turning:
        yield certainty(log, cues)


def _apart(tied: Equations) -> NDArray[np.bool_]:
    shape = (len(tied.center), len(tied.center))
    graph = coo_array((np.ones(len(tied.first)), (tied.first, tied.second)), shape=shape)
    _, part = connected_components(graph, directed=False)
    return np.asarray(part[:-1] != part[0])
