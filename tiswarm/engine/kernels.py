"""Virtual forces between docks, and steps of the whole swarm under them.

A force is the step of a robot's center in one iteration [R]. Offsets point from the robot's own
dock to the other one: a positive magnitude pulls toward it. Forces are gathered from a robot's
rows, never scattered, so runs repeat bit for bit. `grid` is the struct of
`tiswarm.compute.neighbor_kernels`.

Centers and docks are real numbers, or whole numbers of a unit: an offset is then exact wherever the
swarm is, while real numbers in f32 lose what is far from the origin. All other lengths are real.
"""

from typing import Any, NamedTuple

from tiswarm.compute.lang import (
    GRAIN,
    I32,
    Columns,
    Float,
    Ints1,
    Ints2,
    Reals1,
    Reals2,
    Reals3,
    Ref,
    Static,
    holds_integers,
    ti,
)  # fmt: skip
from tiswarm.compute.math_kernels import mixed, rotate, vector_at
from tiswarm.compute.neighbor_kernels import (
    Cells,
    ConnectedDocks,
    Rows,
    StructureTable,
    begin_structure,
    fits,
    list_structure,
    read_ahead,
)  # fmt: skip

_TINY = 1e-20
"""Docks nearer than this [R] have no direction to part in, and no force acts on them."""
UNKNOWN = -(2.0**31)
"""Height of robots that no height pulls."""
WALL = 3.0 * 2.0**28
"""Largest whole number of a center; two docks' numbers then differ by one that fits in 32 bits."""
OUT_OF_REACH = 1e36
"""Squared step that stands for one beyond the WALL, or too long for its square to fit in an f32."""
NAN_OF_FORCE = 1e38
"""Squared step that stands for NaN of a user's force."""
NAN_OF_STEP = 1e37
"""Squared step that stands for NaN of a user's integrator."""
_LONGEST_F32 = 1e18


class Control(Columns):
    """Columns of what a kernel leaves to the next one."""

    TAKEN = 1
    """Steps taken."""
    STALE_FROM = 1
    """First step for which rows are stale, NEVER if they are fresh: no robot moves from it on."""


NEVER = 2**31 - 1
"""Number of a step that is never taken."""


class Numbers(Columns):
    """Columns of the numbers of a step; those that the dynamics ask for follow."""

    HEIGHT_GAIN = 1
    """k_z of Eq. (3) [1]."""
    SPACING = 1
    """D: distance between the centers of two docks that touch [R]."""
    MAX_STEP = 1
    """Longest step of a robot [R]."""
    CUTOFF = 1
    """Where forces of unconnected docks end [R]."""
    ORIGIN = 3
    """Place of a center with the numbers 0 [R]."""


class SwarmState(NamedTuple):
    """What the swarm step reads and writes of N robots with M docks in all."""

    position: Reals2
    """Centers [R or units], shape (N, 3)."""

    reference: Reals2
    """Centers as the rows were made [R or units], shape (N, 3)."""

    height: Reals1
    """Height that is pulled toward, or UNKNOWN, as z of centers, shape (N,), or (1,) if unused."""

    arm: Reals2
    """Center to dock, world frame [R], shape (M, 3)."""

    dock: Reals1
    """Places of docks and, last, their structure: two halves of M rows of four. Step t reads the
    half `t % 2` and writes the other one."""

    mobility: Reals2
    """Step along each axis for a force of 1 [1], shape (N, 3), or (1, 1) if unused."""

    last_step: Reals2
    """Last step of each robot [R], shape (N, 3), or (1, 1) if unused."""

    number: Ints1
    """Seed, number of the first step, and the caller's numbers of robots, shape (2 + N,), or (2,)
    if unused."""

    dock_y: Reals1
    """On processors, `dock` from its second number on; unused on cards."""

    dock_z: Reals1
    """On processors, `dock` from its third number on; unused on cards."""


@ti.func
def in_length(difference, unit, places: Ref):
    """Convert a difference of numbers in `places` to a length."""
    return ti.cast(difference, float) * unit if ti.static(holds_integers(places)) else difference


@ti.func
def place_of(center, unit, x, y, z, robots: Ref):
    """Convert the numbers of a center to its place; the origin is at x, y, z."""
    return ti.Vector([x, y, z]) + in_length(center, unit, robots.position)


@ti.func
def number_of(robots: Ref, at):
    """Read a whole number: the seed, the first step's, or that of robot `at - 2`."""
    return robots.number[at]


@ti.func
def noise_of(robots: Ref, robot, t):
    """Draw three standard normal numbers, a hash of seed, robot and step, by Box and Muller."""
    stream = mixed(ti.cast(robots.number[0], ti.u64)) ^ ti.cast(robots.number[2 + robot], ti.u64)
    key = mixed(stream) + mixed(ti.cast(robots.number[1] + t, ti.u64))
    share = ti.Vector([0.0, 0.0, 0.0, 0.0])
    for k in ti.static(range(4)):
        share[k] = (ti.cast(mixed(key + ti.u64(k << 20)), float) + 0.5) / 2.0**32
    radius = ti.sqrt(-2.0 * ti.log(share[0]))
    turn = 2.0 * ti.math.pi * share[1]
    last = ti.sqrt(-2.0 * ti.log(share[2])) * ti.cos(2.0 * ti.math.pi * share[3])
    return ti.Vector([radius * ti.cos(turn), radius * ti.sin(turn), last])


@ti.func
def _in_places(length, unit, places: Ref):
    """Convert a length, no vector, to the numbers that `places` holds."""
    return (
        ti.cast(ti.round(ti.max(-WALL, ti.min(length / unit, WALL))), ti.i32)
        if ti.static(holds_integers(places))
        else length
    )


@ti.func
def attract_or_repel(distance, connected, spacing, attraction, repulsion):
    """Compute the magnitude of Eqs. (1) and (2), with attraction A a and repulsion B (1 - a).

    Every branch is computed, since which one holds cannot be predicted in a dense swarm.
    """
    gap = distance - spacing
    square = gap * gap  # a name, so that strict arithmetic multiplies twice, not three times
    pull = ti.select(connected, attraction * gap, 0.0)
    return ti.select(gap > 0.0, pull, -repulsion * square * square)


@ti.func
def dock_pair_force(offset, attraction_gain, repulsion_gain, spacing, ramp):
    """Compute the force on a dock whose connected partner lies at `offset`, Eq. (1).

    With d = |offset|, u = offset / d, spacing D and ramp a:

        F =  A a (d - D) u            if d > D
        F = -B (1 - a) (d - D)^4 u    otherwise
    """
    distance = offset.norm()
    attraction = attraction_gain * ramp
    repulsion = repulsion_gain * (1.0 - ramp)
    pull = attract_or_repel(distance, True, spacing, attraction, repulsion)
    return pull / ti.max(distance, _TINY) * offset


@ti.func
def parting(offset, stiffness, spacing):
    """Compute the force of a spring that only parts: stiffness (d - D) u if d < D, else none."""
    distance = offset.norm()
    return stiffness * ti.min(distance - spacing, 0.0) / ti.max(distance, _TINY) * offset


@ti.func
def capped(step, max_step):
    """Shorten a step to the length `max_step` where it is longer."""
    length = step.norm()
    return step * ti.select(length > max_step, max_step / length, 1.0)


class Dynamics:
    """How a swarm moves: functions of kernels, which are compiled for them."""

    pull: Any
    """Force of a pair as `pull_freely`: a vector, or its magnitude toward the other dock."""

    integrate: Any
    """Step of a robot before it is capped, as `follow_force`: a vector."""

    names: tuple[str, ...]
    """Numbers that they ask for, in the order of columns."""

    is_cut: bool = False
    """Whether the engine ends forces of unconnected docks at the cutoff."""

    asks: tuple[str, ...] = ()
    """Fields of `SwarmState` that they ask for."""

    skin: float = 0.25
    """Reach of rows of neighbors beyond a cutoff of D [D], wider where robots are fast. It grows
    with the square root of the cutoff, since wide skins of long cutoffs hold many pairs."""

    has_force: bool = False
    has_integrator: bool = False
    """Whether it is a function of a user, which may return NaN."""

    def __init__(self, pull: Any, integrate: Any, names: tuple[str, ...], **others: Any) -> None:  # noqa: ANN401
        """Set fields; a tuple would slow quadrants down, and it takes dataclasses apart."""
        vars(self).update(pull=pull, integrate=integrate, names=names, **others)


@ti.func
def pull_freely(_offset, distance, connected, number):
    """Compute the magnitude of Eqs. (1) and (2), from the columns of `Numbers` and FREE."""
    attraction = number[Numbers.TOTAL]
    repulsion = number[Numbers.TOTAL + 1]
    return attract_or_repel(distance, connected, number[Numbers.SPACING], attraction, repulsion)


@ti.func
def part_connected(offset, distance, connected, number):
    """Compute the magnitude of Eqs. (1) and (2), and of a spring that parts connected docks."""
    overlap = ti.min(distance - number[Numbers.SPACING], 0.0)
    spring = ti.select(connected, number[Numbers.TOTAL + 2] * overlap, 0.0)
    return pull_freely(offset, distance, connected, number) + spring


@ti.func
def follow_force(force, _center, _robot, _t, _unit, _robots: Ref, _number):
    """Take the force on a robot as its step t, from where its center is, in numbers of a unit."""
    return force


@ti.func
def follow_guide(force, _center, robot, _t, _unit, robots: Ref, number):
    """Scale the force by the robot's mobility and add momentum; return that, the step."""
    for c in ti.static(range(3)):
        force[c] *= robots.mobility[robot, c]
        force[c] += number[Numbers.TOTAL + 3] * robots.last_step[robot, c]
    return force


FREE = Dynamics(pull_freely, follow_force, ("attraction", "repulsion"))
"""Robots follow the forces of the paper."""
GUIDED = Dynamics(
    part_connected, follow_guide, (*FREE.names, "parting", "momentum"),
    asks=("mobility", "last_step"), skin=0.75,
)  # fmt: skip
"""Robots have a mobility along each axis and inertia, and connected docks part."""


def is_vector(value: Any) -> bool:  # noqa: ANN401 - an expression of a kernel
    """Whether an expression is a vector; to be asked in `ti.static`."""
    return isinstance(value, ti.Matrix) or (hasattr(value, "is_tensor") and value.is_tensor())


@ti.func
def _add_row(
    on_card: Static, grid: Ref, dynamics: Static, number, base, row, row_docks, rows: Ref,
    robots: Ref, force,
):  # fmt: skip
    """Add the forces of the docks of a row."""
    # A processor extends each index to 64 bits by itself: one for three coordinates takes less.
    by_axis = ti.static((robots.dock, robots.dock_y, robots.dock_z))
    flag = 1 << grid.own_bits
    first = rows.first[row]
    for e in range(rows.count[row]):
        entry = rows.entry[first + e * grid.entry_stride]
        at = base + 4 * (row * row_docks + (entry & (flag - 1)))
        neighbor_at = base + 4 * (entry >> (grid.own_bits + 1))
        apart = ti.Vector([
            robots.dock[neighbor_at + c] - robots.dock[at + c]
            if ti.static(on_card) else by_axis[c][neighbor_at] - by_axis[c][at]
            for c in range(3)
        ])  # fmt: skip
        offset = in_length(apart, grid.unit, robots.dock)
        distance = offset.norm()
        connected = (entry & flag) != 0
        pull = dynamics.pull(offset, distance, connected, number)
        # An `or` would be a branch, which keeps compilers from vectorizing the loop.
        reaches = connected | (offset.norm_sqr() < number[Numbers.CUTOFF] ** 2)
        if ti.static(is_vector(pull)):
            for c in ti.static(range(3)):
                force[c] += ti.select(reaches, pull[c], 0.0)
        else:
            if ti.static(dynamics.is_cut):
                pull = ti.select(reaches, pull, 0.0)
            force += pull / ti.max(distance, _TINY) * offset
    return force


@ti.func
def _force_on_robot(
    on_card: Static, dynamics: Static, grid: Ref, number, base, robot, rows: Ref, robots: Ref
):  # fmt: skip
    """Sum the forces of a robot's rows."""
    force = ti.Vector([0.0, 0.0, 0.0])
    if ti.static(on_card):
        for row in range(robot * grid.docks, (robot + 1) * grid.docks):
            force = _add_row(on_card, grid, dynamics, number, base, row, 1, rows, robots, force)
    else:
        force = _add_row(
            on_card, grid, dynamics, number, base, robot, grid.docks, rows, robots, force
        )
    return force


@ti.func
def step_robot(
    on_card: Static, dynamics: Static, grid: Ref, numbers: Ref, t, base, next_base, robot,
    rows: Ref, robots: Ref,
):  # fmt: skip
    """Move a robot by its forces; return its squared step and distance from its reference.

    A robot whose whole numbers would go beyond the WALL stops there; its step is OUT_OF_REACH.
    """
    count = ti.static(Numbers.TOTAL + len(dynamics.names))
    number = ti.Vector([numbers[t, c] for c in range(count)])
    force = _force_on_robot(on_card, dynamics, grid, number, base, robot, rows, robots)
    center = vector_at(robots.position, robot)
    # Nested, since the language evaluates both sides of an `and`.
    if number[Numbers.HEIGHT_GAIN] > 0.0:
        if robots.height[robot] != UNKNOWN:
            rise = in_length(robots.height[robot] - center[2], grid.unit, robots.height)
            force[2] += number[Numbers.HEIGHT_GAIN] * rise
    wanted = dynamics.integrate(force, center, robot, t, grid.unit, robots, number)
    lost = 0.0
    if ti.static(dynamics.has_integrator):
        lost = ti.select(ti.math.isnan(wanted.norm_sqr()), NAN_OF_STEP, lost)
    if ti.static(dynamics.has_force):
        lost = ti.select(ti.math.isnan(force.norm_sqr()), NAN_OF_FORCE, lost)
    step = capped(wanted, number[Numbers.MAX_STEP])
    square = step.norm_sqr()
    if ti.static(dynamics.has_force or dynamics.has_integrator):
        square = ti.select(lost > 0.0, lost, square)
        for c in ti.static(range(3)):
            step[c] = ti.select(lost > 0.0, 0.0, step[c])
    strayed = 0.0
    for c in ti.static(range(3)):
        center[c] += _in_places(step[c], grid.unit, robots.position)
        if ti.static(holds_integers(robots.position)):
            beyond = ti.abs(center[c]) >= int(WALL) or ti.abs(step[c]) >= WALL * grid.unit
            if beyond or ti.abs(wanted[c]) > _LONGEST_F32:
                square = OUT_OF_REACH
            center[c] = ti.max(-int(WALL), ti.min(center[c], int(WALL)))
        robots.position[robot, c] = center[c]
        moved = center[c] - robots.reference[robot, c]
        strayed += in_length(moved, grid.unit, robots.position) ** 2
        if ti.static("last_step" in dynamics.asks):
            robots.last_step[robot, c] = step[c]
    for m in range(robot * grid.docks, (robot + 1) * grid.docks):
        for c in ti.static(range(3)):
            arm = _in_places(robots.arm[m, c], grid.unit, robots.dock)
            robots.dock[next_base + 4 * m + c] = center[c] + arm
    return square, strayed


@ti.kernel
def step_robots(
    on_card: Static, steps: Static, dynamics: Static, docks: I32, own_bits: I32, entry_stride: I32,
    stray_limit: Float, unit: Float, first_t: I32, numbers: Reals2,
    entry: Ints1, row_first: Ints1, row_count: Ints1,  # Rows
    position_out: Reals2, reference: Reals2, height: Reals1, arm: Reals2, dock_out: Reals1,
    mobility: Reals2, last_step_out: Reals2, number: Ints1, dock_y: Reals1,
    dock_z: Reals1,  # SwarmState
    control_out: Ints1, largest_move_out: Reals1,
):  # fmt: skip
    """Move every robot a few times, until rows are stale.

    One call takes several steps, since a call takes as long as a thousand robots do.

    On cards a reduction of real numbers would be a loop of compare-and-swap in every warp. There
    robots that strayed write which step is stale, all the same, and few the bits of a step, which
    order as integers do. So a step is one launch.

    Args:
        on_card: Whether a graphics card computes.
        steps: Most steps of a call.
        dynamics: A `Dynamics`.
        docks: First number of `grid`.
        stray_limit: Distance of a robot from its reference at which rows are stale [R].
        unit: What whole centers and docks are numbers of [R]; unused if they are real.
        first_t: Which step comes first.
        numbers: Columns of `Numbers` and those of the dynamics in each step, shape (T, columns).
        control_out: Columns of `Control`; read, too.
        largest_move_out: Longest step of a robot in step t [R], shape (T,); on cards the bits of
            its square as an f32, 0 before.
    """
    rows = ti.static(Rows(entry, row_first, row_count))
    robots = ti.static(SwarmState(
        position_out, reference, height, arm, dock_out, mobility, last_step_out, number, dock_y,
        dock_z,
    ))  # fmt: skip
    # The one dock of a card's row needs no bits, and entries of a processor's follow each other;
    # known to the compiler, this saves registers and arithmetic.
    grid = ti.Struct(
        docks=docks, own_bits=0 if ti.static(on_card) else own_bits,
        entry_stride=entry_stride if ti.static(on_card) else 1, unit=unit,
    )  # fmt: skip
    half = dock_out.shape[0] // 2
    for k in ti.static(range(steps)):
        moved = 0.0
        strayed = 0.0
        for robot in range(position_out.shape[0]):
            if first_t + k < ti.min(control_out[Control.STALE_FROM], numbers.shape[0]):
                base = (first_t + k) % 2 * half
                if ti.static(not on_card):
                    ti.atomic_max(
                        strayed, ti.cast(read_ahead(base, robot * docks, docks, dock_out), float)
                    )
                moved_by, way = step_robot(
                    on_card, dynamics, grid, numbers, first_t + k, base, half - base, robot, rows,
                    robots,
                )  # fmt: skip
                if ti.static(on_card):
                    if way > stray_limit * stray_limit:
                        control_out[Control.STALE_FROM] = first_t + k + 1
                    bits = ti.bit_cast(ti.cast(moved_by, ti.f32), ti.i32)
                    if bits > largest_move_out[first_t + k]:
                        ti.atomic_max(largest_move_out[first_t + k], bits)
                    if robot == 0:
                        control_out[Control.TAKEN] = first_t + k + 1
                else:
                    ti.atomic_max(moved, moved_by)
                    ti.atomic_max(strayed, way)
        if ti.static(not on_card):
            t = first_t + k
            if t < ti.min(control_out[Control.STALE_FROM], numbers.shape[0]):
                control_out[Control.TAKEN] = t + 1
                if strayed > stray_limit * stray_limit:
                    control_out[Control.STALE_FROM] = t + 1
                largest_move_out[t] = ti.sqrt(moved)


@ti.kernel
def turn_docks(orientation_wxyz: Reals2, dock_offset_body: Reals2, arm_out: Reals2):
    """Turn every robot's docks into the world.

    Args:
        orientation_wxyz: Body to world, shape (N, 4).
        dock_offset_body: Center to dock, body frame [R], shape (docks, 3).
        arm_out: Center to dock, world frame [R], shape (M, 3).
    """
    docks = dock_offset_body.shape[0]
    for m in range(arm_out.shape[0]):
        turn = ti.Vector([orientation_wxyz[m // docks, c] for c in range(4)])
        offset = rotate(turn, vector_at(dock_offset_body, m % docks))
        for c in ti.static(range(3)):
            arm_out[m, c] = offset[c]


@ti.kernel
def place_docks(unit: Float, structure: Ints1, position: Reals2, arm: Reals2, dock_out: Reals1):
    """Place every robot's docks, in both halves of `dock`.

    Args:
        unit: As for `step_robots`.
        structure: Number of each robot's structure, shape (N,).
        position: Centers, as `SwarmState` describes them.
        arm: Center to dock, world frame [R], shape (M, 3).
        dock_out: As `SwarmState` describes it.
    """
    docks = arm.shape[0] // position.shape[0]
    for m in range(arm.shape[0]):
        for half in ti.static(range(2)):
            at = 4 * (half * arm.shape[0] + m)
            for c in ti.static(range(3)):
                dock_out[at + c] = position[m // docks, c] + _in_places(arm[m, c], unit, dock_out)
            dock_out[at + 3] = structure[m // docks]


@ti.kernel
def start_interval(
    t: I32, room: I32, longest: Ints1, position: Reals2, reference_out: Reals2, control_out: Ints1
):
    """Note where robots are as rows are made before step t; none moves if these lack room.

    Args:
        t: Step that comes next.
        room: Entries that fit for a run's rows.
        longest: Most entries of a run, shape (1,).
        position: Centers, as `SwarmState` describes them, as the arrays below.
        reference_out: Centers as the rows are made.
        control_out: Columns of `Control`.
    """
    for robot in range(position.shape[0]):
        for c in ti.static(range(3)):
            reference_out[robot, c] = position[robot, c]
        if robot == 0:
            control_out[Control.STALE_FROM] = ti.select(longest[0] <= room, NEVER, t)


@ti.kernel
def to_device(order: Ints1, by_caller: Reals2, numbers_out: Reals2):
    """Copy numbers of robots in the caller's order to the device's, all of shape (N, columns).

    Args:
        order: The caller's number of each robot, shape (N,).
        by_caller: Numbers in the caller's order.
        numbers_out: Numbers in the device's order.
    """
    for robot in range(order.shape[0]):
        for c in range(numbers_out.shape[1]):
            numbers_out[robot, c] = by_caller[order[robot], c]


@ti.kernel
def to_caller(
    order: Ints1, numbers: Reals2, unit: Float, x: Float, y: Float, z: Float, by_caller_out: Reals2
):
    """Copy numbers of robots in the device's order to the caller's, all of shape (N, 3).

    Whole numbers of a unit become lengths where the array that is written has real numbers; x, y, z
    is the place of a center with the numbers 0. Other arguments as for `to_device`.
    """
    origin = ti.Vector([x, y, z])
    for robot in range(order.shape[0]):
        for c in ti.static(range(3)):
            number = numbers[robot, c]
            if ti.static(holds_integers(numbers) and not holds_integers(by_caller_out)):
                by_caller_out[order[robot], c] = origin[c] + ti.cast(number, float) * unit
            else:
                by_caller_out[order[robot], c] = number


@ti.kernel
def find_bounds(position: Reals2, bounds_out: Reals3):
    """Find the least and the greatest numbers of centers in each of some parts of the swarm.

    Args:
        position: Centers, as `SwarmState` describes them; at least as many as parts.
        bounds_out: Least, then greatest, along each axis, shape (parts, 2, 3).
    """
    parts = bounds_out.shape[0]
    for part in range(parts):
        low = vector_at(position, part)
        high = low
        robot = part
        while robot < position.shape[0]:
            at = vector_at(position, robot)
            low = ti.min(low, at)
            high = ti.max(high, at)
            robot += parts
        for c in ti.static(range(3)):
            bounds_out[part, 0, c] = low[c]
            bounds_out[part, 1, c] = high[c]


@ti.kernel
def relax_structures(
    dynamics: Static, own_bits: I32, cutoff: Float, stray_limit: Float, unit: Float,
    numbers: Reals2, structure_out: Ints2,
    begin_out: Ints1, sorted_dock_out: Ints1, sorted_place_out: Ints1,  # Cells
    connection_start: Ints1, connection: Ints1,  # ConnectedDocks
    entry_out: Ints1, row_first_out: Ints1, row_count_out: Ints1,  # Rows
    position_out: Reals2, reference_out: Reals2, height: Reals1, arm: Reals2, dock_out: Reals1,
    mobility: Reals2, last_step_out: Reals2, number: Ints1, dock_y: Reals1,
    dock_z: Reals1,  # SwarmState
    largest_move_out: Reals2,
):  # fmt: skip
    """Take every step of small structures, each on one thread.

    A structure stops where its rows do not fit.

    Args:
        dynamics: A `Dynamics`.
        own_bits: First number of `grid`.
        stray_limit: As for `step_robots`, like `unit` and `numbers`.
        structure_out: Columns of `StructureTable`, shape (S, 10).
        largest_move_out: Longest step of a robot by structure and step [R], shape (S, T).
    """
    cells = ti.static(Cells(begin_out, sorted_dock_out, sorted_place_out))
    connections = ti.static(ConnectedDocks(connection_start, connection))
    rows = ti.static(Rows(entry_out, row_first_out, row_count_out))
    robots = ti.static(SwarmState(
        position_out, reference_out, height, arm, dock_out, mobility, last_step_out, number, dock_y,
        dock_z,
    ))  # fmt: skip
    table = ti.static(structure_out)
    docks = arm.shape[0] // position_out.shape[0]
    half = dock_out.shape[0] // 2
    for s, idle in ti.ndrange(table.shape[0], GRAIN):
        if idle == 0:
            first = table[s, StructureTable.FIRST]
            end = table[s, StructureTable.END]
            grid = ti.Struct(
                docks=docks, own_bits=own_bits, earlier=1, cutoff=cutoff, slot=first * docks,
                table=table[s, StructureTable.TABLE], buckets=table[s, StructureTable.BUCKETS],
                stride_y=table[s, StructureTable.STRIDE_Y],
                stride_z=table[s, StructureTable.STRIDE_Z], entry_stride=1, unit=unit,
            )  # fmt: skip
            begin_structure(s, table)
            stale = 1
            for t in range(numbers.shape[0]):
                base = t % 2 * half
                if stale == 1 and fits(s, table):
                    list_structure(grid, s, base, dock_out, cells, connections, rows, table)
                    stale = 0
                    for robot in range(first, end):
                        for c in ti.static(range(3)):
                            reference_out[robot, c] = position_out[robot, c]
                if fits(s, table):
                    moved = 0.0
                    for robot in range(first, end):
                        moved_by, way = step_robot(
                            False, dynamics, grid, numbers, t, base, half - base, robot, rows,
                            robots,
                        )  # fmt: skip
                        moved = ti.max(moved, moved_by)
                        if way > stray_limit * stray_limit:
                            stale = 1
                    largest_move_out[s, t] = ti.sqrt(moved)
