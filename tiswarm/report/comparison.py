"""Mean RMSE of the conditions of a run, side by side where they can be compared.

A method that is given more measurements errs less, which says nothing of the method. So conditions
stand side by side only if robots sense alike and the methods use the same measurements. One of them
has the smallest error only if it errs less than each other one on each of `FEWEST` structures or
more; with fewer structures there are numbers alone.
"""

import math
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import pandas as pd

from tiswarm.records.messages import counted
from tiswarm.report.run_data import measured_words

FEWEST = 5
"""Structures below which a range says more than a confidence interval or a test, and no error is
called the smallest: without an effect, five differences have one sign in 6 % of studies."""

METHOD = "localization.method"
"""Key of a sweep whose values are compared under each condition."""

MOST_NAMED = 3
"""Conditions of a group that a sentence names, beside those that are the smallest somewhere."""

MOST_TIMES = 10_000
"""Ratio of two errors beyond which the smaller one is exact but for rounding."""

_MOST_GROUPS = 3
_RMSE = "rmse_R_mean"

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
    key = _compared(table)
    points = len(at_points(table, key))
    texts = _apart(found) if _are_apart(found) else [*_by_measurements(found, points)]
    by_condition = swept(table) == ["condition", METHOD]
    return f"{mean_of(rows, points, by_condition=by_condition)}: {'; '.join(texts)}"


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
    names = [name for name in swept(table) if name != key]
    points: dict[str, list[Row]] = {}
    if _RMSE not in table:
        return points
    for row in table[(table["cases"] > 0) & table[_RMSE].notna()].to_dict("records"):
        points.setdefault(_text(row, names), []).append(row)
    return points


def swept(table: pd.DataFrame) -> list[str]:
    """List the columns that identify a row."""
    return [*table.columns[: table.columns.get_loc("cases")]]


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
    return [float(row[_RMSE]) for row in rows]


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


def _are_apart(found: Sequence[Group]) -> bool:
    """Whether there are many conditions, none of them with the measurements of another."""
    return len(found) > _MOST_GROUPS and all(len(group.members) == 1 for group in found)


def _apart(found: Sequence[Group]) -> list[str]:
    """State the errors of conditions whose measurements all differ."""
    names = {name: rows for group in found for name, rows in group.members.items()}
    count = len({*names})
    return [f"{count} conditions, each with other measurements or noise, {_listed(names)}"]


def _by_measurements(found: Sequence[Group], points: int) -> Iterable[str]:
    """State the errors of each of the first groups, and how far those of the others reach."""
    stated: set[str] = set()
    shared = set.intersection(*({*group.measurements.split(", ")} for group in found))
    for group in found[:_MOST_GROUPS]:
        used = measured_words(group.measurements, without=shared & {"non_overlap"})
        again = ", sensed otherwise" if used in stated else ""
        somewhere = f" (at {counted(group.points, 'point')})" if group.points < points else ""
        with_these = f"with {used or 'unknown measurements'}{again}{somewhere}, "
        stated.add(used)
        yield f"{with_these}{_listed(group.members, group)}"
    if rest := found[_MOST_GROUPS:]:
        rows = [row for group in rest for rows in group.members.values() for row in rows]
        count = counted(len({*(name for group in rest for name in group.members)}), "condition")
        errors = range_of(errors_of(rows))
        yield f"with other measurements or noise, {count} of {errors}"


def _listed(members: Mapping[str, Sequence[Row]], group: Group | None = None) -> str:
    """List conditions with their errors: the first ones, and those that are the smallest."""
    wins = group.smallest if group else Counter[str]()
    ordered = sorted(members, key=lambda name: least_error(members[name]))
    named = [name for n, name in enumerate(ordered) if n < MOST_NAMED or wins[name]]
    least = least_error(members[ordered[0]])
    notes = {}
    for name in named:
        if wins[name]:
            points = group.points if group else 0
            where = f" at {wins[name]} of {points} points" if points > 1 else ""
            notes[name] = f" (the smallest on every structure{where})"
        elif group and group.points == 1 and name != ordered[0]:
            notes[name] = _times(least_error(members[name]), least)
    rest = [name for name in ordered if name not in named]
    return list_errors(members, named, rest, notes)


def _times(error: float, least: float) -> str:
    """Write how many times as large an error is, roughly; empty where it is about as large."""
    ratio = error / least if least else math.inf
    if ratio < 1.05:  # noqa: PLR2004 - would be rounded to 1
        return ""
    if ratio > MOST_TIMES:
        return f" (more than {MOST_TIMES:,} times)"
    digits = 1 if 2.0 <= ratio < 9.5 else 2  # noqa: PLR2004 - one digit says enough there
    return f" (about {float(f'{ratio:.{digits}g}'):.6g} times)"


_Pair = tuple[str, str, str]
"""Point, condition, and the condition that is its reference."""


def _differences(pairs: pd.DataFrame) -> dict[_Pair, Row]:
    """List the differences in RMSE, by what they compare."""
    if pairs.empty:
        return {}
    rows: list[Row] = pairs[pairs["measure"] == "rmse_R"].to_dict("records")
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
    if after is not None:  # runs of older versions do not count the larger ones
        return bool(FEWEST <= after["structures"] == after.get("larger"))
    # Methods that are swept have ranges only, and structures that differ cannot be paired.
    is_enough = min(one["cases"], other["cases"]) >= FEWEST
    return METHOD in one and is_enough and bool(one["rmse_R_most"] < other["rmse_R_least"])


def _measurements(row: Row) -> str:
    """Return the measurements of a row; empty where unknown."""
    used = row.get("measurements")
    return used if isinstance(used, str) else ""


def _compared(table: pd.DataFrame) -> str:
    return METHOD if METHOD in swept(table) else "condition"


def _text(row: Row, names: Any) -> str:  # noqa: ANN401 - any collection of column names
    return ", ".join(f"{name}={row[name]}" for name in names)
