"""Outcomes of a study: its jobs are computed by any executor, and their progress is shown."""

import shlex
from collections import deque
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait

from tiswarm.base.errors import (
    CasesFailedError,
    EnvironmentTroubleError,
    OutOfMemoryError,
    TiswarmError,
)
from tiswarm.base.plugins import PluginError
from tiswarm.base.progress import Progress
from tiswarm.study.executors import Executor, reason
from tiswarm.study.jobs import Job
from tiswarm.study.runner import Outcome, failure
from tiswarm.study.store import CaseRecord

_BEAT_S = 1.0
"""Longest time between two looks at the jobs, so that progress lines come while none ends."""


def compute(
    jobs: Sequence[Job], executor: Executor, progress: Progress, *, fail_fast: bool = False
) -> list[Outcome]:
    """Compute jobs; one that fails is split until the failing case is alone.

    `progress` receives a task whose steps are cases, with the number of those that failed.

    Raises:
        CasesFailedError: a case failed, and `fail_fast` stops at failures.
        EnvironmentTroubleError: workers run other code.
    """
    waiting = deque(jobs)
    running: dict[Future[Outcome], Job] = {}
    found: list[Outcome] = []
    failed = 0
    # A user can watch the cases from now on, wherever they are computed.
    progress.info(f"to watch: tiswarm view --live {shlex.quote(str(jobs[0].folder.path))}")
    total = sum(len(job.cases) for job in jobs)
    with progress.task("cases", total, lambda: f"{failed} failed" if failed else "") as advance:
        while waiting or running:
            while waiting and len(running) < executor.width:
                job = waiting.popleft()
                running[executor.submit(job)] = job
            for future in wait(running, _BEAT_S, FIRST_COMPLETED).done:
                job = running.pop(future)
                outcome = _outcome(future, job)
                if outcome is None:
                    waiting.extendleft(reversed(job.halves))
                    continue
                failures = _report(outcome.records, progress)
                if failures and fail_fast:
                    first = failures[0]
                    msg = f"stopped, for a case failed: {first.case}: {first.reason}"
                    raise CasesFailedError(msg)
                found.append(outcome)
                failed += len(failures)
                advance(len(outcome.records))
            advance(0.0)
    return found


def _outcome(future: "Future[Outcome]", job: Job) -> Outcome | None:
    """Return the outcome of a job; None if it is to be split."""
    error = future.exception()
    if error is None:
        return future.result()
    of_one = OutOfMemoryError | PluginError
    concerns_all = isinstance(error, TiswarmError) and not isinstance(error, of_one)
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
        raise EnvironmentTroubleError(msg)
    failed = [record for record in records if not record.is_done]
    for record in failed:
        progress.info(f"case {record.case} failed: {record.reason}")
    ended = {record.seed: record.reason for record in records if record.is_done and record.reason}
    for seed, why in ended.items():
        progress.info(f"seed {seed}: growth ended: {why}")
    return failed
