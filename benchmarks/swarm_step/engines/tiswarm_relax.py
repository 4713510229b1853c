"""tiswarm: the step of a prepared swarm, or the complete call with its preparation."""

import os

import numpy as np
from numpy.typing import NDArray

from benchmarks.swarm_step.scenes import ROBOT, Scene, StepParams
from tiswarm.compute import backend
from tiswarm.engine.relax import PreparedSwarm


class TiswarmRelax:
    """`tiswarm.relax`, which gets the robots in random order and orders them itself."""

    def __init__(
        self,
        scene: Scene,
        params: StepParams,
        *,
        precision: str,
        threads: int,
        arch: str = "cpu",
        whole_call: str = "",
    ) -> None:
        self.scene, self.params = scene, params
        self.prepared = None
        self.options = {
            "precision": "f64" if precision == "float64" else "f32",
            "arch": arch,
            "threads": threads,
        }
        self.builds = 0
        wanted, running = os.environ.get("TISWARM_BACKEND", ""), backend.start(**self.options)
        if not running.library.startswith(wanted):
            msg = f"TISWARM_BACKEND={wanted} was requested, but {running.library} runs"
            raise ImportError(msg)

        if not whole_call:
            self.prepared = self._prepare()

    def run(self, steps: int, max_step: float) -> NDArray[np.float64]:
        """Take steps from the start of the scene; return the final positions."""
        params = self.params
        result = (self.prepared or self._prepare()).relax(
            attraction_gain=params.attraction_gain,
            repulsion_gain=params.repulsion_gain,
            ramp=params.ramp,
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
