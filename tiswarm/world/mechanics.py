"""Forces in a structure under its own weight: one linear solve after a join.

A robot is a center and three docks joined by beams (its links); docks in contact are joined
by a beam, and a dock on the ground by one to the fixed ground. Weight acts on the docks. The
center, which bears no load, is eliminated beforehand, so a robot adds 18 unknowns: the motion
of its docks. In the rigid model a robot is one body with 6 unknowns; on average it senses as
much in towers and some 15 % more in cantilevers, on the same side of F = 10 in nine of ten.

The load that a robot senses in a link follows from the forces on its dock in either model: those
of the dock's contacts and its weight.

Beams are Euler-Bernoulli beams in three dimensions with small deflections. A node moves by
(u, theta): displacement [R] and rotation [rad]. For a beam of length L along the unit vector e,
with axial stiffness EA, radius r and so EI = EA r^2 / 4 and GJ = EI / (1 + nu), the forces and
moments at its first end are

    F = (EA/L e e' + 12 EI/L^3 P) (u1 - u2) + 6 EI/L^2 S (t1 + t2)
    M = 6 EI/L^2 S' (u1 - u2) + (GJ/L e e' + 4 EI/L P) t1 + (2 EI/L P - GJ/L e e') t2

with P = 1 - e e' and S t = t x e (Przemieniecki, Theory of Matrix Structural Analysis, 1968).
"""

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass as parameters
from scipy.sparse import bsr_matrix, csc_matrix
from scipy.sparse.linalg import splu

from tiswarm.aliases import Ints, Reals
from tiswarm.params import STRICT

Array = Reals

GROUND = -1
"""Second dock of a beam that ends in the ground."""

MAX_UNBORNE = 1e-6
"""Largest share of the weight that ground forces of a standing structure may miss [1]."""

UNHELD = "a part of the structure is held by nothing"

SIDE = 6
"""Unknowns of a node."""

ROW_BITS = 32
COLUMN_MASK = (1 << ROW_BITS) - 1


class StructureFailure(Exception):  # noqa: N818 - the structure fails, not the program
    """A structure, or a part of it, that nothing supports."""


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
    """Loads at rest in a structure of N robots, C contacts and G ground contacts."""

    sensed: Array
    """Mean over a robot's links of |axial force| + |bending moment|, shape (N,)."""

    contact_stress: Array
    """Largest von Mises stress in each contact, shape (C,)."""

    ground_stress: Array
    """Largest von Mises stress in each contact with the ground, shape (G,)."""

    ground_force: Array
    """Force of the ground on each dock that stands on it, shape (G, 3)."""

    imbalance: float
    """Greatest component of the sum of weight and ground forces, per unit of weight [1]."""

    @property
    def peak(self) -> float:
        """Largest stress anywhere."""
        return float(max(self.contact_stress.max(initial=0.0), self.ground_stress.max(initial=0.0)))


class BlockMatrix:
    """A symmetric sparse matrix of 6 x 6 blocks that grows; blocks of one place add up in order."""

    def __init__(self) -> None:
        self.place: Ints = np.empty(0, np.int64)
        self.block: Array = np.empty((0, SIDE, SIDE))
        self.waiting: list[tuple[Ints, Array]] = []

    def add(self, nodes: NDArray[np.intp], square: Array) -> None:
        """Add square matrices that couple nodes.

        Args:
            nodes: Nodes of each, shape (n, m).
            square: The matrices, shape (n, 6 m, 6 m).
        """
        n, m = nodes.shape
        blocks = square.reshape(n, m, SIDE, m, SIDE).swapaxes(2, 3).reshape(-1, SIDE, SIDE)
        row = np.repeat(nodes, m, axis=1).ravel()
        column = np.tile(nodes, (1, m)).ravel()
        place = (row.astype(np.int64) << ROW_BITS) | column  # one sortable number
        self.waiting.append((place, blocks))

    def assemble(self, nodes: int) -> csc_matrix:
        """Build the matrix over nodes 0 to `nodes` - 1."""
        place = np.concatenate([self.place, *(place for place, _ in self.waiting)])
        block = np.concatenate([self.block, *(block for _, block in self.waiting)])
        order = np.argsort(place, kind="stable")
        place, block = place[order], block[order]
        first = np.flatnonzero(np.r_[True, place[1:] != place[:-1]])
        self.place, self.block = place[first], np.add.reduceat(block, first)
        self.waiting = []
        row, column = self.place >> ROW_BITS, self.place & COLUMN_MASK
        start = np.searchsorted(row, np.arange(nodes + 1))
        matrix = bsr_matrix((self.block, column, start), shape=(SIDE * nodes, SIDE * nodes))
        by_row = matrix.tocsr()
        # The matrix is symmetric, so rows of one format are columns of the other.
        return csc_matrix((by_row.data, by_row.indices, by_row.indptr), shape=by_row.shape)


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
            StructureFailure: nothing supports the structure or a part of it.
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
        """Compute the load that each robot senses from the forces on its docks, shape (N,)."""
        link = self.arm / np.linalg.norm(self.arm, axis=1, keepdims=True)
        axial = np.abs(np.sum(acting[:, :3] * link, axis=1))
        moment = acting[:, 3:]
        bending = moment - np.sum(moment * link, axis=1, keepdims=True) * link
        load = axial + np.linalg.norm(bending, axis=1)
        mean: Array = load.reshape(-1, len(self.body)).mean(axis=1)
        return mean


def _cross_matrix(vector: Array) -> Array:
    """Build the matrices of v x, shape (n, 3, 3), for vectors v, shape (n, 3)."""
    matrix = np.zeros((len(vector), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[:, i, j] = -vector[:, k]
        matrix[:, j, i] = vector[:, k]
    return matrix


def stiffness(span: Array, axial: float, radius: float, poisson: float) -> Array:
    """Compute the stiffness of beams, nodes in the order first end, second end.

    Args:
        span: First end to second end [R], shape (n, 3).
        axial: EA [weight of a dock].
        radius: r [R].
        poisson: Poisson's ratio [1].

    Returns:
        Shape (n, 12, 12): end forces and moments from end displacements and rotations.
    """
    length = np.linalg.norm(span, axis=1)[:, None, None]
    e = span[:, :, None] / length
    along = e @ e.swapaxes(1, 2)
    across = np.eye(3) - along
    bending = 0.25 * axial * radius**2
    torsion = bending / (1.0 + poisson)
    couple = -6.0 * bending / length**2 * _cross_matrix(e[:, :, 0])
    push = axial / length * along + 12.0 * bending / length**3 * across
    near = torsion / length * along + 4.0 * bending / length * across
    far = 2.0 * bending / length * across - torsion / length * along
    turned = couple.swapaxes(1, 2)
    matrix = np.empty((len(span), 12, 12))
    rows = (
        (push, couple, -push, couple),
        (turned, near, -turned, far),
        (-push, -couple, push, -couple),
        (turned, far, -turned, near),
    )
    for i, row in enumerate(rows):
        for j, part in enumerate(row):
            matrix[:, 3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = part
    return matrix


def rigid_link(arm: Array) -> Array:
    """Build the matrix from a rigid body's node to a point at `arm`: their motions.

    Args:
        arm: Node to point [R], shape (n, 3).

    Returns:
        Shape (n, 6, 6).
    """
    link = np.tile(np.eye(6), (len(arm), 1, 1))
    link[:, :3, 3:] = -_cross_matrix(arm)
    return link


def beam_stress(end: Array, span: Array, section: Array, radius: float) -> Array:
    """Compute the largest von Mises stress in a cross-section of round beams.

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
    """Condense a robot's stiffness, body frame, to its docks, shape (6 docks, 6 docks)."""
    count = len(dock_offset_body)
    links = stiffness(dock_offset_body, params.link_axial, params.beam_radius, params.poisson)
    whole = np.zeros((6 + 6 * count, 6 + 6 * count))
    for k, link in enumerate(links):
        at = np.r_[0:6, 6 + 6 * k : 12 + 6 * k]
        whole[np.ix_(at, at)] += link
    center, docks = slice(0, 6), slice(6, None)
    passed_on = np.linalg.solve(whole[center, center], whole[center, docks])
    return whole[docks, docks] - whole[docks, center] @ passed_on
