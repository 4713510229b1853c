"""Measures speed-up and efficiency of parallel threads, by strong and weak scaling.

    python -m benchmarks.threads                   # 1, 2, 4, ... threads, up to all of them
    python -m benchmarks.threads --threads 1 2 --works growth virtual-force

Strong scaling runs the same work on more threads: the speed-up is the time of one thread over
that of T threads, the efficiency is the speed-up over T. Weak scaling gives T threads T times the
work: the efficiency is the rate of a thread relative to one thread alone. Times are wall times,
the least of the rounds.
"""

import argparse
import json
import os
import time
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from benchmarks.swarm_step.machine import describe
from benchmarks.swarm_step.scenes import ROBOT, StepParams, make
from tiswarm.compute import backend
from tiswarm.engine.relax import PreparedSwarm
from tiswarm.localization.methods import LocalizationParams, localize_batch
from tiswarm.localization.settings import JointParams, Together, VirtualForceParams
from tiswarm.records.sensing_log import SensingLog
from tiswarm.report.figure_style import PAGE_WIDTH, STYLE, marker_style, new_figure, png
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.mechanics import MechanicsParams
from tiswarm.world.params import TowerParams

FIRST_SEED = 1000
SMALL = 100
"""Robots of each structure in a batch."""
KEPT_LOGS = 16
"""Number of different logs; larger batches repeat them."""
STEPS = 25

Task = Callable[[], object]


class Work(NamedTuple):
    """A computation to time."""

    prepare: Callable[[int], Task]
    """Prepares an amount of work; returns a function that does it on the running threads."""

    amount: int
    """Amount for each thread."""

    unit: str
    """Unit of the amount."""


def _towers(seeds: int) -> Task:
    return lambda: grow(
        TowerParams(), robots=SMALL, seeds=range(FIRST_SEED, FIRST_SEED + seeds), robot=ROBOT
    )


def _large(robots: int) -> TowerParams:
    """Return the settings of a tower of `scenarios/scaling.yaml`."""
    return TowerParams(
        movers=max(1, robots // 100),
        solve_every=max(1, robots // 50),
        mechanics=MechanicsParams(model="rigid"),
    )


def _large_tower(robots: int) -> Task:
    params = _large(robots)
    return lambda: grow(params, robots=robots, seeds=[FIRST_SEED], robot=ROBOT)


@cache
def _logs(robots: int, count: int) -> list[SensingLog]:
    params = TowerParams() if robots == SMALL else _large(robots)
    seeds = range(FIRST_SEED, FIRST_SEED + count)
    grown = grow(params, robots=robots, seeds=seeds, robot=ROBOT)
    return [observe(history, SensingParams()) for history in grown]


def _localize_many(params: LocalizationParams) -> Callable[[int], Task]:
    def prepared(structures: int) -> Task:
        logs = [_logs(SMALL, KEPT_LOGS)[n % KEPT_LOGS] for n in range(structures)]
        return lambda: localize_batch(logs, [params] * structures)

    return prepared


def _localize_one(params: LocalizationParams) -> Callable[[int], Task]:
    def prepared(robots: int) -> Task:
        log = _logs(robots, 1)
        return lambda: localize_batch(log, [params])

    return prepared


def _step(robots: int) -> Task:
    scene, step, running = make("block", robots, seed=0), StepParams(), backend.current()
    swarm = PreparedSwarm(
        scene.position, scene.orientation_wxyz, scene.contacts, robot=ROBOT, threads=running.threads
    )
    return lambda: swarm.relax(
        attraction_gain=step.attraction_gain,
        repulsion_gain=step.repulsion_gain,
        ramp=step.ramp,
        steps=STEPS,
        max_step=step.max_step,
    )


JOINT = JointParams(chains=1)
TOGETHER = VirtualForceParams(schedule="together", together=Together(steps=300))
WORKS = {
    "growth": Work(_towers, 8, "towers of 100"),
    "growth of one tower": Work(_large_tower, 2_000, "robots"),
    "virtual-force": Work(_localize_many(VirtualForceParams()), 128, "towers of 100"),
    "virtual-force on one tower": Work(_localize_one(VirtualForceParams()), 2_000, "robots"),
    "virtual-force together": Work(_localize_many(TOGETHER), 128, "towers of 100"),
    "virtual-force together on one tower": Work(_localize_one(TOGETHER), 5_000, "robots"),
    "joint": Work(_localize_many(JOINT), 16, "towers of 100"),
    "joint on one tower": Work(_localize_one(JOINT), 2_000, "robots"),
    "swarm step": Work(_step, 100_000, "robots"),
}


def main() -> None:
    """Measure, print, store and draw a table; earlier rows of other works stay."""
    options = _options()
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "machine.json").write_text(json.dumps(describe(), indent=1) + "\n")
    file = options.out / "threads.csv"
    for name in options.works:
        new = pd.DataFrame(measure(name, options.threads, options.rounds, options.share))
        old = pd.read_csv(file) if file.exists() else new.iloc[:0]
        table = pd.concat([old[old["work"] != name], new])
        table.to_csv(file, index=False, float_format="%.4g")
        print(new.to_string(index=False, float_format="{:.3g}".format), "\n", flush=True)
    draw(pd.read_csv(file), options.out / "threads.png")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    most = backend.available_threads()
    usual = sorted({*(1 << k for k in range(most.bit_length())), most})
    parser.add_argument("--threads", type=int, nargs="+", default=usual, metavar="T")
    parser.add_argument("--works", nargs="+", choices=WORKS, default=list(WORKS))
    parser.add_argument(
        "--rounds", type=int, default=3, help="rounds; we report the least time (default: 3)"
    )
    parser.add_argument("--share", type=float, default=1.0, help="share of the usual work")
    parser.add_argument("--out", type=Path, default=Path("reports/threads"))
    return parser.parse_args()


def measure(
    name: str, threads: Sequence[int], rounds: int, share: float
) -> list[dict[str, object]]:
    """Time a work on each number of threads, by strong and by weak scaling."""
    work = WORKS[name]
    amount = max(1, round(share * work.amount))
    counts = sorted({1, *threads})
    # Strong scaling needs work for the largest number of threads.
    plans = {"strong": dict.fromkeys(counts, counts[-1] * amount)}
    plans["weak"] = {count: count * amount for count in counts}
    rows: list[dict[str, object]] = []
    for scaling, amounts in plans.items():
        wall_s = {count: _least_s(work, count, amounts[count], rounds) for count in counts}
        for count in counts:
            ratio = wall_s[1] / wall_s[count]
            is_strong = scaling == "strong"
            rows.append(
                {
                    "work": name,
                    "scaling": scaling,
                    "threads": count,
                    "amount": amounts[count],
                    "unit": work.unit,
                    "wall_s": wall_s[count],
                    "speed_up": ratio if is_strong else count * ratio,
                    "efficiency": ratio / count if is_strong else ratio,
                    "load": os.getloadavg()[0],
                }
            )
    return rows


def _least_s(work: Work, threads: int, amount: int, rounds: int) -> float:
    """Return the least wall time of some rounds [s], after the kernels are compiled."""
    backend.start(threads=threads)
    task = work.prepare(amount)
    backend.start(threads=threads)
    task()
    taken = []
    for _ in range(rounds):
        begun = time.perf_counter()
        task()
        taken.append(time.perf_counter() - begun)
    return min(taken)


def draw(table: pd.DataFrame, path: Path) -> None:
    """Draw the speed-up of strong scaling and the efficiency of weak scaling."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        figure = new_figure(PAGE_WIDTH, 2.9)
        panels = figure.subplots(1, 2)
        for axes, scaling, value in zip(
            panels, ("strong", "weak"), ("speed_up", "efficiency"), strict=True
        ):
            rows = table[table["scaling"] == scaling]
            for place, (name, part) in enumerate(rows.groupby("work", sort=False)):
                axes.plot(
                    part["threads"], part[value], markersize=3.5, label=name, **marker_style(place)
                )
            counts = sorted(set(rows["threads"]))
            ideal = counts if scaling == "strong" else [1.0] * len(counts)
            axes.plot(counts, ideal, "--", color="0.6", label="ideal")
            axes.set(xscale="log", xlabel="Threads", ylim=(0.0, None))
            axes.set_xticks(counts, list(map(str, counts)))
            axes.minorticks_off()
        panels[0].set(ylabel="Speed-up", title="The same work on more threads")
        panels[1].set(ylabel="Efficiency", title="Work in proportion to threads")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center")
        path.write_bytes(png(figure))


if __name__ == "__main__":
    main()
