"""Answers to questions of scenarios, from the tables of a run; empty where they have no answer.

To add a question, write a function, and add its line to BUILT_IN of `tiswarm/base/registry.py`.
Which conditions have the least errors, `tiswarm.report.answers` says.
"""

import math
from collections.abc import Mapping, Sequence

import pandas as pd

from tiswarm.records.measures import BUILT_FOR, CROSSED, FEWEST, RMSE, SENT, Measure
from tiswarm.records.messages import counted
from tiswarm.report import answers, run_data
from tiswarm.report.answers import METHOD, Results, Row

BUDGET_B = 1_000
"""Bytes that a robot may send, in the mean over robots and structures."""

_MOST_NAMED = 6
_MOST_PARTS = 3


def reached(results: Results) -> str:
    """State what structures reached: heights, reaches and depths, and bridges closed."""
    points = answers.at_points(results.table)
    rows = [row for of_point in points.values() for row in of_point]
    texts = [_reached_at(of_point, _point_words(of_point[0])) for of_point in points.values()]
    if not any(texts):
        return ""
    head, errors = f"Means of {answers.structures_of(rows)}: ", _errors(rows)
    full = head + "; ".join(filter(None, texts)) + errors
    if len(full) <= answers.MOST_LETTERS:
        return full
    parts = (f"{part}{_by_kind(of_part)}" for part, of_part in _parts(rows).items())
    return head + "; ".join(parts) + errors


def _errors(rows: Sequence[Row]) -> str:
    """State the mean RMSE of each condition, or of all where they are many."""
    names = [*dict.fromkeys(row["condition"] for row in rows)]
    names = names if 1 < len(names) <= _MOST_PARTS else [""]
    of_names = ([row for row in rows if row["condition"] == name or not name] for name in names)
    spans = (answers.range_of(answers.errors_of(of_name)) for of_name in of_names)
    texts = (f"{name} {span}".strip() for name, span in zip(names, spans, strict=True))
    return f"; RMSE {', '.join(texts)}"


def _parts(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Divide rows by the last of several swept keys, if that has few values."""
    *_, last = names = _swept(rows[0]) or [""]
    values = dict.fromkeys(row.get(last) for row in rows)
    if len(names) < 2 or len(values) > _MOST_PARTS:  # noqa: PLR2004 - a key beside the last
        return {"": [*rows]}
    return {f"{value}: ": [row for row in rows if row[last] == value] for value in values}


def _by_kind(rows: Sequence[Row]) -> str:
    """State what structures reached, by their kinds."""
    kinds = dict.fromkeys(row.get("kind") for row in rows)
    texts = [_reached_by([row for row in rows if row.get("kind") == kind]) for kind in kinds]
    return ", ".join(filter(None, texts))


def _reached_at(rows: Sequence[Row], place: str) -> str:
    """State what structures of a point reached, once where all conditions have the same."""
    what, values = _reaches(rows)
    if not what:
        return ""
    by_name = [f"{value} ({row['condition']})" for row, value in zip(rows, values, strict=True)]
    shown = by_name if len({*values}) > 1 else values[:1]
    return f"{f'{place}: ' if place else ''}{what} {', '.join(shown)}"


def _reached_by(rows: Sequence[Row]) -> str:
    """State what structures of a kind reached at many points."""
    measure = _built_for(rows)
    if measure is None:
        return ""
    if measure is CROSSED:
        closed = sum(float(row[measure.mean]) for row in rows) / len(rows)
        return f"bridges closed {100.0 * closed:.0f} %"  # conditions may share structures
    reached = answers.range_of(float(row[measure.mean]) for row in rows)
    return f"{measure.label.lower()} of {rows[0]['kind']}s {reached}"


def _reaches(rows: Sequence[Row]) -> tuple[str, list[str]]:
    """Return what structures of a kind are built for, and what those of each row reached."""
    measure = _built_for(rows)
    if measure is None:
        return "", []
    means = [float(row[measure.mean]) for row in rows]
    if measure is CROSSED:
        built = [row["cases"] for row in rows]
        closed = [f"{round(m * n)} of {n:.0f}" for m, n in zip(means, built, strict=True)]
        return "bridges closed", closed
    return measure.label.lower(), [f"{answers.two_digits(mean)} R" for mean in means]


def _built_for(rows: Sequence[Row]) -> Measure | None:
    """Return the measure of what structures of a kind are built for; None if a row lacks it."""
    measure = BUILT_FOR.get(str(rows[0].get("kind")))
    known = measure and all(row.get(measure.mean, math.nan) >= 0.0 for row in rows)
    return measure if known else None


def _point_words(row: Row) -> str:
    """Name a point of the sweep by the labels of its values."""
    return ", ".join(str(row[name]) for name in _swept(row) if row[name])


def _swept(row: Row) -> list[str]:
    """List the swept keys of a row."""
    names = [*map(str, row)]
    return names[names.index("condition") + 1 : names.index("cases")]


def traffic(results: Results) -> str:
    """State the errors of methods whose robots send little, and the least ones of all others."""
    if METHOD in run_data.swept_columns(results.table):
        return ""  # one condition has methods of all kinds
    rows = _by_condition(results.table)
    sent = {
        name: [float(row.get(SENT.mean, math.nan)) for row in each] for name, each in rows.items()
    }
    if not any(max(of_name) >= 0.0 for of_name in sent.values()):
        return ""
    limit = f"{BUDGET_B / 1e3:.0f} kB each"
    kinds: dict[str, dict[str, list[Row]]] = {
        f"of those whose robots send at most {limit}": {},
        "of those that send more": {},
        "with the log of all robots in one place": {},
    }
    few, many, alone = kinds.values()
    for name, of_name in sent.items():
        most = max(of_name)
        (alone if math.isnan(most) else few if most <= BUDGET_B else many)[name] = rows[name]
    notes = {
        name: f" at {answers.range_of((count / 1e3 for count in of_name), ' kB')}"
        for name, of_name in sent.items()
        if name not in alone
    }
    first = [] if few else [f"no condition's robots send at most {limit}"]

    def write(most: int) -> str:
        texts = [
            f"{kind}, {_list_conditions(each, notes, most=most)}"
            for kind, each in kinds.items()
            if each
        ]
        return f"{_head(results.table)}: {'; '.join([*first, *texts])}"

    text = answers.fitted(write, _MOST_NAMED)
    if len(text) <= answers.MOST_LETTERS:
        return text
    where = (f"robots send at most {limit}", "more", "one place has all logs")
    best = [
        f"{place}, {min(each, key=lambda name: answers.least_error(each[name]))}"
        f" {answers.range_of(min(map(answers.errors_of, each.values()), key=min))}"
        for place, each in zip(where, kinds.values(), strict=True)
        if each
    ]
    return f"{_head(results.table)}, least where {'; '.join(best)}"


def cues(results: Results) -> str:
    """State errors by condition beside the first one, and whether the order is the paper's."""
    table, rows = results.table, _by_condition(results.table)
    if len(rows) < 2:  # noqa: PLR2004 - nothing was left out
        return ""
    first = next(iter(rows))
    notes = {name: _changes(rows[first], each) for name, each in rows.items() if name != first}
    ordered = sorted(rows, key=lambda name: sum(answers.errors_of(rows[name])) / len(rows[name]))
    head, order = _head(table), _paper_order(table)
    return answers.fitted(
        lambda most: f"{head}: {_list_conditions(rows, notes, ordered, most=most)}{order}",
        _MOST_NAMED,
    )


def _changes(first: Sequence[Row], rows: Sequence[Row]) -> str:
    """Write by how much errors differ from those of the first condition, point by point."""
    of_first = {_point_words(row): float(row[RMSE.mean]) for row in first}
    found = [
        100.0 * (float(row[RMSE.mean]) / base - 1.0)
        for row in rows
        if (base := of_first.get(_point_words(row), 0.0))
    ]
    if not found:
        return ""
    least, most = (f"{round(pick(found)):+d}" for pick in (min, max))
    return f" ({least if least == most else f'{least} to {most}'} %)"


def _paper_order(table: pd.DataFrame) -> str:
    """Count the points where conditions have the paper's order; empty of few structures."""
    if RMSE.published not in table or table["cases"].min() < FEWEST:
        return ""
    points = [
        [row[RMSE.published] for row in sorted(rows, key=lambda row: float(row[RMSE.mean]))]
        for rows in answers.at_points(table[table[RMSE.published].notna()]).values()
    ]
    points = [published for published in points if len({*published}) > 1]
    if not points:
        return ""
    alike = sum(published == sorted(published) for published in points)
    return f"; in the paper's order at {alike} of {counted(len(points), 'point')}"


def scaling(results: Results) -> str:
    """State errors and exponents of RMSE and CPU time against the number of robots N."""
    table = results.scaling
    if table.empty or "robots" not in table:  # threads, workers or movers
        return ""
    table = table[table["mean"].notna()]
    rmse, time = (table[table["measure"] == name] for name in (RMSE.column, "localize_cpu_s"))
    sizes = rmse["robots"]
    if not rmse["exponent"].notna().any():  # of fewer than three sizes
        return ""
    errors = {str(name): rows for name, rows in rmse.groupby("series", sort=False)}
    ordered = sorted(errors, key=lambda name: float(errors[name]["mean"].min()))
    of_rmse = [f"{name} {_from_to(errors[name])}{_power(errors[name])}" for name in ordered]
    times = {str(name): rows for name, rows in time.groupby("series", sort=False)}
    of_time = [f"{name}{_power(times[name])}" for name in ordered if name in times]
    seeds = answers.structures_of(results.table.to_dict("records"))
    text = f"From {sizes.min():,.0f} to {sizes.max():,.0f} robots, {seeds} each, RMSE of "
    text += ", ".join(of_rmse)
    return f"{text}; CPU time of localization of {', '.join(of_time)}" if of_time else text


def _from_to(rows: pd.DataFrame) -> str:
    """Write the RMSE of the smallest structures, and of the largest."""
    first, *_, last = map(answers.two_digits, rows.sort_values("robots")["mean"])
    return f"{first} to {last} R"


def _power(rows: pd.DataFrame) -> str:
    """Write the exponent of a measure against N; empty where there is none."""
    exponent = float(rows["exponent"].iloc[0])
    return "" if math.isnan(exponent) else f" as N^{exponent:.2f}"


def _by_condition(table: pd.DataFrame) -> dict[str, list[Row]]:
    """List the rows of each condition."""
    found: dict[str, list[Row]] = {}
    for rows in answers.at_points(table).values():
        for row in rows:
            found.setdefault(str(row["condition"]), []).append(row)
    return found


def _head(table: pd.DataFrame) -> str:
    """State what the numbers of a sentence are means of."""
    return answers.mean_of(table.to_dict("records"), len(answers.at_points(table)))


def _list_conditions(
    rows: Mapping[str, Sequence[Row]],
    notes: Mapping[str, str],
    ordered: Sequence[str] = (),
    *,
    most: int,
) -> str:
    """List some conditions with notes: the first ones, by least error, and that with the least."""
    by_least = sorted(rows, key=lambda name: answers.least_error(rows[name]))
    ordered = ordered or by_least
    named = [name for n, name in enumerate(ordered) if n < most or name == by_least[0]]
    rest = [name for name in ordered if name not in named]
    return answers.list_errors(rows, named, rest, notes)
