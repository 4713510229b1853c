"""Joining: how robots that climbed at the same time become part of the structure in turn."""

from tiswarm.compute.cell_kernels import CellList, cube_of, first_item, link
from tiswarm.compute.lang import F64, GRAIN, Ints1, Ints2, Ints3, Ints4, Reals2, Reals3, Ref, ti
from tiswarm.compute.math_kernels import quaternion_at, rotate, vector_at, vector_in
from tiswarm.world.climb_arrays import ClimbLimits, StructureArrays, WalkArrays


@ti.func
def _first_disturbed(limits: Ref, structures: Ref, s, walks: Ref, mover, body: Ref, newest):
    """Find the first stance of a walk that docks from item `newest` on could matter to, or -1.

    Only docks within a flip's reach of its own matter to what a robot senses and does. A robot
    settles anew from the last stance that it walked to.
    """
    disturbed = -1
    for stance in range(ti.max(walks.last[mover], walks.stay[mover]) + 1):
        here = vector_in(walks.center, mover, stance)
        q = quaternion_at(walks.orientation, mover, stance)
        for k in range(body.shape[0]):
            point = here + rotate(q, vector_at(body, k))
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
                    here = vector_in(center, m, stay[m])
                    q = quaternion_at(orientation, m, stay[m])
                    for k in range(docks):
                        point = here + rotate(q, vector_at(body, k))
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
    inverse_edge: F64, chosen: Ints1, dock_count: Ints1,
    # BelievedDocks
    head_out: Ints2, following_out: Ints2, dock: Reals3,
):  # fmt: skip
    """List anew, by place, the docks of some structures that have moved.

    Args:
        inverse_edge: One over the edge of a cube [1 / R].
        chosen: Structures to list, shape (C,).
        dock_count: Docks of every structure, shape (S,).
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
            for item in range(dock_count[s]):
                link(cells, s, item, cube_of(vector_in(dock, s, item), inverse_edge))
