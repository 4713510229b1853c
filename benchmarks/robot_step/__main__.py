"""Measures what the steps of a robot that localizes itself take on a Cortex-M4.

    python -m benchmarks.robot_step                       # a tower of 99 robots, noisy
    python -m benchmarks.robot_step --kind cantilever --seed 1

The steps are C99 sources in single precision beside this file, one a step. GCC compiles them for
the processor, QEMU runs them and counts instructions. Results are compared with those of tiswarm.
Needs Debian's gcc-arm-none-eabi, libnewlib-arm-none-eabi and qemu-system-arm.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.joining import KINDS, NOISY
from benchmarks.robot_step.inputs import Expected, inputs
from benchmarks.robot_step.programs import (
    M4,
    Outcome,
    compiler_version,
    missing,
    on_m4,
    size_of_log,
    sizes,
)
from tiswarm.base.aliases import Reals
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.localization.online.tracker import Tracker
from tiswarm.localization.params import VirtualForceParams
from tiswarm.records.sensing_file import log_entries
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import observe
from tiswarm.world.growth import grow

CLOSE = 1e-3
"""Distance up to which two places are the same [R]."""
STABLE = VirtualForceParams(
    attraction_gain=0.25, repulsion_gain=0.088, height_gain=0.2, initial_offset=4.0
)
"""Gains of the condition `stable` of `scenarios/paper-experiments.yaml`: rounding does not grow."""


def main() -> None:
    """Measure and print a table in Markdown, then what differs from tiswarm."""
    options = _options()
    if tools := missing():
        sys.exit(f"robot_step: found no {tools}; run: apt-get install gcc-arm-none-eabi "
                 "libnewlib-arm-none-eabi qemu-system-arm")  # fmt: skip
    backend.start(threads=1)
    [history] = grow(
        KINDS[options.kind], robots=options.robots, seeds=[options.seed], robot=RobotGeometry()
    )
    log = observe(history, NOISY)
    place = _tracked(log)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text, expected = inputs(log, place, options.nearby, STABLE)
        stable = differences(on_m4(text, folder), expected)
        text, expected = inputs(log, place, options.nearby, VirtualForceParams())
        found = on_m4(text, folder)
        print(f"{compiler_version()}, {' '.join(M4)}\n")
        print(_table(found, sizes(folder)))
        print(f"logf of the C library, for the round: {size_of_log(folder)} B of code\n")
    default = differences(found, expected)
    for name, off in default.items():
        print(f"{name}: off by {np.max(off):.1g}")
    print(f"places by virtual forces, stable gains: off by {np.max(stable['places']):.1g}")
    print(f"places by virtual forces: {np.mean(default['places'] < CLOSE):.0%} within {CLOSE} R")


def _tracked(log: SensingLog) -> Reals:
    """Place all robots but the last one as they join, by `online` [R], shape (N - 1, 3)."""
    header, *lines = log_entries(log)
    tracker = Tracker(header)
    for line in lines[:-1]:
        tracker.take(line)
    return (tracker.positions - log.anchor_position) / log.dock_radius


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kind", choices=KINDS, default="tower")
    parser.add_argument("--robots", type=int, default=99, help="the last one joins (default: 99)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--nearby", type=int, default=19, help="robots that move beside it, up to 19 (default: 19)"
    )
    return parser.parse_args()


def _table(found: list[Outcome], size: dict[str, tuple[int, int]]) -> str:
    """Tabulate instructions and memory of each step."""
    [held] = [each.words for each in found if each.what == "held"]
    spent = {
        what: np.array([each.instructions for each in found if each.what == what])
        for what in ("virtual_force", "candidates", "linearize", "step")
    }
    stack = {what: max(each.stack for each in found if each.what == what) for what in spent}
    join, rows = spent["virtual_force"], size["rows"][0]
    lines = [
        ("300 steps by virtual forces, median of the joins", np.median(join),
         size["virtual_force"], held[0], stack["virtual_force"]),
        ("the join that takes most", join.max(), None, None, None),
        ("search for candidates from 48 starts", spent["candidates"][0],
         np.add(size["candidates"], (rows, 0)), held[2], stack["candidates"]),
        ("a round of Gauss-Newton", spent["linearize"].mean() + spent["step"].mean(),
         np.add(size["neighborhood"], (rows, 0)), held[1], max(stack["linearize"], stack["step"])),
        ("of this: normal equations", spent["linearize"].mean(), None, None, None),
        ("of this: factor and step", spent["step"].mean(), None, None, None),
    ]  # fmt: skip
    text = (
        "| step | instructions | code B | held B | work B | stack B |\n|---|---|---|---|---|---|\n"
    )
    for name, instructions, its_size, its_held, its_stack in lines:
        row = f"| {name} | {instructions:,.0f} |"
        if its_size is not None:
            row += f" {its_size[0]:,} | {its_held:,} | {its_size[1]:,} | {its_stack:,} |"
        else:
            row += " | | | |"
        text += row + "\n"
    return text


def differences(found: list[Outcome], expected: Expected) -> dict[str, Reals]:
    """Compare results with those of tiswarm; lengths in R, costs relative, turns in sd."""
    [candidates] = [each.values for each in found if each.what == "candidates"]
    [state] = [each.values for each in found if each.what == "state"]
    joins = np.array([each.values for each in found if each.what == "virtual_force"])
    count, near = len(candidates) // 4, state[1:].reshape(-1, 6)
    if count != len(expected.candidates):
        raise ValueError(f"{count} candidates; tiswarm finds {len(expected.candidates)}")
    place = candidates[count:].reshape(-1, 3)
    return {
        "places": np.linalg.norm(joins - expected.joins, axis=1),
        "candidates": np.linalg.norm(place - expected.candidates, axis=1),
        "centers of the neighborhood": np.linalg.norm((near - expected.state)[:, :3], axis=1),
        "turns of the neighborhood": np.linalg.norm((near - expected.state)[:, 3:], axis=1),
        "cost of the neighborhood": np.abs(state[:1] / expected.cost - 1.0),
    }


if __name__ == "__main__":
    main()
