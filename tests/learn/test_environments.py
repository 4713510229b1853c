"""Environments keep the conventions of gymnasium and PettingZoo, and grow what growth grows."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import tiswarm

gymnasium = pytest.importorskip("gymnasium", reason="the extra learn installs it")
pettingzoo_test = pytest.importorskip("pettingzoo.test", reason="the extra learn installs it")

from gymnasium.utils.env_checker import check_env  # noqa: E402 - of a library that may be missing
from gymnasium.vector import AutoresetMode  # noqa: E402

import tiswarm.learn  # noqa: E402
from tiswarm.learn.features import (  # noqa: E402
    BELIEVED_FLIP_FEATURES,
    BELIEVED_ROBOT_FEATURES,
    FLIP_FEATURES,
    ROBOT_FEATURES,
)
from tiswarm.learn.observations import action_of  # noqa: E402

ROBOTS = 5
STAY = 36
BACK = 37


def vector(task="Tower", count=3, **arguments):
    """Make a vector environment of few robots."""
    return gymnasium.make_vec(f"tiswarm/{task}-v0", num_envs=count, robots=ROBOTS, **arguments)


def act_as_reactive_build(environment):
    """Return the actions of ReactiveBuild."""
    step = environment.climb_step
    return action_of(tiswarm.reactive_build(step), step, environment.num_envs)


def drawn(environment, rng, observed):
    """Draw a possible action of each structure."""
    mask = observed["action_mask"]
    return (rng.random(mask.shape) * mask).argmax(axis=1)


def content(observed):
    """List an observation as bytes."""
    return [values.tobytes() for values in observed.values()]


def norm(vector):
    """Return the length of a vector, summed in order."""
    x, y, z = vector.tolist()
    return np.sqrt(x * x + y * y + z * z)


def contacts(step, climber, touching, on_ground):
    """Count docks touched and docks on the ground, and find the greatest load touched."""
    touched = touching[touching >= 0]
    sensed = step.sensed[step.structure[climber], touched // 3]
    return [len(touched), np.count_nonzero(on_ground), max([0.0, *sensed[~np.isnan(sensed)]])]


def features(step, climber):
    """Compute what a climber observes from what it sees, number by number."""
    place = step.center[climber]
    goal = step.goal[climber]
    walked = [norm(stance - goal) for stance in step.walk[climber, : step.stance[climber] + 1]]
    flips = np.zeros((STAY, len(FLIP_FEATURES)))
    for k in np.flatnonzero(step.possible[climber]):
        end = step.end[climber, k]
        flips[k] = [
            1.0, norm(end - goal), walked[-1] - norm(end - goal), *(end - place),
            step.angle[climber, k], step.visited[climber, k], step.end_called[climber, k],
            *contacts(
                step, climber, step.end_touching[climber, k], step.end_on_ground[climber, k]
            ),
        ]  # fmt: skip
    robot = [
        1.0, walked[-1], *(goal - place), min(walked), step.stance[climber],
        step.stance[climber] - walked.index(min(walked)), step.called[climber],
        *contacts(step, climber, step.touching[climber], step.on_ground[climber]),
    ]  # fmt: skip
    return [
        np.clip(values, [f.low for f in of], [f.high for f in of]).astype(np.float32)
        for values, of in ((flips, FLIP_FEATURES), (robot, ROBOT_FEATURES))
    ]


def closure(structure, gap):
    """Return what a bridge is worth."""
    if structure.crossed:
        return 2.0 - structure.robot_count / ROBOTS
    x = sorted([0.0, gap, *np.clip(structure.position[:, 0], 0.0, gap)])
    return 1.0 - max(after - before for before, after in pairwise(x)) / gap


@pytest.mark.parametrize("task", ["Tower", "Bridge", "BelievedBridge"])
def test_an_environment_passes_the_checker_of_gymnasium(task):
    """Spaces, seeds, returned values: all as gymnasium's users expect, without a warning."""
    environment = gymnasium.make(f"tiswarm/{task}-v0", robots=ROBOTS).unwrapped

    check_env(environment)


def test_gymnasium_imports_the_package_by_the_name_of_a_task():
    """Nobody has to import it by hand."""
    environment = gymnasium.make("tiswarm.learn:tiswarm/Tower-v0", robots=ROBOTS)

    assert environment.spec.id == "tiswarm/Tower-v0"


def test_all_tasks_are_registered():
    """Each can be made by its name, alone and as vector."""
    for name in tiswarm.learn.TASKS:
        spec = gymnasium.spec(f"tiswarm/{name}-v0")

        assert spec.entry_point
        assert spec.vector_entry_point


@pytest.mark.parametrize("task", ["Tower", "BelievedBridge"])
def test_parallel_environments_pass_the_checkers_of_pettingzoo(task):
    """Climbers that act at the same time are agents by its conventions."""
    environment = tiswarm.learn.parallel_env(task, movers=2, robots=ROBOTS)

    pettingzoo_test.parallel_api_test(environment, num_cycles=60)
    pettingzoo_test.parallel_seed_test(
        lambda: tiswarm.learn.parallel_env(task, movers=2, robots=ROBOTS), num_cycles=5
    )


def test_an_episode_repeats_from_its_seed_and_actions():
    """Alone, or beside others, the same actions bring the same bytes and rewards."""
    environment = vector()
    observed, _ = environment.reset(seed=7)
    rng = np.random.default_rng(0)
    episode = [content({name: values[1] for name, values in observed.items()})]
    actions = []
    for _ in range(40):
        actions.append(drawn(environment, rng, observed))
        observed, reward, over, _, _ = environment.step(actions[-1])
        episode.append(content({name: values[1] for name, values in observed.items()}))
        episode.append([reward[1], over[1]])
        if over[1]:
            break

    alone = gymnasium.make("tiswarm/Tower-v0", robots=ROBOTS)
    observed, _ = alone.reset(seed=8)
    repeated = [content(observed)]
    for action in actions:
        observed, reward, over, _, _ = alone.step(action[1])
        repeated.append(content(observed))
        repeated.append([reward, over])

    assert repeated == episode


@pytest.mark.parametrize("task", ["Tower", "Cantilever", "Bridge"])
def test_returns_are_measures_of_what_is_grown(task):
    """ReactiveBuild earns what its structures measure in the tables of growth."""
    gap = {"gap": 8.0} if task == "Bridge" else {}
    environment = vector(task, settings=gap)
    environment.reset(seed=3)
    earned = np.zeros(3)
    is_over = np.zeros(3, bool)
    while not is_over.all():
        _, reward, over, _, _ = environment.step(act_as_reactive_build(environment))
        earned[~is_over] += reward[~is_over]
        is_over |= over

    kind = {"kind": task.lower(), **gap}
    swarms = tiswarm.grow(kind, robots=ROBOTS, seeds=[3, 4, 5], quiet=True)
    table = [swarm.totals for swarm in swarms]
    if task == "Bridge":
        expected = [closure(swarm, 8.0) for swarm in swarms]
    else:
        name = {"Tower": "height_R", "Cantilever": "reach_R"}[task]
        expected = [max(row[name], 0.0) for row in table]

    np.testing.assert_allclose(earned, expected, atol=1e-9)


def test_robots_that_estimate_grow_by_reactive_build_what_grow_grows():
    """Observed are places as believed, with their sd; rewards are those of the true structure."""
    environment = vector("BelievedBridge", count=2, settings={"gap": 12.0})
    observed, _ = environment.reset(seed=3)
    earned = np.zeros(2)
    is_over = np.zeros(2, bool)
    digests = {}
    most_sd = 0.0
    misplaced = 0.0
    while not is_over.all():
        step = environment.climb_step
        rows = step.slot
        to_goal = np.linalg.norm(step.goal - step.center, axis=1)
        np.testing.assert_allclose(observed["robot"][rows, 1], to_goal, rtol=1e-5)
        np.testing.assert_allclose(observed["robot"][rows, -1], step.sd, rtol=1e-5)
        end_sd = np.where(step.possible, step.end_sd, 0.0)
        np.testing.assert_allclose(observed["flips"][rows, :, -1], end_sd, rtol=1e-5)
        most_sd = max(most_sd, observed["robot"][..., -1].max())
        growth = environment.unwrapped._episodes.growth  # noqa: SLF001 - for true docks
        true = growth.dock.reshape(step.dock.shape)
        joined = np.repeat(growth.present, 3, axis=1)
        misplaced = max(misplaced, np.abs(step.dock - true)[joined].max(initial=0.0))
        observed, reward, over, _, _ = environment.step(act_as_reactive_build(environment))
        earned[~is_over] += reward[~is_over]
        for number in np.flatnonzero(over & ~is_over):
            digests[number] = growth.swarms([number])[0].digest
        is_over |= over

    swarms = tiswarm.grow(
        {"kind": "bridge", "gap": 12.0},
        robots=ROBOTS,
        seeds=[3, 4],
        believe="online",
        sensing={"tilt_noise_deg": 1.0, "yaw_noise_deg": 2.0},
        quiet=True,
    )
    assert [digests[0], digests[1]] == [swarm.digest for swarm in swarms]
    np.testing.assert_allclose(earned, [closure(swarm, 12.0) for swarm in swarms], atol=1e-9)
    assert 0.0 < most_sd < 10.0
    assert misplaced > 0.1


def test_an_episode_that_is_over_begins_anew_with_the_next_step():
    """The step after the end has no reward, and observes what a later episode begins with."""
    environment = vector(count=2)
    environment.reset(seed=5)
    over = np.zeros(2, bool)
    while not over.any():
        _, _, over, _, _ = environment.step(act_as_reactive_build(environment))
    first = int(np.flatnonzero(over)[0])

    observed, reward, over, truncated, infos = environment.step(np.full(2, STAY))

    assert environment.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert reward[first] == 0.0
    assert not over[first]
    assert not truncated[first]
    assert infos["robots"][first] == 0
    assert observed["robot"][first, 0] == 1.0


@pytest.mark.parametrize("make", ["alone", "one of one"])
def test_an_episode_ends_where_nobody_else_climbs(make):
    """With no climber left there is still an observation, zeros, and only staying is possible."""
    if make == "alone":
        environment = gymnasium.make("tiswarm/Tower-v0", robots=ROBOTS).unwrapped
    else:
        environment = vector(count=1)
    environment.reset(seed=5)
    over = False
    while not over:
        step = environment.climb_step
        action = action_of(tiswarm.reactive_build(step), step, 1)
        observed, _, over, _, _ = environment.step(action if make != "alone" else action[0])

    nobody = tiswarm.reactive_build(environment.climb_step)

    assert nobody.shape == (0,)
    assert not observed["robot"].any()
    assert np.flatnonzero(observed["action_mask"]).tolist() == [STAY, BACK]


def test_later_episodes_are_drawn_from_the_seed():
    """A structure has a seed of its own in each episode, alone and beside others."""
    environment = vector(count=2)
    environment.reset(seed=5)

    observed, _ = environment.reset()

    alone = gymnasium.make("tiswarm/Tower-v0", robots=ROBOTS)
    first, _ = alone.reset(seed=6)
    second, _ = alone.reset()
    assert content(first) != content(second)
    assert content(second) == content({name: values[1] for name, values in observed.items()})


def test_an_episode_is_cut_off_after_most_steps():
    """Truncated, not terminated; and the next step begins another one."""
    environment = vector(max_episode_steps=3)
    environment.reset(seed=0)
    outcomes = [environment.step(np.zeros(3, int)) for _ in range(4)]

    assert [outcome[3].all() for outcome in outcomes] == [False, False, True, False]
    assert not any(outcome[2].any() for outcome in outcomes)
    assert (outcomes[3][4]["robots"] == 0).all()


def test_observations_are_what_robots_may_know():
    """Each number is what the guide says, to the byte, calls and loads among them."""
    environment = vector("Bridge", settings={"gap": 8.0, "force_threshold": 0.5})
    observed, _ = environment.reset(seed=3)
    seen = []
    for _ in range(60):
        observed, *_ = environment.step(act_as_reactive_build(environment))
        step = environment.unwrapped.climb_step
        for climber, row in enumerate(step.slot):
            flips, robot = features(step, climber)
            seen.append(np.max([robot, *flips], axis=0))

            assert observed["flips"][row].tobytes() == flips.tobytes()
            assert observed["robot"][row].tobytes() == robot.tobytes()

    assert np.max(seen, axis=0)[-4:].all()  # calls, contacts, ground and loads occur


def test_masks_say_which_actions_differ_from_staying():
    """An action that is not possible is to stay; to stay is always possible."""
    one = vector()
    two = vector()
    observed, infos = one.reset(seed=9)
    two.reset(seed=9)
    impossible = observed["action_mask"].argmin(axis=1)

    stayed = one.step(np.full(3, STAY))
    refused = two.step(impossible)

    assert (np.take_along_axis(observed["action_mask"], impossible[:, None], 1) == 0).all()
    assert (observed["action_mask"][:, STAY:] == 1).all()
    assert (observed["action_mask"] == infos["action_mask"]).all()
    assert content(stayed[0]) == content(refused[0])


@pytest.mark.parametrize(
    ("actions", "problem"),
    [([0.5] * 3, "give 3 integers"), ([0, 0], "give 3 integers"), ([0, 0, 38], "from 0 to 37")],
)
def test_actions_outside_the_space_are_refused(actions, problem):
    """A mistake of a policy is not taken for a choice to stay."""
    environment = vector()
    environment.reset(seed=0)

    with pytest.raises(tiswarm.InputError, match=problem):
        environment.step(np.array(actions))


def test_the_guide_lists_tasks_and_features():
    """Whoever writes a policy reads there what each number is."""
    page = (Path(__file__).parents[2] / "docs/guides/learning.md").read_text(encoding="utf-8")

    for name, task in tiswarm.learn.TASKS.items():
        assert f"| `{name}` | {task.aim} | {task.measure.__name__} | {task.unit} |" in page
    for entry in (*BELIEVED_FLIP_FEATURES, *BELIEVED_ROBOT_FEATURES):
        bounds = f"{entry.low:g} | {entry.high:g}"
        assert f"| `{entry.name}` | {entry.unit} | {bounds} | {entry.meaning} |" in page


def test_agents_of_a_row_without_a_climber_may_only_stay():
    """Founders come one by one: of two climbers the second one starts when the first has joined."""
    environment = tiswarm.learn.parallel_env("Tower", movers=2, robots=ROBOTS)
    observed, infos = environment.reset(seed=1)

    assert observed["climber_0"]["robot"][0] == 1.0
    assert not observed["climber_1"]["robot"].any()
    assert np.flatnonzero(infos["climber_1"]["action_mask"]).tolist() == [STAY, BACK]
