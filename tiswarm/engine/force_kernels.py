"""Virtual forces between docks, as functions of kernels.

A force is the step of a robot's center in one iteration [R]. Offsets point from the robot's
own dock to the other one: a positive magnitude pulls toward it.
"""

from tiswarm.compute.lang import ti

TINY = 1e-20
"""Docks nearer than this [R] have no direction to part in, and feel no force."""


@ti.func
def pull_of(distance, connected, attraction, repulsion, spacing):
    """Magnitude of Eqs. (1) and (2); the ramp is in `attraction` and `repulsion` already.

    Every branch is computed, since which one holds cannot be predicted in a dense swarm.
    """
    gap = distance - spacing
    square = gap * gap  # a name, so that strict arithmetic multiplies twice, not three times
    pull = ti.select(connected, attraction * gap, 0.0)
    return ti.select(gap > 0.0, pull, -repulsion * square * square)


@ti.func
def dock_pair_force(offset, attraction_gain, repulsion_gain, spacing, ramp):
    """Force on a dock whose connected partner lies at `offset`, Eq. (1).

    With d = |offset|, u = offset / d, spacing D and ramp a:

        F =  A a (d - D) u            if d > D
        F = -B (1 - a) (d - D)^4 u    otherwise

    Docks that coincide have no direction to part in, and feel no force.
    """
    distance = offset.norm()
    pull = pull_of(distance, True, attraction_gain * ramp, repulsion_gain * (1.0 - ramp), spacing)
    return pull / ti.max(distance, TINY) * offset


@ti.func
def parting(offset, stiffness, spacing):
    """Force of a spring that only parts: F = stiffness (d - D) u if d < D, else none."""
    distance = offset.norm()
    return stiffness * ti.min(distance - spacing, 0.0) / ti.max(distance, TINY) * offset


@ti.func
def capped(step, max_step):
    """The same step, or one of length `max_step` in its direction where it is longer."""
    length = step.norm()
    scale = ti.select(length > max_step, max_step / length, 1.0)
    return step * scale
