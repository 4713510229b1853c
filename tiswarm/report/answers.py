"""The results of a run in words: a line for each row of `table.csv`, and the answer.

What answers questions of scenarios beyond the least error is a part, `tiswarm/report/questions.py`.

A method that is given more measurements errs less, which says nothing of the method. So conditions
stand side by side only if robots sense alike and the methods use the same measurements. One of them
has the smallest error only if it errs less than each other one on each of `FEWEST` structures or
more; with fewer structures there are numbers alone.
"""

import math
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from tiswarm.base.errors import InputError
from tiswarm.base.registry import BUILT_IN, get
from tiswarm.records.frames import read_frame
from tiswarm.records.measures import (
    CONSISTENT,
    CONVERGED,
    DISCONNECTED,
    DISPARITY,
    FEWEST,
    JOINED,
    RMSE,
)
from tiswarm.records.messages import counted
from tiswarm.records.run_folder import TABLE_NOTES
from tiswarm.report import run_data
from tiswarm.report.run_data import swept_columns

METHOD = "localization.method"
"""Key of a sweep whose values are compared under each condition."""

MOST_NAMED = 3
"""Conditions of a group that a sentence names, beside those that are the smallest somewhere."""

MOST_LETTERS = 215
"""Letters of an answer."""

_TWO_LINES = 230
"""Letters of two lines on a page."""

_MOST_GROUPS = 3

_FEW = 4
"""Conditions that a sentence names all where there is no sweep."""

Row = dict[Hashable, Any]
"""A row of `table.csv`."""


class Group(NamedTuple):
    """Conditions with equal measurements, at the points of a sweep where they have these."""

    measurements: str  # cues, as tables list them; empty where unknown
    members: Mapping[str, Sequence[Row]]  # rows of each condition
    smallest: Counter[str]  # points at which a condition has the smallest error

    @property
    def points(self) -> int:
        """Points of the sweep."""
        return max(map(len, self.members.values()))

    @property
    def least(self) -> float:
        """Least mean RMSE [R]."""
        return min(map(least_error, self.members.values()))


def conclusion(table: pd.DataFrame, pairs: pd.DataFrame) -> str:
    """State mean RMSE by groups of conditions that can be compared; empty without any RMSE.

    The least mean RMSE of all rows comes first.

    Args:
        table: Rows of `table.csv`, a row for each condition and point of the sweep.
        pairs: Rows of `paired.csv`; empty if there are none.
    """
    found = groups(table, pairs)
    if not found:
        return ""
    rows = [row for group in found for rows in group.members.values() for row in rows]
    points = len(at_points(table, _compared(table)))
    are_apart = len(found) > _MOST_GROUPS and all(len(group.members) == 1 for group in found)
    texts = [_apart(found)] if are_apart else [*_by_measurements(found, points)]
    first, *more = texts
    by_condition = swept_columns(table) == ["condition", METHOD]
    head = mean_of(rows, points, by_condition=by_condition)
    return ". ".join([f"{head}: {first}", *(text[:1].upper() + text[1:] for text in more)])


def _brief(table: pd.DataFrame, *, is_small: bool) -> str:
    """State mean RMSE: of all of a few conditions, else of the best, and the range of the rest."""
    key = _compared(table)
    points = at_points(table, key)
    every = [row for rows in points.values() for row in rows]
    rows: dict[str, list[Row]] = {}
    for row in every:
        rows.setdefault(str(row[key]), []).append(row)
    ordered = sorted(rows, key=lambda name: least_error(rows[name]))
    head = mean_of(every, len(points), by_condition=swept_columns(table) == ["condition", METHOD])
    differ = len({_measurements(row) for row in every}) > 1
    note = "; measurements differ" if differ else ""

    def write(most: int) -> str:
        return f"{head}: {list_errors(rows, ordered[:most], ordered[most:], {})}{note}"

    return write(_FEW) if is_small else fitted(write)


def fitted(write: Callable[[int], str], most: int = MOST_NAMED) -> str:
    """Write a sentence with at most so many names, or with fewer if it is too long."""
    texts = [write(count) for count in range(most, 0, -1)]
    return next((text for text in texts if len(text) <= MOST_LETTERS), texts[-1])


def groups(table: pd.DataFrame, pairs: pd.DataFrame) -> list[Group]:
    """List the groups of equal measurements: that with the least error, then the largest ones."""
    key = _compared(table)
    differences = _differences(pairs) if key == "condition" else {}
    members: dict[tuple[str, frozenset[str]], dict[str, list[Row]]] = {}
    smallest: dict[tuple[str, frozenset[str]], Counter[str]] = {}
    for rows in at_points(table, key).values():
        for alike in _alike(rows, differences):
            names = [str(row[key]) for row in alike]
            group = _measurements(alike[0]), frozenset(names)
            for name, row in zip(names, alike, strict=True):
                members.setdefault(group, {}).setdefault(name, []).append(row)
            won = [
                name
                for name, row in zip(names, alike, strict=True)
                if len(alike) > 1
                and all(_is_smaller(row, other, differences) for other in alike if other is not row)
            ]
            smallest.setdefault(group, Counter()).update(won)
    found = [
        Group(key[0], dict(sorted(each.items(), key=lambda m: least_error(m[1]))), smallest[key])
        for key, each in members.items()
    ]
    found.sort(key=lambda group: group.least)
    return [*found[:1], *sorted(found[1:], key=lambda group: len(group.members) == 1)]


def at_points(table: pd.DataFrame, key: str = "condition") -> dict[str, list[Row]]:
    """List the rows with an RMSE by the point of the sweep, in words, without the compared key."""
    names = [name for name in swept_columns(table) if name != key]
    points: dict[str, list[Row]] = {}
    if RMSE.mean not in table:
        return points
    for row in table[(table["cases"] > 0) & table[RMSE.mean].notna()].to_dict("records"):
        points.setdefault(_text(row, names), []).append(row)
    return points


def least_error(rows: Iterable[Row]) -> float:
    """Return the least mean RMSE of some rows [R]."""
    return min(errors_of(rows))


def range_of(values: Iterable[float], unit: str = " R") -> str:
    """Write the least and the greatest of some numbers, or the one that they are."""
    found = [*values]
    least, most = two_digits(min(found)), two_digits(max(found))
    return f"{least}{unit}" if least == most else f"{least} to {most}{unit}"


def two_digits(number: float) -> str:
    """Write a number with two significant digits, or without decimals.

    >>> two_digits(0.7), two_digits(3.66), two_digits(123.4)
    ('0.70', '3.7', '123')
    """
    if abs(number) >= 10.0:  # noqa: PLR2004 - two digits before the point
        return f"{number:.0f}"
    return f"{number:#.2g}".rstrip(".") if number else "0"


def structures_of(rows: Sequence[Row]) -> str:
    """Count the structures behind each of some rows."""
    least, most = (int(pick(row["cases"] for row in rows)) for pick in (min, max))
    return counted(most, "structure") if least == most else f"{least} to {most} structures"


def mean_of(rows: Sequence[Row], points: int, *, by_condition: bool = False) -> str:
    """State what the numbers of a sentence are means of; points of a sweep may be conditions."""
    each = f"under each of {points} conditions" if by_condition else f"at each of {points} points"
    is_single = max(row["cases"] for row in rows) == 1
    text = f"{'RMSE' if is_single else 'Mean RMSE'} of {structures_of(rows)}"
    return f"{text} {each}" if points > 1 else text


def errors_of(rows: Iterable[Row]) -> list[float]:
    """List the mean RMSE of rows [R]."""
    return [float(row[RMSE.mean]) for row in rows]


def list_errors(
    rows: Mapping[str, Sequence[Row]],
    named: Sequence[str],
    rest: Sequence[str],
    notes: Mapping[str, str],
) -> str:
    """List the errors of some conditions with notes, and how far those of the rest reach."""
    texts = [f"{name} {range_of(errors_of(rows[name]))}{notes.get(name, '')}" for name in named]
    if rest:
        most = max(error for name in rest for error in errors_of(rows[name]))
        texts.append(f"and {len(rest)} more up to {two_digits(most)} R")
    return ", ".join(texts)


def _apart(found: Sequence[Group]) -> str:
    """State the errors of conditions whose measurements all differ."""
    rows = {name: rows for group in found for name, rows in group.members.items()}
    ordered = sorted(rows, key=lambda name: least_error(rows[name]))
    most = _FEW if len(rows) <= _FEW else MOST_NAMED
    listed = list_errors(rows, ordered[:most], ordered[most:], {})
    return f"{len(rows)} conditions, each with other measurements or noise, {listed}"


def _by_measurements(found: Sequence[Group], points: int) -> Iterable[str]:
    """State the errors of each of the first groups, and how far those of the others reach."""
    if len(found) == 1:
        yield _compare(found[0]) + " (same measurements)" * (len(found[0].members) > 1)
        return
    stated: set[str] = set()
    first, *_ = known = [{*group.measurements.split(", ")} for group in found]
    hidden = set.intersection(*known) & {"non_overlap"}
    for group, cues in zip(found[:_MOST_GROUPS], known, strict=False):
        used = run_data.measured_words(group.measurements, without=hidden)
        again = ", sensed otherwise" if used in stated else ""
        stated.add(used)
        these = f"with {used or 'unknown measurements'}{again}"
        if used and cues < first:  # the first sentence has all of its measurements
            lost = run_data.measured_words(", ".join(first - cues))
            these = min(these, f"without {lost}", key=len)
        somewhere = f" (at {counted(group.points, 'point')})" if group.points < points else ""
        yield f"{these}{somewhere}, {_compare(group)}"
    if rest := found[_MOST_GROUPS:]:
        rows = [row for group in rest for rows in group.members.values() for row in rows]
        count = counted(len({*(name for group in rest for name in group.members)}), "condition")
        errors = range_of(errors_of(rows))
        yield f"with other measurements or noise, {count} of {errors}"


def _compare(group: Group) -> str:
    """State which condition of a group is best, and the errors of all or of the first ones.

    Conditions beyond the first ones are named where they are best.
    """
    first, *others = group.members
    count = _FEW if len(group.members) <= _FEW else MOST_NAMED
    named = [name for n, name in enumerate(others, 1) if n < count or group.smallest[name]]
    texts = [_with_rank(group, name) for name in named]
    if rest := [name for name in others if name not in named]:
        most = max(error for name in rest for error in errors_of(group.members[name]))
        texts.append(f"and {len(rest)} more up to {two_digits(most)} R")
    best = _with_rank(group, first)
    return f"{best}; {', '.join(texts)}" if texts else best


def _with_rank(group: Group, name: str) -> str:
    """State the error of a condition, and where it is best."""
    points, won = group.points, group.smallest[name]
    errors = range_of(errors_of(group.members[name]))
    where = f" at {won} of {points} points" if points > 1 else ""
    return f"{name} is best{where}, {errors}" if won else f"{name} {errors}"


_Pair = tuple[str, str, str]
"""Point, condition, and the condition that is its reference."""


def _differences(pairs: pd.DataFrame) -> dict[_Pair, Row]:
    """List the differences in RMSE, by what they compare."""
    if pairs.empty:
        return {}
    rows: list[Row] = pairs[pairs["measure"] == RMSE.column].to_dict("records")
    names = pairs.columns[2 : pairs.columns.get_loc("measure")]
    return {(_text(row, names), str(row["condition"]), str(row["against"])): row for row in rows}


def _pair(one: Row, other: Row) -> tuple[_Pair, _Pair]:
    """Return the keys under which the difference of two conditions may stand."""
    names = [*one][: [*one].index("cases")]
    point = _text(one, [name for name in names if name != "condition"])
    first, second = str(one["condition"]), str(other["condition"])
    return (point, first, second), (point, second, first)


def _alike(rows: Sequence[Row], differences: Mapping[_Pair, Row]) -> list[list[Row]]:
    """Divide the rows of a point into those with equal measurements."""
    found: list[list[Row]] = []
    for row in rows:
        same = next((each for each in found if _is_equal(each[0], row, differences)), None)
        if same is None:
            found.append([row])
        else:
            same.append(row)
    return found


def _is_equal(one: Row, other: Row, differences: Mapping[_Pair, Row]) -> bool:
    """Whether two rows use the same measurements, of robots that sense alike."""
    found = [differences[key] for key in _pair(one, other) if key in differences]
    if found:
        return any(each["equal_measurements"] == 1 for each in found)
    used = _measurements(one)  # methods that are swept, or structures that differ
    return bool(used) and used == _measurements(other)


def _is_smaller(one: Row, other: Row, differences: Mapping[_Pair, Row]) -> bool:
    """Whether the error of a row is smaller than another's on each of enough structures."""
    before, after = (differences.get(key) for key in _pair(one, other))
    if before is not None:
        return bool(FEWEST <= before["structures"] == before["smaller"])
    if after is not None:
        return bool(FEWEST <= after["structures"] == after["larger"])
    # Methods that are swept have ranges only, and structures that differ cannot be paired.
    is_enough = min(one["cases"], other["cases"]) >= FEWEST
    return METHOD in one and is_enough and bool(one[RMSE.most] < other[RMSE.least])


def _measurements(row: Row) -> str:
    """Return the measurements of a row; empty where unknown."""
    used = row.get("measurements")
    return used if isinstance(used, str) else ""


def _compared(table: pd.DataFrame) -> str:
    return METHOD if METHOD in swept_columns(table) else "condition"


def _text(row: Row, names: Any) -> str:  # noqa: ANN401 - any collection of column names
    return ", ".join(f"{name}={row[name]}" for name in names)


class Results(NamedTuple):
    """Tables of a run; all but the first may be empty."""

    table: pd.DataFrame  # rows of `table.csv` with finished cases
    pairs: pd.DataFrame  # `paired.csv`
    scaling: pd.DataFrame  # `scaling.csv`


def answer(question: str, results: Results) -> str:
    """Answer a question in a sentence; empty without any RMSE.

    Where the results do not have what a question asks about, or this copy lacks what answers it,
    they answer `least-error`.
    """
    kind = "question"
    can_answer = question in BUILT_IN[kind]
    text = get(kind, question)(results) if can_answer else ""
    return text or mean_errors(results)


def mean_errors(results: Results) -> str:
    """State mean RMSE by groups of conditions with equal measurements, or in brief."""
    table, text = results.table, conclusion(results.table, results.pairs)
    is_small = len(table) <= _FEW and swept_columns(table) == ["condition"]
    most = _TWO_LINES if is_small else MOST_LETTERS
    return text if len(text) <= most else _brief(table, is_small=is_small)


_NEEDED = [RMSE.mean, RMSE.ci95, RMSE.least, RMSE.most, DISPARITY.mean]

_MEANINGS = {
    "RMSE": "(R: radius of a dock; disparity: squared error over squared extent of the shape)",
    "not converged": "(not converged: the search settled on no one best fit; errors may be large)",
    "not consistent": "(not consistent: measurements disagree by more than their stated noise)",
    "disconnected": "(disconnected: no measurement ties the robot to the anchor)",
}
"""What a word of an answer means, by the word."""


def headline(folder: Path) -> str:
    """Write the results of a run: units, a line for each row of its table, then the answer."""
    path = folder / "table.csv"
    if not path.exists():
        raise InputError("has no table.csv; give a folder that `tiswarm run` made", path=folder)
    table = read_frame(
        path, ["condition"], ["cases"], gaps=_NEEDED, notes=TABLE_NOTES, numbers_after="cases"
    )
    labels = run_data.read_labels(folder)
    table = labels.put(table, before="cases")
    last = result_of(folder, table, labels) if len(table) > 1 else ""
    rows = [*map(_in_words, table.to_dict("records"))]
    meanings = [text for word, text in _MEANINGS.items() if any(word in row for row in rows)]
    return "\n".join([*meanings, *rows, *([last] if last else [])])


def read_pairs(folder: Path, labels: run_data.Labels) -> pd.DataFrame:
    """Read the differences of conditions of a run on the same structures; it may have none."""
    words = ["condition", "against", "measure"]
    numbers = ["structures", "difference_mean", "smaller", "wilcoxon_p"]
    path = folder / "paired.csv"
    if not path.exists():
        return pd.DataFrame()
    pairs = read_frame(path, words, gaps=numbers, numbers_after="measure", empty=True)
    pairs = pairs.assign(equal_measurements=pairs.get("equal_measurements", False))
    return labels.put(pairs, before="measure")


def read_scaling(folder: Path, labels: run_data.Labels) -> pd.DataFrame:
    """Read the errors and costs of a run by the number of robots; it may have none."""
    path = folder / "scaling.csv"
    if not path.exists():
        return pd.DataFrame()
    words = ["series", "measure"]
    read = read_frame(path, words, numbers_after="measure", empty=True)
    return labels.put(read)


def result_of(folder: Path, table: pd.DataFrame, labels: run_data.Labels) -> str:
    """Answer the question of a run in one sentence; empty where the table lacks its measures.

    Args:
        folder: Folder of the run.
        table: Its `table.csv`, with labels.
        labels: The labels.
    """
    rows = table[table["cases"] > 0]
    if rows.empty:
        return "No case was finished."
    if not set(_NEEDED) <= set(rows):
        return ""
    pairs, scaling = read_pairs(folder, labels), read_scaling(folder, labels)
    question = run_data.stated_scenario(folder).get("question")
    text = answer(str(question), Results(rows, pairs, scaling)) if len(rows) > 1 else ""
    text = text or "; ".join(map(_in_words, rows.to_dict("records")))
    more = _disconnected_somewhere(rows) if "RMSE" in text else ""
    return f"{text}{more if len(text + more) <= _TWO_LINES else ''}."  # warnings have it, too


def _disconnected_somewhere(rows: pd.DataFrame) -> str:
    """State in how many rows structures have disconnected robots; empty if in none or in one."""
    many = int((rows[DISCONNECTED.mean] > 0.0).sum()) if DISCONNECTED.mean in rows else 0
    if not many or len(rows) == 1:
        return ""
    return f"; robots are disconnected in {many} of {len(rows)} rows"


def _in_words(row: Row) -> str:
    names = [*row]
    keys = [*names[names.index("condition") + 1 : names.index("cases")], "condition"]
    name = ", ".join(str(row[key]) for key in keys if row[key])
    if not row["cases"]:
        return f"{name}: no case was finished"
    text = (
        f"{name}: RMSE {_spread(row)}, disparity {row[DISPARITY.mean]:.3g}, "
        f"{counted(row['cases'], 'structure')}"
    )
    doubtful = []
    for measure in (CONVERGED, CONSISTENT):
        share = row.get(measure.mean, math.nan)
        if lost := 0 if math.isnan(share) else round(row["cases"] * (1.0 - share)):
            doubtful.append(f"{lost} of them not {measure.column}")
    return ", ".join([text, *doubtful]) + _disconnected(row)


def _disconnected(row: Row) -> str:
    """State how many robots no measurement ties to the anchor; empty if there are none."""
    lost = row.get(DISCONNECTED.mean, math.nan)
    if math.isnan(lost) or not lost:
        return ""
    mean = " on average" if row["cases"] > 1 else ""
    joined = row.get(JOINED.mean, math.nan)
    of_all = "" if math.isnan(joined) else f" of {joined:.3g}"
    return f", {lost:.3g}{of_all} robots disconnected{mean}"


def _spread(row: Row) -> str:
    """Write an RMSE with its range, or its confidence interval where that says more."""
    mean, half = row[RMSE.mean], row[RMSE.ci95]
    if row["cases"] >= FEWEST:
        return f"{mean:.3g} R (95 % CI {mean - half:.3g} to {mean + half:.3g})"
    least, most = row[RMSE.least], row[RMSE.most]
    return f"{mean:.3g} R" + (f" ({least:.3g} to {most:.3g})" if row["cases"] > 1 else "")
