"""Fits the gains of `virtual-force` on training structures.

    python -m benchmarks.tuning scenarios/paper.yaml --trials 200 --out fit.json

No training structure is one of the scenario. An interrupted fit continues where it stopped. Needs
`pip install '.[bench]'`. `docs/fits/virtual-force.json` is the record of the shipped gains,
`docs/fits/stable.json` that of stable ones.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.tuning.fit import tune
from tiswarm.app.console import ConsoleProgress
from tiswarm.base.errors import TiswarmError
from tiswarm.scenario.expansion import load_scenario


def main(arguments: Sequence[str] | None = None) -> int:
    """Fit gains, print the best and the chosen ones; return the exit status."""
    options = _options(arguments)
    try:
        record = tune(
            load_scenario(options.scenario, options.set), options.out,
            trials=options.trials, training_seeds=options.training_seeds,
            conditions=options.condition, progress=ConsoleProgress(quiet=options.quiet),
            objective=options.objective, stable=options.stable, threads=options.threads,
        )  # fmt: skip
    except TiswarmError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_status
    for name in ("best", "chosen"):
        gains = {key: value for key, value in record[name].items() if key in record["ranges"]}
        text = ", ".join(f"{key} {value:.3g}" for key, value in gains.items())
        print(f"{name}: RMSE {record[name]['rmse_R']:.3f} R with {text}")
    print(f"record in {options.out}")
    return 0


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.tuning",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scenario", type=Path, help="scenario file, or name of a shipped one")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE",
                        help="override a key of the scenario (repeatable)")  # fmt: skip
    parser.add_argument("--trials", type=int, default=200,
                        help="trials, including those already in the record")  # fmt: skip
    parser.add_argument("--training-seeds", type=int, default=25,
                        help="structures at each sweep point, from seed 1000 on")  # fmt: skip
    parser.add_argument("--condition", action="append", default=[],
                        help="condition to include (repeatable; default: all)")  # fmt: skip
    parser.add_argument("--objective", choices=["sse", "rmse"], default="sse",
                        help="error to minimize, in the mean over structures")  # fmt: skip
    parser.add_argument("--stable", action="store_true",
                        help="fit gains with which rounding does not grow")  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("fit.json"),
                        help="record of the fit to write or continue")  # fmt: skip
    parser.add_argument("--threads", type=int, help="CPU threads (default: all)")
    parser.add_argument("--quiet", action="store_true", help="print no progress")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
