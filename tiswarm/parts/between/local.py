"""What one robot works out from the lines and places of robots that it holds.

The layers of `online` run on these robots alone. Rows about others are left out: where rows of a
block have noise in common, that of those which are left stays as it is. Lengths in R, relative to
the anchor.
"""

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple, TypeVar

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.localization.chains.problem import chosen_rows
from tiswarm.localization.cost.neighborhood import Block, Configuration, block_of
from tiswarm.localization.cost.settings import CANDIDATES, NEIGHBORS
from tiswarm.localization.params import DistributedParams, OnlineParams
from tiswarm.localization.registry import centered
from tiswarm.measurements.odometry import Odometry
from tiswarm.parts.between.chains import annealed
from tiswarm.parts.between.settings import ANSWERS
from tiswarm.parts.between.wire import Whereabouts, read_line, rounding_sd
from tiswarm.parts.online.layers import LocalLayers
from tiswarm.parts.online.lines import mentioned, standing
from tiswarm.records.sensing_file import SensingLogBuilder
from tiswarm.records.sensing_format import (
    STANCE_LISTS,
    HeaderLine,
    RobotLine,
    StanceEntry,
    line_text,
    parse_header,
)

_Entry = TypeVar("_Entry", RobotLine, StanceEntry)

_AXES = 3
_STEPS = 2
"""Steps of "shares a row" to the robots that move."""
OF_ROW = 40
"""Operations for the residual of a row and its derivatives [1]."""
OF_PAIR = 10
"""Operations to find whether two robots are near [1]."""
_LEVEL = (1.0, 0.0, 0.0, 0.0)


@dataclass
class Known:
    """What a robot holds of one robot, itself included."""

    line: bytes = b""
    """What it sensed, as sent; empty if unknown."""

    place: Whereabouts | None = None
    """Where it is; None if unknown."""

    candidates: Reals = field(default_factory=lambda: np.empty((0, _AXES)))
    """Where else it may be, relative to the mean of those it shares rows with [R], (k, 3)."""

    sharing: set[int] = field(default_factory=set)
    """Robots that are known to share rows with it."""

    is_surprising: bool = False
    """Whether chance does not explain its rows and overlaps, as the one that solved for it says."""

    is_current: bool = False
    """Whether it lets the robot that holds this know as it moves."""


@dataclass(frozen=True)
class Program:
    """What every robot is programmed with; it says nothing of other robots."""

    params: DistributedParams
    header: str
    """First line of a sensing file."""

    @property
    def docks(self) -> int:
        """Docks of a robot."""
        return len(_head(self.header).dock_offsets)

    def decoded(self, line: bytes) -> RobotLine:
        """Read a line as it was sent."""
        return _decoded(line, self.docks, self.params.bits)

    def partners(self, line: bytes) -> set[int]:
        """List the robots that a line has rows about."""
        return mentioned(self.decoded(line))


class Solved(NamedTuple):
    """What a robot found out."""

    places: Mapping[int, Whereabouts]
    """Places of robots that moved, and of the one that was solved for, by number."""

    surprising: set[int]
    """Those of them whose rows and overlaps chance does not explain."""

    candidates: Reals
    """As in `Known`, of the one that was solved for."""

    operations: float
    """Additions and multiplications that it took, about."""


@lru_cache(maxsize=16)
def _head(header: str) -> HeaderLine:
    # The second version knows fixes, by which robots are held.
    return parse_header(line_text(header)).model_copy(update={"version": 2})


@lru_cache(maxsize=20_000)
def _decoded(line: bytes, docks: int, bits: int | None) -> RobotLine:
    return read_line(line, docks, bits)


class LocalSwarm:
    """The robots that one robot holds lines of, numbered anew in join order; 0 is the anchor."""

    def __init__(self, program: Program, known: Mapping[int, Known]) -> None:
        """Measure the rows of robots among each other, and put them where they are known to be."""
        held = {n: each for n, each in known.items() if each.line}
        self.numbers: Ints = np.array(sorted({0, *held}), np.int64)
        self._index = {number: k for k, number in enumerate(self.numbers.tolist())}
        self._program, self._params = program, _precise(program, known)
        self.layers = LocalLayers(program.docks, self._params)
        self._sharing: list[set[int]] = [set() for _ in self.numbers]
        position, turn, sd = (np.zeros((len(held) + 1, _AXES)) for _ in range(3))
        for number, k in self._index.items():
            each = held.get(number, Known())
            lines = {n: other.line for n, other in held.items()}
            # A robot whose other rows are not here is held by where it is.
            is_whole = each.place is None or each.sharing <= held.keys()
            block = self._block(number, lines, None if is_whole or not number else each.place)
            self.layers.append(block, self._touching(program, each.line))
            for partner in block.partners.tolist():
                self._sharing[partner].add(k)
                self._sharing[k].add(partner)
            self.layers.places[k] = each.candidates
            if each.place is not None:
                position[k], turn[k], sd[k, 0] = each.place
        count = len(self.numbers)
        self.layers.state = Configuration(position[:count], turn[:count])
        self.layers.sd = sd[:count, 0]

    def solve(self, number: int, *, anew: bool, everywhere: bool = False) -> Solved:
        """Solve for a robot and those near it.

        Args:
            number: The robot.
            anew: Whether to look for its place among all that its rows allow.
            everywhere: Whether to anneal all robots.
        """
        layers, k = self.layers, self._index[number]
        before = Configuration(*(each.copy() for each in layers.state))
        # A robot that has a place keeps it, unless those near it move.
        layers.solve_near(k, layers.place(k) if anew else None)
        if self._program.params.chains:
            moving = np.arange(len(self.numbers)) if everywhere else self._near(k)
            found = annealed(layers, moving, self._program.params, number)
            layers.state, layers.sd[moving] = found.state, found.sd
        state = layers.state
        apart = np.linalg.norm(state.position - before.position, axis=1)
        turned = np.linalg.norm(state.turn - before.turn, axis=1)
        # Who sends exact numbers sends all of them.
        least = 0.0 if self._program.params.bits is None else 1.0
        has_moved = (apart > least * ANSWERS.moved) | (turned > least * ANSWERS.turned)
        has_moved[k] = True
        moved = np.flatnonzero(has_moved)
        number_of = self.numbers[moved].tolist()
        places = [
            Whereabouts(state.position[j].copy(), state.turn[j].copy(), float(layers.sd[j]))
            for j in moved.tolist()
        ]
        surprising = layers.surprising(moved)
        return Solved(
            dict(zip(number_of, places, strict=True)),
            {n for n, is_surprise in zip(number_of, surprising, strict=True) if is_surprise},
            layers.places[k],
            self._operations(k, anew=anew),
        )

    def _near(self, k: int) -> Ints:
        """List the robots within two steps of sharing rows with one, ascending."""
        near, ring = {k}, {k}
        for _ in range(_STEPS):
            ring = {other for each in ring for other in self._sharing[each]} - near
            near |= ring
        return np.array(sorted(near), np.int64)

    def _operations(self, k: int, *, anew: bool) -> float:
        """Count what a search for candidates, linear problems and chains take, about."""
        params, near = self._program.params, self._near(k)
        own, rows = len(self.layers.blocks[k]), [len(self.layers.blocks[j]) for j in near.tolist()]
        search = CANDIDATES.starts * CANDIDATES.rounds * OF_ROW * own**2 if anew else 0
        linear = sum(OF_ROW * m**2 for m in rows) + (2 * _AXES * len(near)) ** 3 / 3
        step = OF_ROW * 2 * sum(rows) + OF_PAIR * len(near) * len(self.numbers)
        rounds = NEIGHBORS.rounds * (1 + params.chains)
        return float(search + rounds * linear + params.chains * params.steps * step)

    def _block(self, number: int, lines: Mapping[int, bytes], stays: Whereabouts | None) -> Block:
        """Measure the rows of a robot about those that are held, and where it stays, if it does."""
        line, others = lines.get(number, b""), {}
        if number:
            members = sorted(self._program.partners(line) & lines.keys() | {0})
            others = {each: lines.get(each, b"") for each in members}
        place = None if stays is None else tuple(stays.position.tolist())
        block = _measured(self._program, self._params, line, tuple(others.items()), place)
        return replace(block, members=np.array([self._index[n] for n in block.members.tolist()]))

    def _touching(self, program: Program, line: bytes) -> set[tuple[int, int, int]]:
        """List docks of a robot in contact with those of robots that are held."""
        if not line:
            return set()
        rows = program.decoded(line).contacts
        return {
            (dock, self._index[other], its) for dock, other, its in rows if other in self._index
        }


def _precise(program: Program, known: Mapping[int, Known]) -> OnlineParams:
    """Return the settings of the layers, in which rounding of what was sent counts as noise."""
    params = program.params
    places = [each.place.position for each in known.values() if each.place is not None]
    farthest = float(np.abs(places).max()) if places else 1.0
    rounding = rounding_sd(farthest, params.bits)
    names = OnlineParams.__dataclass_fields__.keys() & params.__dataclass_fields__.keys()
    shared = {
        name: getattr(params, name) for name in names - {"method", "chains", "steps", "start_sigma"}
    }
    return OnlineParams(
        **shared
        | {
            "contact_sd": float(np.hypot(params.contact_sd, rounding)),
            "height_sd": float(np.hypot(params.height_sd, rounding)),
        }
    )


def _about(line: RobotLine, robots: AbstractSet[int]) -> RobotLine:
    """Leave of a line what it says of some robots, and of its own."""

    def cleared(entry: _Entry) -> _Entry:
        kept = {
            key: [item for item in items if item[kinds.index("robot")] in robots]
            for key, kinds in STANCE_LISTS.items()
            if "robot" in kinds and (items := getattr(entry, key))
        }
        return entry.model_copy(update=kept)

    stances = line.stances and [cleared(entry) for entry in line.stances]
    return cleared(line).model_copy(update={"stances": stances})


def _held(line: RobotLine, center: Reals, unit: float) -> RobotLine:
    """Add to a line that the robot is where it is [log unit]."""
    axes = np.eye(_AXES)
    fixes = [(*axis.tolist(), float(axis @ center), ANSWERS.stays_sd * unit) for axis in axes]
    return line.model_copy(update={"fixes": [*(line.fixes or []), *fixes]})


_ANCHOR = RobotLine(robot=0, orientation_wxyz=list(_LEVEL), contacts=[])
"""An anchor that nothing is known about but its place."""


@lru_cache(maxsize=20_000)
def _measured(
    program: Program,
    params: OnlineParams,
    line: bytes,
    others: tuple[tuple[int, bytes], ...],
    stays: tuple[float, ...] | None,
) -> Block:
    """Measure the rows of a robot about others, which stand; members are the robots' numbers.

    Args:
        program: Of every robot.
        params: Settings of the layers.
        line: What the robot sensed; empty for an anchor that nothing is known about.
        others: Number and line of each, ascending; empty as well.
        stays: Where the robot stays [R]; None if it may move.
    """
    head = _head(program.header)
    about = {number for number, sensed in others if sensed}
    own = _about(program.decoded(line), about) if line else _ANCHOR
    if stays is not None:
        center = np.array(stays) * head.dock_radius + head.anchor_position
        own = _held(own, center, head.dock_radius)
    builder = SensingLogBuilder(head)
    for _, sensed in others:
        builder.add(standing(program.decoded(sensed)) if sensed else _ANCHOR)
    builder.add(own)
    members = np.array([*(number for number, _ in others), own.robot], np.int64)
    log = centered(builder.log())
    return block_of(chosen_rows(log, params, Odometry(log))[0], members)
