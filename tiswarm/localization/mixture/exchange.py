"""Exchanges of outliers: what if the outlier is right, and another measurement is wrong?

A contact that names a wrong robot may hold a part of a structure where it does not belong. All
chains then tear the right contacts of that part. Such a contact closes a cycle with the one that is
torn, in the graph of robots, contacts and ranges. So we hold the torn one, leave out few others of
its cycles, without which a part moves as a whole, and keep what costs less. A known position is an
edge of that graph, too: from its robot to the anchor.

An outlier costs -2 log of the rate of wrong measurements: the cost of configurations is the sum of
squared residuals in variances, each up to that. Lengths in R.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple, cast

import numpy as np

from tiswarm.base.aliases import Bools, Reals
from tiswarm.localization.chains.annealer import anneal
from tiswarm.localization.chains.views import ANNEALING
from tiswarm.localization.cost import OVERLAP_SD
from tiswarm.localization.cost.cost import boltzmann_weights
from tiswarm.localization.mixture import CONVERGENCE, EXCHANGE, MIXTURE
from tiswarm.localization.mixture.anchors import with_wrong_anchors, without_anchors
from tiswarm.localization.mixture.ends import Fit, Posed, descended
from tiswarm.localization.mixture.mixture import mixed
from tiswarm.localization.mixture.verdict import outlier_cost
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.equations import AXES
from tiswarm.measurements.model import SPACING
from tiswarm.records.estimate import Estimate

_RIDGE = 1e-6
"""Precision with which robots that nothing holds stay at the anchor [R^-2]."""


class _End(NamedTuple):
    """A configuration that an exchange leads to."""

    position: Reals
    """Centers [R], shape (N, 3)."""

    cost: float
    """Its cost with outliers [1]."""

    left_out: Bools
    """Rows that were exchanged, shape (E,)."""


def with_exchanges(fit: Fit, estimate: Estimate) -> Estimate | None:
    """Localize again from the best exchange of outliers, if one costs less than the estimate.

    Another choice of outliers that costs nearly as little is said to be possible, and widens `sd`.

    Args:
        fit: Chains.
        estimate: Estimate that they lead to.

    Returns:
        The estimate; None if no exchange costs less, or nearly as little.
    """
    log = fit.log
    problem = fit.problem
    few = fit.is_refined and len(problem.part) <= EXCHANGE.most_robots
    is_simple = not (len(problem.rows.touch) or problem.yaw_precision or problem.is_chained)
    if not (few and is_simple):
        return None
    search = _Search(fit)
    position = estimate.solutions[0].position / log.dock_radius
    if not search.torn(position).any():
        return None
    best, others = search.least(position)
    if not best.left_out.any() and not others:
        return None
    is_anchor = best.left_out & search.of_anchor
    anchors = np.unique(problem.rows.robot[is_anchor])
    if best.left_out.any():
        params = cast("JointParams", fit.params)
        posed = without_anchors(fit, anchors) if len(anchors) else fit
        start = [np.repeat(best.position[None], len(fit.annealed.mean), axis=0)]
        chains = anneal([posed.log], [params], [posed.problem], start=start)[0]
        fit = Fit.of(posed, chains)
        estimate = mixed(fit, restarted=len(chains.mean))
    if len(anchors):
        estimate = with_wrong_anchors(estimate, log, problem.rows.select(is_anchor), anchors)
    return _with_others(estimate, best, others, log.dock_radius)


def _with_others(estimate: Estimate, best: _End, others: list[_End], unit: float) -> Estimate:
    """Widen `sd` by other choices of outliers, and say that there are some.

    Args:
        estimate: The estimate.
        best: Choice of outliers that costs least.
        others: Choices that cost nearly as little.
        unit: R, in the unit of the log.
    """
    verdict = estimate.convergence
    if verdict is None or estimate.sd is None or not others:
        return estimate
    weight = boltzmann_weights(np.array([best.cost, *(end.cost for end in others)]))
    away = np.array([end.position - best.position for end in others])
    square = unit**2 * np.tensordot(weight[1:], (away**2).sum(axis=2), 1)
    farthest = unit * float(np.linalg.norm(away, axis=2).max())
    if verdict.trusted:
        reason = (
            "other outliers explain the measurements nearly as well, and move robots by up to "
            f"{farthest:.3g} {estimate.length_unit}"
        )
        verdict = replace(verdict, consistent=False, testable=True, reason=reason)
    return replace(estimate, convergence=verdict, sd=np.hypot(estimate.sd, np.sqrt(square)))


class _Search:
    """Tries exchanges of the rows of one structure."""

    def __init__(self, fit: Fit) -> None:
        self._fit = fit
        self._rows = fit.problem.rows
        self._variance = self._rows.variance()
        self._known = fit.problem.known
        self._outlier_cost = outlier_cost(fit.log)
        self._pairs = len(self._rows.neighbor)
        is_anchor = np.isfinite(fit.log.known_position[:, 0])
        self.of_anchor = self._known & is_anchor[self._rows.robot]
        """Rows of known positions, shape (E,)."""

    def least(self, position: Reals) -> tuple[_End, list[_End]]:
        """Exchange outliers at a configuration (N, 3) while that costs less.

        Returns:
            The least cost, and others that cost more by no more than chance explains.
        """
        nothing = np.zeros(len(self._rows), np.bool_)
        best = _End(position, self.cost(position), nothing)
        ends = [best]
        for _ in range(EXCHANGE.most_exchanges):
            tried = self.tried(best)
            ends += tried
            least = min(tried, key=lambda end: end.cost, default=best)
            if least.cost > best.cost - EXCHANGE.least_gain:
                break
            best = least
        return best, [end for end in ends if self._is_other(end, best)]

    @staticmethod
    def _is_other(end: _End, best: _End) -> bool:
        """Judge whether a configuration is another one, and nearly as likely."""
        away = np.linalg.norm(end.position - best.position, axis=1).max()
        excess = end.cost - best.cost
        return bool(away > SPACING and excess < -2.0 * np.log(MIXTURE.least_weight))

    def square(self, position: Reals) -> Reals:
        """Squared residuals of all rows in variances, those of a vector as one, shape (E,)."""
        further = np.where(self._known, 0.0, OVERLAP_SD**2)
        square: Reals = self._rows.residual(position) ** 2 / (self._variance + further)
        offset = self._rows.vector_rows
        summed = square[offset].reshape(-1, AXES).sum(axis=1)
        square[offset] = np.repeat(summed / AXES, AXES)
        return square

    def torn(self, position: Reals) -> Bools:
        """Find contacts and ranges that are outliers, shape (E,)."""
        is_torn = self.square(position) > CONVERGENCE.outlier_sd**2
        is_torn[self._pairs :] = False
        return self._rows.any_of_vector(is_torn)

    def cost(self, position: Reals) -> float:
        """Cost of a configuration with its outliers [1]; an anchor is one measurement."""
        square = self.square(position)
        of_places = np.bincount(
            self._rows.robot[self._known], square[self._known], self._rows.robots
        )
        total = np.minimum(square[~self._known], self._outlier_cost).sum()
        return float(total + np.minimum(of_places, self._outlier_cost).sum())

    def tried(self, end: _End) -> list[_End]:
        """Try all exchanges at a configuration, and move the best few to minima."""
        torn = self.torn(end.position) & ~end.left_out
        trials: list[tuple[float, int, Reals, Bools]] = []
        for cut, part in self._cuts(torn, end.left_out):
            without = end.left_out | self._with_rows(cut)
            shift = self._shift(end.position, part, torn, without)
            moved = end.position + part[:, None] * shift
            trials.append((self.cost(moved), len(trials), moved, without))
        trials.sort(key=lambda trial: trial[:2])
        return [self._at_minimum(*trial[2:]) for trial in trials[: EXCHANGE.refined]]

    def _with_rows(self, some: Iterable[int]) -> Bools:
        """All rows of the measurements that some rows belong to, shape (E,)."""
        chosen = np.zeros(len(self._rows), np.bool_)
        for row in some:
            chosen[row] = True
            if self.of_anchor[row]:
                chosen |= self.of_anchor & (self._rows.robot == self._rows.robot[row])
        return self._rows.any_of_vector(chosen)

    def _is_tested(self, torn: Bools) -> Bools:
        """Find robots whose known position torn measurements test, shape (N,).

        A contact says where a robot is; of ranges there have to be spare ones beyond the three that
        would determine its position instead.
        """
        rows = self._rows
        torn_pairs = np.flatnonzero(torn[: self._pairs])
        ends = np.concatenate([rows.robot[torn_pairs], rows.neighbor[torn_pairs]])
        is_contact = np.tile(rows.is_contact[torn_pairs], 2)
        contacts = np.bincount(ends[is_contact], minlength=rows.robots)
        ranges = np.bincount(ends[~is_contact], minlength=rows.robots)
        is_spared = (ranges == 0) | (ranges >= AXES + EXCHANGE.least_spare)
        tested: Bools = is_spared | (contacts > 0)
        return tested

    def _shift(self, position: Reals, part: Bools, torn: Bools, without: Bools) -> Reals:
        """Find the shift of a part that meets the torn rows between it and the rest [R], (3,).

        Orientations are known, so that a part moves as a whole. Distances meet the nearest point of
        their spheres, in turns.
        """
        rows = self._rows
        weight = np.where(without, 0.0, 1.0 / (self._variance + OVERLAP_SD**2))
        sign = part[rows.robot].astype(np.float64)
        sign[: self._pairs] -= part[rows.neighbor]
        weight[: self._pairs] *= torn[: self._pairs]
        moved = np.flatnonzero((sign != 0.0) & (weight > 0.0))
        distances = len(rows.distances.stance)
        spheres = moved[moved < distances]
        planes = moved[moved >= distances]
        normal = np.concatenate([rows.axes(), rows.places.direction])[planes - distances]
        normal = normal * sign[planes, None]
        vector = sign[spheres, None] * rows.vectors(position)[spheres]
        length = rows.distances.length[spheres, None]
        information = (normal.T * weight[planes]) @ normal + _RIDGE * np.eye(AXES)
        information += weight[spheres].sum() * np.eye(AXES)
        fixed = -(normal.T * weight[planes]) @ rows.residual(position)[planes]
        shift = np.zeros(AXES)
        for _ in range(EXCHANGE.turns):
            apart = vector + shift
            size = np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), OVERLAP_SD)
            toward = weight[spheres] @ (length * apart / size - vector)
            shift = np.linalg.solve(information, fixed + toward)
        return shift

    def _at_minimum(self, position: Reals, without: Bools) -> _End:
        """Move a configuration to a minimum of the robust cost."""
        fit = self._fit
        anchors = np.unique(self._rows.robot[without & self.of_anchor])
        posed: Posed = without_anchors(fit, anchors) if len(anchors) else fit
        still = np.zeros(len(position))
        for sigma in (ANNEALING.warmest, fit.annealed.sigma):
            position, _, _ = descended(posed, (position, still), sigma, EXCHANGE.rounds)
        return _End(position, self.cost(position), without)

    def _cuts(self, torn: Bools, removed: Bools) -> Iterator[tuple[frozenset[int], Bools]]:
        """List few measurements without which the ends of a torn one are in separate parts.

        Yields:
            A row of each, and the robots of the part without the anchor, shape (N,).
        """
        rows = self._rows
        graph: list[list[tuple[int, int]]] = [[] for _ in range(rows.robots)]
        edges = [
            (row, rows.robot[row], rows.neighbor[row])
            for row in rows.link[~(torn | removed)[rows.link]].tolist()
        ]
        anchored = np.flatnonzero(self.of_anchor & ~removed & self._is_tested(torn)[rows.robot])
        robots, first = np.unique(rows.robot[anchored], return_index=True)
        edges += [
            (row, robot, 0) for row, robot in zip(anchored[first].tolist(), robots, strict=True)
        ]
        for row, one, two in edges:
            graph[one].append((int(two), row))
            graph[two].append((int(one), row))
        tried: set[frozenset[int]] = set()
        cuts: list[frozenset[int]] = []
        for row in np.intersect1d(np.flatnonzero(torn), rows.link).tolist():
            ends = int(rows.robot[row]), int(rows.neighbor[row])
            waiting = deque([frozenset[int]()])
            while waiting and len(tried) < EXCHANGE.most_tried and len(cuts) < EXCHANGE.most_cuts:
                cut = waiting.popleft()
                if any(smaller <= cut for smaller in cuts):
                    continue
                path, reached = _path(graph, ends, cut)
                if not path:
                    part = reached if not reached[0] else _reached(graph, ends[1], cut)
                    if not part[0]:
                        cuts.append(cut)
                        yield cut, part
                elif len(cut) < EXCHANGE.most_in_cut:
                    further = [cut | {edge} for edge in path]
                    waiting += [one for one in further if one not in tried]
                    tried.update(further)


def _path(
    graph: list[list[tuple[int, int]]], ends: tuple[int, int], without: frozenset[int]
) -> tuple[list[int], Bools]:
    """Find the edges of a shortest path, none if there is none, and the vertices reached, (N,)."""
    start, end = ends
    came: dict[int, tuple[int, int]] = {start: (start, -1)}
    waiting = deque([start])
    while waiting and end not in came:
        vertex = waiting.popleft()
        for neighbor, edge in graph[vertex]:
            if neighbor not in came and edge not in without:
                came[neighbor] = vertex, edge
                waiting.append(neighbor)
    path = []
    vertex = end
    while vertex in came and vertex != start:
        vertex, edge = came[vertex]
        path.append(edge)
    reached = np.zeros(len(graph), np.bool_)
    reached[[*came]] = True
    return path, reached


def _reached(graph: list[list[tuple[int, int]]], start: int, without: frozenset[int]) -> Bools:
    """Find the vertices that a vertex leads to, shape (N,)."""
    return _path(graph, (start, -1), without)[1]
