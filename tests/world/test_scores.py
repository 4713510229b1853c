"""Scores of rules that kernels compute: they grow what the same rule in Python grows."""

import dataclasses
import sys

import pytest

from tests.rules import SEED, assert_same_growth, grow_seeds, with_rule
from tiswarm.base import plugins, registry
from tiswarm.base.errors import InputError
from tiswarm.world.params import TowerParams
from tiswarm.world.walks import climb_laws

pytestmark = [pytest.mark.unchecked, pytest.mark.usefixtures("page_rules")]
"""Each score compiles the climbing of robots anew, in less time without checks of bounds."""


def test_a_score_grows_the_same_in_python_and_as_a_kernel():
    """The ramp of the page does, with any values of its settings, which compile nothing."""
    seeds = range(SEED, SEED + 2)
    compiled = []

    for settings in ({"slope": 0.4, "length": 15.0}, {"slope": 0.9, "length": 7.0}):
        ramp = grow_seeds(with_rule(TowerParams(), "ramp", **settings), 15, seeds)
        as_kernel = with_rule(TowerParams(), "ramp-kernel", **settings)
        assert_same_growth(ramp, grow_seeds(as_kernel, 15, seeds))
        compiled.append(climb_laws(as_kernel)[0].score)

    assert (ramp[0].position != grow_seeds(TowerParams(), 15, seeds)[0].position).any()
    assert compiled[0] is compiled[1]


SCORES = """
import functools

import tiswarm
from tiswarm.compute.lang import ti

SLOPE = 0.5


@ti.func
def above_of(center):
    above = 0
    if center[2] > SLOPE * center[0] + 2.0:
        above = center[2] - SLOPE * center[0] - 2.0
    return above


def doubled(function):
    @functools.wraps(function)
    def twice(*values):
        return 2.0 * function(*values)

    return twice


@tiswarm.rule("whole")
class Whole:
    def score(self):
        @ti.func
        def distance(center, orientation, goal):
            return (center - ti.Vector([20, 0, 10])).norm() + 10 * above_of(center)
        return distance


@tiswarm.rule("wrong")
class Wrong:
    def score(self):
        @ti.func
        def distance(center, orientation, goal):
            return sqrt(center[0])
        return distance


@tiswarm.rule("asking")
class Asking:
    lean: float = 1.0
    name_of_it: str = ""

    def score(self):
        @ti.func
        def distance(center, orientation, goal, lean, tilt):
            return lean * tilt * (center - goal).norm()
        return distance


@tiswarm.rule("decorated")
class Decorated:
    def score(self):
        @doubled
        @ti.func
        def distance(center, orientation, goal):
            return (center - goal).norm()
        return distance


@tiswarm.rule("of-python")
class OfPython:
    def score(self):
        def distance(center, orientation, goal):
            return (center - goal).norm()
        return distance


@tiswarm.rule("decorated-method")
class DecoratedMethod:
    @doubled
    def choose(self, step):
        return 0 * step.robot - 0.5
"""


@pytest.fixture
def scores(tmp_path):
    """File with rules whose scores are kernel functions, or should be."""
    file = tmp_path / "scores.py"
    file.write_text(SCORES)
    plugins.load_plugins([file])
    return file


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Two towers by a score of whole numbers, as its file has it."""
    file = tmp_path_factory.mktemp("scores") / "scores.py"
    file.write_text(SCORES)
    plugins.load_plugins([file])
    towers = grow_seeds(with_rule(TowerParams(), "whole"), 12, [SEED, SEED + 1])
    plugins.forget()
    return towers


def test_a_score_that_begins_with_a_whole_number_grows_as_in_python(whole):
    """Its helper's number becomes real; the ramp of the page has the same score."""
    ramp = with_rule(TowerParams(), "ramp", slope=0.5, length=20.0)

    assert_same_growth(grow_seeds(ramp, 12, [SEED, SEED + 1]), whole)


@pytest.mark.usefixtures("scores")
def test_a_score_follows_a_number_that_it_reads(whole):
    """The steeper ramp of its file, not the one that was compiled first."""
    [before] = grow_seeds(with_rule(TowerParams(), "whole"), 12, [SEED])

    rule = registry.registered("rule")["whole"].value
    module = sys.modules[f"tiswarm_plugin_{registry.registered('rule')['whole'].plugin.digest}"]
    module.SLOPE = 0.1
    [after] = grow_seeds(with_rule(TowerParams(), "whole"), 12, [SEED])
    [flat] = grow_seeds(dataclasses.replace(TowerParams(), rule=rule()), 12, [SEED])

    assert_same_growth([before], whole[:1])
    assert (before.position != after.position).any()
    assert_same_growth([after], [flat])


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("wrong", InputError, r'scores\.py:40: distance: Name "sqrt" is not defined; correct it'),
        (
            "decorated",
            plugins.PluginError,
            r"decorated\.score returned distance, a function of Python",
        ),
        (
            "of-python",
            plugins.PluginError,
            r"of-python\.score returned distance, a function of Python",
        ),
        (
            "asking",
            plugins.PluginError,
            r"asking\.score returned a function that asks for tilt, which is no setting",
        ),
        ("decorated-method", plugins.PluginError, r"decorated-method\.choose returned float64"),
    ],
)
@pytest.mark.usefixtures("scores")
def test_a_score_that_kernels_cannot_compute_is_a_line(name, error, message):
    """Decorators of a method count, too."""
    with pytest.raises(error, match=message) as caught:
        grow_seeds(with_rule(TowerParams(), name), 3, [SEED])

    assert "\n" not in str(caught.value)
