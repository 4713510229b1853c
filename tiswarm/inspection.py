"""Looks for mistakes in what a user hands in, without running anything."""

from dataclasses import dataclass
from pathlib import Path

from tiswarm.errors import InputError
from tiswarm.records.contact_graph import located
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.scenario import find_mistakes, load_scenario
from tiswarm.study.cases import plan


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


def _inspect_log(path: Path) -> Inspection:
    try:
        log = read_sensing_log(path)
    except InputError as mistake:
        return Inspection(mistakes=(mistake,))
    lost = int((~located(log)).sum())
    stances = 0 if log.stances is None else len(log.stances.pivot_dock)
    return Inspection(
        summary=(
            f"{log.robot_count} robots, {len(log.contacts)} contacts, {stances} stances, "
            f"{lost} robots not tied to the anchor"
        )
    )


def _inspect_scenario(path: Path) -> Inspection:
    mistakes = tuple(find_mistakes(path))
    if mistakes:
        return Inspection(mistakes=mistakes)
    cases = plan(load_scenario(path))
    robots = sum(case.settings.robots for case in cases)
    return Inspection(summary=f"{len(cases)} cases, {robots} robots in all")
