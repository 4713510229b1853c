"""Reads poses over time of other programs: GSD, TUM RGB-D, exports of motion capture, folders.

    GSD        particles of all frames; a frame's step is its time
    TUM        time x y z qx qy qz qw, separated by spaces
    Motive     CSV, rows Type, Name, ID, then Rotation and Position; quaternions or angles
    Qualisys   TSV, columns X, Y, Z, Roll, Pitch, Yaw, Residual and maybe Rot[0] to Rot[8]; mm
    Vicon      CSV, blocks Objects or Segments, columns RX, RY, RZ, maybe RW, TX, TY, TZ

The head of an export becomes one line, with names of bodies before those of quantities; the rest is
a table with all robots a row. A folder has a file for each robot, whose name is the number in that
of the file. A single TUM file has one line for each robot, as `tiswarm export` writes it; its time
is the join index. Bodies that the cameras lost have empty cells, or zeros in Qualisys' exports.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.formats import columns, poses
from tiswarm.formats.exports import gsd_library
from tiswarm.records.io import LARGEST, numbered_lines, refuse_special, split_cells
from tiswarm.records.messages import counted
from tiswarm.records.sensing_file import FAR_FROM_UNIT

_TUM = ["time", *"xyz", "qx", "qy", "qz", "qw"]

LONGEST_TEXT = 2**28
"""Largest content of a file of trajectories [byte], whose rows are all in memory."""


def read_gsd(path: Path, assumed: poses.Assumptions) -> poses.PoseTable | None:
    """Read the particles of all frames; return None if the file is not named `.gsd`.

    A particle is the robot that the logged quantity `particles/robot` names, else that of its
    index; constituents of rigid bodies are left out. Positions are from the logged `origin`, if
    there is one, and unwrapped. Docks are the spheres of their shape, if they have one.

    Raises:
        InputError: the file is damaged, or its spheres have another radius.
        EnvironmentTroubleError: the library gsd is not installed.
    """
    if path.suffix != ".gsd":
        return None
    hoomd = gsd_library()
    refuse_special(path)
    tables = []
    docks: Reals | None = None
    constituents = 0
    try:
        with hoomd.open(path, mode="r") as frames:
            for number, frame in enumerate(frames, start=1):
                particles = frame.particles
                rows = _rows_of_frame(frame, number, path)
                body = np.asarray(particles.body, np.int64)
                is_robot = (body < 0) | (body == np.arange(particles.N))
                constituents += int((~is_robot).sum())
                tables.append(rows[is_robot])
                if docks is None:
                    docks = _docks(particles, path, assumed.dock_radius)
    except (RuntimeError, OSError, LookupError, ValueError, TypeError, MemoryError) as error:
        raise InputError(f"not a whole GSD file ({error}); copy it again", path=path) from error
    if not sum(map(len, tables)):
        raise InputError("there are no particles; name a file with robots", path=path)
    rows = pd.concat(tables).assign(run="")
    columns.refuse_far(rows, path, assumed.dock_radius)
    notes = []
    if constituents:
        notes.append(f"{counted(constituents, 'constituent')} of rigid bodies left out")
    return poses.PoseTable(rows, "", (), notes, docks)


def _rows_of_frame(frame: Any, number: int, path: Path) -> pd.DataFrame:  # noqa: ANN401 - no types
    """Read all particles of a frame; its number is their line."""
    particles = frame.particles
    box = np.asarray(frame.configuration.box, np.float64)
    wrapped = np.asarray(particles.position, np.float64) + frame.log.get("origin", 0.0)
    image = np.asarray(particles.image, np.float64)
    if image.any() and box[3:].any():
        problem = f"frame {number} wraps around a box that is not rectangular; unwrap it"
        raise InputError(problem, path=path)
    rows = pd.DataFrame(wrapped + image * box[:3], columns=[*"xyz"])
    rows[poses.QUATERNION] = np.asarray(particles.orientation, np.float64)
    robot = frame.log.get("particles/robot", np.arange(particles.N))
    rows["robot"] = np.asarray(robot, np.int64)
    rows["time"] = float(frame.configuration.step)
    rows["line"] = number
    return rows


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


def read_tum(path: Path, assumed: poses.Assumptions) -> poses.PoseTable | None:
    """Read a folder with a file for each robot, or a TUM file with a robot a line.

    Return None if the path is neither a folder nor named `.tum`.

    Raises:
        InputError: a line is malformed, or a file of the folder has no number in its name.
    """
    if not path.is_dir() and path.suffix != ".tum":
        return None
    if path.is_dir():
        return _read_folder(path, assumed)
    rows, incomplete = _trajectory(path, assumed.dock_radius)
    dropped = columns.report_incomplete(path, incomplete, drop=assumed.drop_incomplete)
    rank = rows["time"].argsort(kind="stable").argsort().to_numpy()
    rows = rows.drop(columns="time").assign(robot=rank, join=rank, run="")
    note = "a robot a line, numbered by time; for poses over time, name a folder with a file each"
    return poses.PoseTable(rows, "", (), [note, *dropped])


def _read_folder(path: Path, assumed: poses.Assumptions) -> poses.PoseTable:
    """Read a file for each robot, whose number is in the file's name: `.tum`, else tables."""
    files = sorted(path.glob("*.tum")) or sorted(
        file for file in path.iterdir() if file.suffix in {".csv", ".txt", ".tsv"}
    )
    robots = columns.numbers_in([file.stem for file in files])
    if files and not robots:
        file = next((file for file in files if len(re.findall(r"\d+", file.stem)) != 1), files[0])
        problem = "the name has no number, or several; name the file as robot_7.tum, or move it "
        raise InputError(f"{problem}out of the folder if it is of no robot", path=file)
    tables = []
    file_of: dict[int, str] = {}
    for file, robot in zip(files, robots, strict=True):
        if robot in file_of:
            problem = f"the name has the number of {file_of[robot]}; give each robot its own"
            raise InputError(problem, path=file)
        file_of[robot] = file.name
        if file.suffix == ".tum":
            rows, incomplete = _trajectory(file, assumed.dock_radius)
            notes = columns.report_incomplete(
                file, incomplete, drop=assumed.drop_incomplete, name=file.name
            )
            table = poses.PoseTable(rows.assign(robot=robot), "", (), notes)
        else:
            table = columns.read_table(file, assumed, robot=robot)
        tables.append(table._replace(rows=table.rows.assign(file=str(file))))
    if not tables:
        if any(file.suffix in {".db3", ".mcap"} for file in path.iterdir()):
            problem = "a bag of ROS 2 without metadata.yaml; run ros2 bag reindex on the folder"
            raise InputError(problem, path=path)
        problem = "there are no files *.tum or *.csv; add one for each robot"
        raise InputError(problem, path=path)
    rows = pd.concat([table.rows for table in tables]).assign(run="")
    all_notes = [note for table in tables for note in table.notes]
    if files[0].suffix != ".tum":
        if not rows["robot"].duplicated().any():
            rows = rows.drop(columns="time", errors="ignore")
        all_notes = [*dict.fromkeys(all_notes)]
    units = {table.length_unit for table in tables}
    if len(units) > 1:
        listed = " and ".join(unit or "none" for unit in sorted(units))
        problem = f"files have different units, {listed}; convert them to one"
        raise InputError(problem, path=path)
    return tables[0]._replace(rows=rows, notes=all_notes)


def _trajectory(path: Path, dock_radius: float) -> tuple[pd.DataFrame, list[int]]:
    """Read the lines of a file, with their numbers, and list the lines that have a NaN."""
    rows = []
    lines = []
    incomplete = []
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
    columns.refuse_far(table, path, dock_radius)
    return table, incomplete


_VICON = ("Objects", "Segments")
_VICON_WITHOUT_POSES = ("Trajectories", "Model Outputs", "Joints", "Devices", "Unlabeled")

_LONGEST_HEAD = 100
"""Lines after which a head without an end is none; events of Qualisys have a line each."""

_Lines = list[list[str]]

_ReadHead = Callable[[Path, _Lines, list[str]], tuple[list[str], int, columns.Sheet]]
"""Takes the file, the cells of its first lines, and all lines; returns the names of columns, the
last line of the head, and what the program implies."""


def read_mocap(path: Path, assumed: poses.Assumptions) -> poses.PoseTable | None:
    """Read the rigid bodies of an export; return None if the file is none.

    Raises:
        InputError: a line is malformed, or the export lacks orientations or has them in angles
            whose order it does not state.
    """
    _, first_line = next(numbered_lines(path, LONGEST_TEXT), (1, ""))
    start = _cells(first_line, path, 1)[0]
    readers: dict[str, _ReadHead] = {
        "Format Version": _motive,
        "FILE_VERSION": _qualisys,
        "NO_OF_FRAMES": _qualisys,
        **dict.fromkeys((*_VICON, *_VICON_WITHOUT_POSES), _vicon),
    }
    read_head = readers.get(start)
    if read_head is None:
        return None
    lines = [text.rstrip() for _, text in numbered_lines(path, LONGEST_TEXT)]
    cells = [_cells(text, path, number) for number, text in enumerate(lines[:_LONGEST_HEAD], 1)]
    names, last, sheet = read_head(path, cells, lines)
    separator = next((sign for sign in "\t;" if sign in lines[last]), ",")
    rows = [line if line.strip(f"{separator} ") else "#" for line in lines[last + 1 :]]
    if read_head is _vicon and "#" in rows:  # a blank line ends a block
        rows = rows[: rows.index("#")]
    for k, row in enumerate(rows):
        if row != "#":
            lacking = len(names) - row.count(separator) - 1
            rows[k] = row + separator * lacking
    if not any(row != "#" for row in rows):
        raise InputError("there are no poses; export frames with bodies", path=path, line=1)
    text = [*"#" * last, columns.header_line(names, separator), *rows]
    return columns.read_table(path, assumed, sheet._replace(text="\n".join(text)))


def _cells(text: str, path: Path, number: int) -> list[str]:
    """Split a line of a head."""
    separator = ";" if text.count(";") > text.count(",") else ","
    if "\t" in text:
        separator = "\t"
    cells = split_cells(text, separator, path, number, is_strict=False)
    return [cell.strip() for cell in cells] or [""]


def _end(head: _Lines, path: Path, program: str, remedy: str) -> int:
    """Find the last line of a head, which starts with Frame."""
    end = next((k for k, cells in enumerate(head) if cells[0] == "Frame"), 0)
    if end == 0:
        raise InputError(f"{program} lacks {remedy}", path=path, line=1)
    return end


def _motive(path: Path, head: _Lines, _: list[str]) -> tuple[list[str], int, columns.Sheet]:
    """Name the columns of an export of Motive."""
    facts = dict(zip(head[0][::2], head[0][1::2], strict=False))
    space = facts.get("Coordinate Space", "Global")
    if space != "Global":
        problem = f"Coordinate Space is {space[:40]}; export again with Global"
        raise InputError(problem, path=path, line=1)
    remedy = "rows Type, Name and Frame; export it with them"
    end = _end(head, path, "the head of Motive's export", remedy)
    rows = {cells[1]: cells for cells in head[:end] if len(cells) > 1}
    if not {"Type", "Name"} <= {*rows}:
        problem = f"the head of Motive's export lacks {remedy}"
        raise InputError(problem, path=path, line=1)
    heads = zip(rows["Type"], rows["Name"], head[end - 1], head[end], strict=False)
    names = [
        f"{name}/{what} {axis}" if kind == "Rigid Body" and axis else ""
        for kind, name, what, axis in heads
    ]
    names[:2] = head[end][:2]
    turn = facts.get("Rotation Type", "Quaternion")
    sheet = columns.Sheet(
        text="",
        program="Motive",
        length_unit=facts.get("Length Units", "Meters").lower(),
        degrees=True,
        euler="" if turn == "Quaternion" else turn,
        notes=["Motive has y up unless an export maps its axes: --up y"],
    )
    return names, end, sheet


def _qualisys(path: Path, head: _Lines, _: list[str]) -> tuple[list[str], int, columns.Sheet]:
    """Name the columns of an export of Qualisys Track Manager."""
    remedy = "BODY_NAMES and a column Frame; export 6D data with both headers"
    end = _end(head, path, "Qualisys' export", remedy)
    bodies = next((cells[1:] for cells in head if cells[0] == "BODY_NAMES"), [])
    if not bodies:
        raise InputError(f"Qualisys' export lacks {remedy}", path=path, line=1)
    names = []
    listed_bodies = iter(bodies)
    body = ""
    for cell in head[end]:
        x_of_body = re.fullmatch(r"(?:(.*) )?X", cell)
        if x_of_body:
            listed_body = next(listed_bodies, "")
            body = x_of_body[1] or listed_body
        names.append(f"{body}/{cell.removeprefix(f'{body} ')}" if body else cell)
    if "Time" in names:  # which is not counted in frames
        names[names.index("Frame")] = ""
    return names, end, columns.Sheet("", "Qualisys", "mm", degrees=True, euler="XYZ")


def _vicon(path: Path, _: _Lines, lines: list[str]) -> tuple[list[str], int, columns.Sheet]:
    """Name the columns of the first block of rigid bodies in an export of Vicon's programs."""
    start = next((k for k, text in enumerate(lines) if text.split(",")[0] in _VICON), -1)
    if start < 0 or len(lines) < start + 5:
        problem = "Vicon's export has no block Objects or Segments, so no orientations; "
        raise InputError(f"{problem}export rigid bodies, with quaternions", path=path, line=1)
    bodies, axes, units = (_cells(lines[start + k], path, start + k + 1) for k in (2, 3, 4))
    names = []
    body = ""
    for place, axis in enumerate(axes):
        if place < len(bodies) and bodies[place]:
            body = bodies[place].removeprefix("Global Angle ").partition(":")[0]
        unit = units[place] if place < len(units) else ""
        name = axis
        if body and re.fullmatch("[RT][XYZW]'*", axis):
            name = f"{body}/{axis} [{unit}]" if unit else f"{body}/{axis}"
        names.append(name)
    return names, start + 4, columns.Sheet("", "Vicon", "mm", degrees=False)
