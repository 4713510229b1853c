"""Rules of growth of the guide, and what they grow."""

import dataclasses
import re

import numpy as np

from tests.runs import REPOSITORY
from tiswarm.base import registry
from tiswarm.base.robot import RobotGeometry
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.params import GrowthParams

PAGE = (REPOSITORY / "docs" / "guides" / "rules.md").read_text()
CODE = "\n\n".join(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL))
FIREANT = RobotGeometry()
SEED = 100_000


def with_rule(params: GrowthParams, name: str, **settings: object) -> GrowthParams:
    """Return parameters of growth with a rule, by its name and settings."""
    return dataclasses.replace(params, rule=registry.get("rule", name)(**settings))


def grow_seeds(params: GrowthParams, robots: int, seeds: "list[int] | range") -> list[History]:
    """Grow structures of the robots of the paper, one for each seed."""
    return grow(params, robots=robots, seeds=seeds, robot=FIREANT)


def assert_same_growth(one: list[History], other: list[History]) -> None:
    """Compare all that the histories of two batches have, bit by bit."""
    for a, b in zip(one, other, strict=True):
        assert (a.robot_count, a.spawns, a.crossed, a.ended) == (
            b.robot_count, b.spawns, b.crossed, b.ended
        )  # fmt: skip
        np.testing.assert_array_equal(a.sensed, b.sensed)
        np.testing.assert_array_equal(
            *(np.array([*map(dataclasses.astuple, h.loads)]) for h in (a, b))
        )
        for mine, its in zip(a.walks, b.walks, strict=True):
            for field in dataclasses.fields(mine):
                np.testing.assert_array_equal(
                    getattr(mine, field.name), getattr(its, field.name), err_msg=field.name
                )
