"""Which flip a robot takes: planned by where it believes docks are, ended by where they are.

A robot that knows where all docks are is the case in which both are the same. Lengths in R.
"""

from tiswarm.compute.cell_kernels import cube_of, first_item
from tiswarm.compute.lang import F64, I32, Ref, Vec3, Vec4, kernel_struct, ti
from tiswarm.compute.math_kernels import (  # fmt: skip
    axis_rotation,
    quaternion_at,
    quaternion_product,
    rotate,
    vector_at,
    vector_in,
)
from tiswarm.world.turn_kernels import contact_angles

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


@ti.func
def gather_near(limits: Ref, docks: Ref, s, pivot, near: Ref, mover):
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
                        near[mover, count, c] = offset[c]
                count += 1
            item = docks.cells.following[s, item]
    return count


@ti.func
def _revisits(limits: Ref, walks: Ref, mover, stance, point):
    """Whether the walk up to `stance` has had its center at `point` before."""
    seen = False
    for earlier in range(stance + 1):
        offset = point - vector_in(walks.center, mover, earlier)
        seen = seen or offset.norm() < limits.revisit_distance
    return seen


@ti.func
def _across(arm):
    """Find the unit vector across `arm` nearest to the body's z axis, or x for an arm along z."""
    size = arm.norm_sqr()
    across = ti.Vector([0.0, 0.0, 1.0]) - arm[2] / size * arm
    if across.norm_sqr() < _ALONG:
        across = ti.Vector([1.0, 0.0, 0.0]) - arm[0] / size * arm
    return across.normalized()


@ti.func
def misplaced(limits: Ref, structures: Ref, believed: Ref, s, walks: Ref, mover, stance, k):
    """Find the vector from where a robot's dock `k` is to where the robot believes it.

    A robot takes its place from a dock that it touches: with dock `k`, else with another, else at
    the last stance where it touched one. Until then it knows its place.
    """
    by = ti.Vector([0.0, 0.0, 0.0], F64)
    if limits.by_belief:
        docks = walks.touching.shape[2]
        found = False
        at = stance
        while at >= 0 and not found:
            for step in range(docks):
                item = walks.touching[mover, at, (k + step) % docks, 0]
                if item >= 0 and not found:
                    by = vector_in(believed.dock, s, item) - vector_in(structures.dock, s, item)
                    found = True
            at -= 1
    return by


@ti.func
def _first_met(limits: Ref, body: Ref, q, k, axis, pivot, near: Ref, mover, count):
    """Find the angles, forward and backward, at which a turn about dock `k` meets something."""
    first = ti.Vector([limits.full_turn, limits.full_turn])
    for step in range(1, body.shape[0]):
        arm = rotate(q, vector_at(body, (k + step) % body.shape[0]) - vector_at(body, k))
        first = ti.min(first, contact_angles(limits, arm, axis, pivot, near, mover, count))
    return first


@ti.func
def nearest_flip(
    limits: Ref, structures: Ref, believed: Ref, climbers: Ref, walks: Ref, mover, stance, k, least
):
    """Of all flips about dock `k`, find the one that the robot believes to end nearest to the goal.

    A flip ends where it truly meets something. One that meets nothing, or what the robot has
    been at before, fails, and the robot tries its next best. Flips are counted that fail and were
    to end nearer to the goal than `least` [R].
    """
    s = climbers.structure[mover]
    body, near, obstacle = ti.static(climbers.dock_offset_body, climbers.near, climbers.obstacle)
    here = vector_in(walks.center, mover, stance)
    q = quaternion_at(walks.orientation, mover, stance)
    goal = vector_at(climbers.goal, mover)
    chosen = Flip(
        distance=ti.math.inf, center=here, orientation=q, planned=q, pivot=-1, overflow=0, failed=0
    )
    body_in = vector_at(body, k)
    to_center = -rotate(q, body_in)
    pivot = here - to_center
    by = misplaced(limits, structures, believed, s, walks, mover, stance, k)
    found = gather_near(limits, believed, s, pivot + by, near, mover)
    count = ti.min(found, near.shape[1])
    chosen.overflow = ti.cast(found > count, ti.i32)
    obstacles = 0
    if limits.by_belief:
        obstacles = gather_near(limits, structures, s, pivot, obstacle, mover)
        chosen.overflow = ti.cast(obstacles > obstacle.shape[1], ti.i32)
    normal = rotate(q, ti.Vector([0.0, 0.0, 1.0]))
    if limits.is_planar:
        normal = ti.Vector([0.0, 1.0, 0.0])  # exactly, so that y stays 0
    elif body_in[2] != 0.0:
        normal = rotate(q, _across(body_in))
    side = normal.cross(to_center.normalized())
    for twist in range(limits.twists):
        turn = 0.5 * limits.full_turn * twist / limits.twists
        axis = ti.cos(turn) * normal + ti.sin(turn) * side
        first = _first_met(limits, body, q, k, axis, pivot + by, near, mover, count)
        truly = first
        if limits.by_belief:
            truly = _first_met(limits, body, q, k, axis, pivot, obstacle, mover, obstacles)
        for way in ti.static(range(2)):
            angle = first[way]
            if angle >= limits.min_flip and angle <= limits.max_flip:
                flip = axis_rotation(axis, (1.0 - 2.0 * way) * angle)
                planned = quaternion_product(flip, q).normalized()
                end = pivot - rotate(planned, body_in)
                distance = (end + by - goal).norm()
                if distance < chosen.distance and not _revisits(limits, walks, mover, stance, end):
                    turned = planned
                    fails = False
                    if limits.by_belief:
                        angle = truly[way]
                        flip = axis_rotation(axis, (1.0 - 2.0 * way) * angle)
                        turned = quaternion_product(flip, q).normalized()
                        end = pivot - rotate(turned, body_in)
                        fails = angle < limits.min_flip or angle > limits.max_flip
                        fails = fails or _revisits(limits, walks, mover, stance, end)
                    if fails:
                        chosen.failed += ti.cast(distance < least, ti.i32)
                    else:
                        chosen.distance = distance
                        chosen.center = end
                        chosen.orientation = turned
                        chosen.planned = planned
                        chosen.pivot = k
    return chosen


@ti.func
def planned_dock(limits: Ref, believed: Ref, body: Ref, s, pivot, planned, k):
    """Find a believed dock that a turn about dock `k` to `planned` was to end at, or GROUND."""
    met = GROUND
    limit = limits.spacing + limits.contact_gap
    for step in range(1, body.shape[0]):
        arm = vector_at(body, (k + step) % body.shape[0]) - vector_at(body, k)
        point = pivot + rotate(planned, arm)
        cube = cube_of(point, limits.inverse_edge)
        for which in range(27):
            item = first_item(believed.cells, s, cube, which)
            while item >= 0:
                if (vector_in(believed.dock, s, item) - point).norm_sqr() < limit * limit:
                    met = item
                item = believed.cells.following[s, item]
    return met
