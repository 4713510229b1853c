"""What a log does not determine, for any method."""

from collections.abc import Collection, Iterator

import numpy as np

from tiswarm.aliases import Reals
from tiswarm.compute.math import normal
from tiswarm.measurements.contacts import disconnected
from tiswarm.measurements.cues import cue_names, measure
from tiswarm.measurements.rigidity import floppy_modes, floppy_robots, weld
from tiswarm.records.estimate import Observability
from tiswarm.records.sensing_log import SensingLog

_SPREAD = 10.0
"""Standard deviation of positions drawn at random [R]."""


def observability(
    log: SensingLog,
    cues: Collection[str],
    position: Reals | None = None,
    *,
    yaw_unknown: bool = False,
) -> Observability:
    """Find what some cues leave undetermined.

    Args:
        log: What was sensed.
        cues: Cues in use; those without measurements are passed over.
        position: Estimated centers, in the log's unit, shape (N, 3). If None, they are drawn at
            random: what is determined hardly depends on where robots are.
        yaw_unknown: Whether each robot's yaw is unknown, too.
    """
    rows = measure(log, cues)
    if position is None:
        robot = np.arange(log.robot_count)[:, None]
        center = _SPREAD * normal(0, "anywhere", robot, np.arange(3))
    else:
        center = position / log.dock_radius
    bodies = weld(rows, center, yaw_unknown=yaw_unknown)
    return Observability(
        cues=tuple(cue for cue in cue_names() if cue in cues),
        yaw_unknown=yaw_unknown,
        unknowns=bodies.dof * (log.robot_count - 1),
        gauge_yaw_sd=(
            float(log.yaw_bias / np.sqrt(log.robot_count)) if bodies.has_gauge_yaw else None
        ),
        floppy_modes=floppy_modes(bodies),
        floppy=floppy_robots(bodies),
        disconnected=disconnected(rows),
    )


def by_cue(log: SensingLog) -> Iterator[Observability]:
    """Find what a log's contacts leave undetermined, and then each further cue that it has.

    Where the log states that yaw is biased, yaw counts as unknown, and at last as known once more.
    """
    yaw_unknown = log.yaw_bias > 0.0
    cues: list[str] = []
    count = -1
    for cue in cue_names():
        more = len(measure(log, [*cues, cue]))
        if more > count or cue == "contacts":
            cues.append(cue)
            count = more
            yield observability(log, cues, yaw_unknown=yaw_unknown)
    if yaw_unknown:
        yield observability(log, cues)
