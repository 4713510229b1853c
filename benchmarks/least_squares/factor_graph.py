"""The least-squares problem as a factor graph of GTSAM: one factor a residual.

The factors compute residuals and derivatives by themselves, robot by robot. So they check the
formulas of `tiswarm.measurements.model` too, not only its solver.
"""

from collections.abc import Callable, Iterator

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult

from tiswarm.localization.least_squares import Problem
from tiswarm.localization.params import LeastSquaresParams

Array = NDArray[np.float64]
Residual = Callable[[list[Array], list[float]], tuple[float, list[Array], list[float]]]
"""From positions and yaws of robots to a residual, and its derivatives by each of them."""

CONVERGED = 1e-8
"""Relative and absolute decrease of the cost below which an iteration is the last."""


def levenberg_marquardt(
    problem: Problem, unknowns: Array, params: LeastSquaresParams
) -> OptimizeResult:
    """Minimize the residuals by GTSAM's Levenberg-Marquardt method; the loss is linear.

    Keys are robots: position N is that of robot N, key R + N its yaw [rad],
    with R robots. The anchor has no position key.
    """
    robots = problem.robots
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    positions, arcs = np.split(unknowns, [3 * robots - 3])
    for robot, position in enumerate(positions.reshape(-1, 3), start=1):
        values.insert(robot, position)
    for robot, arc in enumerate(arcs):
        values.insert(robots + robot, np.array([arc]))
    for involved, residual in _residuals(problem):
        if problem.yaw_sd or max(involved) > 0:
            graph.push_back(_factor(problem, involved, residual))
    if problem.yaw_sd:
        prior = gtsam.noiseModel.Isotropic.Sigma(1, problem.yaw_sd)
        for robot in range(robots):
            graph.push_back(gtsam.PriorFactorVector(robots + robot, np.zeros(1), prior))
    settings = gtsam.LevenbergMarquardtParams()
    settings.setMaxIterations(params.evaluations)
    settings.setRelativeErrorTol(CONVERGED)
    settings.setAbsoluteErrorTol(CONVERGED)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, settings)
    found, iterations = optimizer.optimize(), optimizer.iterations()
    keys = [*range(1, robots), *(robots + np.arange(len(arcs))).tolist()]
    x = np.concatenate([found.atVector(key) for key in keys])
    status = int(iterations < params.evaluations)
    return OptimizeResult(x=x, cost=optimizer.error(), nfev=iterations, status=status)


def _residuals(problem: Problem) -> Iterator[tuple[list[int], Residual]]:
    """List the residuals with the robots that they depend on."""
    rows = problem.rows
    for n, j in enumerate(rows.other.tolist()):
        d = rows.distances
        residual = _distance(
            rows.other_arm[n], rows.arm[n], problem.width[n], d.length[n], hinge=bool(d.is_hinge[n])
        )
        yield [j, int(rows.robot[n])], residual
    for k, (way, value) in enumerate(zip(rows.places.direction, rows.places.value, strict=True)):
        n = len(rows.other) + k
        yield [int(rows.robot[n])], _coordinate(way, rows.arm[n], value, problem.width[n])


def _distance(a: Array, b: Array, width: float, spacing: float, *, hinge: bool) -> Residual:
    """Distance between docks a and b of two robots, less its measured length, over its width."""

    def residual(position: list[Array], yaw: list[float]) -> tuple[float, list[Array], list[float]]:
        from_i, from_j = _turned(a, yaw[0]), _turned(b, yaw[1])
        apart = position[1] + from_j - position[0] - from_i
        distance = float(np.linalg.norm(apart))
        if hinge and distance >= spacing:
            return 0.0, [np.zeros(3), np.zeros(3)], [0.0, 0.0]
        way = apart / (distance * width) if distance else np.zeros(3)
        by_yaw = [-float(way @ _swept(from_i)), float(way @ _swept(from_j))]
        return (distance - spacing) / width, [-way, way], by_yaw

    return residual


def _coordinate(way: Array, arm: Array, value: float, width: float) -> Residual:
    """Coordinate of the end of a robot's arm along a direction, less its value, over its width."""

    def residual(position: list[Array], yaw: list[float]) -> tuple[float, list[Array], list[float]]:
        turned = _turned(arm, yaw[0])
        off = float(way @ (position[0] + turned) - value)
        return off / width, [way / width], [float(way @ _swept(turned)) / width]

    return residual


def _factor(problem: Problem, robots: list[int], residual: Residual) -> "gtsam.CustomFactor":
    placed = [robot for robot in robots if robot > 0]
    turned = robots if problem.yaw_sd else []
    keys = placed + [problem.robots + robot for robot in turned]

    def error(
        _this: "gtsam.CustomFactor", values: "gtsam.Values", slopes: list[Array] | None
    ) -> Array:
        position = [values.atVector(r) if r else problem.anchor for r in robots]
        yaw = [values.atVector(problem.robots + r)[0] for r in turned]
        off, by_position, by_yaw = residual(position, yaw or [0.0] * len(robots))
        if slopes is not None:
            rows = [slope for slope, r in zip(by_position, robots, strict=True) if r]
            rows += [np.array([slope]) for slope in by_yaw[: len(turned)]]
            for n, row in enumerate(rows):
                slopes[n] = row[None]
        return np.array([off])

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), keys, error)


def _turned(arm: Array, yaw: float) -> Array:
    """Turn an arm about the vertical."""
    x, y, z = arm
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([cos * x - sin * y, sin * x + cos * y, z])


def _swept(arm: Array) -> Array:
    """Derivative of a turned arm by its yaw."""
    return np.array([-arm[1], arm[0], 0.0])
