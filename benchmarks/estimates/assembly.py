"""Puts robots together by a plan: rings, stars, ladders, arches, lattices in a plane.

A plan says which robots touch and about where they are. Gauss-Newton steps then move and turn the
robots until the docks of each contact are D apart and no other docks are near. Lengths in R.
"""

from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from tests import structures
from tiswarm.base.aliases import Ints, Reals
from tiswarm.records.sensing_log import KNOWN_SD, SensingLog

SPACING = 2.0
"""D: distance of the centers of two docks that touch."""

CLEAR = 0.05
"""Distance beyond D that docks without contact keep."""

PLANE_SD = 0.01
"""Standard deviation of the plane of planar robots in their logs."""

_LEAST_OFFSET = 1.506
_STRETCH = 1.8
"""Distance of neighbors beyond D before the first step, in distances from center to dock."""

_SPREAD = 0.12
"""Standard deviation of a robot's place in a plan along each axis, in distances of neighbors."""

_ROUNDS, _LONGEST, _TRIES, _TURNS = 200, 1.0, 8, 60
_EXACT, _DAMPING = 1e-9, 1e-3

Made = tuple[SensingLog, Reals]
"""What was sensed, without noise, and the true centers [R], shape (N, 3)."""


class CannotBuildError(Exception):
    """No try put the robots of a plan together."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Which robots touch, and about where they are."""

    place: Reals
    """Centers, in distances of neighbors, shape (N, 3)."""

    pairs: Ints
    """Pairs of robots in contact, the earlier one first, shape (C, 2)."""

    known: tuple[int, ...] = ()
    """Robots beside the first whose positions are known."""

    planar: bool = False
    """Whether all robots are in the plane y = 0."""


def dock_offsets(docks: int, *, planar: bool = False) -> Reals:
    """Place docks evenly on a circle in the x-z plane, or over a sphere, shape (docks, 3)."""
    angle = 2.0 * np.pi * np.arange(docks) / docks
    unit = np.column_stack([np.sin(angle), 0.0 * angle, np.cos(angle)])
    if not planar:
        unit = structures.docks_around(docks, 1.0)
    return max(_LEAST_OFFSET, (SPACING + CLEAR) / float(pdist(unit).min())) * unit


def built(plan: Plan, docks: int, rng: np.random.Generator) -> Made:
    """Put together the robots of a plan, the first one at the origin.

    Raises:
        CannotBuildError: in no try robots touch as planned and nowhere else.
    """
    arms = dock_offsets(docks, planar=plan.planar)
    apart = SPACING + _STRETCH * float(np.linalg.norm(arms[0]))
    for _ in range(_TRIES):
        spread = _SPREAD * apart * rng.normal(size=plan.place.shape)
        spread[:, 1] *= not plan.planar
        center = apart * plan.place + spread
        turn, contacts = _facing(center, arms, plan, rng)
        if _solve(center, turn, arms, contacts, planar=plan.planar):
            return _log(center - center[0], turn, arms, contacts, plan)
    message = f"{len(plan.place)} robots with {docks} docks cannot be put together"
    raise CannotBuildError(message)


def _drawn(count: int, rng: np.random.Generator, *, planar: bool) -> Rotation:
    if planar:
        return Rotation.from_rotvec(rng.uniform(-np.pi, np.pi, (count, 1)) * [0.0, 1.0, 0.0])
    return Rotation.random(count, rng)


def _facing(
    center: Reals, arms: Reals, plan: Plan, rng: np.random.Generator
) -> tuple[list[Rotation], Ints]:
    """Turn robots until docks face their partners; choose the docks of contacts, shape (C, 4)."""
    contacts = plan.pairs[:, [0, 0, 1, 1]].copy()
    turns = []
    for robot in range(len(center)):
        row, side = np.nonzero(plan.pairs == robot)
        toward = center[plan.pairs[row, 1 - side]] - center[robot]
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        tried = []
        drawn = _drawn(_TURNS, rng, planar=plan.planar)
        for number in range(_TURNS):
            turn = drawn[number]
            along = toward @ turn.apply(arms).T
            dock = along.argmax(axis=1)
            if len(row) <= len(arms):
                _, dock = linear_sum_assignment(-along)
            tried.append((float(along[np.arange(len(row)), dock].sum()), turn, dock))
        _, turn, contacts[row, 1 + 2 * side] = max(tried, key=itemgetter(0))
        turns.append(turn)
    return turns, contacts


def _solve(
    center: Reals, turn: list[Rotation], arms: Reals, contacts: Ints, *, planar: bool
) -> bool:
    """Move and turn robots, in place, until all contacts hold; return whether they do."""
    robots, docks = len(center), len(arms)
    axes = np.array([1.0, 0.0, 1.0, 0.0, 1.0, 0.0]) if planar else np.ones(6)
    own, its = (docks * contacts[:, k] + contacts[:, k + 1] for k in (0, 2))
    touching = own * robots * docks + its
    for _ in range(_ROUNDS):
        arm = np.concatenate([each.apply(arms) for each in turn])
        point = np.repeat(center, docks, axis=0) + arm
        near = np.sort(cKDTree(point).query_pairs(SPACING + CLEAR, output_type="ndarray"), axis=1)
        near = near[near[:, 0] // docks != near[:, 1] // docks]
        near = near[~np.isin(near[:, 0] * robots * docks + near[:, 1], touching)]
        i, j = np.concatenate([np.column_stack([own, its]), near]).T
        away = point[i] - point[j]
        apart = np.linalg.norm(away, axis=1)
        off = apart - SPACING
        if np.abs(off[: len(own)]).max(initial=0.0) < _EXACT and not len(near):
            return True
        off[len(own) :] -= 2.0 * CLEAR
        unit = away / apart[:, None]
        row = np.repeat(np.arange(len(i)), 12)
        column = 6 * (np.column_stack([i, j])[:, :, None] // docks) + np.arange(6)
        value = np.stack(
            [np.hstack([unit, np.cross(arm[i], unit)]), -np.hstack([unit, np.cross(arm[j], unit)])],
            axis=1,
        )
        matrix = coo_array(
            ((value * axes).ravel(), (row, column.ravel())), (len(i), 6 * robots)
        ).tocsr()
        normal = (matrix @ matrix.T).toarray() + _DAMPING**2 * np.eye(len(i))
        step = (matrix.T @ np.linalg.solve(normal, -off)).reshape(robots, 6)
        step *= min(1.0, _LONGEST / float(np.abs(step).max()))
        center += step[:, :3]
        turn[:] = [Rotation.from_rotvec(w) * old for w, old in zip(step[:, 3:], turn, strict=True)]
    return False


def _log(center: Reals, turn: list[Rotation], arms: Reals, contacts: Ints, plan: Plan) -> Made:
    log = structures.silent(
        center,
        dock_offset_body=arms,
        orientation_wxyz=Rotation.concatenate(turn).as_quat(scalar_first=True),
        contacts=contacts,
    )
    robots = np.arange(len(center)) if plan.planar else np.empty(0, np.int64)
    every = np.ones(len(robots))
    plane = [robots, 0.0 * every, every, 0.0 * every, 0.0 * every, PLANE_SD * every, -every]
    robot, axis = np.repeat(plan.known, 3).astype(np.int64), np.tile(np.arange(3), len(plan.known))
    every = np.ones(len(robot))
    known = [robot, np.eye(3)[axis], center[robot, axis], KNOWN_SD * every, -every]
    fixes = np.concatenate([np.column_stack(plane), np.column_stack(known).reshape(-1, 7)])
    return replace(log, fixes=np.unique(fixes, axis=0)), center


def _cells(width: int, height: int, *, brick: bool) -> Plan:
    """Plan a wall of robots in a plane: a square lattice, or one of hexagons laid like bricks."""
    number = np.arange(width * height).reshape(height, width)
    up = np.column_stack([number[:-1].ravel(), number[1:].ravel()])
    if brick:
        z, x = np.divmod(up[:, 0], width)
        up = up[(x + z) % 2 == 0]
    along = np.column_stack([number[:, :-1].ravel(), number[:, 1:].ravel()])
    z, x = np.divmod(number.ravel(), width)
    place = np.column_stack([x, 0.0 * x, z]).astype(np.float64)
    if brick:
        place *= [np.sqrt(0.75), 1.0, 1.5]
        place[:, 2] += 0.25 * (-1.0) ** (x + z)
    return Plan(place=place, pairs=np.concatenate([along, up]), planar=True)


def lattice(robots: int, docks: int, rng: np.random.Generator) -> Plan:
    """Plan a wall in a plane in which a tenth of the contacts beyond a tree are left out."""
    width = max(2, round(float(np.sqrt(robots))))
    plan = _cells(width, max(2, robots // width), brick=docks <= 3)  # noqa: PLR2004 - hexagons
    part = np.arange(len(plan.place))
    kept = []
    for one, two in plan.pairs.tolist():
        if part[one] != part[two] or rng.random() > 0.1:  # noqa: PLR2004 - see above
            part[part == part[two]] = part[one]
            kept.append([one, two])
    return replace(plan, pairs=np.array(kept))


def ring(robots: int, rng: np.random.Generator) -> Plan:
    """Plan a closed ring in a tilted plane, squeezed at random."""
    angle = 2.0 * np.pi * np.arange(robots) / robots
    place = np.column_stack([np.cos(angle), rng.uniform(0.6, 1.0) * np.sin(angle), 0.0 * angle])
    place = Rotation.random(None, rng).apply(place / (2.0 * np.sin(np.pi / robots)))
    return Plan(place=place, pairs=_closed(robots))


def _closed(robots: int) -> Ints:
    one = np.arange(robots)
    return np.sort(np.column_stack([one, (one + 1) % robots]), axis=1)


def star(robots: int, rng: np.random.Generator) -> Plan:
    """Plan three to six arms that meet at the anchor, robots joining all arms in turn."""
    arms = int(rng.integers(3, 7))
    toward = structures.docks_around(max(arms, 4), 1.0)[:arms]
    place, pairs = [np.zeros(3)], []
    for robot in range(1, robots):
        place.append((1 + (robot - 1) // arms) * toward[(robot - 1) % arms])
        pairs.append([max(robot - arms, 0), robot])
    turned = Rotation.random(None, rng).apply(np.array(place))
    return Plan(place=turned, pairs=np.array(pairs))


def ladder(robots: int, rng: np.random.Generator) -> Plan:
    """Plan two rows and rungs; a third of the rungs is missing."""
    robots -= robots % 2
    one = np.arange(robots - 2)
    rungs = np.arange(0, robots, 2)
    rungs = rungs[(rng.random(len(rungs)) > 1.0 / 3.0) | (rungs == 0) | (rungs == robots - 2)]
    every = np.arange(robots)
    place = np.column_stack([every // 2, every % 2, 0 * every])
    pairs = np.concatenate([np.column_stack([one, one + 2]), np.column_stack([rungs, rungs + 1])])
    place = Rotation.random(None, rng).apply(place.astype(np.float64))
    return Plan(place=place, pairs=pairs)


def arch(robots: int, rng: np.random.Generator) -> Plan:
    """Plan a chain in a half circle between the anchor and a robot whose position is known."""
    angle = np.pi * np.arange(robots) / (robots - 1)
    place = np.column_stack([1.0 - np.cos(angle), 0.0 * angle, np.sin(angle)])
    place /= 2.0 * np.sin(np.pi / (2.0 * (robots - 1)))
    place = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)]).apply(place)
    one = np.arange(robots - 1)
    return Plan(place=place, pairs=np.column_stack([one, one + 1]), known=(robots - 1,))
