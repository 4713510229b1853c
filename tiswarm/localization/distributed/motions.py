"""The cost of robots as a function of motions; some motions move several robots as one."""

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.localization.cost.cost import Cost, State
from tiswarm.localization.online.neighborhood import NearCost, NearLinear
from tiswarm.localization.online.settings import CANDIDATES, NEIGHBORS

_AXES = 3
_SETTLED = 1e-9
"""Step below which a share of it makes no difference [R]."""


class MotionCost(Cost[NearLinear]):
    """The cost of robots near one as a function of some motions, which move several as one."""

    most_rounds, widest, promised = CANDIDATES.rounds, NEIGHBORS.radius, NEIGHBORS.settled

    def __init__(self, problem: NearCost, basis: Reals) -> None:
        """Take the cost of N robots that may all move, and motions, shape (6 N, n)."""
        self._problem, self._basis = problem, basis

    def linearized(self, state: State) -> NearLinear:
        """Linearize the cost at a state."""
        return self._problem.linearized(state)

    def moved(self, state: State, linear: NearLinear, radius: float) -> tuple[State, float]:
        """Step along the motions."""
        basis = self._basis
        information = basis.T @ linear.information @ basis
        information[np.diag_indices(len(information))] += radius**-2.0
        step = basis @ np.linalg.solve(information, -basis.T @ linear.slope)
        step = step.reshape(2, -1, _AXES)
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
    single = np.zeros((2, robots, _AXES, 2, len(free), _AXES))
    for part in range(2):
        for axis in range(_AXES):
            single[part, free, axis, part, np.arange(len(free)), axis] = 1.0
    together = np.zeros((2, robots, _AXES, len(firsts), _AXES))
    for axis in range(_AXES):
        together[0, :, axis, :, axis] = root[:, None] == firsts
    rows = 2 * robots * _AXES
    return np.hstack([single.reshape(rows, -1), together.reshape(rows, -1)])
