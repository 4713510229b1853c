"""Times the growth of towers and its parts.

    python -m benchmarks.growth            # 100 robots x 25 seeds, 1,000 and 10,000 robots
    python -m benchmarks.growth --quick    # 100 robots x 25 seeds
    python -m benchmarks.growth --robots 10000 30000 --rounds 2  # towers of the scaling study
    python -m benchmarks.growth --robots 30000 --orders minimum-degree nested-dissection

On one thread; a small structure compiles the kernels first. Towers of the scaling study grow in
turn, by each of the orders of elimination, once a round. Their last row compares loads of the last
solve with those of a direct solver of SciPy: the largest difference of a force or moment of a
contact, relative to the largest one.
"""

import argparse
import os
import platform
import time
from collections import Counter
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.compute.machine import machine
from tiswarm.scenario.expansion import load_scenario
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
    "climbing (kernel)": (Walks, "climb_by_score"),
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
    studied = 100, 300, 1_000, 3_000, 10_000, 30_000, 100_000
    parser.add_argument("--robots", type=int, nargs="+", choices=studied,
                        help="sizes of scenarios/scaling.yaml")  # fmt: skip
    parser.add_argument("--rounds", type=int, default=1, help="how often each of them grows")
    orders = "minimum-degree", "nested-dissection"
    parser.add_argument("--orders", nargs="+", choices=orders, default=orders[:1],
                        help="orders of elimination of theirs")  # fmt: skip
    options = parser.parse_args()
    sizes = list(SIZES.items())[: 1 if options.quick else None]
    if options.robots:
        towers = product(options.robots, options.orders)
        sizes = [(f"{n:,} robots, {order}", (n, 1, _studied(n, order))) for n, order in towers]
        sizes *= options.rounds
    running = backend.start(threads=1)
    print(f"machine: {machine()}, Python {platform.python_version()}, {running.library}")
    print(f"threads: {running.threads}, load before: {os.getloadavg()[0]:.2f}\n")
    print("| size | CPU s | a structure s | a join ms | peak MB |", " | ".join(PARTS), "|")
    print("|---" * (5 + len(PARTS)) + "|")
    for order in options.orders:
        compiled = TowerParams(mechanics=MechanicsParams(order=order))
        grow(compiled, robots=10, seeds=[0], robot=RobotGeometry())
    spent: Counter[str] = Counter()
    solved: list[mechanics.Frames] = []
    for part, (owner, name) in PARTS.items():
        setattr(owner, name, _timed(getattr(owner, name), part, spent))
    _keep_last(solved)
    for size, (robots, seeds, params) in sizes:
        spent.clear()
        print(_row(size, robots, seeds, params, spent), flush=True)
        if options.robots:
            print(f"{size}: loads differ by {load_difference(solved[0]):.1e} from SciPy's")


def _studied(robots: int, order: str) -> TowerParams:
    """Read the tower of so many robots from the scaling study; solve it by an order."""
    study = load_scenario(Path(__file__).parents[1] / "scenarios" / "scaling.yaml")
    rows = {row[0]: row for row in next(iter(study.sweep.values()))}
    _, movers, solve_every, goal, _ = rows[robots]
    return TowerParams(
        movers=movers,
        solve_every=solve_every,
        goal_height=goal,
        mechanics=MechanicsParams(model="rigid", order=order),
    )


def _keep_last(solved: list[mechanics.Frames]) -> None:
    """Keep the frames that were solved last."""
    solve = mechanics.Frames.solve

    def kept(frames: mechanics.Frames, structures: Any) -> None:  # noqa: ANN401 - as of solve
        solve(frames, structures)
        solved[:] = [frames]

    setattr(mechanics.Frames, "solve", kept)  # noqa: B010 - a method is no variable


def load_difference(frames: mechanics.Frames) -> float:
    """Compare forces of contacts in the first structure with those of a direct solver [1]."""
    frame, beams = frames.frame, int(frames.frame.beam_count[0])
    nodes = int(frame.node_count[0])
    a, b = frame.ends[0, :beams, :2].T
    stiff = frame.stiffness[0, : 4 * beams].reshape(beams, 2, 2, 6, 6)
    side, rows, columns, values = np.arange(6), [], [], []
    for i, one in enumerate((a, b)):
        for j, other in enumerate((a, b)):
            moves = (one >= 0) & (other >= 0)  # the ground does not
            block = stiff[moves, i, j]
            rows.append(np.broadcast_to((6 * one[moves, None] + side)[:, :, None], block.shape))
            columns.append(np.broadcast_to((6 * other[moves, None] + side)[:, None], block.shape))
            values.append(block)
    entry, row, column = (
        np.concatenate([each.ravel() for each in each_of]) for each_of in (values, rows, columns)
    )
    matrix = coo_matrix((entry, (row, column)), shape=(6 * nodes, 6 * nodes)).tocsc()
    direct = spsolve(matrix, frame.weight[0, :nodes, :6].ravel()).reshape(nodes, 6)
    forces = []
    for motion in (frames.work.motion[0, :nodes, :6], direct):
        of_b = np.where(b[:, None] >= 0, motion[b], 0.0)
        forces.append(
            np.einsum("nij,nj->ni", stiff[:, 0, 0], motion[a])
            + np.einsum("nij,nj->ni", stiff[:, 0, 1], of_b)
        )
    return float(np.abs(forces[0] - forces[1]).max() / np.abs(forces[1]).max())


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
