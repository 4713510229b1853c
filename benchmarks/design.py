"""Compares errors that designs predict with those that whole runs find on fresh structures.

    python -m benchmarks.design                       # four kinds, four suites each
    python -m benchmarks.design --robots 20 --seeds 2

Each suite is predicted on structures of the seeds that a design searches on, and run by `joint` on
as many of fresh seeds. Nothing was fitted on either. Errors are roots of mean squares over
structures and robots [R].
"""

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

import tiswarm
from tiswarm.base.progress import ignore
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study.design.candidates import list_candidates
from tiswarm.study.design.search import FIRST_FRESH_SEED, FIRST_SEED, predict

KINDS: Mapping[str, Mapping[str, Any]] = {
    "tower": {"kind": "tower"},
    "cantilever": {"kind": "cantilever"},
    "bridge": {"kind": "bridge"},
    "planar tower": {"kind": "tower", "plane": True},
}

SUITES: Sequence[Mapping[str, Any]] = (
    {"tilt_noise_deg": 4.0, "yaw_noise_deg": 10.0},
    {"tilt_noise_deg": 1.0, "yaw_noise_deg": 2.0},
    {"tilt_noise_deg": 1.0, "yaw_noise_deg": 2.0, "stances": False, "heights": False},
    {"tilt_noise_deg": 2.0, "yaw_noise_deg": 5.0, "range_reach": 12.0, "range_noise": 0.3},
)

NEAR = 0.3
"""Relative difference up to which a prediction counts as near."""


def compare(kind: Mapping[str, Any], *, robots: int, seeds: int) -> pd.DataFrame:
    """Predict and run each suite; return a row of `predicted_R` and `found_R` for each."""
    task = {"name": "calibration", "robots": robots, "structure": dict(kind)}
    task["localization"] = {"method": "joint"}
    training = tiswarm.grow(
        dict(kind), robots, range(FIRST_SEED, FIRST_SEED + seeds), threads=1, quiet=True
    )
    conditions = {}
    predicted = []
    for number, suite in enumerate(SUITES):
        values = {f"sensing.{key}": value for key, value in suite.items()}
        base = load_scenario(task)
        vary = {key: [value] for key, value in values.items()}
        predicted += predict(list_candidates(base, vary, None), [*training], ignore).tolist()
        conditions[f"suite-{number}"] = values
    study = {
        **task,
        "seeds": {"first": FIRST_FRESH_SEED, "count": seeds},
        "conditions": conditions,
    }
    with tempfile.TemporaryDirectory() as folder:
        run = tiswarm.run(study, out=folder, threads=1, pictures=False, quiet=True)
        squares = run.summary.assign(square=run.summary["rmse_R"] ** 2)
    mean = squares.groupby("condition", sort=False)["square"].mean()
    suites = [", ".join(f"{key} {value}" for key, value in suite.items()) for suite in SUITES]
    rmse = np.sqrt(mean[[*conditions]].to_numpy())
    return pd.DataFrame({"suite": suites, "predicted_R": predicted, "found_R": rmse})


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for each kind and suite, and the share of predictions that are near."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--robots", type=int, default=40)
    parser.add_argument("--seeds", type=int, default=6, help="structures of either kind")
    options = parser.parse_args(arguments)
    tables = []
    for name, kind in KINDS.items():
        table = compare(kind, robots=options.robots, seeds=options.seeds)
        table.insert(0, "kind", name)
        table["ratio"] = table["found_R"] / table["predicted_R"]
        print(table.round(3).to_string(index=False), flush=True)
        tables.append(table)
    ratio = pd.concat(tables)["ratio"]
    near = int(((ratio - 1.0).abs() <= NEAR).sum())
    share = binomtest(near, len(ratio)).proportion_ci(method="wilson")
    print(
        f"{near} of {len(ratio)} predictions within {NEAR:.0%} "
        f"(95 % interval {share.low:.2f} to {share.high:.2f}), median ratio {ratio.median():.2f}"
    )


if __name__ == "__main__":
    main()
