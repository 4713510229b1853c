"""Compares ways to start and settle with what the paper says of its structures.

    python -m benchmarks.reactivebuild.anchor          # half an hour
    python -m benchmarks.reactivebuild.anchor --seeds 2 --robots 30 --out anchor.csv

Grows towers and cantilevers over a grid of rules, and prints facts of the structures alone: when
robots touch the anchor, how many structures are completed, how large they are. It localizes
nothing. `benchmarks/reactivebuild/criterion.py` has the criterion by which one rule is chosen, and
`docs/notes/anchor-gap.md` what came of it.
"""

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks import paper_facts
from benchmarks.reactivebuild.criterion import choose
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.evaluation.metrics import rms_radius
from tiswarm.evaluation.tables import totals
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.params import CantileverParams, ClimbParams, TowerParams

FIRST_SEED = 100_000
"""Seed of the first training structure; results are reported on seeds 0 to 24 and 7000 to 7024."""

ON_ANCHOR = ("first_on_anchor", "second_on_anchor", "third_on_anchor")
KINDS: dict[str, Callable[..., TowerParams | CantileverParams]] = {
    "tower": TowerParams,
    "cantilever": CantileverParams,
}

FORCES = (2.5, 3.5, 5.0, 7.0, 10.0, 14.0, 17.0, 20.0, 25.0, 40.0)
"""Values of F, the load from which robots call [weight of a dock]."""

CALLS = ((1.5, 5), (10.0, 5), (3.0, 1), (3.0, 1000))
"""Values of B and J beside the defaults 3 and 5, for robots that do not settle."""

ANCHORS = (3.5, 5.0, 6.5)
"""Distances of a cantilever's anchor behind the edge [R]."""


def rules() -> Iterator[dict[str, Any]]:
    """Yield every rule of the grid by key.

    A tower's anchor climbs like the others. That of a cantilever is put behind the edge, and robot
    1 stays alone on the ground, else it would be the one on the anchor.
    """
    for force in FORCES:
        shared = {"force_threshold": force, "recruit_base": 3.0, "recruit_limit": 5, "settle": 0.0}
        sets = [{**shared, "settle": share} for share in (0.0, 0.5, 1.0)]
        sets += [{**shared, "recruit_base": base, "recruit_limit": limit} for base, limit in CALLS]
        for each in sets:
            yield {"kind": "tower", **each}
            for anchor in ANCHORS:
                yield {"kind": "cantilever", "anchor": anchor, "founders": 2, **each}
        for anchor in ANCHORS:
            put = {"kind": "cantilever", "anchor": anchor, **shared}
            yield {**put, "founders": 1}
            yield {**put, "founders": 2, "spawn_behind": "placed"}
            yield {**put, "founders": 2, "spawn_behind": "leading"}


def facts(structures: Sequence[History], robots: int) -> dict[str, object]:
    """Summarize structures of one rule.

    Returns:
        Medians of join indices, where a touch that never happens counts as infinite; shares of
        structures; means of sizes [R, rho], and of near docks per robot.
    """
    table = pd.DataFrame([totals(history) for history in structures])
    touched = table[[*ON_ANCHOR]].fillna(np.inf)
    radius = np.mean([rms_radius(history.position) for history in structures])
    return {
        "structures": len(table),
        "complete": np.mean([history.robot_count == robots for history in structures]),
        **{str(name): median for name, median in touched.median().items()},
        "first_quartile": touched["first_on_anchor"].quantile(0.25, interpolation="lower"),
        "third_quartile": touched["first_on_anchor"].quantile(0.75, interpolation="higher"),
        "both_at_once": (touched["second_on_anchor"] == 2).mean(),  # noqa: PLR2004 - robots 1, 2
        "rms_radius_R": radius,
        "rms_radius_rho": radius / structures[0].robot.rho,
        "height_R": table["height_R"].mean(),
        "reach_R": table["reach_R"].mean(),
        "of_goal": np.mean([of_goal(history) for history in structures]),
        "beyond_edge": table["beyond_edge"].mean(),
        "carpet_R": np.mean([carpet(history) for history in structures]),
        "near_docks": np.mean([near_docks(history) for history in structures]),
        "pyramids": np.mean([narrows(history) for history in structures]),
    }


def of_goal(history: History) -> float:
    """Divide the height of a tower, or the reach of a cantilever, by that of its goal."""
    axis, goal = (
        (2, TowerParams().goal_height)
        if history.terrain.is_plane
        else (0, CantileverParams().goal_reach)
    )
    return float(history.position[:, axis].max() / goal)


def carpet(history: History) -> float:
    """Return how far behind the edge a cantilever's robots stand [R]; NaN for towers."""
    behind = -history.position[:, 0].min()
    return math.nan if history.terrain.is_plane else float(behind)


def near_docks(history: History) -> float:
    """Count pairs of docks per robot that are less than NEAR apart, but do not touch."""
    return paper_facts.near_docks(history.position, history.orientation_wxyz, history.robot)


def narrows(history: History) -> bool:
    """Whether each third of the height holds fewer robots than the one below it."""
    return paper_facts.narrows(history.position[:, 2] - history.ground_z)


def main(arguments: Sequence[str] | None = None) -> int:
    """Grow the grid, print its facts and, if asked, write them; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.reactivebuild.anchor",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seeds", type=int, default=40, help="structures of each rule")
    parser.add_argument("--robots", type=int, default=100, help="robots in each structure")
    parser.add_argument("--out", type=Path, help="file for the table, as CSV")
    options = parser.parse_args(arguments)
    backend.start()
    seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
    rows = []
    for rule in rules():
        keys = {key: value for key, value in rule.items() if key not in {"kind", "settle"}}
        params = KINDS[rule["kind"]](**keys, climb=ClimbParams(settle=rule["settle"]))
        grown = grow(params, robots=options.robots, seeds=seeds, robot=RobotGeometry())
        rows.append({**rule, **facts(grown, options.robots)})
        if options.out:
            pd.DataFrame(rows).to_csv(options.out, index=False, lineterminator="\n")
    for table in (pd.DataFrame(rows), choose(pd.DataFrame(rows))):
        print(table.to_string(index=False, float_format="{:.2f}".format, na_rep=""))
    return 0


if __name__ == "__main__":
    sys.exit(main())
