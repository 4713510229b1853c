"""Compares what kinds of error in the places that robots believe cost bridges.

    python -m benchmarks.navigation               # a few minutes
    python -m benchmarks.navigation --seeds 4 --robots 12

Bridges over 30 R grow by beliefs that are the truth plus an error of one kind, the same in all
directions. The first robot of each side is an anchor, and knows its place. Orientations are exact.

| kind | error of a robot |
|---|---|
| independent | a draw of its own |
| shift | the same for all robots of a side but its anchor |
| turn | that of a side turned about the vertical through its anchor |
| adding up | that of the robot that it touched first, plus a draw of its own |

`size` is the root mean square of a draw or the length of the shift [R], or the angle [rad]. The
table has the RMSE, and that of the vector between two robots in contact [R], once a bridge stands;
the share of bridges that closed; and the p of Fisher's exact test against the truth.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import fisher_exact

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.compute.math import dock_offsets
from tiswarm.world.growth import Believe, grow
from tiswarm.world.history import History
from tiswarm.world.params import BridgeParams

GAP = 30.0
"""Width of the gap [R]: by the truth about half of the bridges of 60 robots close."""

CASES = (
    ("independent", 1.5), ("independent", 2.0), ("shift", 3.0), ("turn", 0.2), ("turn", 0.4),
    ("adding up", 0.5), ("adding up", 1.0),
)  # fmt: skip
"""Kinds of error and their sizes."""


def touched_first(history: History) -> list[int]:
    """Return the robot that each one touched first where it stayed, itself if it touched none."""
    at_rest = [walk.at_rest(walk.contacts)[:, 1] for walk in history.walks]
    return [int(others[0]) if len(others) else j for j, others in enumerate(at_rest)]


def anchor_of(first: Sequence[int]) -> Ints:
    """Return the anchor of the side of each robot, shape (N,)."""
    anchor: list[int] = []
    for j, i in enumerate(first):
        anchor.append(j if i == j else anchor[i])
    return np.array(anchor)


def error_of(history: History, kind: str, size: float) -> Reals:
    """Draw the errors of the robots of a structure that has grown so far [R], shape (N, 3).

    A robot keeps its draw as the structure grows.
    """
    rng = np.random.default_rng([history.seed, 1])
    draw = rng.normal(scale=size / np.sqrt(3.0), size=(1_000, 3))[: history.robot_count]
    first = touched_first(history)
    anchor = anchor_of(first)
    is_anchor = anchor == np.arange(len(anchor))
    draw[is_anchor] = 0.0
    if kind == "independent":
        return draw
    if kind == "shift":
        way = rng.normal(size=3)
        shift: Reals = np.where(is_anchor[:, None], 0.0, size * way / np.linalg.norm(way))
        return shift
    if kind == "turn":
        arm = history.position - history.position[anchor]
        sine, cosine = np.sin(size), np.cos(size) - 1.0
        x, y, _ = arm.T
        return np.column_stack([cosine * x - sine * y, sine * x + cosine * y, 0.0 * x])
    for j, i in enumerate(first):
        draw[j] += draw[i] if i != j else 0.0
    return draw


def believing(kind: str, size: float) -> Believe:
    """Return beliefs that are the truth plus an error."""

    def believe(grown: Sequence[History]) -> list[Reals]:
        docks: list[Reals] = []
        for history in grown:
            offset = dock_offsets(history.orientation_wxyz, history.robot.dock_offset_body)
            center = history.position + error_of(history, kind, size)
            docks.append((center[:, None] + offset).reshape(-1, 3))
        return docks

    return believe


def row_of(kind: str, size: float, structures: Sequence[History], closed: int) -> dict[str, Any]:
    """Summarize structures, `closed` being how many of them robots closed that knew the truth."""
    squares, between = [], []
    for history in structures:
        error = error_of(history, kind, size)
        i, _, j, _ = history.contacts.T
        squares.append((error**2).sum(axis=1).mean())
        between.append(((error[i] - error[j]) ** 2).sum(axis=1).mean())
    count = len(structures)
    crossed = sum(history.crossed for history in structures)
    table = [[crossed, count - crossed], [closed, count - closed]]
    return {
        "error": kind,
        "size": size,
        "RMSE_R": np.sqrt(np.mean(squares)),
        "between_neighbors_R": np.sqrt(np.mean(between)),
        "closed": crossed / count,
        "p": float(fisher_exact(table).pvalue),
    }


def compare(robots: int, seeds: Sequence[int], report: Callable[[str], object]) -> pd.DataFrame:
    """Grow bridges by the truth and by each kind of error."""
    params, robot = BridgeParams(gap=GAP), RobotGeometry()
    known = grow(params, robots=robots, seeds=seeds, robot=robot)
    closed = sum(history.crossed for history in known)
    rows = [
        {"error": "none", "size": 0.0, "RMSE_R": 0.0, "between_neighbors_R": 0.0, "p": 1.0}
        | {"closed": closed / len(seeds)}
    ]
    for kind, size in CASES:
        report(f"{kind} {size}")
        believe = believing(kind, size)
        found = grow(params, robots=robots, seeds=seeds, robot=robot, believe=believe)
        rows.append(row_of(kind, size, found, closed))
    return pd.DataFrame(rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.navigation",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seeds", type=int, default=64, help="bridges of each row, from seed 0")
    parser.add_argument("--robots", type=int, default=60, help="robots of each bridge")
    options = parser.parse_args(arguments)
    backend.start()
    found = compare(options.robots, range(options.seeds), lambda s: print(s, file=sys.stderr))
    print(found.to_string(index=False, float_format="{:.3g}".format))
    return 0


if __name__ == "__main__":
    sys.exit(main())
