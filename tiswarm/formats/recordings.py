"""Reads what robots recorded themselves: contacts, orientations and docks on the ground over time.

Three tables, on one clock for all robots:

    contacts       robot, dock, other, other_dock, time, closed
    orientations   robot, time, qw, qx, qy, qz
    ground         robot, dock, time, closed

A contact closes where `closed` is 1 and opens where it is 0; without that column it lasts to the
end. A robot rests from a contact that closes to the first that opens after it. In between it flips
about the dock that stays closed, which turns its orientation.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.compute.math import dock_offsets
from tiswarm.formats import columns
from tiswarm.formats.poses import (
    QUATERNION,
    Assumptions,
    first_names,
    unit_quaternions,
    with_earlier_first,
)
from tiswarm.records.io import CsvFile
from tiswarm.records.messages import counted
from tiswarm.records.sensing_log import SensingLog, Stances, canonical_contacts

_CONTACT = ("robot", "dock", "other", "other_dock")
_GROUND = -1
"""Partner of a dock that stands on the ground."""

_LEAST_TURN_DEG = 0.5
"""Turn from which on a robot flipped; in a smaller one a contact opened and closed again, or
another robot came and left."""

_STEPS_OF_NOISE = 5.0
"""Turn from which on a robot flipped, in standard deviations of the noise of its turn."""

_SD_PER_MEDIAN_ANGLE = 0.65
"""Standard deviation about each axis, per median angle of turns that are normal about all axes."""

_FEWEST = 3
"""Orientations of a rest from which on they state a scatter."""


class _Touch(NamedTuple):
    """A dock of a robot, and what it touches: a dock of another robot, or the ground."""

    dock: int
    partner: int
    partner_dock: int


class _Change(NamedTuple):
    """A contact that closes or opens at a time."""

    time: float
    closes: bool
    is_own: bool  # whether the row is that of the robot itself, not of the other one
    touch: _Touch


class _Rest(NamedTuple):
    """A robot at rest between two flips."""

    begin: float
    end: float
    touches: frozenset[_Touch]  # those that were closed at its end
    wxyz: Reals  # mean orientation, (4,)
    samples: int  # orientations in it
    scatter_deg: float  # of these about each axis; NaN of few


@dataclass
class _Robot:
    """What a robot recorded."""

    time: Reals  # of its orientations, (S,)
    wxyz: Reals  # (S, 4)
    changes: list[_Change] = field(default_factory=list)
    rests: list[_Rest] = field(default_factory=list)
    pivots: list[int] = field(default_factory=list)  # of the flips between its rests

    @property
    def arrival(self) -> tuple[float, bool]:
        """Time of its final rest, and whether one of its own rows closes a contact then.

        Of two robots whose contact closes, the one whose row it is came later.
        """
        begin = self.final.begin
        return begin, any(change.time == begin and change.is_own for change in self.changes)

    @property
    def final(self) -> _Rest:
        """The last rest."""
        return self.rests[-1]


def read_recording(path: Path, assumed: Assumptions) -> tuple[SensingLog, list[str]]:
    """Turn tables of contacts, orientations and ground into a log.

    Args:
        path: Table of contacts.
        assumed: `orientations` and maybe `ground` are the other tables; `dock_offset_body` the
            docks; `columns` the names of columns, in all three.

    Returns:
        The log, and what was done in lines.

    Raises:
        InputError: a table is malformed, names a robot without orientations or a dock that there
            is not, or the docks are not stated.
    """
    if assumed.dock_offset_body is None:
        problem = "contacts alone do not say where docks are; give --dock-offset, or --docks"
        raise InputError(problem)
    contacts = _table(path, [*_CONTACT], assumed.columns)
    ground = None
    if assumed.ground is not None:
        ground = _table(assumed.ground, ["robot", "dock"], assumed.columns)
    turns = _table(Path(str(assumed.orientations)), ["robot", "time", *QUATERNION], assumed.columns)
    names, notes = _names(contacts, turns, ground)
    first = _first_dock([contacts, *([ground] if ground else [])], assumed)
    robots = _robots(turns, names)
    _add_contacts(contacts, robots, names, first, len(assumed.dock_offset_body))
    if ground is not None:
        _add_ground(ground, robots, names, first, len(assumed.dock_offset_body))
    last = max(float(robot.time[-1]) for robot in robots.values())
    last = max([last, *(change.time for robot in robots.values() for change in robot.changes)])
    for number, robot in robots.items():
        _find_rests(number, robot, last, turns.path)
    cut = [number for number, robot in robots.items() if _cut_unexplained(robot)]
    order = _order(robots, assumed.anchors, path)
    log, passing = _log(robots, order, assumed)
    docks_note = f"docks are numbered from {first}"
    stances = 0 if log.stances is None else len(log.stances.pivot_dock)
    notes += [docks_note, f"{counted(stances, 'stance')} before the final poses, between flips"]
    if cut:
        why = "no dock alone stays closed while the robot turns"
        notes.append(f"earlier stances of {first_names(cut)} left out: {why}")
    if passing:
        notes.append(f"{counted(passing, 'contact')} of stances with robots in motion left out")
    return log, notes


class _Table(NamedTuple):
    """A table whose columns have a meaning."""

    file: CsvFile
    column: Mapping[str, str]  # by meaning

    @property
    def path(self) -> Path:
        """Its file."""
        return self.file.path

    def integers(self, meaning: str) -> Ints:
        """Whole numbers of a column, (rows,)."""
        return self.file.integers(self.column[meaning])

    def words(self, meaning: str) -> list[str]:
        """Words of a column."""
        return [str(word).strip() for word in self.file.words(self.column[meaning]).tolist()]


def _table(path: Path, needed: Sequence[str], named: Mapping[str, str]) -> _Table:
    """Read a table by the meaning of its columns: our names, or those that the user gives."""
    columns.refuse_other_files(path)
    file = CsvFile(path, columns.plain_sheet(path).text)
    column = {}
    for meaning in [*needed, "time", "closed"]:
        name = named.get(meaning, meaning)
        if name in file.columns:
            column[meaning] = name
        elif meaning in file.columns:
            column[meaning] = meaning
    lacking = [meaning for meaning in needed if meaning not in column]
    if lacking:
        asked = ",".join(f"{meaning}=NAME" for meaning in lacking)
        problem = f"the columns are {','.join(file.columns)[:200]}, not {','.join(needed)}; name "
        raise InputError(f"{problem}them as by --column {asked}", path=path, line=1)
    return _Table(file, column)


def _names(
    contacts: _Table, turns: _Table, ground: _Table | None
) -> tuple[dict[str, int], list[str]]:
    """Number the robots by the names in all tables; returns the numbers, and a note."""
    listed = [*turns.words("robot"), *contacts.words("robot"), *contacts.words("other")]
    if ground is not None:
        listed += ground.words("robot")
    names = [*dict.fromkeys(listed)]
    numbers, notes = columns.robot_numbers(names)
    return dict(zip(names, numbers, strict=True)), notes


def _first_dock(tables: Sequence[_Table], assumed: Assumptions) -> int:
    """Return the number of the first dock: 0 or 1, which the numbers show, or the user states."""
    if assumed.first_dock is not None:
        return assumed.first_dock
    count = 0 if assumed.dock_offset_body is None else len(assumed.dock_offset_body)
    meanings = ("dock", "other_dock")
    docks = {
        int(dock)
        for table in tables
        for meaning in meanings
        if meaning in table.column
        for dock in table.integers(meaning)
    }
    if 0 in docks:
        return 0
    if count in docks:
        return 1
    problem = f"docks {first_names(sorted(docks))} of {count} may count from 0 or from 1; give "
    raise InputError(f"{problem}--first-dock 0 or 1", path=tables[0].path)


def _robots(turns: _Table, names: Mapping[str, int]) -> dict[int, _Robot]:
    """Read the orientations of each robot, by time."""
    number = np.array([names[name] for name in turns.words("robot")])
    time = columns.times_of(turns.file, turns.column["time"])
    numbers = {name: turns.file.numbers(turns.column[name]) for name in QUATERNION}
    rows_of_file = pd.DataFrame({**numbers, "line": [*turns.file.rows]})
    wxyz = unit_quaternions(rows_of_file, turns.path)
    robots = {}
    for robot in names.values():
        rows = np.flatnonzero(number == robot)
        if not len(rows):
            name = next(name for name in names if names[name] == robot)
            problem = f"there is no orientation of {name}; add a row, or delete its contacts"
            raise InputError(problem, path=turns.path)
        rows = rows[np.argsort(time[rows], kind="stable")]
        robots[robot] = _Robot(time[rows], wxyz[rows])
    return robots


def _changes(table: _Table, robots: Mapping[int, _Robot]) -> Iterator[tuple[int, float, bool]]:
    """Yield the row, time and sense of each change; without times contacts close at the start."""
    start = min(float(robot.time[0]) for robot in robots.values())
    count = len(table.file.rows)
    has_time = "time" in table.column
    time = columns.times_of(table.file, table.column["time"]) if has_time else np.full(count, start)
    has_closed = "closed" in table.column
    closed = table.integers("closed") if has_closed else np.ones(count, np.int64)
    if has_closed:
        wrong = np.flatnonzero((closed != 0) & (closed != 1))
        if len(wrong):
            problem = f"{closed[wrong[0]]} is neither 0, open, nor 1, closed; correct it"
            line = table.file.line(int(wrong[0]))
            raise InputError(problem, path=table.path, line=line, key=table.column["closed"])
    for row in range(count):
        yield row, float(time[row]), bool(closed[row])


def _dock(table: _Table, meaning: str, first: int, count: int) -> Ints:
    """Read the docks of a column, from 0."""
    dock = table.integers(meaning) - first
    wrong = np.flatnonzero((dock < 0) | (dock >= count))
    if len(wrong):
        problem = f"docks count from {first} to {first + count - 1}; correct it, or --first-dock"
        line = table.file.line(int(wrong[0]))
        raise InputError(problem, path=table.path, line=line, key=table.column[meaning])
    return dock


def _add_contacts(
    table: _Table, robots: Mapping[int, _Robot], names: Mapping[str, int], first: int, count: int
) -> None:
    """Add the changes of contacts to both of their robots."""
    dock = _dock(table, "dock", first, count).tolist()
    partner_dock = _dock(table, "other_dock", first, count).tolist()
    robot = [names[name] for name in table.words("robot")]
    partner = [names[name] for name in table.words("other")]
    for row, time, closes in _changes(table, robots):
        if robot[row] == partner[row]:
            problem = "a robot cannot touch itself; name another robot"
            line = table.file.line(row)
            raise InputError(problem, path=table.path, line=line, key=table.column["other"])
        ends = (robot[row], dock[row]), (partner[row], partner_dock[row])
        for is_own, ((number, own_dock), touched) in ((True, ends), (False, ends[::-1])):
            change = _Change(time, closes, is_own, _Touch(own_dock, *touched))
            robots[number].changes.append(change)


def _add_ground(
    table: _Table, robots: Mapping[int, _Robot], names: Mapping[str, int], first: int, count: int
) -> None:
    """Add the changes of docks on the ground."""
    dock = _dock(table, "dock", first, count).tolist()
    robot = [names[name] for name in table.words("robot")]
    for row, time, closes in _changes(table, robots):
        robots[robot[row]].changes.append(
            _Change(time, closes, is_own=False, touch=_Touch(dock[row], _GROUND, 0))
        )


def _find_rests(number: int, robot: _Robot, last: float, path: Path) -> None:
    """Find the rests of a robot, and the docks about which it flips between them.

    A rest is the time from a closing to the first opening after it. Rests between which the robot
    does not turn are one: others came and left.
    """
    robot.changes.sort(key=lambda change: (change.time, not change.closes))
    begin = robot.changes[0].time if robot.changes else float(robot.time[0])
    closed: set[_Touch] = set()
    spans: list[tuple[float, float, frozenset[_Touch]]] = []
    staying: list[frozenset[int]] = []
    stays: set[int] = set()
    is_resting = True
    for change in robot.changes:
        if change.closes:
            if not is_resting:
                begin = change.time
                staying.append(frozenset(stays))
            is_resting = True
            closed.add(change.touch)
            continue
        if change.touch not in closed:
            continue
        if is_resting:
            spans.append((begin, change.time, frozenset(closed)))
            stays = {touch.dock for touch in closed}
        is_resting = False
        closed.discard(change.touch)
        stays &= {touch.dock for touch in closed}
    if not is_resting:
        begin, end, _ = spans.pop()
        before = _rest(robot, begin, end, frozenset(closed))
        after = before._replace(wxyz=robot.wxyz[-1], samples=1)
        if _turns(before, after):
            problem = f"robot {number} is in motion at the end; record until a contact closes"
            raise InputError(problem, path=path)
    spans.append((begin, last, frozenset(closed)))
    rests = [_rest(robot, *span) for span in spans]
    robot.rests = [rests[0]]
    for rest, docks in zip(rests[1:], staying, strict=True):
        before = robot.rests[-1]
        if _turns(before, rest):
            robot.rests.append(rest)
            robot.pivots.append(next(iter(docks)) if len(docks) == 1 else -1)
        else:
            robot.rests[-1] = rest._replace(begin=before.begin)


def _rest(robot: _Robot, begin: float, end: float, touches: frozenset[_Touch]) -> _Rest:
    """Average the orientations in a span of time, or take the nearest where there is none."""
    rows = np.flatnonzero((robot.time >= begin) & (robot.time <= end))
    if not len(rows):
        middle = 0.5 * (begin + end)
        rows = np.array([int(np.argmin(np.abs(robot.time - middle)))])
    turns = Rotation.from_quat(robot.wxyz[rows], scalar_first=True)
    mean = turns.mean()
    scatter = np.nan
    if len(rows) >= _FEWEST:
        angle = np.rad2deg((mean.inv() * turns).magnitude())
        scatter = _SD_PER_MEDIAN_ANGLE * float(np.median(angle))
    wxyz = mean.as_quat(scalar_first=True, canonical=True)
    return _Rest(begin, end, touches, wxyz, len(rows), scatter)


def _turns(before: _Rest, after: _Rest) -> bool:
    """Whether a robot turned by more than the noise between two rests."""
    turn = Rotation.from_quat([before.wxyz, after.wxyz], scalar_first=True)
    angle = np.rad2deg(float((turn[0].inv() * turn[1]).magnitude()))
    noise = np.nanmax([before.scatter_deg, after.scatter_deg, 0.0])
    noise *= np.sqrt(1.0 / before.samples + 1.0 / after.samples)
    return bool(angle >= max(_LEAST_TURN_DEG, _STEPS_OF_NOISE * noise))


def _cut_unexplained(robot: _Robot) -> bool:
    """Leave out the rests before the last flip of an unknown pivot; returns if there is one."""
    unknown = [flip for flip, pivot in enumerate(robot.pivots) if pivot < 0]
    if not unknown:
        return False
    robot.rests = robot.rests[unknown[-1] + 1 :]
    robot.pivots = robot.pivots[unknown[-1] + 1 :]
    return True


def _order(robots: Mapping[int, _Robot], anchors: Sequence[int], path: Path) -> list[int]:
    """Sort robots by the begin of their final rests, the anchor first."""
    for name in anchors:
        if name not in robots:
            problem = f"there is no robot {name}; name one of the tables"
            raise InputError(problem, path=path, argument="anchor")
    if len(anchors) > 1:
        problem = "places of further anchors are not in these tables; name one robot"
        raise InputError(problem, path=path, argument="anchor")
    by_time = sorted(robots, key=lambda number: (*robots[number].arrival, number))
    first = anchors[0] if anchors else by_time[0]
    return [first, *(number for number in by_time if number != first)]


def _log(
    robots: Mapping[int, _Robot], order: Sequence[int], assumed: Assumptions
) -> tuple[SensingLog, int]:
    """Gather what robots sensed at rest; returns the log, and the contacts left out."""
    row_of = {number: row for row, number in enumerate(order)}
    finals = [robots[number].final for number in order]
    orientation = np.array([rest.wxyz for rest in finals])
    contacts = [
        (row, touch.dock, row_of[touch.partner], touch.partner_dock)
        for row, rest in enumerate(finals)
        for touch in rest.touches
        if touch.partner != _GROUND
    ]
    standing = sorted(
        (row, touch.dock)
        for row, rest in enumerate(finals)
        for touch in rest.touches
        if touch.partner == _GROUND
    )
    pairs = with_earlier_first(np.array(contacts, np.int32).reshape(-1, 4))
    stances, passing = _stances(robots, order)
    body = assumed.dock_offset_body
    if body is None:
        raise AssertionError  # read_recording refuses it
    log = SensingLog(
        robot_id=np.array(order, np.int64),
        dock_radius=assumed.dock_radius,
        dock_offset_body=body,
        anchor_position=_anchor_position(orientation[0], standing, assumed, body),
        orientation_wxyz=orientation,
        contacts=canonical_contacts(np.unique(pairs, axis=0)),
        ground_z=_ground_z(assumed),
        ground_docks=np.array(standing, np.int32).reshape(-1, 2),
        flip_height=np.full(len(order), np.nan),
        spawn_position=np.full((len(order), 3), np.nan),
        stances=stances,
        noise=None,
        length_unit=assumed.length_unit,
    )
    return log, passing


def _ground_z(assumed: Assumptions) -> float | None:
    """Height of the ground: 0 where a table has docks on it, and nothing else is stated."""
    if assumed.ground_z is None and assumed.ground is not None:
        return 0.0
    return assumed.ground_z


def _anchor_position(
    wxyz: Reals, standing: Sequence[tuple[int, int]], assumed: Assumptions, body: Reals
) -> Reals:
    """Center of the anchor, above the origin, at the height that its docks on the ground imply."""
    ground_z = _ground_z(assumed)
    docks = [dock for row, dock in standing if row == 0]
    if ground_z is None or not docks:
        return np.zeros(3)
    height = dock_offsets(wxyz[None], body)[0, docks, 2]
    return np.array([0.0, 0.0, ground_z + assumed.dock_radius - float(height.mean())])


def _stances(robots: Mapping[int, _Robot], order: Sequence[int]) -> tuple[Stances | None, int]:
    """Gather the rests before the final ones; returns them, and the number of contacts left out.

    Contacts are with robots that had reached their final rests, not with those in motion.
    """
    row_of = {number: row for row, number in enumerate(order)}
    start = np.cumsum([0, *(len(robots[number].pivots) for number in order)])
    rests = [rest for number in order for rest in robots[number].rests[:-1]]
    if not rests:
        return None, 0
    owner = [row for row, number in enumerate(order) for _ in robots[number].pivots]
    contacts = []
    standing = []
    passing = 0
    for stance, rest in enumerate(rests):
        for touch in rest.touches:
            if touch.partner == _GROUND:
                standing.append((stance, touch.dock))
            elif (
                robots[touch.partner].final.begin <= rest.end
                and row_of[touch.partner] < owner[stance]
            ):
                contacts.append((stance, touch.dock, row_of[touch.partner], touch.partner_dock))
            else:
                passing += 1
    stances = Stances(
        start=start,
        orientation_wxyz=np.array([rest.wxyz for rest in rests]),
        pivot_dock=np.array([p for number in order for p in robots[number].pivots], np.int32),
        contacts=np.unique(np.array(contacts, np.int32).reshape(-1, 4), axis=0),
        ground_docks=np.array(sorted(standing), np.int32).reshape(-1, 2),
    )
    return stances, passing
