"""Comparison of runs: tables, a figure, and a page of all cases."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from tiswarm.app.results import Figure as Picture
from tiswarm.base.errors import InputError
from tiswarm.records.frames import read_frame, write_frame
from tiswarm.records.io import damaged, make_folder
from tiswarm.records.measures import DISPARITY, LOCATED, MAIN, OF_LOCATED, RMSE, RMSE_LOCATED
from tiswarm.records.messages import shown
from tiswarm.records.outputs import NEW, Outputs
from tiswarm.records.run_folder import TABLE_NOTES
from tiswarm.report import figure_style, table_figures
from tiswarm.report.cases_page import cases_page
from tiswarm.report.page_tables import has_guesses
from tiswarm.report.run_data import (
    Labels,
    joined_words,
    load_run,
    read_labels,
    swept_columns,
    with_points,
)
from tiswarm.report.series import measured_cues, series_names
from tiswarm.study import tables
from tiswarm.study.store import CaseRecord, RunFolder

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ERRORS = {RMSE.mean: "RMSE [R]", RMSE.ci95: "± 95 % CI [R]", DISPARITY.mean: "disparity"}
"""Columns of errors that the printed table has, and their headings; `frame` has all."""

_ERRORS_OF_LOCATED = {
    RMSE.mean: "RMSE [R]",
    RMSE.ci95: "± 95 % CI [R]",
    LOCATED.mean: "located [share]",
    RMSE_LOCATED.mean: "RMSE of located [R]",
}
"""Those where not all robots are located."""

_COMPARED = ["run", "series", "against_run", "against_series", "measure"]


_CASE_WORDS = [
    "run",
    "point",
    "condition",
    "kind",
    "method",
    "measurements",
    "case",
    "status",
    "distrust",
    "reason",
]
"""Columns of words of `cases.csv`, which come first."""

FILES = ("comparison.csv", "paired.csv", "comparison.png", "cases.csv", "comparison.html")
"""Files of a comparison."""


@dataclass(frozen=True)
class Comparison:
    """Runs side by side: the folder with `comparison.csv`, `paired.csv` and a figure."""

    folder: Path
    shown: pd.DataFrame
    """Rows of all runs with the labels of their points and conditions."""

    @property
    def table(self) -> pd.DataFrame:
        """Results of all runs by condition."""
        return self._frame("comparison")

    @property
    def paired(self) -> pd.DataFrame:
        """Differences on the structures that runs share."""
        return self._frame("paired")

    @property
    def page(self) -> Path:
        """Page of all cases, which readers plot, sort and select by any column."""
        return self.folder / "comparison.html"

    @property
    def figure(self) -> Picture:
        """Errors of all runs."""
        return Picture(self.folder / "comparison.png")

    def __str__(self) -> str:
        """Write the results of each run by condition, and name the files."""
        files = f"comparison.csv, paired.csv, cases.csv and comparison.png in {self.folder}"
        page = f"open {self.page}"
        return f"{self._short().to_string(index=False, na_rep='')}\n{files}\n{page}"

    def _repr_html_(self) -> str:
        return self._short().to_html(index=False, na_rep="")

    def _short(self) -> pd.DataFrame:
        swept = self.shown["point"].any()
        return _short_table(self.shown if swept else self.shown.drop(columns="point"))

    def _frame(self, name: str) -> pd.DataFrame:
        return read_frame(self.folder / f"{name}.csv", empty=True)


def compare(runs: Sequence[Path], out: Path, outputs: Outputs = NEW) -> Comparison:
    """Write `comparison.csv`, all rows of the runs' `table.csv`, `paired.csv`, figure and page.

    `paired.csv` has differences on the structures that two runs share: those with the same true
    positions to the last bit; names of scenarios do not matter. The figure is `comparison.png`.
    `cases.csv` has all cases, and `comparison.html` is the page of these.

    Raises:
        InputError: fewer than two different runs are given, a folder has no `table.csv`, or a table
            exists and is to stay.
        EnvironmentTroubleError: `out` cannot be made.
    """
    if len({run.resolve() for run in runs}) < max(2, len(runs)):
        raise InputError("give two or more different run folders", key="RUN")
    names = [run.resolve().name for run in runs]
    if len(set(names)) < len(names):
        names = [str(run) for run in runs]
    read = {name: _read_table(run) for run, name in zip(runs, names, strict=True)}
    first = ["run", *dict.fromkeys(key for table in read.values() for key in swept_columns(table))]
    stacked = _stacked(read)
    labels = _labels(dict(zip(names, runs, strict=True)), read)
    labeled = {
        name: with_points(labels[name].put(table.copy(), before="cases"))
        for name, table in read.items()
    }
    series = {
        (name, label): accuracy
        for run, name in zip(runs, names, strict=True)
        for label, accuracy in _by_series(RunFolder(run)).items()
    }
    rows = []
    for (first_key, before), (second_key, after) in itertools.combinations(series.items(), 2):
        is_of_two_runs = first_key[0] != second_key[0]
        if is_of_two_runs and not before.index.intersection(after.index).empty:
            pair = dict(zip(_COMPARED, (*second_key, *first_key), strict=False))
            rows += tables.differences(pair, before, after)
    cases = _cases(dict(zip(names, runs, strict=True)), labels)
    make_folder(out)
    columns = [*first, *stacked.columns.difference(first, sort=False)]
    write_frame(stacked[columns], out / "comparison.csv", opened=outputs.opened)
    pairs = pd.DataFrame(rows, columns=None if rows else _COMPARED)
    write_frame(pairs, out / "paired.csv", opened=outputs.opened)
    comparison = Comparison(out, _stacked(labeled))
    outputs.write(out / FILES[2], figure_style.png(rows_drawing(comparison.shown).draw()))
    write_frame(cases, out / "cases.csv", opened=outputs.opened)
    page = cases_page(f"Comparison of {len(runs)} runs", cases, _CASE_WORDS, file="cases.csv")
    outputs.write(comparison.page, page.encode())
    return comparison


def _cases(runs: Mapping[str, Path], labels: Mapping[str, Labels]) -> pd.DataFrame:
    """Put the cases of all runs below each other, with labels in place of keys."""
    parts = [
        load_run(run, labels[name]).summary.drop(columns="series").assign(run=name)
        for name, run in runs.items()
    ]
    cases = pd.concat(parts, ignore_index=True)
    words = [name for name in _CASE_WORDS if name in cases]
    return cases[[*words, *cases.columns.difference(words, sort=False)]]


def _labels(runs: Mapping[str, Path], read: Mapping[str, pd.DataFrame]) -> dict[str, Labels]:
    """Name the series of all runs, with the measurements in which any two of them differ."""
    labels = {name: read_labels(run) for name, run in runs.items()}
    measured = {
        (run, name): cues
        for run, table in read.items()
        for name, cues in measured_cues(table).items()
    }
    stated = {(run, name): labels[run].conditions.get(name, name) for run, name in measured}
    names = series_names(stated, measured)
    return {
        run: replace(
            of_run, conditions={name: text for (of, name), text in names.items() if of == run}
        )
        for run, of_run in labels.items()
    }


def _stacked(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Put tables below each other, with the names of their runs in front."""
    return pd.concat(tables, names=["run"]).reset_index("run").reset_index(drop=True)


def _read_table(run: Path) -> pd.DataFrame:
    path = run / "table.csv"
    if not path.exists():
        msg = "has no table.csv; give a folder that `tiswarm run` made"
        raise InputError(msg, path=run)
    if "rmse_R_mean" not in read_frame(path, ["condition"], ["cases"], notes=TABLE_NOTES):
        problem = "has no estimates to compare; give runs whose method is neither none nor relax"
        raise InputError(problem, path=run)
    table = read_frame(
        path,
        ["condition"],
        ["cases"],
        gaps=[RMSE.mean, RMSE.ci95, DISPARITY.mean],
        notes=TABLE_NOTES,
        numbers_after="cases",
    )
    for text in map(str, [*table.columns, *table.to_numpy().ravel()]):
        if not text.isprintable():  # a terminal would obey it
            raise damaged(path, f"{shown(text)} is not printable")
    return table


def _by_series(folder: RunFolder) -> dict[str, pd.DataFrame]:
    """Return the accuracy of each series of a run, by the digest of each structure's truth."""
    series: dict[str, dict[str, CaseRecord]] = {}
    for path in sorted(folder.cases.glob("[!.]*")):
        record = folder.read_case(path.name)
        if record is not None and record.is_done:
            series.setdefault(record.series, {})[record.files["truth.csv"]] = record
    return {name: tables.accuracy_by_key(records) for name, records in series.items()}


def rows_drawing(table: pd.DataFrame) -> figure_style.Drawing:
    """Compose panels of the means of the first rows with their intervals.

    Each series of each run has a row, and each run a color. Of more runs than there are colors,
    each run has a row, and each series a color.
    """
    names = joined_words(table, ["point", "condition"])
    if table["run"].nunique() > figure_style.MOST_SERIES >= len({*names}):
        rows = table.assign(row=table["run"], of=names)
        shown = list(dict.fromkeys(rows["row"]))[: table_figures.MOST_ROWS]
        labels = shown
        kind = "run"
    else:  # names may repeat
        rows = table.assign(row=[*map(str, range(len(table)))], of=table["run"])
        shown = rows["row"].tolist()[: table_figures.MOST_ROWS]
        labels = names[: len(shown)]
        kind = "row"
    rows = rows.drop(columns=[m.published for m in MAIN], errors="ignore")
    omitted = rows["row"].nunique() - len(shown)
    rows = rows[rows["row"].isin(shown)]
    measures = {m.column: m for m in (OF_LOCATED if has_guesses(table) else MAIN)}

    def paint(axes: "Axes", column: str, series: Sequence[str]) -> None:
        table_figures.draw_means(axes, rows, measures[column], shown, series)
        table_figures.finish_row_axis(axes, measures[column], labels)

    def complete(panels: figure_style.Panels) -> list[str]:
        figure_style.label_rows(panels.first, labels)
        words = figure_style.mean_words(table["cases"])
        panels.legend(words, panels.entries(), loc="outside upper right")
        return [figure_style.omission_note(omitted, kind, "in comparison.csv")]

    return figure_style.Drawing(
        panels=list(measures), series=list(dict.fromkeys(rows["of"])), paint=paint,
        complete=complete, columns=len(measures), row_height=0.5 + 0.17 * len(shown),
        head_height=0.4, share="y",
    )  # fmt: skip


def _short_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return what stands before the cases of a table, their number, and the errors that it has.

    Numbers have three digits, and a column that no row fills is left out.
    """
    head = table.loc[:, :"cases"]
    headings = (_ERRORS_OF_LOCATED if has_guesses(table) else _ERRORS) | {"cases": "n"}
    errors = table.filter([*headings]).map(lambda value: float(f"{value:.3g}"))
    shown = head.join(errors.drop(columns="cases")).dropna(axis="columns", how="all")
    return shown.rename(columns=headings)
