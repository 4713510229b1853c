"""Mistakes in scenarios and logs, what a log leaves unknown, and estimates in words."""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tiswarm.errors import InputError
from tiswarm.measurements.advice import IMAGES_APART, advise
from tiswarm.measurements.consistency import HEADER_LINES, contradictions
from tiswarm.measurements.contacts import contact_count
from tiswarm.measurements.cues import cue_names
from tiswarm.measurements.observability import by_cue, common_modes
from tiswarm.measurements.units import COLUMNS, Slip, slips
from tiswarm.records.estimate import Estimate, Observability
from tiswarm.records.messages import counted
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_log import SensingLog
from tiswarm.verdicts import MOST_SHOWN, cautions, describe_outliers, distrust, named

_MARGIN = 20
"""Robots in a row that a spawn position may be beyond all others."""

_SPARSE = 1000
"""Robots in a row that a range, or a coordinate of a robot without contacts, may be long."""


_USUAL = (10.0, 25.4, 100.0, 1000.0)
"""Factors between units of length."""

_NEAR = (0.9, 3.5)
"""The true factor is as many times the one found, which follows from bounds, about."""


class Inspection(NamedTuple):
    """All mistakes of a scenario, or the first of a log; the summary of a file without mistakes."""

    mistakes: Sequence[InputError] = ()
    summary: str = ""


class Findings(NamedTuple):
    """An estimate in words."""

    warnings: Sequence[str]
    """What makes it doubtful."""

    notes: Sequence[str]
    """What the log leaves open, and what the method found."""

    advice: Sequence[Mapping[str, str]]
    """Further measurements that would help, as `advice_rows`."""


_LACKING = (
    "a table of positions contains neither the solutions nor the outliers that the method found; "
    "without a table, tiswarm view localizes the log and shows both"
)


def inspect(path: Path) -> Inspection:
    """Inspect a scenario, or a sensing log if the name ends in .jsonl, .jsonl.zst or .mcap."""
    is_log = path.name.endswith((".jsonl", ".jsonl.zst", ".mcap"))
    return _inspect_log(path) if is_log else _inspect_scenario(path)


def explain_estimate(log: SensingLog, path: Path, estimate: Estimate) -> Findings:
    """Explain an estimate; one that was read from a table has no cues."""
    known, warning = estimate.observability, distrust(log, estimate)
    warnings = [*([warning] if warning else []), *cautions(log, estimate)]
    if known is not None and known.cues:
        cues: Collection[str] = known.cues
        notes = [*describe_estimate(log, path, estimate)]
    else:
        cues, notes = cue_names(), [*unknowns(log, path, by_cue(log)), _LACKING]
    return Findings(warnings, notes, advice_rows(log, cues, estimate))


def describe_estimate(log: SensingLog, path: Path, estimate: Estimate) -> Iterator[str]:
    """Describe in lines what the log leaves unknown, and the outliers."""
    yield from unknowns(log, path, filter(None, [estimate.observability]))
    if estimate.located is not None and (left := np.flatnonzero(~estimate.located)).size:
        yield f"not located by those before them (positions are guesses): {named(log, left)}"
    yield from describe_outliers(log, path, estimate)


def unknowns(log: SensingLog, path: Path, found: Iterable[Observability]) -> Iterator[str]:
    """Describe in lines what a log leaves unknown, and contacts that contradict each other.

    `found` is what cues determine, all that are in use last.
    """
    found = list(found)
    if found and (lost := np.flatnonzero(found[-1].disconnected)).size:
        yield f"disconnected from the anchor (positions are guesses): {named(log, lost)}"
    if (single := np.flatnonzero(contact_count(log)[1:] == 1) + 1).size:
        yield f"one contact only: {named(log, single)}"
    gauge_yaw_sd = None
    for known in found:
        yield _left_open(log, known)
        gauge_yaw_sd = known.gauge_yaw_sd if known.yaw_unknown else gauge_yaw_sd
    if gauge_yaw_sd is not None:
        fixed = f"the mean compass fixes it to {math.degrees(gauge_yaw_sd):.2g} deg (1 sd)"
        yield f"global yaw is unobservable; {fixed}"
    impossible = contradictions(log)
    for line, problem in impossible[:MOST_SHOWN]:
        yield f"{path}:{line}: contacts: {problem}"
    if (more := len(impossible) - MOST_SHOWN) > 0:
        yield f"{path}: contacts: {counted(more, 'more such contradiction')}"


def advice_rows(log: SensingLog, cues: Collection[str], estimate: Estimate) -> list[dict[str, str]]:
    """Tabulate which further measurements would constrain robots most: cells by heading.

    Where robots are mirrored, the two likeliest solutions of the estimate count; a table that was
    read from a file has none. No row if nothing helps, or if there are too many robots or loops.
    """
    name, unit = log.robot_id.tolist(), log.length_unit
    is_mirrored = estimate.mirrored is not None and estimate.mirrored.any()
    images = estimate.solutions if is_mirrored else ()
    rows = []
    for rank, found in enumerate(advise(log, cues, estimate.position, images) or [], start=1):
        what = f"{found.kind} of robot {name[found.robot]}"
        if found.kind == "range":
            what = f"{what} to robot {name[found.contact[1]]}"
        elif found.contact:
            own, other, dock = found.contact
            what = f"{what}'s dock {own} with robot {name[other]}'s dock {dock}"
        gains = {
            IMAGES_APART: found.images_apart_sd,
            f"expected RMSE [{unit}]": found.rmse_before,
            f"with it [{unit}]": found.rmse_after,
        }
        rows.append(
            {
                "rank": str(rank),
                "further measurement": what,
                "floppy modes removed": str(found.floppy_modes),
                "robots determined": named(log, found.determined, most=3),
            }
            | {key: f"{value:.3g}" for key, value in gains.items() if not math.isnan(value)}
        )
    return rows


def describe_advice(rows: Sequence[Mapping[str, str]]) -> Iterator[str]:
    """Align the columns of `advice_rows`, in lines."""
    if not rows:
        nothing = "no further contact, height or position would help"
        yield f"{nothing}, or there are too many robots or loops"
        return
    columns = [[heading, *(row[heading] for row in rows)] for heading in rows[0]]
    widths = [max(map(len, column)) for column in columns]
    for cells in zip(*columns, strict=True):
        yield "  ".join(map(str.ljust, cells, widths)).rstrip()


def _left_open(log: SensingLog, known: Observability) -> str:
    cues = f"{', '.join(known.cues).replace('_', ' ')}{', yaw unknown' * known.yaw_unknown}"
    modes = known.floppy_modes
    if modes is None:
        return (
            f"{cues}: too many robots or loops to count floppy modes of {known.unknowns} unknowns"
        )
    text = f"{cues}: {counted(modes, 'floppy mode')} of {known.unknowns} unknowns"
    if known.floppy is not None:
        text += f", {counted(known.floppy.sum(), 'floppy robot')}"
    common, docks = common_modes(log, known)
    if common:
        about = f" about its dock {docks[0]}, the only one in contact" if len(docks) == 1 else ""
        text += f"; in {common} of them, all robots tied to the anchor move as one{about}"
    return text


def _inspect_log(path: Path) -> Inspection:
    try:
        log = read_sensing_log(path)
    except InputError as mistake:
        return Inspection([mistake])
    found = slips(log)
    doubts = [*_slips(path, found), *_unlikely(log, path, found)]
    return Inspection(summary="\n".join([log.size, *doubts, *unknowns(log, path, by_cue(log))]))


def _slips(path: Path, found: Sequence[Slip]) -> Iterator[str]:
    """Describe in lines lengths that seem to be in another unit than the rest."""
    for slip in found[:MOST_SHOWN]:
        times = slip.factor if slip.factor > 1.0 else 1.0 / slip.factor
        near = [usual for usual in _USUAL if _NEAR[0] * times <= usual <= _NEAR[1] * times]
        many = f"about {near[0]:g}" if near else f"at least {float(f'{times:.2g}'):g}"
        size = f"{many} times too {'long' if slip.factor > 1.0 else 'short'}"
        either = " of either" if slip.against in COLUMNS else ""
        problem = f"{slip.what}: {size} beside {slip.against}"
        remedy = f"correct the unit{either}, or leave it out"
        yield f"{path}:{HEADER_LINES + 1 + slip.robot}: {slip.key}: {problem}; {remedy}"
    if (more := len(found) - MOST_SHOWN) > 0:
        yield f"{path}: {counted(more, 'more such length')}"


def _unlikely(log: SensingLog, path: Path, found: Sequence[Slip]) -> Iterator[str]:
    """Describe in lines lengths beyond any likely size of the swarm, of keys without slips."""
    size = 2.0 * np.linalg.norm(log.dock_offset_body, axis=1).max() + log.spacing
    in_a_row, apart = (log.robot_count + _MARGIN) * size, max(log.robot_count, _SPARSE) * size
    robots, anchor = np.arange(log.robot_count), log.anchor_position
    fixed, direction, value = log.fixes[:, 0], log.fixes[:, 1:4], log.fixes[:, 4]
    spawned = np.abs(log.spawn_position - anchor).max(axis=1)
    from_anchor, of_range = "from the anchor", "for a range"
    named = {slip.key for slip in found}
    for key, robot, away, farthest, what in (
        ("flip_height", robots, np.abs(log.flip_height - anchor[2]), in_a_row, from_anchor),
        ("spawn_position", robots, spawned, in_a_row, from_anchor),
        ("fixes", fixed, np.abs(value - direction @ anchor), apart, from_anchor),
        ("ranges", log.ranges[:, 0], log.ranges[:, 2], apart, of_range),
    ):
        wrong = [] if key in named else np.flatnonzero(away > farthest)[:MOST_SHOWN].tolist()
        for row in wrong:
            text = (
                f"{away[row]:.3g} {log.length_unit} {what} is unlikely; correct it or leave it out"
            )
            yield f"{path}:{HEADER_LINES + 1 + int(robot[row])}: {key}: {text}"


def _inspect_scenario(path: Path) -> Inspection:
    # slow to import
    from tiswarm.scenario.expansion import find_mistakes, load_scenario  # noqa: PLC0415
    from tiswarm.study import forecast  # noqa: PLC0415

    if mistakes := find_mistakes(path):
        return Inspection(mistakes)
    return Inspection(summary=str(forecast(load_scenario(path))))
