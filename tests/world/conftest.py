"""Small structures of every kind, grown once."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import rules
from tiswarm.base import plugins
from tiswarm.base.robot import RobotGeometry
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.params import BridgeParams, CantileverParams, ChainParams


@pytest.fixture(scope="session")
def cantilevers() -> list[History]:
    """Three cantilevers of 30 robots."""
    return grow(CantileverParams(), robots=30, seeds=[0, 1, 2], robot=RobotGeometry())


@pytest.fixture(scope="session")
def bridges() -> list[History]:
    """Two bridges that need fewer than 60 robots to cross."""
    return grow(BridgeParams(), robots=60, seeds=[0, 3], robot=RobotGeometry())


@pytest.fixture(scope="session")
def chains() -> list[History]:
    """Two chains of 30 robots that hang from the edge; where founders jam, they do not."""
    histories = grow(ChainParams(), robots=30, seeds=range(10), robot=RobotGeometry())
    hanging = [history for history in histories if history.position[:, 2].min() < -5.0]
    return [hanging[0], hanging[1]]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """File with the rules of the guide."""
    file = tmp_path_factory.mktemp("rules") / "rules.py"
    file.write_text(rules.CODE)
    return file


@pytest.fixture
def page_rules(page: Path) -> Iterator[None]:
    """Load the rules of the guide, and leave none to the next test."""
    plugins.load_plugins([page])
    yield
    plugins.forget()
