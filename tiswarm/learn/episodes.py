"""Episodes of a task side by side: actions in, observations and rewards out."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tiswarm.app.steering import Growth
from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.compute.math import uniform
from tiswarm.learn.observations import Observation, choice_of, observation_of
from tiswarm.learn.tasks import Structures, task_of
from tiswarm.world.choices import ClimbStep

_SEED_BITS = 2.0**53


class Episodes:
    """S structures of a task; a structure has a row for each robot that may climb at a time.

    The first structure from a seed has that seed; each later one a seed that is drawn from it and
    the number of the episode.
    """

    def __init__(
        self,
        task: str,
        count: int,
        *,
        robots: int | None = None,
        movers: int = 1,
        settings: Mapping[str, ArrayLike] | None = None,
        most_steps: int | None = None,
        threads: int | None = None,
    ) -> None:
        """Let the first robots start.

        Args:
            task: Name of the task.
            count: Structures, S.
            robots: Robots in each; as many as the task says if None.
            movers: Robots that climb at the same time.
            settings: Keys of the structure, with a value for each of S, or one for all.
            most_steps: Steps after which an episode is cut off; the task's if None.
            threads: CPU threads; all that this process may use if None.

        Raises:
            InputError: an argument has a mistake.
        """
        self.task = task_of(task)
        self.most_steps = self.task.most_steps if most_steps is None else most_steps
        """Steps after which an episode is cut off."""
        self.robots = self.task.robots if robots is None else robots
        structure: dict[str, Any] = {**self.task.structure, "movers": movers}
        self.growth = Growth(
            structure,
            self.robots,
            range(count),
            settings=settings,
            threads=threads,
            **self.task.navigation,
        )
        gap = (settings or {}).get("gap", structure.get("gap", np.nan))
        self._gap = np.broadcast_to(np.asarray(gap, np.float64), (count,))
        self.rows = count * min(movers, self.robots)
        self.seeds = np.arange(count)
        """Seed of each structure's episodes, shape (S,)."""
        self.episode = np.zeros(count, np.int64)
        """Episodes that each has begun since it was seeded, but the first, shape (S,)."""
        self.measure = np.zeros(count)
        """Measure of each structure as it is, shape (S,)."""
        self.action_count = self.climb_step.possible.shape[1] + 2

    @property
    def climb_step(self) -> ClimbStep:
        """What climbers see: more than they observe."""
        return self.growth.observe()

    def observe(self) -> Observation:
        """Return what climbers observe, by row."""
        return observation_of(self.climb_step, self.rows)

    def seed(self, numbers: AnyInts, seeds: AnyInts) -> None:
        """Begin episodes from seeds, shape (n,)."""
        self.seeds[numbers] = seeds
        self.episode[numbers] = -1
        self.begin(numbers)

    def begin(self, numbers: AnyInts) -> None:
        """Begin the next episode of structures, shape (n,)."""
        if not len(numbers):
            return
        self.episode[numbers] += 1
        episode = self.episode[numbers]
        drawn = uniform(self.seeds[numbers], "episode", episode, 0) * _SEED_BITS
        seeds = np.where(episode == 0, self.seeds[numbers], drawn.astype(np.int64))
        self.growth.reset(numbers, seeds=seeds)
        self.measure[numbers] = 0.0

    def step(self, actions: ArrayLike) -> tuple[Reals, Bools]:
        """Let climbers act.

        Args:
            actions: Action of each row, shape (rows,).

        Returns:
            Change of each structure's measure, and whether it is over, shape (S,).

        Raises:
            InputError: the actions are none.
        """
        chosen = np.asarray(actions)
        if chosen.dtype.kind not in "iu" or chosen.shape != (self.rows,):
            problem = f"{chosen.dtype} of shape {chosen.shape}; give {self.rows} integers"
            raise InputError(problem, argument="actions")
        if ((chosen < 0) | (chosen >= self.action_count)).any():
            problem = f"actions are from 0 to {self.action_count - 1}; correct {chosen.tolist()}"
            raise InputError(problem, argument="actions")
        outcome = self.growth.step(choice_of(chosen, self.climb_step))
        reward = np.zeros(len(self.measure))
        changed = np.flatnonzero(outcome.joined + outcome.lost)
        if len(changed):
            measure = self.task.measure(self._structures(changed))
            reward[changed] = measure - self.measure[changed]
            self.measure[changed] = measure
        return reward, outcome.is_over

    @property
    def joined(self) -> Ints:
        """Robots that have joined each structure, shape (S,)."""
        return self.growth.robot_count

    def _structures(self, numbers: AnyInts) -> Structures:
        """Return some structures as they are."""
        dock = self.growth.dock[numbers]
        return Structures(
            position=dock.mean(axis=2),
            present=self.growth.present[numbers],
            joined=self.growth.robot_count[numbers],
            crossed=self.growth.crossed[numbers],
            gap=self._gap[numbers],
        )


def infos_of(observation: Observation, episodes: Episodes) -> dict[str, Any]:
    """Return what an environment adds to its observations, by row or structure."""
    return {
        "action_mask": observation.action_mask.copy(),
        "robots": episodes.joined,
        "measure": episodes.measure.copy(),
    }
