"""Turns the true history of a structure into the noisy log that localizers read."""

from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.registry import registered
from tiswarm.records.sensing_log import LISTS, SensingLog, Stances
from tiswarm.sensing import failures, fixes, flips, imu, touch
from tiswarm.sensing.connections import sense_connections, sense_directions
from tiswarm.sensing.params import SensingParams
from tiswarm.sensing.ranges import sense_ranges
from tiswarm.sensing.vibration import named_contacts
from tiswarm.world.history import History

COLUMNS = {name: 2 + len(key.columns) for name, key in LISTS.items() if not key.is_whole}
"""Numbers in a row of each list of the log that a sensor may fill, with robot and stance."""

ADDED = {
    "fixes": fixes.sense_fixes,
    "ranges": sense_ranges,
    "directions": sense_directions,
    "connections": sense_connections,
}
"""Sensors beside FireAntV3's own, by the list of the log that each fills, as in `params.added`."""

_Lists = dict[str, NDArray[Any]]
"""Rows of (robot, stance, ...) by the name of their list in the log."""


def observe(history: History, params: SensingParams) -> SensingLog:
    """Sense the whole walk of every robot in a structure.

    A random draw depends on the seed of the history, the robot, and the stance or contact only.
    The only positions of the log are those of anchors and, if set, measured ones: spawns and fixes.

    >>> from tiswarm.base.robot import RobotGeometry
    >>> from tiswarm.world.growth import grow
    >>> from tiswarm.world.params import TowerParams
    >>> [history] = grow(TowerParams(), robots=3, seeds=[0], robot=RobotGeometry())
    >>> log = observe(history, SensingParams(tilt_noise_deg=1.0))
    >>> log.robot_count, log.noise.tilt_deg
    (3, 1.0)
    """
    params = imu.of_shape(params, is_planar=history.is_planar)
    is_mute = failures.failing(history, params, "mute")
    whole = history
    history = failures.sensed_part(touch.felt_part(history), params)
    length = np.array([walk.stance_count for walk in history.walks])
    end = np.cumsum(length)
    sensed = imu.sensed_orientation(history, length, params)
    sensed = imu.failed_orientation(history, length, sensed, params)
    lists: _Lists = {name: np.empty((0, columns)) for name, columns in COLUMNS.items()}
    lists["contacts"] = touch.sensed_contacts(history, params)
    if params.vibration is not None:
        lists["contacts"] = named_contacts(whole, lists["contacts"], params.vibration)
    lists["ground_docks"] = history.table("ground_docks")
    lists["fixes"] = np.unique(
        np.concatenate([fixes.planar_fixes(history), fixes.anchor_fixes(history)]), axis=0
    )
    added = ((name, ADDED[name](history, params)) for name in params.added)
    plugin_suites = [
        entry.value for name, entry in registered("sensor").items() if name == params.suite
    ]
    by_plugin = ((suite.fills, suite.rows(history, params)) for suite in plugin_suites)
    for filled, sensor_rows in chain(added, by_plugin):
        rows = sensor_rows[~is_mute[sensor_rows[:, 0].astype(np.int64)]]
        lists[filled] = np.unique(np.concatenate([lists[filled], rows]), axis=0)
    for name in ("contacts", "ground_docks"):
        if not params.senses(name):
            lists[name] = lists[name][:0]
    lists |= touch.split_touches(lists["contacts"], params)
    final: dict[str, Any] = {
        name: np.delete(rows[_is_last(rows, length)], 1, axis=1) for name, rows in lists.items()
    }
    final["contacts"] = np.ascontiguousarray(final["contacts"][:, [2, 3, 0, 1]])
    orientation = sensed[end - 1]
    if not params.senses("compass"):
        # Orientations of anchors are known, as their positions are.
        is_known = history.is_anchor
        orientation[is_known] = history.orientation_wxyz[is_known]
        orientation[~is_known] = np.nan
    height = flips.flip_height(history, sensed, end)
    spawn = flips.spawn_position(history, params)
    orientation[is_mute] = np.nan
    spawn[is_mute] = np.nan
    return SensingLog(
        robot_id=np.arange(history.robot_count),
        gone=np.flatnonzero(history.is_gone),
        left_after=history.left_after[history.is_gone],
        dock_radius=history.robot.dock_radius,
        dock_offset_body=history.robot.dock_offset_body,
        anchor_position=history.walks[0].center[-1],
        orientation_wxyz=orientation,
        **_ground(history, params),
        flip_height=height if params.senses("heights") else np.full_like(height, np.nan),
        spawn_position=spawn,
        stances=_stances(history, sensed, length, lists) if params.senses("stances") else None,
        noise=params.noise,
        source_name=tuple(params.sources),
        source_sd=np.array([*params.sources.values()], np.float64),
        **final,
    )


def _ground(history: History, params: SensingParams) -> dict[str, Any]:
    """Return what a log states of the ground: the height of a flat one, or that it is not flat."""
    if not params.senses("ground_docks"):
        return {}
    if history.terrain.form is not None:
        # No dock on it is listed, for none has a known height.
        return {"ground_form": history.terrain.form}
    return {"ground_z": history.ground_z}


def _stances(history: History, sensed: Reals, length: Ints, lists: _Lists) -> Stances:
    """Gather every stance except each robot's last."""
    start = np.concatenate([[0], np.cumsum(length - 1)])
    return Stances(
        start=start,
        orientation_wxyz=np.delete(sensed, np.cumsum(length) - 1, axis=0),
        pivot_dock=np.concatenate([walk.pivot_dock for walk in history.walks]),
        **{name: _numbered(rows[~_is_last(rows, length)], start) for name, rows in lists.items()},
    )


def _is_last(rows: NDArray[Any], length: Ints) -> Bools:
    """Whether rows of (robot, stance, ...) are of the robot's last stance."""
    is_last: Bools = rows[:, 1] == length[rows[:, 0].astype(np.int64)] - 1
    return is_last


def _numbered(rows: NDArray[Any], start: Ints) -> NDArray[Any]:
    """Replace (robot, stance) at the start of each row by the stance's index in the log."""
    robot, stance = rows[:, :2].astype(np.int32).T
    return np.column_stack([(start[robot] + stance).astype(np.int32), rows[:, 2:]])
