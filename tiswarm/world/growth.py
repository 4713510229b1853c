"""Growth: robots spawn, climb toward the goal and stay, one after the other.

Many structures grow side by side. Each has one robot on the move at a time and stands still
meanwhile, so the climbs of a round run in parallel, and the same seed grows the same
structure in any company.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute import backend
from tiswarm.compute.rotations import dock_offsets
from tiswarm.robot import RobotGeometry
from tiswarm.world.history import History, Walk
from tiswarm.world.params import TowerParams
from tiswarm.world.spawn import spawn_outside
from tiswarm.world.structure import Structures
from tiswarm.world.walks import Walks, climb_law, flip_reach

GROUND_Z = 0.0


def grow(
    params: TowerParams,
    *,
    robots: int,
    seeds: Sequence[int],
    robot: RobotGeometry,
    tell: Callable[[int], None] = lambda _joined: None,
) -> list[History]:
    """Grow one structure for each seed.

    Args:
        params: Kind of structure, its goal, and how robots climb.
        robots: Robots in each structure.
        seeds: One seed a structure.
        robot: The robots' shape.
        tell: Called after each round with the number of robots that joined in it.

    Returns:
        One history a seed, in that order. Where growth ended early its `ended` says why, and
        what had grown is kept.
    """
    running = backend.current()
    # A flip that stops within 1e-9 R of the true contact needs float64 on any device.
    backend.start(running.arch, threads=running.threads, precision="f64")
    law = climb_law(params.climb, robot, goal=(0.0, 0.0, params.goal_height), ground_z=GROUND_Z)
    structures = Structures.allocate(len(seeds), robots, edge=flip_reach(robot))
    walks = Walks(len(seeds), params.climb, robot)
    sites = [_Site(s, seed, params, robot) for s, seed in enumerate(seeds)]
    while growing := [site for site in sites if site.unfinished(robots)]:
        movers = [site for site in growing if site.spawn(structures)]
        if movers:
            walks.run(
                law,
                structures,
                np.array([site.number for site in movers], np.int32),
                np.array([site.start[0] for site in movers]),
                np.array([site.start[1] for site in movers]),
            )
            joined = [site for slot, site in enumerate(movers) if site.take(walks.walk(slot))]
            _join(structures, joined, robot)
            tell(len(joined))
    return [site.history() for site in sites]


def _join(structures: Structures, sites: "Sequence[_Site]", robot: RobotGeometry) -> None:
    """Make the last robot of each site part of its structure."""
    if not sites:
        return
    center = np.array([site.walks[-1].center[-1] for site in sites])
    orientation = np.array([site.walks[-1].orientation_wxyz[-1] for site in sites])
    docks = center[:, None, :] + dock_offsets(orientation, robot.dock_offset_body)
    structures.join(np.array([site.number for site in sites], np.int32), docks)


class _Site:
    """One structure's own story: who has joined, and how often the next robot has tried."""

    def __init__(self, number: int, seed: int, params: TowerParams, robot: RobotGeometry) -> None:
        self.number = number
        self.seed = seed
        self.params = params
        self.robot = robot
        self.walks: list[Walk] = []
        self.spawns = 0
        self.attempt = 0
        self.ended = ""
        self.start: tuple[NDArray[np.float64], NDArray[np.float64]]

    def unfinished(self, robots: int) -> bool:
        """Whether robots are still to join."""
        return len(self.walks) < robots and not self.ended

    def spawn(self, structures: Structures) -> bool:
        """Draw a start for the next robot; end growth where there is none."""
        start = spawn_outside(
            structures.joined_docks(self.number),
            self.robot,
            distance=(self.params.spawn_min, self.params.spawn_max),
            ground_z=GROUND_Z,
            seed=self.seed,
            index=len(self.walks),
            attempt=self.attempt,
        )
        self.attempt += 1
        self.spawns += 1
        if start is None:
            self.ended = (
                f"no free place to spawn robot {len(self.walks)} around the base; "
                "raise structure.spawn_max"
            )
            return False
        self.start = start
        return True

    def take(self, walk: Walk) -> bool:
        """Keep a walk that ends in the structure; the first robot founds it."""
        joins = walk.joins or not self.walks
        if joins:
            self.walks.append(walk)
            self.attempt = 0
        elif self.attempt >= self.params.climb.max_spawns:
            self.ended = (
                f"robot {len(self.walks)} reached no other robot in {self.attempt} spawns; "
                "raise structure.climb.max_spawns or move the goal"
            )
        return joins

    def history(self) -> History:
        """Bind what happened here."""
        return History(
            seed=self.seed,
            robot=self.robot,
            ground_z=GROUND_Z,
            walks=tuple(self.walks),
            spawns=self.spawns,
            ended=self.ended,
        )
