"""The layers of a join that are local: where the new robot may be, and the robots near it.

All that a robot brings as it joins is the rows of its own line, about itself and earlier robots.
Robots have numbers, in join order. Lengths in R, relative to the anchor.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.compute.chi_square import chi_square_sd
from tiswarm.localization.chains.problem import chosen_rows
from tiswarm.localization.cost import ROBUST_SD
from tiswarm.localization.cost.cost import State, boltzmann_weights, moments
from tiswarm.localization.methods import centered
from tiswarm.localization.mixture import CONVERGENCE
from tiswarm.localization.mixture.verdict import extent
from tiswarm.localization.online.neighborhood import (
    Block,
    NearCost,
    NearLinear,
    Shapes,
    block_of,
    candidates,
    extension,
)
from tiswarm.localization.online.settings import CANDIDATES, NEIGHBORS
from tiswarm.localization.settings import ChiSquareParams
from tiswarm.measurements.cues import CUES
from tiswarm.measurements.equations import AXES
from tiswarm.measurements.model import SPACING, Measurements
from tiswarm.measurements.odometry import Odometry
from tiswarm.measurements.turns import Turns
from tiswarm.records.sensing_format import HeaderLine, RobotLine
from tiswarm.records.sensing_log import SensingLog

_LEAST_SD = 1e-9
"""The anchor has no sd to divide by [R]."""


class Joiner(NamedTuple):
    """What a robot brings as it joins."""

    block: Block
    """The rows of its line."""

    touching: set[tuple[int, int, int]]
    """Its docks in contact: its own, an earlier robot, and the dock of that one."""


def measured(log: SensingLog, members: Ints, params: ChiSquareParams) -> Joiner:
    """Measure what one robot sensed.

    Args:
        log: Its log, in which it comes last and all others only stand.
        members: Index of each robot of the log in the whole structure, shape (M,).
        params: Settings.
    """
    log = centered(log)
    rows, _ = chosen_rows(log, params, Odometry(log))
    earlier, earlier_dock, _, dock = log.contacts.T.tolist()
    touching = {*zip(dock, members[earlier].tolist(), earlier_dock, strict=True)}
    return Joiner(block_of(rows, members), touching)


class LocalLayers:
    """N robots with the rows of each, and where they are by now."""

    def __init__(self, docks: int, params: ChiSquareParams) -> None:
        """Begin without robots; each is to have so many docks."""
        self._params = params
        self.blocks: list[Block] = []
        self._touching: list[set[tuple[int, int, int]]] = []
        self.places: list[Reals] = []
        """Where each robot may be, relative to the mean of those it shares rows with [R]."""
        self.state = State(np.empty((0, AXES)), np.empty((0, AXES)))
        self.shift: Reals = np.empty((0, AXES))
        """From the state to the mean of likely states [R], shape (N, 3)."""
        self.sd: Reals = np.empty(0)
        """Standard deviation of each position [R], shape (N,)."""
        self._sharing: list[set[int]] = []
        self._shapes = Shapes.of_none(docks)

    @property
    def gone(self) -> set[int]:
        """Robots that have left; what was sensed of them stays."""
        return self._shapes.gone

    @property
    def mean(self) -> Reals:
        """Mean of likely states [R], shape (N, 3)."""
        mean: Reals = self.state.position + self.shift
        return mean

    def append(self, robot: Joiner) -> None:
        """Make room for a robot that is nowhere yet."""
        number = len(self.blocks)
        block, touching = robot
        self.blocks.append(block)
        self._touching.append(touching)
        self._sharing.append(set())
        self.places.append(np.empty((0, AXES)))
        for partner in block.partners.tolist():
            self._sharing[partner].add(number)
            self._sharing[number].add(partner)
        zero = np.zeros((1, AXES))
        self.state = State(
            np.concatenate([self.state.position, zero]),
            np.concatenate([self.state.turn, zero]),
        )
        self.shift = np.concatenate([self.shift, zero])
        self.sd = np.append(self.sd, 0.0)
        self._shapes = self._shapes.with_robot(block.arm, block.turn_sd, touching)

    def with_other(self, robots: Mapping[int, Joiner]) -> "LocalLayers":
        """Return layers in which some robots sensed something else; all are where they were."""
        layers = LocalLayers(self._shapes.arm.shape[1], self._params)
        for number, before in enumerate(map(Joiner, self.blocks, self._touching)):
            layers.append(robots.get(number, before))
        layers.places = self.places
        layers.state = self.state
        layers.shift = self.shift
        layers.sd = self.sd
        layers.gone.update(self.gone)
        return layers

    def place(self, number: int) -> Reals:
        """Find the likely places of a robot that joined.

        Without partners it is where its coordinates say, or if these leave that open, where the
        last one is.
        """
        block = self.blocks[number]
        position = self.state.position
        if not len(block.rows.neighbor):
            return _by_coordinates(block, position[number - 1])[None]
        places, cost = candidates(
            block, self.state, self._shapes, non_overlap=self._params.cues.non_overlap
        )
        self.places[number] = places - position[block.partners].mean(axis=0)
        likely: Reals = places[cost <= cost[0] + CANDIDATES.likely]
        return likely

    def solve_near(self, number: int, places: Reals | None = None) -> bool:
        """Solve for a robot and those near it; return whether its rows still surprise.

        Args:
            number: The robot.
            places: Where it may be [R], shape (k, 3); where it is if None. The state is that of the
                likeliest one, and what is reported is the mean.
        """
        near = self.near(number, NEIGHBORS.most)
        position = self.state.position
        turn = self.state.turn
        # Each solution has an array of its own: the best one may be where steps begin.
        if places is None:
            starts = position[None].copy()
        else:
            starts = np.tile(position, (len(places), 1, 1))
            starts[:, number] = places
        self.state = State(starts[0], turn)
        if not self.blocks_about(near):  # nothing says where it is
            self.sd[number] = np.linalg.norm(starts[0], axis=1).max() + SPACING
            return False
        problem = self.neighborhood(near)
        # Robots nearby may give way to one place more than to another.
        minima = [problem.refine(State(start, turn)) for start in starts]
        state, linear, weight = self._weighed(minima, number)
        between_variance = 0.0
        surprised = self._is_surprise(problem, linear, number)
        if surprised:
            state, linear = self._exchanged(problem, state, linear, number)
            surprised = self._is_surprise(problem, linear, number)
        elif places is not None:
            centers = np.array([minimum.position[number] for minimum, _ in minima])
            mean, square = moments(weight, centers)
            self.shift[number] = mean - state.position[number]
            between_variance = float(square)
        self.state = state
        self._revise_means(near, linear.sd(), number, is_new=places is not None)
        self.sd[number] = np.hypot(self.sd[number], np.sqrt(between_variance))
        return surprised

    def loose_near(self, number: int) -> Ints:
        """Find robots near one that ranges may leave free to turn, ascending, shape (k,)."""
        near = self.near(number, NEIGHBORS.most)
        if not any(block.rows.is_central.any() for block in self.blocks_about(near)):
            return near[:0]
        far = extent(self.mean)[near]
        linear = self.neighborhood(near).linearized(self.state)
        return near[linear.sd(np.repeat(far, AXES) ** -2.0) >= NEIGHBORS.loose * far]

    def widen(self, rows: Measurements, number: int, loose: Ints) -> None:
        """Set the sd of robots near one that turn freely: a circle is far from its tangent.

        Args:
            rows: Measurements of all robots.
            number: The robot.
            loose: Robots near it that may turn, ascending, shape (k,).
        """
        position = self.state.position
        near = self.near(number, NEIGHBORS.most)
        turns = turns_at(rows, position, loose)
        if not turns:
            return
        square = turns.off(position, self.mean)[near]
        held = turns.motions(position).reshape(len(position), AXES, -1)[near]
        far = np.repeat(extent(self.mean)[near], AXES)
        linear = self.neighborhood(near).linearized(self.state)
        sd_without_turns = linear.sd(far**-2.0, held.reshape(len(far), -1))
        turned_sd = np.sqrt(square + sd_without_turns**2)
        self.sd[near] = np.where(square > 0.0, turned_sd, self.sd[near])

    def _revise_means(self, near: Ints, sd: Reals, number: int, *, is_new: bool) -> None:
        """Set the sd of robots nearby, and shift means as far as likely states still differ."""
        # What is known better now is less uncertain between states, too.
        share = np.minimum(1.0, sd / np.maximum(self.sd[near], _LEAST_SD)) ** 2
        share[near == number] = 1.0
        self.shift[near] *= share[:, None]
        self.sd[near] = sd
        partners = self.blocks[number].partners
        if is_new and len(partners):
            # It hangs on robots that are elsewhere in other likely states.
            self.shift[number] += self.shift[partners].mean(axis=0)

    def surprising(self, robots: Ints) -> list[bool]:
        """Judge of robots, ascending, whether chance does not explain their rows and overlaps."""
        if not self.blocks_about(robots):
            return [False] * len(robots)
        problem = self.neighborhood(robots)
        linear = problem.linearized(self.state)
        return [self._is_surprise(problem, linear, robot) for robot in robots.tolist()]

    def neighborhood(self, robots: Ints, blocks: list[Block] | None = None) -> NearCost:
        """Gather the cost of some robots, ascending by join order, all others where they are.

        Args:
            robots: The robots.
            blocks: Blocks that count; all about these robots if None.
        """
        return NearCost(
            self.blocks_about(robots) if blocks is None else blocks,
            robots,
            self.sd,
            shapes=self._shapes,
            robust_sd=ROBUST_SD if self._params.robust else None,
            non_overlap=self._params.cues.non_overlap,
        )

    def near(self, number: int, most: int | None = None) -> Ints:
        """List robots within two steps of sharing rows with one, ascending.

        Args:
            number: The robot.
            most: Number of robots at most; as many as there are if None.
        """
        near: dict[int, None] = {number: None}
        ring = [number]
        for _ in range(2):
            further = self.with_partners(ring) - near.keys()
            # If not all may move, those nearest in steps do.
            ring = sorted(further, reverse=True)  # the last that joined are the least known
            near |= dict.fromkeys(ring)
        return np.sort([*near][:most])

    def with_partners(self, robots: Iterable[int]) -> set[int]:
        """Return robots, and all that share a row with one of them."""
        chosen = {*robots}
        return chosen.union(*(self._sharing[robot] for robot in chosen))

    def _weighed(
        self, minima: list[tuple[State, NearLinear]], number: int
    ) -> tuple[State, NearLinear, Reals]:
        """Choose the likeliest of the places of a robot, and weigh all, shape (k,)."""
        block = self.blocks[number]
        score = np.zeros(len(minima))
        if len(minima) > 1:
            for k, (state, linear) in enumerate(minima):
                score[k] = linear.cost - extension(block, state, state.position[number, None])[0]
        state, linear = minima[int(score.argmin())]
        return state, linear, boltzmann_weights(score)

    def blocks_about(self, robots: Ints) -> list[Block]:
        """List the blocks with rows about some robots."""
        # Rows about a robot are in its own block and in those of later robots.
        chosen = {*robots.tolist()}
        for robot in robots.tolist():
            chosen |= {later for later in self._sharing[robot] if later > robot}
        return [self.blocks[robot] for robot in sorted(chosen) if len(self.blocks[robot])]

    def _is_surprise(self, problem: NearCost, linear: NearLinear, number: int) -> bool:
        """Judge whether chance explains the rows and the overlaps of a robot."""
        rows = len(self.blocks[number])
        if not rows:
            return False
        square, overlap = problem.missed(linear, number)
        chance = rows + NEIGHBORS.surprise_sd * (chi_square_sd(rows) + 1.0)
        return bool(square > chance or overlap > NEIGHBORS.overlap_sd)

    def _exchanged(
        self, problem: NearCost, state: State, linear: NearLinear, number: int
    ) -> tuple[State, NearLinear]:
        """Try other places of the robot and of those it shares rows with, one after the other."""
        tried = 0
        for robot in [number, *sorted(self._sharing[number], reverse=True)]:
            partners = self.blocks[robot].partners
            # Where robots join at once, one may hold places of another without its rows.
            if not len(self.places[robot]) or not len(partners):
                continue
            touched = state.position[partners].mean(axis=0)
            for place in self.places[robot]:
                if tried == NEIGHBORS.tried:
                    return state, linear
                position = state.position.copy()
                turn = state.turn.copy()
                if np.linalg.norm(touched + place - position[robot]) < SPACING / 2.0:
                    continue
                position[robot] = touched + place
                turn[robot] = 0.0
                trial, trial_linear = problem.refine(State(position, turn))
                tried += 1
                if trial_linear.cost < linear.cost - NEIGHBORS.gain:
                    state = trial
                    linear = trial_linear
                    # The mean was that of places which have lost.
                    self.shift[robot] = 0.0
                    break
        return state, linear


def _by_coordinates(block: Block, start: Reals) -> Reals:
    """Place a robot where its coordinates say [R], at the start if they leave that open, (3,)."""
    rows = block.rows
    if rows.places.rank < AXES:
        return start
    weight = 1.0 / np.sqrt(rows.variance())
    missed = weight * rows.residual(np.tile(start, (rows.robots, 1)))
    place: Reals = start - np.linalg.lstsq(weight[:, None] * rows.places.direction, missed)[0]
    return place


def turns_at(rows: Measurements, position: Reals, loose: Ints) -> Turns:
    """Find how loose robots turn freely at a minimum (N, 3), without rows that it misses."""
    is_missed = rows.residual(position) ** 2 > CONVERGENCE.outlier_sd**2 * rows.variance()
    met = rows.select(~rows.any_of_vector(is_missed))
    return Turns.of(met, position, np.isin(np.arange(len(position)), loose))


def refuse_header(head: HeaderLine) -> None:
    """Raise InputError where all robots share an error that layers cannot solve for."""
    if head.noise is not None and head.noise.yaw_bias_deg:
        problem = "online solves for no bias of yaw; choose method joint for the whole log"
        raise InputError(problem, key="noise.yaw_bias_deg")
    if any(source.shared_sd > 0.0 for source in (head.sources or {}).values()):
        problem = "online knows no errors that measurements share; choose method joint"
        raise InputError(problem, key="sources")


def refuse_line(line: RobotLine) -> None:
    """Raise InputError where a robot sensed what layers cannot use."""
    if line.orientation_wxyz is None:
        problem = "null follows from the lines of later robots, too; choose method joint"
        raise InputError(problem, key="orientation_wxyz")
    for key in {cue.key for cue in CUES if not cue.names_docks}:
        if any(getattr(entry, key) for entry in (line, *(line.stances or []))):
            remedy = f"leave {key} out, or choose joint"
            raise InputError(f"online cannot find docks that are unknown; {remedy}", key=key)
