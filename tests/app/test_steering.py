"""Growth by choices from outside: what `tiswarm.grow` grows, step by step."""

import numpy as np
import pytest

import tiswarm
from tiswarm.app.logs import Log

KINDS = {
    "tower": {"kind": "tower", "force_threshold": 3.0},
    "cantilever": {"kind": "cantilever", "climb": {"settle": 0.5}},
    "bridge": {"kind": "bridge", "gap": 12.0, "anchors": 2},
    "chain": {"kind": "chain"},
    "three at once": {"kind": "tower", "movers": 3},
    "breaking": {"kind": "cantilever", "strength": {"limit": 250.0, "scatter": 0.3}},
    "leaving": {"kind": "tower", "departures": {"rate": 0.2}},
}
ROBOTS = 14


def finished(growth):
    """Let all robots choose as ReactiveBuild does, until all structures are over."""
    while not growth.is_over.all():
        growth.step(tiswarm.reactive_build(growth.observe()))
    return growth


def played(kind, robots, episodes, places):
    """Play episodes of seeds 0, 1, ... in some places; where one is over, the next one begins.

    Returns:
        Their structures, by seed.
    """
    growth = tiswarm.Growth(kind, robots=robots, seeds=places)
    structures = {}
    next_seed = places
    while len(structures) < episodes:
        growth.step(tiswarm.reactive_build(growth.observe()))
        over = np.flatnonzero(growth.is_over)
        for place in over:
            structures.setdefault(int(growth.seeds[place]), growth.swarms([place])[0])
        begins = over[: episodes - next_seed]
        if len(begins):
            growth.reset(begins, seeds=next_seed + np.arange(len(begins)))
            next_seed += len(begins)
    return [structures[seed] for seed in range(episodes)]


def content(structures):
    """List all that structures are made of, as bytes."""
    return [
        [
            structure.seed,
            structure.ended,
            structure.spawns,
            structure.departures.tobytes(),
            structure.broken.tobytes(),
            structure.contact_load.tobytes(),
            *[
                [walk.center.tobytes(), walk.orientation_wxyz.tobytes(), walk.contacts.tobytes()]
                for walk in structure.walks
            ],
            *[
                [walk.round, walk.recruited, walk.failed_flips.tobytes()]
                for walk in structure.walks
            ],
            *map(str, structure.loads),
        ]
        for structure in structures
    ]


@pytest.mark.filterwarnings("ignore::tiswarm.base.errors.ResultWarning")
@pytest.mark.parametrize(
    ("kind", "robots", "episodes", "places"),
    [
        *[(kind, ROBOTS, 5, 3) for kind in KINDS.values()],
        *[
            pytest.param(kind, 60, 64, 16, marks=pytest.mark.slow)
            for kind in ("tower", "cantilever", "bridge", "chain")
        ],
    ],
)
def test_episodes_of_reactive_build_are_those_of_grow(kind, robots, episodes, places):
    """Structures go and begin anew at their own pace, and still none differs in a byte."""
    expected = tiswarm.grow(kind, robots=robots, seeds=episodes, quiet=True)

    structures = played(kind, robots, episodes, places)

    assert content(structures) == content(expected)


def test_an_episode_depends_on_seed_and_settings_alone():
    """Neither other structures, nor an episode before it in its place, nor threads matter."""
    settings = {
        "gap": [8.0, 12.0, 16.0],
        "climb.patience": [3, 8, 16],
        "force_threshold": [2.0, 10.0, 5.0],
        "recruit_limit": 3,
    }
    seeds = [7, 7, 9]
    growth = tiswarm.Growth("bridge", robots=ROBOTS, seeds=seeds, settings=settings, threads=2)
    finished(growth)
    growth.reset([1], seeds=11, settings={"gap": 9.0})
    finished(growth)

    for number, seed, gap in ((0, 7, 8.0), (1, 11, 9.0), (2, 9, 16.0)):
        alone = {
            "kind": "bridge",
            "gap": gap,
            "climb": {"patience": settings["climb.patience"][number]},
            "force_threshold": settings["force_threshold"][number],
            "recruit_limit": 3,
        }
        expected = tiswarm.grow(alone, robots=ROBOTS, seeds=[seed], threads=1, quiet=True)
        assert content(growth.swarms([number])) == content(expected)


def stacked(log):
    """Place robots one above the other, from the anchor of their log on."""
    return log.anchor_position + np.outer(np.arange(log.robot_count), [0.5, 0.0, 1.0])


SENSING = {"tilt_noise_deg": 1.0, "yaw_noise_deg": 2.0}
BELIEFS = {
    "error": {"belief_error": {"kind": "adding-up", "size": 0.4}, "sensing": SENSING},
    "method": {"navigate_by": "estimate", "believe": "online", "sensing": SENSING},
    "function": {"believe": lambda log: 1.1 * stacked(log), "sensing": SENSING},
}
"""Arguments that say what robots build by."""


@pytest.mark.parametrize("by", BELIEFS)
def test_episodes_of_robots_that_believe_are_those_of_grow(by):
    """Equal seeds, other paces and an episode before it in its place: none differs in a byte."""
    [expected] = tiswarm.grow("bridge", robots=8, seeds=[4], **BELIEFS[by], quiet=True)
    growth = tiswarm.Growth("bridge", robots=8, seeds=[4, 3, 4], **BELIEFS[by])
    finished(growth)
    first, _, third = growth.swarms()

    growth.reset([1], seeds=4)
    finished(growth)

    assert content([first, third]) == content([expected, expected])
    assert content(growth.swarms([1])) == content([expected])
    assert expected.totals["failed_flips"] > 0


def test_structures_of_a_growth_have_errors_of_their_own():
    """Each grows by the size that its settings state."""
    error = {"kind": "independent", "size": 0.0}
    sizes = [0.0, 1.5]

    growth = tiswarm.Growth(
        "tower", robots=8, seeds=[4, 4], belief_error=error, settings={"belief_error.size": sizes}
    )
    observed = growth.observe()
    while (growth.robot_count < 6).all():
        growth.step(tiswarm.reactive_build(growth.observe()))
        observed = growth.observe()

    assert observed.robot_sd[:, :5].tolist() == [[0.0] * 5, [0.0, *[1.5] * 4]]
    finished(growth)
    for number, size in enumerate(sizes):
        expected = tiswarm.grow(
            "tower", robots=8, seeds=[4], belief_error={**error, "size": size}, quiet=True
        )
        assert content(growth.swarms([number])) == content(expected)


def test_a_function_of_a_caller_says_where_robots_believe_to_be():
    """It receives what they sensed, by side of a gap; climbers see its places and their sd."""
    logs = []

    def believe(log):
        logs.append(log)
        count = np.arange(log.robot_count)
        return np.column_stack([count, 10.0 + count, 20.0 + count]), 0.1 * count

    growth = tiswarm.Growth("bridge", robots=6, seeds=[3], believe=believe)
    while growth.robot_count[0] < 5:
        growth.step(tiswarm.reactive_build(growth.observe()))
    observed = growth.observe()

    center = observed.dock[0].reshape(6, 3, 3).mean(axis=1)
    sides = [log.robot_count for log in logs[-2:]]
    place = np.concatenate([np.arange(size) for size in sides])
    joined = sorted(zip(np.rint(center[:5, 0]), observed.robot_sd[0, :5], strict=True))
    assert sum(sides) == 5
    np.testing.assert_allclose(center[:5, 2] - center[:5, 0], 20.0, atol=1e-9)
    np.testing.assert_allclose(joined, sorted(zip(place, 0.1 * place, strict=True)))
    assert isinstance(logs[0], Log)
    assert np.abs(growth.dock[0, :5].mean(axis=1) - center[:5]).max() > 1.0


def test_steps_tell_who_joined_and_who_was_lost():
    """Sums over an episode are what its history has."""
    growth = tiswarm.Growth(KINDS["leaving"], robots=ROBOTS, seeds=4)
    joined = growth.robot_count
    lost = np.zeros(4, int)

    while not growth.is_over.all():
        outcome = growth.step(tiswarm.reactive_build(growth.observe()))
        joined = joined + outcome.joined
        lost = lost + outcome.lost

    swarms = growth.swarms()
    assert joined.tolist() == [len(structure.walks) for structure in swarms]
    assert lost.tolist() == [len(structure.departures) for structure in swarms]
    assert growth.present.sum(axis=1).tolist() == (joined - lost).tolist()


def test_a_caller_lets_robots_leave():
    """Founders stay; who hangs on those that leave falls, and the others are solved anew."""
    growth = tiswarm.Growth("tower", robots=8, seeds=2)

    while not growth.is_over.all():
        leave = growth.present & (growth.robot_count == 5)[:, None]
        growth.step(tiswarm.reactive_build(growth.observe()), leave=leave)

    for structure in growth.swarms():
        assert len(structure.walks) == 8
        assert sorted(structure.departures[:, 0].tolist()) == [1, 2, 3, 4]
        assert np.isnan(structure.sensed[1:5]).all()


def test_equal_seeds_take_different_choices():
    """A population is compared on one draw of starts."""
    growth = tiswarm.Growth("tower", robots=6, seeds=[5, 5])

    while not growth.is_over.all():
        observed = growth.observe()
        touches = (observed.touching >= 0).any(axis=(1, 2))
        stays = np.where(touches, -1, tiswarm.reactive_build(observed))
        choice = np.where(observed.structure == 0, tiswarm.reactive_build(observed), stays)
        growth.step(choice)

    climbed, stayed = growth.swarms()
    assert climbed.position[0].tolist() == stayed.position[0].tolist()
    assert climbed.position[:, 2].max() > stayed.position[:, 2].max()


WRONG = {
    "an unknown setting": (
        lambda: tiswarm.Growth("tower", settings={"goal_hight": 3.0}),
        r"structure\.goal_hight: no such setting; did you mean goal_height\?",
    ),
    "a wrong value": (
        lambda: tiswarm.Growth("tower", seeds=2, settings={"climb.patience": [3, 0]}),
        r"structure\.climb\.patience: 0: .*greater than or equal to 1",
    ),
    "too few values": (
        lambda: tiswarm.Growth("tower", seeds=3, settings={"force_threshold": [3.0, 4.0]}),
        r"structure\.force_threshold: shape \(2,\); give one value, or 3",
    ),
    "a setting of all": (
        lambda: tiswarm.Growth("tower", seeds=2, settings={"climb.twists": [6, 7]}),
        r"structure\.climb\.twists: is the same for all structures of a growth; grow them apart",
    ),
    "a seed below 0": (lambda: tiswarm.Growth("tower", seeds=[-1]), "seeds: .* are no seeds"),
    "a choice that is no flip": (
        lambda: tiswarm.Growth("tower", seeds=2).step([999, -1]),
        "choices: choices are 999 for climber 0; return a possible flip",
    ),
    "choices of another number": (
        lambda: tiswarm.Growth("tower", seeds=2).step([-1]),
        r"shape \(1,\); return a choice for each of 2 climbers",
    ),
    "choices that are no integers": (
        lambda: tiswarm.Growth("tower", seeds=2).step([0.5, 1.5]),
        "choices are float64; give integers",
    ),
    "leavers of another shape": (
        lambda: tiswarm.Growth("tower", robots=5, seeds=2).step([-1, -1], leave=[True, False]),
        r"leave: is bool of shape \(2,\); give truth values of shape \(2, 5\)",
    ),
    "a structure that is not there": (
        lambda: tiswarm.Growth("tower", seeds=2).reset([2]),
        "numbers: .* are no structures; give numbers from 0 to 1",
    ),
    "robots that estimate": (
        lambda: tiswarm.Growth({"kind": "tower", "navigate_by": "estimate"}),
        'structure.navigate_by: .* need a method; give believe, as believe="online"',
    ),
    "errors of some structures": (
        lambda: tiswarm.Growth("tower", seeds=2, settings={"belief_error.size": [0.0, 1.0]}),
        "structure.belief_error.size: no such setting",
    ),
}


@pytest.mark.parametrize("mistake", WRONG)
def test_a_mistake_is_one_line(mistake):
    """It names the argument or key, and what to do."""
    call, message = WRONG[mistake]

    with pytest.raises(tiswarm.InputError, match=message):
        call()


def test_a_wrong_choice_changes_nothing():
    """A caller may mend it and go on."""
    growth = tiswarm.Growth("tower", robots=5, seeds=2)
    with pytest.raises(tiswarm.InputError):
        growth.step([999, 999])

    expected = tiswarm.grow("tower", robots=5, seeds=2, quiet=True)
    assert content(finished(growth).swarms()) == content(expected)
