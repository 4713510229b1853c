"""Joining: how robots that climbed at the same time become part of the structure in turn."""

from tiswarm.compute.cell_kernels import bucket_of, cube_of, link, neighbor_cube
from tiswarm.compute.lang import GRAIN, Ints1, Ints2, Reals2, Reals3, Ref, ti
from tiswarm.compute.math_kernels import quaternion_at, rotate, vector_at, vector_in
from tiswarm.world.kernels import DOCKS
from tiswarm.world.meeting import ClimbLaw


@ti.func
def is_disturbed(
    law, here, q, structure, newest, head: Ref, following: Ref, dock: Ref, dock_offset_body: Ref
):
    """Whether a dock that joined as item `newest` or later could matter to this stance.

    What a robot feels and can do depends on docks within a flip's reach of its own alone.
    """
    found = False
    for k in range(DOCKS):
        point = here + rotate(q, vector_at(dock_offset_body, k))
        cube = cube_of(point, law.inverse_edge)
        for which in range(27):
            item = head[structure, bucket_of(neighbor_cube(cube, which), head.shape[1])]
            while item >= newest:  # chains run from the newest item to the oldest
                offset = vector_in(dock, structure, item) - point
                found = found or offset.norm_sqr() < law.reach * law.reach
                item = following[structure, item]
    return found


@ti.func
def first_disturbed(
    law, mover, last, structure, newest, center: Ref, orientation: Ref, head: Ref, following: Ref,
    dock: Ref, dock_offset_body: Ref,
):  # fmt: skip
    """First stance of a walk that items from `newest` on could matter to, or -1."""
    disturbed = -1
    for stance in range(last + 1):
        if disturbed < 0:
            here = vector_in(center, mover, stance)
            q = quaternion_at(orientation, mover, stance)
            if is_disturbed(
                law, here, q, structure, newest, head, following, dock, dock_offset_body
            ):
                disturbed = stance
    return disturbed


@ti.kernel
def join_undisturbed(
    law: ClimbLaw,
    # movers, structure by structure
    first_mover: Ints1, movers: Ints1, wants: Ints1, dock_offset_body: Reals2, center: Reals3,
    orientation: Reals3, last: Ints1, stay: Ints1,
    # what it changes
    dock: Reals3, robot_count: Ints1, head: Ints2, following: Ints2,
    # what it writes
    disturbed: Ints1, joined: Ints1,
):  # fmt: skip
    """Let movers that climbed at the same time join one after the other, as far as they can.

    A mover joins if nothing that joined before it in this round lies near any stance of its
    walk: then it has met all it would have met, had it started afterwards. The others are
    to go on from the first stance that is disturbed.

    Args:
        law: Terrain, distances and limits.
        first_mover: First entry of `movers` of each structure, shape (S + 1,).
        movers: Slots of the movers, shape (M,).
        wants: Whether each slot's walk ends where it can stay, by slot.
        dock_offset_body: Center to dock in the body frame [R], shape (3, 3).
        center: Walks, by slot [R], shape (slots, stances, 3).
        orientation: Likewise, wxyz, shape (slots, stances, 4).
        last: Last stance of each walk, by slot.
        stay: Stance where the robot stays, by slot.
        dock: Changed: dock centers of the structures [R], shape (S, docks, 3).
        robot_count: Changed: robots of each structure, shape (S,).
        head: Changed: first dock of each bucket, shape (S, buckets).
        following: Changed: next dock of a chain, shape (S, docks).
        disturbed: Written: first disturbed stance of each slot, or -1.
        joined: Written: number under which each slot's robot joined, or -1.
    """
    for i in range(robot_count.shape[0] * GRAIN):
        if i % GRAIN == 0:
            s = i // GRAIN
            newest = DOCKS * robot_count[s]
            for n in range(first_mover[s], first_mover[s + 1]):
                m = movers[n]
                joined[m] = -1
                passed = -1
                if DOCKS * robot_count[s] > newest:
                    passed = first_disturbed(
                        law, m, ti.max(last[m], stay[m]), s, newest,
                        center, orientation, head, following, dock, dock_offset_body,
                    )  # fmt: skip
                if wants[m] and passed < 0 and DOCKS * robot_count[s] < dock.shape[1]:
                    joined[m] = robot_count[s]
                    here = vector_in(center, m, stay[m])
                    q = quaternion_at(orientation, m, stay[m])
                    for k in range(DOCKS):
                        point = here + rotate(q, vector_at(dock_offset_body, k))
                        item = DOCKS * joined[m] + k
                        for c in ti.static(range(3)):
                            dock[s, item, c] = point[c]
                        link(head, following, s, item, cube_of(point, law.inverse_edge))
                    robot_count[s] += 1
            # Only now is it known what all has joined beside those that go on.
            for n in range(first_mover[s], first_mover[s + 1]):
                m = movers[n]
                disturbed[m] = -1
                if joined[m] < 0 and DOCKS * robot_count[s] > newest:
                    disturbed[m] = first_disturbed(
                        law, m, ti.max(last[m], stay[m]), s, newest,
                        center, orientation, head, following, dock, dock_offset_body,
                    )  # fmt: skip
