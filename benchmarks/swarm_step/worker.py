"""Runs one engine in its own process, on request of the parent process.

    python -m benchmarks.swarm_step.worker ENGINE SCENE.npz

Requests and answers are lines of JSON; the output of libraries goes to standard error.
"""

import json
import os
import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from benchmarks.swarm_step import reference
from benchmarks.swarm_step.engines.registry import ENGINES, Engine
from benchmarks.swarm_step.scenes import Scene, StepParams
from tiswarm.study.provenance import peak_memory_mb

UNLIMITED = 1e6
"""Largest displacement that no force reaches [R]."""


def main() -> None:
    """Answer requests until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    entry = ENGINES[sys.argv[1]]
    files = np.load(sys.argv[2])
    scene = Scene(**{name: files[name] for name in Scene.__annotations__})
    params, order = StepParams(), np.arange(len(scene.position))
    if entry.in_order:
        scene, order = scene.in_morton_order(params.spacing + params.skin)
    answer: dict[str, Any] = {}
    try:
        prepare = entry.load()
        before = psutil.Process().memory_info().rss
        engine = prepare(scene, params)
        engine.run(1, params.max_step)
    except Exception as error:  # noqa: BLE001 - the table states any reason
        answer = {"missing": f"{type(error).__name__}: {error}".partition("\n")[0]}
    print(json.dumps(answer), file=answers, flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        if request["do"] == "run":
            answer = measure(engine, request["steps"], request["max_step"])
            answer["memory_B"] = max(2**20 * peak_memory_mb() - before, 0) / len(order)
        else:
            answer = check(engine, scene, params, files, order)
        print(json.dumps(answer), file=answers, flush=True)


def measure(engine: Engine, steps: int, max_step: float) -> dict[str, Any]:
    """Time one run; use the times that the engine itself reports, if any."""
    wall, cpu = time.perf_counter(), time.process_time()
    engine.run(steps, max_step)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return {
        "wall_s": getattr(engine, "own_wall_s", wall),
        "cpu_s": getattr(engine, "own_cpu_s", cpu),
        "builds": engine.builds,
    }


def check(
    engine: Engine,
    scene: Scene,
    params: StepParams,
    files: Mapping[str, NDArray[np.float64]],
    order: NDArray[np.int64],
) -> dict[str, float | None]:
    """Return the largest error of initial forces (relative) and of final positions [R]."""
    if hasattr(engine, "pair_energy"):
        expected = reference.pair_energy(scene, params)
        return {"force_error": abs(engine.pair_energy() / expected - 1.0), "end_error_R": None}
    if not getattr(engine, "computes", True):
        return {"force_error": None, "end_error_R": None}
    force = engine.run(1, UNLIMITED) - scene.position
    expected = files["force"][order]
    answer = {"force_error": float(np.abs(force - expected).max() / np.abs(expected).max())}
    answer["end_error_R"] = None
    if "end" in files:
        end = engine.run(int(files["steps"]), params.max_step)
        answer["end_error_R"] = float(np.abs(end - files["end"][order]).max())
    return answer


if __name__ == "__main__":
    main()
