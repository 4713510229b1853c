"""What a log says about positions, as equations with a standard deviation.

A contact of robot i with robot j, felt at any stance of i, says |p_i + c - p_j| = D with p the
final centers and c known: a flip moves a center by what the orientations before and after say.
Heights, ground and odometry say where a center is, coordinate by coordinate. Each variance
follows from the noise of every orientation that went into it. Lengths in dock radii.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from tiswarm.localization.joint.force_kernels import SPACING
from tiswarm.localization.joint.path import CENTER, Path
from tiswarm.localization.joint.reach import reach
from tiswarm.localization.params import JointParams
from tiswarm.measurements.consistency import ALLOWED_SD, ASSUMED
from tiswarm.measurements.contacts import touching
from tiswarm.records.sensing_log import SensingLog, Stances

CLEARANCE = 10.0
"""Least distance between parts of the contact graph that no measurement ties to each other [R]:
more than docks of two robots that could overlap."""
FLIPS_UNTOLD = 10
"""Flips that a height is taken to come from where the log has no stances."""


class Told(NamedTuple):
    """What tells each coordinate of where N robots are, if anything does."""

    row: NDArray[np.int64]
    """Stance in the walks, shape (N, 3)."""

    dock: NDArray[np.int64]
    """Dock whose coordinate was known there, or CENTER, shape (N, 3)."""

    variance: NDArray[np.float64]
    """Of what was known, without noise of orientations; infinite if nothing was, shape (N, 3)."""

    @classmethod
    def nothing(cls, robots: int) -> "Told":
        """Nothing yet."""
        shape = (robots, 3)
        return cls(np.zeros(shape, np.int64), np.zeros(shape, np.int64), np.full(shape, np.inf))

    @property
    def is_known(self) -> NDArray[np.bool_]:
        """Whether anything tells it, shape (N, 3)."""
        return np.isfinite(self.variance)


@dataclass(frozen=True, kw_only=True)
class Equations:
    """Equations of one structure of N robots; none of them is about the anchor alone."""

    robot: NDArray[np.int64]
    """Robot i that felt each contact, shape (C,)."""

    other: NDArray[np.int64]
    """Robot j that it touched, which joined earlier, shape (C,)."""

    felt: NDArray[np.int64]
    """The contacts themselves, as `felt_contacts` has them, shape (C, 5)."""

    shift: NDArray[np.float64]
    """c, shape (C, 3)."""

    lever: NDArray[np.float64]
    """From each of the two final centers to the dock, x and y of either, shape (C, 4)."""

    variance: NDArray[np.float64]
    """Of the distance, shape (C,)."""

    is_final: NDArray[np.bool_]
    """Whether the contact is of the final stance, shape (C,)."""

    place: NDArray[np.float64]
    """Where each center is known to be, shape (N, 3)."""

    precision: NDArray[np.float64]
    """One over the variance of each coordinate of `place`, 0 where unknown, shape (N, 3)."""

    unobserved: NDArray[np.bool_]
    """Coordinates of disconnected parts that no measurement ties to the anchor, shape (N, 3). The
    first robot of such a part is held at a place of its own, far from all other parts."""

    walk: NDArray[np.float64]
    """Part of x and y of `place` that is the robot's own walk, to be turned back by the yaw that it
    has been turned; added to `place` here, shape (N, 2)."""

    unplaced: NDArray[np.bool_]
    """Axes along which nothing but contacts tells where robots are, shape (3,)."""

    part: NDArray[np.int32]
    """Connected part of the contact graph that each robot is in, shape (N,)."""

    untied: NDArray[np.bool_]
    """Robots that no chain of contacts ties to one whose place is known, shape (N,)."""

    yaw_precision: float
    """One over the variance of a bias of yaw that is solved for [rad^-2], 0 if none is."""

    path: Path
    """Walks that all of this was felt on."""

    told: Told
    """What tells where centers are."""

    own_variance: float
    """Part of the contacts' variance that is no noise of orientations."""

    @property
    def shortage(self) -> float:
        """By how much equations are too few, relative to unknown coordinates (Maxwell's count)."""
        known = len(self.robot) + np.count_nonzero(self.precision[1:])
        return max(0.0, 1.0 - known / max(self.place[1:].size, 1))

    @property
    def sensed_place(self) -> NDArray[np.float64]:
        """Where each center is known to be, its yaw taken as it is sensed, shape (N, 3)."""
        place: NDArray[np.float64] = self.place - np.pad(self.walk, ((0, 0), (0, 1)))
        return place

    @property
    def fewest(self) -> NDArray[np.int64]:
        """Contacts at the end, of the two robots of each contact the fewer, at least 1, (C,)."""
        pair = np.column_stack([self.robot, self.other])
        count = np.bincount(pair[self.is_final].ravel(), minlength=len(self.place))
        fewest: NDArray[np.int64] = np.maximum(count[pair].min(axis=1), 1)
        return fewest

    def reach(
        self, tolerance: float = 0.0, trusted: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float64]:
        """Bound the distance of each robot from the first one of its part [R], shape (N,).

        Args:
            tolerance: By how much contacts may be missed, beside their noise [R].
            trusted: Contacts that count, shape (C,); all if None.
        """
        level = np.linalg.norm(self.lever[:, :2], axis=1) + np.linalg.norm(
            self.lever[:, 2:], axis=1
        )
        # Robots whose yaw is solved for may turn the horizontal parts of the vector.
        turned = np.hypot(level, self.shift[:, 2])
        fixed = turned if self.yaw_precision else np.linalg.norm(self.shift, axis=1)
        longest = fixed + SPACING + ALLOWED_SD * np.sqrt(self.variance + tolerance**2)
        pair = np.column_stack([self.robot, self.other])
        counts = slice(None) if trusted is None else trusted
        return reach(pair[counts], longest[counts], self.part)

    def lengths(
        self, position: NDArray[np.float64], yaw: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Distance of the docks of each contact, shape (..., C).

        Args:
            position: Final centers, shape (..., N, 3).
            yaw: How far each robot is turned from what it senses [rad], shape (..., N).
        """
        apart = position[..., self.robot, :] + self.shift - position[..., self.other, :]
        own, its = np.exp(1j * yaw[..., self.robot]) - 1.0, np.exp(1j * yaw[..., self.other]) - 1.0
        x, y, its_x, its_y = self.lever.T
        turned = own * (x + 1j * y) - its * (its_x + 1j * its_y)
        apart[..., 0] += turned.real
        apart[..., 1] += turned.imag
        length: NDArray[np.float64] = np.linalg.norm(apart, axis=-1)
        return length


def equations(log: SensingLog, params: JointParams) -> Equations:
    """Write down what a log says, as far as its cues are on.

    Args:
        log: What was sensed.
        params: Cues, and the noise of what the log does not tell the noise of.
    """
    noise = log.noise or ASSUMED
    bias = np.radians(noise.yaw_bias_deg or 0.0)
    is_solved = params.solve_yaw and bias > 0.0
    if is_solved:
        noise = replace(noise, yaw_bias_deg=0.0)
    path = Path(log, log.stances or _no_stances(log), noise)
    contact, is_final = _contacts(log, path, params)
    row, own, other, dock = contact.T
    robot = path.owner[row]
    place, precision, told = _places(log, path, params)
    # x and y are not told by anything but odometry.
    walk = np.where(told.is_known[:, :2] & is_solved, path.shift[path.first, :2], 0.0)
    unplaced: NDArray[np.bool_] = np.logical_not(np.any(precision[1:] > 0.0, axis=0))
    is_placed: NDArray[np.bool_] = np.asarray((precision > 0.0).all(axis=1))
    is_placed[0] = True
    graph = touching(np.column_stack([robot, other]), log.robot_count)
    _, part = connected_components(graph, directed=False)
    untied = ~np.isin(part, part[is_placed])
    shift, variance = path.docks(row, own)
    its, its_variance = path.docks(path.final[other], dock)
    measured = np.zeros((part.max() + 1, 3), np.bool_)
    np.logical_or.at(measured, part, precision > 0.0)
    unobserved: NDArray[np.bool_] = untied[:, None] & ~measured[part]
    known = Equations(
        robot=robot,
        other=other,
        felt=np.column_stack([robot, row - path.first[robot], own, other, dock]),
        shift=shift - its,
        lever=np.column_stack([shift[:, :2], its[:, :2]]),
        # The direction is unknown before the positions are: the mean over all directions.
        variance=(variance + its_variance).mean(axis=1) + params.contact_sd**2,
        is_final=is_final,
        place=place + np.pad(walk, ((0, 0), (0, 1))),
        precision=precision,
        unobserved=unobserved,
        walk=walk,
        unplaced=unplaced,
        part=part,
        untied=untied,
        yaw_precision=bias**-2 if is_solved else 0.0,
        path=path,
        told=told,
        own_variance=params.contact_sd**2,
    )
    return _separated(known, log.anchor_position / log.dock_radius, params.height_sd)


def _separated(known: Equations, anchor: NDArray[np.float64], sd: float) -> Equations:
    """Hold the first robot of each disconnected part at a place where no other part can be.

    Parts that overlap would push each other, though nothing measures where they are. They stand in
    a row along x, which odometry alone measures; robots with odometry are not disconnected.
    """
    first = np.unique(known.part, return_index=True)[1]
    size = np.zeros(len(first))
    np.maximum.at(size, known.part, known.reach())
    first = np.sort(first[known.untied[first]])
    row = np.r_[0, first]
    width = size[known.part[row]] + CLEARANCE
    place, precision = known.place.copy(), known.precision.copy()
    middle = anchor[0] + np.cumsum(width[1:] + width[:-1])
    for i, x in zip(first.tolist(), middle.tolist(), strict=True):
        held = known.unobserved[i]
        place[i, held] = np.array([x, anchor[1], anchor[2]])[held]
        precision[i, held] = sd**-2
    return replace(known, place=place, precision=precision)


def _no_stances(log: SensingLog) -> Stances:
    return Stances(
        start=np.zeros(log.robot_count + 1, np.int64),
        orientation_wxyz=np.empty((0, 4)),
        pivot_dock=np.empty(0, np.int32),
        contacts=np.empty((0, 4), np.int32),
        ground_docks=np.empty((0, 2), np.int32),
    )


def _contacts(
    log: SensingLog, path: Path, params: JointParams
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Rows of (stance, own dock, other robot, its dock), sorted, and whether each is final."""
    rows: NDArray[np.int64] = np.empty((0, 4), np.int64)
    sizes = (len(path.owner) + 1, len(log.dock_offset_body), log.robot_count)
    if params.contacts:
        final = log.contacts.astype(np.int64)
        rows = np.column_stack([path.final[final[:, 2]], final[:, 3], final[:, :2]])
    if params.walk_contacts and log.stances is not None:
        felt = log.stances.contacts.astype(np.int64)
        felt[:, 0] = path.row[felt[:, 0]]
        # A dock that stays put says the same thing at the next stance again.
        pivot = log.stances.pivot_dock[log.stances.contacts[:, 0]]
        every = _numbered(np.concatenate([felt, rows]), sizes)
        again = np.isin(_numbered(felt + np.array([1, 0, 0, 0]), sizes), every)
        rows = np.concatenate([rows, felt[~(again & (felt[:, 1] == pivot))]])
    _, first = np.unique(_numbered(rows, sizes), return_index=True)
    rows = rows[first]
    return rows, np.isin(rows[:, 0], path.final)


def _numbered(rows: NDArray[np.int64], sizes: tuple[int, int, int]) -> NDArray[np.int64]:
    """One number for each row of (stance, own dock, other robot, its dock), shape (n,)."""
    stances, docks, robots = sizes
    number: NDArray[np.int64] = np.ravel_multi_index(tuple(rows.T), (stances, docks, robots, docks))
    return number


def _places(
    log: SensingLog, path: Path, params: JointParams
) -> tuple[NDArray[np.float64], NDArray[np.float64], Told]:
    """What is known of each coordinate of each center: the surest of all that tells it.

    Returns:
        Coordinates and one over their variance, both of shape (N, 3), and what told them.
    """
    place = np.zeros((log.robot_count, 3))
    variance = np.full((log.robot_count, 3), np.inf)
    told = Told.nothing(log.robot_count)
    start, start_variance = path.starts()

    def learn(
        row: NDArray[np.int64],
        dock: NDArray[np.int64],
        axis: int,
        at: NDArray[np.float64],
        sure: NDArray[np.float64],
        apart: float,
    ) -> None:
        robot = path.owner[row]
        order = np.lexsort((-sure, robot))  # of a robot's rows the surest comes last
        order = order[np.isfinite(at[order]) & (sure[order] < variance[robot[order], axis])]
        mine = robot[order], axis
        place[mine], variance[mine] = at[order], sure[order]
        told.row[mine], told.dock[mine], told.variance[mine] = row[order], dock[order], apart

    center = np.full(log.robot_count, CENTER)
    height_variance = params.height_sd**2
    if params.height:
        walked = start_variance[:, 2]
        if log.stances is None:
            reach = np.linalg.norm(log.dock_offset_body, axis=1).max() / log.dock_radius
            walked = np.full(log.robot_count, FLIPS_UNTOLD * (2.0 * reach * path.tilt) ** 2)
        height = log.flip_height / log.dock_radius
        learn(path.first, center, 2, height, walked + height_variance, height_variance)
    if params.ground and log.ground_z is not None:
        row, dock = _grounded(log, path, params).T
        at, sure = path.docks(row, dock)
        height = log.ground_z / log.dock_radius + 1.0 - at[:, 2]
        learn(row, dock, 2, height, sure[:, 2] + height_variance, height_variance)
    if params.odometry:
        spawn = None if log.noise is None else log.noise.spawn
        spawn_sd = params.spawn_sd if spawn is None else spawn / log.dock_radius
        apart = spawn_sd**2 + height_variance
        for axis in range(3):
            at = log.spawn_position[:, axis] / log.dock_radius - start[:, axis]
            learn(path.first, center, axis, at, start_variance[:, axis] + apart, apart)
    return place, 1.0 / variance, told


def _grounded(log: SensingLog, path: Path, params: JointParams) -> NDArray[np.int64]:
    """Docks on flat ground, rows of (stance, dock)."""
    final = log.ground_docks.astype(np.int64)
    rows = np.column_stack([path.final[final[:, 0]], final[:, 1]])
    if params.walk_contacts and log.stances is not None:
        felt = log.stances.ground_docks.astype(np.int64)
        felt[:, 0] = path.row[felt[:, 0]]
        rows = np.concatenate([rows, felt])
    return np.unique(rows, axis=0)
