"""Directions and orientations of contacts lead from a robot to its neighbor."""

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.sensing import SensingParams, observe


def turn(wxyz):
    """Rotations of quaternions, shape (n, 4)."""
    return Rotation.from_quat(wxyz, scalar_first=True)


def neighbors(history, **noise):
    """Own row, other row and what was sensed, of all contacts of all stances.

    Returns:
        Own turn and center, other robots, own and other docks, directions, turns of connections.
    """
    log = observe(history, SensingParams(**noise))
    rows = [np.concatenate([getattr(log, key), getattr(log.stances, key)])
            for key in ("directions", "connections")]  # fmt: skip
    np.testing.assert_array_equal(rows[0][:, 1:4], rows[1][:, 1:4])
    final = len(log.directions)
    at = rows[0][:, 0].astype(int)
    earlier = [np.concatenate([getattr(walk, key)[:-1] for walk in history.walks])
               for key in ("orientation_wxyz", "center")]  # fmt: skip
    own = [
        np.concatenate([last[at[:final]], before[at[final:]]])
        for last, before in zip((history.orientation_wxyz, history.position), earlier, strict=True)
    ]
    docks = rows[0][:, 1:4].astype(int).T
    return turn(own[0]), own[1], *docks, rows[0][:, 4:], turn(rows[1][:, 4:])


def test_a_direction_leads_to_the_other_dock(towers):
    """Without noise, D along it from the own dock is the other dock, as far as they touch."""
    history = towers[0]
    body = history.robot.dock_offset_body
    own, center, a, other, b, direction, connection = neighbors(
        history, direction_noise_deg=0.0, connection_noise_deg=0.0
    )

    there = center + own.apply(body[a] + 2.0 * direction)

    expected = history.position[other] + turn(history.orientation_wxyz[other]).apply(body[b])
    # Docks up to 0.02 R farther apart count as touching.
    assert np.linalg.norm(there - expected, axis=1).max() < 0.0201
    found = (own * connection).inv() * turn(history.orientation_wxyz[other])
    assert found.magnitude().max() < 1e-7
    assert len(other) == len(history.table("contacts"))


def test_directions_and_connections_err_as_stated(towers):
    """About each axis across a direction, and about all axes of a connection."""
    across, about = [], []
    for history in towers:
        exact = neighbors(history, direction_noise_deg=0.0, connection_noise_deg=0.0)
        noisy = neighbors(history, direction_noise_deg=2.0, connection_noise_deg=3.0)
        axis = np.cross(exact[5], [0.3, 0.5, 0.8])
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        across += [(noisy[5] * side).sum(axis=1) for side in (axis, np.cross(exact[5], axis))]
        about.append((noisy[6] * exact[6].inv()).as_rotvec())

    # Some 1,000 contacts: five standard errors are 11 %.
    np.testing.assert_allclose(np.degrees([np.std(x) for x in across]), 2.0, rtol=0.25)
    np.testing.assert_allclose(np.degrees(np.concatenate(about).std(axis=0)), 3.0, rtol=0.15)
    assert np.degrees(np.concatenate(across).std()) < 2.2


def test_wrong_contacts_leave_directions_as_they_are(towers):
    """Mistakes about contacts are not mistakes of the sensors of directions."""
    history = dataclasses.replace(towers[0], seed=5)
    quiet = neighbors(history, direction_noise_deg=1.0, connection_noise_deg=1.0)
    mistaken = neighbors(
        history, direction_noise_deg=1.0, connection_noise_deg=1.0, missed_contacts=0.5
    )

    np.testing.assert_array_equal(quiet[5], mistaken[5])
