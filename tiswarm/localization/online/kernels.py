"""Rows of a block in kernels, the normal equations of a neighborhood, and steps of one robot.

The equations are those of `Measurements`. One thread does all of it: a neighborhood is as much work
as starting a few threads. So sums have one order. Lengths in R.
"""

from typing import NamedTuple

from tiswarm.compute.lang import (
    F64,
    I32,
    Columns,
    Ints1,
    Ints2,
    Reals1,
    Reals2,
    Reals3,
    Ref,
    ti,
)
from tiswarm.compute.math_kernels import part_at, vector_at, vector_in
from tiswarm.localization.cost import OVERLAP_SD
from tiswarm.localization.online.settings import CANDIDATES
from tiswarm.measurements import equations
from tiswarm.measurements.equations import AXES
from tiswarm.measurements.model import KNOWN, SPACING

DISTANCE, HINGE, OFFSET, COORDINATE = range(4)
"""Kinds of rows; only distances that are too short count of a hinge."""


class BlockStart(Columns):
    """Columns of `Table.block`: where the rows and the members of a block begin."""

    ROW = 1
    MEMBERS = 1


class RowLabel(Columns):
    """Columns of `Table.number`."""

    KIND = 1
    """Kind of the row."""

    MEMBER = 1
    """Place of the other robot among the members."""

    FIRST = 1
    """Row of the block in which its measurement begins."""


class RowValue(Columns):
    """Columns of `Table.real`."""

    AXIS = 3
    """Unit vector that it measures along; 0 of a distance."""

    ARM = 3
    """From the center of its robot to the dock [R]."""

    TAIL = 3
    """Part of this arm that the final orientation turns [R]."""

    NEIGHBOR_ARM = 3
    """From the center of the other robot to its dock [R]."""

    VALUE = 1
    """Measured distance or coordinate [R]."""

    OWN_VARIANCE = 1
    """Variance without noise of orientations [R^2]."""

    VARIANCE = 1
    """Variance if it were independent of all others [R^2]."""


class WalkedRow(Columns):
    """Columns of `Table.noise`: rows in the order of their stances, the latest stance first.

    As in `WalkNoise`, a row is wrong by d . x + t . w, with d its derivative by the center, x the
    shift of its stance and w the turn of this stance, which shifts earlier ones by M w.
    """

    ROW = 1
    """Row of the block."""

    IS_NEW = 1
    """Whether it is the first row of its stance."""

    SHIFT = 9
    """M of the stance of the row before, 0 of the first row [R]."""

    SKIPPED = 9
    """Covariance of the shift by all turns between these two stances [R^2]."""

    TURN = 9
    """Derivatives of t by d [R]."""


class Whitening(Columns):
    """Columns of `Scratch.factor`: what a row needs of those before it, by x and w."""

    DERIVATIVE = 6
    """d and t."""

    GAIN = 6
    """Change of the expectations of x and w for each R by which the row is off."""

    SD = 1
    """Standard deviation of the row, given those before it [R]."""


class RobotState(Columns):
    """Columns of `BelievedRobots.state`."""

    POSITION = 3
    """Center [R]."""

    TURN = 3
    """Error of the orientation in standard deviations."""

    TURN_SD = 3
    """These standard deviations [rad]."""

    STAYS = 1
    """Standard deviation of each coordinate of a robot that does not move [R]."""

    GONE = 1
    """1 for a robot that has left."""


class RowState(Columns):
    """Columns of `Scratch.row`."""

    DIRECTION = 3
    """Derivative by the robot's center."""

    RESIDUAL = 1
    """What is missed [R]."""

    WIDENED = 1
    """The row's own variance, as far as it gives way [R^2]."""


class Table(NamedTuple):
    """The rows of B blocks, one after the other: E rows, M members."""

    block: Ints2
    """`BlockStart` of each block, and where the last one ends, shape (B + 1, 2)."""

    member: Ints1
    """BelievedRobots of each block: its own, then its partners ascending, shape (M,)."""

    number: Ints2
    """`RowLabel`, shape (E, 3)."""

    real: Reals2
    """`RowValue`, shape (E, 15)."""

    noise: Reals2
    """`WalkedRow`, block after block, shape (E, 29)."""


class BelievedRobots(NamedTuple):
    """N robots."""

    state: Reals2
    """`RobotState`, shape (N, 11)."""

    arm: Reals3
    """Center to dock at the final stance, as sensed [R], shape (N, docks, 3)."""

    touch: Ints2
    """Own dock, the other robot and its dock, for each contact of the later robot, shape (T, 3)."""

    touch_start: Ints1
    """First contact of each robot, shape (N + 1,)."""


class Scratch(NamedTuple):
    """Room for one block of m rows."""

    factor: Reals2
    """`Whitening` of each row in the order of `WalkedRow`, shape (m, 13)."""

    row: Reals2
    """`RowState`, shape (m, 5)."""

    value: Reals2
    """Derivatives by each unknown, then what `NearLinear.of_others` is of, then the residual: a
    row for each, shape (U, m)."""

    place: Ints1
    """Place of each of these among all unknowns, shape (U,)."""


_SMALL = 1e-8
"""Squared angle below which a turn is its series [rad^2]."""
_PARTS = 6
_SHARED = 3
"""Values of a row beside unknowns: its derivatives by a shift of all robots that stay."""
_VALUES = 4
"""Values of a row of one robot: its derivatives by the center, and the residual."""

missed_distance = ti.func(equations.missed_distance)
missed_along = ti.func(equations.missed_along)
slope_by_turn = ti.func(equations.slope_by_turn)
loss_beyond = ti.func(equations.loss_beyond)


@ti.func
def undone(arm, turn):
    """Turn an arm by the rotation vector `-turn`."""
    square = turn.norm_sqr()
    sine = 1.0 - square / 6.0
    cosine = 0.5 - square / 24.0
    if square > _SMALL:
        angle = ti.sqrt(square)
        # Rodrigues' formula, divided by the angle so that no axis has to be found.
        sine = ti.sin(angle) / angle
        cosine = (1.0 - ti.cos(angle)) / square
    across = turn.cross(arm)
    return arm - sine * across + cosine * turn.cross(across)


@ti.func
def turn_of(i, robots: Ref):
    """Read the error of the orientation of robot i as a rotation vector [rad]."""
    return part_at(robots.state, i, RobotState.TURN) * part_at(robots.state, i, RobotState.TURN_SD)


@ti.func
def measure_row(b, a, at, table: Ref, robots: Ref, scratch: Ref):
    """Compute direction and residual of row a of block b, with its robot at `at`.

    Returns:
        The part of its arm that the final orientation turns, and the other robot's arm.
    """
    e = table.block[b, BlockStart.ROW] + a
    kind = table.number[e, RowLabel.KIND]
    robot = table.member[table.block[b, BlockStart.MEMBERS]]
    tail = undone(part_at(table.real, e, RowValue.TAIL), turn_of(robot, robots))
    point = at + part_at(table.real, e, RowValue.ARM) + tail - part_at(table.real, e, RowValue.TAIL)
    neighbor_arm = ti.Vector([0.0, 0.0, 0.0])
    axis = part_at(table.real, e, RowValue.AXIS)
    value = table.real[e, RowValue.VALUE]
    if kind != COORDINATE:
        member = table.block[b, BlockStart.MEMBERS] + table.number[e, RowLabel.MEMBER]
        neighbor = table.member[member]
        sensed_arm = part_at(table.real, e, RowValue.NEIGHBOR_ARM)
        neighbor_arm = undone(sensed_arm, turn_of(neighbor, robots))
        point -= part_at(robots.state, neighbor, RobotState.POSITION) + neighbor_arm
    residual = missed_along(point, axis, value)
    if kind < OFFSET:
        # A distance measures along the line between its ends, which moves with the robots.
        residual, slope = missed_distance(point, value, kind == HINGE)
        axis = slope * point
    for c in ti.static(range(AXES)):
        scratch.row[a, RowState.DIRECTION + c] = axis[c]
    scratch.row[a, RowState.RESIDUAL] = residual
    scratch.row[a, RowState.WIDENED] = table.real[e, RowValue.OWN_VARIANCE]
    return tail, neighbor_arm


@ti.func
def give_way(b, robust_square, table: Ref, scratch: Ref):
    """Widen rows that are missed by far, as `WholeCost` does; return the loss beyond their squares.

    Known positions never give way.

    Args:
        robust_square: Square of the width of the loss [1].
    """
    start = table.block[b, BlockStart.ROW]
    excess = 0.0
    for a in range(table.block[b + 1, BlockStart.ROW] - start):
        # The three rows of a vector give way together.
        parts = AXES if table.number[start + a, RowLabel.KIND] == OFFSET else 1
        first = table.number[start + a, RowLabel.FIRST]
        of_row = table.real[start + a, RowValue.VARIANCE]
        missed = 0.0
        for k in range(first, first + parts):
            variance = table.real[start + k, RowValue.VARIANCE]
            missed += scratch.row[k, RowState.RESIDUAL] ** 2 / (robust_square * variance)
        if table.number[start + a, RowLabel.KIND] == COORDINATE and of_row <= KNOWN:
            missed = 0.0
        scratch.row[a, RowState.WIDENED] += of_row * missed
        excess += loss_beyond(missed, ti.log(1.0 + missed), robust_square) / parts
    return excess


@ti.func
def matrix_at(table: Ref, row, first):
    """Read nine columns of a table, from `first` on, as a matrix, row after row."""
    matrix = ti.Matrix.zero(ti.f64, AXES, AXES)
    for c in ti.static(range(AXES)):
        for k in ti.static(range(AXES)):
            matrix[c, k] = table[row, first + AXES * c + k]
    return matrix


@ti.func
def factor_covariance(b, table: Ref, scratch: Ref):
    """Factor the covariance of the rows of block b, stance after stance back from the final one.

    This is a Kalman filter (1960) of the shift x and the turn w: its innovations are whitened rows.
    """
    start = table.block[b, BlockStart.ROW]
    shift = ti.Matrix.zero(ti.f64, AXES, AXES)  # covariance of x
    both = ti.Matrix.zero(ti.f64, AXES, AXES)  # covariance of x and w
    turn = ti.Matrix.zero(ti.f64, AXES, AXES)  # covariance of w
    for k in range(table.block[b + 1, BlockStart.ROW] - start):
        if table.noise[start + k, WalkedRow.IS_NEW] > 0.0:
            by_turn = matrix_at(table.noise, start + k, WalkedRow.SHIFT)
            skipped = matrix_at(table.noise, start + k, WalkedRow.SKIPPED)
            crossed = both @ by_turn.transpose()
            shift += crossed + crossed.transpose() + by_turn @ turn @ by_turn.transpose() + skipped
            both = ti.Matrix.zero(ti.f64, AXES, AXES)
            turn = ti.Matrix.identity(ti.f64, AXES)
        a = ti.cast(table.noise[start + k, WalkedRow.ROW], ti.i32)
        d = part_at(scratch.row, a, RowState.DIRECTION)
        t = matrix_at(table.noise, start + k, WalkedRow.TURN).transpose() @ d
        of_shift = shift @ d + both @ t
        of_turn = both.transpose() @ d + turn @ t
        variance = d.dot(of_shift) + t.dot(of_turn) + scratch.row[a, RowState.WIDENED]
        shift -= of_shift.outer_product(of_shift) / variance
        both -= of_shift.outer_product(of_turn) / variance
        turn -= of_turn.outer_product(of_turn) / variance
        for c in ti.static(range(AXES)):
            scratch.factor[k, Whitening.DERIVATIVE + c] = d[c]
            scratch.factor[k, Whitening.DERIVATIVE + AXES + c] = t[c]
            scratch.factor[k, Whitening.GAIN + c] = of_shift[c] / variance
            scratch.factor[k, Whitening.GAIN + AXES + c] = of_turn[c] / variance
        scratch.factor[k, Whitening.SD] = ti.sqrt(variance)


@ti.func
def whiten(u, b, table: Ref, scratch: Ref):
    """Divide row u of the values by the factor of the covariance of block b."""
    start = table.block[b, BlockStart.ROW]
    shift = ti.Vector([0.0, 0.0, 0.0])
    turn = ti.Vector([0.0, 0.0, 0.0])
    for k in range(table.block[b + 1, BlockStart.ROW] - start):
        if table.noise[start + k, WalkedRow.IS_NEW] > 0.0:
            shift += matrix_at(table.noise, start + k, WalkedRow.SHIFT) @ turn
            turn = ti.Vector([0.0, 0.0, 0.0])
        a = ti.cast(table.noise[start + k, WalkedRow.ROW], ti.i32)
        innovation = scratch.value[u, a]
        innovation -= part_at(scratch.factor, k, Whitening.DERIVATIVE).dot(shift)
        innovation -= part_at(scratch.factor, k, Whitening.DERIVATIVE + AXES).dot(turn)
        shift += innovation * part_at(scratch.factor, k, Whitening.GAIN)
        turn += innovation * part_at(scratch.factor, k, Whitening.GAIN + AXES)
        scratch.value[u, a] = innovation / scratch.factor[k, Whitening.SD]


@ti.func
def overlap_of(robot, dock, neighbor, neighbor_dock, apart, robots: Ref):
    """How far docks that are apart by a vector reach into each other [R]; 0 if they touch.

    Docks in contact are nearer than D as often as farther.
    """
    deep = -missed_distance(apart, SPACING, 1)[0]
    if deep > 0.0:
        # The later robot lists a contact.
        later = robot
        later_dock = dock
        earlier = neighbor
        earlier_dock = neighbor_dock
        if robot < neighbor:
            later = neighbor
            later_dock = neighbor_dock
            earlier = robot
            earlier_dock = dock
        for t in range(robots.touch_start[later], robots.touch_start[later + 1]):
            is_dock = robots.touch[t, 0] == later_dock and robots.touch[t, 2] == earlier_dock
            if is_dock and robots.touch[t, 1] == earlier:
                deep = 0.0
    return deep


@ti.func
def dock_arm(i, dock, robots: Ref):
    """Arm of a dock of robot i as its orientation is believed to be [R]."""
    return undone(vector_in(robots.arm, i, dock), turn_of(i, robots))


@ti.func
def center_of(i, robots: Ref):
    """Center of robot i [R]."""
    return vector_at(robots.state, i)


@ti.func
def _number_places(b, moving, table: Ref, column: Ref, scratch: Ref):
    """Number the unknowns of the members of block b; return how many values a row has."""
    used = 0
    for k in range(table.block[b, BlockStart.MEMBERS], table.block[b + 1, BlockStart.MEMBERS]):
        if column[table.member[k]] >= 0:
            # All shifts come before all turns, as in `NearLinear`.
            for c in range(_PARTS):
                turns = moving if c >= AXES else 0
                place = AXES * (turns + column[table.member[k]]) + c % AXES
                scratch.place[used + c] = place
            used += _PARTS
    for c in range(_SHARED + 1):
        scratch.place[used + c] = _PARTS * moving + c
    return used + _SHARED + 1


@ti.func
def _slot_of(b, member, table: Ref, column: Ref):
    """First value of a member of block b, -1 if it does not move."""
    start = table.block[b, BlockStart.MEMBERS]
    slot = -1
    if column[table.member[start + member]] >= 0:
        slot = 0
        for k in range(start, start + member):
            slot += _PARTS * (column[table.member[k]] >= 0)
    return slot


@ti.func
def _store(u, a, vector, scratch: Ref):
    """Write three values of row a, from value u on."""
    for c in ti.static(range(AXES)):
        scratch.value[u + c, a] = vector[c]


@ti.func
def _store_turns(u, a, robot, way, arm, robots: Ref, scratch: Ref):
    """Write the derivatives of row a by turns of a robot, whose arm it moves along, from u on."""
    across = slope_by_turn(way, arm)
    for c in ti.static(range(AXES)):
        scratch.value[u + c, a] = across[c] * robots.state[robot, RobotState.TURN_SD + c]


@ti.func
def _fill_values(
    b, a, values, tail, neighbor_arm, table: Ref, robots: Ref, column: Ref, scratch: Ref
):
    """Write the derivatives of row a of block b, and its residual."""
    for u in range(values):
        scratch.value[u, a] = 0.0
    e = table.block[b, BlockStart.ROW] + a
    start = table.block[b, BlockStart.MEMBERS]
    way = part_at(scratch.row, a, RowState.DIRECTION)
    robot = table.member[start]
    slot = _slot_of(b, 0, table, column)
    if slot >= 0:
        _store(slot, a, way, scratch)
        _store_turns(slot + AXES, a, robot, way, tail, robots, scratch)
    # Two robots that stay share their error, as far as both have it.
    stays = robots.state[robot, RobotState.STAYS]
    if table.number[e, RowLabel.KIND] != COORDINATE:
        neighbor = table.member[start + table.number[e, RowLabel.MEMBER]]
        slot = _slot_of(b, table.number[e, RowLabel.MEMBER], table, column)
        if slot >= 0:
            _store(slot, a, -way, scratch)
            _store_turns(slot + AXES, a, neighbor, -way, neighbor_arm, robots, scratch)
        stays -= robots.state[neighbor, RobotState.STAYS]
    _store(values - _SHARED - 1, a, stays * way, scratch)
    scratch.value[values - 1, a] = scratch.row[a, RowState.RESIDUAL]


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
                    first = scratch.place[u]
                    second = scratch.place[4 * part + k]
                    total_out[ti.max(first, second), ti.min(first, second)] += total[k]


@ti.func
def _fill_side(used, robot, pull, arm, moving, robots: Ref, column: Ref, scratch: Ref):
    """Write the derivatives of an overlap by one of its robots; return where the next ones go."""
    after = used
    if column[robot] >= 0:
        _store(used, 0, pull, scratch)
        _store_turns(used + AXES, 0, robot, pull, arm, robots, scratch)
        for c in range(_PARTS):
            turns = moving if c >= AXES else 0
            scratch.place[used + c] = AXES * (turns + column[robot]) + c % AXES
        after += _PARTS
    return after


@ti.func
def _add_overlap(
    robot,
    neighbor,
    arm,
    neighbor_arm,
    apart,
    moving,
    robots: Ref,
    column: Ref,
    scratch: Ref,
    total_out: Ref,
):
    """Add the overlap of two docks at the ends of arms that are apart by a vector."""
    missed, slope = missed_distance(apart, SPACING, 1)
    way = slope * apart / OVERLAP_SD
    used = _fill_side(0, robot, way, arm, moving, robots, column, scratch)
    used = _fill_side(used, neighbor, -way, neighbor_arm, moving, robots, column, scratch)
    stays = robots.state[robot, RobotState.STAYS] - robots.state[neighbor, RobotState.STAYS]
    _store(used, 0, stays * way, scratch)
    scratch.value[used + _SHARED, 0] = missed / OVERLAP_SD
    for c in range(_SHARED + 1):
        scratch.place[used + c] = _PARTS * moving + c
    _add_products(1, used + _SHARED + 1, scratch, total_out)


@ti.func
def _note_overlap(k, deep, overlap_out: Ref):
    """Remember the greatest overlap of the k-th robot that may move."""
    if k >= 0:
        overlap_out[k] = ti.max(overlap_out[k], deep / OVERLAP_SD)


@ti.func
def _add_overlaps(
    robot,
    neighbor,
    moving,
    robots: Ref,
    column: Ref,
    scratch: Ref,
    total_out: Ref,
    overlap_out: Ref,
):
    """Add the overlaps of docks of two robots that do not touch."""
    between = center_of(robot, robots) - center_of(neighbor, robots)
    for dock in range(robots.arm.shape[1]):
        arm = dock_arm(robot, dock, robots)
        for neighbor_dock in range(robots.arm.shape[1]):
            neighbor_arm = dock_arm(neighbor, neighbor_dock, robots)
            apart = between + arm - neighbor_arm
            deep = overlap_of(robot, dock, neighbor, neighbor_dock, apart, robots)
            if deep > 0.0 and deep < SPACING:
                _add_overlap(
                    robot,
                    neighbor,
                    arm,
                    neighbor_arm,
                    apart,
                    moving,
                    robots,
                    column,
                    scratch,
                    total_out,
                )
                _note_overlap(column[robot], deep, overlap_out)
                _note_overlap(column[neighbor], deep, overlap_out)


@ti.kernel
def sum_equations(
    robust_square: F64, non_overlap: I32, reach: F64,
    block: Ints2, member: Ints1, number: Ints2, real: Reals2, noise: Reals2,  # Table
    state: Reals2, arm: Reals3, touch: Ints2, touch_start: Ints1,  # BelievedRobots
    factor: Reals2, row: Reals2, value: Reals2, place: Ints1,  # Scratch
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
    scratch = ti.static(Scratch(factor, row, value, place))
    ti.loop_config(serialize=True)
    for b in range(block.shape[0] - 1):
        moving = mover.shape[0]
        blocks = block.shape[0] - 1
        if b == 0:
            square_out[blocks] = 0.0
        rows = block[b + 1, BlockStart.ROW] - block[b, BlockStart.ROW]
        at = center_of(member[block[b, BlockStart.MEMBERS]], robots)
        values = _number_places(b, moving, table, column, scratch)
        for a in range(rows):
            tail, neighbor_arm = measure_row(b, a, at, table, robots, scratch)
            _fill_values(b, a, values, tail, neighbor_arm, table, robots, column, scratch)
        excess = 0.0
        if robust_square > 0.0:
            excess = give_way(b, robust_square, table, scratch)
        square_out[blocks] += excess
        # With L the factor of the covariance, products of L^-1 V are those of V in its inverse.
        factor_covariance(b, table, scratch)
        for u in range(values):
            whiten(u, b, table, scratch)
        _add_products(rows, values, scratch, total_out)
        square_out[b] = excess
        for a in range(rows):
            square_out[b] += value[values - 1, a] ** 2
    ti.loop_config(serialize=True)
    for k in range(mover.shape[0] * non_overlap):
        robot = mover[k]
        center = center_of(robot, robots)
        moving = mover.shape[0]
        for neighbor in range(state.shape[0]):
            # A pair that may both move is listed once.
            is_listed = neighbor != robot and (neighbor < robot or column[neighbor] < 0)
            # Docks of robots that have left are in nobody's way.
            gone = state[robot, RobotState.GONE] + state[neighbor, RobotState.GONE]
            is_listed = is_listed and gone == 0.0
            if is_listed and (center - center_of(neighbor, robots)).norm_sqr() < reach * reach:
                _add_overlaps(
                    robot, neighbor, moving, robots, column, scratch, total_out, overlap_out
                )


@ti.func
def _sum_at(at, table: Ref, robots: Ref, scratch: Ref, total_out: Ref):
    """Add up the squares of the rows of one robot at a place, as `sum_equations` does."""
    rows = table.block[1, BlockStart.ROW]
    for a in range(rows):
        measure_row(0, a, at, table, robots, scratch)
        for c in ti.static(range(AXES)):
            scratch.value[c, a] = scratch.row[a, RowState.DIRECTION + c]
        scratch.value[AXES, a] = scratch.row[a, RowState.RESIDUAL]
    factor_covariance(0, table, scratch)
    for u in range(_VALUES):
        whiten(u, 0, table, scratch)
        scratch.place[u] = u
        for v in range(_VALUES):
            total_out[u, v] = 0.0
    _add_products(rows, _VALUES, scratch, total_out)


@ti.func
def _step(total: Ref):
    """Solve for the damped step to the minimum [R]."""
    information = ti.Matrix.zero(ti.f64, AXES, AXES)
    slope = ti.Vector([0.0, 0.0, 0.0])
    for u in ti.static(range(AXES)):
        for v in ti.static(range(AXES)):
            information[u, v] = total[max(u, v), min(u, v)]
        information[u, u] += CANDIDATES.damping
        slope[u] = total[AXES, u]
    return -(information.inverse() @ slope)


@ti.func
def _merged(count, place_out: Ref):
    """Keep the first of places that are close to each other; return how many these are."""
    kept = 0
    for n in range(count):
        candidate = vector_at(place_out, n)
        is_new = True
        for k in range(kept):
            if (candidate - vector_at(place_out, k)).norm() < CANDIDATES.merge_distance:
                is_new = False
        if is_new:
            for c in ti.static(range(AXES)):
                place_out[kept, c] = candidate[c]
            kept += 1
    return kept


@ti.func
def _overlaps_at(at, robot, reach, robots: Ref):
    """Sum the squares of overlaps of a robot at a place, in variances."""
    total = 0.0
    for neighbor in range(robots.state.shape[0]):
        between = at - center_of(neighbor, robots)
        is_present = neighbor != robot and robots.state[neighbor, RobotState.GONE] == 0.0
        if is_present and between.norm_sqr() < reach * reach:
            for neighbor_dock in range(robots.arm.shape[1]):
                apart = between - dock_arm(neighbor, neighbor_dock, robots)
                for dock in range(robots.arm.shape[1]):
                    away = apart + dock_arm(robot, dock, robots)
                    deep = overlap_of(robot, dock, neighbor, neighbor_dock, away, robots)
                    total += (deep / OVERLAP_SD) ** 2
    return total


@ti.kernel
def descend(
    non_overlap: I32, reach: F64,
    block: Ints2, member: Ints1, number: Ints2, real: Reals2, noise: Reals2,  # Table
    state: Reals2, arm: Reals3, touch: Ints2, touch_start: Ints1,  # BelievedRobots
    factor: Reals2, row: Reals2, value: Reals2, place: Ints1,  # Scratch
    total_out: Reals2, place_out: Reals2, cost_out: Reals1, count_out: Ints1,
):  # fmt: skip
    """Step from all starts to minima of the chi-square of one block.

    Args:
        non_overlap: Whether docks that do not touch must not overlap.
        reach: Distance of centers beyond which no docks overlap [R].
        total_out: Room for products of three shifts and the residual, in pairs, shape (4, 4).
        place_out: Starts, then the places that they led to [R], shape (starts, 3).
        cost_out: Chi-square of the rows and squares of overlaps at each place, shape (starts,).
        count_out: How many places are left, shape (1,).
    """
    table = ti.static(Table(block, member, number, real, noise))
    robots = ti.static(BelievedRobots(state, arm, touch, touch_start))
    scratch = ti.static(Scratch(factor, row, value, place))
    ti.loop_config(serialize=True)
    for once in range(1):
        robot = member[once]
        count = place_out.shape[0]
        taken = 0
        farthest = CANDIDATES.settled
        while taken < CANDIDATES.rounds and farthest >= CANDIDATES.settled:
            farthest = 0.0
            # Each start goes on by itself: a merge drops starts, and moves none.
            for n in range(count):
                at = vector_at(place_out, n)
                _sum_at(at, table, robots, scratch, total_out)
                step = _step(total_out)
                far = step.norm()
                farthest = ti.max(farthest, far)
                at += step * ti.min(1.0, CANDIDATES.longest_step / ti.max(far, CANDIDATES.settled))
                for c in ti.static(range(AXES)):
                    place_out[n, c] = at[c]
            taken += 1
            # Most starts fall into the same few minima within three steps.
            if taken % CANDIDATES.merge_every == 0:
                count = _merged(count, place_out)
        for n in range(count):
            at = vector_at(place_out, n)
            # The covariance depends on where the robot is.
            _sum_at(at, table, robots, scratch, total_out)
            cost_out[n] = total_out[AXES, AXES]
            if non_overlap:
                cost_out[n] += _overlaps_at(at, robot, reach, robots)
        count_out[0] = count
