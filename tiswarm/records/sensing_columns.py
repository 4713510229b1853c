"""What a sensing file says, checked line by line and gathered into growing columns."""

import math
from array import array
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tiswarm.errors import InputError
from tiswarm.records.sensing_line import HeaderLine, RobotLine, StanceEntry
from tiswarm.records.sensing_log import SensingLog, SensingNoise, Stances

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
