"""What a log says, cue by cue: each is a function that turns the log into rows.

To add a cue, write such a function and an entry of `CUES`; every method that takes cues uses it
then, unless its settings have a switch for it that is off. Lengths in R.
"""

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.measurements.model import (
    NO_COORDINATES,
    NO_OFFSETS,
    SPACING,
    Coordinates,
    Distances,
    Measurements,
    Offsets,
)
from tiswarm.measurements.odometry import CENTER, LINK_SD, UNKNOWN, Odometry, with_orientations
from tiswarm.records.sensing_log import LISTS, SensingLog

_UP = np.array([0.0, 0.0, 1.0])
_FLIPS_ASSUMED = 10
"""Flips that a height is taken to come from where the log has no stances."""


class Precision(NamedTuple):
    """How precise sensors are, beside the noise of orientations; standard deviations in R."""

    contact: float = 0.006
    """Deviation of the distance of two docks in contact from D."""

    height: float = 0.01
    """Deviation of heights and of the ground."""

    spawn: float = 0.2
    """Deviation of each coordinate of a spawn position whose log states none."""


WALKED = "walk_contacts"
"""Cue of earlier stances."""

_Rows = Distances | Offsets | Coordinates
_Producer = Callable[[SensingLog, Odometry, Precision], _Rows]


def _contacts(log: SensingLog, odometry: Odometry, precision: Precision) -> Distances:
    """Docks that touch at the end are D apart."""
    i, a, j, b = log.contacts.T
    final = odometry.final
    return Distances.of(final[j], b, final[i], a, length=SPACING, sd=precision.contact)


def _walk_contacts(log: SensingLog, odometry: Odometry, precision: Precision) -> Distances:
    """Docks that touched at an earlier stance were D apart; the flips since then are known."""
    stance, b, i, a = log.earlier.contacts.T
    at = odometry.row[stance]
    final = odometry.final
    return Distances.of(at, b, final[i], a, length=SPACING, sd=precision.contact)


def _ground(log: SensingLog, odometry: Odometry, precision: Precision) -> Coordinates:
    """A dock on flat ground is one dock radius above it."""
    robot, dock = log.ground_docks.T
    return _on_ground(log, odometry.final[robot], dock, precision)


def _walk_ground(log: SensingLog, odometry: Odometry, precision: Precision) -> Coordinates:
    """A dock that stood on flat ground at an earlier stance was one dock radius above it."""
    stance, dock = log.earlier.ground_docks.T
    return _on_ground(log, odometry.row[stance], dock, precision)


def _height(log: SensingLog, odometry: Odometry, precision: Precision) -> Coordinates:
    """A center is as high as its flips from the ground imply."""
    first = odometry.first
    variance = precision.height**2
    if log.stances is None:
        reach = np.linalg.norm(log.dock_offset_body, axis=1).max() / log.dock_radius
        variance += _FLIPS_ASSUMED * (2.0 * reach * odometry.tilt) ** 2
    value = log.flip_height / log.dock_radius + odometry.shift[first, 2]
    return Coordinates.of(first, np.full_like(first, CENTER), _UP, value, variance=variance)


def _odometry_from_spawn(log: SensingLog, odometry: Odometry, precision: Precision) -> Coordinates:
    """A robot that knows where it started went as far as its flips say."""
    stated = log.stated("spawn")
    sd = precision.spawn if stated is None else stated / log.dock_radius
    first = np.repeat(odometry.first, 3)
    return Coordinates.of(
        first,
        np.full_like(first, CENTER),
        np.tile(np.eye(3), (log.robot_count, 1)),
        (log.spawn_position / log.dock_radius).ravel(),
        variance=sd**2 + precision.height**2,
    )


def _plane(log: SensingLog, odometry: Odometry, precision: Precision) -> Coordinates:
    """The center of a planar robot is in the vertical plane y = const of the anchor."""
    plane = log.fixes[in_plane(log)]
    return _coordinates(replace(log, fixes=plane, stances=None), odometry, precision)


def _anchors(log: SensingLog, odometry: Odometry, precision: Precision) -> Coordinates:
    """The center of a further anchor is known."""
    anchor_fixes = log.fixes[log.is_of_anchor & ~in_plane(log)]
    return _coordinates(replace(log, fixes=anchor_fixes, stances=None), odometry, precision)


def _fixes(log: SensingLog, odometry: Odometry, precision: Precision) -> Coordinates:
    """A center was found along given directions, at the end or at an earlier stance."""
    robot_fixes = log.fixes[~(in_plane(log) | log.is_of_anchor)]
    return _coordinates(replace(log, fixes=robot_fixes), odometry, precision)


def in_plane(log: SensingLog) -> Bools:
    """Choose the fixes that make robots planar: along y, at the y of the anchor.

    Robots are planar up to the first one without such a fix. So cameras, which find robots at
    different y, make none planar, and a robot is planar or not before later ones join.

    Returns:
        Which fixes, shape (F,).
    """
    robot = log.fixes[:, 0].astype(np.int64)
    (x, y, z, value) = log.fixes[:, 1:5].T
    at_anchor = (x == 0.0) & (z == 0.0) & (value == y * log.anchor_position[1])
    has_one = np.isin(np.arange(log.robot_count), robot[at_anchor])
    chosen: Bools = at_anchor & np.logical_and.accumulate(has_one)[robot]
    return chosen


def _coordinates(log: SensingLog, odometry: Odometry, precision: Precision) -> Coordinates:  # noqa: ARG001
    """Coordinates of centers along the normals of all fixes of a log, of any length."""
    stance, rows = _of_all_stances("fixes", log, odometry)
    if not len(rows):
        return NO_COORDINATES
    length = np.linalg.norm(rows[:, :3], axis=1)
    value, sd = rows[:, 3:5].T / length / log.dock_radius
    return Coordinates.of(
        stance, np.full_like(stance, CENTER), rows[:, :3] / length[:, None], value,
        variance=sd**2, source=rows[:, 5].astype(np.int64),
    )  # fmt: skip


def _ranges(log: SensingLog, odometry: Odometry, precision: Precision) -> Distances:  # noqa: ARG001
    """Two centers were found to be that far apart, at the end or at an earlier stance."""
    stance, rows = _of_all_stances("ranges", log, odometry)
    partner_stance = odometry.final[rows[:, 0].astype(np.int64)]
    center = np.full_like(stance, CENTER)
    length, sd = rows[:, 1:3].T / log.dock_radius
    source = rows[:, 3].astype(np.int64)
    return Distances.of(stance, center, partner_stance, center, length=length, sd=sd, source=source)


def _directions(log: SensingLog, odometry: Odometry, precision: Precision) -> Offsets:
    """Docks that touched were D apart in a measured direction, at the end or earlier."""
    stance, rows = _of_all_stances("directions", log, odometry)
    if not len(rows):
        return NO_OFFSETS
    dock, partner, partner_dock = rows[:, :3].T.astype(np.int64)
    stated = log.stated(LISTS["directions"].noise)
    sd = LINK_SD if stated is None else math.radians(stated)
    unit = rows[:, 3:] / np.linalg.norm(rows[:, 3:], axis=1, keepdims=True)
    body_axes = dock_offsets(odometry.orientation_wxyz[stance], np.eye(3))
    vector = SPACING * (unit[:, None] @ body_axes)[:, 0]
    return Offsets.of(
        stance, dock, odometry.final[partner], partner_dock, vector,
        along_sd=precision.contact, across_sd=math.hypot(precision.contact, SPACING * sd),
    )  # fmt: skip


def _displacements(log: SensingLog, odometry: Odometry, precision: Precision) -> Offsets:  # noqa: ARG001
    """The vector between two centers was measured, at the end or at an earlier stance."""
    stance, rows = _of_all_stances("displacements", log, odometry)
    partner_stance = odometry.final[rows[:, 0].astype(np.int64)]
    center = np.full_like(stance, CENTER)
    body_axes = dock_offsets(odometry.orientation_wxyz[stance], np.eye(3))
    vector = (rows[:, None, 1:4] @ body_axes)[:, 0] / log.dock_radius
    sd = rows[:, 4] / log.dock_radius
    return Offsets.of(stance, center, partner_stance, center, vector, along_sd=sd, across_sd=sd)


def _touches(log: SensingLog, odometry: Odometry, precision: Precision) -> Distances:
    """Docks that are not known touched, at the end or at an earlier stance."""
    stance, rows = _of_all_stances("touches", log, odometry)
    stated_dock, partner, stated_partner_dock = rows.T.astype(np.int64)
    dock = np.where(stated_dock < 0, UNKNOWN, stated_dock)
    partner_dock = np.where(stated_partner_dock < 0, UNKNOWN, stated_partner_dock)
    final = odometry.final[partner]
    return Distances.of(stance, dock, final, partner_dock, length=SPACING, sd=precision.contact)


def _of_all_stances(key: str, log: SensingLog, odometry: Odometry) -> tuple[Ints, Reals]:
    """Take rows of final and earlier stances: the stance of each, and its other columns."""
    final: Reals = getattr(log, key)
    earlier = getattr(log.earlier, key)
    stance = [odometry.final[final[:, 0].astype(int)], odometry.row[earlier[:, 0].astype(int)]]
    return np.concatenate(stance), np.concatenate([final, earlier])[:, 1:]


def _on_ground(log: SensingLog, stance: Ints, dock: AnyInts, precision: Precision) -> Coordinates:
    """Docks on flat ground are R above it; none count where the height of the ground is unknown."""
    level = np.nan if log.ground_z is None else log.ground_z / log.dock_radius + 1.0
    value = np.full(len(stance), level)
    return Coordinates.of(stance, dock, _UP, value, variance=precision.height**2)


@dataclass(frozen=True, kw_only=True)
class Cue:
    """What a log says in one way: its rows, its switch in settings, its words."""

    name: str

    rows: _Producer | None = None
    """Function that turns a log into rows; None of a cue without rows."""

    walked: _Producer | None = None
    """Function for earlier stances, used beside the cue `walk_contacts`."""

    has_switch: bool = False
    """Whether settings have a switch for it, a field of `tiswarm.localization.settings.Cues`; a cue
    without one is always used."""

    words: str = ""
    """Words for pages; the name if empty."""

    said: int = 99
    """Place of the words among those of all cues."""

    key: str = ""
    """Key of the log."""

    item: str = ""
    """What a row is, of the robot's `dock`, its `neighbor` and `neighbor_dock`, or `along` an axis,
    `at` a coordinate."""

    names_docks: bool = True
    """Whether its rows name the docks that they are of, or need none; only methods that find docks
    can use others."""


CUES: list[Cue] = [
    Cue(
        name="contacts", rows=_contacts,
        key="contacts", item="contact [{dock}, {neighbor}, {neighbor_dock}]",
        has_switch=True,
        words="final contacts", said=0,
    ),
    Cue(
        name="non_overlap",
        has_switch=True,
        words="non-overlap", said=12,
    ),
    Cue(
        name="ground", rows=_ground, walked=_walk_ground,
        key="ground_docks", item="ground contact of dock {dock}",
        has_switch=True,
        words="ground contacts", said=8,
    ),
    Cue(
        name="height", rows=_height, key="flip_height", item="height",
        has_switch=True,
        words="heights", said=7,
    ),
    Cue(
        name=WALKED, rows=_walk_contacts,
        key="contacts", item="contact [{dock}, {neighbor}, {neighbor_dock}]",
        has_switch=True,
        words="walk contacts", said=1,
    ),
    Cue(
        name="odometry", rows=_odometry_from_spawn,
        key="spawn_position", item="spawn position along {along}",
        has_switch=True,
        words="odometry", said=11,
    ),
    Cue(
        name="plane", rows=_plane, key="fixes", item="fix along {along} at {at}",
        has_switch=True,
        words="the plane of motion", said=9,
    ),
    Cue(
        name="anchors", rows=_anchors, key="fixes", item="fix along {along} at {at}",
        words="further anchors", said=10,
    ),
    Cue(
        name="fixes", rows=_fixes, key="fixes", item="fix along {along} at {at}",
        has_switch=True,
        words="fixes", said=6,
    ),
    Cue(
        name="ranges", rows=_ranges, key="ranges", item="range to robot {neighbor}",
        has_switch=True,
        words="ranges", said=5,
    ),
    Cue(
        name="directions", rows=_directions,
        key="directions", item="direction of contact [{dock}, {neighbor}, {neighbor_dock}]",
        has_switch=True,
        words="directions of contacts", said=3,
    ),
    Cue(
        name="touches", rows=_touches, key="touches", item="touch of robot {neighbor}",
        has_switch=True,
        words="contacts of unknown docks", said=2,
        names_docks=False,
    ),
    Cue(
        name="displacements", rows=_displacements,
        key="displacements", item="displacement to robot {neighbor}",
        has_switch=True,
        words="displacements", said=4,
    ),
]  # fmt: skip
"""The table of cues. To add one, write its function and an entry here: analyses and pages follow.
One with a switch needs a field of `tiswarm.localization.settings.Cues`, too."""


def cue_names() -> tuple[str, ...]:
    """List the names of all cues with rows."""
    return tuple(cue.name for cue in CUES if cue.rows)


class Measured:
    """A log and its rows: lives as long as somebody works on the log.

    It resolves compasses, sums flips and turns each cue into rows once, for all sets of cues.
    """

    def __init__(
        self, log: SensingLog, odometry: Odometry | None = None, precision: Precision | None = None
    ) -> None:
        """Resolve the compasses and sum the flips.

        Args:
            log: What was sensed.
            odometry: Walks of the robots; those of the log if None.
            precision: Precision of the sensors; the usual one if None.
        """
        self.log = with_orientations(log)
        self.odometry = odometry or Odometry(self.log)
        self._precision = precision or Precision()
        self._tables: dict[_Producer, _Rows] = {}
        self._counts: dict[tuple[_Producer, ...], int] = {}
        # Rows of many sets at once would take too much memory in large swarms: only the last stay.
        self._last: tuple[tuple[_Producer, ...], Measurements] | None = None

    def rows(self, cues: Collection[str]) -> Measurements:
        """Return the rows of some cues; those that are not in `CUES` have none."""
        used = self._used(cues)
        if self._last is None or self._last[0] != used:
            self._last = used, self._gather(used)
        return self._last[1]

    def used(self, cues: Collection[str]) -> tuple[str, ...]:
        """List the cues with rows in the log, and those that need none."""
        used = self._used(cues)
        with_rows = {name for name, produce in self._produced(cues) if produce in used}
        names = cue_names()
        return (*(name for name in names if name in with_rows), *sorted(set(cues) - set(names)))

    def count(self, cues: Collection[str]) -> int:
        """Count the rows of some cues."""
        used = self._used(cues)
        if self._last is not None and self._last[0] == used:
            return len(self._last[1])
        if used not in self._counts:
            self._counts[used] = len(self._gather(used))
        return self._counts[used]

    def _used(self, cues: Collection[str]) -> tuple[_Producer, ...]:
        """List the producers of some cues that have rows."""
        used = [produce for _, produce in self._produced(cues)]
        return tuple(produce for produce in used if len(self._table(produce).stance))

    def _produced(self, cues: Collection[str]) -> Iterator[tuple[str, _Producer]]:
        """Yield some cues that were sensed, with the functions of their rows."""
        parts = [part for part in (self.log, self.log.stances) if part is not None]
        for cue in CUES:
            if cue.name not in cues:
                continue
            # Most logs have few of all keys.
            if cue.key and not any(len(getattr(part, cue.key, ())) for part in parts):
                continue
            if cue.rows:
                yield cue.name, cue.rows
            if cue.walked and WALKED in cues:
                yield cue.name, cue.walked

    def _table(self, produce: _Producer) -> _Rows:
        if produce not in self._tables:
            self._tables[produce] = produce(self.log, self.odometry, self._precision)
        return self._tables[produce]

    def _gather(self, used: Collection[_Producer]) -> Measurements:
        tables = [*map(self._table, used)]
        every = Measurements.gather(
            self.odometry,
            [table for table in tables if isinstance(table, Distances)],
            [table for table in tables if isinstance(table, Coordinates)],
            [table for table in tables if isinstance(table, Offsets)],
            shared_sd=self.log.source_sd / self.log.dock_radius,
        )
        return _once_each(every, self.log) if len(every) else every


def measure(
    log: SensingLog,
    cues: Collection[str],
    *,
    odometry: Odometry | None = None,
    precision: Precision | None = None,
) -> Measurements:
    """Turn a log into the rows of one set of cues; arguments as for `Measured`."""
    return Measured(log, odometry, precision).rows(cues)


def _once_each(rows: Measurements, log: SensingLog) -> Measurements:
    """Sort rows, and drop those that a dock which stays put repeats at its next stance.

    Where the direction of a contact was measured, its rows replace the distance. All ranges,
    displacements and fixes count, those of the same robots or along the same axis, too.
    """
    d = rows.distances
    p = rows.places
    walks = rows.odometry
    docks = len(log.dock_offset_body)
    robot, at, dock, partner, partner_dock = rows.sensed_contacts.T
    stance = walks.first[robot] + at
    # Contacts are numbered like the hours of a year, by (stance, dock, other robot, other dock). A
    # robot that flips from stance 7 to 8 about dock 1, which touches dock 0 of robot 5, lists
    # (7, 1, 5, 0) and (8, 1, 5, 0). The number of the first, one stance later, is that of the
    # second, which says the same: the first is dropped. CENTER and UNKNOWN count as docks.
    shape = (len(walks.owner), docks + 2, log.robot_count, docks + 2)
    number = np.ravel_multi_index((stance, dock - UNKNOWN, partner, partner_dock - UNKNOWN), shape)
    stays = rows.is_contact & (dock == walks.pivot[stance])
    following = np.where(stays, number + math.prod(shape[1:]), -1)
    of_distance, of_offset = np.split(number, [len(d.stance)])
    after_distance, after_offset = np.split(following, [len(d.stance)])
    has_direction = np.isin(of_distance, np.concatenate([of_offset, after_offset]))
    has_direction &= rows.is_contact[: len(d.stance)]
    order = np.argsort(of_distance, kind="stable")
    order = order[~(np.isin(after_distance, number) | has_direction)[order]]
    directed = np.argsort(of_offset, kind="stable")
    directed = directed[~np.isin(after_offset, of_offset)[directed]]
    # Docks on the ground are numbered in the same way, by (stance, dock).
    number = np.ravel_multi_index((p.stance, p.dock - CENTER), (len(walks.owner), docks + 1))
    stays = (p.dock != CENTER) & (p.dock == walks.pivot[p.stance])
    is_repeated = stays & np.isin(number + docks + 1, number)
    placed = np.lexsort((*p.direction.T, p.dock, p.stance))
    placed = placed[~is_repeated[placed]]
    return rows.ordered(order, directed, placed)
