"""Runs a scenario: plan, cases, jobs, outcomes, tables; continues where an earlier run ended.

Any executor computes the jobs; their progress is shown.
"""

from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, groupby
from pathlib import Path
from threading import Lock

from tiswarm.base import errors
from tiswarm.base.params import AnyArch, Arch
from tiswarm.base.plugins import PluginError
from tiswarm.base.progress import Advance, Progress, ignore
from tiswarm.localization import methods
from tiswarm.records.messages import counted
from tiswarm.scenario.expansion import Group, Plan, plan
from tiswarm.scenario.model import Scenario
from tiswarm.study.executors import Execution, Executor, open_executor, reason, require_cores
from tiswarm.study.runner import Job, Outcome, batch, failure, first_alone
from tiswarm.study.store import CaseRecord, RunFolder
from tiswarm.study.tables import MeasureTrial, write_tables

_LOCAL = Execution()


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """Result of a run."""

    folder: Path
    computed: int  # cases that this run computed
    found: int  # cases that an earlier run had finished
    failed: tuple[CaseRecord, ...]  # cases that this run could not compute
    missing: int  # cases left to other shards; the shard that leaves none writes the tables

    @property
    def what_failed(self) -> str:
        """How many cases failed, and why the first of them did; empty if none failed."""
        if not self.failed:
            return ""
        first = self.failed[0]
        cases = counted(len(self.failed), "case")
        return f"{cases} failed, the first: {first.case}: {first.reason}"


def run(
    scenario: Scenario,
    parent: Path,
    *,
    progress: Progress,
    arch: AnyArch = "cpu",
    threads: int | None = None,
    execution: Execution = _LOCAL,
    overwrite: bool = False,
) -> RunResult:
    """Compute every case that is not yet stored, then write the tables.

    Args:
        scenario: What to compute.
        parent: Folder that holds the run's folder.
        progress: Receives progress reports.
        arch: Device of methods that are parallel; other stages run on the processor.
        threads: CPU threads; all if None.
        execution: Where cases are computed, and which.
        overwrite: Whether to replace files of a folder that no run made.

    Raises:
        InputError: the folder has files, and no run made it.
        CasesFailedError: a case failed and `execution` stops at failures.
        PluginError: a measure of a plug-in cannot be computed for the first case.
        EnvironmentTroubleError: the device is missing, the folder is in use, or workers run
            other code.
    """
    whole = plan(scenario)
    running = _start_device(whole, arch, threads, execution, progress)
    number, count = execution.shard
    of_shard = whole.structures[number - 1 :: count]
    part = "" if count == 1 else f"{number}-of-{count}"
    with RunFolder.opened(scenario, parent, progress, part, overwrite=overwrite) as folder:
        stored = _read_stored(of_shard, folder, progress)
        missing = _without(of_shard, stored)
        outcomes: list[Outcome] = []
        measures = MeasureTrial(folder, whole.structures)
        measures.try_on(stored.values())
        if missing:
            folder.reopen(progress, computes=execution.scheduler is None)
            progress.begun(folder.path)
            ended = _CaseCount()
            total = sum(map(len, of_shard))
            with progress.task("cases", total, ended.note, len(stored)) as ended.advance:
                for workers, groups in groupby(missing, lambda group: group[0].settings.workers):
                    place = replace(execution, workers=workers) if workers else execution
                    with open_executor(place, threads, progress) as executor:
                        jobs = batch(
                            [*groups],
                            folder,
                            arch=running,
                            threads=executor.threads,
                            width=executor.width,
                            alone=place.case_limit_s is not None,  # to find the one that hangs
                        )
                        if measures.is_due:
                            jobs = first_alone(jobs)
                        outcomes += compute(
                            jobs,
                            executor,
                            ended,
                            progress,
                            fail_fast=place.fail_fast,
                            check=measures.try_on,
                        )
        computed = {record.case: record for outcome in outcomes for record in outcome.records}
        records = stored | computed
        others = folder.read_cases([case for case in whole.cases if case.name not in records])
        records |= {name: record for name, record in others.items() if record.is_current}
        if len(records) == len(whole.cases):
            used = set(chain.from_iterable(outcome.used for outcome in outcomes))
            costs = folder.complete(whole.cases, used)
            write_tables(folder.path, whole, records, costs)
            if all(record.is_done for record in records.values()):
                folder.forget_structures()
    return RunResult(
        folder=folder.path,
        computed=len(computed),
        found=len(stored),
        failed=tuple(record for record in computed.values() if not record.is_done),
        missing=len(whole.cases) - len(records),
    )


def _read_stored(
    structures: Sequence[Group], folder: RunFolder, progress: Progress
) -> dict[str, CaseRecord]:
    """Read finished cases by name, and report how many are kept and how many are outdated."""
    cases = [case for group in structures for case in group]
    stored = [record for record in folder.read_cases(cases).values() if record.is_done]
    current = {record.case: record for record in stored if record.is_current}
    if current:
        progress.info(f"{len(current)} of {len(cases)} cases are already stored")
    outdated = len(stored) - len(current)
    if outdated:
        were, them = ("was", "it") if outdated == 1 else ("were", "them")
        counted_cases = counted(outdated, "case")
        progress.info(f"{counted_cases} {were} computed by other code; computing {them} again")
    return current


def _without(structures: Sequence[Group], stored: dict[str, CaseRecord]) -> list[Group]:
    """Leave out cases that are stored, and structures without other cases."""
    lacking = ([case for case in group if case.name not in stored] for group in structures)
    return [group for group in lacking if group]


def _start_device(
    whole: Plan, arch: AnyArch, threads: int | None, execution: Execution, progress: Progress
) -> Arch:
    """Start the device of a study before anything is written, and return its name.

    On a cluster, only its workers can start it.
    """
    points = {case.variant.label: case.settings for case in whole.cases}.values()
    used = [settings.localization for settings in points]
    if execution.scheduler is not None:
        if arch == "auto":
            raise errors.InputError(
                "auto cannot see the workers; name their device", argument="arch"
            )
        for settings in points:
            methods.require_use(used, arch, settings.precision)
        return arch
    require_cores(points)
    for settings in points:
        settings.structure.mechanics.require_libraries()
    chosen = arch
    wanted = {(p.arch or "", p.threads or 0, p.precision) for p in points}
    for point_arch, point_threads, precision in sorted(wanted):
        methods_of_arch = [p.localization for p in points if (p.arch or "") == point_arch]
        running = methods.start_device(
            methods_of_arch,
            point_arch or arch,
            threads=point_threads or threads,
            precision=precision,
        )
        if not point_arch:
            chosen = running.arch
    if arch != "cpu":
        progress.info(methods.where(used, running))
    return running.arch if chosen == "auto" else chosen


_BEAT_S = 1.0
"""Longest time between two looks at the jobs, so that progress lines come while none ends."""


class _CaseCount:
    """Counts the cases of a study as they end, also those of jobs that still run.

    Threads of an executor report these.
    """

    def __init__(self) -> None:
        self.advance: Advance = ignore
        self.failed = 0
        self.executor: Executor | None = None
        self._lock = Lock()
        self._stored: Counter[int] = Counter()  # cases of running jobs that are stored, by job

    def note(self) -> str:
        """Return how many cases failed, and what a process does."""
        failed = f"{self.failed} failed" if self.failed else ""
        stage = self.executor.stage if self.executor else ""
        return ", ".join(filter(None, (failed, stage)))

    def store(self, job: Job, cases: float) -> None:
        """Count cases that a running job has just stored."""
        with self._lock:
            self._stored[id(job)] += round(cases)
            self.advance(cases)

    def end(self, job: Job, cases: int) -> None:
        """Count the cases of a job that has ended; none if they are to be computed again."""
        with self._lock:
            self.advance(cases - self._stored.pop(id(job), 0))


def compute(
    jobs: Sequence[Job],
    executor: Executor,
    count: _CaseCount,
    progress: Progress,
    *,
    fail_fast: bool = False,
    check: Callable[[Sequence[CaseRecord]], None] = lambda _: None,
) -> list[Outcome]:
    """Compute jobs; one that fails is split until the failing case is alone.

    `count` receives each case that ends. `check` is called with the records of each job, and may
    end the study.

    Raises:
        CasesFailedError: a case failed, and `fail_fast` stops at failures.
        EnvironmentTroubleError: workers run other code.
    """
    waiting = deque(jobs)
    running: dict[Future[Outcome], Job] = {}
    outcomes: list[Outcome] = []
    count.executor = executor
    while waiting or running:
        while waiting and len(running) < executor.width:
            job = waiting.popleft()
            running[executor.submit(job, partial(count.store, job))] = job
        for future in wait(running, _BEAT_S, FIRST_COMPLETED).done:
            job = running.pop(future)
            outcome = _outcome(future, job)
            if outcome is None:
                count.end(job, 0)
                waiting.extendleft(reversed(job.halves))
                continue
            failures = _report(outcome.records, progress)
            if failures and fail_fast:
                first = failures[0]
                msg = f"stopped, for a case failed: {first.case}: {first.reason}"
                raise errors.CasesFailedError(msg)
            check(outcome.records)
            outcomes.append(outcome)
            count.failed += len(failures)
            count.end(job, len(outcome.records))
        count.advance(0.0)
    return outcomes


def _outcome(future: "Future[Outcome]", job: Job) -> Outcome | None:
    """Return the outcome of a job; None if it is to be split."""
    error = future.exception()
    if error is None:
        return future.result()
    of_one = errors.OutOfMemoryError | PluginError
    concerns_all = isinstance(error, errors.TiswarmError) and not isinstance(error, of_one)
    if concerns_all or not isinstance(error, Exception):
        raise error
    if len(job.cases) > 1:
        return None
    traceback = error.details if isinstance(error, PluginError) else ""
    record = job.folder.store_failure(failure(job.cases[0], reason(error)), traceback)
    return Outcome(records=[record], used=())


def _report(records: Sequence[CaseRecord], progress: Progress) -> list[CaseRecord]:
    """Report cases that failed and structures that ended early; return those that failed."""
    if not all(record.is_current for record in records):
        msg = "workers run other code; install the same tiswarm on all machines"
        raise errors.EnvironmentTroubleError(msg)
    failed = [record for record in records if not record.is_done]
    for record in failed:
        progress.info(f"case {record.case} failed: {record.reason}")
    ended = {record.seed: record.reason for record in records if record.is_done and record.reason}
    for seed, why in ended.items():
        progress.info(f"seed {seed}: growth ended: {why}")
    return failed
