"""Times the growth of towers and its parts.

    python -m benchmarks.growth            # 100 robots x 25 seeds, 1,000 and 10,000 robots
    python -m benchmarks.growth --quick    # 100 robots x 25 seeds

On one thread; a small structure compiles the kernels first.
"""

import argparse
import os
import platform
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.compute.machine import machine
from tiswarm.study.provenance import peak_memory_mb
from tiswarm.world import frame_kernels, growth, mechanics, walks
from tiswarm.world.growth import grow
from tiswarm.world.mechanics import MechanicsParams
from tiswarm.world.params import TowerParams
from tiswarm.world.walks import Walks

SIZES = {
    "100 robots, 25 structures": (100, 25, TowerParams()),
    "1,000 robots": (1_000, 1, TowerParams()),
    "10,000 robots, 100 movers, a solve every 100 joins": (
        10_000,
        1,
        TowerParams(movers=100, solve_every=100, mechanics=MechanicsParams(model="rigid")),
    ),
}
PARTS: dict[str, tuple[Any, str]] = {
    "climbing (kernel)": (Walks, "climb"),
    "joining (kernel)": (Walks, "join"),
    "mechanics": (mechanics.Frames, "solve"),
    "elimination and loads (kernel) within mechanics": (frame_kernels, "find_loads"),
    "relays": (walks, "relay"),
    "spawning": (growth.GrowingStructure, "spawn"),
}


def main() -> None:
    """Measure and print a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="the smallest size only")
    sizes = list(SIZES.items())[: 1 if parser.parse_args().quick else None]
    running = backend.start(threads=1)
    print(f"machine: {machine()}, Python {platform.python_version()}, {running.library}")
    print(f"threads: {running.threads}, load before: {os.getloadavg()[0]:.2f}\n")
    print("| size | CPU s | a structure s | a join ms | peak MB |", " | ".join(PARTS), "|")
    print("|---" * (5 + len(PARTS)) + "|")
    grow(TowerParams(), robots=10, seeds=[0], robot=RobotGeometry())
    spent: Counter[str] = Counter()
    for part, (owner, name) in PARTS.items():
        setattr(owner, name, _timed(getattr(owner, name), part, spent))
    for size, (robots, seeds, params) in sizes:
        spent.clear()
        print(_row(size, robots, seeds, params, spent), flush=True)


def _timed(function: Callable[..., Any], part: str, spent: Counter[str]) -> Callable[..., Any]:
    """Wrap a function to add the time of every call to its part."""

    def timed(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401 - any function
        begun = time.process_time()
        try:
            return function(*args, **kwargs)
        finally:
            spent[part] += time.process_time() - begun

    return timed


def _row(name: str, robots: int, seeds: int, params: TowerParams, spent: Counter[str]) -> str:
    """Grow one size; return a row of the table."""
    begun = time.process_time()
    grow(params, robots=robots, seeds=range(seeds), robot=RobotGeometry())
    cpu = time.process_time() - begun
    parts = [f"{spent[part]:.2f} s" for part in PARTS]
    figures = f"{cpu:.1f}", f"{cpu / seeds:.3f}", f"{1e3 * cpu / seeds / robots:.2f}"
    return "| " + " | ".join([name, *figures, str(peak_memory_mb()), *parts]) + " |"


if __name__ == "__main__":
    main()
