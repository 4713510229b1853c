"""Executors of jobs: this process, processes on this machine, or a Dask cluster.

A job in a process of its own may hang, crash or be killed without harm to others. Processes are
started by `subprocess`: those of `multiprocessing` are forbidden within workers of Dask, and would
need a guard in the scripts of users.
"""

import atexit
import gc
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, NamedTuple

from tiswarm.base.errors import EnvironmentTroubleError, InputError, TiswarmError
from tiswarm.base.process import child_command
from tiswarm.base.progress import Advance, Note, Progress, ignore
from tiswarm.compute import backend, kernel_cache
from tiswarm.scenario.model import Scenario
from tiswarm.study.runner import Job, OnStored, Outcome, run_job

START_S = 600.0  # time that a process has to start and to compile the kernels of a job
END_S = 10.0  # time that an idle process has to store its kernels and end
_LONGEST_POLL_S = 1e6  # the system counts milliseconds in 32 bits
_READY = "ready"
_STAGE_EVERY_S = 1.0  # least time between two messages on a stage
_CRASHES = {"SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGSEGV"}


@dataclass(frozen=True, kw_only=True)
class Execution:
    """Where and how the cases of a run are computed; no byte of the results depends on it."""

    workers: int | None = None  # processes that share the threads; None computes in this one
    scheduler: str | None = None  # address of a Dask scheduler whose workers see the same folders
    shard: tuple[int, int] = (1, 1)  # part to compute, and the number of parts
    case_limit_s: float | None = None  # longest wall time of a case [s]
    fail_fast: bool = False  # whether the first case that fails ends the run

    def __post_init__(self) -> None:
        """Raise InputError for values that exclude each other."""
        number, count = self.shard
        if not 1 <= number <= count:
            raise InputError(f"invalid shard {number}/{count}: use I/N with 1 <= I <= N")
        if self.workers is not None and self.scheduler is not None:
            problem = "a scheduler has workers of its own; leave one out"
            raise InputError(problem, argument="workers")
        limit = self.case_limit_s
        if limit is not None and not 0.0 < limit < math.inf:
            problem = f"{limit:g} should be a number of seconds above 0; leave it out for no limit"
            raise InputError(problem, argument="case_limit_s")

    @property
    def processes(self) -> int:
        """Processes of this machine that compute jobs beside the one that starts them."""
        if self.scheduler is not None:
            return 0
        return self.workers or int((self.workers, self.case_limit_s) != (None, None))


def require_cores(points: Collection[Scenario]) -> None:
    """Refuse threads and workers of a scenario beyond the cores that this process may use.

    Raises:
        EnvironmentTroubleError: a point asks for more.
    """
    most = backend.available_threads()
    for key in ("threads", "workers"):
        asked = max(getattr(settings, key) or 0 for settings in points)
        if asked > most:
            problem = f"{key}: {asked} are more than the {most} cores of this process"
            raise EnvironmentTroubleError(f"{problem}; choose fewer")


class _JobError(Exception):
    """A job could not be done, for the reason in the text."""


class _CrashError(_JobError):
    """Machine code crashed, perhaps that of a damaged kernel."""


class Executor(NamedTuple):
    """Starts jobs, `width` at the same time, each with so many CPU threads; all if None."""

    submit: Callable[[Job, OnStored], "Future[Outcome]"]
    width: int
    threads: int | None

    @property
    def stage(self) -> str:
        """What one of the processes does that compute jobs; empty without any."""
        return next((process.stage for process in list(_running) if process.stage), "")


@contextmanager
def open_executor(
    execution: Execution, threads: int | None, progress: Progress
) -> Iterator[Executor]:
    """Open an executor; jobs that still run when the block ends are stopped.

    `threads` are CPU threads in all, or of each job on a cluster. `progress` receives the progress
    of jobs that this process computes.

    Raises:
        EnvironmentTroubleError: Dask is not installed, or no scheduler answers.
    """
    limit = execution.case_limit_s
    _ending.clear()
    if execution.scheduler is not None:
        from tiswarm.study.cluster import connected  # noqa: PLC0415 - needs an extra

        with connected(execution.scheduler) as (remote, width):
            try:
                yield Executor(
                    lambda job, _on_stored: remote.submit(_run_in_process, job, limit),
                    width,
                    threads or 1,
                )
            finally:
                _end_all()  # processes of a cluster within this process
    elif execution.processes:
        width = execution.processes
        with ThreadPoolExecutor(width) as waiting:
            try:
                job_threads = max(1, (threads or backend.available_threads()) // width)
                yield Executor(
                    lambda job, on_stored: waiting.submit(_run_in_process, job, limit, on_stored),
                    width,
                    job_threads,
                )
            finally:
                waiting.shutdown(wait=False, cancel_futures=True)
                _end_all()
    else:
        yield Executor(
            lambda job, on_stored: _run_in_this_process(job, progress, on_stored), 1, threads
        )


def _run_in_this_process(job: Job, progress: Progress, on_stored: OnStored) -> "Future[Outcome]":
    done: Future[Outcome] = Future()
    try:
        done.set_result(run_job(job, progress, on_stored=on_stored))
    except Exception as error:  # noqa: BLE001 - the caller raises it from the future
        done.set_exception(error)
    return done


def reason(error: BaseException) -> str:
    """Write in one line why a job could not be done."""
    kind = "" if isinstance(error, _JobError | TiswarmError) else type(error).__name__
    return ": ".join(filter(None, (kind, " ".join(str(error).split()))))


# --- processes -------------------------------------------------------------------------------

_running: set["_Process"] = set()
_ending = threading.Event()  # set once processes of this run are to end
_of_thread = threading.local()


def _run_in_process(job: Job, limit_s: float | None, on_stored: OnStored = ignore) -> Outcome:
    """Run a job in another process; where machine code crashes it, once more with new kernels."""
    try:
        return _attempt(job, limit_s, on_stored)
    except _CrashError as crash:
        if not kernel_cache.clear(Path(backend.current().cache)):
            raise
        sys.stderr.write(f"tiswarm: warning: {crash}; kernel cache cleared, trying once more\n")
        return _attempt(job, limit_s, on_stored)


def _attempt(job: Job, limit_s: float | None, on_stored: OnStored) -> Outcome:
    """Run a job in the process of this thread, which is replaced after any failure."""
    process: _Process = getattr(_of_thread, "process", None) or _Process()
    _of_thread.process = None
    try:
        outcome = process.run(job, limit_s, on_stored)
    except BaseException:
        process.end()
        raise
    _of_thread.process = process
    return outcome


class _Stage(str):
    """What a process does, and how far it is."""

    __slots__ = ()


class _Stored(NamedTuple):
    """Cases that a process has just stored."""

    cases: float


class _Sent(Progress):
    """Sends the stages of a job to the process that waits for it."""

    def __init__(self, send: Callable[[object], None]) -> None:
        self.send = send

    @contextmanager
    def task(
        self,
        name: str,
        total: int,
        note: Note = lambda: "",  # noqa: ARG002 - the stages of a job have none
        done: int = 0,
    ) -> Iterator[Advance]:
        so_far = float(done)
        sent_s = -math.inf

        def advance(steps: float) -> None:
            nonlocal so_far, sent_s
            so_far += steps
            now_s = time.monotonic()
            if now_s - sent_s >= _STAGE_EVERY_S:
                sent_s = now_s
                self.send(_Stage(f"{name} {so_far:.0f} of {total}"))

        advance(0.0)
        yield advance


class _Process:
    """A process that runs one job after another."""

    def __init__(self) -> None:
        self.is_idle = True
        self.stage = ""
        self.output = TemporaryFile()  # noqa: SIM115 - closed as the process ends
        self.connection, child_end = Pipe()
        code = "from tiswarm.study.executors import main; main({}, {})"
        self.process = subprocess.Popen(  # noqa: S603 - our own code
            child_command(code.format(child_end.fileno(), os.getpid())),
            stdin=subprocess.DEVNULL,
            stdout=self.output,
            stderr=self.output,
            pass_fds=[child_end.fileno()],
        )
        child_end.close()
        _running.add(self)
        if _ending.is_set():
            self.end()

    def run(self, job: Job, limit_s: float | None, on_stored: OnStored) -> Outcome:
        """Run a job, unless it takes longer than allowed for all of its cases."""
        self.is_idle = False
        with suppress(OSError):  # the process has ended; receiving finds out why
            self.connection.send(job)
        message = self._receive(START_S, "its process did not start within {:g} s; run it again")
        if message == _READY:
            total_s = None if limit_s is None else limit_s * len(job.cases)
            problem = "took longer than {:g} s; raise --case-limit"
            message = self._receive(total_s, problem, on_stored)
        self.stage = ""
        if isinstance(message, TiswarmError):
            raise message
        if not isinstance(message, Outcome):
            raise _JobError(message)
        self.is_idle = True
        return message

    def dismiss(self) -> None:
        """Let the process store the kernels it has compiled and end, if it has nothing to do."""
        if self.is_idle:
            self.connection.close()

    def end(self) -> None:
        """Wait for the end of the process if it was dismissed, or else kill it."""
        if self in _running:
            _running.discard(self)
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(END_S if self.connection.closed else 0.0)
            self.process.kill()
            self.process.wait()
            self.connection.close()
            self.output.close()

    def _receive(self, limit_s: float | None, problem: str, on_stored: OnStored = ignore) -> object:
        end_s = math.inf if limit_s is None else time.monotonic() + limit_s
        try:
            while True:
                remaining_s = end_s - time.monotonic()
                if self.connection.poll(max(0.0, min(_LONGEST_POLL_S, remaining_s))):
                    message = self.connection.recv()
                    if isinstance(message, _Stage):
                        self.stage = message
                    elif isinstance(message, _Stored):
                        on_stored(message.cases)
                    else:
                        return message
                elif remaining_s <= _LONGEST_POLL_S:
                    raise _JobError(problem.format(limit_s))
        except (EOFError, OSError) as error:
            raise self._cause_of_death() from error

    def _cause_of_death(self) -> _JobError:
        status = self.process.wait()
        if status < 0:
            name = signal.Signals(-status).name
            hint = ", perhaps for lack of memory" if name == "SIGKILL" else ""
            kind = _CrashError if name in _CRASHES else _JobError
            return kind(f"its process was killed by {name}{hint}")
        self.output.seek(0)
        lines = self.output.read().decode(errors="replace").splitlines() or ["without a message"]
        return _JobError(f"its process ended with status {status}: {lines[-1]}")


def _end_all() -> None:
    _ending.set()
    ended = list(_running)
    for process in ended:
        process.dismiss()
    for process in ended:
        process.end()


def main(descriptor: int, parent: int) -> None:
    """Run the jobs that arrive at a connection, and send back the outcome of each."""
    gc.set_threshold(50_000, 20, 100)  # as for a command
    atexit.register(gc.freeze)
    threading.Thread(target=_end_with, args=[parent], daemon=True).start()
    connection: Connection[object, Any] = Connection(descriptor)
    with suppress(EOFError):
        while True:
            job = connection.recv()
            message: Outcome | TiswarmError | str
            try:
                progress = _Sent(connection.send)
                message = run_job(
                    job,
                    progress,
                    on_ready=lambda: connection.send(_READY),
                    on_stored=lambda cases: connection.send(_Stored(cases)),
                )
            except TiswarmError as error:
                message = error
            except Exception as error:  # noqa: BLE001 - the parent decides what to do
                message = reason(error)
            connection.send(message)


def _end_with(parent: int) -> None:
    """End this process once its parent has ended, as nobody waits for the outcome then."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)
