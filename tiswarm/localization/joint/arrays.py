"""Arrays of the annealer's kernels, in bundles that the host allocates and kernels hand on.

The swarm is C copies, one a chain, of N robots: those of all structures, end to end. Copies of one
structure in one chain are a block; there are B blocks. All structures together have T subtrees.
Copy r of robot i in chain c is number c N + i. Lengths in R.

A table has a name for each of its columns, or for the first of several that form a vector.
"""

from enum import Flag, auto
from typing import NamedTuple

from tiswarm.compute.lang import Ints2, Reals1, Reals2, Reals3


class Traits(Flag):
    """What kernels are compiled for, beside the docks of a robot; anew for each other set."""

    BY_BLOCK = auto()
    """One thread takes all steps of a block, and builds its rows anew when they are stale. Else
    all threads take the next step together, and the host builds rows."""

    TURNING = auto()
    """Some robot turns; no bit of others depends on it."""

    OFFSETS = auto()
    """Some entry of the contacts is an offset."""

    TOUCHES = auto()
    """Some entry of the contacts is a touch."""

    GONE = auto()
    """Some robot has left, so that its docks are in nobody's way."""


class KernelVariant(NamedTuple):
    """The same for functions of kernels, which ask in `ti.static`."""

    docks: int
    """Docks of a robot."""

    by_block: bool
    """Whether `BY_BLOCK` is among the traits."""

    turning: bool
    """Whether `TURNING` is."""

    has_offsets: bool
    """Whether `OFFSETS` is."""

    has_touches: bool
    """Whether `TOUCHES` is."""

    has_gone: bool
    """Whether `GONE` is."""


def variant_of(docks: int, traits: Traits) -> KernelVariant:
    """Write traits out. A kernel is launched with traits, since quadrants takes no tuples there."""
    return KernelVariant(docks, *(trait in traits for trait in Traits))


class Step(NamedTuple):
    """One step of all structures."""

    number: int
    """Steps taken before it, t."""

    seed: int
    """Seed of the random numbers."""

    hold: int
    """First step after which positions count for the averages."""

    schedule: Reals2
    """Square root of the temperature of each structure at each step [R], and last the size of the
    docks, as a part of their full size [1], shape (S + 1, steps)."""


class Robots(NamedTuple):
    """Constants of each robot."""

    label: Ints2
    """Shape (N, 8); columns:

    STRUCTURE: Structure that the robot is of.
    NUMBER: Join number within it; 0 is the anchor.
    NON_OVERLAP: Whether docks that do not touch repel; those of a robot that has left never do.
    SUBTREE: Subtree that the robot belongs to.
    CONTACT, CONTACT_END: First entry of its contacts, and the one after their last.
    PLANE, PLANE_END: First of its planes, and the one after their last.
    """

    weight: Reals2
    """Shape (N, 3); columns:

    ROBUST: One over the squared width of the robust loss of links, 0 for none [1].
    YAW_PRECISION: Precision of the sensed yaw, 0 where robots do not turn [rad^-2].
    LIGHTEST: Factor of every mass; 4 halves the steps [1].
    """


STRUCTURE, NUMBER, NON_OVERLAP, SUBTREE, CONTACT, CONTACT_END, PLANE, PLANE_END = range(8)
ROBUST, YAW_PRECISION, LIGHTEST = range(3)


class Contacts(NamedTuple):
    """Contacts and ranges, robot by robot; every one stands at both its robots, K entries in all.

    An offset is a contact whose direction is measured; of a touch the docks are unknown.
    """

    label: Ints2
    """Shape (K, 4); columns:

    PARTNER: Robot on the other side.
    IS_FINAL: Whether the robots touch at their final stances.
    IS_OWN: Whether the robot measured the offset, not its partner.
    TOUCH: Row of a touch in `candidates`, -1 of other entries.
    """

    value: Reals2
    """Shape (K, 14), or (K, 7) where nobody turns and there are no offsets; columns:

    ARMS: Arm of the robot's dock less that of the partner's, as sensed [R], 3 columns.
    LENGTH: Measured distance of the docks [R].
    VARIANCE: Its variance, or that along an offset [R^2].
    ACROSS: The variance across an offset, 0 of other entries [R^2].
    EXTENSION: Gain in log-likelihood for each R more between the two centers [R^-1].
    LEVERS: Horizontal arms, which turn: the robot's x and y and the partner's [R], 4 columns.
    VECTOR: The measured vector from the robot's dock to the partner's, as sensed [R], 3 columns.
    """

    candidates: Reals3
    """Arms of the docks that may be those of each touch, as sensed: the robot's and the partner's
    [R], shape (H, docks, 6)."""


PARTNER, IS_FINAL, IS_OWN, TOUCH = range(4)
ARMS, LENGTH, VARIANCE, ACROSS, EXTENSION, LEVERS, VECTOR = 0, 3, 4, 5, 6, 7, 11


class MeasuredColumns(NamedTuple):
    """All that is known of robots."""

    robots: Robots
    """Constants of each."""

    contacts: Contacts
    """Their contacts and ranges."""

    plane: Reals2
    """Planes on which robots were measured to be, robot by robot, shape (P, 11); columns:

    POINT: A point of the plane [R], 3 columns.
    DIRECTION: The unit vector perpendicular to it, 3 columns.
    WALK: The part of the point which turns with the robot, x and y to be subtracted [R], 2 columns.
    PRECISION: Precision of the distance from the plane [R^-2].
    CROWD: 1 where other planes of the robot are perpendicular to it, 3 elsewhere.
    PLANE_ROBUST: One over the squared width of the robust loss, 0 for none [1].
    """


POINT, DIRECTION, WALK, PRECISION, CROWD, PLANE_ROBUST = 0, 3, 6, 8, 9, 10


class Subtrees(NamedTuple):
    """Subtrees of the contact graph, which move as one."""

    table: Ints2
    """Shape (T, 8); columns:

    OWN: First own robot.
    OWN_END: The one after the last of these.
    END: The one after the last that moves with it.
    PARENT: Subtree that it grows out of.
    MOVES: Whether it moves along x, y and z, 3 columns.
    ORDINAL: Its number within the structure.
    """

    motion: Reals2
    """Of each copy, shape (C T, 14); columns:

    FORCE, MASS, VELOCITY: As for robots, of all that moves with the subtree.
    SHIFT: Shift in this step, its ancestors' included [R], 3 columns.
    OWN_SHIFT: The same without its ancestors', written on graphics cards [R], 3 columns.
    WEIGHT: Mass, in masses of its own robots.
    """


OWN, OWN_END, END, PARENT, MOVES, ORDINAL = 0, 1, 2, 3, 4, 7
SHIFT, OWN_SHIFT, WEIGHT = 7, 10, 13


class Copies(NamedTuple):
    """State of every copy of a robot."""

    arm: Reals3
    """Center to dock, world frame [R], shape (C N, docks, 3)."""

    position: Reals2
    """Centers [R], shape (C N, 3)."""

    motion: Reals2
    """Shape (C N, 7); columns:

    FORCE: Force of this step, 3 columns.
    MASS: Mass.
    VELOCITY: Velocity, 3 columns.
    """

    heading: Reals2
    """How far robots are turned, and how they turn, shape (C N, 7); columns:

    COS, SIN, YAW: Cosine, sine and angle of the turn so far [rad].
    SPIN, TORQUE, INERTIA: Velocity, force and mass of the turn.
    TOTAL: Sum of the angles that are averaged [rad].
    """

    total: Reals2
    """Sums over the steps that are averaged, shape (C N, 4): positions [R], and, in the column
    SQUARE, their squares [R^2]."""


FORCE, MASS, VELOCITY = 0, 3, 4
COS, SIN, YAW, SPIN, TORQUE, INERTIA, TOTAL = range(7)
SQUARE = 3


class Blocks(NamedTuple):
    """Progress of each block, and its Verlet rows."""

    progress: Ints2
    """Shape (B, 7); columns:

    TREE, TREE_END: First copy of a subtree, and the one after the last.
    TAKEN: Steps taken so far.
    AGE: Steps that the rows have served, or STALE.
    IS_THIN: Whether the rows that are built next have the thin skin.
    HAS_STRAYED, IS_FAST: Whether a robot is beyond half the skin in this step, and beyond a quarter
        of the thick one; written on graphics cards, for the first block only.
    """

    listed: Reals1
    """Where robots were as rows were built, and last their block [R], rows of four."""


TREE, TREE_END, TAKEN, AGE, IS_THIN, HAS_STRAYED, IS_FAST = range(7)
STALE = -1
"""Age of rows that have to be built anew."""
