"""Parameters that all measurements of a log share, such as the dock offset, as changes of the log.

If one of them is stated wrongly, every robot's measurements are off by a little. Each parameter
turns a log into the log that states another value, so that all rows follow. Lengths in R.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Reals
from tiswarm.measurements.equations import AXES
from tiswarm.records.sensing_log import LISTS, SensingLog

_LEAST_DOCK_OFFSET = 1e-6
"""Dock offset below which docks are at the center, so that no factor changes it [R]."""


class CommonParameter(NamedTuple):
    """A parameter that all measurements share."""

    name: str
    """Name in sentences, after an article."""

    key: str
    """Key of the log that states it."""

    kind: str
    """What its values are: a "length", a "height", a "factor", or a "turn" of three components
    [rad]."""

    applies: Callable[[SensingLog], bool]
    """Judges whether measurements of a log depend on it."""

    stated: Callable[[SensingLog], float]
    """Returns its value in a log [log unit, 1]; 0 of a turn."""

    changed: Callable[[SensingLog, Reals], SensingLog]
    """Returns the log that states a value more by a change [R, 1, rad], shape (components,)."""

    @property
    def components(self) -> int:
        """Number of components of its value."""
        return AXES if self.kind == "turn" else 1


def _mean_dock_offset(log: SensingLog) -> float:
    """Return the mean distance of docks from the center [log unit]."""
    return float(np.linalg.norm(log.dock_offset_body, axis=1).mean())


def _has_offsets(log: SensingLog) -> bool:
    """Judge whether docks are away from the center."""
    return _mean_dock_offset(log) > _LEAST_DOCK_OFFSET * log.dock_radius


def _with_dock_offset(log: SensingLog, change: Reals) -> SensingLog:
    """Move all docks away from the center, by lengths in proportion to their distance."""
    factor = 1.0 + float(change[0]) * log.dock_radius / _mean_dock_offset(log)
    return replace(log, dock_offset_body=factor * log.dock_offset_body)


def _with_dock_radius(log: SensingLog, change: Reals) -> SensingLog:
    """Change the radius of docks; all other lengths keep their values in the unit of the log."""
    return replace(log, dock_radius=log.dock_radius * (1.0 + float(change[0])))


def _measures_lengths(log: SensingLog) -> bool:
    """Judge whether lengths were measured by something else than docks that touch."""
    parts = (log, log.earlier)
    lists = ("ranges", "fixes", "displacements")
    of_robots = (log.flip_height, log.spawn_position)
    has_lists = any(len(getattr(part, name)) for part in parts for name in lists)
    return has_lists or any(bool(np.isfinite(values[1:]).any()) for values in of_robots)


def _with_scale(log: SensingLog, change: Reals) -> SensingLog:
    """Multiply measured lengths: those of the robot are divided, which has the same effect."""
    factor = 1.0 / (1.0 + float(change[0]))
    return replace(
        log,
        dock_radius=factor * log.dock_radius,
        dock_offset_body=factor * log.dock_offset_body,
    )


def _has_ground(log: SensingLog) -> bool:
    """Judge whether docks stood on ground of known height."""
    standing = len(log.ground_docks) + len(log.earlier.ground_docks)
    return log.ground_z is not None and standing > 0


def _has_heights(log: SensingLog) -> bool:
    """Judge whether robots know their heights."""
    return bool(np.isfinite(log.flip_height[1:]).any())


def _with_ground(log: SensingLog, change: Reals) -> SensingLog:
    """Lift the ground."""
    ground_z = log.ground_z or 0.0
    return replace(log, ground_z=ground_z + float(change[0]) * log.dock_radius)


def _with_heights(log: SensingLog, change: Reals) -> SensingLog:
    """Add a length to all heights."""
    return replace(log, flip_height=log.flip_height + float(change[0]) * log.dock_radius)


def _has_ranges(log: SensingLog) -> bool:
    """Judge whether distances of centers were measured."""
    return len(log.ranges) + len(log.earlier.ranges) > 0


def _with_ranges(log: SensingLog, change: Reals) -> SensingLog:
    """Add a length to all ranges."""
    longer = np.zeros(log.ranges.shape[1])
    longer[LISTS["ranges"].columns.index("distance") + 1] = float(change[0]) * log.dock_radius
    stances = log.stances
    if stances is not None:
        stances = replace(stances, ranges=stances.ranges + longer)
    return replace(log, ranges=log.ranges + longer, stances=stances)


def _with_anchor(log: SensingLog, change: Reals) -> SensingLog:
    """Lift the anchor: ground and heights are lower, seen from there."""
    return _with_ground(_with_heights(log, -change), -change)


def _with_world_turn(log: SensingLog, change: Reals) -> SensingLog:
    """Turn all orientations in the frame of the world, those of earlier stances, too."""
    turn = Rotation.from_rotvec(change)

    def turned(wxyz: Reals) -> Reals:
        if not len(wxyz):
            return wxyz
        return (turn * Rotation.from_quat(wxyz, scalar_first=True)).as_quat(scalar_first=True)

    stances = log.stances
    if stances is not None:
        stances = replace(stances, orientation_wxyz=turned(stances.orientation_wxyz))
    return replace(log, orientation_wxyz=turned(log.orientation_wxyz), stances=stances)


def _with_turned_docks(log: SensingLog, change: Reals) -> SensingLog:
    """Turn docks about the center in the body frame."""
    return replace(log, dock_offset_body=Rotation.from_rotvec(change).apply(log.dock_offset_body))


COMMON_PARAMETERS: tuple[CommonParameter, ...] = (
    CommonParameter(
        "dock offset", "dock_offsets", "length", _has_offsets, _mean_dock_offset, _with_dock_offset
    ),
    CommonParameter(
        "dock radius", "dock_radius", "length",
        lambda _log: True, lambda log: log.dock_radius, _with_dock_radius,
    ),
    CommonParameter(
        "scale of measured lengths", "dock_radius and dock_offsets", "factor",
        _measures_lengths, lambda _log: 1.0, _with_scale,
    ),
    CommonParameter(
        "ground height", "ground_z", "height",
        _has_ground, lambda log: log.ground_z or 0.0, _with_ground,
    ),
    CommonParameter(
        "shift of all heights", "flip_height", "length",
        _has_heights, lambda _log: 0.0, _with_heights,
    ),
    CommonParameter(
        "shift of all ranges", "ranges", "length",
        _has_ranges, lambda _log: 0.0, _with_ranges,
    ),
    CommonParameter(
        "anchor height", "anchor_position", "height",
        lambda log: _has_heights(log) and _has_ground(log),
        lambda log: float(log.anchor_position[2]), _with_anchor,
    ),
    CommonParameter(
        "turn of the world frame of all orientations", "orientation_wxyz", "turn",
        lambda _log: True, lambda _log: 0.0, _with_world_turn,
    ),
    CommonParameter(
        "turn of all docks in the body frame", "dock_offsets", "turn",
        _has_offsets, lambda _log: 0.0, _with_turned_docks,
    ),
)  # fmt: skip
"""The parameters that are tried where a log is not consistent."""
