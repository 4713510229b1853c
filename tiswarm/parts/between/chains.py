"""Annealing of the robots near one, by that robot alone. Lengths in R, relative to the anchor."""

from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.localization.cost.kernels import (
    ARM,
    AXIS,
    COORDINATE,
    KIND,
    MEMBER,
    MEMBERS,
    OTHER_ARM,
    ROW,
    VALUE,
    VARIANCE,
)
from tiswarm.localization.cost.neighborhood import Configuration, Neighborhood
from tiswarm.measurements.model import SPACING
from tiswarm.parts.between.chain_kernels import ChainDocks, ChainRows, anneal_near
from tiswarm.parts.between.settings import CHAINS, DistributedParams
from tiswarm.parts.online.layers import LocalLayers

_AXES = 3


class NearAnnealed(NamedTuple):
    """The best of several chains, for the K robots that moved."""

    state: Configuration
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
    arm = problem.shapes.arm
    begin = layers.state.position
    moves = np.zeros(len(begin), np.int32)
    moves[moving[moving > 0]] = 1
    view = np.tile(begin, (params.chains, 1, 1))
    reach = 2.0 * float(np.linalg.norm(arm, axis=2).max()) + SPACING
    anneal_near(
        (params.seed * 4_099 + number) % 2**31, reach,
        _schedule(params.start_sigma, params.steps), moves,
        *_rows_of(problem, len(begin)), *_docks_of(problem),
        view, np.zeros_like(view), np.zeros_like(view),
    )  # fmt: skip
    found = [problem.solved(Configuration(begin.copy(), layers.state.turn.copy()))]
    found += [problem.solved(Configuration(end, layers.state.turn.copy())) for end in view]
    score = np.array([each[1].cost - _gain(layers, moving, each[0], reach) for each in found])
    best = int(score.argmin())
    state, linear = found[best]
    # Ends that are nearly as likely as the best one make its position uncertain.
    weight = np.exp(-0.5 * (score - score[best]) / CHAINS.tempered)
    weight /= weight.sum()
    away = [((each.position - state.position)[moving] ** 2).sum(axis=1) for each, _ in found]
    spread = weight @ np.array(away)
    return NearAnnealed(state, np.sqrt(problem.sd(linear) ** 2 + spread))


def _schedule(begin: float, steps: int) -> Reals:
    """Cool from a sigma to the least by the same factor at each step, shape (steps,)."""
    return begin * (CHAINS.end_sigma / begin) ** (np.arange(steps) / max(steps - 1, 1))


def _gain(layers: LocalLayers, moving: Ints, state: Configuration, reach: float) -> float:
    """Compute what some robots gain by their extension [1], up to the reach of a contact [R]."""
    total = 0.0
    for k in moving.tolist():
        partners = layers.blocks[k].partners
        if len(partners):
            apart = np.linalg.norm(state.position[partners] - state.position[k], axis=1)
            # Beyond its reach a contact would give way, and the robot would gain by that.
            total += 2.0 * CHAINS.extension * float(np.minimum(apart, reach).mean())
    return total


def _rows_of(problem: Neighborhood, robots: int) -> ChainRows:
    """List the rows about robots that may move, by robot; turns of orientations are noise here."""
    block, member, number, real, _ = problem.table
    rows, first = np.diff(block[:, ROW]), np.repeat(block[:-1, MEMBERS], np.diff(block[:, ROW]))
    own = member[first].astype(np.int64)
    is_pair = number[:, KIND] != COORDINATE
    other = np.where(is_pair, member[first + number[:, MEMBER]], -1).astype(np.int64)
    arm = real[:, ARM : ARM + _AXES] - real[:, OTHER_ARM : OTHER_ARM + _AXES]
    axis = real[:, AXIS : AXIS + _AXES]
    # As many rows as a robot has, they push it outward once.
    pairs = np.add.reduceat(is_pair, block[:-1, ROW])
    share = np.where(is_pair, CHAINS.extension / np.maximum(np.repeat(pairs, rows), 1), 0.0)
    value = np.column_stack([real[:, VALUE], real[:, VARIANCE], share])
    # The partner lists the row, too, from its own end.
    robot = np.concatenate([own, other[is_pair]])
    order = np.argsort(robot, kind="stable")
    both = [
        np.concatenate([other, own[is_pair]]),
        np.concatenate([arm, -arm[is_pair]]),
        np.concatenate([axis, -axis[is_pair]]),
        np.concatenate([value, value[is_pair]]),
    ]
    start = np.searchsorted(robot[order], np.arange(robots + 1)).astype(np.int32)
    partner, arms, axes, values = (np.ascontiguousarray(each[order]) for each in both)
    return ChainRows(start, partner.astype(np.int32), arms, axes, values)


def _docks_of(problem: Neighborhood) -> ChainDocks:
    """List the docks of all robots, and by robot those in contact."""
    arm, touch, robots = problem.shapes.arm, problem.shapes.touch, len(problem.shapes.arm)
    later = np.repeat(np.arange(robots), np.diff(problem.shapes.touch_start))
    own, other, its = touch.T
    every = np.concatenate(
        [np.column_stack([later, own, other, its]), np.column_stack([other, its, later, own])]
    ).astype(np.int32)
    contact = every[np.lexsort(every.T[::-1])]
    start = np.searchsorted(contact[:, 0], np.arange(robots + 1)).astype(np.int32)
    return ChainDocks(np.ascontiguousarray(arm), start, np.ascontiguousarray(contact[:, 1:]))
