"""The tables of a run.

`summary.csv` has a row a case, `table.csv` a row a condition beside the paper's numbers,
`paired.csv` a row a pair of conditions on the same structures, `profiles.csv` a row a range of
robots that are alike.
"""

import itertools
import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from tiswarm.evaluation.metrics import mean_std_ci95, paired_difference
from tiswarm.evaluation.paper import PAPER, PAPER_ROBOTS, Published
from tiswarm.evaluation.profiles import error_profile, relative_profile
from tiswarm.localization.params import VirtualForceParams
from tiswarm.records.messages import counted
from tiswarm.robot import RobotGeometry
from tiswarm.scenario import Scenario
from tiswarm.sensing import SensingParams
from tiswarm.study.cases import point_text
from tiswarm.study.storage import DONE, CaseRecord

ACCURACY = (
    "rmse_R",
    "rmse_rho",
    "rmse_yaw_aligned_R",
    "rmse_rigid_aligned_R",
    "rmse_per_contact_R",
    "procrustes_disparity",
)
AVERAGED = (
    "contacts_per_robot",
    "rms_radius_R",
    "height_R",
    "peak_stress",
    "floppy_modes",
    "coverage_50",
    "coverage_90",
    "outlier_precision",
    "outlier_recall",
    "converged",
    *ACCURACY,
)

_Item = TypeVar("_Item")


def summary(records: Sequence[CaseRecord], settings: Sequence[Scenario]) -> pd.DataFrame:
    """One row a case, failed ones included."""
    return pd.DataFrame(
        [
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
                **record.scores,
            }
            for record, setting in zip(records, settings, strict=True)
        ]
    )


def table(records: Sequence[CaseRecord], settings: Sequence[Scenario]) -> pd.DataFrame:
    """One row a sweep point and condition: mean over its seeds, and how far it can be trusted."""
    pairs = list(zip(records, settings, strict=True))
    rows = []
    for group in _grouped(pairs, lambda pair: pair[0].series):
        first, setting = group[0]
        ours = _with_statistics([record for record, _ in group])
        rows.append({"condition": first.condition, **first.point, **ours, **_paper(setting, ours)})
    return pd.DataFrame(rows)


def paired(records: Sequence[CaseRecord]) -> pd.DataFrame:
    """One row a measure and pair of conditions of a sweep point: differences by structure."""
    rows = []
    for of_point in _grouped(records, lambda record: point_text(record.point)):
        conditions = _grouped(of_point, lambda record: record.condition)
        for first, second in itertools.combinations(conditions, 2):
            pair = _accuracy(first).merge(_accuracy(second), on="seed")
            rows += [
                {
                    "condition": second[0].condition,
                    "against": first[0].condition,
                    **first[0].point,
                    "measure": name,
                    **paired_difference(
                        pair[f"{name}_x"].to_numpy(float), pair[f"{name}_y"].to_numpy(float)
                    ),
                }
                for name in ACCURACY
            ]
    return pd.DataFrame(rows, columns=None if rows else ["condition", "against", "measure"])


def profiles(records: Sequence[CaseRecord], cases: Path) -> pd.DataFrame:
    """Rows of errors by what robots have in common, for each sweep point and condition."""
    parts = []
    done = [record for record in records if record.status == DONE]
    for of_row in _grouped(done, lambda record: record.series):
        folders = [cases / record.case for record in of_row]
        robots = [pd.read_csv(folder / "robots.csv") for folder in folders]
        robots = [table.assign(join=np.arange(len(table))) for table in robots]
        relative = [pd.read_csv(folder / "relative.csv") for folder in folders]
        profile = pd.concat(
            [error_profile(pd.concat(robots)), relative_profile(pd.concat(relative))]
        )
        first = {"condition": of_row[0].condition, **of_row[0].point}
        for place, (name, value) in enumerate(first.items()):
            profile.insert(place, name, [value] * len(profile))
        parts.append(profile)
    return pd.concat(parts) if parts else pd.DataFrame(columns=["condition", "by"])


def _accuracy(records: Sequence[CaseRecord]) -> pd.DataFrame:
    """Seed and accuracy of the cases that are done."""
    return pd.DataFrame(
        [{"seed": record.seed, **record.scores} for record in records if record.scores],
        columns=["seed", *ACCURACY],
    )


def headline(folder: Path) -> str:
    """Say in a few lines what a run came to, from its `table.csv`."""
    rows = pd.read_csv(folder / "table.csv")
    lines = [_headline_row(row) for row in rows.to_dict("records")]
    return "\n".join([*lines, f"results in {folder}"])


def _headline_row(row: dict[Hashable, Any]) -> str:
    """One condition in words."""
    names = list(row)
    swept = names[names.index("condition") + 1 : names.index("cases")]
    point = " ".join(f"{key}={row[key]}" for key in swept)
    name = f"{point} {row['condition']}".strip()
    if not row["cases"]:
        return f"{name}: no case was finished"
    interval = f" ± {row['rmse_R_ci95']:.2f}" if row["rmse_R_ci95"] >= 0.0 else ""
    share = row.get("converged_mean", math.nan)
    lost = 0 if math.isnan(share) else round(row["cases"] * (1.0 - share))
    return (
        f"{name}: RMSE {row['rmse_R_mean']:.2f}{interval} R, disparity "
        f"{row['procrustes_disparity_mean']:.4f}, {counted(row['cases'], 'structure')}"
        f"{f', {lost} of them not converged' if lost else ''}"
    )


def _published(setting: Scenario) -> Published | None:
    """The paper's numbers where the setting is the paper's.

    It leaves open how flips end and how robots walk, and all gains.
    """
    method, structure = setting.localization, setting.structure
    usual = type(structure)()
    if (
        setting.robots != PAPER_ROBOTS
        or replace(structure, climb=usual.climb) != usual
        or (setting.robot, setting.sensing) != (RobotGeometry(), SensingParams())
        or not isinstance(method, VirtualForceParams)
        or method.back_propagation
    ):
        return None
    return PAPER.get((structure.kind, method.z_correction, method.undocked_repulsion))


def _paper(setting: Scenario, ours: Mapping[str, Any]) -> dict[str, object]:
    """The paper's numbers for its own setting, and ours divided by them."""
    cell = _published(setting)
    rmse, disparity = (cell.rmse_radii, cell.disparity) if cell else (math.nan, math.nan)
    return {
        "paper_rmse_radii": rmse,
        "paper_procrustes_disparity": disparity,
        "rmse_R_to_paper": ours["rmse_R_mean"] / rmse,
        "rmse_rho_to_paper": ours["rmse_rho_mean"] / rmse,
        "procrustes_disparity_to_paper": ours["procrustes_disparity_mean"] / disparity,
    }


def _with_statistics(records: Sequence[CaseRecord]) -> dict[str, object]:
    """Counts of the cases, and means and their certainty of those that are done."""
    scores = pd.DataFrame([record.scores for record in records if record.scores])
    full: dict[str, object] = {"cases": len(scores), "failed": len(records) - len(scores)}
    for name in AVERAGED:
        column = scores[name] if name in scores else pd.Series(dtype=float)
        values = mean_std_ci95(column.to_numpy(np.float64))
        full |= {f"{name}_{statistic}": value for statistic, value in values.items()}
    return full


def _grouped(items: Iterable[_Item], key: Callable[[_Item], str]) -> list[list[_Item]]:
    """Lists of items with the same key, in the order in which each first appears."""
    groups: dict[str, list[_Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return list(groups.values())
