"""Walks of the robots that climb at the same time, as the kernel records them."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute.dialect import Vec3
from tiswarm.errors import TiswarmError
from tiswarm.robot import DOCK_COUNT, RobotGeometry
from tiswarm.world import kernels
from tiswarm.world.history import Walk
from tiswarm.world.params import ClimbParams
from tiswarm.world.structure import Structures


def flip_reach(robot: RobotGeometry) -> float:
    """Greatest distance from a pivot to the centre of a dock that a flip can meet [R]."""
    return math.sqrt(3.0) * robot.rho + robot.spacing


def climb_law(
    climb: ClimbParams, robot: RobotGeometry, *, goal: Sequence[float], ground_z: float
) -> kernels.ClimbLaw:
    """Gather what the climb kernel needs to know and does not change."""
    return kernels.ClimbLaw(
        goal=Vec3(*goal),
        spacing=robot.spacing,
        contact_gap=climb.contact_gap,
        ground_z=ground_z,
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
    """Room for `slots` walks at once; each run overwrites the walks of the last."""

    def __init__(self, slots: int, climb: ClimbParams, robot: RobotGeometry) -> None:
        """Reserve memory: about 70 kB a slot at the default cap on flips."""
        stances = climb.max_flips + 1
        # Docks do not overlap, so no more fit around a pivot than their volumes allow.
        near = math.ceil((flip_reach(robot) + robot.dock_radius) ** 3)
        self.robot = robot
        self.near = np.empty((slots, near, 3))
        self.center = np.empty((slots, stances, 3))
        self.orientation_wxyz = np.empty((slots, stances, 4))
        self.pivot_dock = np.empty((slots, stances), np.int32)
        self.touching = np.empty((slots, stances, DOCK_COUNT, kernels.MAX_TOUCHING), np.int32)
        self.on_ground = np.empty((slots, stances, DOCK_COUNT), np.int32)
        self.last = np.empty(slots, np.int32)
        self.best = np.empty(slots, np.int32)
        self.state = np.empty(slots, np.int32)

    def run(
        self,
        law: kernels.ClimbLaw,
        structures: Structures,
        structure_of: NDArray[np.int32],
        center: NDArray[np.float64],
        orientation_wxyz: NDArray[np.float64],
    ) -> None:
        """Let M robots climb, each from its own start, into slots 0 to M - 1.

        Args:
            law: What holds for all of them.
            structures: What they climb.
            structure_of: Structure that each climbs, shape (M,).
            center: Where each starts [R], shape (M, 3).
            orientation_wxyz: How each is turned at the start, shape (M, 4).
        """
        count = len(structure_of)
        self.center[:count, 0] = center
        self.orientation_wxyz[:count, 0] = orientation_wxyz
        kernels.climb(
            law,
            structures.chains.head,
            structures.chains.following,
            structures.dock,
            structure_of,
            self.robot.dock_offset_body,
            self.near[:count],
            self.center[:count],
            self.orientation_wxyz[:count],
            self.pivot_dock[:count],
            self.touching[:count],
            self.on_ground[:count],
            self.last[:count],
            self.best[:count],
            self.state[:count],
        )
        if (self.state[:count] == kernels.SCRATCH_FULL).any():
            msg = "more docks than fit stand within one flip of a robot: the structure overlaps"
            raise TiswarmError(msg)

    def walk(self, slot: int) -> Walk:
        """Copy one walk out, with the way back to its best stance at the end."""
        last, best = int(self.last[slot]), int(self.best[slot])
        order = np.r_[0 : last + 1, np.arange(last - 1, best - 1, -1)]
        stance, own, item = _entries(self.touching[slot, order])
        contacts = np.column_stack([stance, own, item // DOCK_COUNT, item % DOCK_COUNT])
        return Walk(
            center=self.center[slot, order],
            orientation_wxyz=self.orientation_wxyz[slot, order],
            # Out and back between two stances go about the same dock.
            pivot_dock=self.pivot_dock[slot, np.minimum(order[:-1], order[1:])],
            contacts=contacts[np.lexsort(contacts.T[::-1])].astype(np.int32),
            ground_docks=np.argwhere(self.on_ground[slot, order]).astype(np.int32),
        )


def _entries(
    touching: NDArray[np.int32],
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.int32]]:
    """Stance, own dock and touched dock of every entry in use."""
    stance, own, slot = np.nonzero(touching >= 0)
    return stance, own, touching[stance, own, slot]
