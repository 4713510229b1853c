"""Compares the swarm step with other engines: time, memory, and forces.

    python -m benchmarks.swarm_step                    # one scene, 1,000 and 10,000 robots
    python -m benchmarks.swarm_step --full             # all scenes, 100 to 1,000,000 robots
    python -m benchmarks.swarm_step --engines tiswarm-f64 numba-f64 --sizes 1e5

New rows are added to the table in the folder, so a long table can be measured in parts.
Engines run interleaved, each in its own process, and each run starts at the beginning of the
scene and includes neighbor lists. Needs `pip install '.[bench]'`; the table names what is missing.
"""

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.swarm_step import reference
from benchmarks.swarm_step.engines.registry import ENGINES
from benchmarks.swarm_step.figure import draw
from benchmarks.swarm_step.machine import describe
from benchmarks.swarm_step.process import EngineProcess
from benchmarks.swarm_step.scenes import SCENES, StepParams, make

QUICK_SIZES = (1_000, 10_000)
FULL_SIZES = (100, 1_000, 10_000, 100_000, 1_000_000)
STEPS, FEW_STEPS = 50, 25
"""Steps of a run, and of a run of a million robots; both rebuild lists every 13 steps."""
STILL = 1e-6
"""Largest step at which lists never become stale, to time steps without list builds [R]."""
MOST_CHECKED = 10_000
"""Largest number of robots for a check at the end of the run."""
ROUNDINGS = 32
"""Largest error in each step, in roundings of the largest coordinate. Rounding a million robots to
float32 alone, with float64 from there on, causes an error of 17."""


def main() -> None:
    """Measure, print, store and draw a table."""
    options = _options()
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "machine.json").write_text(json.dumps(describe(), indent=1) + "\n")
    file = options.out / "swarm_step.csv"
    table = pd.read_csv(file, keep_default_na=False, na_values=[""]) if file.exists() else None
    for scene in options.scenes:
        for robots in options.sizes:
            known = [] if table is None else table.to_dict("records")
            here = pd.DataFrame(measure(scene, robots, options, known))
            table = _put(here, table)
            table.to_csv(file, index=False, float_format="%.4g")
            print(here.to_string(index=False, float_format="{:.3g}".format), "\n", flush=True)
    draw(table, options.out / "swarm_step.png")
    sys.exit(int((table["note"] == "WRONG").any()))


def _put(new: pd.DataFrame, table: pd.DataFrame | None) -> pd.DataFrame:
    """Replace earlier rows of the same engines and scenes, and keep the rest."""
    if table is None:
        return new
    place = ["scene", "robots", "engine"]
    kept = table[~table.set_index(place).index.isin(new.set_index(place).index)]
    rows = [*kept.to_dict("records"), *new.to_dict("records")]
    return pd.DataFrame(rows).sort_values(place[:2], kind="stable")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    size = {"type": lambda text: int(float(text)), "nargs": "+", "metavar": "N"}
    parser.add_argument("--full", action="store_true", help="all scenes and sizes")
    parser.add_argument("--sizes", **size, help="numbers of robots")
    parser.add_argument("--scenes", nargs="+", choices=SCENES)
    parser.add_argument("--engines", nargs="+", choices=ENGINES, default=list(ENGINES))
    parser.add_argument(
        "--repeats", type=int, default=5, help="rounds; we report medians (default: 5)"
    )
    parser.add_argument(
        "--limit-s", type=float, default=120.0, help="skip runs that would take longer [s]"
    )
    parser.add_argument("--out", type=Path, default=Path("reports/swarm-step"))
    options = parser.parse_args()
    options.sizes = options.sizes or (FULL_SIZES if options.full else QUICK_SIZES)
    options.scenes = options.scenes or (list(SCENES) if options.full else ["block"])
    return options


def measure(
    name: str, robots: int, options: argparse.Namespace, earlier: list[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Run every engine on one scene of one size, interleaved."""
    params, scene = StepParams(), make(name, robots, seed=0)
    steps = FEW_STEPS if robots >= FULL_SIZES[-1] else STEPS
    wanted = {"force": reference.force(scene, params, scene.position), "steps": steps}
    if robots <= MOST_CHECKED:
        wanted["end"] = reference.run(scene, params, steps)
    extent = np.ptp(scene.position + scene.separation, axis=0).max()
    rows = {
        engine: {"scene": name, "robots": robots, "engine": engine} for engine in options.engines
    }
    processes = {}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.npz"
        np.savez(file, **vars(scene), **wanted)
        for engine, row in rows.items():
            row["note"] = _too_slow(engine, name, robots, steps, options.limit_s, earlier)
            if not row["note"]:
                processes[engine] = EngineProcess(engine, file)
                row["note"] = processes[engine].missing
        processes = {
            engine: process for engine, process in processes.items() if not process.missing
        }
        for engine, process in processes.items():
            process.ask(do="run", steps=steps, max_step=params.max_step)  # warms up
            rows[engine] |= process.ask(do="check")
            if _is_wrong(rows[engine], extent, steps, ENGINES[engine].precision):
                rows[engine]["note"] = "WRONG"
    times = _take_turns(processes, steps, options.repeats)
    for engine, taken in times.items():
        rows[engine] |= _summary(taken, times[next(iter(times))], robots, steps)
    for process in processes.values():
        process.stop()
    return list(rows.values())


def _take_turns(
    processes: dict[str, EngineProcess], steps: int, repeats: int
) -> dict[str, list[dict[str, Any]]]:
    """Time complete runs, and runs of 1 and 1 + T steps without stale lists, engine by engine."""
    times: dict[str, list[dict[str, Any]]] = {engine: [] for engine in processes}
    for _ in range(repeats):
        for engine, process in processes.items():
            taken = process.ask(do="run", steps=steps, max_step=StepParams().max_step)
            short = process.ask(do="run", steps=1, max_step=STILL)
            long = process.ask(do="run", steps=1 + steps, max_step=STILL)
            taken["step_s"] = long["cpu_s"] - short["cpu_s"]
            times[engine].append(taken)
    return times


def _summary(
    taken: list[dict[str, Any]], first: list[dict[str, Any]], robots: int, steps: int
) -> dict[str, Any]:
    """Return medians per robot and step, and medians of the ratios to the first engine."""
    per = 1e9 / (robots * steps)
    table, base = pd.DataFrame(taken), pd.DataFrame(first)
    return {
        "steps": steps,
        "builds": taken[-1]["builds"],
        "cpu_ns": per * table["cpu_s"].median(),
        "wall_ns": per * table["wall_s"].median(),
        "step_cpu_ns": per * table["step_s"].median(),
        "cpu_ratio": (table["cpu_s"] / base["cpu_s"]).median(),
        "wall_ratio": (table["wall_s"] / base["wall_s"]).median(),
        "memory_B": table["memory_B"].iloc[0],
        "load": os.getloadavg()[0],
    }


def _too_slow(
    engine: str, scene: str, robots: int, steps: int, limit_s: float, earlier: list[dict[str, Any]]
) -> str:
    """Return a note if a run would exceed the limit, judging by the last smaller run."""
    known = [
        row
        for row in earlier
        if row["scene"] == scene and row["engine"] == engine and row["robots"] < robots
    ]
    expected = 1e-9 * robots * steps * known[-1].get("wall_ns", 0.0) if known else 0.0
    if known and not known[-1].get("wall_ns", 0.0) > 0.0:
        return str(known[-1]["note"])
    return f"skipped: a run would take about {expected:.0f} s" if expected > limit_s else ""


def _is_wrong(row: dict[str, Any], extent: float, steps: int, precision: str) -> bool:
    """Whether errors exceed what rounding explains."""
    allowed = ROUNDINGS * np.finfo(precision).eps * (extent + 1.0)
    errors = row["force_error"] or 0.0, (row["end_error_R"] or 0.0) / steps
    return not max(errors) <= allowed


if __name__ == "__main__":
    main()
