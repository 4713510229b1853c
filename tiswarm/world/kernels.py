"""Walks: how robots climb a structure that stands still meanwhile.

A flip turns a robot about an axis through one of its attached docks (the pivot), at right
angles to the line from that dock to the robot's center, until another dock first touches
something. Lengths in R, angles in rad, everything in float64.
"""

from tiswarm.compute.cells import bucket_of, cube_of, neighbor_cube
from tiswarm.compute.dialect import (
    F64,
    GRAIN,
    I32,
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
from tiswarm.compute.kernels import vector_at
from tiswarm.compute.rotations import axis_rotation, quaternion_product, rotate
from tiswarm.world.meeting import ClimbLaw, ground_kind, meeting_angles, row

DOCKS = 3
MAX_TOUCHING = 12
"""No more unit spheres than this can touch one (the kissing number)."""

WALKING = 0
ENDED = 1
RECRUITED = 2
OUT_OF_FLIPS = 3
SCRATCH_FULL = 4


@kernel_struct
class Flip:
    """A flip that could be taken: where it ends and about which dock."""

    distance: F64
    center: Vec3
    orientation: Vec4
    pivot: I32
    overflow: I32


@ti.func
def body_dock(dock_offset_body: ti.template(), k):
    """Center to dock `k` in the body frame."""
    return ti.Vector([dock_offset_body[k, 0], dock_offset_body[k, 1], dock_offset_body[k, 2]])


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
    relay: ti.template(),
):
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
            if (row(dock, structure, item) - point).norm_sqr() < limit * limit:
                touching[mover, stance, k, count] = item
                count += 1
                if relay[structure, item] > 0:
                    called = 1
            item = following[structure, item]
    ground = ground_kind(point, law)
    on_ground[mover, stance, k] = ground
    return ti.Vector([count + ground, called])


@ti.func
def nearest_flip(
    law,
    goal,
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
                distance = (end - goal).norm()
                if distance < chosen.distance and not was_there(center, mover, stance, end, law):
                    chosen.distance = distance
                    chosen.center = end
                    chosen.orientation = turned
                    chosen.pivot = k
    return chosen


@ti.func
def was_there(center: ti.template(), mover, stance, point, law):
    """Whether the walk up to `stance` has had its center at `point` before."""
    seen = False
    for earlier in range(stance + 1):
        seen = seen or (point - row(center, mover, earlier)).norm() < law.revisit_distance
    return seen


@ti.func
def move_to(mover, stance, flip, center: ti.template(), orientation: ti.template()):
    """Write the stance that a flip leads to."""
    for c in ti.static(range(3)):
        center[mover, stance, c] = flip.center[c]
    for c in ti.static(range(4)):
        orientation[mover, stance, c] = flip.orientation[c]


@ti.kernel
def climb(
    law: ClimbLaw,
    # structure
    head: Ints2,
    following: Ints2,
    dock: Reals3,
    relay: Ints2,
    # movers
    movers: Ints1,
    structure_of: Ints1,
    first_stance: Ints1,
    goal: Reals2,
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
    """Walk each mover up its structure, one flip at a time, toward its goal.

    Of all flips about all attached docks the one that ends nearest to the goal is taken,
    unless the walk has been there before. A robot that is recruited stops where it is. Else
    the walk ends after `law.patience` steps without a new best, or when no flip is left, and
    the caller lets the robot walk back to its best stance.

    Args:
        law: Terrain, distances and limits.
        head: First dock of each bucket, shape (S, buckets).
        following: Next dock of a chain, shape (S, docks).
        dock: Dock centers of the structures [R], shape (S, docks, 3).
        relay: What each dock passes on; a robot that touches a positive one is recruited,
            shape (S, docks).
        movers: Slots of the robots that move, shape (M,); what follows is by slot.
        structure_of: Structure that each climbs, shape (slots,).
        first_stance: Stance to go on from; those before it are kept, shape (slots,).
        goal: Where each wants to be [R], shape (slots, 3).
        dock_offset_body: Center to dock in the body frame [R], shape (3, 3).
        near: Scratch: vectors from the pivot to docks in reach, shape (slots, near, 3).
        center: Up to the first stance read, then written [R], shape (slots, stances, 3).
        orientation: Likewise, wxyz, shape (slots, stances, 4).
        pivot_dock: Written: dock that stays put as the robot leaves a stance, shape
            (slots, stances).
        touching: Written: docks of the structure that each dock touches, or -1, shape
            (slots, stances, 3, MAX_TOUCHING).
        on_ground: Written: 0, or 1 on flat ground, or 2 on an edge, shape (slots, stances, 3).
        last: Written: last stance of the walk, shape (slots,).
        best: Written: the stance to stay at, shape (slots,).
        state: Written: how the walk ended, shape (slots,).
    """
    for i in range(movers.shape[0] * GRAIN):
        if i % GRAIN == 0:
            m = movers[i // GRAIN]
            s = structure_of[m]
            target = vector_at(goal, m)
            stance = first_stance[m]
            best_stance = 0
            best_distance = (row(center, m, 0) - target).norm()
            for earlier in range(1, stance + 1):
                distance = (row(center, m, earlier) - target).norm()
                if distance < best_distance:
                    best_distance = distance
                    best_stance = earlier
            state[m] = WALKING
            while state[m] == WALKING:
                here = row(center, m, stance)
                q = ti.Vector([orientation[m, stance, c] for c in range(4)])
                flip = Flip(distance=ti.math.inf, center=here, orientation=q, pivot=-1, overflow=0)
                attached = ti.Vector([0, 0, 0])
                called = 0
                for k in range(DOCKS):
                    point = here + rotate(q, body_dock(dock_offset_body, k))
                    felt = feel(
                        touching, on_ground, m, stance, k, point,
                        law, head, following, s, dock, relay,
                    )  # fmt: skip
                    attached[k] = felt[0]
                    called = ti.max(called, felt[1])
                if called:
                    state[m] = RECRUITED
                    best_stance = stance
                elif stance - best_stance < law.patience:
                    for k in range(DOCKS):
                        if attached[k] > 0:
                            other = nearest_flip(
                                law, target, m, stance, s, k, here, q,
                                head, following, dock, dock_offset_body, near, center,
                            )  # fmt: skip
                            if other.overflow:
                                state[m] = SCRATCH_FULL
                            if other.distance < flip.distance:
                                flip = other
                if state[m] == WALKING:
                    if flip.pivot < 0:
                        state[m] = ENDED
                    elif stance + 2 >= center.shape[1]:  # the last is kept for settling
                        state[m] = OUT_OF_FLIPS
                    else:
                        pivot_dock[m, stance] = flip.pivot
                        stance += 1
                        move_to(m, stance, flip, center, orientation)
                        if flip.distance < best_distance:
                            best_distance = flip.distance
                            best_stance = stance
            last[m] = stance
            best[m] = best_stance


@ti.func
def odd_one_out(touching: ti.template(), on_ground: ti.template(), mover, stance):
    """The only dock that touches nothing, or -1 where none or several do."""
    loose = -1
    count = 0
    for k in range(DOCKS):
        if touching[mover, stance, k, 0] < 0 and on_ground[mover, stance, k] == 0:
            loose = k
            count += 1
    return ti.select(count == 1, loose, -1)


@ti.kernel
def settle(
    law: ClimbLaw,
    # structure
    head: Ints2,
    following: Ints2,
    dock: Reals3,
    relay: Ints2,
    # movers
    movers: Ints1,
    structure_of: Ints1,
    dock_offset_body: Reals2,
    near: Reals3,
    last: Ints1,
    best: Ints1,
    # what they write
    center: Reals3,
    orientation: Reals3,
    pivot_dock: Ints2,
    touching: Ints4,
    on_ground: Ints3,
    stay: Ints1,
):
    """Let robots that touch with two docks turn about these until the third touches too.

    They turn the way that takes the smaller angle. The stance they come to is written behind
    the last of the walk, with the pivot that leads to it. Arguments as for `climb`; `stay` is
    written: the stance where each robot stays, settled or not, shape (slots,).
    """
    for i in range(movers.shape[0] * GRAIN):
        if i % GRAIN == 0:
            m = movers[i // GRAIN]
            s = structure_of[m]
            stay[m] = best[m]
            loose = odd_one_out(touching, on_ground, m, best[m])
            if loose >= 0:
                one = (loose + 1) % DOCKS
                here = row(center, m, best[m])
                q = ti.Vector([orientation[m, best[m], c] for c in range(4)])
                body_in = body_dock(dock_offset_body, one)
                across = rotate(q, body_dock(dock_offset_body, (loose + 2) % DOCKS) - body_in)
                arm = rotate(q, body_dock(dock_offset_body, loose) - body_in)
                pivot = here + rotate(q, body_in)
                axis = across.normalized()
                count = gather_near(near, m, pivot, law, head, following, s, dock)
                count = ti.min(count, near.shape[1])
                met = meeting_angles(arm, axis, pivot, near, m, count, law)
                angle = ti.min(met[0], met[1])
                if angle <= law.max_flip:
                    flip = axis_rotation(axis, ti.select(met[0] <= met[1], angle, -angle))
                    turned = quaternion_product(flip, q).normalized()
                    end = pivot - rotate(turned, body_in)
                    stay[m] = last[m] + 1
                    pivot_dock[m, stay[m]] = one
                    for c in ti.static(range(3)):
                        center[m, stay[m], c] = end[c]
                    for c in ti.static(range(4)):
                        orientation[m, stay[m], c] = turned[c]
                    for k in range(DOCKS):
                        point = end + rotate(turned, body_dock(dock_offset_body, k))
                        feel(
                            touching, on_ground, m, stay[m], k, point,
                            law, head, following, s, dock, relay,
                        )  # fmt: skip
