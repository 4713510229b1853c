"""Times `joint` on towers whose robots walked long ways, by flips of a robot.

    python -m benchmarks.flips                       # 300 and 1,500 robots
    python -m benchmarks.flips --robots 300 --chains 4
    python -m benchmarks.flips --robots 300 --linear # one linear problem alone

Large towers grow high where contacts are strong and robots are patient: with a force threshold of
10, 60 and 200 robots flip some 10, 50 and 100 times. They sense contacts at each stance, with noise
of 1 deg in tilt and 2 deg in yaw. One linear problem is the cost linearized at the truth, with the
factor of its rows' covariance: median of five. On one thread; a small tower compiles the kernels.
"""

import argparse
import time

import numpy as np

import tiswarm
from tiswarm.compute import backend
from tiswarm.compute.machine import machine
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.cost.cost import WholeCost
from tiswarm.localization.settings import JointParams
from tiswarm.study.provenance import peak_memory_mb

WALKS = {
    10: {},
    50: {"force_threshold": 60.0, "climb": {"patience": 64}},
    100: {"force_threshold": 200.0, "climb": {"patience": 128}},
}
"""Settings of growth by flips of a robot, about [1]."""

GOAL_HEIGHT = 500.0
"""Height that no tower reaches [R]."""


def main() -> None:
    """Measure and print a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, nargs="+", default=[300, 1_500])
    parser.add_argument("--flips", type=int, nargs="+", choices=WALKS, default=list(WALKS))
    parser.add_argument("--chains", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--linear", action="store_true", help="localize nothing")
    options = parser.parse_args()
    running = backend.start(threads=1)
    print(f"{machine()}, {running.library}\n", flush=True)
    measured(20, 10, options)
    print(
        "| robots | flips a robot | longest walk | rows of walks | one linear problem [CPU s] "
        "| numbers of the factor | joint [CPU s] | RMSE [R] | MB |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for robots in options.robots:
        for flips in options.flips:
            print(measured(robots, flips, options), flush=True)


def measured(robots: int, flips: int, options: argparse.Namespace) -> str:
    """Grow, sense and localize a tower; return its row of the table."""
    movers = max(3, robots // 100)
    structure = {
        "kind": "tower",
        "goal_height": GOAL_HEIGHT,
        "mechanics": {"model": "rigid"},
        "movers": movers,
        "solve_every": 2 * movers,
        **WALKS[flips],
    }
    swarms = tiswarm.grow(structure, robots=robots, seeds=[options.seed])
    log = swarms[0].sense(tilt_noise_deg=1.0, yaw_noise_deg=2.0)
    cost = WholeCost(log, pose_problem(log, JointParams()).rows)
    truth = cost.at(np.asarray(swarms[0].position), np.zeros(robots))
    times = []
    for _ in range(5):
        start = time.process_time()
        linear = cost.linearized(truth)
        times.append(time.process_time() - start)
    by_joint = "| - | - "
    if not options.linear:
        start = time.process_time()
        estimate = log.localize("joint", chains=options.chains)
        seconds = time.process_time() - start
        by_joint = f"| {seconds:.2g} | {swarms.score([estimate])['rmse_R'].iloc[0]:.2g} "
    walks = np.diff(log.earlier.start)
    return (
        f"| {robots:,} | {walks.mean():.0f} | {walks.max()} | {len(linear.walked):,} "
        f"| {np.median(times):.2g} | {linear.covariance.size:,} {by_joint}| {peak_memory_mb()} |"
    )


if __name__ == "__main__":
    main()
