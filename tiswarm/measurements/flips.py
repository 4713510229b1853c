"""Orientations that fit a robot's own flips.

A flip turns a robot about an axis through its pivot dock. Where a mechanism allows few axes, they
are a finite set in the body; the angle is any, since a flip ends at the first contact. The axis
points the same way before and after the flip, and docks on flat ground are level. We estimate all
orientations of a robot's walk at once: least squares of the sensed ones under these conditions, by
Gauss-Newton steps. Turns e of the orientations are in the world frame, R -> exp(e) R, in rad.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.compute.chi_square import chi_square_limit
from tiswarm.compute.math import dock_offsets
from tiswarm.compute.normal_equations import inverted, solved
from tiswarm.measurements.odometry import ASSUMED, stuck_robots
from tiswarm.records.sensing_log import SensingLog

_PLAY = 1e-3
"""Standard deviation of an axis about each direction across it [rad]."""

_LEVEL = 0.01
"""Standard deviation of the height of a dock on the ground [dock radii]."""

_LEAST = 1e-4
"""Noise of orientations below this counts as this much [rad]."""

_ODD = 14.0
"""Chi-square, of two degrees of freedom, from which a flip has none of the axes: one flip of a
thousand that has one."""

_SDS = 5.0
"""Standard deviations of its chi-square by which the walk of a robot may misfit."""

_STEPS = 5
"""Gauss-Newton steps."""


def flip_axes(dock_offset_body: Reals, count: int) -> Reals:
    """List the axes about which robots may flip, in the body frame, shape (docks, count, 3).

    They are evenly spread over 180 degrees across the line from the dock to the center. The first
    is the one nearest to the z axis of the body, or to x for a dock on the z axis.
    """
    unit = dock_offset_body / np.linalg.norm(dock_offset_body, axis=1, keepdims=True)
    is_upright = unit[:, :2].any(axis=1, keepdims=True)
    aim = np.where(is_upright, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    normal = aim - (aim * unit).sum(axis=1, keepdims=True) * unit
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    turn = np.pi / count * np.arange(count)[:, None]
    axes: Reals = np.cos(turn) * normal[:, None] + np.sin(turn) * np.cross(normal, -unit)[:, None]
    return axes


def fit_orientations(log: SensingLog, count: int) -> SensingLog:
    """Replace sensed orientations by those that fit the flips of each robot.

    Robots keep what they sensed if their flips do not fit, or if their sensors are stuck. The noise
    that the log then states is the root mean square over final stances.

    Args:
        log: What was sensed, with all orientations known.
        count: Axes of each dock that robots flip about.
    """
    noise = log.noise or ASSUMED
    sd = np.maximum(np.radians([noise.tilt_deg, noise.tilt_deg, noise.yaw_deg]), _LEAST)
    earlier = log.earlier
    robots = log.robot_count
    length = np.diff(earlier.start) + 1
    first = np.cumsum(length) - length
    of_earlier = np.arange(len(earlier.pivot_dock)) + np.repeat(np.arange(robots), length - 1)
    of_final = first + length - 1
    wxyz = np.empty((length.sum(), 4))
    pivot = np.zeros(length.sum(), np.int64)
    wxyz[of_earlier] = earlier.orientation_wxyz
    wxyz[of_final] = log.orientation_wxyz
    pivot[of_earlier] = earlier.pivot_dock
    on_ground = np.zeros((len(wxyz), len(log.dock_offset_body)), np.bool_)
    on_ground[of_earlier[earlier.ground_docks[:, 0]], earlier.ground_docks[:, 1]] = True
    on_ground[of_final[log.ground_docks[:, 0]], log.ground_docks[:, 1]] = True
    body = log.dock_offset_body / log.dock_radius
    variance = np.tile(sd**2, (len(wxyz), 1))
    walks: Ints = np.arange(robots)
    if log.orientation_sd is not None:
        walks = np.flatnonzero(np.isnan(log.orientation_sd[:, 0]))
    walks = walks[~np.isin(walks, stuck_robots(log))]
    for stances in np.unique(length[walks]).tolist():
        rows = first[walks[length[walks] == stances], None] + np.arange(stances)
        fitted, spread, fits = _fitted(wxyz[rows], pivot[rows], on_ground[rows], body, count, sd)
        wxyz[rows[fits]] = fitted[fits]
        variance[rows[fits]] = spread[fits]
    variance = variance[of_final]
    tilt, yaw = np.degrees(np.sqrt([variance[:, :2].mean(), variance[:, 2].mean()])).tolist()
    return replace(
        log,
        orientation_wxyz=wxyz[of_final],
        stances=log.stances and replace(log.stances, orientation_wxyz=wxyz[of_earlier]),
        noise=replace(noise, tilt_deg=min(tilt, noise.tilt_deg), yaw_deg=min(yaw, noise.yaw_deg)),
    )


def _fitted(
    wxyz: Reals, pivot: Ints, on_ground: Bools, body: Reals, count: int, sd: Reals
) -> tuple[Reals, Reals, Bools]:
    """Fit the orientations of G walks of S stances each.

    Args:
        wxyz: Sensed orientations, shape (G, S, 4).
        pivot: Dock about which the robot leaves each stance, shape (G, S).
        on_ground: Whether each dock stands on flat ground, shape (G, S, docks).
        body: Center to dock in the body frame [dock radii], shape (docks, 3).
        count: Axes of each dock.
        sd: Noise of an orientation about each axis of the world [rad], shape (3,).

    Returns:
        Orientations (G, S, 4), variances about the axes of the world [rad^2] (G, S, 3), and whether
        flips explain what each robot sensed (G,).
    """
    walks, stances = pivot.shape
    sensed = Rotation.from_quat(wxyz.reshape(-1, 4), scalar_first=True)
    axis, is_known = _chosen(wxyz, flip_axes(body, count)[pivot[:, :-1]], sd)
    weight = is_known[..., None] / _PLAY
    standing = on_ground[..., None] / np.maximum(on_ground.sum(axis=2), 1)[..., None, None]
    turned = sensed
    size = 3 * stances
    # Gauss-Newton steps. Turns are small, since all orientations were sensed, and rows are few: the
    # information of a walk is dense, and its inverse gives the variances, too. Rows of axes and of
    # docks on the ground have tiny standard deviations, which make them conditions; those of what
    # was sensed keep the information regular along all turns that no condition resists.
    for _ in range(_STEPS):
        q = turned.as_quat(scalar_first=True).reshape(wxyz.shape)
        before = _turned(q[:, :-1], axis)
        after = _turned(q[:, 1:], axis)
        arm = dock_offsets(q.reshape(-1, 4), body).reshape(*on_ground.shape, 3)
        # Docks on the ground are at their mean height.
        arm = (arm - (arm * standing).sum(axis=2, keepdims=True)) * on_ground[..., None] / _LEVEL
        rows = np.zeros((walks, stances, 6 + arm.shape[2], stances, 3))
        off = np.zeros(rows.shape[:3])
        stance = np.arange(stances)
        flip = np.arange(stances - 1)
        rows[:, stance, :3, stance] = np.diag(1.0 / sd)
        off[:, :, :3] = (sensed * turned.inv()).as_rotvec().reshape(walks, stances, 3) / sd
        # A turn e moves the vector v by e x v: the matrix of v has rows v x (unit vectors).
        rows[:, flip, 3:6, flip + 1] = _crossed(weight * after).swapaxes(0, 1)
        rows[:, flip, 3:6, flip] = -_crossed(weight * before).swapaxes(0, 1)
        off[:, :-1, 3:6] = weight * (before - after)
        rows[:, stance, 6:, stance] = (
            np.stack([arm[..., 1], -arm[..., 0], 0.0 * arm[..., 2]], axis=-1).swapaxes(0, 1)
        )  # fmt: skip
        off[:, :, 6:] = -arm[..., 2]
        matrix = rows.reshape(walks, -1, size)
        right = off.reshape(walks, -1, 1)
        inverse = inverted(matrix.swapaxes(1, 2) @ matrix)
        step = inverse @ (matrix.swapaxes(1, 2) @ right)
        turned = Rotation.from_rotvec(step.reshape(-1, 3)) * turned
    square = ((matrix @ step - right)[..., 0] ** 2).sum(axis=1)
    spare = 2 * is_known.sum(axis=1) + np.clip(on_ground.sum(axis=2) - 1, 0, 2).sum(axis=1)
    variance = np.diagonal(inverse, axis1=1, axis2=2).reshape(walks, stances, 3)
    fits: Bools = square <= chi_square_limit(spare, _SDS)
    return turned.as_quat(canonical=True, scalar_first=True).reshape(wxyz.shape), variance, fits


def _chosen(wxyz: Reals, axes: Reals, sd: Reals) -> tuple[Reals, Bools]:
    """Choose the axis of each flip that moved least from one sensed orientation to the next.

    Args:
        wxyz: Sensed orientations, shape (G, S, 4).
        axes: Axes that each flip may have, in the body frame, shape (G, S - 1, axes, 3).
        sd: Noise of an orientation about each axis of the world [rad], shape (3,).

    Returns:
        Axes in the body frame (G, S - 1, 3), and whether each explains the flip (G, S - 1).
    """
    before, after = (_turned(q[:, :, None], axes) for q in (wxyz[:, :-1], wxyz[:, 1:]))
    middle = before + after
    middle /= np.maximum(np.linalg.norm(middle, axis=-1, keepdims=True), _LEAST)
    moved = _crossed(middle) * sd
    spread = 2.0 * moved @ moved.swapaxes(-1, -2) + _PLAY**2 * np.eye(3)
    # The noise along the axis is 0: what is left there is of second order.
    off = after - before
    off -= (off * middle).sum(axis=-1, keepdims=True) * middle
    square = (off * solved(spread, off)).sum(axis=-1)
    best = square.argmin(axis=-1)[..., None]
    chosen = np.take_along_axis(axes, best[..., None], axis=2)[:, :, 0]
    return chosen, np.take_along_axis(square, best, axis=2)[..., 0] < _ODD


def _turned(wxyz: Reals, vector: Reals) -> Reals:
    """Turn vectors (..., 3) by orientations, whose shape without the last axis is broadcast."""
    shape = np.broadcast_shapes(wxyz.shape[:-1], vector.shape[:-1])
    turn = np.broadcast_to(wxyz, (*shape, 4)).reshape(-1, 4)
    by = np.broadcast_to(vector, (*shape, 3)).reshape(-1, 3)
    turned: Reals = Rotation.from_quat(turn, scalar_first=True).apply(by) if len(by) else by
    return turned.reshape(*shape, 3)


def _crossed(vector: Reals) -> Reals:
    """Return matrices that map a turn e to e x v, for vectors v of shape (..., 3)."""
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, z, -y], [-z, zero, x], [y, -x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
