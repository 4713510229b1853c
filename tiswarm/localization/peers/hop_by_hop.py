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

Trilateration is by rows to others whose centers are known. A distance puts a robot on a sphere, a
coordinate on a plane, a measured vector on three planes. Their intersection follows in closed form,
and then from Gauss-Newton steps weighted by variance. Lengths in R.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.progress import ignore
from tiswarm.compute.normal_equations import damped, inverted, solved
from tiswarm.localization.cost import EXTENSION, OVERLAP_SD
from tiswarm.localization.mixture.assessment import assess
from tiswarm.localization.mixture.verdict import rms
from tiswarm.localization.peers.settings import HopByHopParams
from tiswarm.measurements.contacts import connected_parts, disconnected, nearest_overlap
from tiswarm.measurements.cues import measure
from tiswarm.measurements.equations import components, missed_along, missed_distance
from tiswarm.measurements.model import SPACING, Measurements
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

POINTS = 3
"""Independent linear equations from which on spheres and planes intersect in one or two points."""

INDEPENDENT = 0.03
"""Least singular value of unit rows that counts [1]: three whose directions are within two degrees
of a plane determine a point no better than two do."""

_STEPS = 16
"""Gauss-Newton steps at most; a point that overshot took ten."""

_SETTLED = 1e-9
"""Steps of a point end when one is not longer [R]."""

_DAMPING = 1e-9
"""Damping of a step relative to the information: it stops motions that no row measures."""

_LEAST = 1e-13
"""Part of the largest eigenvalue below which rounding hides others."""

_UP = np.array([0.0, 0.0, 1.0])
_TINY = np.finfo(np.float64).tiny

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


class Ties(NamedTuple):
    """E rows as one of their robots sees them, sorted by robot; p is its center.

    A sphere has the equation |p - q - shift| = reach, a plane normal . (p - q - shift) = reach,
    with q the center of the partner, or 0 for the world.
    """

    robot: Ints
    """Robot, shape (E,)."""

    partner: Ints
    """Other robot, or N for the world, shape (E,)."""

    shift: Reals
    """From the partner's center to the middle of the sphere, or the origin of the plane [R], shape
    (E, 3)."""

    normal: Reals
    """Unit normal of a plane, 0 of a sphere, shape (E, 3)."""

    reach: Reals
    """Radius of the sphere, or coordinate of the plane [R], shape (E,)."""

    variance: Reals
    """Variance of the row, without that of the partner [R^2], shape (E,)."""

    is_sphere: Bools
    """Whether the row is a sphere, shape (E,)."""

    @classmethod
    def of(cls, rows: Measurements) -> "Ties":
        """List each row of a pair twice, so that each of its robots can be located from the other.

        Each robot has a row of infinite variance, too, so that no sum over its rows is empty.
        """
        distance = rows.distances.length
        robots = rows.robots
        count = len(rows.neighbor)
        i = rows.robot[:count]
        j = rows.neighbor
        robot = rows.robot[count:]
        shift = rows.neighbor_arm - rows.arm[:count]
        variance = rows.variance()
        owner = np.concatenate([i, j, robot, np.arange(robots)])
        nothing = np.zeros((robots, 3))
        normal = np.concatenate([np.zeros((len(distance), 3)), rows.offsets.axis])
        reach = np.concatenate([distance, np.zeros(len(rows.offsets.axis))])
        sphere = np.arange(count) < len(distance)
        no_sphere = np.zeros(len(robot) + robots, np.bool_)
        ties = cls(
            robot=owner,
            partner=np.concatenate([j, i, np.full(len(robot) + robots, robots)]),
            shift=np.concatenate([shift, -shift, -rows.arm[count:], nothing]),
            normal=np.concatenate([normal, normal, rows.places.direction, nothing]),
            reach=np.concatenate([reach, reach, rows.places.value, nothing[:, 0]]),
            variance=np.concatenate([variance[:count], variance, np.full(robots, np.inf)]),
            is_sphere=np.concatenate([sphere, sphere, no_sphere]),
        )
        return ties.select(np.argsort(owner, kind="stable"))

    def select(self, chosen: Bools | Ints) -> "Ties":
        """Keep rows, or sort them."""
        return Ties._make(column[chosen] for column in self)


class Trilateration:
    """Rows of n robots whose partners have been placed."""

    def __init__(self, ties: Ties, position: Reals, covariance: Reals) -> None:
        """Look partners up.

        Args:
            ties: Rows.
            position: Center of each robot, and 0 for the world [R], shape (N + 1, 3).
            covariance: Covariance of each [R^2], shape (N + 1, 3, 3).
        """
        self.ties = ties
        is_first = np.diff(ties.robot, prepend=-1) > 0
        self.first = np.flatnonzero(is_first)
        """First row of each robot, shape (n,)."""
        self.of = np.cumsum(is_first) - 1
        """Robot of each row, counted from 0, shape (E,)."""
        self.partner = position[ties.partner]
        """Center of the partner [R], shape (E, 3)."""
        self.middle = self.partner + ties.shift
        """Middle of the sphere, or origin of the plane [R], shape (E, 3)."""
        # A partner's own error is in what its robots measure from it.
        of_partner = covariance[ties.partner]
        along = (ties.normal[:, None] @ of_partner @ ties.normal[:, :, None])[:, 0, 0]
        mean = np.trace(of_partner, axis1=1, axis2=2) / 3.0
        self.precision = 1.0 / (ties.variance + np.where(ties.is_sphere, mean, along))
        """Inverse variance; of the partner's, a sphere has the mean over directions, (E,)."""
        spheres = np.maximum(self.sum(ties.is_sphere), 1.0)
        self.origin = self.sum(ties.is_sphere[:, None] * self.middle) / spheres[:, None]
        """Mean of the middles of spheres [R], shape (n, 3)."""
        away = length(self.middle - self.origin[self.of]) + np.abs(ties.reach)
        farthest = np.maximum.reduceat(away, self.first) + SPACING
        self.bound = farthest[:, None, None] / INDEPENDENT
        """How far from `origin` rows that do not contradict each other meet [R], (n, 1, 1)."""

    def sum(self, values: Reals | Bools) -> Reals:
        """Sum values of rows (E, ...) over those of each robot, shape (n, ...)."""
        total: Reals = np.add.reduceat(values, self.first, axis=0, dtype=np.float64)
        return total

    def rank(self) -> Ints:
        """Count independent linear equations of each robot, shape (n,)."""
        square = np.linalg.eigvalsh(self.sum(outer(self._linear()[0])))
        rank: Ints = (square > INDEPENDENT**2).sum(axis=1)
        return rank

    def _linear(self) -> tuple[Reals, Reals]:
        """Write rows as linear equations of x = p - origin and |x|^2 / D.

        Returns:
            Coefficients, shape (E, 4), and right sides [R], shape (E,).
        """
        ties = self.ties
        is_sphere = ties.is_sphere
        middle = self.middle - self.origin[self.of]
        radius = np.maximum(ties.reach, SPACING)  # dividing by it makes residuals distances
        on_sphere = 0.5 * (ties.reach**2 - (middle**2).sum(axis=1)) / radius
        on_plane = ties.reach + (ties.normal * middle).sum(axis=1)
        row = np.empty((len(radius), 4))
        row[:, :3] = np.where(is_sphere[:, None], -middle / radius[:, None], ties.normal)
        row[:, 3] = np.where(is_sphere, 0.5 * SPACING / radius, 0.0)
        return row, np.where(is_sphere, on_sphere, on_plane)

    def crossings(self) -> Reals:
        """Intersect the line that the linear equations determine best with a paraboloid, |x|^2.

        Returns:
            Two points of each robot, the upper one first [R], shape (n, 2, 3). They are equal where
            planes alone determine one, or where the line misses the paraboloid. Below the rank
            `POINTS` they have no meaning.
        """
        row, value = self._linear()
        weighted = self.precision[:, None] * row
        square, axis = np.linalg.eigh(self.sum(weighted[:, :, None] * row[:, None]))
        moment = self.sum(weighted * value[:, None])
        floor = _LEAST * square[:, 3:] + _TINY
        share = (moment[:, None] @ axis)[:, 0, 1:] / np.maximum(square[:, 1:], floor)
        foot = (axis[:, :, 1:] @ share[:, :, None])[:, :, 0]
        along = axis[:, :, 0]
        a = (along[:, :3] ** 2).sum(axis=1)
        b = 2.0 * (foot[:, :3] * along[:, :3]).sum(axis=1) - SPACING * along[:, 3]
        c = (foot[:, :3] ** 2).sum(axis=1) - SPACING * foot[:, 3]
        square = b**2 - 4.0 * a * c
        # The usual formula would subtract nearly equal numbers where a or c is small.
        half = -0.5 * (b + np.copysign(np.sqrt(np.maximum(square, 0.0)), b))
        near = np.divide(c, half, out=np.zeros_like(c), where=square > 0.0)
        far = np.divide(half, a, out=near.copy(), where=a > _DAMPING)
        step = np.column_stack([np.where(square > 0.0, near, far), far])[:, :, None]
        offset = foot[:, None, :3] + step * along[:, None, :3]
        point = self.origin[:, None] + self._bounded(offset)
        is_lower = point[:, 0, 2] < point[:, 1, 2]
        return np.where(is_lower[:, None, None], point[:, ::-1], point)

    def residual(self, point: Reals) -> tuple[Reals, Reals]:
        """Compute what points miss rows by.

        Args:
            point: K centers of each robot [R], shape (n, K, 3).

        Returns:
            Derivatives by the point, which are unit vectors, shape (E, K, 3), and residuals [R],
            shape (E, K). At the middle of a sphere the vector is up.
        """
        away = point[self.of] - self.middle[:, None]
        is_sphere = self.ties.is_sphere[:, None]
        plane = self.ties.normal[:, None]
        reach = self.ties.reach[:, None]
        on_sphere, slope = missed_distance(components(away), reach, is_hinge=False)
        outward = np.where(slope[..., None] > 0.0, slope[..., None] * away, _UP)
        on_plane = missed_along(components(away), components(plane), reach)
        normal = np.where(is_sphere[..., None], outward, plane)
        return normal, np.where(is_sphere, on_sphere, on_plane)

    def descend(self, start: Reals) -> tuple[Reals, Reals]:
        """Take Gauss-Newton steps from K centers of each robot, shape (n, K, 3).

        Returns:
            The best points on the way [R], shape (n, K, 3), and their chi-square, shape (n, K).
        """
        point = start
        best = start
        least = np.full(start.shape[:2], np.inf)
        is_moving = np.ones(start.shape[:2], np.bool_)  # each by itself, in any batch
        for _ in range(_STEPS):
            normal, residual = self.residual(point)
            pull = self.precision[:, None] * residual
            misfit = self.sum(pull * residual)
            is_better = is_moving & (misfit < least)
            best = np.where(is_better[..., None], point, best)
            least = np.fmin(misfit, least)
            information = self.sum(self.precision[:, None, None, None] * outer(normal))
            damping = _DAMPING * np.trace(information, axis1=2, axis2=3) + _TINY
            slope = self.sum(pull[..., None] * normal)
            step = self._bounded(solved(damped(information, damping), slope))
            is_moving &= length(step) > _SETTLED
            if not is_moving.any():
                break
            point = np.where(is_moving[..., None], point - step, point)
        return best, least

    def _bounded(self, vector: Reals) -> Reals:
        """Shorten vectors (n, K, 3) beyond the bound, which rows in contradiction can lead to."""
        bounded: Reals = vector / np.maximum(length(vector)[..., None] / self.bound, 1.0)
        return bounded

    def covariance(self, point: Reals, prior: Reals, shared: Reals) -> tuple[Reals, Reals]:
        """Compute the covariance of centers, with independent and with equal errors of partners.

        Partners owe their errors to much the same rows, which therefore do not average out.

        Args:
            point: Centers [R], shape (n, 3).
            prior: Information of a prior [R^-2], shape (n,).
            shared: Covariance of each robot's partners, and 0 for the world [R^2], (N + 1, 3, 3).

        Returns:
            Covariance if partners' errors are independent, which rows are weighted by, and if
            partners are off by the same vector [R^2], both of shape (n, 3, 3).
        """
        normal = self.residual(point[:, None])[0][:, 0]
        weighted = self.precision[:, None, None] * outer(normal)
        information = self.sum(weighted)
        least = np.maximum(prior, _LEAST * np.trace(information, axis1=1, axis2=2))
        of_prior = least[:, None, None] * np.eye(3)
        inverse = inverted(information + of_prior)
        # Rows of infinite variance have no weight; 0 times infinity would be NaN.
        share = np.where(self.precision > 0.0, self.ties.variance, 0.0) * self.precision
        noise = self.sum(share[:, None, None] * weighted) + of_prior
        is_tied = self.ties.partner < len(shared) - 1
        tied = (self.precision * is_tied)[:, None, None]
        mean = self.sum(tied * shared[self.ties.partner]) / np.maximum(self.sum(tied), _TINY)
        moved = inverse @ self.sum(is_tied[:, None, None] * weighted)
        return inverse, inverse @ noise @ inverse + moved @ mean @ moved.swapaxes(1, 2)

    def open_axes(self, point: Reals, least: Reals) -> Bools:
        """Find coordinates along which rows alone give less than some information [R^-2].

        Args:
            point: Centers [R], shape (n, 3).
            least: Least information along each direction, shape (n,).

        Returns:
            Coordinates, shape (n, 3); at least one where the rank is below `POINTS`.
        """
        normal = self.residual(point[:, None])[0][:, 0]
        information = self.sum(outer(normal) / self.ties.variance[:, None, None])
        square, axis = np.linalg.eigh(information)
        is_open = square < np.maximum(least, _DAMPING * square[:, 2])[:, None]
        is_open[:, 0] |= self.rank() < POINTS
        share = (axis**2 @ is_open[:, :, None])[:, :, 0]
        return np.asarray(share > INDEPENDENT**2)


def length(vector: Reals) -> Reals:
    """Compute the lengths of vectors (..., 3)."""
    square: Reals = (vector**2).sum(axis=-1)
    return np.sqrt(square)


def unit(vector: Reals) -> Reals:
    """Divide vectors (..., 3) by their lengths; 0 stays 0."""
    divisor = length(vector)[..., None]
    return np.divide(vector, divisor, out=np.zeros_like(vector), where=divisor > 0.0)


def outer(vector: Reals) -> Reals:
    """Multiply vectors (..., k) with themselves, shape (..., k, k)."""
    return vector[..., :, None] * vector[..., None, :]


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
    rows = measure(log, params.used_cues)
    placed = place(
        log, rows, non_overlap=params.cues.non_overlap, in_join_order=params.order == "join"
    )
    position = placed.position
    unit_length = log.dock_radius
    is_guess = np.logical_not(placed.is_located)
    assessment = assess(log, params.used_cues, position, is_guess=is_guess, sd=placed.sd)
    gap = rows.residual(position)[: len(rows.neighbor)]
    return Estimate(
        robot_id=log.robot_id,
        position=position * unit_length,
        undetermined=placed.undetermined,
        **assessment.fields(disconnected(rows), unit_length),
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
        self.non_overlap = non_overlap
        self.is_gone = log.is_gone
        self.part = connected_parts(rows)
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
        hops = [0 for _ in range(self.robots)]
        partner = np.where(self.ties.partner < self.robots, self.ties.partner, 0)
        for i, j in zip(self.ties.robot.tolist(), partner.tolist(), strict=True):
            hops[i] = max(hops[i], hops[j] + 1) if i else 0
        for hop in range(1, max(hops) + 1):
            robots = np.flatnonzero(np.array(hops) == hop)
            self._try(robots)
            is_determined = ~self.undetermined[robots].any(axis=1)
            self._locate(robots[is_determined])
            if not is_determined.all():
                self._guess(robots[~is_determined])

    def place_by_hops(self) -> None:
        """Place robots as soon as located ones determine their positions; then all others."""
        waiting = np.flatnonzero(~self.is_placed)
        robots = waiting
        while robots.size:
            self._try(robots)
            determined = np.flatnonzero(~self.is_placed[:-1] & ~self.undetermined.any(axis=1))
            # The sharpest first: what they are placed by is in the errors of all later ones.
            variance = np.trace(self.covariance[determined], axis1=1, axis2=2)
            located = determined[variance <= _SHARP**2 * variance.min(initial=np.inf)]
            if not located.size and len(robots) == len(waiting):
                break
            self._locate(located)
            waiting = np.flatnonzero(~self.is_placed)
            tied = np.intersect1d(waiting, self.ties.robot[np.isin(self.ties.partner, located)])
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

    def _locate(self, robots: Ints) -> None:
        """Keep where robots are, for all that are placed by them."""
        self.is_located[robots] = True
        self.is_placed[robots] = True

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
        cost = misfit - favor
        every = np.arange(len(robots))
        chosen = cost.argmin(axis=1)
        position = point[every, chosen]
        odds = np.exp(-0.5 * np.minimum(np.abs(cost[:, 1] - cost[:, 0]), _MOST))
        mirrored = (odds / (1.0 + odds))[:, None, None] * outer(apart)
        self.position[robots] = position
        covariance, shared_covariance = rows.covariance(position, prior, self.shared_covariance)
        self.covariance[robots] = covariance + mirrored
        self.shared_covariance[robots] = shared_covariance + mirrored
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
        is_obstacle = self.is_placed[:-1] & ~self.is_gone
        obstacle = (self.position[:-1, None] + self.docks)[is_obstacle].reshape(-1, 3)
        dock = point[:, :, None] + self.docks[robots][:, None]
        square: Reals = ((nearest_overlap(dock, obstacle) / OVERLAP_SD) ** 2).sum(axis=2)
        square[self.is_gone[robots]] = 0.0
        return square
