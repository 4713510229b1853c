"""The tables of a run as the page shows them: chosen columns, rounded, with units."""

import math
import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import pandas as pd

from tiswarm.records.messages import counted
from tiswarm.report.folder import swept_columns

MOST_CASES = 2_000
"""Rows of the table of cases; more are left to `summary.csv`."""

MOST_REASONS = 5

Row = Mapping[Hashable, Any]
Column = tuple[str, Callable[[Row], "Cell"]]
"""Label of a column, and how a row fills it."""


class Cell(NamedTuple):
    """One cell: what is read, and what it is sorted by."""

    text: str
    value: float | None = None


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of the page, between its title and a note."""

    header: list[str]
    rows: list[list[Cell]]
    title: str = ""
    note: str = ""

    @classmethod
    def of(
        cls, table: pd.DataFrame, columns: Sequence[Column], *, title: str, note: str
    ) -> "Table":
        """Show a row of cells for each row of a table."""
        rows = [[cell(row) for _, cell in columns] for row in table.to_dict("records")]
        header = [label for label, _ in columns]
        return cls(header=header, rows=rows, title=title, note=note)


ACCURACY = (
    ("RMSE [R]", "rmse_R", 2),
    ("RMSE [rho]", "rmse_rho", 2),
    ("disparity", "procrustes_disparity", 4),
)
LIMITS = (
    ("contacts per robot", "contacts_per_robot", 2),
    ("floppy modes", "floppy_modes", 1),
    ("rms radius [R]", "rms_radius_R", 1),
)
PARTS = (
    ("as it is", "rmse_R", 2),
    ("yaw and place aligned", "rmse_yaw_aligned_R", 2),
    ("rigidly aligned", "rmse_rigid_aligned_R", 2),
    ("between robots in contact", "rmse_per_contact_R", 2),
)
OF_ITSELF = (
    ("in the 50 % interval", "coverage_50", 2),
    ("in the 90 % interval", "coverage_90", 2),
    ("contacts judged wrong: precision", "doubted_precision", 2),
    ("recall", "doubted_recall", 2),
    ("converged", "converged", 2),
)
PUBLISHED = (
    ("published [robot radii]", "paper_rmse_radii", 2),
    ("published disparity", "paper_procrustes_disparity", 3),
)
CASE = (
    ("robots", "robots", 0),
    *ACCURACY[:1],
    ("yaw aligned [R]", "rmse_yaw_aligned_R", 2),
    ("rigidly aligned [R]", "rmse_rigid_aligned_R", 2),
    *ACCURACY[2:],
    *LIMITS,
    ("height [R]", "height_R", 1),
    ("peak stress", "peak_stress", 0),
)


def result_tables(table: pd.DataFrame, paired: pd.DataFrame) -> list[Table]:
    """Everything a reader wants to know first; `paired` may be empty."""
    tables = [_headline(table), _parts(table)]
    if _means(table, OF_ITSELF):
        tables.append(_of_itself(table))
    if "wilcoxon_p" in paired:
        tables.append(_differences(paired))
    return tables


def case_table(summary: pd.DataFrame) -> Table:
    """One row a case, to be sorted and filtered."""
    left_out = len(summary) - MOST_CASES
    return Table.of(
        summary.head(MOST_CASES),
        [
            _words("case"),
            _words("status"),
            *(_numbers(*column) for column in CASE if column[1] in summary),
            _words("reason"),
        ],
        title="",
        note=f"{left_out} more cases are in summary.csv." if left_out > 0 else "",
    )


def machine_table(manifest: Mapping[str, Any]) -> Table:
    """By what and in what time the run was computed."""
    facts = {
        **manifest.get("machine", {}),
        **manifest.get("backend", {}),
        "peak_memory_MB": manifest.get("peak_memory_MB", ""),
        "python": manifest.get("python", ""),
        **manifest.get("libraries", {}),
        **{
            f"{name} [s wall, s CPU]": f"{spent['wall_s']}, {spent['cpu_s']}"
            for name, spent in manifest.get("stages", {}).items()
        },
    }
    return Table(
        title="Machine and versions",
        header=["what", "which"],
        rows=[
            [Cell(name.replace("_MB", " [MB]")), Cell(str(value))]
            for name, value in facts.items()
            if value != ""
        ],
    )


def warnings_of(summary: pd.DataFrame, manifest: Mapping[str, Any]) -> list[str]:
    """What a reader must know before believing a number."""
    done = summary["status"] == "done"
    found = []
    if not done.all():
        reasons = [*dict.fromkeys(summary.loc[~done, "reason"].dropna())]
        shown = "; ".join(map(str, reasons[:MOST_REASONS]))
        found.append(f"{(~done).sum()} of {len(summary)} cases failed: {shown}.")
    found += _unconverged(summary[done])
    ended = summary.loc[done, "reason"].dropna()
    if len(ended):
        shown = "; ".join(map(str, [*dict.fromkeys(ended)][:MOST_REASONS]))
        found.append(f"Growth of {counted(len(ended), 'case')} ended early: {shown}.")
    if "unlocated" in summary and (lost := summary["unlocated"].fillna(0)).any():
        found.append(
            f"No chain of final contacts ties {counted(int(lost.sum()), 'robot')} in "
            f"{counted((lost > 0).sum(), 'case')} to the anchor; their positions rest on other "
            "cues or are guesses."
        )
    found += _floppiness(summary[done])
    renders = manifest.get("renders", {}).values()
    excuses = {str(picture["reason"]) for picture in renders if picture["reason"]}
    found += [f"Renders are by a simpler renderer: {reason}." for reason in sorted(excuses)]
    return found


def _unconverged(done: pd.DataFrame) -> list[str]:
    """Name the cases whose estimate does not fit what was sensed."""
    if "converged" not in done:
        return []
    lost = done[done["converged"].eq(False)]  # noqa: FBT003 - other methods leave it empty
    if not len(lost):
        return []
    more = ["..."] if len(lost) > MOST_REASONS else []
    names = ", ".join([*map(str, lost["case"][:MOST_REASONS]), *more])
    warning = (
        f"{len(lost)} of {len(done)} cases did not converge ({names}): their best chain misses "
        f"what was sensed by up to {lost['misfit_sd'].max():.0f} sd more than chance explains. "
        "Their errors count in all tables; more steps or chains may mend them."
    )
    return [warning]


def _floppiness(done: pd.DataFrame) -> list[str]:
    """Say how much the senses leave open."""
    if "floppy_modes" not in done or not len(done):
        return []
    modes = done["floppy_modes"]
    if not (modes > 0).any():
        return []
    least, most = f"{modes.min():.0f}", f"{modes.max():.0f}"
    count = least if least == most else f"{least} to {most}"
    told = (
        f"What the method uses of the log leaves {count} floppy modes a case: motions that nothing "
        "of it would notice. No method can do away with errors along them."
    )
    return [told]


def _headline(table: pd.DataFrame) -> Table:
    """Accuracy beside the published numbers, and what limits it."""
    published = [column for column in PUBLISHED if table[column[1]].notna().any()]
    rmse, rho, disparity = ACCURACY
    notes = ["Mean ± half width of its 95 % confidence interval over structures."]
    if published:
        notes.append(
            "R is the radius of a dock, rho the distance from a robot's center to a dock; the "
            'published "robot radius" is not defined, so both stand beside it.'
        )
    return Table.of(
        table,
        [
            *_swept(table),
            ("structures", lambda row: _number(row["cases"], 0)),
            *_means(table, [rmse, rho]),
            *(_numbers(*column) for column in published if column in PUBLISHED[:1]),
            *_means(table, [disparity]),
            *(_numbers(*column) for column in published if column in PUBLISHED[1:]),
            *_means(table, LIMITS),
        ],
        title="Localization",
        note=" ".join(notes),
    )


def _parts(table: pd.DataFrame) -> Table:
    """What the error is made of."""
    return Table.of(
        table,
        [*_swept(table), *_means(table, PARTS)],
        title="RMSE after alignment [R]",
        note=(
            "What an alignment takes away was a turned or shifted frame; what stays is a wrong "
            "shape. Between robots in contact: of one robot's place as seen from the other."
        ),
    )


def _of_itself(table: pd.DataFrame) -> Table:
    """Whether what a method says of its own estimate is true."""
    return Table.of(
        table,
        [*_swept(table), *_means(table, OF_ITSELF)],
        title="What the method says of its estimate",
        note=(
            "Part of the robots that are as near to their estimated place as its standard "
            "deviation promises; of the contacts judged wrong those that are, and of all wrong "
            "ones those that are found; part of the estimates that converged."
        ),
    )


def _differences(paired: pd.DataFrame) -> Table:
    """RMSE and disparity between conditions, structure by structure."""
    labels = {"rmse_R": "RMSE [R]", "procrustes_disparity": "disparity"}
    first = paired["against"] == paired["against"].iloc[0]
    return Table.of(
        paired[first & paired["measure"].isin(labels)],
        [
            _words("condition"),
            _words("against"),
            *_swept(paired, before="measure")[2:],
            ("measure", lambda row: Cell(labels[row["measure"]])),
            ("difference", lambda row: _mean(row, "difference", 3, sign="+")),
            ("smaller in", _smaller),
            ("p", lambda row: _chance(row["wilcoxon_p"])),
        ],
        title="Differences on the same structures",
        note=(
            "p by Wilcoxon's signed-rank test, not corrected for how many are made. More measures, "
            "and other pairs of conditions, are in paired.csv."
        ),
    )


def _swept(table: pd.DataFrame, *, before: str = "cases") -> list[Column]:
    """What tells rows of a table apart: the condition and what is swept, be it a whole section."""
    return [_point(name) for name in swept_columns(table, before=before)]


def _point(name: str) -> Column:
    return (name, lambda row: Cell(re.sub(r"[{}']", "", str(row[name]))))


def _means(table: pd.DataFrame, columns: Sequence[tuple[str, str, int]]) -> list[Column]:
    """Label and cell of each mean that a table has."""
    return [
        _mean_of(*column)
        for column in columns
        if f"{column[1]}_mean" in table and table[f"{column[1]}_mean"].notna().any()
    ]


def _mean_of(label: str, name: str, digits: int) -> Column:
    return (label, lambda row: _mean(row, name, digits))


def _numbers(label: str, name: str, digits: int) -> Column:
    return (label, lambda row: _number(row[name], digits))


def _words(name: str) -> Column:
    return (name, lambda row: Cell("" if pd.isna(row[name]) else str(row[name])))


def _smaller(row: Row) -> Cell:
    return Cell(f"{row['smaller']} of {row['structures']}", float(row["smaller"]))


def _mean(row: Row, name: str, digits: int, *, sign: str = "") -> Cell:
    """Mean ± half width of its confidence interval."""
    mean, width = row[f"{name}_mean"], row.get(f"{name}_ci95", math.nan)
    if math.isnan(mean):
        return Cell("")
    interval = f" ± {width:.{digits}f}" if width >= 0.0 else ""
    return Cell(f"{mean:{sign}.{digits}f}{interval}", float(mean))


def _chance(p: float) -> Cell:
    """A p value, as far as it is worth telling."""
    return Cell("< 0.0001", p) if p < 1e-4 else _number(p, 4)  # noqa: PLR2004 - four digits


def _number(value: float, digits: int) -> Cell:
    """A number, or nothing where it is unknown."""
    return Cell("") if math.isnan(value) else Cell(f"{value:.{digits}f}", float(value))
