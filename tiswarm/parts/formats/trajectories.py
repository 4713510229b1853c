"""Reads poses over time of other programs: frames of GSD, trajectories of TUM RGB-D.

    GSD   particles of all frames; a frame's step is its time
    TUM   time x y z qx qy qz qw, separated by spaces

A folder of TUM files has one for each robot, whose name is the number in that of the file. A single
file has one line for each robot, as `tiswarm export` writes it; its time is the join index.
"""

import re
from pathlib import Path

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.parts.formats.exports import gsd_library
from tiswarm.parts.formats.poses import (
    LONGEST_NUMBER,
    QUATERNION,
    PoseTable,
    refuse_far,
    report_incomplete,
)
from tiswarm.records.io import LARGEST, numbered_lines, unreadable
from tiswarm.records.messages import counted
from tiswarm.records.sensing_file import FAR_FROM_UNIT

_TUM = ["time", *"xyz", "qx", "qy", "qz", "qw"]

LONGEST_TEXT = 2**28
"""Largest content of a file of trajectories [byte], whose rows are all in memory."""


def read_gsd(path: Path, *, dock_radius: float) -> PoseTable:
    """Read the particles of all frames; docks are the spheres of their shape, if they have one.

    A particle is the robot that the logged quantity `particles/robot` names, else that of its
    index; constituents of rigid bodies are left out. Positions are from the logged `origin`, if
    there is one, and unwrapped.

    Raises:
        InputError: the file is damaged, or its spheres have another radius.
        EnvironmentTroubleError: the library gsd is not installed.
    """
    hoomd = gsd_library()
    if not path.is_file():
        raise unreadable(
            path, OSError(0, "no regular file") if path.exists() else FileNotFoundError()
        )
    tables, docks, left_out = [], None, 0
    try:
        with hoomd.open(path, mode="r") as frames:
            for number, frame in enumerate(frames, start=1):
                particles, box = frame.particles, np.asarray(frame.configuration.box, np.float64)
                body = np.asarray(particles.body, np.int64)
                is_robot = (body < 0) | (body == np.arange(particles.N))
                left_out += int((~is_robot).sum())
                place = np.asarray(particles.position, np.float64) + frame.log.get("origin", 0.0)
                around = np.asarray(particles.image, np.float64)
                if around.any() and box[3:].any():
                    problem = (
                        f"frame {number} wraps around a box that is not rectangular; unwrap it"
                    )
                    raise InputError(problem, path=path)
                rows = pd.DataFrame(place + around * box[:3], columns=[*"xyz"])
                rows[QUATERNION] = np.asarray(particles.orientation, np.float64)
                rows["robot"] = np.asarray(
                    frame.log.get("particles/robot", np.arange(particles.N)), np.int64
                )
                rows["time"], rows["line"] = float(frame.configuration.step), number
                tables.append(rows[is_robot])
                docks = _docks(particles, path, dock_radius) if docks is None else docks
    except (RuntimeError, OSError, LookupError, ValueError, TypeError, MemoryError) as error:
        raise InputError(f"not a whole GSD file ({error}); copy it again", path=path) from error
    if not sum(map(len, tables)):
        raise InputError("there are no particles; name a file with robots", path=path)
    rows = pd.concat(tables).assign(run="")
    refuse_far(rows, path, dock_radius)
    notes = [f"{counted(left_out, 'constituent')} of rigid bodies left out"] if left_out else []
    return PoseTable(rows, "", (), notes, docks)


def _docks(particles: object, path: Path, dock_radius: float) -> Reals | None:
    """Read the docks of the first type of particles, shape (D, 3); None if it has no spheres."""
    shape = (getattr(particles, "type_shapes", None) or [{}])[0]
    if shape.get("type") != "SphereUnion":
        return None
    for diameter in shape["diameters"]:
        if not np.isclose(diameter, 2.0 * dock_radius, rtol=1e-5):
            problem = f"the spheres have a radius of {diameter / 2.0:g}, not {dock_radius:g}"
            raise InputError(f"{problem}; give that of the file", path=path, argument="dock_radius")
    return np.array(shape["centers"], np.float64)


def read_tum(path: Path, *, dock_radius: float, drop_incomplete: bool) -> PoseTable:
    """Read a folder of trajectories, one for each robot, or a file with a robot a line.

    Args:
        path: Folder or file.
        dock_radius: Radius of a dock sphere.
        drop_incomplete: Whether to leave out lines with NaN, instead of refusing them.

    Raises:
        InputError: a line is malformed, or a file of the folder has no number in its name.
    """
    notes: list[str] = []
    if path.is_dir():
        tables = []
        named: dict[int, str] = {}
        for file in sorted(path.glob("*.tum")):
            numbers = re.findall(r"\d+", file.stem)
            if len(numbers) != 1 or len(numbers[0]) > LONGEST_NUMBER:
                problem = "the name has no number, or several; name the file as robot_7.tum"
                raise InputError(problem, path=file)
            if (other := named.setdefault(int(numbers[0]), file.name)) != file.name:
                problem = f"the name has the number of {other}; give each robot its own"
                raise InputError(problem, path=file)
            rows, lines = _trajectory(file, dock_radius)
            notes += report_incomplete(file, lines, drop=drop_incomplete, name=file.name)
            tables.append(rows.assign(robot=int(numbers[0]), file=str(file)))
        if not tables:
            raise InputError("there are no files *.tum; add one for each robot", path=path)
        return PoseTable(pd.concat(tables).assign(run=""), "", (), notes)
    rows, lines = _trajectory(path, dock_radius)
    notes += report_incomplete(path, lines, drop=drop_incomplete)
    rank = rows["time"].argsort(kind="stable").argsort().to_numpy()
    note = "a robot a line, numbered by time; for poses over time, name a folder with a file each"
    return PoseTable(
        rows.drop(columns="time").assign(robot=rank, join=rank, run=""), "", (), [note, *notes]
    )


def _trajectory(path: Path, dock_radius: float) -> tuple[pd.DataFrame, list[int]]:
    """Read the lines of a file, with their numbers, and list the lines that have a NaN."""
    rows, lines, incomplete = [], [], []
    for line, text in numbered_lines(path, LONGEST_TEXT):
        cells = text.split()
        if not cells or cells[0].startswith("#"):
            continue
        try:
            row = [*map(float, cells)]
        except ValueError:
            row = []
        if len(row) == len(_TUM) and np.isnan(row).any():
            incomplete.append(line)
            continue
        if len(row) != len(_TUM) or not np.abs(row).max() <= LARGEST:
            problem = (
                "is not time, x, y, z, qx, qy, qz, qw; write eight numbers with spaces between"
            )
            raise InputError(problem, path=path, line=line)
        length = float(np.linalg.norm(row[-4:]))
        if not abs(length - 1.0) <= FAR_FROM_UNIT:
            problem = f"the quaternion has length {length:.6g}; scale it to 1"
            raise InputError(problem, path=path, line=line)
        rows.append(row)
        lines.append(line)
    if not rows and not incomplete:
        raise InputError("there are no poses; add a line for each", path=path, line=1)
    if not rows:
        raise InputError("no line is complete; add a pose", path=path, line=incomplete[0])
    table = pd.DataFrame(rows, columns=_TUM).assign(line=lines)
    refuse_far(table, path, dock_radius)
    return table, incomplete
