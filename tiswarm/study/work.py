"""Works off cases whose structures are of one kind: grow, sense, localize, evaluate, store."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from tiswarm.compute import backend
from tiswarm.compute.backend import Backend
from tiswarm.evaluation import tables as scores
from tiswarm.evaluation.outliers import outlier_scores
from tiswarm.evaluation.profiles import by_hops_apart
from tiswarm.localization.registry import localize_many
from tiswarm.params import Arch, Precision
from tiswarm.progress import Progress
from tiswarm.records.estimate import Estimate
from tiswarm.records.positions import Truth
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import observe
from tiswarm.study.cases import Case
from tiswarm.study.costs import Costs
from tiswarm.study.storage import DONE, FAILED, CaseRecord, RunFolder
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.soundness import unsoundness

KEPT_FROM_S = 10.0
"""Growth that took so long is not lost if a run is stopped before its cases are stored."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """Cases whose structures are of one kind, and all that is needed to work them off."""

    folder: RunFolder
    cases: Sequence[Case]
    arch: Arch
    threads: int | None
    """CPU threads; all if None."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What came of a job."""

    records: Sequence[CaseRecord]
    """One of each case; they are stored too."""

    backend: Backend | None
    """What ran the kernels, if any ran."""


def work_off(job: Job, progress: Progress) -> Outcome:
    """Compute and store the cases of a job."""
    backend.start(job.arch, threads=job.threads)
    records = _Bench(job, progress).work_off()
    return Outcome(records=records, backend=backend.current())


def failure(case: Case, reason: str) -> CaseRecord:
    """Record of a case that could not be computed."""
    return _record(case, FAILED, reason)


class _Bench:
    """Where a job is worked off, stage by stage."""

    def __init__(self, job: Job, progress: Progress) -> None:
        self.job = job
        self.progress = progress
        self.costs = Costs()

    def work_off(self) -> list[CaseRecord]:
        histories = self._grow(self.job.cases)
        sound, records = self._sift(self.job.cases, histories)
        logs = self._sense(sound, histories)
        for cases, felt in _alike(sound, logs):
            estimates = self._localize(cases, felt)
            with self._stage("evaluate and store", cases) as advance:
                for case, log, estimate in zip(cases, felt, estimates, strict=True):
                    records.append(self._store(case, histories[case.seed], log, estimate))
                    advance(1)
            for case in cases:
                self.job.folder.store_cost(case.name, self.costs.of(case.name))
        return records

    @contextmanager
    def _stage(
        self, name: str, cases: Sequence[Case], total: int | None = None
    ) -> Iterator[Callable[[int], None]]:
        """Watch and time a stage, whose cost its cases share."""
        steps = len(cases) if total is None else total
        shared = self.costs.stage(name, [case.name for case in cases])
        with shared, self.progress.task(name, steps) as advance:
            yield advance

    def _grow(self, chunk: Sequence[Case]) -> dict[int, History]:
        """Grow each structure once, whatever the number of its conditions."""
        histories, settings = self._kept(chunk), chunk[0].settings
        missing = [case for case in chunk if case.seed not in histories]
        first = {case.seed: case for case in reversed(missing)}
        seeds = sorted(first)
        if not seeds:
            return histories
        with self._stage("grow", missing, len(seeds) * settings.robots) as advance:
            grown = grow(
                settings.structure,
                robots=settings.robots,
                seeds=seeds,
                robot=settings.robot,
                on_progress=advance,
            )
        for seed, history in zip(seeds, grown, strict=True):
            share = self.costs.of(first[seed].name)["grow"]
            if share["wall_s"] * len(missing) > KEPT_FROM_S and history.walks:
                self.job.folder.keep_grown(first[seed], history, share)
        return histories | dict(zip(seeds, grown, strict=True))

    def _kept(self, chunk: Sequence[Case]) -> dict[int, History]:
        """Read the structures that an earlier run has grown, which pays for them."""
        histories = {}
        for seed, case in {case.seed: case for case in chunk}.items():
            if found := self.job.folder.grown(case):
                histories[seed], share = found
                self.costs.paid("grow", [c.name for c in chunk if c.seed == seed], share)
                self.progress.info(f"seed {seed}: its structure was grown by an earlier run")
        return histories

    def _sift(
        self, chunk: Sequence[Case], histories: dict[int, History]
    ) -> tuple[list[Case], list[CaseRecord]]:
        """Set aside cases whose structure must not be stored, with the reason."""
        gap = chunk[0].settings.structure.climb.contact_gap
        faults = {seed: _fault(history, gap) for seed, history in histories.items()}
        failures = [failure(case, faults[case.seed]) for case in chunk if faults[case.seed]]
        for failed in failures:
            self.job.folder.store_failure(failed)
        return [case for case in chunk if not faults[case.seed]], failures

    def _sense(self, cases: Sequence[Case], histories: dict[int, History]) -> list[SensingLog]:
        with self._stage("sense", cases) as advance:
            logs = []
            for case in cases:
                logs.append(observe(histories[case.seed], case.settings.sensing))
                advance(1)
        return logs

    def _localize(self, cases: Sequence[Case], logs: Sequence[SensingLog]) -> list[Estimate]:
        """Localize side by side cases of one method and precision."""
        with self._stage("localize", cases) as advance:
            precision = cases[0].settings.precision
            backend.start(self.job.arch, threads=self.job.threads, precision=precision)
            methods = [case.settings.localization for case in cases]
            return localize_many(logs, methods, with_observability=True, on_progress=advance)

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
        scored |= outlier_scores(history, log, estimate, cues=case.settings.localization.cues)
        return self.job.folder.store(
            _record(case, DONE, history.ended, _json_numbers(scored | scores.totals(history))),
            truth=truth,
            log=log,
            estimate=estimate,
            tables={
                "robots": scores.by_robot(truth, log, estimate, history.sensed),
                "convergence": scores.by_iteration(truth, estimate),
                "growth": scores.by_join(history),
                "relative": by_hops_apart(truth, log, estimate),
            },
            cost=self.costs.of(case.name),
        )


def _alike(
    cases: Sequence[Case], logs: Sequence[SensingLog]
) -> Iterator[tuple[list[Case], list[SensingLog]]]:
    """List cases of one method and precision, which are localized side by side, and their logs."""

    def kind(sensed: tuple[Case, SensingLog]) -> tuple[str, Precision]:
        settings = sensed[0].settings
        return settings.localization.method, settings.precision

    for _, group in groupby(sorted(zip(cases, logs, strict=True), key=kind), key=kind):
        alike = list(group)
        yield [case for case, _ in alike], [log for _, log in alike]


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
