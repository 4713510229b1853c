"""Runs a scenario case by case; goes on where an earlier run ended."""

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from pathlib import Path

from tiswarm.compute import backend
from tiswarm.errors import CasesFailedError, InputError, TiswarmError
from tiswarm.params import Arch
from tiswarm.progress import Progress
from tiswarm.records.messages import counted
from tiswarm.scenario import Scenario, load_scenario
from tiswarm.study import manifest, tables
from tiswarm.study.cases import ROBOTS_AT_ONCE, Case, chunks, halves, plan, robots_to_grow, shard
from tiswarm.study.pool import Dispatch, Pool, opened, reason
from tiswarm.study.scaling import write_scaling
from tiswarm.study.storage import DONE, FAILED, CaseRecord, RunFolder, write_table
from tiswarm.study.work import Job, Outcome, failure

PLAIN = Dispatch()

WHOLE = (manifest.FILE, "report.html")
"""Files that tell of a whole run, which it is not while cases are computed."""

CHUNKS_EACH = 4
"""Chunks for each process of a pool, so that all end at about the same time."""


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """What a run left behind."""

    folder: Path
    computed: int
    """Cases computed now."""

    found: int
    """Cases that an earlier run had finished."""

    failed: tuple[CaseRecord, ...]
    missing: int
    """Cases left to other shards that are not there yet; tables are written once none is."""

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
    arch: Arch = "cpu",
    threads: int | None = None,
    dispatch: Dispatch = PLAIN,
) -> RunResult:
    """Compute every case that is not yet stored, then write the tables.

    Args:
        scenario: What to compute.
        parent: Folder that holds the run's folder.
        progress: Receives progress reports.
        arch: Device.
        threads: CPU threads; all if None.
        dispatch: Where cases are computed, and which.

    Raises:
        CasesFailedError: a case failed and the run was to stop there.
    """
    if not dispatch.is_remote:  # a device that is not there is told before anything is written
        backend.start(arch, threads=threads)
    folder = RunFolder.of(scenario, parent)
    cases = plan(scenario)
    mine = shard(cases, *dispatch.shard)
    part = "" if dispatch.shard == PLAIN.shard else "{}-of-{}".format(*dispatch.shard)
    with folder.held(part):
        stored = ((case, folder.stored(case.name)) for case in mine)
        records = {case.name: record for case, record in stored if record is not None}
        missing = [case for case in mine if case.name not in records]
        found = len(records)
        if found:
            progress.info(f"{found} of {len(mine)} cases are already stored")
        if outdated := sum(folder.is_outdated(case.name) for case in missing):
            was, them = ("was", "it") if outdated == 1 else ("were", "them")
            many = counted(outdated, "case")
            progress.info(f"{many} {was} computed by other code; computing {them} again")
        used = None
        if missing:
            for name in WHOLE:
                (folder.path / name).unlink(missing_ok=True)
            with opened(dispatch, threads, progress) as pool:
                for outcome in _compute(missing, folder, pool, arch, dispatch, progress):
                    records |= {record.case: record for record in outcome.records}
                    used = outcome.backend or used
        failed = tuple(record for record in records.values() if record.status == FAILED)
        others = {case.name for case in cases} - set(records)
        elsewhere = {name: folder.recorded(name) for name in others}
        records |= {name: record for name, record in elsewhere.items() if record is not None}
        result = RunResult(
            folder=folder.path,
            computed=len(missing),
            found=found,
            failed=failed,
            missing=len(cases) - len(records),
        )
        if not result.missing:
            if used is not None or not (folder.path / manifest.FILE).exists():
                costs = [folder.cost(case.name) for case in cases]
                described = manifest.describe(used or backend.current(), costs)
                manifest.write_manifest(folder.path, described | {"cases": len(cases)})
            write_tables(folder, cases, [records[case.name] for case in cases])
            if all(record.status == DONE for record in records.values()):
                folder.forget_grown()
    return result


def write_tables(folder: RunFolder, cases: Sequence[Case], records: Sequence[CaseRecord]) -> None:
    """Write the tables of a run from the cases."""
    settings = [case.settings for case in cases]
    write_table(tables.summary(records, settings), folder.path / "summary.csv")
    write_table(tables.table(records, settings), folder.path / "table.csv")
    write_table(tables.paired(records), folder.path / "paired.csv")
    write_table(tables.profiles(records, folder.cases), folder.path / "profiles.csv")
    write_scaling(folder, cases, {record.case: record for record in records})


def tabulate(path: Path) -> None:
    """Write the tables of a run folder anew from its stored cases.

    Raises:
        InputError: where `path` is not a run folder.
    """
    resolved = path / "scenario.yaml"
    if not resolved.is_file():
        msg = "this is no run folder, for it holds no scenario.yaml; give one that a run made"
        raise InputError(msg, path=path)
    folder = RunFolder(path)
    stored = [(case, folder.recorded(case.name)) for case in plan(load_scenario(resolved))]
    kept = [(case, record) for case, record in stored if record is not None]
    write_tables(folder, [case for case, _ in kept], [record for _, record in kept])


def _compute(
    missing: Sequence[Case],
    folder: RunFolder,
    pool: Pool,
    arch: Arch,
    dispatch: Dispatch,
    progress: Progress,
) -> Iterator[Outcome]:
    """Compute cases in chunks; a chunk that cannot be done is split until the culprit is alone."""
    waiting = deque(chunks(missing, _robots_at_once(missing, pool, dispatch)))
    flying: dict[Future[Outcome], list[Case]] = {}
    while waiting or flying:
        while waiting and len(flying) < pool.width:
            chunk = waiting.popleft()
            job = Job(folder=folder, cases=chunk, arch=arch, threads=pool.threads)
            flying[pool.submit(job)] = chunk
        for future in wait(flying, return_when=FIRST_COMPLETED).done:
            chunk = flying.pop(future)
            outcome = _outcome(future, chunk, folder)
            if outcome is None:
                waiting.extendleft(reversed(halves(chunk)))
                continue
            _tell(outcome.records, progress)
            first = next((r for r in outcome.records if r.status == FAILED), None)
            if first is not None and dispatch.fail_fast:
                msg = f"stopped, for a case failed: {first.case}: {first.reason}"
                raise CasesFailedError(msg)
            yield outcome


def _robots_at_once(missing: Sequence[Case], pool: Pool, dispatch: Dispatch) -> int:
    """Size of a chunk: large, but small enough to keep a pool busy and to tell who hangs."""
    if dispatch.case_limit_s is not None:
        return 1
    if pool.width == 1:
        return ROBOTS_AT_ONCE
    return min(ROBOTS_AT_ONCE, robots_to_grow(missing) // (CHUNKS_EACH * pool.width) + 1)


def _outcome(future: "Future[Outcome]", chunk: list[Case], folder: RunFolder) -> Outcome | None:
    """What came of a chunk; None if it is to be split.

    Raises:
        TiswarmError: trouble that every other case would have too.
    """
    error = future.exception()
    if error is None:
        return future.result()
    if isinstance(error, TiswarmError) or not isinstance(error, Exception):
        raise error
    if len(chunk) > 1:
        return None
    record = failure(chunk[0], reason(error))
    folder.store_failure(record)
    return Outcome(records=[record], backend=None)


def _tell(records: Sequence[CaseRecord], progress: Progress) -> None:
    """Say which cases failed, and which structures ended early."""
    ended = {}
    for record in records:
        if record.status == FAILED:
            progress.info(f"case {record.case} failed: {record.reason}")
        elif record.reason:
            ended[record.seed] = record.reason
    for seed, why in ended.items():
        progress.info(f"seed {seed}: growth ended: {why}")
