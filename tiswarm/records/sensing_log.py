"""The sensing log: what a swarm sensed while it grew, and all that a localizer reads."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from inspect import cleandoc
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.params import STRICT
from tiswarm.records.messages import counted

FARTHEST = 1e10
"""Lengths in a log are smaller [dock radii]; float64 resolves 1e-6 dock radii there."""

KNOWN_SD = 1e-3
"""Standard deviation of the three fixes that state the position of a further anchor [dock radii];
robots with fixes no less precise are anchors."""

_ROUNDING = 1e-9


def _not_tiny(angle: float) -> float:
    if 0.0 < angle < 1e-9:  # noqa: PLR2004 - its inverse square is a number of float32
        raise ValueError(f"{angle:g} should be 0 or at least 1e-9; correct it")
    return angle


Angle = Annotated[float, Field(ge=0.0, le=180.0), AfterValidator(_not_tiny)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


@pydantic.dataclasses.dataclass(frozen=True, kw_only=True, config=STRICT)
class SensingNoise:
    """Noise of the senses as the log states it; None where the log does not state it.

    The orientation noise of each stance is drawn anew, except for the bias.
    """

    tilt_deg: Angle
    """Standard deviation about a horizontal axis [deg]."""

    yaw_deg: Angle
    """Standard deviation about the vertical [deg]."""

    yaw_bias_deg: Angle | None = None
    """Standard deviation about the vertical that a robot keeps at all its stances [deg]."""

    spawn: Annotated[float, Field(ge=0.0)] | None = None
    """Standard deviation of each coordinate of a spawn position [log unit]."""

    missed_contacts: Fraction | None = None
    """Fraction of contacts that are not sensed [1]."""

    wrong_docks: Fraction | None = None
    """Fraction of contacts that name the wrong dock of the other robot [1]."""

    false_contacts: Fraction | None = None
    """Sensed contacts that do not exist, per true contact [1]."""

    direction_deg: Angle | None = None
    """Standard deviation of a contact's direction about each axis perpendicular to it [deg]."""

    connection_deg: Angle | None = None
    """Standard deviation of the orientation of a robot in contact, about each axis [deg]."""


Column = Literal[
    "dock",
    "dock or null",
    "robot",
    "source",
    "normal",
    "value",
    "distance",
    "vector",
    "direction",
    "quaternion",
    "sd",
    "height",
    "coordinate",
]
"""What a number of an item is. Checks, units and moves of the anchor follow from it. Heights and
coordinates are numbers of a robot, not of an item in a list."""

WHOLE = ("dock", "dock or null", "robot")
_OF_BODY = ("dock", "dock or null", "vector")


@dataclass(frozen=True)
class Key:
    """A key of a robot's line, in files and in logs; those of a list hold for each stance."""

    columns: tuple[Column, ...]
    """Numbers of an item. A robot is on an earlier line; a source may be left out."""

    meaning: str
    """Description in the JSON Schema."""

    version: int = 1
    """First version of the format that has the key."""

    repeats: bool = False
    """Whether items may be equal: a device may measure twice, and get the same number."""

    noise: str = ""
    """Key of the header's noise that states the standard deviation."""

    @cached_property
    def is_whole(self) -> bool:
        """Whether all numbers are whole."""
        return all(column in WHOLE for column in self.columns)

    @cached_property
    def robot(self) -> int | None:
        """Column of the other robot; None where an item names none."""
        return self.columns.index("robot") if "robot" in self.columns else None

    @property
    def is_of_docks(self) -> bool:
        """Whether an item starts with docks that touch: own dock, other robot, other dock."""
        return self.columns[1:2] == ("robot",)

    @property
    def is_of_body(self) -> bool:
        """Whether an item means nothing without the orientation of its robot."""
        return any(column in _OF_BODY for column in self.columns)

    def part(self, rows: NDArray[Any], *kinds: Column) -> Reals:
        """Select the columns of some kinds from an array of a log, shape (n, columns of them)."""
        numbers = rows if rows.ndim > 1 else rows[:, None]
        start = numbers.shape[1] - len(self.columns)
        return numbers[:, [start + k for k, column in enumerate(self.columns) if column in kinds]]

    def rows(self, items: Sequence[Sequence[float]] = ()) -> NDArray[Any]:
        """Make rows of a log from items after the number of a stance, shape (n, 1 + columns)."""
        kind = np.int32 if self.is_whole else np.float64
        return np.array(items, kind).reshape(-1, 1 + len(self.columns))

    def numbers(self, values: Sequence[float | Sequence[float] | None]) -> Reals:
        """Gather numbers of robots, NaN for None, shape (n,), or (n, columns) of several."""
        count = len(self.columns)
        missing = math.nan if count == 1 else [math.nan] * count
        return np.array([missing if value is None else value for value in values], np.float64)


def _listed(*columns: Any, meaning: str, **settings: Any) -> Any:  # noqa: ANN401 - a field
    """Declare an array of a log with its key."""
    key = Key(columns, cleandoc(meaning), **settings)
    return field(default_factory=key.rows, metadata={"key": key})


def _of_robot(*columns: Any, meaning: str) -> dict[str, Key]:  # noqa: ANN401 - of Column
    """Describe optional numbers of a robot."""
    return {"key": Key(columns, meaning)}


@dataclass(frozen=True, kw_only=True)
class Sensed:
    """What was sensed at stances: an array for each key, a row for each item.

    Rows start with the robot in `SensingLog`, which has the final stances, and with the stance in
    `Stances`. Robots, docks and sources are numbers; a dock or source that is not known is -1.
    """

    contacts: NDArray[np.int32] = _listed(
        "dock",
        "robot",
        "dock",
        meaning="""
    Rows of [own dock, other robot, other dock]; the other robot is on an earlier line.
    """,
    )
    """Sensed contacts, rows of (stance, own dock, other robot, other dock), shape (C, 4)."""

    ground_docks: NDArray[np.int32] = _listed("dock", meaning="Docks on flat ground.")
    """Docks on flat ground, rows of (robot or stance, dock), shape (G, 2)."""

    fixes: Reals = _listed(
        *["normal"] * 3,
        "value",
        "sd",
        "source",
        version=2,
        repeats=True,
        meaning="""
    Measured coordinates of the center, rows of [x, y, z, value, sd] or [x, y, z, value, sd,
    source]: along the unit vector (x, y, z) the center is at the value [length unit]. The sd is
    without the error that measurements of the source share. Version 2.
    """,
    )
    """Measured coordinates of centers, rows of (robot or stance, direction (3), value, standard
    deviation, source), shape (F, 7). The source is a row of `source_name`, or -1 for none; the
    standard deviation is without the error that its measurements share."""

    ranges: Reals = _listed(
        "robot",
        "distance",
        "sd",
        "source",
        version=2,
        repeats=True,
        meaning="""
    Measured distances of centers, rows of [other robot, distance, sd] or [other robot, distance,
    sd, source] [length unit]; the other robot is on an earlier line. Version 2.
    """,
    )
    """Measured distances from the center to the final center of an earlier robot, rows of (robot
    or stance, other robot, distance, standard deviation, source), shape (D, 5). Source and standard
    deviation are as in `fixes`."""

    directions: Reals = _listed(
        "dock",
        "robot",
        "dock",
        *["direction"] * 3,
        version=2,
        noise="direction_deg",
        meaning="""
    Measured directions of contacts, rows of [own dock, other robot, other dock, x, y, z]: the
    unit vector in the own body frame from the center of the own dock to that of the other, whose
    robot is on an earlier line. Version 2.
    """,
    )
    """Measured directions of contacts, rows of (robot or stance, dock, earlier robot, its dock,
    unit vector from dock to dock in the robot's body frame (3)), shape (U, 7)."""

    connections: Reals = _listed(
        "dock",
        "robot",
        "dock",
        *["quaternion"] * 4,
        version=2,
        noise="connection_deg",
        meaning="""
    Measured orientations of robots in contact, rows of [own dock, other robot, other dock, w, x,
    y, z]: a unit quaternion from the body of the other robot, which is on an earlier line, to the
    own body. Version 2.
    """,
    )
    """Measured relative orientations, rows of (robot or stance, dock, earlier robot, its dock, unit
    quaternion from the earlier robot's body to the robot's (4)), shape (Q, 8)."""

    touches: NDArray[np.int32] = _listed(
        "dock or null",
        "robot",
        "dock or null",
        version=2,
        meaning="""
    Contacts of unknown docks, rows of [own dock or null, other robot, other dock or null], at
    least one of them null; the other robot is on an earlier line. Version 2.
    """,
    )
    """Contacts of unknown docks, rows of (robot or stance, dock or -1, earlier robot, its dock or
    -1), shape (H, 4)."""

    displacements: Reals = _listed(
        "robot",
        *["vector"] * 3,
        "sd",
        version=2,
        repeats=True,
        meaning="""
    Measured vectors between centers, rows of [other robot, x, y, z, sd] [length unit]: from the
    own center to that of the other robot, which is on an earlier line, in the own body frame. The
    sd holds along each axis, beside the noise of the own orientation. Version 2.
    """,
    )
    """Measured vectors from the center to the final center of an earlier robot, rows of (robot or
    stance, other robot, vector in the robot's body frame (3), standard deviation along each axis),
    shape (V, 6). The standard deviation is without the noise of the robot's orientation."""


@dataclass(frozen=True, kw_only=True)
class Stances(Sensed):
    """The M stances of all robots before their final ones, by robot and then by time.

    The stances of robot i are rows `start[i]` to `start[i + 1]`.
    """

    start: Ints
    """First stance of each robot, shape (N + 1,)."""

    orientation_wxyz: Reals
    """Sensed orientation, body to world, unit quaternion, shape (M, 4)."""

    pivot_dock: NDArray[np.int32]
    """Dock that stays put while the robot flips out of the stance, shape (M,)."""


@dataclass(frozen=True, kw_only=True, repr=False)
class SensingLog(Sensed):
    """Everything a swarm of N robots sensed.

    Robots are numbered 0 to N - 1 in join order; robot 0 is the anchor. The log holds no true
    position except the anchor's. Rows of lists, here and in `stances`, are sorted, so two logs with
    equal content have equal arrays. They are unique, but where their key repeats.
    """

    robot_id: Ints
    """Name of each robot in its file: distinct integers, shape (N,)."""

    dock_radius: float
    """Radius of a dock sphere, in the log's own unit (R when it is 1)."""

    dock_offset_body: Reals
    """Center to dock in the body frame, shape (docks, 3)."""

    anchor_position: Reals
    """Known center of robot 0, shape (3,)."""

    orientation_wxyz: Reals
    """Sensed final orientation, body to world, unit quaternion, shape (N, 4). NaN for a robot
    without a compass; the anchor has one."""

    orientation_sd: Reals | None = None
    """Standard deviations about a horizontal axis and about the vertical [rad], shape (N, 2), of
    final orientations that were chained by connections; NaN where they were sensed, None where all
    were. No file has them."""

    contacts: NDArray[np.int32]
    """Docked pairs, rows of (robot i, dock of i, robot j, dock of j), i < j, shape (C, 4).

    Sorted by (j, dock of j, i, dock of i): the later robot j sensed them when it joined.
    """

    ground_z: float | None = None
    """Height of the flat ground; None without flat ground."""

    ground_form: Literal["uneven"] | None = None
    """Form of ground that is no plane, so that no dock on it has a known height; None for flat
    ground, and without ground."""

    flip_height: Reals = field(
        metadata=_of_robot(
            "height", meaning="Height of the center that the flips imply [length unit]."
        )
    )
    """Height of the center inferred from the flip history; NaN where missing, shape (N,)."""

    spawn_position: Reals = field(
        metadata=_of_robot(*["coordinate"] * 3, meaning="Center at the first stance [length unit].")
    )
    """Sensed center at the first stance; NaN where missing, shape (N, 3)."""

    stances: Stances | None = None
    """Flip history; None where the log has none."""

    noise: SensingNoise | None = None
    """Noise of the senses as the log states it; None where it states none."""

    source_name: tuple[str, ...] = ()
    """Name of each source of fixes and ranges, such as a plane of a lighthouse; distinct."""

    source_sd: Reals = field(default_factory=lambda: np.empty(0))
    """Standard deviation of the error that all measurements of a source share [log unit], shape
    (sources,)."""

    gone: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    """Robots that have left, ascending, shape (G,). What they sensed and what others sensed of them
    stays, and is about where they last stood; later robots may stand there, too."""

    left_after: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    """Robots that had joined when each of them left, shape (G,)."""

    line: Ints | None = None
    """Line of each robot in its file, shape (N,); None where they are as tiswarm writes them."""

    length_unit: str = "R"
    """Name of the log's unit of length."""

    def __repr__(self) -> str:
        """Describe the log in a line."""
        return f"SensingLog({self.size}, lengths in {self.length_unit})"

    @property
    def earlier(self) -> Stances:
        """Stances before the final ones; none where the log has no flip history."""
        return self.stances or Stances(
            start=np.zeros(self.robot_count + 1, np.int64),
            orientation_wxyz=np.empty((0, 4)),
            pivot_dock=np.empty(0, np.int32),
        )

    def stated(self, noise: str) -> float | None:
        """Return a number of `noise`; None where the log states none."""
        number: float | None = getattr(self.noise, noise, None)
        return number

    @property
    def robot_count(self) -> int:
        """N."""
        return len(self.robot_id)

    @property
    def is_of_anchor(self) -> Bools:
        """Whether each fix is of a further anchor, shape (F,).

        Its robot has fixes no less precise than `KNOWN_SD`, of no source, in all directions.
        """
        robot = self.fixes[:, 0].astype(np.int64)
        normal = self.fixes[:, 1:4]
        is_precise = self.fixes[:, 5] <= KNOWN_SD * self.dock_radius * (1.0 + _ROUNDING)
        is_precise &= self.fixes[:, 6] < 0.0
        span = np.zeros((self.robot_count, 3, 3))
        np.add.at(span, robot, (normal[:, :, None] * normal[:, None]) * is_precise[:, None, None])
        is_known: Bools = np.linalg.eigvalsh(span)[:, 0] > _ROUNDING
        return is_precise & is_known[robot]

    @property
    def fixed_position(self) -> Reals:
        """Centers of further anchors, NaN for all other robots [log unit], shape (N, 3)."""
        position = np.full((self.robot_count, 3), np.nan)
        fixes = self.fixes[self.is_of_anchor]
        for robot in np.unique(fixes[:, 0]).astype(np.int64).tolist():
            fixes_of_robot = fixes[fixes[:, 0] == robot]
            position[robot] = np.linalg.lstsq(fixes_of_robot[:, 1:4], fixes_of_robot[:, 4])[0]
        return position

    @property
    def known_position(self) -> Reals:
        """Centers of all anchors, NaN for all other robots [log unit], shape (N, 3)."""
        position = self.fixed_position
        position[0] = self.anchor_position
        return position

    @property
    def is_gone(self) -> Bools:
        """Whether each robot has left, shape (N,)."""
        return np.isin(np.arange(self.robot_count), self.gone)

    def line_of(self, robot: int) -> int:
        """Return the number of a robot's line in its file, the header being 1."""
        if self.line is not None:
            return int(self.line[robot])
        departures = np.count_nonzero(self.left_after <= robot)
        return 2 + robot + departures

    @property
    def size(self) -> str:
        """Numbers of robots, contacts and stances, in words."""
        stances = len(self.earlier.pivot_dock)
        sizes = {"robot": self.robot_count, "contact": len(self.contacts), "stance": stances}
        return ", ".join(counted(number, noun) for noun, number in sizes.items())

    @property
    def spacing(self) -> float:
        """D: distance between the centers of two docks that touch."""
        return 2.0 * self.dock_radius

    @property
    def yaw_bias(self) -> float:
        """Standard deviation of the robots' biases of yaw [rad]; 0 where the log states none."""
        return math.radians(self.stated("yaw_bias_deg") or 0.0)


LISTS: dict[str, Key] = {array.name: array.metadata["key"] for array in fields(Sensed)}
"""Keys of every stance, in the order in which they are written."""

NUMBERS: dict[str, Key] = {
    array.name: array.metadata["key"]
    for array in fields(SensingLog)
    if "key" in array.metadata and array.name not in LISTS
}
"""Keys of a robot with optional numbers, NaN in the log where a line has none."""

KEYS = LISTS | NUMBERS
"""The table of keys. To add one, declare its field in `Sensed` or `SensingLog`: readers, writers,
checks, schema and builder follow."""


def moved(log: SensingLog, by: Reals) -> SensingLog:
    """Move all positions of a log by a vector, shape (3,)."""

    def numbers(part: Sensed, keys: Mapping[str, Key]) -> dict[str, Any]:
        changed: dict[str, Any] = {}
        for name, key in keys.items():
            rows = getattr(part, name)
            if "value" in key.columns:
                start = 1 + key.columns.index("normal")
                changed[name] = rows.copy()
                value = 1 + key.columns.index("value")
                changed[name][:, value] += rows[:, start : start + len(by)] @ by
            elif "height" in key.columns:
                changed[name] = rows + by[2]
            elif "coordinate" in key.columns:
                changed[name] = rows + by
        return changed

    stances = log.stances
    return replace(
        log,
        anchor_position=log.anchor_position + by,
        ground_z=None if log.ground_z is None else log.ground_z + float(by[2]),
        stances=stances and replace(stances, **numbers(stances, LISTS)),
        **numbers(log, KEYS),
    )


def canonical_contacts(contacts: NDArray[np.int32]) -> NDArray[np.int32]:
    """Sort rows of `SensingLog.contacts` and drop repeated ones, shape (C, 4)."""
    joiner_first = np.unique(contacts.reshape(-1, 4)[:, [2, 3, 0, 1]], axis=0)
    return np.ascontiguousarray(joiner_first[:, [2, 3, 0, 1]])
