"""Runs methods on the benchmark's logs, or grades estimates that somebody else made.

    python -m benchmarks.logs joint least-squares                # methods of tiswarm
    python -m benchmarks.logs scipy gtsam isam2                  # needs pip install '.[bench]'
    python -m benchmarks.logs chain --plugin chain.py            # a method of yours
    python -m benchmarks.logs --estimates my-estimates           # NAME.csv for each NAME.jsonl
    python -m benchmarks.logs joint --logs tower-a room          # some logs
    python -m benchmarks.logs joint --rounding all               # as another processor rounds

The table has a row a log and method, and the summary one a method. Both and a figure are written to
--out.
"""

import argparse
import os
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import tiswarm
from benchmarks.logs.grade import Bound, Grade, grade, refused, summary
from benchmarks.logs.limit import known_robots
from tests.roundings import KINDS
from tiswarm.base.errors import TiswarmError
from tiswarm.base.registry import load_plugins
from tiswarm.records.estimate import Estimate
from tiswarm.records.positions import read_estimate, read_positions_of
from tiswarm.records.sensing_log import SensingLog
from tiswarm.report.figure_style import (
    PAGE_WIDTH,
    PALETTE,
    STYLE,
    TRUE_BLUE,
    UNKNOWN_GRAY,
    label_plainly,
    new_figure,
    png,
)

FOLDER = Path(__file__).parent / "data"
ROUNDING = "TISWARM_BENCHMARK_ROUNDING"
"""Variable that says which rounding this process has."""

PEERS = ("scipy", "gtsam", "isam2")
_SPREAD = 0.25
"""Rows over which a method's logs are spread, to either side."""
_LOOKS: dict[bool, dict[str, Any]] = {
    False: {"marker": "o", "markersize": 3.0, "alpha": 0.6, "color": TRUE_BLUE, "label": "a log"},
    True: {"marker": "X", "markersize": 6.0, "color": PALETTE[3], "label": "wrong, and silent"},
}
_MEAN: dict[str, Any] = {"marker": "D", "markersize": 5.0, "color": "black", "capsize": 3.0}


def main() -> int:
    """Grade methods or estimates, and print and write the tables."""
    options = _options()
    if options.rounding != os.environ.get(ROUNDING, "own"):
        # Libraries read their variables as they load.
        command = [sys.executable, "-m", "benchmarks.logs", *sys.argv[1:]]
        variables = KINDS[options.rounding] | {ROUNDING: options.rounding}
        os.execve(sys.executable, command, os.environ | variables)  # noqa: S606
    bounds = _bounds(options.logs)
    load_plugins(options.plugin)
    if set(PEERS) & set(options.methods):
        import benchmarks.logs.peers  # noqa: F401, PLC0415 - needs an extra
    grades: list[Grade] = []
    for found in _graded(options, bounds):
        grades.append(found)
        print(_line(found), flush=True)
    table = pd.DataFrame([asdict(each) for each in grades])
    total = summary(table)
    options.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(options.out / "grades.csv", index=False, float_format="%.4g")
    total.to_csv(options.out / "summary.csv", index=False, float_format="%.4g")
    print(f"\n{total.to_string(index=False, float_format='{:.3g}'.format)}")
    (options.out / "grades.png").write_bytes(draw(table, total))
    print(f"\ntables and grades.png in {options.out}")
    return 0


def _graded(options: argparse.Namespace, bounds: list[Bound]) -> Iterator[Grade]:
    """Localize each log by each method, or read its estimate, and grade it."""
    for bound in bounds:
        log = tiswarm.read_log(FOLDER / f"{bound.log}.jsonl")
        truth = read_positions_of(log, FOLDER / f"{bound.log}.truth.csv")
        known, _ = known_robots(log, truth, bound.frame)
        if options.estimates is not None:
            path = options.estimates / f"{bound.log}.csv"
            if path.exists():
                estimate = read_estimate(log, path)
                yield grade(options.estimates.name, bound, estimate, truth, known, np.nan)
            continue
        for method in options.methods:
            begun = time.process_time()
            try:
                found: Estimate = _localized(log, method)
            except TiswarmError as problem:
                yield refused(method, bound, str(problem).partition(";")[0])
                continue
            yield grade(method, bound, found, truth, known, time.process_time() - begun)


def _localized(log: SensingLog, method: str) -> Estimate:
    with warnings.catch_warnings():
        # Verdicts are in the table.
        warnings.simplefilter("ignore")
        return tiswarm.localize(log, method)


def draw(table: pd.DataFrame, total: pd.DataFrame) -> bytes:
    """Draw the error over the limit of each log that is not open, by method, as PNG."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        figure = new_figure(PAGE_WIDTH, 0.8 + 0.35 * len(total))
        axes = figure.subplots()
        for row, mean in enumerate(total.to_dict("records")):
            own = table[(table["method"] == mean["method"]) & table["over_limit"].notna()]
            at = row + np.linspace(-_SPREAD, _SPREAD, len(own))
            for silent, look in _LOOKS.items():
                some = (own["silent"] == silent).to_numpy()
                axes.plot(own["over_limit"][some], at[some], linestyle="", **look)
            middle = mean["over_limit"]
            half = [[middle - mean["from"]], [mean["to"] - middle]]
            axes.errorbar(middle, row, xerr=half, label="geometric mean, 95 % interval", **_MEAN)
            if row == 0:
                figure.legend(loc="outside upper right", ncols=3)
        axes.axvline(1.0, color=UNKNOWN_GRAY, linewidth=0.8, zorder=0)
        axes.set(xscale="log", xlabel="Error over the limit of a log")
        label_plainly(axes.xaxis)
        axes.set_yticks(range(len(total)), total["method"])
        axes.invert_yaxis()
        return png(figure)


def _line(found: Grade) -> str:
    """Describe a grade in a line."""
    if np.isnan(found.rmse):
        return f"{found.log:<22} {found.method:<16} {found.verdict}"
    over = "open" if np.isnan(found.over_limit) else f"{found.over_limit:.2f} times the limit"
    silent = ", SILENT" if found.silent else ""
    return f"{found.log:<22} {found.method:<16} {found.rmse:.3g} R, {over}, {found.verdict}{silent}"


def _bounds(names: list[str]) -> list[Bound]:
    """Read the limits of some logs, of all if none is named."""
    table = pd.read_csv(FOLDER / "limits.csv")
    if unknown := set(names) - set(table["log"]):
        sys.exit(f"benchmarks.logs: there is no log {min(unknown)}; see {FOLDER / 'limits.csv'}")
    chosen = table[table["log"].isin(names)] if names else table
    keys = [field.name for field in fields(Bound)]
    return [
        Bound(**dict(zip(keys, row, strict=True))) for row in chosen[keys].itertuples(index=False)
    ]


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.logs",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("methods", nargs="*", metavar="METHOD", help="names of methods")
    parser.add_argument("--plugin", nargs="*", default=[], type=Path, help="files with methods")
    parser.add_argument("--estimates", type=Path, metavar="FOLDER", help="estimates to grade")
    parser.add_argument("--logs", nargs="*", default=[], metavar="NAME", help="some logs alone")
    parser.add_argument(
        "--rounding", choices=KINDS, default="own", help="a kind of python -m tests.roundings"
    )
    parser.add_argument("--out", type=Path, default=Path("reports/logs"))
    options = parser.parse_args()
    if bool(options.methods) == bool(options.estimates):
        parser.error("name methods, or a folder of estimates")
    return options


if __name__ == "__main__":
    sys.exit(main())
