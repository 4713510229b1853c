"""One robot: what it holds, what it answers, and how it solves for the robots near it.

A robot reads its own memory and the bytes that it hears. It has no other way to another robot.

1. It joins, and lets the robots that it has rows about know that they share rows. It sends its line
   to the first that it touches. This one passes it on to its keeper: the nearest robot that moved
   it before. Without one that is near it becomes a keeper itself. A base keeps all.
2. The keeper asks robots step by step of "shares a row", unless what it holds of them is current:
   whom they share rows with, where they are, and what they sensed if it does not hold that.
3. It solves, and sends each robot that moved its new place. Who is moved lets all others that hold
   its place know that they hold it no more.
4. After `tenure` joins it solves for no more, and another robot takes over.
5. In a review a message walks along first contacts, from robot to robot and back. Whom it reaches
   solves again for all that it solved for. What hangs on these robots moves as one: otherwise
   those that are not asked would hold a structure that is to shift as a whole.
   Who waits for the return of the message sends it again. A robot that heard of no partner solves
   for itself when it comes.
6. A robot that touches none, and all that hang on it, are a body of their own, in which they know
   where they are. Who touches two bodies joins them: its keeper solves for it in one of them, then
   for the shift of the other as one. A message around lets that one hang on the new robot.

The layers of `online` run on the robots that it holds alone. Rows about others are left out: where
rows of a block have noise in common, that of those which are left stays as it is. Lengths in R,
relative to the anchor.

Settings were chosen on towers and cantilevers of the seeds 1000 to 1007, which no result is
reported on.
"""

import zlib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.normal_equations import damped, inverted, solved
from tiswarm.localization.chains.annealer import Annealer
from tiswarm.localization.chains.problem import Planes, fewest_contacts
from tiswarm.localization.chains.views import (
    ANNEALING,
    ChainView,
    Links,
    cooled,
    find_subtrees,
)
from tiswarm.localization.cost import EXTENSION, ROBUST_SD
from tiswarm.localization.cost.cost import Cost, State, boltzmann_weights
from tiswarm.localization.distributed import wire
from tiswarm.localization.distributed.channel import Message, pause
from tiswarm.localization.distributed.settings import DistributedParams
from tiswarm.localization.online.kernels import (
    COORDINATE,
    OFFSET,
    BlockStart,
    RowLabel,
    RowValue,
    Table,
)
from tiswarm.localization.online.layers import Joiner, LocalLayers, measured
from tiswarm.localization.online.neighborhood import Block, NearCost, NearLinear
from tiswarm.localization.online.settings import CANDIDATES, NEIGHBORS
from tiswarm.measurements.equations import AXES as _AXES
from tiswarm.measurements.odometry import CENTER
from tiswarm.records.sensing_file import SensingLogBuilder
from tiswarm.records.sensing_format import HeaderLine, RobotLine
from tiswarm.records.sensing_log import LISTS

_TEMPERED = 4.0
"""Divisor of costs by which ends of chains weigh in standard deviations [1]: few chains meet few of
the likely minima. Chosen on towers and cantilevers of the seeds 1000 to 1007, which no result is
reported on."""


@dataclass(frozen=True, kw_only=True)
class AnswerSettings:
    """What is worth a message."""

    moved: float = 0.05
    """Shift from which on a robot hears where it is now [R]."""

    turned: float = 0.5
    """Turn from which on it does [standard deviations]."""

    shifted: float = 0.1
    """Shift from which on a branch does [R]."""

    doubtful_sd: float = 1.0
    """Standard deviation from which on a robot doubts its position: half a dock diameter [R]."""

    stays_sd: float = 0.05
    """Standard deviation of each coordinate of a robot whose other rows are not here: the robots
    that solved for it know more of it [R]."""


ANSWERS = AnswerSettings()

OF_ROW = 40
"""Operations for the residual of a row and its derivatives [1]."""
OF_PAIR = 10
"""Operations to find whether two robots are near [1]."""
_SETTLED = 1e-9
"""Step below which a share of it makes no difference [R]."""
_LEVEL = [1.0, 0.0, 0.0, 0.0]

_READS_ALL = ("join", "ask", "answer", "lines", "place")
"""Messages that robots read although they pass by."""

_SIZE = 2
"""Bytes of a number or a length between lines."""

_FARTHEST = 255
"""Contacts up to which a message counts those that it takes."""


@dataclass
class Known:
    """What a robot holds of one robot, itself included."""

    line: bytes = b""
    """What it sensed, as sent; empty if unknown."""

    place: wire.Whereabouts | None = None
    """Where it is; None if unknown."""

    candidates: Reals = field(default_factory=lambda: np.empty((0, _AXES)))
    """Where else it may be, relative to the mean of those it shares rows with [R], (k, 3)."""

    sharing: set[int] = field(default_factory=set)
    """Robots that are known to share rows with it."""

    span: tuple[int, int] | None = None
    """When the last walk came to the robot, and left it: those between hang on it."""

    since: int = 0
    """Robot that joined as it was asked last; it has said who shares rows with it until then."""

    is_surprising: bool = False
    """Whether chance does not explain its rows and overlaps, as the one that solved for it says."""

    is_current: bool = False
    """Whether it lets the robot that holds this know as it moves."""

    @property
    def body(self) -> int:
        """First robot of the body in which it is placed; -1 if it is not."""
        return -1 if self.place is None else self.place.body


@dataclass(frozen=True, eq=False)
class Program:
    """What every robot is programmed with; it says nothing of other robots."""

    params: DistributedParams
    header: HeaderLine
    """First line of a sensing file."""

    @property
    def docks(self) -> int:
        """Docks of a robot."""
        return len(self.header.dock_offsets)

    def decoded(self, line: bytes) -> RobotLine:
        """Read a line as it was sent."""
        return _decoded(line, self.docks, self.params.bits)

    def partners(self, line: bytes) -> set[int]:
        """List the robots that a line has rows about."""
        entry = self.decoded(line)
        return {
            item[key.robot]
            for stance in (entry, *(entry.stances or []))
            for name, key in LISTS.items()
            if key.robot is not None
            for item in getattr(stance, name) or []
        }


class Solved(NamedTuple):
    """What a robot found out."""

    places: dict[int, wire.Whereabouts]
    """Places of robots that moved, and of the one that was solved for, by number."""

    surprising: set[int]
    """Those of them whose rows and overlaps chance does not explain."""

    candidates: Reals
    """As in `Known`, of the one that was solved for."""

    operations: float
    """Additions and multiplications that it took, about."""

    shifts: Mapping[int, tuple[Reals, list[int]]] = {}
    """By a robot, the shift of all that hang on it [R], and those that do not take part."""

    along: Mapping[int, Reals] = {}
    """Shift of each robot that does and is held [R], by its number."""


@lru_cache(maxsize=20_000)
def _decoded(line: bytes, docks: int, bits: int | None) -> RobotLine:
    return wire.read_line(line, docks, bits)


class LocalSwarm:
    """The robots that one robot holds lines of, numbered anew in join order; 0 is the anchor."""

    def __init__(self, program: Program, known: Mapping[int, Known]) -> None:
        """Measure the rows of robots among each other, and put them where they are known to be."""
        held = {n: each for n, each in known.items() if each.line}
        self.numbers: Ints = np.array(sorted({0, *held}), np.int64)
        self._index = {number: k for k, number in enumerate(self.numbers.tolist())}
        self._program, self._params = program, _precise(program, known)
        self.layers = LocalLayers(program.docks, self._params)
        position, turn, sd = (np.zeros((len(held) + 1, _AXES)) for _ in range(3))
        self._stays = np.zeros(len(self.numbers), np.bool_)
        self._spans: list[tuple[int, int] | None] = []
        self._opened: dict[int, Joiner] = {}
        self.body = 0
        for number, k in self._index.items():
            each = held.get(number, Known())
            lines = {n: other.line for n, other in held.items()}
            # A robot whose other rows are not here is held by where it is.
            is_whole = each.place is None or each.sharing <= held.keys()
            self._stays[k] = not is_whole and number > 0
            block = self._block(number, lines, each.place if self._stays[k] else None)
            touching = self._touching(program, each.line)
            self._spans.append(each.span)
            if self._stays[k]:
                self._opened[k] = Joiner(self._block(number, lines, None), touching)
            self.layers.append(Joiner(block, touching))
            self.layers.places[k] = each.candidates
            if each.place is not None:
                position[k], turn[k], sd[k, 0] = each.place[:3]
                self.body = each.place.body
        if self.body:
            self.layers.gone.add(0)  # the anchor is elsewhere
        count = len(self.numbers)
        self.layers.state = State(position[:count], turn[:count])
        self.layers.sd = sd[:count, 0]

    def solve(self, number: int, *, anew: bool, everywhere: bool = False) -> Solved:
        """Solve for a robot and those near it.

        Args:
            number: The robot.
            anew: Whether to look for its place among all that its rows allow.
            everywhere: Whether to anneal all robots.
        """
        layers, k = self.layers, self._index[number]
        before = State(*(each.copy() for each in layers.state[:2]))
        given = layers.sd.copy()
        # A robot that has a place keeps it, unless those near it move.
        layers.solve_near(k, layers.place(k) if anew else None)
        moving = np.arange(len(self.numbers)) if everywhere else layers.near(k)
        # Chains need a row that pulls.
        if self._program.params.chains and layers.blocks_about(moving):
            found = annealed(layers, moving, self._program.params, number)
            layers.state = found.state
            self._revise_sd(given, moving, found.sd)
        return self._solved(number, before, self._operations(k, anew=anew))

    def _revise_sd(self, given: Reals, moving: Ints, spread: Reals) -> None:
        """Set the sd of robots that moved: what others err by counts, and how far chains differ."""
        layers, stays = self.layers, self._stays[moving]
        # Where a robot stays by what others found, it is as uncertain as they found it.
        layers.sd[self._stays] = given[self._stays]
        free = moving[~stays]
        if len(free) and layers.blocks_about(free):
            linear = layers.neighborhood(free).linearized(layers.state)
            layers.sd[free] = np.hypot(spread[~stays], linear.sd())

    def _solved(self, number: int, before: State, operations: float) -> Solved:
        """List the robots that moved, and the one that was solved for."""
        layers, k = self.layers, self._index[number]
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
            wire.Whereabouts(
                state.position[j].copy(), state.turn[j].copy(), float(layers.sd[j]), self.body
            )
            for j in moved.tolist()
        ]
        surprising = layers.surprising(moved)
        return Solved(
            dict(zip(number_of, places, strict=True)),
            {n for n, is_surprise in zip(number_of, surprising, strict=True) if is_surprise},
            layers.places[k],
            operations,
        )

    def relax(self, number: int) -> Solved:
        """Move robots whose rows are all held to the minimum, and what hangs on each as one.

        Without the second a structure that is to shift as a whole would be held where it is by all
        robots that are not here.
        """
        layers, robots = self.layers, len(self.numbers)
        before = State(*(each.copy() for each in layers.state[:2]))
        every, is_free = np.arange(robots), ~self._stays & (self.numbers > 0)
        free = np.flatnonzero(is_free)
        opened = layers.with_other(self._opened)
        blocks = opened.blocks_about(free)
        if not blocks:
            return self._solved(number, before, 0.0)
        root, parted = self._branches(is_free)
        basis = _motions(free, root)
        problem = _MotionCost(opened.neighborhood(every, blocks), basis)
        state, linear = before, problem.linearized(before)
        for _ in range(NEIGHBORS.rounds):
            other, _ = problem.moved(state, linear, NEIGHBORS.radius)
            there = problem.linearized(other)
            if there.cost > linear.cost - NEIGHBORS.settled:
                break
            state, linear = other, there
        stays = self._stays & (root < 0)
        layers.sd[free] = self._sd(linear, basis, stays)[free]
        shifts: dict[int, tuple[Reals, list[int]]] = {}
        along: dict[int, Reals] = {}
        for first in np.unique(root[root >= 0]).tolist():
            members = np.flatnonzero(root == first)
            shift = state.position[members[0]] - before.position[members[0]]
            if np.linalg.norm(shift) > ANSWERS.shifted:
                shift = wire.rounded(shift, self._program.params.bits)
                shifts[int(self.numbers[first])] = shift, [*self.numbers[parted[first]].tolist()]
                along |= dict.fromkeys(self.numbers[members].tolist(), shift)
            state.position[members] = before.position[members]
        layers.state = state
        found = self._solved(number, before, NEIGHBORS.rounds * (2.0 * _AXES * len(free)) ** 3)
        return found._replace(shifts=shifts, along=along)

    def _branches(self, is_free: Bools) -> tuple[Ints, dict[int, list[int]]]:
        """Find what hangs on robots that are free to move, by the spans of a walk.

        Returns:
            The last free robot on the way to each other one, -1 if there is none, shape (N,); and
            by this robot the free ones that are next on ways beyond it.
        """
        root = np.full(len(is_free), -1)
        parted: dict[int, list[int]] = {}
        spans = {k: self._spans[k] for k in np.flatnonzero(is_free).tolist() if self._spans[k]}
        for k, span in enumerate(self._spans):
            if span is None:
                continue
            above = [j for j, its in spans.items() if its[0] < span[0] < its[1]]
            last = max(above, key=lambda j: spans[j][0], default=-1)
            if is_free[k]:
                parted.setdefault(last, []).append(k)
            else:
                root[k] = last
        return root, parted | {k: [] for k in set(root.tolist()) - parted.keys()}

    def closing(self, number: int, members: Collection[int], places: Reals) -> tuple[Reals, float]:
        """Find the shift by which another body is where a robot touches it.

        Args:
            number: The robot, where it is in its own body.
            members: Robots of the other body, where they are in that one.
            places: Where the robot may be in that one [R], shape (k, 3).

        Returns:
            The shift, shape (3,), and its standard deviation [R].
        """
        layers, k, robots = self.layers, self._index[number], len(self.numbers)
        body = np.array([self._index[n] for n in sorted(members)])
        root, alone = np.full(robots, -1), np.array([k])
        root[body] = k
        opened = layers.with_other({j: self._opened[j] for j in body.tolist() if self._stays[j]})
        blocks, basis = opened.blocks_about(np.append(body, k)), _motions(alone, root)
        problem = _MotionCost(opened.neighborhood(np.arange(robots), blocks), basis)
        found = []
        for place in places:
            start = layers.state.position.copy()
            start[body] += start[k] - place
            found.append(problem.refine(State(start, layers.state.turn)))
        reach = opened.neighborhood(alone).shapes.reach
        score = np.array([each[1].cost - _gain(opened, alone, each[0], reach) for each in found])
        shift = np.array([(each.position - layers.state.position)[body[0]] for each, _ in found])
        best = int(score.argmin())
        spread = boltzmann_weights(score, _TEMPERED) @ ((shift - shift[best]) ** 2).sum(axis=1)
        stays = (root < 0) & (np.arange(robots) != k)
        return shift[best], float(
            np.hypot(self._sd(found[best][1], basis, stays)[body[0]], np.sqrt(spread))
        )

    def places_of(self, number: int) -> Reals:
        """Find where rows about those that are held allow a robot to be [R], shape (k, 3)."""
        layers, k = self.layers, self._index[number]
        layers.place(k)
        found: Reals = layers.places[k] + layers.state.position[layers.blocks[k].partners].mean(
            axis=0
        )
        return found

    def is_floating(self, number: int) -> bool:
        """Judge whether the rows of a robot tie it neither to the world nor to one that is held."""
        rows = self.layers.blocks[self._index[number]].rows
        return not len(rows.other) and rows.places.rank < _AXES

    def _sd(self, linear: NearLinear, basis: Reals, stays: Bools) -> Reals:
        """Compute the standard deviation of each robot that moved [R], shape (N,).

        Errors of those that stay, shape (N,), count as a shift that they share.
        """
        robots = len(stays)
        known = damped(basis.T @ linear.information @ basis, NEIGHBORS.open_precision)
        others = np.zeros((2, robots, _AXES, _AXES))
        sd = np.where(stays, self.layers.sd, 0.0)
        others[0] = sd[:, None, None] * np.eye(_AXES) / np.sqrt(_AXES)
        inverse = inverted(known)
        shared = basis @ inverse @ (basis.T @ (linear.information @ others.reshape(-1, _AXES)))
        own = ((basis @ inverse) * basis).sum(axis=1)
        square = (own + (shared**2).sum(axis=1)).reshape(2, robots, _AXES)
        found: Reals = np.sqrt(square[0].sum(axis=1))
        return found

    def _operations(self, k: int, *, anew: bool) -> float:
        """Count what a search for candidates, linear problems and chains take, about."""
        params, near = self._program.params, self.layers.near(k)
        own, rows = len(self.layers.blocks[k]), [len(self.layers.blocks[j]) for j in near.tolist()]
        search = CANDIDATES.starts * CANDIDATES.rounds * OF_ROW * own**2 if anew else 0
        linear = sum(OF_ROW * m**2 for m in rows) + (2 * _AXES * len(near)) ** 3 / 3
        step = OF_ROW * 2 * sum(rows) + OF_PAIR * len(near) * len(self.numbers)
        rounds = NEIGHBORS.rounds * (1 + params.chains)
        return float(search + rounds * linear + params.chains * params.steps * step)

    def _block(
        self, number: int, lines: Mapping[int, bytes], stays: wire.Whereabouts | None
    ) -> Block:
        """Measure the rows of a robot about those that are held, and where it stays, if it does."""
        members = [0]
        if number:
            others = self._program.partners(lines[number]) & lines.keys()
            members = [*sorted(others | {0}), number]
        place = None if stays is None else tuple(stays.position.tolist())
        sent = tuple(lines.get(each, b"") for each in members)
        block = _measured(self._program, self._params, sent, place)
        return replace(block, members=np.array([self._index[n] for n in members]))

    def _touching(self, program: Program, line: bytes) -> set[tuple[int, int, int]]:
        """List docks of a robot in contact with those of robots that are held."""
        if not line:
            return set()
        rows = program.decoded(line).contacts
        return {
            (dock, self._index[other], its) for dock, other, its in rows if other in self._index
        }


class _MotionCost(Cost[NearLinear]):
    """The cost of robots near one as a function of some motions, which move several as one."""

    most_rounds = CANDIDATES.rounds
    widest = NEIGHBORS.radius
    least_reduction = NEIGHBORS.settled

    def __init__(self, problem: NearCost, basis: Reals) -> None:
        """Take the cost of N robots that may all move, and motions, shape (6 N, n)."""
        self._problem, self._basis = problem, basis

    def linearized(self, state: State) -> NearLinear:
        """Linearize the cost at a state."""
        return self._problem.linearized(state)

    def moved(self, state: State, linear: NearLinear, radius: float) -> tuple[State, float]:
        """Step along the motions."""
        basis = self._basis
        known = damped(basis.T @ linear.information @ basis, radius**-2.0)
        step = (basis @ solved(known, -basis.T @ linear.slope)).reshape(2, -1, _AXES)
        share = min(1.0, NEIGHBORS.longest_step / max(np.abs(step[0]).max(), _SETTLED))
        other = State(state.position + share * step[0], state.turn + share * step[1])
        return other, float(-share * linear.slope @ step.ravel())


def _motions(free: Ints, root: Ints) -> Reals:
    """Lay out shifts and turns of robots that are free, and shifts of branches, a column each."""
    robots = len(root)
    firsts = np.unique(root[root >= 0])
    single = np.zeros((2, robots, _AXES, 2, len(free), _AXES))
    for part in range(2):
        for axis in range(_AXES):
            single[part, free, axis, part, np.arange(len(free)), axis] = 1.0
    together = np.zeros((2, robots, _AXES, len(firsts), _AXES))
    for axis in range(_AXES):
        together[0, :, axis, :, axis] = root[:, None] == firsts
    rows = 2 * robots * _AXES
    return np.hstack([single.reshape(rows, -1), together.reshape(rows, -1)])


def _precise(program: Program, known: Mapping[int, Known]) -> DistributedParams:
    """Return the settings for layers, in which rounding of what was sent counts as noise."""
    params = program.params
    places = [each.place.position for each in known.values() if each.place is not None]
    farthest = float(np.abs(places).max()) if places else 1.0
    rounding = wire.rounding_sd(farthest, params.bits)
    return replace(
        params,
        contact_sd=float(np.hypot(params.contact_sd, rounding)),
        height_sd=float(np.hypot(params.height_sd, rounding)),
    )


def held(line: RobotLine, center: Reals, sd: float) -> RobotLine:
    """Add to a line that the robot is where it is, with an sd of each coordinate [log unit]."""
    axes = np.eye(_AXES)
    fixes = [(*axis.tolist(), float(axis @ center), sd) for axis in axes]
    return line.model_copy(update={"fixes": [*(line.fixes or []), *fixes]})


_ANCHOR = RobotLine.model_validate({"robot": -1, "orientation_wxyz": _LEVEL, "contacts": []})
"""An anchor that nothing is known about but its place: what robots sensed of it is left out."""


@lru_cache(maxsize=20_000)
def _measured(
    program: Program,
    params: DistributedParams,
    lines: tuple[bytes, ...],
    stays: tuple[float, ...] | None,
) -> Block:
    """Measure the rows of a robot about others, which stand.

    Args:
        program: Of every robot.
        params: Settings of the layers.
        lines: Of the robots that it names and are held, and of itself, in join order; the first is
            the anchor's, empty if nothing is known about it.
        stays: Where the robot stays [R]; None if it may move.
    """
    # The second version knows fixes, by which robots are held.
    head = program.header.model_copy(update={"version": 2})
    robots = [program.decoded(line) if line else _ANCHOR for line in lines]
    if stays is not None:
        center = np.array(stays) * head.dock_radius + head.anchor_position
        robots[-1] = held(robots[-1], center, ANSWERS.stays_sd * head.dock_radius)
    builder = SensingLogBuilder(head, of_some=True)
    for robot in robots:
        builder.add(robot)
    return measured(*builder.log_of(len(robots) - 1), params).block


@dataclass
class _Search:
    """What a robot that solves has asked so far."""

    joiner: int
    step: dict[int, int]
    """Steps of "shares a row" to each robot that it knows to be near."""
    current: int = 0
    """Robots within so many steps have answered."""
    waiting: set[int] = field(default_factory=set)
    answered: set[int] = field(default_factory=set)
    walked: int | None = None
    """Robots that a walk has come to, which goes on once this is solved; None without one."""
    is_review: bool = False
    """Whether to solve again for all that the robot solved for."""


class Peer:
    """A robot of a swarm that localizes itself."""

    def __init__(self, program: Program, line: RobotLine) -> None:
        """Begin with what the robot sensed, under its number in join order."""
        self._program = program
        self.number = line.robot
        content = wire.line_bytes(line, program.docks, program.params.bits)
        partners = program.partners(content)
        self.known: dict[int, Known] = {line.robot: Known(content, sharing=partners)}
        self.touching = sorted({other for _, other, _ in line.contacts})
        self.outbox: list[Message] = []
        self._hosts = [self.number]
        if program.params.solver != "joiner":
            self._hosts = [*self.touching, self.number]
        # Robots that moved this one, and contacts to them.
        self._keepers: dict[int, int] = {}
        # The robot that another keeper may have to solve for, and its line.
        self._hosted: tuple[int, bytes] | None = None
        # The robot that this one hangs on, its first contact, and those that hang on this one.
        self._parent = min(self.touching, default=None)
        self._children: set[int] = set()
        # Robots that this one solved for.
        self._kept: set[int] = set()
        # Number of the last walk, when it came here and went on, to whom it is to go, and where
        # it is; -1 if it is not at a robot that hangs on this one.
        self._walk, self._entered, self._went, self._visited = -1, 0, 0, -1
        self._left = list[int]()
        # Times that what the robot waits for was repeated.
        self._tries = 0
        # The shift by which its body joined another one, as it was sent.
        self._joined = b""
        # Robots that rely on hearing of it when this one moves.
        self._watchers: set[int] = set()
        self._search: _Search | None = None
        self._solved, self._annealed = 0, 0
        self.operations = 0.0

    @property
    def place(self) -> wire.Whereabouts | None:
        """Where the robot takes itself to be; None if it does not know."""
        return self.known[self.number].place

    def join(self) -> None:
        """Let robots know that rows are shared; the first of the swarm is the anchor."""
        mine = self.known[self.number]
        if self.number == 0:
            mine.place = wire.Whereabouts(np.zeros(3), np.zeros(3), 0.0)
            return
        host = self._hosts.pop(0)
        # Who has been named knows that it shares rows; who solves has to know the rows.
        parts = dict.fromkeys(sorted(self._program.partners(mine.line) - {host}), b"")
        if host == self.number:
            self._say("join", b"", parts)
            self._begin(host)
        else:
            self._say("join", b"", parts | {host: mine.line})

    def hear(self, message: Message) -> Message:
        """Take in a message, whether it was for this robot or passes by; return what goes on."""
        if message.kind in _READS_ALL:
            return getattr(self, f"_hear_{message.kind}")(message) or message
        if self.number in message.parts:
            getattr(self, f"_hear_{message.kind}")(message)
        return message

    def _hear_moved(self, message: Message) -> None:
        self._of(message.sender).is_current = False

    def _hear_task(self, message: Message) -> None:
        if self._is_busy:
            self._say("full", b"", {message.sender: b""})
        else:
            self._take(message.parts[self.number])

    def _hear_branch(self, message: Message) -> None:
        self._pass_shift(message.common)

    def _hear_shift(self, message: Message) -> None:
        """Move with the robot that this one hangs on."""
        found = wire.read_shift(message.common, self._program.params.bits)
        self._hang_on(message.sender)
        if found.body:
            self._joined = message.common
            self._join_body(self.number, found)
            self._warn(self.number)
        elif self.place is not None and found.keeper != self.number:
            mine = self.known[self.number]
            mine.place = self.place._replace(position=self.place.position + found.shift)
            self._warn(found.keeper)
        self._pass_shift(message.common)

    def _pass_shift(self, content: bytes) -> None:
        """Let robots that hang on this one move, too."""
        parted = wire.read_shift(content, self._program.params.bits).parted
        self._say("shift", content, dict.fromkeys(sorted(self._children - {*parted}), b""))

    def _join_body(self, number: int, found: wire.JointShift) -> None:
        """Move what this robot holds of one to another body, unless it is there."""
        its = self._of(number)
        if its.place is not None and its.body == found.body:
            its.place = wire.Whereabouts(
                its.place.position + found.shift,
                its.place.turn,
                float(np.hypot(its.place.sd, found.sd)),
                found.joined,
            )

    def _hang_on(self, parent: int) -> None:
        """Hang on a robot; what this one hung on before hangs on it then, as its body joined."""
        if parent == self._parent:
            return
        self._children.discard(parent)
        if self._parent is not None:
            self._children.add(self._parent)
        self._parent = parent

    def _hear_lost(self, message: Message) -> None:
        """Repeat the shift for a robot that has not heard of it."""
        if self._joined:
            self._say("shift", self._joined, {message.sender: b""})

    def _hear_hang(self, message: Message) -> None:
        self._hang(message.parts[self.number], message.common)

    def _hang(self, pair: bytes, content: bytes) -> None:
        """Hang on a robot of one body, and let the other body hang on this one."""
        parent, child = wire.read_pair(pair)
        if self._parent != parent:
            self._parent = parent
            self._say("child", b"", {parent: b""})
        self._children.add(child)
        self._joined = content
        self._say("shift", content, {child: b""})

    def _hear_child(self, message: Message) -> None:
        self._children.add(message.sender)

    def review(self) -> None:
        """Send a message around that lets each robot that solved do so again for all it solved for.

        It walks along first contacts, twice: on the first walk robots learn what hangs on whom.
        Who waits for the return of a walk sends it again.
        """
        self._enter(0, self._walk + 1)

    def _hear_walk(self, message: Message) -> None:
        count, walk = wire.read_walk(message.common)
        if walk != self._walk:
            self._hang_on(message.sender)
            if self.known[self.number].body > 0:
                self._say("lost", b"", {message.sender: b""})
            self._enter(count, walk)
        elif message.sender == self._visited:
            self._go_on(count)
        elif message.sender == self._parent:
            self._answer_walk()

    def _answer_walk(self) -> None:
        """Answer the robot that this one hangs on, which has not heard of the walk again."""
        if self._search is not None or self._visited >= 0:
            self._say("walking", b"", {self._parent or 0: b""})
        else:
            self._say_walk(self._went, self._parent)

    def _hear_walking(self, message: Message) -> None:
        if message.sender == self._visited:
            self._tries = 0

    def _enter(self, count: int, walk: int) -> None:
        """Take in a walk that comes to this robot."""
        self._walk, self._entered, self._visited = walk % wire.WALKS, count, -1
        self._left = sorted(self._children)
        if self._is_alone:
            self._begin(self.number, count + 1)
        elif walk % 2 and self._kept:
            self._review(count + 1)
        else:
            self._go_on(count + 1)

    @property
    def _is_alone(self) -> bool:
        """Whether the robot touches others, and has heard of no place among them."""
        return bool(self.touching) and (self.place is None or self.place.body == self.number)

    def _go_on(self, count: int) -> None:
        """Let a walk go to the next robot that hangs on this one, or back."""
        self._went, self._tries = count, 0
        if self._left:
            self._visited = self._left.pop(0)
            self._say_walk(count, self._visited)
            return
        self._visited = -1
        self.known[self.number].span = self._entered, count
        if self._parent is not None:
            self._say_walk(count, self._parent)
        elif self._walk % 2 == 0:
            self._enter(0, self._walk + 1)

    def _say_walk(self, count: int, robot: int | None) -> None:
        if robot is not None:
            self._say("walk", wire.write_walk(count, self._walk), {robot: b""})

    def _review(self, count: int) -> None:
        """Solve again for all that this robot solved for, then let the walk go on."""
        every = dict.fromkeys(self._kept | {self.number}, 0)
        self._search = _Search(self.number, every, walked=count, is_review=True)
        self._search.waiting = self._kept - {self.number}
        if self._search.waiting:
            self._ask(self._search.waiting)
        else:
            self._advance()

    def _hear_place(self, message: Message) -> Message:
        """Take in where robots are, and count the contact to the next one."""
        for number, part in message.parts.items():
            self._hold_place(number, part)
        [contacts] = message.common
        if self.number in message.parts:
            self._follow(message.sender, contacts)
        return message._replace(common=bytes([min(contacts + 1, _FARTHEST)]))

    def _follow(self, keeper: int, contacts: int) -> None:
        """Take note of a robot that moved this one, and let others that hold it know."""
        self._keepers[keeper] = contacts
        self._warn(keeper)
        self._watchers.add(keeper)

    def _warn(self, keeper: int) -> None:
        """Let robots that hold this one know that a keeper has moved it, but for that keeper."""
        others = self._watchers - {keeper}
        self._watchers &= {keeper}
        self._say("moved", b"", dict.fromkeys(sorted(others), b""))

    def _take(self, line: bytes) -> None:
        """Become the keeper of a robot, which sent this line."""
        number = self._program.decoded(line).robot
        self._hold_line(number, line)
        for partner in self._of(number).sharing & self.known.keys():
            self.known[partner].sharing.add(number)
        self._begin(number)
        self._forget()

    @property
    def _exchanges(self) -> bool:
        """Whether candidates travel: who anneals finds other images without them."""
        return not self._program.params.chains

    @property
    def waits(self) -> bool:
        """Whether the robot still waits for something."""
        is_lost = self.place is None and bool(self._hosts)
        return self._search is not None or self._visited >= 0 or is_lost

    def expire(self) -> int:
        """Repeat what has no answer, or go on without; return the rounds to be silent before."""
        search = self._search
        self._tries += 1
        silent = pause(self._tries)
        if search is None and self._visited < 0:
            if self._parent is not None:
                # The first notice may be lost.
                self._say("child", b"", {self._parent: b""})
            self.join()
        elif self._tries > self._program.params.retries:
            silent = 0
            if search is None:
                self._go_on(self._went)
            else:
                search.waiting.clear()
                self._advance()
        elif search is None:
            self._say_walk(self._went, self._visited)
        else:
            self._ask(search.waiting)
        return silent

    def judge(self) -> bool:
        """Judge whether the robot doubts where it is, by what it heard.

        It does if chance does not explain its rows and overlaps, if its standard deviation is
        large, or if it heard of no place relative to the anchor.
        """
        if self.place is None or self.place.body or self.place.sd > ANSWERS.doubtful_sd:
            return True
        return self.known[self.number].is_surprising

    @property
    def joins(self) -> int:
        """Joins that the robot solved."""
        return len(self._kept)

    @property
    def memory(self) -> int:
        """Bytes of what the robot holds."""
        bits = self._program.params.bits or 64
        return sum(
            len(each.line)
            + (wire.NUMBER * (1 + len(each.sharing)) + bits * (6 + each.candidates.size) + 8 + 7)
            // 8
            for each in self.known.values()
        )

    def _say(self, kind: str, common: bytes, parts: dict[int, bytes]) -> None:
        if parts:
            self.outbox.append(Message(kind, self.number, common, parts))

    def _of(self, number: int) -> Known:
        return self.known.setdefault(number, Known())

    def _hear_join(self, message: Message) -> None:
        """Take in that a robot shares rows with others, and see that somebody solves for it."""
        for partner in message.parts.keys() & self.known.keys():
            self.known[partner].sharing.add(message.sender)
        if line := message.parts.get(self.number):
            if self.number == min(o for _, o, _ in self._program.decoded(line).contacts):
                self._children.add(message.sender)
            self._find_keeper(message.sender, line)

    def _find_keeper(self, joiner: int, line: bytes) -> None:
        """Hand the line of a robot to who solves for it."""
        keeper = self._keeper()
        if keeper != self.number:
            self._hosted = joiner, line
            self._say("task", b"", {keeper: line})
        elif self._is_busy:
            self._say("full", b"", {joiner: b""})
        else:
            self._take(line)

    def _hear_full(self, message: Message) -> None:
        """Try the next keeper, or the next robot that this one touches."""
        self._keepers.pop(message.sender, None)
        if self._hosted is not None:
            self._find_keeper(*self._hosted)
        elif self.place is None:
            self.join()

    @property
    def _is_busy(self) -> bool:
        """Whether this robot has solved for as many as it does."""
        params = self._program.params
        return params.solver == "keeper" and self._solved >= params.tenure

    def _keeper(self) -> int:
        """Choose who solves for a robot that touches this one, perhaps this one itself."""
        params = self._program.params
        if params.solver == "base":
            return 0
        near = [
            (contacts, keeper)
            for keeper, contacts in self._keepers.items()
            if contacts <= params.reach and not (keeper == self.number and self._is_busy)
        ]
        return min(near)[1] if near else self.number

    def _begin(self, joiner: int, walked: int | None = None) -> None:
        """Begin to solve for a robot; a walk may go on after that."""
        self._search = _Search(joiner, {joiner: 0}, walked=walked)
        self._advance()

    def _advance(self) -> None:
        """Ask the robots a step farther; solve once there are no more."""
        search = self._search
        params = self._program.params
        while search is not None and not search.waiting:
            hops = 1 if search.is_review else params.hops
            if search.current == hops or not self._widen(search):
                self._search = None
                self._solve(search)
                return
            search.current += 1
            self._tries = 0
            there = {n for n, step in search.step.items() if step == search.current}
            search.waiting = {n for n in there if not self._is_current(n)}
            if search.is_review:
                search.waiting = there - {self.number}
            if search.waiting:
                self._ask(search.waiting)

    def _is_current(self, number: int) -> bool:
        """Judge whether nothing is to be asked of a robot: it lets this one know as it moves."""
        its = self._of(number)
        return number == self.number or (its.is_current and bool(its.line))

    def _widen(self, search: _Search) -> bool:
        """Number the robots a step farther; return whether there are any."""
        last = [n for n, step in search.step.items() if step == search.current]
        further = {other for n in last for other in self._of(n).sharing} - search.step.keys()
        room = self._program.params.asked + 1 - len(search.step)
        if search.is_review:
            room = len(further)
        # The last that joined are the least known.
        chosen = sorted(further, reverse=True)[: max(room, 0)]
        search.step |= dict.fromkeys(chosen, search.current + 1)
        return bool(chosen)

    def _ask(self, robots: Iterable[int]) -> None:
        """Ask robots for what this one does not hold of them."""
        parts = {}
        for number in sorted(robots):
            its = self._of(number)
            asked = wire.Asked(not its.line, self._checksum(number), its.since)
            parts[number] = wire.write_question(asked)
        self._say("ask", b"", parts)

    def _answer(self, asker: int, part: bytes) -> None:
        """Answer what a robot asked."""
        asked, mine = wire.read_question(part), self.known[self.number]
        self._watchers.add(asker)
        answer = wire.Writer(self._program.params.bits)
        is_moved = mine.place is not None and asked.checksum != self._checksum(self.number)
        answer.number(is_moved, 1)
        wire.write_span(answer, mine.span)
        # Robots that joined before this one are in its line.
        since = max(asked.since, self.number + 1)
        wire.write_numbers(answer, (other for other in mine.sharing if other >= since))
        if mine.place is not None and is_moved:
            wire.write_place(answer, mine.place)
            if self._exchanges:
                wire.write_candidates(answer, mine.candidates)
        line = mine.line if asked.wants_line else b""
        self._say("answer", answer.to_bytes() + line, {asker: b""})

    def _hear_answer(self, message: Message) -> None:
        its = self._of(message.sender)
        answer = wire.read_answer(message.common, self._program.params.bits, self._exchanges)
        self._hold_line(message.sender, answer.line)
        its.sharing.update(answer.sharing)
        its.span = answer.span
        if answer.place is not None:
            its.place, its.candidates = answer.place, answer.candidates
        if self.number in message.parts:
            its.is_current = True
            if self._search is not None:
                # Its notice may have come after the question.
                its.since = self._search.joiner
        # By radio, robots hear answers that others asked for.
        if self._search is not None:
            self._search.answered.add(message.sender)
            self._check_off()

    def _hear_ask(self, message: Message) -> Message:
        """Answer a question, or hand out lines as one passes by."""
        if self.number in message.parts:
            self._answer(message.sender, message.parts[self.number])
        elif self._program.params.channel == "touch":
            return self._hand_out(message)
        return message

    def _hand_out(self, message: Message) -> Message:
        """Answer with lines that this robot holds of others that are asked for them."""
        found, parts = b"", {**message.parts}
        for number, part in message.parts.items():
            line = self.known[number].line if number in self.known else b""
            asked = wire.read_question(part)
            if asked.wants_line and line:
                found += number.to_bytes(_SIZE, "big") + len(line).to_bytes(_SIZE, "big") + line
                parts[number] = wire.write_question(asked._replace(wants_line=False))
        if found:
            self._say("lines", b"", {message.sender: found})
        return message._replace(parts=parts)

    def _hear_lines(self, message: Message) -> None:
        for lines in message.parts.values():
            part = lines
            while part:
                number, size = (int.from_bytes(part[k : k + _SIZE], "big") for k in (0, _SIZE))
                self._hold_line(number, part[2 * _SIZE :][:size])
                part = part[2 * _SIZE + size :]
        if self._search is not None:
            self._check_off()

    def _hold_line(self, number: int, line: bytes) -> None:
        """Take in what a robot sensed, if anything was sent of it."""
        if line:
            self._of(number).line = line
            self._of(number).sharing |= self._program.partners(line)

    def _check_off(self) -> None:
        """Wait no longer for robots that have answered and whose lines are here."""
        search = self._search
        if search is not None and search.waiting:
            search.waiting -= {n for n in search.answered if self._of(n).line}
            self._advance()

    def _hold_place(self, number: int, part: bytes) -> None:
        answer, its = wire.read_result(part, self._program.params.bits), self._of(number)
        # Bodies join those of lower numbers: who places it in a higher one has not heard of that.
        if answer.place is None or 0 <= its.body < answer.place.body:
            return
        its.place, its.is_surprising = answer.place, answer.is_surprising
        if len(answer.candidates):
            its.candidates = answer.candidates

    def _checksum(self, number: int) -> int:
        """Check what this robot holds of one, against what that holds of itself."""
        its = self._of(number)
        if its.place is None:
            return 0
        text = wire.Writer(self._program.params.bits)
        wire.write_place(text, its.place)
        return zlib.crc32(text.to_bytes()) % int(2**wire.CHECK - 1) + 1

    def _placed(self) -> dict[int, Known]:
        """List the robots whose lines and places are held."""
        return {n: each for n, each in self.known.items() if each.line and each.place is not None}

    def _solve(self, search: _Search) -> None:
        """Solve for a robot with what is held, and send new places."""
        if search.is_review:
            held = self._placed()
            near = {n: each for n, each in held.items() if n in search.step or not n}
            mine = _of_body(near, self.known[self.number].body)
            self._send(self.number, LocalSwarm(self._program, mine).relax(self.number))
        elif search.walked is None:
            self._place(search)
        else:
            self._place_again(search)
        if search.walked is not None:
            self._go_on(search.walked)

    def _place_again(self, search: _Search) -> None:
        """Solve for this robot, which was alone, and move what hangs on it to the body it is in."""
        mine = self.known[self.number]
        before, mine.place = mine.place, None
        self._place(search)
        if before is None or mine.place is None:
            return
        if mine.body == self.number:
            mine.place = before
        else:
            shift = mine.place.position - before.position
            self._joined = wire.write_shift(
                wire.JointShift(
                    self.number, shift, body=before.body, joined=mine.body, sd=mine.place.sd
                ),
                self._program.params.bits,
            )

    def _place(self, search: _Search) -> None:
        """Solve for a robot that joined."""
        joiner = search.joiner
        held = self._placed()
        self._kept.add(joiner)
        near = {n: each for n, each in held.items() if n in search.step or self._is_current(n)}
        near[joiner] = self.known[joiner]
        if 0 in held:
            near[0] = held[0]
        partners = self._program.partners(near[joiner].line) & near.keys()
        bodies = sorted({near[n].body for n in partners})
        mine = _of_body(near, min(bodies, default=0)) | {joiner: near[joiner]}
        swarm = LocalSwarm(self._program, mine)
        if swarm.is_floating(joiner):
            swarm.body = joiner
        anew = near[joiner].place is None
        solved = swarm.solve(joiner, anew=anew, everywhere=self._has_grown(len(near)))
        if swarm.body == joiner:
            solved.places[joiner] = solved.places[joiner]._replace(sd=0.0)
        self._send(joiner, solved)
        if swarm.body and joiner == self.number and self._parent is not None:
            # Who solves for itself sent no line.
            self._say("child", b"", {self._parent: b""})
        for body in bodies[1:]:
            self._close(joiner, near, body)

    def _close(self, joiner: int, near: Mapping[int, Known], body: int) -> None:
        """Let a body join that of a robot which touches both, and solve for those near it."""
        own, other = near[joiner].body, _of_body(near, body)
        line = near[joiner].line
        touching = sorted(o for _, o, _ in self._program.decoded(line).contacts)
        # By radio, messages reach robots that it touched on its way, too.
        ways = [n for n in (*touching, *sorted(self._program.partners(line))) if n in near]
        parent, child = (next(n for n in ways if near[n].body == b) for b in (own, body))
        lost = replace(near[joiner], place=None)
        places = LocalSwarm(self._program, other | {joiner: lost}).places_of(joiner)
        both = LocalSwarm(self._program, _of_body(near, own) | other)
        shift, sd = both.closing(joiner, other.keys(), places)
        content = wire.write_shift(
            wire.JointShift(self.number, shift, body=body, joined=own, sd=sd),
            self._program.params.bits,
        )
        found = wire.read_shift(content, self._program.params.bits)
        for number, its in self.known.items():
            # Who has not heard of it by then is asked again.
            its.is_current &= its.body != body
            self._join_body(number, found)
        at = wire.write_pair(parent, child)
        if joiner == self.number:
            self._hang(at, content)
        else:
            self._say("hang", content, {joiner: at})
        solved = LocalSwarm(self._program, _of_body(near, own)).solve(
            joiner, anew=False, everywhere=True
        )
        self._send(joiner, solved)

    def _send(self, joiner: int, solved: Solved) -> None:
        """Send robots their new places."""
        # Thinking costs a robot energy, too.
        self.operations += solved.operations
        parts = {}
        for number, place in solved.places.items():
            part = wire.Writer(self._program.params.bits)
            part.number(number == joiner and self._exchanges, 1)
            part.number(number in solved.surprising, 1)
            wire.write_place(part, place)
            if number == joiner and self._exchanges:
                wire.write_candidates(part, solved.candidates)
            parts[number] = part.to_bytes()
            # The robot holds what others hear, rounded as it is.
            self._hold_place(number, parts[number])
            self._of(number).is_current = True
        if parts.pop(self.number, None):
            self._follow(self.number, 0)
        self._say("place", b"\1", parts)
        self._send_shifts(solved)

    def _send_shifts(self, solved: Solved) -> None:
        """Let branches move as one."""
        for number, shift in solved.along.items():
            its = self._of(number)
            if its.place is not None:
                its.place = its.place._replace(position=its.place.position + shift)
        if self.number in solved.along:
            self._warn(self.number)
        for first, (shift, parted) in solved.shifts.items():
            content = wire.write_shift(
                wire.JointShift(self.number, shift, parted), self._program.params.bits
            )
            if first == self.number:
                self._pass_shift(content)
            else:
                self._say("branch", content, {first: b""})

    def _has_grown(self, robots: int) -> bool:
        """Count one more robot solved for, and judge whether all that are held are due."""
        self._solved += 1
        is_due = self._solved - self._annealed >= self._program.params.growth * robots
        if is_due:
            self._annealed = self._solved
        return is_due

    def _forget(self) -> None:
        """Drop lines beyond as many as there is room for.

        Those that are not current go first, then those of the robots heard of first.
        """
        lines = [n for n, each in self.known.items() if each.line and n != self.number]
        busy = {} if self._search is None else self._search.step
        # Those asked about now are needed.
        beyond = max(len(lines) - self._program.params.robots, 0)
        spare = sorted((n for n in lines if n not in busy), key=self._is_current)
        for number in spare[:beyond]:
            del self.known[number]


def _of_body(near: Mapping[int, Known], body: int) -> dict[int, Known]:
    """Choose robots that are placed relative to a body."""
    return {n: each for n, each in near.items() if each.body == body}


class NearAnnealed(NamedTuple):
    """The best of several chains, for the K robots that moved."""

    state: State
    """All robots."""

    sd: Reals
    """Standard deviation of each position, over the chains too [R], shape (K,)."""


def annealed(
    layers: LocalLayers, moving: Ints, params: DistributedParams, number: int
) -> NearAnnealed:
    """Anneal some robots from where they are, and keep the likeliest end.

    Args:
        layers: The robots that are held.
        moving: Those that may move, ascending, shape (K,).
        params: Settings.
        number: Number of the robot that is solved for, which kicks depend on.
    """
    problem = layers.neighborhood(moving)
    begin, turn = layers.state[:2]
    view = view_near(layers, moving, problem, params)
    seed = (params.seed * 4_099 + number) % 2**31
    [chains] = Annealer([view], seed=seed, hold=1, is_short=True).run(frames=2)
    starts = [State(each.copy(), turn.copy()) for each in (begin, *chains.last)]
    found = [problem.refine(start) for start in starts]
    reach = problem.shapes.reach
    score = np.array([each[1].cost - _gain(layers, moving, each[0], reach) for each in found])
    best = int(score.argmin())
    state = found[best][0]
    # Ends that are nearly as likely as the best one make its position uncertain.
    weight = boltzmann_weights(score, _TEMPERED)
    away = [((each.position - state.position)[moving] ** 2).sum(axis=1) for each, _ in found]
    spread = weight @ np.array(away)
    return NearAnnealed(state, np.sqrt(spread))


def _gain(layers: LocalLayers, moving: Ints, state: State, reach: float) -> float:
    """Compute what some robots gain by their extension [1], up to the reach of a contact [R]."""
    total = 0.0
    for k in moving.tolist():
        partners = layers.blocks[k].partners
        if len(partners):
            apart = np.linalg.norm(state.position[partners] - state.position[k], axis=1)
            # Beyond its reach a contact would give way, and the robot would gain by that.
            total += 2.0 * EXTENSION * float(np.minimum(apart, reach).mean())
    return total


def view_near(
    layers: LocalLayers, moving: Ints, problem: NearCost, params: DistributedParams
) -> ChainView:
    """Describe what a robot heard as chains see it; turns of orientations are noise here."""
    begin, robots = layers.state.position, len(layers.blocks)
    shapes, table = problem.shapes, problem.table
    moves = np.isin(np.arange(robots), moving[moving > 0])
    robust = ROBUST_SD**-2 * params.robust
    links = _links_of(layers.blocks_about(moving), table, robots)
    planes = _planes_of(table)
    # A subtree moves if all its robots do, and nothing measures where they are.
    stops = planes.along(robots) | ~moves[:, None]
    return ChainView(
        arm=shapes.arm,
        begin=np.tile(begin, (params.chains, 1, 1)),
        moves=moves,
        repels=params.non_overlap & ~np.isin(np.arange(robots), [*shapes.gone]),
        sigma=cooled(params.start_sigma, ANNEALING.coldest, params.steps, 1),
        robust=robust,
        yaw_precision=0.0,
        links=links,
        planes=planes,
        plane_robust=np.full(len(planes.robot), robust),
        forest=find_subtrees(
            np.column_stack([links.robot, links.other]), np.zeros(1, np.int64), robots
        ),
        stops=stops,
    )


def _links_of(blocks: list[Block], table: Table, robots: int) -> Links:
    """Lay out the pairs of some blocks, which are those of the table."""
    count = np.diff(table.block[:, BlockStart.ROW])
    first = np.repeat(table.block[:-1, BlockStart.MEMBERS], count)
    row = np.arange(len(first)) - np.repeat(table.block[:-1, BlockStart.ROW], count)
    kind = table.number[:, RowLabel.KIND]
    is_pair = kind != COORDINATE
    begins = (table.number[:, RowLabel.FIRST] == row)[is_pair]
    at = np.flatnonzero(is_pair)[begins]
    tables = [each for b in blocks for each in (b.rows.distances, b.rows.offsets)]
    final = np.repeat(
        [b.rows.odometry.final[-1] for b in blocks for _ in range(2)],
        [len(each.stance) for each in tables],
    )
    stance = np.concatenate([each.stance for each in tables])
    dock = np.concatenate([each.dock for each in tables])
    is_final = ((stance == final) & (dock != CENTER))[begins]
    is_offset = kind[at] == OFFSET
    vector = np.zeros((len(at), _AXES))
    vector[is_offset] = np.concatenate([b.rows.offsets.vector[::_AXES] for b in blocks])
    real = table.real[at]
    total = np.bincount(np.cumsum(begins) - 1, table.real[is_pair, RowValue.VARIANCE], len(at))
    robot = table.member[first[at]].astype(np.int64)
    other = table.member[first[at] + table.number[at, RowLabel.MEMBER]].astype(np.int64)
    share = is_final / fewest_contacts(np.column_stack([robot, other]), is_final, robots)
    return Links(
        robot=robot,
        other=other,
        is_final=is_final,
        is_offset=is_offset,
        is_touch=np.zeros(len(at), np.bool_),
        arms=real[:, RowValue.ARM : RowValue.TAIL]
        - real[:, RowValue.OTHER_ARM : RowValue.VALUE]
        - vector,
        length=real[:, RowValue.VALUE],
        variance=real[:, RowValue.VARIANCE],
        across=np.where(is_offset, 0.5 * (total - real[:, RowValue.VARIANCE]), 0.0),
        extension=np.where(is_offset, 0.0, EXTENSION * share),
        levers=np.zeros((len(at), 4)),
        vector=vector,
        candidates=np.empty((0, blocks[0].arm.shape[0], 2 * _AXES)),
    )


def _planes_of(table: Table) -> Planes:
    """Turn the coordinates of a table into planes."""
    at = np.flatnonzero(table.number[:, RowLabel.KIND] == COORDINATE)
    own = np.repeat(
        table.member[table.block[:-1, BlockStart.MEMBERS]], np.diff(table.block[:, BlockStart.ROW])
    )
    real = table.real[at]
    direction = real[:, RowValue.AXIS : RowValue.ARM]
    value = real[:, RowValue.VALUE] - (direction * real[:, RowValue.ARM : RowValue.TAIL]).sum(
        axis=1
    )
    return Planes(
        robot=own[at].astype(np.int64),
        direction=direction,
        point=direction * value[:, None],
        walk=np.zeros((len(at), 2)),
        precision=1.0 / real[:, RowValue.VARIANCE],
    )
