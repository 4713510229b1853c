"""Forces in a structure under its own weight: one linear solve after a join.

A robot is a center and three docks joined by beams (its links); docks in contact are joined
by a beam, and a dock on the ground by one to the fixed ground. Weight acts on the docks. The
center, which bears no load, is eliminated beforehand, so a robot adds 18 unknowns: the motion
of its docks. In the rigid model a robot is one body with 6 unknowns; on average it senses as
much in towers and some 15 % more in cantilevers, on the same side of F = 10 in nine of ten.

What a robot feels in a link follows from what acts on its dock in either model: the forces of
the dock's contacts and its weight.
"""

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass as parameters
from scipy.sparse.linalg import splu

from tiswarm.params import STRICT
from tiswarm.world.beams import Array, rigid_link, stiffness
from tiswarm.world.blocks import BlockMatrix

GROUND = -1
"""Stands for the ground where a beam's second dock is named."""

MAX_UNBORNE = 1e-6
"""Greatest share of the weight that may be missing from the ground forces of what stands [1]."""

UNHELD = "a part of the structure is held by nothing"


class StructureFailure(Exception):  # noqa: N818 - the structure fails, not the program
    """A structure cannot bear its weight, or is none."""


@parameters(frozen=True, kw_only=True, config=STRICT)
class MechanicsParams:
    """Stiffness of robots and contacts, in units of the weight of a dock and R."""

    model: Literal["flexible", "rigid"] = "flexible"
    """Whether robots bend (18 unknowns each) or only contacts do (6 unknowns each)."""

    link_axial: Annotated[float, Field(gt=0.0)] = 2e9
    """EA of a link between a robot's center and a dock."""

    contact_axial: Annotated[float, Field(gt=0.0)] = 1e10
    """EA of a contact between two docks, or a dock and the ground."""

    beam_radius: Annotated[float, Field(gt=0.0)] = 0.5
    """Radius of links and contacts [R]."""

    poisson: Annotated[float, Field(ge=0.0, lt=0.5)] = 0.3
    """Poisson's ratio [1]."""


@dataclass(frozen=True, kw_only=True)
class Loads:
    """What a structure of N robots, C contacts and G ground contacts bears, at rest."""

    sensed: Array
    """Mean over a robot's links of |axial force| + |bending moment|, shape (N,)."""

    contact_stress: Array
    """Largest von Mises stress in each contact, shape (C,)."""

    ground_stress: Array
    """The same in each contact with the ground, shape (G,)."""

    ground_force: Array
    """Force of the ground on each dock that stands on it, shape (G, 3)."""

    imbalance: float
    """Greatest component of the sum of weight and ground forces, per unit of weight [1]."""

    @property
    def peak(self) -> float:
        """Largest stress anywhere."""
        return float(max(self.contact_stress.max(initial=0.0), self.ground_stress.max(initial=0.0)))


class _Arrival(NamedTuple):
    """A robot that has joined and whose beams are not built yet; see `Frame.join`."""

    center: Array
    turn: Array
    contacts: NDArray[np.int32]
    footing: Array


class Frame:
    """The beams of one structure; grows by a robot at a time."""

    def __init__(self, params: MechanicsParams, dock_offset_body: Array) -> None:
        """Prepare an empty frame for robots of one shape."""
        self.params = params
        self.body = dock_offset_body
        self.robot = _condensed_robot(dock_offset_body, params)
        self.rigid = params.model == "rigid"
        self.dock: Array = np.empty((0, 3))
        self.arm: Array = np.empty((0, 3))
        self.ends: NDArray[np.intp] = np.empty((0, 2), np.intp)
        self.span: Array = np.empty((0, 3))
        self.beams: list[Array] = []
        self.blocks = BlockMatrix()
        self.waiting: list[_Arrival] = []

    def join(self, center: Array, turn: Array, contacts: NDArray[np.int32], footing: Array) -> None:
        """Add a robot.

        Args:
            center: Its center [R], shape (3,).
            turn: Its orientation, body to world, shape (3, 3).
            contacts: Docks in contact, rows of (earlier dock, own dock), dock k of robot i
                being 3 i + k, shape (c, 2).
            footing: Docks on the ground, rows of (own dock, x, y, z): where it touches [R],
                shape (g, 4).
        """
        self.waiting.append(_Arrival(center, turn, contacts, footing))

    @property
    def joints(self) -> NDArray[np.intp]:
        """Docks that touch, rows of (dock, dock), shape (C, 2)."""
        self._admit()
        inner: NDArray[np.intp] = self.ends[self.ends[:, 1] != GROUND]
        return inner

    def _admit(self) -> None:
        """Build the beams of all robots that joined since the last solve."""
        if not self.waiting:
            return
        center, turn, contacts, footing = map(list, zip(*self.waiting, strict=True))
        self.waiting = []
        turns = np.array(turn)
        arm = self.body @ turns.swapaxes(1, 2)
        first = len(self.dock)
        self.arm = np.concatenate([self.arm, arm.reshape(-1, 3)])
        docks = (np.array(center)[:, None] + arm).reshape(-1, 3)
        self.dock = np.concatenate([self.dock, docks])
        if not self.rigid:
            own = first + np.arange(len(docks)).reshape(-1, len(self.body))
            self.blocks.add(own, _turned(self.robot, turns))
        joints, feet = np.concatenate(contacts), np.concatenate(footing)
        foot = np.column_stack([feet[:, 0], np.full(len(feet), GROUND)])
        ends = np.concatenate([joints, foot]).astype(np.intp)
        target = np.concatenate([self.dock[joints[:, 1]], feet[:, 1:]])
        self._connect(ends, target - self.dock[ends[:, 0]])

    def _connect(self, ends: NDArray[np.intp], span: Array) -> None:
        """Add beams from docks to docks or to the ground."""
        params = self.params
        beams = stiffness(span, params.contact_axial, params.beam_radius, params.poisson)
        self.ends = np.concatenate([self.ends, ends])
        self.span = np.concatenate([self.span, span])
        self.beams.append(beams)
        if self.rigid:
            follow = self._follow(ends)
            beams = follow.swapaxes(1, 2) @ beams @ follow
        standing = ends[:, 1] == GROUND
        nodes = self._node(ends)
        self.blocks.add(nodes[~standing], beams[~standing])
        self.blocks.add(nodes[standing, :1], beams[standing, :6, :6])

    def _node(self, dock: NDArray[np.intp]) -> NDArray[np.intp]:
        """Node that a dock moves with."""
        return dock // len(self.body) if self.rigid else dock

    def _follow(self, ends: NDArray[np.intp]) -> Array:
        """Motion of beam ends from that of the rigid robots they are on, shape (n, 12, 12)."""
        follow = np.zeros((len(ends), 12, 12))
        follow[:, :6, :6] = rigid_link(self.arm[ends[:, 0]])
        follow[:, 6:, 6:] = rigid_link(self.arm[ends[:, 1]])
        return follow

    def solve(self) -> Loads:
        """Find the forces at rest under the robots' own weight.

        Raises:
            StructureFailure: where the structure, or a part of it, is held by nothing.
        """
        self._admit()
        weight = np.zeros((len(self.dock), 6))
        weight[:, 2] = -1.0
        both: Array = self._motion(weight)[self._node(self.ends)].reshape(-1, 12, 1)
        if self.rigid:
            both = self._follow(self.ends) @ both
        both[self.ends[:, 1] == GROUND, 6:] = 0.0
        self.beams = [np.concatenate(self.beams)]
        force = (self.beams[0] @ both).reshape(-1, 2, 6)
        acting = weight.copy()
        for side in range(2):
            here = self.ends[:, side] != GROUND
            np.add.at(acting, self.ends[here, side], -force[here, side])
        loads = self._loads(force, acting)
        # Rounding hides that a matrix is singular, but not that nothing bears the weight.
        if not loads.imbalance <= MAX_UNBORNE:
            raise StructureFailure(UNHELD)
        return loads

    def _motion(self, weight: Array) -> Array:
        """Displacement and rotation of every node, shape (nodes, 6)."""
        if self.rigid:
            pushed = rigid_link(self.arm).swapaxes(1, 2) @ weight[:, :, None]
            weight = pushed.reshape(-1, len(self.body), 6).sum(axis=1)
        if not (self.ends[:, 1] == GROUND).any():
            raise StructureFailure(UNHELD)
        matrix = self.blocks.assemble(len(weight))
        try:
            factor = splu(
                matrix,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:
            raise StructureFailure(UNHELD) from error
        return factor.solve(weight.ravel()).reshape(-1, 6)

    def _loads(self, force: Array, acting: Array) -> Loads:
        """Turn end forces of beams, (n, 2, 6), and what acts on docks, (d, 6), into loads."""
        standing = self.ends[:, 1] == GROUND
        section = np.where(standing, 1.0, 0.5)[:, None] * self.span
        stress = beam_stress(force[:, 0], self.span, section, self.params.beam_radius)
        ground_force = force[standing, 1, :3]
        surplus = ground_force.sum(axis=0) - [0.0, 0.0, len(self.dock)]
        return Loads(
            sensed=self._sensed(acting),
            contact_stress=stress[~standing],
            ground_stress=stress[standing],
            ground_force=ground_force,
            imbalance=float(np.abs(surplus).max() / len(self.dock)),
        )

    def _sensed(self, acting: Array) -> Array:
        """What each robot feels, from what acts on its docks, shape (N,)."""
        link = self.arm / np.linalg.norm(self.arm, axis=1, keepdims=True)
        axial = np.abs(np.sum(acting[:, :3] * link, axis=1))
        moment = acting[:, 3:]
        bending = moment - np.sum(moment * link, axis=1, keepdims=True) * link
        felt = axial + np.linalg.norm(bending, axis=1)
        mean: Array = felt.reshape(-1, len(self.body)).mean(axis=1)
        return mean


def beam_stress(end: Array, span: Array, section: Array, radius: float) -> Array:
    """Largest von Mises stress in a cross-section of round beams.

    Args:
        end: Force and moment on the first end, shape (n, 6).
        span: First end to second end [R], shape (n, 3).
        section: First end to the section [R], shape (n, 3).
        radius: Of the beams [R].

    Returns:
        Shape (n,): square root of sigma^2 + 3 tau^2 at the rim, with sigma from axial force
        and bending and tau from shear and torsion.
    """
    area = np.pi * radius**2
    modulus = 0.25 * np.pi * radius**3
    axis = span / np.linalg.norm(span, axis=1, keepdims=True)
    force, moment = end[:, :3], end[:, 3:] - np.cross(section, end[:, :3])
    pull, shear = _split(force, axis)
    torque, bend = _split(moment, axis)
    sigma = pull / area + bend / modulus
    tau = 4.0 / 3.0 * shear / area + torque / (2.0 * modulus)
    return np.sqrt(sigma**2 + 3.0 * tau**2)


def _split(vector: Array, axis: Array) -> tuple[Array, Array]:
    """Sizes of the parts along and across an axis."""
    along = np.sum(vector * axis, axis=1)
    across = np.linalg.norm(vector - along[:, None] * axis, axis=1)
    return np.abs(along), across


def _turned(square: Array, turn: Array) -> Array:
    """Turn a stiffness over some nodes with each of n rotations, shape (n, side, side)."""
    thirds = len(square) // 3
    blocks = square.reshape(thirds, 3, thirds, 3)
    turned: Array = np.einsum("nij,ajbk,nlk->naibl", turn, blocks, turn, optimize=True)
    return turned.reshape(len(turn), len(square), len(square))


def _condensed_robot(dock_offset_body: Array, params: MechanicsParams) -> Array:
    """Stiffness of a robot in its body frame as its docks feel it, shape (6 docks, 6 docks)."""
    count = len(dock_offset_body)
    links = stiffness(dock_offset_body, params.link_axial, params.beam_radius, params.poisson)
    whole = np.zeros((6 + 6 * count, 6 + 6 * count))
    for k, link in enumerate(links):
        at = np.r_[0:6, 6 + 6 * k : 12 + 6 * k]
        whole[np.ix_(at, at)] += link
    center, docks = slice(0, 6), slice(6, None)
    passed_on = np.linalg.solve(whole[center, center], whole[center, docks])
    return whole[docks, docks] - whole[docks, center] @ passed_on
