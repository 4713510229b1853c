"""Tables of a run.

| file | one row for each |
|---|---|
| `summary.csv` | case |
| `table.csv` | condition and point, with the paper's numbers |
| `paired.csv` | measure and pair of conditions, on the same structures; of cases with estimates |
| `profiles.csv` | condition and range of robots that are alike; of cases with estimates |
| `throughput.csv` | condition and number of robots of runs of the engine: robot steps a second |
| `scaling.csv` | condition, measure and number of robots, threads, workers or movers |
| `suites.csv` | condition and point, with the price of the sensors |
"""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.base.progress import Progress
from tiswarm.base.registry import get, registered
from tiswarm.base.robot import RobotGeometry
from tiswarm.evaluation import metrics, paper
from tiswarm.evaluation.tables import plugin_scores
from tiswarm.localization.methods import LocalizationParams
from tiswarm.localization.settings import VirtualForceParams
from tiswarm.records import measures
from tiswarm.records.estimate import Estimate
from tiswarm.records.frames import read_frame, write_frame
from tiswarm.records.intervals import ends_of, mean_std_ci95
from tiswarm.records.io import run_file
from tiswarm.records.measures import Measure
from tiswarm.records.messages import counted
from tiswarm.records.positions import Truth, read_estimate
from tiswarm.records.run_folder import NO_METHOD
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_log import SensingLog
from tiswarm.records.terrain import NO_EDGE, Terrain
from tiswarm.scenario.expansion import Case, Group, Plan, load_scenario, plan
from tiswarm.scenario.model import Scenario
from tiswarm.sensing import SensingParams
from tiswarm.study.provenance import Cost
from tiswarm.study.runner import grow_again
from tiswarm.study.scaling import scaling
from tiswarm.study.store import CaseRecord, RunFolder
from tiswarm.world.ground.solid import SolidGround
from tiswarm.world.history import History
from tiswarm.world.params import structure_ground

_RECRUITMENT = ("force_threshold", "recruit_base", "recruit_limit")
_ROUNDING_R = 1e-9
"""RMSE [R] that rounding explains: no other one is a multiple of it."""

_PRICED = (1, 100, 1_000, 10_000)
"""Robots whose sensors have a price in `suites.csv`."""


def write_tables(
    run: Path,
    whole: Plan,
    stored: Mapping[str, CaseRecord],
    costs: Mapping[str, Mapping[str, Cost]],
) -> None:
    """Write all tables of a run folder from the records and costs of its stored cases, by name."""
    cases = [case for case in whole.cases if case.name in stored]
    scored = _with_plugin_scores(RunFolder(run), whole.structures, stored)
    records = [scored[case.name] for case in cases]
    settings = [case.settings for case in cases]
    written = {"summary": summary(records, settings), "table": table(records, settings)}
    localized = [(r, s) for r, s in zip(records, settings, strict=True) if _is_localized(s)]
    if localized:
        records = [record for record, _ in localized]
        settings = [setting for _, setting in localized]
        written["paired"] = paired(records, settings)
        written["profiles"] = profiles(records, run / "cases")
        if {setting.sensing.suite for setting in settings} != {SensingParams().suite}:
            written["suites"] = suites(records, settings, run / "cases")
    if any(setting.localization.runs_engine for setting in settings):
        written["throughput"] = throughput(records, settings, costs)
    else:
        written |= scaling(run, whole.structures, stored, costs)
    for name, content in written.items():
        write_frame(content, run / f"{name}.csv")


def _is_localized(setting: Scenario) -> bool:
    """Whether a case estimates positions."""
    return setting.localization.places_robots


class MeasureTrial:
    """Computes the measures of plug-ins for the first finished case.

    Else one that fails would end a study after its last case.
    """

    def __init__(self, folder: RunFolder, structures: Sequence[Group]) -> None:
        """Take the folder of the run, and its cases by the structure that they share."""
        self.is_due = bool(registered("measure"))
        self._folder = folder
        self._cases = {case.name: case for group in structures for case in group}

    def try_on(self, records: Iterable[CaseRecord]) -> None:
        """Compute the measures for the first of the records that is done, unless they have been.

        Raises:
            PluginError: a measure failed, or returned something else than a number.
        """
        if not self.is_due:
            return
        done = [record for record in records if record.is_done]
        if done:
            group = [self._cases[done[0].case]]
            _with_plugin_scores(self._folder, [group], {done[0].case: done[0]})
            self.is_due = False


def _with_plugin_scores(
    folder: RunFolder, structures: Sequence[Group], stored: Mapping[str, CaseRecord]
) -> dict[str, CaseRecord]:
    """Add the measures of plug-ins to records, from the files of their cases; return all by name.

    Other tables follow from the records; the cases themselves stay as they are, so that an edit of
    a measure computes no case again.
    """
    scored = dict(stored)
    runs_engine = any(case.settings.localization.runs_engine for g in structures for case in g)
    if runs_engine or not registered("measure"):
        return scored
    for group in structures:
        done = [case for case in group if case.name in stored and stored[case.name].is_done]
        shared = _SharedHistory(folder, done)
        for case in done:
            record = stored[case.name]
            scores = {**record.scores, **plugin_scores(_StoredParts(folder, case, shared).part)}
            scored[case.name] = replace(record, scores=scores)
    return scored


class _SharedHistory:
    """The history of a structure, which its cases share: kept by the run, or grown again."""

    def __init__(self, folder: RunFolder, cases: Group) -> None:
        self._folder = folder
        self._cases = cases

    @cached_property
    def history(self) -> History:
        """The history, as it was grown."""
        kept = self._folder.read_structure(self._cases[0])
        return grow_again(self._cases[0]) if kept is None else kept[0]


class _StoredParts:
    """The parts of a stored case, each read once, as a measure asks for it."""

    def __init__(self, folder: RunFolder, case: Case, shared: _SharedHistory) -> None:
        self._path = folder.cases / case.name
        self._shared = shared
        self.settings = case.settings

    def part(self, name: str) -> object:
        """Return a part by its name; None where the case has none."""
        return getattr(self, name)

    @property
    def history(self) -> History:
        """The structure, with all stances and loads."""
        return self._shared.history

    @cached_property
    def log(self) -> SensingLog:
        """What robots sensed."""
        return read_sensing_log(self._path / "sensing.jsonl")

    @cached_property
    def estimate(self) -> Estimate | None:
        """Where robots are by the method; None without one."""
        if not _is_localized(self.settings):
            return None
        return read_estimate(self.log, self._path / "estimate.csv")

    @cached_property
    def truth(self) -> Truth:
        """Where robots are."""
        position = ["x_R", "y_R", "z_R"]
        orientation = ["qw", "qx", "qy", "qz"]
        robots = read_frame(self._path / "robots.csv", [*position, *orientation])
        return Truth(
            robot_id=self.log.robot_id,
            position=robots[position].to_numpy(float),
            orientation_wxyz=robots[orientation].to_numpy(float),
        )


def summary(records: Sequence[CaseRecord], settings: Sequence[Scenario]) -> pd.DataFrame:
    """Tabulate every case, failed ones included."""
    rows = [
        {
            "case": record.case,
            "seed": record.seed,
            "series": record.series,
            "condition": record.condition,
            "point": record.point_text,
            "kind": _kind(setting),
            "method": _title(setting.localization),
            **record.point_cells,
            "robots": setting.robots,
            "measurements": record.measurements,
            "status": record.status,
            "distrust": record.distrust,
            "reason": record.reason,
            **({} if setting.localization.runs_engine else _edges(_ground(setting))),
            **record.scores,
        }
        for record, setting in zip(records, settings, strict=True)
    ]
    return pd.DataFrame(rows)


def _title(method: LocalizationParams) -> str:
    """Name a method, with what else makes it another one."""
    return " ".join([method.title, *filter(None, [getattr(method, "scheme", None)])])


def _kind(setting: Scenario) -> str:
    """Return the kind of a structure; runs of the engine have a swarm in its place."""
    return "swarm" if setting.localization.runs_engine else setting.structure.kind


def _ground(setting: Scenario) -> Terrain | SolidGround:
    return structure_ground(setting.structure)


def _edges(terrain: Terrain | SolidGround) -> dict[str, float]:
    """Place the edges of the ground, if it has any, for pictures."""
    edges = {"left_edge_R": terrain.left_edge, "right_edge_R": terrain.right_edge}
    return {name: x for name, x in edges.items() if x < NO_EDGE}


def table(records: Sequence[CaseRecord], settings: Sequence[Scenario]) -> pd.DataFrame:
    """Tabulate each point and condition: means over seeds, their uncertainty, paper's numbers.

    Changes are relative to the paper's first condition at the same point, or else the first. Where
    no case has an estimate, what needs one has no column.
    """
    with_estimates = any(map(_is_localized, settings))
    averaged = _averaged(settings)
    setting_of = dict(zip([record.case for record in records], settings, strict=True))
    rows = []
    for of_point in _grouped(records, lambda record: record.point_text):
        at_point = []
        for group in _grouped(of_point, lambda record: record.condition):
            first = group[0]
            statistics = _with_statistics(group, averaged)
            setting = setting_of[first.case]
            used = {"measurements": _used(record.measurements for record in group)}
            used |= {"kind": _kind(setting), "method": _title(setting.localization)}
            row = {"condition": first.condition, **first.point_cells, **statistics, **used}
            if with_estimates:
                row |= _rounds(setting) | _paper(setting, statistics)
            at_point.append(row)
        if not with_estimates:
            rows += at_point
            continue
        of_paper = [row for row in at_point if row[measures.RMSE.published] > 0.0]
        of_estimates = [row for row in at_point if row["method"] != NO_METHOD]
        base = (of_paper or of_estimates or at_point)[0]
        for row, (name, rmse) in itertools.product(
            at_point, (("", measures.RMSE.mean), ("paper_", measures.RMSE.published))
        ):
            change = row[rmse] / base[rmse] - 1.0 if base[rmse] > _ROUNDING_R else math.nan
            row[f"{name}rmse_change_percent"] = 100.0 * change
        rows += at_point
    return pd.DataFrame(rows)


def _rounds(setting: Scenario) -> dict[str, float]:
    """Return the settings of rounds of back-propagation, if there are any; NaN if all robots move.

    The last join is always followed by a round, so there are at most `robots` joins between two.
    """
    method = setting.localization
    if not isinstance(method, VirtualForceParams) or not method.back_propagation:
        return {}
    rounds = method.back_propagation
    return {
        "round_every": min(rounds.every, setting.robots),
        "round_recent": rounds.recent or math.nan,
        "round_sweeps": rounds.sweeps,
    }


def _published(setting: Scenario) -> paper.Published | None:
    """Return the paper's numbers; it leaves open all gains, and how robots start, walk and call."""
    method = setting.localization
    structure = setting.structure
    if structure.kind not in {kind for kind, *_ in paper.PAPER}:
        return None
    open_keys = ("anchor", "climb", "founders", "spawn_behind", *_RECRUITMENT)
    usual = replace(type(structure)(), **{key: getattr(structure, key) for key in open_keys})
    if (
        setting.robots != paper.PAPER_ROBOTS
        or structure != usual
        or (setting.robot, setting.sensing) != (RobotGeometry(), SensingParams())
        or not isinstance(method, VirtualForceParams)
        or method.back_propagation
    ):
        return None
    return paper.PAPER.get((structure.kind, method.z_correction, method.undocked_repulsion))


def _paper(setting: Scenario, ours: Mapping[str, Any]) -> dict[str, Any]:
    """Return the paper's numbers for a setting of the paper, and ratios of ours to them."""
    cell = _published(setting)
    rmse, disparity = (cell.rmse_radii, cell.disparity) if cell else (math.nan, math.nan)
    return {
        measures.RMSE.published: rmse,
        measures.DISPARITY.published: disparity,
        **{
            f"{of.column}_to_paper": ours[of.mean] / rmse
            for of in (measures.RMSE, measures.RMSE_RHO)
        },
        f"{measures.DISPARITY.column}_to_paper": ours[measures.DISPARITY.mean] / disparity,
    }


def _averaged(settings: Sequence[Scenario]) -> list[Measure]:
    """List the measures whose means a study has."""
    all_averaged = [measure for measure in measures.all_measures() if measure.averaged]
    if any(setting.localization.runs_engine for setting in settings):
        return [measure for measure in all_averaged if measure.is_of_engine]
    with_estimates = any(map(_is_localized, settings))
    return [
        measure
        for measure in all_averaged
        if not measure.is_of_engine and (with_estimates or not measure.needs_estimate)
    ]


def _with_statistics(records: Sequence[CaseRecord], averaged: Sequence[Measure]) -> dict[str, Any]:
    """Count cases, and return means over the finished ones with their uncertainty and range."""
    scores = pd.DataFrame([record.scores for record in records if record.is_done])
    full: dict[str, Any] = {"cases": len(scores), "failed": len(records) - len(scores)}
    for measure in averaged:
        column = scores.get(measure.column, pd.Series(dtype=float))
        values = column.to_numpy(np.float64)
        statistics = _statistics(measure, values)
        full |= {measure.statistic(name): value for name, value in statistics.items()}
    return full


def _statistics(measure: Measure, values: Reals) -> dict[str, float]:
    """Return the mean of a measure over structures with its uncertainty and range."""
    statistics = mean_std_ci95(values) | metrics.least_and_most(values)
    if measure.is_share:
        del statistics["ci95"]
        statistics |= ends_of(measure, values)
    if measure.is_yes_or_no:
        statistics["count"] = int(np.isfinite(values).sum())
    return statistics


def _used(measurements: Iterable[str]) -> str:
    """List what was measured of some structures, those with most measurements first."""
    lists = sorted(dict.fromkeys(measurements), key=len, reverse=True)
    names = [name for text in lists for name in text.split(", ") if name]
    return ", ".join(dict.fromkeys(names))


def paired(records: Sequence[CaseRecord], settings: Sequence[Scenario]) -> pd.DataFrame:
    """Tabulate differences between conditions of a point on the same structures, by measure.

    Measurements of two conditions are equal if robots sense alike and the methods use the same of
    each structure.
    """
    sensed = dict(zip([record.case for record in records], settings, strict=True))
    rows = []
    for of_point in _grouped(records, lambda record: record.point_text):
        conditions = _grouped(of_point, lambda record: record.condition)
        for first, second in itertools.combinations(conditions, 2):
            if sensed[first[0].case].structure.navigate_by == "estimate":
                continue  # each condition built structures of its own
            names = {"condition": second[0].condition, "against": first[0].condition}
            senses = {repr(sensed[group[0].case].sensing) for group in (first, second)}
            used_first, used_second = (
                {r.seed: r.measurements for r in group if r.is_done} for group in (first, second)
            )
            seeds = used_first.keys() & used_second.keys()
            is_equal = bool(seeds) and len(senses) == 1
            is_equal = is_equal and all(
                used_first[seed] == used_second[seed] != "" for seed in seeds
            )
            rows += differences(
                {**names, **first[0].point_cells},
                accuracy_by_key({record.seed: record for record in first}),
                accuracy_by_key({record.seed: record for record in second}),
                equal_measurements=is_equal,
            )
    return pd.DataFrame(rows, columns=None if rows else ["condition", "against", "measure"])


def accuracy_by_key(records: Mapping[Any, CaseRecord]) -> pd.DataFrame:
    """Tabulate the accuracy of finished cases by structure, under the keys of these."""
    done = {key: record.scores for key, record in records.items() if record.is_done}
    return pd.DataFrame(
        list(done.values()),
        index=pd.Index(list(done)),
        columns=[measure.column for measure in measures.paired_measures()],
    )


def differences(
    first_columns: Mapping[str, Any],
    before: pd.DataFrame,
    after: pd.DataFrame,
    **last_columns: object,
) -> list[dict[str, Any]]:
    """Return a row for each measure: difference `after - before` over shared structures."""
    a, b = before.align(after, join="inner", axis=0)
    statistics = {
        name: metrics.paired_difference(a[name].to_numpy(float), b[name].to_numpy(float))
        for name in a
    }
    return [
        {**first_columns, "measure": name, **row, **last_columns}
        for name, row in statistics.items()
    ]


def profiles(records: Sequence[CaseRecord], cases: Path) -> pd.DataFrame:
    """Tabulate errors by join, height, hops and contacts, for each point and condition."""
    profiles_of_series = []
    names_of = []
    done = [record for record in records if record.is_done]
    for of_row in _grouped(done, lambda record: record.series):
        folders = [cases / record.case for record in of_row]
        names = ["z_R", "error_R", "hops_from_anchor", "contacts"]
        robots = [read_frame(folder / "robots.csv", gaps=names) for folder in folders]
        robots = [table.assign(join=np.arange(len(table))) for table in robots]
        gone = ["left", "fell"]
        robots = [t[~t["lost"].isin(gone)] if "lost" in t else t for t in robots]
        robots = [t[[*names, "join"]] for t in robots]
        names = ["hops_apart", "pairs", "mean_error_R", measures.RMSE.column]
        relative = [
            read_frame(folder / "relative.csv", numbers=names, empty=True) for folder in folders
        ]
        errors = [
            metrics.error_profile(_joined_tables(robots)),
            metrics.relative_profile(_joined_tables(relative)),
        ]
        profiles_of_series.append(_joined_tables(errors))
        first = {"condition": of_row[0].condition, **of_row[0].point_cells}
        names_of += [first for _ in range(len(profiles_of_series[-1]))]
    if not profiles_of_series:
        return pd.DataFrame(columns=["condition", "by"])
    rows = pd.concat(profiles_of_series, ignore_index=True)
    return pd.concat([pd.DataFrame(names_of), rows], axis=1)


def _joined_tables(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Join tables of equal columns; those without rows have no types that count."""
    with_rows = [table for table in tables if len(table)]
    return pd.concat(with_rows or tables[:1])


def throughput(
    records: Sequence[CaseRecord],
    settings: Sequence[Scenario],
    costs: Mapping[str, Mapping[str, Cost]],
) -> pd.DataFrame:
    """Tabulate how many steps of a robot the engine takes in a second, and its memory.

    Rows are points and conditions; means are over finished cases. Preparation and compilation do
    not count, neighbor lists do.
    """
    setting_of = dict(zip([record.case for record in records], settings, strict=True))
    rows = []
    for group in _grouped(records, lambda record: record.series):
        first = group[0]
        setting = setting_of[first.case]
        steps = getattr(setting.localization, "steps", 0)
        spent = [costs[r.case]["relax"] for r in group if r.is_done and "relax" in costs[r.case]]
        row = {
            "condition": first.condition,
            **first.point_cells,
            "cases": len(spent),
            "robot_count": setting.robots,
            "steps": steps,
        }
        for unit in ("cpu_s", "wall_s"):
            rates = [setting.robots * steps / max(cost[unit], 1e-9) for cost in spent]
            row[f"robot_steps_per_{unit}"] = float(np.mean(rates)) if rates else math.nan
            row[f"least_per_{unit}"] = min(rates, default=math.nan)
            row[f"most_per_{unit}"] = max(rates, default=math.nan)
        row["peak_memory_MB"] = max((cost["peak_memory_MB"] for cost in spent), default=math.nan)
        rows.append(row)
    return pd.DataFrame(rows)


def suites(
    records: Sequence[CaseRecord], settings: Sequence[Scenario], cases: Path
) -> pd.DataFrame:
    """Tabulate what the sensors of each point and condition cost, and how well robots localize.

    A method that places robots one by one states which are located. With any other, those are
    located whose positions its cues determine. Means are over structures.
    """
    setting_of = dict(zip([record.case for record in records], settings, strict=True))
    shown = measures.PAGE["suites"]
    rows = []
    for group in _grouped(records, lambda record: record.series):
        first = group[0]
        setting = setting_of[first.case]
        suite = get("sensor", setting.sensing.suite)
        touch = setting.sensing.touch
        method = setting.localization.method
        done = [
            {**record.scores, **_located(cases / record.case)} for record in group if record.is_done
        ]
        row = {
            "condition": first.condition,
            **first.point_cells,
            "suite": setting.sensing.suite,
            "way": f"{method} / touch" if touch else method,
            "needs": suite.needs,
            "cases": len(done),
            **{f"usd_{n}": suite.price(n, touch=touch) for n in _PRICED},
        }
        scores = pd.DataFrame(done, columns=[measure.column for measure in shown], dtype=float)
        for measure in shown:
            statistics = _statistics(measure, scores[measure.column].to_numpy())
            intervals = (name for name in statistics if name.startswith("ci95"))
            row |= {measure.statistic(name): statistics[name] for name in ("mean", *intervals)}
        rows.append(row)
    return pd.DataFrame(rows)


def _located(case: Path) -> dict[str, float]:
    """Return the share of robots located and their RMSE, both without the anchor.

    NaN where nothing states it.
    """
    names = measures.LOCATED.column, measures.RMSE_LOCATED.column
    estimate = read_frame(case / "estimate.csv", ["known"]).iloc[1:]
    square = read_frame(case / "robots.csv", gaps=["error_R"])["error_R"].iloc[1:] ** 2
    if "undetermined" in estimate:
        is_located = estimate["undetermined"].isna()
    elif estimate["known"].isna().any():
        return dict.fromkeys(names, math.nan)
    else:
        is_located = estimate["known"].isin(["yes", "mirrored"])
    return dict(zip(names, (is_located.mean(), square[is_located].mean() ** 0.5), strict=True))


def _grouped(
    records: Sequence[CaseRecord], key: Callable[[CaseRecord], str]
) -> list[list[CaseRecord]]:
    """List records with the same key, in the order in which each key first appears."""
    groups: dict[str, list[CaseRecord]] = {}
    for record in records:
        groups.setdefault(key(record), []).append(record)
    return list(groups.values())


def open_folder(path: Path) -> tuple[RunFolder, Plan]:
    """Open the folder of a run, finished or not; returns it and the plan of its scenario.

    Raises:
        InputError: it is no folder of a run.
    """
    resolved = path / "scenario.yaml"
    if not resolved.exists():
        msg = "this is no run folder: it has no scenario.yaml; give a folder that a run made"
        raise InputError(msg, path=path)
    return RunFolder(path), plan(load_scenario(run_file(resolved)))


def tabulate(path: Path, progress: Progress) -> None:
    """Write the tables of a run folder again, from its stored cases.

    Raises:
        InputError: it is no folder of a run, or no case is intact.
    """
    folder, whole = open_folder(path)
    stored = folder.read_cases(whole.cases)
    if not stored:
        problem = "no case of this run is intact; run the scenario again to restore them"
        raise InputError(problem, path=path)
    lost = len(whole.cases) - len(stored)
    if lost:
        many = counted(lost, "case")
        progress.info(f"without {many}, missing or damaged; run the scenario again to restore")
    write_tables(path, whole, stored, folder.read_costs(whole.cases))
