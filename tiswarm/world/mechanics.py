"""Forces in a structure under its own weight: one linear solve after a join.

A robot is a center and n docks joined by beams (its links); docks in contact are joined by a
beam, and a dock on the ground by one to the fixed ground. Weight acts on the docks, so a robot
weighs n. The center, which bears no load, is eliminated beforehand, so a robot adds 6 n unknowns:
the motion of its docks. In the rigid model a robot is one body with 6 unknowns; on average
FireAntV3 senses as much in towers and some 15 % more in cantilevers, on the same side of F = 10 in
nine of ten.

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
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass as parameters
from scipy.sparse import bsr_matrix, csc_matrix
from scipy.sparse.linalg import splu

from tiswarm.aliases import Ints, Reals
from tiswarm.params import STRICT

_GROUND = -1
"""Second dock of a beam that ends in the ground."""
_MAX_UNBORNE = 1e-6
"""Largest share of the weight that ground forces of a standing structure may miss [1]."""
_UNHELD = "a part of the structure is held by nothing"
_SIDE = 6
"""Unknowns of a node."""
_ROW_BITS = 32


class StructureFailure(Exception):  # noqa: N818 - the structure fails, not the program
    """A structure, or a part of it, that nothing supports."""


@parameters(frozen=True, kw_only=True, config=STRICT)
class MechanicsParams:
    """Stiffness of robots and contacts, in units of the weight of a dock and R."""

    model: Literal["flexible", "rigid"] = "flexible"
    """Whether robots bend (6 unknowns a dock) or only contacts do (6 unknowns each)."""

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

    sensed: Reals
    """Mean over a robot's links of |axial force| + |bending moment|, shape (N,)."""

    contact_stress: Reals
    """Largest von Mises stress in each contact, shape (C,)."""

    ground_stress: Reals
    """Largest von Mises stress in each contact with the ground, shape (G,)."""

    ground_force: Reals
    """Force of the ground on each dock that stands on it, shape (G, 3)."""

    imbalance: float
    """Greatest component of the sum of weight and ground forces, per unit of weight [1]."""

    @property
    def peak(self) -> float:
        """Largest stress anywhere."""
        return float(max(self.contact_stress.max(initial=0.0), self.ground_stress.max(initial=0.0)))


class _BlockMatrix:
    """A symmetric sparse matrix of 6 x 6 blocks that grows; blocks of one place add up in order."""

    def __init__(self) -> None:
        self.place: Ints = np.empty(0, np.int64)
        self.block: Reals = np.empty((0, _SIDE, _SIDE))
        self.waiting: list[tuple[Ints, Reals]] = []

    def add(self, nodes: NDArray[np.intp], square: Reals) -> None:
        """Add square matrices that couple nodes.

        Args:
            nodes: Nodes of each, shape (n, m).
            square: The matrices, shape (n, 6 m, 6 m).
        """
        n, m = nodes.shape
        blocks = square.reshape(n, m, _SIDE, m, _SIDE).swapaxes(2, 3).reshape(-1, _SIDE, _SIDE)
        row = np.repeat(nodes, m, axis=1).ravel()
        column = np.tile(nodes, (1, m)).ravel()
        place = (row.astype(np.int64) << _ROW_BITS) | column  # one sortable number
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
        row, column = self.place >> _ROW_BITS, self.place & ((1 << _ROW_BITS) - 1)
        start = np.searchsorted(row, np.arange(nodes + 1))
        matrix = bsr_matrix((self.block, column, start), shape=(_SIDE * nodes, _SIDE * nodes))
        by_row = matrix.tocsr()
        # The matrix is symmetric, so rows of one format are columns of the other.
        return csc_matrix((by_row.data, by_row.indices, by_row.indptr), shape=by_row.shape)


class Frame:
    """The beams of one structure; grows by a robot at a time."""

    def __init__(self, params: MechanicsParams, dock_offset_body: Reals) -> None:
        self.params = params
        self.body = dock_offset_body
        self.robot = _condensed_robot(dock_offset_body, params)
        self.rigid = params.model == "rigid"
        self.dock: Reals = np.empty((0, 3))
        self.arm: Reals = np.empty((0, 3))
        self.ends: NDArray[np.intp] = np.empty((0, 2), np.intp)
        self.span: Reals = np.empty((0, 3))
        self.beams: list[Reals] = []
        self.blocks = _BlockMatrix()
        self.waiting: list[tuple[Reals, Reals, NDArray[np.int32], Reals]] = []

    def join(self, center: Reals, turn: Reals, contacts: NDArray[np.int32], footing: Reals) -> None:
        """Add a robot.

        Args:
            center: Its center [R], shape (3,).
            turn: Its orientation, body to world, shape (3, 3).
            contacts: Docks in contact, rows of (earlier dock, own dock), dock k of robot i
                being n i + k, shape (c, 2).
            footing: Docks on the ground, rows of (own dock, x, y, z): where it touches [R],
                shape (g, 4).
        """
        self.waiting.append((center, turn, contacts, footing))

    @property
    def joints(self) -> NDArray[np.intp]:
        """Docks that touch, rows of (dock, dock), shape (C, 2)."""
        self._admit()
        inner: NDArray[np.intp] = self.ends[self.ends[:, 1] != _GROUND]
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
        foot = np.column_stack([feet[:, 0], np.full(len(feet), _GROUND)])
        ends = np.concatenate([joints, foot]).astype(np.intp)
        target = np.concatenate([self.dock[joints[:, 1]], feet[:, 1:]])
        span, params = target - self.dock[ends[:, 0]], self.params
        beams = stiffness(span, params.contact_axial, params.beam_radius, params.poisson)
        self.ends = np.concatenate([self.ends, ends])
        self.span = np.concatenate([self.span, span])
        self.beams.append(beams)
        if self.rigid:
            follow = self._follow(ends)
            beams = follow.swapaxes(1, 2) @ beams @ follow
        standing = ends[:, 1] == _GROUND
        nodes = self._node(ends)
        self.blocks.add(nodes[~standing], beams[~standing])
        self.blocks.add(nodes[standing, :1], beams[standing, :6, :6])

    def _node(self, dock: NDArray[np.intp]) -> NDArray[np.intp]:
        """Node that a dock moves with."""
        return dock // len(self.body) if self.rigid else dock

    def _follow(self, ends: NDArray[np.intp]) -> Reals:
        """Motion of beam ends from that of the rigid robots they are on, shape (n, 12, 12)."""
        follow = np.zeros((len(ends), 12, 12))
        follow[:, :6, :6] = _rigid_link(self.arm[ends[:, 0]])
        follow[:, 6:, 6:] = _rigid_link(self.arm[ends[:, 1]])
        return follow

    def solve(self) -> Loads:
        """Find the forces at rest under the robots' own weight.

        Raises:
            StructureFailure: nothing supports the structure or a part of it.
        """
        self._admit()
        weight = np.zeros((len(self.dock), 6))
        weight[:, 2] = -1.0
        both: Reals = self._motion(weight)[self._node(self.ends)].reshape(-1, 12, 1)
        standing = self.ends[:, 1] == _GROUND
        if self.rigid:
            both = self._follow(self.ends) @ both
        both[standing, 6:] = 0.0
        self.beams = [np.concatenate(self.beams)]
        force = (self.beams[0] @ both).reshape(-1, 2, 6)
        acting = weight.copy()
        np.add.at(acting, self.ends[:, 0], -force[:, 0])
        np.add.at(acting, self.ends[~standing, 1], -force[~standing, 1])
        section = np.where(standing, 1.0, 0.5)[:, None] * self.span
        stress = _beam_stress(force[:, 0], self.span, section, self.params.beam_radius)
        ground_force = force[standing, 1, :3]
        surplus = ground_force.sum(axis=0) - [0.0, 0.0, len(self.dock)]
        imbalance = float(np.abs(surplus).max() / len(self.dock))
        # Rounding hides that a matrix is singular, but not that nothing bears the weight.
        if not imbalance <= _MAX_UNBORNE:
            raise StructureFailure(_UNHELD)
        return Loads(
            sensed=self._sensed(acting),
            contact_stress=stress[~standing],
            ground_stress=stress[standing],
            ground_force=ground_force,
            imbalance=imbalance,
        )

    def _motion(self, weight: Reals) -> Reals:
        """Solve for the displacement and rotation of every node, shape (nodes, 6)."""
        if self.rigid:
            pushed = _rigid_link(self.arm).swapaxes(1, 2) @ weight[:, :, None]
            weight = pushed.reshape(-1, len(self.body), 6).sum(axis=1)
        if not (self.ends[:, 1] == _GROUND).any():
            raise StructureFailure(_UNHELD)
        matrix, options = self.blocks.assemble(len(weight)), {"SymmetricMode": True}
        try:
            factor = splu(matrix, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        except RuntimeError as error:
            if "singular" not in str(error):  # it ran out of memory
                raise
            raise StructureFailure(_UNHELD) from error
        return factor.solve(weight.ravel()).reshape(-1, 6)

    def _sensed(self, acting: Reals) -> Reals:
        """Compute the load that each robot senses from the forces on its docks, shape (N,)."""
        link = self.arm / np.linalg.norm(self.arm, axis=1, keepdims=True)
        axial = np.abs(np.sum(acting[:, :3] * link, axis=1))
        moment = acting[:, 3:]
        bending = moment - np.sum(moment * link, axis=1, keepdims=True) * link
        load = axial + np.linalg.norm(bending, axis=1)
        mean: Reals = load.reshape(-1, len(self.body)).mean(axis=1)
        return mean


def _cross_matrix(vector: Reals) -> Reals:
    """Build the matrices of v x, shape (n, 3, 3), for vectors v, shape (n, 3)."""
    matrix = np.zeros((len(vector), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[:, i, j] = -vector[:, k]
        matrix[:, j, i] = vector[:, k]
    return matrix


def stiffness(span: Reals, axial: float, radius: float, poisson: float) -> Reals:
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


def _rigid_link(arm: Reals) -> Reals:
    """Build the matrix from the motion of a rigid body's node to that of a point, (n, 6, 6).

    `arm` is from the node to the point [R], shape (n, 3).
    """
    link = np.tile(np.eye(6), (len(arm), 1, 1))
    link[:, :3, 3:] = -_cross_matrix(arm)
    return link


def _beam_stress(end: Reals, span: Reals, section: Reals, radius: float) -> Reals:
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
    (pull, shear), (torque, bend) = _split(force, axis), _split(moment, axis)
    sigma = pull / area + bend / modulus
    tau = 4.0 / 3.0 * shear / area + torque / (2.0 * modulus)
    return np.sqrt(sigma**2 + 3.0 * tau**2)


def _split(vector: Reals, axis: Reals) -> tuple[Reals, Reals]:
    """Sizes of the parts along and across an axis."""
    along = np.sum(vector * axis, axis=1)
    across = np.linalg.norm(vector - along[:, None] * axis, axis=1)
    return np.abs(along), across


def _turned(square: Reals, turn: Reals) -> Reals:
    """Turn a stiffness over some nodes with each of n rotations, shape (n, side, side)."""
    thirds = len(square) // 3
    blocks = square.reshape(thirds, 3, thirds, 3)
    turned: Reals = np.einsum("nij,ajbk,nlk->naibl", turn, blocks, turn, optimize=True)
    return turned.reshape(len(turn), len(square), len(square))


def _condensed_robot(dock_offset_body: Reals, params: MechanicsParams) -> Reals:
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
