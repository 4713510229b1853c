"""Runs a scenario: grow, sense, localize, evaluate, store; goes on where an earlier run ended."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from tiswarm.compute import backend
from tiswarm.compute.choices import Arch
from tiswarm.errors import InputError
from tiswarm.evaluation import growth
from tiswarm.evaluation import tables as scores
from tiswarm.evaluation.profiles import by_hops_apart
from tiswarm.localization.registry import localize_many
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog
from tiswarm.records.truth import Truth
from tiswarm.scenario import Scenario, load_scenario
from tiswarm.sensing import observe
from tiswarm.study import manifest, tables
from tiswarm.study.cases import Case, chunks, plan
from tiswarm.study.scorecard import write_scorecard
from tiswarm.study.storage import DONE, FAILED, CaseRecord, RunFolder, write_table
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.soundness import unsoundness


class Watcher(Protocol):
    """Whoever is told how a run goes on."""

    def say(self, text: str) -> None:
        """Hear one line."""

    def stage(self, name: str, total: int) -> AbstractContextManager[Callable[[int], None]]:
        """Watch a stage of `total` steps; the block's value is told steps as they are done."""


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """What a run left behind."""

    folder: Path
    """The run folder."""

    computed: int
    """Cases computed now."""

    found: int
    """Cases that an earlier run had finished."""

    failed: tuple[CaseRecord, ...]
    """Cases that failed."""


def run(
    scenario: Scenario,
    parent: Path,
    *,
    watcher: Watcher,
    arch: Arch = "cpu",
    threads: int | None = None,
) -> RunResult:
    """Compute every case that is not yet stored, then write the tables.

    Args:
        scenario: What to compute.
        parent: Folder that holds the run's folder.
        watcher: Told how it goes on.
        arch: Device.
        threads: CPU threads; all if None.
    """
    backend.start(arch, threads=threads)
    folder = RunFolder.of(scenario, parent)
    cases = plan(scenario)
    stored = ((case, folder.stored(case.name)) for case in cases)
    records = {case.name: record for case, record in stored if record is not None}
    missing = [case for case in cases if case.name not in records]
    if records:
        watcher.say(f"{len(records)} of {len(cases)} cases are already stored")
    stopwatch = manifest.Stopwatch()
    bench = _Bench(folder, stopwatch, watcher, arch, threads)
    for chunk in chunks(missing):
        records |= {record.case: record for record in bench.work_off(chunk)}
    if missing:
        manifest.write_manifest(
            folder.path, manifest.describe(backend.current(), stopwatch) | {"cases": len(cases)}
        )
    complete = [records[case.name] for case in cases]
    write_tables(folder, scenario, cases, complete)
    return RunResult(
        folder=folder.path,
        computed=len(missing),
        found=len(cases) - len(missing),
        failed=tuple(record for record in complete if record.status == FAILED),
    )


def write_tables(
    folder: RunFolder, scenario: Scenario, cases: Sequence[Case], records: Sequence[CaseRecord]
) -> None:
    """Write the tables of a run, and the scorecard if one is wanted, from the cases."""
    write_table(tables.summary(records), folder.path / "summary.csv")
    settings = [case.settings for case in cases]
    write_table(tables.table(records, settings), folder.path / "table.csv")
    write_table(tables.paired(records), folder.path / "paired.csv")
    write_table(tables.profiles(records, folder.cases), folder.path / "profiles.csv")
    if scenario.scorecard != "none":
        write_scorecard(folder, cases, records)


def tabulate(path: Path) -> None:
    """Write the tables of a run folder anew from its stored cases.

    Raises:
        InputError: where `path` is not a run folder.
    """
    resolved = path / "scenario.yaml"
    if not resolved.is_file():
        msg = "this is no run folder, for it holds no scenario.yaml; give one that a run made"
        raise InputError(msg, path=path)
    folder, scenario = RunFolder(path), load_scenario(resolved)
    stored = [(case, folder.recorded(case.name)) for case in plan(scenario)]
    kept = [(case, record) for case, record in stored if record is not None]
    write_tables(folder, scenario, [case for case, _ in kept], [record for _, record in kept])


class _Bench:
    """Where chunks of cases are worked off, stage by stage."""

    def __init__(
        self,
        folder: RunFolder,
        stopwatch: manifest.Stopwatch,
        watcher: Watcher,
        arch: Arch,
        threads: int | None,
    ) -> None:
        self.folder = folder
        self.stopwatch = stopwatch
        self.watcher = watcher
        self.arch: Arch = arch
        self.threads = threads

    def work_off(self, chunk: Sequence[Case]) -> list[CaseRecord]:
        """Compute and store cases whose structures are of one kind."""
        histories = self._grow(chunk)
        sound, records = self._sift(chunk, histories)
        logs = self._sense(sound, histories)
        estimates = self._localize(sound, logs)
        with self._stage("evaluate and store", len(sound)) as advance:
            for case, log, estimate in zip(sound, logs, estimates, strict=True):
                records.append(self._store(case, histories[case.seed], log, estimate))
                advance(1)
        return records

    @contextmanager
    def _stage(self, name: str, total: int) -> Iterator[Callable[[int], None]]:
        with self.stopwatch.stage(name), self.watcher.stage(name, total) as advance:
            yield advance

    def _grow(self, chunk: Sequence[Case]) -> dict[int, History]:
        """Grow each structure once, whatever the number of its conditions."""
        settings = chunk[0].settings
        seeds = sorted({case.seed for case in chunk})
        with self._stage("grow", len(seeds) * settings.robots) as advance:
            grown = grow(
                settings.structure,
                robots=settings.robots,
                seeds=seeds,
                robot=settings.robot,
                tell=advance,
            )
        return dict(zip(seeds, grown, strict=True))

    def _sift(
        self, chunk: Sequence[Case], histories: dict[int, History]
    ) -> tuple[list[Case], list[CaseRecord]]:
        """Set aside cases whose structure must not be stored, with the reason."""
        gap = chunk[0].settings.structure.climb.contact_gap
        faults = {seed: _fault(history, gap) for seed, history in histories.items()}
        failures = [_record(case, FAILED, faults[case.seed]) for case in chunk if faults[case.seed]]
        for failure in failures:
            self.folder.store_failure(failure)
            self.watcher.say(f"case {failure.case} failed: {failure.reason}")
        for seed, history in histories.items():
            if history.ended and not faults[seed]:
                self.watcher.say(f"seed {seed}: growth ended: {history.ended}")
        return [case for case in chunk if not faults[case.seed]], failures

    def _sense(self, cases: Sequence[Case], histories: dict[int, History]) -> list[SensingLog]:
        with self._stage("sense", len(cases)) as advance:
            logs = []
            for case in cases:
                logs.append(observe(histories[case.seed], case.settings.sensing))
                advance(1)
        return logs

    def _localize(self, cases: Sequence[Case], logs: Sequence[SensingLog]) -> list[Estimate]:
        if not cases:
            return []
        precision = cases[0].settings.precision
        with self._stage("localize", len(cases)) as advance:
            backend.start(self.arch, threads=self.threads, precision=precision)
            methods = [case.settings.localization for case in cases]
            return localize_many(logs, methods, tell=advance)

    def _store(
        self, case: Case, history: History, log: SensingLog, estimate: Estimate
    ) -> CaseRecord:
        """Evaluate one case and write it down."""
        truth = Truth(
            robot_id=log.robot_id,
            position=history.position,
            orientation_wxyz=history.orientation_wxyz,
        )
        scored = scores.score(
            truth,
            log,
            estimate,
            history.robot,
            cues=case.settings.localization.cues,
        )
        return self.folder.store(
            _record(case, DONE, history.ended, _json_numbers(scored | growth.totals(history))),
            truth=truth,
            log=log,
            estimate=estimate,
            tables={
                "robots": scores.by_robot(truth, log, estimate, history.sensed),
                "convergence": scores.by_iteration(truth, estimate),
                "growth": growth.by_join(history),
                "relative": by_hops_apart(truth, log, estimate),
            },
        )


def _fault(history: History, contact_gap: float) -> str:
    """Why a structure cannot be used, or nothing."""
    if history.robot_count < 2:  # noqa: PLR2004 - one robot has nobody to touch
        return history.ended or "only one robot joined"
    return unsoundness(history, contact_gap=contact_gap)


def _record(
    case: Case, status: str, reason: str, scored: dict[str, float | int | None] | None = None
) -> CaseRecord:
    return CaseRecord(
        case=case.name,
        seed=case.seed,
        condition=case.variant.condition,
        point=case.variant.point,
        status=status,
        reason=reason,
        scores=scored or {},
    )


def _json_numbers(scored: dict[str, float | int]) -> dict[str, float | int | None]:
    """Say None where a number is unknown, for JSON has no NaN."""
    return {name: None if np.isnan(value) else value for name, value in scored.items()}
