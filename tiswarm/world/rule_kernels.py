"""The flips that climbers may take, and what they would touch at the ends of these, as kernels.

The search of ReactiveBuild finds its flips by the same functions, those of `world.climb_kernels`.
"""

from typing import NamedTuple

from tiswarm.compute.lang import (
    GRAIN,
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
    ti,
)
from tiswarm.compute.math_kernels import rotate, vector_at, vector_in
from tiswarm.compute.neighbor_kernels import CellList
from tiswarm.world.climb_kernels import (
    SCRATCH_FULL,
    Beliefs,
    ClimbedDocks,
    Climbers,
    ClimbLimits,
    Manner,
    Obstacles,
    WalkArrays,
    enters,
    first_met,
    flip_axis,
    flipped,
    hinge_at,
    is_attached,
    limits_of,
    quaternion_at,
    revisits,
    sense_contacts,
    settle,
    site_of,
    turn_about,
)


class FlipArrays(NamedTuple):
    """Flips that each climber may take from the last stance of its walk, by slot.

    Column 2 (t k + j) + w has the flip about dock k and axis j of t, forward for w = 0; K in all.
    """

    angle: Reals2
    """Angle of the turn [rad], negative backward, or 0 where there is no flip, (slots, K)."""

    center: Reals3
    """Centers where the flips end [R], shape (slots, K, 3)."""

    orientation: Reals3
    """Orientations where they end, wxyz, shape (slots, K, 4)."""

    visited: Ints2
    """Whether the walk has been there before, shape (slots, K)."""


class StanceColumn(Columns):
    """What a climber meets at a stance."""

    CALLED = 1
    """Whether it touches a dock with a call."""
    OVERFLOW = 1
    """SCRATCH_FULL where more docks are near than fit, else 0."""


class EndContacts(NamedTuple):
    """What robots touch in several poses, as `WalkArrays` has it for stances."""

    touching: Ints4
    on_ground: Ints3


@ti.kernel
def list_flips(
    limits_of_one: ClimbLimits, movers: Ints1, sensed_out: Ints2,
    # ClimbedDocks
    head: Ints2, following: Ints2, dock: Reals3, relay: Ints2,
    # Climbers
    structure: Ints1, first_stance: Ints1, goal: Reals2, manner: Ints2,
    dock_offset_body: Reals2, twist: Reals2, near_out: Reals3, ground: Reals1,
    of_structure: Reals2,
    # WalkArrays
    center: Reals3, orientation: Reals3, pivot_dock: Ints2, touching_out: Ints4,
    on_ground_out: Ints3, last: Ints1, best: Ints1, stay: Ints1,
    # FlipArrays
    angle_out: Reals2, end_out: Reals3, turned_out: Reals3, visited_out: Ints2,
    laws: Static,
):  # fmt: skip
    """List what movers touch at the last stance of their walks, and the flips from there.

    `climb` takes the best of the same flips, in the same order. Where no stance is left, there
    are none.

    Args:
        limits_of_one: Distances and limits, and the terrain of one structure.
        movers: Slots of the robots that move, shape (M,).
        sensed_out: Columns of `StanceColumn`, shape (slots, 2).
        laws: Form of the ground: a `Laws`.
    """
    structures = ti.static(ClimbedDocks(CellList(head, following), dock, relay))
    believed = ti.static(Beliefs(CellList(head, following), dock, orientation))
    climbers = ti.static(Climbers(
        structure, first_stance, goal, manner, dock_offset_body, twist, near_out, ground,
        of_structure,
    ))  # fmt: skip
    walks = ti.static(WalkArrays(
        center, orientation, pivot_dock, touching_out, on_ground_out, last, best, stay,
    ))  # fmt: skip
    flips = ti.static(FlipArrays(angle_out, end_out, turned_out, visited_out))
    site = ti.static(site_of(ground, laws))
    for i, idle in ti.ndrange(movers.shape[0], GRAIN):
        if idle == 0:
            m = movers[i]
            limits = limits_of(limits_of_one, of_structure, structure[m])
            stance_center = vector_in(center, m, last[m])
            q = quaternion_at(orientation, m, last[m])
            called = 0
            for k in range(dock_offset_body.shape[0]):
                point = stance_center + rotate(q, vector_at(dock_offset_body, k))
                called |= sense_contacts(
                    limits, site, structures, structure[m], walks, m, last[m], k, point
                )
            sensed_out[m, StanceColumn.CALLED] = called
            sensed_out[m, StanceColumn.OVERFLOW] = 0
            for column in range(angle_out.shape[1]):
                angle_out[m, column] = 0.0
            for k in range(dock_offset_body.shape[0]):
                # One is kept for settling.
                if last[m] + 2 < center.shape[1] and is_attached(walks, m, last[m], k):
                    sensed_out[m, StanceColumn.OVERFLOW] |= _flips_about(
                        limits, structures, believed, climbers, walks, m, k, flips, laws
                    )


@ti.func
def _flips_about(
    limits: Ref, structures: Ref, believed: Ref, climbers: Ref, walks: Ref, m, k, flips: Ref,
    laws: Ref,
):  # fmt: skip
    """List the flips of a mover about its dock `k`; return SCRATCH_FULL or 0."""
    body = ti.static(climbers.dock_offset_body)
    site = ti.static(site_of(climbers.ground, laws))
    near = ti.static(Obstacles(climbers.near, site))
    stance = walks.last[m]
    q = quaternion_at(walks.orientation, m, stance)
    hinge = hinge_at(limits, structures, believed, climbers, walks, m, stance, k)
    anywhere = ti.Vector([0.0, 0.0, -ti.math.inf, 0.0])
    for number in range(climbers.twist.shape[0]):
        axis = flip_axis(climbers, hinge, number)
        turn = turn_about(axis, k, q, hinge.pivot)
        first = first_met(limits, body, turn, near, m, hinge.count, anywhere)
        for way in ti.static(range(2)):
            if first[way] >= limits.min_flip and first[way] <= limits.max_flip:
                column = 2 * (climbers.twist.shape[0] * k + number) + way
                turned = flipped(axis, way, first[way], q)
                end = hinge.pivot - rotate(turned, hinge.body_in)
                flips.angle[m, column] = (1.0 - 2.0 * way) * first[way]
                if ti.static(site.has_zones):
                    if enters(limits, site, body, end, turned):
                        flips.angle[m, column] = 0.0
                flips.visited[m, column] = ti.cast(revisits(limits, walks, m, stance, end), ti.i32)
                for c in ti.static(range(3)):
                    flips.center[m, column, c] = end[c]
                for c in ti.static(range(4)):
                    flips.orientation[m, column, c] = turned[c]
    return SCRATCH_FULL * hinge.overflow


@ti.kernel
def sense_ends(
    limits_of_one: ClimbLimits, movers: Ints1, structure: Ints1, dock_offset_body: Reals2,
    # ClimbedDocks
    head: Ints2, following: Ints2, dock: Reals3, relay: Ints2,
    # FlipArrays, all but the last
    angle: Reals2, end: Reals3, turned: Reals3,
    touching_out: Ints4, on_ground_out: Ints3, called_out: Ints2, ground: Reals1,
    of_structure: Reals2, laws: Static,
):  # fmt: skip
    """Find what movers would touch where the flips from `list_flips` end.

    Args:
        limits_of_one: Distances and limits, and the terrain of one structure.
        movers: Slots of the robots that move, shape (M,).
        structure: Structure that the robots of each slot climb, shape (slots,).
        dock_offset_body: Center to dock in the body frame [R], shape (n, 3).
        touching_out: As in `WalkArrays`, by flip in place of stance.
        on_ground_out: As in `WalkArrays`, by flip in place of stance.
        called_out: Whether a dock with a call is touched, shape (slots, K).
        ground: Numbers of the bodies of the ground.
        of_structure: Numbers of each structure, as `Climbers` has them.
        laws: Form of the ground: a `Laws`.
    """
    structures = ti.static(ClimbedDocks(CellList(head, following), dock, relay))
    contacts = ti.static(EndContacts(touching_out, on_ground_out))
    site = ti.static(site_of(ground, laws))
    for i, idle in ti.ndrange(movers.shape[0], GRAIN):
        if idle == 0:
            m = movers[i]
            limits = limits_of(limits_of_one, of_structure, structure[m])
            for column in range(angle.shape[1]):
                called_out[m, column] = 0
                if angle[m, column] != 0.0:
                    q = quaternion_at(turned, m, column)
                    for k in range(dock_offset_body.shape[0]):
                        arm = rotate(q, vector_at(dock_offset_body, k))
                        point = vector_in(end, m, column) + arm
                        called_out[m, column] |= sense_contacts(
                            limits, site, structures, structure[m], contacts, m, column, k, point
                        )


@ti.kernel
def settle_walks(
    limits_of_one: ClimbLimits, movers: Ints1,
    # ClimbedDocks
    head: Ints2, following: Ints2, dock: Reals3, relay: Ints2,
    # Climbers
    structure: Ints1, first_stance: Ints1, goal: Reals2, manner: Ints2,
    dock_offset_body: Reals2, twist: Reals2, near_out: Reals3, ground: Reals1,
    of_structure: Reals2,
    # WalkArrays
    center_out: Reals3, orientation_out: Reals3, pivot_dock_out: Ints2, touching_out: Ints4,
    on_ground_out: Ints3, last: Ints1, best: Ints1, stay_out: Ints1,
    laws: Static,
):  # fmt: skip
    """Let movers that settle turn, where they stay, until a third dock touches.

    Args:
        limits_of_one: Distances and limits, and the terrain of one structure.
        movers: Slots of the robots that move, shape (M,).
        laws: Form of the ground: a `Laws`.
    """
    structures = ti.static(ClimbedDocks(CellList(head, following), dock, relay))
    climbers = ti.static(Climbers(
        structure, first_stance, goal, manner, dock_offset_body, twist, near_out, ground,
        of_structure,
    ))  # fmt: skip
    walks = ti.static(WalkArrays(
        center_out, orientation_out, pivot_dock_out, touching_out, on_ground_out, last, best,
        stay_out,
    ))  # fmt: skip
    for i, idle in ti.ndrange(movers.shape[0], GRAIN):
        if idle == 0 and manner[movers[i], Manner.SETTLES]:
            m = movers[i]
            limits = limits_of(limits_of_one, of_structure, structure[m])
            settle(limits, structures, climbers, walks, m, laws)
