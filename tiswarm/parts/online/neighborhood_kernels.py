"""Sums the normal equations of a neighborhood: block by block, then overlap by overlap.

One thread does all of it: a neighborhood is as much work as starting a few threads. So sums have
one order. Lengths in R.
"""

from tiswarm.compute.lang import F64, I32, Ints1, Ints2, Reals1, Reals2, Reals3, Ref, ti
from tiswarm.compute.math_kernels import part_at
from tiswarm.localization.refinement import OVERLAP_SD
from tiswarm.measurements.rows import SPACING
from tiswarm.parts.online.arrays import (
    COORDINATE,
    DIRECTION,
    GONE,
    KIND,
    MEMBER,
    MEMBERS,
    RESIDUAL,
    ROW,
    STAYS,
    TURN_SD,
    BelievedRobots,
    Scratch,
    Table,
)
from tiswarm.parts.online.row_kernels import (
    center_of,
    dock_arm,
    factor_covariance,
    give_way,
    is_touching,
    measure_row,
    overlap_of,
    whiten,
)

_AXES = 3
_PARTS = 6
_SHARED = 3
"""Values of a row beside unknowns: its derivatives by a shift of all robots that stay."""


@ti.func
def _number_places(b, moving, table: Ref, column: Ref, scratch: Ref):
    """Number the unknowns of the members of block b; return how many values a row has."""
    used = 0
    for k in range(table.block[b, MEMBERS], table.block[b + 1, MEMBERS]):
        if column[table.member[k]] >= 0:
            # All shifts come before all turns, as in `Linearized`.
            for c in range(_PARTS):
                turns = moving if c >= _AXES else 0
                place = _AXES * (turns + column[table.member[k]]) + c % _AXES
                scratch.place[used + c] = place
            used += _PARTS
    for c in range(_SHARED + 1):
        scratch.place[used + c] = _PARTS * moving + c
    return used + _SHARED + 1


@ti.func
def _slot_of(b, member, table: Ref, column: Ref):
    """First value of a member of block b, -1 if it does not move."""
    start = table.block[b, MEMBERS]
    slot = -1
    if column[table.member[start + member]] >= 0:
        slot = 0
        for k in range(start, start + member):
            slot += _PARTS * (column[table.member[k]] >= 0)
    return slot


@ti.func
def _store(u, a, vector, scratch: Ref):
    """Write three values of row a, from value u on."""
    for c in ti.static(range(_AXES)):
        scratch.value[u + c, a] = vector[c]


@ti.func
def _fill_values(b, a, values, tail, its, table: Ref, robots: Ref, column: Ref, scratch: Ref):
    """Write the derivatives of row a of block b, and its residual."""
    for u in range(values):
        scratch.value[u, a] = 0.0
    e, start = table.block[b, ROW] + a, table.block[b, MEMBERS]
    way, own = part_at(scratch.row, a, DIRECTION), table.member[start]
    slot = _slot_of(b, 0, table, column)
    if slot >= 0:
        _store(slot, a, way, scratch)
        _store(slot + _AXES, a, way.cross(tail) * part_at(robots.state, own, TURN_SD), scratch)
    # Two robots that stay share their error, as far as both have it.
    stays = robots.state[own, STAYS]
    if table.number[e, KIND] != COORDINATE:
        other = table.member[start + table.number[e, MEMBER]]
        slot = _slot_of(b, table.number[e, MEMBER], table, column)
        if slot >= 0:
            _store(slot, a, -way, scratch)
            across = its.cross(way) * part_at(robots.state, other, TURN_SD)
            _store(slot + _AXES, a, across, scratch)
        stays -= robots.state[other, STAYS]
    _store(values - _SHARED - 1, a, stays * way, scratch)
    scratch.value[values - 1, a] = scratch.row[a, RESIDUAL]


@ti.func
def _add_products(rows, values, scratch: Ref, total_out: Ref):
    """Add the products of all values of some rows, in pairs, to the lower triangle of a sum."""
    for u in range(values):
        # Four sums side by side: each addition of one alone waits for the last.
        for part in range(u // 4 + 1):
            total = ti.Vector([0.0, 0.0, 0.0, 0.0])
            for a in range(rows):
                for k in ti.static(range(4)):
                    total[k] += scratch.value[u, a] * scratch.value[ti.min(4 * part + k, u), a]
            for k in ti.static(range(4)):
                if 4 * part + k <= u:
                    first, second = scratch.place[u], scratch.place[4 * part + k]
                    total_out[ti.max(first, second), ti.min(first, second)] += total[k]


@ti.func
def _fill_side(used, robot, pull, arm, moving, robots: Ref, column: Ref, scratch: Ref):
    """Write the derivatives of an overlap by one of its robots; return where the next ones go."""
    after = used
    if column[robot] >= 0:
        _store(used, 0, pull, scratch)
        _store(used + _AXES, 0, pull.cross(arm) * part_at(robots.state, robot, TURN_SD), scratch)
        for c in range(_PARTS):
            turns = moving if c >= _AXES else 0
            scratch.place[used + c] = _AXES * (turns + column[robot]) + c % _AXES
        after += _PARTS
    return after


@ti.func
def _add_overlap(robot, other, arm, its, apart, moving, robots: Ref, column: Ref,
                 scratch: Ref, total_out: Ref):  # fmt: skip
    """Add the overlap of two docks at the ends of arms that are apart by a vector."""
    way = apart.normalized() / OVERLAP_SD
    used = _fill_side(0, robot, way, arm, moving, robots, column, scratch)
    used = _fill_side(used, other, -way, its, moving, robots, column, scratch)
    stays = robots.state[robot, STAYS] - robots.state[other, STAYS]
    _store(used, 0, stays * way, scratch)
    scratch.value[used + _SHARED, 0] = -overlap_of(apart) / OVERLAP_SD
    for c in range(_SHARED + 1):
        scratch.place[used + c] = _PARTS * moving + c
    _add_products(1, used + _SHARED + 1, scratch, total_out)


@ti.func
def _note_overlap(k, deep, overlap_out: Ref):
    """Remember the greatest overlap of the k-th robot that may move."""
    if k >= 0:
        overlap_out[k] = ti.max(overlap_out[k], deep / OVERLAP_SD)


@ti.func
def _add_overlaps(robot, other, moving, robots: Ref, column: Ref, scratch: Ref, total_out: Ref,
                  overlap_out: Ref):  # fmt: skip
    """Add the overlaps of docks of two robots that do not touch."""
    later, earlier = ti.max(robot, other), ti.min(robot, other)
    between = center_of(robot, robots) - center_of(other, robots)
    for dock in range(robots.arm.shape[1]):
        arm = dock_arm(robot, dock, robots)
        for its in range(robots.arm.shape[1]):
            other_arm = dock_arm(other, its, robots)
            apart = between + arm - other_arm
            deep = overlap_of(apart)
            if deep > 0.0 and deep < SPACING:
                first = dock if robot > other else its
                second = its if robot > other else dock
                # Docks in contact are nearer than D as often as farther.
                if not is_touching(later, first, earlier, second, robots):
                    _add_overlap(robot, other, arm, other_arm, apart, moving, robots, column,
                                 scratch, total_out)  # fmt: skip
                    _note_overlap(column[robot], deep, overlap_out)
                    _note_overlap(column[other], deep, overlap_out)


@ti.kernel
def sum_equations(
    robust_square: F64, non_overlap: I32, reach: F64,
    block: Ints2, member: Ints1, number: Ints2, real: Reals2, noise: Reals1,  # Table
    state: Reals2, arm: Reals3, touch: Ints2, touch_start: Ints1,  # BelievedRobots
    covariance: Reals2, row: Reals2, value: Reals2, place: Ints1,  # Scratch
    mover: Ints1, column: Ints1,
    total_out: Reals2, square_out: Reals1, overlap_out: Reals1,
):  # fmt: skip
    """Add up the squares of all rows and overlaps about robots that may move.

    Args:
        robust_square: Square of the width of the robust loss [1]; 0 where squares count.
        non_overlap: Whether docks that do not touch must not overlap.
        reach: Distance of centers beyond which no docks overlap [R].
        mover: BelievedRobots that may move, ascending, shape (K,).
        column: Place of each robot among these, -1 for those that stay, shape (N,).
        total_out: Zeros at first. Products of shifts and turns of all that may move, a shift of
            the others, and the residual, in pairs; lower triangle, shape (6 K + 4, 6 K + 4).
        square_out: Loss of the rows of each block, then all of it beyond squares, shape (B + 1,).
        overlap_out: Zeros at first. Greatest overlap of each robot that may move [standard
            deviations], shape (K,).
    """
    table = ti.static(Table(block, member, number, real, noise))
    robots = ti.static(BelievedRobots(state, arm, touch, touch_start))
    scratch = ti.static(Scratch(covariance, row, value, place))
    ti.loop_config(serialize=True)
    for b in range(block.shape[0] - 1):
        moving, blocks = mover.shape[0], block.shape[0] - 1
        if b == 0:
            square_out[blocks] = 0.0
        rows = block[b + 1, ROW] - block[b, ROW]
        at = center_of(member[block[b, MEMBERS]], robots)
        values = _number_places(b, moving, table, column, scratch)
        for a in range(rows):
            tail, its = measure_row(b, a, at, table, robots, scratch)
            _fill_values(b, a, values, tail, its, table, robots, column, scratch)
        excess = 0.0
        if robust_square > 0.0:
            excess = give_way(b, robust_square, table, scratch)
        square_out[blocks] += excess
        # With L the factor of the covariance, products of L^-1 V are those of V in its inverse.
        factor_covariance(b, noise, table, scratch)
        for u in range(values):
            whiten(u, rows, scratch)
        _add_products(rows, values, scratch, total_out)
        square_out[b] = excess
        for a in range(rows):
            square_out[b] += value[values - 1, a] ** 2
    ti.loop_config(serialize=True)
    for k in range(mover.shape[0] * non_overlap):
        robot = mover[k]
        here = center_of(robot, robots)
        for other in range(state.shape[0]):
            # A pair that may both move is listed once.
            is_listed = other != robot and (other < robot or column[other] < 0)
            # Docks of robots that have left are in nobody's way.
            is_listed = is_listed and state[robot, GONE] + state[other, GONE] == 0.0
            if is_listed and (here - center_of(other, robots)).norm_sqr() < reach * reach:
                _add_overlaps(robot, other, mover.shape[0], robots, column, scratch, total_out,
                              overlap_out)  # fmt: skip
