"""Arrays of the annealer's kernels, in bundles that the host allocates and kernels hand on.

The swarm is C copies, one a chain, of N robots: those of all structures, end to end. Copies of one
structure in one chain are a block; there are B blocks. All structures together have T subtrees.
Copy r of robot i in chain c is number c N + i. Lengths in R.
"""

from typing import NamedTuple

from tiswarm.compute.lang import Float, Ints1, Ints2, Longs2, Reals1, Reals2, Reals3


class Step(NamedTuple):
    """One step of one structure."""

    number: int
    """Steps taken before it, t."""

    sigma: Float
    """Square root of the temperature [R]."""

    growth: Float
    """Size of the docks, as a part of their full size."""

    inertia_factor: Float
    """Factor of every mass; 4 halves the steps."""

    seed: int
    """Seed of the random numbers."""

    is_averaged: bool
    """Whether positions after this step count for the averages."""


class Robots(NamedTuple):
    """Constants of each robot."""

    label: Ints2
    """Structure that each robot is of, join number within it, and whether docks that do not touch
    repel, shape (N, 3)."""

    weight: Reals2
    """One over the squared width of the robust loss of links, 0 for none [1], and the precision of
    the sensed yaw, 0 where robots do not turn [rad^-2], shape (N, 2)."""


STRUCTURE, NUMBER, NON_OVERLAP = range(3)
ROBUST, YAW_PRECISION = range(2)
"""Columns of `Robots`."""


class Contacts(NamedTuple):
    """Contacts and ranges in CSR form; every one stands at both its robots, K entries in all.

    An offset is a contact whose direction is measured.
    """

    start: Ints1
    """First entry of each robot, shape (N + 1,)."""

    label: Ints2
    """Robot on the other side, whether the robots touch at their final stances, whether the robot
    measured the offset, not its partner, and the row of a touch in `candidates`, -1 of other
    entries, shape (K, 4)."""

    value: Reals2
    """Arm of the robot's dock less that of the partner's, as sensed [R], measured distance [R], its
    variance or that along an offset, the variance across an offset, 0 of other entries [R^2], and
    the gain in log-likelihood for each R more between the two centers [R^-1], shape (K, 7)."""

    level: Reals2
    """What turns with robots: horizontal arms, the robot's x and y and the partner's, and the
    measured vector from the robot's dock to the partner's, as sensed [R], shape (K, 7)."""

    has_offsets: bool
    """Whether any entry is an offset."""

    candidates: Reals3
    """Arms of the docks that may be those of each touch, as sensed: the robot's and the partner's
    [R], shape (H, docks, 6)."""

    has_touches: bool
    """Whether any entry is a touch."""


PARTNER, IS_FINAL, IS_OWN, TOUCH = range(4)
LENGTH, VARIANCE, ACROSS, EXTENSION = range(3, 7)
VECTOR = 4
"""Columns of `Contacts`; the shift and the lever come first."""


class Priors(NamedTuple):
    """Planes on which robots were measured to be, P of them in CSR form."""

    start: Ints1
    """First plane of each robot, shape (N + 1,)."""

    plane: Reals2
    """A point of each plane [R], the unit vector perpendicular to it, the part of the point which
    turns with the robot, x and y to be subtracted [R], the precision of the distance from the plane
    [R^-2], 1 where other planes of the robot are perpendicular to it, 3 elsewhere, and one over the
    squared width of the robust loss, 0 for none [1], shape (P, 11)."""


DIRECTION, WALK, PRECISION, CROWD, PLANE_ROBUST = 3, 6, 8, 9, 10
"""Columns of `Priors`; the point comes first."""


class Subtrees(NamedTuple):
    """Subtrees of the contact graph, which move as one."""

    of_robot: Ints1
    """Subtree that each copy of a robot belongs to, shape (C N,)."""

    table: Ints2
    """First own robot, the one after the last of these, the one after the last that moves with
    it, parent, whether it moves along x, y and z, and its number within the structure, shape
    (T, 8)."""

    weight: Reals1
    """Mass of each subtree, in masses of its own robots, shape (T,)."""

    first: Ints1
    """First subtree of each block, shape (B + 1,)."""

    pull: Reals2
    """Force on each copy of a subtree, and its mass, shape (C T, 4)."""

    velocity: Reals2
    """Velocity of each copy, shape (C T, 3)."""

    shift: Reals2
    """Shift of each copy in this step, its ancestors' included, and, written on graphics cards,
    without these [R], shape (C T, 6)."""

    sums: Longs2
    """Forces and masses of copies, added up run by run in parts of one, and then sums of runs;
    `motion_kernels` says how. Written on graphics cards, shape (`sum_rows(C N)`, 4)."""


OWN_END, END, PARENT, MOVES, ORDINAL = 1, 2, 3, 4, 7
"""Columns of `Subtrees.table`."""


class Swarm(NamedTuple):
    """State of every copy of a robot."""

    arm: Reals3
    """Center to dock, world frame [R], shape (C N, docks, 3)."""

    position: Reals2
    """Centers [R], shape (C N, 3)."""

    velocity: Reals2
    """Velocities, shape (C N, 3)."""

    force: Reals2
    """Forces of this step, shape (C N, 3)."""

    mass: Reals1
    """Masses, shape (C N,)."""

    heading: Reals2
    """How far robots are turned, and how they turn; columns as `force_kernels` names them, shape
    (C N, 7)."""

    total: Reals2
    """Sum of the positions that are averaged [R], shape (C N, 3)."""

    square_total: Reals1
    """Sum of their squares [R^2], shape (C N,)."""


class Blocks(NamedTuple):
    """Progress of each block, and the age of its Verlet rows."""

    start: Ints1
    """First robot of each block, shape (B + 1,)."""

    taken: Ints1
    """Steps taken so far, shape (B,)."""

    age: Ints1
    """Steps that the rows have served, or STALE, shape (B,)."""

    skin: Reals1
    """Reach of the rows beyond that of forces, for rows built next [R], shape (B,)."""

    listed: Reals1
    """Where robots were as rows were built, and last their block [R], rows of four."""

    strayed: Ints1
    """Whether a robot is beyond half the skin in this step, and beyond a quarter of the thick one;
    written on graphics cards, shape (2,)."""
