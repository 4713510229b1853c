"""Rules that choose flips see where robots believe to be, and docks stop flips where they are."""

import numpy as np
import pytest

from tests import oracle
from tests.rules import FIREANT, SEED, assert_same_growth, grow_seeds, with_rule
from tests.world.test_beliefs import misplaced
from tiswarm.base import plugins
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study.navigation import navigate
from tiswarm.world.choices import reactive_build
from tiswarm.world.growth import GrowthBatch, SteeredGrowth, grow
from tiswarm.world.history import LEFT
from tiswarm.world.history_file import find_fault
from tiswarm.world.params import TowerParams

ERRORS = {
    "tower": {"kind": "independent", "size": 1.0},
    "bridge": {"kind": "adding-up", "size": 0.4},
    "cantilever": {"kind": "shift", "size": 2.0},
}
"""By kind of structure, errors of what robots believe."""

STRUCTURES = {
    "tower": {"movers": 3, "climb": {"settle": 0.5}},
    "bridge": {"gap": 20.0},
    "cantilever": {},
}
"""By kind, its other settings."""

REACH = np.linalg.norm(FIREANT.dock_offset_body, axis=1).max() + 1e-9
"""Distance from the center to a dock [R]: a flip moves the center by twice as much at most."""

RULES = '''
import numpy as np
import tiswarm


@tiswarm.rule("narrow", local=True)
class Narrow:
    def choose(self, step):
        return tiswarm.reactive_build(step)


@tiswarm.rule("moody")
class Moody:
    """Say what is believed, keep it, and leave after six rounds."""

    memory = 4
    message = 3
    rounds_after = 4

    def choose(self, step):
        return tiswarm.reactive_build(step)

    def act(self, members):
        members.memory[:] = np.column_stack([members.center, members.sd])
        members.say[:] = members.center[:, None]
        return members.age > 6
'''


@pytest.fixture
def rules(tmp_path):
    """A rule with memory, messages and leaving, loaded."""
    file = tmp_path / "moody.py"
    file.write_text(RULES)
    plugins.load_plugins([file])
    yield
    plugins.forget()


def scenario_with_error(kind):
    """Settings of a structure whose robots go by the truth and an error, and sense with noise."""
    by = {"navigate_by": "error", "belief_error": ERRORS[kind]}
    given = {
        "name": "x",
        "robots": 20,
        "seeds": 2,
        "structure": {"kind": kind, **STRUCTURES[kind], **by},
        "sensing": {"tilt_noise_deg": 1.0, "yaw_noise_deg": 3.0},
        "localization": {"method": "joint"},
    }
    return load_scenario(given)


def grown_by(settings, params, seeds=(SEED, SEED + 1)):
    """Structures that grow by settings of a scenario."""
    robots = settings.robots
    return grow(params, robots=robots, seeds=seeds, robot=FIREANT, **navigate(settings))


@pytest.mark.usefixtures("page_rules")
@pytest.mark.parametrize("kind", STRUCTURES)
def test_reactive_build_of_a_user_builds_by_errors_what_the_built_in_one_builds(kind):
    """The rule of the guide takes, tries and fails the same flips, to the last bit."""
    settings = scenario_with_error(kind)

    by_user = grown_by(settings, with_rule(settings.structure, "reactive-build-python"))

    built_in = grown_by(settings, settings.structure)
    assert_same_growth(built_in, by_user)
    assert sum(walk.failed_flips.sum() for history in by_user for walk in history.walks) > 20


@pytest.mark.usefixtures("page_rules")
def test_a_rule_whose_robots_believe_the_truth_builds_what_it_builds_by_the_truth():
    """A belief without error fails no flip of a rule that draws flips, and has no effect."""
    params = with_rule(TowerParams(movers=2), "random")

    believed = grow(params, robots=12, seeds=[SEED], robot=FIREANT, believe=misplaced(0.0))

    [by_truth] = grow_seeds(params, 12, [SEED])
    for walk, true_walk in zip(believed[0].walks, by_truth.walks, strict=True):
        np.testing.assert_array_equal(walk.center, true_walk.center)
        assert not walk.failed_flips.any()


@pytest.mark.usefixtures("page_rules")
@pytest.mark.parametrize("sd", [0.3, 3.0])
def test_structures_of_rules_are_sound_whatever_robots_believe(sd):
    """Docks do not overlap, contacts are as they are, and each flip turns about its pivot."""
    params = with_rule(TowerParams(movers=2), "random")

    [history] = grow(params, robots=12, seeds=[SEED], robot=FIREANT, believe=misplaced(sd))

    assert find_fault(history, contact_gap=0.02) == ""
    assert len(history.walks) == 12
    for walk in history.walks:
        for step, k in enumerate(walk.pivot_dock):
            before, after = (
                walk.center[at]
                + oracle.matrix(walk.orientation_wxyz[at]) @ history.robot.dock_offset_body[k]
                for at in (step, step + 1)
            )
            np.testing.assert_allclose(after, before, atol=1e-12)


def steps_by(believe, robots=10, seeds=(SEED, SEED + 1), params=TowerParams()):  # noqa: B008
    """Yield a batch and each step of climbers that build as ReactiveBuild does."""
    batch = GrowthBatch([params] * len(seeds), robots, seeds, FIREANT, believe, None)
    steered = SteeredGrowth(batch)
    batch.steered = steered
    while not steered.is_over.all():
        step = steered.observe()
        yield batch, step
        steered.step(reactive_build(step))


def test_climbers_see_places_as_the_robot_that_they_touch_believes_them():
    """All is shifted by the error of one robot, compared for each climber, walk and flip."""
    compared = 0
    for batch, step in steps_by(misplaced(0.8)):
        error = batch.believed.dock - batch.arrays.dock
        stances = batch.walks.stances
        for m, slot in enumerate(step.slot):
            stance = step.stance[m]
            touched = stances.touching[slot, : stance + 1, :, 0]
            at = [t for t in range(stance + 1) if (touched[t] >= 0).any()]
            docks = touched[at[-1]] if at else np.full(3, -1)
            by_pivot = [
                next((docks[(k + i) % 3] for i in range(3) if docks[(k + i) % 3] >= 0), -1)
                for k in range(3)
            ]
            shift = np.array([error[step.structure[m], dock] * (dock >= 0) for dock in by_pivot])
            sd = [0.8 if dock >= 0 else 0.0 for dock in by_pivot]
            true_center = stances.center[slot, stance]
            np.testing.assert_allclose(step.center[m] - true_center, shift[0], atol=1e-12)
            np.testing.assert_allclose(step.walk[m, stance], step.center[m], atol=1e-12)
            assert step.sd[m] == sd[0]
            assert step.end_sd[m].tolist() == [sd[k] for k in step.pivot]
            moved = np.linalg.norm(step.end[m] - true_center - shift[step.pivot], axis=1)
            assert (moved[step.possible[m]] < 2.0 * REACH).all()
            compared += bool(at)

    assert compared > 30


def test_climbers_see_docks_that_they_touch_where_these_are_believed():
    """Places and standard deviations are those of the docks and robots that `touching` names."""
    compared = 0
    for batch, step in steps_by(misplaced(0.8)):
        for m, k in np.argwhere(step.touching[:, :, 0] >= 0):
            item = step.touching[m, k, 0]
            np.testing.assert_array_equal(
                step.touched_dock[m, k], batch.believed.dock[step.structure[m], item]
            )
            assert step.touched_sd[m, k] == step.robot_sd[step.structure[m], item // 3] == 0.8
            compared += 1
        nothing = step.touching[:, :, 0] < 0
        assert np.isnan(step.touched_dock[nothing]).all()
        assert np.isnan(step.touched_sd[nothing]).all()

    assert compared > 30


@pytest.mark.usefixtures("rules")
def test_a_local_rule_believes_ends_by_the_robots_that_it_touches_and_fails_no_flip():
    """A flip ends where it truly meets something; its place is shifted as the pivot's robot is."""
    params = with_rule(TowerParams(), "narrow")
    compared = 0
    for batch, step in steps_by(misplaced(1.0), params=params):
        climb = batch.walks
        slots = step.slot
        true = [batch.steered._climb._flips.center[slot] for slot in slots]  # noqa: SLF001
        source = climb.sources(slots, step.stance)
        error = (batch.believed.dock - batch.arrays.dock).reshape(len(batch.sd), -1, 3, 3)[:, :, 0]
        for m, k in np.argwhere(step.possible & (source[:, step.pivot] >= 0)):
            shift = error[step.structure[m], source[m, step.pivot[k]]]
            np.testing.assert_allclose(step.end[m, k], true[m][k] + shift, atol=1e-12)
            compared += 1
        assert not step.failed.any()

    assert compared > 100


def test_a_flip_that_fails_leaves_the_climber_where_it_stood_and_is_not_possible_again():
    """It counts as a try until the climber stands elsewhere."""
    before = {}
    failures = 0
    for batch, step in steps_by(misplaced(2.0)):
        for m, slot in enumerate(step.slot):
            key = (step.structure[m], step.robot[m])
            stance, tries, center = before.get(key, (-1, 0, None))
            failed = step.failed[m].sum()
            if stance == step.stance[m] and failed:
                failures += 1
                assert step.tries[m] == tries + 1
                np.testing.assert_array_equal(batch.walks.stances.center[slot, stance], center)
            assert not (step.failed[m] & step.possible[m]).any()
            assert step.tries[m] - step.walk_tries[m, step.stance[m]] == failed
            center = batch.walks.stances.center[slot, step.stance[m]].copy()
            before[key] = (step.stance[m], step.tries[m], center)

    assert failures > 10


def test_structures_by_beliefs_do_not_depend_on_their_company():
    """A seed builds alone, among others and at its own pace what it builds with all in step."""
    settings = scenario_with_error("tower")
    params = settings.structure
    together = grown_by(settings, params, seeds=[3, 4, 5])
    batch = GrowthBatch([params] * 2, 20, [5, 4], FIREANT, **navigate(settings))
    steered = SteeredGrowth(batch)
    while not steered.is_over.all():
        steered.step(reactive_build(steered.observe()))

    at_own_pace = batch.histories(batch.numbers)
    assert_same_growth([together[2], together[1]], at_own_pace)


@pytest.mark.usefixtures("rules")
def test_members_act_by_where_they_believe_to_be_and_leave():
    """They keep and say believed places; who leaves is gone, and the others stay sound."""
    params = with_rule(TowerParams(), "moody")
    batch = GrowthBatch([params], 10, [SEED], FIREANT, misplaced(0.5), None)
    steered = SteeredGrowth(batch, together=True)
    while not steered.is_over.all():
        steered.step(params.rule.choose(steered.observe()))

    [history] = batch.histories(batch.numbers)
    kept = batch.members.memory[0, :10]
    left = history.departures[history.departures[:, 2] == LEFT, 0]
    believed = batch.believed.dock[0].reshape(10, 3, 3).mean(axis=1)
    stays = ~history.is_gone
    assert len(left) > 0
    assert find_fault(history, contact_gap=0.02) == ""
    np.testing.assert_allclose(kept[stays, :3], believed[stays], atol=1e-12)
    assert (kept[stays, 3] == 0.5).all()
    assert (np.linalg.norm(kept[stays, :3] - history.position[stays], axis=1) > 0.05).all()


@pytest.mark.usefixtures("rules")
def test_a_robot_that_joins_acts_by_the_place_that_it_believed_as_it_climbed():
    """Its first round comes before it is localized, and the truth is hidden from it then, too."""
    params = with_rule(TowerParams(), "moody")
    shift = np.array([7.0, 0.0, 0.0])
    batch = GrowthBatch([params], 6, [SEED], FIREANT, misplaced(0.0, tuple(shift)), None)
    acted = []
    act = batch.members.act

    def spy(rule_act, numbers, present):
        joined = int(present[0].sum())
        acted.append((joined, batch.members.center[0, :joined].copy()))
        return act(rule_act, numbers, present)

    batch.members.act = spy
    steered = SteeredGrowth(batch, together=True)
    while batch.arrays.robot_count[0] < 4:
        steered.step(params.rule.choose(steered.observe()))

    true = batch.arrays.dock[0].reshape(6, 3, 3).mean(axis=1)
    newest = {}
    for joined, center in acted:
        newest.setdefault(joined, center[-1])
    assert sorted(newest) == [1, 2, 3, 4]
    np.testing.assert_allclose(newest[1], true[0], atol=1e-9)  # it has touched nobody
    for joined in (2, 3, 4):
        np.testing.assert_allclose(newest[joined], true[joined - 1] + shift, atol=1e-9)
