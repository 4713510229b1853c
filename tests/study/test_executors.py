"""Studies that are interrupted, broken, sharded, in processes and on clusters."""

import fcntl
import os
import re
import signal
import socket
import textwrap
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.recorder import Recorder
from tests.runs import REPOSITORY, assert_same_results, run_tower
from tiswarm.base.errors import CasesFailedError, EnvironmentTroubleError, InputError
from tiswarm.base.progress import Progress, ignore
from tiswarm.compute import backend
from tiswarm.scenario.expansion import load_scenario, plan
from tiswarm.study import Execution, executors, runner

SMALL = ("robots=8", "seeds=4", "conditions={a: {}, b: {localization.iterations: 20}}")
QUIET = Progress()


class _Watcher(Recorder):
    """Keeps the lines, and the steps of the task `cases` with what stands beside them."""

    def __init__(self) -> None:
        super().__init__()
        self.total, self.done, self.steps, self.beside = 0, 0, [], set()

    @contextmanager
    def task(self, name, total, note=lambda: "", done=0):
        if name != "cases":
            yield ignore
            return
        self.total, self.done = total, done
        yield lambda steps: self.steps.append((steps, note())) if steps else self.beside.add(note())


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """Folder of an uninterrupted run."""
    return run_tower(tmp_path_factory.mktemp("whole"), SMALL).folder


@pytest.fixture
def inject(tmp_path, monkeypatch):
    """Return a function that lets new processes run some lines as they start."""

    def into_processes(lines: str) -> None:
        site = tmp_path / "site"
        site.mkdir()
        (site / "sitecustomize.py").write_text(textwrap.dedent(lines))
        monkeypatch.setenv("PYTHONPATH", f"{site}{os.pathsep}{REPOSITORY}")

    return into_processes


@pytest.mark.parametrize(
    ("execution", "cases", "least_jobs"),
    [
        ({}, 8, 1),
        pytest.param({"workers": 2}, 8, 4, marks=pytest.mark.trial),
        ({"shard": (1, 2)}, 4, 1),
        # The system counts milliseconds in 32 bits; a limit of 1e7 s failed every case.
        pytest.param({"case_limit_s": 1e300}, 8, 4, marks=pytest.mark.trial),
    ],
    ids=["here", "workers", "shard", "limit"],
)
def test_cases_are_reported_wherever_they_are_computed(
    whole, tmp_path, monkeypatch, execution, cases, least_jobs
):
    """The first line names the command that shows them, and the task moves as each job ends.

    Processes give the bytes of one, and import no file of the working folder.
    """
    (tmp_path / "calendar.py").write_text("x = 1")
    monkeypatch.chdir(tmp_path)
    watcher = _Watcher()

    result = run_tower(tmp_path / "out of sight", SMALL, progress=watcher, **execution)

    assert (result.computed, result.failed) == (cases, ())
    if cases == 8:
        assert_same_results(whole, result.folder)
    assert watcher.lines[0] == f"to watch: tiswarm view --live '{result.folder}'"
    assert watcher.total == cases == sum(steps for steps, _ in watcher.steps)
    assert len(watcher.steps) >= least_jobs
    if not execution.keys() & {"workers", "case_limit_s"}:
        assert {note for _, note in watcher.steps} == {""}


@pytest.mark.parametrize(
    "execution",
    [{}, pytest.param({"workers": 2}, marks=pytest.mark.trial)],
    ids=["here", "workers"],
)
def test_cases_count_as_they_are_stored_beside_those_of_an_earlier_run(tmp_path, execution):
    """Users saw `0 of 64` while 18 cases were stored: cases to do were counted, and by jobs."""
    run_tower(tmp_path, SMALL, shard=(1, 2))
    watcher = _Watcher()

    run_tower(tmp_path, SMALL, progress=watcher, **execution)

    assert (watcher.done, watcher.total) == (4, 8)
    assert sum(steps for steps, _ in watcher.steps) == 4
    if not execution:
        assert [steps for steps, _ in watcher.steps] == [1, 1, 1, 1]


def test_stages_name_their_condition_and_point(tmp_path):
    """A study of days says which of its cases take so long."""
    recorder = Recorder()

    run_tower(tmp_path, ("sweep={robots: [4, 5]}", *SMALL[1:]), progress=recorder)

    assert "grow (a, 4 robots and 1 more)" in recorder.tasks
    assert "localize (b, 5 robots)" in recorder.tasks


def test_cases_of_a_job_that_is_split_count_once(tmp_path, monkeypatch):
    """A case that fails lets the others of its job be computed again."""
    fail = executors.run_job
    broken = []

    def break_once(job, *arguments, **options):
        outcome = fail(job, *arguments, **options)
        if not broken:
            broken.append(job)
            raise ValueError("broken")
        return outcome

    monkeypatch.setattr(executors, "run_job", break_once)
    watcher = _Watcher()

    run_tower(tmp_path, SMALL, progress=watcher)

    assert min(steps for steps, _ in watcher.steps) < 0
    assert sum(steps for steps, _ in watcher.steps) == 8


@pytest.mark.trial
def test_processes_report_what_they_do_before_a_job_ends(tmp_path):
    """Cases of large jobs end after minutes: users saw `0 of 1100` until then."""
    watcher = _Watcher()

    run_tower(tmp_path, SMALL, progress=watcher, workers=1)

    assert any(re.fullmatch(r"[a-z ]+( \(.+\))? \d+ of \d+", note) for note in watcher.beside)


def test_each_process_begins_with_one_structure(whole):
    """Their cases are stored early: a run that is stopped keeps them."""
    scenario = load_scenario(REPOSITORY / "tests/tower.yaml", ["robots=8", "seeds=20"])

    jobs = runner.batch(plan(scenario).structures, whole, arch="cpu", threads=1, width=2)

    sizes = [len(job.structures) for job in jobs]
    assert sizes[:2] == [1, 1]
    assert sum(sizes) == 20
    assert max(sizes) > 1


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"shard": (3, 2)}, "invalid shard 3/2: use I/N"),
        ({"workers": 2, "scheduler": "tcp://here:1"}, "workers: a scheduler has workers"),
    ],
)
def test_an_impossible_execution_is_refused(fields, problem):
    """A caller from Python gets the message of the command."""
    with pytest.raises(InputError, match=problem):
        Execution(**fields)


@pytest.mark.trial
def test_processes_keep_the_kernels_that_they_compile(tmp_path, monkeypatch):
    """They end by themselves once there is no more to do, as kernels are stored at the end."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    run_tower(tmp_path, [*SMALL, "seeds=1", "conditions={a: {}}"], workers=1)

    kernels = [*(tmp_path / "cache").rglob("*.tic")]
    assert len(kernels) > 1  # one is of the start


def test_shards_make_the_same_run_together(whole, tmp_path):
    """Each case is computed by one shard, and the last shard writes the tables."""
    parts = [run_tower(tmp_path, SMALL, shard=(number, 3)) for number in (3, 1, 2)]

    assert [part.missing for part in parts] == [6, 2, 0]
    assert sum(part.computed for part in parts) == 8
    assert_same_results(whole, parts[0].folder)


@pytest.mark.slow
def test_a_dask_cluster_changes_no_byte(whole, tmp_path):
    """Threads of a Dask worker, each with its own process, give the bytes of one process."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
    ) as cluster:
        watcher = _Watcher()
        result = run_tower(tmp_path, SMALL, scheduler=cluster.scheduler_address, progress=watcher)

    assert result.computed == 8 == sum(steps for steps, _ in watcher.steps)
    assert watcher.lines == [f"to watch: tiswarm view --live {result.folder}"]
    assert_same_results(whole, result.folder)


def test_a_missing_scheduler_is_an_error(tmp_path, monkeypatch):
    """The run ends with an error instead of waiting."""
    pytest.importorskip("distributed")
    monkeypatch.setattr("tiswarm.study.cluster.CONNECT_S", 0.1)

    with pytest.raises(EnvironmentTroubleError, match="no Dask scheduler answers"):
        run_tower(tmp_path, SMALL, scheduler="tcp://127.0.0.1:1")


@pytest.mark.slow
def test_a_case_that_breaks_is_marked_and_the_rest_goes_on(tmp_path, inject):
    """Each failed case has its reason, and a later run computes all of them."""
    inject("""
        import os, signal
        import tiswarm.sensing
        observe = tiswarm.sensing.observe

        def stumble(history, params):
            if history.seed == 1:
                raise ValueError("a sensor\\nbroke")
            if history.seed == 2:
                os.kill(os.getpid(), signal.SIGKILL)
            return observe(history, params)

        tiswarm.sensing.observe = stumble
    """)
    three = ("seeds=3", "conditions={a: {}}")

    broken = run_tower(tmp_path, [*SMALL, *three], workers=1, case_limit_s=600.0)
    mended = run_tower(tmp_path, [*SMALL, *three])

    reasons = {record.seed: record.reason for record in broken.failed}
    assert reasons == {
        1: "ValueError: a sensor broke",
        2: "its process was killed by SIGKILL, perhaps for lack of memory",
    }
    assert (mended.found, mended.failed) == (1, ())


@pytest.mark.slow
def test_a_crash_of_machine_code_is_tried_again_with_new_kernels(
    tmp_path, monkeypatch, inject, capsys
):
    """One line says so."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("CRASHES", str(tmp_path / "crashes"))
    inject("""
        import os, pathlib, signal
        import tiswarm.sensing
        observe = tiswarm.sensing.observe

        def stumble(history, params):
            crashes = pathlib.Path(os.environ["CRASHES"])
            if not crashes.exists():
                crashes.touch()
                os.kill(os.getpid(), signal.SIGSEGV)
            return observe(history, params)

        tiswarm.sensing.observe = stumble
    """)
    monkeypatch.delenv("TISWARM_DEBUG")  # the library would exit instead of crashing
    for threads in (1, 2):  # the second start stores the kernels of the first
        backend.start(threads=threads)

    result = run_tower(tmp_path, [*SMALL, "seeds=1", "conditions={a: {}}"], workers=1)

    assert result.failed == ()
    assert "killed by SIGSEGV; kernel cache cleared, trying once more" in capsys.readouterr().err


@pytest.mark.slow
def test_a_case_that_takes_too_long_is_given_up(tmp_path):
    """The case fails with the limit as its reason."""
    result = run_tower(tmp_path, [*SMALL, "seeds=1", "conditions={a: {}}"], case_limit_s=0.001)

    assert [record.reason for record in result.failed] == [
        "took longer than 0.001 s; raise --case-limit"
    ]


@pytest.mark.trial
def test_a_process_that_never_starts_is_given_up(tmp_path, monkeypatch, inject):
    """The case fails if its process hangs before it computes."""
    inject("import time; time.sleep(60)")
    monkeypatch.setattr("tiswarm.study.executors.START_S", 0.5)

    result = run_tower(tmp_path, [*SMALL, "seeds=1", "conditions={a: {}}"], workers=1)

    assert [record.reason for record in result.failed] == [
        "its process did not start within 0.5 s; run it again"
    ]


@pytest.mark.trial
def test_workers_of_other_code_are_refused(tmp_path, inject):
    """The run ends before it mixes their cases with others, and computes them again later."""
    inject("""
        import tiswarm.study.provenance
        tiswarm.study.provenance.package_code = lambda: "0123456789ab"
    """)
    one = ("seeds=1", "conditions={a: {}}")

    with pytest.raises(EnvironmentTroubleError, match="install the same tiswarm"):
        run_tower(tmp_path, [*SMALL, *one], workers=1)

    assert not [*tmp_path.glob("*/summary.csv")]
    assert run_tower(tmp_path, [*SMALL, *one]).computed == 1


def test_a_culprit_is_found_within_a_batch(whole, tmp_path, monkeypatch):
    """If a method fails for one case of a batch, only that case fails."""
    real = runner.localize_many

    def fail(logs, methods, **settings):
        if any(m.iterations == 20 and log.seed == 2 for log, m in zip(logs, methods, strict=True)):
            raise MemoryError
        return real(logs, methods, **settings)

    def mark(history, params):
        log = observe(history, params)
        object.__setattr__(log, "seed", history.seed)
        return log

    observe = runner.observe
    monkeypatch.setattr(runner, "observe", mark)
    monkeypatch.setattr(runner, "localize_many", fail)

    result = run_tower(tmp_path, SMALL)

    [record] = result.failed
    assert record.case == "2-b"
    assert record.reason.startswith("memory ran out: MemoryError; compute fewer robots")
    monkeypatch.undo()
    assert run_tower(tmp_path, SMALL).computed == 1
    assert_same_results(whole, result.folder)


def test_fail_fast_stops_at_the_first(tmp_path, monkeypatch):
    """The first failed case ends the run."""

    def fail(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(runner, "observe", fail)

    with pytest.raises(CasesFailedError, match=r"0-a: ZeroDivisionError"):
        run_tower(tmp_path, SMALL, fail_fast=True)
    assert len([*tmp_path.glob("*/cases/[!.]*")]) == 1


@pytest.mark.slow
def test_a_killed_run_goes_on_to_the_same_bytes(process, whole, tmp_path, inject):
    """After kill -9 within the fourth case, three cases are found and five computed."""
    inject("""
        import os, pathlib, signal
        replace = pathlib.Path.replace
        records = 0

        def replace_or_die(path, target):
            global records
            records += target.name == "case.json"
            if records == 4:
                os.kill(os.getpid(), signal.SIGKILL)
            return replace(path, target)

        pathlib.Path.replace = replace_or_die
    """)
    settings = [part for text in SMALL for part in ("--set", text)]

    killed = process("run", "tests/tower.yaml", *settings, "--no-pictures", "--out", tmp_path)
    resumed = run_tower(tmp_path, SMALL)

    assert killed.returncode == -signal.SIGKILL
    assert (resumed.found, resumed.computed) == (3, 5)
    assert_same_results(whole, resumed.folder)


def test_a_folder_takes_one_run_at_a_time(whole):
    """A second run is refused while the first computes, and leaves the scenario of that one.

    Shards of one run are accepted.
    """
    before = (whole / "scenario.yaml").read_bytes()
    with (whole / ".lock").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)
        with pytest.raises(EnvironmentTroubleError, match="another run is at work here"):
            run_tower(whole.parent, [*SMALL, "description=another one"])
        assert (whole / "scenario.yaml").read_bytes() == before
        assert run_tower(whole.parent, SMALL, shard=(1, 2)).missing == 0


@pytest.mark.slow
def test_each_point_of_a_sweep_has_its_own_precision(tmp_path):
    """Cases of one batch are localized in their own precision."""
    joint = "conditions={a: {localization: {method: joint, steps: 50, hold_steps: 10}}}"
    many = [*SMALL, "seeds=1", joint]
    swept = run_tower(tmp_path, [*many, "sweep.precision=[f64, f32]"]).folder / "cases"
    alone = run_tower(tmp_path, [*many, "precision=f32"]).folder / "cases"

    single = (alone / "0-a" / "estimate.csv").read_bytes()
    assert (swept / "0-precision=f32,a" / "estimate.csv").read_bytes() == single
    assert (swept / "0-precision=f64,a" / "estimate.csv").read_bytes() != single


@pytest.mark.parametrize("address", ["garbage", "", "tcp://", "inproc://x", "tcp://127.0.0.1:1"])
def test_a_wrong_address_is_found_before_a_client_is_made(tmp_path, monkeypatch, capfd, address):
    """A client of Dask tried for a minute, then complained as the process ended."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(distributed, "Client", lambda *_, **__: pytest.fail("a client was made"))

    with pytest.raises(EnvironmentTroubleError, match="no Dask scheduler answers at"):
        run_tower(tmp_path, SMALL, scheduler=address)

    assert capfd.readouterr().err == ""


def test_a_server_that_is_no_scheduler_is_an_error(tmp_path, monkeypatch):
    """It accepts a connection, and then says nothing."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(distributed, "Client", lambda *_, **__: pytest.fail("a client was made"))
    monkeypatch.setattr("tiswarm.study.cluster.CONNECT_S", 0.2)

    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(EnvironmentTroubleError, match="no Dask scheduler answers at"):
            run_tower(tmp_path, SMALL, scheduler=address)
