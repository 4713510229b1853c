"""Where jobs are done: here, in processes of their own, or on a Dask cluster.

A job in a process of its own may hang, crash or be killed without harm to others.
"""

import os
import pickle
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import IO, Any, cast

from tiswarm.compute.backend import available_threads
from tiswarm.errors import EnvironmentTroubleError, TiswarmError
from tiswarm.progress import Progress
from tiswarm.records.messages import counted
from tiswarm.study.slurm import Slurm, submitted
from tiswarm.study.work import Job, Outcome, work_off

CONNECT_S = 30
"""How long a scheduler may take to answer [s]."""

_running: set["_Process"] = set()
_own = threading.local()


@dataclass(frozen=True, kw_only=True)
class Dispatch:
    """Where and how the cases of a run are computed; it changes no byte of what comes out."""

    workers: int | None = None
    """Processes side by side, each with its share of the threads; none of their own if None."""

    scheduler: str | None = None
    """Address of a Dask scheduler whose workers see the same folders."""

    slurm: Slurm | None = None
    """Jobs of SLURM to compute in, which see the same folders."""

    shard: tuple[int, int] = (1, 1)
    """Which part of how many this run computes."""

    case_limit_s: float | None = None
    """Wall time that each case may take [s]."""

    fail_fast: bool = False
    """Whether the first case that fails ends the run."""

    @property
    def is_remote(self) -> bool:
        """Whether cases are computed on other machines."""
        return self.scheduler is not None or self.slurm is not None


class WorkError(Exception):
    """A job could not be done; the text says why."""


@dataclass(frozen=True, kw_only=True)
class Pool:
    """Takes jobs."""

    submit: Callable[[Job], "Future[Outcome]"]
    width: int
    """Jobs done at the same time."""

    threads: int | None
    """CPU threads for each job; all if None."""


@contextmanager
def opened(dispatch: Dispatch, threads: int | None, progress: Progress) -> Iterator[Pool]:
    """Open a pool; jobs that still run when the block ends early are stopped.

    Args:
        dispatch: Where jobs are done.
        threads: CPU threads; all of the machine, or one on a cluster, if None.
        progress: Receives the progress of jobs done here.
    """
    limit = dispatch.case_limit_s
    if dispatch.slurm is not None:
        slurm, each = dispatch.slurm, threads or 1
        with submitted(slurm, each) as cluster, _connected(cluster) as client:
            progress.info(f"submitted {counted(slurm.jobs, 'SLURM job')}; cases start when jobs do")
            width = slurm.jobs * max(1, slurm.cores // each)
            yield Pool(submit=_submit(client, limit), width=width, threads=each)
    elif dispatch.scheduler is not None:
        with _connected(dispatch.scheduler) as client:
            width = max(1, sum(client.nthreads().values()))
            yield Pool(submit=_submit(client, limit), width=width, threads=threads or 1)
    elif dispatch.workers is not None or limit is not None:
        width = dispatch.workers or 1
        with _threads(width) as executor:
            yield Pool(
                submit=lambda job: executor.submit(_in_own_process, job, limit),
                width=width,
                threads=max(1, (threads or available_threads()) // width),
            )
    else:
        yield Pool(submit=lambda job: _at_once(job, progress), width=1, threads=threads)


def _at_once(job: Job, progress: Progress) -> "Future[Outcome]":
    done: Future[Outcome] = Future()
    try:
        done.set_result(work_off(job, progress))
    except Exception as error:  # noqa: BLE001 - whoever looks at the result is told
        done.set_exception(error)
    return done


@contextmanager
def _threads(count: int) -> Iterator[ThreadPoolExecutor]:
    """Run threads that wait for processes; these end with the block, whatever they do."""
    with ThreadPoolExecutor(count) as executor:
        try:
            yield executor
        finally:
            executor.shutdown(wait=False, cancel_futures=True)
            _end_all()


def _submit(client: Any, limit_s: float | None) -> Callable[[Job], "Future[Outcome]"]:  # noqa: ANN401 - untyped
    cluster = client.get_executor(pure=False)
    return lambda job: cluster.submit(_in_own_process, job, limit_s)


@contextmanager
def _connected(address: Any) -> Iterator[Any]:  # noqa: ANN401 - a text, or a cluster without types
    try:
        from distributed import Client  # noqa: PLC0415 - an extra, and slow to import
    except ImportError as error:
        msg = "--scheduler needs Dask; pip install 'tiswarm[cluster]'"
        raise EnvironmentTroubleError(msg) from error
    try:
        client: Any = Client(address, timeout=CONNECT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        msg = f"no Dask scheduler answers at {address}; start one, or correct --scheduler"
        raise EnvironmentTroubleError(msg) from error
    with client:
        try:
            yield client
        finally:
            _end_all()  # of a cluster within this process, as tests have it


def _in_own_process(job: Job, limit_s: float | None) -> Outcome:
    """Do a job in the process of this thread, which is started anew after any failure.

    Raises:
        WorkError: the job raised, took too long, or its process was killed.
    """
    process: _Process = getattr(_own, "process", None) or _Process()
    try:
        outcome = process.do(job, limit_s)
    except BaseException:
        process.end()
        _own.process = None
        raise
    _own.process = process
    return outcome


class _Process:
    """A process that does one job after another."""

    def __init__(self) -> None:
        """Start it."""
        self.told = TemporaryFile()  # noqa: SIM115 - closed as it ends
        self.process = subprocess.Popen(
            [sys.executable, "-c", "from tiswarm.study.pool import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.told,
        )
        self.jobs = cast("IO[bytes]", self.process.stdin)
        self.answers = cast("IO[bytes]", self.process.stdout)
        self.is_ready = False
        _running.add(self)

    def do(self, job: Job, limit_s: float | None) -> Outcome:
        """Do a job, unless it takes longer than allowed for each of its cases."""
        if not self.is_ready:
            self.is_ready = bool(self._answer(None))
        with suppress(BrokenPipeError):  # it has died, and what comes next will tell
            _write(job, self.jobs)
        found = self._answer(None if limit_s is None else limit_s * len(job.cases))
        if isinstance(found, TiswarmError):
            raise found
        if not isinstance(found, Outcome):
            raise WorkError(found)
        return found

    def end(self) -> None:
        """Kill it, unless that is done."""
        if self not in _running:
            return
        _running.discard(self)
        self.process.kill()
        self.process.communicate()
        self.told.close()

    def _answer(self, limit_s: float | None) -> object:
        if not select.select([self.answers], [], [], limit_s)[0]:
            msg = f"took longer than {limit_s:g} s; give --case-limit more"
            raise WorkError(msg)
        try:
            return pickle.load(self.answers)  # noqa: S301 - from this very program
        except EOFError as error:
            raise WorkError(self._last_words()) from error

    def _last_words(self) -> str:
        status = self.process.wait()
        if status < 0:
            name = signal.Signals(-status).name
            hint = ", perhaps for want of memory" if name == "SIGKILL" else ""
            return f"its process was killed by {name}{hint}"
        self.told.seek(0)
        words = self.told.read().decode(errors="replace").splitlines()
        return f"its process ended with status {status}: {(words or ['it said nothing'])[-1]}"


def _end_all() -> None:
    for process in list(_running):
        process.end()


def reason(error: BaseException) -> str:
    """Say in one line why a job could not be done."""
    kind = "" if isinstance(error, WorkError) else type(error).__name__
    return ": ".join(filter(None, (kind, " ".join(str(error).split()))))


def main() -> None:
    """Do the jobs that come in on standard input and write what came of each to standard output.

    At first it says that it is ready.
    """
    threading.Thread(target=_end_with, args=[os.getppid()], daemon=True).start()
    stream = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not mix with the answers
    found: Outcome | TiswarmError | str
    _write("ready", stream)
    while True:
        try:
            job = pickle.load(sys.stdin.buffer)  # noqa: S301 - from the process that started this
        except EOFError:
            return
        try:
            found = work_off(job, Progress())
        except TiswarmError as error:
            found = error
        except Exception as error:  # noqa: BLE001 - the parent decides what comes of it
            found = reason(error)
        _write(found, stream)


def _write(found: object, stream: IO[bytes]) -> None:
    pickle.dump(found, stream)
    stream.flush()


def _end_with(parent: int) -> None:
    """End once the parent has, for then nobody waits for the outcome any more."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)
