"""The cost of robots as a function of motions; some motions move several robots as one."""

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.normal_equations import damped, solved
from tiswarm.localization.cost.cost import Cost, State
from tiswarm.localization.online.neighborhood import NearCost, NearLinear
from tiswarm.localization.online.settings import CANDIDATES, NEIGHBORS
from tiswarm.measurements.equations import AXES

_SETTLED = 1e-9
"""Step below which a share of it makes no difference [R]."""


class MotionCost(Cost[NearLinear]):
    """The cost of robots near one as a function of some motions, which move several as one."""

    most_rounds = CANDIDATES.rounds
    widest = NEIGHBORS.radius
    least_reduction = NEIGHBORS.settled

    def __init__(self, problem: NearCost, basis: Reals) -> None:
        """Take the cost of N robots that may all move, and motions, shape (6 N, n)."""
        self._problem, self._basis = problem, basis

    def linearized(self, state: State) -> NearLinear:
        """Linearize the cost at a state."""
        return self._problem.linearized(state)

    def moved(self, state: State, linear: NearLinear, radius: float) -> tuple[State, float]:
        """Step along the motions."""
        basis = self._basis
        information = damped(basis.T @ linear.information @ basis, radius**-2.0)
        step = basis @ solved(information, -basis.T @ linear.slope)
        step = step.reshape(2, -1, AXES)
        share = min(1.0, NEIGHBORS.longest_step / max(np.abs(step[0]).max(), _SETTLED))
        stepped = State(state.position + share * step[0], state.turn + share * step[1])
        return stepped, float(-share * linear.slope @ step.ravel())


def motions(free: Ints, root: Ints) -> Reals:
    """Lay out shifts and turns of robots that are free, and shifts of branches, a column each.

    Args:
        free: Robots that move by themselves, shape (K,).
        root: The robot whose branch each one is in, -1 if it is in none, shape (N,).

    Returns:
        Motions of n columns, shape (6 N, n): all shifts, then all turns.
    """
    robots = len(root)
    firsts = np.unique(root[root >= 0])
    single = np.zeros((2, robots, AXES, 2, len(free), AXES))
    for part in range(2):
        for axis in range(AXES):
            single[part, free, axis, part, np.arange(len(free)), axis] = 1.0
    together = np.zeros((2, robots, AXES, len(firsts), AXES))
    for axis in range(AXES):
        together[0, :, axis, :, axis] = root[:, None] == firsts
    rows = 2 * robots * AXES
    return np.hstack([single.reshape(rows, -1), together.reshape(rows, -1)])
