"""Where the robots of a study of the engine start: a lattice with random shifts and turns."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.robot import Robot
from tiswarm.compute.math import dock_offsets, normal, uniform


class Ball:
    """A robot that is a ball of radius R: one dock at its center."""

    spacing = 2.0
    """D [R]."""

    dock_offset_body: Reals = np.zeros((1, 3))
    """Center to dock [R], shape (1, 3)."""


class PlacedSwarm(NamedTuple):
    """N robots with docks of radius R, and the docks that are connected."""

    position: Reals  # centers [R], shape (N, 3)
    orientation_wxyz: Reals  # body to world, shape (N, 4)
    contacts: Ints  # robot, dock, other robot, other dock, shape (C, 4); the first robot is earlier

    def docks(self, robot: Robot) -> Reals:
        """Place the docks of each robot in the world [R], shape (N, docks, 3)."""
        offset = dock_offsets(self.orientation_wxyz, robot.dock_offset_body)
        docks: Reals = self.position[:, None] + offset
        return docks


def place(
    robots: int, seed: int, *, robot: Robot, pitch: float, jitter: float, turned: bool, band: float
) -> PlacedSwarm:
    """Place robots on a cubic lattice, filled layer by layer.

    Args:
        robots: Number of robots N.
        seed: Seed of shifts and turns.
        robot: Where docks are on a robot.
        pitch: Distance between places of the lattice [R].
        jitter: Largest shift of a robot from its place along each axis [R].
        turned: Whether orientations are random.
        band: Docks of two robots are connected if their distance differs from D by this at most
            [R]; 0 connects none.
    """
    index = np.arange(robots)
    side = int(np.ceil(round(robots ** (1.0 / 3.0), 9)))
    cell = np.stack([index % side, index // side % side, index // side**2], axis=1)
    shift = 2.0 * uniform(seed, "lattice", index[:, None], np.arange(3)) - 1.0
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (robots, 1))
    if turned:
        turn = normal(seed, "turn", index[:, None], np.arange(4))
        turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    unconnected = PlacedSwarm(pitch * cell + jitter * shift, turn, np.empty((0, 4), np.int64))
    if band == 0.0:
        return unconnected
    pairs, distance = dock_pairs(unconnected, robot, robot.spacing + band)
    contacts = pairs[distance >= robot.spacing - band]
    return unconnected._replace(contacts=contacts)


def dock_pairs(placed: PlacedSwarm, robot: Robot, reach: float) -> tuple[Ints, Reals]:
    """List the pairs of docks of two robots that are nearer than a reach.

    Returns:
        Rows of (robot, dock, other robot, other dock), the earlier robot first, in order, shape
        (P, 4); and their distances [R], shape (P,).
    """
    docks = len(robot.dock_offset_body)
    dock = placed.docks(robot).reshape(-1, 3)
    pair = cKDTree(dock).query_pairs(reach, output_type="ndarray")
    pair = pair[pair[:, 0] // docks != pair[:, 1] // docks]
    pair = pair[np.lexsort((pair[:, 1], pair[:, 0]))]
    distance: Reals = np.linalg.norm(dock[pair[:, 0]] - dock[pair[:, 1]], axis=1)
    rows: Ints = np.stack([pair // docks, pair % docks], axis=2).reshape(-1, 4).astype(np.int64)
    return rows, distance


def are_connected(pairs: Ints, contacts: Ints, docks: int) -> Bools:
    """Whether each pair of docks, shape (P, 4), is one of the contacts, shape (C, 4)."""

    def key(rows: Ints) -> Ints:
        ends = rows[:, [0, 2]] * docks + rows[:, [1, 3]]
        robots = int(max(ends.max(initial=0) + 1, 1))
        numbers: Ints = ends[:, 0] * robots + ends[:, 1]
        return numbers

    both = key(np.concatenate([pairs, contacts]))
    connected: Bools = np.isin(both[: len(pairs)], both[len(pairs) :])
    return connected
