"""Rows of a block in kernels: what they miss, along what they change, how their noise is related.

The equations are those of `Measurements`. Lengths in R.
"""

from tiswarm.compute.lang import Ref, ti
from tiswarm.compute.math_kernels import part_at, vector_at, vector_in
from tiswarm.measurements.rows import KNOWN, SPACING
from tiswarm.parts.online.arrays import (
    ARM,
    AXIS,
    COORDINATE,
    DIRECTION,
    FIRST,
    HINGE,
    KIND,
    MEMBER,
    MEMBERS,
    NOISE,
    OFFSET,
    OTHER_ARM,
    OWN_VARIANCE,
    POSITION,
    RESIDUAL,
    ROW,
    TAIL,
    TURN,
    TURN_SD,
    VALUE,
    VARIANCE,
    WIDENED,
)

_SMALL = 1e-8
"""Squared angle below which a turn is its series [rad^2]."""
_AXES = 3


@ti.func
def undone(arm, turn):
    """Turn an arm by the rotation vector `-turn`."""
    square = turn.norm_sqr()
    sine, cosine = 1.0 - square / 6.0, 0.5 - square / 24.0
    if square > _SMALL:
        angle = ti.sqrt(square)
        # Rodrigues' formula, divided by the angle so that no axis has to be found.
        sine, cosine = ti.sin(angle) / angle, (1.0 - ti.cos(angle)) / square
    across = turn.cross(arm)
    return arm - sine * across + cosine * turn.cross(across)


@ti.func
def turn_of(i, robots: Ref):
    """Read the error of the orientation of robot i as a rotation vector [rad]."""
    return part_at(robots.state, i, TURN) * part_at(robots.state, i, TURN_SD)


@ti.func
def measure_row(b, a, at, table: Ref, robots: Ref, scratch: Ref):
    """Compute direction and residual of row a of block b, with its robot at `at`.

    Returns:
        The part of its arm that the final orientation turns, and the other robot's arm.
    """
    e = table.block[b, ROW] + a
    kind = table.number[e, KIND]
    own = table.member[table.block[b, MEMBERS]]
    tail = undone(part_at(table.real, e, TAIL), turn_of(own, robots))
    point = at + part_at(table.real, e, ARM) + tail - part_at(table.real, e, TAIL)
    its = ti.Vector([0.0, 0.0, 0.0])
    axis, value = part_at(table.real, e, AXIS), table.real[e, VALUE]
    if kind != COORDINATE:
        other = table.member[table.block[b, MEMBERS] + table.number[e, MEMBER]]
        its = undone(part_at(table.real, e, OTHER_ARM), turn_of(other, robots))
        point -= part_at(robots.state, other, POSITION) + its
    residual = point.dot(axis) - value
    if kind < OFFSET:
        # A distance measures along the line between its ends, which moves with the robots.
        length = point.norm()
        residual = length - value
        axis *= 0.0
        if length > 0.0:
            axis = point / length
        if kind == HINGE and residual >= 0.0:
            axis, residual = 0.0 * axis, 0.0
    for c in ti.static(range(_AXES)):
        scratch.row[a, DIRECTION + c] = axis[c]
    scratch.row[a, RESIDUAL] = residual
    scratch.row[a, WIDENED] = table.real[e, OWN_VARIANCE]
    return tail, its


@ti.func
def give_way(b, robust_square, table: Ref, scratch: Ref):
    """Widen rows that are missed by far, as `Cost` does; return the loss beyond their squares.

    Known positions never give way.

    Args:
        robust_square: Square of the width of the loss [1].
    """
    start = table.block[b, ROW]
    excess = 0.0
    for a in range(table.block[b + 1, ROW] - start):
        # The three rows of a vector give way together.
        parts = _AXES if table.number[start + a, KIND] == OFFSET else 1
        first = table.number[start + a, FIRST]
        missed = 0.0
        for k in range(first, first + parts):
            variance = table.real[start + k, VARIANCE]
            missed += scratch.row[k, RESIDUAL] ** 2 / (robust_square * variance)
        if table.number[start + a, KIND] == COORDINATE and table.real[start + a, VARIANCE] <= KNOWN:
            missed = 0.0
        scratch.row[a, WIDENED] += table.real[start + a, VARIANCE] * missed
        excess += robust_square * (ti.log(1.0 + missed) - missed / (1.0 + missed)) / parts
    return excess


@ti.func
def factor_covariance(b, noise: Ref, table: Ref, scratch: Ref):
    """Write the Cholesky factor of the covariance of the rows of block b.

    Args:
        noise: As `Table.noise`.
    """
    rows = table.block[b + 1, ROW] - table.block[b, ROW]
    start = table.block[b, NOISE]
    for a in range(rows):
        way = part_at(scratch.row, a, DIRECTION)
        for k in range(a + 1):
            # d N e, less the part that earlier columns of the factor explain.
            its = part_at(scratch.row, k, DIRECTION)
            total = 0.0
            for c in ti.static(range(_AXES)):
                here = start + ((_AXES * a + c) * rows + k) * _AXES
                through = ti.Vector([noise[here], noise[here + 1], noise[here + 2]])
                total += way[c] * through.dot(its)
            if a == k:
                total += scratch.row[a, WIDENED]
            for c in range(k):
                total -= scratch.covariance[a, c] * scratch.covariance[k, c]
            if a == k:
                scratch.covariance[a, a] = ti.sqrt(total)
            else:
                scratch.covariance[a, k] = total / scratch.covariance[k, k]


@ti.func
def whiten(u, rows, scratch: Ref):
    """Divide row u of the values by the Cholesky factor."""
    for a in range(rows):
        total = scratch.value[u, a]
        for c in range(a):
            total -= scratch.covariance[a, c] * scratch.value[u, c]
        scratch.value[u, a] = total / scratch.covariance[a, a]


@ti.func
def is_touching(later, dock, earlier, its, robots: Ref):
    """Whether two docks are in contact."""
    found = False
    for t in range(robots.touch_start[later], robots.touch_start[later + 1]):
        if (
            robots.touch[t, 0] == dock
            and robots.touch[t, 1] == earlier
            and robots.touch[t, 2] == its
        ):
            found = True
    return found


@ti.func
def overlap_of(apart):
    """How far docks whose centers are apart by a vector reach into each other [R]."""
    return ti.max(SPACING - apart.norm(), 0.0)


@ti.func
def dock_arm(i, dock, robots: Ref):
    """Arm of a dock of robot i as its orientation is believed to be [R]."""
    return undone(vector_in(robots.arm, i, dock), turn_of(i, robots))


@ti.func
def center_of(i, robots: Ref):
    """Center of robot i [R]."""
    return vector_at(robots.state, i)
