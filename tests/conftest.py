"""What every test shares: kernels with bounds checks, and one small structure."""

import os

os.environ["TISWARM_DEBUG"] = "1"  # read when the backend starts

import pytest

from tiswarm.compute import backend
from tiswarm.robot import RobotGeometry
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.params import TowerParams


@pytest.fixture(autouse=True)
def _running_backend() -> None:
    """Start every test on the same backend, whatever the last one did."""
    backend.start()


@pytest.fixture(scope="session")
def towers() -> list[History]:
    """Three towers of 30 robots."""
    return grow(TowerParams(), robots=30, seeds=[0, 1, 2], robot=RobotGeometry())
