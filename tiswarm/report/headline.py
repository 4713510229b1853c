"""The results of a run in words: a line for each row of `table.csv`, and the answer."""

import math
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from tiswarm.base.errors import InputError
from tiswarm.records.frames import read_frame
from tiswarm.records.messages import counted
from tiswarm.records.run_folder import TABLE_NOTES
from tiswarm.report.answers import Results, answer
from tiswarm.report.comparison import FEWEST
from tiswarm.report.run_data import relabeled, stated_scenario, swept_columns, swept_words

_MEASURES = [
    "rmse_R_mean", "rmse_R_ci95", "rmse_R_least", "rmse_R_most", "procrustes_disparity_mean",
]  # fmt: skip
_DISCONNECTED = "disconnected_mean"
_Row = dict[Hashable, Any]


def headline(folder: Path) -> str:
    """Write the results of a run: a line for each row of its table, then the answer."""
    path = folder / "table.csv"
    if not path.exists():
        raise InputError("has no table.csv; give a folder that `tiswarm run` made", path=folder)
    table = read_frame(
        path, ["condition"], ["cases"], gaps=_MEASURES, notes=TABLE_NOTES, numbers_after="cases"
    )
    swept = swept_columns(table)
    table[swept] = swept_words(table)[swept]
    last = result_of(folder, table) if len(table) > 1 else ""
    return "\n".join([*map(_in_words, table.to_dict("records")), *([last] if last else [])])


def read_pairs(folder: Path) -> pd.DataFrame:
    """Read the differences of conditions of a run on the same structures; it may have none."""
    words = ["condition", "against", "measure"]
    numbers = ["structures", "difference_mean", "smaller", "wilcoxon_p"]
    path = folder / "paired.csv"
    if not path.exists():
        return pd.DataFrame()
    pairs = read_frame(path, words, gaps=numbers, numbers_after="measure", empty=True)
    pairs = pairs.assign(equal_measurements=pairs.get("equal_measurements", False))
    swept = swept_columns(pairs, before="measure")
    pairs[swept] = swept_words(pairs, before="measure")[swept]
    return pairs


def read_scaling(folder: Path) -> pd.DataFrame:
    """Read the errors and costs of a run by the number of robots; it may have none."""
    path = folder / "scaling.csv"
    if not path.exists():
        return pd.DataFrame()
    numbers = ["mean", "exponent", "slope"]
    return read_frame(path, ["series", "measure"], ["robots"], gaps=numbers, empty=True)


def result_of(folder: Path, table: pd.DataFrame, labels: Mapping[str, str] | None = None) -> str:
    """Answer the question of a run in one sentence; empty where the table lacks its measures.

    Args:
        folder: Folder of the run.
        table: Its `table.csv`, with conditions as the sentence names them.
        labels: What names conditions, by what the files of the run call them.
    """
    rows = table[table["cases"] > 0]
    if rows.empty:
        return "No case was finished."
    if not set(_MEASURES) <= set(rows):
        return ""
    pairs, scaling = (relabeled(read(folder), labels or {}) for read in (read_pairs, read_scaling))
    question = stated_scenario(folder).get("question")
    text = answer(str(question), Results(rows, pairs, scaling)) if len(rows) > 1 else ""
    text = text or "; ".join(map(_in_words, rows.to_dict("records")))
    return f"{text}{_disconnected_somewhere(rows) if 'RMSE' in text else ''}."


def _disconnected_somewhere(rows: pd.DataFrame) -> str:
    """State in how many rows structures have disconnected robots; empty if in none or in one."""
    many = int((rows[_DISCONNECTED] > 0.0).sum()) if _DISCONNECTED in rows else 0
    if not many or len(rows) == 1:
        return ""
    least = f"; robots are disconnected from the anchor in {many} of {len(rows)} rows of the table"
    return f"{least}, where no method can place them"


def _in_words(row: _Row) -> str:
    point = " ".join(f"{key}={row[key]}" for key in _swept(row))
    name = f"{point} {row['condition']}".strip()
    if not row["cases"]:
        return f"{name}: no case was finished"
    text = (
        f"{name}: RMSE {_spread(row)}, disparity {row['procrustes_disparity_mean']:.3g}, "
        f"{counted(row['cases'], 'structure')}"
    )
    doubtful = []
    for word in ("converged", "consistent"):
        share = row.get(f"{word}_mean", math.nan)
        if lost := 0 if math.isnan(share) else round(row["cases"] * (1.0 - share)):
            doubtful.append(f"{lost} of them not {word}")
    return ", ".join([text, *doubtful]) + _disconnected(row)


def _disconnected(row: _Row) -> str:
    """State how many robots no measurement ties to the anchor; empty if there are none."""
    lost = row.get(_DISCONNECTED, math.nan)
    if math.isnan(lost) or not lost:
        return ""
    mean = " on average" if row["cases"] > 1 else ""
    joined = row.get("joined_mean", math.nan)
    of_all = "" if math.isnan(joined) else f" of {joined:.3g}"
    return f", {lost:.3g}{of_all} robots disconnected{mean}"


def _swept(row: _Row) -> list[Hashable]:
    names = list(row)
    return names[names.index("condition") + 1 : names.index("cases")]


def _spread(row: _Row) -> str:
    """Write an RMSE with its range, or its confidence interval where that says more."""
    mean, half = row["rmse_R_mean"], row["rmse_R_ci95"]
    if row["cases"] >= FEWEST:
        return f"{mean:.3g} R (95 % CI {mean - half:.3g} to {mean + half:.3g})"
    least, most = row["rmse_R_least"], row["rmse_R_most"]
    return f"{mean:.3g} R" + (f" ({least:.3g} to {most:.3g})" if row["cases"] > 1 else "")
