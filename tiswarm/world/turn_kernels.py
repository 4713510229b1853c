"""Where a dock that turns about a pivot first meets something. Lengths in R, angles in rad.

A dock that turns about a pivot by the angle t has, along any fixed direction, a coordinate of
the form a cos t + b sin t + c. Against a dock at w from the pivot the direction is w, against
flat ground it is straight down; both ask where a cos t + b sin t first rises through a level,
which has a closed form. At a rounded edge the squared distance to its axis is followed in
steps that cannot jump over a contact.
"""

from tiswarm.compute.lang import Ref, ti
from tiswarm.compute.math_kernels import vector_in

_SETTLED_RISE = 1e-12
"""A dock whose coordinate swings by less than this [R] slides along: it never enters."""
_RESTING_ANGLE = 1e-7
"""A contact met this little before the start of a turn is the one the dock rests on [rad]."""
_RESTING_GAP = 1e-10
"""Squared distances to an edge this close to contact are contact [R^2]."""
_MET = 1e-13
"""Largest step that counts as arrival at the edge [rad]."""
_NUDGE = 1e-3
"""Turn after which a dock that leaves an edge tangentially is clear of it [rad]."""
_MAX_STEPS = 500
"""Most steps along an edge; 10 to 40 are usual."""


@ti.func
def _ahead(angle, full_turn):
    """Wrap an angle to [0, a full turn); an angle just behind 0 is the contact it rests on."""
    wrapped = angle - full_turn * ti.floor(angle / full_turn)
    return ti.select(wrapped > full_turn - _RESTING_ANGLE, 0.0, wrapped)


@ti.func
def crossing_angles(a, b, level, full_turn):
    """Find where a cos t + b sin t first rises through `level`, turning forward and backward.

    Returns a full turn where it never does. Rising means entering: the obstacle lies above the
    level. A dock above the level all the way round touches at its lowest point, where it starts,
    and cannot turn.
    """
    angles = ti.Vector([full_turn, full_turn])
    swing = ti.sqrt(a * a + b * b)
    if swing <= -level and swing > _SETTLED_RISE:
        angles = ti.Vector([0.0, 0.0])
    elif swing > level and swing > _SETTLED_RISE:
        peak = ti.atan2(b, a)
        half_width = ti.acos(level / swing)
        angles[0] = _ahead(peak - half_width, full_turn)
        angles[1] = _ahead(-peak - half_width, full_turn)
    return angles


@ti.func
def _edge_angle(middle, across, onward, edge, side, limits):
    """Find the turn after which a dock first meets a slab with a rounded edge, or a full turn.

    The slab ends at `edge`, on its right for a `side` of 1, else -1 on its left.
    The dock is at middle + across cos t + onward sin t. Its squared distance to the slab's
    spine less D^2, g(t), is smooth with |g''| <= m, so up to the root of
    g + g' h - m h^2 / 2 nothing can be met.
    """
    depth = 0.5 * limits.spacing
    height = middle[2] - (limits.ground_z - depth)
    swing_x = ti.sqrt(across[0] * across[0] + onward[0] * onward[0])
    swing_z = ti.sqrt(across[2] * across[2] + onward[2] * onward[2])
    reach_x = ti.max(side * (middle[0] - edge) + swing_x, 0.0)
    bend = 2.0 * (swing_x * (swing_x + reach_x) + swing_z * (swing_z + ti.abs(height) + swing_z))
    met = limits.full_turn
    t = 0.0 * height
    steps = 0
    if swing_z < _SETTLED_RISE and ti.abs(height) > limits.spacing - _RESTING_GAP:
        t = limits.full_turn  # it slides along the flat and never enters
    # Each step ends before anything can be met: no contact is jumped over.
    while t < limits.full_turn and steps < _MAX_STEPS:
        steps += 1
        c = ti.cos(t)
        s = ti.sin(t)
        out = ti.max(side * (middle[0] + across[0] * c + onward[0] * s - edge), 0.0)
        up = height + across[2] * c + onward[2] * s
        gap = out * out + up * up - limits.spacing * limits.spacing
        slope = 2.0 * side * out * (onward[0] * c - across[0] * s)
        slope += 2.0 * up * (onward[2] * c - across[2] * s)
        if gap < _RESTING_GAP and t == 0.0 and slope > -_RESTING_GAP:
            gap = 0.0
            t = ti.max(slope / bend, _NUDGE)
        else:
            room = slope * slope + 2.0 * bend * gap
            step = (slope + ti.sqrt(ti.max(room, 0.0))) / bend
            if step < _MET:
                met = t
                break
            t += step
    return ti.min(met, limits.full_turn)


@ti.func
def slab_angles(middle, across, onward, edge, side, limits):
    """Find the angles, forward and backward, at which a dock first meets a slab."""
    angles = ti.Vector([limits.full_turn, limits.full_turn])
    swing_x = ti.sqrt(across[0] * across[0] + onward[0] * onward[0])
    swing_z = ti.sqrt(across[2] * across[2] + onward[2] * onward[2])
    top = limits.ground_z + 0.5 * limits.spacing
    if middle[2] - swing_z < top + _RESTING_GAP:
        inland = side * (middle[0] - edge) + swing_x <= 0.0
        if inland and middle[2] > limits.ground_z:
            angles = crossing_angles(-across[2], -onward[2], middle[2] - top, limits.full_turn)
        elif side * (middle[0] - edge) - swing_x < limits.spacing:
            angles[0] = _edge_angle(middle, across, onward, edge, side, limits)
            angles[1] = _edge_angle(middle, across, -onward, edge, side, limits)
    return angles


@ti.func
def contact_angles(limits: Ref, arm, axis, pivot, near: Ref, mover, near_count):
    """Find the angles, forward and backward, at which a dock at `arm` from the pivot is stopped."""
    along = arm.dot(axis)
    across = arm - along * axis
    onward = axis.cross(arm)
    middle = pivot + along * axis
    first = slab_angles(middle, across, onward, limits.left_edge, 1.0, limits)
    first = ti.min(first, slab_angles(middle, across, onward, limits.right_edge, -1.0, limits))
    for k in range(near_count):
        to_other = vector_in(near, mover, k)
        level = 0.5 * (arm.norm_sqr() + to_other.norm_sqr() - limits.spacing * limits.spacing)
        level -= along * to_other.dot(axis)
        met = crossing_angles(to_other.dot(across), to_other.dot(onward), level, limits.full_turn)
        first = ti.min(first, met)
    return first
