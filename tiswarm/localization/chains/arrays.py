"""Arrays of the annealer's kernels, in bundles that the host allocates and kernels hand on.

The swarm is C copies, one a chain, of N robots: those of all structures, end to end. Copies of one
structure in one chain are a block; there are B blocks. All structures together have T subtrees.
Copy r of robot i in chain c is number c N + i. Lengths in R.

Robots of a subtree stand in a row in memory. `order` is that order, of the robots of all structures
end to end, shape (N,).
"""

from collections.abc import Sequence
from enum import Flag, auto
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.backend import Allocator
from tiswarm.compute.lang import Columns, DeviceArray, Ints2, Longs2, Reals1, Reals2, Reals3
from tiswarm.localization.chains.problem import Planes
from tiswarm.localization.chains.views import ChainView, Links, weights


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
    """What functions of kernels are compiled for; they ask in `ti.static`."""

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


class RobotLabel(Columns):
    """Columns of `Robots.label`."""

    STRUCTURE = 1
    """Structure that the robot is of."""
    NUMBER = 1
    """Join number within it."""
    MOVES = 1
    """Whether the robot moves; anchors do not."""
    NON_OVERLAP = 1
    """Whether docks that do not touch repel; those of a robot that has left never do."""
    SUBTREE = 1
    """Subtree that the robot belongs to."""
    CONTACT = 1
    """First entry of its contacts."""
    CONTACT_END = 1
    """The one after their last."""
    PLANE = 1
    """First of its planes."""
    PLANE_END = 1
    """The one after the last."""


class RobotWeight(Columns):
    """Columns of `Robots.weight`."""

    ROBUST = 1
    """One over the squared width of the robust loss of links, 0 for none [1]."""
    YAW_PRECISION = 1
    """Precision of the sensed yaw, 0 where robots do not turn [rad^-2]."""
    LIGHTEST = 1
    """Factor of every mass; 4 halves the steps [1]."""


class Robots(NamedTuple):
    """Constants of each robot."""

    label: Ints2
    """Columns of `RobotLabel`, shape (N, 9)."""

    weight: Reals2
    """Columns of `RobotWeight`, shape (N, 3)."""


class LinkLabel(Columns):
    """Columns of `Contacts.label`."""

    PARTNER = 1
    """Robot on the other side."""
    IS_FINAL = 1
    """Whether the robots touch at their final stances."""
    IS_OWN = 1
    """Whether the robot measured the offset, not its partner."""
    TOUCH = 1
    """Row of a touch in `candidates`, -1 of other entries."""


class LinkValue(Columns):
    """Columns of `Contacts.value`, as `Links` has them; of its other robot, signs are opposite.

    The last two are there only where robots turn or there are offsets.
    """

    ARMS = 3
    LENGTH = 1
    VARIANCE = 1
    ACROSS = 1
    EXTENSION = 1
    LEVERS = 4
    VECTOR = 3


class Contacts(NamedTuple):
    """Contacts and ranges, robot by robot; every one stands at both its robots, K entries in all.

    An offset is a contact whose direction is measured; of a touch the docks are unknown.
    """

    label: Ints2
    """Columns of `LinkLabel`, shape (K, 4)."""

    value: Reals2
    """Columns of `LinkValue`, shape (K, 14) or (K, 7)."""

    candidates: Reals3
    """Arms of the docks that may be those of each touch, as sensed: the robot's and the partner's
    [R], shape (H, docks, 6)."""


class PlaneValue(Columns):
    """Columns of `MeasuredColumns.plane`, as `Planes` has them, and two more."""

    POINT = 3
    DIRECTION = 3
    WALK = 2
    PRECISION = 1
    CROWD = 1
    """1 where other planes of the robot are perpendicular to it, 3 elsewhere."""
    ROBUST = 1
    """One over the squared width of the robust loss, 0 for none [1]."""


class MeasuredColumns(NamedTuple):
    """All that is known of robots."""

    robots: Robots
    """Constants of each."""

    contacts: Contacts
    """Their contacts and ranges."""

    plane: Reals2
    """Planes on which robots were measured to be, robot by robot: columns of `PlaneValue`, shape
    (P, 11)."""


class SubtreeLabel(Columns):
    """Columns of `Subtrees.table`."""

    OWN = 1
    """First own robot."""
    OWN_END = 1
    """The one after the last of these."""
    END = 1
    """The one after the last that moves with it."""
    PARENT = 1
    """Subtree that it grows out of."""
    MOVES = 3
    """Whether it moves along x, y and z."""
    ORDINAL = 1
    """Its number within the structure."""


class BodyMotion(Columns):
    """Columns of the motion of a robot, and the first ones of that of a subtree."""

    FORCE = 3
    """Force of this step."""
    MASS = 1
    """Mass."""
    VELOCITY = 3
    """Velocity."""


class SubtreeMotion(BodyMotion):
    """Columns of `Subtrees.motion`; the first ones are of all that moves with the subtree."""

    SHIFT = 3
    """Shift in this step, its ancestors' included [R]."""
    OWN_SHIFT = 3
    """Shift in this step without its ancestors', written on graphics cards [R]."""
    WEIGHT = 1
    """Mass, in masses of its own robots."""


class Subtrees(NamedTuple):
    """Subtrees of the contact graph, which move as one."""

    table: Ints2
    """Columns of `SubtreeLabel`, shape (T, 8)."""

    motion: Reals2
    """Columns of `SubtreeMotion` of each copy, shape (C T, 14)."""


class Heading(Columns):
    """Columns of `Copies.heading`: how far robots are turned, and how they turn."""

    COS = 1
    """Cosine of the turn so far."""
    SIN = 1
    """Its sine."""
    YAW = 1
    """Its angle [rad]."""
    SPIN = 1
    """Velocity of the turn."""
    TORQUE = 1
    """Its force."""
    INERTIA = 1
    """Its mass."""
    SUM = 1
    """Sum of the angles that are averaged [rad]."""


class OverlapSums(Columns):
    """Columns of `Copies.overlap`: sums over the docks that are too near to those of a copy.

    All but the number are in parts of one.
    """

    FORCE = 3
    """Force."""
    TORQUE = 1
    """Its torque about the vertical."""
    INERTIA = 1
    """Squared horizontal arms of the robot's docks."""
    COUNT = 1
    """Number of pairs of docks."""


class Moments(Columns):
    """Columns of `Copies.total`: sums over the steps that are averaged."""

    POSITION = 3
    """Positions [R]."""
    SQUARE = 1
    """Their squares, all axes together [R^2]."""


class Copies(NamedTuple):
    """State of every copy of a robot."""

    arm: Reals3
    """Center to dock, world frame [R], shape (C N, docks, 3)."""

    position: Reals2
    """Centers [R], shape (C N, 3)."""

    motion: Reals2
    """Columns of `BodyMotion`, shape (C N, 7)."""

    heading: Reals2
    """Columns of `Heading`, shape (C N, 7)."""

    total: Reals2
    """Columns of `Moments`, shape (C N, 4)."""

    overlap: Longs2
    """Columns of `OverlapSums`, shape (C N, 6)."""


class BlockProgress(Columns):
    """Columns of `Blocks.progress`."""

    TREE = 1
    """First copy of a subtree."""
    TREE_END = 1
    """The one after the last."""
    HOLD = 1
    """First step that counts for the averages."""
    TAKEN = 1
    """Steps taken so far."""
    AGE = 1
    """Steps that the rows have served, or `STALE`."""
    IS_THIN = 1
    """Whether the rows that are built next have the thin skin."""
    HAS_STRAYED = 1
    """Whether a robot is beyond half the skin in this step; on graphics cards, first block only."""
    IS_FAST = 1
    """Whether a robot is beyond a quarter of the thick skin; the same."""


class Blocks(NamedTuple):
    """Progress of each block, and its Verlet rows."""

    progress: Ints2
    """Columns of `BlockProgress`, shape (B, 8)."""

    listed: Reals1
    """Where robots were as rows were built, and last their block [R], rows of four."""


STALE = -1
"""Age of rows that have to be built anew."""


def traits_of(views: Sequence[ChainView], *, by_block: bool) -> Traits:
    """Find what kernels are to be compiled for, in views that are annealed side by side."""
    traits = Traits.BY_BLOCK if by_block else Traits(0)
    if any(v.yaw_precision for v in views):
        traits |= Traits.TURNING
    if any(v.links.is_offset.any() for v in views):
        traits |= Traits.OFFSETS
    if any(v.links.is_touch.any() for v in views):
        traits |= Traits.TOUCHES
    if any(v.repels.any() and not v.repels.all() for v in views):
        traits |= Traits.GONE
    return traits


def measured_arrays(
    memory: Allocator, views: Sequence[ChainView], order: Ints, lightest: float
) -> MeasuredColumns:
    """Put all that is known of robots on the device.

    Args:
        memory: Where arrays are allocated.
        views: Robots and measurements of each structure.
        order: Robots of all structures in the order of memory, shape (N,).
        lightest: Factor of every mass.
    """
    size = [len(v.moves) for v in views]
    subtree_robots = np.concatenate([np.diff(v.forest.first) for v in views])
    contact, contacts = _contact_arrays(memory, views, order)
    robot = _in_memory([v.planes.robot for v in views], size, order)
    planes = Planes(*map(np.concatenate, zip(*(v.planes for v in views), strict=True)))
    table = PlaneValue.pack(
        POINT=planes.point, DIRECTION=planes.direction, WALK=planes.walk,
        PRECISION=planes.precision,
        CROWD=np.concatenate([v.planes.crowd(n) for v, n in zip(views, size, strict=True)]),
        ROBUST=np.concatenate([v.plane_robust for v in views]),
    )[np.argsort(robot, kind="stable")]  # fmt: skip
    plane = _row_starts(robot, len(order))
    label = RobotLabel.pack(
        STRUCTURE=np.repeat(np.arange(len(size)), size),
        NUMBER=np.concatenate([np.arange(robots) for robots in size])[order],
        MOVES=np.concatenate([v.moves for v in views])[order],
        NON_OVERLAP=np.concatenate([v.repels for v in views])[order],
        SUBTREE=np.repeat(np.arange(len(subtree_robots)), subtree_robots),
        CONTACT=contact[:-1],
        CONTACT_END=contact[1:],
        PLANE=plane[:-1],
        PLANE_END=plane[1:],
    )
    weight = RobotWeight.pack(
        ROBUST=np.repeat([v.robust for v in views], size),
        YAW_PRECISION=np.repeat([v.yaw_precision for v in views], size),
        LIGHTEST=np.full(len(order), lightest),
    )
    robots = Robots(label=memory.upload(label), weight=memory.upload(weight))
    return MeasuredColumns(robots=robots, contacts=contacts, plane=_upload(memory, table))


def _contact_arrays(
    memory: Allocator, views: Sequence[ChainView], order: Ints
) -> tuple[Ints, Contacts]:
    """Put the links of all structures on the device, each at both its robots.

    Returns:
        First entry of each robot, shape (N + 1,), and the contacts.
    """
    size = [len(v.moves) for v in views]
    robot = _in_memory([v.links.robot for v in views], size, order)
    partner = _in_memory([v.links.neighbor for v in views], size, order)
    links = Links(*map(np.concatenate, zip(*(v.links for v in views), strict=True)))
    touch = np.full((2, len(robot)), -1)
    touch[:, links.is_touch] = np.arange(2 * len(links.candidates)).reshape(2, -1)
    is_own = np.ones_like(robot)
    label = {"PARTNER": partner, "IS_FINAL": links.is_final, "IS_OWN": is_own, "TOUCH": touch[0]}
    value = {
        "ARMS": links.arms,
        "LENGTH": links.length,
        "VARIANCE": links.variance,
        "ACROSS": links.across,
        "EXTENSION": links.extension,
    }
    partner_value = {"ARMS": -links.arms}
    if links.is_offset.any() or any(v.yaw_precision for v in views):
        value |= {"LEVERS": links.levers, "VECTOR": links.vector}
        partner_value |= {"LEVERS": links.levers[:, [2, 3, 0, 1]], "VECTOR": -links.vector}
    # Each contact once more, as its partner has it.
    partner_label = label | {"PARTNER": robot, "IS_OWN": np.zeros_like(robot), "TOUCH": touch[1]}
    both = np.concatenate([robot, partner])
    # Stable: each robot sums its contacts in the order of the log, in any company.
    by_robot = np.argsort(both, kind="stable")
    labels = np.concatenate([LinkLabel.pack(**columns) for columns in (label, partner_label)])[
        by_robot
    ]
    values = np.concatenate(
        [LinkValue.pack(**columns) for columns in (value, value | partner_value)]
    )[by_robot]
    arms = links.candidates
    return _row_starts(both, len(order)), Contacts(
        label=_upload(memory, labels),
        value=_upload(memory, values, padding=1.0),
        candidates=_upload(memory, np.concatenate([arms, np.roll(arms, 3, axis=2)])),
    )


def subtree_arrays(memory: Allocator, views: Sequence[ChainView], chains: int) -> Subtrees:
    """Put the subtrees of all structures on the device, at rest.

    Args:
        memory: Where arrays are allocated.
        views: Robots and measurements of each structure.
        chains: Chains of each.
    """
    trees = [v.forest for v in views]
    count = np.array([len(tree.parent) for tree in trees])
    own_count = np.concatenate([np.diff(tree.first) for tree in trees])
    end = np.cumsum(own_count)
    parent = np.concatenate(
        [t.parent + a for t, a in zip(trees, np.cumsum(count) - count, strict=True)]
    )
    last = end.copy()
    # Parents stand before what grows out of them: backward, each is whole when it is added.
    for subtree in range(len(own_count) - 1, -1, -1):
        last[parent[subtree]] = max(last[parent[subtree]], last[subtree])
    ordinal = np.concatenate([np.arange(n) for n in count])
    stops = np.concatenate([v.stops[v.forest.order] for v in views])
    before = np.pad(np.cumsum(stops, axis=0), ((1, 0), (0, 0)))
    # Everyone together does not move.
    moves = (before[last] == before[end - own_count]) & (ordinal > 0)[:, None]
    table = SubtreeLabel.pack(
        OWN=end - own_count, OWN_END=end, END=last, PARENT=parent, MOVES=moves, ORDINAL=ordinal
    )
    motion = np.zeros((chains, len(own_count), SubtreeMotion.TOTAL))
    motion[:, :, SubtreeMotion.WEIGHT] = np.concatenate([weights(tree) for tree in trees])
    return Subtrees(
        table=memory.upload(table),
        motion=memory.upload(motion.reshape(-1, SubtreeMotion.TOTAL)),
    )


def swarm_arrays(memory: Allocator, arm: Reals, position: Reals, lightest: float) -> Copies:
    """Put all copies of all robots on the device, at rest.

    Args:
        memory: Where arrays are allocated.
        arm: Center to dock, in the order of memory, shape (N, docks, 3).
        position: Where the copies begin, shape (C N, 3).
        lightest: Mass of each.
    """
    upload = memory.upload
    copies = len(position)
    motion = np.zeros((copies, BodyMotion.TOTAL))
    heading = np.zeros((copies, Heading.TOTAL))
    motion[:, BodyMotion.MASS] = lightest
    heading[:, Heading.COS] = 1.0
    heading[:, Heading.INERTIA] = lightest
    return Copies(
        arm=upload(np.tile(arm, (copies // len(arm), 1, 1))),
        position=upload(position),
        motion=upload(motion),
        heading=upload(heading),
        total=upload(np.zeros((copies, Moments.TOTAL))),
        overlap=memory.longs(copies, OverlapSums.TOTAL),
    )


def block_arrays(
    memory: Allocator, start: Ints, views: Sequence[ChainView], chains: int, hold: int
) -> Blocks:
    """Put blocks that have taken no step on the device; `start` has the first copy of each."""
    blocks = len(start) - 1
    first = np.cumsum([0, *np.tile([len(v.forest.parent) for v in views], chains)])
    none = np.zeros(blocks, np.int64)
    progress = BlockProgress.pack(
        TREE=first[:-1], TREE_END=first[1:], HOLD=none + hold, TAKEN=none, AGE=none + STALE,
        IS_THIN=none, HAS_STRAYED=none, IS_FAST=none,
    )  # fmt: skip
    listed = np.zeros((start[-1], 4))
    listed[:, 3] = np.repeat(np.arange(blocks), np.diff(start))
    return Blocks(progress=memory.upload(progress), listed=memory.upload(listed.ravel()))


def _in_memory(robot: Sequence[Ints], size: Sequence[int], order: Ints) -> Ints:
    """Number robots, given structure by structure, as they stand in memory."""
    first = np.cumsum([0, *size])[:-1]
    number: Ints = np.argsort(order)[
        np.concatenate([of_structure + a for of_structure, a in zip(robot, first, strict=True)])
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
