"""Whole configurations beside one: moved as nothing resists, mirrored, or built from distances.

Ranges alone leave a swarm free to turn about its anchor, and do not exclude its mirror image.
Chains then differ by such motions, and their mean would be too small. Where measured distances fit
as a whole, chains start beside those of the annealer. Lengths in R.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Bools, Reals
from tiswarm.localization.chains.problem import Problem
from tiswarm.measurements.model import SPACING, Measurements

_UNRESISTED = 1e-6
"""Change of a measurement for each R of motion below which it does not resist [1]."""

_AXES = 3
MOST_ROBOTS = 1000
"""Robots beyond which the matrix of all distances takes too long."""

_RIDGE = 1e-6


class Frame(NamedTuple):
    """Rigid motions about the anchor that change no measurement."""

    axes: Reals
    """Orthonormal axes of free turns: none, one, or three (two that move a line), shape (n, 3)."""

    is_hand_free: bool
    """Whether a mirror image, in a plane through these axes, meets the measurements as well."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names as in `Estimate.free_frame`."""
        turns = {0: (), 1: ("axis",)}.get(len(self.axes), ("rotation",))
        return (*turns, *(["hand"] if self.is_hand_free else []))

    def motions(self, position: Reals, moves: Bools) -> Reals:
        """Orthonormal motions of robots at positions (N, 3) by free turns, shape (3 N, n)."""
        motions = _turning(self.axes, (position - position[0]) * moves[:, None])
        return np.linalg.qr(motions)[0]


HELD = Frame(np.empty((0, _AXES)), is_hand_free=False)
"""Measurements resist every motion."""


def free_frame(rows: Measurements, position: Reals, moves: Bools) -> Frame:
    """Find the rigid motions of some robots that change no measurement.

    Args:
        rows: Measurements.
        position: Centers where these are met, the anchor first [R], shape (N, 3).
        moves: Robots tied to the anchor, shape (N,).
    """
    arm = (position - position[0]) * moves[:, None]
    extent = np.linalg.norm(arm)
    if not extent:
        return HELD
    turns = _turning(np.eye(_AXES), arm)
    changed = rows.jacobian(position)[:, : turns.shape[0]] @ turns
    _, size, axes = np.linalg.svd(np.linalg.qr(np.asarray(changed), mode="r"))
    size = np.pad(size, (0, _AXES - len(size)))
    moved = np.linalg.norm(turns @ axes.T, axis=0)
    axes = axes[(size <= _UNRESISTED * extent) & (moved > _UNRESISTED * extent)]

    def is_free(there: Reals) -> bool:
        """Whether robots with these arms meet the measurements as well."""
        image = np.where(moves[:, None], position[0] + there, position)
        change = rows.residual(image) - rows.residual(position)
        return bool(np.abs(change).max(initial=0.0) <= _UNRESISTED * extent)

    # What resists to second order only does so after a turn by 1 rad.
    axes = axes[[is_free(Rotation.from_rotvec(axis).apply(arm)) for axis in axes]]
    if not len(axes):
        return HELD
    frame = Frame(axes, is_hand_free=True)
    return frame._replace(is_hand_free=is_free(_mirrored(arm, frame)))


def align(position: Reals, other: Reals, frame: Frame, moves: Bools) -> Reals:
    """Move robots by free motions so that they are nearest to where others are (Kabsch 1976).

    Args:
        position: Centers of K configurations [R], shape (K, N, 3).
        other: Centers to be near to, those of the anchor equal [R], shape (N, 3).
        frame: Free motions.
        moves: Robots that move, shape (N,).

    Returns:
        Orthogonal matrices that rows of arms from the anchor are multiplied by, shape (K, 3, 3).
    """
    matrices = np.tile(np.eye(_AXES), (len(position), 1, 1))
    if not len(frame.axes):
        return matrices
    there = (other - other[0])[moves]
    for k, centers in enumerate(position):
        here = (centers - centers[0])[moves]
        images = [here, _mirrored(here, frame)] if frame.is_hand_free else [here]
        mirror = [np.eye(_AXES), _mirrored(np.eye(_AXES), frame)]
        turns = [_turn(image, there, frame) for image in images]
        off = [
            np.linalg.norm(image @ turn - there) for image, turn in zip(images, turns, strict=True)
        ]
        best = int(np.argmin(off))
        matrices[k] = mirror[best] @ turns[best]
    return matrices


def _turning(axes: Reals, arm: Reals) -> Reals:
    """Velocities of arms (N, 3) that turn about axes (n, 3) at 1 rad/s, shape (3 N, n)."""
    velocity = np.cross(axes[:, None], arm).astype(np.float64)
    return velocity.reshape(len(axes), arm.size).T


def _mirrored(arm: Reals, frame: Frame) -> Reals:
    """Mirror arms in a plane that contains the axis of free turns, or in any if all are free."""
    along = frame.axes[0]
    across = np.cross(along, np.eye(_AXES)[np.abs(along).argmin()])
    across /= np.linalg.norm(across)
    mirrored: Reals = arm - 2.0 * (arm @ across)[..., None] * across
    return mirrored


def _turn(here: Reals, there: Reals, frame: Frame) -> Reals:
    """Find the free turn that brings arms (n, 3) nearest to others: a matrix to multiply by."""
    if len(frame.axes) == 1:
        basis = np.linalg.svd(frame.axes)[2]  # the axis first
        (_, a, b), (_, c, d) = (here @ basis.T).T, (there @ basis.T).T
        angle = np.arctan2((a * d - b * c).sum(), (a * c + b * d).sum())
        cos, sin = np.cos(angle), np.sin(angle)
        inner = np.array([[1.0, 0.0, 0.0], [0.0, cos, sin], [0.0, -sin, cos]])
        turn: Reals = basis.T @ inner @ basis
        return turn
    u, _, vt = np.linalg.svd(here.T @ there)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    proper: Reals = u @ sign @ vt
    return proper


def scaled_distances(problem: Problem, anchor: Reals) -> list[Reals]:
    """Place robots by classical multidimensional scaling, and both images where they are known.

    The distance of two robots is taken to be the shortest way along measured distances (Shang et
    al., MobiHoc 2003). An affine map fits the result to measured coordinates; the nearest turn and
    shift counts.

    Args:
        problem: Measurements.
        anchor: Center of the anchor [R], shape (3,).

    Returns:
        Two mirror images, shape (N, 3) each; none without ranges, or beyond `MOST_ROBOTS`.
    """
    robots, rows = problem.rows.robots, problem.rows
    if rows.is_contact.all() or not _AXES <= robots <= MOST_ROBOTS:
        return []
    length = np.where(
        problem.is_offset,
        np.linalg.norm(problem.shift, axis=1),
        np.where(
            rows.is_contact[problem.link],
            np.hypot(np.linalg.norm(problem.shift, axis=1), SPACING),
            problem.length,
        ),
    )
    # Sparse matrices add up entries at the same place: keep the shortest of each pair.
    order = np.argsort(length, kind="stable")
    low, high = np.sort(problem.pair[order], axis=1).T
    ends, shortest = np.unique(low * robots + high, return_index=True)
    graph = coo_array((length[order][shortest], np.divmod(ends, robots)), shape=(robots, robots))
    away = dijkstra(graph, directed=False)
    farthest = away[np.isfinite(away)].max()
    square: Reals = -0.5 * np.where(np.isfinite(away), away, farthest) ** 2
    # Double centering turns squared distances into products of arms from the mean.
    square -= square.mean(axis=0)
    square -= square.mean(axis=1)[:, None]
    value, vector = eigh(square, subset_by_index=(robots - _AXES, robots - 1))
    shape = vector * np.sqrt(np.maximum(value, 0.0))
    shape -= shape[0]
    return [_fitted(image, problem, anchor) for image in (shape, shape * [1.0, 1.0, -1.0])]


def _fitted(shape: Reals, problem: Problem, anchor: Reals) -> Reals:
    """Turn and shift a shape about its anchor to fit measured coordinates, shape (N, 3)."""
    rows, links = problem.rows, len(problem.rows.other)
    robot, direction = rows.robot[links:], rows.places.direction
    value = -rows.residual(np.tile(anchor, (rows.robots, 1)))[links:]
    # n . A x = value, with nine unknowns
    matrix = (direction[:, :, None] * shape[robot][:, None, :]).reshape(-1, _AXES**2)
    ridge = _RIDGE * max(float((matrix**2).sum()), 1.0) * np.eye(_AXES**2)
    affine = np.linalg.solve(matrix.T @ matrix + ridge, matrix.T @ value).reshape(_AXES, _AXES)
    u, _, vt = np.linalg.svd(affine)
    # The nearest proper rotation to the map (Kabsch 1976): no mirror image.
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    fitted: Reals = anchor + shape @ turn.T
    return fitted


def images(problem: Problem, position: Reals) -> list[Reals]:
    """Mirror a configuration in the plane nearest to the robots whose places are measured.

    Where these are in one plane, as beacons on a ceiling, ranges exclude neither image.

    Args:
        problem: Measurements.
        position: Centers [R], shape (N, 3).

    Returns:
        The image, shape (N, 3), if at least three robots are measured in all directions.
    """
    known: Bools = np.all(problem.sensed_place()[1], axis=1)
    known[0] = True
    if known.sum() < _AXES or known.all():
        return []
    center = position[known].mean(axis=0)
    normal = np.linalg.svd(position[known] - center, full_matrices=False)[2][2]
    mirrored = position - 2.0 * ((position - center) @ normal)[:, None] * normal
    return [np.where(known[:, None], position, mirrored)]
