"""Flips and walks: how a robot climbs a structure that stands still meanwhile.

A flip turns the robot about an axis through one of its attached docks (the pivot), at right
angles to the line from that dock to the robot's centre, until another dock first touches
something. Lengths in R, angles in rad, everything in float64.

A dock that turns about the pivot by the angle t has, along any fixed direction, a coordinate
of the form a cos t + b sin t + c. Both ways of touching are therefore one question: where
does a cos t + b sin t first rise through a level? Against a dock at w from the pivot the
direction is w; against the ground it is straight down.
"""

from tiswarm.compute.cells import bucket_of, cube_of, link, neighbor_cube
from tiswarm.compute.dialect import (
    F64,
    I32,
    Float,
    Ints1,
    Ints2,
    Ints3,
    Ints4,
    Reals2,
    Reals3,
    Vec3,
    Vec4,
    kernel_struct,
    ti,
)
from tiswarm.compute.rotations import axis_rotation, quaternion_product, rotate

DOCKS = 3
MAX_TOUCHING = 12
"""No more unit spheres than this can touch one (the kissing number)."""

SETTLED_RISE = 1e-12
"""A dock whose coordinate swings by less than this [R] slides along: it never enters."""

RESTING_ANGLE = 1e-7
"""A contact met this little before the start of a turn is the one the dock rests on [rad]."""

WALKING = 0
ENDED = 1
OUT_OF_FLIPS = 2
SCRATCH_FULL = 3


@kernel_struct
class ClimbLaw:
    """Numbers that do not change during a climb; see `ClimbParams`."""

    goal: Vec3
    spacing: F64
    contact_gap: F64
    ground_z: F64
    min_flip: F64
    max_flip: F64
    revisit_distance: F64
    full_turn: F64
    reach: F64
    inverse_edge: F64
    twists: I32
    patience: I32


@kernel_struct
class Flip:
    """A flip that could be taken: where it ends and about which dock."""

    distance: F64
    center: Vec3
    orientation: Vec4
    pivot: I32
    overflow: I32


@ti.func
def row(array: ti.template(), i, j):
    """Vector from the last axis of a three-dimensional array."""
    return ti.Vector([array[i, j, 0], array[i, j, 1], array[i, j, 2]])


@ti.func
def body_dock(dock_offset_body: ti.template(), k):
    """Centre to dock `k` in the body frame."""
    return ti.Vector([dock_offset_body[k, 0], dock_offset_body[k, 1], dock_offset_body[k, 2]])


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
def meeting_angles(arm, axis, pivot, near: ti.template(), mover, near_count, law):
    """Angles, forward and backward, at which a dock at `arm` from the pivot meets something."""
    along = arm.dot(axis)
    across = arm - along * axis
    onward = axis.cross(arm)
    level = pivot[2] + along * axis[2] - law.ground_z - 0.5 * law.spacing
    first = rise_angles(-across[2], -onward[2], level, law.full_turn)
    for k in range(near_count):
        to_other = row(near, mover, k)
        level = 0.5 * (arm.norm_sqr() + to_other.norm_sqr() - law.spacing * law.spacing)
        level -= along * to_other.dot(axis)
        met = rise_angles(to_other.dot(across), to_other.dot(onward), level, law.full_turn)
        first = ti.min(first, met)
    return first


@ti.func
def gather_near(
    near: ti.template(),
    mover,
    pivot,
    law,
    head: ti.template(),
    following: ti.template(),
    structure,
    dock: ti.template(),
):
    """List the vectors from `pivot` to the structure's docks in reach; return how many."""
    count = 0
    cube = cube_of(pivot, law.inverse_edge)
    for which in range(27):
        item = head[structure, bucket_of(neighbor_cube(cube, which), head.shape[1])]
        while item >= 0:
            offset = row(dock, structure, item) - pivot
            if offset.norm_sqr() < law.reach * law.reach:
                if count < near.shape[1]:
                    for c in ti.static(range(3)):
                        near[mover, count, c] = offset[c]
                count += 1
            item = following[structure, item]
    return count


@ti.func
def feel(
    touching: ti.template(),
    on_ground: ti.template(),
    mover,
    stance,
    k,
    point,
    law,
    head: ti.template(),
    following: ti.template(),
    structure,
    dock: ti.template(),
):
    """Record what dock `k` at `point` touches in this stance; return how many things."""
    count = 0
    limit = law.spacing + law.contact_gap
    for slot in range(MAX_TOUCHING):
        touching[mover, stance, k, slot] = -1
    cube = cube_of(point, law.inverse_edge)
    for which in range(27):
        item = head[structure, bucket_of(neighbor_cube(cube, which), head.shape[1])]
        while item >= 0:
            if (row(dock, structure, item) - point).norm_sqr() < limit * limit:
                touching[mover, stance, k, count] = item
                count += 1
            item = following[structure, item]
    grounded = ti.cast(point[2] < law.ground_z + 0.5 * law.spacing + law.contact_gap, ti.i32)
    on_ground[mover, stance, k] = grounded
    return count + grounded


@ti.func
def nearest_flip(
    law,
    mover,
    stance,
    structure,
    k,
    here,
    q,
    head: ti.template(),
    following: ti.template(),
    dock: ti.template(),
    dock_offset_body: ti.template(),
    near: ti.template(),
    center: ti.template(),
):
    """Of all flips about dock `k`, find the one that ends nearest to the goal."""
    chosen = Flip(distance=ti.math.inf, center=here, orientation=q, pivot=-1, overflow=0)
    body_in = body_dock(dock_offset_body, k)
    to_center = -rotate(q, body_in)
    pivot = here - to_center
    count = gather_near(near, mover, pivot, law, head, following, structure, dock)
    if count > near.shape[1]:
        chosen.overflow = 1
        count = near.shape[1]
    normal = rotate(q, ti.Vector([0.0, 0.0, 1.0]))
    side = normal.cross(to_center.normalized())
    for twist in range(law.twists):
        turn = 0.5 * law.full_turn * twist / law.twists
        axis = ti.cos(turn) * normal + ti.sin(turn) * side
        first = ti.Vector([law.full_turn, law.full_turn])
        for step in range(1, DOCKS):
            arm = rotate(q, body_dock(dock_offset_body, (k + step) % DOCKS) - body_in)
            first = ti.min(first, meeting_angles(arm, axis, pivot, near, mover, count, law))
        for way in ti.static(range(2)):
            angle = first[way]
            if angle >= law.min_flip and angle <= law.max_flip:
                flip = axis_rotation(axis, (1.0 - 2.0 * way) * angle)
                turned = quaternion_product(flip, q).normalized()
                end = pivot - rotate(turned, body_in)
                distance = (end - law.goal).norm()
                if distance < chosen.distance and not was_there(center, mover, stance, end, law):
                    chosen.distance = distance
                    chosen.center = end
                    chosen.orientation = turned
                    chosen.pivot = k
    return chosen


@ti.func
def was_there(center: ti.template(), mover, stance, point, law):
    """Whether the walk up to `stance` has had its centre at `point` before."""
    seen = False
    for earlier in range(stance + 1):
        seen = seen or (point - row(center, mover, earlier)).norm() < law.revisit_distance
    return seen


@ti.kernel
def climb(
    law: ClimbLaw,
    # structure
    head: Ints2,
    following: Ints2,
    dock: Reals3,
    # movers
    structure_of: Ints1,
    dock_offset_body: Reals2,
    near: Reals3,
    # what they write
    center: Reals3,
    orientation: Reals3,
    pivot_dock: Ints2,
    touching: Ints4,
    on_ground: Ints3,
    last: Ints1,
    best: Ints1,
    state: Ints1,
):
    """Walk each mover up its structure, one flip at a time, toward the goal.

    Of all flips about all attached docks the one that ends nearest to the goal is taken,
    unless the walk has been there before. The walk ends after `law.patience` steps without a
    new best, or when no flip is left; the caller lets the robot walk back to its best stance.

    Args:
        law: Goal, distances and limits.
        head: First dock of each bucket, shape (S, buckets).
        following: Next dock of a chain, shape (S, docks).
        dock: Dock centres of the structures [R], shape (S, docks, 3).
        structure_of: Structure that each mover climbs, shape (M,).
        dock_offset_body: Centre to dock in the body frame [R], shape (3, 3).
        near: Scratch: vectors from the pivot to docks in reach, shape (M, near, 3).
        center: Stance 0 is read, the others written [R], shape (M, stances, 3).
        orientation: Likewise, wxyz, shape (M, stances, 4).
        pivot_dock: Written: dock that stays put as the robot leaves a stance, (M, stances).
        touching: Written: docks of the structure that each dock touches, or -1, shape
            (M, stances, 3, MAX_TOUCHING).
        on_ground: Written: whether each dock touches the ground, shape (M, stances, 3).
        last: Written: last stance of the walk, shape (M,).
        best: Written: the stance nearest to the goal, shape (M,).
        state: Written: ENDED if the walk came to its end, else what cut it off, shape (M,).
    """
    ti.loop_config(block_dim=1)  # a walk is work enough for a thread
    for m in range(structure_of.shape[0]):
        s = structure_of[m]
        stance = 0
        best_stance = 0
        best_distance = (row(center, m, 0) - law.goal).norm()
        state[m] = WALKING
        while state[m] == WALKING:
            here = row(center, m, stance)
            q = ti.Vector([orientation[m, stance, c] for c in range(4)])
            flip = Flip(distance=ti.math.inf, center=here, orientation=q, pivot=-1, overflow=0)
            for k in range(DOCKS):
                point = here + rotate(q, body_dock(dock_offset_body, k))
                attached = feel(
                    touching, on_ground, m, stance, k, point, law, head, following, s, dock
                )
                if attached and stance - best_stance < law.patience:
                    other = nearest_flip(
                        law, m, stance, s, k, here, q,
                        head, following, dock, dock_offset_body, near, center,
                    )  # fmt: skip
                    if other.overflow:
                        state[m] = SCRATCH_FULL
                    if other.distance < flip.distance:
                        flip = other
            if state[m] == WALKING:
                if flip.pivot < 0:
                    state[m] = ENDED
                elif stance + 1 >= center.shape[1]:
                    state[m] = OUT_OF_FLIPS
                else:
                    pivot_dock[m, stance] = flip.pivot
                    stance += 1
                    for c in ti.static(range(3)):
                        center[m, stance, c] = flip.center[c]
                    for c in ti.static(range(4)):
                        orientation[m, stance, c] = flip.orientation[c]
                    if flip.distance < best_distance:
                        best_distance = flip.distance
                        best_stance = stance
        last[m] = stance
        best[m] = best_stance


@ti.kernel
def link_docks(
    structure_of: Ints1,
    first_item: Ints1,
    dock: Reals3,
    inverse_edge: Float,
    head: Ints2,
    following: Ints2,
):
    """Enter the docks of newly joined robots in their structures' cell lists.

    Args:
        structure_of: Structure of each new robot, each at most once, shape (J,).
        first_item: Its first dock, shape (J,).
        dock: Dock centres [R], shape (S, docks, 3).
        inverse_edge: One over the edge of a cube [1/R].
        head: Changed: first dock of each bucket, shape (S, buckets).
        following: Changed: next dock of a chain, shape (S, docks).
    """
    for n in range(structure_of.shape[0]):
        s = structure_of[n]
        for k in range(DOCKS):
            item = first_item[n] + k
            link(head, following, s, item, cube_of(row(dock, s, item), inverse_edge))
