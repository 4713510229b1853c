"""Solvers of other libraries as methods of the benchmark, on the rows that `least-squares` has.

All start where `hop-by-hop` ends. Importing this module registers them.
"""

import gtsam
import numpy as np
from scipy.optimize import least_squares

import tiswarm
from benchmarks.least_squares.factor_graph import by_robot, levenberg_marquardt, minimum
from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.localization.chains.problem import Problem, pose_problem
from tiswarm.localization.peers.hop_by_hop import place
from tiswarm.localization.peers.settings import LeastSquaresParams
from tiswarm.localization.settings import Cues
from tiswarm.records.sensing_log import SensingLog

PARAMS = LeastSquaresParams(robust=False, cues=Cues(non_overlap=False, touches=False))
FARTHEST = 1e6
"""Coordinate beyond which a solver has failed [R]."""


@tiswarm.method("scipy", cues=PARAMS.used_cues)
def scipy_trust_region(log: SensingLog) -> Reals:
    """Minimize a robust cost by SciPy's trust-region method: `soft_l1` of residuals in sd."""
    problem, start, yaw = _posed(log)
    rows, robots, turns = problem.rows, len(start), bool(problem.yaw_precision)
    width = np.sqrt(rows.variance())

    def parts(unknown: Reals) -> tuple[Reals, Reals]:
        position, turn = unknown[: 3 * robots].reshape(-1, 3), unknown[3 * robots :]
        return position, turn if turns else yaw

    def residual(unknown: Reals) -> Reals:
        position, turn = parts(unknown)
        prior = turn * problem.yaw_precision**0.5 if turns else np.empty(0)
        held = (position[0] - start[0]) / 1e-6
        return np.concatenate([rows.residual(position, turn) / width, prior, held])

    def slope(unknown: Reals) -> Reals:
        of_rows = rows.jacobian(*parts(unknown)).toarray() / width[:, None]
        of_prior = np.eye(robots, 4 * robots, 3 * robots) * problem.yaw_precision**0.5
        of_held = np.eye(3, 4 * robots) / 1e-6
        full = np.concatenate([of_rows, of_prior[: robots * turns], of_held])
        columns = (4 if turns else 3) * robots
        return np.asarray(full[:, :columns])

    unknown = np.concatenate([start.ravel(), yaw if turns else np.empty(0)])
    found = least_squares(residual, unknown, slope, loss="soft_l1", x_scale="jac")
    return _checked(parts(found.x)[0], log)


@tiswarm.method("gtsam", cues=PARAMS.used_cues)
def gtsam_batch(log: SensingLog) -> Reals:
    """Minimize the chi-square by GTSAM's Levenberg-Marquardt method."""
    return _checked(levenberg_marquardt(*_posed(log)).position, log)


@tiswarm.method("isam2", cues=PARAMS.used_cues)
def isam2(log: SensingLog) -> Reals:
    """Minimize the chi-square robot by robot, as they join, by GTSAM's iSAM2.

    Dogleg steps, as robots whose measurements leave motions open need.
    """
    problem, start, yaw = _posed(log)
    params = gtsam.ISAM2Params()
    params.setOptimizationParams(gtsam.ISAM2DoglegParams())
    params.relinearizeSkip = 1
    solver = gtsam.ISAM2(params)
    # So that motions that nothing resists leave no singular matrix.
    loose = gtsam.noiseModel.Isotropic.Sigma(3, 100.0)
    for robot, (graph, values) in enumerate(by_robot(problem, start, yaw)):
        if robot:
            graph.push_back(gtsam.PriorFactorVector(robot, start[robot], loose))
        try:
            solver.update(graph, values)
        except RuntimeError as failure:
            raise InputError(f"iSAM2 met a singular matrix at robot {robot}") from failure
    found = minimum(problem, start[0], solver.calculateBestEstimate(), 0.0)
    return _checked(found.position, log)


def _posed(log: SensingLog) -> tuple[Problem, Reals, Reals]:
    """Pose the problem of a log, and find positions and yaws to start from."""
    problem = pose_problem(log, PARAMS)
    if len(problem.rows.shared_sd):
        raise InputError("measurements share errors of sources, which this method cannot use")
    start = place(log, problem.rows, non_overlap=False).position
    return problem, start, np.zeros(log.robot_count)


def _checked(position: Reals, log: SensingLog) -> Reals:
    if not (np.abs(position) < FARTHEST).all():
        raise InputError("the solver diverged")
    centers: Reals = position * log.dock_radius
    return centers
