"""Builds a sensing log robot by robot, and refuses what the robots before it rule out."""

import math
from array import array
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np

from tiswarm.base.errors import InputError
from tiswarm.records.messages import shown
from tiswarm.records.sensing_format import (
    MOST_CONTACTS,
    NEW_LISTS,
    REPEATABLE,
    ROBOT_NUMBERS,
    STANCE_LISTS,
    HeaderLine,
    RobotLine,
    StanceEntry,
)
from tiswarm.records.sensing_log import SensingLog, Stances

FAR_FROM_UNIT = 1e-3
"""Deviation of a unit vector's or quaternion's length from 1 above which it is refused."""

_CLOSE_TO_UNIT = 1e-9
"""Deviation below which neither is scaled to 1, so that our own ones keep their bits."""


class SensedStance(NamedTuple):
    """One checked stance, with indices in place of the names of other robots."""

    orientation_wxyz: list[float]
    lists: dict[str, list[tuple[Any, ...]]]  # sorted items of each list in `STANCE_LISTS`


class SensingLogBuilder:
    """Builds a log robot by robot; checks each against the robots before it."""

    def __init__(self, header: HeaderLine) -> None:
        """Start a log without robots."""
        self._header = header
        self._source_of = {name: row for row, name in enumerate(header.sources or {})}
        self._index_of: dict[int, int] = {}
        self._touching = array("B")  # final contacts of every dock, robot after robot
        self._final = _StanceColumns()
        self._earlier = _StanceColumns()
        self._numbers = {key: array("d") for key in ROBOT_NUMBERS}
        self._pivot_dock = array("i")
        self._stance_start = array("q", [0])
        self._has_stances = False

    def add(self, line: RobotLine) -> SensedStance:
        """Append a robot and return its final stance; a refused robot leaves no trace.

        An InputError names the key at fault, but neither file nor line.
        """
        if line.robot in self._index_of:
            problem = f"robot {line.robot} has a line already; give every robot its own number"
            raise InputError(problem, key="robot")
        robot, stances = line.robot, line.stances or []
        for key in ROBOT_NUMBERS:
            number, anchor = getattr(line, key), self._header.anchor_position
            self._header.refuse_far(key, number, anchor if np.ndim(number) else anchor[2])
        final = self._checked(line, "", robot)
        earlier = [self._checked(each, f"stances[{n}].", robot) for n, each in enumerate(stances)]
        self._count_contacts(robot, final)
        self._index_of[line.robot] = len(self._index_of)
        self._final.append(final)
        for stance in earlier:
            self._earlier.append(stance)
        for key, missing in ROBOT_NUMBERS.items():
            number = getattr(line, key)
            self._numbers[key].extend(np.ravel(missing if number is None else number))
        self._pivot_dock.extend(entry.pivot_dock for entry in stances)
        self._stance_start.append(len(self._pivot_dock))
        self._has_stances = self._has_stances or line.stances is not None
        return final

    def log(self) -> SensingLog:
        """Assemble the log; at least one robot must have been added."""
        final = self._final.arrays()
        final["contacts"] = np.ascontiguousarray(final["contacts"][:, [2, 3, 0, 1]])
        numbers: dict[str, Any] = {
            key: np.array(self._numbers[key]).reshape(-1, *np.shape(missing))
            for key, missing in ROBOT_NUMBERS.items()
        }
        stances = Stances(
            start=np.array(self._stance_start, dtype=np.int64),
            pivot_dock=np.array(self._pivot_dock, dtype=np.int32),
            **self._earlier.arrays(),
        )
        return SensingLog(
            robot_id=np.array(list(self._index_of), dtype=np.int64),
            dock_radius=self._header.dock_radius,
            dock_offset_body=np.array(self._header.dock_offsets, dtype=np.float64),
            anchor_position=np.array(self._header.anchor_position, dtype=np.float64),
            ground_z=self._header.ground_z,
            stances=stances if self._has_stances else None,
            noise=self._header.noise,
            length_unit=self._header.length_unit,
            **self._header.source_arrays(),
            **final,
            **numbers,
        )

    def _checked(self, entry: RobotLine | StanceEntry, prefix: str, robot: int) -> SensedStance:
        """Check one stance of the robot of this name."""
        if isinstance(entry, StanceEntry):
            self._check_dock(entry.pivot_dock, f"{prefix}pivot_dock")
        if entry.ground_docks and self._header.ground_z is None:
            problem = "there is no ground; give ground_z in the header or leave ground_docks empty"
            raise InputError(problem, key=f"{prefix}ground_docks")
        orientation = self._orientation(entry, f"{prefix}orientation_wxyz")
        check: dict[str, Callable[[Any, str], Any]] = {
            "dock": self._check_dock,
            "dock or null": lambda dock, key: -1 if dock is None else self._check_dock(dock, key),
            "robot": partial(self._robot_index, robot),
            "number": lambda number, _: number,
            "source": self._source_index,
        }
        lists: dict[str, list[tuple[Any, ...]]] = {}
        for name, kinds in STANCE_LISTS.items():
            if name in NEW_LISTS:
                self._header.refuse_new(f"{prefix}{name}", getattr(entry, name))
            items: list[tuple[Any, ...]] = []
            if not getattr(entry, name):  # as most are
                lists[name] = items
                continue
            first: dict[tuple[Any, ...], int] = {}
            for place, numbers in enumerate(getattr(entry, name)):
                here = f"{prefix}{name}[{place}]"
                # A source may be left out at the end.
                pairs = zip_longest(kinds, [numbers] if len(kinds) == 1 else numbers)
                item = tuple(check[kind](number, here) for kind, number in pairs)
                items.append(self._checked_item(name, item, here))
                before = first.setdefault(items[-1], place)
                if before != place and name not in REPEATABLE:
                    problem = f"repeats {prefix}{name}[{before}]; list it once"
                    raise InputError(problem, key=here)
            lists[name] = sorted(items)
        return SensedStance(orientation, lists)

    def _checked_item(self, name: str, item: tuple[Any, ...], key: str) -> tuple[Any, ...]:
        """Check the numbers of an item of one list beside each other; scale unit vectors."""
        if name == "fixes":
            self._check_fix(item, key)
        elif name == "ranges":
            self._check_range(item, key)
        elif name in {"directions", "connections"}:
            what = "direction" if name == "directions" else "quaternion"
            return (*item[:3], *_unit(item[3:], what, key))
        elif name == "touches" and -1 not in {item[0], item[2]}:
            raise InputError("both docks are known; list the contact in contacts", key=key)
        return item

    def _orientation(self, entry: RobotLine | StanceEntry, key: str) -> list[float]:
        """Check a stance's orientation; NaN for a robot without a compass."""
        if entry.orientation_wxyz is not None:
            return _unit(entry.orientation_wxyz, "quaternion", key)
        if self._header.version == 1:
            raise InputError("null needs version 2; give an orientation or that version", key=key)
        if not self._index_of:
            raise InputError("the anchor's orientation is null; give it", key=key)
        if isinstance(entry, RobotLine) and entry.stances:
            problem = "null leaves the stances without an end; give an orientation or no stances"
            raise InputError(problem, key=key)
        return [math.nan] * 4

    def _check_fix(self, fix: tuple[float, ...], key: str) -> None:
        *direction, value, sd, _ = fix
        _unit(direction, "direction", key)
        self._header.refuse_far(key, value, np.dot(direction, self._header.anchor_position))
        self._header.refuse_sd(key, sd)

    def _check_range(self, measured: tuple[float, ...], key: str) -> None:
        _, distance, sd, _ = measured
        self._header.refuse_far(key, distance, 0.0)
        if not distance > 0.0:
            raise InputError(f"the distance {distance:g} should be positive; correct it", key=key)
        self._header.refuse_sd(key, sd)

    def _count_contacts(self, robot: int, final: SensedStance) -> None:
        docks, mine = len(self._header.dock_offsets), len(self._index_of)
        touching = Counter[int]()
        for dock, other, its in final.lists["contacts"]:
            touching.update([docks * mine + dock, docks * other + its])
        for place, more in touching.items():
            before = self._touching[place] if place < len(self._touching) else 0
            if before + more > MOST_CONTACTS:
                name = [*self._index_of, robot][place // docks]
                problem = (
                    f"dock {place % docks} of robot {name} has more than {MOST_CONTACTS} contacts"
                )
                raise InputError(f"{problem}; delete false ones", key="contacts")
        self._touching.extend(bytes(docks))
        for place, more in touching.items():
            self._touching[place] += more

    def _robot_index(self, myself: int, name: int, key: str) -> int:
        if name == myself:
            problem = "the robot touches itself; name another robot or delete the contact"
            raise InputError(problem, key=key)
        if name not in self._index_of:
            problem = f"robot {name} is not on an earlier line; list a contact at the later robot"
            raise InputError(problem, key=key)
        return self._index_of[name]

    def _source_index(self, name: str | None, key: str) -> int:
        if name is not None and name not in self._source_of:
            problem = f"the header has no source {shown(name)}; add it to sources there"
            raise InputError(problem, key=key)
        return -1 if name is None else self._source_of[name]

    def _check_dock(self, dock: int, key: str) -> int:
        count = len(self._header.dock_offsets)
        if not 0 <= dock < count:
            problem = f"there is no dock {dock}; the header has docks 0 to {count - 1}"
            raise InputError(problem, key=key)
        return dock


class _StanceColumns:
    """Orientation and lists of many stances, in little memory."""

    def __init__(self) -> None:
        self._orientation = array("d")
        self._lists = {
            key: array("d" if "number" in kinds else "i") for key, kinds in STANCE_LISTS.items()
        }

    def append(self, stance: SensedStance) -> None:
        row = len(self._orientation) // 4
        self._orientation.extend(stance.orientation_wxyz)
        for key, items in stance.lists.items():
            for item in items:
                self._lists[key].extend((row, *item))

    def arrays(self) -> dict[str, Any]:
        lists = {
            key: np.array(self._lists[key]).reshape(-1, 1 + len(kinds))
            for key, kinds in STANCE_LISTS.items()
        }
        return {"orientation_wxyz": np.array(self._orientation).reshape(-1, 4), **lists}


def _unit(parts: Sequence[float], what: str, key: str) -> list[float]:
    length = math.hypot(*parts)
    if not abs(length - 1.0) <= FAR_FROM_UNIT:  # as for lengths that are NaN
        raise InputError(f"the {what} has length {length:.6g}; scale it to 1", key=key)
    scale = 1.0 if abs(length - 1.0) <= _CLOSE_TO_UNIT else length
    return [part / scale for part in parts]
