"""Environments of growth for programs that learn: gymnasium's, and PettingZoo's in parallel.

    import gymnasium
    import tiswarm.learn  # registers the tasks

    environment = gymnasium.make("tiswarm/Tower-v0")
    environments = gymnasium.make_vec("tiswarm/Bridge-v0", num_envs=1024)
    together = tiswarm.learn.parallel_env("Tower", movers=3)

`gymnasium.make("tiswarm.learn:tiswarm/Tower-v0")` imports this package itself. The extra `learn`
installs both libraries.
"""

from typing import TYPE_CHECKING

from tiswarm.learn.tasks import TASKS, GrowthTask

try:
    import gymnasium
except ModuleNotFoundError as error:
    problem = "environments need the library gymnasium; pip install 'tiswarm[learn]'"
    raise ModuleNotFoundError(problem, name=error.name) from error

if TYPE_CHECKING:
    from tiswarm.learn.parallel import TaskParallelEnv

__all__ = ["TASKS", "GrowthTask", "parallel_env"]


def parallel_env(task: str = "Tower", **arguments: object) -> "TaskParallelEnv":
    """Make an environment by PettingZoo's parallel interface.

    Args:
        task: Name of the task.
        arguments: As `tiswarm.learn.parallel.TaskParallelEnv` takes them.

    Raises:
        ModuleNotFoundError: PettingZoo is not installed.
    """
    try:
        from tiswarm.learn.parallel import TaskParallelEnv  # noqa: PLC0415 - a library of its own
    except ModuleNotFoundError as error:
        problem = "robots in parallel need the library pettingzoo; pip install 'tiswarm[learn]'"
        raise ModuleNotFoundError(problem, name=error.name) from error
    return TaskParallelEnv(task, **arguments)  # type: ignore[arg-type]


for _name, _task in TASKS.items():
    gymnasium.register(
        id=f"tiswarm/{_name}-v0",
        entry_point="tiswarm.learn.environments:TaskEnv",
        vector_entry_point="tiswarm.learn.environments:TaskVectorEnv",
        max_episode_steps=_task.most_steps,
        kwargs={"task": _name},
    )
