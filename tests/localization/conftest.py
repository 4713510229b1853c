"""Structures that tests of methods share, in two sizes."""

import pytest

from tiswarm.base.robot import RobotGeometry
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.params import TowerParams

SIZES = [12, pytest.param(30, marks=pytest.mark.trial)]
"""Robots of a structure: each claim has a small witness, and its full size in a trial."""


@pytest.fixture(scope="session", params=SIZES)
def towers(request: pytest.FixtureRequest) -> list[History]:
    """Three towers of 12 robots, and of 30 in a trial."""
    return _grown(request.param)


@pytest.fixture(scope="session")
def tall_towers() -> list[History]:
    """Three towers of 30 robots, for claims that fewer robots cannot show."""
    return _grown(30)


def _grown(robots: int) -> list[History]:
    return grow(TowerParams(), robots=robots, seeds=[0, 1, 2], robot=RobotGeometry())
