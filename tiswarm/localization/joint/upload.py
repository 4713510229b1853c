"""Arrays of the annealer's kernels, filled from problems: the bundles of `arrays`. Lengths in R.

Robots of a subtree stand in a row in memory. `order` is that order, of the robots of all structures
end to end, shape (N,).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.backend import Allocator
from tiswarm.compute.lang import DeviceArray
from tiswarm.localization.cost.settings import ROBUST_SD
from tiswarm.localization.joint.arrays import (
    ACROSS,
    AGE,
    ARMS,
    CONTACT,
    CONTACT_END,
    COS,
    CROWD,
    DIRECTION,
    EXTENSION,
    INERTIA,
    IS_FAST,
    IS_FINAL,
    IS_OWN,
    LENGTH,
    LEVERS,
    LIGHTEST,
    MASS,
    NON_OVERLAP,
    NUMBER,
    PARTNER,
    PLANE,
    PLANE_END,
    PLANE_ROBUST,
    POINT,
    PRECISION,
    ROBUST,
    SQUARE,
    STALE,
    STRUCTURE,
    SUBTREE,
    TOTAL,
    TOUCH,
    TREE,
    TREE_END,
    VARIANCE,
    VECTOR,
    VELOCITY,
    WALK,
    YAW_PRECISION,
    Blocks,
    Contacts,
    Copies,
    MeasuredColumns,
    Robots,
    Traits,
)
from tiswarm.localization.joint.problem import Problem
from tiswarm.localization.joint.subtrees import Forest
from tiswarm.localization.params import JointParams
from tiswarm.measurements.model import KNOWN


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
