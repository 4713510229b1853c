"""Synthetic swarms of any size: robots on a jittered lattice, randomly oriented and numbered.

A dock has about seven docks of other robots within 1.3 D. Contacts are the pairs of docks that
happen to be about D apart. Lengths are in R.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tiswarm.base.robot import RobotGeometry

ROBOT = RobotGeometry()
PITCH = 2.9
"""Distance between lattice places [R]."""
JITTER = 1.0
"""Largest shift of a robot from its place, along each axis [R]."""
CONTACT_BAND = 0.16
"""Largest deviation from D of the distance of connected docks [R]."""
BATCH = 100
"""Robots of each structure in the scene `batch`."""
KEY_BITS = 21
"""Bits of a coordinate in a Morton key."""
COLUMN = 4
"""Robots along each side of the cross-section of the diagonal column."""


@dataclass(frozen=True, kw_only=True)
class StepParams:
    """Gains and limits of the step; forces are displacements of a robot's center [R]."""

    attraction_gain: float = 0.05
    repulsion_gain: float = 0.04
    ramp: float = 0.5
    max_step: float = 0.02
    """Largest displacement in a step; small enough for four list builds in 50 steps [R]."""
    spacing: float = ROBOT.spacing
    skin: float = 0.5
    """Lists contain pairs up to D + skin; a robot that moved half of it causes a rebuild [R]."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Initial poses of N robots, and C pairs of connected docks."""

    position: NDArray[np.float64]
    """Centers [R], shape (N, 3); structures may overlap each other."""

    orientation_wxyz: NDArray[np.float64]
    """Body to world, shape (N, 4)."""

    contacts: NDArray[np.int32]
    """Robot, dock, other robot, other dock; shape (C, 4)."""

    structure: NDArray[np.int32]
    """Structure of each robot, shape (N,)."""

    @property
    def dock_offset(self) -> NDArray[np.float64]:
        """Vectors from center to dock in the world frame [R], shape (N, 3, 3)."""
        turn = Rotation.from_quat(self.orientation_wxyz, scalar_first=True).as_matrix()
        return np.einsum("nij,kj->nki", turn, ROBOT.dock_offset_body)

    @property
    def separation(self) -> NDArray[np.float64]:
        """Shift that separates structures, for engines that support only one [R], shape (N, 3)."""
        count = int(self.structure.max()) + 1
        if count == 1:
            return np.zeros_like(self.position)
        side = int(np.ceil(count ** (1 / 3)))
        place = np.stack(np.unravel_index(np.arange(count), (side, side, side)), axis=1)
        room = np.ptp(self.position, axis=0).max() + 10.0
        return room * place[self.structure]

    def in_morton_order(self, edge: float) -> tuple["Scene", NDArray[np.int64]]:
        """Renumber the robots along a Morton curve; return the old numbers too."""
        order = morton_order(self.position + self.separation, edge)
        rank = np.empty(len(order), np.int32)
        rank[order] = np.arange(len(order))
        contacts = self.contacts.copy()
        contacts[:, 0::2] = rank[contacts[:, 0::2]]
        sorted_scene = Scene(
            position=self.position[order],
            orientation_wxyz=self.orientation_wxyz[order],
            contacts=contacts,
            structure=self.structure[order],
        )
        return sorted_scene, order


def make(name: str, robots: int, seed: int) -> Scene:
    """Build a scene; the same seed gives the same scene."""
    rng = np.random.default_rng(seed)
    place, structure = SCENES[name](robots)
    place = place + rng.uniform(-JITTER, JITTER, (robots, 3))
    shuffled = rng.permutation(robots)
    unconnected = Scene(
        position=place[shuffled],
        orientation_wxyz=Rotation.random(robots, rng).as_quat(scalar_first=True),
        contacts=np.empty((0, 4), np.int32),
        structure=structure[shuffled].astype(np.int32),
    )
    return Scene(**{**vars(unconnected), "contacts": _contacts(unconnected)})


def _lattice(robots: int, wide: int, deep: int) -> NDArray[np.float64]:
    """Fill layers of wide x deep places from the bottom up."""
    index = np.arange(robots)
    cell = np.stack([index % wide, index // wide % deep, index // (wide * deep)], axis=1)
    return PITCH * cell


def _block(robots: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    side = int(np.ceil(robots ** (1 / 3)))
    return _lattice(robots, side, side), np.zeros(robots, np.int64)


def _tower(robots: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    side = int(np.ceil((robots / 4) ** (1 / 3)))
    return _lattice(robots, side, side), np.zeros(robots, np.int64)


def _diagonal(robots: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    upright = _lattice(robots, COLUMN, COLUMN)
    turn, _ = Rotation.align_vectors([[1.0, 1.0, 1.0]], [[0.0, 0.0, 1.0]])
    return turn.apply(upright), np.zeros(robots, np.int64)


def _batch(robots: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    structure = np.arange(robots) // BATCH
    side = int(np.ceil(BATCH ** (1 / 3)))
    return _lattice(BATCH, side, side)[np.arange(robots) % BATCH], structure


SCENES = {"block": _block, "tower": _tower, "diagonal": _diagonal, "batch": _batch}


def _contacts(scene: Scene) -> NDArray[np.int32]:
    """Return the pairs of docks of different robots with a distance in a band about D."""
    dock = (scene.position + scene.separation)[:, None] + scene.dock_offset
    dock = dock.reshape(-1, 3)
    pair = cKDTree(dock).query_pairs(ROBOT.spacing + CONTACT_BAND, output_type="ndarray")
    apart = np.linalg.norm(dock[pair[:, 0]] - dock[pair[:, 1]], axis=1)
    pair = pair[(apart > ROBOT.spacing - CONTACT_BAND) & (pair[:, 0] // 3 != pair[:, 1] // 3)]
    pair = pair[np.lexsort((pair[:, 1], pair[:, 0]))]
    return np.stack([pair // 3, pair % 3], axis=2).reshape(-1, 4).astype(np.int32)


def morton_order(position: NDArray[np.float64], edge: float) -> NDArray[np.int64]:
    """Return the order of points along a Morton curve, which keeps neighbors together."""
    cell = np.floor((position - position.min(axis=0)) / edge).astype(np.uint64)
    key = np.zeros(len(cell), np.uint64)
    for bit in range(KEY_BITS):
        for axis in range(3):
            key |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(key, kind="stable")
