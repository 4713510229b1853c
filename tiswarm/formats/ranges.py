"""Reads tables of ranges between tags and beacons, as radios measure them, as a sensing log.

A table has a range a row, `tag,beacon,range`, or the ranges of a tag to all beacons, whose names
the columns have. Tags have no docks and need no compass: one dock at the center, of a radius that
does not matter, and orientations that no measurement uses. Ranges of two tags count, too.

Without a stated standard deviation, repeated readings state it: the median of a pair enters once,
with the scatter of a reading, since readings of a pair share the errors of their line of sight.
"""

import re
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.formats.columns import (
    LENGTHS,
    plain_sheet,
    refuse_other_files,
    report_incomplete,
    robot_numbers,
    split_unit,
)
from tiswarm.formats.poses import some
from tiswarm.records.io import CsvFile
from tiswarm.records.messages import counted
from tiswarm.records.sensing_log import KNOWN_SD, SensingLog, SensingNoise

_NAMES: Mapping[str, Sequence[str]] = {
    "tag": ("tag", "tag_id", "robot", "robot_id", "node", "from", "initiator", "mobile", "id"),
    "beacon": ("beacon", "beacon_id", "anchor", "anchor_id", "other", "to", "responder", "peer"),
    "range": ("range", "distance", "dist", "d", "tof_range"),
    "sd": ("sd", "std", "stdev", "sigma"),
    "bias": ("bias", "offset"),
    "bias_sd": ("bias_sd", "bias_std", "shared_sd"),
    **{axis: (axis, f"pos_{axis}", f"position.{axis}") for axis in "xyz"},
}
"""Names of columns by their meaning, in lower case and without a unit."""

_MAD = 1.4826
"""Standard deviation of a normal distribution in median deviations."""

_FEWEST = 3
"""Readings of a pair from which on they state a scatter."""

_MOVED = 5.0
"""Scatter of a pair, in that of most pairs, from which on its robots moved or paths changed."""

_DRIFT = 2.0
"""Scatter of readings of a pair, in that of one from the next, from which on its robots moved."""

_FEWEST_IN_ORDER = 8
"""Readings of a pair from which on their order shows that."""

_SCALES = {"mm": 1e-3, "cm": 1e-2, "dm": 0.1, "ft": 0.3048, "in": 0.0254}
"""Units that are taken for m, with their lengths [m]; a range may be in either."""

_SLACK = 5.0
"""Standard deviations by which lengths of a triangle may miss each other."""

_FEW = 0.1
"""Share of triangles that may be impossible, by outliers."""

_MOST = 1 / 3
"""Share of them from which on another unit is looked for."""

_MOST_OF_A_TAG = 30
"""Ranges of a tag whose triangles are looked at."""

_RADIUS = 0.01
"""Radius of the dock at the center of a tag, in the median of ranges."""


class Beacons(NamedTuple):
    """N beacons at known places, by name."""

    name: list[str]
    place: Reals  # (N, 3)
    sd: Reals  # of each coordinate; 0 where none is stated, (N,)
    bias: Reals  # what its ranges are too long by, (N,)
    bias_sd: Reals  # of what all its ranges are too long by beside it; 0 where none is, (N,)
    unit: str


class _Ranges(NamedTuple):
    """Ranges, a row each."""

    ends: list[tuple[str, str]]
    length: Reals
    sd: Reals  # NaN where none is stated
    unit: str


def read_beacons(path: Path, columns: Mapping[str, str]) -> Beacons:
    """Read a table `beacon,x,y,z`, with `sd`, `bias` and `bias_sd` where these are known.

    Args:
        path: The table.
        columns: Names of its columns, by their meaning, where others are not the usual ones.

    Raises:
        InputError: the table is malformed, or names a beacon twice.
    """
    refuse_other_files(path)
    table = CsvFile(path, plain_sheet(path).text)
    found = _columns(table, {**_NAMES, "beacon": (*_NAMES["beacon"], "name", "id")}, columns)
    if lacking := [name for name in ("beacon", *"xyz") if name not in found]:
        problem = f"the columns are {','.join(table.columns)[:200]}, not beacon,x,y,z; add "
        problem += f"{','.join(lacking)}, or name columns as by --column {lacking[0]}=NAME"
        raise InputError(problem, path=path, line=1)
    names = [name.strip() for name in table.words(found["beacon"]).tolist()]
    for row, name in enumerate(names):
        if name in names[:row]:
            problem = f"beacon {name[:40]} has a row already; keep one"
            raise InputError(problem, path=path, line=table.line(row), key=found["beacon"])
    units = {split_unit(found[axis], LENGTHS)[1] for axis in "xyz"}
    if len(units) > 1:
        problem = f"the axes have different units: {', '.join(sorted(units))}; convert them to one"
        raise InputError(problem, path=path, line=1)
    _refuse_other_units(path, found, ("bias", "sd", "bias_sd"), next(iter(units)))

    def numbers(name: str) -> Reals:
        return table.numbers(found[name], empty=0.0) if name in found else np.zeros(len(names))

    place = np.column_stack([table.numbers(found[axis]) for axis in "xyz"])
    return Beacons(names, place, numbers("sd"), numbers("bias"), numbers("bias_sd"), units.pop())


def read_ranges(
    path: Path,
    beacons: Path,
    *,
    columns: Mapping[str, str],
    sd: float | None,
    radius: float | None,
    drop_incomplete: bool,
) -> tuple[SensingLog, list[str], list[str]]:
    """Turn a table of ranges and one of beacons into a sensing log, with notes and warnings.

    The first robot is the beacon whose place is known best.

    Args:
        path: Table of ranges.
        beacons: Table of beacons.
        columns: Names of columns of both tables, by their meaning, that are not the usual ones.
        sd: Standard deviation of a range where the table has no column of it; None if unknown.
        radius: Radius of the dock of a tag; 1 % of the median range if None.
        drop_incomplete: Whether to drop rows without a range, instead of refusing them.

    Raises:
        InputError: a table is malformed, units differ, or nothing states how exact ranges are.
    """
    if unknown := [name for name in columns if name not in _NAMES]:
        problem = f"{unknown[0]!r} is no quantity of ranges; use {', '.join(_NAMES)}"
        raise InputError(problem, argument="column")
    known, notes = read_beacons(beacons, columns), list[str]()
    ranges = _read(path, known.name, columns, notes, drop=drop_incomplete)
    if ranges.unit != known.unit and "" not in {ranges.unit, known.unit}:
        problem = f"ranges are in {ranges.unit}, beacons in {known.unit}; convert them to one unit"
        raise InputError(problem, path=path, line=1)
    place = {name: row for row, name in enumerate(known.name)}
    bias = dict(zip(known.name, known.bias.tolist(), strict=True))
    length = ranges.length - [bias.get(a, 0.0) + bias.get(b, 0.0) for a, b in ranges.ends]
    stated = ranges.sd if sd is None else np.where(np.isnan(ranges.sd), sd, ranges.sd)
    rows = [
        (a, b, float(value), float(width))
        for (a, b), value, width in zip(ranges.ends, length, stated, strict=True)
        if value > 0.0 and not (a in place and b in place)
    ]
    if lost := len(length) - len(rows):
        notes.append(f"{counted(lost, 'range')} left out: empty, 0, or between two beacons")
    if not rows:
        raise InputError("there are no ranges of tags; add some", path=path, line=2)
    warnings = _strangers(path, known.name, rows)
    if np.isnan([row[3] for row in rows]).any():
        rows = _pooled(path, rows, notes, warnings)
    warnings += _impossible(known, rows)
    size = radius or float(f"{_RADIUS * np.median([row[2] for row in rows]):.1g}")
    return _log(known, rows, size, ranges.unit or known.unit, notes), notes, warnings


def _log(
    known: Beacons, rows: Sequence["_Row"], radius: float, unit: str, notes: list[str]
) -> SensingLog:
    """Log beacons, the best known first, then tags; note who has which number."""
    place = {name: row for row, name in enumerate(known.name)}
    tags = sorted({name for a, b, *_ in rows for name in (a, b)} - {*place}, key=_natural)
    first = int(known.sd.argmin())
    names = [known.name[first], *(n for n in known.name if n != known.name[first]), *tags]
    numbers, renamed = _numbers(names, len(place))
    notes += renamed
    notes.append(
        f"{len(place)} beacons, {counted(len(tags), 'tag')}, {counted(len(rows), 'range')}"
    )
    row_of = {name: row for row, name in enumerate(names)}
    source = [k for k, name in enumerate(names) if name in place and known.bias_sd[place[name]] > 0]
    entries = []
    for a, b, value, width in rows:
        later, earlier = sorted((row_of[a], row_of[b]), reverse=True)
        shared = source.index(earlier) if earlier in source else -1
        entries.append((later, earlier, value, width, shared))
    fixes = [
        (row_of[name], *axis, along, known.sd[k] or KNOWN_SD * radius, -1)
        for name, k in place.items()
        if k != first
        for axis, along in zip(np.eye(3), known.place[k], strict=True)
    ]
    count = len(names)
    return SensingLog(
        robot_id=np.array(numbers, np.int64),
        dock_radius=radius,
        dock_offset_body=np.zeros((1, 3)),
        anchor_position=known.place[first],
        orientation_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        contacts=np.empty((0, 4), np.int32),
        fixes=np.array(sorted(fixes)).reshape(-1, 7),
        ranges=np.array(sorted(entries), np.float64).reshape(-1, 5),
        flip_height=np.full(count, np.nan),
        spawn_position=np.full((count, 3), np.nan),
        noise=SensingNoise(tilt_deg=0.0, yaw_deg=0.0),
        source_name=tuple(f"beacon {names[k]}"[:40] for k in source),
        source_sd=np.array([known.bias_sd[place[names[k]]] for k in source], np.float64),
        length_unit=unit or "unit",
    )


def _strangers(path: Path, beacons: Sequence[str], rows: Sequence["_Row"]) -> list[str]:
    """Warn of beacons without ranges beside names that no table has as beacons or tags.

    Raises:
        InputError: no range is to a beacon.
    """
    named = {name for a, b, *_ in rows for name in (a, b)}
    strangers = sorted({b for _, b, *_ in rows} - {a for a, *_ in rows} - {*beacons}, key=_natural)
    silent = [name for name in beacons if name not in named]
    if len(silent) == len(beacons):
        problem = f"no range is to a beacon: ranges have {some(strangers or sorted(named))}, "
        raise InputError(f"{problem}beacons are {some(beacons)}; write them alike", path=path)
    problem = f"ranges are to names without a place, which are located as tags: {some(strangers)}; "
    return [f"{problem}add their places if they are beacons"] if strangers else []


def _impossible(known: Beacons, rows: Sequence["_Row"]) -> list[str]:
    """Warn where ranges of a tag to two beacons are no triangle with the distance of these."""
    place = dict(zip(known.name, known.place, strict=True))
    by_tag: dict[str, list[tuple[Reals, float, float]]] = {}
    for a, b, value, width in rows:
        for tag, beacon in ((a, b), (b, a)):
            if beacon in place and tag not in place:
                by_tag.setdefault(tag, []).append((place[beacon], value, width))
    apart, first, second, slack = list[float](), list[float](), list[float](), list[float]()
    for seen in by_tag.values():
        for one, other in combinations(seen[:_MOST_OF_A_TAG], 2):
            apart.append(float(np.linalg.norm(one[0] - other[0])))
            first.append(one[1])
            second.append(other[1])
            slack.append(_SLACK * float(np.hypot(one[2], other[2])))
    sides = np.array([apart, first, second])
    number = _not_triangles(sides, np.array(slack), 1.0)
    if number <= _FEW * len(apart):
        return []
    problem = f"{number} of {len(apart)} triangles of a tag and two beacons cannot be"
    for unit, length in _SCALES.items() if number > _MOST * len(apart) else ():
        for scale, fit in (
            (length, f"{unit} and beacons in m"),
            (1 / length, f"m and beacons in {unit}"),
        ):
            if _not_triangles(sides, np.array(slack), scale) <= _FEW * len(apart):
                return [f"{problem}; with ranges in {fit} they can: convert them to one unit"]
    return [f"{problem}: correct places or names of beacons, or give their bias"]


def _not_triangles(sides: Reals, slack: Reals, scale: float) -> int:
    """Count triangles that cannot be, with ranges in another unit."""
    apart, first, second = sides[0], scale * sides[1], scale * sides[2]
    off = np.maximum(np.abs(first - second) - apart, apart - first - second)
    return int((off > scale * slack).sum())


def _refuse_other_units(
    path: Path, found: Mapping[str, str], names: Sequence[str], unit: str
) -> None:
    """Refuse columns of lengths in another unit than those beside them; some may have none."""
    for name in names:
        other = split_unit(found[name], LENGTHS)[1] if name in found else ""
        if other and other.lower() != unit.lower():
            problem = f"this column is in {other}, others in {unit or 'none'}; convert them to one"
            raise InputError(f"{problem} unit", path=path, line=1, key=found[name])


def _columns(
    table: CsvFile, names: Mapping[str, Sequence[str]], given: Mapping[str, str]
) -> dict[str, str]:
    """Find columns by their meaning, those first whose names are given."""
    bare = {column: split_unit(column, LENGTHS)[0].lower() for column in table.columns}
    found = {meaning: column for meaning, column in given.items() if column in bare}
    for meaning, known in names.items():
        if meaning in found:
            continue
        column = next((c for name in known for c in table.columns if bare[c] == name), None)
        if column is not None:
            found[meaning] = column
    return found


def _read(
    path: Path,
    beacons: Sequence[str],
    columns: Mapping[str, str],
    notes: list[str],
    *,
    drop: bool,
) -> _Ranges:
    """Read a range a row, or those of a tag to all beacons; gaps of the latter are left out.

    Ranges to all beacons are of one tag if no column names tags.
    """
    refuse_other_files(path)
    table = CsvFile(path, plain_sheet(path).text)
    found = _columns(table, _NAMES, columns)
    wide = {} if "beacon" in found else _by_beacon(table.columns, beacons)
    wanted = [] if wide else ["tag", "beacon", "range"]
    if lacking := [name for name in wanted if name not in found]:
        problem = f"the columns are {','.join(table.columns)[:200]}, neither tag,beacon,range nor "
        problem += f"tag and names of beacons; rename or add {','.join(lacking)}, or name columns "
        raise InputError(f"{problem}as by --column {lacking[0]}=NAME", path=path, line=1)
    values = [*wide] or [found["range"]]
    units = {split_unit(column, LENGTHS)[1] for column in values}
    if len(units) > 1:
        problem = f"ranges have different units: {', '.join(sorted(units))}; convert them to one"
        raise InputError(problem, path=path, line=1)
    if not wide:
        lines = table.incomplete([found[name] for name in wanted])
        notes += report_incomplete(path, lines, drop=drop)
        table.drop(lines)
    _refuse_other_units(path, found, ("sd",), next(iter(units)))
    tags = ["tag"] * len(table.rows)
    if "tag" in found:
        tags = [name.strip() for name in table.words(found["tag"]).tolist()]
    ends, length, sd = list[tuple[str, str]](), list[float](), list[float]()
    for column in values:
        lost = {*table.incomplete([column])}
        for line in lost:
            table.rows[line][table.columns.index(column)] = ""
        others = [wide[column]] * len(tags) if wide else table.words(found["beacon"]).tolist()
        ends += [(tag, other.strip()) for tag, other in zip(tags, others, strict=True)]
        length += table.numbers(column, empty=0.0).tolist()
        sd += _deviations(table, found.get("sd"))
    for row, (tag, other) in enumerate(ends):
        if tag == other:
            problem = f"{tag[:40]!r} has a range to itself; name another robot, or give tags and "
            problem += "beacons different names, such as T1 and A1"
            raise InputError(problem, path=path, line=table.line(row % len(tags)))
    return _Ranges(ends, np.array(length), np.array(sd), units.pop())


def _deviations(table: CsvFile, column: str | None) -> list[float]:
    """Read positive standard deviations; NaN without a column."""
    if column is None:
        return [np.nan] * len(table.rows)
    widths: list[float] = table.numbers(column).tolist()
    for row, width in enumerate(widths):
        if width <= 0.0:
            problem = f"{width:g} is no standard deviation; write a positive one"
            raise InputError(problem, path=table.path, line=table.line(row), key=column)
    return widths


def _by_beacon(columns: Sequence[str], beacons: Sequence[str]) -> dict[str, str]:
    """Find columns that are named after beacons, such as `range_A1 [m]`."""
    found = {}
    for column in columns:
        name = re.sub(r"^(?:range|distance|dist|d)[\W_]*|[\W_]{0,8}(?:range|distance|dist)$", "",
                      split_unit(column, LENGTHS)[0], flags=re.IGNORECASE)  # fmt: skip
        if name in beacons:
            found[column] = name
    return found


_Row = tuple[str, str, float, float]


def _pooled(path: Path, rows: Sequence[_Row], notes: list[str], warnings: list[str]) -> list[_Row]:
    """Replace readings without a standard deviation by the median of each pair, with a scatter."""
    pairs: dict[tuple[str, str], list[float]] = {}
    kept = [row for row in rows if not np.isnan(row[3])]
    for a, b, value, width in rows:
        if np.isnan(width):
            pairs.setdefault((a, b) if _natural(a) < _natural(b) else (b, a), []).append(value)
    scatter = {
        pair: _MAD * float(np.median(np.abs(np.array(each) - np.median(each))))
        for pair, each in pairs.items()
        if len(each) >= _FEWEST
    }
    width = float(np.median([*scatter.values()])) if scatter else 0.0
    if not width:
        shown = "repeated readings are equal" if scatter else "no repeated readings show it"
        problem = f"nothing states how exact ranges are, and {shown}; add a "
        raise InputError(f"{problem}column sd, or give --range-sd", path=path, line=1)
    notes.append(
        f"ranges scatter by {width:.2g} (1 sd), in {counted(len(scatter), 'pair')} with repeated "
        "readings: the median of each pair counts once, with that sd"
    )
    if wide := [f"{a} to {b}" for (a, b), each in scatter.items() if each > _MOVED * width]:
        problem = f"readings scatter far more than others: {some(wide)}; robots moved, or paths "
        warnings.append(f"{problem}changed: cut the table to a time of rest")
    if _drift(pairs) > _DRIFT:
        problem = "readings of a pair follow each other closely, and drift: robots moved; "
        warnings.append(f"{problem}cut the table to a time of rest")
    return kept + [
        (*pair, float(np.median(each)), max(width, scatter.get(pair, 0.0)))
        for pair, each in pairs.items()
    ]


def _drift(pairs: Mapping[tuple[str, str], Sequence[float]]) -> float:
    """Compare the scatter of readings with that of each from the next; the median of pairs.

    It is 1 for readings with errors of their own; 0 where there are too few, or equal ones.
    """
    ratios = [0.0]
    for each in pairs.values():
        steps = np.abs(np.diff(each))
        if len(each) >= _FEWEST_IN_ORDER and (step := float(np.median(steps))) > 0.0:
            off = np.abs(np.array(each) - np.median(each))
            ratios.append(float(np.median(off)) * np.sqrt(2.0) / step)
    return float(np.median(ratios[1:] or ratios))


def _natural(name: str) -> tuple[int, str]:
    """Sort names by the first number in them."""
    found = re.search(r"\d+", name)
    return (int(found[0]) if found else 0, name)


def _numbers(names: Sequence[str], beacons: int) -> tuple[list[int], list[str]]:
    """Give each robot a number: that in its name, where no other robot has the same."""
    numbers, _ = robot_numbers(names)
    if all(str(number) in name for number, name in zip(numbers, names, strict=True)):
        return numbers, []
    tags, _ = robot_numbers(names[beacons:])
    after = [max(tags, default=-1) + 1 + k for k in range(beacons)]
    listed = [f"{name} is {k}" for name, k in zip(names, [*after, *tags], strict=True)]
    return [*after, *tags], [f"robots are numbered: {some(listed)}"]
