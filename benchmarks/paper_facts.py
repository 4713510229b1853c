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
from scipy.stats import spearmanr, wilcoxon

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.math import dock_offsets
from tiswarm.evaluation.tables import DOCK_DIAMETER
from tiswarm.report.run_data import load_run
from tiswarm.world.params import ClimbParams

SCENARIO = "paper"
"""Name of the scenario."""

ALL, NO_Z, NEITHER = "all-cues", "no-z", "no-z-no-undock"
"""Conditions of the paper's table."""

OWN_AXIS = "own-axis-"
"""Start of the names of conditions in which robots without Z start along their own z axis."""

_BEFORE = {
    NO_Z: ALL,
    NEITHER: NO_Z,
    OWN_AXIS + NO_Z: ALL,
    OWN_AXIS + NEITHER: OWN_AXIS + NO_Z,
}
"""The condition with one cue more, by condition."""

NEAR = 0.5
"""Gap up to which docks that do not touch count as near [R]."""

_TOUCHING = ClimbParams().contact_gap
"""Gap up to which docks touch [R]."""

_EARLY = 10
"""Number of the robots that the paper calls early, the anchor among them."""

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
    """Return the mean error of the first `_EARLY` robots but the anchor, or of the others [R]."""
    error = robots["error_R"].to_numpy(float)
    return float(error[1:_EARLY].mean() if early else error[_EARLY:].mean())


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
    return _apart(place, place, dock_offsets(wxyz, robot.dock_offset_body), DOCK_DIAMETER + NEAR)


def collapsed_docks(place: Reals, estimate: Reals, wxyz: Reals, robot: RobotGeometry) -> float:
    """Count pairs of docks per robot that do not touch, but overlap by `NEAR` in the estimate.

    Args:
        place: Centers of N robots [R], shape (N, 3).
        estimate: Their estimates [R], shape (N, 3).
        wxyz: Their orientations, body to world, shape (N, 4).
        robot: Geometry of a robot.
    """
    return _apart(place, estimate, dock_offsets(wxyz, robot.dock_offset_body), DOCK_DIAMETER - NEAR)


def _apart(place: Reals, estimate: Reals, arms: Reals, distance: float) -> float:
    """Count pairs of docks per robot that do not touch, but are near by the estimate.

    Args:
        place: Centers of N robots [R], shape (N, 3).
        estimate: Their estimates [R], shape (N, 3).
        arms: Offsets of their n docks in the world [R], shape (N, n, 3).
        distance: Distance below which the estimated docks are near [R].
    """
    docks, estimated = ((center[:, None] + arms).reshape(-1, 3) for center in (place, estimate))
    pair = cKDTree(estimated).query_pairs(distance, output_type="ndarray")
    first, second = (pair // arms.shape[1]).T
    gap = np.linalg.norm(docks[pair[:, 0]] - docks[pair[:, 1]], axis=1) - DOCK_DIAMETER
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
    return near_docks(*_poses(robots), RobotGeometry())


def _collapsed_docks(robots: pd.DataFrame) -> float:
    place, wxyz = _poses(robots)
    estimate = robots[["x_est_R", "y_est_R", "z_est_R"]].to_numpy(float)
    return collapsed_docks(place, estimate, wxyz, RobotGeometry())


def _poses(robots: pd.DataFrame) -> tuple[Reals, Reals]:
    """Return centers [R], shape (N, 3), and orientations, body to world, shape (N, 4)."""
    place = robots[["x_R", "y_R", "z_R"]].to_numpy(float)
    return place, robots[["qw", "qx", "qy", "qz"]].to_numpy(float)


OF_ROBOTS = {
    "near_docks": Fact("1", _near_docks),
    "collapsed_docks": Fact("1", _collapsed_docks),
    "narrows": Fact("1", lambda robots: float(narrows(robots["z_R"].to_numpy(float)))),
    "early_error_R": Fact("R", lambda robots: _errors(robots, early=True)),
    "late_error_R": Fact("R", lambda robots: _errors(robots, early=False)),
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

UNITS = {name: fact.unit for name, fact in (OF_ROBOTS | OF_STEPS).items()} | {"both_at_once": "1"}
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
    return cases.join(facts)


def of_groups(run: Path, cases: pd.DataFrame) -> pd.DataFrame:
    """Tabulate facts of all structures of a condition and point together.

    Returns:
        A row each: condition, point, measure, value, unit. They are the least RMSE of a structure
        and its standard deviation over structures; standard deviations of the errors of all robots
        by third of the height; median and quartiles of the first robot on the anchor; and p of
        Wilcoxon's signed-rank test of RMSE and disparity against the condition with one cue more
        (`_p`), and against all cues (`_p_all`).
    """
    folders = {case.name: case.folder for case in load_run(run).cases}
    rows: list[tuple[str, str, str, float, str]] = []
    for point, at_point in cases.groupby("point", sort=False):
        conditions = {
            str(condition): group.set_index("seed").sort_index()
            for condition, group in at_point.groupby("condition", sort=False)
        }
        for condition, group in conditions.items():
            values = {
                ("rmse_least_R", "R"): group["rmse_R"].min(),
                ("rmse_sd_R", "R"): group["rmse_R"].std(),
                ("first_median", "1"): _quartile(group, 0.5, "lower"),
                ("first_quartile", "1"): _quartile(group, 0.25, "lower"),
                ("third_quartile", "1"): _quartile(group, 0.75, "higher"),
            }
            spread = _spreads([pd.read_csv(folders[n] / "robots.csv") for n in group["case"]])
            values |= {(f"error_sd_{third}_R", "R"): sd for third, sd in spread.items()}
            if condition in _BEFORE:
                for end, reference in (("p", _BEFORE[condition]), ("p_all", ALL)):
                    for measure in ("rmse_R", "procrustes_disparity"):
                        change = (group[measure] - conditions[reference][measure]).dropna()
                        values[f"{measure}_{end}", "1"] = wilcoxon(change).pvalue
            rows += [
                (condition, str(point), name, float(value), unit)
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
