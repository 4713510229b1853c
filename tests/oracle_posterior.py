"""Exact posteriors of small logs, by annealed importance sampling; slow, and independent of chains.

Robot 0 is the anchor. A log of final stances measures the centers p of the others by contacts,
heights and fixes. With the arms a and b of two docks that touch, as sensed, and their distance D,

    |v| = D + e,  v = p_j + b - p_i - a,  e ~ N(0, s^2)

The variance s^2 is that of the contact and that of the errors of both orientations, averaged over
all directions of v. Errors of contacts count as independent, as the annealer of `joint` takes them.
Heights and fixes are n . p = value, with normal errors. Docks that do not touch overlap by
max(2 - distance, 0), a normal error of the sd `OVERLAP_SD`. Centers have a normal prior that is far
wider than any structure.

**Annealing.** Variances of contacts grow by sigma^2, which falls from level to level; the overlap
enters with a power that grows to 1. Particles are weighed from level to level, drawn anew where few
carry the weight, and moved at each level (Neal, Annealed importance sampling, Stat. Comput. 11,
2001; Del Moral, Doucet and Jasra, Sequential Monte Carlo samplers, J. R. Stat. Soc. B 68, 2006).

**Moves.** If the error of v is normal and isotropic about D u, with u uniform on the sphere and
precision k, then the density of r = |v| is, up to a constant,

    g(r) = exp(-k (r - D)^2 / 2) (1 - exp(-2 k D r)) / (k D r)
    u given p: von Mises-Fisher about v / r, with concentration k D r
    p given u: normal, with one precision matrix for all particles

These two draws after each other leave g as it is, and are reversible. A Metropolis step corrects
what they propose for the true density, N(r; D, s^2), and for overlaps. Lengths in dock radii R.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tests.oracle import matrix
from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.records.sensing_log import SensingLog

SPACING = 2.0
"""D [R]."""

CONTACT_SD = 0.006
"""c: standard deviation of the distance of docks that touch [R]."""

HEIGHT_SD = 0.01
"""Standard deviation of a height, beside that of its flips [R]."""

FLIPS = 10
"""Flips that a height is taken to come from."""

OVERLAP_SD = 0.05
"""Standard deviation of an overlap [R]."""

PRIOR_SD = 100.0
"""Standard deviation of the prior of each coordinate [R]."""

_WIDEST, _NARROWEST = 6.0, 0.02
"""Standard deviation at the first level, and at the last one before 0 [R]."""

_WITHOUT_OVERLAPS = 0.25
"""Share of the levels at which docks may overlap freely [1]."""

_FIRST_POWER = 1e-4
"""Least power of the overlaps beyond these levels [1]."""

_FEWEST = 0.5
"""Effective share of the particles below which they are drawn anew [1]."""

_TINY = 1e-12


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Weighted draws of the centers of N robots."""

    position: Reals
    """Centers [R], shape (n, N, 3)."""

    weight: Reals
    """Weights, which add up to 1, shape (n,)."""

    acceptance: float
    """Share of the last moves that were accepted [1]."""

    @property
    def mean(self) -> Reals:
        """Posterior means [R], shape (N, 3)."""
        mean: Reals = np.tensordot(self.weight, self.position, 1)
        return mean

    @property
    def sd(self) -> Reals:
        """Root mean square distance from the mean [R], shape (N,)."""
        away = ((self.position - self.mean) ** 2).sum(axis=2)
        sd: Reals = np.sqrt(self.weight @ away)
        return sd

    @property
    def effective(self) -> float:
        """Effective number of draws [1]."""
        return float(1.0 / (self.weight**2).sum())

    def distances(self, place: Reals) -> Reals:
        """Distances of all draws from places (N, 3) [R], shape (n, N)."""
        away: Reals = np.linalg.norm(self.position - place, axis=2)
        return away

    @classmethod
    def of_both(cls, one: "Posterior", two: "Posterior") -> "Posterior":
        """Put together the draws of two independent runs."""
        return cls(
            position=np.concatenate([one.position, two.position]),
            weight=0.5 * np.concatenate([one.weight, two.weight]),
            acceptance=0.5 * (one.acceptance + two.acceptance),
        )


class _Sensed(NamedTuple):
    """What a log of N robots says: C contacts and Q coordinates. Lengths in R."""

    anchor: Reals
    """Center of the anchor, shape (3,)."""

    arm: Reals
    """From centers to docks, as sensed, shape (N, docks, 3)."""

    contact: Ints
    """Robot i, its dock, robot j and its dock of each contact, shape (C, 4)."""

    turn_sd: Reals
    """Standard deviations of the turns of each robot along the axes [rad], shape (3,)."""

    robot: Ints
    """Robot of each coordinate, shape (Q,)."""

    normal: Reals
    """n, shape (Q, 3)."""

    value: Reals
    """Measured coordinates, shape (Q,)."""

    variance: Reals
    """Variances of these, shape (Q,)."""

    is_apart: Bools
    """Pairs of docks that do not touch, numbered robot after robot; each pair counts once, shape (N
    docks, N docks)."""

    @property
    def robots(self) -> int:
        """N."""
        return len(self.arm)


def _sensed(log: SensingLog) -> _Sensed:
    """Read a log that has final contacts, heights and fixes, and nothing else that counts."""
    assert log.stances is None, "the oracle knows final stances alone"
    assert log.noise is not None
    assert not len(log.ground_docks)
    assert not len(log.ranges)
    unit = log.dock_radius
    tilt, yaw = np.radians([log.noise.tilt_deg, log.noise.yaw_deg])
    arm = np.array([log.dock_offset_body @ matrix(q).T for q in log.orientation_wxyz]) / unit
    high = np.flatnonzero(np.isfinite(log.flip_height))
    high = high[high > 0]
    reach = np.linalg.norm(log.dock_offset_body, axis=1).max() / unit
    height_variance = HEIGHT_SD**2 + FLIPS * (2.0 * reach * tilt) ** 2
    fixes = log.fixes[log.fixes[:, 0] > 0]
    length = np.linalg.norm(fixes[:, 1:4], axis=1)
    docks = arm.shape[1]
    contact = log.contacts.astype(np.int64)
    dock = np.arange(len(arm) * docks)
    is_apart = dock[:, None] // docks < dock // docks
    one = contact[:, 0] * docks + contact[:, 1]
    two = contact[:, 2] * docks + contact[:, 3]
    is_apart[one, two] = False
    is_apart[two, one] = False
    return _Sensed(
        anchor=log.anchor_position / unit,
        arm=arm,
        contact=contact,
        turn_sd=np.array([tilt, tilt, yaw]),
        robot=np.concatenate([high, fixes[:, 0].astype(np.int64)]),
        normal=np.concatenate(
            [np.tile([0.0, 0.0, 1.0], (len(high), 1)), fixes[:, 1:4] / length[:, None]]
        ),
        value=np.concatenate([log.flip_height[high] / unit, fixes[:, 4] / length / unit]),
        variance=np.concatenate(
            [np.full(len(high), height_variance), (fixes[:, 5] / length / unit) ** 2]
        ),
        is_apart=is_apart,
    )


class _Sampler:
    """Particles of one log at one level after the other, n of them."""

    def __init__(self, sensed: _Sensed, particles: int, seed: int) -> None:
        """Lay out the linear rows: contacts, coordinates, and the prior."""
        self.sensed = sensed
        self.random = np.random.default_rng(seed)
        self.particles = particles
        i, a, j, b = sensed.contact.T
        arms = sensed.arm[i, a], sensed.arm[j, b]
        self.beyond = arms[1] - arms[0]
        self.variance = CONTACT_SD**2 + sum(_mean_variance(arm, sensed.turn_sd) for arm in arms)
        robots = sensed.robots
        contacts = len(i)
        ends = np.zeros((contacts, robots))
        ends[np.arange(contacts), j] += 1.0
        ends[np.arange(contacts), i] -= 1.0
        of_contacts = np.kron(ends, np.eye(3))
        of_places = np.zeros((len(sensed.robot), robots, 3))
        of_places[np.arange(len(sensed.robot)), sensed.robot] = sensed.normal
        rows = np.concatenate([of_contacts, of_places.reshape(-1, 3 * robots)])
        # The anchor is known: its columns are constants.
        self.rows = np.concatenate([rows[:, 3:], np.eye(3 * robots - 3)])
        self.constant = np.concatenate([
            rows[:, :3] @ sensed.anchor + np.concatenate([self.beyond.ravel(), -sensed.value]),
            -np.tile(sensed.anchor, robots - 1),
        ])  # fmt: skip

    def vectors(self, position: Reals) -> tuple[Reals, Reals]:
        """Compute u, shape (n, C, 3), and r, shape (n, C)."""
        i, _, j, _ = self.sensed.contact.T
        vector = position[:, j] - position[:, i] + self.beyond
        length = np.maximum(np.linalg.norm(vector, axis=2), _TINY)
        return vector / length[:, :, None], length

    def overlap(self, position: Reals) -> Reals:
        """Compute half of the squared overlaps in variances, shape (n,)."""
        point = (position[:, :, None] + self.sensed.arm).reshape(len(position), -1, 3)
        square = (point**2).sum(axis=2)
        between = square[:, :, None] + square[:, None] - 2.0 * point @ point.transpose(0, 2, 1)
        particle, one, two = np.nonzero((between < SPACING**2) & self.sensed.is_apart)
        distance = np.sqrt(np.maximum(between[particle, one, two], 0.0))
        half = 0.5 * ((SPACING - distance) / OVERLAP_SD) ** 2
        return np.bincount(particle, half, len(position)).astype(np.float64)

    def log_density(self, position: Reals, sigma: float) -> Reals:
        """Log density of contacts, up to a constant, shape (n,); other rows do not change."""
        away = self.vectors(position)[1] - SPACING
        log_density: Reals = -0.5 * (away**2 / (self.variance + sigma**2)).sum(axis=1)
        return log_density

    def factor(self, position: Reals, sigma: float) -> Reals:
        """Log ratio of N(r; D, s^2) to g(r), summed over contacts, up to a constant, shape (n,)."""
        twice = 2.0 * SPACING * self.vectors(position)[1] / (self.variance + sigma**2)
        ratio: Reals = -np.log(-np.expm1(-twice) / twice).sum(axis=1)
        return ratio

    def level(self, sigma: float) -> tuple[Reals, Reals, Reals]:
        """Weights of all rows, and the covariance of places given directions with its factor."""
        weight = np.concatenate([
            np.repeat(1.0 / (self.variance + sigma**2), 3),
            1.0 / self.sensed.variance,
            np.full(3 * self.sensed.robots - 3, PRIOR_SD**-2),
        ])  # fmt: skip
        covariance = np.linalg.inv(self.rows.T @ (weight[:, None] * self.rows))
        covariance = 0.5 * (covariance + covariance.T)
        return weight, covariance, np.linalg.cholesky(covariance)

    def drawn(self, at_level: tuple[Reals, Reals, Reals], direction: Reals) -> Reals:
        """Draw places given the directions of contacts, (n, C, 3), shape (n, N, 3)."""
        weight, covariance, factor = at_level
        missed = np.tile(self.constant, (self.particles, 1))
        components = direction[0].size
        missed[:, :components] -= SPACING * direction.reshape(self.particles, -1)
        mean = -(missed * weight) @ self.rows @ covariance
        place = mean + self.random.normal(size=mean.shape) @ factor.T
        moving = place.reshape(self.particles, -1, 3)
        anchor = np.tile(self.sensed.anchor, (self.particles, 1, 1))
        return np.concatenate([anchor, moving], axis=1)

    def proposed(self, position: Reals, at_level: tuple[Reals, Reals, Reals]) -> Reals:
        """Draw directions given places, and places given these."""
        direction, length = self.vectors(position)
        precision = at_level[0][: 3 * length.shape[1] : 3]
        concentration = precision * SPACING * length
        share = self.random.random(length.shape)
        # The inverse of the distribution function of the cosine, exact in three dimensions.
        cosine = np.log(share + (1.0 - share) * np.exp(-2.0 * concentration)) / concentration
        cosine = np.clip(1.0 + cosine, -1.0, 1.0)[:, :, None]
        across = self.random.normal(size=direction.shape)
        across -= (across * direction).sum(axis=2, keepdims=True) * direction
        across /= np.linalg.norm(across, axis=2, keepdims=True)
        return self.drawn(at_level, cosine * direction + np.sqrt(1.0 - cosine**2) * across)


def _mean_variance(arm: Reals, turn_sd: Reals) -> Reals:
    """Average the variance of r by turns of arms (C, 3) over all directions, shape (C,).

    A turn w moves a dock by w x a, along u by w . (a x u); the mean square of a component of a x u
    is that of the components of a across it, over 3.
    """
    square = arm**2
    across = square.sum(axis=1, keepdims=True) - square
    mean: Reals = across @ turn_sd**2 / 3.0
    return mean


def posterior(
    log: SensingLog, *, seed: int, particles: int = 256, levels: int = 80, sweeps: int = 3
) -> Posterior:
    """Draw from the posterior of a log.

    Args:
        log: Final contacts, heights and fixes of N robots.
        seed: Number of the run; runs of different numbers are independent.
        particles: n.
        levels: Levels, from the widest one to 0.
        sweeps: Moves at each level.
    """
    sampler = _Sampler(_sensed(log), particles, seed)
    random = sampler.random
    free = round(_WITHOUT_OVERLAPS * levels)
    sigmas = [*np.geomspace(_WIDEST, _NARROWEST, levels - 1).tolist(), 0.0]
    powers = [*[0.0] * free, *np.geomspace(_FIRST_POWER, 1.0, levels - free).tolist()]
    # The first draw is of a law in which v is normal about 0: one Gaussian.
    at_level = sampler.level(sigmas[0])
    contacts = len(sampler.sensed.contact)
    position = sampler.drawn(at_level, np.zeros((particles, contacts, 3)))
    precision = at_level[0][: 3 * contacts : 3]
    length = sampler.vectors(position)[1]
    log_weight = 0.5 * (precision * (length**2 - (length - SPACING) ** 2)).sum(axis=1)
    overlap = sampler.overlap(position)
    accepted: list[float] = []
    for k, (sigma, power) in enumerate(zip(sigmas, powers, strict=True)):
        if k:
            log_weight += sampler.log_density(position, sigma)
            log_weight -= sampler.log_density(position, sigmas[k - 1])
            log_weight -= (power - powers[k - 1]) * overlap
        weight = _normalized(log_weight)
        if 1.0 / (weight**2).sum() < _FEWEST * particles and k < levels - 1:
            chosen = _chosen(weight, random)
            position = position[chosen]
            overlap = overlap[chosen]
            log_weight = np.zeros(particles)
        at_level = sampler.level(sigma)
        for _ in range(sweeps):
            candidate = sampler.proposed(position, at_level)
            candidate_overlap = sampler.overlap(candidate)
            gain = sampler.factor(candidate, sigma) - sampler.factor(position, sigma)
            gain -= power * (candidate_overlap - overlap)
            is_accepted = np.log(random.random(particles)) < gain
            position = np.where(is_accepted[:, None, None], candidate, position)
            overlap = np.where(is_accepted, candidate_overlap, overlap)
            accepted.append(float(is_accepted.mean()))
    weight = _normalized(log_weight)
    return Posterior(position=position, weight=weight, acceptance=float(np.mean(accepted[-9:])))


def _normalized(log_weight: Reals) -> Reals:
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    return weight


def _chosen(weight: Reals, random: np.random.Generator) -> Ints:
    """Draw particles by their weights, systematically, shape (n,)."""
    at = (random.random() + np.arange(len(weight))) / len(weight)
    chosen = np.searchsorted(np.cumsum(weight), at)
    return np.minimum(chosen, len(weight) - 1).astype(np.int64)
