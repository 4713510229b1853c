"""Localizes a million robots once: a field of towers on one ground, in one log.

    python -m benchmarks.million                    # 100 towers of 10,000
    python -m benchmarks.million --towers 4 --arms 4 --robots 400 --alone

Towers are grown one after the other from seeds of their own, as are arms
(cantilevers); all stand in a square grid, so far apart that they cannot touch. Robots sense
contacts, ground and heights, without noise. Each structure's first robot is an anchor whose place
is known; nothing else ties the structures to each other. `joint` anneals all robots as one
structure in one chain, without walk contacts. Each stage prints its wall time, processor time and
peak of memory. `--alone` localizes each structure in a log of its own too, for comparison.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.compute.machine import machine
from tiswarm.evaluation.metrics import rmse, robot_errors
from tiswarm.localization.methods import localize_batch
from tiswarm.localization.settings import Cues, JointParams
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import SensingParams, observe
from tiswarm.study.provenance import peak_memory_mb
from tiswarm.world.growth import grow
from tiswarm.world.mechanics import MechanicsParams
from tiswarm.world.params import CantileverParams, TowerParams

SENSES = SensingParams(stances=False)
ANCHOR_SD = 0.01
"""Standard deviation of the known place of each tower's first robot [R]."""
GAP = 10.0
"""Least distance of robots of neighboring structures [R], so that no docks overlap."""
HUNDRED = {"tower": 65.0, "arm": 45.0}
"""Height or reach of the goal of 100 robots [R]."""


def main() -> None:
    """Grow, sense, localize and evaluate; print what each took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--towers", type=int, default=100)
    parser.add_argument("--arms", type=int, default=0, help="cantilevers beside them")
    parser.add_argument("--robots", type=int, default=10_000, help="robots of each structure")
    parser.add_argument("--alone", action="store_true", help="localize each structure alone, too")
    parser.add_argument("--threads", type=int)
    options = parser.parse_args()
    running = backend.start(threads=options.threads)
    print(f"machine: {machine()}, {running.library}, {running.threads} threads")
    names = [f"tower {seed}" for seed in range(options.towers)]
    names += [f"arm {seed}" for seed in range(options.arms)]
    with stage("growing and sensing"):
        grown = [sensed(name, options.robots) for name in names]
    with stage("putting the structures side by side"):
        edges = np.array([[truth.min(axis=0), truth.max(axis=0)] for _, truth in grown])
        widest = np.ptp(edges[:, :, :2], axis=(0, 1)).max()
        columns = int(np.ceil(np.sqrt(len(grown))))
        row, column = np.divmod(np.arange(len(grown)), columns)
        shifts = (GAP + widest) * np.column_stack([column, row, 0 * row])
        log = side_by_side([log for log, _ in grown], shifts)
        truth = np.concatenate([truth + s for (_, truth), s in zip(grown, shifts, strict=True)])
    print(log, flush=True)
    with stage("joint"):
        position = localized(log)
    errors = robot_errors(position, truth)
    print(
        f"RMSE {rmse(position, truth):.3f} R, median {np.median(errors):.3f} R, "
        f"99 % within {np.quantile(errors, 0.99):.3f} R, farthest {errors.max():.1f} R"
    )
    for name, (own, centers), part, right in zip(
        names, grown, np.split(position, len(grown)), np.split(truth, len(grown)), strict=True
    ):
        alone = f", alone {rmse(localized(own), centers):.3f} R" if options.alone else ""
        print(f"{name}: RMSE {rmse(part, right):.3f} R{alone}", flush=True)


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


def goal(kind: str, robots: int) -> float:
    """Return the height of a tower's goal, or the reach of an arm's [R]."""
    return HUNDRED[kind] * (robots / 100) ** (1 / 3)


def sensed(name: str, robots: int) -> tuple[SensingLog, Reals]:
    """Grow a structure as `scenarios/scaling.yaml` does, and sense it.

    Args:
        name: Kind and seed of the structure.
        robots: N.

    Returns:
        Its log, and its robots' centers [R], shape (N, 3).
    """
    kind, seed = name.split()
    size = goal(kind, robots)
    params = TowerParams(goal_height=size) if kind == "tower" else CantileverParams(goal_reach=size)
    params = replace(
        params,
        movers=max(1, robots // 100),
        solve_every=max(1, robots // 50),
        mechanics=MechanicsParams(model="rigid"),
    )
    [history] = grow(params, robots=robots, seeds=[int(seed)], robot=RobotGeometry())
    if history.ended:
        raise SystemExit(f"{name}: {history.ended}")
    return observe(history, SENSES), history.position


def localized(log: SensingLog) -> Reals:
    """Localize a log by one chain of `joint`, shape (N, 3) [R]."""
    params = JointParams(chains=1, cues=Cues(walk_contacts=False, odometry=False))
    [estimate] = localize_batch([log], [params])
    return estimate.position


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
