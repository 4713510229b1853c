"""Structures as their mechanics sees them: random ones, and those that were grown."""

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.robot import RobotGeometry
from tiswarm.world.mechanics import Frames, Loads, MechanicsParams

BODY = RobotGeometry().dock_offset_body


@dataclass(frozen=True, kw_only=True)
class Standing:
    """Robots of n docks that touch each other and the ground; dock k of robot i is n i + k."""

    center: np.ndarray
    """Centers [R], shape (N, 3)."""

    turn: np.ndarray
    """Orientations, body to world, shape (N, 3, 3)."""

    contacts: np.ndarray
    """Docks that touch, shape (C, 2), in the order in which the later robot joins."""

    standing: np.ndarray
    """Docks on the ground, in the order in which their robots join, shape (G,)."""

    foot: np.ndarray
    """Where they touch it [R], shape (G, 3)."""

    body: np.ndarray = field(default_factory=lambda: BODY)
    """Center to dock in the body frame [R], shape (n, 3)."""

    @property
    def dock(self):
        """Dock centers [R], shape (n N, 3)."""
        return (self.center[:, None] + self.body @ self.turn.swapaxes(1, 2)).reshape(-1, 3)


def solve(structure: Standing, params: MechanicsParams | None = None, **settings: object) -> Loads:
    """Loads of a structure, mechanics being as usual except for `settings`."""
    robots, docks = len(structure.center), len(structure.body)
    frames = Frames(params or MechanicsParams(**settings), docks=docks, robots=robots)
    for j in range(robots):
        join(frames, 0, structure, j)
    frames.solve([0])
    return frames.loads(0)


def join(frames: Frames, number: int, structure: Standing, j: int) -> None:
    """Let one robot join, the ones before it having done so."""
    docks = len(structure.body)
    own = structure.standing // docks == j
    frames.join(
        number,
        structure.center[j],
        structure.dock[docks * j : docks * (j + 1)],
        structure.contacts[structure.contacts[:, 1] // docks == j],
        structure.standing[own],
        structure.foot[own],
    )


def grown(history, robots: int | None = None) -> Standing:
    """The first robots of a structure that grew, all by default."""
    count, n = robots or history.robot_count, history.robot.dock_count
    i, a, j, b = history.contacts[history.contacts[:, 2] < count].T
    docks = np.concatenate([history.ground_docks, history.edge_docks])
    docks = docks[docks[:, 0] < count]
    docks = docks[np.argsort(docks[:, 0], kind="stable")]
    whole = Standing(
        center=history.position[:count],
        turn=Rotation.from_quat(history.orientation_wxyz[:count], scalar_first=True).as_matrix(),
        contacts=np.column_stack([n * i + a, n * j + b]).astype(np.int32),
        standing=(n * docks[:, 0] + docks[:, 1]).astype(np.int32),
        foot=np.empty((0, 3)),
        body=history.robot.dock_offset_body,
    )
    foot = history.terrain.foot(whole.dock[whole.standing])
    return dataclasses.replace(whole, foot=foot)
