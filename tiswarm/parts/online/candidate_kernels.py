"""Steps to the minima of one block, from all starts; one thread takes them. Lengths in R."""

from tiswarm.compute.lang import F64, I32, Ints1, Ints2, Reals1, Reals2, Reals3, Ref, ti
from tiswarm.compute.math_kernels import vector_at
from tiswarm.localization.refinement import OVERLAP_SD
from tiswarm.parts.online.arrays import (
    DIRECTION,
    GONE,
    RESIDUAL,
    ROW,
    BelievedRobots,
    Scratch,
    Table,
)
from tiswarm.parts.online.row_kernels import (
    center_of,
    dock_arm,
    factor_covariance,
    is_touching,
    measure_row,
    overlap_of,
    whiten,
)
from tiswarm.parts.online.settings import CANDIDATES

_AXES = 3
_VALUES = 4


@ti.func
def _whiten_rows(at, noise: Ref, table: Ref, robots: Ref, scratch: Ref):
    """Divide derivatives and residuals of the rows by the factor of their covariance at a place."""
    rows = table.block[1, ROW]
    for a in range(rows):
        measure_row(0, a, at, table, robots, scratch)
        for c in ti.static(range(_AXES)):
            scratch.value[c, a] = scratch.row[a, DIRECTION + c]
        scratch.value[_AXES, a] = scratch.row[a, RESIDUAL]
    factor_covariance(0, noise, table, scratch)
    for u in range(_VALUES):
        whiten(u, rows, scratch)


@ti.func
def _product(u, v, rows, scratch: Ref):
    """Add up the products of two values over all rows."""
    total = 0.0
    for a in range(rows):
        total += scratch.value[u, a] * scratch.value[v, a]
    return total


@ti.func
def _step(rows, scratch: Ref):
    """Solve for the damped step to the minimum [R]."""
    known = ti.Matrix.zero(ti.f64, _AXES, _AXES)
    slope = ti.Vector([0.0, 0.0, 0.0])
    for u in ti.static(range(_AXES)):
        for v in ti.static(range(_AXES)):
            known[u, v] = _product(u, v, rows, scratch)
        known[u, u] += CANDIDATES.damping
        slope[u] = _product(u, _AXES, rows, scratch)
    return -(known.inverse() @ slope)


@ti.func
def _merged(count, place_out: Ref):
    """Keep the first of places that are close to each other; return how many these are."""
    kept = 0
    for n in range(count):
        here = vector_at(place_out, n)
        is_new = True
        for k in range(kept):
            if (here - vector_at(place_out, k)).norm() < CANDIDATES.alike:
                is_new = False
        if is_new:
            for c in ti.static(range(_AXES)):
                place_out[kept, c] = here[c]
            kept += 1
    return kept


@ti.func
def _overlaps_at(at, own, reach, robots: Ref):
    """Sum the squares of overlaps of robot `own` at a place, in variances."""
    total = 0.0
    for other in range(robots.state.shape[0]):
        between = at - center_of(other, robots)
        is_there = other != own and robots.state[other, GONE] == 0.0
        if is_there and between.norm_sqr() < reach * reach:
            for its in range(robots.arm.shape[1]):
                apart = between - dock_arm(other, its, robots)
                for dock in range(robots.arm.shape[1]):
                    deep = overlap_of(apart + dock_arm(own, dock, robots))
                    if deep > 0.0 and not is_touching(own, dock, other, its, robots):
                        total += (deep / OVERLAP_SD) ** 2
    return total


@ti.kernel
def descend(
    non_overlap: I32, reach: F64,
    block: Ints2, member: Ints1, number: Ints2, real: Reals2, noise: Reals1,  # Table
    state: Reals2, arm: Reals3, touch: Ints2, touch_start: Ints1,  # BelievedRobots
    covariance: Reals2, row: Reals2, value: Reals2, place: Ints1,  # Scratch
    place_out: Reals2, cost_out: Reals1, count_out: Ints1,
):  # fmt: skip
    """Step from all starts to minima of the chi-square of one block.

    Args:
        non_overlap: Whether docks that do not touch must not overlap.
        reach: Distance of centers beyond which no docks overlap [R].
        place_out: Starts, then the places that they led to [R], shape (starts, 3).
        cost_out: Chi-square of the rows and squares of overlaps at each place, shape (starts,).
        count_out: How many places are left, shape (1,).
    """
    table = ti.static(Table(block, member, number, real, noise))
    robots = ti.static(BelievedRobots(state, arm, touch, touch_start))
    scratch = ti.static(Scratch(covariance, row, value, place))
    ti.loop_config(serialize=True)
    for once in range(1):
        rows, own = block[1, ROW], member[once]
        count = place_out.shape[0]
        taken, farthest = 0, CANDIDATES.settled
        while taken < CANDIDATES.rounds and farthest >= CANDIDATES.settled:
            farthest = 0.0
            # Each start goes on by itself: a merge drops starts, and moves none.
            for n in range(count):
                at = vector_at(place_out, n)
                _whiten_rows(at, noise, table, robots, scratch)
                step = _step(rows, scratch)
                far = step.norm()
                farthest = ti.max(farthest, far)
                at += step * ti.min(1.0, CANDIDATES.longest_step / ti.max(far, CANDIDATES.settled))
                for c in ti.static(range(_AXES)):
                    place_out[n, c] = at[c]
            taken += 1
            # Most starts fall into the same few minima within three steps.
            if taken % CANDIDATES.merge_every == 0:
                count = _merged(count, place_out)
        for n in range(count):
            at = vector_at(place_out, n)
            # The covariance depends on where the robot is.
            _whiten_rows(at, noise, table, robots, scratch)
            cost_out[n] = _product(_AXES, _AXES, rows, scratch)
            if non_overlap:
                cost_out[n] += _overlaps_at(at, own, reach, robots)
        count_out[0] = count
