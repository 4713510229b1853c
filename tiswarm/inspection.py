"""Looks for mistakes in what a user hands in, and for what a log cannot tell."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tiswarm.errors import InputError
from tiswarm.measurements.consistency import HEADER_LINES, contradictions
from tiswarm.measurements.contacts import contact_count, located
from tiswarm.measurements.observability import by_cue
from tiswarm.records.estimate import Estimate, Observability
from tiswarm.records.messages import counted
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_log import SensingLog

MOST_SHOWN = 10


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """What was found in one file."""

    mistakes: tuple[InputError, ...] = ()
    """Everything wrong with it; a log is read up to its first mistake."""

    summary: str = ""
    """What it holds, where nothing is wrong."""


def inspect(path: Path) -> Inspection:
    """Look at a scenario, or at a sensing log where the name ends in .jsonl."""
    return _inspect_log(path) if path.suffix == ".jsonl" else _inspect_scenario(path)


def doubts(log: SensingLog, path: Path, found: Iterable[Observability]) -> Iterator[str]:
    """Say line by line what a log cannot tell."""
    if (lost := np.flatnonzero(~located(log))).size:
        yield f"tied to the anchor by no chain of contacts: {_robots(log, lost)}"
    if (single := np.flatnonzero(contact_count(log)[1:] == 1) + 1).size:
        yield f"in one contact only: {_robots(log, single)}"
    swing = None
    for known in found:
        yield _left_open(known)
        swing = known.swing if known.turning else swing
    if swing is not None:
        held = f"only the mean of all compasses does, to {math.degrees(swing):.2g} degrees"
        yield f"nothing sensed holds the swarm against turning about the anchor; {held}"
    impossible = contradictions(log)
    for line, problem in impossible[:MOST_SHOWN]:
        yield f"{path}:{line}: contacts: {problem}"
    if (more := len(impossible) - MOST_SHOWN) > 0:
        yield f"{path}: contacts: {counted(more, 'more such contradiction')}"


def failed_to_converge(log: SensingLog, estimate: Estimate) -> str | None:
    """Warn of an estimate that cannot be trusted; None where there is nothing to warn of."""
    found = estimate.convergence
    if found is None or found.converged:
        return None
    residual = f"residual of its best chain {estimate.solutions[0].residual:.2g} {log.length_unit}"
    return (
        f"not converged: misses what was sensed by {found.misfit_sd:.0f} sd more than its count of "
        f"measurements explains ({residual}); positions and sd may be far off. Try twice the steps "
        "or chains; if that does not help, look for wrong contacts or state the log's noise"
    )


def judged_wrong(log: SensingLog, path: Path, estimate: Estimate) -> Iterator[str]:
    """Say line by line which contacts a method did not believe."""
    rows = estimate.doubted
    name = log.robot_id.tolist()
    flips = np.zeros(log.robot_count) if log.stances is None else np.diff(log.stances.start)
    for robot, stance, own, other, dock in [] if rows is None else rows.tolist():
        key = "contacts" if stance == flips[robot] else f"stances[{stance}].contacts"
        told = f"robot {name[robot]}'s contact [{own}, {name[other]}, {dock}] is judged wrong"
        yield f"{path}:{HEADER_LINES + 1 + robot}: {key}: {told}"


def ambiguities(log: SensingLog, estimate: Estimate) -> Iterator[str]:
    """Say line by line which solutions a method found, where these are several."""
    found, unit = estimate.solutions, log.length_unit
    if len(found) <= 1:
        return
    chains = sum(solution.chains for solution in found)
    for number, solution in enumerate(found[:MOST_SHOWN], start=1):
        told = f"solution {number} of {len(found)}: {solution.chains} of {chains} chains"
        told += f", residual {solution.residual:.3g} {unit} ({solution.residual_sd:.2g} sd)"
        if number > 1:
            away = np.linalg.norm(solution.position - found[0].position, axis=1)
            farthest = np.argsort(-away, kind="stable")
            elsewhere = farthest[away[farthest] > log.spacing]
            told += f", {solution.residual - found[0].residual:.2g} {unit} more than solution 1"
            told += f"; up to {away.max():.3g} {unit} from there: {_robots(log, elsewhere)}"
        yield told
    if (more := len(found) - MOST_SHOWN) > 0:
        yield counted(more, "more solution")
    yield f"the estimate follows from the mean of all {chains} chains and is none of these"


def outcome(log: SensingLog, estimate: Estimate) -> str:
    """Say in one line what a method came to, and beside a mean of chains what the best one did."""
    unit, residual = log.length_unit, estimate.residual[-1]
    told = [counted(estimate.robot_count, "robot"), f"residual {residual:.2g} {unit} rms"]
    if estimate.residual_sd is not None:
        told[-1] += f" ({estimate.residual_sd:.2g} sd)"
    told += [
        f"of the best chain {each.residual:.2g} {unit} ({each.residual_sd:.2g} sd)"
        for each in estimate.solutions[:1]
    ]
    return ", ".join(told)


def _left_open(known: Observability) -> str:
    """Count what some cues leave unknown."""
    modes = known.floppy_modes
    untold = "too many robots to count the floppy modes"
    told = (
        f"{', '.join(known.cues).replace('_', ' ')}{', yaw unknown' * known.turning}: "
        f"{untold if modes is None else counted(modes, 'floppy mode')} of {known.unknowns}"
    )
    return told if known.loose is None else f"{told}, {counted(known.loose.sum(), 'robot')} loose"


def _robots(log: SensingLog, rows: NDArray[np.intp]) -> str:
    """Count robots, and name the first."""
    names = ", ".join(map(str, log.robot_id[rows[:MOST_SHOWN]].tolist()))
    more = ", ..." if len(rows) > MOST_SHOWN else ""
    return f"{counted(len(rows), 'robot')} ({names}{more})"


def _inspect_log(path: Path) -> Inspection:
    try:
        log = read_sensing_log(path)
    except InputError as mistake:
        return Inspection(mistakes=(mistake,))
    stances = 0 if log.stances is None else len(log.stances.pivot_dock)
    sizes = {"robot": log.robot_count, "contact": len(log.contacts), "stance": stances}
    held = ", ".join(counted(number, noun) for noun, number in sizes.items())
    return Inspection(summary="\n".join([held, *doubts(log, path, by_cue(log))]))


def _inspect_scenario(path: Path) -> Inspection:
    # Slow to import, and no business of a log's.
    from tiswarm.scenario import find_mistakes, load_scenario  # noqa: PLC0415
    from tiswarm.study.cases import plan  # noqa: PLC0415
    from tiswarm.study.forecast import forecast  # noqa: PLC0415

    mistakes = tuple(find_mistakes(path))
    if mistakes:
        return Inspection(mistakes=mistakes)
    return Inspection(summary=str(forecast(plan(load_scenario(path)))))
