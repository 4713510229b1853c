"""How the poses of a graph are turned: by priors, along relative poses, or by ranges.

Relative poses make a trajectory rigid, but for errors that add up along it. Where no prior states
how one of its poses is turned, ranges from its poses to places that priors state leave six unknowns
of the whole trajectory, which are fitted. Lengths in the unit of the graph.
"""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy import optimize
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.interop.graph_lines import Graph, GraphLine

_RIVAL = 20.0
"""Chi-square by which each other orientation has to be worse than the one that is taken."""

_APART = 0.1
"""Angle beyond which two minima are different orientations [rad]."""

_UNKNOWNS = 6


class Turn(NamedTuple):
    """Orientation of a pose."""

    wxyz: Reals
    """Body to world, shape (4,)."""

    variance: float
    """Mean over the axes [rad^2]."""

    @property
    def rotation(self) -> Rotation:
        """The rotation from body to world."""
        return Rotation.from_quat(self.wxyz, scalar_first=True)


class _Pose(NamedTuple):
    """A pose in the frame of the first of its trajectory."""

    turn: Rotation
    place: Reals  # shape (3,)
    turn_variance: float  # mean over the axes [rad^2]
    variance: float  # of the place, mean over the axes


class _Ranges(NamedTuple):
    """Ranges from poses of a trajectory to known places."""

    seen_from: Reals  # places of the poses in the trajectory's frame, shape (n, 3)
    to: Reals  # known places, shape (n, 3)
    length: Reals  # shape (n,)
    sd: Reals  # with that of the pose, shape (n,)


def find_turns(
    graph: Graph, known: dict[str, Turn], places: dict[str, GraphLine]
) -> dict[str, Turn]:
    """Find how poses are turned; leave out those that no line turns.

    Args:
        graph: The graph.
        known: Orientations that priors or the anchor state.
        places: Priors that state a position.
    """
    near: dict[str, list[tuple[str, GraphLine]]] = {}
    for line in graph.lines:
        if line.kind == "pose":
            for name, other in (line.names, line.names[::-1]):
                near.setdefault(name, []).append((other, line))
    found = dict(known)
    for name, pose, before in _walk(near, list(known)):
        start = found[before]
        turn = (start.rotation * pose.turn).as_quat(scalar_first=True)
        found[name] = Turn(turn, start.variance + pose.turn_variance)
    for first in near:
        if first in found:
            continue
        trajectory = {first: _STILL}
        for name, step, before in _walk(near, [first]):
            trajectory[name] = _joined(trajectory[before], step)
        ranges = _ranges(graph, trajectory, places)
        frame = None if ranges is None else _fit(ranges)
        if frame is not None:
            for name, pose in trajectory.items():
                turn = (frame.rotation * pose.turn).as_quat(scalar_first=True)
                found[name] = Turn(turn, frame.variance + pose.turn_variance)
    return found


def _walk(
    near: dict[str, list[tuple[str, GraphLine]]], start: list[str]
) -> Iterator[tuple[str, _Pose, str]]:
    """Follow relative poses, the fewest first: name, step from the pose before, and its name."""
    waiting, reached = deque(start), {*start}
    while waiting:
        before = waiting.popleft()
        for name, line in near.get(before, ()):
            if name not in reached:
                reached.add(name)
                waiting.append(name)
                yield name, _step(line, forward=line.names[0] == before), before


def _step(line: GraphLine, *, forward: bool) -> _Pose:
    """Return a relative pose from the first of its ends to the second, or back."""
    turn, place = Rotation.from_quat(line.wxyz, scalar_first=True), line.vector
    if not forward:
        turn = turn.inv()
        place = -turn.apply(place)
    return _Pose(turn, place, line.turn_variance, float(np.trace(line.spread)) / 3.0)


_STILL = _Pose(Rotation.identity(), np.zeros(3), 0.0, 0.0)


def _joined(before: _Pose, step: _Pose) -> _Pose:
    """Append a step to a pose; variances add up, and turns move what comes after them."""
    swung = 2.0 / 3.0 * before.turn_variance * float(step.place @ step.place)
    return _Pose(
        before.turn * step.turn,
        before.place + before.turn.apply(step.place),
        before.turn_variance + step.turn_variance,
        before.variance + step.variance + swung,
    )


def _ranges(
    graph: Graph, trajectory: dict[str, _Pose], places: dict[str, GraphLine]
) -> _Ranges | None:
    """Gather the ranges from a trajectory to known places; None if they are too few."""
    rows = []
    for line in graph.lines:
        for name, other in (line.names, line.names[::-1]) if line.kind == "range" else ():
            if name in trajectory and other in places and other not in trajectory:
                pose, place = trajectory[name], places[other]
                spread = line.spread[0, 0] + pose.variance + float(np.trace(place.spread)) / 3.0
                rows.append((*pose.place, *place.vector, line.vector[0], np.sqrt(spread)))
    if len(rows) <= _UNKNOWNS:
        return None
    table = np.array(rows)
    return _Ranges(table[:, :3], table[:, 3:6], table[:, 6], table[:, 7])


def _fit(ranges: _Ranges) -> Turn | None:
    """Fit orientation and place of a trajectory; None where several orientations fit, or any."""
    starts = Rotation.create_group("O")
    found = [_minimum(ranges, starts[k]) for k in range(len(starts))]
    cost = np.array([2.0 * each.cost for each in found])
    best = int(cost.argmin())
    turns = Rotation.from_quat([_turned(starts[k], f).as_quat() for k, f in enumerate(found)])
    rivals: Ints = np.flatnonzero((turns * turns[best].inv()).magnitude() > _APART)
    if cost[rivals].min(initial=np.inf) < cost[best] + _RIVAL:
        return None
    last = _minimum(ranges, turns[best], found[best].x[3:])
    information = last.jac.T @ last.jac
    if np.linalg.matrix_rank(information) < _UNKNOWNS:
        return None
    misfit = max(1.0, 2.0 * last.cost / (len(ranges.length) - _UNKNOWNS))
    variance = misfit * float(np.trace(np.linalg.inv(information)[:3, :3])) / 3.0
    return Turn(_turned(turns[best], last).as_quat(scalar_first=True), variance)


def _minimum(
    ranges: _Ranges, start: Rotation, place: Reals | None = None
) -> optimize.OptimizeResult:
    """Minimize chi-square from an orientation; without a place, from the middle of known ones."""

    def residual(unknown: Reals) -> Reals:
        turn = Rotation.from_rotvec(unknown[:3]) * start
        away = turn.apply(ranges.seen_from) + unknown[3:] - ranges.to
        residual: Reals = (np.linalg.norm(away, axis=1) - ranges.length) / ranges.sd
        return residual

    if place is None:
        place = ranges.to.mean(axis=0) - start.apply(ranges.seen_from.mean(axis=0))
    found: optimize.OptimizeResult = optimize.least_squares(  # type: ignore[operator]
        residual, np.concatenate([np.zeros(3), place]), method="lm"
    )
    return found


def _turned(start: Rotation, found: optimize.OptimizeResult) -> Rotation:
    """Return the orientation of a minimum."""
    return Rotation.from_rotvec(found.x[:3]) * start
