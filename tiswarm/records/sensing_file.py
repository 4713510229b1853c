"""The interchange file `sensing.jsonl`: from a log to a file and back, line by line.

The builder of a log refuses what the lines before a line rule out.

Numbers are written in the shortest form that reads back as the same float64, so a log comes back
bit for bit, and a file that we wrote, read and write again keeps its bytes. Reader and writer need
memory for the log and one line.
"""

import json
import math
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Bools, Ints
from tiswarm.base.errors import InputError
from tiswarm.records import sensing_format
from tiswarm.records.io import Opener, at_line, decode, raw_lines, replacing
from tiswarm.records.messages import shown
from tiswarm.records.sensing_format import FORMAT, HeaderLine, RobotLine, SensingLine, StanceEntry
from tiswarm.records.sensing_log import (
    LISTS,
    NUMBERS,
    WHOLE,
    Column,
    Key,
    SensingLog,
    Stances,
    canonical_contacts,
)

FAR_FROM_UNIT = 1e-3
"""Deviation of a unit vector's or quaternion's length from 1 above which it is refused."""

_CLOSE_TO_UNIT = 1e-9
"""Deviation below which neither is scaled to 1, so that our own ones keep their bits."""

_UNIT = {"normal": "direction", "direction": "direction", "quaternion": "quaternion"}
"""Columns that are unit vectors, in words; a normal stays as it is."""

_REALS = {
    name: [
        (column, key.columns.index(column), key.columns.index(column) + key.columns.count(column))
        for column in dict.fromkeys(key.columns)
        if column not in (*WHOLE, "source")
    ]
    for name, key in LISTS.items()
}
"""Real numbers of an item: what they are, the first of them and the one after the last."""

_OF_DOCKS = [name for name, key in LISTS.items() if key.is_of_docks]

Contact = tuple[int | None, int, int | None]
"""Own dock, name of the other robot, its dock; None for an unknown dock."""


class SensedStance(NamedTuple):
    """One checked stance, with indices in place of the names of other robots."""

    orientation_wxyz: list[float]
    lists: dict[str, list[tuple[Any, ...]]]  # sorted items of each key in `LISTS`


class SensingLogBuilder:
    """Builds a log line by line; checks each against those before it.

    A line that is refused leaves no trace: an InputError names the key at fault, but neither file
    nor line.
    """

    def __init__(self, header: HeaderLine, *, of_some: bool = False) -> None:
        """Start a log without robots.

        Args:
            header: First line of the log.
            of_some: Whether it is of some robots only: what they sensed of others is left out.
        """
        self.header = header
        self._of_some = of_some
        self._source_of = {name: row for row, name in enumerate(header.sources or {})}
        self._index_of: dict[int, int] = {}
        self._gone: dict[int, int] = {}  # robots that had joined by then
        self._lines = 1  # the header
        # A robot has one entry in all columns that follow, or one more with each new line.
        self._entry = array("q")
        self._line = array("q")
        self._touching = array("B")  # final contacts of every dock, robot after robot
        self._final = _StanceColumns()
        self._earlier = _StanceColumns()
        self._numbers = {name: array("d") for name in NUMBERS}
        self._pivot_dock = array("i")
        self._stance_start = array("q", [0])
        self._has_stances = array("b")

    @property
    def numbers(self) -> Mapping[int, int]:
        """By name, the number of each robot, in join order."""
        return self._index_of

    def take(self, line: SensingLine) -> None:
        """Take a line of any kind."""
        if line.event == "leave":
            self.leave(line.robot)
        elif line.event == "release":
            self.release(line.robot, line.contacts)
        elif line.event == "replace":
            self.replace(line)
        else:
            self.add(line)

    def add(self, line: RobotLine) -> SensedStance:
        """Append a robot and return its final stance."""
        if line.robot in self._index_of:
            problem = f"robot {line.robot} has a line already; give every robot its own number"
            raise InputError(problem, key="robot")
        entry = len(self._line)
        number = len(self._index_of)
        stance = self._enter(line, number)
        self._index_of[line.robot] = number
        self._entry.append(entry)
        return stance

    def replace(self, line: RobotLine) -> SensedStance:
        """Take a new line of a robot in place of its last one, and return its final stance."""
        entry = len(self._line)
        number = self._present(line.robot, "robot")
        stance = self._enter(line, number)
        self._entry[number] = entry
        return stance

    def leave(self, robot: int) -> None:
        """Mark the robot of this name as gone; all that was sensed stays."""
        number = self._present(robot, "robot")
        if number == 0:
            problem = "the anchor holds all others; start a log with another anchor"
            raise InputError(problem, key="robot")
        self._gone[number] = len(self._index_of)
        self._lines += 1

    def release(self, robot: int, contacts: Sequence[Contact]) -> None:
        """Drop contacts of a robot, with the directions and connections of these docks.

        Args:
            robot: Its name.
            contacts: Rows of (own dock, name of the other robot, other dock), None for an unknown
                dock; the line of either of the two has each.
        """
        released: list[tuple[int, int, int, int]] = []
        for place, (dock, name, partner_dock) in enumerate(contacts):
            number = self._present(robot, "robot")
            partner = self._present(name, f"contacts[{place}]")
            end = (number, -1 if dock is None else dock)
            partner_end = (partner, -1 if partner_dock is None else partner_dock)
            (earlier, earlier_dock), (later, later_dock) = sorted([end, partner_end])
            contact = (later, later_dock, earlier, earlier_dock)
            if contact in released or not self._final.holds((self._entry[later], *contact[1:])):
                problem = f"robots {robot} and {name} do not touch so; correct the docks"
                raise InputError(problem, key=f"contacts[{place}]")
            released.append(contact)
        for later, later_dock, earlier, earlier_dock in released:
            if self._final.drop((self._entry[later], later_dock, earlier, earlier_dock)):
                for touched in self._ends(later, later_dock, earlier, earlier_dock):
                    self._touching[touched] -= 1
        self._lines += 1

    def log(self) -> SensingLog:
        """Assemble the log; at least one robot must have been added."""
        return self._log(np.arange(len(self._entry)))

    def log_of(self, number: int) -> tuple[SensingLog, Ints]:
        """Assemble the log of one robot: before it, the anchor and those that it names only stand.

        Of a robot that only stands the log has its final orientation and fixes.

        Args:
            number: Number of the robot, in join order.

        Returns:
            The log, and the number of each of its M robots, ascending, shape (M,).
        """
        entry = self._entry[number]
        mentioned = self._final.mentioned(entry, entry + 1)
        mentioned |= self._earlier.mentioned(*self._stance_start[entry : entry + 2])
        robots = np.array(sorted({0, number} | mentioned))
        return self._log(robots, standing=len(robots) - 1), robots

    def _log(self, robots: Ints, standing: int = 0) -> SensingLog:
        """Assemble the log of some robots, ascending; so many of the first only stand."""
        entry = _of_entries(self._entry, 1)[robots]
        start = _of_entries(self._stance_start, 1)
        final = self._final.arrays(entry, robots, standing)
        final["contacts"] = np.ascontiguousarray(final["contacts"][:, [2, 3, 0, 1]])
        numbers: dict[str, Any] = {
            name: _of_entries(self._numbers[name], len(key.columns))[entry]
            for name, key in NUMBERS.items()
        }
        line = _of_entries(self._line, 1)[entry]
        count = np.diff(start)[entry]
        count[:standing] = 0
        for number in numbers.values():
            number[:standing] = np.nan
        first = np.concatenate([[0], np.cumsum(count)])
        # The stances of an entry are in a row; those of robots follow by join order.
        chosen = np.repeat(start[entry] - first[:-1], count) + np.arange(first[-1])
        stances = Stances(
            start=first,
            pivot_dock=_of_entries(self._pivot_dock, 1)[chosen],
            **self._earlier.arrays(chosen, robots),
        )
        departed = np.flatnonzero(np.isin(robots, [*self._gone]))
        left_after = np.searchsorted(robots, [self._gone[n] for n in robots[departed].tolist()])
        index = np.arange(len(line))
        lines_before = np.searchsorted(np.sort(left_after), index, side="right")
        in_order = np.array_equal(line, 2 + index + lines_before)
        return SensingLog(
            robot_id=np.array(list(self._index_of), dtype=np.int64)[robots],
            gone=departed,
            left_after=left_after,
            line=None if in_order else line,
            dock_radius=self.header.dock_radius,
            dock_offset_body=np.array(self.header.dock_offsets, dtype=np.float64),
            anchor_position=np.array(self.header.anchor_position, dtype=np.float64),
            ground_z=self.header.ground_z,
            ground_form=self.header.ground_form,
            stances=stances if _of_entries(self._has_stances, 1)[entry[standing:]].any() else None,
            noise=self.header.noise,
            length_unit=self.header.length_unit,
            **self.header.source_arrays(),
            **final,
            **numbers,
        )

    def _present(self, robot: int, key: str) -> int:
        """Return the number of the robot of this name, which has joined and not left."""
        if robot not in self._index_of:
            problem = f"robot {robot} is not on an earlier line; let it join first"
            raise InputError(problem, key=key)
        number = self._index_of[robot]
        if number in self._gone:
            problem = f"robot {robot} has left; delete this line, or let the robot leave later"
            raise InputError(problem, key=key)
        return number

    def _enter(self, line: RobotLine, number: int) -> SensedStance:
        """Append the entry of a robot of this number, and return its final stance."""
        stances = line.stances or []
        anchor = self.header.anchor_position
        for key_name, key in NUMBERS.items():
            start = anchor[2] if key.columns == ("height",) else anchor
            self.header.refuse_far(key_name, getattr(line, key_name), start)
        name = line.robot
        final = self._checked(line, "", name, number)
        earlier = [
            self._checked(stance, f"stances[{n}].", name, number)
            for n, stance in enumerate(stances)
        ]
        self._count_contacts(name, number, final)
        self._final.append(final)
        for checked in earlier:
            self._earlier.append(checked)
        for key_name, key in NUMBERS.items():
            value = getattr(line, key_name)
            missing = [math.nan] * len(key.columns)
            self._numbers[key_name].extend(missing if value is None else np.ravel(value))
        self._pivot_dock.extend(entry.pivot_dock for entry in stances)
        self._stance_start.append(len(self._pivot_dock))
        self._has_stances.append(line.stances is not None)
        self._lines += 1
        self._line.append(self._lines)
        return final

    def _require_flat_ground(self, key: str) -> None:
        """Raise InputError where docks on the ground would say no height."""
        if self.header.ground_form is not None:
            problem = f"docks on {self.header.ground_form} ground are not listed; leave it empty"
            raise InputError(problem, key=key)
        if self.header.ground_z is None:
            problem = "there is no ground; give ground_z in the header or leave ground_docks empty"
            raise InputError(problem, key=key)

    def _checked(
        self, entry: RobotLine | StanceEntry, prefix: str, robot: int, number: int
    ) -> SensedStance:
        """Check one stance of the robot of this name and number."""
        if isinstance(entry, StanceEntry):
            self._check_dock(entry.pivot_dock, f"{prefix}pivot_dock")
        if entry.ground_docks:
            self._require_flat_ground(f"{prefix}ground_docks")
        orientation = self._orientation(entry, f"{prefix}orientation_wxyz", number)
        check: dict[str, Callable[[Any, str], Any]] = {
            "dock": self._check_dock,
            "dock or null": lambda dock, key: -1 if dock is None else self._check_dock(dock, key),
            "robot": partial(self._robot_index, robot, number),
            "source": self._source_index,
        }
        lists: dict[str, list[tuple[Any, ...]]] = {}
        for name, key in LISTS.items():
            listed = getattr(entry, name)
            if listed is not None and key.version > self.header.version:
                self.header.refuse_new(f"{prefix}{name}", listed, key.version)
            items: list[tuple[Any, ...]] = []
            if not listed:  # as most are
                lists[name] = items
                continue
            columns = key.columns
            reals = _REALS[name]
            first_place_of: dict[tuple[Any, ...], int] = {}
            for place, numbers in enumerate(listed):
                if self._of_some and self._is_of_others(key, numbers, robot):
                    continue
                place_key = f"{prefix}{name}[{place}]"
                # A source may be left out at the end.
                pairs = zip_longest(columns, [numbers] if len(columns) == 1 else numbers)
                item = tuple(
                    check[column](number, place_key) if column in check else number
                    for column, number in pairs
                )
                items.append(self._checked_reals(reals, item, place_key) if reals else item)
                if columns[0] == "dock or null" and -1 not in item:
                    problem = "both docks are known; list the contact in contacts"
                    raise InputError(problem, key=place_key)
                first_place = first_place_of.setdefault(items[-1], place)
                if first_place != place and not key.repeats:
                    problem = f"repeats {prefix}{name}[{first_place}]; list it once"
                    raise InputError(problem, key=place_key)
            lists[name] = sorted(items)
        return SensedStance(orientation, lists)

    def _checked_reals(
        self, reals: list[tuple[Column, int, int]], item: tuple[Any, ...], key: str
    ) -> tuple[Any, ...]:
        """Check the real numbers of an item beside each other; scale unit vectors."""
        checked = item
        for column, start, end in reals:
            part = item[start:end]
            if column in _UNIT:
                unit = _unit(part, _UNIT[column], key)
                if column != "normal":
                    checked = (*checked[:start], *unit, *checked[end:])
            elif column == "value":  # along the normal before it
                along = np.dot(item[:start], self.header.anchor_position)
                self.header.refuse_far(key, part[0], along)
            elif column == "distance":
                self.header.refuse_far(key, part[0], 0.0)
                if not part[0] > 0.0:
                    problem = f"the distance {part[0]:g} should be positive; correct it"
                    raise InputError(problem, key=key)
            elif column == "vector":
                self.header.refuse_far(key, part, 0.0)
                if not any(part):
                    raise InputError("the vector has length 0; correct it", key=key)
            elif column == "sd":
                self.header.refuse_sd(key, part[0])
        return checked

    def _orientation(self, entry: RobotLine | StanceEntry, key: str, number: int) -> list[float]:
        """Check a stance's orientation; NaN for a robot without a compass."""
        if entry.orientation_wxyz is not None:
            return _unit(entry.orientation_wxyz, "quaternion", key)
        if self.header.version == 1:
            raise InputError("null needs version 2; give an orientation or that version", key=key)
        if number == 0:
            raise InputError("the anchor's orientation is null; give it", key=key)
        if isinstance(entry, RobotLine) and entry.stances:
            problem = "null leaves the stances without an end; give an orientation or no stances"
            raise InputError(problem, key=key)
        return [math.nan] * 4

    def _ends(self, robot: int, dock: int, partner: int, partner_dock: int) -> list[int]:
        """Return where `_touching` has the two docks of a contact."""
        docks = len(self.header.dock_offsets)
        return [docks * robot + dock, docks * partner + partner_dock]

    def _count_contacts(self, robot: int, number: int, final: SensedStance) -> None:
        """Count the contacts of each dock that a new final stance of a robot changes."""
        docks = len(self.header.dock_offsets)
        touching = Counter[int]()
        for contact in final.lists["contacts"]:
            touching.update(self._ends(number, *contact))
        if number < len(self._entry):
            for contact in self._final.items("contacts", self._entry[number]):
                touching.subtract(self._ends(number, *contact))
        for end, change in touching.items():
            count = self._touching[end] if end < len(self._touching) else 0
            if count + change > sensing_format.MOST_CONTACTS:
                name = [*self._index_of, robot][end // docks]
                most = f"more than {sensing_format.MOST_CONTACTS} contacts; delete false ones"
                problem = f"dock {end % docks} of robot {name} has {most}"
                raise InputError(problem, key="contacts")
        if number == len(self._entry):
            self._touching.extend(bytes(docks))
        for end, change in touching.items():
            self._touching[end] += change

    def _is_of_others(self, key: Key, item: Sequence[Any], robot: int) -> bool:
        """Judge whether an item of a list is about a robot that is not in the log."""
        if key.robot is None:
            return False
        return item[key.robot] != robot and item[key.robot] not in self._index_of

    def _robot_index(self, robot: int, number: int, name: int, key: str) -> int:
        if name == robot:
            problem = "the robot touches itself; name another robot or delete the contact"
            raise InputError(problem, key=key)
        if self._index_of.get(name, number) >= number:
            problem = f"robot {name} is not on an earlier line; list a contact at the later robot"
            raise InputError(problem, key=key)
        return self._index_of[name]

    def _source_index(self, name: str | None, key: str) -> int:
        if name is not None and name not in self._source_of:
            problem = f"the header has no source {shown(name)}; add it to sources there"
            raise InputError(problem, key=key)
        return -1 if name is None else self._source_of[name]

    def _check_dock(self, dock: int, key: str) -> int:
        count = len(self.header.dock_offsets)
        if not 0 <= dock < count:
            problem = f"there is no dock {dock}; the header has docks 0 to {count - 1}"
            raise InputError(problem, key=key)
        return dock


class _StanceColumns:
    """Orientation and lists of many stances, in little memory."""

    def __init__(self) -> None:
        self._orientation = array("d")
        self._lists = {name: array("i" if key.is_whole else "d") for name, key in LISTS.items()}

    def append(self, stance: SensedStance) -> None:
        row = len(self._orientation) // 4
        self._orientation.extend(stance.orientation_wxyz)
        for key, items in stance.lists.items():
            for item in items:
                self._lists[key].extend((row, *item))

    def items(self, key: str, stance: int) -> list[tuple[Any, ...]]:
        """Return the items of one list of a stance."""
        table = self._table(key)
        return [tuple(row) for row in table[table[:, 0] == stance, 1:].tolist()]

    def holds(self, contact: tuple[int, int, int, int]) -> bool:
        """Whether a stance has a contact of these docks: (stance, own dock, robot, its dock)."""
        return any(self._is_of(contact, key).any() for key in _OF_DOCKS)

    def drop(self, contact: tuple[int, int, int, int]) -> bool:
        """Drop the items of a contact; return whether one of `contacts` was among them."""
        is_dropped = {key: self._is_of(contact, key) for key in _OF_DOCKS}
        for key, is_item in is_dropped.items():
            if is_item.any():
                kept = array(self._lists[key].typecode)
                kept.frombytes(self._table(key)[~is_item].tobytes())
                self._lists[key] = kept
        return bool(is_dropped["contacts"].any())

    def mentioned(self, first: int, stop: int) -> set[int]:
        """List the robots that some stances in a row name."""
        mentioned: set[int] = set()
        for name, key in LISTS.items():
            if key.robot is not None and self._lists[name]:
                table = self._table(name)
                begin, end = np.searchsorted(table[:, 0], [first, stop])
                mentioned.update(map(int, table[begin:end, 1 + key.robot].tolist()))
        return mentioned

    def arrays(self, chosen: Ints, robots: Ints, standing: int = 0) -> dict[str, Any]:
        """Return the arrays of some stances, numbered in this order.

        Args:
            chosen: The stances, shape (n,).
            robots: Those that they name, ascending; each gets its place among them as its number.
            standing: Number of stances, the first ones, that have fixes only.
        """
        lists = {}
        for name, key in LISTS.items():
            table = self._table(name)
            # Stances were appended one after the other, each with its items.
            first = np.searchsorted(table[:, 0], chosen)
            count = np.searchsorted(table[:, 0], chosen, "right") - first
            if name != "fixes":
                count[:standing] = 0
            end = np.cumsum(count)
            table = table[np.repeat(first + count - end, count) + np.arange(count.sum())]
            table[:, 0] = np.repeat(np.arange(len(chosen)), count)
            if key.robot is not None:
                robot_column = table[:, 1 + key.robot]
                robot_column[:] = np.searchsorted(robots, robot_column)
            lists[name] = table
        return {"orientation_wxyz": _of_entries(self._orientation, 4)[chosen], **lists}

    def _table(self, key: str) -> Any:  # noqa: ANN401 - of integers or floats
        """Return the items of a list of all stances, shape (n, 1 + numbers of an item)."""
        return _of_entries(self._lists[key], 1 + len(LISTS[key].columns))

    def _is_of(self, contact: tuple[int, int, int, int], key: str) -> Bools:
        """Find the items of a contact in a list, shape (n,)."""
        is_item: Bools = (self._table(key)[:, :4] == contact).all(axis=1)
        return is_item


def _of_entries(numbers: "array[Any]", count: int) -> Any:  # noqa: ANN401 - of integers or floats
    """Return a row for each entry, shape (n, count), or (n,) where it has one number."""
    # No copy: a join reads the rows of few stances. Arrays cannot grow while a view is in use.
    rows = np.frombuffer(numbers, numbers.typecode)
    rows.flags.writeable = False
    return rows if count == 1 else rows.reshape(-1, count)


def _unit(parts: Sequence[float], quantity: str, key: str) -> list[float]:
    length = math.hypot(*parts)
    if not abs(length - 1.0) <= FAR_FROM_UNIT:  # as for lengths that are NaN
        raise InputError(f"the {quantity} has length {length:.6g}; scale it to 1", key=key)
    scale = 1.0 if abs(length - 1.0) <= _CLOSE_TO_UNIT else length
    return [part / scale for part in parts]


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
        builder = SensingLogBuilder(sensing_format.parse_header(decode(raw, path, number)))
    for number, raw in lines:
        with at_line(path, number):
            builder.take(sensing_format.parse_line(decode(raw, path, number), builder.header))
    with at_line(path, 1):
        builder.header.require_lines(number - 1)
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
        from tiswarm.records.mcap import sensing_lines  # noqa: PLC0415 - needs an extra

        return sensing_lines(path)
    return raw_lines(path, source=source, takes_pipe=True)


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
    """Yield the content of each line of a sensing file: header, robots, and who left after each."""
    yield _header_entries(log)
    for count, entries in enumerate(_robot_entries(log), 1):
        yield entries
        for robot in log.robot_id[log.gone[log.left_after == count]].tolist():
            yield {"event": "leave", "robot": robot}


def lines_of(log: SensingLog) -> tuple[HeaderLine, list[RobotLine]]:
    """Return the header of a log and the lines of its robots, as a reader of its file has them.

    Raises:
        InputError: a reader would refuse them; it has the key alone.
    """
    lines = [sensing_format.parsed(entries, RobotLine) for entries in _robot_entries(log)]
    return check_header(log), lines


def check_header(log: SensingLog) -> HeaderLine:
    """Return the header of a log; an InputError, with the key alone, where a reader refuses it."""
    return sensing_format.parse_header(_header_entries(log))


def _header_entries(log: SensingLog) -> dict[str, object]:
    entries: dict[str, object] = {
        "format": FORMAT,
        "version": _version(log),
        "lines": log.robot_count + len(log.gone),
        "dock_radius": log.dock_radius,
        "dock_offsets": log.dock_offset_body.tolist(),
        "anchor_position": log.anchor_position.tolist(),
        "ground_z": log.ground_z,
        "length_unit": log.length_unit,
    }
    if log.ground_form is not None:
        entries["ground_form"] = log.ground_form
    if log.noise is not None:
        stated = asdict(log.noise).items()
        entries["noise"] = {key: value for key, value in stated if value is not None}
    if log.source_name:
        sources = zip(log.source_name, log.source_sd.tolist(), strict=True)
        entries["sources"] = {name: {"shared_sd": sd} for name, sd in sources}
    return entries


def _robot_entries(log: SensingLog) -> Iterator[dict[str, object]]:
    stances = log.stances
    arrays = {key: getattr(log, key) for key in LISTS}
    arrays["contacts"] = canonical_contacts(log.contacts)[:, [2, 3, 0, 1]]
    unused = {name for name, key in LISTS.items() if key.version > 1 and not _is_used(name, log)}
    absent = unused | ({"ground_docks"} if log.ground_z is None else set())
    arrays = {key: rows for key, rows in arrays.items() if key not in absent}
    final = _lists(arrays, log.robot_count, log)
    if stances is not None:
        arrays = {key: getattr(stances, key) for key in LISTS if key not in unused}
        earlier = _lists(arrays, len(stances.pivot_dock), log)
    for i, name in enumerate(log.robot_id.tolist()):
        wxyz = log.orientation_wxyz[i]
        orientation = None if np.isnan(wxyz).all() else wxyz.tolist()
        entries: dict[str, object] = {"robot": name, "orientation_wxyz": orientation, **next(final)}
        for key in NUMBERS:
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
    if len(log.gone) or log.ground_form is not None:
        return sensing_format.EVENT_VERSION
    has_null = bool(np.isnan(log.orientation_wxyz).any())
    versions = [2 if has_null or log.source_name else 1]
    for name, key in LISTS.items():
        if log.stated(key.noise) is not None or _is_used(name, log):
            versions.append(key.version)
    return max(versions)


def _is_used(key: str, log: SensingLog) -> bool:
    """Whether any stance has items in a list."""
    return any(len(getattr(part, key)) for part in (log, log.earlier))


def _lists(
    arrays: dict[str, NDArray[Any]], count: int, log: SensingLog
) -> Iterator[dict[str, list[object]]]:
    """Yield the lists of each stance, from arrays whose first column names the stance, in order."""
    start = {}
    items = {}
    for key, rows in arrays.items():
        pairs = zip(LISTS[key].columns, rows.T[1:], strict=True)
        columns = [_column(kind, number, log) for kind, number in pairs]
        if not LISTS[key].is_whole:  # whole numbers may stand among them
            columns = [column.astype(object) for column in columns]
        items[key] = columns[0] if len(columns) == 1 else np.column_stack(columns)
        start[key] = np.searchsorted(rows[:, 0], np.arange(count + 1))
    for stance in range(count):
        places = {key: slice(*first[stance : stance + 2]) for key, first in start.items()}
        yield {key: _rows(key, items[key][place]) for key, place in places.items()}


def _rows(key: str, items: NDArray[Any]) -> list[Any]:
    """List the rows of one stance; where a source is null, it is left out."""
    rows: list[Any] = items.tolist()
    if LISTS[key].columns[-1] != "source":
        return rows
    return [row[:-1] if row[-1] is None else row for row in rows]


def _column(kind: Column, number: NDArray[Any], log: SensingLog) -> NDArray[Any]:
    """Write a column as the file has it: names of robots and sources, null for unknown docks."""
    if kind == "robot":
        return log.robot_id[number.astype(np.int64)]
    if kind == "source":  # -1, for none, is the last
        return np.array([*log.source_name, None], object)[number.astype(np.int64)]
    if kind == "dock or null":
        column = number.astype(object)
        column[number < 0] = None
        return column
    return number.astype(np.int64) if kind == "dock" else number
