"""Where a robot stood at each of its stances, seen from its final center, and how noisy that is.

A flip moves a center by what the orientations before and after say, so the noise of one stance is
in everything the robot sensed there and before. Lengths in R, angles in rad.

Orientations of robots without a compass are chained by connections. A connection says how robot j
is turned seen from robot i, Q = R_i^T R_j. With turns d of the orientations in the world frame,
R -> exp(d) R, its residual log(R_i Q R_j^T) changes by d_i - d_j. Noise of a connection is alike
about all axes. So the sum of squares over all connections is least where one sparse linear system
is solved for each axis: the Laplacian of the graph of connections (rotation averaging; Hartley et
al., "Rotation averaging", IJCV 2013). Compasses stay as they are: what they gain from connections
is small, and least squares over all measurements finds it.
"""

import math
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.csgraph import breadth_first_order
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.math import dock_offsets, normal
from tiswarm.compute.normal_equations import factored
from tiswarm.records.sensing_log import LISTS, SensingLog, SensingNoise, Stances

ASSUMED = SensingNoise(tilt_deg=1.0, yaw_deg=2.0)
"""Noise of a log that states none."""

LINK_SD = math.radians(1.0)
"""Standard deviation of a direction or connection about each axis, of a log that states none."""

_LEAST_SD = 1e-7
"""Noise of connections below this counts as this much."""

_HELD = 1e6
"""Precision of what stays as it is, in those of a connection."""

_ROUNDS = 4
"""Linear problems solved, each at where the last one led."""

_DRAWS = 64
"""Draws of all errors from which variances are computed, to some 10 %."""


class Connections(NamedTuple):
    """Q connections between robots whose orientations are known by now."""

    robot: Ints
    """Robot that sensed each, shape (Q,)."""

    neighbor: Ints
    """Robot that it sensed, shape (Q,)."""

    residual: Reals
    """log(R_i Q R_j^T), in the world frame, shape (Q, 3)."""

    sd: float
    """Standard deviation about each axis."""

    is_chained: Bools
    """Robots whose orientation follows from connections, shape (N,)."""


def with_orientations(log: SensingLog) -> SensingLog:
    """Chain the orientations of robots without a compass from those of robots with one.

    Robots to which no connections lead have no orientation that their docks could be turned by:
    all that these docks sensed is left out, so that such robots count as disconnected. A bias of
    yaw, if the log states one, counts as noise of the compasses.

    Returns:
        The log with the orientations of all robots and their `orientation_sd`; the log itself if
        all robots have a compass.
    """
    is_missing: Bools = np.isnan(log.orientation_wxyz[:, 0])
    if not is_missing.any():
        return log
    guess, is_lost = _chained(log, is_missing)
    noise = log.noise or ASSUMED
    yaw_deg = min(math.hypot(noise.yaw_deg, noise.yaw_bias_deg or 0.0), 180.0)
    oriented = replace(
        _without(log, is_lost),
        orientation_wxyz=guess,
        noise=replace(noise, yaw_deg=yaw_deg, yaw_bias_deg=None),
    )
    wxyz, sd = _averaged(oriented, is_missing & ~is_lost)
    sd[~is_missing] = np.nan
    return replace(oriented, orientation_wxyz=wxyz, orientation_sd=sd)


def connections_of(log: SensingLog) -> Connections:
    """Look up the connections of final stances; all robots of the log have orientations."""
    robot, partner = log.connections[:, [0, 2]].astype(np.int64).T
    orientation = Rotation.from_quat(log.orientation_wxyz, scalar_first=True)
    turn = Rotation.from_quat(log.connections[:, 4:], scalar_first=True)
    stated = log.stated(LISTS["connections"].noise)
    sd = LINK_SD if stated is None else math.radians(stated)
    residual = (orientation[robot] * turn * orientation[partner].inv()).as_rotvec()
    chained = np.zeros((len(orientation), 2)) if log.orientation_sd is None else log.orientation_sd
    return Connections(robot, partner, residual, max(sd, _LEAST_SD), ~np.isnan(chained[:, 0]))


def _averaged(log: SensingLog, is_chained: Bools) -> tuple[Reals, Reals]:
    """Average the rotations of some robots, shape (N,), from a guess; the others stay.

    Returns:
        Orientations, shape (N, 4), and standard deviations about a horizontal axis and about the
        vertical, with the noise of the compasses that they follow from, shape (N, 2).
    """
    links = connections_of(log)
    robots = log.robot_count
    count = len(links.robot)
    weight = links.sd**-2.0
    sign = np.repeat([1.0, -1.0], count)
    row = np.tile(np.arange(count), 2)
    ends = np.concatenate([links.robot, links.neighbor])
    change: csc_array = csc_array((sign, (row, ends)), shape=(count, robots))
    hold = np.where(is_chained, 0.0, _HELD * weight)
    information = csc_array(weight * (change.T @ change) + diags_array(hold))
    factor = factored(information, pivots="any")
    # The matrix depends on the graph alone: one factorization serves all rounds.
    for _ in range(_ROUNDS):
        step = factor.solve(weight * (change.T @ connections_of(log).residual))
        step[~is_chained] = 0.0
        turned = Rotation.from_rotvec(-step) * Rotation.from_quat(
            log.orientation_wxyz, scalar_first=True
        )
        log = replace(log, orientation_wxyz=turned.as_quat(scalar_first=True))
    noise = log.noise or ASSUMED
    # Variances are the diagonal of an inverse that is dense; draws take one solve for all.
    draw = normal(0, "orientations", np.arange(count + robots)[:, None], np.arange(_DRAWS))
    pull = change.T @ draw[:count] / links.sd
    errors = [
        factor.solve(pull + hold[:, None] * math.radians(sd_deg) * draw[count:])
        for sd_deg in (noise.tilt_deg, noise.yaw_deg)
    ]
    sd = np.sqrt([(error**2).mean(axis=1) for error in errors]).T
    return log.orientation_wxyz, sd


def _chained(log: SensingLog, is_missing: Bools) -> tuple[Reals, Bools]:
    """Follow connections, the fewest to each robot, from robots with a compass.

    Returns:
        Orientations, shape (N, 4), and robots to which no connections lead, shape (N,).
    """
    robots = len(is_missing)
    pair = log.connections[:, [0, 2]].astype(np.int64)
    row_of = {ends: row for row, ends in enumerate(map(tuple, pair.tolist()))}
    with_compass = np.flatnonzero(~is_missing)
    world = np.full_like(with_compass, robots)  # leads to all compasses
    first, second = np.concatenate([pair, np.column_stack([world, with_compass])]).T
    graph = csr_array((np.ones(len(first)), (first, second)), shape=(robots + 1, robots + 1))
    # Errors add up along a chain: breadth first, each robot gets the shortest one.
    order, before = breadth_first_order(graph, robots, directed=False)
    turns = Rotation.from_quat(log.connections[:, 4:], scalar_first=True)
    wxyz = np.where(is_missing[:, None], [1.0, 0.0, 0.0, 0.0], log.orientation_wxyz)
    for i in order[is_missing[np.minimum(order, robots - 1)] & (order < robots)].tolist():
        j = int(before[i])
        seen = turns[row_of[i, j]].inv() if (i, j) in row_of else turns[row_of[j, i]]
        turned = Rotation.from_quat(wxyz[j], scalar_first=True) * seen
        wxyz[i] = turned.as_quat(scalar_first=True)
    is_lost = is_missing.copy()
    is_lost[order[order < robots]] = False
    return wxyz, is_lost


def _without(log: SensingLog, is_lost: Bools) -> SensingLog:
    """Leave out what docks of some robots, shape (N,), sensed or were sensed at, and vectors."""
    final = {}
    earlier = {}
    for name, key in LISTS.items():
        if key.is_of_body:
            ends = [0, 2] if key.is_of_docks else [0]
            rows = getattr(log, name)
            final[name] = rows[~is_lost[rows[:, ends].astype(np.int64)].any(axis=1)]
            if log.stances is not None and len(ends) > 1:
                rows = getattr(log.stances, name)
                earlier[name] = rows[~is_lost[rows[:, 2].astype(np.int64)]]
    return replace(log, **final, stances=log.stances and replace(log.stances, **earlier))


CENTER = -1
"""In place of a dock: the robot's center."""

UNKNOWN = -2
"""In place of a dock: one that the robot does not know. Its arm counts as 0."""


class Odometry:
    """All S stances of all robots, robot after robot, in time order; the final one comes last."""

    def __init__(self, log: SensingLog, noise: SensingNoise | None = None) -> None:
        """Sum every robot's flips backward from its final stance.

        Args:
            log: What was sensed; one that lists no stances has N, the final ones. Robots without a
                compass are turned as their connections say.
            noise: Noise of the orientations; that of the log, or `ASSUMED`, if None.
        """
        log = with_orientations(log)
        stances = log.earlier
        noise = noise or log.noise or ASSUMED
        robots = log.robot_count
        owner = np.concatenate([_owners(stances), np.arange(robots)])
        # Stable: a robot's stances stay in time order, and its final one, appended last, ends them.
        order = np.argsort(owner, kind="stable")
        self.owner: Ints = owner[order]
        """Robot of each stance, shape (S,)."""
        self.row = np.empty(len(order), np.int64)
        """Where each of the log's earlier stances, and then each final one, is, shape (S,)."""
        self.row[order] = np.arange(len(order))
        self.final = self.row[len(order) - robots :]
        """Final stance of each robot, shape (N,)."""
        self.first = np.r_[0, self.final[:-1] + 1]
        """First stance of each robot, shape (N,)."""
        self.tilt, self.yaw, self.bias = np.radians(
            [noise.tilt_deg, noise.yaw_deg, noise.yaw_bias_deg or 0.0]
        )
        self.turn_sd = np.tile([self.tilt, self.yaw], (len(order), 1))
        """Standard deviation of the orientation of each stance about a horizontal axis and about
        the vertical [rad], shape (S, 2). Errors of stances count as independent. Orientations that
        were chained by connections share errors; only `joint`'s refinement accounts for that."""
        if log.orientation_sd is not None:
            is_chained = ~np.isnan(log.orientation_sd[:, 0])
            self.turn_sd[self.final[is_chained]] = log.orientation_sd[is_chained]
        wxyz = np.concatenate([stances.orientation_wxyz, log.orientation_wxyz])[order]
        self.orientation_wxyz = wxyz
        """Sensed orientation at each stance, body to world, unit quaternion, shape (S, 4)."""
        self.arm = dock_offsets(wxyz, log.dock_offset_body) / log.dock_radius
        """Center to dock at each stance [R], shape (S, docks, 3)."""
        still = np.zeros((robots, 3))
        self.shift = np.concatenate([displacements(log, stances), still])[order] / log.dock_radius
        """From the final center to the center at each stance [R], shape (S, 3)."""
        pivot = np.r_[stances.pivot_dock, np.zeros(robots, np.int32)][order]
        self.pivot = np.where(np.isin(np.arange(len(order)), self.final), CENTER, pivot)
        """Dock that stays put while the robot leaves a stance; CENTER at the last, shape (S,)."""
        # A final stance is measured from the center itself.
        self.held = self.arm[np.arange(len(order)), pivot]
        self.held[self.final] = 0.0
        self.reached = self.arm[np.arange(len(order)), np.roll(pivot, 1)] - self.held
        """From the dock held by to the one that the stance was reached on [R], shape (S, 3)."""
        self.reached[self.first] = 0.0
        self.wide: Ints = np.empty(0, np.int64)
        """Robots whose orientations are hardly known: see `widened`, shape (K,)."""
        self.walked = self._variance_walked(self.turn_sd)
        """Variance of what lies between a stance and the final center [R^2], shape (S, 3)."""

    @property
    def axis_sd(self) -> Reals:
        """Standard deviation of each orientation about each axis of the world [rad], (S, 3)."""
        sd: Reals = self.turn_sd[:, [0, 0, 1]]
        return sd

    @property
    def is_earlier(self) -> Bools:
        """Which stances are not final ones, shape (S,)."""
        is_earlier = np.ones(len(self.owner), np.bool_)
        is_earlier[self.final] = False
        return is_earlier

    def widened(self, robots: Ints, sd: float) -> "Odometry":
        """Return a copy in which nothing better than `sd` [rad] is known of some orientations.

        Args:
            robots: Robots whose orientations these are, shape (K,).
            sd: Standard deviation about each axis [rad].
        """
        wider = copy(self)
        wider.wide = robots
        is_wide = np.isin(self.owner, robots)[:, None]
        wider.turn_sd = np.where(is_wide, np.maximum(sd, self.turn_sd), self.turn_sd)
        wider.walked = self._variance_walked(wider.turn_sd)
        return wider

    def _variance_walked(self, turn_sd: Reals) -> Reals:
        """Sum the variances of all flips after each stance, of orientations that noisy."""
        summed = np.cumsum(_turned(turn_sd, self.reached)[::-1], axis=0)[::-1]
        later = np.concatenate([summed[1:], np.zeros((1, 3))])
        # The sums run over all robots: take off what comes after the robot's own final stance.
        walked: Reals = later - later[self.final][self.owner]
        return walked

    def arms(self, stance: Ints, dock: Ints) -> tuple[Reals, Reals]:
        """Arms from final centers to docks, or centers, at some stances.

        Args:
            stance: Stances, shape (n,).
            dock: Dock of each, CENTER or UNKNOWN, shape (n,).

        Returns:
            Arms [R] and the variance of each of their coordinates [R^2], both of shape (n, 3).
        """
        offset = self._offset(stance, dock)
        at: Reals = self.shift[stance] + offset
        # The dock that the robot holds by stays put: noise of the stance turns the way from there.
        variance = self.walked[stance] + _turned(self.turn_sd[stance], offset - self.held[stance])
        if self.bias:
            # It turns the whole walk about the final center: (x, y) moves by (-y, x).
            variance[:, :2] += self.bias**2 * at[:, 1::-1] ** 2
        return at, variance

    def candidates(self, stance: Ints, dock: Ints) -> tuple[Reals, Reals]:
        """Compute `arms` of all docks that each may be: every one if UNKNOWN, else itself.

        Returns:
            Arms [R] and the variance of each of their coordinates [R^2], (n, docks, 3) both.
        """
        docks = self.arm.shape[1]
        every = np.where(dock[:, None] == UNKNOWN, np.arange(docks), dock[:, None])
        at, variance = self.arms(np.repeat(stance, docks), every.ravel())
        return at.reshape(-1, docks, 3), variance.reshape(-1, docks, 3)

    def _offset(self, stance: Ints, dock: Ints) -> Reals:
        """Vectors from centers to docks, 0 of CENTER and UNKNOWN [R], shape (n, 3)."""
        # CENTER and UNKNOWN are no docks: any index serves, since their arm becomes 0.
        at_dock = self.arm[stance, np.maximum(dock, CENTER)]
        return np.where((dock < 0)[:, None], 0.0, at_dock)

    def variance_along(
        self, axis: Reals, stance: Ints, dock: Ints, beyond: Reals | float = 0.0
    ) -> Reals:
        """Propagate the noise of orientations to components of such arms.

        Args:
            axis: Unit vector along each component, shape (n, 3).
            stance: Stances, shape (n,).
            dock: Dock of each, or CENTER, shape (n,).
            beyond: Vectors that begin there and that the stance turns too [R], shape (n, 3).

        Returns:
            Variance of each component [R^2], shape (n,).
        """
        # A turn w moves a part by w x part, whose component along the axis is w . (part x axis).
        sd = self.axis_sd
        first = np.cross(self.first_parts(stance, dock, beyond), axis) * sd[stance]
        shift = np.cross(np.eye(3), self.reached[:, None]) * sd[:, None]
        later = self.sums_of_later(shift @ shift.swapaxes(1, 2))[stance]
        noise = (first**2).sum(axis=1) + np.einsum("ni,nij,nj->n", axis, later, axis)
        x, y, _ = (self.arms(stance, dock)[0] + beyond).T
        variance: Reals = noise + self.bias**2 * (x * axis[:, 1] - y * axis[:, 0]) ** 2
        return variance

    def first_parts(self, stance: Ints, dock: Ints, beyond: Reals | float = 0.0) -> Reals:
        """Return the parts of such arms that the orientations of their own stances turn.

        The rest of an arm are the vectors `reached` of all later stances, each turned by its own
        orientation.

        Args:
            stance: Stances, shape (n,).
            dock: Dock of each, or CENTER, shape (n,).
            beyond: Vectors that begin there and that the stance turns too [R], shape (n, 3).

        Returns:
            Vectors from the dock held by to the end of the arm [R], shape (n, 3).
        """
        part: Reals = self._offset(stance, dock) + beyond - self.held[stance]
        return part

    def sums_of_later(self, value: Reals) -> Reals:
        """Sum values of all later stances of the same robot, shape (S, ...)."""
        last = len(value) - 1
        return _sums_before(value[::-1], last - self.final[::-1])[::-1]

    def sums_of_earlier(self, value: Reals) -> Reals:
        """Sum values of all earlier stances of the same robot, shape (S, ...)."""
        return _sums_before(value, self.first)


def _sums_before(value: Reals, first: Ints) -> Reals:
    """Sum what stands before each value in its group; groups begin at `first`, ascending."""
    # Each group ends with minus its own sum: sums of early groups do not round those of later ones.
    step = value.copy()
    step[first[1:] - 1] -= np.add.reduceat(value, first, axis=0)[:-1]
    total = np.zeros_like(value)
    np.cumsum(step[:-1], axis=0, out=total[1:])
    total[first] = 0.0
    return total


def _turned(turn_sd: Reals, arm: Reals) -> Reals:
    """Variance of each coordinate of arms (n, 3) that noisy orientations (n, 2) turn, (n, 3)."""
    x, y, z = arm.T**2
    tilt, yaw = turn_sd.T**2
    return np.column_stack([tilt * z + yaw * y, tilt * z + yaw * x, tilt * (x + y)])


def _owners(stances: Stances) -> Ints:
    """Find the robot of each earlier stance, shape (M,)."""
    count = np.diff(stances.start)
    return np.repeat(np.arange(len(count)), count)


def displacements(log: SensingLog, stances: Stances) -> Reals:
    """Vectors from each robot's final center to its center at every earlier stance, shape (M, 3).

    The dock at b that a robot flips about stays put, so its center moves by (R - R') b, with R
    and R' its orientations before and after; flips are summed backward from the last.
    """
    row = np.arange(len(stances.pivot_dock))
    is_last = np.zeros(len(row), np.bool_)
    # Robots that never walked list no earlier stance, hence no last one.
    is_last[stances.start[1:][np.diff(stances.start) > 0] - 1] = True
    before = dock_offsets(stances.orientation_wxyz, log.dock_offset_body)
    final = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    # After the last earlier stance comes the final one, which another table has.
    after = np.where(
        is_last[:, None],
        final[_owners(stances), stances.pivot_dock],
        before[(row + 1) % max(len(row), 1), stances.pivot_dock],
    )
    step = before[row, stances.pivot_dock] - after
    walked = np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)])
    moved: Reals = walked[:-1] - walked[stances.start[1:]][_owners(stances)]
    return moved


def stuck_robots(log: SensingLog) -> Ints:
    """Find the robots whose orientation sensors repeat one value while they flip, shape (K,)."""
    if log.stances is None:
        return np.empty(0, np.int64)
    flips = np.diff(log.stances.start)
    owner = np.repeat(np.arange(log.robot_count), flips)
    repeats = (log.stances.orientation_wxyz == log.orientation_wxyz[owner]).all(axis=1)
    same = np.bincount(owner, weights=repeats, minlength=log.robot_count)
    return np.flatnonzero((flips > 0) & (same == flips))
