"""Arrays of the annealer's kernels, in bundles that the host allocates and kernels hand on.

The swarm is C copies, one a chain, of N robots: those of all structures, end to end. Copies of one
structure in one chain are a block; there are B blocks. All structures together have T subtrees.
Copy r of robot i in chain c is number c N + i. Lengths in R.

A table has a name for each of its columns, or for the first of several that form a vector.

Robots of a subtree stand in a row in memory. `order` is that order, of the robots of all structures
end to end, shape (N,).
"""

from collections.abc import Mapping, Sequence
from enum import Flag, auto
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.backend import Allocator
from tiswarm.compute.lang import DeviceArray, Ints2, Reals1, Reals2, Reals3
from tiswarm.localization.chains.problem import Problem
from tiswarm.localization.chains.subtrees import Forest, weights
from tiswarm.localization.cost.settings import ROBUST_SD
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.model import KNOWN


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


def traits_of(problems: Sequence[Problem], *, by_block: bool) -> Traits:
    """Find what kernels are to be compiled for, in problems that are annealed side by side."""
    traits = Traits.BY_BLOCK if by_block else Traits(0)
    if any(p.yaw_precision for p in problems):
        traits |= Traits.TURNING
    if any(p.is_offset.any() for p in problems):
        traits |= Traits.OFFSETS
    if any(p.is_touch.any() for p in problems):
        traits |= Traits.TOUCHES
    if any(len(p.gone) for p in problems):
        traits |= Traits.GONE
    return traits


def measured_arrays(
    memory: Allocator,
    problems: Sequence[Problem],
    params: Sequence[JointParams],
    order: Ints,
    *,
    trees: Sequence[Forest],
    lightest: float,
) -> MeasuredColumns:
    """Put all that is known of robots on the device.

    Args:
        memory: Where arrays are allocated.
        problems: Measurements of each structure.
        params: Settings for each.
        order: Robots of all structures in the order of memory, shape (N,).
        trees: Subtrees of each.
        lightest: Factor of every mass.
    """
    size = [len(p.part) for p in problems]
    number = np.concatenate([np.arange(robots) for robots in size])[order]
    own = np.concatenate([np.diff(tree.first) for tree in trees])
    pairs = zip(params, problems, strict=True)
    repels = np.concatenate([p.non_overlap & ~e.is_gone for p, e in pairs])[order]
    contact, contacts = _contact_arrays(memory, problems, params, order)
    plane, planes = _plane_array(memory, problems, params, order)
    label = {
        STRUCTURE: np.repeat(np.arange(len(size)), size),
        NUMBER: number,
        NON_OVERLAP: repels.astype(np.int64),
        SUBTREE: np.repeat(np.arange(len(own)), own),
        CONTACT: contact[:-1],
        CONTACT_END: contact[1:],
        PLANE: plane[:-1],
        PLANE_END: plane[1:],
    }
    weight = {
        ROBUST: np.repeat([ROBUST_SD**-2 * p.robust for p in params], size),
        YAW_PRECISION: np.repeat([p.yaw_precision for p in problems], size),
        LIGHTEST: np.full(len(order), lightest),
    }
    robots = Robots(label=memory.upload(_packed(label)), weight=memory.upload(_packed(weight)))
    return MeasuredColumns(robots=robots, contacts=contacts, plane=planes)


def _contact_arrays(
    memory: Allocator, problems: Sequence[Problem], params: Sequence[JointParams], order: Ints
) -> tuple[Ints, Contacts]:
    """Put the contacts of all structures on the device, each at both its robots.

    Returns:
        First entry of each robot, shape (N + 1,), and the contacts.
    """
    robot = _in_memory([e.robot for e in problems], problems, order)
    other = _in_memory([e.other for e in problems], problems, order)
    is_offset = np.concatenate([e.is_offset for e in problems])
    extension = np.concatenate(
        [p.extension_prior * e.is_final / e.fewest for e, p in zip(problems, params, strict=True)]
    )
    extension[is_offset] = 0.0  # their direction is measured
    vector = np.concatenate([e.vector for e in problems])
    shift = np.concatenate([e.shift for e in problems]) - vector
    lever = np.concatenate([e.lever for e in problems])
    lever[:, :2] -= vector[:, :2]
    variance = np.concatenate([e.variance[e.link] for e in problems])
    total = np.concatenate([e.by_link(e.variance) for e in problems])
    is_touch = np.concatenate([e.is_touch for e in problems])
    arms = np.concatenate([np.dstack([arm for arm, _ in e.rows.touch_arms]) for e in problems])
    touch = np.full((2, len(robot)), -1)
    touch[:, is_touch] = np.arange(2 * len(arms)).reshape(2, -1)
    label = {
        PARTNER: other,
        IS_FINAL: np.concatenate([e.is_final & e.is_present for e in problems]).astype(np.int64),
        IS_OWN: np.ones_like(robot),
        TOUCH: touch[0],
    }
    value = {
        ARMS: shift,
        LENGTH: np.concatenate([e.length for e in problems]),
        VARIANCE: variance,
        ACROSS: np.where(is_offset, 0.5 * (total - variance), 0.0),
        EXTENSION: extension,
    }
    back = {ARMS: -shift}
    if is_offset.any() or any(p.yaw_precision for p in problems):
        value |= {LEVERS: lever, VECTOR: vector}
        back |= {LEVERS: lever[:, [2, 3, 0, 1]], VECTOR: -vector}
    # The same contact as its other robot has it.
    its_label = label | {PARTNER: robot, IS_OWN: np.zeros_like(robot), TOUCH: touch[1]}
    both = np.concatenate([robot, other])
    # Stable: each robot sums its contacts in the order of the log, in any company.
    by_robot = np.argsort(both, kind="stable")
    labels, values = (
        np.concatenate([_packed(one), _packed(two)])[by_robot]
        for one, two in ((label, its_label), (value, value | back))
    )
    return _row_starts(both, len(order)), Contacts(
        label=_upload(memory, labels),
        value=_upload(memory, values, padding=1.0),
        candidates=_upload(memory, np.concatenate([arms, np.roll(arms, 3, axis=2)])),
    )


def _plane_array(
    memory: Allocator, problems: Sequence[Problem], params: Sequence[JointParams], order: Ints
) -> tuple[Ints, DeviceArray]:
    """Put the planes of all structures on the device, robot by robot.

    Returns:
        First plane of each robot, shape (N + 1,), and `MeasuredColumns.plane`.
    """
    robot = _in_memory([e.planes.robot for e in problems], problems, order)
    table = np.concatenate([_planes_of(*each) for each in zip(problems, params, strict=True)])
    plane = _upload(memory, table[np.argsort(robot, kind="stable")])
    return _row_starts(robot, len(order)), plane


def _planes_of(problem: Problem, params: JointParams) -> Reals:
    """Gather the columns of `MeasuredColumns.plane` of one structure, shape (P, 11)."""
    planes = problem.planes
    gives_way = planes.is_redundant(problem.part) & (planes.precision * KNOWN < 1.0)
    robust = ROBUST_SD**-2 * params.robust * gives_way
    return _packed({
        POINT: planes.point,
        DIRECTION: planes.direction,
        WALK: planes.walk,
        PRECISION: planes.precision,
        CROWD: planes.crowd(len(problem.part)),
        PLANE_ROBUST: robust,
    })  # fmt: skip


def subtree_arrays(
    memory: Allocator, problems: Sequence[Problem], trees: Sequence[Forest], chains: int
) -> Subtrees:
    """Put the subtrees of all structures on the device, at rest.

    Args:
        memory: Where arrays are allocated.
        problems: Measurements of each structure.
        trees: Subtrees of each.
        chains: Chains of each.
    """
    count = np.array([len(tree.parent) for tree in trees])
    own = np.concatenate([np.diff(tree.first) for tree in trees])
    end = np.cumsum(own)
    parent = np.concatenate(
        [t.parent + a for t, a in zip(trees, np.cumsum(count) - count, strict=True)]
    )
    last = end.copy()
    # Parents stand before what grows out of them: backward, each is whole when it is added.
    for subtree in range(len(own) - 1, -1, -1):
        last[parent[subtree]] = max(last[parent[subtree]], last[subtree])
    ordinal = np.concatenate([np.arange(n) for n in count])
    held = [_held(problem)[tree.order] for problem, tree in zip(problems, trees, strict=True)]
    before = np.pad(np.cumsum(np.concatenate(held), axis=0), ((1, 0), (0, 0)))
    # Everyone together does not move.
    moves = (before[last] == before[end - own]) & (ordinal > 0)[:, None]
    table = [end - own, end, last, parent, moves, ordinal]  # OWN to ORDINAL
    motion = np.zeros((chains, len(own), WEIGHT + 1))
    motion[:, :, WEIGHT] = np.concatenate([weights(tree) for tree in trees])
    return Subtrees(
        table=memory.upload(np.column_stack(table)),
        motion=memory.upload(motion.reshape(-1, WEIGHT + 1)),
    )


def _held(problem: Problem) -> Bools:
    """Find the axes along which coordinates of each robot stop its subtrees, shape (N, 3).

    Many robots that were measured would hold a subtree more stiffly than its mass allows. What
    holds a root is in the root's own mass: a part moves as one toward where its root was measured.
    """
    held = problem.planes.along(len(problem.part))
    held[problem.roots] = False
    return held


def swarm_arrays(memory: Allocator, arm: Reals, position: Reals, lightest: float) -> Copies:
    """Put all copies of all robots on the device, at rest.

    Args:
        memory: Where arrays are allocated.
        arm: Center to dock, in the order of memory, shape (N, docks, 3).
        position: Where the copies begin, shape (C N, 3).
        lightest: Mass of each.
    """
    upload, copies = memory.upload, len(position)
    motion, heading = np.zeros((copies, VELOCITY + 3)), np.zeros((copies, TOTAL + 1))
    motion[:, MASS] = lightest
    heading[:, COS] = 1.0
    heading[:, INERTIA] = lightest
    return Copies(
        arm=upload(np.tile(arm, (copies // len(arm), 1, 1))),
        position=upload(position),
        motion=upload(motion),
        heading=upload(heading),
        total=upload(np.zeros((copies, SQUARE + 1))),
    )


def block_arrays(memory: Allocator, start: Ints, trees: Sequence[Forest], chains: int) -> Blocks:
    """Put blocks that have taken no step on the device; `start` has the first copy of each."""
    blocks = len(start) - 1
    first = np.cumsum([0, *np.tile([len(tree.parent) for tree in trees], chains)])
    progress = np.zeros((blocks, IS_FAST + 1), np.int64)
    progress[:, TREE], progress[:, TREE_END], progress[:, AGE] = first[:-1], first[1:], STALE
    listed = np.zeros((start[-1], 4))
    listed[:, 3] = np.repeat(np.arange(blocks), np.diff(start))
    return Blocks(progress=memory.upload(progress), listed=memory.upload(listed.ravel()))


def _packed(columns: Mapping[int, NDArray[Any]]) -> NDArray[Any]:
    """Pack columns into a table, each where its name says; all have a row for each item."""
    parts = [np.atleast_2d(columns[first].T).T for first in sorted(columns)]
    widths = [part.shape[1] for part in parts]
    if sorted(columns) != [sum(widths[:k]) for k in range(len(widths))]:
        raise ValueError(f"columns {sorted(columns)} have {widths} numbers")
    return np.column_stack(parts)


def _in_memory(robot: Sequence[Ints], problems: Sequence[Problem], order: Ints) -> Ints:
    """Number robots, given structure by structure, as they stand in memory."""
    first = np.cumsum([0, *(len(p.part) for p in problems)])[:-1]
    number: Ints = np.argsort(order)[
        np.concatenate([own + a for own, a in zip(robot, first, strict=True)])
    ]
    return number


def _row_starts(robot: Ints, robots: int) -> Ints:
    """Find the first row of each robot in a sorted table, shape (N + 1,)."""
    starts: Ints = np.r_[0, np.bincount(robot, minlength=robots).cumsum()]
    return starts


def _upload(memory: Allocator, values: NDArray[Any], padding: float = 0.0) -> DeviceArray:
    """Copy an array to the device; a kernel takes no empty one."""
    width = [(0, 0 if len(values) else 1), *[(0, 0)] * (values.ndim - 1)]
    return memory.upload(np.pad(values, width, constant_values=padding))
