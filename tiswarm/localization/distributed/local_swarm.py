"""How a robot solves for the robots near it, with what it holds of them.

The layers of `online` run on the robots that it holds alone. Rows about robots that it does not
hold are left out: where rows of a block have noise in common, that of the rest stays as it is.
Lengths in R, relative to the anchor.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.normal_equations import damped, inverted
from tiswarm.localization.cost.cost import State, boltzmann_weights
from tiswarm.localization.distributed import wire
from tiswarm.localization.distributed.annealing import TEMPERED, annealed, extension_gain
from tiswarm.localization.distributed.memory import Record
from tiswarm.localization.distributed.motions import MotionCost, motions
from tiswarm.localization.distributed.program import ANSWERS, Program
from tiswarm.localization.distributed.settings import DistributedParams
from tiswarm.localization.online.layers import Joiner, LocalLayers, measured
from tiswarm.localization.online.neighborhood import Block, NearLinear
from tiswarm.localization.online.settings import CANDIDATES, NEIGHBORS
from tiswarm.measurements.equations import AXES
from tiswarm.records.sensing_file import SensingLogBuilder
from tiswarm.records.sensing_format import RobotLine

_OF_ROW = 40
"""Operations for the residual of a row and its derivatives [1]."""
_OF_PAIR = 10
"""Operations to find whether two robots are near [1]."""
_LEVEL = [1.0, 0.0, 0.0, 0.0]


class LocalSolution(NamedTuple):
    """What a robot that solved knows of robots near it."""

    places: dict[int, wire.Whereabouts]
    """Places of robots that moved, and of the one that was solved for, by number."""

    surprising: set[int]
    """Those of them whose rows and overlaps chance does not explain."""

    candidates: Reals
    """As in `Record`, of the one that was solved for."""

    operations: float
    """Additions and multiplications that it took, about."""

    shifts: Mapping[int, tuple[Reals, list[int]]] = {}
    """By a robot, the shift of all that hang on it [R], and those that do not take part."""

    along: Mapping[int, Reals] = {}
    """Shift of each robot that does and is held [R], by its number."""


class LocalSwarm:
    """The robots that one robot holds lines of, numbered anew in join order; 0 is the anchor."""

    def __init__(self, program: Program, records: Mapping[int, Record]) -> None:
        """Measure the rows of robots among each other, and put them where they are said to be."""
        with_lines = {n: record for n, record in records.items() if record.line}
        self.numbers: Ints = np.array(sorted({0, *with_lines}), np.int64)
        self._index = {number: k for k, number in enumerate(self.numbers.tolist())}
        self._program = program
        self._params = _precise(program, records)
        self.layers = LocalLayers(program.docks, self._params)
        position, turn, sd = (np.zeros((len(with_lines) + 1, AXES)) for _ in range(3))
        self._stays = np.zeros(len(self.numbers), np.bool_)
        self._spans: list[tuple[int, int] | None] = []
        self._opened: dict[int, Joiner] = {}
        self.body = 0
        lines = {n: record.line for n, record in with_lines.items()}
        for number, k in self._index.items():
            record = with_lines.get(number, Record())
            # A robot whose other rows are not here is held by where it is.
            is_whole = record.place is None or record.sharing <= with_lines.keys()
            self._stays[k] = not is_whole and number > 0
            block = self._block(number, lines, record.place if self._stays[k] else None)
            touching = self._touching(record.line)
            self._spans.append(record.span)
            if self._stays[k]:
                self._opened[k] = Joiner(self._block(number, lines, None), touching)
            self.layers.append(Joiner(block, touching))
            self.layers.places[k] = record.candidates
            if record.place is not None:
                position[k], turn[k], sd[k, 0] = record.place[:3]
                self.body = record.place.body
            if record.is_gone:
                self.layers.gone.add(k)  # others may stand in its place
        if self.body:
            self.layers.gone.add(0)  # the anchor is elsewhere
        count = len(self.numbers)
        self.layers.state = State(position[:count], turn[:count])
        self.layers.sd = sd[:count, 0]

    def solve(self, number: int, *, anew: bool, everywhere: bool = False) -> LocalSolution:
        """Solve for a robot and those near it.

        Args:
            number: The robot.
            anew: Whether to look for its place among all that its rows allow.
            everywhere: Whether to anneal all robots.
        """
        layers = self.layers
        k = self._index[number]
        before = self._state_copy()
        sd_before = layers.sd.copy()
        # A robot that has a place keeps it, unless those near it move.
        layers.solve_near(k, layers.place(k) if anew else None)
        moving = np.arange(len(self.numbers)) if everywhere else layers.near(k)
        # Chains need a row that pulls.
        if self._program.params.chains and layers.blocks_about(moving):
            best = annealed(layers, moving, self._program.params, number)
            layers.state = best.state
            self._revise_sd(sd_before, moving, best.sd)
        return self._solution(number, before, self._operations(k, anew=anew))

    def _state_copy(self) -> State:
        """Copy where robots are, and their turns."""
        return State(*(array.copy() for array in self.layers.state[:2]))

    def _revise_sd(self, sd_before: Reals, moving: Ints, spread: Reals) -> None:
        """Set the sd of robots that moved: what others err by counts, and how far chains differ."""
        layers = self.layers
        stays = self._stays[moving]
        # Where a robot stays by what others solved, it is as uncertain as they said.
        layers.sd[self._stays] = sd_before[self._stays]
        free = moving[~stays]
        if len(free) and layers.blocks_about(free):
            linear = layers.neighborhood(free).linearized(layers.state)
            layers.sd[free] = np.hypot(spread[~stays], linear.sd())

    def _solution(self, number: int, before: State, operations: float) -> LocalSolution:
        """List the robots that moved, and the one that was solved for."""
        layers = self.layers
        k = self._index[number]
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
        return LocalSolution(
            dict(zip(number_of, places, strict=True)),
            {n for n, is_surprise in zip(number_of, surprising, strict=True) if is_surprise},
            layers.places[k],
            operations,
        )

    def relax(self, number: int) -> LocalSolution:
        """Move robots whose rows are all held to the minimum, and what hangs on each as one.

        Without the second a structure that is to shift as a whole would be held where it is by all
        robots that are not here.
        """
        layers = self.layers
        robots = len(self.numbers)
        before = self._state_copy()
        is_free = ~self._stays & (self.numbers > 0)
        free = np.flatnonzero(is_free)
        opened = layers.with_other(self._opened)
        blocks = opened.blocks_about(free)
        if not blocks:
            return self._solution(number, before, 0.0)
        root, parted = self._branches(is_free)
        basis = motions(free, root)
        problem = MotionCost(opened.neighborhood(np.arange(robots), blocks), basis)
        state = before
        linear = problem.linearized(before)
        for _ in range(NEIGHBORS.rounds):
            trial, _ = problem.moved(state, linear, NEIGHBORS.radius)
            at_trial = problem.linearized(trial)
            if at_trial.cost > linear.cost - NEIGHBORS.settled:
                break
            state, linear = trial, at_trial
        stays = self._stays & (root < 0)
        layers.sd[free] = self._sd(linear, basis, stays)[free]
        shifts: dict[int, tuple[Reals, list[int]]] = {}
        along: dict[int, Reals] = {}
        for first in np.unique(root[root >= 0]).tolist():
            members = np.flatnonzero(root == first)
            shift = state.position[members[0]] - before.position[members[0]]
            if np.linalg.norm(shift) > ANSWERS.shifted:
                shift = wire.rounded(shift, self._program.params.bits)
                shifts[int(self.numbers[first])] = shift, self.numbers[parted[first]].tolist()
                along |= dict.fromkeys(self.numbers[members].tolist(), shift)
            state.position[members] = before.position[members]
        layers.state = state
        operations = NEIGHBORS.rounds * (2.0 * AXES * len(free)) ** 3
        solution = self._solution(number, before, operations)
        return solution._replace(shifts=shifts, along=along)

    def _branches(self, is_free: Bools) -> tuple[Ints, dict[int, list[int]]]:
        """Find what hangs on robots that are free to move, by the spans of a walk.

        Returns:
            The last free robot on the way to each other one, -1 if there is none, shape (N,); and
            by this robot the free ones that are next on ways beyond it.
        """
        root = np.full(len(is_free), -1)
        parted: dict[int, list[int]] = {}
        free_spans = {
            k: span for k, span in enumerate(self._spans) if is_free[k] and span is not None
        }
        for k, span in enumerate(self._spans):
            if span is None:
                continue
            enters = span[0]
            above = [j for j, (begin, end) in free_spans.items() if begin < enters < end]
            last = max(above, key=lambda j: free_spans[j][0], default=-1)
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
        layers = self.layers
        k = self._index[number]
        robots = len(self.numbers)
        body = np.array([self._index[n] for n in sorted(members)])
        alone = np.array([k])
        root = np.full(robots, -1)
        root[body] = k
        opened = layers.with_other({j: self._opened[j] for j in body.tolist() if self._stays[j]})
        blocks = opened.blocks_about(np.append(body, k))
        basis = motions(alone, root)
        problem = MotionCost(opened.neighborhood(np.arange(robots), blocks), basis)
        minima = []
        for place in places:
            start = layers.state.position.copy()
            start[body] += start[k] - place
            minima.append(problem.refine(State(start, layers.state.turn)))
        reach = opened.neighborhood(alone).shapes.reach
        score = np.array([
            linear.cost - extension_gain(opened, alone, minimum, reach)
            for minimum, linear in minima
        ])  # fmt: skip
        shift = np.array([
            (minimum.position - layers.state.position)[body[0]] for minimum, _ in minima
        ])  # fmt: skip
        best = int(score.argmin())
        spread = boltzmann_weights(score, TEMPERED) @ ((shift - shift[best]) ** 2).sum(axis=1)
        stays = (root < 0) & (np.arange(robots) != k)
        sd = self._sd(minima[best][1], basis, stays)[body[0]]
        return shift[best], float(np.hypot(sd, np.sqrt(spread)))

    def places_of(self, number: int) -> Reals:
        """List where rows about those that are held allow a robot to be [R], shape (k, 3)."""
        layers = self.layers
        k = self._index[number]
        layers.place(k)
        partners = layers.state.position[layers.blocks[k].partners]
        places: Reals = layers.places[k] + partners.mean(axis=0)
        return places

    def is_floating(self, number: int) -> bool:
        """Judge whether the rows of a robot tie it neither to the world nor to one that is held."""
        rows = self.layers.blocks[self._index[number]].rows
        return not len(rows.neighbor) and rows.places.rank < AXES

    def _sd(self, linear: NearLinear, basis: Reals, stays: Bools) -> Reals:
        """Compute the standard deviation of each robot that moved [R], shape (N,).

        Errors of those that stay, shape (N,), count as a shift that they share.
        """
        robots = len(stays)
        information = damped(basis.T @ linear.information @ basis, NEIGHBORS.open_precision)
        shift = np.zeros((2, robots, AXES, AXES))
        sd = np.where(stays, self.layers.sd, 0.0)
        shift[0] = sd[:, None, None] * np.eye(AXES) / np.sqrt(AXES)
        covariance = inverted(information)
        by_shift = linear.information @ shift.reshape(-1, AXES)
        shared = basis @ covariance @ (basis.T @ by_shift)
        variance = ((basis @ covariance) * basis).sum(axis=1)
        square = (variance + (shared**2).sum(axis=1)).reshape(2, robots, AXES)
        deviation: Reals = np.sqrt(square[0].sum(axis=1))
        return deviation

    def _operations(self, k: int, *, anew: bool) -> float:
        """Count what a search for candidates, linear problems and chains take, about."""
        params = self._program.params
        near = self.layers.near(k)
        rows_of_one = len(self.layers.blocks[k])
        rows = [len(self.layers.blocks[j]) for j in near.tolist()]
        search = 0
        if anew:
            search = CANDIDATES.starts * CANDIDATES.rounds * _OF_ROW * rows_of_one**2
        linear = sum(_OF_ROW * m**2 for m in rows) + (2 * AXES * len(near)) ** 3 / 3
        step = _OF_ROW * 2 * sum(rows) + _OF_PAIR * len(near) * len(self.numbers)
        rounds = NEIGHBORS.rounds * (1 + params.chains)
        return float(search + rounds * linear + params.chains * params.steps * step)

    def _block(
        self, number: int, lines: Mapping[int, bytes], stays: wire.Whereabouts | None
    ) -> Block:
        """Measure the rows of a robot about those that are held, and where it stays, if it does."""
        members = [0]
        if number:
            partners = self._program.partners(lines[number]) & lines.keys()
            members = [*sorted(partners | {0}), number]
        place = None if stays is None else tuple(stays.position.tolist())
        sent = tuple(lines.get(n, b"") for n in members)
        block = _measured(self._program, self._params, sent, place)
        return replace(block, members=np.array([self._index[n] for n in members]))

    def _touching(self, line: bytes) -> set[tuple[int, int, int]]:
        """List docks of a robot in contact with those of robots that are held."""
        if not line:
            return set()
        return {
            (dock, self._index[robot], robot_dock)
            for dock, robot, robot_dock in self._program.decoded(line).contacts
            if robot in self._index
        }


def _precise(program: Program, records: Mapping[int, Record]) -> DistributedParams:
    """Return the settings for layers, in which rounding of what was sent counts as noise."""
    params = program.params
    positions = [record.place.position for record in records.values() if record.place is not None]
    farthest = float(np.abs(positions).max()) if positions else 1.0
    rounding = wire.rounding_sd(farthest, params.bits)
    return replace(
        params,
        contact_sd=float(np.hypot(params.contact_sd, rounding)),
        height_sd=float(np.hypot(params.height_sd, rounding)),
    )


def with_fix(line: RobotLine, center: Reals, sd: float) -> RobotLine:
    """Add to a line that the robot is where it is, with an sd of each coordinate [log unit]."""
    axes = np.eye(AXES)
    fixes = [(*axis.tolist(), float(axis @ center), sd) for axis in axes]
    return line.model_copy(update={"fixes": [*(line.fixes or []), *fixes]})


_ANCHOR = RobotLine.model_validate({"robot": -1, "orientation_wxyz": _LEVEL, "contacts": []})
"""An anchor whose place alone is available: what robots sensed of it is left out."""


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
        robots[-1] = with_fix(robots[-1], center, ANSWERS.stays_sd * head.dock_radius)
    builder = SensingLogBuilder(head, of_some=True)
    for robot in robots:
        builder.add(robot)
    return measured(*builder.log_of(len(robots) - 1), params).block
