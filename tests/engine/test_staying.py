"""Robots stay on the device between calls; a result is read from there, and outlasts it."""

import copy
import dataclasses
import gc
import pickle
from collections import Counter

import numpy as np
import pytest

from tests.engine.test_relax import GAINS, ROBOT, swarm
from tiswarm import relax
from tiswarm.base.errors import InputError
from tiswarm.compute import backend, dlpack, math_kernels
from tiswarm.engine import relax as engine
from tiswarm.engine import stepping

ROBOTS = 60
STEPS = 16
PULLED = {**GAINS, "max_step": 0.1, "ramp": 0.5}


@pytest.fixture(params=["all at once", "as on a card"])
def _large(request, monkeypatch):
    """Let small swarms stand for large ones; the processor runs a card's kernels too."""
    monkeypatch.setattr(engine, "SMALL", 0)
    monkeypatch.setattr(backend.Backend, "on_card", request.param == "as on a card")
    monkeypatch.setattr(stepping, "_STEPS_ON_CARD", 4)  # fewer to compile


class Launches:
    """Launches of kernels, and the sizes of arrays of the host that they read or write.

    Every copy of an array to or from a device of the library is such a launch.
    """

    def __init__(self):
        self.clear()

    def clear(self):
        """Forget them."""
        self.kernels = Counter()
        self.copied = []


@pytest.fixture
def launches(monkeypatch):
    """What is launched."""
    seen = Launches()
    kernel = type(math_kernels.probe_arithmetic._primal)  # noqa: SLF001 - the library shows none
    launch = kernel.__call__

    def watched(of_kernel, *arguments, **options):
        seen.kernels[of_kernel.func.__name__] += 1
        seen.copied += [each.size for each in arguments if isinstance(each, np.ndarray)]
        return launch(of_kernel, *arguments, **options)

    monkeypatch.setattr(kernel, "__call__", watched)
    return seen


@pytest.mark.parametrize("_large", ["as on a card"], indirect=True)
@pytest.mark.usefixtures("_large")
def test_steps_copy_nothing_of_a_swarm_to_or_from_the_host(launches):
    """Nor do results that nobody reads; one that is read is copied once, and its zeros are not."""
    result = relax(*swarm(ROBOTS), robot=ROBOT, steps=STEPS, **PULLED)
    prepared = result.swarm
    launches.clear()

    prepared.step(STEPS, **PULLED)
    further = result.resume()
    prepared.relax(steps=STEPS, **PULLED)

    table = STEPS * prepared.stepper.numbers.shape[1]
    assert max(launches.copied) == table < 3 * ROBOTS  # numbers of steps alone
    assert launches.kernels["turn_docks"] == 0
    launches.clear()
    places, still = further.position, further.last_step
    assert launches.copied == [3 * ROBOTS]
    assert places.shape == still.shape
    assert not still.any()
    assert further.force_error == pytest.approx(result.force_error, rel=0.1)
    assert max(launches.copied[1:]) <= 6 * ROBOTS  # bounds of at most as many parts as robots


@pytest.mark.usefixtures("_large")
def test_an_interval_is_four_kernels(launches):
    """Sort docks, write rows, begin, and steps; a call adds one that places docks, and one copy."""
    prepared = engine.PreparedSwarm(*swarm(ROBOTS), robot=ROBOT)
    prepared.relax(steps=1, **PULLED)
    launches.clear()

    builds = prepared.relax(steps=4, **{**PULLED, "max_step": 1e-6}).list_builds

    assert builds == 1
    names = ["place_docks", "sort_docks", "fill_rows", "start_interval", "step_robots"]
    counts = dict.fromkeys(names, 1)
    counts["step_robots"] = 1 if prepared.running.on_card else 2
    own = {name: n for name, n in launches.kernels.items() if "ndarray" not in name}
    assert own == counts
    assert sum(launches.kernels.values()) <= sum(counts.values()) + 4  # numbers, moves, centers


@pytest.mark.parametrize("small", [0, 2_000], ids=["all at once", "by structure"])
def test_a_result_stays_as_it_was(small, monkeypatch):
    """Whatever moves its robots later, and however often it goes on; to the bit."""
    monkeypatch.setattr(engine, "SMALL", small)
    place = swarm(ROBOTS)
    result, twin = (relax(*place, robot=ROBOT, steps=3, **PULLED) for _ in range(2))
    expected = twin.position

    first = result.resume(steps=9)
    result.swarm.step(5, **PULLED)
    second = result.resume(steps=9)
    moved = result.swarm.position

    np.testing.assert_array_equal(result.position, expected)
    np.testing.assert_array_equal(first.position, second.position)
    np.testing.assert_array_equal(moved, second.position)
    assert (result.taken, first.taken, second.taken) == (3, 12, 12)
    np.testing.assert_allclose(
        first.position, relax(*place, robot=ROBOT, steps=12, **PULLED).position, atol=1e-12
    )


@pytest.mark.usefixtures("_large")
def test_arrays_of_results_that_ended_are_used_again(monkeypatch):
    """A loop of calls reserves no memory anew."""
    result = relax(*swarm(ROBOTS), robot=ROBOT, steps=1, **PULLED)
    for _ in range(3):
        result = result.resume()
    reserved = []
    for name in ("reals", "ints"):
        monkeypatch.setattr(backend.Allocator, name, lambda *shape: reserved.append(shape))

    for _ in range(5):
        result = result.resume()

    assert reserved == []


@pytest.mark.parametrize("small", [0, 2_000], ids=["all at once", "by structure"])
def test_results_outlast_their_device(small, monkeypatch):
    """Another device ends that of a result, which is read before, and goes on as it began."""
    monkeypatch.setattr(engine, "SMALL", small)
    place = swarm(ROBOTS)
    expected = relax(*place, robot=ROBOT, steps=3, **PULLED)
    right = expected.position, expected.resume(steps=2).position
    result = relax(*place, robot=ROBOT, steps=3, **PULLED)

    backend.start(threads=1, precision="f32")

    assert result.state.arrays is None or small
    np.testing.assert_array_equal(result.position, right[0])
    np.testing.assert_allclose(result.resume(steps=2).position, right[1], atol=1e-12)


@pytest.mark.usefixtures("_large")
def test_copies_of_a_result_need_no_device():
    """As those that go to another process do."""
    result = relax(*swarm(ROBOTS), robot=ROBOT, steps=3, **PULLED)

    sent = pickle.loads(pickle.dumps(result))  # noqa: S301 - our own

    for twin in (sent, copy.deepcopy(result)):
        assert twin.swarm is None
        np.testing.assert_array_equal(twin.position, result.position)
        assert twin.force_error == result.force_error
        further = twin.resume(steps=2).position
        np.testing.assert_allclose(further, result.resume(steps=2).position, atol=1e-12)


def test_other_libraries_take_positions_by_dlpack():
    """On a processor from the host."""
    result = relax(*swarm(ROBOTS), robot=ROBOT, steps=3, **PULLED)

    np.testing.assert_array_equal(np.from_dlpack(result), result.position)
    assert result.__dlpack_device__() == (dlpack.CPU, 0)


def test_a_capsule_names_memory_of_the_device():
    """NumPy reads what the library wrote; what nobody needs any more is forgotten."""
    memory = backend.Allocator(backend.start(threads=1), on_host=False)
    values = np.arange(12.0).reshape(4, 3)
    exported = memory.export(memory.upload(values))
    before = len(dlpack.in_use)

    taken = np.from_dlpack(exported)
    unused = exported.__dlpack__()

    np.testing.assert_array_equal(taken, values)
    assert taken.ctypes.data == exported.address
    assert len(dlpack.in_use) == before + 2
    del taken, unused
    gc.collect()
    assert len(dlpack.in_use) == before
    with pytest.raises(BufferError, match="on device"):
        exported.__dlpack__(dl_device=(dlpack.CUDA, 0))


def test_positions_on_other_cards_are_read_on_the_host(monkeypatch):
    """The error says where they are, and what to do."""
    monkeypatch.setattr(engine, "SMALL", 0)
    result = relax(*swarm(ROBOTS), robot=ROBOT, steps=1, **PULLED)
    memory = result.swarm.stepper.memory
    vulkan = dataclasses.replace(memory.running, arch="vulkan")
    result.swarm.stepper.memory = dataclasses.replace(memory, running=vulkan)

    with pytest.raises(InputError, match="vulkan has them; read `position`"):
        np.from_dlpack(result)
