"""Studies on a Dask cluster whose parts are killed, and two studies at one scheduler."""

import json
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from tests.runs import REPOSITORY, assert_same_results, call, environment, run_tower

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

SMALL = ("robots=8", "seeds=6", "conditions={a: {}}")
CASES = 6
WAIT_S = 300.0


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """Folder of an undisturbed run in this process."""
    return run_tower(tmp_path_factory.mktemp("whole"), SMALL).folder


@contextmanager
def _dask(program: str, *options: object):
    """Run a program of Dask in a process of its own, on this machine alone."""
    command = [sys.executable, "-m", f"distributed.cli.dask_{program}", *map(str, options)]
    with subprocess.Popen(
        [*command, "--host", "127.0.0.1", "--no-dashboard"],
        cwd=REPOSITORY, env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    ) as process:  # fmt: skip
        try:
            yield process
        finally:
            process.kill()


class _Cluster:
    """A scheduler and two workers; `kill` ends one of them without a word."""

    def __init__(self, processes: ExitStack, folder: Path, port: int = 0) -> None:
        note = folder / f"scheduler-{port}.json"
        self.scheduler = processes.enter_context(
            _dask("scheduler", "--port", port, "--scheduler-file", note)
        )
        _wait_for(note.exists)
        self.address = json.loads(note.read_text())["address"]
        self.port = int(self.address.rpartition(":")[2])
        single = (self.address, "--nthreads", 1, "--no-nanny", "--local-directory", folder)
        self.workers = [processes.enter_context(_dask("worker", *single)) for _ in range(2)]
        with distributed.Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=WAIT_S)


def _wait_for(event) -> None:
    until = time.monotonic() + WAIT_S
    while not event():
        assert time.monotonic() < until
        time.sleep(0.05)


@pytest.fixture
def cluster(tmp_path):
    """Return a cluster of two workers of one thread each."""
    with ExitStack() as processes:
        yield _Cluster(processes, tmp_path)


@contextmanager
def _killed_amid(out: Path, victim: "subprocess.Popen[bytes]"):
    """Kill a process as soon as a case is stored."""

    def kill() -> None:
        _wait_for(lambda: [*out.glob("*/cases/[!.]*")])
        victim.kill()

    with ThreadPoolExecutor() as pool:
        killing = pool.submit(kill)
        yield
        killing.result()


def _command(out: Path, address: str):
    settings = [part for text in SMALL for part in ("--set", text)]
    return call(
        "run", "tests/tower.yaml", *settings, "--no-pictures", "--out", out,
        "--scheduler", address, "--quiet",
    )  # fmt: skip


def test_a_worker_that_is_killed_costs_no_byte(cluster, whole, tmp_path):
    """Its jobs are computed by the other worker."""
    with _killed_amid(tmp_path / "out", cluster.workers[0]):
        result = run_tower(tmp_path / "out", SMALL, scheduler=cluster.address)

    assert (result.computed, result.failed) == (CASES, ())
    assert_same_results(whole, result.folder)


def test_a_run_without_its_scheduler_ends_and_resumes(cluster, whole, tmp_path):
    """The command ends with one line and status 1; a run without a cluster finds what is done."""
    with _killed_amid(tmp_path / "out", cluster.scheduler):
        done = _command(tmp_path / "out", cluster.address)
    resumed = run_tower(tmp_path / "out", SMALL)

    lost = f"the Dask scheduler at {cluster.address} was lost; start it, then run again"
    assert (done.returncode, done.stderr) == (1, f"tiswarm: error: {lost} to continue\n")
    assert resumed.found > 0
    assert_same_results(whole, resumed.folder)


def test_a_run_survives_a_scheduler_that_starts_anew(cluster, whole, tmp_path):
    """A cluster at the same address finishes the run, or the same command does so."""
    with ExitStack() as processes:
        with _killed_amid(tmp_path / "out", cluster.scheduler), ThreadPoolExecutor() as pool:
            first = pool.submit(_command, tmp_path / "out", cluster.address)
            cluster.scheduler.wait(WAIT_S)
            _Cluster(processes, tmp_path, cluster.port)
        done = first.result()
        again = _command(tmp_path / "out", cluster.address)

    assert done.returncode == 0 or "was lost; start it, then run again" in done.stderr, done.stderr
    assert again.returncode == 0, again.stderr
    assert_same_results(whole, next((tmp_path / "out").iterdir()))


def test_two_studies_share_a_scheduler_but_no_folder(cluster, whole, tmp_path):
    """A second study in the folder of the first is refused; one in another folder is computed."""
    with ThreadPoolExecutor() as pool:
        first = pool.submit(_command, tmp_path / "out", cluster.address)
        _wait_for(lambda: [*(tmp_path / "out").glob("*/.lock")])
        second = pool.submit(_command, tmp_path / "out", cluster.address)
        other = pool.submit(_command, tmp_path / "other", cluster.address)

    assert second.result().returncode == 1
    assert "another run is at work here" in second.result().stderr
    for study, out in ((first, "out"), (other, "other")):
        assert study.result().returncode == 0, study.result().stderr
        assert_same_results(whole, next((tmp_path / out).iterdir()))
