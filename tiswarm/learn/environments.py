"""Environments by the conventions of gymnasium: one structure, or many at once.

An observation is a dictionary of what `tiswarm.learn.observations` lists. An action is the number
of a flip, 0 to K - 1; K is to stay, K + 1 to go back to where the walk was nearest to the goal and
stay there. A flip that is not possible is to stay.
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.learn.episodes import Episodes, infos_of
from tiswarm.learn.features import Feature, features_of
from tiswarm.world.choices import ClimbStep

Observed = dict[str, NDArray[Any]]
Infos = dict[str, Any]

_MOST_SEEDS = 2**31


class TaskEnv(gymnasium.Env[Observed, np.int64]):
    """A structure that grows by the choices of its climber, flip by flip."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - the name is gymnasium's

    def __init__(
        self,
        task: str = "Tower",
        *,
        robots: int | None = None,
        settings: Mapping[str, ArrayLike] | None = None,
        threads: int | None = 1,
    ) -> None:
        """Make an environment of a task.

        Args:
            task: Name of the task.
            robots: Robots in the structure; as many as the task says if None.
            settings: Keys of the structure, such as `{"gap": 25.0}`.
            threads: CPU threads; all that this process may use if None.

        Raises:
            InputError: an argument has a mistake.
        """
        self._episodes = Episodes(task, 1, robots=robots, settings=settings, threads=threads)
        self.observation_space = observation_space(self._episodes)
        self.action_space = spaces.Discrete(self._episodes.action_count)
        self._is_seeded = False

    @property
    def climb_step(self) -> ClimbStep:
        """What the climber sees: more than it observes."""
        return self._episodes.climb_step

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, Infos]:
        """Begin an episode.

        Args:
            seed: Seed of the structure; those of later episodes are drawn from it.
            options: None has an effect.
        """
        super().reset(seed=seed, options=options)
        first = np.zeros(1, np.int64)
        if seed is None and not self._is_seeded:
            seed = int(self.np_random.integers(_MOST_SEEDS))
        if seed is None:
            self._episodes.begin(first)
        else:
            self._episodes.seed(first, np.array([seed]))
        self._is_seeded = True
        return self._observed()

    def step(self, action: np.int64) -> tuple[Observed, float, bool, bool, Infos]:
        """Let the climber act; the episode terminates where the structure is over.

        Raises:
            InputError: there is no such action.
        """
        reward, is_over = self._episodes.step(np.array([action]))
        observed, infos = self._observed()
        return observed, float(reward[0]), bool(is_over[0]), False, infos

    def _observed(self) -> tuple[Observed, Infos]:
        observation = self._episodes.observe()
        infos = infos_of(observation, self._episodes)
        observed = {name: values[0] for name, values in observation._asdict().items()}
        return observed, {
            "action_mask": infos["action_mask"][0],
            "robots": int(infos["robots"][0]),
            "measure": float(infos["measure"][0]),
        }


class TaskVectorEnv(VectorEnv[Observed, Ints, NDArray[Any]]):
    """Structures that grow side by side, each by the choices of its climber.

    An episode that is over begins anew with the next step, whose action has no effect.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        task: str = "Tower",
        *,
        robots: int | None = None,
        settings: Mapping[str, ArrayLike] | None = None,
        max_episode_steps: int | None = None,
        threads: int | None = None,
    ) -> None:
        """Make environments of a task.

        Args:
            num_envs: Structures.
            task: Name of the task.
            robots: Robots in each; as many as the task says if None.
            settings: Keys of the structure, with a value for each of them, or one for all.
            max_episode_steps: Steps after which an episode is cut off; the task's if None.
            threads: CPU threads; all that this process may use if None.

        Raises:
            InputError: an argument has a mistake.
        """
        self._episodes = Episodes(
            task,
            num_envs,
            robots=robots,
            settings=settings,
            most_steps=max_episode_steps,
            threads=threads,
        )
        self.num_envs = num_envs
        self.single_observation_space = observation_space(self._episodes)
        self.single_action_space = spaces.Discrete(self._episodes.action_count)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._is_seeded = False
        self._steps = np.zeros(num_envs, np.int64)
        self._is_done: Bools = np.zeros(num_envs, np.bool_)

    @property
    def climb_step(self) -> ClimbStep:
        """What climbers see: more than they observe."""
        return self._episodes.climb_step

    def reset(
        self,
        *,
        seed: int | Sequence[int] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observed, Infos]:
        """Begin all episodes.

        Args:
            seed: Seed of the first structure, whose followers have the next ones, or a seed of
                each; those of later episodes are drawn from these.
            options: None has an effect.

        Raises:
            InputError: there are more or fewer seeds than structures.
        """
        numbers = np.arange(self.num_envs)
        if seed is None or isinstance(seed, int | np.integer):
            super().reset(seed=None if seed is None else int(seed), options=options)
        seeds: NDArray[Any] | None = None
        if seed is not None:
            seeds = np.asarray(seed)
            if seeds.ndim == 0:
                seeds = seeds + numbers
        elif not self._is_seeded:
            seeds = self.np_random.integers(_MOST_SEEDS, size=self.num_envs)
        if seeds is None:
            self._episodes.begin(numbers)
        elif seeds.shape != numbers.shape:
            raise InputError(f"{len(seeds)} seeds; give {self.num_envs}", argument="seed")
        else:
            self._episodes.seed(numbers, seeds)
        self._is_seeded = True
        self._steps[:] = 0
        self._is_done[:] = False
        return self._observed()

    def step(self, actions: ArrayLike) -> tuple[Observed, Reals, Bools, Bools, Infos]:
        """Let all climbers act, and begin the episodes that were over before.

        Raises:
            InputError: there are no such actions.
        """
        begins = self._is_done
        rewards, is_over = self._episodes.step(actions)
        self._episodes.begin(np.flatnonzero(begins))
        self._steps += 1
        self._steps[begins] = 0
        rewards[begins] = 0.0
        terminated = is_over & ~begins
        truncated = ~terminated & (self._steps >= self._episodes.most_steps)
        self._is_done = terminated | truncated
        observed, infos = self._observed()
        return observed, rewards, terminated, truncated, infos

    def _observed(self) -> tuple[Observed, Infos]:
        observation = self._episodes.observe()
        infos = infos_of(observation, self._episodes)
        for name in tuple(infos):
            infos[f"_{name}"] = np.ones(self.num_envs, np.bool_)
        return observation._asdict(), infos


def observation_space(episodes: Episodes) -> spaces.Space[Observed]:
    """Return the space of what one climber observes, a dictionary."""
    flips = episodes.action_count - 2
    of_flip, of_robot = features_of(by_belief=episodes.climb_step.by_belief)
    space: Any = spaces.Dict(
        {
            "flips": _box(of_flip, (flips, len(of_flip))),
            "robot": _box(of_robot, (len(of_robot),)),
            "action_mask": spaces.MultiBinary(episodes.action_count),
        }
    )
    observed: spaces.Space[Observed] = space
    return observed


def _box(features: tuple[Feature, ...], shape: tuple[int, ...]) -> spaces.Box:
    """Return the space of features, which are along the last axis."""
    low = np.array([feature.low for feature in features], np.float32)
    high = np.array([feature.high for feature in features], np.float32)
    return spaces.Box(np.broadcast_to(low, shape), np.broadcast_to(high, shape), dtype=np.float32)
