"""Compares policies on the tasks of tiswarm.learn, on seeds that training never saw.

python -m benchmarks.tasks                     the table in docs/guides/learning.md
python -m benchmarks.tasks --tune              ReactiveBuild's patience, on training seeds
python -m benchmarks.tasks --evolve Bridge30   weights of a linear policy, on training seeds
python -m benchmarks.tasks --speed             choices a CPU second
"""

import argparse
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

import tiswarm
import tiswarm.learn
from tiswarm.base.aliases import AnyInts, Bools, Reals
from tiswarm.learn.environments import TaskVectorEnv
from tiswarm.learn.features import FLIP_FEATURES, ROBOT_FEATURES
from tiswarm.learn.observations import action_of

WEIGHTS = Path(__file__).with_name("policies.json")
"""Weights of evolved policies, by task, each with its command and seeds."""

FIRST_TEST_SEED = 1_000_000
"""First seed of the table; training seeds are below."""

PATIENCE = 16
"""Patience of ReactiveBuild that beat the shipped one on training seeds of Tower and Bridge30."""

_TRIED = (3, 6, 10, 16, 24)
_SCALE = {"R": 3.0, "rad": 3.0, "weight of a dock": 10.0}
_FAR = {"distance": 30.0, "to_x": 30.0, "to_y": 30.0, "to_z": 30.0, "best": 30.0, "flips": 10.0}
_TRAINING_STEPS = 1000
_POPULATION = 12
_WARMING_STEPS = 100
_CONFIDENCE = 1.96

_Act = Callable[[Any, dict[str, Any]], AnyInts]


class Played(NamedTuple):
    """Episodes of a policy: values of each, shape (episodes,)."""

    measure: Reals
    closed: Bools
    robots: AnyInts
    choices: AnyInts
    cpu_s: float


def play(
    task: str,
    seeds: AnyInts,
    act: _Act,
    settings: dict[str, Any] | None = None,
    most_steps: int | None = None,
) -> Played:
    """Play an episode from each seed, cut off after most steps, or those of the task."""
    start = time.process_time()
    count = len(seeds)
    environment = TaskVectorEnv(
        count, task, settings=settings, max_episode_steps=most_steps, threads=1
    )
    observed, infos = environment.reset(seed=seeds.tolist())
    is_over = np.zeros(count, np.bool_)
    measure = np.zeros(count)
    robots = np.zeros(count, np.int64)
    choices = np.zeros(count, np.int64)
    while not is_over.all():
        actions = act(environment.unwrapped, observed)
        observed, _, terminated, truncated, infos = environment.step(actions)
        plays = ~is_over
        measure[plays] = infos["measure"][plays]
        robots[plays] = infos["robots"][plays]
        choices += plays
        is_over |= terminated | truncated
    return Played(measure, measure >= 1.0, robots, choices, time.process_time() - start)


def draw(seed: int) -> _Act:
    """Return a policy that draws a possible action."""
    rng = np.random.default_rng(seed)

    def act(_environment: object, observed: dict[str, Any]) -> AnyInts:
        mask = observed["action_mask"]
        drawn: AnyInts = (rng.random(mask.shape) * mask).argmax(axis=1)
        return drawn

    return act


def reactive(environment: Any, _observed: object) -> AnyInts:  # noqa: ANN401 - it has a climb step
    """Act as ReactiveBuild."""
    step = environment.climb_step
    return action_of(tiswarm.reactive_build(step), step, environment.num_envs)


def linear(weights: Reals) -> _Act:
    """Return a policy that takes the possible action of the greatest weighted sum of features.

    Args:
        weights: Of features of flips, of the climber's for staying, and for going back.
    """
    of_flip, of_stay, of_back = np.split(
        weights, [len(FLIP_FEATURES), len(FLIP_FEATURES) + len(ROBOT_FEATURES)]
    )

    def act(_environment: object, observed: dict[str, Any]) -> AnyInts:
        robot = observed["robot"] / _SCALES[-len(ROBOT_FEATURES) :]
        flips = observed["flips"] / _SCALES[: len(FLIP_FEATURES)]
        scores = np.column_stack([flips @ of_flip, robot @ of_stay, robot @ of_back])
        best: AnyInts = np.where(observed["action_mask"], scores, -np.inf).argmax(axis=1)
        return best

    return act


def _scales() -> Reals:
    """Return by how much features are divided, of flips and of the climber twice."""
    flips = [_FAR.get(entry.name, _SCALE.get(entry.unit, 1.0)) for entry in FLIP_FEATURES]
    robot = [_FAR.get(entry.name, _SCALE.get(entry.unit, 1.0)) for entry in ROBOT_FEATURES]
    return np.array(flips + robot + robot)


_SCALES = _scales()


def names() -> list[str]:
    """Name the weights of a linear policy."""
    flips = [f"flip {entry.name}" for entry in FLIP_FEATURES]
    stay = [f"stay {entry.name}" for entry in ROBOT_FEATURES]
    return [*flips, *stay, *[f"back {entry.name}" for entry in ROBOT_FEATURES]]


def by_hand() -> Reals:
    """Return weights that act much as ReactiveBuild: gain, no visits, patience, calls."""
    terms = {
        "flip gain": 1.0,
        "flip visited": -6.0,
        "stay climbs": -6.0,
        "stay called": 12.0,
        "back climbs": -5.5,
        "back since_best": 1.0,
    }
    return np.array([terms.get(name, 0.0) for name in names()])


def evolve(task: str, *, generations: int, seed: int, episodes: int) -> dict[str, Any]:
    """Evolve a linear policy from the one by hand, by CMA-ES.

    A generation plays its candidates on the same training seeds, which the next one replaces.
    """
    from cmaes import CMA  # noqa: PLC0415 - of the extra bench

    start = time.process_time()
    optimizer = CMA(mean=by_hand(), sigma=0.5, seed=seed, population_size=_POPULATION)
    progress = []
    for generation in range(generations):
        candidates = [optimizer.ask() for _ in range(optimizer.population_size)]
        first = generation * episodes
        seeds = np.tile(np.arange(first, first + episodes), len(candidates))
        acts = [linear(candidate) for candidate in candidates]

        def act(
            environment: object, observed: dict[str, Any], acts: Sequence[_Act] = acts
        ) -> AnyInts:
            parts = []
            for number, of_candidate in enumerate(acts):
                rows = slice(number * episodes, (number + 1) * episodes)
                part = {name: values[rows] for name, values in observed.items()}
                parts.append(of_candidate(environment, part))
            return np.concatenate(parts)

        played = play(task, seeds, act, most_steps=_TRAINING_STEPS)
        measure = played.measure.reshape(len(candidates), episodes).mean(axis=1)
        optimizer.tell(list(zip(candidates, (-measure).tolist(), strict=True)))
        progress.append(round(float(measure.mean()), 4))
        minutes = (time.process_time() - start) / 60.0
        print(
            f"generation {generation + 1}: {measure.mean():.3f}, {minutes:.1f} CPU min", flush=True
        )
    return {
        "command": f"python -m benchmarks.tasks --evolve {task} --generations {generations} "
        f"--seed {seed} --episodes {episodes}",
        "training_seeds": f"0 to {generations * episodes - 1}",
        "mean_measure_of_generations": progress,
        "weights": dict(zip(names(), optimizer.mean.round(4).tolist(), strict=True)),
    }


def tune(tasks: Sequence[str], episodes: int) -> None:
    """Print what ReactiveBuild is worth by its patience, on training seeds."""
    for task in tasks:
        for patience in _TRIED:
            played = play(task, np.arange(episodes), reactive, {"climb.patience": patience})
            mean = played.measure.mean()
            print(f"{task}, patience {patience}: {mean:.3f}, {played.closed.sum()}", flush=True)


def policies(task: str) -> dict[str, tuple[_Act, dict[str, Any] | None]]:
    """Return the policies of the table, with settings of the structure."""
    listed: dict[str, tuple[_Act, dict[str, Any] | None]] = {
        "ReactiveBuild as shipped": (reactive, None),
        f"ReactiveBuild, patience {PATIENCE}": (
            reactive,
            {"climb.patience": PATIENCE},
        ),
        "linear by hand": (linear(by_hand()), None),
    }
    evolved = {}
    if WEIGHTS.is_file():
        evolved = json.loads(WEIGHTS.read_text(encoding="utf-8"))
    if task in evolved:
        weights = evolved[task]["weights"]
        listed["linear, evolved"] = (linear(np.array([weights[name] for name in names()])), None)
    listed["random"] = (draw(0), None)
    return listed


def row(task: str, policy: str, played: Sequence[Played]) -> str:
    """Return a row of the table; intervals are of 95 %, over the episodes of all sets."""
    measure = np.concatenate([of_set.measure for of_set in played])
    closed = np.concatenate([of_set.closed for of_set in played])
    robots = np.concatenate([of_set.robots for of_set in played])
    choices = np.concatenate([of_set.choices for of_set in played])
    half = _CONFIDENCE * measure.std(ddof=1) / np.sqrt(len(measure))
    shown = "-"
    if "Bridge" in task:
        shown = f"{closed.sum()} of {len(closed)}"
    return (
        f"| `{task}` | {policy} | {measure.mean():.2f} ± {half:.2f} | {shown} "
        f"| {robots.mean():.1f} | {choices.mean():.0f} |"
    )


def speed(task: str, counts: Sequence[int], steps: int) -> None:
    """Print choices a CPU second of ReactiveBuild on one thread, once kernels are compiled."""
    play(task, np.arange(2), reactive, most_steps=_WARMING_STEPS)
    for count in counts:
        environment: Any = gymnasium.make_vec(f"tiswarm/{task}-v0", num_envs=count, threads=1)
        observed, _ = environment.reset(seed=0)
        choices = 0
        start = time.process_time()
        for _ in range(steps):
            choices += int(observed["robot"][:, 0].sum())
            observed, *_ = environment.step(reactive(environment.unwrapped, observed))
        rate = choices / (time.process_time() - start)
        print(f"| {count:,} | {rate:,.0f} |", flush=True)


def main() -> None:
    """Print the table, or what an option asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", nargs="+", default=[*tiswarm.learn.TASKS])
    parser.add_argument("--sets", type=int, default=5)
    parser.add_argument("--episodes", type=int, default=256)
    parser.add_argument("--tune", action="store_true")
    parser.add_argument("--evolve", metavar="TASK")
    parser.add_argument("--generations", type=int, default=7)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--speed", action="store_true")
    given = parser.parse_args()
    if given.tune:
        tune(given.tasks, given.episodes)
        return
    if given.speed:
        speed("Tower", (1, 64, 1024, 4096), 40)
        return
    if given.evolve:
        kept = {}
        if WEIGHTS.is_file():
            kept = json.loads(WEIGHTS.read_text(encoding="utf-8"))
        kept[given.evolve] = evolve(
            given.evolve, generations=given.generations, seed=given.seed, episodes=given.episodes
        )
        WEIGHTS.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
        return
    print("| task | policy | measure | closed | robots | choices |\n|---|---|---|---|---|---|")
    for task in given.tasks:
        for policy, (act, settings) in policies(task).items():
            sets = [
                play(
                    task, FIRST_TEST_SEED + 1000 * number + np.arange(given.episodes), act, settings
                )
                for number in range(given.sets)
            ]
            print(row(task, policy, sets), flush=True)


if __name__ == "__main__":
    main()
