"""Algorithm 1 as an independent NumPy program, written from the paper's text and listing.

It shares nothing with the package but the log. Where `tests.oracle` follows every option of
`virtual-force`, dock by dock, this one has the paper's three conditions only, and is quick enough
for whole structures.
"""

from typing import NamedTuple

import numpy as np

from tests.oracle import matrix

D = 2.0  # dock spacing: docks are spheres of radius 1


class Gains(NamedTuple):
    """The constants that the paper names, but does not state."""

    A: float
    B: float
    k_z: float
    s: float  # "scale factor"
    T: int  # "max iterations"
    threshold: float = 0.0  # "error < threshold"


def localize(log, gains, *, z_cue=True, undocked_repulsion=True):
    """Place all robots in join order; lengths in R.

    Section III-C: "The first robot is designated as an anchor". A robot starts from the average of
    its located neighbors, along its own z axis, or along z-hat where no flipping history says which
    way is outward. Robots on the ground know their height in all conditions.
    """
    turns = [matrix(quaternion) for quaternion in log.orientation_wxyz]
    arms = np.array([[turn @ dock for dock in log.dock_offset_body] for turn in turns])
    places = np.full((log.robot_count, 3), np.nan)
    places[0] = log.anchor_position
    for r in range(1, log.robot_count):
        touched = log.contacts[log.contacts[:, 2] == r]
        neighbors = np.unique(touched[:, 0]) if len(touched) else np.array([0])
        outward = turns[r][:, 2] if z_cue else np.array([0.0, 0.0, 1.0])
        place = places[neighbors].mean(axis=0) + gains.s * outward
        docks = (places[:r, None] + arms[:r]).reshape(-1, 3)
        is_connected = np.zeros((3, len(docks)), bool)
        is_connected[touched[:, 3], 3 * touched[:, 0] + touched[:, 1]] = True
        repels = ~is_connected
        if not undocked_repulsion:  # the listing's loop over neighbors remains
            repels &= np.isin(np.arange(len(docks)) // 3, touched[:, 0])
        height = _height(log, r, arms[r], z_cue=z_cue)
        for t in range(1, gains.T + 1):
            place = place + _force(place, arms[r], docks, is_connected, repels, gains, t / gains.T)
            if not np.isnan(height):
                place[2] += gains.k_z * (height - place[2])  # Eq. (3), after "Update P_r"
            if _error(place, arms[r], docks, is_connected, height) < gains.threshold:
                break
        places[r] = place
    return places


def _force(place, arms, docks, is_connected, repels, gains, ramp):
    """Eqs. (1) and (2) on the center, all dock pairs at once; along the line to the other dock."""
    apart = docks[None] - (place + arms)[:, None]
    d = np.sqrt((apart**2).sum(axis=2))
    pull = gains.A * ramp * np.where(is_connected & (d > D), d - D, 0.0)
    push = gains.B * (1.0 - ramp) * np.where((is_connected | repels) & (d < D), (d - D) ** 4, 0.0)
    return ((pull - push)[..., None] * apart / d[..., None]).sum(axis=(0, 1))


def _height(log, r, arms, *, z_cue):
    """Height of the center by docks on the ground, else by the flips, else NaN."""
    standing = log.ground_docks[log.ground_docks[:, 0] == r, 1]
    if len(standing):
        return np.mean(log.ground_z + 1.0 - arms[standing, 2])
    return log.flip_height[r] if z_cue else np.nan


def _error(place, arms, docks, is_connected, height):
    """What a robot itself can know of its error: how far contacts miss D and its height."""
    own, other = np.nonzero(is_connected)
    missed = np.linalg.norm(docks[other] - place - arms[own], axis=1) - D
    if not np.isnan(height):
        missed = np.append(missed, height - place[2])
    return np.sqrt(np.mean(missed**2)) if len(missed) else np.inf
