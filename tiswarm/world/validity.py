"""Whether a structure could stand in the world: checked before it is stored."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tiswarm.aliases import Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.robot import DOCK_COUNT
from tiswarm.world.history import History
from tiswarm.world.terrain import Terrain

MAX_OVERLAP = 1e-9
"""Deepest overlap that rounding may leave [R]."""

MAX_IMBALANCE = 1e-6
"""Greatest share of the weight that the ground may fail to bear in the numbers [1]."""


def find_fault(history: History, *, contact_gap: float) -> str:
    """Find what is wrong with a structure.

    Args:
        history: The structure as it grew.
        contact_gap: Docks closer than this count as touching [R].

    Returns:
        The first fault, or an empty string where there is none.
    """
    robot = history.robot
    turned = dock_offsets(history.orientation_wxyz, robot.dock_offset_body)
    dock = history.position[:, None, :] + turned
    checks = (
        _overlap(dock.reshape(-1, 3), robot.spacing),
        _sunken(dock, history.terrain, robot.dock_radius),
        _open_contact(dock, history.contacts, robot.spacing, contact_gap),
        _unsupported(history),
        _unbalanced(history),
    )
    return next((fault for fault in checks if fault), "")


def _overlap(dock: Reals, spacing: float) -> str:
    pairs = cKDTree(dock).query_pairs(spacing - MAX_OVERLAP, output_type="ndarray")
    pairs = pairs[pairs[:, 0] // DOCK_COUNT != pairs[:, 1] // DOCK_COUNT]
    if len(pairs) == 0:
        return ""
    depth = spacing - np.linalg.norm(dock[pairs[:, 0]] - dock[pairs[:, 1]], axis=1)
    worst = int(np.argmax(depth))
    i, j = pairs[worst] // DOCK_COUNT
    return f"robots {i} and {j} overlap by {depth[worst]:.3g} R"


def _sunken(dock: Reals, terrain: Terrain, radius: float) -> str:
    depth = terrain.depth(dock.reshape(-1, 3), radius)
    if depth.max() <= MAX_OVERLAP:
        return ""
    return f"robot {np.argmax(depth) // DOCK_COUNT} is {depth.max():.3g} R deep in the ground"


def _open_contact(dock: Reals, contacts: NDArray[np.int32], spacing: float, gap: float) -> str:
    i, a, j, b = contacts.T
    distance = np.linalg.norm(dock[i, a] - dock[j, b], axis=1)
    off = np.flatnonzero(distance > spacing + gap)
    if len(off) == 0:
        return ""
    return f"robots {i[off[0]]} and {j[off[0]]} are in contact {distance[off[0]]:.3g} R apart"


def _unsupported(history: History) -> str:
    """Robots that neither touch an earlier one nor stand on the ground."""
    supported = np.zeros(history.robot_count, np.bool_)
    supported[history.contacts[:, 2]] = True
    supported[history.ground_docks[:, 0]] = True
    supported[history.edge_docks[:, 0]] = True
    if supported.all():
        return ""
    return f"robot {np.argmin(supported)} touches neither an earlier robot nor the ground"


def _unbalanced(history: History) -> str:
    """Mechanics whose ground forces do not bear the weight."""
    worst = max((load.imbalance for load in history.loads), default=0.0)
    if not worst > MAX_IMBALANCE:
        return ""
    return f"weight and ground forces differ by {worst:.3g} of the weight"
