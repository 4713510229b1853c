"""Tables of a run, and of several runs side by side.

| file | one row for each |
|---|---|
| `summary.csv` | case |
| `table.csv` | condition and point, with the paper's numbers |
| `paired.csv` | measure and pair of conditions, on the same structures |
| `profiles.csv` | condition and range of robots that are alike |
| `scaling.csv` | series, measure and number of robots |
| `suites.csv` | condition and point, with the price of the sensors |
| `comparison.csv` | row of `table.csv` of each run |
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tiswarm.errors import InputError
from tiswarm.evaluation.metrics import mean_std_ci95, paired_difference, power_law_exponent
from tiswarm.evaluation.paper import MM_PER_RADIUS, PAPER, PAPER_ROBOTS, Published
from tiswarm.evaluation.profiles import error_profile, relative_profile
from tiswarm.localization.params import VirtualForceParams
from tiswarm.records.frames import read_frame, write_frame
from tiswarm.records.io import make_folder
from tiswarm.records.terrain import NO_EDGE, Terrain
from tiswarm.robot import RobotGeometry
from tiswarm.scenario.model import Scenario
from tiswarm.sensing import SensingParams
from tiswarm.sensing.suites import SUITES
from tiswarm.study.cases import Case, point_text, series_text, structures
from tiswarm.study.provenance import Cost
from tiswarm.study.store import CaseRecord, RunFolder

_ACCURACY = (
    "rmse_R", "rmse_rho", "rmse_yaw_aligned_R", "rmse_rigid_aligned_R", "rmse_per_contact_R",
    "procrustes_disparity",
)  # fmt: skip
_AVERAGED = (
    "contacts_per_robot", "rms_radius_R", "height_R", "peak_stress", "floppy_modes", "coverage_50",
    "coverage_90", "outlier_precision", "outlier_recall", "converged", "steps_per_robot",
    "located", "rmse_located_R",
    "first_on_anchor", "second_on_anchor", "third_on_anchor", *_ACCURACY,
)  # fmt: skip
_OF_SUITES = ("located", "rmse_located_R", "rmse_R", "procrustes_disparity", "floppy_modes")
_PRICED = (1, 100, 1_000, 10_000)
"""Robots whose sensors have a price in `suites.csv`."""

_SCALED = ("rmse_R", "procrustes_disparity")
_COMPARED = ["run", "series", "against_run", "against_series", "measure"]


def summary(records: Sequence[CaseRecord], settings: Sequence[Scenario]) -> pd.DataFrame:
    """Tabulate every case, failed ones included."""
    rows = [
        {
            "case": record.case,
            "seed": record.seed,
            "series": record.series,
            "condition": record.condition,
            "point": point_text(record.point),
            "kind": setting.structure.kind,
            **record.point,
            "status": record.status,
            "reason": record.reason,
            **_edges(setting.structure.terrain),
            **record.scores,
        }
        for record, setting in zip(records, settings, strict=True)
    ]
    return pd.DataFrame(rows)


def _edges(terrain: Terrain) -> dict[str, float]:
    """Place the edges of the ground, if it has any, for pictures."""
    edges = {"left_edge_R": terrain.left_edge, "right_edge_R": terrain.right_edge}
    return {name: x for name, x in edges.items() if x < NO_EDGE}


def table(records: Sequence[CaseRecord], settings: Sequence[Scenario]) -> pd.DataFrame:
    """Tabulate each point and condition: means over seeds, their uncertainty, paper's numbers.

    Changes are relative to the paper's first condition at the same point, or else the first.
    """
    setting_of = dict(zip([record.case for record in records], settings, strict=True))
    rows = []
    for of_point in _grouped(records, lambda record: point_text(record.point)):
        at_point = []
        for group in _grouped(of_point, lambda record: record.condition):
            first, ours = group[0], _with_statistics(group)
            setting = setting_of[first.case]
            row = {"condition": first.condition, **first.point, **ours}
            at_point.append(row | _rounds(setting) | _paper(setting, ours))
        of_paper = [row for row in at_point if row["paper_rmse_radii"] > 0.0]
        base = (of_paper or at_point)[0]
        for row, (name, rmse) in itertools.product(
            at_point, (("", "rmse_R_mean"), ("paper_", "paper_rmse_radii"))
        ):
            change = row[rmse] / base[rmse] - 1.0 if base[rmse] else math.nan
            row[f"{name}rmse_change_percent"] = 100.0 * change
        rows += at_point
    return pd.DataFrame(rows)


def _rounds(setting: Scenario) -> dict[str, float]:
    """Return the settings of rounds of back-propagation, if there are any; NaN if all robots move.

    The last join is always followed by a round, so there are at most `robots` joins between two.
    """
    method = setting.localization
    if not isinstance(method, VirtualForceParams) or not (rounds := method.back_propagation):
        return {}
    return {
        "round_every": min(rounds.every, setting.robots),
        "round_recent": rounds.recent or math.nan,
        "round_sweeps": rounds.sweeps,
    }


def _published(setting: Scenario) -> Published | None:
    """Return the paper's numbers; it leaves open all gains, and how robots start and walk."""
    method, structure = setting.localization, setting.structure
    open_keys = ("anchor", "climb", "founders", "spawn_behind")
    usual = replace(type(structure)(), **{key: getattr(structure, key) for key in open_keys})
    if (
        setting.robots != PAPER_ROBOTS
        or structure != usual
        or (setting.robot, setting.sensing) != (RobotGeometry(), SensingParams())
        or not isinstance(method, VirtualForceParams)
        or method.back_propagation
    ):
        return None
    return PAPER.get((structure.kind, method.z_correction, method.undocked_repulsion))


def _paper(setting: Scenario, ours: Mapping[str, Any]) -> dict[str, Any]:
    """Return the paper's numbers for a setting of the paper, and ratios of ours to them."""
    cell = _published(setting)
    rmse, disparity = (cell.rmse_radii, cell.disparity) if cell else (math.nan, math.nan)
    return {
        "paper_rmse_radii": rmse,
        "paper_procrustes_disparity": disparity,
        "rmse_mm_mean": ours["rmse_R_mean"] * MM_PER_RADIUS,
        "rmse_mm_ci95": ours["rmse_R_ci95"] * MM_PER_RADIUS,
        "rmse_R_to_paper": ours["rmse_R_mean"] / rmse,
        "rmse_rho_to_paper": ours["rmse_rho_mean"] / rmse,
        "procrustes_disparity_to_paper": ours["procrustes_disparity_mean"] / disparity,
    }


def _with_statistics(records: Sequence[CaseRecord]) -> dict[str, Any]:
    """Count cases, and return means over the finished ones with their uncertainty."""
    scores = pd.DataFrame([record.scores for record in records if record.is_done])
    full: dict[str, Any] = {"cases": len(scores), "failed": len(records) - len(scores)}
    rmse = scores["rmse_R"] if len(scores) else pd.Series([math.nan])
    full |= {"rmse_R_least": float(rmse.min()), "rmse_R_most": float(rmse.max())}
    for name in _AVERAGED:
        column = scores[name] if name in scores else pd.Series(dtype=float)
        values = mean_std_ci95(column.to_numpy(np.float64))
        full |= {f"{name}_{statistic}": value for statistic, value in values.items()}
    return full


def paired(records: Sequence[CaseRecord]) -> pd.DataFrame:
    """Tabulate differences between conditions of a point on the same structures, by measure."""
    rows = []
    for of_point in _grouped(records, lambda record: point_text(record.point)):
        conditions = _grouped(of_point, lambda record: record.condition)
        for first, second in itertools.combinations(conditions, 2):
            names = {"condition": second[0].condition, "against": first[0].condition}
            rows += _differences(
                {**names, **first[0].point},
                _accuracy({record.seed: record for record in first}),
                _accuracy({record.seed: record for record in second}),
            )
    return pd.DataFrame(rows, columns=None if rows else ["condition", "against", "measure"])


def _accuracy(records: Mapping[Any, CaseRecord]) -> pd.DataFrame:
    """Tabulate the accuracy of finished cases by structure, under the keys of these."""
    done = {key: record.scores for key, record in records.items() if record.is_done}
    return pd.DataFrame(list(done.values()), index=pd.Index(list(done)), columns=list(_ACCURACY))


def _differences(
    first_columns: Mapping[str, Any], before: pd.DataFrame, after: pd.DataFrame
) -> list[dict[str, Any]]:
    """Return a row for each measure: difference `after - before` over shared structures."""
    a, b = before.align(after, join="inner", axis=0)
    found = {
        name: paired_difference(a[name].to_numpy(float), b[name].to_numpy(float))
        for name in _ACCURACY
    }
    return [{**first_columns, "measure": name, **row} for name, row in found.items()]


def profiles(records: Sequence[CaseRecord], cases: Path) -> pd.DataFrame:
    """Tabulate errors by join, height, hops and contacts, for each point and condition."""
    parts, names_of = [], []
    done = [record for record in records if record.is_done]
    for of_row in _grouped(done, lambda record: record.series):
        folders = [cases / record.case for record in of_row]
        names = ["z_R", "error_R", "hops_from_anchor", "contacts"]
        robots = [read_frame(folder / "robots.csv", gaps=names) for folder in folders]
        robots = [table.assign(join=np.arange(len(table))) for table in robots]
        names = ["hops_apart", "pairs", "mean_error_R", "rmse_R"]
        relative = [
            read_frame(folder / "relative.csv", numbers=names, empty=True) for folder in folders
        ]
        errors = [error_profile(pd.concat(robots)), relative_profile(pd.concat(relative))]
        parts.append(pd.concat(errors))
        first = {"condition": of_row[0].condition, **of_row[0].point}
        names_of += [first] * len(parts[-1])
    if not parts:
        return pd.DataFrame(columns=["condition", "by"])
    every = pd.concat(parts, ignore_index=True)
    return pd.concat([pd.DataFrame(names_of), every], axis=1)


# --- sensor suites ---------------------------------------------------------------------------


def suites(
    records: Sequence[CaseRecord], settings: Sequence[Scenario], cases: Path
) -> pd.DataFrame:
    """Tabulate what the sensors of each point and condition cost, and how well robots localize.

    A method that places robots one by one states which are located. With any other, those are
    located whose positions its cues determine. Means are over structures.
    """
    setting_of = dict(zip([record.case for record in records], settings, strict=True))
    rows = []
    for group in _grouped(records, lambda record: record.series):
        first, setting = group[0], setting_of[group[0].case]
        suite, touch = SUITES[setting.sensing.suite], setting.sensing.touch
        done = [
            {**record.scores, **_located(cases / record.case)} for record in group if record.is_done
        ]
        row = {
            "condition": first.condition,
            **first.point,
            "suite": suite.name,
            "way": setting.localization.method + ", touch" * touch,
            "needs": suite.needs,
            "cases": len(done),
            **{f"usd_{n}": suite.price(n, touch=touch) for n in _PRICED},
        }
        scores = pd.DataFrame(done, columns=list(_OF_SUITES), dtype=float)
        for name in _OF_SUITES:
            found = mean_std_ci95(scores[name].to_numpy())
            row |= {f"{name}_mean": found["mean"], f"{name}_ci95": found["ci95"]}
        rows.append(row)
    return pd.DataFrame(rows)


def _located(case: Path) -> dict[str, float]:
    """Return the share of robots located and their RMSE, both without the anchor.

    NaN where nothing states it.
    """
    estimate = read_frame(case / "estimate.csv", ["known"]).iloc[1:]
    square = read_frame(case / "robots.csv", gaps=["error_R"])["error_R"].iloc[1:] ** 2
    if "undetermined" in estimate:
        is_located = estimate["undetermined"].isna()
    elif estimate["known"].isna().any():
        return {"located": math.nan, "rmse_located_R": math.nan}
    else:
        is_located = estimate["known"] == "yes"
    return {"located": is_located.mean(), "rmse_located_R": square[is_located].mean() ** 0.5}


# --- size of the swarm -----------------------------------------------------------------------


def scaling(
    cases: Sequence[Case], records: Sequence[CaseRecord], costs: Sequence[Mapping[str, Cost]]
) -> pd.DataFrame:
    """Tabulate accuracy, times and memory of each stage against N, with exponents p of N^p.

    `exponent` is fitted to all sizes; `slope` is p between a size and the one before, where
    constant costs matter less. The growth of a structure counts once for any number of its
    conditions. Memory is that of the whole batch that a structure was computed in. `records` and
    `costs`, by stage, are those of each case.
    """
    record_of = {record.case: record for record in records}
    cost_of = {case.name: cost for case, cost in zip(cases, costs, strict=True)}
    rows = []
    for group in structures(cases):
        done = [case for case in group if record_of[case.name].is_done]
        grown = _together([cost_of[case.name].get("grow", {}) for case in done])
        for case in done:
            point = {key: value for key, value in case.variant.point.items() if key != "robots"}
            measured = {name: record_of[case.name].scores[name] for name in _SCALED}
            for stage, cost in {**cost_of[case.name], "grow": grown}.items():
                measured |= {f"{stage.replace(' ', '_')}_{unit}": n for unit, n in cost.items()}
            series = series_text(point, case.variant.condition)
            row = {"series": series, "robots": case.settings.robots}
            rows += [row | {"measure": name, "mean": value} for name, value in measured.items()]
    table = pd.DataFrame(rows, columns=["series", "measure", "robots", "mean"])
    alike = table.groupby(["series", "measure", "robots"], sort=False, as_index=False)
    points = alike.agg({"mean": "mean"}).sort_values("robots", kind="stable")
    parts = [_with_powers(part) for _, part in points.groupby(["series", "measure"], sort=False)]
    return pd.concat(parts) if parts else _with_powers(points)


def _together(costs: Sequence[Cost]) -> Cost:
    """Return the cost that cases share."""
    known = [cost for cost in costs if cost]
    peak = max((cost["peak_memory_MB"] for cost in known), default=math.nan)
    times = {unit: sum(cost[unit] for cost in known) for unit in ("wall_s", "cpu_s")}
    return {**times, "peak_memory_MB": peak} if known else {}


def _with_powers(points: pd.DataFrame) -> pd.DataFrame:
    """Add the columns `exponent` and `slope` to the means of one measure, by ascending N."""
    robots, mean = points["robots"].to_numpy(float), points["mean"].to_numpy(float)
    known = np.log(np.where(mean > 0.0, mean, math.nan))
    slope = np.diff(known, prepend=math.nan) / np.diff(np.log(robots), prepend=math.nan)
    return points.assign(exponent=power_law_exponent(robots, mean), slope=slope)


# --- several runs ----------------------------------------------------------------------------


def compare(runs: Sequence[Path], out: Path) -> None:
    """Write `comparison.csv`, all rows of the runs' `table.csv`, and `paired.csv`, differences.

    Differences are on the structures that two runs share: those with the same true positions to
    the last bit; names of scenarios do not matter.

    Raises:
        InputError: fewer than two different runs are given, or a folder has no `table.csv`.
        EnvironmentTroubleError: `out` cannot be made.
    """
    if len({run.resolve() for run in runs}) < max(2, len(runs)):
        raise InputError("give two or more different run folders", key="RUN")
    names = [run.resolve().name for run in runs]
    if len(set(names)) < len(names):
        names = [str(run) for run in runs]
    tables = [_read_table(run).assign(run=name) for run, name in zip(runs, names, strict=True)]
    swept = [list(table.columns[1 : table.columns.get_loc("cases")]) for table in tables]
    first = ["run", "condition", *dict.fromkeys(itertools.chain.from_iterable(swept))]
    both = pd.concat(tables, ignore_index=True)
    series = {
        (name, label): accuracy
        for run, name in zip(runs, names, strict=True)
        for label, accuracy in _by_series(RunFolder(run)).items()
    }
    rows = []
    for (one, before), (other, after) in itertools.combinations(series.items(), 2):
        if one[0] != other[0] and not before.index.intersection(after.index).empty:
            pair = dict(zip(_COMPARED, (*other, *one), strict=False))
            rows += _differences(pair, before, after)
    make_folder(out)
    write_frame(both[[*first, *both.columns.difference(first, sort=False)]], out / "comparison.csv")
    write_frame(pd.DataFrame(rows, columns=None if rows else _COMPARED), out / "paired.csv")


def _read_table(run: Path) -> pd.DataFrame:
    path = run / "table.csv"
    if not path.exists():
        msg = "has no table.csv; give a folder that `tiswarm run` made"
        raise InputError(msg, path=run)
    measures = ["rmse_R_mean", "rmse_R_ci95", "procrustes_disparity_mean"]
    return read_frame(path, ["condition"], ["cases"], gaps=measures, numbers_after="cases")


def _by_series(folder: RunFolder) -> dict[str, pd.DataFrame]:
    """Return the accuracy of each series of a run, by the digest of each structure's truth."""
    series: dict[str, dict[str, CaseRecord]] = {}
    for path in sorted(folder.cases.glob("[!.]*")):
        record = folder.read_case(path.name)
        if record is not None and record.is_done:
            series.setdefault(record.series, {})[record.files["truth.csv"]] = record
    return {name: _accuracy(records) for name, records in series.items()}


def _grouped(
    records: Sequence[CaseRecord], key: Callable[[CaseRecord], str]
) -> list[list[CaseRecord]]:
    """List records with the same key, in the order in which each key first appears."""
    groups: dict[str, list[CaseRecord]] = {}
    for record in records:
        groups.setdefault(key(record), []).append(record)
    return list(groups.values())
