"""The interchange file `sensing.jsonl`: from a log to a file and back.

Numbers are written in the shortest form that reads back as the same float64, so a log comes
back bit for bit, and a file of ours that is read and written again keeps its bytes. Both
directions hold the log and one line at a time.
"""

import json
import math
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tiswarm.errors import InputError
from tiswarm.records.io import at_line, numbered_lines, replacing
from tiswarm.records.messages import dotted, explain, shown
from tiswarm.records.sensing_log import SensingLog, SensingNoise, Stances, canonical_contacts

FORMAT = "tiswarm-sensing"
VERSION = 1

RobotName = Annotated[int, Field(ge=-(2**63), le=2**63 - 1)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]
Contact = Annotated[list[int], Field(min_length=3, max_length=3)]
Contacts = Annotated[list[Contact], Field(fail_fast=True)]
Docks = Annotated[list[int], Field(fail_fast=True)]
Spread = Annotated[float, Field(ge=0.0)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


class _Line(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)


class NoiseEntry(_Line):
    """How wrong the senses are; keys as `SensingNoise` explains them."""

    tilt_deg: Spread
    yaw_deg: Spread
    yaw_bias_deg: Spread | None = None
    spawn: Spread | None = None
    missed_contacts: Fraction | None = None
    wrong_docks: Fraction | None = None
    false_contacts: Fraction | None = None


class HeaderLine(_Line):
    """What holds for all robots; keys in the order they are written."""

    format: Literal["tiswarm-sensing"]
    version: Literal[1]
    dock_radius: Annotated[float, Field(gt=0.0)]
    dock_offsets: Annotated[list[Vector], Field(min_length=1, fail_fast=True)]
    anchor_position: Vector
    ground_z: float | None
    length_unit: Annotated[str, Field(min_length=1)]
    noise: NoiseEntry | None = None


class StanceEntry(_Line):
    """One stance before the final one."""

    orientation_wxyz: Quaternion
    pivot_dock: int
    contacts: Contacts = []
    ground_docks: Docks | None = None


class RobotLine(_Line):
    """One robot, at its final stance and at those before."""

    robot: RobotName
    orientation_wxyz: Quaternion
    contacts: Contacts
    ground_docks: Docks | None = None
    flip_height: float | None = None
    spawn_position: Vector | None = None
    stances: Annotated[list[StanceEntry], Field(fail_fast=True)] | None = None


_Model = TypeVar("_Model", HeaderLine, RobotLine)
_NESTED: dict[str | int, type[_Line]] = {"stances": StanceEntry, "noise": NoiseEntry}


def parse_header(text: str) -> HeaderLine:
    """Read the first line.

    Raises:
        InputError: with the key at fault, but without file and line.
    """
    entries = _parse_json(text)
    if entries.get("format") != FORMAT:
        problem = f'the first line is not a header; start it with {{"format": "{FORMAT}", ...'
        raise InputError(problem, key="format")
    version = entries.get("version")
    if type(version) is not int or version != VERSION:
        problem = f"{shown(version)} is not supported; this program reads version {VERSION}"
        raise InputError(problem, key="version")
    return _validate(entries, HeaderLine)


def parse_robot(text: str) -> RobotLine:
    """Read any line but the first.

    Raises:
        InputError: with the key at fault, but without file and line.
    """
    return _validate(_parse_json(text), RobotLine)


def _validate(entries: dict[str, object], model: type[_Model]) -> _Model:
    try:
        return model.model_validate(entries)
    except ValidationError as found:
        error = found.errors(include_url=False)[0]
    place = error["loc"]
    section = _NESTED.get(place[0], model) if len(place) > 1 else model
    raise InputError(explain(error, section.model_fields), key=dotted(place))


def _parse_json(text: str) -> dict[str, object]:
    if not text.strip():
        problem = "the line is empty; delete it"
        raise InputError(problem)
    try:
        entries = _DECODER.decode(text)
    except json.JSONDecodeError as error:
        problem = f"not JSON at column {error.colno}: {error.msg}; write one JSON object a line"
        raise InputError(problem) from error
    except (ValueError, RecursionError) as error:
        problem = "nested too deep, or a number of thousands of digits; write one robot a line"
        raise InputError(problem) from error
    if not isinstance(entries, dict):
        problem = f"{shown(entries)} is not a JSON object; write the line as {{...}}"
        raise InputError(problem)
    return entries


def _without_duplicates(pairs: list[tuple[str, object]]) -> dict[str, object]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        counts = Counter(name for name, _ in pairs)
        twice = counts.most_common(1)[0][0]
        problem = "the key stands twice in one object; keep one of the two"
        raise InputError(problem, key=dotted([twice]))
    return entries


_DECODER = json.JSONDecoder(object_pairs_hook=_without_duplicates)


FAR_FROM_UNIT = 1e-3
"""A quaternion whose length is off by more is refused: it is no rounded unit quaternion."""

CLOSE_TO_UNIT = 1e-9
"""A quaternion whose length is off by less is kept as it stands, so that ours keep their bits."""

_UNKNOWN_PLACE = [math.nan] * 3
_Entry = RobotLine | StanceEntry


class Felt(NamedTuple):
    """One stance, checked, with names of other robots turned into indices."""

    orientation_wxyz: list[float]
    contacts: list[tuple[int, int, int]]
    """Rows of (own dock, other robot, its dock), sorted."""
    ground_docks: list[int]


class _FeltColumns:
    """Orientation and touches, of final stances or of earlier ones: one row each."""

    def __init__(self) -> None:
        self.orientation = array("d")
        self.contacts = array("i")
        """Rows of (row, own dock, other robot, other dock)."""
        self.ground_docks = array("i")
        """Rows of (row, own dock)."""

    def append(self, felt: Felt) -> None:
        row = len(self.orientation) // 4
        self.orientation.extend(felt.orientation_wxyz)
        for contact in felt.contacts:
            self.contacts.extend((row, *contact))
        for dock in felt.ground_docks:
            self.ground_docks.extend((row, dock))


class SensingColumns:
    """The log so far; every robot that is added is checked against those before it."""

    def __init__(self, header: HeaderLine) -> None:
        self._header = header
        self._index_of: dict[int, int] = {}
        self._final = _FeltColumns()
        self._earlier = _FeltColumns()
        self._flip_height = array("d")
        self._spawn_position = array("d")
        self._pivot_dock = array("i")
        self._stance_start = array("q", [0])
        self._knows_stances = False

    def add(self, robot: RobotLine) -> Felt:
        """Append a robot, and return what it feels at the end; one that is refused is not added.

        Raises:
            InputError: with the key at fault, but without file and line.
        """
        if robot.robot in self._index_of:
            problem = f"robot {robot.robot} has a line already; give every robot its own number"
            raise InputError(problem, key="robot")
        stances = robot.stances or []
        self._index_of[robot.robot] = len(self._index_of)
        try:
            final = self._checked(robot, "")
            earlier = [self._checked(entry, f"stances[{n}].") for n, entry in enumerate(stances)]
        except InputError:
            del self._index_of[robot.robot]
            raise
        self._final.append(final)
        self._flip_height.append(math.nan if robot.flip_height is None else robot.flip_height)
        self._spawn_position.extend(robot.spawn_position or _UNKNOWN_PLACE)
        for felt in earlier:
            self._earlier.append(felt)
        self._pivot_dock.extend(entry.pivot_dock for entry in stances)
        self._stance_start.append(len(self._pivot_dock))
        self._knows_stances = self._knows_stances or robot.stances is not None
        return final

    def log(self) -> SensingLog:
        """Assemble the log; at least one robot must have been added."""
        noise, final = self._header.noise, self._final
        felt = np.array(final.contacts, dtype=np.int32).reshape(-1, 4)
        return SensingLog(
            robot_id=np.array(list(self._index_of), dtype=np.int64),
            dock_radius=self._header.dock_radius,
            dock_offset_body=np.array(self._header.dock_offsets, dtype=np.float64),
            anchor_position=np.array(self._header.anchor_position, dtype=np.float64),
            orientation_wxyz=np.array(final.orientation).reshape(-1, 4),
            contacts=np.ascontiguousarray(felt[:, [2, 3, 0, 1]]),
            ground_z=self._header.ground_z,
            ground_docks=np.array(final.ground_docks, dtype=np.int32).reshape(-1, 2),
            flip_height=np.array(self._flip_height),
            spawn_position=np.array(self._spawn_position).reshape(-1, 3),
            stances=self._stances() if self._knows_stances else None,
            noise=None if noise is None else SensingNoise(**noise.model_dump()),
            length_unit=self._header.length_unit,
        )

    def _stances(self) -> Stances:
        felt = self._earlier
        return Stances(
            start=np.array(self._stance_start, dtype=np.int64),
            orientation_wxyz=np.array(felt.orientation).reshape(-1, 4),
            pivot_dock=np.array(self._pivot_dock, dtype=np.int32),
            contacts=np.array(felt.contacts, dtype=np.int32).reshape(-1, 4),
            ground_docks=np.array(felt.ground_docks, dtype=np.int32).reshape(-1, 2),
        )

    def _checked(self, entry: _Entry, prefix: str) -> Felt:
        """Check one stance of the robot that was named last."""
        if isinstance(entry, StanceEntry):
            self._check_dock(entry.pivot_dock, f"{prefix}pivot_dock")
        return Felt(
            _unit(entry.orientation_wxyz, f"{prefix}orientation_wxyz"),
            self._checked_contacts(entry.contacts, f"{prefix}contacts"),
            self._checked_ground_docks(entry.ground_docks or [], f"{prefix}ground_docks"),
        )

    def _checked_contacts(
        self, contacts: Sequence[Sequence[int]], key: str
    ) -> list[tuple[int, int, int]]:
        """Return rows of (own dock, index of the other robot, its dock), in order."""
        rows = []
        myself = len(self._index_of) - 1
        for place, (own_dock, name, other_dock) in enumerate(contacts):
            here = f"{key}[{place}]"
            self._check_dock(own_dock, here)
            self._check_dock(other_dock, here)
            other = self._index_of.get(name)
            if other is None:
                problem = (
                    f"robot {name} is not on an earlier line; list a contact at the later robot"
                )
                raise InputError(problem, key=here)
            if other == myself:
                problem = "the robot touches itself; name another robot or delete the contact"
                raise InputError(problem, key=here)
            rows.append((own_dock, other, other_dock))
        _refuse_repeated(rows, key)
        return sorted(rows)

    def _checked_ground_docks(self, docks: Sequence[int], key: str) -> list[int]:
        if docks and self._header.ground_z is None:
            problem = "there is no ground; give ground_z in the header or leave ground_docks empty"
            raise InputError(problem, key=key)
        for place, dock in enumerate(docks):
            self._check_dock(dock, f"{key}[{place}]")
        _refuse_repeated(docks, key)
        return sorted(docks)

    def _check_dock(self, dock: int, key: str) -> None:
        count = len(self._header.dock_offsets)
        if not 0 <= dock < count:
            problem = f"there is no dock {dock}; the header has docks 0 to {count - 1}"
            raise InputError(problem, key=key)


def _unit(orientation_wxyz: list[float], key: str) -> list[float]:
    length = math.hypot(*orientation_wxyz)
    if abs(length - 1.0) > FAR_FROM_UNIT:
        problem = f"the quaternion has length {length:.6g}; scale it to 1"
        raise InputError(problem, key=key)
    if abs(length - 1.0) <= CLOSE_TO_UNIT:
        return orientation_wxyz
    return [part / length for part in orientation_wxyz]


def _refuse_repeated(rows: Sequence[object], key: str) -> None:
    first: dict[object, int] = {}
    for place, row in enumerate(rows):
        if first.setdefault(row, place) != place:
            problem = f"says the same as {key}[{first[row]}]; list it once"
            raise InputError(problem, key=f"{key}[{place}]")


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
    with at_line(path, number):
        columns = SensingColumns(parse_header(text))
    for number, text in lines:
        with at_line(path, number):
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
