"""The tables of a run's page with units, and what it says beside them: warnings and notes."""

import math
import re
import textwrap
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from tiswarm.measurements.verdicts import describe_misfit
from tiswarm.records import error_law
from tiswarm.records.frames import csv_text
from tiswarm.records.measures import (
    BUILT_FOR,
    CONSISTENT,
    CONVERGED,
    COVERAGE_90,
    DEPTH,
    DIED,
    DISCONNECTED,
    DISPARITY,
    FEWEST,
    FLOPPY_MODES,
    LEFT,
    LOCATED,
    MISFIT,
    PAGE,
    REACH,
    RMSE,
    RMSE_LOCATED,
    SD_FACTOR,
    SENT,
    SETTLED,
    SPARE,
    SURE,
    SURE_OFF,
    TESTABLE,
    Measure,
    plugin_headings,
)
from tiswarm.records.messages import MISSING, counted, percent, three_digits
from tiswarm.records.run_folder import Manifest
from tiswarm.report.run_data import NO_KEYS, joined_words, swept_columns, with_points
from tiswarm.report.series import measured_words, split_cues

MOST_ROWS = 2_000
"""Most rows of a table of cases or robots; a file beside the page has all."""

POINT = "point"
"""Column of the point of a sweep."""

_PUBLISHED = {
    RMSE.published: "published RMSE [robot radii]",
    RMSE.mean: "RMSE [R]",
    "rmse_rho_to_paper": "to the published, radius = rho",
    "rmse_R_to_paper": "radius = R",
    "paper_rmse_change_percent": "published change [%]",
    "rmse_change_percent": "change [%]",
    DISPARITY.published: "published disparity",
    DISPARITY.mean: "disparity",
}
"""Headings of columns of `table.csv` beside those of the paper."""


@dataclass(frozen=True, kw_only=True)
class PageTable:
    """A table of the page.

    A number that is missing is an empty text in `frame`, and a dash for readers.
    """

    frame: pd.DataFrame  # formatted cells; all of them are text once the table is made
    words: Collection[str]  # columns of words, which are aligned left; the others contain numbers
    title: str = ""
    note: str = ""
    is_first: bool = False  # whether readers see it without a click

    def __post_init__(self) -> None:
        """Make a text of each cell; that of a number that is missing is empty."""
        texts = {name: self._texts(str(name), cells) for name, cells in self.frame.items()}
        object.__setattr__(self, "frame", pd.DataFrame(texts, index=self.frame.index))

    def _texts(self, name: str, cells: "pd.Series[Any]") -> "pd.Series[str]":
        texts = cells.astype(object).where(cells.notna(), "").map(str)
        return texts if name in self.words else texts.replace("nan", "")

    @property
    def shown(self) -> pd.DataFrame:
        """Cells of the columns that are shown, with a dash for each number that is missing."""
        frame = self.frame[self.columns]
        numbers = [name for name in frame if name not in self.words]
        return frame.assign(**{str(name): frame[name].replace("", MISSING) for name in numbers})

    @property
    def is_grouped(self) -> bool:
        """Whether conditions stand below the point of a sweep that they share."""
        return {POINT, "condition"} <= {*self.frame}

    @property
    def columns(self) -> list[str]:
        """Columns that are shown."""
        return [str(name) for name in self.frame if not (self.is_grouped and name == POINT)]

    @property
    def groups(self) -> list[tuple[str, list[list[str]]]]:
        """Cells of all rows, below the point that they share; that is empty without one."""
        points = self.frame[POINT] if self.is_grouped else pd.Series("", self.frame.index)
        groups = self.shown.groupby(points, sort=False)
        return [(str(point), rows.to_numpy().tolist()) for point, rows in groups]


_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "|": r"\textbar{}",
        "±": r"$\pm$",
        **{letter: f"\\{letter}" for letter in "&%$#_{}"},
    }
)
"""Letters that LaTeX reads as commands, or prints as others in its default encoding OT1."""


def _latex(text: object) -> str:
    """Escape a text for LaTeX."""
    return str(text).translate(_LATEX)


def paper_text(table: PageTable, form: str, name: str = "") -> str:
    """Write a table for a paper, as "latex" with rules of booktabs, "markdown" or "csv".

    CSV repeats the point of the sweep in each row; the others write it once. In LaTeX, the label of
    the table is `tab:` and the name.
    """
    frame = table.frame
    if form == "csv":
        return csv_text(frame)
    if table.is_grouped:
        frame = frame.assign(**{POINT: frame[POINT].mask(frame[POINT].duplicated(), "")})
    if form == "latex":
        sides = "".join("l" if name in table.words else "r" for name in frame)
        style = frame.style.hide(axis="index").format(_latex)
        style = style.format_index(_latex, axis="columns")
        return style.to_latex(
            hrules=True,
            column_format=sides,
            caption=_latex(f"{table.title} by condition. {table.note}"),
            label=f"tab:{name}" if name else None,
        )
    rule = [":--" if name in table.words else "--:" for name in frame]
    cells = frame.replace(r"\|", r"\\|", regex=True).to_numpy().tolist()
    rows = [[*map(str, frame)], rule, *cells]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def console_text(table: PageTable, width: int = 100) -> str:
    """Write a table in aligned columns below its note, which is wrapped to a width in letters.

    The point of a sweep stands once, in a line above its conditions.
    """
    frame = table.shown
    cells = [[*map(str, frame)], *frame.to_numpy().tolist()]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]

    def aligned(row: Sequence[str]) -> str:
        texts = [
            cell.ljust(width) if name in table.words else cell.rjust(width)
            for name, cell, width in zip(frame, row, widths, strict=True)
        ]
        return "  ".join(texts).rstrip()

    lines = [*textwrap.wrap(table.note, width), aligned(cells[0])]
    for point, rows in table.groups:
        if point:
            lines.append(f"{point}:")
        lines += map(aligned, rows)
    return "\n".join(lines)


def headline_table(
    table: pd.DataFrame,
    question: str = "",
    *,
    powers: pd.DataFrame | None = None,
    with_verdicts: bool = False,
    best_first: bool = True,
) -> PageTable:
    """Format accuracy, and what a question asks for: a row for each series.

    RMSE is that of all robots. Where not all are located, their share and RMSE stand beside it.
    Verdicts are how many estimates converged and are consistent, where not all are; a page has them
    in a table of their own.

    Args:
        table: `table.csv` with labels.
        question: Question of the scenario.
        powers: Powers of N of series and measures, as `RunData.powers` has them.
        with_verdicts: Whether to count verdicts.
        best_first: Whether the series of each point are sorted by their RMSE.
    """
    if SETTLED.mean in table:
        return _swarm_table(table)
    if RMSE.mean not in table:
        return _structure_table(table)
    rows = _best_first(table) if best_first else table
    columns = _counts(rows) | _errors(rows) | _asked(rows, question, powers)
    if with_verdicts:
        columns |= _verdicts(rows)
    with_shares = has_guesses(rows) or any(_CLOSED in heading for heading in columns)
    notes = _notes_on_means(rows, with_shares=with_shares)
    notes += _measurements_in_use(rows)
    notes.append("R: a dock's radius.")
    notes += _notes_on_columns(columns)
    if rows.get(LOCATED.mean, pd.Series(dtype=float)).eq(1.0).all() and LOCATED.mean in rows:
        notes.append("All robots are located: measurements tie them to the anchor.")
    return _labeled(_names(rows), columns, "Accuracy", " ".join(notes))


def _counts(rows: pd.DataFrame) -> dict[str, pd.Series]:
    """Format over how many structures the means of each row are."""
    return {"n": _numbers(rows["cases"])}


def _errors(rows: pd.DataFrame) -> dict[str, pd.Series]:
    """Format RMSE and disparity; where not all robots are located, RMSE, their share and RMSE."""
    if not has_guesses(rows):
        return _means(rows, "accuracy")
    least = rows.get(LOCATED.least, rows[LOCATED.mean]).astype(float)
    share = _mean(rows, LOCATED, factor=100.0).mask(least >= 1.0, "100")
    return {
        PAGE["accuracy"][RMSE]: _mean(rows, RMSE),
        _heading(_LOCATED, LOCATED, rows): share,
        _OF_LOCATED: _mean(rows, RMSE_LOCATED),
    }


def _notes_on_means(rows: pd.DataFrame, *, with_shares: bool) -> list[str]:
    """State over how many structures means are, and what stands beside them."""
    most = rows["cases"].max()
    if most <= 1:
        return ["Values of n = 1 structure."]
    notes = ["Means over n structures, or over those of them that have a value."]
    if most >= FEWEST:
        notes.append("± is the half width of the 95 % CI.")
    return [*notes, *_in_parentheses(rows, with_shares=with_shares)]


def _in_parentheses(rows: pd.DataFrame, *, with_shares: bool = True) -> list[str]:
    """State what stands in parentheses: ranges of few structures, and intervals of shares.

    Shares of structures have intervals of any number; those of robots, of enough structures.
    """
    notes = []
    if _has_ranges(rows):
        notes.append(f"In parentheses: least and greatest, of fewer than {FEWEST} structures.")
    if with_shares:
        notes.append("Shares have their 95 % CI in parentheses.")
    return notes


def _has_ranges(rows: pd.DataFrame) -> bool:
    """Whether some means are over so few structures that their least and greatest stand beside."""
    return bool(rows["cases"].between(2, FEWEST - 1).any())


def _swarm_table(table: pd.DataFrame) -> PageTable:
    """Format whether swarms settled, and how they ended: a row for each point and condition."""
    columns = _counts(table) | _means(table, "swarms")
    notes = [
        note.replace("structure", "swarm") for note in _notes_on_means(table, with_shares=True)
    ]
    notes.append("R: a dock's radius.")
    notes.append(
        "Last step: the longest of a robot. Overlap: of docks that are not connected. Gap: root "
        "mean square by which connected docks miss touching. Moved: from where robots started."
    )
    return _labeled(_names(table), columns, "Swarms", " ".join(notes))


def throughput_table(table: pd.DataFrame) -> PageTable:
    """Format how fast the engine moved swarms, which differs from run to run."""
    columns = {
        "robots": _numbers(table["robot_count"]),
        "robot steps / CPU s": _numbers(table["robot_steps_per_cpu_s"]),
        "robot steps / s": _numbers(table["robot_steps_per_wall_s"]),
        "memory [MB]": _numbers(table["peak_memory_MB"]),
    }
    note = (
        "Steps of a robot, neighbor lists included, in a second of processor time and of time; "
        "compilation does not count. These depend on the machine and on what else it does."
    )
    return replace(_labeled(_names(table), columns, "Throughput", note), is_first=True)


_RARE = (LEFT, DIED)
"""Measures that have a column only where they are not zero."""


def _structure_table(table: pd.DataFrame) -> PageTable:
    """Format what structures reached, which robots stand, and loads: a row for each point."""
    columns = _counts(table) | _asked(table, "reached")
    for measure, heading in PAGE["structures"].items():
        is_usual = measure in _RARE and not table.get(measure.most, pd.Series([0.0])).any()
        columns |= {} if is_usual else _means_of(table, {measure: heading})
    with_shares = "bridge" in {*table.get("kind", [])}
    notes = [*_notes_on_means(table, with_shares=with_shares), "R: a dock's radius."]
    notes += _notes_on_columns(columns)
    return _labeled(_names(table), columns, "Structures", " ".join(notes))


def _best_first(table: pd.DataFrame) -> pd.DataFrame:
    """Sort the rows of each point of the sweep by the RMSE of all robots."""
    point = with_points(table).groupby("point", sort=False).ngroup()
    return table.assign(point_rank=point).sort_values(["point_rank", RMSE.mean], kind="stable")


def has_guesses(rows: pd.DataFrame) -> bool:
    """Whether robots of some series of `table.csv` are not located, whose positions are guesses."""
    return bool((rows.get(LOCATED.mean, pd.Series(dtype=float)) < 1.0).any())


def _heading(heading: str, measure: Measure, rows: pd.DataFrame) -> str:
    """Write the heading of a measure; beside ranges, that of a share says that it has intervals."""
    is_said = _has_ends(measure, rows) and _has_ranges(rows)
    return f"{heading} (95 % CI)" if is_said else heading


def _has_ends(measure: Measure, rows: pd.DataFrame) -> bool:
    """Whether means of a measure stand beside both ends of intervals, some of them at least."""
    if measure.is_yes_or_no:
        return True
    return measure.is_share and bool(rows.get(measure.bounds[0], pd.Series()).notna().any())


_LOCATED = "located [%]"
_CLOSED = "bridges closed"
_OF_LOCATED = "RMSE of located [R]"
_CHANGE = "change [%]"
_POWER = "RMSE as N^p: p"
_NOTES = {
    "disparity": "Disparity 0: right shape.",
    _LOCATED: "Located: robots that measurements tie to the anchor, and that a method which places "
    "robots one by one could place; positions of others are guesses.",
    _CHANGE: "Change: of RMSE from that of the condition without a change, at the same point.",
    _POWER: "p: power of the number of robots as which RMSE grows, over all sizes, with its 95 % "
    "CI.",
    "standing": "Standing: robots that contacts tie to the ground in the end.",
    "least margin": "Margin: strength of a contact in parts of its load.",
    "peak stress": "Peak stress: in weights of a dock / R^2.",
    "converged": "Converged: the search settled on one best fit; elsewhere, errors may be large.",
    "consistent": "Consistent: measurements agree within the noise that their logs state.",
}
"""Meaning of a column, by its label."""


def _notes_on_columns(columns: Collection[str]) -> list[str]:
    """List what columns mean, by their headings."""
    headings = {heading.removesuffix(" (95 % CI)") for heading in columns}
    return [note for heading, note in _NOTES.items() if heading in headings]


def _verdicts(rows: pd.DataFrame) -> dict[str, pd.Series]:
    """Format the estimates that converged, and those that are consistent, where not all are.

    They are counted among those that have the verdict; tables of earlier versions have no `count`.
    """
    columns: dict[str, pd.Series] = {}
    for measure in (CONVERGED, CONSISTENT):
        share = rows.get(measure.mean, pd.Series(math.nan, rows.index)).astype(float)
        if (share < 1.0).any():
            judged = rows.get(measure.statistic("count"), rows["cases"])
            texts = (share * judged).map("{:.0f}".format) + " of " + judged.map("{:.0f}".format)
            columns[measure.column] = texts.where(share.notna(), "")
    return columns


def _asked(
    rows: pd.DataFrame, question: str, powers: pd.DataFrame | None = None
) -> dict[str, pd.Series]:
    """Format what a question asks for beside accuracy, by label."""
    if question == "traffic" and SENT.mean in rows:
        return {"sent by a robot [B]": _mean(rows, SENT)}
    if question == "cues" and RMSE.mean in rows:
        return _changes(rows)
    if question == "sizes" and powers is not None and len(powers):
        return {_POWER: _powers(rows, powers)}
    if question != "reached" or "kind" not in rows:
        return {}
    # A column for each measure: heights and shares that closed do not compare.
    columns = {}
    for kind, measure in BUILT_FOR.items():
        is_built_for = rows["kind"] == kind
        if measure.mean in rows and is_built_for.any():
            means = _mean(rows[is_built_for], measure)
            heading = _heading(_aim(measure), measure, rows)
            columns[heading] = means.reindex(rows.index, fill_value="")
    return columns


def _aim(measure: Measure) -> str:
    """Return the heading of a measure of what structures are built for: `height [R]`."""
    return measure.axis[0].lower() + measure.axis[1:]


def _powers(rows: pd.DataFrame, powers: pd.DataFrame) -> "pd.Series[str]":
    """Format the power of N of the RMSE of each series, in its row of the greatest N."""
    axis = str(powers.columns[2])
    of_rmse = powers[powers["measure"] == RMSE.column].set_index("series")
    if axis not in swept_columns(rows):
        return pd.Series("", rows.index)
    swept = [key for key in swept_columns(rows) if key not in {axis, *NO_KEYS}]
    series = pd.Series(joined_words(rows, [*swept, "condition"]), rows.index)
    is_last = rows.index.to_series().groupby(series).transform("max") == rows.index
    texts = series.map(
        {
            name: power_words(row["exponent"], row["exponent_ci95"])
            for name, row in of_rmse.iterrows()
        }
    )
    return texts.where(is_last).fillna("")


def power_words(exponent: float, half: float) -> str:
    """Write a power with the half width of its 95 % confidence interval; empty if it is unknown.

    >>> power_words(-0.8, 0.123)
    '-0.80 ± 0.12'
    """
    return f"{exponent:.2f} ± {half:.2f}" if math.isfinite(exponent + half) else ""


def _changes(rows: pd.DataFrame) -> dict[str, pd.Series]:
    """Format by how much the error of each condition differs from that of the first one [%].

    The first condition is that of `table.csv`, whose order the index of the rows has.
    """
    named = with_points(rows).sort_index(kind="stable")
    first = named["condition"].iloc[0]
    of_first = named[named["condition"] == first].set_index("point")[RMSE.mean]
    change = 100.0 * (named[RMSE.mean] / named["point"].map(of_first) - 1.0)
    texts = [_number(round(value), "+") if math.isfinite(value) else "" for value in change]
    changes = pd.Series(texts, named.index, dtype=str).where(named["condition"] != first, "")
    return {_CHANGE: changes.reindex(rows.index)}


def _measurements_in_use(rows: pd.DataFrame) -> list[str]:
    """State what all series measure, and what those of a point of the sweep have in addition.

    Names of conditions have the measurements in which they differ; points may differ, too, as
    methods do.
    """
    if "measurements" not in rows:
        return []
    named = with_points(rows).dropna(subset=["measurements"])
    cues = named["measurements"].map(lambda names: set(split_cues(str(names))))
    cues = cues[cues.map(bool)]
    if cues.empty:
        return []
    shared = set.intersection(*cues)
    notes = [f"All series use {_cue_words(shared)}."] if shared else []
    points_by_words: dict[str, list[str]] = {}
    for point, of_point in cues.groupby(named["point"], sort=False):
        added = set.intersection(*of_point) - shared
        points_by_words.setdefault(_cue_words(added) if added else "", []).append(str(point))
    points_by_words.pop("", None)
    most = max(map(len, points_by_words.values()), default=0)
    if len(points_by_words) > _MOST_GROUPS or most > _MOST_POINTS:
        return [*notes, "Measurements differ between points: table.csv lists them."]
    for words, points in points_by_words.items():
        notes.append(f"Those of {'; '.join(points)} also use {words}.")
    return notes


_MOST_GROUPS = 2
"""Most groups of points whose measurements a note lists."""

_MOST_POINTS = 5
"""Most points of such a group."""


def _cue_words(cues: Collection[str]) -> str:
    return measured_words(", ".join(sorted(cues)))


def result_tables(
    table: pd.DataFrame, paired: pd.DataFrame, suites: pd.DataFrame | None = None
) -> list[PageTable]:
    """Format the other results of a run; `paired` and `suites` may be empty."""
    tables = []
    if suites is not None and len(suites):
        tables.append(_measured_suites(suites))
    if RMSE.published in table and table[RMSE.published].notna().any():
        tables.append(_beside_the_paper(table))
    if len(paired):
        tables.append(_differences(paired))
    if RMSE.mean in table:
        tables += _errors_in_parts(table)
    tables += _plugin_measures(table)
    tables += _calibration(table)
    tables += _robots_on_anchor(table)
    return tables


def _errors_in_parts(table: pd.DataFrame) -> Iterator[PageTable]:
    """Format errors after alignment, errors for attachment, and what limits them."""
    words = _names(table)
    note = "Alignment removes a rotated or shifted frame; the rest is a wrong shape."
    yield _labeled(words, _means(table, "aligned"), "RMSE after alignment [R]", note)
    note = (
        "2 R, a dock's diameter, is what the paper calls sufficient for attachment. Robots: in the "
        "world; neighbors: the vector between two robots in contact, one hop apart, with its RMSE. "
        f"{' '.join(_in_parentheses(table))}"
    )
    yield _labeled(words, _means(table, "attachment"), "Accuracy for attachment", note)
    note = "Floppy modes are motions that change no measurement: no method can remove such errors."
    yield _labeled(words, _means(table, "limits"), "Limits of the accuracy", note)


def _plugin_measures(table: pd.DataFrame) -> Iterator[PageTable]:
    """Format the measures of plug-ins, if there are any."""
    columns = _means_of(table, plugin_headings())
    if not columns:
        return
    texts = [
        f"{measure.column}: {measure.meaning}."
        for measure in plugin_headings()
        if measure.mean in table
    ]
    yield _labeled(_names(table), columns, "Measures of plug-ins", " ".join(texts))


def _calibration(table: pd.DataFrame) -> Iterator[PageTable]:
    """Format what methods report of their estimates beside what is true, if any does."""
    columns: dict[str, pd.Series] = {}
    for measure, heading in PAGE["calibration"].items():
        tested = _consistent(table) if measure is CONSISTENT else {}
        columns |= tested or _means_of(table, {measure: heading})
    if not columns:
        return
    note = (
        f"{' '.join(_in_parentheses(table))} Means are over the structures that have a value. "
        "A robot is in its interval if its error is within the interval that its "
        "standard deviation implies; more than 0.5 and 0.9 mean that the standard deviations "
        "are too large."
    )
    if any("outliers" in label for label in columns):
        note += (
            " Precision: wrong contacts among those reported as outliers; recall: reported "
            "outliers among wrong contacts."
        )
    if PAGE["calibration"][RMSE_LOCATED] in columns:
        note += " Robots located are without anchors, whose errors are 0."
    if any(heading.startswith(PAGE["calibration"][CONSISTENT]) for heading in columns):
        note += (
            " Converged: several searches found one least cost. Consistent: noise as stated "
            "explains it; where not, the factor multiplies standard deviations. Not testable: "
            "no measurements are spare."
        )
    if "mirrored robots" in columns:
        note += (
            " Mirrored robots, counted by case: configurations that fit put them farther apart "
            "than their standard deviation."
        )
    labeled = _labeled(_names(table), columns, "Calibration", note)
    is_reported = (labeled.frame[[*columns]] != "").any(axis=1)
    yield replace(labeled, frame=labeled.frame[is_reported])


def statement_of(summary: pd.DataFrame) -> str:
    """State in a sentence how many robots are near where they are shown; empty without estimates.

    It is of the series with the largest share, in the mean over its cases, and says so.
    """
    done = summary[summary["status"] == "done"]
    if RMSE.column not in done or done[RMSE.column].isna().all():
        return ""
    share = done.groupby("series", sort=False).mean(numeric_only=True)
    share = share.reindex(columns=[SURE.column, SURE_OFF.column])
    if share[SURE.column].isna().all():
        # Tables of earlier versions have intervals alone.
        if done.reindex(columns=[COVERAGE_90.column]).notna().any(axis=None):
            return ""
        return "No method states the error of single robots."
    best = share[SURE.column].idxmax()
    off = share[SURE_OFF.column][best]
    name = f"{best}, {_rank(share[SURE.column])}: " if len(share) > 1 else ""
    text = f"{name}{percent(share[SURE.column][best])} % of the robots are within 1 R of where they"
    text += f" are shown with a probability of {100.0 * error_law.SURE:g} % or more"
    structures = int(done.loc[done["series"] == best, SURE.column].notna().sum())
    if structures > 1:
        text += f" (mean over {structures} structures)"
    return text + (f"; {percent(off)} % of these are not." if off > 0.0 else ".")


def _rank(shares: "pd.Series[float]") -> str:
    """Say that the series with the largest share was chosen, and from how many."""
    rivals = int(shares.notna().sum())
    if rivals == 1:
        return "the only series that states errors of single robots"
    equals = int((shares == shares.max()).sum())
    first = "the best" if equals == 1 else f"one of the {equals} best"
    return f"{first} of {rivals} series"


def _robots_on_anchor(table: pd.DataFrame) -> Iterator[PageTable]:
    """Format which robots touch the anchor, if the table states it."""
    columns = _means(table, "anchor")
    if not columns:
        return
    note = (
        "Join index of the robots that touch the anchor in the end; the anchor has index 0. "
        "Means are over structures in which so many robots touch it."
    )
    labeled = _labeled(_names(table), columns, "Robots on the anchor", note)
    yield replace(labeled, frame=_once(labeled.frame))


def _consistent(table: pd.DataFrame) -> dict[str, pd.Series]:
    """Format the share of consistent estimates among those that were tested, by label."""
    if TESTABLE.mean not in table:
        return {}
    tested = table[TESTABLE.mean].astype(float)
    share = table.get(CONSISTENT.mean, tested * math.nan).astype(float)
    spare = _numbers(table.get(SPARE.mean, tested * math.nan))
    tested_share = np.where(tested < 1.0, " of " + _numbers(tested) + " testable", "")
    texts = np.where(
        tested > 0.0, _numbers(share) + tested_share, "not testable (" + spare + " spare)"
    )
    has_verdict = tested.notna()
    if not has_verdict.any():
        return {}
    column = pd.Series(texts, table.index, dtype=str).where(has_verdict, "")
    return {PAGE["calibration"][CONSISTENT]: column}


def _measured_suites(suites: pd.DataFrame) -> PageTable:
    """Format prices of sensor suites beside what robots achieve with them."""
    note = (
        "Prices [USD] are those of the paper's Table I: of the sensors of so many robots, touch "
        "included, and of what the suite needs, if Table I states it. Positions are determined of "
        "robots that the method places one by one, or else of those that its cues fix, up to "
        "mirror images; measurements may tie more robots to the anchor. "
        "Systems of a lattice, m-blocks and atron, cannot build these structures: "
        "their rows mean FireAntV3 robots whose docks know the pose of a connection. "
        f"{' '.join(_notes_on_means(suites, with_shares=True))}"
    )
    prices = [name for name in map(str, suites) if name.startswith("usd_")]
    costs = {_price_of(int(n.removeprefix("usd_"))): _numbers(suites[n]) for n in prices}
    columns = {**costs, **_counts(suites), **_means(suites, "suites"), "needs": suites["needs"]}
    words = _names(suites)
    shown = _labeled(words, columns, "Table I, measured", note)
    return replace(shown, words=[*words, "needs"], is_first=True)


def _price_of(robots: int) -> str:
    return f"{robots:,} robot{'' if robots == 1 else 's'} [USD]"


def _once(frame: pd.DataFrame) -> pd.DataFrame:
    """Leave out the conditions of a table where all of them have the same rows."""
    shared = frame.drop(columns="condition").drop_duplicates()
    return shared if len(shared) * frame["condition"].nunique() == len(frame) else frame


def _beside_the_paper(table: pd.DataFrame) -> PageTable:
    """Format the rows of the paper's settings beside its numbers."""
    rows = table[table[RMSE.published].notna()]
    note = (
        'The paper does not define its "robot radius". It is either R, the radius of a dock, or '
        "rho, the distance from a robot's center to a dock; ratios are stated for both. Changes "
        "are relative to the first condition."
    )
    means = {measure.mean: measure for measure in (RMSE, DISPARITY)}
    columns = {
        heading: _mean(rows, means[name]) if name in means else _numbers(rows[name])
        for name, heading in _PUBLISHED.items()
        if name in rows
    }
    return replace(_labeled(_names(rows), columns, "Beside the paper", note), is_first=True)


def _differences(paired: pd.DataFrame) -> PageTable:
    """Format differences between conditions on the same structures."""
    first = paired["against"] == paired["against"].iloc[0]
    headings = {measure.column: heading for measure, heading in PAGE["accuracy"].items()}
    rows = paired[first & paired["measure"].isin([*headings])]
    words = _names(rows, "measure").assign(measure=rows["measure"].map(headings))
    columns = {
        "difference": _mean(rows, "difference", sign="+"),
        "smaller in": rows["smaller"].astype(str) + " of " + rows["structures"].astype(str),
        "measurements": np.where(rows["equal_measurements"] == 1, "the same", "others"),
    }
    against = f"Differences from {paired['against'].iloc[0]}: negative ones are smaller."
    note = "paired.csv contains all measures and pairs."
    p = rows["wilcoxon_p"].where(rows["structures"] >= FEWEST)
    if p.notna().any():
        columns["p"] = _numbers(p).mask(p < 1e-4, "< 0.0001")  # noqa: PLR2004 - a limit of the test
        note = (
            "p of Wilcoxon's signed-rank test, not corrected for multiple comparisons; with n "
            f"structures it is at least 2^(1 - n), and fewer than {FEWEST} have none. {note}"
        )
    return _labeled(words, columns, "Differences on the same structures", f"{against} {note}")


def case_table(summary: pd.DataFrame, *, in_words: bool = False) -> PageTable:
    """Format a row for each case, named by its folder, or in words by its series and seed."""
    shown = summary.head(MOST_ROWS)
    words = shown[["case", "status"]].fillna("").astype(str)
    if in_words:
        words["case"] = words["case"].str.replace(r"-.*", "", regex=True)
        words["case"] = shown["series"] + ", seed " + words["case"]
    measures = PAGE["cases"] | plugin_headings()
    if SETTLED.column in shown:
        measures = PAGE["swarms"]
    elif RMSE.column not in shown:
        measures = measures | {REACH: "reach [R]", DEPTH: "depth [R]"} | PAGE["structures"]
    headings = {measure.column: heading for measure, heading in measures.items()}
    first = {RMSE.column: headings[RMSE.column]} if RMSE.column in headings else {}
    headings = {**first, "robots": "robots"} | headings
    numbers = {label: _numbers(shown[name]) for name, label in headings.items() if name in shown}
    reasons = shown["reason"].fillna("").astype(str)
    reason = {"reason": reasons} if reasons.any() else {}
    omitted = len(summary) - len(shown)
    note = f"{counted(omitted, 'more case')} in summary.csv." if omitted else ""
    if in_words:
        note += ' The column "case" of summary.csv names their folders.'
    return replace(_labeled(words, numbers | reason, "Cases", note), words=[*words, *reason])


_MOST_CONTACTS = 10
"""Rows of the table of weakest contacts."""


def weakest_contacts(loads: pd.DataFrame, case: str) -> PageTable:
    """Format the loads of the contacts that are nearest to breaking.

    Args:
        loads: Loads of a case, `loads.csv`, from the weakest contact on.
        case: What the page calls the case.
    """
    shown = loads.head(_MOST_CONTACTS)
    frame = pd.DataFrame({name: shown[name].astype(str) for name in ("robot", "dock", "neighbor")})
    frame["neighbor dock"] = (
        shown["neighbor_dock"].astype(object).where(shown["neighbor_dock"].notna())
    )
    names = [*map(str, loads)]
    for name in names[names.index("neighbor_dock") + 1 :]:
        frame[_with_unit(name)] = _numbers(shown[name])
    note = (
        f"Case {case}: margin is strength over load; the contact in the first row is the next to "
        "break. Pull is positive. W is the weight of a dock, R its radius. "
        f"loads.csv in the folder of a case has all its contacts, here {len(loads)}."
    )
    return PageTable(
        frame=frame, words=["neighbor"], title="Weakest contacts", note=note, is_first=True
    )


def _with_unit(column: str) -> str:
    """Write the name of a column with its unit in brackets.

    >>> [_with_unit(column) for column in ("bending_N_m", "stress_W_per_R2", "margin")]
    ['bending [N m]', 'stress [W / R^2]', 'margin']
    """
    name, _, unit = column.partition("_")
    unit = unit.replace("_per_", " / ").replace("_", " ").replace("R2", "R^2")
    return f"{name} [{unit}]" if unit else name


def machine_table(manifest: Manifest) -> PageTable:
    """Format the machine, the versions and the computing times."""
    facts = {
        **manifest.machine,
        **manifest.backend,
        **manifest.devices,
        "error of forces by rounding": f"{manifest.force_error:.1g}",
        "peak_memory_MB": manifest.peak_memory_MB,
        "python": manifest.python,
        **manifest.libraries,
    }
    if manifest.numerics:
        for name in manifest.numerics[0]:
            values = dict.fromkeys(process[name] for process in manifest.numerics)
            facts[f"numbers by {name}"] = " and ".join(values)
    for name, spent in manifest.stages.items():
        facts[f"{name} [s wall, s CPU]"] = f"{spent.wall_s}, {spent.cpu_s}"
    rows = [
        (name.replace("_MB", " [MB]").replace("_", " "), str(value))
        for name, value in facts.items()
        if value not in {"", None}
    ]
    frame = pd.DataFrame(rows, columns=["item", "value"])
    return PageTable(frame=frame, words=["item", "value"], title="Machine and versions")


def _names(table: pd.DataFrame, before: str = "cases") -> pd.DataFrame:
    """Return the columns that name a row: point of the sweep, if there is one, and condition."""
    names = with_points(table, before=before)[[POINT, "condition"]]
    if len(names) > 1 and names[POINT].is_unique:  # one condition, which says nothing
        return names[[POINT]].rename(columns={POINT: "condition"})
    return names if names[POINT].any() else names[["condition"]]


def _labeled(
    words: pd.DataFrame, columns: dict[str, pd.Series], title: str, note: str
) -> PageTable:
    """Put columns of words beside columns of formatted numbers."""
    frame = pd.concat([words, pd.DataFrame(columns, index=words.index)], axis=1)
    return PageTable(frame=frame, words=words.columns.astype(str), title=title, note=note)


def _means(table: pd.DataFrame, section: str) -> dict[str, pd.Series]:
    """Format the means that a table of the page shows, by heading, if `table` has them."""
    return _means_of(table, PAGE[section])


def _means_of(table: pd.DataFrame, headings: Mapping[Measure, str]) -> dict[str, pd.Series]:
    """Format the means of measures, by heading, if `table` has them."""
    return {
        _heading(heading, measure, table): _mean(table, measure)
        for measure, heading in headings.items()
        if measure.mean in table and table[measure.mean].notna().any()
    }


def _mean(
    table: pd.DataFrame, measure: Measure | str, *, sign: str = "", factor: float = 1.0
) -> "pd.Series[str]":
    """Format means with the half widths of their confidence intervals, or with ranges.

    Shares have both ends of their intervals, which are not symmetric.
    """
    name = measure.column if isinstance(measure, Measure) else measure
    has_ends = isinstance(measure, Measure) and _has_ends(measure, table)
    ends = ("ci95_low", "ci95_high") if has_ends else ("least", "most")
    columns = [f"{name}_{statistic}" for statistic in ("mean", "ci95", *ends)]
    values = factor * table.reindex(columns=columns).astype(float).to_numpy()
    count = table["cases" if "cases" in table else "structures"]
    texts = [_spread(*row, sign=sign) for row in np.column_stack([count, values]).tolist()]
    return pd.Series(texts, table.index, dtype=str)


def _spread(count: float, mean: float, half: float, least: float, most: float, *, sign: str) -> str:
    """Write a mean with three significant digits and what is known of its uncertainty."""
    if count >= FEWEST and math.isfinite(half):
        digits = max(0, 2 - math.floor(math.log10(abs(mean) or 1.0)))
        return f"{mean:{sign}.{digits}f} ± {half:.{digits}f}"
    between = f" ({_number(least)} to {_number(most)})" if count > 1 and least < most else ""
    return _number(mean, sign) + between


def _number(value: float, sign: str = "") -> str:
    """Write a number with three significant digits, a whole one without decimals."""
    if math.isnan(value):
        return ""
    if math.isinf(value):
        return str(value)
    plus = sign if value > 0.0 else ""
    whole = value == round(value) or abs(value) >= 1000.0  # noqa: PLR2004 - all digits before the point
    return plus + (f"{value:.0f}" if whole else three_digits(value))


def _numbers(values: pd.Series) -> "pd.Series[str]":
    """Format numbers; unknown ones are empty."""
    return values.astype(float).map(_number).astype(str)  # of no values too


_MOST_REASONS = 5
_NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_VERDICTS = (*(m.column for m in (CONVERGED, CONSISTENT, MISFIT, SD_FACTOR)), "distrust")


def warnings_of(summary: pd.DataFrame) -> list[str]:
    """List what makes results of a run wrong or incomplete."""
    done = summary[summary["status"] == "done"]
    failed = summary[summary["status"] != "done"]
    warnings = []
    if len(failed):
        why = _first_of(failed["reason"].dropna().unique(), "; ")
        warnings.append(f"{len(failed)} of {len(summary)} cases failed: {why}.")
    warnings += _untrusted(done)
    if DISCONNECTED.column in done:
        disconnected = done[DISCONNECTED.column].fillna(0)
        if disconnected.any():
            robots = counted(int(disconnected.sum()), "robot")
            cases = counted(int((disconnected > 0).sum()), "case")
            warnings.append(
                f"No measurement that was used ties {robots} in {cases} to the anchor; "
                "their positions are guesses."
            )
    return warnings


def notes_of(summary: pd.DataFrame, manifest: Manifest) -> list[str]:
    """List what a reader of the results should know."""
    done = summary[summary["status"] == "done"]
    notes = []
    ended = done["reason"].dropna()
    if len(ended):
        why = _first_of(ended.unique(), "; ")
        notes.append(
            f"Growth ended before all robots joined in {counted(len(ended), 'case')}: {why}."
        )
    if FLOPPY_MODES.column in done:
        modes = done[FLOPPY_MODES.column]
        if (modes > 0).any():
            count = " to ".join(dict.fromkeys(f"{end:.0f}" for end in (modes.min(), modes.max())))
            notes.append(
                f"The measurements that the method uses leave {count} floppy modes a case: motions "
                "that change no measurement. No method can remove errors along them."
            )
    reasons = sorted({origin.reason for origin in manifest.renders.values() if origin.reason})
    notes += [f"A simpler renderer drew the pictures: {reason}." for reason in reasons]
    return notes


def _first_of(items: Iterable[object], separator: str) -> str:
    """Join the first of some texts."""
    texts = [str(item) for item in items]
    shown = texts[:_MOST_REASONS]
    if len(texts) > _MOST_REASONS:
        shown.append("...")
    return separator.join(shown)


def _merged(texts: Iterable[str]) -> list[str]:
    """Merge texts that differ in numbers only, into one with the range of each number."""
    numbers_by_words: dict[tuple[str, ...], list[list[str]]] = {}
    for text in texts:
        words = tuple(_NUMBER.split(text))  # what stands before, between and after the numbers
        numbers_by_words.setdefault(words, []).append(_NUMBER.findall(text))
    merged = []
    for words, numbers in numbers_by_words.items():
        ranges = [_range(column) for column in zip(*numbers, strict=True)]
        pairs = zip(ranges, words[1:], strict=True)
        merged.append(words[0] + "".join(f"{span}{word}" for span, word in pairs))
    return merged


def _range(numbers: Iterable[str]) -> str:
    """Write the least and the greatest of some numbers, as they are written."""
    ascending = sorted(dict.fromkeys(numbers), key=float)
    if len(ascending) == 1:
        return ascending[0]
    return f"{ascending[0]} to {ascending[-1]}"


def _untrusted(done: pd.DataFrame) -> Iterator[str]:
    """Name the cases whose estimate did not converge, or is not consistent, and why."""
    cases = done.reindex(columns=[*done, *{*_VERDICTS} - {*done}])
    trapped = cases[CONVERGED.column].eq(False)  # noqa: FBT003 - other methods leave it empty
    if trapped.any():
        text = f"{_share(cases, trapped, 'did not converge')}. The search found no single best fit."
        yield f"{text} All tables include their errors. Try more steps or chains."
    at_odds = cases[CONSISTENT.column].eq(False) & ~trapped  # noqa: FBT003
    if at_odds.any():
        misfit = cases[MISFIT.column][at_odds].dropna()
        factor = cases[SD_FACTOR.column][at_odds].max()
        sizes = [describe_misfit(max(misfit, key=abs, default=0.0))]
        if factor > 1.0:
            sizes.append(f"sd is multiplied by {factor:.2g}")
        most = " and ".join(filter(None, sizes))
        text = _share(cases, at_odds, "are not consistent with the noise that their logs state")
        yield f"{text}. At most, {most}." if most else f"{text}."


def _share(cases: pd.DataFrame, is_affected: pd.Series, what: str) -> str:
    """Count and name cases, and state the reasons of those that are no whole condition or series.

    A condition or series is named once if all of its cases are among them. Where there are no
    other cases, the reasons are theirs.
    """
    names = []
    is_open = is_affected.copy()  # cases that no name includes yet
    for column in ("condition", "series"):
        group = cases.get(column, pd.Series("", cases.index)).fillna("")
        is_repeated = group.groupby(group).transform("size") > 1
        is_whole = is_affected.groupby(group).transform("all") & is_repeated
        names += [f"all of {name}" for name in group[is_whole & is_open].unique() if name]
        is_open &= ~is_whole | (group == "")
    single = cases.loc[is_open, ["case", "series"]].itertuples(index=False)
    names += [f"seed {case.partition('-')[0]} of {name}" for case, name in single]
    explained = is_open if is_open.any() else is_affected
    reasons = cases["distrust"][explained].dropna().unique()
    count = f"{is_affected.sum()} of {counted(len(cases), 'case')}"
    text = f"{count} {what} ({_first_of(names, '; ')})"
    return f"{text}: {_first_of(_merged(reasons), '; ')}" if len(reasons) else text
