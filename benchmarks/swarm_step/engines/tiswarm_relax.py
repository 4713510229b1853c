"""tiswarm on a swarm that was put on the device before, as its peers are; or the whole call."""

import os

import numpy as np
from numpy.typing import NDArray

from benchmarks.swarm_step.scenes import ROBOT, Law, Scene
from tiswarm.compute import backend
from tiswarm.engine.relax import PreparedSwarm


class TiswarmRelax:
    """`tiswarm.relax`, which is handed the robots in their shuffled order and renumbers them."""

    def __init__(
        self,
        scene: Scene,
        law: Law,
        *,
        precision: str,
        threads: int,
        arch: str = "cpu",
        whole_call: str = "",
    ) -> None:
        self.scene, self.law = scene, law
        self.prepared = None
        self.options = {
            "precision": "f64" if precision == "float64" else "f32",
            "arch": arch,
            "threads": threads,
        }
        self.builds = 0
        wanted, running = os.environ.get("TISWARM_BACKEND", ""), backend.start(**self.options)
        if not running.library.startswith(wanted):
            msg = f"TISWARM_BACKEND={wanted} was asked for, {running.library} runs"
            raise ImportError(msg)

        if not whole_call:
            self.prepared = self._prepare()

    def run(self, steps: int, max_step: float) -> NDArray[np.float64]:
        """Take steps from the scene's start."""
        law = self.law
        result = (self.prepared or self._prepare()).relax(
            attraction_gain=law.attraction_gain,
            repulsion_gain=law.repulsion_gain,
            ramp=law.ramp,
            steps=steps,
            max_step=max_step,
        )
        self.builds = result.list_builds
        return result.position

    def _prepare(self) -> PreparedSwarm:
        scene = self.scene
        return PreparedSwarm(
            scene.position,
            scene.orientation_wxyz,
            scene.contacts,
            robot=ROBOT,
            structure=scene.structure,
            **self.options,
        )
