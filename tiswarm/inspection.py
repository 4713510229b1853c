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
from tiswarm.records.estimate import Estimate, Observability
from tiswarm.records.messages import counted
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_format import ROBOT_NUMBERS
from tiswarm.records.sensing_log import SensingLog
from tiswarm.verdicts import MOST_SHOWN, cautions, describe_outliers, distrust, named

_MARGIN = 20
"""Robots in a row that a spawn position may be beyond all others."""


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
    found = [*_unlikely(log, path), *unknowns(log, path, by_cue(log))]
    return Inspection(summary="\n".join([log.size, *found]))


def _unlikely(log: SensingLog, path: Path) -> Iterator[str]:
    """Describe in lines positions farther from the anchor than all robots in a row."""
    size = 2.0 * np.linalg.norm(log.dock_offset_body, axis=1).max() + log.spacing
    farthest = (log.robot_count + _MARGIN) * size
    for key in ROBOT_NUMBERS:
        number = getattr(log, key).reshape(log.robot_count, -1)
        away = np.abs(number - log.anchor_position[-number.shape[1] :]).max(axis=1)
        for robot in np.flatnonzero(away > farthest)[:MOST_SHOWN].tolist():
            text = f"{away[robot]:.3g} {log.length_unit} from the anchor is unlikely"
            yield f"{path}:{HEADER_LINES + 1 + robot}: {key}: {text}; correct it or leave it out"


def _inspect_scenario(path: Path) -> Inspection:
    # slow to import
    from tiswarm.scenario.expansion import find_mistakes, load_scenario  # noqa: PLC0415
    from tiswarm.study import forecast  # noqa: PLC0415

    if mistakes := find_mistakes(path):
        return Inspection(mistakes)
    return Inspection(summary=str(forecast(load_scenario(path))))
