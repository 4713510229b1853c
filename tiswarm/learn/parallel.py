"""An environment by PettingZoo's parallel interface: robots that climb at the same time.

An agent is a climber, `climber_0` to `climber_{movers - 1}`: where its robot stays, the next robot
that starts in its stead is its body, until the structure is over for all. While none starts, as
before a founder has joined, it observes 0 and may only stay. All agents have the same reward, the
change of the structure's measure. Observations and actions are those of
`tiswarm.learn.environments`.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike
from pettingzoo import ParallelEnv

from tiswarm.learn.environments import Infos, Observed, observation_space
from tiswarm.learn.episodes import Episodes, infos_of

_MOST_SEEDS = 2**31


class TaskParallelEnv(ParallelEnv[str, Observed, np.int64]):  # type: ignore[misc] # no types
    """A structure that grows by the choices of several climbers."""

    metadata: dict[str, Any] = {"render_modes": [], "name": "tiswarm_v0"}  # noqa: RUF012 - as PettingZoo

    def __init__(
        self,
        task: str = "Tower",
        *,
        movers: int = 1,
        robots: int | None = None,
        settings: Mapping[str, ArrayLike] | None = None,
        max_episode_steps: int | None = None,
        threads: int | None = 1,
    ) -> None:
        """Make an environment of a task.

        Args:
            task: Name of the task.
            movers: Robots that climb at the same time.
            robots: Robots in the structure; as many as the task says if None.
            settings: Keys of the structure, such as `{"gap": 25.0}`.
            max_episode_steps: Steps after which an episode is cut off; the task's if None.
            threads: CPU threads; all that this process may use if None.

        Raises:
            InputError: an argument has a mistake.
        """
        self._episodes = Episodes(
            task,
            1,
            robots=robots,
            movers=movers,
            settings=settings,
            most_steps=max_episode_steps,
            threads=threads,
        )
        self.possible_agents = [f"climber_{row}" for row in range(self._episodes.rows)]
        self.agents: list[str] = []
        self.render_mode = None
        observed = observation_space(self._episodes)
        self._observation_spaces = dict.fromkeys(self.possible_agents, observed)
        self._action_spaces = {
            agent: spaces.Discrete(self._episodes.action_count) for agent in self.possible_agents
        }
        self._steps = 0
        self._is_seeded = False

    def observation_space(self, agent: str) -> spaces.Space[Observed]:
        """Return the space of what an agent observes."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Discrete:
        """Return the space of an agent's actions."""
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observed], dict[str, Infos]]:
        """Begin an episode.

        Args:
            seed: Seed of the structure; those of later episodes are drawn from it.
            options: None has an effect.
        """
        del options
        first = np.zeros(1, np.int64)
        if seed is None and not self._is_seeded:
            seed = int(np.random.default_rng().integers(_MOST_SEEDS))
        if seed is None:
            self._episodes.begin(first)
        else:
            self._episodes.seed(first, np.array([seed]))
        self._is_seeded = True
        self._steps = 0
        self.agents = [*self.possible_agents]
        return self._observed()

    def step(
        self, actions: dict[str, np.int64]
    ) -> tuple[
        dict[str, Observed], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Infos]
    ]:
        """Let all climbers act; who is not named stays.

        Raises:
            InputError: there are no such actions.
        """
        stay = self._episodes.action_count - 2
        chosen = [int(actions.get(agent, stay)) for agent in self.possible_agents]
        reward, is_over = self._episodes.step(np.array(chosen))
        self._steps += 1
        is_cut_off = not is_over[0] and self._steps >= self._episodes.most_steps
        observed, infos = self._observed()
        agents = self.agents
        if is_over[0] or is_cut_off:
            self.agents = []
        return (
            observed,
            dict.fromkeys(agents, float(reward[0])),
            dict.fromkeys(agents, bool(is_over[0])),
            dict.fromkeys(agents, bool(is_cut_off)),
            infos,
        )

    def _observed(self) -> tuple[dict[str, Observed], dict[str, Infos]]:
        observation = self._episodes.observe()
        infos = infos_of(observation, self._episodes)
        by_agent = {}
        info_by_agent = {}
        for row, agent in enumerate(self.agents):
            by_agent[agent] = {name: values[row] for name, values in observation._asdict().items()}
            info_by_agent[agent] = {
                "action_mask": infos["action_mask"][row],
                "robots": int(infos["robots"][0]),
                "measure": float(infos["measure"][0]),
            }
        return by_agent, info_by_agent
