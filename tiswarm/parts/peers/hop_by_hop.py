"""Hop-by-hop localization, as rival systems do it: each robot solves for its own position, once.

A robot uses its rows of the world, such as fixes and heights, and those that tie it to robots
already placed: it trilaterates. It never moves again.

A robot is located if its rows of the world and of located robots determine its position. Spheres
and planes often intersect in two points that mirror each other. Then further rows, or the space
that other docks take up, must exclude one of them. Robots that are not located are placed last, by
all robots that are placed:

1. Of two points, a robot takes the one that rows, docks in the way and a prior favor. The prior is
   that robots in contact extend away from each other. Of equal points it takes the upper one.
2. A robot on a circle or a sphere starts across from the robots that it touches, and moves to a
   point nearby that fits its rows. With ranges it starts in the middle of its partners.
3. A robot without rows to others starts at the mean of all that are placed.

The variance of robots already placed enters the weights as if their errors were independent. `sd`
takes the partners of a robot to be off by the same vector. Repeated readings are averaged first, so
that each partner, and each source, counts once. Yaw is taken as sensed.
Lengths in R.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.progress import ignore
from tiswarm.localization.cost.settings import EXTENSION, OVERLAP_SD
from tiswarm.localization.mixture.verdict import assess, rms
from tiswarm.measurements.contacts import disconnected, parts
from tiswarm.measurements.cues import measure
from tiswarm.measurements.model import SPACING, Measurements
from tiswarm.parts.peers.settings import HopByHopParams
from tiswarm.parts.peers.trilateration import (
    POINTS,
    Ties,
    Trilateration,
    length,
    outer,
    unit,
)
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

_CERTAIN = 9.0
"""Chi-square by which the worse one of two points must exceed the other to be excluded."""

_SHARP = 2.0
"""Robots become located at once if their sd is within this factor of the least [1]. Others wait for
more partners. Chosen on training structures."""

_INFORMATION = 3.0
"""Least information of the rows along each axis, relative to that of the initial guess [1]: they
halve its standard deviation. Ranges to robots almost in a line leave more."""

_MOST = 1e3
"""Chi-square beyond which odds are nil; avoids an overflow."""


class Placed(NamedTuple):
    """Where N robots are by their own measurements."""

    position: Reals
    """Centers [R], shape (N, 3)."""

    sd: Reals
    """Standard deviation of each [R], shape (N,)."""

    undetermined: Bools
    """Coordinates that are guesses, shape (N, 3)."""

    @property
    def is_located(self) -> Bools:
        """Whether no coordinate of a robot is a guess, shape (N,)."""
        is_located: Bools = np.logical_not(self.undetermined.any(axis=1))
        return is_located


def localize(
    log: SensingLog,
    params: HopByHopParams,
    _on_progress: Callable[[float], None] = ignore,
) -> Estimate:
    """Localize a structure.

    Returns:
        Its estimate. The residual is the root mean square over contacts, ranges, and the components
        of measured offsets. Verdicts are on located robots.
    """
    rows = measure(log, params.cues)
    placed = place(log, rows, non_overlap=params.non_overlap, in_join_order=params.order == "join")
    position, unit_length = placed.position, log.dock_radius
    is_guess = np.logical_not(placed.is_located)
    found = assess(log, params.cues, position, is_guess=is_guess, sd=placed.sd)
    gap = rows.residual(position)[: len(rows.other)]
    return Estimate(
        robot_id=log.robot_id,
        position=position * unit_length,
        disconnected=disconnected(rows),
        sd=found.convergence.sd_factor * placed.sd * unit_length,
        undetermined=placed.undetermined,
        **found._asdict(),
        iteration=np.zeros(1, np.int64),
        trace=position[None] * unit_length,
        residual=np.array([rms(gap) * unit_length]),
    )


def place(
    log: SensingLog, rows: Measurements, *, non_overlap: bool, in_join_order: bool = False
) -> Placed:
    """Place the robots of a log by its rows."""
    swarm = _HopByHopSwarm(
        rows.averaged(), log, non_overlap=non_overlap, is_earlier_only=in_join_order
    )
    if in_join_order:
        swarm.place_in_join_order()
    else:
        swarm.place_by_hops()
    return Placed(
        position=swarm.position[:-1],
        sd=np.sqrt(np.trace(swarm.shared_covariance[:-1], axis1=1, axis2=2)),
        undetermined=swarm.undetermined,
    )


class _HopByHopSwarm:
    """N robots, some of them placed, and last in each array the world."""

    def __init__(
        self, rows: Measurements, log: SensingLog, *, non_overlap: bool, is_earlier_only: bool
    ) -> None:
        """Place the anchor."""
        self.robots = rows.robots
        self.non_overlap, self.is_gone = non_overlap, log.is_gone
        self.part = parts(rows)
        self.docks = rows.odometry.arm[rows.odometry.final]
        self.position = np.zeros((self.robots + 1, 3))
        self.position[0] = log.anchor_position / log.dock_radius
        self.covariance = np.zeros((self.robots + 1, 3, 3))
        self.shared_covariance = np.zeros((self.robots + 1, 3, 3))
        self.is_located = np.isin(np.arange(self.robots + 1), [0, self.robots])
        self.is_placed = self.is_located.copy()
        self.undetermined = np.zeros((self.robots, 3), np.bool_)
        self.ties = Ties.of(rows)
        if is_earlier_only:
            is_world = self.ties.partner == self.robots
            self.ties = self.ties.select((self.ties.partner < self.ties.robot) | is_world)

    def place_in_join_order(self) -> None:
        """Place robots whose earlier partners have been placed, as many as there are at once."""
        hops = [0] * self.robots
        partner = np.where(self.ties.partner < self.robots, self.ties.partner, 0)
        for i, j in zip(self.ties.robot.tolist(), partner.tolist(), strict=True):
            hops[i] = max(hops[i], hops[j] + 1) if i else 0
        for hop in range(1, max(hops) + 1):
            robots = np.flatnonzero(np.array(hops) == hop)
            self._try(robots)
            is_known = ~self.undetermined[robots].any(axis=1)
            self.is_located[robots[is_known]] = self.is_placed[robots[is_known]] = True
            if not is_known.all():
                self._guess(robots[~is_known])

    def place_by_hops(self) -> None:
        """Place robots as soon as located ones determine their positions; then all others."""
        robots = waiting = np.flatnonzero(~self.is_placed)
        while robots.size:
            self._try(robots)
            known = np.flatnonzero(~self.is_placed[:-1] & ~self.undetermined.any(axis=1))
            # The sharpest first: what they are placed by is in the errors of all later ones.
            variance = np.trace(self.covariance[known], axis1=1, axis2=2)
            known = known[variance <= _SHARP**2 * variance.min(initial=np.inf)]
            if not known.size and len(robots) == len(waiting):
                break
            self.is_located[known] = self.is_placed[known] = True
            waiting = np.flatnonzero(~self.is_placed)
            tied = np.intersect1d(waiting, self.ties.robot[np.isin(self.ties.partner, known)])
            # At last ask all: docks placed since may exclude the mirror image of any robot.
            robots = tied if tied.size else waiting
        while not self.is_placed.all():
            robots = np.flatnonzero(~self.is_placed)
            rows = self._rows(robots, self.is_placed)
            is_tied = rows.sum(rows.ties.partner < self.robots) > 0.0
            if is_tied.any():
                rank = np.where(is_tied, rows.rank(), -1)
                self._guess(robots[rank == rank.max()])
            else:  # each part starts with its first robot
                self._guess(robots[np.unique(self.part[robots], return_index=True)[1]])

    def _rows(self, robots: Ints, sources: Bools) -> Trilateration:
        """Gather the rows that tie some robots to some sources."""
        is_asked = np.zeros(self.robots, np.bool_)
        is_asked[robots] = True
        chosen = is_asked[self.ties.robot] & sources[self.ties.partner]
        return Trilateration(self.ties.select(chosen), self.position, self.covariance)

    def _try(self, robots: Ints) -> None:
        """Compute where robots are by those that are located, and what these leave open."""
        self.undetermined[robots] = self._solve(robots, self.is_located)

    def _guess(self, robots: Ints) -> None:
        """Place robots by all that are placed."""
        self._solve(robots, self.is_placed)
        self.is_placed[robots] = True

    def _solve(self, robots: Ints, sources: Bools) -> Bools:
        """Set positions and covariances of robots by their rows to sources.

        Returns:
            Coordinates that these rows leave open, shape (n, 3).
        """
        rows = self._rows(robots, sources)
        guess, prior, least = self._prior(rows, sources)
        can_cross = rows.rank() >= POINTS
        # Two starts for each robot: three spheres meet at two points, mirror images of each other.
        start = np.repeat(guess[:, None], 2, axis=1)
        if can_cross.any():
            start = np.where(can_cross[:, None, None], rows.crossings(), start)
        point, misfit = rows.descend(start)
        apart = point[:, 1] - point[:, 0]
        # Points that are nearer than this along each axis count as one.
        differs = np.abs(apart) > OVERLAP_SD
        # Where both starts lead to one point, nothing can prefer either.
        favor = np.zeros_like(misfit)
        if differs.any():
            misfit += self._overlap(robots, point)
            favor = self._extension(rows, point)
        cost, every = misfit - favor, np.arange(len(robots))
        chosen = cost.argmin(axis=1)
        position = point[every, chosen]
        odds = np.exp(-0.5 * np.minimum(np.abs(cost[:, 1] - cost[:, 0]), _MOST))
        mirrored = (odds / (1.0 + odds))[:, None, None] * outer(apart)
        self.position[robots] = position
        found = rows.covariance(position, prior, self.shared_covariance)
        self.covariance[robots], self.shared_covariance[robots] = (
            each + mirrored for each in found
        )
        is_ambiguous = misfit[every, 1 - chosen] < misfit[every, chosen] + _CERTAIN
        is_open: Bools = is_ambiguous[:, None] & differs
        return is_open | rows.open_axes(position, _INFORMATION * least)

    def _prior(self, rows: Trilateration, sources: Bools) -> tuple[Reals, Reals, Reals]:
        """Guess where robots are before they solve their rows.

        From a partner, every direction is as likely as another.

        Returns:
            Centers [R], shape (n, 3), the information of this guess along each axis [R^-2], (n,),
            and the part of it that is due to partners, shape (n,).
        """
        ties = rows.ties
        is_tied = ties.partner < self.robots
        count = rows.sum(is_tied)
        across = (ties.is_sphere * ties.reach)[:, None] * unit(ties.shift)
        guess = rows.sum(is_tied[:, None] * (rows.middle + across))
        guess /= np.maximum(count, 1.0)[:, None]
        of_partners = rows.sum(is_tied * 3.0 / np.maximum(ties.reach, SPACING) ** 2)
        others = self.position[:-1][sources[:-1]]
        extent = max(float(others.var(axis=0).sum()), SPACING**2)
        guess = np.where(count[:, None] > 0.0, guess, others.mean(axis=0))
        return guess, np.where(count > 0.0, of_partners, 3.0 / extent), of_partners

    def _extension(self, rows: Trilateration, point: Reals) -> Reals:
        """Compute how much the prior favors points (n, K, 3), in chi-square, shape (n, K)."""
        touches = rows.ties.is_sphere & (length(rows.ties.shift) > 0.0)
        away = length(point[rows.of] - rows.partner[:, None])
        contacts = np.maximum(rows.sum(touches), 1.0)
        mean: Reals = rows.sum(touches[:, None] * away) / contacts[:, None]
        return 2.0 * EXTENSION * mean

    def _overlap(self, robots: Ints, point: Reals) -> Reals:
        """Compute the chi-square of docks in the way at points (n, K, 3), shape (n, K)."""
        if not self.non_overlap:
            return np.zeros(point.shape[:2])
        is_there = self.is_placed[:-1] & ~self.is_gone
        there = (self.position[:-1, None] + self.docks)[is_there].reshape(-1, 3)
        dock = point[:, :, None] + self.docks[robots][:, None]
        overlap = np.maximum(SPACING - cKDTree(there).query(dock)[0], 0.0)
        square: Reals = ((overlap / OVERLAP_SD) ** 2).sum(axis=2)
        square[self.is_gone[robots]] = 0.0
        return square
