"""Mistakes in scenarios and logs, what a log leaves unknown, and estimates in words."""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tiswarm.base.aliases import Ints
from tiswarm.base.errors import InputError
from tiswarm.measurements.contacts import contact_count
from tiswarm.measurements.cues import cue_names
from tiswarm.measurements.observability import by_cue, common_modes
from tiswarm.measurements.units import doubts, impossible
from tiswarm.measurements.verdicts import (
    cautions,
    describe_outliers,
    describe_solutions,
    distrust,
    headline,
    named,
    solution_name,
    verdict,
)
from tiswarm.records.estimate import Estimate, Observability
from tiswarm.records.messages import counted
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_log import SensingLog

if TYPE_CHECKING:
    from tiswarm.measurements.advice.further import AdviceTable, Kind


class Inspection(NamedTuple):
    """All mistakes of a scenario, or the first of a log; the summary of a file without mistakes."""

    mistakes: Sequence[InputError] = ()
    summary: str = ""

    def __str__(self) -> str:
        """Give the summary, or the mistakes, in lines."""
        return self.summary or "\n".join(map(str, self.mistakes))


_LACKING = (
    "a table of positions contains neither the solutions nor the outliers that the method found; "
    "without a table, tiswarm view localizes the log and shows both"
)


def inspect(given: Path | dict[str, Any], overrides: Sequence[str] = ()) -> Inspection:
    """Inspect a scenario, or a sensing log if the name ends in .jsonl, .jsonl.zst or .mcap.

    A scenario may be plain data; `overrides` are texts `KEY=VALUE`, of a scenario alone.
    """
    path = Path() if isinstance(given, Mapping) else given
    is_log = path.name.lower().endswith((".jsonl", ".jsonl.zst", ".mcap"))
    if not is_log:
        return _inspect_scenario(given, overrides)
    if overrides:
        raise InputError("is a log, which has no keys to override; leave --set out", path=path)
    return _inspect_log(path)


@dataclass(frozen=True)
class Findings:
    """An estimate in words: they are found when they are asked for."""

    log: SensingLog
    path: Path
    """Name of the log in messages."""

    estimate: Estimate
    chosen: int | None = None
    """Number of the solution that the positions are, counted from 1; None for the mean of all."""

    @cached_property
    def doubt(self) -> str:
        """Why the estimate cannot be trusted, and what to do; empty if it can."""
        return distrust(self.log, self.estimate)

    @cached_property
    def warnings(self) -> list[str]:
        """What makes the estimate doubtful, in lines."""
        return [*([self.doubt] if self.doubt else []), *cautions(self.log, self.estimate)]

    @cached_property
    def notes(self) -> list[str]:
        """What the log leaves open, and the outliers, in lines."""
        if self._cues:
            return [*describe_estimate(self.log, self.path, self.estimate)]
        return [*unknowns(self.log, self.path, by_cue(self.log)), _LACKING]

    @cached_property
    def advice(self) -> "AdviceTable":
        """Further measurements that would constrain robots most."""
        return self.advise()

    def advise(self, budget: int | None = None, kinds: "Sequence[Kind]" = ()) -> "AdviceTable":
        """Return the advice, with the set of `budget` measurements that helps most together.

        Args:
            budget: Largest number of measurements in the set; no set if None.
            kinds: Kinds of measurements in the set; all but anchor if there are none.

        Raises:
            InputError: the budget is not positive, a kind is unknown, or there are too many robots.
        """
        from tiswarm.measurements.advice.further import tabulate  # noqa: PLC0415 - slow to import

        return tabulate(self.log, self._cues or cue_names(), self.estimate, budget, kinds)

    @property
    def solutions(self) -> list[str]:
        """The solutions that the method found, in lines."""
        return [*describe_solutions(self.log, self.estimate)]

    @property
    def solution(self) -> str:
        """Name of the chosen solution and a colon; empty for the mean of all."""
        return f"{solution_name(self.estimate, self.chosen)}: " if self.chosen else ""

    @property
    def summary(self) -> str:
        """Number of robots and whether to trust the estimate, in a line."""
        found = verdict(self.estimate) if self.doubt else headline(self.log, self.estimate)
        size = counted(self.estimate.robot_count, "robot")
        return f"{self.solution}{size}{f', {found}' if found else ''}"

    def __str__(self) -> str:
        """Give notes, cautions and the summary, in lines."""
        return "\n".join([*self.notes, *cautions(self.log, self.estimate), self.summary])

    @property
    def _cues(self) -> Collection[str]:
        """Cues that the method used; none of an estimate that was read from a table."""
        known = self.estimate.observability
        return () if known is None else known.cues


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
    if log.ground_form is not None:
        yield f"the ground is {log.ground_form}: docks on it have no known height, and do not count"
    if log.gone.size:
        yield f"gone (their positions are where they last stood): {named(log, log.gone)}"
    if (single := np.flatnonzero(contact_count(log)[1:] == 1) + 1).size:
        yield f"one contact only: {named(log, single)}"
    gauge_yaw_sd = None
    for known in found:
        yield _left_open(log, known)
        gauge_yaw_sd = known.gauge_yaw_sd if known.yaw_unknown else gauge_yaw_sd
    if gauge_yaw_sd is not None:
        fixed = f"the mean compass fixes it to {math.degrees(gauge_yaw_sd):.2g} deg (1 sd)"
        yield f"global yaw is unobservable; {fixed}"
    yield from impossible(log, path)


def _left_open(log: SensingLog, known: Observability) -> str:
    cues = f"{', '.join(known.cues).replace('_', ' ')}{', yaw unknown' * known.yaw_unknown}"
    modes = known.floppy_modes
    if modes is None:
        return (
            f"{cues}: too many robots or loops to count floppy modes of {known.unknowns} unknowns"
        )
    meaning = f"free motion{'s' * (modes != 1)}"
    text = f"{cues}: {counted(modes, 'floppy mode')} ({meaning}) of {known.unknowns} unknowns"
    if known.floppy is not None and modes:
        text += f", which move {counted(known.floppy.sum(), 'robot')}"
    common, docks = common_modes(log, known)
    if common:
        text += f"; in {common} of them, all robots tied to the anchor move as one{_about(docks)}"
    return text


def _about(docks: Ints) -> str:
    """Say about which point of the anchor other robots turn, if there is one."""
    if len(docks) != 1:
        return ""
    if docks[0] < 0:  # CENTER
        return " about its center: none of its docks is in contact"
    return f" about its dock {docks[0]}, the only one in contact"


def _inspect_log(path: Path) -> Inspection:
    try:
        log = read_sensing_log(path)
    except InputError as mistake:
        return Inspection([mistake])
    summary = [log.size, *doubts(log, path), *unknowns(log, path, by_cue(log))]
    return Inspection(summary="\n".join(summary))


def _inspect_scenario(given: Path | dict[str, Any], overrides: Sequence[str]) -> Inspection:
    # slow to import
    from tiswarm.scenario.expansion import find_mistakes, load_scenario  # noqa: PLC0415
    from tiswarm.study.forecast import forecast  # noqa: PLC0415

    if mistakes := find_mistakes(given, overrides):
        return Inspection(mistakes)
    return Inspection(summary=str(forecast(load_scenario(given, overrides))))
