"""The swarm step: every robot at once, moved by what its docks feel.

    F_i = sum over connected docks of Eq. (1)
        + sum over other docks of other robots nearer than D of Eq. (2)
        + k_z (h_i - z_i) along z, Eq. (3)
    p_i <- p_i + F_i, no farther than the largest step

Equations as in `tiswarm.engine.force_kernels`. Lengths in the unit of the robot's spacing D.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiswarm.compute import backend
from tiswarm.engine.prepared import PreparedSwarm, RelaxResult
from tiswarm.engine.swarm import Swarm
from tiswarm.params import Arch, Precision
from tiswarm.robot import Robot

__all__ = ["PreparedSwarm", "RelaxResult", "prepare", "relax"]


def relax(
    position: ArrayLike,
    orientation_wxyz: ArrayLike,
    contacts: ArrayLike,
    *,
    robot: Robot,
    attraction_gain: float,
    repulsion_gain: float,
    ramp: float | Sequence[float] | NDArray[np.float64],
    steps: int,
    height: ArrayLike | None = None,
    height_gain: float = 0.0,
    max_step: float | None = None,
    structure: ArrayLike | None = None,
    precision: Precision = "f64",
    arch: Arch = "cpu",
    threads: int | None = None,
) -> RelaxResult:
    """Take steps of the whole swarm under Eqs. (1)-(3), all robots at once.

    The bytes of the result depend on the arguments alone, not on threads.

    Args:
        position: Centers, shape (N, 3).
        orientation_wxyz: Body to world, unit quaternions, kept throughout, shape (N, 4).
        contacts: Connected docks, rows of (robot i, dock, robot j, dock), shape (C, 4).
        robot: Where docks are on a robot, and D; its unit of length is that of all lengths here.
        attraction_gain: A of Eq. (1) [1].
        repulsion_gain: B of Eqs. (1) and (2) [length^-3].
        ramp: alpha, the share of attraction, 0 to 1: one number, or one a step.
        steps: T.
        height: Height that each robot is pulled toward, NaN for none, shape (N,).
        height_gain: k_z of Eq. (3) [1].
        max_step: A robot moves no farther than this in a step; None for no limit.
        structure: Number of each robot's structure, shape (N,); robots of different structures
            never feel each other. None for one structure.
        precision: f32 halves the memory and loses what is far from the origin.
        arch: Device; it computes there or an error is raised.
        threads: CPU threads; all that this process may use if None.

    Raises:
        InputError: where an argument makes no sense, or forces diverge.
        EnvironmentTroubleError: where the machine lacks the device or the memory.
    """
    return prepare(
        position, orientation_wxyz, contacts, robot=robot, height=height, structure=structure,
        precision=precision, arch=arch, threads=threads,
    ).relax(
        attraction_gain=attraction_gain, repulsion_gain=repulsion_gain, ramp=ramp, steps=steps,
        height_gain=height_gain, max_step=max_step,
    )  # fmt: skip


def prepare(
    position: ArrayLike,
    orientation_wxyz: ArrayLike,
    contacts: ArrayLike,
    *,
    robot: Robot,
    height: ArrayLike | None = None,
    structure: ArrayLike | None = None,
    precision: Precision = "f64",
    arch: Arch = "cpu",
    threads: int | None = None,
) -> PreparedSwarm:
    """Put a swarm on the device, to be relaxed again and again, as when gains are fitted.

    Args: as `relax` has them, and so are the errors.
    """
    swarm = Swarm.checked(
        position, orientation_wxyz, contacts, robot=robot, height=height, structure=structure
    )
    running = backend.start(arch, threads=threads, precision=precision)
    swarm.check_resolution(running)
    return PreparedSwarm(running, swarm)
