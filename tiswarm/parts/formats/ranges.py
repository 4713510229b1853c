"""Reads tables of ranges between tags and beacons, as radios measure them, as a sensing log.

A table has a range a row, `tag,beacon,range`, or the ranges of a tag to all beacons, whose names
the columns have. Tags have no docks and need no compass: one dock at the center, of a radius that
does not matter, and orientations that no measurement uses. Ranges of two tags count, too.

Without a stated standard deviation, repeated readings state it: the median of a pair enters once,
with the scatter of a reading, since readings of a pair share the errors of their line of sight.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.parts.formats.columns import (
    LENGTHS,
    plain_sheet,
    report_incomplete,
    robot_numbers,
    split_unit,
)
from tiswarm.parts.formats.poses import some
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


def read_beacons(path: Path) -> Beacons:
    """Read a table `beacon,x,y,z`, with `sd`, `bias` and `bias_sd` where these are known.

    Raises:
        InputError: the table is malformed, or names a beacon twice.
    """
    table = CsvFile(path, plain_sheet(path).text)
    found = _columns(table, {**_NAMES, "beacon": (*_NAMES["beacon"], "name", "id")})
    if lacking := [name for name in ("beacon", *"xyz") if name not in found]:
        problem = f"the columns are {','.join(table.columns)[:200]}, not beacon,x,y,z; add "
        raise InputError(f"{problem}{','.join(lacking)}", path=path, line=1)
    names = [name.strip() for name in table.words(found["beacon"]).tolist()]
    for row, name in enumerate(names):
        if name in names[:row]:
            problem = f"beacon {name[:40]} has a row already; keep one"
            raise InputError(problem, path=path, line=table.line(row), key=found["beacon"])
    units = {split_unit(found[axis], LENGTHS)[1] for axis in "xyz"}
    if len(units) > 1:
        problem = f"the axes have different units: {', '.join(sorted(units))}; convert them to one"
        raise InputError(problem, path=path, line=1)

    def numbers(name: str) -> Reals:
        return table.numbers(found[name], empty=0.0) if name in found else np.zeros(len(names))

    place = np.column_stack([table.numbers(found[axis]) for axis in "xyz"])
    return Beacons(names, place, numbers("sd"), numbers("bias"), numbers("bias_sd"), units.pop())


def read_ranges(
    path: Path, beacons: Path, *, sd: float | None, radius: float | None, drop_incomplete: bool
) -> tuple[SensingLog, list[str], list[str]]:
    """Turn a table of ranges and one of beacons into a sensing log, with notes and warnings.

    The first robot is the beacon whose place is known best.

    Args:
        path: Table of ranges.
        beacons: Table of beacons.
        sd: Standard deviation of a range where the table has no column of it; None if unknown.
        radius: Radius of the dock of a tag; 1 % of the median range if None.
        drop_incomplete: Whether to drop rows without a range, instead of refusing them.

    Raises:
        InputError: a table is malformed, units differ, or nothing states how exact ranges are.
    """
    known, notes = read_beacons(beacons), list[str]()
    ranges = _read(path, known.name, notes, drop=drop_incomplete)
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
    warnings = list[str]()
    if np.isnan([row[3] for row in rows]).any():
        rows = _pooled(path, rows, notes, warnings)
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


def _columns(table: CsvFile, names: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Find columns by their meaning."""
    bare = {column: split_unit(column, LENGTHS)[0].lower() for column in table.columns}
    found = {}
    for meaning, known in names.items():
        column = next((c for name in known for c in table.columns if bare[c] == name), None)
        if column is not None:
            found[meaning] = column
    return found


def _read(path: Path, beacons: Sequence[str], notes: list[str], *, drop: bool) -> _Ranges:
    """Read a range a row, or those of a tag to all beacons; gaps of the latter are left out."""
    table = CsvFile(path, plain_sheet(path).text)
    found = _columns(table, _NAMES)
    wide = {} if "beacon" in found else _by_beacon(table.columns, beacons)
    wanted = ["tag", *([] if wide else ["beacon", "range"])]
    if lacking := [name for name in wanted if name not in found]:
        problem = f"the columns are {','.join(table.columns)[:200]}, neither tag,beacon,range nor "
        problem += f"tag and names of beacons; rename or add {','.join(lacking)}"
        raise InputError(problem, path=path, line=1)
    values = [*wide] or [found["range"]]
    units = {split_unit(column, LENGTHS)[1] for column in values}
    if len(units) > 1:
        problem = f"ranges have different units: {', '.join(sorted(units))}; convert them to one"
        raise InputError(problem, path=path, line=1)
    if not wide:
        lines = table.incomplete([found[name] for name in wanted])
        notes += report_incomplete(path, lines, drop=drop)
        table.drop(lines)
    tags = [name.strip() for name in table.words(found["tag"]).tolist()]
    ends, length, sd = list[tuple[str, str]](), list[float](), list[float]()
    for column in values:
        lost = {*table.incomplete([column])}
        for line in lost:
            table.rows[line][table.columns.index(column)] = ""
        others = [wide[column]] * len(tags) if wide else table.words(found["beacon"]).tolist()
        ends += [(tag, other.strip()) for tag, other in zip(tags, others, strict=True)]
        length += table.numbers(column, empty=0.0).tolist()
        widths = table.numbers(found["sd"]) if "sd" in found else np.full(len(tags), np.nan)
        sd += widths.tolist()
        for row, width in enumerate(sd[-len(tags) :]):
            if width <= 0.0:
                problem = f"{width:g} is no standard deviation; write a positive one"
                raise InputError(problem, path=path, line=table.line(row), key=found["sd"])
    for row, (tag, other) in enumerate(ends):
        if tag == other:
            problem = f"{tag[:40]!r} has a range to itself; name another robot"
            raise InputError(problem, path=path, line=table.line(row % len(tags)))
    return _Ranges(ends, np.array(length), np.array(sd), units.pop())


def _by_beacon(columns: Sequence[str], beacons: Sequence[str]) -> dict[str, str]:
    """Find columns that are named after beacons, such as `range_A1 [m]`."""
    found = {}
    for column in columns:
        name = re.sub(r"^(?:range|distance|dist|d)[\W_]*|[\W_]*(?:range|distance|dist)$", "",
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
        problem = "nothing states how exact ranges are, and no repeated readings show it; add a "
        raise InputError(f"{problem}column sd, or give --range-sd", path=path, line=1)
    notes.append(
        f"ranges scatter by {width:.2g} (1 sd), in {counted(len(scatter), 'pair')} with repeated "
        "readings: the median of each pair counts once, with that sd"
    )
    if wide := [f"{a} to {b}" for (a, b), each in scatter.items() if each > _MOVED * width]:
        problem = f"readings scatter far more than others: {some(wide)}; robots moved, or paths "
        warnings.append(f"{problem}changed: cut the table to a time of rest")
    return kept + [
        (*pair, float(np.median(each)), max(width, scatter.get(pair, 0.0)))
        for pair, each in pairs.items()
    ]


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
