"""The interchange file `sensing.jsonl`: from a log to a file and back.

Numbers are written in the shortest form that reads back as the same float64, so a log comes
back bit for bit, and a file of ours that is read and written again keeps its bytes. Both
directions hold the log and one line at a time.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tiswarm.errors import InputError
from tiswarm.records.atomic import replacing
from tiswarm.records.lines import numbered_lines, placed
from tiswarm.records.sensing_columns import SensingColumns
from tiswarm.records.sensing_line import FORMAT, VERSION, parse_header, parse_robot
from tiswarm.records.sensing_log import SensingLog, Stances, canonical_contacts

_Entries = dict[str, object]


def read_sensing_log(path: Path) -> SensingLog:
    """Read a sensing file.

    Raises:
        InputError: the file cannot be read or a line is malformed; tells file, line and key.
    """
    lines = numbered_lines(path)
    number, text = next(lines, (0, ""))
    if number == 0:
        problem = "the file is empty; start it with a header line"
        raise InputError(problem, path=path, line=1)
    with placed(path, number):
        columns = SensingColumns(parse_header(text))
    for number, text in lines:
        with placed(path, number):
            columns.add(parse_robot(text))
    if number == 1:
        problem = "there are no robots; add a line for each, the anchor first"
        raise InputError(problem, path=path, line=2)
    return columns.log()


def write_sensing_log(log: SensingLog, path: Path) -> None:
    """Write a sensing file.

    Raises:
        ValueError: a number that must be known is not finite.
        EnvironmentTroubleError: the file cannot be written.
    """
    with replacing(path) as file:
        file.write(_json_line(_header_entries(log)))
        for entries in _robot_entries(log):
            file.write(_json_line(entries))


def _json_line(entries: _Entries) -> bytes:
    return f"{json.dumps(entries, allow_nan=False)}\n".encode()


def _header_entries(log: SensingLog) -> _Entries:
    entries: _Entries = {
        "format": FORMAT,
        "version": VERSION,
        "dock_radius": log.dock_radius,
        "dock_offsets": log.dock_offset_body.tolist(),
        "anchor_position": log.anchor_position.tolist(),
        "ground_z": log.ground_z,
        "length_unit": log.length_unit,
    }
    if log.noise is not None:
        stated = asdict(log.noise).items()
        entries["noise"] = {key: value for key, value in stated if value is not None}
    return entries


def _robot_entries(log: SensingLog) -> Iterator[_Entries]:
    names = log.robot_id.tolist()
    joiner_first = canonical_contacts(log.contacts)[:, [2, 3, 0, 1]]
    contacts = _Groups(joiner_first, len(names))
    ground_docks = _Groups(log.ground_docks, len(names))
    stances = None if log.stances is None else _StanceEntries(log.stances, names)
    for i, name in enumerate(names):
        entries: _Entries = {
            "robot": name,
            "orientation_wxyz": log.orientation_wxyz[i].tolist(),
            "contacts": _named(contacts[i], names),
        }
        if log.ground_z is not None:
            entries["ground_docks"] = ground_docks[i][:, 0].tolist()
        if not np.isnan(log.flip_height[i]):
            entries["flip_height"] = float(log.flip_height[i])
        if not np.isnan(log.spawn_position[i]).all():
            entries["spawn_position"] = log.spawn_position[i].tolist()
        if stances is not None:
            entries["stances"] = stances.of_robot(i)
        yield entries


class _StanceEntries:
    """The stances of a log, ready to be written robot by robot."""

    def __init__(self, stances: Stances, names: list[int]) -> None:
        count = len(stances.pivot_dock)
        self._stances = stances
        self._names = names
        self._contacts = _Groups(stances.contacts, count)
        self._ground_docks = _Groups(stances.ground_docks, count)

    def of_robot(self, i: int) -> list[_Entries]:
        """Entries of all stances of one robot, in time order."""
        return [
            {
                "orientation_wxyz": self._stances.orientation_wxyz[row].tolist(),
                "pivot_dock": int(self._stances.pivot_dock[row]),
                "contacts": _named(self._contacts[row], self._names),
                "ground_docks": self._ground_docks[row][:, 0].tolist(),
            }
            for row in range(self._stances.start[i], self._stances.start[i + 1])
        ]


class _Groups:
    """Rows sorted by their first column, found by it; the first column is dropped."""

    def __init__(self, rows: NDArray[np.int32], count: int) -> None:
        self._rows = rows[:, 1:]
        self._start = np.searchsorted(rows[:, 0], np.arange(count + 1))

    def __getitem__(self, group: int) -> NDArray[np.int32]:
        return self._rows[self._start[group] : self._start[group + 1]]


def _named(contacts: NDArray[np.int32], names: list[int]) -> list[list[int]]:
    """Replace the index of the other robot by its name."""
    return [[own, names[other], dock] for own, other, dock in contacts.tolist()]
