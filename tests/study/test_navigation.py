"""Robots build by what the method of their case estimates as they join."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from tests.runs import REPOSITORY
from tests.structures import grown
from tests.world.test_beliefs import same
from tiswarm import study
from tiswarm.base.errors import InputError
from tiswarm.base.progress import Progress
from tiswarm.evaluation.tables import by_join
from tiswarm.localization.distributed.method import PeerSwarm
from tiswarm.localization.methods import joining, localize
from tiswarm.scenario.expansion import load_scenario, variants
from tiswarm.sensing import observe
from tiswarm.study import navigation
from tiswarm.world.growth import grow
from tiswarm.world.params import BeliefErrorParams, BridgeParams

SETS = ["robots=10", "seeds=2", "sensing.tilt_noise_deg=1"]
BY_ESTIMATE = "structure.navigate_by=estimate"
BOTH = [
    "sweep={structure.navigate_by: [truth, estimate]}",
    "conditions={once: {}, back: {localization.back_propagation: {every: 5}}}",
]


def _loaded(*sets):
    return load_scenario(REPOSITORY / "tests" / "tower.yaml", [*SETS, *sets])


def _run(folder, *sets) -> Path:
    return study.run(_loaded(*sets), folder, progress=Progress()).folder


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A run whose robots know the truth or go by either of two ways to localize."""
    return _run(tmp_path_factory.mktemp("loop"), *BOTH)


def test_each_condition_builds_structures_of_its_own(built):
    """By the truth, conditions share their structures; by estimates, no two have the same."""
    cases = pd.read_csv(built / "summary.csv")
    truth = cases["structure.navigate_by"] == "truth"

    assert cases.loc[truth].groupby("seed")["rms_radius_R"].nunique().tolist() == [1, 1]
    assert cases.loc[~truth].groupby("seed")["rms_radius_R"].nunique().max() == 2
    assert cases.loc[truth, "flips_as_planned"].isna().all()
    assert cases.loc[~truth, "flips_as_planned"].between(0.2, 0.999).all()


def test_conditions_that_built_different_structures_are_not_paired(built):
    """Differences on the same structures are those of robots that know the truth."""
    pairs = pd.read_csv(built / "paired.csv")

    assert set(pairs["structure.navigate_by"]) == {"truth"}


def _believed(settings, *, robots):
    """Structures of a growth, each with what its robots believe."""
    believe, found = navigation.believe_by(settings), []

    def spy(grown):
        beliefs = believe(grown)
        found.extend((s.history(), belief) for s, belief in zip(grown, beliefs, strict=True))
        return beliefs

    [built] = grow(settings.structure, robots=robots, seeds=[4], robot=settings.robot, believe=spy)
    return [*found[:-1], (built, found[-1][1])]


def test_robots_go_by_what_the_log_of_those_before_them_localizes_to():
    """Beliefs are the estimates of the method, on what a structure's robots sensed by then."""
    settings = variants(_loaded(BY_ESTIMATE))[0].settings

    believed = _believed(settings, robots=9)

    assert [history.robot_count for history, _ in believed] == [*range(1, 10)]
    for history, belief in believed:
        log = observe(history, settings.sensing)
        np.testing.assert_allclose(
            belief.center, localize(log, settings.localization).position, atol=1e-9
        )


MESSAGES = (
    "conditions={messages: {localization: {method: distributed, chains: 1, steps: 20, reviews: 0}}}"
)
PUBLISHED = "conditions={published: {localization: {method: distributed, scheme: algorithm-1}}}"


@pytest.mark.parametrize("by", [MESSAGES, PUBLISHED])
def test_robots_that_build_send_what_those_of_a_whole_log_do(by):
    """By messages, each join goes on from what robots know; places and bytes are those counted."""
    settings = variants(_loaded(BY_ESTIMATE, by))[0].settings

    believed = _believed(settings, robots=9)

    for history, belief in believed[::4]:
        found = localize(observe(history, settings.sensing), settings.localization)
        # Heights are sent relative to other points, and rounded to 16 bits.
        np.testing.assert_allclose(belief.center, found.position, atol=0.01)
        assert belief.sent.sum() == pytest.approx(found.traffic["sent"].sum(), rel=0.1)
    by_then = by_join(believed[-1][0])["sent_B"]
    assert by_then.tolist() == [belief.sent.mean() for _, belief in believed]


def test_each_robot_joins_once_while_it_builds_by_messages(monkeypatch):
    """Nothing is solved anew: a bridge's robots join the swarm of their side one by one."""
    structure = "structure={kind: bridge, gap: 30, navigate_by: estimate}"
    settings, joined = variants(_loaded(structure, MESSAGES))[0].settings, []
    join = PeerSwarm.join
    monkeypatch.setattr(
        PeerSwarm, "join", lambda swarm, line: (joined.append(line.robot), join(swarm, line))
    )

    history = _believed(settings, robots=10)[-1][0]

    sides = np.unique(navigation.founders_of(history), return_counts=True)[1]
    assert sorted(joined) == sorted(number for size in sides for number in range(size))
    assert len(joined) == 10


def test_each_side_of_a_gap_has_an_anchor_and_does_not_know_the_other_side():
    """The first robot of each side is where it is; others are where their own side puts them."""
    structure = "structure={kind: bridge, gap: 30, navigate_by: estimate}"

    history, belief = _believed(variants(_loaded(structure))[0].settings, robots=10)[-1]

    error = np.linalg.norm(belief.center - history.position, axis=1)
    side = history.position[:, 0] > 15.0
    assert 0 < side.sum() < 10
    assert error[np.flatnonzero(side)[0]] < 1e-9
    assert error[np.flatnonzero(~side)[0]] < 1e-9
    assert error.max() < 8.0  # of 30 R and more if both took their place from one anchor


def test_methods_that_place_robots_as_they_join_build_what_whole_logs_do(monkeypatch):
    """Placed one by one or localized anew after each join, robots are believed at one place."""
    settings = variants(_loaded(BY_ESTIMATE))[0].settings
    assert joining(settings.localization)

    def built():
        return grow(
            settings.structure, robots=10, seeds=[1], robot=settings.robot,
            believe=navigation.believe_by(settings),
        )[0]  # fmt: skip

    one_by_one = built()
    monkeypatch.setattr(navigation.methods, "joining", lambda _: None)
    anew = built()

    assert all(same(a, b) for a, b in zip(one_by_one.walks, anew.walks, strict=True))


def test_climbing_robots_plan_by_the_orientations_of_their_log():
    """The turns of growth lead from the true orientations to the logged ones."""
    settings = variants(_loaded(BY_ESTIMATE, "sensing.yaw_noise_deg=2"))[0].settings
    by = navigation.navigate(settings)
    [history] = grow(settings.structure, robots=4, seeds=[3], robot=settings.robot, **by)

    log = observe(history, settings.sensing)
    for j, walk in enumerate(history.walks):
        turn = Rotation.from_quat(by["turn"](3, j, walk.stance_count), scalar_first=True)
        true = Rotation.from_quat(walk.orientation_wxyz, scalar_first=True)
        sensed = (turn * true).as_quat(canonical=True, scalar_first=True)
        start, end = log.stances.start[j : j + 2]
        np.testing.assert_allclose(sensed[:-1], log.stances.orientation_wxyz[start:end], atol=1e-9)
        np.testing.assert_allclose(sensed[-1], log.orientation_wxyz[j], atol=1e-9)


@pytest.fixture(scope="module")
def bridges():
    """One bridge with eight robots, and with twelve."""
    return [grown(BridgeParams(gap=30.0), robots=robots, seed=0) for robots in (8, 12)]


def _errors(bridge, kind, size):
    return navigation.error_of(bridge, BeliefErrorParams(kind=kind, size=size))


@pytest.mark.parametrize("kind", ["independent", "shift", "turn", "adding-up"])
def test_anchors_know_their_places_and_robots_keep_their_errors(bridges, kind):
    """A robot whose error changed with each join would not go by one wrong belief."""
    small, large = (_errors(bridge, kind, 0.5) for bridge in bridges)

    anchors = np.unique(navigation.founders_of(bridges[1]))
    assert len(anchors) == 2
    assert (large[anchors] == 0.0).all()
    np.testing.assert_allclose(large[:8], small, atol=1e-12)
    assert np.abs(np.delete(large, anchors, axis=0)).max() > 0.1


def test_errors_are_shared_or_add_up_as_their_names_say(bridges):
    """One shift for all but the anchors; else that of the robot touched first and an own draw."""
    bridge, first = bridges[1], [*range(12)]
    for j, walk in enumerate(bridge.walks):
        touched = [i for at, _, i, _ in walk.contacts if at == walk.stance_count - 1]
        first[j] = touched[0] if touched else j
    follows = np.array(first) != np.arange(12)

    shift, turn = _errors(bridge, "shift", 3.0), _errors(bridge, "turn", 0.4)
    own, added = (_errors(bridge, kind, 1.0) for kind in ("independent", "adding-up"))

    np.testing.assert_allclose(np.linalg.norm(shift[follows], axis=1), 3.0)
    assert np.ptp(shift[follows], axis=0).max() == 0.0
    np.testing.assert_allclose((added - added[first])[follows], own[follows], atol=1e-12)
    arm = bridge.position - bridge.position[navigation.founders_of(bridge)]
    np.testing.assert_allclose(
        np.linalg.norm(turn, axis=1), 2.0 * np.sin(0.2) * np.hypot(*arm[:, :2].T), atol=1e-12
    )


@pytest.mark.parametrize(
    "sets", ["structure.navigate_by=error", "structure.belief_error={kind: shift, size: 1}"]
)
def test_an_error_and_its_kind_go_together(sets):
    """One without the other would be a run by the truth, or by no error."""
    with pytest.raises(InputError, match="belief_error"):
        variants(_loaded(sets))
