"""Histories as arrays, and as files of these."""

import json
import zipfile
from collections.abc import Mapping
from dataclasses import astuple, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.robot import RobotGeometry
from tiswarm.records.io import replacing
from tiswarm.world.history import History, LoadSummary, Walk
from tiswarm.world.params import StructureParams

_SINGLE = ("recruited", "round")
"""Fields of a walk that are one value each; the others are arrays."""

_TABLES = tuple(field.name for field in fields(Walk) if field.name not in _SINGLE)
_FACTS = ("seed", "spawns", "crossed", "ended")


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
        with path.open("rb") as file, np.load(file) as tables:
            return from_arrays(dict(tables), params, robot)
    except DAMAGED:
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
    )
