"""Measures speed-up and efficiency of parallel threads, by strong and weak scaling.

    python -m benchmarks.threads                   # 1, 2, 4, ... threads, up to all of them
    python -m benchmarks.threads --threads 1 2 --works growth virtual-force
    python -m benchmarks.threads --redraw benchmarks/baselines/threads.csv

Strong scaling runs the same work on more threads: the speed-up is the time of one thread over
that of T threads, the efficiency is the speed-up over T. Weak scaling gives T threads T times the
work: the efficiency is the rate of a thread relative to one thread alone. Times are wall times,
the least of the rounds, and processor times of all threads, which other work lengthens less.

The figure has the swarm step on cards beside it, as `benchmarks.gpu` measured it: a block, with
neighbor lists, in float64.
"""

import argparse
import json
import os
import time
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pandas as pd

from benchmarks.swarm_step.machine import describe
from benchmarks.swarm_step.scenes import ROBOT, StepParams, make
from tiswarm.compute import backend
from tiswarm.engine.relax import PreparedSwarm
from tiswarm.localization.methods import LocalizationParams, localize_batch
from tiswarm.localization.settings import JointParams, Together, VirtualForceParams
from tiswarm.records.sensing_log import SensingLog
from tiswarm.report.figure_style import (
    PAGE_WIDTH,
    STYLE,
    label_plainly,
    marker_style,
    new_figure,
    png,
)
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.mechanics import MechanicsParams
from tiswarm.world.params import TowerParams

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIRST_SEED = 1000
SMALL = 100
"""Robots of each structure in a batch."""
KEPT_LOGS = 16
"""Number of different logs; larger batches repeat them."""
STEPS = 25
CARDS = {
    "H100": {1e4: 22.0, 1e5: 7.4, 1e6: 8.8},
    "H200": {1e4: 20.0, 1e5: 5.9, 1e6: 11.0},
    "16 threads": {1e6: 40.0},
}
"""Wall time of a robot's step [ns] by robots, taichi in float64, as docs/benchmarks.md has it.

Robots went to the card and back in each call; the threads are those of a machine with a card.
"""
_STEP = "swarm step"

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
    _STEP: Work(_step, 100_000, "robots"),
}


def main() -> None:
    """Measure, print, store and draw a table; earlier rows of other works stay."""
    options = _options()
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "machine.json").write_text(json.dumps(describe(), indent=1) + "\n")
    file = options.out / "threads.csv"
    if options.redraw:
        draw(pd.read_csv(options.redraw), options.out / "threads.png")
        return
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
    parser.add_argument("--redraw", type=Path, metavar="CSV", help="only draw an earlier table")
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
        least = {count: _least_s(work, count, amounts[count], rounds) for count in counts}
        for count in counts:
            wall_s, cpu_s = least[count]
            ratio = least[1][0] / wall_s
            is_strong = scaling == "strong"
            rows.append(
                {
                    "work": name,
                    "scaling": scaling,
                    "threads": count,
                    "amount": amounts[count],
                    "unit": work.unit,
                    "wall_s": wall_s,
                    "cpu_s": cpu_s,
                    "speed_up": ratio if is_strong else count * ratio,
                    "efficiency": ratio / count if is_strong else ratio,
                    "load": os.getloadavg()[0],
                }
            )
    return rows


def _least_s(work: Work, threads: int, amount: int, rounds: int) -> tuple[float, float]:
    """Return the least wall and processor time of some rounds [s], after kernels are compiled."""
    backend.start(threads=threads)
    task = work.prepare(amount)
    backend.start(threads=threads)
    task()
    taken = []
    for _ in range(rounds):
        begun = time.perf_counter(), time.process_time()
        task()
        taken.append((time.perf_counter() - begun[0], time.process_time() - begun[1]))
    wall_s, cpu_s = zip(*taken, strict=True)
    return min(wall_s), min(cpu_s)


def draw(table: pd.DataFrame, path: Path) -> None:
    """Draw speed-up and efficiency against threads, and the swarm step beside that of cards."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        figure = new_figure(PAGE_WIDTH, 3.4)
        panels = figure.subplots(1, 3)
        _draw_scaling(panels[0], table, "strong", "speed_up")
        _draw_scaling(panels[1], table, "weak", "efficiency")
        panels[0].set(ylabel="Speed-up", title="The same work")
        panels[1].set(ylabel="Efficiency", title="Work in proportion")
        _draw_step(panels[2], table[(table["work"] == _STEP) & (table["scaling"] == "strong")])
        figure.legend(
            *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3,
            title="left and middle panel",
        )  # fmt: skip
        path.write_bytes(png(figure))


def _draw_scaling(axes: "Axes", table: pd.DataFrame, scaling: str, value: str) -> None:
    """Draw a value of each work against the number of threads, and the ideal."""
    rows = table[table["scaling"] == scaling]
    for place, name in enumerate(table["work"].unique()):
        part = rows[rows["work"] == name]
        axes.plot(part["threads"], part[value], markersize=3.5, label=name, **marker_style(place))
    counts = sorted(set(rows["threads"]))
    ideal = counts if scaling == "strong" else [1.0] * len(counts)
    axes.plot(counts, ideal, "--", color="0.6", label="ideal")
    axes.set(xscale="log", xlabel="Threads", ylim=(0.0, None))
    axes.set_xticks(counts, list(map(str, counts)))
    axes.minorticks_off()


def _draw_step(axes: "Axes", rows: pd.DataFrame) -> None:
    """Draw the wall time of a robot's step against robots, of these threads and of cards."""
    here = {
        f"{row['threads']:.0f} thread{'s' * (row['threads'] > 1)} here": {
            row["amount"]: 1e9 * row["wall_s"] / (STEPS * row["amount"])
        }
        for _, row in rows.iterrows()
    }
    for place, (name, times) in enumerate({**CARDS, **here}.items()):
        robots, step_ns = zip(*times.items(), strict=True)
        marker = "osD^vPX"[place % 7]
        axes.plot(robots, step_ns, marker=marker, markersize=3.5, color="0.3")
        below = name == "H200"
        axes.annotate(
            name, (robots[len(robots) // 2], step_ns[len(step_ns) // 2]), (0, -4 if below else 4),
            textcoords="offset points", ha="center", va="top" if below else "bottom", fontsize=7,
        )  # fmt: skip
    axes.set(xscale="log", yscale="log", xlabel="Robots", ylabel="A robot's step [ns]",
             title="Swarm step, cards too")  # fmt: skip
    axes.set_xlim(right=3e6)
    axes.set_ylim(2.0, 6e2)
    for axis in (axes.xaxis, axes.yaxis):
        label_plainly(axis)


if __name__ == "__main__":
    main()
