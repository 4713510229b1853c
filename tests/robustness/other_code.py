"""What other code of a process does around a call of tiswarm; `test_other_code.py` runs it.

Each function of SITUATIONS takes a call, as a function without arguments, and the digest of the
positions that the call must give. It asserts in a process of its own.
"""

import asyncio
import contextlib
import multiprocessing
import os
import random
import signal
import sys
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from hashlib import sha256
from importlib import import_module

import numpy as np
import pytest

import tiswarm
from tests.engine.test_relax import GAINS, ROBOT, swarm
from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.engine.relax import PreparedSwarm

Call = Callable[[], str]

METHODS = {
    "virtual-force": {},
    "least-squares": {},
    "joint": {"chains": 2, "steps": 40, "hold_steps": 20},
}
CALLS = (*METHODS, "relax", "relax in f32", "relax many")
THREADS = 4
CHILD_LIMIT_S = 60.0
EARLIEST_S, LATEST_S = 1e-3, 3.0
"""When an interrupt comes."""


def attempt(situation: str, name: str, log: str, expected: str, seed: str) -> None:
    """Make a call in a situation; print its name, or the library that it lacks."""
    random.seed(seed)
    outcome = situation.replace("_", " ")
    try:
        SITUATIONS[situation](partial(compute, name, log), expected)
    except ModuleNotFoundError as error:
        outcome = f"no {error.name}"
    print(outcome)  # noqa: T201


def compute(name: str, log: str) -> str:
    """Make a call; return a digest of its positions."""
    if name in METHODS:
        warnings.simplefilter("ignore")  # so few steps do not converge
        position = tiswarm.localize(log, name, **METHODS[name]).position
    else:
        place = swarm(2_001 if name == "relax many" else 30)
        precision = "f32" if name.endswith("f32") else "f64"
        options = {"robot": ROBOT, "ramp": 0.5, "steps": 5, "precision": precision}
        position = tiswarm.relax(*place, **options, **GAINS).position
    return sha256(position.tobytes()).hexdigest()


def _library():
    return import_module(os.environ.get("TISWARM_BACKEND", "taichi"))


def _start_program(ti):
    """Start a program of the user's and return what checks that it is whole."""
    ti.init(arch=ti.cpu, log_level=ti.ERROR)
    field = ti.field(ti.f32, 4)
    array = ti.ndarray(ti.f32, 4)

    def check() -> None:
        assert ti.lang.impl.current_cfg().default_fp == ti.f32
        for each in (field, array):
            np.testing.assert_array_equal(each.to_numpy(), 7.0)

    for each in (field, array):
        each.fill(7.0)
    return check


def _assert_refused(call: Call, *words: str) -> None:
    with pytest.raises(EnvironmentTroubleError) as refusal:
        call()
    said = str(refusal.value)
    assert all(word in said for word in words), said
    assert "\n" not in said


def fields_before_the_first_call(call: Call, expected: str) -> None:
    """A program of the user's runs first; after its end the call computes."""
    ti = _library()
    check = _start_program(ti)

    for _ in range(2):
        _assert_refused(call, "another program", "reset() first", "process of its own")
        check()
    ti.reset()

    assert call() == expected


def init_between_calls(call: Call, expected: str) -> None:
    """A program of the user's replaces ours."""
    ti = _library()
    assert call() == expected
    check = _start_program(ti)

    _assert_refused(call, "another program")
    check()
    ti.reset()

    assert call() == expected


def reset_between_calls(call: Call, expected: str) -> None:
    """Nothing of the user's runs, so kernels start anew."""
    assert call() == expected

    _library().reset()

    assert call() == expected
    assert call() == expected


def a_swarm_that_outlives_its_program(call: Call, expected: str) -> None:
    """Arrays on a device that a reset ended free nothing of the program that comes next."""
    ti = _library()
    prepared = PreparedSwarm(*swarm(2_001), robot=ROBOT)
    prepared.relax(ramp=0.5, steps=1, **GAINS)
    check = _start_program(ti)

    _assert_refused(partial(prepared.relax, ramp=0.5, steps=1, **GAINS), "another program")
    ti.reset()
    with pytest.raises(InputError, match="prepare it again"):
        prepared.relax(ramp=0.5, steps=1, **GAINS)
    check = _start_program(ti)
    del prepared

    check()
    ti.reset()
    assert call() == expected


def the_other_library(call: Call, expected: str) -> None:
    """A program of the library that tiswarm does not use, where both are installed."""
    other = "taichi" if _library().__name__ == "quadrants" else "quadrants"
    check = _start_program(import_module(other))

    assert call() == expected
    check()
    assert call() == expected


def _in_fork(work: Callable[[], None]) -> None:
    """Do work in a child by fork, which must end; it raises here what it raises there."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # newer Pythons warn of threads
        child = os.fork()
    if child == 0:
        with contextlib.redirect_stdout(sys.stderr):
            work()
        sys.exit(0)  # with all that a process does as it ends
    end = time.monotonic() + CHILD_LIMIT_S
    while (status := os.waitpid(child, os.WNOHANG)) == (0, 0):
        if time.monotonic() > end:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            raise AssertionError("the child hangs")
        time.sleep(0.02)
    assert status == (child, 0)


def fork_after_a_call(call: Call, expected: str) -> None:
    """A child without the threads of its parent refuses, and ends; the parent goes on."""
    assert call() == expected

    _in_fork(lambda: _assert_refused(call, "forked", 'get_context("spawn")'))
    _in_fork(lambda: None)

    assert call() == expected


def fork_before_the_first_call(call: Call, expected: str) -> None:
    """Child and parent compute."""

    def work() -> None:
        assert call() == expected

    _in_fork(work)
    work()


def fork_while_a_thread_computes(call: Call, expected: str) -> None:
    """The child does not wait for a turn that nobody gives back."""
    assert call() == expected
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(lambda: [call() for _ in range(3)])
        time.sleep(0.1)

        _in_fork(lambda: _assert_refused(call, "forked"))

        assert set(running.result()) == {expected}


def _result_or_error(call: Call) -> str:
    try:
        return call()
    except EnvironmentTroubleError as error:
        return str(error)


def pools_of_processes(call: Call, expected: str) -> None:
    """Spawned children compute; forked ones say what to do."""
    assert call() == expected

    for method in ("spawn", "fork"):
        with multiprocessing.get_context(method).Pool(1) as pool:
            found = pool.apply_async(_result_or_error, [call]).get(CHILD_LIMIT_S)
        assert found == expected if method == "spawn" else "spawn" in found


def workers_of_joblib(call: Call, expected: str) -> None:
    """Its own processes and threads compute; those that it forks say what to do."""
    joblib = import_module("joblib")
    assert call() == expected

    for kind in ("loky", "threading", "multiprocessing"):
        tasks = (joblib.delayed(_result_or_error)(call) for _ in range(2))
        [found] = set(joblib.Parallel(2, backend=kind)(tasks))
        assert found == expected if kind != "multiprocessing" else "spawn" in found


def workers_of_dask(call: Call, expected: str) -> None:
    """Worker processes compute, and so do threads of this process."""
    dask = import_module("distributed")
    assert call() == expected

    for processes in (True, False):
        options = {"n_workers": 1, "threads_per_worker": 2, "dashboard_address": None}
        with (
            dask.LocalCluster(processes=processes, **options) as cluster,
            dask.Client(cluster) as client,
        ):
            tasks = [client.submit(call, pure=False) for _ in range(3)]
            assert set(client.gather(tasks)) == {expected}


def first_calls_in_threads(call: Call, expected: str) -> None:
    """Calls that start kernels all at once."""
    with ThreadPoolExecutor(THREADS) as pool:
        assert {each.result() for each in [pool.submit(call) for _ in range(THREADS)]} == {expected}


def threads_on_different_devices(call: Call, expected: str) -> None:
    """Calls that start kernels anew for each other, in f64 and f32, with one thread and two."""
    place = swarm(2_001)

    def relaxed(number: int) -> bytes:
        precision, threads = ("f32", "f64")[number % 2], 1 + number // 2 % 2
        options = {"ramp": 0.5, "steps": 3, "precision": precision, "threads": threads}
        return tiswarm.relax(*place, robot=ROBOT, **options, **GAINS).position.tobytes()

    right = [relaxed(number) for number in range(THREADS)]
    with ThreadPoolExecutor(2 * THREADS) as pool:
        found = [pool.submit(relaxed, number) for number in range(THREADS)]
        calls = [pool.submit(call) for _ in range(THREADS)]

        assert [each.result() for each in found] == right
        assert {each.result() for each in calls} == {expected}


def executors_of_asyncio(call: Call, expected: str) -> None:
    """First calls from tasks, in two kinds of threads."""

    async def main() -> list[str]:
        loop = asyncio.get_running_loop()
        tasks = [loop.run_in_executor(None, call) for _ in range(2)]
        return await asyncio.gather(*tasks, asyncio.to_thread(call), asyncio.to_thread(call))

    assert set(asyncio.run(main())) == {expected}


def interrupts(call: Call, expected: str) -> None:
    """A key pressed at any moment, of the start or of a call, leaves the next call as it was."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGALRM, interrupt)
    for _ in range(5):
        with contextlib.suppress(KeyboardInterrupt):
            delay = EARLIEST_S * (LATEST_S / EARLIEST_S) ** random.random()  # noqa: S311
            signal.setitimer(signal.ITIMER_REAL, delay)
            try:
                call()
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0.0)

        assert call() == expected


SITUATIONS = {
    work.__name__: work
    for work in (
        fields_before_the_first_call, init_between_calls, reset_between_calls,
        a_swarm_that_outlives_its_program, the_other_library,
        fork_after_a_call, fork_before_the_first_call, fork_while_a_thread_computes,
        pools_of_processes, workers_of_joblib, workers_of_dask,
        first_calls_in_threads, threads_on_different_devices, executors_of_asyncio, interrupts,
    )
}  # fmt: skip
