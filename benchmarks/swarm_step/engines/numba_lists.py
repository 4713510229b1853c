"""Numba: the algorithm of tiswarm, with a cell list by counting sort, Verlet rows, full gather."""

import numpy as np
from numpy.typing import NDArray

from benchmarks.swarm_step.engines import kernels
from benchmarks.swarm_step.scenes import Scene, StepParams


class NumbaLists:
    """Steps on neighbor lists that are rebuilt when a robot has moved half the skin."""

    def __init__(self, scene: Scene, params: StepParams, *, precision: str, threads: int) -> None:
        real = np.dtype(precision).type
        self.params, self.real, self.pieces = params, real, threads
        placed = scene.position + scene.separation
        self.separation = scene.separation
        self.start_position = placed.astype(real)
        robots = len(placed)
        self.dock_offset = np.zeros((3 * robots, 4), real)
        self.dock_offset[:, :3] = scene.dock_offset.reshape(-1, 3)
        self.contact_start, self.contact_entry = _pack_contacts(scene.contacts, robots)
        buckets = 1 << max(7, (3 * robots - 1).bit_length())
        self.bucket = np.empty(3 * robots, np.int32)
        self.bucket_start = np.empty(buckets + 1, np.int32)
        self.slot_dock = np.empty((3 * robots, 4), real)
        self.slot_id = np.empty(3 * robots, np.int32)
        self.first = np.empty(robots, np.int64)
        self.end = np.empty(robots, np.int64)
        self.entry = np.empty((threads, 24 * robots // threads + 256), np.int32)
        self.farthest = np.empty(threads, real)
        parallel = threads > 1
        self._find_rows = kernels.find_rows_in_parallel if parallel else kernels.find_rows
        self._take_step = kernels.take_step_in_parallel if parallel else kernels.take_step
        self.builds = 0

    def run(self, steps: int, max_step: float) -> NDArray[np.float64]:
        """Take steps from the start of the scene; return the final positions."""
        gains = self._gains(max_step)
        here, there = self.start_position.copy(), np.empty_like(self.start_position)
        dock = self.dock_offset.copy()
        dock[:, :3] += np.repeat(here, 3, axis=0)
        moved = np.zeros_like(dock)
        self.builds, farthest = 0, np.inf
        origin = here.copy()
        for _ in range(steps):
            if farthest > (0.5 * self.params.skin) ** 2:
                self._build(dock)
                origin[:] = here
            farthest = self._step(dock, here, origin, gains, there, moved)
            here, there, dock, moved = there, here, moved, dock
        return here - self.separation

    def _step(self, dock, here, origin, gains, there, moved) -> float:  # noqa: ANN001 - arrays
        """Step from `here` and `dock` to `there` and `moved`; return the largest squared move."""
        lists = self.first, self.end, self.entry.reshape(-1)
        arrays = dock, self.dock_offset, here, origin
        self._take_step(*lists, *arrays, *gains, there, moved, self.farthest)
        return float(self.farthest.max())

    def _gains(self, max_step: float) -> tuple[np.floating, ...]:
        """Return gains, spacing and largest step in the precision of the arrays."""
        params = self.params
        pull, push = (
            params.attraction_gain * params.ramp,
            params.repulsion_gain * (1.0 - params.ramp),
        )
        return tuple(map(self.real, (pull, push, params.spacing, max_step)))

    def _build(self, dock: NDArray) -> None:
        """Build the rows; allocate more memory and repeat if they do not fit."""
        self.builds += 1
        reach = self.real(self.params.spacing + self.params.skin)
        strides = local_strides(dock, reach, len(self.bucket_start) - 1)
        cells = self.bucket_start, self.slot_dock, self.slot_id
        kernels.sort_by_cell(dock, reach, *strides, self.bucket, *cells)
        used = np.empty(self.pieces, np.int64)
        while True:
            self._find_rows(
                dock,
                reach,
                *strides,
                *cells,
                self.contact_start,
                self.contact_entry,
                self.first,
                self.end,
                self.entry,
                used,
            )
            if used.max() <= self.entry.shape[1]:
                return
            self.entry = np.empty((self.pieces, int(1.1 * used.max())), np.int32)


def _pack_contacts(contacts: NDArray[np.int32], robots: int) -> tuple[NDArray, NDArray]:
    """Return the row entries of each robot's contacts, from both ends, in CSR form."""
    both = np.concatenate([contacts, contacts[:, [2, 3, 0, 1]]])
    entry = 8 * (3 * both[:, 2] + both[:, 3]) + 2 * both[:, 1] + 1
    by_robot = np.lexsort((entry, both[:, 0]))
    start = np.searchsorted(both[by_robot, 0], np.arange(robots + 1))
    return start.astype(np.int32), entry[by_robot]


def local_strides(dock: NDArray, reach: float, buckets: int) -> tuple[int, int]:
    """Return strides of the cell hash for which the 27 cells around a dock have different buckets.

    If the bounding box fits into the table, neighboring cells have neighboring buckets, which
    saves cache misses.
    """
    low, high = dock.min(axis=0), dock.max(axis=0)
    size = np.floor((high - low) / reach).astype(np.int64) + 4
    beside = np.arange(-1, 2)
    stride_y, stride_z = int(size[0]), int(size[0] * size[1])
    while True:
        bucket = beside[:, None, None] * stride_z + beside[:, None] * stride_y + beside
        if len(np.unique(bucket % buckets)) == bucket.size:
            return stride_y, stride_z
        stride_y, stride_z = stride_y + 1, stride_z + 5
