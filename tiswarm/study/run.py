"""Runs a scenario case by case, and continues where an earlier run ended."""

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from pathlib import Path

from tiswarm.base.errors import (
    CasesFailedError,
    EnvironmentTroubleError,
    InputError,
    OutOfMemoryError,
    TiswarmError,
)
from tiswarm.base.params import AnyArch, Arch
from tiswarm.base.progress import Progress
from tiswarm.compute import backend
from tiswarm.localization import registry
from tiswarm.records.frames import write_frame
from tiswarm.records.io import run_file
from tiswarm.records.messages import counted
from tiswarm.records.run_folder import read_manifest, write_manifest
from tiswarm.scenario.expansion import load_scenario, variants
from tiswarm.scenario.model import Scenario
from tiswarm.study import tables
from tiswarm.study.cases import ROBOTS_AT_ONCE, Case, batches, halves, plan, shard, structures
from tiswarm.study.executors import Execution, Executor, open_executor, reason
from tiswarm.study.provenance import Used, manifest
from tiswarm.study.runner import Job, Outcome, failure
from tiswarm.study.scaling import scaling
from tiswarm.study.store import CaseRecord, RunFolder, remove

_HERE = Execution()
_BATCHES_EACH = 4
"""Batches for each process of an executor, so that all end at about the same time."""


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
        """How many cases failed, and why the first of them did."""
        many, first = counted(len(self.failed), "case"), self.failed[0]
        return f"{many} failed, the first: {first.case}: {first.reason}"


def run(
    scenario: Scenario,
    parent: Path,
    *,
    progress: Progress,
    arch: AnyArch = "cpu",
    threads: int | None = None,
    execution: Execution = _HERE,
) -> RunResult:
    """Compute every case that is not yet stored, then write the tables.

    Args:
        scenario: What to compute.
        parent: Folder that holds the run's folder.
        progress: Receives progress reports.
        arch: Device of methods that are `registry.PARALLEL`; other stages run on the processor.
        threads: CPU threads; all if None.
        execution: Where cases are computed, and which.

    Raises:
        CasesFailedError: a case failed and `execution` stops at failures.
        EnvironmentTroubleError: the device is missing, the folder is in use, or workers run
            other code.
    """
    arch = _start_device(scenario, arch, threads, execution, progress)
    folder = RunFolder.of(scenario, parent)
    cases = plan(scenario)
    mine = shard(cases, *execution.shard)
    part = "" if execution.shard == _HERE.shard else "{}-of-{}".format(*execution.shard)
    with folder.locked(part):
        stored = folder.read_cases(mine)
        stored = {name: record for name, record in stored.items() if record.is_done}
        records = {name: record for name, record in stored.items() if record.is_current}
        missing = [case for case in mine if case.name not in records]
        if found := len(records):
            progress.info(f"{found} of {len(mine)} cases are already stored")
        if outdated := len(stored) - found:
            were, them = ("was", "it") if outdated == 1 else ("were", "them")
            many = counted(outdated, "case")
            progress.info(f"{many} {were} computed by other code; computing {them} again")
        used: set[Used] = set()
        if missing:
            for name in ("manifest.json", "report.html"):  # they describe a complete run
                remove(folder.path / name)
            with open_executor(execution, threads, progress) as executor:
                for outcome in _compute(missing, folder, executor, arch, execution, progress):
                    records |= {record.case: record for record in outcome.records}
                    used.update(outcome.used)
        failed = tuple(record for record in records.values() if not record.is_done)
        others = folder.read_cases([case for case in cases if case.name not in records])
        records |= {name: record for name, record in others.items() if record.is_current}
        result = RunResult(
            folder=folder.path,
            computed=len(missing),
            found=found,
            failed=failed,
            missing=len(cases) - len(records),
        )
        if not result.missing:
            if not _has_manifest(folder.path):
                costs = [folder.read_cost(case.name) for case in cases]
                write_manifest(
                    folder.path, manifest(used or {Used("grow", backend.current())}, costs)
                )
            _write_tables(folder, cases, [records[case.name] for case in cases])
            if all(record.is_done for record in records.values()):
                folder.remove_structures()
    return result


def _start_device(
    scenario: Scenario,
    arch: AnyArch,
    threads: int | None,
    execution: Execution,
    progress: Progress,
) -> Arch:
    """Start the device of a study before anything is written, and return its name.

    On a cluster, only its workers can start it.
    """
    points = [variant.settings for variant in variants(scenario)]
    titles = {registry.title(settings.localization) for settings in points}
    if execution.scheduler is not None:
        if arch == "auto":
            raise InputError("auto cannot see the workers; name their device", argument="arch")
        for settings in points:
            registry.require_use(titles, arch, settings.precision)
        return arch
    for precision in sorted({settings.precision for settings in points}):
        running = registry.start_device(titles, arch, threads=threads, precision=precision)
    if arch != "cpu":
        progress.info(registry.where(titles, running))
    return running.arch


def _has_manifest(run: Path) -> bool:
    try:
        return bool(read_manifest(run).tiswarm)
    except InputError:
        return False


def _write_tables(folder: RunFolder, cases: Sequence[Case], records: Sequence[CaseRecord]) -> None:
    settings = [case.settings for case in cases]
    costs = [folder.read_cost(case.name) for case in cases]
    written = {
        "summary": tables.summary(records, settings),
        "table": tables.table(records, settings),
        "paired": tables.paired(records, settings),
        "profiles": tables.profiles(records, folder.cases),
    }
    if len({setting.robots for setting in settings}) > 1:
        written["scaling"] = scaling(cases, records, costs)
    if {setting.sensing.suite for setting in settings} != {"fireant-v3"}:
        written["suites"] = tables.suites(records, settings, folder.cases)
    for name, content in written.items():
        write_frame(content, folder.path / f"{name}.csv")


def open_folder(path: Path) -> tuple[RunFolder, list[Case]]:
    """Open the folder of a run, finished or not; returns it and all cases of its scenario.

    Raises:
        InputError: it is no folder of a run.
    """
    resolved = path / "scenario.yaml"
    if not resolved.exists():
        msg = "this is no run folder: it has no scenario.yaml; give a folder that a run made"
        raise InputError(msg, path=path)
    return RunFolder(path), plan(load_scenario(run_file(resolved)))


def tabulate(path: Path, progress: Progress) -> None:
    """Write the tables of a run folder again, from its stored cases.

    Raises:
        InputError: it is no folder of a run, or no case is intact.
    """
    folder, cases = open_folder(path)
    stored = folder.read_cases(cases)
    kept = [case for case in cases if case.name in stored]
    if not kept:
        problem = "no case of this run is intact; run the scenario again to restore them"
        raise InputError(problem, path=path)
    if lost := len(cases) - len(kept):
        many = counted(lost, "case")
        progress.info(f"without {many}, missing or damaged; run the scenario again to restore")
    _write_tables(folder, kept, [stored[case.name] for case in kept])


def _compute(
    missing: Sequence[Case],
    folder: RunFolder,
    executor: Executor,
    arch: Arch,
    execution: Execution,
    progress: Progress,
) -> Iterator[Outcome]:
    """Compute cases in batches; a batch that fails is split until the failing case is alone."""
    waiting = deque(batches(missing, _robots_at_once(missing, executor, execution)))
    running: dict[Future[Outcome], list[Case]] = {}
    while waiting or running:
        while waiting and len(running) < executor.width:
            batch = waiting.popleft()
            job = Job(folder=folder, cases=batch, arch=arch, threads=executor.threads)
            running[executor.submit(job)] = batch
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            batch = running.pop(future)
            outcome = _outcome(future, batch, folder)
            if outcome is None:
                waiting.extendleft(reversed(halves(batch)))
                continue
            if not all(record.is_current for record in outcome.records):
                msg = "workers run other code; install the same tiswarm on all machines"
                raise EnvironmentTroubleError(msg)
            _report(outcome.records, progress)
            first = next((record for record in outcome.records if not record.is_done), None)
            if first is not None and execution.fail_fast:
                raise CasesFailedError(f"stopped, for a case failed: {first.case}: {first.reason}")
            yield outcome


def _robots_at_once(missing: Sequence[Case], executor: Executor, execution: Execution) -> int:
    """Choose the size of a batch: large, but enough batches to keep all processes busy."""
    if execution.case_limit_s is not None:  # one structure each, to find the one that hangs
        return 1
    if executor.width == 1:
        return ROBOTS_AT_ONCE
    robots = sum(group[0].settings.robots for group in structures(missing))
    return min(ROBOTS_AT_ONCE, robots // (_BATCHES_EACH * executor.width) + 1)


def _outcome(future: "Future[Outcome]", batch: list[Case], folder: RunFolder) -> Outcome | None:
    """Return the outcome of a batch; None if it is to be split."""
    error = future.exception()
    if error is None:
        return future.result()
    concerns_all = isinstance(error, TiswarmError) and not isinstance(error, OutOfMemoryError)
    if concerns_all or not isinstance(error, Exception):
        raise error
    if len(batch) > 1:
        return None
    record = failure(batch[0], reason(error))
    folder.store_failure(record)
    return Outcome(records=[record], used=())


def _report(records: Sequence[CaseRecord], progress: Progress) -> None:
    """Report cases that failed and structures that ended early."""
    for record in records:
        if not record.is_done:
            progress.info(f"case {record.case} failed: {record.reason}")
    ended = {record.seed: record.reason for record in records if record.is_done and record.reason}
    for seed, why in ended.items():
        progress.info(f"seed {seed}: growth ended: {why}")
