"""`summary.csv`, a row a case, and `table.csv`, a row a condition beside the paper's numbers."""

from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from tiswarm.scenario import Scenario
from tiswarm.study.scorecard import summed_up
from tiswarm.study.storage import CaseRecord

PAPER = {
    ("tower", True, True): (1.64, 0.045),
    ("tower", False, True): (1.84, 0.051),
    ("tower", False, False): (2.36, 0.066),
    ("cantilever", True, True): (3.91, 0.166),
    ("cantilever", False, True): (5.26, 0.219),
    ("cantilever", False, False): (5.12, 0.251),
}
"""Table II of the paper: (kind, z correction, undocked repulsion) to RMSE in its "robot radii",
which it does not define, and Procrustes disparity."""

AVERAGED = (
    "contacts_per_robot",
    "rms_radius_R",
    "height_R",
    "peak_stress",
    "floppy_modes",
    "rmse_R",
    "rmse_rho",
    "procrustes_disparity",
)


def summary(records: Sequence[CaseRecord]) -> pd.DataFrame:
    """One row a case, failed ones included."""
    return pd.DataFrame(
        [
            {
                "case": record.case,
                "seed": record.seed,
                "condition": record.condition,
                **record.point,
                "status": record.status,
                "reason": record.reason,
                **record.scores,
            }
            for record in records
        ]
    )


def table(records: Sequence[CaseRecord], settings: Sequence[Scenario]) -> pd.DataFrame:
    """One row a sweep point and condition: mean and standard deviation over its seeds.

    Args:
        records: What came of each case.
        settings: What each case was computed from.
    """
    rows: dict[str, dict[str, object]] = {}
    of_row: dict[str, list[CaseRecord]] = {}
    for record, setting in zip(records, settings, strict=True):
        key = record.case.partition("-")[2]
        rows.setdefault(key, {"condition": record.condition, **record.point, **_paper(setting)})
        of_row.setdefault(key, []).append(record)
    return pd.DataFrame([_with_statistics(rows[key], of_row[key]) for key in rows])


def headline(folder: Path) -> str:
    """Say in a few lines what a run came to, from its `table.csv` and `laws.csv`."""
    rows = pd.read_csv(folder / "table.csv")
    lines = [_headline_row(row) for row in rows.to_dict("records")]
    lines += [f"results in {folder}", summed_up(folder)]
    return "\n".join(line for line in lines if line)


def _headline_row(row: dict[Hashable, Any]) -> str:
    """One condition in words."""
    known = {"condition", "cases", "failed"} | {name for name in row if "_" in str(name)}
    point = " ".join(f"{key}={value}" for key, value in row.items() if key not in known)
    name = f"{point} {row['condition']}".strip()
    if not row["cases"]:
        return f"{name}: no case was finished"
    return (
        f"{name}: RMSE {row['rmse_R_mean']:.2f} R, disparity "
        f"{row['procrustes_disparity_mean']:.4f}, {row['cases']} structures"
    )


def _paper(setting: Scenario) -> dict[str, object]:
    """The paper's numbers for the same kind of structure and the same cues."""
    method = setting.localization
    key = (setting.structure.kind, method.z_correction, method.undocked_repulsion)
    rmse, disparity = PAPER.get(key, (None, None))
    return {"paper_rmse_radii": rmse, "paper_procrustes_disparity": disparity}


def _with_statistics(row: dict[str, object], records: Sequence[CaseRecord]) -> dict[str, object]:
    """Add counts, means and standard deviations of the cases that are done."""
    paper = {name: row[name] for name in row if name.startswith("paper_")}
    scores = pd.DataFrame([record.scores for record in records if record.scores])
    full: dict[str, object] = {name: row[name] for name in row if name not in paper}
    full |= {"cases": len(scores), "failed": len(records) - len(scores)}
    for name in AVERAGED:
        column = scores[name].astype(float) if name in scores else pd.Series(dtype=float)
        full[f"{name}_mean"] = column.mean()
        full[f"{name}_std"] = column.std()
    return full | paper
