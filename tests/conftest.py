"""Fixtures of all tests: kernels with bounds checks, a small structure, a small run."""

import os
from pathlib import Path

os.environ["TISWARM_DEBUG"] = "1"  # read when the backend starts

import pytest

from tests import runs
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.params import TowerParams


@pytest.fixture(autouse=True)
def _running_backend() -> None:
    """Start every test on the same backend."""
    backend.start()


@pytest.fixture(scope="session")
def towers() -> list[History]:
    """Three towers of 30 robots."""
    return grow(TowerParams(), robots=30, seeds=[0, 1, 2], robot=RobotGeometry())


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
    """Folder of a small run of the tower scenario, drawn."""
    out = tmp_path_factory.mktemp("runs")
    done = tiswarm(
        "run", "tests/tower.yaml", "--set", "robots=12", "--set", "seeds=2", "--out", out
    )
    assert done.returncode == 0, done.stderr
    return next(out.iterdir())
