"""Which condition of a run has the least error, among those that can be compared.

A method that is given more measurements errs less, which says nothing of the method. So conditions
are compared only if robots sense alike and the methods use the same measurements, and one beats
another only if it has the smaller error on every structure.
"""

import math
from collections import Counter
from collections.abc import Hashable, Iterator
from typing import Any, NamedTuple

import pandas as pd

from tiswarm.records.messages import counted

METHOD = "localization.method"
"""Key of a sweep whose values are compared under each condition."""

MOST_NAMED = 3
"""Conditions that a sentence compares with the best one."""

_Row = dict[Hashable, Any]


class Contest(NamedTuple):
    """A row of `table.csv` with the least RMSE of those that use its measurements."""

    best: _Row
    beaten: list[_Row]
    """Rows with a greater error on every structure, the least first."""


def conclusion(table: pd.DataFrame, pairs: pd.DataFrame) -> str:
    """Name the condition with the least error; empty where none can be compared.

    Args:
        table: Rows of `table.csv`, a row for each condition and point of the sweep.
        pairs: Rows of `paired.csv`; empty if there are none.
    """
    key, found = _compared(table), list(_contests(table, pairs))
    if not found:
        return ""
    same = "With the same measurements"
    if len(_points(table, key)) == 1:
        return f"{same}, {'; '.join(_in_words(contest, key) for contest in found)}"
    where = ("under", "condition") if _names(table) == ["condition", METHOD] else ("at", "point")
    (first, most), *others = Counter(str(best[key]) for best, _ in found).most_common()
    of_all = counted(len(found), where[1])
    texts = [f"{first} has the smallest RMSE {where[0]} {most} of {of_all}"]
    texts += [f"{name} {where[0]} {count}" for name, count in others]
    return f"{same}, {', '.join(texts)}"


def _in_words(contest: Contest, key: str) -> str:
    error = contest.best["rmse_R_mean"]
    texts = []
    for row in contest.beaten[:MOST_NAMED]:
        times = row["rmse_R_mean"] / error if error else math.inf
        digits = f"{times:.3g}" if times < 1000.0 else f"{times:.0f}"  # noqa: PLR2004 - no exponent
        texts.append(f"that of {row[key]} is {f'{digits} times as large' if error else 'larger'}")
    return f"{contest.best[key]} has the smallest RMSE, {error:.3g} R; {', '.join(texts)}"


def _contests(table: pd.DataFrame, pairs: pd.DataFrame) -> Iterator[Contest]:
    """Compare the rows of each point, if there are several that can be compared."""
    key = _compared(table)
    differences = _differences(pairs) if key == "condition" else {}
    if key == "condition" and not differences:
        return  # conditions grew structures of their own
    for rows in _points(table, key).values():
        waiting = sorted(rows, key=lambda row: row["rmse_R_mean"])
        while waiting:
            best = waiting.pop(0)
            rivals = [row for row in waiting if _is_equal(best, row, differences)]
            beaten = [row for row in rivals if _is_beaten(best, row, differences)]
            if beaten:
                yield Contest(best, beaten)
            waiting = [row for row in waiting if row not in rivals]


_Pair = tuple[str, str, str]
"""Point, condition, and the condition that is its reference."""


def _differences(pairs: pd.DataFrame) -> dict[_Pair, _Row]:
    """List the differences in RMSE, by what they compare."""
    if pairs.empty:
        return {}
    rows: list[_Row] = pairs[pairs["measure"] == "rmse_R"].to_dict("records")
    names = pairs.columns[2 : pairs.columns.get_loc("measure")]
    return {(_text(row, names), str(row["condition"]), str(row["against"])): row for row in rows}


def _pair(best: _Row, row: _Row) -> tuple[_Pair, _Pair]:
    """Return the keys under which the difference of two conditions may stand."""
    names = [*best][: [*best].index("cases")]
    point = _text(best, [name for name in names if name != "condition"])
    one, other = str(best["condition"]), str(row["condition"])
    return (point, one, other), (point, other, one)


def _is_equal(best: _Row, row: _Row, differences: dict[_Pair, _Row]) -> bool:
    """Whether two rows use the same measurements, of robots that sense alike."""
    if not differences:
        used = best.get("measurements")
        return isinstance(used, str) and used == row["measurements"]
    found = [differences[key] for key in _pair(best, row) if key in differences]
    return any(each["equal_measurements"] == 1 for each in found)


def _is_beaten(best: _Row, row: _Row, differences: dict[_Pair, _Row]) -> bool:
    """Whether the error of a row is greater on every structure."""
    if not differences:  # methods that are swept have ranges only
        return bool(best["rmse_R_most"] < row["rmse_R_least"])
    is_before, is_after = (differences.get(key) for key in _pair(best, row))
    if is_before is not None:
        return bool(0 < is_before["structures"] == is_before["smaller"])
    return is_after is not None and bool(is_after["structures"] > is_after["smaller"] == 0)


def _points(table: pd.DataFrame, key: str) -> dict[str, list[_Row]]:
    """List the rows with results, by what they share but for the compared key."""
    names = [name for name in _names(table) if name != key]
    points: dict[str, list[_Row]] = {}
    for row in table[table["cases"] > 0].to_dict("records"):
        points.setdefault(_text(row, names), []).append(row)
    return points


def _names(table: pd.DataFrame) -> list[str]:
    """List the columns that identify a row."""
    return [*table.columns[: table.columns.get_loc("cases")]]


def _compared(table: pd.DataFrame) -> str:
    return METHOD if METHOD in _names(table) else "condition"


def _text(row: _Row, names: Any) -> str:  # noqa: ANN401 - any collection of column names
    return ", ".join(f"{name}={row[name]}" for name in names)
