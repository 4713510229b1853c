"""What docks sense of a robot in contact: the direction to its dock, and its orientation."""

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import AnyInts, Ints, Reals
from tiswarm.compute.math import normal
from tiswarm.sensing.params import SensingParams
from tiswarm.world.history import History


def sense_directions(history: History, params: SensingParams) -> Reals:
    """Measure where the other dock of each true contact lies, as seen from the own dock.

    Returns:
        Rows of (robot, stance, own dock, other robot, other dock, unit vector in the own body
        frame (3)), shape (U, 8).
    """
    if params.direction_noise_deg is None:
        return np.empty((0, 8))
    contacts = history.table("contacts")
    _, _, dock, neighbor, neighbor_dock = contacts.T
    body = history.robot.dock_offset_body
    row = _stance_row(history, contacts)
    center = np.concatenate([walk.center for walk in history.walks])[row]
    arm = _turn(history.orientation_wxyz[neighbor]).apply(body[neighbor_dock])
    way = history.position[neighbor] + arm
    way = _stance_turn(history, row).inv().apply(way - center) - body[dock]
    way = _error(history, "direction", params.direction_noise_deg).apply(way)
    return np.column_stack([contacts, way / np.linalg.norm(way, axis=1, keepdims=True)])


def sense_connections(history: History, params: SensingParams) -> Reals:
    """Measure the orientation of the other robot of each true contact.

    Returns:
        Rows of (robot, stance, own dock, other robot, other dock, unit quaternion from the other
        body to the own (4)), shape (Q, 9).
    """
    if params.connection_noise_deg is None:
        return np.empty((0, 9))
    contacts = history.table("contacts")
    neighbor_turn = _turn(history.orientation_wxyz[contacts[:, 3]])
    turn = _stance_turn(history, _stance_row(history, contacts)).inv() * neighbor_turn
    turn = _error(history, "connection", params.connection_noise_deg) * turn
    return np.column_stack([contacts, turn.as_quat(canonical=True, scalar_first=True)])


def _turn(wxyz: Reals) -> Rotation:
    return Rotation.from_quat(wxyz, scalar_first=True)


def _stance_row(history: History, contacts: AnyInts) -> Ints:
    """Place of each contact's stance among all stances."""
    length = [walk.stance_count for walk in history.walks]
    return np.asarray(np.cumsum([0, *length])[contacts[:, 0]] + contacts[:, 1])


def _stance_turn(history: History, row: Ints) -> Rotation:
    return _turn(np.concatenate([walk.orientation_wxyz for walk in history.walks])[row])


def _error(history: History, stream: str, sd_deg: float) -> Rotation:
    """Draw a small turn for each contact, with the same deviation about every axis."""
    count = [len(walk.contacts) for walk in history.walks]
    robot = np.repeat(np.arange(history.robot_count), count)
    draw = 3 * np.concatenate([np.arange(n) for n in count])[:, None] + np.arange(3)
    turn = np.radians(sd_deg) * normal(history.seed, stream, robot[:, None], draw)
    return Rotation.from_rotvec(turn)
