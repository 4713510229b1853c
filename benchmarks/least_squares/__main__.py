"""Compares the minimum that `least-squares` moves to with GTSAM's, of the same problems.

    python -m benchmarks.least_squares                        # towers and cantilevers we grow
    python -m benchmarks.least_squares reports/tower-1a2b3c4d/cases/0-baseline/sensing.jsonl

Both solvers get the same rows and start, that of `hop-by-hop`: squares count, errors of rows are
independent, and docks may overlap. A row of the table is a log and a solver: the chi-square, the
error if a truth.csv is beside the log, the wall time, and the largest distance of a robot between
the two solvers' minima. Chi-square has many minima, so the solvers may end in different ones. GTSAM
calls a Python function for every residual, which takes most of its time. Needs
`pip install '.[bench]'`.
"""

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd

import tiswarm
from benchmarks.least_squares.factor_graph import Array, Minimum, levenberg_marquardt
from tiswarm.compute import backend
from tiswarm.evaluation.metrics import rmse
from tiswarm.localization.chains.problem import Problem, pose_problem
from tiswarm.localization.cost.cost import WholeCost
from tiswarm.localization.peers.hop_by_hop import place
from tiswarm.localization.peers.settings import LeastSquaresParams
from tiswarm.localization.settings import Cues
from tiswarm.records.sensing_log import SensingLog

PARAMS = LeastSquaresParams(robust=False, cues=Cues(non_overlap=False, touches=False))
SCENARIOS = ("tower", "cantilever")


def ours(log: SensingLog, problem: Problem, position: Array, yaw: Array) -> Minimum:
    """Minimize the chi-square of a problem by the steps of `least-squares`."""
    cost = WholeCost(
        log, problem.rows, yaw_precision=problem.yaw_precision, non_overlap=False,
        are_independent=True,
    )  # fmt: skip
    state, linear = cost.refine(cost.at(position, yaw), PARAMS.rounds)
    return Minimum(state.position, state.yaw, linear.chi_square)


def compare(log: SensingLog) -> pd.DataFrame:
    """Find the minimum of a log with both solvers, from one start."""
    problem = pose_problem(log, PARAMS)
    if len(problem.rows.shared_sd):
        raise SystemExit("benchmarks.least_squares: takes no logs with sources; leave it out")
    start = place(log, problem.rows, non_overlap=False).position, np.zeros(log.robot_count)
    solvers: dict[str, Callable[[], Minimum]] = {
        "tiswarm": lambda: ours(log, problem, *start),
        "gtsam": lambda: levenberg_marquardt(problem, *start),
    }
    rows, found = [], {}
    for name, solve in solvers.items():
        begun = time.perf_counter()
        found[name] = solve()
        rows.append(
            {
                "robots": log.robot_count,
                "solver": name,
                "chi_square": found[name].chi_square,
                "wall_s": time.perf_counter() - begun,
                "position": found[name].position * log.dock_radius,
            }
        )
    apart = np.linalg.norm(found["tiswarm"].position - found["gtsam"].position, axis=1).max()
    return pd.DataFrame(rows).assign(largest_distance_R=apart)


def main() -> None:
    """Compare the solvers on every log, print and store the table."""
    options = _options()
    backend.start()
    tables = []
    with tempfile.TemporaryDirectory() as scratch:
        for path in options.logs or _grown(options, Path(scratch)):
            table = compare(tiswarm.read_log(path))
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
