"""Histories as arrays, as files of these, and the faults that one may have."""

import json
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import astuple, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tiswarm.base.errors import InputError
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.math import dock_offsets
from tiswarm.records.io import replacing, run_file
from tiswarm.world.history import History, Walk
from tiswarm.world.mechanics import MAX_UNBORNE, LoadSummary
from tiswarm.world.params import StructureParams

_SINGLE = ("recruited", "round")
"""Fields of a walk that are one value each; the others are arrays."""

_TABLES = tuple(field.name for field in fields(Walk) if field.name not in _SINGLE)
_FACTS = ("seed", "spawns", "crossed", "ended")

_MAX_OVERLAP = 1e-9
"""Deepest overlap that rounding may leave [R]."""

DAMAGED = (OSError, EOFError, LookupError, TypeError, ValueError, zipfile.BadZipFile)
"""Errors of reading a damaged file of structures."""


def write_history(history: History, path: Path) -> None:
    """Write a structure of at least one robot as `.npz`.

    Raises:
        EnvironmentTroubleError: it cannot be written.
    """
    arrays: dict[str, Any] = to_arrays(history)
    with replacing(path) as file:
        np.savez(file, **arrays)


def read_history(path: Path, params: StructureParams, robot: RobotGeometry) -> History | None:
    """Read a structure that was grown by these settings; None where it is missing or damaged."""
    try:
        with run_file(path).open("rb") as file, np.load(file) as tables:
            return from_arrays(dict(tables), params, robot)
    except (InputError, *DAMAGED):
        return None


def to_arrays(history: History) -> dict[str, NDArray[Any]]:
    """Convert a structure of at least one robot to arrays, which `from_arrays` reads back."""
    arrays: dict[str, NDArray[Any]] = {
        "facts": np.array(json.dumps({name: getattr(history, name) for name in _FACTS})),
        "sensed": history.sensed,
        "strain": np.array([astuple(load) for load in history.loads]),
    }
    for name in _SINGLE:
        arrays[name] = np.array([getattr(walk, name) for walk in history.walks])
    for name in _TABLES:
        rows = [getattr(walk, name) for walk in history.walks]
        arrays |= {name: np.concatenate(rows), f"{name}_end": np.cumsum([len(r) for r in rows])}
    if len(history.departures):
        arrays["departures"] = history.departures
    return arrays


def from_arrays(
    arrays: Mapping[str, NDArray[Any]], params: StructureParams, robot: RobotGeometry
) -> History:
    """Build a structure that was grown by these settings from its arrays.

    Raises:
        LookupError, TypeError, ValueError: the arrays are damaged.
    """
    fields_of: dict[str, list[Any]] = {name: arrays[name].tolist() for name in _SINGLE}
    fields_of |= {name: np.split(arrays[name], arrays[f"{name}_end"][:-1]) for name in _TABLES}
    rows = zip(*fields_of.values(), strict=True)
    walks = [Walk(**dict(zip(fields_of, row, strict=True))) for row in rows]
    loads = [LoadSummary(*row) for row in arrays["strain"].tolist()]
    return History(
        **json.loads(str(arrays["facts"])),
        robot=params.robot(robot),
        terrain=params.terrain,
        anchors=params.anchor_count,
        walks=tuple(walks),
        loads=tuple(replace(load, calling=int(load.calling)) for load in loads),
        sensed=arrays["sensed"],
        departures=arrays.get("departures", np.empty((0, 3), np.int32)),
    )


def find_fault(history: History, *, contact_gap: float) -> str:
    """Find what is wrong with a structure.

    Args:
        history: The structure as it grew.
        contact_gap: Docks closer than this count as touching [R].

    Returns:
        The first fault, or an empty string where there is none.
    """
    return next(_faults(history, contact_gap), "")


def _faults(history: History, contact_gap: float) -> Iterator[str]:
    robot, contacts = history.robot, history.contacts
    stays = ~history.is_gone
    turned = dock_offsets(history.orientation_wxyz, robot.dock_offset_body)
    docks = history.position[:, None, :] + turned
    dock = docks.reshape(-1, 3)
    count = robot.dock_count

    pairs = cKDTree(dock).query_pairs(robot.spacing - _MAX_OVERLAP, output_type="ndarray")
    pairs = pairs[pairs[:, 0] // count != pairs[:, 1] // count]
    pairs = pairs[stays[pairs // count].all(axis=1)]
    if len(pairs):
        depth = robot.spacing - np.linalg.norm(dock[pairs[:, 0]] - dock[pairs[:, 1]], axis=1)
        worst = int(np.argmax(depth))
        i, j = pairs[worst] // count
        yield f"robots {i} and {j} overlap by {depth[worst]:.3g} R"

    depth = history.terrain.depth(dock, robot.dock_radius)
    if not depth.max() <= _MAX_OVERLAP:
        yield f"robot {np.argmax(depth) // count} is {depth.max():.3g} R deep in the ground"

    i, a, j, b = contacts.T
    distance = np.linalg.norm(docks[i, a] - docks[j, b], axis=1)
    for k in np.flatnonzero(distance > robot.spacing + contact_gap):
        yield f"robots {i[k]} and {j[k]} are in contact {distance[k]:.3g} R apart"

    joined = history.is_held | ~stays
    if not joined.all():
        yield f"robot {np.argmin(joined)} touches neither an earlier robot nor the ground"

    imbalance = max((load.imbalance for load in history.loads), default=0.0)
    if imbalance > MAX_UNBORNE:
        yield f"weight and ground forces differ by {imbalance:.3g} of the weight"
