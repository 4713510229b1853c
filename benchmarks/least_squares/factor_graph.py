"""The chi-square of a log as a factor graph of GTSAM: one factor a row.

The factors compute residuals and derivatives by themselves, robot by robot. So they check the
formulas of `tiswarm.measurements.model` too, not only its solver.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from tiswarm.localization.chains.problem import Problem

Array = NDArray[np.float64]
Residual = Callable[[list[Array], list[float]], tuple[float, list[Array], list[float]]]
"""From positions and yaws of robots to a residual, and its derivatives by each of them."""

CONVERGED = 1e-8
"""Relative and absolute decrease of the cost below which an iteration is the last."""

MOST_ITERATIONS = 200


class Minimum(NamedTuple):
    """Where a solver ended."""

    position: Array
    """Centers [R], shape (N, 3)."""

    yaw: Array
    """Yaw corrections [rad], shape (N,)."""

    chi_square: float


def levenberg_marquardt(problem: Problem, position: Array, yaw: Array) -> Minimum:
    """Minimize the chi-square of a problem by GTSAM's Levenberg-Marquardt method.

    Keys are robots: position N is that of robot N, key R + N its yaw [rad], with R robots. The
    anchor has no position key.

    Args:
        problem: Measurements without touches and sources.
        position: Centers to start from [R], shape (N, 3).
        yaw: Yaw corrections to start from [rad], shape (N,).
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for part, new in by_robot(problem, position, yaw):
        graph.push_back(part)
        values.insert(new)
    settings = gtsam.LevenbergMarquardtParams()
    settings.setMaxIterations(MOST_ITERATIONS)
    settings.setRelativeErrorTol(CONVERGED)
    settings.setAbsoluteErrorTol(CONVERGED)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, settings)
    found = optimizer.optimize()
    return minimum(problem, position[0], found, 2.0 * optimizer.error())


def by_robot(
    problem: Problem, position: Array, yaw: Array
) -> Iterator[tuple["gtsam.NonlinearFactorGraph", "gtsam.Values"]]:
    """Yield what each robot adds to the graph as it joins: factors, and new values with a start.

    Arguments as for `levenberg_marquardt`, and keys as there.
    """
    robots = len(position)
    is_turned = bool(problem.yaw_precision)
    added: list[list[gtsam.CustomFactor]] = [[] for _ in range(robots)]
    for involved, residual in _residuals(problem):
        if is_turned or max(involved) > 0:
            factor = _factor(problem, position[0], involved, residual)
            added[max(involved)].append(factor)
    for robot, factors in enumerate(added):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for factor in factors:
            graph.push_back(factor)
        if robot:
            values.insert(robot, position[robot])
        if is_turned:
            prior = gtsam.noiseModel.Isotropic.Sigma(1, problem.yaw_precision**-0.5)
            values.insert(robots + robot, np.array([yaw[robot]]))
            graph.push_back(gtsam.PriorFactorVector(robots + robot, np.zeros(1), prior))
        yield graph, values


def minimum(problem: Problem, anchor: Array, found: "gtsam.Values", chi_square: float) -> Minimum:
    """Read the robots of a problem from values."""
    robots = len(problem.part)
    places = [found.atVector(robot) for robot in range(1, robots)]
    yaw = np.zeros(robots)
    if problem.yaw_precision:
        yaw = np.array([found.atVector(robots + robot)[0] for robot in range(robots)])
    return Minimum(np.vstack([anchor[None], *places]), yaw, chi_square)


def _residuals(problem: Problem) -> Iterator[tuple[list[int], Residual]]:
    """List the residuals with the robots that they depend on."""
    rows = problem.rows
    width = np.sqrt(rows.variance())
    distances = len(rows.distances.length)
    for n, (i, j) in enumerate(zip(rows.robot.tolist(), rows.neighbor.tolist(), strict=False)):
        ends = rows.neighbor_arm[n], rows.arm[n], width[n]
        if n < distances:
            yield [j, i], _distance(*ends, rows.distances.length[n])
        else:
            yield [j, i], _offset(*ends, rows.offsets.axis[n - distances])
    for k, (way, value) in enumerate(zip(rows.places.direction, rows.places.value, strict=True)):
        n = len(rows.neighbor) + k
        yield [int(rows.robot[n])], _coordinate(way, rows.arm[n], value, width[n])


def _distance(a: Array, b: Array, width: float, length: float) -> Residual:
    """Distance between the ends of arms a and b of two robots, less its measured length."""

    def residual(position: list[Array], yaw: list[float]) -> tuple[float, list[Array], list[float]]:
        from_i, from_j = _turned(a, yaw[0]), _turned(b, yaw[1])
        apart = position[1] + from_j - position[0] - from_i
        distance = float(np.linalg.norm(apart))
        way = apart / (distance * width) if distance else np.zeros(3)
        by_yaw = [-float(way @ _swept(from_i)), float(way @ _swept(from_j))]
        return (distance - length) / width, [-way, way], by_yaw

    return residual


def _offset(a: Array, b: Array, width: float, axis: Array) -> Residual:
    """Component of the vector between the ends of arms, along an axis of the second robot."""

    def residual(position: list[Array], yaw: list[float]) -> tuple[float, list[Array], list[float]]:
        from_i, from_j = _turned(a, yaw[0]), _turned(b, yaw[1])
        apart = position[1] + from_j - position[0] - from_i
        way = _turned(axis, yaw[1]) / width
        by_yaw = [
            -float(way @ _swept(from_i)),
            float(way @ _swept(from_j) + _swept(way) @ apart),
        ]
        return float(way @ apart), [-way, way], by_yaw

    return residual


def _coordinate(way: Array, arm: Array, value: float, width: float) -> Residual:
    """Coordinate of the end of a robot's arm along a direction, less its value."""

    def residual(position: list[Array], yaw: list[float]) -> tuple[float, list[Array], list[float]]:
        turned = _turned(arm, yaw[0])
        off = float(way @ (position[0] + turned) - value)
        return off / width, [way / width], [float(way @ _swept(turned)) / width]

    return residual


def _factor(
    problem: Problem, anchor: Array, robots: list[int], residual: Residual
) -> "gtsam.CustomFactor":
    count = len(problem.part)
    placed = [robot for robot in robots if robot > 0]
    turned = robots if problem.yaw_precision else []
    keys = placed + [count + robot for robot in turned]

    def error(
        _this: "gtsam.CustomFactor", values: "gtsam.Values", slopes: list[Array] | None
    ) -> Array:
        position = [values.atVector(r) if r else anchor for r in robots]
        yaw = [values.atVector(count + r)[0] for r in turned]
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
