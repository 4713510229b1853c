"""Names of series: a point of the sweep, a condition, and the measurements that it uses.

Tables, figures, captions and sentences call a series by the name that it has here. Where conditions
of a run differ in their measurements, the name of each has those that distinguish it, so that no
reader compares unlike ones unawares.
"""

from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from typing import TypeVar

import pandas as pd

from tiswarm.base.registry import get
from tiswarm.base.registry import names as registered_names
from tiswarm.measurements.cues import CUES, WALKED, Cue

SEPARATOR = " / "
"""What stands between the parts of a name.

Commas separate names: in tables of files, in sentences and in the options of commands.
"""

_FINAL = "contacts"
"""Cue of contacts at the end."""

_MOST_LISTED = 3
"""Most measurements in which conditions differ that names list; of more, they say what is missing
where that is shorter."""

_Key = TypeVar("_Key", bound=Hashable)


def series_names(
    conditions: Mapping[_Key, str], measured: Mapping[_Key, Collection[str]]
) -> dict[_Key, str]:
    """Name the conditions of one run or several, with the measurements in which they differ.

    Args:
        conditions: Labels by condition.
        measured: Cues that each condition uses, by condition; empty if it measured nothing.

    >>> used = {"joint": ["contacts", "walk_contacts"], "paper": ["contacts"]}
    >>> series_names({"joint": "joint", "paper": "Algorithm 1"}, used)
    {'joint': 'joint / walk contacts', 'paper': 'Algorithm 1 / final contacts'}
    >>> used = {"walks": ["contacts", "ground", "walk_contacts"], "joint": ["contacts"]}
    >>> series_names({"walks": "joint / walk contacts", "joint": "joint"}, used)["walks"]
    'joint / walk contacts and ground contacts'
    """
    used = {name: set(cues) for name, cues in measured.items() if cues}
    shared = set.intersection(*used.values()) if used else set()
    varied = set().union(*used.values()) - shared
    names: dict[_Key, str] = {}
    for name, label in conditions.items():
        words = _distinction(used[name], varied) if varied and name in used else ""
        is_said = not words or label.endswith(words)
        short = label if is_said else joined([_without_words(label, varied), words])
        names[name] = joined([label, words]) if short in names.values() else short
    return names


def joined(parts: Iterable[str]) -> str:
    """Join the parts of a name, such as a point and a condition, without those that are empty."""
    return SEPARATOR.join(filter(None, parts))


def _without_words(label: str, varied: Collection[str]) -> str:
    """Take from the end of a label a measurement that varies, since all of them follow it."""
    method, _, last = label.rpartition(SEPARATOR)
    return method if method and last in _in_words(varied) else label


def measured_cues(table: pd.DataFrame) -> dict[str, set[str]]:
    """List the cues that each condition of `summary.csv` or `table.csv` uses at any point."""
    measured: dict[str, set[str]] = {name: set() for name in table["condition"].dropna()}
    if "measurements" in table:
        used = table.dropna(subset=["condition", "measurements"])
        for name, cues in zip(used["condition"], used["measurements"], strict=True):
            measured[name] |= {*split_cues(str(cues))}
    return measured


def _distinction(cues: Collection[str], varied: Collection[str]) -> str:
    """Say which of the measurements that vary a condition uses, or which it lacks."""
    present = [cue for cue in varied if cue in cues]
    absent = [cue for cue in varied if cue not in cues]
    if not present:
        words = ["final contacts"] if WALKED in absent and _FINAL in cues else []
        lacking = [cue for cue in absent if not words or cue != WALKED]
        if len(lacking) > _MOST_LISTED:
            words.append("fewest measurements")
        elif lacking:
            words.append(f"without {_all_of(lacking)}")
        return joined(words)
    if not absent and len(varied) > _MOST_LISTED:
        return "all measurements"
    is_short = len(varied) <= _MOST_LISTED or len(present) < len(absent)
    return _all_of(present) if is_short else f"without {_all_of(absent)}"


_METHODS = {"virtual-force": "Algorithm 1"}
"""Methods that have another name in the paper."""


def way_words(way: str) -> str:
    """Write in words how robots localize, as `suites.csv` has it.

    >>> way_words("virtual-force"), way_words("hop-by-hop"), way_words("joint / touch")
    ('Algorithm 1', 'hop by hop', 'joint / touch')
    """
    return joined(_METHODS.get(part, part.replace("-", " ")) for part in way.split(SEPARATOR))


def suite_words(name: str) -> str:
    """Write the name of a sensor suite as that of its system; of an unknown one as it is."""
    suite = get("sensor", name) if name in registered_names("sensor") else None
    return getattr(suite, "title", "") or name


def measured_words(cues: str) -> str:
    """Write cues, as tables list them, in words.

    >>> measured_words("contacts, height, walk_contacts")
    'final contacts, walk contacts and heights'
    """
    *first, last = _in_words(split_cues(cues)) or [""]
    return f"{', '.join(first)} and {last}" if first else last


def split_cues(names: str) -> list[str]:
    """Split the list of cues of a table."""
    return [name for name in names.split(", ") if name]


def _all_of(names: Collection[str]) -> str:
    """List the words of cues without a comma, which names do not have."""
    return " and ".join(_in_words(names))


def _in_words(names: Collection[str]) -> Sequence[str]:
    """Return the words of cues in the order of sentences; an unknown one is its own word."""
    cue_by_name = {cue.name: cue for cue in CUES}
    cues = [cue_by_name.get(name, Cue(name=name)) for name in names]
    cues.sort(key=lambda cue: (cue.said, cue.name))
    return [cue.words or cue.name.replace("_", " ") for cue in cues]
