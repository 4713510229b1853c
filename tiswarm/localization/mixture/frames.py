"""Rigid motions of all robots that no measurement resists, and chains aligned along them.

Ranges alone leave a swarm free to turn about its anchor, and do not exclude its mirror image.
Chains then differ by such motions, and their mean would be too small. Lengths in R.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Bools, Reals
from tiswarm.measurements.model import Measurements

_UNRESISTED = 1e-6
"""Change of a measurement for each R of motion below which it does not resist [1]."""

_AXES = 3


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
