"""Compares policies on the tasks of tiswarm.learn, on seeds that training never saw.

python -m benchmarks.tasks                     the table in docs/guides/learning.md
python -m benchmarks.tasks --tune              settings of ReactiveBuild, on training seeds
python -m benchmarks.tasks --evolve Bridge30   weights of a linear policy, on training seeds
python -m benchmarks.tasks --speed             choices a CPU second
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

import tiswarm
import tiswarm.learn
from tiswarm.base.aliases import AnyInts, Bools, Reals
from tiswarm.learn.episodes import Episodes
from tiswarm.learn.features import FLIP_FEATURES, ROBOT_FEATURES
from tiswarm.learn.observations import action_of

FITTED = Path(__file__).with_name("policies.json")
"""What is fitted, by kind of policy and by task, each with its command and seeds."""

FIRST_TEST_SEED = 1_000_000
"""First seed of the table; training seeds are below."""

TRIED: dict[str, tuple[float, ...]] = {
    "climb.patience": (3, 6, 10, 16, 24),
    "force_threshold": (5.0, 10.0, 15.0, 25.0),
    "recruit_limit": (0, 1, 2, 5),
}
"""Values of ReactiveBuild's settings that are tried, one setting after the other."""

_SCALE = {"R": 3.0, "rad": 3.0, "weight of a dock": 10.0}
_FAR = {"distance": 30.0, "to_x": 30.0, "to_y": 30.0, "to_z": 30.0, "best": 30.0, "flips": 10.0}
_MOST_GAIN = 2.5  # of a flip, in 3 R
_TRAINING_STEPS = 1000
_POPULATION = 12
_WARMING_STEPS = 60
_CONFIDENCE = 1.96

POLICIES = {
    "random": "random",
    "shipped": "ReactiveBuild as shipped",
    "tuned": "ReactiveBuild, tuned",
    "terms": "linear, its terms alone",
    "evolved": "linear, evolved",
}
"""Policies of the table, as it names them."""

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
    episodes = Episodes(task, count, settings=settings, most_steps=most_steps, threads=1)
    episodes.seed(np.arange(count), seeds)
    is_over: Bools = np.zeros(count, np.bool_)
    choices = np.zeros(count, np.int64)
    for _ in range(episodes.most_steps):
        choices += ~is_over
        _, is_over = episodes.step(act(episodes, episodes.observe()._asdict()))
        if is_over.all():
            break
    measure = episodes.measure
    cpu_s = time.process_time() - start
    return Played(measure, measure >= 1.0, episodes.joined, choices, cpu_s)


def draw(seed: int) -> _Act:
    """Return a policy that draws a possible action."""
    rng = np.random.default_rng(seed)

    def act(_environment: object, observed: dict[str, Any]) -> AnyInts:
        mask = observed["action_mask"]
        drawn: AnyInts = (rng.random(mask.shape) * mask).argmax(axis=1)
        return drawn

    return act


def reactive(episodes: Any, observed: dict[str, Any]) -> AnyInts:  # noqa: ANN401 - has a climb step
    """Act as ReactiveBuild."""
    step = episodes.climb_step
    return action_of(tiswarm.reactive_build(step), step, len(observed["action_mask"]))


def linear(weights: Reals) -> _Act:
    """Return a policy that takes the possible action of the greatest weighted sum of features.

    Args:
        weights: Of features of flips, of the climber's for staying, and for going back.
    """
    of_flip, of_stay, of_back = np.split(
        weights, [len(FLIP_FEATURES), len(FLIP_FEATURES) + len(ROBOT_FEATURES)]
    )

    def act(_environment: object, observed: dict[str, Any]) -> AnyInts:
        # Where robots go by estimates they observe more, which comes last and has no weight.
        robot = observed["robot"][:, : len(ROBOT_FEATURES)] / _SCALES[-len(ROBOT_FEATURES) :]
        flips = observed["flips"][..., : len(FLIP_FEATURES)] / _SCALES[: len(FLIP_FEATURES)]
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


def by_terms(patience: float) -> Reals:
    """Return weights that act much as ReactiveBuild: gain, no visits, calls, and patience."""
    never = patience + _MOST_GAIN  # a robot without another flip goes back
    terms = {
        "flip gain": 1.0,
        "flip visited": -never,
        "stay climbs": -never,
        "stay called": 2.0 * never,
        "back climbs": 0.5 - patience,
        "back since_best": 1.0,
    }
    return np.array([terms.get(name, 0.0) for name in names()])


def fitted(kind: str, task: str) -> dict[str, Any]:
    """Return what was fitted of a kind of policy on a task; empty if nothing was."""
    stored: dict[str, Any] = json.loads(FITTED.read_text(encoding="utf-8"))
    entry: dict[str, Any] = stored.get(kind, {}).get(task, {})
    return entry


def keep(kind: str, task: str, entry: dict[str, Any]) -> None:
    """Write what was fitted of a kind of policy on a task beside all else that was."""
    stored = json.loads(FITTED.read_text(encoding="utf-8"))
    stored.setdefault(kind, {})[task] = entry
    FITTED.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")


def patience_of(task: str) -> float:
    """Return the patience of ReactiveBuild that was best on training seeds, or is shipped."""
    settings = fitted("tuned", task).get("settings", {})
    return float(settings.get("climb.patience", TRIED["climb.patience"][0]))


def evolve(task: str, *, generations: int, seed: int, episodes: int) -> Iterator[dict[str, Any]]:
    """Evolve a linear policy from ReactiveBuild's terms, by CMA-ES.

    A generation plays its candidates on the same training seeds, which the next one replaces.

    Yields:
        What so many generations come to, after each of them.
    """
    from cmaes import CMA  # noqa: PLC0415 - of the extra bench

    start = time.process_time()
    mean = by_terms(patience_of(task))
    optimizer = CMA(mean=mean, sigma=0.5, seed=seed, population_size=_POPULATION)
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
        yield {
            "cpu_min": round(minutes, 1),
            "command": f"python -m benchmarks.tasks --evolve {task} "
            f"--generations {generation + 1} --seed {seed} --episodes {episodes}",
            "training_seeds": f"0 to {(generation + 1) * episodes - 1}",
            "mean_measure_of_generations": progress,
            "weights": dict(zip(names(), optimizer.mean.round(4).tolist(), strict=True)),
        }


def tune(task: str, episodes: int) -> dict[str, Any]:
    """Choose settings of ReactiveBuild, each the best on training seeds with those before it."""
    start = time.process_time()
    settings: dict[str, Any] = {}
    means: dict[str, dict[str, float]] = {}
    for name, values in TRIED.items():
        seeds = np.tile(np.arange(episodes), len(values))
        tried = {**settings, name: np.repeat(values, episodes)}
        played = play(task, seeds, reactive, tried)
        mean = played.measure.reshape(len(values), episodes).mean(axis=1)
        means[name] = {
            str(value): round(float(m), 4) for value, m in zip(values, mean, strict=True)
        }
        settings[name] = values[int(mean.argmax())]
        print(f"{task}, {name}: {means[name]}", flush=True)
    return {
        "cpu_min": round((time.process_time() - start) / 60.0, 1),
        "command": f"python -m benchmarks.tasks --tune --tasks {task} --episodes {episodes}",
        "training_seeds": f"0 to {episodes - 1}",
        "mean_measure": means,
        "settings": settings,
    }


def policies(task: str) -> dict[str, tuple[_Act, dict[str, Any] | None]]:
    """Return the policies of the table by name, with settings of the structure."""
    listed: dict[str, tuple[_Act, dict[str, Any] | None]] = {
        "random": (draw(0), None),
        "shipped": (reactive, None),
        "terms": (linear(by_terms(patience_of(task))), None),
    }
    tuned = fitted("tuned", task)
    if tuned:
        listed["tuned"] = (reactive, tuned["settings"])
    evolved = fitted("evolved", task)
    if evolved:
        weights = np.array([evolved["weights"][name] for name in names()])
        listed["evolved"] = (linear(weights), None)
    return listed


def row(task: str, policy: str, played: Played) -> str:
    """Return a row of the table; intervals are of 95 %, over the episodes of all sets."""
    measure = played.measure
    closed = played.closed
    half = _CONFIDENCE * measure.std(ddof=1) / np.sqrt(len(measure))
    shown = "-"
    if tiswarm.learn.TASKS[task].structure["kind"] == "bridge":
        low, high = share_interval(int(closed.sum()), len(closed))
        shown = f"{100 * closed.mean():.0f} ({100 * low:.0f} to {100 * high:.0f})"
    return (
        f"| `{task}` | {policy} | {len(measure)} | {measure.mean():.2f} ± {half:.2f} | {shown} "
        f"| {played.robots.mean():.1f} | {played.choices.mean():.0f} |"
    )


def share_interval(count: int, total: int) -> tuple[float, float]:
    """Return Wilson's interval of 95 % of a share."""
    z = _CONFIDENCE
    share = count / total
    middle = share + z * z / (2.0 * total)
    half = z * np.sqrt(share * (1.0 - share) / total + (z / (2.0 * total)) ** 2)
    whole = 1.0 + z * z / total
    return max(0.0, float((middle - half) / whole)), min(1.0, float((middle + half) / whole))


def speed(task: str, counts: Sequence[int], steps: int) -> None:
    """Print choices a CPU second of ReactiveBuild on one thread, once kernels are compiled.

    Structures have grown for some steps by then, so that some are at their end and begin anew.
    """
    for count in counts:
        environment: Any = gymnasium.make_vec(f"tiswarm/{task}-v0", num_envs=count, threads=1)
        observed, _ = environment.reset(seed=0)
        for _ in range(_WARMING_STEPS):
            observed, *_ = environment.step(reactive(environment.unwrapped, observed))
        choices = 0
        start = time.process_time()
        for _ in range(max(steps, 400 // count)):
            choices += int(observed["robot"][:, 0].sum())
            observed, *_ = environment.step(reactive(environment.unwrapped, observed))
        rate = choices / (time.process_time() - start)
        print(f"| {count:,} | {rate:,.0f} |", flush=True)


def main() -> None:
    """Print the table, or what an option asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", nargs="+", default=[*tiswarm.learn.TASKS])
    parser.add_argument("--policies", nargs="+", default=[*POLICIES])
    parser.add_argument("--sets", type=int, default=5)
    parser.add_argument("--episodes", type=int, default=256)
    parser.add_argument("--tune", action="store_true")
    parser.add_argument("--evolve", metavar="TASK")
    parser.add_argument("--generations", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--speed", action="store_true")
    arguments = parser.parse_args()
    if arguments.tune:
        for task in arguments.tasks:
            keep("tuned", task, tune(task, arguments.episodes))
        return
    if arguments.speed:
        speed("Bridge", (1, 64, 1024, 4096), 40)
        return
    if arguments.evolve:
        for evolved in evolve(
            arguments.evolve,
            generations=arguments.generations,
            seed=arguments.seed,
            episodes=arguments.episodes,
        ):
            keep("evolved", arguments.evolve, evolved)
        return
    print("| task | policy | episodes | measure | closed, % | robots | choices |")
    print("|---|---|---|---|---|---|---|")
    for task in arguments.tasks:
        for policy, (act, settings) in policies(task).items():
            if policy not in arguments.policies:
                continue
            first = FIRST_TEST_SEED + 1000 * np.arange(arguments.sets)
            seeds = (first[:, None] + np.arange(arguments.episodes)).ravel()
            print(row(task, POLICIES[policy], play(task, seeds, act, settings)), flush=True)


if __name__ == "__main__":
    main()
