"""The import contract that keeps the truth from localizers covers every method there is."""

import sys
from pathlib import Path

import pytest

from tests.runs import LOCALIZERS
from tiswarm.base.registry import BUILT_IN
from tiswarm.localization import methods
from tiswarm.localization.methods import settings_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
[CONTRACT] = [
    contract
    for contract in PROJECT["tool"]["importlinter"]["contracts"]
    if contract["name"] == "a localizer never sees the truth"
]


def _is_covered(module: str) -> bool:
    rooms = tuple(f"{room}." for room in CONTRACT["source_modules"])
    return f"{module}.".startswith(rooms)


@pytest.mark.parametrize("name", LOCALIZERS)
def test_every_method_is_covered(name):
    """Settings and code of a method are in rooms that cannot reach the truth."""
    settings = BUILT_IN["method"][name].partition(":")[0]

    assert _is_covered(settings)
    assert _is_covered(settings_of(name).module)


def test_what_rewrites_logs_is_covered():
    """Orientations that flips correct come from the log alone."""
    assert _is_covered(methods.fit_orientations.__module__)


def test_truth_and_world_are_forbidden():
    """True positions, terrain, growth, senses and scores are out of reach."""
    assert {
        "tiswarm.evaluation",
        "tiswarm.records.positions",
        "tiswarm.sensing",
        "tiswarm.world",
    } <= {*CONTRACT["forbidden_modules"]}
