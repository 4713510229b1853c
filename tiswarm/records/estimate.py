"""What a localizer returns."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

HALF_WITHIN = 0.85
MOST_WITHIN = 1.6
"""Standard deviations within which half and nine tenths of the robots should be; fitted on training
structures, for distances are not normal: robots of an arm share their error."""


@dataclass(frozen=True, kw_only=True)
class Solution:
    """One of several ways to satisfy what was sensed, about as good as the others."""

    chains: int
    """How many of the method's chains ended there."""

    residual: float
    """Least residual of these, in the log's unit."""

    residual_sd: float
    """The same in standard deviations."""

    position: NDArray[np.float64]
    """Centers in the chain that has it, in the log's unit, shape (N, 3)."""


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """Whether a method that anneals several chains found an estimate that fits what was sensed."""

    converged: bool
    """Whether the best chain misses its measurements by no more than chance allows."""

    misfit_sd: float
    """How far the chi-square of the best chain's measurements exceeds their count, in standard
    deviations of a chi-square; contacts judged wrong do not count."""

    chains: int
    """Chains that the estimate is made of."""

    restarted: int
    """Annealings that were repeated with smaller steps, because a robot was farther away than its
    contacts reach or the chain's temperature ran away."""


@dataclass(frozen=True, kw_only=True)
class Observability:
    """What some cues can tell of N robots."""

    cues: tuple[str, ...]
    turning: bool
    """Whether each robot's yaw is unknown."""

    unknowns: int
    """What there is to be known: coordinates of all robots but the anchor, and where yaw is unknown
    how far each robot is turned, seen from the mean of all."""

    swing: float | None
    """Where yaw is unknown and nothing but the mean of all compasses holds the swarm as a whole
    against turning about the anchor, the standard deviation of that [rad]; else None."""

    floppy_modes: int | None
    """Independent motions of the swarm that nothing sensed would notice, or None where there are
    too many robots to count them."""

    loose: NDArray[np.bool_] | None
    """Whether such motions shift each robot, shape (N,), or None likewise."""

    apart: NDArray[np.bool_]
    """Whether nothing but a height ties each robot to the anchor, shape (N,)."""

    @property
    def known(self) -> list[str]:
        """Say of each robot whether its place can be known: "yes", "loose" or "apart".

        Nothing is said where there are too many robots to find out.
        """
        tied = "" if self.loose is None else np.where(self.loose, "loose", "yes")
        words = np.where(self.apart, "apart", tied)
        return [str(word) for word in words]


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Estimated positions of N robots, in join order, and how they were reached."""

    robot_id: NDArray[np.int64]
    """Name of each robot, shape (N,)."""

    position: NDArray[np.float64]
    """Estimated centers, in the log's unit, shape (N, 3)."""

    located: NDArray[np.bool_]
    """Whether a chain of contacts ties the robot to the anchor, shape (N,)."""

    sd: NDArray[np.float64] | None = None
    """Standard deviation of each position where the method knows it, shape (N,); half of the robots
    should be within `HALF_WITHIN` of it, nine of ten within `MOST_WITHIN`."""

    yaw: NDArray[np.float64] | None = None
    """Turn about the vertical to be added to each sensed orientation [rad], shape (N,); None where
    the method takes them as they are."""

    convergence: Convergence | None = None
    """Whether the estimate fits what was sensed; None where the method does not judge it."""

    doubted: NDArray[np.int64] | None = None
    """Contacts judged wrong, rows as `felt_contacts` has them, shape (K, 5); None where the method
    does not judge them, or did not converge."""

    solutions: tuple[Solution, ...] = ()
    """Distinct solutions that the method found, of less residual before those of more; `position`
    is the mean over all of their chains, or follows from it. Empty where the method looks for one
    only."""

    observability: Observability | None = None
    """What the cues in use cannot tell; filled in after the method has run."""

    iteration: NDArray[np.int64]
    """Iterations at which the trace was recorded, ascending, shape (K,)."""

    trace: NDArray[np.float64]
    """Estimated centers at those iterations, shape (K, N, 3)."""

    residual_sd: float | None = None
    """Residual of the estimate in standard deviations, root mean square over the contacts; None
    where the method has none."""

    residual: NDArray[np.float64]
    """What the method drives to zero, at those iterations, shape (K,).

    For virtual-force: root mean square step of the robots [log unit per iteration]. For joint and
    least-squares: root mean square by which docks in contact are not D apart [log unit].
    """

    @property
    def robot_count(self) -> int:
        """N."""
        return len(self.robot_id)
