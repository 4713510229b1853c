"""Walks of the robots that climb at the same time, as the kernels record them."""

import math

import numpy as np
from numpy.typing import NDArray

from tiswarm.errors import TiswarmError
from tiswarm.robot import DOCK_COUNT, RobotGeometry
from tiswarm.world import kernels
from tiswarm.world.history import Walk
from tiswarm.world.join_kernels import join_undisturbed
from tiswarm.world.meeting import MAX_TOUCHING, ClimbLaw
from tiswarm.world.params import ClimbParams
from tiswarm.world.structure import Structures
from tiswarm.world.terrain import Terrain

Slots = NDArray[np.int32]


def flip_reach(robot: RobotGeometry) -> float:
    """Greatest distance from a pivot to the center of a dock that a flip can meet [R]."""
    return math.sqrt(3.0) * robot.rho + robot.spacing


def climb_law(climb: ClimbParams, robot: RobotGeometry, terrain: Terrain) -> ClimbLaw:
    """Gather what the kernels need to know and does not change."""
    return ClimbLaw(
        spacing=robot.spacing,
        contact_gap=climb.contact_gap,
        ground_z=terrain.ground_z,
        left_edge=terrain.left_edge,
        right_edge=terrain.right_edge,
        min_flip=math.radians(climb.min_flip_deg),
        max_flip=math.radians(climb.max_flip_deg),
        revisit_distance=climb.revisit_distance,
        full_turn=2.0 * math.pi,
        reach=flip_reach(robot),
        inverse_edge=1.0 / flip_reach(robot),
        twists=climb.twists,
        patience=climb.patience,
    )


class Walks:
    """Room for the walks of as many robots as climb at once, one slot each."""

    def __init__(
        self, structure_of: NDArray[np.int32], climb: ClimbParams, robot: RobotGeometry
    ) -> None:
        """Reserve memory: about 90 kB a slot at the default cap on flips.

        `structure_of` is the structure that each slot's robots climb, ascending, shape (slots,).
        """
        slots, stances = len(structure_of), climb.max_flips + 2
        # Docks do not overlap, so no more fit around a pivot than their volumes allow.
        near = math.ceil((flip_reach(robot) + robot.dock_radius) ** 3)
        self.structure_of = structure_of
        self.body = robot.dock_offset_body
        self.settles = climb.settle
        self.first_stance = np.zeros(slots, np.int32)
        self.goal = np.zeros((slots, 3))
        self.near = np.empty((slots, near, 3))
        self.center = np.empty((slots, stances, 3))
        self.orientation_wxyz = np.empty((slots, stances, 4))
        self.pivot_dock = np.empty((slots, stances), np.int32)
        self.touching = np.empty((slots, stances, DOCK_COUNT, MAX_TOUCHING), np.int32)
        self.on_ground = np.empty((slots, stances, DOCK_COUNT), np.int32)
        self.last = np.zeros(slots, np.int32)
        self.best = np.zeros(slots, np.int32)
        self.stay = np.zeros(slots, np.int32)
        self.state = np.zeros(slots, np.int32)
        self.disturbed = np.zeros(slots, np.int32)
        self.joined = np.zeros(slots, np.int32)

    def start(
        self,
        slot: int,
        center: NDArray[np.float64],
        orientation_wxyz: NDArray[np.float64],
        goal: NDArray[np.float64],
    ) -> None:
        """Put a new robot in a slot: where it starts [R], how it is turned, where it goes."""
        self.center[slot, 0] = center
        self.orientation_wxyz[slot, 0] = orientation_wxyz
        self.goal[slot] = goal
        self.first_stance[slot] = 0

    def climb(self, law: ClimbLaw, structures: Structures, movers: Slots) -> None:
        """Let the robots in the slots `movers` walk on from their first stance."""
        kernels.climb(
            law, structures.chains.head, structures.chains.following, structures.dock,
            structures.relay, movers, self.structure_of, self.first_stance, self.goal, self.body,
            self.near, self.center, self.orientation_wxyz, self.pivot_dock, self.touching,
            self.on_ground, self.last, self.best, self.state,
        )  # fmt: skip
        if (self.state[movers] == kernels.SCRATCH_FULL).any():
            msg = "more docks than fit stand within one flip of a robot: the structure overlaps"
            raise TiswarmError(msg)
        self.stay[movers] = self.best[movers]
        if self.settles:
            self._settle(law, structures, movers)

    def _settle(self, law: ClimbLaw, structures: Structures, movers: Slots) -> None:
        """Let robots that touch with two docks touch with the third."""
        kernels.settle(
            law, structures.chains.head, structures.chains.following, structures.dock,
            structures.relay, movers, self.structure_of, self.body, self.near, self.last, self.best,
            self.center, self.orientation_wxyz, self.pivot_dock, self.touching, self.on_ground,
            self.stay,
        )  # fmt: skip

    def join(
        self, law: ClimbLaw, structures: Structures, movers: Slots, wants: NDArray[np.int32]
    ) -> None:
        """Let movers join whose walks no earlier one disturbs; see `join_undisturbed`.

        Args:
            law: Terrain, distances and limits.
            structures: What they climbed; grows.
            movers: Their slots, ascending, shape (M,).
            wants: Whether each slot's walk ends where it can stay, shape (slots,).
        """
        first = np.searchsorted(
            self.structure_of[movers], np.arange(len(structures.robot_count) + 1)
        )
        join_undisturbed(
            law, first.astype(np.int32), movers, wants, self.body, self.center,
            self.orientation_wxyz, self.last, self.stay, structures.dock, structures.robot_count,
            structures.chains.head, structures.chains.following, self.disturbed, self.joined,
        )  # fmt: skip

    def touches(self, slot: int) -> bool:
        """Whether the robot touches another one where it stays."""
        return bool((self.touching[slot, self.stay[slot]] >= 0).any())

    def walk(self, slot: int) -> Walk:
        """Copy one walk out, with the way back to where the robot stays at its end."""
        last, best = int(self.last[slot]), int(self.best[slot])
        order = np.r_[0 : last + 1, np.arange(last - 1, best - 1, -1)]
        # Out and back between two stances go about the same dock.
        pivot = self.pivot_dock[slot, np.minimum(order[:-1], order[1:])]
        if self.stay[slot] > last:
            order = np.append(order, last + 1)
            pivot = np.append(pivot, self.pivot_dock[slot, last + 1])
        touching = self.touching[slot, order]
        stance, own, place = np.nonzero(touching >= 0)
        item = touching[stance, own, place]
        contacts = np.column_stack([stance, own, item // DOCK_COUNT, item % DOCK_COUNT])
        on_ground = self.on_ground[slot, order]
        return Walk(
            center=self.center[slot, order],
            orientation_wxyz=self.orientation_wxyz[slot, order],
            pivot_dock=pivot,
            contacts=contacts[np.lexsort(contacts.T[::-1])].astype(np.int32),
            ground_docks=np.argwhere(on_ground == FLAT).astype(np.int32),
            edge_docks=np.argwhere(on_ground == EDGE).astype(np.int32),
            recruited=bool(self.state[slot] == kernels.RECRUITED),
        )


FLAT, EDGE = 1, 2
"""What the kernels call flat ground and a rounded edge."""
