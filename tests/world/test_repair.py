"""The rule of the guide that repairs takes more of the places that robots left."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from tiswarm.base import registry as door
from tiswarm.base.robot import RobotGeometry
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.history_file import find_fault
from tiswarm.world.params import DepartureParams, TowerParams

PAGE = (Path(__file__).parents[2] / "docs" / "guides" / "repair.md").read_text()
SEEDS = range(100_000, 100_004)


@pytest.fixture
def repair(tmp_path):
    """The class of the rule on the page."""
    file = tmp_path / "repair.py"
    file.write_text(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[0])
    door.load_plugins([file])
    yield door.get("rule", "repair")
    door.forget()


def _grown(rate: float, rule: object = None) -> list[History]:
    params = TowerParams(departures=DepartureParams(rate=rate))
    params = dataclasses.replace(params, rule=rule) if rule else params
    return grow(params, robots=60, seeds=SEEDS, robot=RobotGeometry())


def _taken(history: History) -> int:
    """Places of robots that left to which another one came within a dock diameter."""
    vacant: list[np.ndarray] = []
    taken = 0
    for j, place in enumerate(history.position):
        left = [each for each in vacant if np.linalg.norm(each - place) > 2.0]
        taken += len(vacant) - len(left)
        gone = [robot for robot, joined, _ in history.departures.tolist() if joined == j + 1]
        vacant = left + [history.position[robot] for robot in gone]
    return taken


def test_climbers_take_the_places_that_robots_left(repair):
    """At least half more than those of ReactiveBuild, and all structures are sound."""
    mended, other = _grown(0.1, repair()), _grown(0.1)

    assert [find_fault(history, contact_gap=0.02) for history in mended] == [""] * 4
    assert sum(map(_taken, mended)) > 1.5 * sum(map(_taken, other)) > 0


def test_nothing_to_repair_is_reactive_build(repair):
    """Where nobody leaves, the structures are the same."""
    for mine, its in zip(_grown(0.0, repair()), _grown(0.0), strict=True):
        np.testing.assert_array_equal(mine.position, its.position)


def test_one_climber_of_so_many_repairs(repair):
    """Others climb as ReactiveBuild does: with a great number, all but the first."""
    for mine, its in zip(_grown(0.3, repair(every=10**6)), _grown(0.3), strict=True):
        np.testing.assert_array_equal(mine.position, its.position)
