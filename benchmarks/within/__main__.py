"""Fits the law of error / sd on training logs, and tests P(error < x) on all others.

    python -m benchmarks.within errors --training --logs 60       # errors of training logs
    python -m benchmarks.within fit                               # docs/fits/errors.json
    python -m benchmarks.within errors --logs 100                 # errors of other logs
    python -m benchmarks.within report                            # tables, as in docs/accuracy.md

`errors` continues where it stopped, and stops after --minutes.
"""

import argparse
import json
import sys
from pathlib import Path

import pandas as pd

from benchmarks.within.errors import ALL_SETS, METHODS, measure
from benchmarks.within.law import fitted
from benchmarks.within.reliability import tables
from tiswarm.base.version import __version__
from tiswarm.compute import backend

RECORD = Path(__file__).parents[2] / "docs" / "fits" / "errors.json"
"""Record of the shipped law."""


def main() -> int:
    """Do what the command says."""
    options = _options()
    training = options.command == "fit" or getattr(options, "training", False)
    path = options.out / ("training.csv" if training else "errors.csv")
    if options.command == "errors":
        backend.start(threads=1)
        measure(
            path, names=options.sets, methods=options.methods, logs=options.logs,
            training=training, seconds=60.0 * options.minutes,
        )  # fmt: skip
        print(f"errors in {path}")
        return 0
    errors = pd.read_csv(path, keep_default_na=False, na_values={"sd_R": ["", "nan"]})
    if options.command == "fit":
        record = {"tiswarm": __version__, **fitted(errors)}
        options.record.write_text(f"{json.dumps(record, indent=1)}\n")
        print(json.dumps(record["chosen"]))
        return 0
    for title, table in tables(errors).items():
        table.to_csv(options.out / f"{title}.csv", index=False)
        print(f"\n{title}\n\n{_markdown(table)}")
    return 0


def _markdown(table: pd.DataFrame) -> str:
    rows = [list(table.columns), ["---"] * len(table.columns)]
    rows += [[str(cell) for cell in row] for row in table.itertuples(index=False)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.within",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("command", choices=["errors", "fit", "report"])
    parser.add_argument(
        "--sets", nargs="+", default=[*ALL_SETS], choices=[*ALL_SETS], metavar="SET",
        help=f"some of {', '.join(ALL_SETS)}",
    )  # fmt: skip
    parser.add_argument("--methods", nargs="+", default=[*METHODS], metavar="METHOD")
    parser.add_argument("--logs", type=int, default=100, metavar="N", help="logs of each set")
    parser.add_argument("--training", action="store_true", help="logs to fit on")
    parser.add_argument("--minutes", type=float, default=600.0, help="time to begin logs in")
    parser.add_argument("--record", type=Path, default=RECORD, help="record of the fit to write")
    parser.add_argument("--out", type=Path, default=Path("reports/within"))
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
