"""Where a turning dock first meets something: another dock, flat ground, a rounded edge.

Lengths in R, angles in rad, everything in float64.

A dock that turns about a pivot by the angle t has, along any fixed direction, a coordinate of
the form a cos t + b sin t + c. Against a dock at w from the pivot the direction is w, against
flat ground it is straight down; both ask where a cos t + b sin t first rises through a level,
which has a closed form. At a rounded edge the squared distance to its axis is followed in
steps that cannot jump over a contact.
"""

from tiswarm.compute.cell_kernels import bucket_of, cube_of, neighbor_cube
from tiswarm.compute.lang import F64, I32, Ref, kernel_struct, ti
from tiswarm.compute.math_kernels import vector_in

SETTLED_RISE = 1e-12
"""A dock whose coordinate swings by less than this [R] slides along: it never enters."""

RESTING_ANGLE = 1e-7
"""A contact met this little before the start of a turn is the one the dock rests on [rad]."""

RESTING_GAP = 1e-10
"""Squared distances to an edge this close to contact are contact [R^2]."""

MET = 1e-13
"""A step this small has arrived at the edge [rad]."""

NUDGE = 1e-3
"""Turn after which a dock that leaves an edge tangentially is clear of it [rad]."""

MAX_STEPS = 500
"""Steps along an edge; some 10 to 40 are taken."""

MAX_TOUCHING = 12
"""No more unit spheres than this can touch one (the kissing number)."""


@kernel_struct
class ClimbLaw:
    """Numbers that do not change during a climb; see `ClimbParams` and `Terrain`."""

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
    inverse_edge: F64
    twists: I32
    patience: I32


@ti.func
def ahead(angle, full_turn):
    """The same angle in [0, a full turn); what lies a hair behind is the contact rested on."""
    wrapped = angle - full_turn * ti.floor(angle / full_turn)
    if wrapped > full_turn - RESTING_ANGLE:
        wrapped = 0.0
    return wrapped


@ti.func
def rise_angles(a, b, level, full_turn):
    """Turn after which a cos t + b sin t first rises through `level`: forward and backward.

    Returns a full turn where it never does. Rising means entering: what lies above the level
    is inside the obstacle.
    """
    angles = ti.Vector([full_turn, full_turn])
    swing = ti.sqrt(a * a + b * b)
    if swing > ti.abs(level) and swing > SETTLED_RISE:
        peak = ti.atan2(b, a)
        half_width = ti.acos(level / swing)
        angles[0] = ahead(peak - half_width, full_turn)
        angles[1] = ahead(-peak - half_width, full_turn)
    return angles


@ti.func
def beyond_edge(x, edge, side):
    """How far `x` lies beyond the edge of a slab whose outside is at `side` (1 right, -1 left)."""
    return ti.max(side * (x - edge), 0.0)


@ti.func
def edge_angle(middle, across, onward, edge, side, law):
    """Turn after which a dock first meets a slab with a rounded edge, or a full turn.

    The dock is at middle + across cos t + onward sin t. Its squared distance to the slab's
    spine less D^2, g(t), is smooth with |g''| <= m, so up to the root of
    g + g' h - m h^2 / 2 nothing can be met.
    """
    depth = 0.5 * law.spacing
    height = middle[2] - (law.ground_z - depth)
    swing_x = ti.sqrt(across[0] * across[0] + onward[0] * onward[0])
    swing_z = ti.sqrt(across[2] * across[2] + onward[2] * onward[2])
    reach_x = ti.max(side * (middle[0] - edge) + swing_x, 0.0)
    bend = 2.0 * (swing_x * (swing_x + reach_x) + swing_z * (swing_z + ti.abs(height) + swing_z))
    met = law.full_turn
    t = 0.0 * height
    steps = 0
    if swing_z < SETTLED_RISE and ti.abs(height) > law.spacing - RESTING_GAP:
        t = law.full_turn  # it slides level with the flat, and never enters
    while t < law.full_turn and steps < MAX_STEPS:
        steps += 1
        c = ti.cos(t)
        s = ti.sin(t)
        out = beyond_edge(middle[0] + across[0] * c + onward[0] * s, edge, side)
        up = height + across[2] * c + onward[2] * s
        gap = out * out + up * up - law.spacing * law.spacing
        slope = 2.0 * side * out * (onward[0] * c - across[0] * s)
        slope += 2.0 * up * (onward[2] * c - across[2] * s)
        if gap < RESTING_GAP and t == 0.0 and slope > -RESTING_GAP:
            gap = 0.0
            t = ti.max(slope / bend, NUDGE)
        else:
            room = slope * slope + 2.0 * bend * gap
            step = (slope + ti.sqrt(ti.max(room, 0.0))) / bend
            if step < MET:
                met = t
                break
            t += step
    return ti.min(met, law.full_turn)


@ti.func
def slab_angles(middle, across, onward, edge, side, law):
    """Angles, forward and backward, at which a dock first meets a slab."""
    angles = ti.Vector([law.full_turn, law.full_turn])
    swing_x = ti.sqrt(across[0] * across[0] + onward[0] * onward[0])
    swing_z = ti.sqrt(across[2] * across[2] + onward[2] * onward[2])
    top = law.ground_z + 0.5 * law.spacing
    if middle[2] - swing_z < top + RESTING_GAP:
        inland = side * (middle[0] - edge) + swing_x <= 0.0
        if inland and middle[2] > law.ground_z:
            angles = rise_angles(-across[2], -onward[2], middle[2] - top, law.full_turn)
        elif side * (middle[0] - edge) - swing_x < law.spacing:
            angles[0] = edge_angle(middle, across, onward, edge, side, law)
            angles[1] = edge_angle(middle, across, -onward, edge, side, law)
    return angles


@ti.func
def ground_kind(point, law):
    """0 where a dock at `point` is off the ground, 1 on flat ground, 2 on an edge."""
    kind = 0
    depth = 0.5 * law.spacing
    up = point[2] - (law.ground_z - depth)
    for way in ti.static(range(2)):
        side = 1.0 - 2.0 * way
        edge = law.left_edge if way == 0 else law.right_edge
        out = beyond_edge(point[0], edge, side)
        limit = law.spacing + law.contact_gap
        if out * out + up * up < limit * limit:
            kind = ti.select(out == 0.0 and up > 0.0, 1, 2)
    return kind


@ti.func
def meeting_angles(arm, axis, pivot, near: Ref, mover, near_count, law):
    """Angles, forward and backward, at which a dock at `arm` from the pivot meets something."""
    along = arm.dot(axis)
    across = arm - along * axis
    onward = axis.cross(arm)
    middle = pivot + along * axis
    first = slab_angles(middle, across, onward, law.left_edge, 1.0, law)
    first = ti.min(first, slab_angles(middle, across, onward, law.right_edge, -1.0, law))
    for k in range(near_count):
        to_other = vector_in(near, mover, k)
        level = 0.5 * (arm.norm_sqr() + to_other.norm_sqr() - law.spacing * law.spacing)
        level -= along * to_other.dot(axis)
        met = rise_angles(to_other.dot(across), to_other.dot(onward), level, law.full_turn)
        first = ti.min(first, met)
    return first


@ti.func
def gather_near(near: Ref, mover, pivot, law, head: Ref, following: Ref, structure, dock: Ref):
    """List the vectors from `pivot` to the structure's docks in reach; return how many."""
    count = 0
    cube = cube_of(pivot, law.inverse_edge)
    for which in range(27):
        item = head[structure, bucket_of(neighbor_cube(cube, which), head.shape[1])]
        while item >= 0:
            offset = vector_in(dock, structure, item) - pivot
            if offset.norm_sqr() < law.reach * law.reach:
                if count < near.shape[1]:
                    for c in ti.static(range(3)):
                        near[mover, count, c] = offset[c]
                count += 1
            item = following[structure, item]
    return count


@ti.func
def feel(
    touching: Ref, on_ground: Ref, mover, stance, k, point, law, head: Ref, following: Ref,
    structure, dock: Ref, relay: Ref,
):  # fmt: skip
    """Record what dock `k` at `point` touches; return how many things, and if one recruits."""
    count = 0
    called = 0
    limit = law.spacing + law.contact_gap
    for slot in range(MAX_TOUCHING):
        touching[mover, stance, k, slot] = -1
    cube = cube_of(point, law.inverse_edge)
    for which in range(27):
        item = head[structure, bucket_of(neighbor_cube(cube, which), head.shape[1])]
        while item >= 0:
            if (vector_in(dock, structure, item) - point).norm_sqr() < limit * limit:
                touching[mover, stance, k, count] = item
                count += 1
                if relay[structure, item] > 0:
                    called = 1
            item = following[structure, item]
    ground = ground_kind(point, law)
    on_ground[mover, stance, k] = ground
    return ti.Vector([count + ground, called])
