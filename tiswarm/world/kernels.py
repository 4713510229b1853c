"""Walks: how robots climb a structure that stands still meanwhile.

A flip turns a robot about an axis through one of its attached docks (the pivot), at right
angles to the line from that dock to the robot's center, until another dock first touches
something. Lengths in R, angles in rad, everything in float64.
"""

from tiswarm.compute.lang import (
    F64,
    GRAIN,
    I32,
    Ints1,
    Ints2,
    Ints3,
    Ints4,
    Reals2,
    Reals3,
    Ref,
    Vec3,
    Vec4,
    kernel_struct,
    ti,
)
from tiswarm.compute.math_kernels import (
    axis_rotation,
    quaternion_at,
    quaternion_product,
    rotate,
    vector_at,
    vector_in,
)
from tiswarm.world.meeting import ClimbLaw, feel, gather_near, meeting_angles

DOCKS = 3

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
def nearest_flip(
    law, goal, mover, stance, structure, k, here, q, head: Ref, following: Ref, dock: Ref,
    dock_offset_body: Ref, near: Ref, center: Ref,
):  # fmt: skip
    """Of all flips about dock `k`, find the one that ends nearest to the goal."""
    chosen = Flip(distance=ti.math.inf, center=here, orientation=q, pivot=-1, overflow=0)
    body_in = vector_at(dock_offset_body, k)
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
            arm = rotate(q, vector_at(dock_offset_body, (k + step) % DOCKS) - body_in)
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
def was_there(center: Ref, mover, stance, point, law):
    """Whether the walk up to `stance` has had its center at `point` before."""
    seen = False
    for earlier in range(stance + 1):
        seen = seen or (point - vector_in(center, mover, earlier)).norm() < law.revisit_distance
    return seen


@ti.func
def move_to(mover, stance, here, q, center: Ref, orientation: Ref):
    """Write where a robot is at a stance, and how it is turned."""
    for c in ti.static(range(3)):
        center[mover, stance, c] = here[c]
    for c in ti.static(range(4)):
        orientation[mover, stance, c] = q[c]


@ti.kernel
def climb(
    law: ClimbLaw,
    # structure
    head: Ints2, following: Ints2, dock: Reals3, relay: Ints2,
    # movers
    movers: Ints1, structure_of: Ints1, first_stance: Ints1, goal: Reals2, dock_offset_body: Reals2,
    near: Reals3,
    # what they write
    center: Reals3, orientation: Reals3, pivot_dock: Ints2, touching: Ints4, on_ground: Ints3,
    last: Ints1, best: Ints1, state: Ints1,
):  # fmt: skip
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
            best_distance = (vector_in(center, m, 0) - target).norm()
            for earlier in range(1, stance + 1):
                distance = (vector_in(center, m, earlier) - target).norm()
                if distance < best_distance:
                    best_distance = distance
                    best_stance = earlier
            state[m] = WALKING
            while state[m] == WALKING:
                here = vector_in(center, m, stance)
                q = quaternion_at(orientation, m, stance)
                flip = Flip(distance=ti.math.inf, center=here, orientation=q, pivot=-1, overflow=0)
                attached = ti.Vector([0, 0, 0])
                called = 0
                for k in range(DOCKS):
                    point = here + rotate(q, vector_at(dock_offset_body, k))
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
                        move_to(m, stance, flip.center, flip.orientation, center, orientation)
                        if flip.distance < best_distance:
                            best_distance = flip.distance
                            best_stance = stance
            last[m] = stance
            best[m] = best_stance


@ti.func
def odd_one_out(touching: Ref, on_ground: Ref, mover, stance):
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
    head: Ints2, following: Ints2, dock: Reals3, relay: Ints2,
    # movers
    movers: Ints1, structure_of: Ints1, dock_offset_body: Reals2, near: Reals3, last: Ints1,
    best: Ints1,
    # what they write
    center: Reals3, orientation: Reals3, pivot_dock: Ints2, touching: Ints4, on_ground: Ints3,
    stay: Ints1,
):  # fmt: skip
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
                here = vector_in(center, m, best[m])
                q = quaternion_at(orientation, m, best[m])
                body_in = vector_at(dock_offset_body, one)
                across = rotate(q, vector_at(dock_offset_body, (loose + 2) % DOCKS) - body_in)
                arm = rotate(q, vector_at(dock_offset_body, loose) - body_in)
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
                    move_to(m, stay[m], end, turned, center, orientation)
                    for k in range(DOCKS):
                        point = end + rotate(turned, vector_at(dock_offset_body, k))
                        feel(
                            touching, on_ground, m, stay[m], k, point,
                            law, head, following, s, dock, relay,
                        )  # fmt: skip
