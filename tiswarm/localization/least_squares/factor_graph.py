"""The same residuals made small by GTSAM, whose factor graph knows who is tied to whom."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tiswarm.errors import EnvironmentTroubleError
from tiswarm.localization.least_squares.problem import Pairs, Places, Problem, Reals

if TYPE_CHECKING:
    import gtsam


SETTLED = 1e-8
"""An iteration that lowers the cost by less than this, or this part of it, is the last."""


class Found(NamedTuple):
    """What an optimiser came to, named as scipy does."""

    x: Reals
    cost: float
    """Half the sum of squares."""

    nfev: int
    """Iterations here, evaluations there."""

    status: int
    """0 if it was stopped before it had settled."""


def minimize(problem: Problem, unknowns: Reals, evaluations: int) -> Found:
    """Solve by the method of Levenberg and Marquardt, one factor a robot.

    Args:
        problem: Residuals and their derivatives.
        unknowns: Where to start from.
        evaluations: Iterations at most.

    Raises:
        EnvironmentTroubleError: gtsam is not installed.
    """
    try:
        import gtsam  # noqa: PLC0415 - an extra
    except ImportError as error:
        msg = "gtsam is not installed; pip install 'tiswarm[gtsam]', or set optimizer: scipy"
        raise EnvironmentTroubleError(msg) from error
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    blocks = _blocks(problem)
    for key, block in enumerate(blocks):
        values.insert(key, unknowns[block])
    last = [np.maximum(problem.pairs.i, problem.pairs.j), problem.places.j]
    for robot in np.unique(np.concatenate(last)):
        if robot > 0 or problem.yaw_sd:  # the anchor moves in no way but by a turn
            graph.push_back(_factor(problem, robot))
    if problem.yaw_sd:
        sure = gtsam.noiseModel.Isotropic.Sigma(1, problem.unit * problem.yaw_sd)
        for key in range(problem.robots - 1, len(blocks)):
            graph.push_back(gtsam.PriorFactorVector(key, np.zeros(1), sure))
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(evaluations)
    params.setRelativeErrorTol(SETTLED)
    params.setAbsoluteErrorTol(SETTLED)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, params)
    found, settled = optimizer.optimize(), optimizer.iterations() < evaluations
    x = np.concatenate([found.atVector(key) for key in range(len(blocks))])
    return Found(x, optimizer.error(), optimizer.iterations(), int(settled))


def _blocks(problem: Problem) -> list[slice]:
    """Unknowns of each key: places of all robots but the anchor, then turns of all, if any."""
    places = [slice(3 * k, 3 * k + 3) for k in range(problem.robots - 1)]
    turns = range(3 * problem.robots - 3, problem.shape[1])
    return places + [slice(k, k + 1) for k in turns]


def _factor(problem: Problem, robot: int) -> "gtsam.CustomFactor":
    """Gather the residuals of a robot with earlier ones and of its own place; there are some."""
    import gtsam  # noqa: PLC0415 - an extra

    of_pair = np.maximum(problem.pairs.i, problem.pairs.j) == robot
    pairs = Pairs(*(column[of_pair] for column in problem.pairs))
    places = Places(*(column[problem.places.j == robot] for column in problem.places))
    part, involved = problem.part(pairs, places)
    blocks, rows = _blocks(part), len(pairs.i) + len(places.j)
    keys = involved[1:] - 1
    if problem.yaw_sd:
        keys = np.concatenate([keys, problem.robots - 1 + involved])

    def error(
        this: "gtsam.CustomFactor", values: "gtsam.Values", slopes: list[Reals] | None
    ) -> Reals:
        unknowns = np.concatenate([values.atVector(key) for key in this.keys()])  # noqa: SIM118
        if slopes is not None:
            jacobian = part.jacobian(unknowns).toarray()[:rows]
            for n, block in enumerate(blocks):
                slopes[n] = jacobian[:, block]
        return part.residuals(unknowns)[:rows]

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), keys.tolist(), error)
