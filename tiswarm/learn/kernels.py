"""The features of what climbers observe, as a kernel, in the order of `learn.features`."""

from tiswarm.compute.lang import (
    GRAIN,
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
from tiswarm.learn.features import FLIP_FEATURES, ROBOT_FEATURES
from tiswarm.world.climb_kernels import (
    ClimbedDocks,
    ClimbLimits,
    limits_of,
    quaternion_at,
    sense_contacts,
    site_of,
)
from tiswarm.world.rule_kernels import EndContacts


@ti.kernel
def observe(
    limits_of_one: ClimbLimits, movers: Ints1, called: Ints1, sensed: Reals2,
    # ClimbedDocks
    head: Ints2, following: Ints2, dock: Reals3, relay: Ints2,
    # Climbers
    structure: Ints1, goal: Reals2, dock_offset_body: Reals2, ground: Reals1,
    of_structure: Reals2,
    # WalkArrays, where climbers believe them; flips that failed
    center: Reals3, touching: Ints4, on_ground: Ints3, last: Ints1, failed_count: Ints2,
    # FlipArrays
    angle: Reals2, end: Reals3, turned: Reals3, visited: Ints2,
    # EndContacts of one stance
    touching_out: Ints4, on_ground_out: Ints3,
    flips_out: Reals3, robot_out: Reals2,
    laws: Static,
):  # fmt: skip
    """Compute what movers observe; rows of others stay as they are.

    Args:
        limits_of_one: Distances and limits, and the terrain of one structure.
        movers: Slots of the robots that move, shape (M,).
        called: Whether each touches a dock that passes a call on, shape (M,).
        sensed: Load that each robot of the structures sensed, NaN for none, shape (S, N).
        failed_count: Flips that failed from each stance, shape (slots, stances).
        touching_out: Scratch: docks that each dock touches at an end, shape (slots, 1, n, most).
        on_ground_out: Scratch: ground on which they stand there, shape (slots, 1, n).
        flips_out: `FLIP_FEATURES`, 0 where there is no flip, shape (slots, K, F).
        robot_out: `ROBOT_FEATURES`, shape (slots, G).
        laws: Form of the ground: a `Laws`.
    """
    structures = ti.static(ClimbedDocks(CellList(head, following), dock, relay))
    here = ti.static(EndContacts(touching, on_ground))
    end_contacts = ti.static(EndContacts(touching_out, on_ground_out))
    site = ti.static(site_of(ground, laws))
    for i, idle in ti.ndrange(movers.shape[0], GRAIN):
        if idle == 0:
            m = movers[i]
            s = structure[m]
            limits = limits_of(limits_of_one, of_structure, s)
            aim = vector_at(goal, m)
            start = vector_in(center, m, last[m])
            to_goal = aim - start
            distance = to_goal.norm()
            best = last[m]
            least = distance
            for earlier in range(last[m]):
                stance = last[m] - 1 - earlier
                walked = (vector_in(center, m, stance) - aim).norm()
                if walked <= least:
                    least = walked
                    best = stance
            tries = last[m]
            since_best = last[m] - best
            for stance in range(last[m] + 1):
                tries += failed_count[m, stance]
                if stance >= best:
                    since_best += failed_count[m, stance]
            met = _met(sensed, here, s, m, last[m], dock_offset_body.shape[0])
            robot = ti.Vector([
                1.0, distance, to_goal[0], to_goal[1], to_goal[2], least, tries, since_best,
                called[i], met[0], met[1], met[2],
            ])  # fmt: skip
            for c in ti.static(range(len(ROBOT_FEATURES))):
                robot_out[m, c] = _cut(robot[c], ROBOT_FEATURES[c])
            for column in range(angle.shape[1]):
                if angle[m, column] != 0.0:
                    q = quaternion_at(turned, m, column)
                    place = vector_in(end, m, column)
                    calls = 0
                    for k in range(dock_offset_body.shape[0]):
                        point = place + rotate(q, vector_at(dock_offset_body, k))
                        calls |= sense_contacts(
                            limits, site, structures, s, end_contacts, m, 0, k, point
                        )
                    meets = _met(sensed, end_contacts, s, m, 0, dock_offset_body.shape[0])
                    remaining = (place - aim).norm()
                    way = place - start
                    flip = ti.Vector([
                        1.0, remaining, distance - remaining, way[0], way[1], way[2],
                        angle[m, column], visited[m, column], calls, meets[0], meets[1], meets[2],
                    ])  # fmt: skip
                    for c in ti.static(range(len(FLIP_FEATURES))):
                        flips_out[m, column, c] = _cut(flip[c], FLIP_FEATURES[c])


@ti.func
def _met(sensed: Ref, contacts: Ref, s, m, stance, docks):
    """Count touched docks and own docks on the ground, and find the greatest load touched."""
    met = ti.Vector([0.0, 0.0, 0.0])
    for k in range(docks):
        if contacts.on_ground[m, stance, k] > 0:
            met[1] += 1.0
        slot = 0
        while slot < contacts.touching.shape[3] and contacts.touching[m, stance, k, slot] >= 0:
            met[0] += 1.0
            load = sensed[s, contacts.touching[m, stance, k, slot] // docks]
            if load > met[2]:  # noqa: PLR1730 - never for NaN: dead robots sense nothing
                met[2] = load
            slot += 1
    return met


@ti.func
def _cut(value, feature: Ref):
    """Cut a value off at the bounds of its feature."""
    return ti.min(ti.max(value, float(feature.low)), float(feature.high))
