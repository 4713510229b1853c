"""Mistakes in scenarios and logs, what a log leaves unknown, and estimates in words."""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tiswarm.aliases import AnyInts, Reals
from tiswarm.errors import InputError
from tiswarm.measurements.advice import advise
from tiswarm.measurements.consistency import HEADER_LINES, contradictions
from tiswarm.measurements.contacts import contact_count, parts, reach
from tiswarm.measurements.cues import cue_names, measure
from tiswarm.measurements.observability import by_cue, common_modes
from tiswarm.measurements.odometry import CENTER, UNKNOWN
from tiswarm.measurements.rows import SPACING
from tiswarm.records.estimate import Estimate, Observability
from tiswarm.records.messages import counted
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_format import ROBOT_NUMBERS
from tiswarm.records.sensing_log import SensingLog

MOST_SHOWN = 10

_STRETCH = 1.5
"""A chain of contacts this many times as long as it can be is no error of a few dock radii."""

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


def convergence_warning(log: SensingLog, estimate: Estimate) -> str:
    """Return a warning if an estimate did not converge, else an empty text."""
    found = estimate.convergence
    if found is None:
        return _reach_warning(log, estimate)
    if found.converged:
        return ""
    residual = f"residual of the best chain {estimate.solutions[0].residual:.2g} {log.length_unit}"
    return (
        f"not converged: chi-square exceeds its expectation by {found.misfit_sd:.0f} sd "
        f"({residual}); positions and sd may be far off. Try twice the steps or chains; if that "
        "does not help, look for wrong contacts or state the log's noise"
    )


def _reach_warning(log: SensingLog, estimate: Estimate) -> str:
    """Return a warning if robots are where no chain of their contacts ends, else an empty text."""
    rows = measure(log, ["contacts"])
    arms = np.linalg.norm([rows.arm, rows.other_arm], axis=2).sum(axis=0)
    part = parts(rows)
    bound = reach(np.column_stack([rows.robot, rows.other]), SPACING + arms, part)
    first = np.unique(part, return_index=True)[1][part]
    away = np.linalg.norm(estimate.position - estimate.position[first], axis=1)
    beyond = np.flatnonzero(away > _STRETCH * bound * log.dock_radius)
    if not beyond.size:
        return ""
    return (
        f"not converged: beyond the reach of their contacts are {_robots(log, beyond)}; "
        "look for wrong contacts, heights and spawn positions"
    )


def explain_estimate(log: SensingLog, path: Path, estimate: Estimate) -> Findings:
    """Explain an estimate; one that was read from a table has neither cues nor a residual."""
    warning, known = convergence_warning(log, estimate), estimate.observability
    if known is not None and known.cues:
        cues: Collection[str] = known.cues
        notes = [*describe_estimate(log, path, estimate), describe_residual(log, estimate)]
    else:
        cues, notes = cue_names(), [*unknowns(log, path, by_cue(log)), _LACKING]
    advice = advice_rows(log, cues, estimate.position)
    return Findings([warning] if warning else [], notes, advice)


def describe_estimate(log: SensingLog, path: Path, estimate: Estimate) -> Iterator[str]:
    """Describe in lines what the log leaves unknown, and the outliers."""
    yield from unknowns(log, path, filter(None, [estimate.observability]))
    if estimate.located is not None and (left := np.flatnonzero(~estimate.located)).size:
        yield f"not located by those before them (positions are guesses): {_robots(log, left)}"
    yield from _outliers(log, path, estimate)


def unknowns(log: SensingLog, path: Path, found: Iterable[Observability]) -> Iterator[str]:
    """Describe in lines what a log leaves unknown, and contacts that contradict each other.

    `found` is what cues determine, all that are in use last.
    """
    found = list(found)
    if found and (lost := np.flatnonzero(found[-1].disconnected)).size:
        yield f"disconnected from the anchor (positions are guesses): {_robots(log, lost)}"
    if (single := np.flatnonzero(contact_count(log)[1:] == 1) + 1).size:
        yield f"one contact only: {_robots(log, single)}"
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


def _outliers(log: SensingLog, path: Path, estimate: Estimate) -> Iterator[str]:
    contacts, places = estimate.outlier_contacts, estimate.outlier_places
    if contacts is None or places is None:
        return
    name = log.robot_id.tolist()
    flips = np.zeros(log.robot_count) if log.stances is None else np.diff(log.stances.start)
    rows = [
        (robot, stance, "ranges", f"range to {name[other]}")
        if own == CENTER
        else (robot, stance, "contacts", f"contact [{own}, {name[other]}, {dock}]")
        if UNKNOWN not in (own, dock)
        else (robot, stance, "touches", f"touch of {name[other]}")
        for robot, stance, own, other, dock in contacts.tolist()
    ]
    rows += [
        (robot, flips[robot], "flip_height", "height, spawn position or fix")
        if dock == CENTER
        else (robot, stance, "ground_docks", f"ground contact of dock {dock}")
        for robot, stance, dock in places.tolist()
    ]
    for robot, stance, key, what in rows:
        of_stance = "" if stance == flips[robot] else f"stances[{stance}]."
        place = f"{path}:{HEADER_LINES + 1 + robot}: {of_stance}{key}"
        yield f"{place}: robot {name[robot]}'s {what} is an outlier"


def describe_solutions(log: SensingLog, estimate: Estimate) -> Iterator[str]:
    """Describe in lines the solutions that a method found, if there are several."""
    found, unit = estimate.solutions, log.length_unit
    if len(found) <= 1:
        return
    chains = sum(solution.chains for solution in found)
    for number, solution in enumerate(found[:MOST_SHOWN], start=1):
        text = f"solution {number} of {len(found)}: {solution.chains} of {chains} chains"
        text += f", residual {solution.residual:.3g} {unit} ({solution.residual_sd:.2g} sd)"
        if number > 1:
            away = np.linalg.norm(solution.position - found[0].position, axis=1)
            farthest = np.argsort(-away, kind="stable")
            elsewhere = farthest[away[farthest] > log.spacing]
            text += f", {solution.residual - found[0].residual:.2g} {unit} more than solution 1"
            text += f"; up to {away.max():.3g} {unit} from there: {_robots(log, elsewhere)}"
        yield text
    if (more := len(found) - MOST_SHOWN) > 0:
        yield counted(more, "more solution")


def describe_residual(log: SensingLog, estimate: Estimate) -> str:
    """Describe an estimate in one line: its residual, and that of its best chain if it has one."""
    unit, residual = log.length_unit, estimate.residual[-1]
    text = f"{counted(estimate.robot_count, 'robot')}, residual {residual:.2g} {unit} rms"
    if estimate.residual_sd is not None:
        text += f" ({estimate.residual_sd:.2g} sd)"
    for best in estimate.solutions[:1]:
        text += f", of the best chain {best.residual:.2g} {unit} ({best.residual_sd:.2g} sd)"
    return text


def advice_rows(log: SensingLog, cues: Collection[str], position: Reals) -> list[dict[str, str]]:
    """Tabulate which further measurements would constrain robots most: cells by heading.

    Arguments as for `advise`. No row if nothing helps, or if there are too many robots or loops.
    """
    name, unit = log.robot_id.tolist(), log.length_unit
    rows = []
    for rank, found in enumerate(advise(log, cues, position) or [], start=1):
        what = f"{found.kind} of robot {name[found.robot]}"
        if found.contact:
            own, other, dock = found.contact
            what = f"{what}'s dock {own} with robot {name[other]}'s dock {dock}"
        rmse = {f"expected RMSE [{unit}]": found.rmse_before, f"with it [{unit}]": found.rmse_after}
        rows.append(
            {
                "rank": str(rank),
                "further measurement": what,
                "floppy modes removed": str(found.floppy_modes),
                "robots determined": _robots(log, found.determined, most=3),
            }
            | {key: f"{value:.3g}" for key, value in rmse.items() if not math.isnan(value)}
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


def _robots(log: SensingLog, rows: AnyInts, most: int = MOST_SHOWN) -> str:
    """Count robots, and list the first."""
    names = [*map(str, log.robot_id[rows[:most]].tolist()), *["..."] * (len(rows) > most)]
    return counted(len(rows), "robot") + (f" ({', '.join(names)})" if names else "")


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
