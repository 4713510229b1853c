"""Facts of a run of `scenarios/paper.yaml` that its tables do not have.

*Contact-Driven Localization in a Freeform Robotic Self-Assembled Structure* says in sentences what
its scatter plots and curves show. `benchmarks.results` stores these facts of a run beside the
means of measures, and `benchmarks/paper_sentences.py` sets them beside the sentences.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from scipy.stats import spearmanr, wilcoxon

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.math import dock_offsets
from tiswarm.evaluation import metrics
from tiswarm.report.run_data import load_run
from tiswarm.world.params import ClimbParams

SCENARIO = "paper"
"""Name of the scenario."""

NEAR = 0.5
"""Gap up to which docks that do not touch count as near [R]."""

_TOUCHING = ClimbParams().contact_gap
"""Gap up to which docks touch [R]."""

_EARLY = 10
"""Largest join index of the robots that the paper calls early."""

_TILT_DEG = 10.0
"""Inclination of a tower in the paper's example of the disparity."""

_CLOSE = 1.1
"""Multiple of the last RMSE from which on an estimate counts as settled."""

THIRDS = ("low", "middle", "high")
"""Thirds of the height of a tower."""


class Fact(NamedTuple):
    """A number of a case."""

    unit: str
    """Its unit."""

    compute: Callable[[pd.DataFrame], float]
    """Compute it from a table of robots in join order; NaN where it does not exist."""


def _errors(robots: pd.DataFrame, *, early: bool) -> float:
    """Return the mean error of robots up to the join index `_EARLY`, or of the later ones [R]."""
    error = robots["error_R"].to_numpy(float)
    return float(error[1 : _EARLY + 1].mean() if early else error[_EARLY + 1 :].mean())


def _around_anchor(robots: pd.DataFrame, *, before: bool) -> float:
    """Return the mean error of robots that joined before the first on the anchor, or not [R]."""
    later = robots["hops_from_anchor"].iloc[1:] == 1
    if not later.any():
        return np.nan
    first = int(later.to_numpy().argmax()) + 1
    error = robots["error_R"].to_numpy(float)
    part = error[1:first] if before else error[first:]
    return float(part.mean()) if len(part) else np.nan


def _correlation(robots: pd.DataFrame, column: str) -> float:
    """Return Spearman's rank correlation of the error with a column, without the anchor."""
    return float(spearmanr(robots[column].iloc[1:], robots["error_R"].iloc[1:]).statistic)


def near_docks(place: Reals, wxyz: Reals, robot: RobotGeometry) -> float:
    """Count pairs of docks per robot that are less than `NEAR` apart, but do not touch.

    Args:
        place: Centers of N robots [R], shape (N, 3).
        wxyz: Their orientations, body to world, shape (N, 4).
        robot: Geometry of a robot.
    """
    arms = dock_offsets(wxyz, robot.dock_offset_body)
    center = (place[:, None] + arms).reshape(-1, 3)
    pair = cKDTree(center).query_pairs(2.0 + NEAR, output_type="ndarray")
    first, second = (pair // arms.shape[1]).T
    gap = np.linalg.norm(center[pair[:, 0]] - center[pair[:, 1]], axis=1) - 2.0
    return np.count_nonzero((first != second) & (gap > _TOUCHING)) / len(place)


def thirds(height: Reals) -> Ints:
    """Return in which third of the greatest height each robot is, 0 to 2; shape (N,) as heights."""
    third: Ints = np.clip(np.floor(3.0 * height / height.max()).astype(np.int64), 0, 2)
    return third


def narrows(height: Reals) -> bool:
    """Whether each third of the height holds fewer robots than the one below it."""
    lower, middle, upper = np.bincount(thirds(height), minlength=3)
    return bool(lower > middle > upper)


def _near_docks(robots: pd.DataFrame) -> float:
    place = robots[["x_R", "y_R", "z_R"]].to_numpy(float)
    return near_docks(place, robots[["qw", "qx", "qy", "qz"]].to_numpy(float), RobotGeometry())


def tilted_rmse(robots: pd.DataFrame) -> float:
    """Return the RMSE of a structure that leans by `_TILT_DEG` about its anchor [R]."""
    place = robots[["x_R", "y_R", "z_R"]].to_numpy(float)
    lean = Rotation.from_euler("x", _TILT_DEG, degrees=True)
    return float(metrics.rmse(place[0] + lean.apply(place - place[0]), place))


OF_ROBOTS = {
    "near_docks": Fact("1", _near_docks),
    "narrows": Fact("1", lambda robots: float(narrows(robots["z_R"].to_numpy(float)))),
    "tilted_rmse_R": Fact("R", tilted_rmse),
    "early_error_R": Fact("R", lambda robots: _errors(robots, early=True)),
    "late_error_R": Fact("R", lambda robots: _errors(robots, early=False)),
    "before_anchor_error_R": Fact("R", lambda robots: _around_anchor(robots, before=True)),
    "from_anchor_error_R": Fact("R", lambda robots: _around_anchor(robots, before=False)),
    "join_correlation": Fact("1", lambda robots: _correlation(robots, "robot")),
    "hops_correlation": Fact("1", lambda robots: _correlation(robots, "hops_from_anchor")),
}
"""Facts of `robots.csv` of a case, by the name of the measure."""


def settled_step(convergence: pd.DataFrame) -> float:
    """Return the step from which on the RMSE stays within `_CLOSE` times its last value."""
    rmse = convergence["rmse_R"].to_numpy(float)
    far = np.flatnonzero(rmse > _CLOSE * rmse[-1])
    step = convergence["iteration"].to_numpy(float)
    return float(step[far[-1] + 1] if len(far) else step[0])


OF_STEPS = {
    "start_rmse_R": Fact("R", lambda convergence: float(convergence["rmse_R"].iloc[0])),
    "settled_step": Fact("1", settled_step),
}
"""Facts of `convergence.csv` of a case, by the name of the measure."""

UNITS = {name: fact.unit for name, fact in (OF_ROBOTS | OF_STEPS).items()} | {
    "both_at_once": "1",
    "whole": "1",
}
"""Units of the facts of cases."""


def with_facts(run: Path, cases: pd.DataFrame) -> pd.DataFrame:
    """Add the facts of each finished case as columns.

    Args:
        run: Folder of the run.
        cases: Its `summary.csv`, rows of finished cases.
    """
    folders = {case.name: case.folder for case in load_run(run).cases}
    rows = []
    for name in cases["case"]:
        robots = pd.read_csv(folders[name] / "robots.csv")
        steps = pd.read_csv(folders[name] / "convergence.csv")
        rows.append(
            {key: fact.compute(robots) for key, fact in OF_ROBOTS.items()}
            | {key: fact.compute(steps) for key, fact in OF_STEPS.items()}
        )
    facts = pd.DataFrame(rows, index=cases.index)
    facts["both_at_once"] = (cases["second_on_anchor"] == 2).astype(float)  # noqa: PLR2004 - robots 1, 2
    facts["whole"] = (cases["joined"] == cases["robots"]).astype(float)
    return cases.join(facts)


def of_groups(run: Path, cases: pd.DataFrame) -> pd.DataFrame:
    """Tabulate facts of all structures of a condition and point together.

    Returns:
        A row each: condition, point, measure, value, unit. They are the least RMSE of a structure
        and its standard deviation over structures; standard deviations of the errors of all robots
        by third of the height; median and quartiles of the first robot on the anchor; and p of
        Wilcoxon's signed-rank test of RMSE and disparity against the condition before.
    """
    folders = {case.name: case.folder for case in load_run(run).cases}
    rows: list[tuple[str, str, str, float, str]] = []
    for point, at_point in cases.groupby("point", sort=False):
        before = None
        for condition, group in at_point.groupby("condition", sort=False):
            values = {
                ("rmse_least_R", "R"): group["rmse_R"].min(),
                ("rmse_sd_R", "R"): group["rmse_R"].std(),
                ("first_median", "1"): _quartile(group, 0.5, "lower"),
                ("first_quartile", "1"): _quartile(group, 0.25, "lower"),
                ("third_quartile", "1"): _quartile(group, 0.75, "higher"),
            }
            spread = _spreads([pd.read_csv(folders[n] / "robots.csv") for n in group["case"]])
            values |= {(f"error_sd_{third}_R", "R"): sd for third, sd in spread.items()}
            by_seed = group.set_index("seed").sort_index()
            if before is not None:
                for measure in ("rmse_R", "procrustes_disparity"):
                    change = (by_seed[measure] - before[measure]).dropna()
                    values[f"{measure}_p", "1"] = wilcoxon(change).pvalue
            before = by_seed
            rows += [
                (str(condition), str(point), name, float(value), unit)
                for (name, unit), value in values.items()
            ]
    return pd.DataFrame(rows, columns=["condition", "point", "measure", "value", "unit"])


def _quartile(group: pd.DataFrame, share: float, side: Literal["lower", "higher"]) -> float:
    """Return a quartile of the first robot on the anchor; infinite if too few ever touch it."""
    first = group["first_on_anchor"].fillna(np.inf).to_numpy(float)
    return float(np.quantile(first, share, method=side))


def _spreads(structures: list[pd.DataFrame]) -> dict[str, float]:
    """Return the standard deviation of the errors of robots by third of the height [R]."""
    third = np.concatenate([thirds(robots["z_R"].to_numpy(float))[1:] for robots in structures])
    error = np.concatenate([robots["error_R"].to_numpy(float)[1:] for robots in structures])
    return {name: float(error[third == n].std(ddof=1)) for n, name in enumerate(THIRDS)}
