"""What a log does not determine, for any method."""

from collections.abc import Collection, Iterator

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.math import normal
from tiswarm.measurements.contacts import connected_parts, disconnected, hops
from tiswarm.measurements.cues import Measured, cue_names, measure
from tiswarm.measurements.rigidity import common_motions, floppy_motions, weld
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
    measured: Measured | None = None,
) -> Observability:
    """Find what some cues leave undetermined.

    Args:
        log: What was sensed.
        cues: Cues in use; those without measurements in the log are left out.
        position: Estimated centers, in the log's unit, shape (N, 3). If None, they are drawn at
            random: what is determined hardly depends on where robots are.
        yaw_unknown: Whether each robot's yaw is unknown, too.
        measured: Rows of the log, if somebody has them.
    """
    measured = measured or Measured(log)
    center = _anywhere(log) if position is None else position / log.dock_radius
    rows = measured.rows(cues).associated(center)
    bodies = weld(rows, center, yaw_unknown=yaw_unknown)
    motions = floppy_motions(bodies)
    return Observability(
        cues=tuple(_held(measured, cues)),
        yaw_unknown=yaw_unknown,
        unknowns=bodies.dof * (log.robot_count - 1),
        gauge_yaw_sd=(
            float(log.yaw_bias / np.sqrt(log.robot_count)) if bodies.has_gauge_yaw else None
        ),
        floppy_modes=bodies.floppy_modes,
        floppy=None if motions is None else motions.robots(),
        disconnected=disconnected(rows),
    )


def by_cue(log: SensingLog) -> Iterator[Observability]:
    """Find what a log's contacts leave undetermined, and then each further cue that it has.

    Where the log states that yaw is biased, yaw counts as unknown, and at last as known once more.
    """
    yaw_unknown = log.yaw_bias > 0.0
    measured = Measured(log)
    cues: list[str] = []
    for cue in _held(measured, cue_names()):
        cues.append(cue)
        yield observability(log, cues, yaw_unknown=yaw_unknown, measured=measured)
    if yaw_unknown:
        yield observability(log, cues, measured=measured)


def common_modes(log: SensingLog, observability: Observability) -> tuple[int, Ints]:
    """Count the floppy modes that move all robots tied to the anchor as one.

    Contacts at a single dock of the anchor, for example, resist no turn about it.

    Returns:
        Number of such modes, and the docks of the anchor in contact, CENTER where other
        measurements tie it, shape (n,).
    """
    rows = measure(log, observability.cues).associated(_anywhere(log))
    modes = common_motions(
        rows, _anywhere(log), connected_parts(rows), yaw_unknown=observability.yaw_unknown
    )
    robot, _, dock, partner, partner_dock = rows.sensed_contacts.T
    return modes, np.unique(np.concatenate([partner_dock[partner == 0], dock[robot == 0]]))


def _anywhere(log: SensingLog) -> Reals:
    """Draw centers at random [R], shape (N, 3)."""
    robot = np.arange(log.robot_count)[:, None]
    return _SPREAD * normal(0, "anywhere", robot, np.arange(3))


def _held(measured: Measured, cues: Collection[str]) -> Iterator[str]:
    """List the contacts, and each further cue that adds measurements to those before it."""
    held: list[str] = []
    count = -1
    for cue in cue_names():
        if cue not in cues:
            continue
        more = measured.count([*held, cue])
        if more > count or cue == "contacts":
            held.append(cue)
            count = more
            yield cue


def hops_from_anchors(log: SensingLog) -> Reals:
    """Count the fewest contacts from any anchor to every robot, infinite without, shape (N,)."""
    anchors = np.flatnonzero(np.isfinite(log.known_position[:, 0]))
    fewest: Reals = hops(log, anchors).min(axis=0)
    return fewest
