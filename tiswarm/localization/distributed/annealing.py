"""Chains that anneal the robots near one, from what a single robot holds of them."""

from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Ints, Reals
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
from tiswarm.localization.cost.cost import State, boltzmann_weights
from tiswarm.localization.distributed.settings import DistributedParams
from tiswarm.localization.online.kernels import (
    COORDINATE,
    OFFSET,
    BlockStart,
    RowLabel,
    RowValue,
    Table,
)
from tiswarm.localization.online.layers import LocalLayers
from tiswarm.localization.online.neighborhood import Block, NearCost
from tiswarm.measurements.equations import AXES
from tiswarm.measurements.odometry import CENTER

TEMPERED = 4.0
"""Divisor of costs by which ends of chains weigh in standard deviations [1]: few chains meet few of
the likely minima. Chosen on towers and cantilevers of the seeds 1000 to 1007, which no result is
reported on."""


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
    starts = [State(position.copy(), turn.copy()) for position in (begin, *chains.last)]
    minima = [problem.refine(start) for start in starts]
    reach = problem.shapes.reach
    score = np.array([
        linear.cost - extension_gain(layers, moving, minimum, reach) for minimum, linear in minima
    ])  # fmt: skip
    best = int(score.argmin())
    state = minima[best][0]
    # Ends that are nearly as likely as the best one make its position uncertain.
    weight = boltzmann_weights(score, TEMPERED)
    away = [((minimum.position - state.position)[moving] ** 2).sum(axis=1) for minimum, _ in minima]
    spread = weight @ np.array(away)
    return NearAnnealed(state, np.sqrt(spread))


def extension_gain(layers: LocalLayers, moving: Ints, state: State, reach: float) -> float:
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
    begin = layers.state.position
    robots = len(layers.blocks)
    shapes = problem.shapes
    table = problem.table
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
        repels=params.cues.non_overlap & ~np.isin(np.arange(robots), [*shapes.gone]),
        sigma=cooled(params.start_sigma, ANNEALING.coldest, params.steps, 1),
        robust=robust,
        yaw_precision=0.0,
        links=links,
        planes=planes,
        plane_robust=np.full(len(planes.robot), robust),
        forest=find_subtrees(
            np.column_stack([links.robot, links.neighbor]), np.zeros(1, np.int64), robots
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
    tables = [rows for b in blocks for rows in (b.rows.distances, b.rows.offsets)]
    final = np.repeat(
        [b.rows.odometry.final[-1] for b in blocks for _ in range(2)],
        [len(rows.stance) for rows in tables],
    )
    stance = np.concatenate([rows.stance for rows in tables])
    dock = np.concatenate([rows.dock for rows in tables])
    is_final = ((stance == final) & (dock != CENTER))[begins]
    is_offset = kind[at] == OFFSET
    vector = np.zeros((len(at), AXES))
    vector[is_offset] = np.concatenate([b.rows.offsets.vector[::AXES] for b in blocks])
    real = table.real[at]
    total = np.bincount(np.cumsum(begins) - 1, table.real[is_pair, RowValue.VARIANCE], len(at))
    robot = table.member[first[at]].astype(np.int64)
    partner = table.member[first[at] + table.number[at, RowLabel.MEMBER]].astype(np.int64)
    share = is_final / fewest_contacts(np.column_stack([robot, partner]), is_final, robots)
    return Links(
        robot=robot,
        neighbor=partner,
        is_final=is_final,
        is_offset=is_offset,
        is_touch=np.zeros(len(at), np.bool_),
        arms=real[:, RowValue.ARM : RowValue.TAIL]
        - real[:, RowValue.NEIGHBOR_ARM : RowValue.VALUE]
        - vector,
        length=real[:, RowValue.VALUE],
        variance=real[:, RowValue.VARIANCE],
        across=np.where(is_offset, 0.5 * (total - real[:, RowValue.VARIANCE]), 0.0),
        extension=np.where(is_offset, 0.0, EXTENSION * share),
        levers=np.zeros((len(at), 4)),
        vector=vector,
        candidates=np.empty((0, blocks[0].arm.shape[0], 2 * AXES)),
    )


def _planes_of(table: Table) -> Planes:
    """Turn the coordinates of a table into planes."""
    at = np.flatnonzero(table.number[:, RowLabel.KIND] == COORDINATE)
    robot = np.repeat(
        table.member[table.block[:-1, BlockStart.MEMBERS]], np.diff(table.block[:, BlockStart.ROW])
    )
    real = table.real[at]
    direction = real[:, RowValue.AXIS : RowValue.ARM]
    value = real[:, RowValue.VALUE] - (direction * real[:, RowValue.ARM : RowValue.TAIL]).sum(
        axis=1
    )
    return Planes(
        robot=robot[at].astype(np.int64),
        direction=direction,
        point=direction * value[:, None],
        walk=np.zeros((len(at), 2)),
        precision=1.0 / real[:, RowValue.VARIANCE],
    )
