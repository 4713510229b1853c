"""Runs methods on generated logs, and grades what their estimates say against the truth.

    python -m benchmarks.estimates                              # all sets, three methods
    python -m benchmarks.estimates planar --logs 30 --training  # the first 30 training logs
    python -m benchmarks.estimates torn --methods joint online --by kind lie

The sets are in `benchmarks/estimates/sets.py`. Constants are fitted on training logs alone. The
tables are printed as Markdown; --out has them and `grades.csv`, with a row a log and method.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

import pandas as pd

import tiswarm
from benchmarks.estimates.grade import Grade, bound, grade, summary
from benchmarks.estimates.sets import SETS, TRAINING
from tiswarm.base.errors import TiswarmError
from tiswarm.compute import backend
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

METHODS = ("joint", "least-squares", "hop-by-hop")


def graded(name: str, number: int, methods: list[str]) -> list[Grade]:
    """Make a log of a set, localize it by each method, and grade the estimates."""
    _, make = SETS[name]
    case = make(number)
    limits = bound(case)
    grades = []
    for method in methods:
        begun = time.process_time()
        try:
            estimate = _localized(case.log, method)
        except TiswarmError as problem:
            why = str(problem).partition(";")[0]
            grades.append(
                Grade(
                    set=name, number=number, method=method, kind=case.kind, lie=case.lie,
                    robots=case.log.robot_count, refused=why,
                )
            )  # fmt: skip
            continue
        grades.append(
            grade(
                case, limits, estimate, name=name, number=number, method=method,
                cpu_s=time.process_time() - begun,
            )
        )  # fmt: skip
    return grades


def _localized(log: SensingLog, method: str) -> Estimate:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # verdicts are in the table
        return tiswarm.localize(log, method, threads=1)


def _start(methods: list[str]) -> None:
    """Start kernels on one thread and compile them, so that no log pays."""
    backend.start(threads=1)
    _, make = SETS["planar"]
    log = make(TRAINING - 1).log
    for method in methods:
        _localized(log, method)


def _all_graded(options: argparse.Namespace) -> Iterator[list[Grade]]:
    first = TRAINING if options.training else 0
    tasks = [
        (name, first + k, options.methods)
        for name in options.sets or SETS
        for k in range(min(options.logs or SETS[name][0], SETS[name][0]))
    ]
    if options.processes == 1:
        _start(options.methods)
        yield from (graded(*task) for task in tasks)
        return
    with ProcessPoolExecutor(
        options.processes, get_context("spawn"), initializer=_start, initargs=(options.methods,)
    ) as pool:
        yield from pool.map(graded, *zip(*tasks, strict=True))


def main() -> int:
    """Grade all logs, and print and write the tables."""
    options = _options()
    grades: list[Grade] = []
    # What is graded so far is written in any case.
    with suppress(KeyboardInterrupt):
        for found in _all_graded(options):
            grades += found
            silent = " ".join(each.method for each in found if each.silent)
            if silent:
                one = found[0]
                print(
                    f"{one.set} {one.number}: {one.kind}, {one.lie}: silent: {silent}", flush=True
                )
    table = pd.DataFrame([asdict(each) for each in grades])
    options.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(options.out / "grades.csv", index=False, float_format="%.5g")
    for by in (["set", "method"], *([["set", *options.by, "method"]] if options.by else [])):
        total = summary(table, by)
        total.to_csv(options.out / f"summary-{'-'.join(by)}.csv", index=False, float_format="%.4g")
        print(f"\n{_markdown(total)}")
    print(f"\ntables in {options.out}")
    return 0


def _markdown(table: pd.DataFrame) -> str:
    rows = [list(table.columns), ["---"] * len(table.columns)]
    rows += [
        [f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in row]
        for row in table.itertuples(index=False)
    ]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.estimates",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("sets", nargs="*", metavar="SET", help=f"some of {', '.join(SETS)}")
    parser.add_argument("--methods", nargs="+", default=[*METHODS], metavar="METHOD")
    parser.add_argument("--logs", type=int, metavar="N", help="the first N logs of each set")
    parser.add_argument("--training", action="store_true", help="logs to fit constants on")
    parser.add_argument(
        "--by", nargs="+", default=[], choices=["kind", "lie"], help="a further table by these"
    )
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("reports/estimates"))
    options = parser.parse_args()
    if unknown := set(options.sets) - set(SETS):
        parser.error(f"there is no set {min(unknown)}; choose from {', '.join(SETS)}")
    return options


if __name__ == "__main__":
    sys.exit(main())
