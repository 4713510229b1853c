"""Whether a structure could stand in the world: checked before it is stored."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from tiswarm.compute.math import dock_offsets
from tiswarm.world.history import History

_MAX_OVERLAP = 1e-9
"""Deepest overlap that rounding may leave [R]."""

_MAX_IMBALANCE = 1e-6
"""Greatest share of the weight that the ground may fail to bear in the numbers [1]."""


def find_fault(history: History, *, contact_gap: float) -> str:
    """Find what is wrong with a structure.

    Args:
        history: The structure as it grew.
        contact_gap: Docks closer than this count as touching [R].

    Returns:
        The first fault, or an empty string where there is none.
    """
    return next(_faults(history, contact_gap), "")


def _faults(history: History, contact_gap: float) -> Iterator[str]:
    robot, contacts = history.robot, history.contacts
    turned = dock_offsets(history.orientation_wxyz, robot.dock_offset_body)
    docks = history.position[:, None, :] + turned
    dock = docks.reshape(-1, 3)
    count = robot.dock_count

    pairs = cKDTree(dock).query_pairs(robot.spacing - _MAX_OVERLAP, output_type="ndarray")
    pairs = pairs[pairs[:, 0] // count != pairs[:, 1] // count]
    if len(pairs):
        depth = robot.spacing - np.linalg.norm(dock[pairs[:, 0]] - dock[pairs[:, 1]], axis=1)
        worst = int(np.argmax(depth))
        i, j = pairs[worst] // count
        yield f"robots {i} and {j} overlap by {depth[worst]:.3g} R"

    depth = history.terrain.depth(dock, robot.dock_radius)
    if not depth.max() <= _MAX_OVERLAP:
        yield f"robot {np.argmax(depth) // count} is {depth.max():.3g} R deep in the ground"

    i, a, j, b = contacts.T
    distance = np.linalg.norm(docks[i, a] - docks[j, b], axis=1)
    for k in np.flatnonzero(distance > robot.spacing + contact_gap):
        yield f"robots {i[k]} and {j[k]} are in contact {distance[k]:.3g} R apart"

    joined = np.zeros(history.robot_count, np.bool_)
    joined[contacts[:, 2]] = True
    joined[history.ground_docks[:, 0]] = True
    joined[history.edge_docks[:, 0]] = True
    if not joined.all():
        yield f"robot {np.argmin(joined)} touches neither an earlier robot nor the ground"

    imbalance = max((load.imbalance for load in history.loads), default=0.0)
    if imbalance > _MAX_IMBALANCE:
        yield f"weight and ground forces differ by {imbalance:.3g} of the weight"
