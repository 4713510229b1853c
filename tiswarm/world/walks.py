"""Structures and the walks of robots on them, as kernels see them, and the calls that end walks.

Robots under great load call others to their aid, through their neighbors. A robot that senses s
sends recruit = min(floor(B^(s/F - 1)), J), and nothing below F. Each of its zones, one for each
dock, passes on the greatest of that, the call that comes in at the same zone less 1, and the one
that comes in at another zone less 2; so a call fades with distance (Swissler and Rubenstein,
ReactiveBuild, DARS 2021).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce
from inspect import signature
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from tiswarm.base.aliases import AnyInts, Bools, Reals
from tiswarm.base.errors import TiswarmError
from tiswarm.base.robot import PlanarRobot, RobotGeometry
from tiswarm.compute.lang import Ref, ti
from tiswarm.compute.user_functions import is_of_library, mistake_of_user, reads, undecorated
from tiswarm.records.terrain import Terrain
from tiswarm.world import climb_kernels
from tiswarm.world.belief_kernels import BelievedWalks, believe_stances
from tiswarm.world.climb_kernels import (
    EDGE,
    FLAT,
    MAX_TOUCHING,
    BelievedDocks,
    Climbers,
    ClimbLimits,
    Laws,
    Manner,
    StructureArrays,
    StructureColumn,
    WalkArrays,
    join_undisturbed,
)
from tiswarm.world.ground.kernels import HEADER
from tiswarm.world.ground.solid import SolidGround, with_zones
from tiswarm.world.history import Walk
from tiswarm.world.params import (
    ClimbParams,
    GrowthParams,
    RecruitParams,
    structure_ground,
    structure_zones,
)

_Slots = NDArray[np.int32]


class Belief(NamedTuple):
    """What the N robots of a structure that has grown so far believe."""

    center: Reals
    """Where their centers are [R], shape (N, 3)."""

    orientation_wxyz: Reals
    """How they stand, body to world, shape (N, 4)."""

    sd: Reals
    """Standard deviation of each center, over all three axes [R], shape (N,); NaN if unknown."""

    sent: Reals = np.array([np.nan])
    """Bytes that each robot has sent for that, shape (N,); NaN where robots send none."""


Turn = Callable[[int, int, int], Reals]
"""Returns the turns from the orientations of a robot to those that it senses, at as many stances:
from the seed, the robot's number and that of the stances; wxyz, shape (stances, 4)."""

_ROUNDING = 1e-6
"""By how much a flip may be longer by rounding, which adds up over a walk [1]."""

_BELIEVED_NEARER = 8
"""Docks overlap where robots believe them, so that so many times as many are listed at a pivot."""


def climb_limits(
    climb: ClimbParams, robot: RobotGeometry, terrain: Terrain | SolidGround, *, by_belief: bool
) -> ClimbLimits:
    """Gather the numbers that do not change during a climb."""
    # No flip meets a dock whose center is farther than this from the pivot.
    reach = float(pdist(robot.dock_offset_body).max()) + robot.spacing
    # A flip swings the center about a dock, up to twice its distance from there.
    arm = float(np.linalg.norm(robot.dock_offset_body, axis=1).max())
    is_planar = isinstance(robot, PlanarRobot)
    return ClimbLimits(
        spacing=robot.spacing,
        contact_gap=climb.contact_gap,
        ground_z=terrain.ground_z,
        left_edge=terrain.left_edge,
        right_edge=terrain.right_edge,
        min_flip=math.radians(climb.min_flip_deg),
        max_flip=math.radians(climb.max_flip_deg),
        revisit_distance=climb.revisit_distance,
        full_turn=2.0 * math.pi,
        reach=reach,
        longest_flip=2.0 * arm * (1.0 + _ROUNDING),
        inverse_edge=1.0 / reach,
        is_planar=is_planar,
        by_belief=by_belief,
    )


def _twists(climb: ClimbParams, robot: RobotGeometry) -> Reals:
    """List the axes through a dock, as `Climbers` has them, shape (axes, 2)."""
    axes = 1 if isinstance(robot, PlanarRobot) else climb.twists
    angles = [math.pi * number / axes for number in range(axes)]
    return np.array([(math.cos(angle), math.sin(angle)) for angle in angles])


def climb_laws(params: GrowthParams) -> tuple[Laws, Reals]:
    """Return what kernels are compiled for, and the numbers of the ground's bodies and zones."""
    score = climb_kernels.goal_distance
    if hasattr(params.rule, "score"):
        score, _ = _score_of(params.rule)
    laws = Laws(score, has_zones=params.no_entry is not None)
    zones = structure_zones(params)
    array: Reals = np.zeros(HEADER)
    ground = structure_ground(params)
    if isinstance(ground, SolidGround):
        laws = laws._replace(users=ground.users, is_flat=False)
        array = ground.array
    return laws, array if zones is None else with_zones(array, zones)


class Spawn(NamedTuple):
    """How a robot starts."""

    center: Reals
    """Center [R], shape (3,)."""

    orientation_wxyz: Reals
    """Body to world, shape (4,)."""

    goal: Reals
    """Place that it climbs toward [R], shape (3,)."""

    patience: int
    """Steps in a row without a new best with which it gives up; 0 to stay where it starts."""

    settles: bool
    """Whether it turns, where it stays, until a third dock touches."""

    robot: int
    """Robots that started in the structure before."""


def structure_rows(params: Sequence[GrowthParams]) -> Reals:
    """List the numbers of S structures as `Climbers` has them, shape (S, P)."""
    names: tuple[str, ...] = ()
    if hasattr(params[0].rule, "score"):
        _, names = _score_of(params[0].rule)
    rows = []
    for of_structure in params:
        ground = structure_ground(of_structure)
        settings = [float(getattr(of_structure.rule, name)) for name in names]
        rows.append([ground.ground_z, ground.left_edge, ground.right_edge, *settings])
    return np.array(rows)


_scores: dict[tuple[object, ...], Any] = {}
"""Scores of rules, as `Laws` have them, by what they read."""

_OF_ENGINE = 3
"""Arguments of a score that are no settings: center, orientation, goal."""


def asked_settings(score: Any) -> tuple[str, ...]:  # noqa: ANN401 - a function of kernels
    """Name the settings of its rule that a score asks for."""
    return tuple(signature(undecorated(score)).parameters)[_OF_ENGINE:]


def _score_of(rule: Any) -> tuple[Any, tuple[str, ...]]:  # noqa: ANN401 - settings, a function
    """Return the score of a rule, and the settings that it asks for.

    It is the same function where it reads the same, so that kernels are compiled once.
    """
    score = rule.score()
    names = asked_settings(score)
    return _scores.setdefault(reads(undecorated(score)), _caller(score, len(names))), names


def _caller(score: Any, count: int) -> Any:  # noqa: ANN401 - functions of kernels
    """Return a score as `Laws` have it, which gives that of a user so many settings."""

    def evaluate(*arguments: object) -> tuple[object]:
        return (score(*arguments),)

    first = StructureColumn.TOTAL

    def scored(center, orientation, goal, of_structure: Ref, s):  # noqa: ANN001, ANN202 - of kernels
        return ti.static(
            evaluate(center, orientation, goal, *[of_structure[s, first + c] for c in range(count)])
        )[0]

    return ti.func(scored)


class Walks:
    """Room for the walks of as many robots as climb at once, one slot each."""

    def __init__(
        self,
        structure_of: _Slots,
        limits: ClimbLimits,
        limits_by_truth: ClimbLimits,
        params: Sequence[GrowthParams],
        robot: RobotGeometry,
        seeds: Sequence[int],
    ) -> None:
        """Reserve memory: about 90 kB a slot at the default cap on flips.

        Args:
            structure_of: Structure that each slot's robots climb, ascending, shape (slots,).
            limits: Numbers that do not change.
            limits_by_truth: The same for robots that do not go by beliefs.
            params: Settings of each structure: how robots climb, and by which rule.
            robot: The robots' shape.
            seeds: Seed of each structure.
        """
        self.laws, ground = climb_laws(params[0])
        self.seed = np.array(seeds, np.uint64)[structure_of]
        self.robot = np.zeros(len(structure_of), np.int32)
        slots = len(structure_of)
        stances = params[0].climb.max_flips + 2
        docks = robot.dock_count
        # Docks do not overlap, so no more fit around a pivot than their volumes allow.
        near_most = math.ceil((limits.reach + robot.dock_radius) ** 3)
        rows = slots
        believed_stances = 0
        if limits.by_belief:
            near_most *= _BELIEVED_NEARER
            rows *= 2
            believed_stances = stances
        self.limits = limits
        self.limits_by_truth = limits_by_truth
        self.docks = docks
        self.climbers = Climbers(
            structure=structure_of,
            first_stance=np.zeros(slots, np.int32),
            goal=np.zeros((slots, 3)),
            manner=np.zeros((slots, Manner.TOTAL), np.int32),
            dock_offset_body=robot.dock_offset_body,
            twist=_twists(params[0].climb, robot),
            near=np.empty((rows, near_most, 3)),
            ground=ground,
            of_structure=structure_rows(params),
        )
        last, best, stay = np.zeros((3, slots), np.int32)
        self.stances = WalkArrays(
            center=np.empty((slots, stances, 3)),
            orientation=np.empty((slots, stances, 4)),
            pivot_dock=np.empty((slots, stances), np.int32),
            touching=np.empty((slots, stances, docks, MAX_TOUCHING), np.int32),
            on_ground=np.empty((slots, stances, docks), np.int32),
            last=last,
            best=best,
            stay=stay,
        )
        self.state, self.disturbed, self.joined = np.zeros((3, slots), np.int32)
        self.flips = np.zeros((slots, believed_stances, 2), np.int32)
        self.turn = np.tile([1.0, 0.0, 0.0, 0.0], (slots, believed_stances, 1))
        self.believed = BelievedWalks(self.stances.center, self.stances.orientation)
        """Where robots believe the stances of their walks; where they are, if they know."""
        if limits.by_belief:
            self.believed = BelievedWalks(
                np.zeros((slots, stances, 3)), np.zeros((slots, stances, 4))
            )

    def restart(
        self, structures: AnyInts, seeds: Sequence[int], params: Sequence[GrowthParams]
    ) -> None:
        """Let robots climb structures, shape (n,), by other seeds and settings of these."""
        for structure, seed in zip(structures.tolist(), seeds, strict=True):
            self.seed[self.climbers.structure == structure] = seed
        self.climbers.of_structure[structures] = structure_rows(params)

    def start(self, slot: int, spawn: Spawn) -> None:
        """Put a new robot in a slot."""
        self.stances.center[slot, 0] = spawn.center
        self.stances.orientation[slot, 0] = spawn.orientation_wxyz
        self.climbers.goal[slot] = spawn.goal
        self.climbers.manner[slot, Manner.PATIENCE] = spawn.patience
        self.climbers.manner[slot, Manner.SETTLES] = spawn.settles
        self.climbers.first_stance[slot] = 0
        self.robot[slot] = spawn.robot

    def climb_by_score(
        self, structures: StructureArrays, believed: BelievedDocks, movers: _Slots
    ) -> None:
        """Let the robots in the slots `movers` walk on from their first stance, by a score.

        Args:
            structures: Structures that they climb.
            believed: Where robots believe the docks of these.
            movers: Slots of the robots, shape (M,).
        """
        try:
            climb_kernels.climb(
                self.limits, movers, self.state, self.flips, *structures.cells, structures.dock,
                structures.relay, *believed.cells, believed.dock, self.turn, *self.climbers,
                *self.stances, self.laws,
            )  # fmt: skip
        except Exception as error:
            mistake = None
            if is_of_library(error):
                mistake = mistake_of_user(error)
            if mistake is None:
                raise
            raise mistake from error

    def believe(
        self,
        structures: StructureArrays,
        believed: BelievedDocks,
        slots: _Slots,
        first: _Slots,
        last: _Slots,
    ) -> None:
        """Put stances of walks where their robots believe them, unless these know.

        Args:
            structures: Structures that they climb.
            believed: Where robots believe the docks of these.
            slots: Slots of the robots, shape (M,).
            first: First stance of each slot to put, shape (slots,).
            last: Last one, shape (slots,).
        """
        if not self.limits.by_belief:
            return
        climbers = self.climbers
        stances = self.stances
        believe_stances(
            self.limits, slots, first, last, structures.dock, believed.dock, self.turn,
            climbers.structure, climbers.dock_offset_body, climbers.of_structure, stances.center,
            stances.orientation, stances.touching, *self.believed,
        )  # fmt: skip

    def sources(self, slots: _Slots, stance: AnyInts) -> AnyInts:
        """List the robots from whose docks climbers take their places, as the kernels do.

        A climber takes its place from a robot that it touches, with the dock about which it turns
        if it can, else from the one that it touched last.

        Args:
            slots: Slots of the climbers, shape (M,).
            stance: Stance of each, shape (M,).

        Returns:
            By dock about which each turns, robots, or -1 where it has touched none, shape (M, n).
        """
        items = self.stances.touching[slots, : int(stance.max(initial=0)) + 1, :, 0]
        touches = (items >= 0).any(axis=2)
        touches &= np.arange(items.shape[1]) <= np.asarray(stance)[:, None]
        latest = items.shape[1] - 1 - touches[:, ::-1].argmax(axis=1)
        item = items[np.arange(len(items)), latest]
        pivot = np.arange(self.docks)
        by_pivot = item[:, (pivot[:, None] + pivot) % self.docks]
        first = (by_pivot >= 0).argmax(axis=2)
        source = np.take_along_axis(by_pivot, first[:, :, None], axis=2)[:, :, 0]
        return np.where(touches.any(axis=1)[:, None], source // self.docks, -1)

    def refuse_overlaps(self, movers: _Slots) -> None:
        """Raise an error if a robot met more docks than fit around it."""
        if (self.state[movers] == climb_kernels.SCRATCH_FULL).any():
            problem = "more docks than fit stand within one flip of a robot: the structure overlaps"
            raise TiswarmError(problem)

    def join(self, structures: StructureArrays, movers: _Slots, wants: NDArray[np.int32]) -> None:
        """Let movers join whose walks no earlier one disturbs; see `join_undisturbed`.

        Args:
            structures: Structures that they climbed; grow.
            movers: Their slots, ascending, shape (M,).
            wants: Whether each slot's walk ends where it can stay, shape (slots,).
        """
        cells, *docks = structures
        climbed = self.climbers.structure[movers]
        first = np.searchsorted(climbed, np.arange(len(structures.dock) + 1)).astype(np.int32)
        join_undisturbed(
            self.limits, first, movers, wants, self.climbers.dock_offset_body, *cells, *docks,
            *self.stances, self.disturbed, self.joined,
        )  # fmt: skip

    def pass_on(
        self,
        rule: Any,  # noqa: ANN401 - settings of any rule
        call: NDArray[np.int32],
        contacts: AnyInts,
        mute: Bools | None,
    ) -> NDArray[np.int32]:
        """Return what each dock passes on by a rule; see `relay`."""
        if not hasattr(rule, "spread"):
            return relay(call, contacts, docks=self.docks, mute=mute)
        spread: NDArray[np.int32] = rule.spread(call, contacts)
        if mute is not None:
            spread = np.where(np.repeat(mute, self.docks), 0, spread)
        return spread

    def touched(self, slot: int) -> AnyInts:
        """List the robots that a walk that is to go on has touched so far, with repeats."""
        items = self.stances.touching[slot, : self.climbers.first_stance[slot] + 1]
        robots: AnyInts = items[items >= 0] // self.docks
        return robots

    def walks(self, slots: AnyInts, rounds: AnyInts) -> list[Walk]:
        """Copy walks out, each with the way back to where the robot stays at its end.

        They are parts of one array each, which all of them fill.

        Args:
            slots: Slots of the robots, shape (k,).
            rounds: Round in which each joined, shape (k,).
        """
        if not len(slots):
            return []
        stances = self.stances
        last = stances.last[slots].astype(np.int64)
        turns_back = 2 * last - stances.best[slots] + 1
        settles = stances.stay[slots] > last
        # A row for each stance of all walks, one walk after the other.
        end = np.cumsum(turns_back + settles)
        start = np.append(0, end[:-1])
        walk = np.repeat(np.arange(len(slots)), end - start)
        place = np.arange(end[-1]) - start[walk]
        row = (slots[walk], last[walk] - np.abs(last[walk] - place))
        is_settled = place == turns_back[walk]
        row[1][is_settled] = last[walk[is_settled]] + 1
        # Out and back between two stances go about the same dock.
        leaves = np.minimum(row[1][:-1], row[1][1:])
        leaves[is_settled[1:]] = row[1][1:][is_settled[1:]]
        pivot = stances.pivot_dock[row[0][:-1], leaves]
        center = stances.center[row]
        orientation = stances.orientation[row]
        # Docks are found cell by cell: sorted, contacts do not depend on the cells.
        touching = np.sort(stances.touching[row], axis=2)
        touched = np.nonzero(touching >= 0)
        robot, dock = np.divmod(touching[touched], self.docks)
        contacts = _by_walk(start, touched[0], place, touched[1], robot, dock)
        on_ground = stances.on_ground[row]
        flat, edge = (
            _by_walk(start, stance, place, dock_of_robot)
            for stance, dock_of_robot in ((on_ground == kind).nonzero() for kind in (FLAT, EDGE))
        )
        walks = []
        for k, (slot, first, stop) in enumerate(zip(slots, start, end, strict=True)):
            flips = self.flips[slot, : last[k] + 1]
            walks.append(
                Walk(
                    center=center[first:stop],
                    orientation_wxyz=orientation[first:stop],
                    pivot_dock=pivot[first : stop - 1],
                    contacts=contacts[k],
                    ground_docks=flat[k],
                    edge_docks=edge[k],
                    planned_robot=flips[:-1, 0] // self.docks,  # and GROUND, -1, stays what it is
                    failed_flips=flips[:, 1].copy(),
                    recruited=bool(self.state[slot] == climb_kernels.RECRUITED),
                    round=int(rounds[k]),
                )
            )
        return walks


def _by_walk(
    start: AnyInts, row: AnyInts, stance: AnyInts, *columns: AnyInts
) -> list[NDArray[np.int32]]:
    """Split rows that begin with a stance among the walks that begin at `start`, shape (k,).

    Args:
        start: First stance of each walk among those of all, ascending, shape (k,).
        row: Stances among those of all walks, ascending, shape (n,).
        stance: What to call each stance of all walks, shape (L,).
        columns: Other columns, shape (n,).
    """
    table = np.column_stack([stance[row], *columns]).astype(np.int32)
    bounds = np.append(np.searchsorted(row, start), len(row)).tolist()
    return [table[a:b] for a, b in pairwise(bounds)]


def note_belief(walks: list[Walk], contacts: AnyInts, error: Reals, sent: Reals) -> None:
    """Note in the walks of the newest how wrong all are [R], (N, 3), and what they sent, (N,)."""
    i, _, j, _ = contacts.T
    center_error = np.linalg.norm(error, axis=1)
    contact_error = np.linalg.norm(error[i] - error[j], axis=1)
    center_rmse = _root_mean_square(center_error)
    contact_rmse = _root_mean_square(contact_error)
    for robot, walk in enumerate(walks):
        if not len(walk.belief):
            columns = [center_rmse, center_error[robot], contact_rmse, sent.mean(), sent.max()]
            walks[robot] = replace(walk, belief=np.array(columns))


def _root_mean_square(errors: Reals) -> float:
    """Compute the root mean square, 0 of no errors."""
    if not len(errors):
        return 0.0
    return float(np.sqrt((errors**2).mean()))


def recruit(sensed: Reals, params: RecruitParams) -> NDArray[np.int32]:
    """Compute the call that each robot makes by its sensed load, shape (N,)."""
    ratio = sensed / params.force_threshold
    # Cap the power where the call exceeds J, to avoid overflow.
    most = np.log(params.recruit_limit + 2.0) / np.log(params.recruit_base)
    call = np.floor(params.recruit_base ** np.minimum(ratio - 1.0, most))
    return np.where(ratio < 1.0, 0, np.minimum(call, params.recruit_limit)).astype(np.int32)


def relay(
    call: NDArray[np.int32], contacts: AnyInts, *, docks: int, mute: Bools | None = None
) -> NDArray[np.int32]:
    """Spread all calls from zero, and return what each dock passes on.

    Args:
        call: Call that each robot makes by its sensed load, shape (N,).
        contacts: Docks that touch, rows of (dock, dock) as docks i + k, shape (C, 2).
        docks: Docks of a robot.
        mute: Robots that pass nothing on, shape (N,).

    Returns:
        Shape (docks N,).
    """
    call_of_dock = np.repeat(call, docks)
    passed_on = call_of_dock
    if not call.any():
        return passed_on
    receiver, sender = np.concatenate([contacts, contacts[:, ::-1]]).T
    while True:
        incoming = np.zeros_like(passed_on)
        sent = passed_on[sender]
        is_passed_on = sent > 1  # nothing is left of others
        np.maximum.at(incoming, receiver[is_passed_on], sent[is_passed_on])
        # The greatest of all zones may stand for the others': in its own zone the -1 prevails.
        greatest = np.repeat(reduce(np.maximum, incoming.reshape(-1, docks).T), docks)
        spread = np.maximum(call_of_dock, np.maximum(incoming - 1, greatest - 2))
        if mute is not None:
            spread[np.repeat(mute, docks)] = 0
        if np.array_equal(spread, passed_on):
            return passed_on
        passed_on = spread
