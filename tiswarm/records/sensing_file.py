"""The interchange file `sensing.jsonl`: from a log to a file and back.

Numbers are written in the shortest form that reads back as the same float64, so a log comes back
bit for bit, and a file that we wrote, read and write again keeps its bytes. Reader and writer need
memory for the log and one line.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.errors import InputError
from tiswarm.records.io import Opener, at_line, decode, raw_lines, replacing
from tiswarm.records.mcap_file import sensing_lines
from tiswarm.records.sensing_builder import SensingLogBuilder
from tiswarm.records.sensing_events import EVENT_VERSION, parse_line
from tiswarm.records.sensing_format import (
    FORMAT,
    NEW_LISTS,
    NEW_NOISE,
    ROBOT_NUMBERS,
    STANCE_LISTS,
    parse_header,
)
from tiswarm.records.sensing_log import SensingLog, canonical_contacts


def read_sensing_log(path: Path) -> SensingLog:
    r"""Read a sensing file; where the name ends in .mcap, its messages are the lines.

    Raises:
        InputError: the file cannot be read or a line is malformed; names file, line and key.

    >>> from tempfile import TemporaryDirectory
    >>> header = {"format": FORMAT, "version": 1, "dock_radius": 1.0, "dock_offsets": [[1.5, 0, 0]]}
    >>> header |= {"anchor_position": [0, 0, 1], "ground_z": None, "length_unit": "R"}
    >>> anchor = {"robot": 7, "orientation_wxyz": [1, 0, 0, 0], "contacts": [], "flip_height": 5.31}
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "sensing.jsonl"
    ...     _ = path.write_text(f"{json.dumps(header)}\n{json.dumps(anchor)}")
    ...     write_sensing_log(read_sensing_log(path), path)
    ...     print(path.read_text().splitlines()[1])
    {"robot": 7, "orientation_wxyz": [1.0, 0.0, 0.0, 0.0], "contacts": [], "flip_height": 5.31}
    """
    lines = log_lines(path)
    number, raw = next(lines, (0, b""))
    if number == 0:
        raise InputError("the file is empty; start it with a header line", path=path, line=1)
    with at_line(path, number):
        builder = SensingLogBuilder(parse_header(decode(raw, path, number)))
    for number, raw in lines:
        with at_line(path, number):
            builder.take(parse_line(decode(raw, path, number), builder.header))
    if number == 1:
        problem = "there are no robots; add a line for each, the anchor first"
        raise InputError(problem, path=path, line=2)
    return builder.log()


def log_lines(path: Path, source: BinaryIO | None = None) -> Iterator[tuple[int, bytes]]:
    """Yield the bytes of each line of a log with its number, counted from 1, as it is read.

    Args:
        path: Sensing file of any kind, or what messages call an open input.
        source: Open input to read in place of the file.

    Raises:
        InputError: the file cannot be read, or a line is too long.
    """
    if source is None and path.suffix == ".mcap":
        return sensing_lines(path)
    return raw_lines(path, source=source)


def write_sensing_log(log: SensingLog, path: Path, *, opened: Opener = replacing) -> None:
    """Write a sensing file, which `opened` opens.

    Raises:
        ValueError: a number that must be known is not finite.
        EnvironmentTroubleError: the file cannot be written.
    """
    with opened(path) as file:
        for entries in log_entries(log):
            file.write(f"{json.dumps(entries, allow_nan=False)}\n".encode())


def log_entries(log: SensingLog) -> Iterator[dict[str, Any]]:
    """Yield the content of each line of a sensing file: the header, robot by robot, who left."""
    left = ({"event": "leave", "robot": robot} for robot in log.robot_id[log.gone].tolist())
    return chain([_header_entries(log)], _robot_entries(log), left)


def check_header(log: SensingLog) -> None:
    """Raise InputError, with the key alone, where a reader would refuse a log's header."""
    parse_header(json.dumps(_header_entries(log)))


def _header_entries(log: SensingLog) -> dict[str, object]:
    entries: dict[str, object] = {
        "format": FORMAT,
        "version": _version(log),
        "dock_radius": log.dock_radius,
        "dock_offsets": log.dock_offset_body.tolist(),
        "anchor_position": log.anchor_position.tolist(),
        "ground_z": log.ground_z,
        "length_unit": log.length_unit,
    }
    if log.noise is not None:
        stated = asdict(log.noise).items()
        entries["noise"] = {key: value for key, value in stated if value is not None}
    if log.source_name:
        shared = zip(log.source_name, log.source_sd.tolist(), strict=True)
        entries["sources"] = {name: {"shared_sd": sd} for name, sd in shared}
    return entries


def _robot_entries(log: SensingLog) -> Iterator[dict[str, object]]:
    stances = log.stances
    arrays = {key: getattr(log, key) for key in STANCE_LISTS}
    arrays["contacts"] = canonical_contacts(log.contacts)[:, [2, 3, 0, 1]]
    unused = {key for key in NEW_LISTS if not _is_used(key, log)}
    absent = unused | ({"ground_docks"} if log.ground_z is None else set())
    arrays = {key: rows for key, rows in arrays.items() if key not in absent}
    final = _lists(arrays, log.robot_count, log)
    if stances is not None:
        arrays = {key: getattr(stances, key) for key in STANCE_LISTS if key not in unused}
        earlier = _lists(arrays, len(stances.pivot_dock), log)
    for i, name in enumerate(log.robot_id.tolist()):
        wxyz = log.orientation_wxyz[i]
        orientation = None if np.isnan(wxyz).all() else wxyz.tolist()
        entries: dict[str, object] = {"robot": name, "orientation_wxyz": orientation, **next(final)}
        for key in ROBOT_NUMBERS:
            number = getattr(log, key)[i]
            if not np.isnan(number).all():
                entries[key] = number.tolist()
        if stances is not None:
            entries["stances"] = [
                {
                    "orientation_wxyz": stances.orientation_wxyz[row].tolist(),
                    "pivot_dock": int(stances.pivot_dock[row]),
                    **next(earlier),
                }
                for row in range(stances.start[i], stances.start[i + 1])
            ]
        yield entries


def _version(log: SensingLog) -> int:
    """Return the first version that has all keys and events of a log."""
    if len(log.gone):
        return EVENT_VERSION
    states_new = any(getattr(log.noise, key, None) is not None for key in NEW_NOISE)
    has_null = bool(np.isnan(log.orientation_wxyz).any())
    is_new = states_new or has_null or bool(log.source_name)
    return 2 if is_new or any(_is_used(key, log) for key in NEW_LISTS) else 1


def _is_used(key: str, log: SensingLog) -> bool:
    """Whether any stance has items in a list."""
    return any(len(getattr(part, key)) for part in (log, log.stances) if part is not None)


def _lists(
    arrays: dict[str, NDArray[Any]], count: int, log: SensingLog
) -> Iterator[dict[str, list[object]]]:
    """Yield the lists of each stance, from arrays whose first column names the stance, in order."""
    start, items = {}, {}
    for key, rows in arrays.items():
        pairs = zip(STANCE_LISTS[key], rows.T[1:], strict=True)
        columns = [_column(kind, number, log) for kind, number in pairs]
        if "number" in STANCE_LISTS[key]:  # whole numbers may stand among them
            columns = [column.astype(object) for column in columns]
        items[key] = columns[0] if len(columns) == 1 else np.column_stack(columns)
        start[key] = np.searchsorted(rows[:, 0], np.arange(count + 1))
    for stance in range(count):
        places = {key: slice(*first[stance : stance + 2]) for key, first in start.items()}
        yield {key: _rows(key, items[key][place]) for key, place in places.items()}


def _rows(key: str, items: NDArray[Any]) -> list[Any]:
    """List the rows of one stance; where a source is null, it is left out."""
    rows: list[Any] = items.tolist()
    if STANCE_LISTS[key][-1] != "source":
        return rows
    return [row[:-1] if row[-1] is None else row for row in rows]


def _column(kind: str, number: NDArray[Any], log: SensingLog) -> NDArray[Any]:
    """Write a column as the file has it: names of robots and sources, null for unknown docks."""
    if kind == "number":
        return number
    index = number.astype(np.int64)
    if kind == "robot":
        return log.robot_id[index]
    if kind == "source":
        return np.array([*log.source_name, None], object)[index]  # -1, for none, is the last
    if kind == "dock or null":
        column = index.astype(object)
        column[index < 0] = None
        return column
    return index
