"""What a log cannot tell, whatever the method: said before and after localizing."""

from collections.abc import Collection, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tiswarm.compute.math import normal
from tiswarm.measurements.linear import Equations, equations
from tiswarm.measurements.rigidity import floppy_modes, loose, weld
from tiswarm.records.estimate import Observability
from tiswarm.records.sensing_log import SensingLog

TYING = ("contacts", "walk_contacts", "odometry")
"""Cues that tie a robot to another, or to the world, in every direction they need."""

LEVEL = ("ground", "height")
"""Cues that tell a height only."""


def observability(
    log: SensingLog,
    cues: Collection[str],
    position: NDArray[np.float64] | None = None,
    *,
    turning: bool = False,
) -> Observability:
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
    return Observability(
        cues=counting,
        turning=turning,
        unknowns=bodies.ways * (log.robot_count - 1),
        swing=float(log.yaw_bias / np.sqrt(log.robot_count)) if bodies.swings else None,
        floppy_modes=floppy_modes(bodies),
        loose=loose(bodies),
        apart=_apart(tied),
    )


def by_cue(log: SensingLog) -> Iterator[Observability]:
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
        yield observability(log, cues[:count], turning=turning)
    if turning:
        yield observability(log, cues)


def _apart(tied: Equations) -> NDArray[np.bool_]:
    shape = (len(tied.center), len(tied.center))
    graph = coo_array((np.ones(len(tied.first)), (tied.first, tied.second)), shape=shape)
    _, part = connected_components(graph, directed=False)
    return np.asarray(part[:-1] != part[0])
