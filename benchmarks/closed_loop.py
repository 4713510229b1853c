"""Grows the structures of a study whose robots go by estimates, without final answers.

    python -m benchmarks.closed_loop --point "gap': 30" --condition online --workers 2
    python -m benchmarks.closed_loop --scenario scenarios/patience.yaml --seeds 710000 64
    python -m benchmarks.results reports/closed-loop-grown --write

`tiswarm run` localizes each structure once more when it stands, which takes twice as long as growth
itself. This command grows the same structures by the same beliefs and stores what they reached, in
a folder that `benchmarks.results` reads. It continues where it was stopped. `--set` changes the
scenario, for searches on other seeds.
"""

import argparse
import json
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from tiswarm.base.version import __version__
from tiswarm.compute import backend, numerics
from tiswarm.compute.machine import machine
from tiswarm.evaluation.tables import totals
from tiswarm.records.run_folder import cell_of
from tiswarm.scenario.expansion import Variant, load_scenario, variants
from tiswarm.study.navigation import navigate
from tiswarm.world.growth import grow

SCENARIO = Path("scenarios/closed-loop.yaml")
"""Scenario that is grown if no other is named."""

_BY_ESTIMATES, _BY_TRUTH = 8, 64
"""Structures that grow side by side: estimates take the time of each by itself."""


class Task(NamedTuple):
    """Structures of one point under one condition."""

    point: str
    variant: Variant
    seeds: list[int]


def tasks(
    wanted: Iterable[Variant],
    seeds: Sequence[int] | None,
    finished: Sequence[tuple[str, str, int]],
) -> list[Task]:
    """List what has to be grown, in parts.

    Robots that know the truth build alike under all conditions: the first condition stands for all.
    Seeds are those of the scenario if None.
    """
    done, by_truth = {*finished}, set()
    rows = []
    for variant in wanted:
        point = ", ".join(f"{key}={cell_of(value)}" for key, value in variant.point.items())
        by_estimates = variant.settings.structure.navigate_by == "estimate"
        if not by_estimates:
            if point in by_truth:
                continue
            by_truth.add(point)
        all_seeds = variant.settings.seed_list if seeds is None else seeds
        missing = [s for s in all_seeds if (variant.condition, point, s) not in done]
        size = _BY_ESTIMATES if by_estimates else _BY_TRUTH
        parts = [missing[k : k + size] for k in range(0, len(missing), size)]
        rows += [Task(point, variant, part) for part in parts]
    return rows


def grow_task(task: Task) -> list[dict[str, Any]]:
    """Grow structures, and return a row of `summary.csv` for each."""
    backend.choose(threads=1)
    backend.processor()
    settings = task.variant.settings
    histories = grow(
        settings.structure,
        robots=settings.robots,
        seeds=task.seeds,
        robot=settings.robot,
        **navigate(settings),
    )
    columns = {"condition": task.variant.condition, "point": task.point, "status": "done"}
    return [
        columns | {"seed": seed, "joined": history.robot_count} | totals(history)
        for seed, history in zip(task.seeds, histories, strict=True)
    ]


def run(folder: Path, wanted: Sequence[Variant], seeds: Sequence[int] | None, workers: int) -> None:
    """Grow what a folder lacks, and store it part by part."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "summary.csv"
    table = pd.read_csv(file) if file.exists() else pd.DataFrame()
    finished = [
        (str(row["condition"]), str(row["point"]), int(row["seed"]))
        for row in table.to_dict("records")
    ]
    backend.choose(threads=1)
    backend.processor()
    manifest = {
        "tiswarm": __version__,
        "machine": machine(),
        "numerics": [numerics.current()._asdict()],
    }
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for rows in pool.map(grow_task, tasks(wanted, seeds, finished)):
            table = pd.concat([table, pd.DataFrame(rows)], ignore_index=True)
            table.to_csv(file, index=False)
            print(f"{rows[0]['condition']}, {rows[0]['point']}: {len(table)}", flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Grow the structures of a scenario; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.closed_loop",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--scenario", type=Path, default=SCENARIO, help="its file")
    parser.add_argument("--seeds", type=int, nargs=2, metavar=("FIRST", "COUNT"))
    parser.add_argument("--point", default=[], action="append", help="part of a point's name")
    parser.add_argument("--condition", default=[], action="append", help="name of a condition")
    parser.add_argument("--set", default=[], action="append", metavar="KEY=VALUE")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, default=Path("reports"), help="parent of the folder")
    options = parser.parse_args(arguments)
    scenario = load_scenario(options.scenario, options.set)
    seeds = range(options.seeds[0], sum(options.seeds)) if options.seeds else None
    wanted = [
        variant
        for variant in variants(scenario)
        if (not options.condition or variant.condition in options.condition)
        and all(part in str(variant.point) for part in options.point)
    ]
    run(options.out / f"{scenario.name}-grown", wanted, seeds, options.workers)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
