"""Localizes a million robots once: a field of towers on one ground, in one log.

    python -m benchmarks.million                    # 100 towers of 10,000
    python -m benchmarks.million --towers 4 --robots 1000

Towers are grown one after the other from seeds of their own, and stand in a square grid. Robots
sense contacts, ground and heights, without noise. Each tower's first robot is an anchor whose place
is known; nothing else ties the towers to each other. `joint` anneals all robots as one structure in
one chain, without walk contacts. Each stage prints its wall time, processor time and peak of
memory.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from tiswarm.aliases import Reals
from tiswarm.compute import backend
from tiswarm.evaluation.metrics import rmse, robot_errors
from tiswarm.localization.params import JointParams
from tiswarm.localization.registry import METHODS
from tiswarm.records.sensing_log import SensingLog
from tiswarm.robot import RobotGeometry
from tiswarm.sensing import SensingParams, observe
from tiswarm.study.provenance import machine, peak_memory_mb
from tiswarm.world.growth import grow
from tiswarm.world.mechanics import MechanicsParams
from tiswarm.world.params import TowerParams

SENSES = SensingParams(stances=False)
ANCHOR_SD = 0.01
"""Standard deviation of the known place of each tower's first robot [R]."""
APART = 0.6
"""Distance of neighboring towers, in heights of their goal."""


def main() -> None:
    """Grow, sense, localize and evaluate; print what each took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--towers", type=int, default=100)
    parser.add_argument("--robots", type=int, default=10_000, help="robots of a tower")
    parser.add_argument("--threads", type=int)
    options = parser.parse_args()
    running = backend.start(threads=options.threads)
    print(f"machine: {machine()}, {running.library}, {running.threads} threads")
    goal = 65.0 * (options.robots / 100) ** (1 / 3)
    with stage("growing and sensing"):
        grown = [sensed_tower(seed, options.robots, goal) for seed in range(options.towers)]
    with stage("putting the towers side by side"):
        columns = int(np.ceil(np.sqrt(options.towers)))
        shifts = [
            APART * goal * np.array([t % columns, t // columns, 0.0]) for t in range(len(grown))
        ]
        log = side_by_side([log for log, _ in grown], shifts)
        truth = np.concatenate([truth + s for (_, truth), s in zip(grown, shifts, strict=True)])
        del grown
    print(log, flush=True)
    params = JointParams(chains=1, walk_contacts=False, odometry=False)
    with stage("joint"):
        [estimate] = METHODS["joint"].localize_batch([log], [params])
    errors = robot_errors(estimate.position, truth)
    print(
        f"RMSE {rmse(estimate.position, truth):.3f} R, median {np.median(errors):.3f} R, "
        f"99 % within {np.quantile(errors, 0.99):.3f} R, farthest {errors.max():.1f} R"
    )


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Print what a stage takes."""
    wall, cpu = time.perf_counter(), time.process_time()
    yield
    print(
        f"{name}: {time.perf_counter() - wall:.0f} s wall, {time.process_time() - cpu:.0f} s of "
        f"processors, peak so far {peak_memory_mb()} MB",
        flush=True,
    )


def sensed_tower(seed: int, robots: int, goal: float) -> tuple[SensingLog, Reals]:
    """Grow a tower as `scenarios/scaling.yaml` does; return its log and its robots' centers [R]."""
    params = TowerParams(
        goal_height=goal,
        movers=max(1, robots // 100),
        solve_every=max(1, robots // 50),
        mechanics=MechanicsParams(model="rigid"),
    )
    [history] = grow(params, robots=robots, seeds=[seed], robot=RobotGeometry())
    if history.ended:
        raise SystemExit(f"tower of seed {seed}: {history.ended}")
    return observe(history, SENSES), history.position


def side_by_side(logs: Sequence[SensingLog], shifts: Sequence[Reals]) -> SensingLog:
    """Put the logs of structures that stand apart into one; fixes state where their anchors are.

    Args:
        logs: Logs without stances and fixes.
        shifts: Where each structure's origin is [R], shape (3,).
    """
    first = np.cumsum([0, *(log.robot_count for log in logs)]).astype(np.int32)
    starts = first[:-1, None]
    anchor = np.array([log.anchor_position for log in logs]) + shifts
    axis = np.tile(np.arange(3), len(logs))
    robot = np.repeat(starts, 3)
    every = np.ones(len(axis))
    fixes = [robot, *np.eye(3)[axis].T, anchor.ravel(), ANCHOR_SD * every, -every]
    contacts, ground = (
        np.concatenate(
            [getattr(log, name) + start * columns for log, start in zip(logs, starts, strict=True)]
        )
        for name, columns in (("contacts", [1, 0, 1, 0]), ("ground_docks", [1, 0]))
    )
    names = ("orientation_wxyz", "flip_height", "spawn_position")
    return replace(
        logs[0],
        robot_id=np.arange(first[-1]),
        contacts=contacts.astype(np.int32),
        ground_docks=ground.astype(np.int32),
        fixes=np.column_stack(fixes)[3:],
        **{name: np.concatenate([getattr(log, name) for log in logs]) for name in names},
    )


if __name__ == "__main__":
    main()
