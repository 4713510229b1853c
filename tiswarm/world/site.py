"""One growing structure's own story: who has joined, what it bears, who tries next."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tiswarm.compute.math import uniform
from tiswarm.robot import DOCK_COUNT, RobotGeometry
from tiswarm.world.history import History, Strain, Walk
from tiswarm.world.kinds import KINDS
from tiswarm.world.mechanics import Frame, Loads, StructureFailure
from tiswarm.world.params import StructureParams
from tiswarm.world.recruitment import recruit, relay
from tiswarm.world.structure import Structures

Array = NDArray[np.float64]

MAX_TRIES = 64
"""Places drawn for one robot before its spawn counts as blocked."""


class Site:
    """A structure that grows, robot by robot."""

    def __init__(
        self, number: int, seed: int, params: StructureParams, robot: RobotGeometry
    ) -> None:
        """Prepare empty ground."""
        self.number = number
        self.seed = seed
        self.params = params
        self.robot = robot
        self.kind = KINDS[params.kind]
        self.terrain = self.kind.terrain(params)
        self.frame = Frame(params.mechanics, robot.dock_offset_body)
        self.rim = [0.0] * self.kind.sides
        self.low_docks: Array = np.empty((0, 3))
        self.surveyed = 0
        self.walks: list[Walk] = []
        self.strain: list[Strain] = []
        self.sides: list[int] = []
        self.sensed: Array = np.empty(0)
        self.unsolved = 0
        self.spawned = 0
        self.in_vain = 0
        self.crossed = False
        self.ended = ""

    @property
    def founding(self) -> bool:
        """Whether the next robot may stay without touching another."""
        return len(self.walks) < self.kind.sides

    def spawn(self, docks: Array) -> tuple[Array, Array, Array] | None:
        """Lay the next robot flat on the ground, turned at random.

        Draws depend on the seed and the number of robots spawned before alone.

        Args:
            docks: Dock centers of the structure [R], shape (n, 3).

        Returns:
            Center [R], orientation wxyz and goal [R]; None where every place was taken.
        """
        self._survey(docks)
        index = self.spawned
        self.spawned += 1
        side = len(self.walks) % self.kind.sides if self.founding else index % self.kind.sides
        for trial in range(MAX_TRIES):
            draw = uniform(self.seed, "spawn", index, 3 * trial + np.arange(3))
            x, y = self.kind.start(self.params, side, self.rim[side], draw[:2])
            center = np.array([x, y, self.terrain.ground_z + self.robot.dock_radius])
            if self._is_free(center):
                half = np.pi * draw[2]
                orientation = np.array([np.cos(half), 0.0, 0.0, np.sin(half)])
                return center, orientation, self.kind.goal(self.params, side)
        self.ended = f"no free place to spawn robot {len(self.walks)}; raise structure.spawn_max"
        return None

    def _survey(self, docks: Array) -> None:
        """Look at the docks that joined since the last spawn, for the next robots' places."""
        new = docks[self.surveyed :]
        self.surveyed = len(docks)
        for side, rim in enumerate(self.rim):
            self.rim[side] = max(rim, self.kind.rim(self.params, side, new))
        above = new[:, 2] - (self.terrain.ground_z + self.robot.dock_radius)
        self.low_docks = np.concatenate([self.low_docks, new[np.abs(above) <= self._clearance]])

    @property
    def _clearance(self) -> float:
        """Distance of docks from a robot's center that they cannot touch, however it is turned."""
        return self.robot.rho + self.robot.spacing

    def _is_free(self, center: Array) -> bool:
        """Whether a robot at `center`, on the ground, overlaps nothing, however it is turned."""
        distance = np.linalg.norm(self.low_docks - center, axis=1)
        return bool(distance.min(initial=np.inf) > self._clearance)

    def turn_away(self) -> None:
        """Count a robot that found no place; end growth where too many have."""
        self.in_vain += 1
        if self.in_vain >= self.params.climb.max_spawns:
            self.ended = (
                f"{self.in_vain} robots in a row reached no other robot; "
                "raise structure.climb.max_spawns or move the goal"
            )

    def join(self, walk: Walk) -> None:
        """Make a robot part of the structure."""
        j = len(self.walks)
        self.in_vain = 0
        self.walks.append(walk)
        turn = Rotation.from_quat(walk.orientation_wxyz[-1], scalar_first=True).as_matrix()
        own, other, dock = walk.at_rest(walk.contacts).T
        contacts = np.column_stack([DOCK_COUNT * other + dock, DOCK_COUNT * j + own])
        standing = np.concatenate(
            [walk.at_rest(walk.ground_docks)[:, 0], walk.at_rest(walk.edge_docks)[:, 0]]
        )
        docks = walk.center[-1] + self.robot.dock_offset_body @ turn.T
        footing = np.column_stack([DOCK_COUNT * j + standing, self.terrain.foot(docks[standing])])
        self.frame.join(walk.center[-1], turn, contacts, footing)
        self.unsolved += 1
        self._mark_side(j, other, docks[standing, 0])
        self.strain.append(Strain())

    def _mark_side(self, j: int, others: NDArray[np.int32], standing_x: Array) -> None:
        """End growth when what came from both sides of a gap holds together."""
        if self.kind.sides == 1:
            return
        touched = {self.sides[i] for i in others}
        touched |= {int(x > 0.5 * self.terrain.right_edge) for x in standing_x}
        self.sides.append(min(touched))
        if len(touched) > 1:
            self.crossed = True
            self.ended = f"the gap is bridged by {j + 1} robots"

    def recruit(self, structures: Structures, *, last: bool) -> None:
        """Solve the mechanics if it is due, and spread every call for help anew."""
        if self.unsolved >= self.params.solve_every or (last and self.unsolved):
            try:
                self._take(self.frame.solve())
            except StructureFailure as failure:
                self.ended = str(failure)
                return
        call = np.zeros(len(self.walks), np.int32)
        call[: len(self.sensed)] = recruit(self.sensed, self.params)
        count = DOCK_COUNT * len(self.walks)
        structures.relay[self.number, :count] = relay(call, self.frame.joints)

    def _take(self, loads: Loads) -> None:
        """Remember what a solve found."""
        self.unsolved = 0
        self.sensed = loads.sensed
        self.strain[-1] = Strain(
            peak=loads.peak,
            sensed_max=float(loads.sensed.max()),
            calling=int((recruit(loads.sensed, self.params) > 0).sum()),
            least_support=float(loads.ground_force[:, 2].min(initial=np.inf)),
            imbalance=loads.imbalance,
        )

    def history(self) -> History:
        """Bind what happened here."""
        return History(
            seed=self.seed,
            robot=self.robot,
            terrain=self.terrain,
            walks=tuple(self.walks),
            spawns=self.spawned,
            strain=tuple(self.strain),
            sensed=self.sensed,
            crossed=self.crossed,
            ended=self.ended,
        )
