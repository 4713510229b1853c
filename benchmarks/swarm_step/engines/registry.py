"""The engines by name, with their precision and number of threads."""

import importlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.swarm_step.scenes import Scene, StepParams

ALL = os.cpu_count() or 1


class Engine(Protocol):
    """A prepared scene that can be run repeatedly."""

    builds: int
    """Number of list builds in the last run."""

    def run(self, steps: int, max_step: float) -> NDArray[np.float64]:
        """Take steps from the start of the scene; return the final positions, shape (N, 3)."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """How to start an engine in its own process."""

    engine: str
    """Module of this package, a colon, and the class."""

    precision: str = "float64"
    threads: int = 1
    options: Mapping[str, str] = field(default_factory=dict)
    """More arguments of the class."""

    environment: Mapping[str, str] = field(default_factory=dict)
    """Environment variables of the process."""

    in_order: bool = True
    """Whether it gets the robots in Morton order; tiswarm orders them itself."""

    def load(self) -> Callable[[Scene, StepParams], Engine]:
        """Import the engine; return a function that prepares a scene."""
        module, name = self.engine.split(":")
        factory = getattr(importlib.import_module(f"{__package__}.{module}"), name)
        return partial(factory, precision=self.precision, threads=self.threads, **self.options)


def _ours(
    precision: str = "float64",
    threads: int = 1,
    arch: str = "cpu",
    library: str = "taichi",
    whole_call: str = "",
) -> Entry:
    return Entry(
        engine="tiswarm_relax:TiswarmRelax",
        precision=precision,
        threads=threads,
        options={"arch": arch, "whole_call": whole_call},
        environment={"TISWARM_BACKEND": library},
        in_order=False,
    )


def _warp(precision: str, device: str = "cpu") -> Entry:
    return Entry(engine="warp_grid:WarpGrid", precision=precision, options={"device": device})


def _jax(precision: str) -> Entry:
    one = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    return Entry(engine="jax_dense:JaxDense", precision=precision, environment={"XLA_FLAGS": one})


ENGINES = {
    "tiswarm-f64": _ours(),
    "tiswarm-f64-call": _ours(whole_call="yes"),
    "tiswarm-f32": _ours("float32"),
    "quadrants-f64": _ours(library="quadrants"),
    "quadrants-f32": _ours("float32", library="quadrants"),
    "numba-f64": Entry(engine="numba_lists:NumbaLists"),
    "numba-f32": Entry(engine="numba_lists:NumbaLists", precision="float32"),
    "c-f64": Entry(engine="c_lists:CLists"),
    "c-f32": Entry(engine="c_lists:CLists", precision="float32"),
    "by-hand-f64": Entry(engine="c_lists:ByHand"),
    "by-hand-f32": Entry(engine="c_lists:ByHand", precision="float32"),
    "lammps-f64": Entry(engine="lammps_docks:LammpsDocks"),
    "warp-f64": _warp("float64"),
    "warp-f32": _warp("float32"),
    "kdtree-f64": Entry(engine="kdtree:KdTree"),
    "jax-md-f64": _jax("float64"),
    "jax-md-f32": _jax("float32"),
    "stream-f64": Entry(engine="c_lists:Streaming"),
    "stream-f32": Entry(engine="c_lists:Streaming", precision="float32"),
    "tiswarm-f64-all": _ours(threads=ALL),
    "numba-f64-all": Entry(engine="numba_lists:NumbaLists", threads=ALL),
    "tiswarm-cuda-f64": _ours(arch="cuda"),
    "tiswarm-cuda-f32": _ours("float32", arch="cuda"),
    "quadrants-cuda-f64": _ours(arch="cuda", library="quadrants"),
    "quadrants-cuda-f32": _ours("float32", arch="cuda", library="quadrants"),
    "warp-cuda-f64": _warp("float64", "cuda"),
    "warp-cuda-f32": _warp("float32", "cuda"),
    "tiswarm-vulkan-f32": _ours("float32", arch="vulkan"),
    "tiswarm-metal-f32": _ours("float32", arch="metal"),
}
"""Every engine; one thread, unless the name ends in `all`."""
