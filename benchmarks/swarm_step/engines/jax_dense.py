"""jax-md: a neighbor list of docks, and forces by array operations."""

import os

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import jax.numpy as jnp
import numpy as np
from jax_md import partition, space
from numpy.typing import NDArray

from benchmarks.swarm_step.scenes import Scene, StepParams

MOST_CELLS_PER_DOCK = 32
"""Largest number of cells per dock: the cell list covers the whole box, and must fit in memory."""
MARGIN = 5.0
"""Margin of the box around the swarm [R]."""


class JaxDense:
    """Dense neighbor list that jax-md rebuilds when a dock has moved half the skin."""

    def __init__(self, scene: Scene, params: StepParams, *, precision: str, threads: int) -> None:
        del threads
        jax.config.update("jax_enable_x64", precision == "float64")
        placed = scene.position + scene.separation
        self.shift = scene.separation - placed.min(axis=0) + MARGIN
        box = np.ptp(placed, axis=0) + 2.0 * MARGIN
        robots, reach = len(placed), params.spacing + params.skin
        if np.prod(box / reach) > MOST_CELLS_PER_DOCK * 3 * robots + 1000:
            msg = "the cell list covers the whole box, which is too sparse in this scene"
            raise ImportError(msg)
        self.start_position = jnp.asarray((scene.position + self.shift).astype(precision))
        self.dock_offset = jnp.asarray(scene.dock_offset.astype(precision))
        self.connected = jnp.asarray(3 * scene.contacts[:, 0::2] + scene.contacts[:, 1::2])
        displacement, _ = space.free()
        self.neighbors = partition.neighbor_list(
            displacement,
            jnp.asarray(box),
            params.spacing,
            params.skin,
            custom_mask_function=lambda idx: jnp.where(
                idx // 3 == jnp.arange(len(idx))[:, None] // 3, len(idx), idx
            ),
            format=partition.Dense,
        )
        dock = (self.start_position[:, None] + self.dock_offset).reshape(-1, 3)
        self.start_list = self.neighbors.allocate(dock)
        self.advance = jax.jit(self._advance)
        self.params, self.builds = params, 0

    def run(self, steps: int, max_step: float) -> NDArray[np.float64]:
        """Take steps from the start of the scene; return the final positions."""
        here = self.start_position
        elsewhere = self.start_list.reference_position + self.params.skin
        listed = self.start_list.set(reference_position=elsewhere)  # forces a rebuild
        builds = jnp.zeros((), jnp.int32)
        for _ in range(steps):
            here, listed, builds = self.advance(here, listed, builds, max_step)
        self.builds = int(builds)
        if bool(listed.did_buffer_overflow):
            msg = "the neighbor list overflowed"
            raise RuntimeError(msg)
        return np.asarray(here, np.float64) - self.shift

    def _advance(
        self,
        position: jax.Array,
        listed: partition.NeighborList,
        builds: jax.Array,
        max_step: float,
    ) -> tuple[jax.Array, partition.NeighborList, jax.Array]:
        params = self.params
        dock = (position[:, None] + self.dock_offset).reshape(-1, 3)
        before, listed = listed, self.neighbors.update(dock, listed)
        builds += jnp.any(listed.reference_position != before.reference_position)
        offset = dock.at[listed.idx].get(mode="fill", fill_value=jnp.inf) - dock[:, None]
        distance = jnp.sqrt(jnp.sum(offset * offset, axis=2))
        gap = jnp.minimum(distance - params.spacing, 0.0)
        push = jnp.where(
            gap < 0.0, -params.repulsion_gain * (1.0 - params.ramp) * gap**4 / distance, 0.0
        )
        force = jnp.sum(push[:, :, None] * jnp.where(gap[:, :, None] < 0.0, offset, 0.0), axis=1)
        own, other = self.connected[:, 0], self.connected[:, 1]
        offset = dock[other] - dock[own]
        distance = jnp.sqrt(jnp.sum(offset * offset, axis=1))
        gap = jnp.maximum(distance - params.spacing, 0.0)
        pull = (params.attraction_gain * params.ramp * gap / distance)[:, None] * offset
        force = force.at[own].add(pull).at[other].add(-pull)
        step = force.reshape(-1, 3, 3).sum(axis=1)
        length = jnp.sqrt(jnp.sum(step * step, axis=1, keepdims=True))
        return position + step * jnp.minimum(1.0, max_step / length), listed, builds
