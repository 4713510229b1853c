"""Arrays of the annealer's kernels, filled from problems: the bundles of `arrays`. Lengths in R.

Robots of a subtree stand in a row in memory. `order` is that order, of the robots of all structures
end to end, shape (N,).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiswarm.aliases import Ints, Reals
from tiswarm.compute.backend import Allocator
from tiswarm.compute.lang import DeviceArray
from tiswarm.localization.joint.arrays import Blocks, Contacts, Priors, Robots, Swarm
from tiswarm.localization.joint.force_kernels import INERTIA
from tiswarm.localization.joint.kernels import SKIN, STALE
from tiswarm.localization.joint.problem import Problem
from tiswarm.localization.joint.settings import AnnealSchedule
from tiswarm.localization.params import JointParams

_AS_SENSED = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""A row of the kernel's headings to begin with."""


def robot_arrays(
    memory: Allocator, problems: Sequence[Problem], params: Sequence[JointParams], order: Ints
) -> Robots:
    """Put the constants of all robots on the device."""
    size = [len(p.part) for p in problems]
    number = np.concatenate([np.arange(robots) for robots in size])[order]
    non_overlap = np.repeat([int(p.non_overlap) for p in params], size)
    robust = [AnnealSchedule.outlier_sd**-2 * p.robust for p in params]
    weight = np.column_stack([robust, [p.yaw_precision for p in problems]])
    return Robots(
        label=memory.upload(
            np.column_stack([np.repeat(np.arange(len(size)), size), number, non_overlap])
        ),
        weight=memory.upload(np.repeat(weight, size, axis=0)),
    )


def contact_arrays(
    memory: Allocator, problems: Sequence[Problem], params: Sequence[JointParams], order: Ints
) -> Contacts:
    """Put the contacts of all structures on the device, each at both its robots."""
    robot = _in_memory([e.robot for e in problems], problems, order)
    other = _in_memory([e.other for e in problems], problems, order)
    is_final = np.concatenate([e.is_final for e in problems]).astype(np.int64)
    is_offset = np.concatenate([e.is_offset for e in problems])
    extension = np.concatenate(
        [p.extension_prior * e.is_final / e.fewest for e, p in zip(problems, params, strict=True)]
    )
    extension[is_offset] = 0.0  # their direction is measured
    vector = np.concatenate([e.vector for e in problems])
    shift = np.concatenate([e.shift for e in problems]) - vector
    lever = np.concatenate([e.lever for e in problems])
    lever[:, :2] -= vector[:, :2]
    length = np.concatenate([e.length for e in problems])
    variance = np.concatenate([e.variance[e.link] for e in problems])
    total = np.concatenate([e.by_link(e.variance) for e in problems])
    across = np.where(is_offset, 0.5 * (total - variance), 0.0)
    is_touch = np.concatenate([e.is_touch for e in problems])
    arms = np.concatenate([np.dstack([arm for arm, _ in e.rows.touch_arms]) for e in problems])
    touch = np.full((2, len(robot)), -1)
    touch[:, is_touch] = np.arange(2 * len(arms)).reshape(2, -1)
    own, its = np.ones_like(robot), np.zeros_like(robot)
    value = np.column_stack([length, variance, across, extension])
    label = [
        np.column_stack([other, is_final, own, touch[0]]),
        np.column_stack([robot, is_final, its, touch[1]]),
    ]
    both = np.concatenate([robot, other])
    by_robot = np.argsort(both, kind="stable")
    return Contacts(
        start=memory.upload(_row_starts(both, len(order))),
        label=_upload(memory, np.concatenate(label)[by_robot]),
        value=_upload(
            memory,
            np.concatenate([np.c_[shift, value], np.c_[-shift, value]])[by_robot],
            padding=1.0,
        ),
        level=_upload(
            memory,
            np.concatenate([np.c_[lever, vector], np.c_[lever[:, [2, 3, 0, 1]], -vector]])[
                by_robot
            ],
        ),
        has_offsets=bool(is_offset.any()),
        candidates=_upload(memory, np.concatenate([arms, np.roll(arms, 3, axis=2)])),
        has_touches=bool(len(arms)),
    )


def prior_arrays(
    memory: Allocator, problems: Sequence[Problem], params: Sequence[JointParams], order: Ints
) -> Priors:
    """Put the planes of all structures on the device, robot by robot."""
    robot = _in_memory([e.planes.robot for e in problems], problems, order)
    table = np.concatenate([_planes_of(*each) for each in zip(problems, params, strict=True)])
    return Priors(
        start=memory.upload(_row_starts(robot, len(order))),
        plane=_upload(memory, table[np.argsort(robot, kind="stable")]),
    )


def _planes_of(problem: Problem, params: JointParams) -> Reals:
    """Gather the columns of `Priors.plane` of one structure, shape (P, 11)."""
    planes = problem.planes
    crowd = planes.crowd(len(problem.part))
    robust = AnnealSchedule.outlier_sd**-2 * params.robust * planes.is_redundant(problem.part)
    columns = [planes.point, planes.direction, planes.walk, planes.precision, crowd, robust]
    return np.column_stack(columns)


def swarm_arrays(memory: Allocator, arm: Reals, position: Reals, inertia_factor: float) -> Swarm:
    """Put all copies of all robots on the device, at rest.

    Args:
        memory: Where arrays are allocated.
        arm: Center to dock, in the order of memory, shape (N, docks, 3).
        position: Where the copies begin, shape (C N, 3).
        inertia_factor: Mass of each.
    """
    upload, copies = memory.upload, len(position)
    heading = np.tile(_AS_SENSED, (copies, 1))
    heading[:, INERTIA] = inertia_factor
    return Swarm(
        arm=upload(np.tile(arm, (copies // len(arm), 1, 1))),
        position=upload(position),
        velocity=upload(np.zeros((copies, 3))),
        force=upload(np.zeros((copies, 3))),
        mass=upload(np.full(copies, inertia_factor)),
        heading=upload(heading),
        total=upload(np.zeros((copies, 3))),
        square_total=upload(np.zeros(copies)),
    )


def block_arrays(memory: Allocator, start: Ints) -> Blocks:
    """Put blocks that have taken no step on the device; `start` has the first copy of each."""
    upload, blocks = memory.upload, len(start) - 1
    listed = np.zeros((start[-1], 4))
    listed[:, 3] = np.repeat(np.arange(blocks), np.diff(start))
    return Blocks(
        start=upload(start),
        taken=upload(np.zeros(blocks, np.int64)),
        age=upload(np.full(blocks, STALE)),
        skin=upload(np.full(blocks, SKIN)),
        listed=upload(listed.ravel()),
        strayed=upload(np.zeros(2, np.int64)),
    )


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
