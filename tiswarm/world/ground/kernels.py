"""The ground as one function: the distance from a point to it, and what follows from that.

The distance is positive outside, negative inside, and true up to a few dock radii from the surface;
farther away it may be less. Between two points it changes by at most their distance times the
ground's Lipschitz constant, which is 1 unless a body says more. So from a point at distance d,
nothing can be met within d over that constant: every search goes on in such steps.

A ground is the union of bodies. The numbers of all bodies are in one array: those of `HEADER`, a
row of `BodyNumbers` for each body, then for each zone, and the values of grids.
Functions of users are compiled in. Their bodies are the last ones, in the same order.

Lengths in R, angles in rad, all in float64.
"""

from typing import NamedTuple

from tiswarm.compute.lang import (
    F64,
    I32,
    Columns,
    Ints1,
    Reals1,
    Reals2,
    Reals3,
    Ref,
    Static,
    ti,
)
from tiswarm.compute.math_kernels import TIE, turn_order, vector_at

PLANE, SLAB, BOX, CYLINDER, SPHERE, CLOSED_GRID, HEIGHT_GRID, USER = range(8)
"""Kinds of bodies. A height grid continues outward as its border is; a closed one has no border."""

LIPSCHITZ = 2
"""Place of the Lipschitz constant."""

HEADER = 3
"""Numbers before the rows: how many bodies there are, how many zones, and the Lipschitz constant.
"""

FAR = 1e30
"""Distance to a ground without bodies [R]."""


class BodyNumbers(Columns):
    """Numbers of a body, in its frame if not said otherwise."""

    KIND = 1
    """Kind, one of those above."""
    POSITION = 3
    """Origin of the body's frame, in that of the world [R]."""
    TURN = 9
    """Rows of the rotation from the world to the body."""
    SIZE = 3
    """Half of the sizes of a box; radius and half of the height of a cylinder, and 0; radius of a
    sphere, and 0, 0; first corner of a grid [R]."""
    EDGE = 1
    """Radius of rounded edges; half the thickness of a slab [R]."""
    FIRST = 1
    """Place in the array of a grid's first value."""
    COUNT = 3
    """Values of a grid along x, y and z, the last in a row."""
    CELL = 1
    """Distance between two values of a grid [R]."""


class GroundArray(NamedTuple):
    """The ground, as kernels see it."""

    array: Reals1
    """Numbers of all bodies and zones."""

    users: tuple[object, ...]
    """Functions of users, from a point in the body's frame to the distance [R]."""


SLIDE = 0.1
"""Shortest step of a dock that turns or falls [R].

Docks slide along the ground, where the distance allows no step at all. What the center of a dock
may not enter is rounded by the dock's radius, so that its curvature is at most 1 / R where it is
convex, and that of a dock's path adds less than half of that. So what lies between two steps is at
most 1.5 SLIDE^2 / 8 = 2e-3 R deep in the way of a dock that passes it. No dock stops inside.
"""
GLIDE = 2e-3
"""Shortest step of a ray, which nothing rounds [R]."""
TOUCH = 1e-10
"""Distance to the ground that counts as none [R]: rounding may be behind it."""
_MET = 1e-11
"""Distance to the ground that ends a search [R], below TOUCH."""
_HALVINGS = 40
"""Halvings of a step in which the ground was met: of SLIDE, 1e-13 R are left."""


@ti.func
def in_body(point, ground: Ref, base):
    """Express a point in the frame of the body whose numbers begin at `base`."""
    offset = ti.Vector([0.0, 0.0, 0.0], F64)
    for c in ti.static(range(3)):
        offset[c] = point[c] - ground.array[base + BodyNumbers.POSITION + c]
    local = ti.Vector([0.0, 0.0, 0.0], F64)
    for r in ti.static(range(3)):
        for c in ti.static(range(3)):
            local[r] += ground.array[base + BodyNumbers.TURN + 3 * r + c] * offset[c]
    return local


@ti.func
def grid_distance(local, ground: Ref, base, is_closed):
    """Interpolate a grid of distances linearly along each axis, and continue it outward."""
    cell = ground.array[base + BodyNumbers.CELL]
    inside = ti.Vector([0.0, 0.0, 0.0], F64)
    share = ti.Vector([0.0, 0.0, 0.0], F64)
    low = ti.Vector([0, 0, 0], I32)
    count = ti.Vector([0, 0, 0], I32)
    for c in ti.static(range(3)):
        count[c] = ti.cast(ground.array[base + BodyNumbers.COUNT + c], I32)
        place = (local[c] - ground.array[base + BodyNumbers.SIZE + c]) / cell
        inside[c] = ti.min(ti.max(place, 0.0), count[c] - 1.0)
        low[c] = ti.min(ti.cast(ti.floor(inside[c]), I32), count[c] - 2)
        share[c] = inside[c] - low[c]
        inside[c] = place - inside[c]  # cells beyond the border
    first = ti.cast(ground.array[base + BodyNumbers.FIRST], I32)
    distance = ti.cast(0.0, F64)
    for i, j, k in ti.static(ti.ndrange(2, 2, 2)):
        place = ((low[0] + i) * count[1] + low[1] + j) * count[2] + low[2] + k
        weight = share[0] if i else 1.0 - share[0]
        weight *= share[1] if j else 1.0 - share[1]
        weight *= share[2] if k else 1.0 - share[2]
        distance += weight * ground.array[first + place]
    return distance + cell * (inside.norm() if is_closed else inside[2])


@ti.func
def body_distance(local, ground: Ref, base):
    """Compute the distance from a point in the body's frame to a body that is no function."""
    kind = ti.cast(ground.array[base + BodyNumbers.KIND], I32)
    edge = ground.array[base + BodyNumbers.EDGE]
    size = ti.Vector([0.0, 0.0, 0.0], F64)
    for c in ti.static(range(3)):
        size[c] = ground.array[base + BodyNumbers.SIZE + c]
    distance = local[2]
    if kind == SLAB:
        out = ti.max(local[0], 0.0)
        up = local[2] + edge
        distance = ti.sqrt(out * out + up * up) - edge
    elif kind == BOX:
        beyond = ti.abs(local) - size + edge
        distance = ti.max(beyond, 0.0).norm() + ti.min(beyond.max(), 0.0) - edge
    elif kind == CYLINDER:
        around = ti.sqrt(local[0] * local[0] + local[1] * local[1]) - size[0] + edge
        above = ti.abs(local[2]) - size[1] + edge
        outside = ti.Vector([ti.max(around, 0.0), ti.max(above, 0.0)])
        distance = outside.norm() + ti.min(ti.max(around, above), 0.0) - edge
    elif kind == SPHERE:
        distance = local.norm() - size[0]
    elif kind == CLOSED_GRID or kind == HEIGHT_GRID:
        distance = grid_distance(local, ground, base, kind == CLOSED_GRID)
    return distance


@ti.func
def nearest_body(point, ground: Ref):
    """Return the distance from a point to the ground [R], and the number of the nearest body."""
    nearest = ti.Vector([FAR, -1.0], F64)
    count = ti.cast(ground.array[0], I32)
    solids = count - ti.static(len(ground.users))
    for row in range(solids):
        base = HEADER + row * BodyNumbers.TOTAL
        distance = ti.cast(0.0, F64)
        if (
            ground.array[base + BodyNumbers.KIND] == PLANE
        ):  # most grounds have one: no need to turn all
            for c in ti.static(range(3)):
                offset = point[c] - ground.array[base + BodyNumbers.POSITION + c]
                distance += ground.array[base + BodyNumbers.TURN + 6 + c] * offset
        else:
            distance = body_distance(in_body(point, ground, base), ground, base)
        if distance < nearest[0]:
            nearest = ti.Vector([distance, ti.cast(row, F64)])
    for user in ti.static(range(len(ground.users))):
        base = HEADER + (solids + user) * BodyNumbers.TOTAL
        distance = ti.static(ground.users[user])(in_body(point, ground, base))
        if distance < nearest[0]:
            nearest = ti.Vector([distance, ti.cast(solids + user, F64)])
    return nearest


@ti.func
def distance_to(point, ground: Ref):
    """Return the distance from a point to the ground [R], negative inside."""
    return nearest_body(point, ground)[0]


@ti.func
def zone_distance(point, ground: Ref):
    """Return the distance from a point to the nearest zone that robots may not enter [R]."""
    nearest = ti.cast(FAR, F64)
    first = ti.cast(ground.array[0], I32)
    for zone in range(ti.cast(ground.array[1], I32)):
        base = HEADER + (first + zone) * BodyNumbers.TOTAL
        nearest = ti.min(nearest, body_distance(in_body(point, ground, base), ground, base))
    return nearest


@ti.func
def normal_at(point, ground: Ref):
    """Return the unit vector along which the distance grows fastest."""
    slope = ti.Vector([0.0, 0.0, 0.0], F64)
    for c in ti.static(range(3)):
        step = ti.Vector([0.0, 0.0, 0.0], F64)
        step[c] = 1e-5
        slope[c] = distance_to(point + step, ground) - distance_to(point - step, ground)
    length = slope.norm()
    normal = ti.Vector([0.0, 0.0, 1.0], F64)
    if length > 0.0:
        normal = slope / length
    return normal


@ti.func
def on_arc(middle, across, onward, angle):
    """Return where a dock is that has turned by an angle."""
    return middle + ti.cos(angle) * across + ti.sin(angle) * onward


@ti.func
def arc_clearance(middle, across, onward, ground: Ref):
    """Bound the distance to the ground of a point that turns about an axis from below [R].

    The point is at middle + across cos t + onward sin t. The bound of a plane is exact, so that no
    search follows docks which slide along it.
    """
    swing = across.norm()
    clearance = ti.cast(FAR, F64)
    count = ti.cast(ground.array[0], I32)
    solids = count - ti.static(len(ground.users))
    for row in range(solids):
        base = HEADER + row * BodyNumbers.TOTAL
        distance = ti.cast(0.0, F64)
        if ground.array[base + BodyNumbers.KIND] == PLANE:
            a = ti.cast(0.0, F64)
            b = ti.cast(0.0, F64)
            for c in ti.static(range(3)):
                normal = ground.array[base + BodyNumbers.TURN + 6 + c]
                distance += normal * (middle[c] - ground.array[base + BodyNumbers.POSITION + c])
                a += normal * across[c]
                b += normal * onward[c]
            distance -= ti.sqrt(a * a + b * b)
        else:
            distance = body_distance(in_body(middle, ground, base), ground, base)
            distance -= ground.array[LIPSCHITZ] * swing
        clearance = ti.min(clearance, distance)
    for user in ti.static(range(len(ground.users))):
        base = HEADER + (solids + user) * BodyNumbers.TOTAL
        distance = ti.static(ground.users[user])(in_body(middle, ground, base))
        clearance = ti.min(clearance, distance - ground.array[LIPSCHITZ] * swing)
    return clearance


@ti.func
def arc_angle(middle, across, onward, radius, most, aim, ground: Ref):
    """Find the angle at which a sphere that turns about an axis meets the ground, `most` at most.

    The center of the sphere is at middle + across cos t + onward sin t. A sphere that rests on the
    ground may slide along it and leave it; where it would enter at once, the angle is 0.
    After the angle t, a robot gains cos t aim_0 + sin t aim_1. The angle is 0, too, of ways that
    gain less than aim_2 wherever they end, or end before aim_3.
    """
    swing = across.norm()
    lipschitz = ground.array[LIPSCHITZ]
    met = most
    if swing > TOUCH and arc_clearance(middle, across, onward, ground) - radius < -0.5 * TOUCH:
        largest = ti.sqrt(aim[0] * aim[0] + aim[1] * aim[1])
        best = turn_order(aim[0] / largest, aim[1] / largest)
        t = 0.0 * swing
        before = t
        gap = distance_to(on_arc(middle, across, onward, t), ground) - radius
        while t < most and met == most:
            before = t
            gap_before = gap
            t += ti.max(gap / lipschitz, SLIDE) / swing
            gap = distance_to(on_arc(middle, across, onward, t), ground) - radius
            is_entered = gap < -TOUCH
            is_lost = t < aim[3]
            is_behind = False
            if t < most and aim[0] < aim[2]:
                # What gains enough is between two angles, one before the best and one behind it.
                gains = ti.cos(t) * aim[0] + ti.sin(t) * aim[1]
                order = turn_order(ti.cos(t), ti.sin(t))
                is_lost = is_lost or (gains < aim[2] and order < best - TIE)
                is_behind = gains < aim[2] and order > best + TIE
            if is_entered and is_lost:
                met = 0.0
            elif is_entered:
                met = before
                # False position, with the value halved of an end that stays (Illinois): few of the
                # distances of a bisection are needed.
                low = before
                high = t
                gap_high = gap
                steps = 0
                if gap_before < _MET:
                    steps = _HALVINGS
                while steps < _HALVINGS:
                    steps += 1
                    part = (low * gap_high - high * gap_before) / (gap_high - gap_before)
                    gap_part = distance_to(on_arc(middle, across, onward, part), ground) - radius
                    if ti.abs(gap_part) <= _MET:
                        met = part
                        steps = _HALVINGS
                    elif gap_part < 0.0:
                        high = part
                        gap_high = gap_part
                        gap_before *= 0.5
                    else:
                        low = part
                        met = part
                        gap_before = gap_part
                        gap_high *= 0.5
            elif is_behind:
                t = most  # only an end before this one could count, which another dock may meet
    return ti.min(met, most)


@ti.kernel
def measure(point: Reals2, array: Reals1, users: Static, distance_out: Reals1, body_out: Ints1):
    """Compute distances to the ground.

    Args:
        point: Points [R], shape (n, 3).
        array: Numbers of bodies and zones.
        users: Functions of users.
        distance_out: Distances [R], shape (n,).
        body_out: Numbers of the nearest bodies, shape (n,).
    """
    ground = ti.static(GroundArray(array, users))
    for i in range(point.shape[0]):
        nearest = nearest_body(vector_at(point, i), ground)
        distance_out[i] = nearest[0]
        body_out[i] = ti.cast(nearest[1], I32)


@ti.kernel
def measure_zones(point: Reals2, array: Reals1, distance_out: Reals1):
    """Compute distances to zones that robots may not enter.

    Args:
        point: Points [R], shape (n, 3).
        array: Numbers of bodies and zones.
        distance_out: Distances [R], shape (n,).
    """
    ground = ti.static(GroundArray(array, ()))
    for i in range(point.shape[0]):
        distance_out[i] = zone_distance(vector_at(point, i), ground)


@ti.kernel
def find_feet(point: Reals2, array: Reals1, users: Static, foot_out: Reals2):
    """Find the nearest places on the ground to points near it.

    Args:
        point: Points [R], shape (n, 3).
        array: Numbers of bodies and zones.
        users: Functions of users.
        foot_out: Places [R], shape (n, 3).
    """
    ground = ti.static(GroundArray(array, users))
    ti.loop_config(serialize=True)  # few at a time: to wake threads would take longer
    for i in range(point.shape[0]):
        place = vector_at(point, i)
        foot = place - distance_to(place, ground) * normal_at(place, ground)
        for c in ti.static(range(3)):
            foot_out[i, c] = foot[c]


@ti.kernel
def cast_rays(
    start: Reals2, way: Reals2, radius: F64, lipschitz: F64, array: Reals1, users: Static,
    length_out: Reals1,
):  # fmt: skip
    """Find how far spheres that move straight go before they meet the ground.

    Args:
        start: Where centers start [R], shape (n, 3).
        way: Straight way of each center [R], shape (n, 3).
        radius: Radius of the spheres; 0 for points [R].
        lipschitz: Largest change of the distance over that of the point [1].
        array: Numbers of bodies and zones.
        users: Functions of users.
        length_out: Length that each goes; infinite where it meets nothing [R], shape (n,).
    """
    ground = ti.static(GroundArray(array, users))
    for i in range(start.shape[0]):
        whole = vector_at(way, i).norm()
        ahead = vector_at(way, i) / ti.max(whole, 1e-300)
        place = vector_at(start, i)
        length_out[i] = ti.math.inf
        t = 0.0 * whole
        before = t
        gap = distance_to(place, ground) - radius
        while t < whole and gap >= -TOUCH:
            before = t
            t = ti.min(t + ti.max(gap / lipschitz, GLIDE), whole)
            gap = distance_to(place + t * ahead, ground) - radius
        if gap < -TOUCH:
            low = before
            high = t
            for _ in range(_HALVINGS):
                half = 0.5 * (low + high)
                if distance_to(place + half * ahead, ground) - radius < 0.0:
                    high = half
                else:
                    low = half
            length_out[i] = low


@ti.kernel
def drop_robots(
    place: Reals2, arm: Reals3, depth: F64, radius: F64, lipschitz: F64, array: Reals1,
    users: Static, fall_out: Reals1,
):  # fmt: skip
    """Find how far robots that fall straight down go before a dock meets the ground.

    Args:
        place: Where centers start [R], shape (n, 3).
        arm: Vectors from the center to the docks [R], shape (n, docks, 3).
        depth: How far they may fall [R].
        radius: Radius of a dock [R].
        lipschitz: Largest change of the distance over that of the point [1].
        array: Numbers of bodies and zones.
        users: Functions of users.
        fall_out: How far each falls; infinite without ground in `depth` [R], shape (n,).
    """
    ground = ti.static(GroundArray(array, users))
    ti.loop_config(serialize=True)  # few at a time: to wake threads would take longer
    for i in range(place.shape[0]):
        fall_out[i] = ti.math.inf
        t = ti.cast(0.0, F64)
        before = t
        gap = _robot_gap(place, arm, i, t, radius, ground)
        while t < depth and gap >= 0.0:
            before = t
            t += ti.max(gap / lipschitz, SLIDE)
            gap = _robot_gap(place, arm, i, t, radius, ground)
        if gap < 0.0:
            low = before
            high = t
            for _ in range(_HALVINGS):
                half = 0.5 * (low + high)
                if _robot_gap(place, arm, i, half, radius, ground) < 0.0:
                    high = half
                else:
                    low = half
            fall_out[i] = low


@ti.func
def _robot_gap(place: Ref, arm: Ref, i, fall, radius, ground: Ref):
    """Return the least gap between the docks of a robot that has fallen and the ground."""
    gap = ti.cast(FAR, F64)
    for k in range(arm.shape[1]):
        dock = ti.Vector([0.0, 0.0, -fall], F64)
        for c in ti.static(range(3)):
            dock[c] += place[i, c] + arm[i, k, c]
        gap = ti.min(gap, distance_to(dock, ground) - radius)
    return gap
