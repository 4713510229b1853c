"""Warp: a HashGrid, queried in every step for the docks around each dock."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from benchmarks.swarm_step.scenes import Scene, StepParams

wp.config.quiet = True
CELLS = 128
"""Cells of the grid along each axis; it wraps around."""


class WarpGrid:
    """Cells of D + half the skin, refilled when a robot has moved that half."""

    def __init__(
        self, scene: Scene, params: StepParams, *, precision: str, threads: int, device: str = "cpu"
    ) -> None:
        del threads
        wp.init()
        self.device = wp.get_device(device)
        self.real = wp.float64 if precision == "float64" else wp.float32
        self.vector = wp.types.vector(3, self.real)
        self.params, self.separation = params, scene.separation
        placed = (scene.position + scene.separation).astype(precision)
        self.start_position = self._array(placed)
        self.dock_offset = self._array(scene.dock_offset.reshape(-1, 3))
        start, other = _contact_rows(scene.contacts, len(placed))
        self.contact_start = wp.array(start, dtype=wp.int32, device=self.device)
        self.contact_dock = wp.array(other, dtype=wp.int32, device=self.device)
        cells = [CELLS] * 3
        self.grid = wp.HashGrid(*cells, device=self.device, dtype=self.real)
        self.place_docks, self.take_step = _kernels(self.real, self.vector)
        self.builds = 0

    def _array(self, values: NDArray[np.floating]) -> wp.array:
        return wp.array(values, dtype=self.vector, device=self.device)

    def run(self, steps: int, max_step: float) -> NDArray[np.float64]:
        """Take steps from the start of the scene; return the final positions."""
        params, robots = self.params, len(self.start_position)
        here, there = wp.clone(self.start_position), wp.empty_like(self.start_position)
        origin = wp.clone(here)
        dock = wp.empty_like(self.dock_offset)
        farthest = wp.zeros(1, dtype=self.real, device=self.device)
        reach = params.spacing + 0.5 * params.skin
        gains = params.attraction_gain * params.ramp, params.repulsion_gain * (1.0 - params.ramp)
        self.builds, moved = 0, np.inf
        for _ in range(steps):
            self._launch(self.place_docks, 3 * robots, [here, self.dock_offset], [dock])
            if moved > (0.5 * params.skin) ** 2:
                self.grid.build(dock, reach)
                wp.copy(origin, here)
                self.builds += 1
            farthest.zero_()
            contacts = self.contact_start, self.contact_dock
            numbers = *gains, params.spacing, max_step, reach
            inputs = [self.grid.id, dock, here, origin, *contacts, *numbers]
            self._launch(self.take_step, robots, inputs, [there, farthest])
            moved = float(farthest.numpy()[0])
            here, there = there, here
        return here.numpy().astype(np.float64) - self.separation

    def _launch(self, kernel: Any, count: int, inputs: list, outputs: list) -> None:  # noqa: ANN401
        wp.launch(kernel, dim=count, inputs=inputs, outputs=outputs, device=self.device)


def _contact_rows(contacts: NDArray[np.int32], robots: int) -> tuple[NDArray, NDArray]:
    """Return the docks in contact with each dock, from both ends, in CSR form."""
    pair = 3 * contacts[:, 0::2] + contacts[:, 1::2]
    own, other = np.concatenate([pair, pair[:, ::-1]]).T
    by_dock = np.lexsort((other, own))
    return np.searchsorted(own[by_dock], np.arange(3 * robots + 1)), other[by_dock]


def _kernels(real: Any, vector: Any) -> tuple[Any, Any]:  # noqa: ANN401 - types of Warp
    """Return the kernels for one precision."""

    @wp.kernel
    def place_docks(  # noqa: ANN202 - a kernel
        position: wp.array(dtype=vector),
        dock_offset: wp.array(dtype=vector),
        dock: wp.array(dtype=vector),
    ):
        k = wp.tid()
        dock[k] = position[k // 3] + dock_offset[k]

    @wp.kernel
    def take_step(  # noqa: ANN202 - a kernel
        grid: wp.uint64,
        dock: wp.array(dtype=vector),
        position: wp.array(dtype=vector),
        origin: wp.array(dtype=vector),
        contact_start: wp.array(dtype=wp.int32),
        contact_dock: wp.array(dtype=wp.int32),
        attraction: real,
        repulsion: real,
        spacing: real,
        max_step: real,
        reach: real,
        moved: wp.array(dtype=vector),
        farthest: wp.array(dtype=real),
    ):
        i = wp.tid()
        force = vector()
        for k in range(3 * i, 3 * i + 3):
            own = dock[k]
            for other in wp.hash_grid_query(grid, own, reach):
                offset = dock[other] - own
                squared = wp.dot(offset, offset)
                if squared < spacing * spacing and other // 3 != i:
                    distance = wp.sqrt(squared)
                    gap = (distance - spacing) * (distance - spacing)
                    force -= repulsion * gap * gap / distance * offset
            for slot in range(contact_start[k], contact_start[k + 1]):
                offset = dock[contact_dock[slot]] - own
                distance = wp.length(offset)
                if distance > spacing:
                    force += attraction * (distance - spacing) / distance * offset
        length = wp.length(force)
        if length > max_step:
            force = max_step / length * force
        moved[i] = position[i] + force
        wp.atomic_max(farthest, 0, wp.length_sq(moved[i] - origin[i]))

    return place_docks, take_step
