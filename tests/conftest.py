"""Fixtures of all tests: kernels with bounds checks, a small structure, a small run."""

import fcntl
import os
from pathlib import Path

os.environ["TISWARM_DEBUG"] = "1"  # read when the backend starts

import pytest
from hypothesis import HealthCheck, settings

from tests import runs
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.params import TowerParams

BOUNDS = "TISWARM_DEBUG"
"""Variable by which kernels check the bounds of arrays; read when the backend starts."""

ROOMS_WITH_KERNELS = {"compute", "engine", "world"}
ROOMS_OF_TRIALS = ROOMS_WITH_KERNELS | {"localization", "distributed", "online", "peers"}
"""Rooms whose kernels check bounds: those of methods in trials alone, which need half as long
without."""
ROOMS_WITHOUT_KERNELS = {
    "advice", "base", "evaluation", "formats", "measurements", "records", "scenario", "sensing",
    "suites",
}  # fmt: skip
"""Rooms whose tests compute little or nothing."""

THREADS = "test_threads.py"
"""File of all tests that compute on several numbers of threads."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort tests by the program that their kernels need; the rest of their order stays.

    A program traces every kernel that it runs anew, seconds for growth alone. So each worker of
    pytest starts each program as few times as tests allow. Workers begin with equal numbers of
    tests in a row: of two, one has the rooms without checks, the other one those with checks, and
    both have tests without kernels, to hand on at the end. Tests on numbers of threads come first,
    as a worker hands on its last tests.
    """
    items.sort(
        key=lambda item: (
            item.path.name != THREADS,
            _checks_bounds(item),
            _room(item) in ROOMS_WITHOUT_KERNELS,
            _choice(item),
        )
    )


def _room(node: pytest.Item | pytest.Module) -> str:
    return node.path.parent.name


def _checks_bounds(node: pytest.Item | pytest.Module) -> bool:
    """Whether kernels check the bounds of arrays in a test or a module."""
    if node.get_closest_marker("checked"):
        return True
    in_trial = node.config.option.markexpr.startswith("trial")
    rooms = ROOMS_OF_TRIALS if in_trial else ROOMS_WITH_KERNELS
    return _room(node) in rooms and node.get_closest_marker("unchecked") is None


def _choice(item: pytest.Item) -> list[tuple[str, object]]:
    """Return the arguments with which a test starts the backend, in an order."""
    marker = item.get_closest_marker("program")
    return sorted(marker.kwargs.items()) if marker else []


# How long an example takes is the machine's business: it may be slow, busy, or compiling a kernel.
settings.register_profile(
    "any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("any machine")


@pytest.fixture(autouse=True, scope="module")
def _bounds(request: pytest.FixtureRequest) -> None:
    """Let kernels check bounds in their own rooms and `checked` modules, but not `unchecked` ones.

    Annealing takes two and a half times as long with checks, and whole runs would find nothing that
    tests of kernels do not.
    """
    checks = str(int(_checks_bounds(request.node)))
    if os.environ[BOUNDS] != checks:
        os.environ[BOUNDS] = checks
        backend.start(precision="f32")  # another program, so that the next one starts anew
    backend.start()  # fixtures of the module come before the first test


@pytest.fixture(autouse=True)
def _running_backend(request: pytest.FixtureRequest) -> None:
    """Start every test on the same backend, or on the one that its marker `program` names."""
    backend.start(**dict(_choice(request.node)))


@pytest.fixture(scope="session")
def towers() -> list[History]:
    """Three towers of 30 robots."""
    return grow(TowerParams(), robots=30, seeds=[0, 1, 2], robot=RobotGeometry())


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Offer a file name that every example of a property test may use again."""
    return tmp_path_factory.mktemp("scratch") / "file"


@pytest.fixture(scope="session")
def tiswarm() -> runs.Command:
    """Call `tiswarm` with some arguments, in this process."""
    return runs.call_here


@pytest.fixture(scope="session")
def process() -> runs.Command:
    """Call `tiswarm` with some arguments and variables, in a process of its own."""
    return runs.call


@pytest.fixture(scope="session")
def small_run(tiswarm: runs.Command, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a small run of the tower scenario, drawn; all workers of pytest read the same."""
    base = tmp_path_factory.getbasetemp()
    out = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "small-run"
    out.mkdir(exist_ok=True)
    with (out / ".making").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not [*out.glob("tower-*")]:
            settings = ("--set", "robots=12", "--set", "seeds=2", "--out", out)
            done = tiswarm("run", "tests/tower.yaml", *settings)
            assert done.returncode == 0, done.stderr
    [run] = out.glob("tower-*")
    return run
