"""Robots choose flips by where they believe docks are, and land where docks are."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import oracle
from tiswarm.base.robot import RobotGeometry
from tiswarm.evaluation.tables import totals
from tiswarm.world.growth import grow
from tiswarm.world.history_file import find_fault
from tiswarm.world.params import (
    BridgeParams,
    CantileverParams,
    ChainParams,
    ClimbParams,
    TowerParams,
)
from tiswarm.world.walks import Belief

FIREANT = RobotGeometry()
KINDS = [
    TowerParams(),
    TowerParams(movers=3, climb=ClimbParams(settle=0.5)),
    TowerParams(plane=True),
    CantileverParams(),
    BridgeParams(),
    ChainParams(),
]


def misplaced(sd, common=(0.0, 0.0, 0.0)):
    """Beliefs that are wrong by a common vector, and by an own one for each robot [R]."""

    def believe(grown):
        beliefs = []
        for structure in grown:
            history = structure.history()
            rng = np.random.default_rng(history.seed)
            error = rng.normal(scale=sd, size=(1_000, 3))[: history.robot_count] + common
            believed_sd = np.full(history.robot_count, sd)
            beliefs.append(Belief(history.position + error, history.orientation_wxyz, believed_sd))
        return beliefs

    return believe


def _built(params, *, robots=20, seeds=(0, 1), believe=None):
    return grow(params, robots=robots, seeds=seeds, robot=FIREANT, believe=believe)


def same(a, b):
    """Whether two robots walked the same way."""
    names = ("center", "orientation_wxyz", "pivot_dock", "contacts")
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)


@pytest.mark.parametrize("params", KINDS, ids=lambda params: params.kind)
def test_robots_that_believe_the_truth_build_what_robots_build_that_know_it(params):
    """The structures are equal to the last bit, and every flip ends where it was planned to."""
    known, believed = _built(params), _built(params, believe=misplaced(0.0))

    for one, other in zip(known, believed, strict=True):
        assert all(same(a, b) for a, b in zip(one.walks, other.walks, strict=True))
        assert (totals(other)["flips_as_planned"], totals(other)["failed_flips"]) == (1.0, 0.0)
        assert np.isnan([totals(one)["flips_as_planned"], totals(one)["failed_flips"]]).all()


@settings(max_examples=10)
@given(
    sd=st.floats(0.0, 6.0),
    params=st.sampled_from(KINDS),
    seed=st.integers(0, 10_000),
)
def test_structures_are_sound_whatever_robots_believe(sd, params, seed):
    """Docks do not overlap, contacts are as they are, and no pivot moves."""
    [history] = _built(params, seeds=[seed], believe=misplaced(sd))

    assert find_fault(history, contact_gap=0.02) == ""
    for walk in history.walks:
        for step, k in enumerate(walk.pivot_dock):
            before, after = (
                walk.center[at]
                + oracle.matrix(walk.orientation_wxyz[at]) @ history.robot.dock_offset_body[k]
                for at in (step, step + 1)
            )
            np.testing.assert_allclose(after, before, atol=1e-12)


def test_flips_fail_more_often_the_more_neighbors_are_misplaced():
    """Errors of 0, .3, 1 and 3 R spoil none, some, more and most of the flips.

    Flips that meet nothing are undone, and count apart from those that end elsewhere.
    """
    built = [_built(TowerParams(), believe=misplaced(sd)) for sd in (0, 0.3, 1, 3)]

    shares, failed = (
        [np.mean([totals(history)[name] for history in histories]) for histories in built]
        for name in ("flips_as_planned", "failed_flips")
    )

    assert (shares[0], failed[0]) == (1.0, 0.0)
    assert shares == sorted(shares, reverse=True)
    assert failed == sorted(failed)
    assert shares[-1] < 0.75
    assert failed[-1] > 0.05  # the third in a row ends a walk, so few fail


def test_a_flip_that_fails_is_a_step_of_the_walk():
    """Failed flips and stances after the best one are at most as many as the robot has patience."""
    spent = []
    for history in _built(TowerParams(), robots=30, believe=misplaced(2.0)):
        for walk in history.walks:
            if not walk.recruited and len(walk.planned_robot):
                last = len(walk.planned_robot)
                best = 2 * last + 1 - walk.stance_count  # the way back ends there
                spent.append(last - best + walk.failed_flips[best:].sum())

    assert max(spent) == TowerParams().climb.patience
    assert len(spent) > 20


def test_flips_are_counted_as_slow_words_have_it():
    """Tries are swings and failures; as planned are those that led a free dock to the place."""
    [history] = _built(TowerParams(), seeds=[2], believe=misplaced(1.0))
    tried = swung = good = 0
    for walk in history.walks:
        swung += walk.stance_count - 1 + sum(walk.failed_flips)
        tried += len(walk.planned_robot) + sum(walk.failed_flips)
        for flip, robot in enumerate(walk.planned_robot):
            free = {0, 1, 2} - {walk.pivot_dock[flip]}
            met = {i for at, own, i, _ in walk.contacts if at == flip + 1 and own in free}
            stands = [own for at, own in walk.ground_docks if at == flip + 1 and own in free]
            good += robot in met if robot >= 0 else bool(stands)

    found = totals(history)
    assert 0 < good < tried
    assert found["flips_as_planned"] == pytest.approx(good / tried)
    assert found["tries_per_robot"] == pytest.approx(swung / 20)


def test_robots_plan_by_the_orientation_that_they_sense():
    """With wrong orientations alone flips go wrong, and the more so the more they are turned."""
    shares = []
    for angle in (0.0, 0.05, 0.3):

        def turn(seed, robot, stances, angle=angle):
            axis = np.random.default_rng([seed, robot]).normal(size=(stances, 3))
            axis /= np.linalg.norm(axis, axis=1)[:, None]
            return np.column_stack([np.full(stances, np.cos(angle)), np.sin(angle) * axis])

        built = grow(
            TowerParams(), robots=20, seeds=(0, 1), robot=FIREANT, believe=misplaced(0.0), turn=turn
        )
        shares.append(np.mean([totals(history)["flips_as_planned"] for history in built]))

    assert shares[0] == 1.0
    assert shares[2] < shares[1] < 1.0
    assert shares[2] < 0.9


def test_errors_and_bytes_of_beliefs_are_kept_as_robots_join():
    """A walk has the RMSE of all, its robot's own error, the RMSE between neighbors, and bytes."""
    believe, errors = misplaced(1.0), []

    def spy(grown):
        [belief] = believe(grown)
        history = grown[0].history()
        errors.append(belief.center - history.position)
        return [belief._replace(sent=10 * np.arange(history.robot_count))]

    [history] = _built(TowerParams(), robots=8, seeds=[1], believe=spy)

    for j, (walk, error) in enumerate(zip(history.walks, errors, strict=True)):
        pairs = [(a, b) for a, _, b, _ in history.contacts if b <= j]
        between = [((error[a] - error[b]) ** 2).sum() for a, b in pairs] or [0.0]
        expected = [(error**2).sum(axis=1).mean(), (error[j] ** 2).sum(), np.mean(between)]
        np.testing.assert_allclose(walk.belief[:3], np.sqrt(expected), atol=1e-12)
        assert walk.belief[3:].tolist() == [5.0 * j, 10.0 * j]
    found = totals(history)
    assert found["belief_final_R"] == pytest.approx(history.walks[-1].belief[0])
    assert (found["belief_sent_B"], found["belief_worst_sent_B"]) == (35.0, 70.0)
    assert found["belief_newest_R"] == pytest.approx(
        np.sqrt(np.mean([walk.belief[1] ** 2 for walk in history.walks]))
    )


def test_a_common_shift_spoils_no_flip_of_a_robot_that_has_touched_another():
    """A robot takes its place from what it touches, so both are shifted alike."""
    shift = (3.0, -2.0, 1.0)
    for history in _built(TowerParams(), believe=misplaced(0.0, shift)):
        for walk in history.walks[1:]:
            first = walk.contacts[:, 0].min()
            touched = {(stance, other) for stance, _, other, _ in walk.contacts}
            for flip, robot in enumerate(walk.planned_robot):
                if flip >= first and robot >= 0:
                    assert (flip + 1, robot) in touched


def test_robots_stop_where_they_believe_to_be_nearest_to_the_goal():
    """Robots that believe to be 18 R higher than they are build half as high toward 20 R."""
    params = TowerParams(goal_height=20.0)
    lifted = _built(params, robots=40, believe=misplaced(0.0, (0.0, 0.0, 18.0)))
    known = _built(params, robots=40)

    for one, other in zip(lifted, known, strict=True):
        assert totals(one)["height_R"] < 0.5 * totals(other)["height_R"]


def test_a_seed_builds_the_same_in_any_company():
    """Structures whose robots believe what is wrong do not depend on those beside them."""
    params = replace(TowerParams(), movers=2)
    together = _built(params, seeds=[3, 4, 5], believe=misplaced(1.0))
    [alone] = _built(params, seeds=[4], believe=misplaced(1.0))

    assert all(same(a, b) for a, b in zip(together[1].walks, alone.walks, strict=True))
