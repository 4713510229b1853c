"""Growth: robots spawn, climb toward the goal and stay, until a structure is complete.

Structures grow side by side, in rounds. In a round every structure stands still while its
movers climb, all at once; then they join one after the other. A mover whose walk passes what
has just joined goes on from there in the next round, so nobody walks through anybody; only
calls for help reach those who climb together a round late. A seed grows the same structure in
any company and on any number of threads.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from tiswarm.compute import backend
from tiswarm.robot import RobotGeometry
from tiswarm.world.history import History
from tiswarm.world.kinds import KINDS
from tiswarm.world.params import StructureParams
from tiswarm.world.site import Site
from tiswarm.world.structure import Structures
from tiswarm.world.walks import Walks, climb_law


def grow(
    params: StructureParams,
    *,
    robots: int,
    seeds: Sequence[int],
    robot: RobotGeometry,
    on_progress: Callable[[int], None] = lambda _joined: None,
) -> list[History]:
    """Grow one structure for each seed.

    Args:
        params: Kind of structure, its goal, how robots climb and when they call for help.
        robots: Robots in each structure.
        seeds: One seed a structure.
        robot: The robots' shape.
        on_progress: Called after each round with the number of robots that joined in it.

    Returns:
        One history a seed, in that order. Where growth ended early its `ended` says why, and
        what had grown is kept.
    """
    running = backend.current()
    # A flip that stops within 1e-9 R of the true contact needs float64 on any device.
    backend.start(running.arch, threads=running.threads, precision="f64")
    with ThreadPoolExecutor(running.threads) as threads:
        nursery = _Nursery(params, robots, seeds, robot, threads)
        while nursery.spawn():
            on_progress(nursery.round())
    return [site.history() for site in nursery.sites]


class _Nursery:
    """Structures that grow together and the robots that climb them, `movers` slots each."""

    def __init__(
        self,
        params: StructureParams,
        robots: int,
        seeds: Sequence[int],
        robot: RobotGeometry,
        threads: ThreadPoolExecutor,
    ) -> None:
        self.threads = threads
        self.robots = robots
        self.sites = [Site(s, seed, params, robot) for s, seed in enumerate(seeds)]
        self.structures = Structures.allocate(len(seeds), robots)
        self.site_of = np.repeat(np.arange(len(seeds), dtype=np.int32), params.movers)
        self.walks = Walks(self.site_of, params.climb, robot)
        self.law = climb_law(params.climb, robot, KINDS[params.kind].terrain(params))
        self.moving = np.zeros(len(self.site_of), np.bool_)

    def spawn(self) -> bool:
        """Fill the free slots of unfinished structures; return whether any robot moves."""
        for slot, site in self._slots():
            # Founders come one by one, for they found what the others climb.
            crowd = site.founding and self.moving[self.site_of == site.number].any()
            if not self.moving[slot] and not crowd and self._wants_more(site):
                start = site.spawn(self.structures.joined_docks(site.number))
                if start is not None:
                    self.walks.start(slot, *start)
                    self.moving[slot] = True
        return bool(self.moving.any())

    def _slots(self) -> list[tuple[int, Site]]:
        return [(slot, self.sites[s]) for slot, s in enumerate(self.site_of)]

    def _wants_more(self, site: Site) -> bool:
        """Whether robots are missing beyond those that climb already."""
        climbing = int(self.moving[self.site_of == site.number].sum())
        return not site.ended and len(site.walks) + climbing < self.robots

    def round(self) -> int:
        """Let all movers climb, and those that can join; return how many did."""
        movers = np.flatnonzero(self.moving).astype(np.int32)
        self.walks.climb(self.law, self.structures, movers)
        wants = np.zeros(len(self.site_of), np.int32)
        for slot in movers:
            wants[slot] = self.walks.touches(slot) or self.sites[self.site_of[slot]].founding
        self.walks.join(self.law, self.structures, movers, wants)
        grown = {self.site_of[slot] for slot in movers if self._settle(slot, bool(wants[slot]))}
        list(self.threads.map(self._recruit, sorted(grown)))
        for slot, site in self._slots():
            self.moving[slot] &= not site.ended
        return int((self.walks.joined[movers] >= 0).sum())

    def _recruit(self, number: int) -> None:
        """Let the robots of a structure call; factoring its matrix frees other threads."""
        site = self.sites[number]
        complete = len(site.walks) == self.robots or bool(site.ended)
        site.recruit(self.structures, last=complete)

    def _settle(self, slot: int, wants: bool) -> bool:  # noqa: FBT001 - one of three outcomes
        """Take a mover's outcome to its site: joined, to go on, or gone; return if it joined."""
        site = self.sites[self.site_of[slot]]
        disturbed = self.walks.disturbed[slot]
        joined = bool(self.walks.joined[slot] >= 0)
        if joined:
            site.join(self.walks.walk(slot))
        elif disturbed > 0:
            self.walks.first_stance[slot] = disturbed
            return False
        elif not wants:
            site.turn_away()
        self.moving[slot] = False
        return joined
