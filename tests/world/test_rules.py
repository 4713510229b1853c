"""Rules of growth: those of the guide grow what the kernel grows, and all structures are sound."""

import dataclasses

import numpy as np
import pytest

from tests import oracle
from tests.rules import FIREANT, SEED, assert_same_growth, grow_seeds, with_rule
from tiswarm.base import plugins, registry
from tiswarm.compute.math import dock_offsets, uniform
from tiswarm.world.history_file import find_fault
from tiswarm.world.params import (
    BridgeParams,
    CantileverParams,
    ChainParams,
    ClimbParams,
    DepartureParams,
    GrowthParams,
    TowerParams,
)
from tiswarm.world.walks import recruit, relay

KINDS: dict[str, GrowthParams] = {
    "tower": TowerParams(),
    "cantilever": CantileverParams(anchor=3.5, founders=2),
    "bridge": BridgeParams(),
    "chain": ChainParams(),
    "settling": TowerParams(climb=ClimbParams(settle=0.5)),
    "movers": TowerParams(movers=4),
    "plane": TowerParams(plane=True),
    "anchors": TowerParams(anchors=2),
    "leaving": TowerParams(departures=DepartureParams(rate=0.3)),
    "dying": TowerParams(movers=3, departures=DepartureParams(rate=0.3, kind="die")),
    "short": TowerParams(climb=ClimbParams(max_flips=6)),
}


pytestmark = pytest.mark.usefixtures("page_rules")


@pytest.mark.parametrize("kind", KINDS)
def test_reactive_build_in_python_grows_the_bytes_of_the_kernel(kind):
    """All of the history is equal, for every kind of structure and way to climb."""
    params, seeds = KINDS[kind], range(SEED, SEED + 2)

    assert_same_growth(
        grow_seeds(params, 12, seeds),
        grow_seeds(with_rule(params, "reactive-build-python"), 12, seeds),
    )


@pytest.mark.trial
@pytest.mark.parametrize(("robots", "seeds"), [(30, 50), (100, 4)])
def test_reactive_build_in_python_grows_the_bytes_of_the_kernel_on_many_seeds(robots, seeds):
    """So the published laws of ReactiveBuild hold for the rule as for the kernel."""
    params = TowerParams()

    assert_same_growth(
        grow_seeds(params, robots, range(SEED, SEED + seeds)),
        grow_seeds(with_rule(params, "reactive-build-python"), robots, range(SEED, SEED + seeds)),
    )


@pytest.mark.parametrize("kind", ["tower", "bridge", "movers"])
def test_structures_of_a_random_rule_are_sound(kind):
    """No overlap, contacts at the right distance, and nobody stays alone, whatever is chosen."""
    params = with_rule(KINDS[kind], "random", flips=3)

    for history in grow_seeds(params, 15, [SEED, SEED + 1]):
        assert find_fault(history, contact_gap=0.02) == ""
        lonely = {*range(history.robot_count)} - {*history.contacts[:, [0, 2]].ravel().tolist()}
        assert len(lonely) <= params.founder_count


@pytest.mark.parametrize("rule", ["random", "ramp"])
def test_company_does_not_change_a_structure(rule):
    """A seed grows the same structure alone and in a batch, though a rule sees all at once."""
    params = with_rule(TowerParams(), rule)

    [alone] = grow_seeds(params, 12, [SEED + 1])

    assert_same_growth([alone], grow_seeds(params, 12, [SEED, SEED + 1, SEED + 2])[1:2])


def test_robots_stay_where_the_rule_says():
    """Random climbers stay after so many flips, at the first robot that they touch."""
    [history] = grow_seeds(with_rule(TowerParams(), "random", flips=4), 12, [SEED])

    for walk in history.walks[1:]:
        touched = np.unique(walk.contacts[:, 0])
        assert walk.stance_count - 1 == touched[touched >= 4].min()


def test_a_rule_may_call_in_its_own_way():
    """Robots that call from half the load end up under smaller loads."""
    late, early = (
        grow_seeds(with_rule(TowerParams(), name), 25, [SEED])[0]
        for name in ("reactive-build-python", "early-call")
    )

    assert early.sensed.max() < 0.7 * late.sensed.max()
    calls = registry.get("rule", "early-call")(share=1.0).call(np.array([1.0, 10.0]), TowerParams())
    assert calls.tolist() == [0, 5]


class Recorder:
    """A rule that keeps what it saw and then does as another rule."""

    name = "recorder"

    def __init__(self, like: str, call=None, spread=None) -> None:
        self.like, self.steps = registry.get("rule", like)(), []
        self.call = call or recruit
        self.spread = spread or (lambda call, contacts: relay(call, contacts, docks=3))

    def choose(self, step):
        """Keep the step, and choose."""
        seen = {
            name: np.array(getattr(step, name))
            for name in (
                "structure", "robot", "stance", "center", "orientation_wxyz", "walk", "touching",
                "on_ground", "called", "possible", "visited", "end", "end_orientation_wxyz",
                "angle", "pivot", "end_touching", "end_on_ground", "end_called", "dock", "relay",
                "robot_count", "sensed", "present",
            )
        }  # fmt: skip
        seen["draw"] = step.uniform("flip", 3)
        self.steps.append(seen)
        return self.like.choose(step)


def _recorded(params: GrowthParams, robots: int, seeds: list[int], like: str) -> list[dict]:
    rule = Recorder(like)
    params = dataclasses.replace(params)
    object.__setattr__(params, "rule", rule)
    grow_seeds(params, robots, seeds)
    return rule.steps


@pytest.fixture(scope="module")
def steps(page):
    """What climbers of two towers saw at some of their steps."""
    plugins.load_plugins([page])
    found = _recorded(TowerParams(force_threshold=4.0), 12, [SEED, SEED + 1], "early-call")
    return found[::7]


def test_a_step_states_what_flips_end_at(steps):
    """Ends are the poses that the flip makes; docks touch there what an oracle says they do."""
    for step in steps:
        for m, k in np.argwhere(step["possible"]).tolist():
            here, q = step["center"][m], step["orientation_wxyz"][m]
            end, turned = step["end"][m, k], step["end_orientation_wxyz"][m, k]
            docks = end + dock_offsets(turned[None], FIREANT.dock_offset_body)[0]
            before = here + dock_offsets(q[None], FIREANT.dock_offset_body)[0]
            pivot = step["pivot"][k]
            joined = step["dock"][step["structure"][m]][
                : 3 * step["robot_count"][step["structure"][m]]
            ]
            apart = np.linalg.norm(docks[:, None] - joined, axis=2)

            np.testing.assert_allclose(docks[pivot], before[pivot], atol=1e-12)
            turn = oracle.matrix(turned) @ oracle.matrix(q).T
            cosine = 0.5 * (np.trace(turn) - 1.0)
            assert abs(np.cos(step["angle"][m, k]) - cosine) < 1e-9
            assert apart.min(initial=9.0) > 2.0 - 1e-9
            assert docks[:, 2].min() > 1.0 - 1e-9
            for dock in range(3):
                touched = step["end_touching"][m, k, dock]
                assert {*touched[touched >= 0]} == {*np.flatnonzero(apart[dock] < 2.02)}
                assert step["end_on_ground"][m, k, dock] == (docks[dock, 2] < 1.02)
            relay = step["relay"][step["structure"][m]][: len(joined)]
            assert step["end_called"][m, k] == (relay[(apart < 2.02).any(axis=0)] > 0).any()
            walk = step["walk"][m, : step["stance"][m] + 1]
            near = np.linalg.norm(walk - end, axis=1).min()
            assert step["visited"][m, k] == (near < 0.05)


def test_a_step_states_where_climbers_are(steps):
    """The walk ends at the center; contacts of the stance and calls are those of the structure."""
    assert any(step["called"].any() for step in steps)
    for step in steps:
        for m in range(len(step["stance"])):
            s, stance = step["structure"][m], step["stance"][m]
            docks = step["center"][m] + dock_offsets(
                step["orientation_wxyz"][m][None], FIREANT.dock_offset_body
            )[0]  # fmt: skip
            joined = step["dock"][s][: 3 * step["robot_count"][s]]
            is_near = np.linalg.norm(docks[:, None] - joined, axis=2) < 2.02
            touching = step["touching"][m]

            np.testing.assert_array_equal(step["walk"][m, stance], step["center"][m])
            assert np.isnan(step["walk"][m, stance + 1 :]).all()
            assert {*touching[touching >= 0]} == {*np.nonzero(is_near)[1]}
            assert step["called"][m] == (step["relay"][s][: len(joined)][is_near.any(0)] > 0).any()
            draw = uniform(SEED + s, "flip", step["robot"][m], 2**16 * stance + np.arange(3))
            np.testing.assert_array_equal(step["draw"][m], draw)


def test_a_rule_may_spread_calls_in_its_own_way():
    """Where no call is passed on, nobody is recruited; the engine's relay is the default."""
    params = dataclasses.replace(TowerParams(force_threshold=2.0))
    silent = Recorder("reactive-build-python", spread=lambda call, _: np.repeat(0 * call, 3))
    object.__setattr__(params, "rule", silent)

    [quiet] = grow_seeds(params, 15, [SEED])
    [usual] = grow_seeds(TowerParams(force_threshold=2.0), 15, [SEED])

    assert not any(walk.recruited for walk in quiet.walks)
    assert any(walk.recruited for walk in usual.walks)


@pytest.mark.parametrize(
    ("returned", "problem"),
    [
        ("np.zeros(1)", r"wrong\.py: wrong\.choose returned float64; return integers"),
        ("np.zeros(9, int)", r"returned shape \(9,\); return a choice for each of 1 climbers"),
        ("np.array([99])", r"returned 99 for climber 0; return a possible flip, -1 to stay"),
        ("np.array([-9])", r"returned -9 for climber 0; .* stance s of its 1"),
        ("(~step.possible).argmax(axis=1)", "return a possible flip"),
        ("None", r"wrong\.choose returned None; return integers"),
        ("step.back(99)", r"returned -101 for climber 0; .* stance s of its 1"),
        ("step.flips", r"wrong\.py:\d+: wrong\.choose failed: AttributeError"),
        ("[[0], [1, 2]]", r"wrong\.py: wrong\.choose failed: ValueError"),
    ],
)
def test_a_wrong_choice_is_a_line(tmp_path, returned, problem):
    """It names the file, what was returned, and what to return."""
    code = "import numpy as np\nimport tiswarm\n\n@tiswarm.rule('wrong')\nclass Wrong:\n"
    code += f"    def choose(self, step):\n        return {returned}\n"
    (tmp_path / "wrong.py").write_text(code)
    plugins.load_plugins([tmp_path / "wrong.py"])

    with pytest.raises(plugins.PluginError, match=problem):
        grow_seeds(with_rule(TowerParams(), "wrong"), 3, [SEED])


@pytest.mark.parametrize("name", ["dock", "relay", "robot_count", "sensed"])
def test_a_rule_cannot_write_what_it_sees(tmp_path, name):
    """Docks that a rule moved would let the next robots stay inside others."""
    code = "import tiswarm\n\n@tiswarm.rule('writes')\nclass Writes:\n"
    code += f"    def choose(self, step):\n        step.{name}[...] = 0\n        return -1\n"
    (tmp_path / "writes.py").write_text(code)
    plugins.load_plugins([tmp_path / "writes.py"])

    with pytest.raises(
        plugins.PluginError, match=r"writes\.py:6: writes\.choose failed: .*read-only"
    ):
        grow_seeds(with_rule(TowerParams(), "writes"), 3, [SEED])


def test_a_rule_cannot_write_calls(tmp_path):
    """The loads that robots sensed are those of the record."""
    code = "import tiswarm\n\n@tiswarm.rule('calls')\nclass Calls:\n"
    code += "    def choose(self, step):\n        return -1\n\n"
    code += "    def call(self, sensed, params):\n        sensed[:] = 0.0\n        return sensed\n"
    (tmp_path / "calls.py").write_text(code)
    plugins.load_plugins([tmp_path / "calls.py"])

    with pytest.raises(plugins.PluginError, match=r"calls\.call failed: .*read-only"):
        registry.get("rule", "calls")().call(np.ones(2), None)


@pytest.mark.parametrize(
    ("end", "recruits"), [("-1", True), ("step.back(np.maximum(step.stance - 1, 0))", False)]
)
def test_who_goes_back_to_an_earlier_stance_is_not_recruited(tmp_path, end, recruits):
    """A climber is recruited where it is called and stays, however it climbed there."""
    code = "import numpy as np\nimport tiswarm\n\n@tiswarm.rule('turns-back')\nclass TurnsBack:\n"
    code += "    def choose(self, step):\n"
    code += "        flips = step.possible.argmax(axis=1)\n"
    code += (
        f"        return np.where((step.stance < 2) & step.possible.any(axis=1), flips, {end})\n"
    )
    (tmp_path / "turns_back.py").write_text(code)
    plugins.load_plugins([tmp_path / "turns_back.py"])

    [history] = grow_seeds(with_rule(TowerParams(force_threshold=0.01), "turns-back"), 8, [SEED])

    assert history.walks
    assert any(walk.recruited for walk in history.walks) == recruits


@pytest.mark.parametrize("one", ["-1", "step.back(0)"])
def test_one_choice_is_that_of_all_climbers(tmp_path, one):
    """A number stands for an array of equal ones."""
    grown = []
    for name, returned in [("one", one), ("each", f"np.full(len(step.robot), {one})")]:
        file = tmp_path / f"{name}.py"
        code = f"import numpy as np\nimport tiswarm\n\n@tiswarm.rule('{name}')\nclass Rule:\n"
        file.write_text(f"{code}    def choose(self, step):\n        return {returned}\n")
        plugins.load_plugins([file])
        grown += [grow_seeds(with_rule(TowerParams(), name), 3, [SEED])]

    assert f"or correct the rule {name}" in grown[1][0].ended
    assert_same_growth(
        *([dataclasses.replace(each, ended="") for each in found] for found in grown)
    )


RANDOM = """
import random

import numpy as np
import tiswarm
from numpy.random import default_rng

KEPT = np.random.default_rng(1)


@tiswarm.rule("draws")
class Draws:
    kept = np.random.RandomState(1)

    def choose(self, step):
        DRAW
        return -1
"""


@pytest.mark.parametrize(
    ("draw", "problem"),
    [
        ("np.random.random(3)", "the generator of numpy.random was used, whose numbers do not"),
        ("np.random.normal()", "the generator of numpy.random was used"),
        ("random.random()", "the generator of random was used"),
        ("KEPT.normal()", "the generator KEPT was used"),
        ("self.kept.normal()", "the generator kept was used"),
        ("np.random.default_rng().normal()", r"default_rng\(\) without a seed does not repeat"),
        ("default_rng().normal()", r"default_rng\(\) without a seed does not repeat"),
    ],
)
def test_random_numbers_of_a_rule_that_would_not_repeat_are_refused(tmp_path, draw, problem):
    """The same seed would grow another structure at each call, without a word."""
    file = tmp_path / "draws.py"
    file.write_text(RANDOM.replace("DRAW", draw))
    plugins.load_plugins([file])

    with pytest.raises(
        plugins.PluginError, match=rf"draws\.py.*: draws\.choose failed: .*{problem}"
    ):
        grow_seeds(with_rule(TowerParams(), "draws"), 3, [SEED])
    np.random.default_rng()  # that of others needs no seed


@pytest.mark.parametrize("draw", ["np.random.default_rng(3).normal()", "step.uniform('a', 2)"])
def test_random_numbers_of_a_rule_that_repeat_are_its_own(tmp_path, draw):
    """A generator of the call, and that of the step."""
    file = tmp_path / "draws.py"
    file.write_text(RANDOM.replace("DRAW", draw))
    plugins.load_plugins([file])

    [history] = grow_seeds(with_rule(TowerParams(), "draws"), 2, [SEED])

    assert history.robot_count >= 1
