"""Labels of the rows of a sweep: what pages, figures and sentences call its points."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from tiswarm.records.run_folder import LABEL, cell_of

_SIGNS = re.compile(r"[^\w. -]+")

BASELINE = "baseline"
"""Name of the condition of a scenario that states none."""

SELECTORS = ("kind", "method", "suite")
"""Last words of the keys that select which settings a section has; labels begin with theirs."""

SYMBOLS = {"force_threshold": "F", "recruit_base": "B", "recruit_limit": "J"}
"""Symbols of settings that have one, by the last word of the key."""

LENGTHS = {
    "anchor",
    "beam_radius",
    "cell",
    "contact_band",
    "contact_gap",
    "contact_sd",
    "cutoff",
    "edge_radius",
    "end_sigma",
    "fix_bias",
    "fix_noise",
    "gap",
    "goal_beyond",
    "goal_depth",
    "goal_height",
    "goal_reach",
    "height",
    "height_sd",
    "initial_offset",
    "jitter",
    "max_step",
    "pitch",
    "radius",
    "range_bias",
    "range_noise",
    "range_reach",
    "resolution",
    "revisit_distance",
    "rho",
    "scale",
    "settled_below",
    "spawn_max",
    "spawn_min",
    "spawn_noise",
    "spawn_sd",
    "spawn_width",
    "start_sigma",
    "stop_error",
}
"""Last words of keys whose values are lengths [R]."""


def swept_keys(entry: str) -> list[str]:
    """Return the keys of an entry of the sweep: one, or several that change together."""
    return [key.strip() for key in entry.split(",")]


def labels_of(value: object) -> list[Any]:
    """List the labels that a row of a sweep has: those of the mappings in it."""
    cells = value if isinstance(value, (list, tuple)) else [value]
    return [cell[LABEL] for cell in cells if isinstance(cell, dict) and LABEL in cell]


def without_label(value: Any) -> Any:  # noqa: ANN401 - any JSON
    """Return a swept value without its label."""
    if not isinstance(value, dict):
        return value
    return {key: setting for key, setting in value.items() if key != LABEL}


def row_labels(sweep: Mapping[str, Sequence[Any]]) -> dict[str, dict[str, str]]:
    """Label the rows of each entry of a valid sweep, by its first key and their cells in tables.

    A row of mappings may have a `label`. Others have one made of the values in which the rows
    differ, with their units: `gap 20 R`. An entry with one row has none: all points share it.
    """
    labels_by_key = {}
    for entry, rows in sweep.items():
        key, *followers = swept_keys(entry)
        cells = [row if followers else [row] for row in rows]
        values = [without_label(row[0]) for row in cells]
        if len(values) == 1:
            labels_by_key[key] = {cell_of(values[0]): ""}
            continue
        stated = [next(map(str, labels_of(row)), "") for row in cells]
        made = _made(key, values)
        labels = [label or text for label, text in zip(stated, made, strict=True)]
        labels_by_key[key] = dict(zip(map(cell_of, values), _distinct(labels), strict=True))
    return labels_by_key


def _made(key: str, values: Sequence[Any]) -> list[str]:
    """Write the values in which rows differ: as few of them as keep all rows apart."""
    rows = [dict(_flat(key, value)) for value in values]
    keys = list(dict.fromkeys(name for row in rows for name in row))
    keys.sort(key=lambda name: name.rpartition(".")[2] not in SELECTORS)
    kept: list[str] = []
    for name in keys:
        if _kinds(rows, [*kept, name]) > _kinds(rows, kept):
            kept.append(name)
    return [" ".join(words_of(name, row[name]) for name in kept if name in row) for row in rows]


def _flat(key: str, value: object) -> Iterator[tuple[str, object]]:
    """Yield the values of nested mappings by dotted key."""
    if isinstance(value, Mapping) and value:
        for name, nested in value.items():
            yield from _flat(f"{key}.{name}", nested)
    else:
        yield key, value


def _kinds(rows: Sequence[Mapping[str, Any]], keys: Sequence[str]) -> int:
    """Count the rows that differ in some keys."""
    return len({tuple(cell_of(row[key]) if key in row else None for key in keys) for row in rows})


def words_of(key: str, value: object) -> str:
    """Write a value of a setting with the last word of its key or its symbol, and its unit.

    >>> words_of("structure.gap", 20.0), words_of("structure.kind", "tower"), words_of("robots", 60)
    ('gap 20 R', 'tower', '60 robots')
    >>> words_of("structure.force_threshold", 3.5), words_of("sensing.tilt_noise_deg", 2.0)
    ('F 3.5', 'tilt noise 2 deg')
    >>> words_of("structure.navigate_by", "truth"), words_of("sensing.stances", False)
    ('by truth', 'without stances')
    """
    name = key.rpartition(".")[2]
    words = name.removesuffix("_deg").replace("_", " ")
    if isinstance(value, bool):
        return f"{'with' if value else 'without'} {words}"
    if value is None:
        return f"no {words}"
    if isinstance(value, str):
        return f"by {value}" if words.endswith(" by") else value
    if isinstance(value, (int, float)) and key == "robots":
        return f"{value:,.12g} robots"
    if isinstance(value, (int, float)):
        unit = " deg" if name.endswith("_deg") else ""
        if name in LENGTHS:
            unit = " R"
        return f"{SYMBOLS.get(name, words)} {value:.12g}{unit}"
    return f"{words} {_SIGNS.sub(' ', cell_of(value)).strip()}"


def _distinct(labels: Sequence[str]) -> list[str]:
    """Number labels that occur again."""
    return [
        f"{label} ({labels[: n + 1].count(label)})" if labels.count(label) > 1 else label
        for n, label in enumerate(labels)
    ]
