"""Rules by what robots sense, remember, say and hear: local views, waiting, leaving."""

import numpy as np
import pytest

import tiswarm
from tests.rules import SEED, assert_same_growth, grow_seeds
from tests.world.test_beliefs import misplaced
from tiswarm.base import plugins, registry
from tiswarm.base.errors import InputError
from tiswarm.world.choices import reactive_build
from tiswarm.world.growth import GrowthBatch, SteeredGrowth, chosen_by
from tiswarm.world.history import LEFT
from tiswarm.world.members import BYTES, LOCAL, LocalStep, MemberArrays, Members
from tiswarm.world.params import BridgeParams, TowerParams

RULES = '''
import numpy as np
import tiswarm


@tiswarm.rule("local-reactive-build", local=True)
class LocalReactiveBuild:
    def choose(self, step):
        return tiswarm.reactive_build(step)


@tiswarm.rule("polite", local=True)
class Polite:
    """Wait for two rounds at the first robot, then climb on; leave after five rounds."""

    memory = 2
    message = 1
    rounds_after = 6

    def choose(self, step):
        touches = (step.touching >= 0).any(axis=(1, 2))
        waits = touches & (step.memory[:, 0] < 2)
        step.memory[waits, 0] += 1
        heard = np.nanmax(step.heard, axis=(1, 2), initial=0)
        step.memory[:, 1] = np.fmax(step.memory[:, 1], heard)
        return np.where(waits, step.wait, tiswarm.reactive_build(step))

    def act(self, members):
        members.say[:] = members.memory[:, None, 1:] + 1
        np.fmax.at(members.memory[:, 1], members.contacts[:, 0], members.heard[:, 0])
        return members.age > 5


@tiswarm.rule("global", local=True)
class Global:
    def choose(self, step):
        return -1 * (step.dock[0, 0, 0] > 0)


@tiswarm.rule("wrong-act")
class WrongAct:
    def choose(self, step):
        return tiswarm.reactive_build(step)

    def act(self, members):
        return [1.5]
'''


@pytest.fixture
def rules(tmp_path):
    """File with local rules, loaded."""
    file = tmp_path / "local_rules.py"
    file.write_text(RULES)
    plugins.load_plugins([file])
    yield file
    plugins.forget()


def params_of(name, kind=TowerParams, **settings):
    """Settings of a structure that grows by a rule of the file."""
    return kind(rule=registry.get("rule", name)(), **settings)


def states(name, robots=8, believe=None):
    """Yield the rule and each step of climbers of two structures that grow by it."""
    params = params_of(name)
    shape = tiswarm.RobotGeometry()
    batch = GrowthBatch([params] * 2, robots, [SEED, SEED + 1], shape, believe, None)
    steered = SteeredGrowth(batch)
    batch.steered = steered
    while not steered.is_over.all():
        step = steered.observe()
        yield params.rule, batch, step
        steered.step(chosen_by(params.rule, step))


@pytest.mark.usefixtures("rules")
def test_reactive_build_needs_no_more_than_its_own_senses():
    """Growth by what climbers touch and hear alone is that of the rule that sees all."""
    assert_same_growth(
        grow_seeds(TowerParams(), 10, [SEED]),
        grow_seeds(params_of("local-reactive-build"), 10, [SEED]),
    )


@pytest.mark.usefixtures("rules")
@pytest.mark.parametrize("name", ["local-reactive-build", "polite"])
def test_a_local_choice_does_not_depend_on_what_a_robot_does_not_know(name):
    """Robots out of reach move, loads and calls of all change, and each climber chooses alone."""
    rng = np.random.default_rng(0)
    steps = 0
    for rule, batch, step in states(name):
        chosen = [
            int(rule.choose(LocalStep(step, np.array([m])))[0]) for m in range(len(step.stance))
        ]
        saved = [batch.arrays.dock.copy(), batch.sensed.copy(), batch.members.said.copy()]
        for m in range(len(step.stance)):
            dock = batch.arrays.dock[step.structure[m]]
            is_far = np.linalg.norm(dock - step.center[m], axis=1) > 9.0
            dock[is_far] += rng.normal(size=(is_far.sum(), 3))
            touched = step.touching[m][step.touching[m] >= 0] // 3
            untouched = np.setdiff1d(np.arange(batch.robots), touched)
            batch.members.said[step.structure[m], untouched] = rng.normal()
            batch.sensed[:] = rng.normal(size=batch.sensed.shape)
            alone = LocalStep(step, np.array([m]))
            assert rule.choose(alone).tolist() == [chosen[m]]
        batch.arrays.dock[:], batch.sensed[:], batch.members.said[:] = saved
        steps += 1

    assert steps > 20


def seen_locally(step, row):
    """List all that one climber of a local rule knows, as bytes."""
    local = LocalStep(step, np.array([row]))
    arrays = [getattr(local, name) for name in sorted(LOCAL)]
    return [np.ascontiguousarray(array).tobytes() for array in arrays]


@pytest.mark.usefixtures("rules")
def test_a_local_climber_learns_no_place_that_its_docks_do_not_pass_on():
    """All robots that it has not touched come to believe other places, and loads change.

    It is asked anew after that. What it sees has not changed in a bit: neither where it believes
    itself and its flips to end, nor what these meet, nor how sure it is of that.
    """
    rng = np.random.default_rng(0)
    compared = 0
    for _, batch, step in states("local-reactive-build", believe=misplaced(0.7)):
        climb = batch.steered._climb  # noqa: SLF001 - to observe again
        for row, slot in enumerate(step.slot):
            before = seen_locally(step, row)
            number = step.structure[row]
            walked = batch.walks.stances.touching[slot, : step.stance[row] + 1]
            touched = np.unique(walked[walked >= 0] // 3)
            joined = batch.arrays.robot_count[number]
            untouched = np.setdiff1d(np.arange(joined), touched)
            saved = [array.copy() for array in (batch.believed.dock, batch.sd, batch.sensed)]
            dock = batch.believed.dock[number].reshape(-1, 3, 3)
            dock[untouched] += rng.normal(size=(len(untouched), 1, 3))
            batch.sd[number, untouched] += 1.0
            batch.sensed[:] = rng.normal(size=batch.sensed.shape)
            batch._list([batch.structures[number]], *batch.believed.cells, batch.believed.dock)  # noqa: SLF001

            after = seen_locally(climb.observe(), row)

            assert after == before
            compared += len(untouched) > 0
            batch.believed.dock[:], batch.sd[:], batch.sensed[:] = saved
            batch._list([batch.structures[number]], *batch.believed.cells, batch.believed.dock)  # noqa: SLF001
            climb.observe()

    assert compared > 10


@pytest.mark.usefixtures("rules")
def test_a_local_rule_that_looks_at_others_is_refused():
    """The line says what a climber knows."""
    with pytest.raises(plugins.PluginError, match="a climber of a local rule does not know dock"):
        grow_seeds(params_of("global"), 4, [SEED])


@pytest.mark.usefixtures("rules")
def test_robots_wait_remember_and_leave_of_their_own_accord():
    """Each waits two rounds; the structure dissolves but for its founder."""
    [history] = grow_seeds(params_of("polite"), 6, [SEED])

    joined = np.array([walk.round for walk in history.walks])
    assert (np.diff(joined) >= 3).all()
    assert len(history.walks) == 6
    left = history.departures[history.departures[:, 2] == LEFT, 0]
    assert 0 not in left
    assert history.is_held.sum() < 6


@pytest.mark.usefixtures("rules")
def test_members_hear_what_those_that_they_touch_said_a_round_before():
    """Compared with a walk over contacts, robot by robot; bytes are counted by contact."""
    arrays = MemberArrays(
        registry.get("rule", "polite")(), structures=1, robots=3, slots=1, docks=2
    )
    arrays.contacts = np.array([[0, 0, 1, 1, 0], [0, 1, 0, 0, 1], [0, 1, 1, 2, 0], [0, 2, 0, 1, 1]])
    heard = []

    def act(members):
        heard.append([tuple(row) for row in np.column_stack([members.contacts, members.heard])])
        members.say[:, :, 0] = 10.0 * np.arange(3)[:, None] + np.arange(2) + 100.0 * len(heard)
        return np.array([False, False, True])

    present = np.ones((1, 3), bool)
    leaves = arrays.act(act, np.array([0]), present)
    arrays.act(act, np.array([0]), present)

    assert leaves.tolist() == [[False, False, True]]
    assert all(np.isnan(row[4]) for row in heard[0])
    said = {(robot, dock): 100.0 + 10 * robot + dock for robot in range(3) for dock in range(2)}
    assert heard[1] == [(*row, said[row[2], row[3]]) for row in arrays.contacts[:, 1:].tolist()]
    assert arrays.sent.tolist() == [[2 * BYTES, 4 * BYTES, 2 * BYTES]]


@pytest.mark.usefixtures("rules")
def test_a_bridge_dissolves_without_those_that_only_it_held():
    """Those who leave take with them whom nothing else holds; the others stay sound."""
    params = params_of("polite", BridgeParams, gap=8.0)

    [history] = grow_seeds(params, 10, [SEED])

    assert len(history.departures) > 0
    assert history.is_held[0]


@pytest.mark.usefixtures("page_rules")
def test_robots_that_hear_of_no_joiner_leave_from_the_top():
    """The rule of the guide: who leaves was nearer to the goal than whoever stood beside it."""
    [history] = grow_seeds(params_of("visit"), 8, [SEED])

    robot, _, event = history.departures.T
    distance = np.linalg.norm(history.position - [0.0, 0.0, 65.0], axis=1)
    first = robot[event == LEFT][0]
    neighbors = [pair for pair in history.contacts[:, [0, 2]].tolist() if first in pair]
    assert len(history.walks) == 8
    assert (event == LEFT).sum() >= 4
    assert all(distance[first] <= distance[pair].min() for pair in neighbors)
    assert (history.sent > 0).all()


@pytest.mark.usefixtures("rules")
def test_what_act_wrongly_returns_is_a_line():
    """It says what to return."""
    with pytest.raises(plugins.PluginError, match=r"wrong-act\.act .*return True for each of 1"):
        grow_seeds(params_of("wrong-act"), 4, [SEED])


def test_a_caller_may_let_climbers_wait():
    """Waiting ends growth only after as many rounds as robots may be spawned in vain."""
    growth = tiswarm.Growth({"kind": "tower", "climb": {"max_spawns": 4}}, robots=4, seeds=1)

    while not growth.is_over.all():
        step = growth.observe()
        touches = (step.touching >= 0).any(axis=(1, 2))
        growth.step(np.where(touches, step.wait, reactive_build(step)))

    assert growth.robot_count.tolist() == [1]
    assert growth.ended[0].startswith("robots waited for 4 rounds, and none joined; raise")


def written(tmp_path, text):
    """Load a file with rules."""
    file = tmp_path / "written_rules.py"
    file.write_text("import numpy as np\nimport tiswarm\n" + text)
    plugins.load_plugins([file])
    return file


TALKER = """
@tiswarm.rule("talker", local=True)
class Talker:
    memory = 2
    message = 1
    def choose(self, step):
        {choose}
        return tiswarm.reactive_build(step)
    def act(self, members):
        {act}
"""


@pytest.mark.parametrize("size", ["-1", "1.5", "True", "'two'"])
@pytest.mark.parametrize("name", ["memory", "message", "rounds_after"])
def test_numbers_of_a_rule_are_checked_as_its_file_is_read(tmp_path, name, size):
    """The line names the file, the rule, the number and what to write."""
    text = f'@tiswarm.rule("odd")\nclass Odd:\n    {name} = {size}\n    choose = lambda s, t: -1\n'

    with pytest.raises(InputError, match=rf"odd: {name} is .*write a whole number") as refused:
        written(tmp_path, text)

    assert refused.value.path.name == "written_rules.py"


def test_a_number_of_a_rule_that_is_a_setting_is_checked_too(tmp_path):
    """A scenario may give it."""
    text = '@tiswarm.rule("odd")\nclass Odd:\n    memory: int = 1\n    choose = lambda s, t: -1\n'
    written(tmp_path, text)

    with pytest.raises(InputError, match=r"memory is -1; write a whole number"):
        tiswarm.grow("tower", robots=3, rule={"name": "odd", "memory": -1})

    plugins.forget()


@pytest.mark.parametrize(
    ("choose", "act", "problem"),
    [
        ("", "members.memory[:, 5] = 1", "memory = 2 and message = 1"),
        ("step.memory[:, 5] = 1", "", "memory = 2 and message = 1"),
        ("", "np.random.rand()", "members.uniform in act"),
        ("", "members.robots", "does not know robots; it knows .*contacts.*robot.*say"),
        ("", "members.says = 1", "says cannot be written; .*memory and say alone"),
        ("step.say = 1", "", "say cannot be written; .*memory alone"),
        ("", "members.memory = np.zeros(3)", r"members.memory of shape \(3,\); write"),
        ("step.memory = None", "", "step.memory of shape none; write"),
        ("", "members.say[:] = np.inf", "message with an infinite number; say finite"),
    ],
)
def test_a_mistake_of_a_local_rule_says_what_to_write(tmp_path, choose, act, problem):
    """A line with the file, the method and the remedy."""
    written(tmp_path, TALKER.format(choose=choose or "pass", act=act or "pass"))

    with pytest.raises(plugins.PluginError, match=problem) as refused:
        grow_seeds(params_of("talker"), 4, [SEED])

    assert "written_rules.py" in str(refused.value)
    assert "talker." in str(refused.value)
    plugins.forget()


def test_an_array_that_a_rule_replaces_counts_as_written(tmp_path):
    """Memory and messages that are assigned are those that robots keep and hear."""
    places = "members.memory = members.memory + 1; members.say = np.full(members.say.shape, 2.0)"
    written(tmp_path, TALKER.format(choose="step.memory = step.memory + 0.5", act=places))
    params = params_of("talker")
    batch = GrowthBatch([params], 4, [SEED], tiswarm.RobotGeometry(), None, None)
    steered = SteeredGrowth(batch)

    while not steered.is_over.all():
        steered.step(chosen_by(params.rule, steered.observe()))

    members = batch.members
    assert (members.memory[0, :, 0] > 1.0).all()
    assert (members.memory[0, 1:, 0] % 1.0 == 0.5).any()
    assert np.nanmax(members.said) == 2.0
    plugins.forget()


def test_members_know_their_numbers(tmp_path):
    """They are those by which contacts name neighbors: who joined first is 0."""
    text = "assert (members.robot == np.arange(len(members.age)) % 4).all(); return None"
    written(tmp_path, TALKER.format(choose="pass", act=text))

    [history] = grow_seeds(params_of("talker"), 4, [SEED])

    assert history.robot_count == 4
    plugins.forget()


@pytest.mark.parametrize("kind", [Members, LocalStep])
def test_help_lists_what_robots_of_a_rule_see(kind):
    """Each attribute has a sentence with its shape."""
    shown = {name: value for name, value in vars(kind).items() if isinstance(value, property)}

    assert {"memory", "heard", "sd", "center", "goal"} <= {*shown}
    assert all("(" in value.__doc__ for name, value in shown.items() if name != "wait")


def test_a_growth_takes_a_rule_as_a_class(tmp_path):
    """So does the structure of a mapping; a class without the decorator is refused in a line."""
    text = "\nKIND = Talker\n"
    written(tmp_path, TALKER.format(choose="pass", act="pass") + text)
    rule_class = type("Plain", (), {"name": "talker"})

    with pytest.raises(InputError, match=r"Plain is no rule; give its name, .*@tiswarm\.rule"):
        tiswarm.Growth({"kind": "tower", "rule": rule_class}, robots=3)

    growth = tiswarm.Growth({"kind": "tower", "rule": registry.get("rule", "talker")}, robots=3)
    assert len(growth) == 1
    plugins.forget()


def test_structures_of_a_rule_that_is_not_loaded_say_how_to_load_it(tmp_path):
    """The line names what Python code can do."""
    written(tmp_path, TALKER.format(choose="pass", act="pass"))
    swarms = tiswarm.grow("tower", robots=3, rule="talker", quiet=True)
    file = swarms.save(tmp_path / "swarms.npz")
    plugins.forget()

    with pytest.raises(
        InputError, match=r"import its file first, or name it in plugins"
    ) as refused:
        tiswarm.open_swarms(file)

    assert "--plugin" not in str(refused.value)


@pytest.mark.usefixtures("page_rules")
def test_the_rule_of_the_guide_is_local():
    """Its robots decide alone as they do among others, as they climb and as they act."""
    assert tiswarm.check_local("visit", robots=5) > 100


@pytest.mark.parametrize(
    ("choose", "act", "method"),
    [
        (
            "return np.full(len(step.stance), -1 - (len(step.stance) > 1))",
            "",
            "choose",
        ),
        ("step.memory[:] = step.stance.sum() + len(step.stance)", "", "choose"),
        ("", "members.memory[:, 0] = members.center[:, 2].max()", "act"),
        ("", "members.say[:] = len(members.age)", "act"),
        ("", "return members.age > members.age.mean()", "act"),
        ("", "COUNT.append(0); members.memory[:, 0] = len(COUNT)", "act"),
    ],
)
def test_a_rule_that_knows_of_others_is_not_local(tmp_path, choose, act, method):
    """The line names the method and the robot."""
    text = TALKER.format(choose=choose or "pass", act=act or "pass")
    written(tmp_path, "COUNT = []\n" + text)

    with pytest.raises(plugins.PluginError, match=rf"talker\.{method} is not local: robot \d+"):
        tiswarm.check_local("talker", {"kind": "tower", "movers": 2}, robots=5)

    plugins.forget()


def test_a_rule_that_sees_all_is_refused_as_local():
    """The line says how to register it."""
    with pytest.raises(InputError, match="register it with local=True"):
        tiswarm.check_local("reactive-build")


@pytest.mark.usefixtures("page_rules")
def test_a_local_rule_grows_step_by_step_what_it_grows_alone():
    """A caller that asks the rule for its choices ends where `grow` does, memory included."""
    rule = registry.get("rule", "visit")()
    growth = tiswarm.Growth({"kind": "tower", "rule": rule}, robots=5, seeds=[SEED])

    while not growth.is_over.all():
        growth.step(chosen_by(rule, growth.observe()))

    [alone] = tiswarm.grow("tower", robots=5, seeds=[SEED], rule=rule, quiet=True)
    assert growth.swarms()[0].departures.tolist() == alone.departures.tolist()
    assert growth.swarms().sent[0].tolist() == alone.sent.tolist()


def test_a_rule_of_all_that_a_climber_knows_is_local(tmp_path):
    """Also by how sure it is of its place, which it has of the robot that it touched last."""
    text = "step.memory[:, 0] = np.nan_to_num(step.sd); step.memory[:, 1] += step.called"
    written(
        tmp_path, TALKER.format(choose=text, act="members.say[:] = members.memory[:, None, :1]")
    )

    assert tiswarm.check_local("talker", robots=4) > 20
    plugins.forget()
