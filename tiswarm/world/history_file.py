"""A grown structure in a file, so that nobody has to grow it again."""

import json
import zipfile
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiswarm.records.io import replacing
from tiswarm.robot import RobotGeometry
from tiswarm.world.history import History, Strain, Walk
from tiswarm.world.kinds import KINDS
from tiswarm.world.params import StructureParams

_TABLES = tuple(field.name for field in fields(Walk) if field.name != "recruited")
_STRAINS = tuple(field.name for field in fields(Strain))
_CALLING = _STRAINS.index("calling")
_FACTS = ("seed", "spawns", "crossed", "ended")


def write_history(history: History, path: Path) -> None:
    """Write a structure of at least one robot as `.npz`.

    Raises:
        EnvironmentTroubleError: it cannot be written.
    """
    arrays: dict[str, Any] = {
        "facts": json.dumps({name: getattr(history, name) for name in _FACTS}),
        "sensed": history.sensed,
        "strain": np.array([astuple(strain) for strain in history.strain]),
        "recruited": np.array([walk.recruited for walk in history.walks]),
    }
    for name in _TABLES:
        rows = [getattr(walk, name) for walk in history.walks]
        arrays |= {name: np.concatenate(rows), f"{name}_end": np.cumsum([len(r) for r in rows])}
    with replacing(path) as file:
        np.savez(file, **arrays)


def read_history(path: Path, params: StructureParams, robot: RobotGeometry) -> History | None:
    """Read a structure that was grown by these settings; None where it is missing or damaged."""
    try:
        with path.open("rb") as file, np.load(file) as tables:
            arrays: dict[str, NDArray[Any]] = dict(tables)
        return _history(arrays, params, robot)
    except (OSError, EOFError, LookupError, TypeError, ValueError, zipfile.BadZipFile):
        return None


def _history(
    arrays: dict[str, NDArray[Any]], params: StructureParams, robot: RobotGeometry
) -> History:
    parts = {name: np.split(arrays[name], arrays[f"{name}_end"][:-1]) for name in _TABLES}
    return History(
        **json.loads(str(arrays["facts"])),
        robot=robot,
        terrain=KINDS[params.kind].terrain(params),
        walks=tuple(
            Walk(recruited=recruited, **{name: parts[name][j] for name in _TABLES})
            for j, recruited in enumerate(arrays["recruited"].tolist())
        ),
        strain=tuple(
            Strain(**dict(zip(_STRAINS, row, strict=True)) | {"calling": int(row[_CALLING])})
            for row in arrays["strain"].tolist()
        ),
        sensed=arrays["sensed"],
    )
