"""Walks: how robots climb a structure that stands still meanwhile, flip by flip, and then join it.

A flip turns a robot about an axis through one of its attached docks (the pivot), at right
angles to the line from that dock to the robot's center, until another dock first touches
something: another dock, or the ground. It is planned by where the robot believes
docks are, and ends by where they are; where robots know, both are the same.

A dock that turns about a pivot by the angle t has, along any fixed direction, a coordinate of
the form a cos t + b sin t + c. Against a dock at w from the pivot the direction is w, against
flat ground it is straight down; both ask where a cos t + b sin t first rises through a level,
which has a closed form. At a rounded edge the squared distance to its axis is followed in
steps that cannot jump over a contact. On ground of any other form the steps follow from the
distance to it (`ground/kernels.py`).

Robots that climbed at the same time join in turn. Lengths in R, angles in rad, all in float64.
"""

from typing import Any, NamedTuple

from tiswarm.compute.lang import (
    F64,
    GRAIN,
    I32,
    Columns,
    Ints1,
    Ints2,
    Ints3,
    Ints4,
    Reals1,
    Reals2,
    Reals3,
    Ref,
    Static,
    Vec3,
    Vec4,
    kernel_struct,
    ti,
)
from tiswarm.compute.math_kernels import TIE, rotate, turn_order, vector_at, vector_in
from tiswarm.compute.neighbor_kernels import CellList, cube_of, first_item, link
from tiswarm.world.ground.kernels import GroundArray, arc_angle, distance_to, zone_distance

FLAT = 1
"""Flat ground that a dock stands on; 0 for no ground."""
EDGE = 2
"""Rounded edge, underside, or ground of any other form, that a dock stands on."""
MAX_TOUCHING = 12
"""No more unit spheres than this can touch one (the kissing number)."""


@kernel_struct
class ClimbLimits:
    """Numbers that do not change during a climb; see `ClimbParams` and `Terrain`.

    The ground's are those of one structure: kernels put in those of each, see `limits_of`.
    """

    spacing: F64
    contact_gap: F64
    ground_z: F64
    left_edge: F64
    right_edge: F64
    min_flip: F64
    max_flip: F64
    revisit_distance: F64
    full_turn: F64
    reach: F64
    longest_flip: F64
    inverse_edge: F64
    is_planar: I32
    by_belief: I32


class StructureArrays(NamedTuple):
    """S structures with room for N robots of n docks each; n i + k is dock k of robot i."""

    cells: CellList
    """The joined docks by place."""

    dock: Reals3
    """Dock centers [R]; rows of robots that have not joined are meaningless, (S, n N, 3)."""

    relay: Ints2
    """Call that each dock passes on; a robot that touches a positive one is recruited, (S, n N)."""

    robot_count: Ints1
    """Robots that have joined, shape (S,)."""


class ClimbedDocks(NamedTuple):
    """What climbers touch of `StructureArrays`."""

    cells: CellList
    dock: Reals3
    relay: Ints2


class BelievedDocks(NamedTuple):
    """The joined docks where robots believe them; those of `StructureArrays` if they know."""

    cells: CellList
    """The docks by believed place."""

    dock: Reals3
    """Dock centers [R], shape (S, n N, 3)."""


class Beliefs(NamedTuple):
    """What robots that climb believe: `BelievedDocks`, and how they stand."""

    cells: CellList
    dock: Reals3
    turn: Reals3
    """From the orientation at each stance to the sensed one, wxyz, shape (slots, stances, 4)."""


class Manner(Columns):
    """How a robot ends its climb."""

    PATIENCE = 1
    """Steps in a row without a new best with which it gives up; 0 to stay where it starts."""
    SETTLES = 1
    """Whether it turns, where it stays, until a third dock touches."""


class Climbers(NamedTuple):
    """Robots that climb at the same time, one slot each."""

    structure: Ints1
    """Structure that each slot's robots climb, ascending, shape (slots,)."""

    first_stance: Ints1
    """Stance to go on from; those before it are kept, shape (slots,)."""

    goal: Reals2
    """Goal of each [R], shape (slots, 3)."""

    manner: Ints2
    """Columns of `Manner`, shape (slots, 2)."""

    dock_offset_body: Reals2
    """Center to dock in the body frame [R], shape (n, 3)."""

    twist: Reals2
    """Cosine and sine of each axis's angle to the first at the same dock, shape (axes, 2)."""

    near: Reals3
    """Scratch: vectors from the pivot to docks in reach, as believed, shape (slots, near, 3).

    As many more rows have them as they are, for robots that do not know: see `row_of_true`.
    """

    ground: Reals1
    """Numbers of bodies of the ground, and of zones, as `ground.kernels.GroundArray` has them."""

    of_structure: Reals2
    """Columns of `StructureColumn`, and settings that the score of its rule asks for, (S, P)."""


class StructureColumn(Columns):
    """Numbers of a structure: where its ground is, if that has a closed form."""

    GROUND_Z = 1
    """Height of its top [R]."""
    LEFT_EDGE = 1
    """Where the slab on the left ends [R]."""
    RIGHT_EDGE = 1
    """Where the slab on the right begins [R]."""


class Laws(NamedTuple):
    """What kernels are compiled for."""

    score: Any
    """Function of (center, orientation, goal, numbers of structures, structure) to minimize."""

    users: tuple[Any, ...] = ()
    """Functions of users for the ground."""

    is_flat: bool = True
    """Whether the ground has a closed form, a plane or slabs, and no bodies."""

    has_zones: bool = False
    """Whether there are zones that robots may not enter."""


@ti.func
def limits_of(limits: Ref, of_structure: Ref, s):
    """Put the ground of a structure into the limits."""
    return ClimbLimits(
        spacing=limits.spacing,
        contact_gap=limits.contact_gap,
        ground_z=of_structure[s, StructureColumn.GROUND_Z],
        left_edge=of_structure[s, StructureColumn.LEFT_EDGE],
        right_edge=of_structure[s, StructureColumn.RIGHT_EDGE],
        min_flip=limits.min_flip,
        max_flip=limits.max_flip,
        revisit_distance=limits.revisit_distance,
        full_turn=limits.full_turn,
        reach=limits.reach,
        longest_flip=limits.longest_flip,
        inverse_edge=limits.inverse_edge,
        is_planar=limits.is_planar,
        by_belief=limits.by_belief,
    )


class Site(NamedTuple):
    """The ground that robots climb on, and zones that they may not enter."""

    ground: GroundArray
    is_flat: bool
    has_zones: bool


def site_of(ground: Reals1, laws: Laws) -> Site:
    """Bundle what says where the ground is."""
    return Site(GroundArray(ground, laws.users), laws.is_flat, laws.has_zones)


class Obstacles(NamedTuple):
    """What turning docks may meet."""

    near: Reals3
    """Vectors from the pivot to docks in reach, shape (rows, near, 3)."""

    site: Site


class WalkArrays(NamedTuple):
    """Stances of the climbers' walks, by slot."""

    center: Reals3
    """Centers [R], shape (slots, stances, 3)."""

    orientation: Reals3
    """Body to world, wxyz, shape (slots, stances, 4)."""

    pivot_dock: Ints2
    """Dock that stays put as the robot leaves a stance, shape (slots, stances)."""

    touching: Ints4
    """Docks of the structure that each dock touches, or -1, (slots, stances, n, MAX_TOUCHING)."""

    on_ground: Ints3
    """0, FLAT or EDGE, shape (slots, stances, n)."""

    last: Ints1
    """Last stance of each walk, shape (slots,)."""

    best: Ints1
    """Best stance of each walk, shape (slots,)."""

    stay: Ints1
    """Stance where each robot stays, settled or not, shape (slots,)."""


NEVER = 4.0
"""In place of a `turn_order`: what is not met in a full turn."""
RESTS = -1.0
"""In place of a `turn_order`: what is met where the turn starts."""
_SETTLED_RISE = 1e-12
"""A dock whose coordinate swings by less than this [R] slides along: it never enters."""
_RESTING_ANGLE = 1e-7
"""A contact met this little before the start of a turn is the one the dock rests on [rad]."""
_RESTING_GAP = 1e-10
"""Squared distances to an edge this close to contact are contact [R^2]."""
_MET = 1e-13
"""Largest step that counts as arrival at the edge [rad]."""
_NUDGE = 1e-3
"""Turn after which a dock that leaves an edge tangentially is clear of it [rad]."""
_MAX_STEPS = 500
"""Most steps along an edge; 10 to 40 are usual."""
_IN_SUCCESSION = 8
"""Stances of a walk that one of them may exclude."""
_DOCKS_OF_AN_AXIS = 2
"""Attached docks with which a robot settles: it turns about the line through both."""


@ti.func
def quaternion_at(array: Ref, i, j):
    """Read a quaternion from the last axis of a three-dimensional array."""
    return ti.Vector([array[i, j, c] for c in range(4)])


@ti.func
def quaternion_product(p, q):
    """Compose rotations: first `q`, then `p`."""
    return ti.Vector([
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    ])  # fmt: skip


@ti.func
def axis_rotation(axis, angle):
    """Rotation by `angle` [rad] about the unit vector `axis`."""
    s = ti.sin(0.5 * angle)
    return ti.Vector([ti.cos(0.5 * angle), s * axis[0], s * axis[1], s * axis[2]])


@ti.func
def _ahead(angle, full_turn):
    """Wrap an angle to [0, a full turn); an angle just behind 0 is the contact it rests on."""
    wrapped = angle - full_turn * ti.floor(angle / full_turn)
    return ti.select(wrapped > full_turn - _RESTING_ANGLE, 0.0, wrapped)


@ti.func
def crossing_angles(a, b, level, full_turn):
    """Find where a cos t + b sin t first rises through `level`, turning forward and backward.

    Returns a full turn where it never does. Rising means entering: the obstacle lies above the
    level. A dock above the level all the way round touches at its lowest point, where it starts,
    and cannot turn.
    """
    angles = ti.Vector([full_turn, full_turn])
    swing = ti.sqrt(a * a + b * b)
    if swing <= -level and swing > _SETTLED_RISE:
        angles = ti.Vector([0.0, 0.0])
    elif swing > level and swing > _SETTLED_RISE:
        peak = ti.atan2(b, a)
        half_width = ti.acos(level / swing)
        angles[0] = _ahead(peak - half_width, full_turn)
        angles[1] = _ahead(-peak - half_width, full_turn)
    return angles


@ti.func
def _edge_angle(middle, across, onward, edge, side, limits):
    """Find the turn after which a dock first meets a slab with a rounded edge, or a full turn.

    The slab ends at `edge`, on its right for a `side` of 1, else -1 on its left.
    The dock is at middle + across cos t + onward sin t. Its squared distance to the slab's
    spine less D^2, g(t), is smooth with |g''| <= m, so up to the root of
    g + g' h - m h^2 / 2 nothing can be met.
    """
    depth = 0.5 * limits.spacing
    height = middle[2] - (limits.ground_z - depth)
    swing_x = ti.sqrt(across[0] * across[0] + onward[0] * onward[0])
    swing_z = ti.sqrt(across[2] * across[2] + onward[2] * onward[2])
    reach_x = ti.max(side * (middle[0] - edge) + swing_x, 0.0)
    bend = 2.0 * (swing_x * (swing_x + reach_x) + swing_z * (swing_z + ti.abs(height) + swing_z))
    met = limits.full_turn
    t = 0.0 * height
    steps = 0
    if swing_z < _SETTLED_RISE and ti.abs(height) > limits.spacing - _RESTING_GAP:
        t = limits.full_turn  # it slides along the flat and never enters
    # Each step ends before anything can be met: no contact is jumped over.
    while t < limits.full_turn and steps < _MAX_STEPS:
        steps += 1
        c = ti.cos(t)
        s = ti.sin(t)
        out = ti.max(side * (middle[0] + across[0] * c + onward[0] * s - edge), 0.0)
        up = height + across[2] * c + onward[2] * s
        gap = out * out + up * up - limits.spacing * limits.spacing
        slope = 2.0 * side * out * (onward[0] * c - across[0] * s)
        slope += 2.0 * up * (onward[2] * c - across[2] * s)
        if gap < _RESTING_GAP and t == 0.0 and slope > -_RESTING_GAP:
            gap = 0.0
            t = ti.max(slope / bend, _NUDGE)
        else:
            room = slope * slope + 2.0 * bend * gap
            step = (slope + ti.sqrt(ti.max(room, 0.0))) / bend
            if step < _MET:
                met = t
                break
            t += step
    return ti.min(met, limits.full_turn)


@ti.func
def slab_angles(middle, across, onward, edge, side, limits):
    """Find the angles, forward and backward, at which a dock first meets a slab."""
    angles = ti.Vector([limits.full_turn, limits.full_turn])
    swing_x = ti.sqrt(across[0] * across[0] + onward[0] * onward[0])
    swing_z = ti.sqrt(across[2] * across[2] + onward[2] * onward[2])
    top = limits.ground_z + 0.5 * limits.spacing
    if middle[2] - swing_z < top + _RESTING_GAP:
        inland = side * (middle[0] - edge) + swing_x <= 0.0
        if inland and middle[2] > limits.ground_z:
            angles = crossing_angles(-across[2], -onward[2], middle[2] - top, limits.full_turn)
        elif side * (middle[0] - edge) - swing_x < limits.spacing:
            angles[0] = _edge_angle(middle, across, onward, edge, side, limits)
            angles[1] = _edge_angle(middle, across, -onward, edge, side, limits)
    return angles


@ti.func
def _slabs_angles(limits: Ref, pivot, circle):
    """Find the angles, forward and backward, at which a dock first meets either slab."""
    middle = pivot + circle.along * circle.axis
    across = circle.across
    onward = circle.onward
    left = slab_angles(middle, across, onward, limits.left_edge, 1.0, limits)
    right = slab_angles(middle, across, onward, limits.right_edge, -1.0, limits)
    return ti.min(left, right)


@kernel_struct
class Circle:
    """Way of a dock that turns about an axis through another dock of its robot, the pivot.

    After the angle t it is at along axis + across cos t + onward sin t from the pivot.
    """

    arm: Vec3
    axis: Vec3
    across: Vec3
    onward: Vec3
    along: F64


@kernel_struct
class PivotTurn:
    """A turn of a robot about an axis through one of its docks, or through two of them."""

    orientation: Vec4
    axis: Vec3
    pivot: Vec3
    dock: I32
    second_dock: I32


@ti.func
def turn_about(axis, dock, orientation, pivot):
    """Describe a turn about an axis through a single dock, which is at the pivot."""
    return PivotTurn(orientation=orientation, axis=axis, pivot=pivot, dock=dock, second_dock=dock)


@ti.func
def circle_of(body: Ref, turn, dock):
    """Find the circle of a dock of a robot that turns."""
    arm = rotate(turn.orientation, vector_at(body, dock) - vector_at(body, turn.dock))
    axis = turn.axis
    along = arm.dot(axis)
    return Circle(
        arm=arm, axis=axis, across=arm - along * axis, onward=axis.cross(arm), along=along
    )


@ti.func
def _rise(limits: Ref, circle, to_dock):
    """Return a, b and the level of a dock: it is met where a cos t + b sin t rises through that."""
    squares = circle.arm.norm_sqr() + to_dock.norm_sqr() - limits.spacing * limits.spacing
    level = 0.5 * squares - circle.along * to_dock.dot(circle.axis)
    return ti.Vector([to_dock.dot(circle.across), to_dock.dot(circle.onward), level])


@ti.func
def _rise_orders(rise):
    """Find the `turn_order` of angles at which a dock is met, turning forward and backward.

    It is NEVER for a dock that is not met, and RESTS for one that the turn is at rest on. The third
    number is 1 where rounding decides, else 0. There is no branch: processors would often guess it
    wrong.
    """
    a, b, level = rise[0], rise[1], rise[2]
    swing = a * a + b * b
    room = swing - level * level
    is_met = (room >= TIE * swing) & (swing > 0.0)
    is_close = (room < TIE * swing) & ((level < 0.0) | (room > -TIE * swing))
    side = ti.sqrt(ti.max(room, 0.0))
    sign = ti.Vector([1.0, -1.0])
    cosine = (a * level + sign * b * side) / swing
    sine = (sign * b * level - a * side) / swing
    is_resting = (cosine > 0.0) & (sine < 0.0) & (sine > -0.5 * _RESTING_ANGLE)
    order = ti.select(is_resting, RESTS, turn_order(cosine, sine))
    is_close = is_close | (is_met & (order.max() > NEVER - TIE))
    order = ti.select(is_met, order, NEVER)
    return ti.Vector([order[0], order[1], ti.cast(is_close, F64)])


@ti.func
def _gain_where_met(rise, sense, aim):
    """Return what a robot has gained where it meets a dock; `sense` is 1 forward, -1 backward."""
    a, b, level = rise[0], rise[1], rise[2]
    swing = a * a + b * b
    side = sense * ti.sqrt(swing - level * level)
    return ((a * level + b * side) * aim[0] + (b * level - a * side) * aim[1]) / swing


@ti.func
def _least_close_angles(limits: Ref, body: Ref, turn, near: Ref, row, count, least):
    """Compute the angles of all docks that rounding may put first; return the least each way."""
    first = ti.Vector([limits.full_turn, limits.full_turn])
    for dock in range(body.shape[0]):
        if dock != turn.dock and dock != turn.second_dock:
            circle = circle_of(body, turn, dock)
            for entry in range(count):
                rise = _rise(limits, circle, vector_in(near, row, entry))
                orders = _rise_orders(rise)
                if orders[2] > 0.0 or orders[0] < least[0] + TIE or orders[1] < least[1] + TIE:
                    angles = crossing_angles(rise[0], rise[1], rise[2], limits.full_turn)
                    first = ti.min(first, angles)
    return first


@ti.func
def _ground_angles(limits: Ref, body: Ref, turn, ground: Ref, first, aim):
    """Find the angles, `first` at most, at which a turn meets ground of any form."""
    for case in range(2 * body.shape[0]):  # not unrolled: the compiler takes long
        dock = case // 2
        way = case % 2
        angle = ti.select(way == 0, first[0], first[1])
        if dock != turn.dock and dock != turn.second_dock and angle > 0.0:
            sense = 1.0 - 2.0 * way
            circle = circle_of(body, turn, dock)
            angle = arc_angle(
                turn.pivot + circle.along * circle.axis,
                circle.across,
                sense * circle.onward,
                0.5 * limits.spacing,
                angle,
                ti.Vector([aim[0], sense * aim[1], aim[2], aim[3]]),
                ground,
            )
        first[0] = ti.select(way == 0, angle, first[0])
        first[1] = ti.select(way == 0, first[1], angle)
    return first


@ti.func
def first_met(limits: Ref, body: Ref, turn, obstacles: Ref, row, count, aim):
    """Find the angles, forward and backward, at which a turn meets the ground or a dock of a row.

    After the angle t, cos t aim_0 + sin t aim_1 is what a robot gains, and 0 stands for ways that
    gain less than aim_2 wherever they end, or end before aim_3. A full turn stands for ways that
    meet nothing.
    """
    first = ti.Vector([limits.full_turn, limits.full_turn])
    most = ti.sqrt(aim[0] * aim[0] + aim[1] * aim[1])
    if most < aim[2]:
        first = ti.Vector([0.0, 0.0])
    # Angles cost much more than what says which is the least: one is computed each way.
    least = ti.Vector([NEVER, NEVER])
    second = ti.Vector([NEVER, NEVER])
    a = ti.Vector([0.0, 0.0])
    b = ti.Vector([0.0, 0.0])
    level = ti.Vector([0.0, 0.0])
    is_close = 0.0 * most
    step = 1
    while step < body.shape[0] and first.max() > 0.0:
        dock = (turn.dock + step) % body.shape[0]
        step += 1
        if dock != turn.second_dock:
            circle = circle_of(body, turn, dock)
            if ti.static(obstacles.site.is_flat):
                first = ti.min(first, _slabs_angles(limits, turn.pivot, circle))
            for entry in range(count):
                rise = _rise(limits, circle, vector_in(obstacles.near, row, entry))
                orders = _rise_orders(rise)
                is_close = ti.max(is_close, orders[2])
                order = ti.Vector([orders[0], orders[1]])
                is_less = order < least
                second = ti.select(is_less, least, ti.select(order < second, order, second))
                least = ti.select(is_less, order, least)
                a = ti.select(is_less, rise[0], a)
                b = ti.select(is_less, rise[1], b)
                level = ti.select(is_less, rise[2], level)
            first = ti.select(least == RESTS, 0.0, first)
    is_tied = (first > 0.0) & (least < NEVER) & (second < least + TIE)
    if first.max() > 0.0 and (is_close > 0.0 or is_tied.any()):
        near = ti.static(obstacles.near)
        angles = _least_close_angles(limits, body, turn, near, row, count, least)
        first = ti.min(first, angles)
    for way in ti.static(range(2)):
        if first[way] > 0.0 and least[way] < NEVER:
            sense = 1.0 - 2.0 * way
            rise = ti.Vector([a[way], b[way], level[way]])
            gain = _gain_where_met(rise, sense, aim)
            if first[way] < limits.full_turn or ti.static(not obstacles.site.is_flat):
                # It may end before, and passes there what gains most, or gains less and less.
                best = turn_order(aim[0] / most, sense * aim[1] / most)
                gain = ti.select(least[way] > best - TIE, most, ti.max(aim[0], gain))
            if gain < aim[2]:
                first[way] = 0.0
            else:
                angles = crossing_angles(rise[0], rise[1], rise[2], limits.full_turn)
                first[way] = ti.min(first[way], angles[way])
    first = ti.select(first < aim[3], 0.0, first)
    if ti.static(not obstacles.site.is_flat):
        # The search costs much more than that for docks, which often rules a way out.
        first = _ground_angles(limits, body, turn, obstacles.site.ground, first, aim)
    return first


_ALONG = 1e-6
"""Squared sine of the angle below which a dock counts as on the z axis of the body."""
GROUND = -1
"""What a flip is planned to end at if that is no dock."""


@kernel_struct
class Flip:
    """A flip that could be taken, and how many fail that the robot tries before."""

    distance: F64
    center: Vec3
    orientation: Vec4
    planned: Vec4
    pivot: I32
    overflow: I32
    failed: I32


@kernel_struct
class Hinge:
    """An attached dock about which a robot may turn."""

    pivot: Vec3
    body_in: Vec3
    by: Vec3
    normal: Vec3
    side: Vec3
    count: I32
    obstacles: I32
    overflow: I32


@ti.func
def _no_flip(center, q):
    """Stay at a pose, for want of a flip."""
    return Flip(
        distance=ti.math.inf,
        center=center,
        orientation=q,
        planned=q,
        pivot=-1,
        overflow=0,
        failed=0,
    )


@ti.func
def goal_distance(center, _orientation, goal, _of_structure: Ref, _s):
    """Distance of a robot's center to its goal [R]: what a climber of ReactiveBuild minimizes."""
    return (center - goal).norm()


@ti.func
def scored(climbers: Ref, mover, center, q, laws: Ref):
    """Score a pose of a climber, where it believes itself."""
    goal = vector_at(climbers.goal, mover)
    return laws.score(center, q, goal, climbers.of_structure, climbers.structure[mover])


@ti.func
def row_of_true(climbers: Ref, mover):
    """Return the row of `near` where a robot that goes by belief has docks as they are."""
    return climbers.structure.shape[0] + mover


@ti.func
def gather_near(limits: Ref, docks: Ref, s, pivot, near: Ref, row):
    """List the vectors from `pivot` to docks in reach, true or believed; return how many."""
    count = 0
    cube = cube_of(pivot, limits.inverse_edge)
    for which in range(27):
        item = first_item(docks.cells, s, cube, which)
        while item >= 0:
            offset = vector_in(docks.dock, s, item) - pivot
            if offset.norm_sqr() < limits.reach * limits.reach:
                if count < near.shape[1]:
                    for c in ti.static(range(3)):
                        near[row, count, c] = offset[c]
                count += 1
            item = docks.cells.following[s, item]
    return count


@ti.func
def revisits(limits: Ref, walks: Ref, mover, stance, point):
    """Whether the walk up to `stance` has had its center at `point` before.

    Of stances in succession, one that is farther away than they flip excludes all.
    """
    seen = 0
    excluding = limits.revisit_distance + _IN_SUCCESSION // 2 * limits.longest_flip
    for part in range(stance // _IN_SUCCESSION + 1):
        first = part * _IN_SUCCESSION
        middle = ti.min(first + _IN_SUCCESSION // 2, stance)
        if (point - vector_in(walks.center, mover, middle)).norm_sqr() <= excluding**2:
            # Without roots and branches, compilers look at several stances at a time.
            for earlier in range(first, ti.min(first + _IN_SUCCESSION, stance + 1)):
                offset = point - vector_in(walks.center, mover, earlier)
                seen |= ti.cast(offset.norm_sqr() < limits.revisit_distance**2, ti.i32)
    return seen != 0


@ti.func
def enters(limits: Ref, site: Ref, body: Ref, center, q):
    """Whether a dock of a robot reaches into a zone that robots may not enter."""
    is_inside = False
    for k in range(body.shape[0]):
        point = center + rotate(q, vector_at(body, k))
        gap = zone_distance(point, site.ground) - 0.5 * limits.spacing
        is_inside = is_inside or gap < 0.0
    return is_inside


@ti.func
def may_end(limits: Ref, site: Ref, climbers: Ref, walks: Ref, mover, stance, center, q):
    """Whether a flip may end at a pose: where the walk has not been, and in no zone."""
    is_allowed = not revisits(limits, walks, mover, stance, center)
    if ti.static(site.has_zones):
        is_allowed = is_allowed and not enters(limits, site, climbers.dock_offset_body, center, q)
    return is_allowed


@ti.func
def _across(arm):
    """Find the unit vector across `arm` nearest to the body's z axis, or x for an arm along z."""
    size = arm.norm_sqr()
    across = ti.Vector([0.0, 0.0, 1.0]) - arm[2] / size * arm
    if across.norm_sqr() < _ALONG:
        across = ti.Vector([1.0, 0.0, 0.0]) - arm[0] / size * arm
    return across.normalized()


@ti.func
def sensed_orientation(limits: Ref, believed: Ref, walks: Ref, mover, stance):
    """Find the orientation that a robot senses at a stance, its own where it knows the truth."""
    q = quaternion_at(walks.orientation, mover, stance)
    if limits.by_belief:
        q = quaternion_product(quaternion_at(believed.turn, mover, stance), q)
    return q


@ti.func
def misplaced(
    limits: Ref, structures: Ref, believed: Ref, body: Ref, s, walks: Ref, mover, stance, k, place
):
    """Find the vector from where a `place` of a robot's body is to where the robot believes it.

    A robot takes its place from a dock that it touches: with dock `k`, else with another, else at
    the last stance where it touched one. Its sensed orientation leads from there to the place.
    Until it touches a dock, it knows its place.
    """
    by = ti.Vector([0.0, 0.0, 0.0], F64)
    if limits.by_belief:
        docks = walks.touching.shape[2]
        has_touched = False
        at = stance
        while at >= 0 and not has_touched:
            for step in range(docks):
                touching_dock = (k + step) % docks
                item = walks.touching[mover, at, touching_dock, 0]
                if item >= 0 and not has_touched:
                    by = vector_in(believed.dock, s, item) - vector_in(structures.dock, s, item)
                    arm = place - vector_at(body, touching_dock)
                    arm = rotate(quaternion_at(walks.orientation, mover, at), arm)
                    by += rotate(quaternion_at(believed.turn, mover, at), arm) - arm
                    has_touched = True
            at -= 1
    return by


@ti.func
def hinge_at(
    limits: Ref, structures: Ref, believed: Ref, climbers: Ref, walks: Ref, mover, stance, k
):
    """Describe how a robot may turn about its dock `k`, and list the docks that it may meet."""
    s = climbers.structure[mover]
    body = ti.static(climbers.dock_offset_body)
    near = ti.static(climbers.near)
    q = quaternion_at(walks.orientation, mover, stance)
    body_in = vector_at(body, k)
    to_center = -rotate(q, body_in)
    pivot = vector_in(walks.center, mover, stance) - to_center
    by = misplaced(limits, structures, believed, body, s, walks, mover, stance, k, body_in)
    near_count = gather_near(limits, believed, s, pivot + by, near, mover)
    count = ti.min(near_count, near.shape[1])
    overflow = ti.cast(near_count > count, ti.i32)
    obstacles = 0
    if limits.by_belief:
        true_count = gather_near(limits, structures, s, pivot, near, row_of_true(climbers, mover))
        obstacles = ti.min(true_count, near.shape[1])
        overflow = ti.cast(true_count > obstacles, ti.i32)
    normal = rotate(q, ti.Vector([0.0, 0.0, 1.0]))
    if limits.is_planar:
        normal = ti.Vector([0.0, 1.0, 0.0])  # exactly, so that y stays 0
    elif body_in[2] != 0.0:
        normal = rotate(q, _across(body_in))
    side = normal.cross(to_center.normalized())
    return Hinge(
        pivot=pivot,
        body_in=body_in,
        by=by,
        normal=normal,
        side=side,
        count=count,
        obstacles=obstacles,
        overflow=overflow,
    )


@ti.func
def flip_axis(climbers: Ref, hinge, number):
    """Return one of the axes that a robot may turn about at a dock."""
    return climbers.twist[number, 0] * hinge.normal + climbers.twist[number, 1] * hinge.side


@ti.func
def flipped(axis, way, angle, q):
    """Turn an orientation by an angle about an axis, forward for a `way` of 0, else backward."""
    return quaternion_product(axis_rotation(axis, (1.0 - 2.0 * way) * angle), q).normalized()


@ti.func
def _aim(limits: Ref, hinge, axis, goal, nearest, laws: Ref):
    """Return what a flip about an axis gains, and has to gain, as `contact_angles` takes it."""
    to_goal = goal - hinge.pivot
    reach = hinge.body_in.norm()
    ahead = hinge.side.cross(hinge.normal)
    onward = axis.cross(ahead)
    aim = ti.Vector([to_goal.dot(ahead), to_goal.dot(onward), -ti.math.inf, limits.min_flip])
    if ti.static(laws.score == goal_distance) and not limits.by_belief:
        # |g - r e|^2 < d^2 for the unit vector e to the center
        room = to_goal.norm_sqr() + reach**2 - nearest**2
        aim[2] = 0.5 * room / reach - TIE
    return aim


@ti.func
def nearest_flip(
    limits: Ref,
    structures: Ref,
    believed: Ref,
    climbers: Ref,
    walks: Ref,
    mover,
    stance,
    k,
    within,
    laws: Ref,
):
    """Of all flips about dock `k`, find the one that the robot believes to end nearest to the goal.

    A score takes the place of the distance, see `goal_distance`. A robot plans by the orientation
    that it senses. A flip ends where it truly meets something. One that meets nothing, or what the
    robot has been at before, fails, and the robot tries its next best. So does one that ends in a
    zone. Flips are counted that fail and were to score less than the first number of `within`; the
    second is that of the best one.
    """
    body = ti.static(climbers.dock_offset_body)
    site = ti.static(site_of(climbers.ground, laws))
    near = ti.static(Obstacles(climbers.near, site))
    q = quaternion_at(walks.orientation, mover, stance)
    goal = vector_at(climbers.goal, mover)
    sensed = sensed_orientation(limits, believed, walks, mover, stance)
    hinge = hinge_at(limits, structures, believed, climbers, walks, mover, stance, k)
    chosen = _no_flip(hinge.pivot, q)
    chosen.overflow = hinge.overflow
    pivot = hinge.pivot
    by = hinge.by
    body_in = hinge.body_in
    for number in range(climbers.twist.shape[0]):
        axis = flip_axis(climbers, hinge, number)
        aim = _aim(limits, hinge, axis, goal, ti.min(within[1], chosen.distance), laws)
        sensed_axis = axis
        if limits.by_belief:
            sensed_axis = rotate(quaternion_at(believed.turn, mover, stance), axis)
        planned_turn = turn_about(sensed_axis, k, sensed, pivot + by)
        first = first_met(limits, body, planned_turn, near, mover, hinge.count, aim)
        truly = first
        if limits.by_belief:
            row = row_of_true(climbers, mover)
            true_turn = turn_about(axis, k, q, pivot)
            truly = first_met(limits, body, true_turn, near, row, hinge.obstacles, aim)
        for way in ti.static(range(2)):
            angle = first[way]
            if angle >= limits.min_flip and angle <= limits.max_flip:
                turned = flipped(axis, way, angle, q)
                planned = turned
                if limits.by_belief:
                    planned = flipped(sensed_axis, way, angle, sensed)
                end = pivot - rotate(turned, body_in)
                believed_end = pivot - rotate(planned, body_in) + by
                distance = scored(climbers, mover, believed_end, planned, laws)
                is_next = distance < chosen.distance
                if is_next and may_end(limits, site, climbers, walks, mover, stance, end, turned):
                    fails = False
                    if limits.by_belief:
                        angle = truly[way]
                        turned = flipped(axis, way, angle, q)
                        end = pivot - rotate(turned, body_in)
                        fails = not may_end(
                            limits, site, climbers, walks, mover, stance, end, turned
                        )
                        fails = fails or angle < limits.min_flip or angle > limits.max_flip
                    if fails:
                        chosen.failed += ti.cast(distance < within[0], ti.i32)
                    else:
                        chosen.distance = distance
                        chosen.center = end
                        chosen.orientation = turned
                        chosen.planned = planned
                        chosen.pivot = k
    return chosen


@ti.func
def best_flip(
    limits: Ref,
    structures: Ref,
    believed: Ref,
    climbers: Ref,
    walks: Ref,
    mover,
    stance,
    laws: Ref,
):
    """Find the flip that a robot takes from a stance, and how many fail that it tries before."""
    center = vector_in(walks.center, mover, stance)
    flip = _no_flip(center, quaternion_at(walks.orientation, mover, stance))
    failed = 0
    overflow = 0
    least = -ti.math.inf
    # Which flips the robot tries before is known once the one that it takes is.
    for _ in range(1 + limits.by_belief):
        for k in range(climbers.dock_offset_body.shape[0]):
            if is_attached(walks, mover, stance, k):
                within = ti.Vector([least, flip.distance])
                candidate = nearest_flip(
                    limits, structures, believed, climbers, walks, mover, stance, k, within, laws
                )
                overflow |= candidate.overflow
                failed += candidate.failed
                if candidate.distance < flip.distance:
                    flip = candidate
        least = flip.distance
    flip.failed = failed
    flip.overflow = overflow
    return flip


@ti.func
def planned_dock(
    limits: Ref, structures: Ref, believed: Ref, climbers: Ref, walks: Ref, mover, stance, flip
):
    """Find a believed dock that a flip from a stance was planned to end at, or GROUND."""
    s = climbers.structure[mover]
    body = ti.static(climbers.dock_offset_body)
    k = flip.pivot
    to_dock = vector_at(body, k)
    by = misplaced(limits, structures, believed, body, s, walks, mover, stance, k, to_dock)
    q = quaternion_at(walks.orientation, mover, stance)
    pivot = vector_in(walks.center, mover, stance) + rotate(q, to_dock) + by
    met = GROUND
    limit = limits.spacing + limits.contact_gap
    for step in range(1, body.shape[0]):
        arm = vector_at(body, (k + step) % body.shape[0]) - to_dock
        point = pivot + rotate(flip.planned, arm)
        cube = cube_of(point, limits.inverse_edge)
        for which in range(27):
            item = first_item(believed.cells, s, cube, which)
            while item >= 0:
                if (vector_in(believed.dock, s, item) - point).norm_sqr() < limit * limit:
                    met = item
                item = believed.cells.following[s, item]
    return met


WALKING, ENDED, RECRUITED, SCRATCH_FULL = range(4)
"""States of a walk."""


@ti.func
def _ground_kind(point, limits, site: Ref):
    """Find the ground that a dock at `point` stands on: 0, FLAT or EDGE."""
    kind = 0
    if ti.static(site.is_flat):
        kind = _slab_kind(point, limits)
    else:
        gap = distance_to(point, site.ground) - 0.5 * limits.spacing
        kind = ti.select(gap < limits.contact_gap, EDGE, 0)
    return kind


@ti.func
def _slab_kind(point, limits):
    """Find the part of a slab that a dock at `point` stands on: 0, FLAT or EDGE."""
    kind = 0
    depth = 0.5 * limits.spacing
    up = point[2] - (limits.ground_z - depth)
    for way in ti.static(range(2)):
        side = 1.0 - 2.0 * way
        edge = limits.left_edge if way == 0 else limits.right_edge
        out = ti.max(side * (point[0] - edge), 0.0)
        limit = limits.spacing + limits.contact_gap
        if out * out + up * up < limit * limit:
            kind = ti.select(out == 0.0 and up > 0.0, FLAT, EDGE)
    return kind


@ti.func
def sense_contacts(limits: Ref, site: Ref, structures: Ref, s, walks: Ref, mover, stance, k, point):
    """Record what dock `k` at `point` touches; return whether any of it recruits."""
    count = 0
    called = 0
    limit = limits.spacing + limits.contact_gap
    for slot in range(MAX_TOUCHING):
        walks.touching[mover, stance, k, slot] = -1
    low = cube_of(point - limit, limits.inverse_edge)
    last = ti.cast(cube_of(point + limit, limits.inverse_edge) - low, I32)
    for z in range(last[2] + 1):  # ti.ndrange would divide for each cube
        for y in range(last[1] + 1):
            for x in range(last[0] + 1):
                cube = low + ti.Vector([x, y, z])
                item = first_item(structures.cells, s, cube, 13)  # the cube itself
                while item >= 0:
                    if (vector_in(structures.dock, s, item) - point).norm_sqr() < limit * limit:
                        walks.touching[mover, stance, k, count] = item
                        count += 1
                        if structures.relay[s, item] > 0:
                            called = 1
                    item = structures.cells.following[s, item]
    walks.on_ground[mover, stance, k] = _ground_kind(point, limits, site)
    return called


@ti.func
def is_attached(walks: Ref, mover, stance, k):
    """Whether dock `k` touches another dock or the ground."""
    return walks.touching[mover, stance, k, 0] >= 0 or walks.on_ground[mover, stance, k] != 0


@ti.func
def _move_to(walks: Ref, mover, stance, center, q):
    for c in ti.static(range(3)):
        walks.center[mover, stance, c] = center[c]
    for c in ti.static(range(4)):
        walks.orientation[mover, stance, c] = q[c]


@ti.func
def settle(limits: Ref, structures: Ref, climbers: Ref, walks: Ref, m, laws: Ref):
    """Let a robot that touches with two docks turn about these until a third touches too.

    It turns the way that takes the smaller angle, unless that leads into a zone. The stance it
    comes to is written behind the last of the walk, with the pivot that leads to it.
    """
    s = climbers.structure[m]
    best = walks.best[m]
    body = ti.static(climbers.dock_offset_body)
    near = ti.static(climbers.near)
    site = ti.static(site_of(climbers.ground, laws))
    obstacles = ti.static(Obstacles(near, site))
    docks = body.shape[0]
    free = -1
    attached = 0
    for k in range(docks):
        if is_attached(walks, m, best, k):
            attached += 1
        else:
            free = k
    if free >= 0 and attached == _DOCKS_OF_AN_AXIS:
        first_dock = -1
        second_dock = -1
        for step in range(1, docks):
            k = (free + step) % docks
            if is_attached(walks, m, best, k):
                first_dock = ti.select(first_dock < 0, k, first_dock)
                second_dock = k
        q = quaternion_at(walks.orientation, m, best)
        body_in = vector_at(body, first_dock)
        across = rotate(q, vector_at(body, second_dock) - body_in)
        pivot = vector_in(walks.center, m, best) + rotate(q, body_in)
        axis = across.normalized()
        count = ti.min(gather_near(limits, structures, s, pivot, near, m), near.shape[1])
        anywhere = ti.Vector([0.0, 0.0, -ti.math.inf, 0.0])
        turn = PivotTurn(
            orientation=q, axis=axis, pivot=pivot, dock=first_dock, second_dock=second_dock
        )
        met = first_met(limits, body, turn, obstacles, m, count, anywhere)
        angle = ti.min(met[0], met[1])
        flip = axis_rotation(axis, ti.select(met[0] <= met[1], angle, -angle))
        turned = quaternion_product(flip, q).normalized()
        end = pivot - rotate(turned, body_in)
        is_allowed = angle <= limits.max_flip
        if ti.static(site.has_zones):
            is_allowed = is_allowed and not enters(limits, site, body, end, turned)
        if is_allowed:
            stay = walks.last[m] + 1
            walks.stay[m] = stay
            walks.pivot_dock[m, stay] = first_dock
            _move_to(walks, m, stay, end, turned)
            for k in range(docks):
                point = end + rotate(turned, vector_at(body, k))
                sense_contacts(limits, site, structures, s, walks, m, stay, k, point)


@ti.kernel
def climb(
    limits_of_one: ClimbLimits, movers: Ints1, state_out: Ints1, flips_out: Ints3,
    # ClimbedDocks
    head: Ints2, following: Ints2, dock: Reals3, relay: Ints2,
    # Beliefs
    believed_head: Ints2, believed_following: Ints2, believed_dock: Reals3, turn: Reals3,
    # Climbers
    structure: Ints1, first_stance: Ints1, goal: Reals2, manner: Ints2,
    dock_offset_body: Reals2, twist: Reals2, near_out: Reals3, ground: Reals1,
    of_structure: Reals2,
    # WalkArrays, from the first stance on
    center_out: Reals3, orientation_out: Reals3, pivot_dock_out: Ints2, touching_out: Ints4,
    on_ground_out: Ints3, last_out: Ints1, best_out: Ints1, stay_out: Ints1,
    laws: Static,
):  # fmt: skip
    """Walk each mover up its structure, one flip at a time, toward its goal.

    Of all flips about all attached docks the one that ends nearest to the goal is taken,
    unless the walk has been there before. A flip that fails is a step, too: the robot swings, and
    swings back. A robot that is recruited stops where it is. Else the walk ends after `patience`
    steps without a new best, or when no flip is left, and the caller lets the robot walk back to
    its best stance. Distances to the goal, and what a flip meets, are as the robot believes; what
    it touches and where a flip ends are as they are.

    Args:
        limits_of_one: Distances and limits, and the terrain of one structure.
        movers: Slots of the robots that move, shape (M,).
        state_out: How each walk ended, shape (slots,).
        flips_out: Item of the dock that the flip from each stance was planned to end at, or GROUND,
            and flips that failed there, shape (slots, stances, 2); written only where robots go by
            belief.
        turn: From the orientation at each stance to that which the robot senses, where it goes by
            belief, wxyz, shape (slots, stances, 4).
        laws: What climbers minimize, and form of the ground: a `Laws`.
    """
    structures = ti.static(ClimbedDocks(CellList(head, following), dock, relay))
    believed = ti.static(Beliefs(CellList(believed_head, believed_following), believed_dock, turn))
    climbers = ti.static(Climbers(
        structure, first_stance, goal, manner, dock_offset_body, twist, near_out, ground,
        of_structure,
    ))  # fmt: skip
    walks = ti.static(WalkArrays(
        center_out, orientation_out, pivot_dock_out, touching_out, on_ground_out, last_out,
        best_out, stay_out,
    ))  # fmt: skip
    site = ti.static(site_of(ground, laws))
    for i, idle in ti.ndrange(movers.shape[0], GRAIN):
        if idle == 0:
            m = movers[i]
            s = structure[m]
            limits = limits_of(limits_of_one, of_structure, s)
            stance = first_stance[m]
            best_stance = 0
            best_step = 0
            steps = 0
            best_distance = ti.math.inf
            middle = ti.Vector([0.0, 0.0, 0.0], F64)
            for earlier in range(stance):
                by = misplaced(
                    limits, structures, believed, dock_offset_body, s, walks, m, earlier, 0, middle
                )
                was = sensed_orientation(limits, believed, walks, m, earlier)
                believed_center = vector_in(center_out, m, earlier) + by
                distance = scored(climbers, m, believed_center, was, laws)
                if distance < best_distance:
                    best_distance = distance
                    best_stance = earlier
                    best_step = steps
                steps += 1
                if limits.by_belief:
                    steps += flips_out[m, earlier, 1]
            state_out[m] = WALKING
            while state_out[m] == WALKING:
                center = vector_in(center_out, m, stance)
                q = quaternion_at(orientation_out, m, stance)
                flip = _no_flip(center, q)
                called = 0
                for k in range(dock_offset_body.shape[0]):
                    point = center + rotate(q, vector_at(dock_offset_body, k))
                    called |= sense_contacts(
                        limits, site, structures, s, walks, m, stance, k, point
                    )
                by = misplaced(
                    limits, structures, believed, dock_offset_body, s, walks, m, stance, 0, middle
                )
                sensed = sensed_orientation(limits, believed, walks, m, stance)
                distance = scored(climbers, m, center + by, sensed, laws)
                if distance < best_distance:
                    best_distance = distance
                    best_stance = stance
                    best_step = steps
                steps_left = best_step + manner[m, Manner.PATIENCE] - steps
                if called:
                    state_out[m] = RECRUITED
                    best_stance = stance
                elif steps_left > 0:
                    flip = best_flip(limits, structures, believed, climbers, walks, m, stance, laws)
                    if flip.overflow:
                        state_out[m] = SCRATCH_FULL
                    if flip.failed >= steps_left:
                        flip.failed = steps_left
                        flip.pivot = -1
                steps += 1 + flip.failed
                if limits.by_belief:
                    flips_out[m, stance, 1] = flip.failed
                if state_out[m] == WALKING:
                    # One is kept for settling.
                    if flip.pivot < 0 or steps + 1 >= center_out.shape[1]:
                        state_out[m] = ENDED
                    else:
                        pivot_dock_out[m, stance] = flip.pivot
                        if limits.by_belief:
                            flips_out[m, stance, 0] = planned_dock(
                                limits, structures, believed, climbers, walks, m, stance, flip
                            )
                        stance += 1
                        _move_to(walks, m, stance, flip.center, flip.orientation)
            last_out[m] = stance
            best_out[m] = best_stance
            stay_out[m] = best_stance
            if manner[m, Manner.SETTLES]:
                settle(limits, structures, climbers, walks, m, laws)


@ti.func
def _first_disturbed(limits: Ref, structures: Ref, s, walks: Ref, mover, body: Ref, newest):
    """Find the first stance of a walk that docks from item `newest` on could matter to, or -1.

    Only docks within a flip's reach of its own matter to what a robot senses and does. A robot
    settles anew from the last stance that it walked to.
    """
    disturbed = -1
    for stance in range(ti.max(walks.last[mover], walks.stay[mover]) + 1):
        center = vector_in(walks.center, mover, stance)
        q = quaternion_at(walks.orientation, mover, stance)
        for k in range(body.shape[0]):
            point = center + rotate(q, vector_at(body, k))
            cube = cube_of(point, limits.inverse_edge)
            for which in range(27):
                item = first_item(structures.cells, s, cube, which)
                while item >= newest:  # chains run from the newest item to the oldest
                    offset = vector_in(structures.dock, s, item) - point
                    if offset.norm_sqr() < limits.reach * limits.reach:
                        disturbed = ti.min(stance, walks.last[mover])
                    item = structures.cells.following[s, item]
        if disturbed >= 0:
            break
    return disturbed


@ti.kernel
def join_undisturbed(
    limits: ClimbLimits, first_mover: Ints1, movers: Ints1, wants: Ints1, dock_offset_body: Reals2,
    # StructureArrays
    head_out: Ints2, following_out: Ints2, dock_out: Reals3, relay: Ints2, robot_count_out: Ints1,
    # WalkArrays
    center: Reals3, orientation: Reals3, pivot_dock: Ints2, touching: Ints4, on_ground: Ints3,
    last: Ints1, best: Ints1, stay: Ints1,
    disturbed_out: Ints1, joined_out: Ints1,
):  # fmt: skip
    """Let movers that climbed at the same time join one after the other, as far as they can.

    A mover joins if nothing that joined before it in this round lies near any stance of its
    walk: then it has met all it would have met, had it started afterwards. The others are
    to go on from the first stance that is disturbed.

    Args:
        limits: Terrain, distances and limits.
        first_mover: First entry of `movers` of each structure, shape (S + 1,).
        movers: Slots of the movers, structure by structure, shape (M,).
        wants: Whether each slot's walk ends where it can stay, shape (slots,).
        dock_offset_body: Center to dock in the body frame [R], shape (docks, 3).
        disturbed_out: First disturbed stance of each slot, or -1.
        joined_out: Number under which each slot's robot joined, or -1.
    """
    structures = ti.static(
        StructureArrays(CellList(head_out, following_out), dock_out, relay, robot_count_out)
    )
    walks = ti.static(
        WalkArrays(center, orientation, pivot_dock, touching, on_ground, last, best, stay)
    )
    body = ti.static(dock_offset_body)
    for s, idle in ti.ndrange(robot_count_out.shape[0], GRAIN):
        if idle == 0:
            docks = body.shape[0]
            newest = docks * robot_count_out[s]
            for n in range(first_mover[s], first_mover[s + 1]):
                m = movers[n]
                joined_out[m] = -1
                passed = -1
                if docks * robot_count_out[s] > newest:
                    passed = _first_disturbed(limits, structures, s, walks, m, body, newest)
                if wants[m] and passed < 0 and docks * robot_count_out[s] < dock_out.shape[1]:
                    joined_out[m] = robot_count_out[s]
                    stay_center = vector_in(center, m, stay[m])
                    q = quaternion_at(orientation, m, stay[m])
                    for k in range(docks):
                        point = stay_center + rotate(q, vector_at(body, k))
                        item = docks * joined_out[m] + k
                        for c in ti.static(range(3)):
                            dock_out[s, item, c] = point[c]
                        link(structures.cells, s, item, cube_of(point, limits.inverse_edge))
                    robot_count_out[s] += 1
            # Only now is it known who has joined beside those that go on.
            for n in range(first_mover[s], first_mover[s + 1]):
                m = movers[n]
                disturbed_out[m] = -1
                if joined_out[m] < 0 and docks * robot_count_out[s] > newest:
                    disturbed_out[m] = _first_disturbed(
                        limits, structures, s, walks, m, body, newest
                    )


@ti.kernel
def list_docks(
    inverse_edge: F64, chosen: Ints1, dock_count: Ints1, present: Ints2,
    # BelievedDocks
    head_out: Ints2, following_out: Ints2, dock: Reals3,
):  # fmt: skip
    """List anew, by place, the docks of some structures that have moved or lost robots.

    Args:
        inverse_edge: One over the edge of a cube [1 / R].
        chosen: Structures to list, shape (C,).
        dock_count: Docks of every structure, shape (S,).
        present: Whether each robot has not left, shape (S, N).
        head_out: First item of each bucket; see `CellList`.
        following_out: Next item of each chain.
        dock: Dock centers [R], shape (S, n N, 3).
    """
    cells = ti.static(CellList(head_out, following_out))
    for c, idle in ti.ndrange(chosen.shape[0], GRAIN):
        if idle == 0:
            s = chosen[c]
            for bucket in range(head_out.shape[1]):
                head_out[s, bucket] = -1
            docks = dock.shape[1] // present.shape[1]
            for item in range(dock_count[s]):
                if present[s, item // docks]:
                    link(cells, s, item, cube_of(vector_in(dock, s, item), inverse_edge))
