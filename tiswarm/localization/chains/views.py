"""What chains are made of: robots, what was measured of them, and where chains begin.

A view is a whole log, as `joint` has it, or what one robot heard of others. Lengths in R.

With orientations sensed, a subtree of the contact graph can move as one only by a shift. Moving its
robots one by one would take ever longer the more there are, so the annealer shifts whole subtrees
too. Measured coordinates tie a part without the anchor to it: each such part is a subtree, too.

Constants of chains are here, each with its unit and its reason. A class says where its values are
from, a field where its own is from elsewhere. "Chosen" values gave the least error among a few
tried, "fitted" ones minimize a misfit; both were found on training structures, of seeds that no
result is reported on.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse.csgraph import dijkstra

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.math import dock_offsets, normal
from tiswarm.localization.chains.problem import Planes, Problem
from tiswarm.localization.cost import ROBUST_SD
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.contacts import stand_across, touching
from tiswarm.measurements.model import KNOWN
from tiswarm.records.sensing_log import SensingLog


@dataclass(frozen=True, kw_only=True)
class AnnealSchedule:
    """How chains are annealed, beside what `JointParams` sets. Chosen on training structures."""

    coldest: float = 0.01
    """Square root of the end temperature where measurements are sharp and sufficient [R]. A lower
    end temperature separates solutions that miss measurements by little."""

    warmest: float = 0.025
    """Square root of the end temperature where measurements are neither [R]: colder chains sample
    less of what is not measured."""

    underdetermined: float = 0.05
    """Underdetermination from which on to end at `warmest` [1]: too little is measured to gain from
    colder chains."""

    ranged: float = 2.0
    """Least square root of the start temperature where ranges alone tie robots to each other [R]:
    they leave more minima to escape from."""

    growing: float = 0.1
    """Share of the steps in which docks grow to their full size [1], so that robots pass through
    each other at first."""

    smallest: float = 0.1
    """Size of docks in the first step, as a part of their full size [1]. Docks that are solid at
    once push each other out of the initial heap faster than friction takes the heat away."""

    reinitialize_from: float = 0.4
    """Share of the steps after which lost robots are initialized anew [1]."""

    lost: float = 4.0
    """A contact whose docks are farther than D + this apart is lost [R]: docks that far apart no
    longer find each other."""

    lost_sd: float = 3.0
    """Least miss of a lost contact [standard deviations]: uncertain ones may be missed by more than
    `lost`."""

    frames: int = 24
    """Frames of the trace [1], between which lost robots are looked for."""

    launch: int = 3000
    """Kernel-launch overhead [robot steps], by which work is divided among threads. Measured."""

    restarts: int = 2
    """Times that a chain that failed is annealed again [1], each time in steps half as long."""

    join_memory: float = 5.0
    """Decay length of the join-location prior [joins]: robots join near the last ones that did."""

    trilateration: int = 30
    """Steps in which the initial guess of a robot meets its ranges [1]."""

    join_window: int = 200
    """Joins that the prior looks back on [joins]: 40 decay lengths. The rest has no weight."""

    join_variance: float = 3.0
    """Mean square error of a robot placed by this prior [variances of the prior]. Fitted."""


ANNEALING = AnnealSchedule()

_SUBTREE_WEIGHT = 3.0
"""Least mass of a subtree, in masses of its own robots: contacts hold these no less stiffly than
the subtree, and they move beside it."""
_MOST_MOBILITY = 3.0
"""Most that 1 / mass of all subtrees a robot is in may add up to, for a robot of mass 1. An overlap
of two robots pushes them and all subtrees that contain one of them, so the work of a step is
proportional to that sum, which would grow with the number of robots in a thin arm. Results on
generated trees, loops, balls and chains are alike with 1 and with 3."""

_TINY = 1e-9


class Links(NamedTuple):
    """C distances and offsets of pairs of robots, H of them touches of unknown docks."""

    robot: Ints
    """Robot that sensed each, shape (C,)."""

    neighbor: Ints
    """Robot that it sensed, its partner, shape (C,)."""

    is_final: Bools
    """Whether docks of the two touch at their final stances, and neither has left, shape (C,)."""

    is_offset: Bools
    """Whether the vector between the docks is measured, shape (C,)."""

    is_touch: Bools
    """Whether the docks are unknown, shape (C,)."""

    arms: Reals
    """Arm of the robot's dock less that of the other's, as sensed [R], shape (C, 3)."""

    length: Reals
    """Measured distance of the docks, 0 of an offset [R], shape (C,)."""

    variance: Reals
    """Variance of the measured distance, or along an offset [R^2], shape (C,)."""

    across: Reals
    """Variance across an offset, 0 of distances [R^2], shape (C,)."""

    extension: Reals
    """Gain in log-likelihood for each R more between the two centers [R^-1], shape (C,).

    Robots climb as far as they can.
    """

    levers: Reals
    """Horizontal arms of the docks, which turn: the robot's x and y, the other's [R], (C, 4)."""

    vector: Reals
    """Measured vector from the robot's dock to the other's, 0 of distances [R], shape (C, 3)."""

    candidates: Reals
    """Arms of the docks that each touch may be of, as sensed: the robot's, and the other's [R].

    Shape (H, docks, 6).
    """


@dataclass(frozen=True, kw_only=True)
class Forest:
    """Subtrees of one structure of N robots, each before those that grow out of it.

    The robots of a subtree are tied to the anchor only by way of robots nearer to it.

    All robots that are a number of hops or more from the anchor fall apart into subtrees. The own
    robots of a subtree are its nearest to the anchor; its others are own ones of subtrees that grow
    out of it. The first subtree is everyone.
    """

    order: Ints
    """Robots, own ones of subtree after subtree, so that those of each stand in a row, (N,)."""

    first: Ints
    """Where in `order` the own robots of each subtree start, shape (T + 1,)."""

    parent: Ints
    """Subtree that each grows out of, 0 of the first, shape (T,)."""


@dataclass(frozen=True, kw_only=True)
class ChainView:
    """N robots that are annealed together, in each of C chains."""

    arm: Reals
    """Center to dock, world frame [R], shape (N, docks, 3)."""

    begin: Reals
    """Where chains begin [R], shape (C, N, 3)."""

    moves: Bools
    """Whether each robot moves, shape (N,)."""

    repels: Bools
    """Whether docks of a robot repel those that they do not touch, shape (N,)."""

    sigma: Reals
    """Square root of the temperature at each step [R], shape (steps,)."""

    robust: float
    """One over the squared width of the robust loss of links, 0 for none [1]."""

    yaw_precision: float
    """Precision of the sensed yaw, 0 where robots do not turn [rad^-2]."""

    links: Links
    """Measurements of pairs."""

    planes: Planes
    """Measured coordinates."""

    plane_robust: Reals
    """One over the squared width of the robust loss of each plane, 0 for none [1], shape (P,)."""

    forest: Forest
    """Subtrees that move as one."""

    stops: Bools
    """Axes along which each robot keeps subtrees from moving that it is in, shape (N, 3)."""

    relocate: Callable[[Reals, Reals], int] | None = None
    """Places robots anew that a chain has lost, given positions and yaw; returns how many."""


def view_of(
    log: SensingLog, params: JointParams, problem: Problem, start: Reals | None = None
) -> ChainView:
    """Describe a whole log as chains see it.

    Args:
        log: What was sensed.
        params: Settings.
        problem: Measurements of the log.
        start: Where chains begin, at `start_sigma` of the settings [R], shape (chains, N, 3); at
            initial guesses if None.
    """
    robots = log.robot_count
    begin = start
    if begin is None:
        begin = initial_guess(log, problem, params.seed, params.chains_for(robots))
    robust = float(ROBUST_SD**-2 * params.robust)
    planes = problem.planes
    gives_way = planes.is_redundant(problem.part) & (planes.precision * KNOWN < 1.0)
    # Many robots that were measured would hold a subtree more stiffly than its mass allows. What
    # holds a root is in the root's own mass: a part moves as one toward its root's place.
    stops = planes.along(robots)
    stops[problem.roots] = False
    # What grows out of robots that stay moves as one, as what grows out of the anchor does.
    pair = np.where(problem.moves[problem.pair], problem.pair, 0)
    roots = problem.roots[problem.moves[problem.roots]]
    return ChainView(
        arm=dock_offsets(log.orientation_wxyz, log.dock_offset_body / log.dock_radius),
        begin=begin,
        moves=problem.moves & (np.arange(robots) > 0),
        repels=params.cues.non_overlap & ~problem.is_gone,
        sigma=cooled(
            start_sigma(problem, params) if start is None else params.start_sigma,
            end_sigma(problem, params),
            params.steps_for(robots),
            params.hold_steps,
        ),
        robust=robust,
        yaw_precision=problem.yaw_precision,
        links=_links_of(problem, params.extension_prior),
        planes=planes,
        plane_robust=np.where(gives_way, robust, 0.0),
        forest=find_subtrees(pair, roots, robots),
        stops=stops,
        relocate=partial(reinitialize_lost, problem) if params.robust else None,
    )


def _links_of(problem: Problem, extension: float) -> Links:
    """Lay out the links of a problem; `extension` is the prior's gain, shared by a robot's."""
    is_offset = problem.is_offset
    vector = problem.vector
    levers = problem.lever
    levers[:, :2] -= vector[:, :2]
    variance = problem.variance[problem.link]
    total = problem.by_link(problem.variance)
    return Links(
        robot=problem.robot,
        neighbor=problem.neighbor,
        is_final=problem.is_final & problem.is_present,
        is_offset=is_offset,
        is_touch=problem.is_touch,
        arms=problem.shift - vector,
        length=problem.length,
        variance=variance,
        across=np.where(is_offset, 0.5 * (total - variance), 0.0),
        # The direction of an offset is measured.
        extension=np.where(is_offset, 0.0, extension * problem.is_final / problem.fewest),
        levers=levers,
        vector=vector,
        candidates=np.dstack([arm for arm, _ in problem.rows.touch_arms]),
    )


def start_sigma(problem: Problem, params: JointParams) -> float:
    """Choose the square root of the temperature at which annealing of one structure begins [R].

    Ranges are longer than contacts. Where they alone tie robots to each other, the first guess is
    often folded, and colder chains remain so.
    """
    is_contact = problem.rows.is_contact
    by_ranges = len(is_contact) > 0 and not is_contact.any()
    return max(params.start_sigma, ANNEALING.ranged * by_ranges)


def end_sigma(problem: Problem, params: JointParams) -> float:
    """Choose the square root of the end temperature of one structure [R].

    The colder the end, the better it separates solutions that miss measurements by little. But
    colder chains sample less of what nothing measures, and noise leaves nothing to be separated.
    """
    if params.end_sigma is not None:
        return params.end_sigma
    coldest = ANNEALING.coldest
    warmest = ANNEALING.warmest
    noise = float(np.sqrt(np.median(problem.variance))) if len(problem.variance) else warmest
    lacking = problem.underdetermination / ANNEALING.underdetermined
    return min(max(coldest + (warmest - coldest) * lacking, noise), warmest)


def cooled(begin: float, end: float, steps: int, holding: int) -> Reals:
    """Cool by the same factor at every step, then hold; sigma of each, shape (steps + holding,)."""
    falling = begin * (end / begin) ** (np.arange(steps) / steps)
    return np.concatenate([falling, np.full(holding, end)])


def find_subtrees(pair: Ints, roots: Ints, robots: int) -> Forest:
    """Split a structure into subtrees; robots that nothing ties to the anchor are in the first.

    Args:
        pair: Robots that touch each other at any stance, as often as they do, shape (C, 2).
        roots: Robots that hold their parts. Their measured coordinates tie them to the anchor, so
            that each part without it is a subtree, too.
        robots: N.
    """
    roots = roots[roots > 0]
    tied = np.column_stack([roots, np.zeros_like(roots)])
    pair = np.unique(np.concatenate([pair, tied]), axis=0)
    level = _levels(robots, pair)
    owner, parent = _grown(level, pair[level[pair[:, 0]] >= 0])
    number = _from_the_anchor(parent)
    owner = number[owner]
    return Forest(
        order=np.lexsort((level, owner)),
        first=np.searchsorted(np.sort(owner), np.arange(len(parent) + 1)),
        parent=number[parent[np.argsort(number)]],
    )


def weights(tree: Forest) -> Reals:
    """Weigh each subtree, in masses of its own robots, so that no robot is moved by too many.

    Thin subtrees that grow out of each other are heavier the more of them there are; what a subtree
    needs for its longest continuation holds for all others.

    Returns:
        Weight of each subtree [1], shape (T,).
    """
    mobility = 1.0 / (_SUBTREE_WEIGHT * np.diff(tree.first))
    mobility[0] = 0.0  # everyone together does not move
    total = mobility.copy()
    for subtree in range(1, len(total)):
        total[subtree] += total[tree.parent[subtree]]
    for subtree in range(len(total) - 1, 0, -1):
        total[tree.parent[subtree]] = max(total[tree.parent[subtree]], total[subtree])
    return _SUBTREE_WEIGHT * np.maximum(1.0, total / _MOST_MOBILITY)


def _levels(robots: int, pair: Ints) -> Ints:
    """Count the hops from the anchor to each robot, -1 if none lead there, shape (N,)."""
    anchor = np.zeros(1, np.int64)
    hops = dijkstra(touching(pair, robots), directed=False, indices=anchor, unweighted=True)[0]
    return np.where(np.isfinite(hops), hops, -1).astype(np.int64)


def _grown(level: Ints, pair: Ints) -> tuple[Ints, Ints]:
    """Find the subtree of each robot and the parent of each, from the tips to the anchor."""
    owner = np.zeros(len(level), np.int64)
    parent = [0]
    nearer = level[pair].min(axis=1)
    joined = DisjointSet(range(len(level)))
    tops: dict[int, list[int]] = {}  # subtrees of each set that have no parent yet
    # From the tips inward: robots of a level that farther ones connect are in one subtree.
    for hops in range(level.max(), 0, -1):
        for i, j in pair[nearer == hops].tolist():
            parts = {joined[i], joined[j]}
            joined.merge(i, j)
            tops[joined[i]] = [top for part in parts for top in tops.pop(part, [])]
        made: dict[int, int] = {}
        for i in np.flatnonzero(level == hops).tolist():
            part = joined[i]
            if part not in made:
                made[part] = len(parent)
                parent.append(0)
                for top in tops.get(part, []):
                    parent[top] = made[part]
                tops[part] = [made[part]]
            owner[i] = made[part]
    return owner, np.array(parent)


def _from_the_anchor(parent: Ints) -> Ints:
    """Number subtrees so that each stands before all that grow out of it, and they in a row."""
    grown: list[list[int]] = [[] for _ in parent]
    for subtree in range(1, len(parent)):
        grown[parent[subtree]].append(subtree)
    number = np.empty(len(parent), np.int64)
    waiting = [0]
    for count in range(len(parent)):
        subtree = waiting.pop()
        number[subtree] = count
        waiting += grown[subtree]
    return number


def initial_guess(log: SensingLog, problem: Problem, seed: int, chains: int) -> Reals:
    """Place each robot where its contacts with robots already placed meet, give or take one R.

    Robots follow each other along the chains of contacts, from the first robot of each part on.
    Unless the direction is measured in which a dock lies from the one it touches, the guess takes
    robots to stand across from each other; otherwise thousands would begin in a heap. A robot
    with ranges to robots already placed moves to where these meet best.

    Returns:
        Positions, other ones for each chain [R], shape (chains, N, 3).
    """
    robot = np.arange(log.robot_count)
    draw = 3 * np.arange(chains)[:, None, None] + np.arange(3)
    guess = normal(seed, "first guess", robot[:, None], draw)
    across = _across(problem)
    toward = np.concatenate([across, -across])
    partner = np.concatenate([problem.neighbor, problem.robot])
    rows = _rows(np.concatenate([problem.robot, problem.neighbor]), log.robot_count)
    is_range = np.tile(~problem.rows.is_contact[problem.link] & ~problem.is_offset, 2)
    length = np.tile(problem.length, 2)
    place, is_measured = problem.sensed_place()
    guess[:, 0] = log.anchor_position / log.dock_radius
    is_placed = robot == 0
    # Nearest first along the contacts: each robot then finds neighbors that are placed.
    for i in np.argsort(problem.reach(), kind="stable").tolist():
        if is_placed[i]:
            continue
        placed_rows = rows[i][is_placed[partner[rows[i]]]]
        met = (
            guess[:, partner[placed_rows]] - toward[placed_rows]
            if len(placed_rows)
            else guess[:, :1]
        )
        guess[:, i] += met.mean(axis=1)
        ranged = placed_rows[is_range[placed_rows]]
        for _ in range(ANNEALING.trilateration if len(ranged) else 0):
            away = guess[:, i, None] - guess[:, partner[ranged]]
            short = length[ranged] / np.maximum(np.linalg.norm(away, axis=2), _TINY)
            guess[:, i] += ((short - 1.0)[:, :, None] * away).mean(axis=1)
        guess[:, i, is_measured[i]] = place[i, is_measured[i]]
        is_placed[i] = True
    return guess


def reinitialize_lost(problem: Problem, position: Reals, yaw: Reals) -> int:
    """Place robots anew that most of their contacts have lost: at the median of these contacts.

    While the temperature is high others may move in front of a robot; its contacts are then too far
    away to pull it back.

    Args:
        problem: Measurements of the structure.
        position: Read and written [R], shape (chains, N, 3).
        yaw: Yaw corrections [rad], shape (chains, N).

    Returns:
        How many robots moved.
    """
    gap = np.sqrt(problem.by_link(problem.residual(position, yaw) ** 2))
    count = np.bincount(problem.robot, minlength=position.shape[1])
    across = _across(problem)
    is_measured = problem.sensed_place()[1]
    rows = _rows(problem.robot, len(count))
    moved = 0
    sd = np.sqrt(problem.by_link(problem.variance))
    far = np.maximum(ANNEALING.lost, ANNEALING.lost_sd * sd)
    for centers, missed in zip(position, gap > far, strict=True):
        # A single lost contact may be wrong; the majority of them is not.
        lost = np.bincount(problem.robot[missed], minlength=len(count)) > 0.5 * count
        for i in np.flatnonzero(lost & problem.moves).tolist():
            robot_rows = rows[i]
            # The median: one wrong contact does not take the robot away from all others.
            met = np.median(centers[problem.neighbor[robot_rows]] - across[robot_rows], axis=0)
            centers[i] = np.where(is_measured[i], centers[i], met)
            moved += 1
    return moved


def place_disconnected(mean: Reals, problem: Problem) -> tuple[Reals, Reals]:
    """Place each part that nothing ties to the anchor where its first robot may have joined.

    That robot touched one that was there before, and robots join where the last ones did. The
    annealer keeps such parts away from all others, and shapes them alone.

    Args:
        mean: Mean position of each chain [R], shape (chains, N, 3).
        problem: Measurements of the structure.

    Returns:
        Positions with such parts placed [R], shape (chains, N, 3), and their mean square error, 0
        for all other robots [R^2], shape (chains, N).
    """
    placed = mean.copy()
    square = np.zeros(mean.shape[:2])
    firsts = np.unique(problem.part, return_index=True)[1]
    for first in np.sort(firsts[problem.untied[firsts]]).tolist():
        window = slice(max(first - ANNEALING.join_window, 0), first)
        earlier = placed[:, window]
        weight = np.exp(np.arange(1 - earlier.shape[1], 1) / ANNEALING.join_memory)
        weight /= weight.sum()
        place = weight @ earlier
        away = (earlier - place[:, None]) @ problem.loose[first]
        part = problem.part == problem.part[first]
        placed[:, part] += ((place - placed[:, first]) @ problem.loose[first])[:, None]
        # The earlier ones may be of disconnected parts, too.
        uncertain = ANNEALING.join_variance * (away**2).sum(axis=2) + square[:, window]
        # Where these are in one place, it is still off by the distance of docks in contact, 2 R.
        square[:, part] = np.maximum(uncertain @ weight, 4.0)[:, None]
    return placed, square


def set_apart(problem: Problem, position: Reals) -> Reals:
    """Move parts that nothing ties to the world to where no other part can be, shape (N, 3)."""
    first = np.unique(problem.part, return_index=True)[1][problem.part]
    away = (problem.sensed_place()[0] - position)[first]
    moved: Reals = position + (problem.loose @ away[:, :, None])[:, :, 0]
    return moved


def _rows(robot: Ints, robots: int) -> list[NDArray[np.intp]]:
    """List for each robot where it stands in an array of robots."""
    order = np.argsort(robot, kind="stable")
    return np.split(order, np.searchsorted(robot[order], np.arange(1, robots)))


def _across(problem: Problem) -> Reals:
    """From the center of the other robot back to that of one across from it [R], shape (C, 3).

    Of an offset it is measured.
    """
    return stand_across(problem.shift, is_contact=problem.is_final & ~problem.is_offset)
