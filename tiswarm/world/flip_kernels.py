"""Walks: how robots climb a structure that stands still meanwhile, flip by flip.

A flip turns a robot about an axis through one of its attached docks (the pivot), at right
angles to the line from that dock to the robot's center, until another dock first touches
something: another dock, flat ground, a rounded edge. Lengths in R, everything in float64.
"""

from tiswarm.compute.cell_kernels import CellList, cube_of, first_item
from tiswarm.compute.lang import (  # fmt: skip
    GRAIN,
    Ints1,
    Ints2,
    Ints3,
    Ints4,
    Reals2,
    Reals3,
    Ref,
    ti,
)
from tiswarm.compute.math_kernels import (  # fmt: skip
    axis_rotation,
    quaternion_at,
    quaternion_product,
    rotate,
    vector_at,
    vector_in,
)
from tiswarm.world.climb_arrays import (
    EDGE,
    FLAT,
    MAX_TOUCHING,
    BelievedDocks,
    Climbers,
    ClimbLimits,
    StructureArrays,
    WalkArrays,
)
from tiswarm.world.plan_kernels import (
    Flip,
    gather_near,
    misplaced,
    nearest_flip,
    planned_dock,
)
from tiswarm.world.turn_kernels import contact_angles

_WALKING, _ENDED, RECRUITED, SCRATCH_FULL = range(4)
"""States of a walk."""


@ti.func
def _ground_kind(point, limits):
    """Find the ground that a dock at `point` stands on: 0, FLAT or EDGE."""
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
def _sense_contacts(limits: Ref, structures: Ref, s, walks: Ref, mover, stance, k, point):
    """Record what dock `k` at `point` touches; return whether any of it recruits."""
    count = 0
    called = 0
    limit = limits.spacing + limits.contact_gap
    for slot in range(MAX_TOUCHING):
        walks.touching[mover, stance, k, slot] = -1
    cube = cube_of(point, limits.inverse_edge)
    for which in range(27):
        item = first_item(structures.cells, s, cube, which)
        while item >= 0:
            if (vector_in(structures.dock, s, item) - point).norm_sqr() < limit * limit:
                walks.touching[mover, stance, k, count] = item
                count += 1
                if structures.relay[s, item] > 0:
                    called = 1
            item = structures.cells.following[s, item]
    walks.on_ground[mover, stance, k] = _ground_kind(point, limits)
    return called


@ti.func
def _is_attached(walks: Ref, mover, stance, k):
    """Whether dock `k` touches another dock or the ground."""
    return walks.touching[mover, stance, k, 0] >= 0 or walks.on_ground[mover, stance, k] != 0


@ti.func
def _move_to(walks: Ref, mover, stance, here, q):
    for c in ti.static(range(3)):
        walks.center[mover, stance, c] = here[c]
    for c in ti.static(range(4)):
        walks.orientation[mover, stance, c] = q[c]


@ti.func
def _settle(limits: Ref, structures: Ref, climbers: Ref, walks: Ref, m):
    """Let a robot that touches with two docks turn about these until a third touches too.

    It turns the way that takes the smaller angle. The stance it comes to is written behind the
    last of the walk, with the pivot that leads to it.
    """
    s, best = climbers.structure[m], walks.best[m]
    body, near = ti.static(climbers.dock_offset_body, climbers.near)
    docks = body.shape[0]
    free, attached = -1, 0
    for k in range(docks):
        if _is_attached(walks, m, best, k):
            attached += 1
        else:
            free = k
    if free >= 0 and attached == 2:  # noqa: PLR2004 - an axis
        one, other = -1, -1
        for step in range(1, docks):
            k = (free + step) % docks
            if _is_attached(walks, m, best, k):
                one, other = ti.select(one < 0, k, one), k
        q = quaternion_at(walks.orientation, m, best)
        body_in = vector_at(body, one)
        across = rotate(q, vector_at(body, other) - body_in)
        pivot = vector_in(walks.center, m, best) + rotate(q, body_in)
        axis = across.normalized()
        count = ti.min(gather_near(limits, structures, s, pivot, near, m), near.shape[1])
        met = ti.Vector([limits.full_turn, limits.full_turn])
        for k in range(docks):
            if k != one and k != other:
                arm = rotate(q, vector_at(body, k) - body_in)
                met = ti.min(met, contact_angles(limits, arm, axis, pivot, near, m, count))
        angle = ti.min(met[0], met[1])
        if angle <= limits.max_flip:
            flip = axis_rotation(axis, ti.select(met[0] <= met[1], angle, -angle))
            turned = quaternion_product(flip, q).normalized()
            end = pivot - rotate(turned, body_in)
            stay = walks.last[m] + 1
            walks.stay[m] = stay
            walks.pivot_dock[m, stay] = one
            _move_to(walks, m, stay, end, turned)
            for k in range(docks):
                point = end + rotate(turned, vector_at(body, k))
                _sense_contacts(limits, structures, s, walks, m, stay, k, point)


@ti.kernel
def climb(
    limits: ClimbLimits, movers: Ints1, state_out: Ints1, planned_out: Ints2, failed_out: Ints2,
    # StructureArrays
    head: Ints2, following: Ints2, dock: Reals3, relay: Ints2, robot_count: Ints1,
    # BelievedDocks
    believed_head: Ints2, believed_following: Ints2, believed_dock: Reals3,
    # Climbers
    structure: Ints1, first_stance: Ints1, goal: Reals2, patience: Ints1, settles: Ints1,
    dock_offset_body: Reals2, near_out: Reals3, obstacle_out: Reals3,
    # WalkArrays, from the first stance on
    center_out: Reals3, orientation_out: Reals3, pivot_dock_out: Ints2, touching_out: Ints4,
    on_ground_out: Ints3, last_out: Ints1, best_out: Ints1, stay_out: Ints1,
):  # fmt: skip
    """Walk each mover up its structure, one flip at a time, toward its goal.

    Of all flips about all attached docks the one that ends nearest to the goal is taken,
    unless the walk has been there before. A robot that is recruited stops where it is. Else
    the walk ends after `patience` steps without a new best, or when no flip is left, and
    the caller lets the robot walk back to its best stance. Distances to the goal, and what a
    flip meets, are as the robot believes; what it touches and where a flip ends are as they are.

    Args:
        limits: Terrain, distances and limits.
        movers: Slots of the robots that move, shape (M,).
        state_out: How each walk ended, shape (slots,).
        planned_out: Item of the dock that the flip from each stance was planned to end at, or
            GROUND, shape (slots, stances); written only where robots go by belief.
        failed_out: Flips that failed at each stance, of the same shape; written as rarely.
    """
    structures = ti.static(StructureArrays(CellList(head, following), dock, relay, robot_count))
    believed = ti.static(BelievedDocks(CellList(believed_head, believed_following), believed_dock))
    climbers = ti.static(Climbers(
        structure, first_stance, goal, patience, settles, dock_offset_body, near_out, obstacle_out,
    ))  # fmt: skip
    walks = ti.static(WalkArrays(
        center_out, orientation_out, pivot_dock_out, touching_out, on_ground_out, last_out,
        best_out, stay_out,
    ))  # fmt: skip
    for i, idle in ti.ndrange(movers.shape[0], GRAIN):
        if idle == 0:
            m = movers[i]
            s = structure[m]
            target = vector_at(goal, m)
            stance = first_stance[m]
            best_stance = 0
            best_distance = ti.math.inf
            for earlier in range(stance):
                by = misplaced(limits, structures, believed, s, walks, m, earlier, 0)
                distance = (vector_in(center_out, m, earlier) + by - target).norm()
                if distance < best_distance:
                    best_distance = distance
                    best_stance = earlier
            state_out[m] = _WALKING
            while state_out[m] == _WALKING:
                here = vector_in(center_out, m, stance)
                q = quaternion_at(orientation_out, m, stance)
                flip = Flip(
                    distance=ti.math.inf, center=here, orientation=q, planned=q, pivot=-1,
                    overflow=0, failed=0,
                )  # fmt: skip
                called = failed = 0
                for k in range(dock_offset_body.shape[0]):
                    point = here + rotate(q, vector_at(dock_offset_body, k))
                    called |= _sense_contacts(limits, structures, s, walks, m, stance, k, point)
                by = misplaced(limits, structures, believed, s, walks, m, stance, 0)
                distance = (here + by - target).norm()
                if distance < best_distance:
                    best_distance = distance
                    best_stance = stance
                if called:
                    state_out[m] = RECRUITED
                    best_stance = stance
                elif stance - best_stance < patience[m]:
                    # Which flips the robot tries before is known once the one that it takes is.
                    least = -ti.math.inf
                    for _ in range(1 + limits.by_belief):
                        for k in range(dock_offset_body.shape[0]):
                            if _is_attached(walks, m, stance, k):
                                other = nearest_flip(
                                    limits, structures, believed, climbers, walks, m, stance, k,
                                    least,
                                )  # fmt: skip
                                if other.overflow:
                                    state_out[m] = SCRATCH_FULL
                                if other.distance < flip.distance:
                                    flip = other
                                failed += other.failed
                        least = flip.distance
                if limits.by_belief:
                    failed_out[m, stance] = failed
                if state_out[m] == _WALKING:
                    # One is kept for settling.
                    if flip.pivot < 0 or stance + 2 >= center_out.shape[1]:
                        state_out[m] = _ENDED
                    else:
                        pivot_dock_out[m, stance] = flip.pivot
                        if limits.by_belief:
                            arm = rotate(q, vector_at(dock_offset_body, flip.pivot))
                            by = misplaced(
                                limits, structures, believed, s, walks, m, stance, flip.pivot
                            )
                            planned_out[m, stance] = planned_dock(
                                limits, believed, dock_offset_body, s, here + arm + by,
                                flip.planned, flip.pivot,
                            )  # fmt: skip
                        stance += 1
                        _move_to(walks, m, stance, flip.center, flip.orientation)
            last_out[m] = stance
            best_out[m] = best_stance
            stay_out[m] = best_stance
            if settles[m]:
                _settle(limits, structures, climbers, walks, m)
