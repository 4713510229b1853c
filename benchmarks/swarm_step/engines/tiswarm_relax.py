"""tiswarm as its users call it: one call from arrays to arrays, renumbering and all."""

import os

import numpy as np
from numpy.typing import NDArray

from benchmarks.swarm_step.scenes import ROBOT, Law, Scene
from tiswarm import relax
from tiswarm.compute import backend


class TiswarmRelax:
    """`tiswarm.relax`, which is handed the robots in their shuffled order."""

    def __init__(
        self, scene: Scene, law: Law, *, precision: str, threads: int, arch: str = "cpu"
    ) -> None:
        self.scene, self.law = scene, law
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

    def run(self, steps: int, max_step: float) -> NDArray[np.float64]:
        """Take steps from the scene's start."""
        scene, law = self.scene, self.law
        result = relax(
            scene.position,
            scene.orientation_wxyz,
            scene.contacts,
            robot=ROBOT,
            attraction_gain=law.attraction_gain,
            repulsion_gain=law.repulsion_gain,
            ramp=law.ramp,
            steps=steps,
            max_step=max_step,
            structure=scene.structure,
            **self.options,
        )
        self.builds = result.list_builds
        return result.position
