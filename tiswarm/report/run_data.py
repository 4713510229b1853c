"""Reads a run folder once: its cases and its tables.

All functions of this room raise InputError if a file that they read is missing or damaged.
"""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.records.frames import read_frame
from tiswarm.records.io import damaged, run_file
from tiswarm.records.measures import DISCONNECTED, LOCATED
from tiswarm.records.run_folder import (
    ENGINE_METHOD,
    LABEL,
    NO_METHOD,
    TABLE_NOTES,
    case_folder,
    check_folders,
)
from tiswarm.records.terrain import NO_EDGE
from tiswarm.report.series import joined, measured_cues, series_names
from tiswarm.scenario.labels import BASELINE, row_labels, words_of
from tiswarm.scenario.yaml_source import plain_scalar, read_yaml


@dataclass(frozen=True, kw_only=True)
class StoredCase:
    """A case in the folder of a run, and its row of `summary.csv`."""

    name: str  # of its folder
    folder: Path
    done: bool
    condition: str
    series: str  # point of the sweep and condition, which cases of other seeds share
    point: str  # values of the sweep; empty without a sweep
    kind: str  # kind of its structure
    method: str  # that localized its robots; empty where unknown
    robots: int  # robots of its structure; 0 where unknown
    left_edge: float  # end of the ground at the left [R], as in `Terrain`
    right_edge: float  # beginning of the ground at the right [R]
    user_colorings: Sequence[Any] = ()  # values of the user that color its robots, `Coloring`s

    @property
    def title(self) -> str:
        """Series and seed, as captions name the case."""
        return f"{self.series}, seed {self.name.partition('-')[0]}"

    @property
    def has_estimate(self) -> bool:
        """Whether its robots were localized."""
        return self.method not in {NO_METHOD, ENGINE_METHOD}

    @property
    def is_of_engine(self) -> bool:
        """Whether it is a run of the engine."""
        return self.method == ENGINE_METHOD

    def columns(
        self,
        file: str,
        names: Sequence[str],
        *,
        gaps: Sequence[str] = (),
        optional: Sequence[str] = (),
        empty: bool = False,
    ) -> Reals:
        """Read columns of numbers of a file of the case, shape (rows, names).

        Numbers in the columns `gaps` may be unknown, NaN; the columns `optional` may be missing,
        too. The file may have no rows if `empty`.
        """
        required = [name for name in names if name not in (*gaps, *optional)]
        table = read_frame(
            self.folder / file, numbers=required, gaps=gaps, optional=optional, empty=empty
        )
        return table.reindex(columns=list(names)).to_numpy(float)


NO_KEYS = ("condition", "against", "run", "suite", "way", "needs", "point")
"""Columns of words before the numbers of a table that are no swept keys."""

_PAIR = re.compile(r", (?=[a-z_.]+=)")
"""What separates the swept keys of a point from each other."""


@dataclass(frozen=True)
class Labels:
    """What pages, figures and sentences call the conditions and points of a run."""

    conditions: Mapping[str, str] = field(default_factory=dict)  # by name, with measurements
    rows: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # by swept key and cell

    def cell(self, key: str, cell: Any) -> str:  # noqa: ANN401 - text or a number
        """Return the label of a swept value; empty if all points share it, or there is none."""
        text = "" if pd.isna(cell) else str(cell)
        labels = self.rows.get(key, {})
        if text in labels or not text:
            return labels.get(text, "")
        words = re.sub(r"[{}]|kind: ", "", text).replace(": ", " ").replace("_", " ")
        return words_of(key, plain_scalar(words))

    def point(self, text: str) -> str:
        """Return the label of a point that is written as `key=value, key=value`."""
        pairs = [pair.partition("=") for pair in _PAIR.split(text)]
        labels = [self.cell(key, cell) if equals else key for key, equals, cell in pairs]
        return joined(labels)

    def series(self, text: str) -> str:
        """Return the label of a series: of its point, if there is one, and of its condition."""
        point, _, condition = text.rpartition(", ")
        condition = self.conditions.get(condition, condition)
        return joined([self.point(point), condition])

    def put(self, table: pd.DataFrame, *, before: str = "") -> pd.DataFrame:
        """Write labels into the columns of conditions, series and points, and of swept keys.

        Swept keys are the columns before a named one; those whose value all points share are left
        out.
        """
        for name in table.columns.intersection(["condition", "against"]):
            table[name] = table[name].replace(self.conditions)
        for name, label in (("series", self.series), ("point", self.point)):
            if name in table:
                table[name] = table[name].map(label, na_action="ignore")
        swept = swept_columns(table, before=before) if before else []
        for key in [key for key in swept if key not in NO_KEYS]:
            words = [self.cell(key, cell) for cell in table[key]]
            table[key] = pd.Series(words, table.index, dtype=object)
            if self.rows.get(key) and not any(self.rows[key].values()):
                table = table.drop(columns=key)
        return table


_WORDS = ["case", "series", "condition", "point", "kind", "status", "reason"]
"""Columns of text that a summary has."""

Series = dict[str, list[StoredCase]]
"""Cases that are done, by the name of their series."""


@dataclass(frozen=True)
class RunData:
    """The folder of a run, and its summary."""

    folder: Path
    summary: pd.DataFrame  # all cases, `summary.csv`, with labels
    labels: Labels = Labels()
    user_colorings: Mapping[str, Sequence[Any]] = field(default_factory=dict)  # by case

    @cached_property
    def cases(self) -> list[StoredCase]:
        """All cases, in the order of the summary."""
        unknown = {"robots": 0, "method": "", "left_edge_R": NO_EDGE, "right_edge_R": NO_EDGE}
        table = self.summary.reindex(columns=[*_WORDS, *unknown])
        table = table.fillna(unknown | dict.fromkeys(_WORDS, ""))
        return [
            StoredCase(
                name=row["case"],
                folder=case_folder(self.folder, row["case"]),
                done=row["status"] == "done",
                robots=int(row["robots"]),
                left_edge=row["left_edge_R"],
                right_edge=row["right_edge_R"],
                method=row["method"],
                user_colorings=self.user_colorings.get(row["case"], ()),
                **{word: row[word] for word in ("condition", "series", "point", "kind")},
            )
            for row in table.to_dict("records")
        ]

    @cached_property
    def series(self) -> Series:
        """The cases that are done, by series."""
        series: Series = {}
        for case in self.cases:
            if case.done:
                series.setdefault(case.series, []).append(case)
        return series

    @cached_property
    def localized(self) -> Series:
        """The cases that are done and have an estimate, by series."""
        chosen = {
            name: [case for case in cases if case.has_estimate]
            for name, cases in self.series.items()
        }
        return {name: cases for name, cases in chosen.items() if cases}

    @property
    def has_structures_alone(self) -> bool:
        """Whether no case is one whose robots are localized."""
        return bool(self.cases) and not any(case.has_estimate for case in self.cases)

    @property
    def is_of_engine(self) -> bool:
        """Whether cases are runs of the engine, whose robots are swarms and no structures."""
        return any(case.is_of_engine for case in self.cases)

    @property
    def sweeps_robots(self) -> bool:
        """Whether this is a study of scaling."""
        return (self.folder / "scaling.csv").is_file()

    @property
    def sweeps_robot(self) -> bool:
        """Whether the robots of its cases differ."""
        return any(str(column).partition(".")[0] == "robot" for column in self.summary)

    @property
    def has_guesses(self) -> bool:
        """Whether robots of some case are not located, whose positions are guesses."""
        return bool((self.summary.get(LOCATED.column, pd.Series(dtype=float)) < 1.0).any())

    @property
    def note(self) -> str:
        """How many cases failed or have disconnected robots; empty if none did and none has."""
        count = len(self.cases)
        failed = sum(not case.done for case in self.cases)
        disconnected = self.summary.get(DISCONNECTED.column, pd.Series(dtype=float))
        lost = int((disconnected > 0).sum())
        notes = []
        if failed:
            notes.append(f"{failed} of {count} cases failed and are left out")
        if lost:
            have = "has" if lost == 1 else "have"
            notes.append(f"{lost} of {count} cases {have} disconnected robots")
        return "; ".join(notes)

    def choose(self, name: str | None) -> StoredCase:
        """Find a case that is done by its name; the first of those with most robots if None.

        Raises:
            InputError: there is no such case.
        """
        done = [case for case in self.cases if case.done]
        candidates = done
        if name is not None:
            candidates = [case for case in done if case.name == name]
        if candidates:
            return max(candidates, key=lambda case: case.robots)
        if not done:
            problem = "no case of this run is done; there is nothing to draw"
            raise InputError(problem, path=self.folder)
        choices = ", ".join(case.name for case in done[:9])
        problem = f"no case {name!r} is done; choose one of {choices}"
        raise InputError(problem, path=self.folder, argument="case")

    def table(
        self,
        name: str,
        words: Sequence[str],
        gaps: Sequence[str],
        *,
        after: str,
        optional: bool = False,
    ) -> pd.DataFrame:
        """Read a table of the run as `read_frame` does, with numbers after one of its columns.

        An optional table may be missing or have no rows. Conditions and swept values have their
        labels.
        """
        path = self.folder / name
        if optional and not path.exists():
            return pd.DataFrame()
        table = read_frame(
            path, words, gaps=gaps, notes=TABLE_NOTES, numbers_after=after, empty=optional
        )
        return self.labels.put(table, before=after)

    @property
    def powers(self) -> pd.DataFrame:
        """Powers p of N^p of each series and measure: the last rows of each in `scaling.csv`.

        Empty if there is no such table. N may also be threads, workers or movers; the name of the
        third column says what it is.
        """
        table = self.table(
            "scaling.csv", ["series", "measure"], ["mean"], after="measure", optional=True
        )
        if table.empty or "exponent_ci95" not in table:
            return pd.DataFrame()
        return table.groupby(["series", "measure"], sort=False).tail(1)

    def subfolder(self, name: str) -> Path:
        """Make a folder within the run's folder, unless it exists.

        Raises:
            EnvironmentTroubleError: the run's folder is not writable.
        """
        folder = self.folder / name
        try:
            folder.mkdir(exist_ok=True)
        except OSError as error:
            problem = f"{folder}: cannot be made: {error.strerror}; check the rights of its folder"
            raise EnvironmentTroubleError(problem) from error
        return folder


def load_run(folder: Path, labels: Labels | None = None) -> RunData:
    """Read the summary of a run.

    Args:
        folder: Its folder.
        labels: Names of its series; those of this run alone if None.

    Raises:
        InputError: the folder is not one of a run, its summary is damaged, or a part is a link.
    """
    path = folder / "summary.csv"
    if not os.path.lexists(path):
        problem = "contains no summary of a run; name a folder that `tiswarm run` made"
        raise InputError(problem, path=folder)
    check_folders(folder)
    return named_run(folder, read_frame(path, _WORDS, ["seed"], numbers_after="reason"), labels)


def named_run(folder: Path, summary: pd.DataFrame, labels: Labels | None = None) -> RunData:
    """Name the series of a summary, with the measurements in which they differ.

    Args:
        folder: Folder of the run.
        summary: Cases of it.
        labels: Names of its series; those of these cases if None.
    """
    if labels is None:
        labels = read_labels(folder)
        measured = measured_cues(summary)
        stated = {name: labels.conditions.get(name, name) for name in measured}
        names = series_names(stated, measured)
        if labels.rows and names == {BASELINE: BASELINE}:
            names = {BASELINE: ""}  # points alone name the series of a sweep
        labels = replace(labels, conditions=names)
    return RunData(folder, labels.put(summary), labels)


def read_labels(folder: Path) -> Labels:
    """Read the labels of a run; values of a run without a scenario have labels made of them."""
    conditions = {
        name: str(entries.get(LABEL, name)) for name, entries in stated_conditions(folder).items()
    }
    stated = _stated(folder)
    sweep = stated.get("sweep") if isinstance(stated, dict) else None
    try:
        return Labels(conditions, row_labels(sweep) if isinstance(sweep, dict) else {})
    except (TypeError, LookupError, ValueError) as error:
        raise damaged(folder / "scenario.yaml", "its sweep has another form") from error


def stated_scenario(folder: Path) -> dict[str, Any]:
    """Read the scenario of a run, every default included; empty where a run has none."""
    stated = _stated(folder)
    if not isinstance(stated, dict):
        raise damaged(folder / "scenario.yaml", "it is no mapping of keys to values")
    return stated


def _stated(folder: Path) -> Any:  # noqa: ANN401 - any JSON
    path = folder / "scenario.yaml"
    return read_yaml(run_file(path)).data if path.exists() else {}


def stated_conditions(folder: Path) -> dict[str, dict[str, Any]]:
    """Read what each condition of a run sets, by its name; empty where a run has no scenario."""
    stated = _stated(folder)
    conditions = stated.get("conditions") if isinstance(stated, dict) else None
    if not isinstance(conditions, dict):
        return {}
    return {name: entries for name, entries in conditions.items() if isinstance(entries, dict)}


def swept_columns(table: pd.DataFrame, *, before: str = "cases") -> list[str]:
    """List the columns that identify a row: the condition and the swept keys."""
    return list(table.columns[: table.columns.get_loc(before)])


def read_pairs(folder: Path, labels: Labels) -> pd.DataFrame:
    """Read the differences of conditions of a run on the same structures; it may have none."""
    words = ["condition", "against", "measure"]
    numbers = ["structures", "difference_mean", "smaller", "wilcoxon_p"]
    path = folder / "paired.csv"
    if not path.exists():
        return pd.DataFrame()
    pairs = read_frame(path, words, gaps=numbers, numbers_after="measure", empty=True)
    pairs = pairs.assign(equal_measurements=pairs.get("equal_measurements", False))
    return labels.put(pairs, before="measure")


def with_points(table: pd.DataFrame, *, before: str = "cases") -> pd.DataFrame:
    """Put a column `point`, empty without a sweep, in the place of the labels of swept keys."""
    swept = [key for key in swept_columns(table, before=before) if key not in NO_KEYS]
    points = joined_words(table, swept)
    table = table.drop(columns=swept)
    table.insert(1, "point", points)
    return table


def joined_words(table: pd.DataFrame, columns: Sequence[str]) -> list[str]:
    """Name each row by the words of some columns, without those that are empty."""
    return [joined(row) for row in table[[*columns]].to_numpy().tolist()]
