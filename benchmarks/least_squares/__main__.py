"""Compares the method least-squares with GTSAM on the same problems.

    python -m benchmarks.least_squares                        # towers and cantilevers we grow
    python -m benchmarks.least_squares reports/tower-1a2b3c4d/cases/0-baseline/sensing.jsonl

Both solvers get the same residuals, start and rounds. A row of the table is a log and a solver:
the root mean square of the contact residuals, the error if a truth.csv is beside the log, the
wall time, and the largest distance of a robot between the two solvers' estimates. The sum of
squares has many minima, so the solvers may end in different ones. GTSAM calls a Python function
for every residual, which takes most of its time. Needs `pip install '.[bench]'`.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

import tiswarm
from benchmarks.least_squares.factor_graph import levenberg_marquardt
from tiswarm.compute import backend
from tiswarm.evaluation.metrics import rmse
from tiswarm.localization import virtual_force
from tiswarm.localization.least_squares import improve, trust_region
from tiswarm.localization.params import LeastSquaresParams
from tiswarm.records.sensing_log import SensingLog

SOLVERS = {"scipy": trust_region, "gtsam": levenberg_marquardt}
SCENARIOS = ("tower", "cantilever")


def compare(log: SensingLog, params: LeastSquaresParams) -> pd.DataFrame:
    """Localize a log with both solvers, from one start."""
    start = virtual_force.localize_batch([log], [params.start])[0].position
    rows, found = [], {}
    for name, solver in SOLVERS.items():
        begun = time.perf_counter()
        estimate = improve(log, params, start, minimize=solver)
        wall = time.perf_counter() - begun
        found[name] = estimate.position
        rows.append(
            {
                "robots": log.robot_count,
                "solver": name,
                "contact_rms_R": estimate.residual[-1] / log.dock_radius,
                "wall_s": wall,
                "position": estimate.position,
            }
        )
    apart = np.linalg.norm(found["scipy"] - found["gtsam"], axis=1).max() / log.dock_radius
    return pd.DataFrame(rows).assign(largest_distance_R=apart)


def main() -> None:
    """Compare the solvers on every log, print and store the table."""
    options = _options()
    params = LeastSquaresParams()
    backend.start()
    tables = []
    with tempfile.TemporaryDirectory() as scratch:
        for path in options.logs or _grown(options, Path(scratch)):
            table = compare(tiswarm.read_log(path), params)
            truth = path.with_name("truth.csv")
            if truth.exists():
                true = pd.read_csv(truth)[["x_R", "y_R", "z_R"]].to_numpy()
                table["rmse_R"] = [rmse(position, true) for position in table["position"]]
            name = path.parent.parent.parent.name.rpartition("-")[0] or path.parent.name
            table.insert(0, "log", f"{name}/{path.parent.name}")
            tables.append(table.drop(columns="position"))
            print(tables[-1].to_string(index=False, float_format="{:.4g}".format), flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    pd.concat(tables).to_csv(options.out / "least-squares.csv", index=False, float_format="%.6g")
    print(f"table in {options.out / 'least-squares.csv'}")


def _grown(options: argparse.Namespace, folder: Path) -> Iterator[Path]:
    """Grow structures by two scenarios and return their logs."""
    sizes = {"robots": options.robots, "seeds": options.seeds, "conditions": {"baseline": {}}}
    for name in SCENARIOS:
        file = Path("scenarios") / f"{name}.yaml"
        run = tiswarm.run(file, sizes, out=folder, pictures=False, quiet=True)
        yield from sorted(run.folder.glob("cases/*/sensing.jsonl"))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", nargs="*", type=Path, metavar="LOG", help="sensing logs")
    parser.add_argument("--robots", type=int, default=30, help="robots of each grown structure")
    parser.add_argument("--seeds", type=int, default=2, help="structures of each kind")
    parser.add_argument("--out", type=Path, default=Path("reports/least-squares"))
    return parser.parse_args()


if __name__ == "__main__":
    main()
