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
    named,
    reasons,
    solution_name,
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


def inspect(source: Path | dict[str, Any], overrides: Sequence[str] = ()) -> Inspection:
    """Inspect a scenario, or a sensing log if the name ends in .jsonl, .jsonl.zst or .mcap.

    A scenario may be plain data; `overrides` are texts `KEY=VALUE`, of a scenario alone.
    """
    path = Path() if isinstance(source, Mapping) else source
    is_log = path.name.lower().endswith((".jsonl", ".jsonl.zst", ".mcap"))
    if not is_log:
        return _inspect_scenario(source, overrides)
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
        return [*filter(None, [self.doubt]), *cautions(self.log, self.estimate)]

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
    def statement(self) -> str:
        """How many robots are near where they are shown, in a sentence."""
        if len(self.estimate.solutions) <= 1 or not self.solution:
            return f"{self.solution}{self.estimate.statement}"
        return f"{self.solution}if it is right, {self.estimate.statement}"

    @property
    def reasons(self) -> list[str]:
        """Why the others may not be there, and what the log leaves open, in lines."""
        return [
            *reasons(self.log, self.estimate),
            *cautions(self.log, self.estimate),
            *self.notes,
        ]

    def __str__(self) -> str:
        """Give the statement and its reasons, in lines."""
        return "\n".join([self.statement, *self.reasons])

    @property
    def _cues(self) -> Collection[str]:
        """Cues that the method used; none of an estimate that was read from a table."""
        observability = self.estimate.observability
        return () if observability is None else observability.cues


def describe_estimate(log: SensingLog, path: Path, estimate: Estimate) -> Iterator[str]:
    """Describe in lines what the log leaves unknown, and the outliers."""
    yield from unknowns(log, path, filter(None, [estimate.observability]))
    if estimate.located is not None and not estimate.located.all():
        unlocated = np.flatnonzero(~estimate.located)
        yield f"not located by those before them (positions are guesses): {named(log, unlocated)}"
    yield from describe_outliers(log, path, estimate)


def unknowns(
    log: SensingLog, path: Path, observabilities: Iterable[Observability]
) -> Iterator[str]:
    """Describe in lines what a log leaves unknown, and contacts that contradict each other.

    `observabilities` are what cues determine, all that are in use last.
    """
    observabilities = list(observabilities)
    if observabilities and observabilities[-1].disconnected.any():
        disconnected = np.flatnonzero(observabilities[-1].disconnected)
        yield f"disconnected from the anchor (positions are guesses): {named(log, disconnected)}"
    if log.ground_form is not None:
        yield f"the ground is {log.ground_form}: docks on it have no known height, and do not count"
    if log.gone.size:
        yield f"gone (their positions are where they last stood): {named(log, log.gone)}"
    single = np.flatnonzero(contact_count(log)[1:] == 1) + 1
    if single.size:
        yield f"one contact only: {named(log, single)}"
    gauge_yaw_sd = None
    for observability in observabilities:
        yield _underdetermined(log, observability)
        if observability.yaw_unknown:
            gauge_yaw_sd = observability.gauge_yaw_sd
    if gauge_yaw_sd is not None:
        fixed = f"the mean compass fixes it to {math.degrees(gauge_yaw_sd):.2g} deg (1 sd)"
        yield f"global yaw is unobservable; {fixed}"
    yield from impossible(log, path)


def _underdetermined(log: SensingLog, observability: Observability) -> str:
    """Describe in a line which motions change no measurement of some cues."""
    cues = ", ".join(observability.cues).replace("_", " ")
    if observability.yaw_unknown:
        cues += ", yaw unknown"
    unknown_count = observability.unknowns
    modes = observability.floppy_modes
    if modes is None:
        return f"{cues}: too many robots or loops to count floppy modes of {unknown_count} unknowns"
    meaning = "free motion" if modes == 1 else "free motions"
    text = f"{cues}: {counted(modes, 'floppy mode')} ({meaning}) of {unknown_count} unknowns"
    if observability.floppy is not None and modes:
        text += f", which move {counted(observability.floppy.sum(), 'robot')}"
    common, docks = common_modes(log, observability)
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


def _inspect_scenario(source: Path | dict[str, Any], overrides: Sequence[str]) -> Inspection:
    # slow to import
    from tiswarm.scenario.expansion import examine, in_file_order  # noqa: PLC0415
    from tiswarm.study.forecast import forecast  # noqa: PLC0415

    try:
        scenario, mistakes = examine(source, overrides)
    except InputError as error:
        return Inspection([error])
    if scenario is None or mistakes:
        return Inspection(in_file_order(mistakes))
    return Inspection(summary=str(forecast(scenario)))
