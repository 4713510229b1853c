"""The history of a structure's growth: the true stances of every robot."""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.base.robot import PlanarRobot, RobotGeometry
from tiswarm.records.terrain import Terrain
from tiswarm.world.ground.solid import SolidGround
from tiswarm.world.mechanics import LoadSummary, parts
from tiswarm.world.rest import Stability

LEFT, FELL, DIED = range(3)
"""What happened to a robot: it left, it fell as others left, or it died where it stands."""


@dataclass(frozen=True, kw_only=True)
class Walk:
    """The stances of one robot, from its spawn to where it stays.

    L stances; contacts are with robots that joined earlier.
    """

    center: Reals
    """Centers [R], shape (L, 3)."""

    orientation_wxyz: Reals
    """Body to world, shape (L, 4)."""

    pivot_dock: NDArray[np.int32]
    """Dock that stays put as the robot leaves each stance but the last, shape (L - 1,)."""

    contacts: NDArray[np.int32]
    """Rows of (stance, own dock, other robot, other dock), sorted, shape (K, 4)."""

    ground_docks: NDArray[np.int32]
    """Docks on flat ground, rows of (stance, own dock), sorted, shape (G, 2)."""

    edge_docks: NDArray[np.int32]
    """Docks on a slab's rounded edge or underside, rows of (stance, own dock), shape (E, 2)."""

    planned_robot: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, np.int32))
    """Robot that each flip was planned to end at, -1 for none, of flips before the way back; empty
    where robots know their places, shape (flips,)."""

    failed_flips: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, np.int32))
    """Flips that met nothing, or where the robot had been, at each stance before the way back, and
    so were undone; empty where robots know their places, shape (flips + 1,)."""

    belief: Reals = field(default_factory=lambda: np.empty(0))
    """Errors of centers where robots believed them once this one had joined [R]: RMSE of all, error
    of its own, RMSE of the vector between two in contact; then bytes that a robot had sent by then,
    in the mean and at most, NaN where none sends any; empty where robots know, shape (5,)."""

    recruited: bool = False
    """Whether the robot stays because it was called for."""

    round: int = 0
    """Round of growth in which the robot joined, from 0. In a round, every robot that climbs walks
    until it can join, is turned away, or an earlier join of the round disturbs its walk."""

    @property
    def stance_count(self) -> int:
        """L."""
        return len(self.center)

    def at_rest(self, rows: NDArray[np.int32]) -> NDArray[np.int32]:
        """Select the rows, stance first, of the last stance, and drop that column."""
        return rows[rows[:, 0] == self.stance_count - 1, 1:]


class StanceRows(NamedTuple):
    """L stances of all robots, from the spawn of the first robot to where the last one stays."""

    structure: Ints
    """Index of the structure in the batch, shape (L,)."""

    robot: Ints
    """Robot in join order, shape (L,)."""

    center: Reals
    """Centers [R], shape (L, 3)."""

    orientation_wxyz: Reals
    """Body to world, shape (L, 4)."""

    pivot_dock: Ints
    """Dock that stays put as the robot leaves the stance; -1 at the robot's last, shape (L,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class History:
    """A structure of N robots as it grew; the truth that sensing and evaluation start from."""

    seed: int
    robot: RobotGeometry
    terrain: Terrain | SolidGround
    walks: tuple[Walk, ...]
    """One walk for each robot, in join order."""

    anchors: int = 1
    """Robots at known positions, the first to join."""

    spawns: int
    """Robots spawned, including those that never joined."""

    loads: tuple[LoadSummary, ...]
    """Loads in the structure after each join, in join order."""

    sensed: Reals
    """Load that each robot senses in the end [weight of a dock], shape (N,); NaN of one that left,
    fell or died."""

    departures: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 3), np.int32))
    """Who left, fell or died, in order, shape (D, 3).

    Rows of (robot, robots that had joined by then, event); the event is 0 (LEFT) if the robot left,
    1 (FELL) if it fell as others left, and 2 (DIED) if it died where it stands. Robots of the same
    number joined and left in between two walks.
    """

    departure_round: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, np.int32))
    """Round of each departure, from 0, shape (D,). Rounds in which robots of a complete structure
    act follow those of growth."""

    may_lose: bool = False
    """Whether robots may leave, fall or die, by the settings of the structure."""

    sent: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    """Bytes that each robot has sent by the rule of growth, shape (N,), or empty without
    messages."""

    broken: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 5), np.int32))
    """Contacts that broke, in order, rows of (robot, dock, robot, dock, robots that had joined by
    then), the earlier robot first; robot and dock are -1 for the ground, shape (B, 5)."""

    loaded_contacts: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 4), np.int32))
    """Contacts when the mechanics were solved last, rows of (robot, dock, robot, dock), the earlier
    robot first; robot and dock are -1 for the ground, shape (L, 4)."""

    contact_load: Reals = field(default_factory=lambda: np.empty((0, 6)))
    """Loads of these contacts: pull along them, negative where docks press, and force across them
    [weight of a dock], bending moment and torsion [weight of a dock times R], largest von Mises
    stress [weight of a dock / R^2], and their load in parts of their strength [1], NaN of docks
    that hold any load, shape (L, 6)."""

    crossed: bool = False
    """Whether a bridge joins both sides of its gap."""

    ended: str = ""
    """Reason why growth stopped before all robots had joined; empty where it did not."""

    stability: Stability | Literal[""] = ""
    """Whether a structure on docks that rest stands, tipped or slid when the mechanics were solved
    last; empty where the ground holds them."""

    @property
    def robot_count(self) -> int:
        """N."""
        return len(self.walks)

    @property
    def is_anchor(self) -> Bools:
        """Whether the position of each robot is known to all, shape (N,)."""
        is_anchor: Bools = np.arange(self.robot_count) < self.anchors
        return is_anchor

    @property
    def join_round(self) -> Ints:
        """Round of growth in which each robot joined, from 0, shape (N,)."""
        return np.array([walk.round for walk in self.walks])

    @property
    def leave_round(self) -> Ints:
        """Round in which each robot left, fell or died; -1 if none, shape (N,).

        A robot that died and fell later has the round in which it fell.
        """
        robot, joined, _ = self.departures.T
        rounds = np.full(self.robot_count, -1)
        # Structures of older versions have no rounds: there it is that of the latest join.
        is_stated = len(self.departure_round) == len(robot)
        rounds[robot] = self.departure_round if is_stated else self.join_round[joined - 1]
        return rounds

    @property
    def flips(self) -> Ints:
        """Flips of each robot, the way back to its best stance included, shape (N,)."""
        return np.array([walk.stance_count - 1 for walk in self.walks])

    @property
    def is_recruited(self) -> Bools:
        """Whether each robot stays because it was called for, shape (N,)."""
        return np.array([walk.recruited for walk in self.walks])

    @property
    def sensed_load(self) -> Reals:
        """Load that each robot senses in its links in the end [weight of a dock], shape (N,).

        NaN of one that left, fell or died, or that joined after loads were last computed.
        """
        load = np.full(self.robot_count, math.nan)
        load[: len(self.sensed)] = self.sensed
        return load

    @property
    def peak_stress(self) -> Reals:
        """Largest stress in any contact after each join [weight of a dock / R^2], shape (N,).

        NaN where the mechanics were not solved after that join.
        """
        return np.array([load.peak for load in self.loads])

    @property
    def breaks(self) -> bool:
        """Whether docks have a strength, from which on contacts break."""
        return bool(len(self.broken) or np.isfinite(self.contact_load[:, 5]).any())

    @property
    def margin(self) -> Reals:
        """Least strength of a robot's contacts in parts of their load in the end [1], shape (N,).

        NaN of robots without contacts, and where docks hold any load.
        """
        margin: Reals = np.full(self.robot_count + 1, math.nan)  # the last is the ground, -1
        with np.errstate(divide="ignore"):  # a contact without load has any margin
            of_contact = 1.0 / self.contact_load[:, 5]
        for robots in (self.loaded_contacts[:, 0], self.loaded_contacts[:, 2]):
            np.fmin.at(margin, robots, of_contact)
        return margin[:-1]

    @property
    def left_after(self) -> Ints:
        """Robots that had joined when each left or fell; N + 1 for one that remains, shape (N,)."""
        after = np.full(self.robot_count, self.robot_count + 1)
        robot, joined, _ = self.departures[self.departures[:, 2] != DIED].T
        after[robot] = joined
        return after

    @property
    def is_gone(self) -> Bools:
        """Whether each robot left or fell; positions are then where it last stood, shape (N,)."""
        is_gone: Bools = self.left_after <= self.robot_count
        return is_gone

    @property
    def is_held(self) -> Bools:
        """Whether contacts among those that are left tie each robot to the ground, shape (N,).

        Anchors stay where they are, with or without contacts.
        """
        standing = np.concatenate([self.ground_docks, self.edge_docks])[:, 0]
        count = self.robot_count
        on_ground = np.column_stack([standing, np.full(len(standing), count)])
        part = parts(np.concatenate([self.contacts[:, ::2], on_ground]), count + 1)
        is_held: Bools = part[:count] == part[count]
        return is_held | self.is_anchor

    @property
    def position(self) -> Reals:
        """Final centers [R], also of robots that left, shape (N, 3)."""
        return np.array([walk.center[-1] for walk in self.walks])

    @property
    def orientation_wxyz(self) -> Reals:
        """Final orientations, body to world, shape (N, 4)."""
        return np.array([walk.orientation_wxyz[-1] for walk in self.walks])

    @property
    def is_planar(self) -> bool:
        """Whether all robots are in the plane y = 0."""
        return isinstance(self.robot, PlanarRobot)

    @property
    def ground_z(self) -> float:
        """Height of the flat ground, or that heights count from [R]."""
        return self.terrain.ground_z

    @property
    def contacts(self) -> NDArray[np.int32]:
        """Docked pairs in the end, by joiner, rows of (i, dock of i, j, dock of j), i < j.

        Shape (C, 4).
        """
        return self._remaining(self.contacts_at_join)

    @property
    def contacts_at_join(self) -> NDArray[np.int32]:
        """Docked pairs as each j joined, of the same form; robots may have left since."""
        return self._at_rest("contacts")[:, [2, 3, 0, 1]]

    @property
    def ground_docks(self) -> NDArray[np.int32]:
        """Docks on flat ground in the end, rows of (robot, dock), shape (G, 2)."""
        return self._remaining(self._at_rest("ground_docks"))

    @property
    def edge_docks(self) -> NDArray[np.int32]:
        """Docks on ground that is not flat in the end, rows of (robot, dock), shape (E, 2)."""
        return self._remaining(self._at_rest("edge_docks"))

    @property
    def stance_contacts(self) -> NDArray[np.int32]:
        """Contacts at each stance of each walk, shape (K, 5).

        Rows of (robot, stance, own dock, other robot, other dock); stances count from 0.
        """
        return self.table("contacts")

    @property
    def stances(self) -> StanceRows:
        """All stances of all robots; their structure is 0."""
        length = [walk.stance_count for walk in self.walks]
        return StanceRows(
            structure=np.zeros(sum(length), np.int64),
            robot=np.repeat(np.arange(len(self.walks)), length),
            center=np.concatenate([walk.center for walk in self.walks]),
            orientation_wxyz=np.concatenate([walk.orientation_wxyz for walk in self.walks]),
            pivot_dock=np.concatenate([np.append(walk.pivot_dock, -1) for walk in self.walks]),
        )

    def table(self, name: str) -> NDArray[np.int32]:
        """Gather the rows that all walks have in a table: (robot, stance, ...)."""
        rows = [getattr(walk, name) for walk in self.walks]
        robot = np.repeat(np.arange(len(rows), dtype=np.int32), [*map(len, rows)])
        return np.column_stack([robot, np.concatenate(rows)])

    def _at_rest(self, name: str) -> NDArray[np.int32]:
        """Gather a table's rows of the last stance of every walk: (robot, ...)."""
        rows = self.table(name)
        stances = np.array([walk.stance_count for walk in self.walks])
        return np.delete(rows[rows[:, 1] == stances[rows[:, 0]] - 1], 1, axis=1)

    def _remaining(self, rows: NDArray[np.int32]) -> NDArray[np.int32]:
        """Choose the rows, (robot, dock, ...) for each end, that hold: nobody left, none broke."""
        return rows[~self.is_gone[rows[:, ::2]].any(axis=1) & ~self.is_broken(rows)]

    def is_broken(self, rows: AnyInts) -> Bools:
        """Whether contacts broke, rows of (robot, dock) of the earlier robot or alone, then more.

        Args:
            rows: Rows of (i, dock of i, j, dock of j), i < j, or of (robot, dock) on the ground,
                shape (n, 4) or (n, 2).
        """
        if not len(self.broken):
            return np.zeros(len(rows), np.bool_)
        # The earlier robot names a contact; the ground has no end of its own.
        broken_rows = {tuple(row) for row in self.broken[:, :4].tolist()}
        whole = np.full((len(rows), 4), -1)
        whole[:, : rows.shape[1]] = rows
        return np.array([tuple(row) in broken_rows for row in whole.tolist()], np.bool_)
