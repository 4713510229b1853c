"""Flips as climbers plan them by where they believe docks to be, as kernels.

`rule_kernels.list_flips` lists where flips truly end. A climber that goes by beliefs sees what is
listed here instead: where it believes itself, and where it believes its flips to end. The search of
ReactiveBuild plans by the same functions, those of `world.climb_kernels`.
"""

from typing import NamedTuple

from tiswarm.compute.lang import (
    F64,
    GRAIN,
    I32,
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
from tiswarm.compute.math_kernels import rotate, vector_in
from tiswarm.compute.neighbor_kernels import CellList
from tiswarm.world.climb_kernels import (
    Beliefs,
    BelievedDocks,
    ClimbLimits,
    Flip,
    Obstacles,
    enters,
    first_met,
    flip_axis,
    flipped,
    hinge_at,
    is_attached,
    limits_of,
    misplaced,
    planned_dock,
    quaternion_at,
    revisits,
    row_of_true,
    sensed_orientation,
    site_of,
    turn_about,
)
from tiswarm.world.rule_kernels import FlipArrays


class PlanningClimbers(NamedTuple):
    """What planning reads of `Climbers`, and its scratch."""

    structure: Ints1
    dock_offset_body: Reals2
    twist: Reals2
    near: Reals3


class WalkedStances(NamedTuple):
    """What planning reads of `WalkArrays`."""

    center: Reals3
    orientation: Reals3
    touching: Ints4
    on_ground: Ints3
    last: Ints1


class DockPlaces(NamedTuple):
    """Docks of robots that have joined, without their cells."""

    dock: Reals3
    """Dock centers [R], shape (S, n N, 3)."""


class TurnedDocks(NamedTuple):
    """What `Beliefs` has, without its cells."""

    dock: Reals3
    turn: Reals3


class BelievedWalks(NamedTuple):
    """Where climbers believe the stances of their walks, by slot."""

    center: Reals3
    """Believed centers [R], shape (slots, stances, 3)."""

    orientation: Reals3
    """Sensed orientations, body to world, wxyz, shape (slots, stances, 4)."""


@ti.func
def _believe_stance(
    limits: Ref, structures: Ref, believed: Ref, body: Ref, s, walks: Ref, m, stance, out: Ref
):
    """Write where a climber believes itself at a stance of its walk, and how it senses to stand."""
    middle = ti.Vector([0.0, 0.0, 0.0], F64)
    by = misplaced(limits, structures, believed, body, s, walks, m, stance, 0, middle)
    place = vector_in(walks.center, m, stance) + by
    sensed = sensed_orientation(limits, believed, walks, m, stance)
    for c in ti.static(range(3)):
        out.center[m, stance, c] = place[c]
    for c in ti.static(range(4)):
        out.orientation[m, stance, c] = sensed[c]


@ti.kernel
def believe_stances(
    limits_of_one: ClimbLimits, movers: Ints1, first: Ints1, last: Ints1,
    # true docks and believed ones
    dock: Reals3, believed_dock: Reals3, turn: Reals3,
    # of Climbers and WalkArrays
    structure: Ints1, dock_offset_body: Reals2, of_structure: Reals2,
    center: Reals3, orientation: Reals3, touching: Ints4,
    # BelievedWalks
    believed_center_out: Reals3, sensed_out: Reals3,
):  # fmt: skip
    """Write where movers believe themselves at some stances of their walks.

    Args:
        limits_of_one: Distances and limits, and the terrain of one structure.
        movers: Slots of the robots, shape (M,).
        first: First stance of each slot to write, shape (slots,).
        last: Last stance of each slot to write, shape (slots,).
        dock: True dock centers [R], shape (S, n N, 3).
        believed_dock: Dock centers where robots believe them [R], shape (S, n N, 3).
        turn: As `Beliefs` has it.
        believed_center_out: Believed centers [R], shape (slots, stances, 3).
        sensed_out: Sensed orientations, wxyz, shape (slots, stances, 4).
    """
    structures = ti.static(DockPlaces(dock))
    believed = ti.static(TurnedDocks(believed_dock, turn))
    walks = ti.static(WalkedStances(center, orientation, touching, None, None))
    out = ti.static(BelievedWalks(believed_center_out, sensed_out))
    for i, idle in ti.ndrange(movers.shape[0], GRAIN):
        if idle == 0:
            m = movers[i]
            limits = limits_of(limits_of_one, of_structure, structure[m])
            for stance in range(first[m], last[m] + 1):
                _believe_stance(
                    limits, structures, believed, dock_offset_body, structure[m], walks, m,
                    stance, out,
                )  # fmt: skip


@ti.kernel
def plan_flips(
    limits_of_one: ClimbLimits, is_local: I32, movers: Ints1,
    # true docks, and Beliefs
    head: Ints2, following: Ints2, dock: Reals3,
    believed_head: Ints2, believed_following: Ints2, believed_dock: Reals3, turn: Reals3,
    # of Climbers
    structure: Ints1, dock_offset_body: Reals2, twist: Reals2, near_out: Reals3, ground: Reals1,
    of_structure: Reals2,
    # of WalkArrays
    center: Reals3, orientation: Reals3, touching: Ints4, on_ground: Ints3, last: Ints1,
    # FlipArrays
    angle_out: Reals2, end_out: Reals3, turned_out: Reals3, visited_out: Ints2,
    laws: Static,
):  # fmt: skip
    """List the flips that movers plan from the last stance of their walks.

    The columns are those of `list_flips`, which comes before: it finds what robots touch there. A
    planned flip ends where a dock is believed to meet something, and `visited` says whether the
    robot would then be where it has been. A robot that plans locally knows only what the robots
    that it touches believe: its flips end where they truly meet something, which it senses, and it
    believes that place by its own.

    Args:
        limits_of_one: Distances and limits, and the terrain of one structure.
        is_local: Whether robots plan locally.
        movers: Slots of the robots that move, shape (M,).
        laws: Form of the ground: a `Laws`.
    """
    structures = ti.static(BelievedDocks(CellList(head, following), dock))
    believed = ti.static(Beliefs(CellList(believed_head, believed_following), believed_dock, turn))
    climbers = ti.static(PlanningClimbers(structure, dock_offset_body, twist, near_out))
    walks = ti.static(WalkedStances(center, orientation, touching, on_ground, last))
    flips = ti.static(FlipArrays(angle_out, end_out, turned_out, visited_out))
    site = ti.static(site_of(ground, laws))
    for i, idle in ti.ndrange(movers.shape[0], GRAIN):
        if idle == 0:
            m = movers[i]
            limits = limits_of(limits_of_one, of_structure, structure[m])
            for column in range(angle_out.shape[1]):
                angle_out[m, column] = 0.0
            for k in range(dock_offset_body.shape[0]):
                if is_attached(walks, m, last[m], k):
                    _plans_about(
                        limits, is_local, site, structures, believed, climbers, walks, m, k, flips
                    )


@ti.func
def _plans_about(
    limits: Ref, is_local, site: Ref, structures: Ref, believed: Ref, climbers: Ref, walks: Ref,
    m, k, flips: Ref,
):  # fmt: skip
    """List the flips that a mover plans about its dock `k`."""
    stance = walks.last[m]
    body = ti.static(climbers.dock_offset_body)
    near = ti.static(Obstacles(climbers.near, site))
    q = quaternion_at(walks.orientation, m, stance)
    sensed = sensed_orientation(limits, believed, walks, m, stance)
    hinge = hinge_at(limits, structures, believed, climbers, walks, m, stance, k)
    pivot = hinge.pivot
    anywhere = ti.Vector([0.0, 0.0, -ti.math.inf, 0.0])
    for number in range(climbers.twist.shape[0]):
        axis = flip_axis(climbers, hinge, number)
        sensed_axis = rotate(quaternion_at(believed.turn, m, stance), axis)
        first = ti.Vector([0.0, 0.0], F64)
        if is_local:
            row = row_of_true(climbers, m)
            turn = turn_about(axis, k, q, pivot)
            first = first_met(limits, body, turn, near, row, hinge.obstacles, anywhere)
        else:
            place = pivot + hinge.by
            turn = turn_about(sensed_axis, k, sensed, place)
            first = first_met(limits, body, turn, near, m, hinge.count, anywhere)
        for way in ti.static(range(2)):
            if first[way] >= limits.min_flip and first[way] <= limits.max_flip:
                column = 2 * (climbers.twist.shape[0] * k + number) + way
                turned = flipped(axis, way, first[way], q)
                planned = flipped(sensed_axis, way, first[way], sensed)
                end = pivot - rotate(turned, hinge.body_in)
                believed_end = pivot - rotate(planned, hinge.body_in) + hinge.by
                flips.angle[m, column] = (1.0 - 2.0 * way) * first[way]
                if ti.static(site.has_zones):
                    if enters(limits, site, body, end, turned):
                        flips.angle[m, column] = 0.0
                flips.visited[m, column] = ti.cast(revisits(limits, walks, m, stance, end), ti.i32)
                for c in ti.static(range(3)):
                    flips.center[m, column, c] = believed_end[c]
                for c in ti.static(range(4)):
                    flips.orientation[m, column, c] = planned[c]


@ti.kernel
def note_planned_docks(
    limits_of_one: ClimbLimits, movers: Ints1, dock: Reals3,
    # Beliefs
    believed_head: Ints2, believed_following: Ints2, believed_dock: Reals3, turn: Reals3,
    # of Climbers
    structure: Ints1, first_stance: Ints1, dock_offset_body: Reals2, of_structure: Reals2,
    # of WalkArrays
    center: Reals3, orientation: Reals3, touching: Ints4, last: Ints1, pivot_dock: Ints2,
    planned: Reals3, flips_out: Ints3,
):  # fmt: skip
    """Note the docks at which the flips of walks were planned to end, from `first_stance` on.

    Args:
        limits_of_one: Distances and limits, and the terrain of one structure.
        movers: Slots of the robots, shape (M,).
        dock: True dock centers [R], shape (S, n N, 3).
        planned: Orientation in which the flip from each stance was planned to end, wxyz, shape
            (slots, stances, 4).
        flips_out: Column 0: item of that dock, or GROUND, as `climb` notes it, shape (slots,
            stances, 2).
    """
    structures = ti.static(DockPlaces(dock))
    believed = ti.static(Beliefs(CellList(believed_head, believed_following), believed_dock, turn))
    climbers = ti.static(PlanningClimbers(structure, dock_offset_body, None, None))
    walks = ti.static(WalkedStances(center, orientation, touching, None, None))
    for i, idle in ti.ndrange(movers.shape[0], GRAIN):
        if idle == 0:
            m = movers[i]
            limits = limits_of(limits_of_one, of_structure, structure[m])
            for stance in range(first_stance[m], last[m]):
                flip = Flip(
                    distance=0.0,
                    center=vector_in(center, m, stance),
                    orientation=quaternion_at(orientation, m, stance),
                    planned=quaternion_at(planned, m, stance),
                    pivot=pivot_dock[m, stance],
                    overflow=0,
                    failed=0,
                )
                flips_out[m, stance, 0] = planned_dock(
                    limits, structures, believed, climbers, walks, m, stance, flip
                )
