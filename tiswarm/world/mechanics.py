"""Forces in a structure under its weight and a payload: one linear solve after a join.

A robot is a center and n docks joined by beams (its links); docks in contact are joined by a
beam, and a dock on the ground by one to the fixed ground. Weight acts on the docks, so a robot
weighs n. A robot adds 6 (n + 1) unknowns: the motion of its center and of its docks. In the rigid
model a robot is one body with 6 unknowns; on average FireAntV3 senses as much in towers and some
15 % more in cantilevers, on the same side of F = 10 in nine of ten.

Where the ground holds docks, feet are clamped. Where docks rest on it, a foot is a beam that turns
freely where it touches the ground, and `rest.py` finds which of them open and slide.

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

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Strict, ValidationError, ValidatorFunctionWrapHandler, WrapValidator
from pydantic.dataclasses import dataclass as parameters
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.base.params import STRICT, UNLESS_SET
from tiswarm.compute import backend
from tiswarm.compute.numerics import aligned_zeros, native_vectors, optimized_by_llvm
from tiswarm.records.messages import shown
from tiswarm.world import dissection, frame_kernels, rest
from tiswarm.world.block_kernels import ROW_WIDTH
from tiswarm.world.panels import PanelSolver

GRAVITY = 9.80665
"""Standard acceleration of gravity [m/s^2]."""

MAX_UNBORNE = 1e-6
"""Largest share of the weight that ground forces of a standing structure may miss [1]."""
_SIDE = 6
"""Unknowns of a node."""


_LEAF = 3
"""Most neighbors of a node that is eliminated before the core of a structure."""

_DOWN = (0.0, 0.0, -1.0)
"""Direction of gravity on level ground."""

_SHORTEST = 1e-6
"""Least length of a vector that has a direction."""


class StructureFailure(Exception):  # noqa: N818 - the structure fails, not the program
    """A structure, or a part of it, that nothing supports."""


def _one_mistake(expected: str) -> WrapValidator:
    """Make one mistake of those that a value has part by part: it should be what is expected."""

    def checked(value: object, check: ValidatorFunctionWrapHandler) -> object:
        try:
            return check(value)
        except ValidationError as invalid:
            raise ValueError(f"{shown(value)} should be {expected}") from invalid

    return WrapValidator(checked)


# A wrapped value passes through Python, where strict checks accept no list for a tuple.
_Coordinate = Annotated[float, Strict(), Field(ge=-1e4, le=1e4)]
_Place = Annotated[tuple[_Coordinate, _Coordinate, _Coordinate], Strict(strict=False)]
_Component = Annotated[float, Strict(), Field(ge=-1e6, le=1e6)]
_Direction = Annotated[
    tuple[_Component, _Component, _Component],
    Strict(strict=False),
    _one_mistake("a vector [x, y, z] of numbers within 1e6"),
]


@parameters(frozen=True, kw_only=True, config=STRICT)
class PayloadParams:
    """A weight that one robot of the structure carries at its center."""

    weight: Annotated[float, Field(gt=0.0, le=1e6)]
    """Its weight in weights of a robot; with `robot_mass_kg` its mass in kg."""

    at: Annotated[
        Literal["top"] | _Place, _one_mistake("top, or a place [x, y, z] within 1e4 R")
    ] = "top"
    """Who carries it at each solve: the highest robot (top), or the one whose center is nearest to
    a place [x, y, z] [R]."""

    robot_mass_kg: Annotated[float | None, UNLESS_SET, Field(gt=0.0)] = None
    """Mass of a robot [kg]; with it, `weight` is in kg."""

    def weight_for(self, docks: int) -> float:
        """Return its weight [weight of a dock], for robots of so many docks."""
        return self.weight / (self.robot_mass_kg or 1.0) * docks

    def carrier(self, center: Reals, able: AnyInts) -> int:
        """Choose the robot that carries it, the first of several.

        Args:
            center: Centers of the robots [R], shape (N, 3).
            able: Robots that stand, ascending, shape (n,).
        """
        if self.at == "top":
            return int(able[np.argmax(center[able, 2])])
        return int(able[np.argmin(np.linalg.norm(center[able] - np.array(self.at), axis=1))])


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

    # Runs without these keys keep their hashes, which name folders.
    gravity: Annotated[_Direction, Field(exclude_if=lambda value: value == _DOWN)] = _DOWN
    """Direction of gravity [x, y, z], of any length but 0; not vertical for a slope or a push from
    the side. Robots climb and spawn as before."""

    ground: Annotated[
        Literal["holds", "rests"], Field(exclude_if=lambda value: value == "holds")
    ] = "holds"
    """Whether the ground holds docks in all directions (holds), or docks rest on it: it presses and
    rubs, and neither pulls nor turns them (rests). Growth then ends where the structure tips or
    slides."""

    friction: Annotated[float | None, UNLESS_SET, Field(ge=0.0, le=10.0)] = None
    """Coefficient of friction of docks on the ground [1]; goes with `ground: rests`."""

    payload: Annotated[PayloadParams | None, UNLESS_SET] = None
    """A weight that one robot carries; null for none."""

    order: Annotated[
        Literal["minimum-degree", "nested-dissection"],
        Field(exclude_if=lambda value: value == "minimum-degree"),
    ] = "minimum-degree"
    """Order in which nodes of a structure are eliminated when forces are computed: always one with
    the fewest neighbors (minimum-degree), or by METIS (nested-dissection), which takes less time
    from some 30,000 robots on and needs `pip install tiswarm[large]`. Forces are the same but for
    rounding. Goes with `ground: holds`."""

    def __post_init__(self) -> None:
        """Refuse gravity without a direction, and friction that is missing or says nothing.

        Raises:
            ValueError: it is so.
        """
        if math.hypot(*self.gravity) < _SHORTEST:
            raise ValueError("gravity has no direction; give a vector like [0, 0, -1]")
        if self.ground == "rests" and self.friction is None:
            raise ValueError("docks that rest need a coefficient; add friction, such as 0.5")
        if self.ground == "rests" and self.is_dissected:
            raise ValueError("docks that rest are solved by minimum-degree; leave order out")
        if self.ground == "holds" and self.friction is not None:
            raise ValueError("friction goes with ground: rests; set both, or neither")

    @property
    def is_dissected(self) -> bool:
        """Whether METIS orders nodes."""
        return self.order == "nested-dissection"

    def require_libraries(self) -> None:
        """Raise an error unless the libraries that solve structures are installed.

        Raises:
            EnvironmentTroubleError: METIS should order nodes, and is not installed.
        """
        if self.is_dissected:
            dissection.import_metis()

    @property
    def down(self) -> Reals:
        """Unit vector of gravity, the weight of a dock, shape (3,)."""
        return np.array(self.gravity) / math.hypot(*self.gravity)


class ContactLoads(NamedTuple):
    """Loads in the section of C contacts, of docks with docks and with the ground, at rest.

    The section is halfway between two docks, or where a dock stands on the ground.
    """

    axial: Reals
    """Pull along each contact, negative where it is pressed [weight of a dock], shape (C,)."""

    shear: Reals
    """Force across each contact [weight of a dock], shape (C,)."""

    bending: Reals
    """Moment that bends each contact [weight of a dock times R], shape (C,)."""

    torsion: Reals
    """Moment about the axis of each contact [weight of a dock times R], shape (C,)."""

    stress: Reals
    """Largest von Mises stress in the section [weight of a dock / R^2], shape (C,)."""


@dataclass(frozen=True, kw_only=True)
class Loads:
    """Loads at rest in a structure of N robots, C contacts and G ground contacts."""

    sensed: Reals
    """Mean over a robot's links of |axial force| + |bending moment|; NaN of one that was removed,
    shape (N,)."""

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


@dataclass(frozen=True)
class LoadSummary:
    """Loads in a structure under its weight; NaN where it was not solved after that join."""

    peak: float = math.nan
    """Largest stress in any contact [weight of a dock / R^2]."""

    sensed_max: float = math.nan
    """Largest load that any robot senses [weight of a dock]."""

    calling: int = 0
    """Robots that call for help."""

    least_support: float = math.nan
    """Least force of the ground on a dock against gravity; negative where the ground pulls."""

    imbalance: float = math.nan
    """Difference of weight and ground forces, per weight [1]."""


class Frames:
    """The beams of structures that grow side by side."""

    def __init__(
        self, params: MechanicsParams, *, docks: int, robots: int, structures: int = 1
    ) -> None:
        """Reserve memory for so many structures of so many robots of so many docks."""
        self.params = params
        self.rigid = params.model == "rigid"
        self.shape = (params.beam_radius, params.poisson)
        self.rests = params.ground == "rests"
        params.require_libraries()  # before anything grows
        self.panels = PanelSolver()
        self.down = params.down
        self.robots = np.zeros(structures, np.int32)
        self.stability: list[rest.Stability | Literal[""]] = [""] * structures
        self.carrier = np.full(structures, -1)  # robot with the payload
        self.center = np.zeros((structures, robots, 3))
        self.gone = np.zeros((structures, robots), np.bool_)
        self.dock = np.zeros((structures, robots, docks, 3))
        self.waiting: list[tuple[Any, ...]] = []  # those that `join` has added since the last solve
        if self.rigid:
            nodes = robots
            beams = 3 * robots
        else:
            nodes = (docks + 1) * robots
            beams = (docks + 3) * robots
        self.frame = frame_kernels.FrameArrays(
            node_count=np.zeros(structures, np.int32),
            beam_count=np.zeros(structures, np.int32),
            ends=np.empty((structures, beams, frame_kernels.BeamEnds.TOTAL), np.int32),
            stiffness=np.empty((structures, 4 * beams, _SIDE, _SIDE)),
            span=np.empty((structures, beams, 3)),
            arm=np.zeros((structures, docks * robots, 3)),  # read, and not used, for the ground
            weight=aligned_zeros(structures, nodes, ROW_WIDTH),
            slip=np.zeros((structures, docks * robots, 3)),
        )
        self.work = frame_kernels.EliminationArrays(
            node=np.zeros((structures, nodes, frame_kernels.Node.TOTAL), np.int32),
            order=np.empty((structures, nodes + 1, frame_kernels.NodeList.TOTAL), np.int32),
            half=np.empty((structures, 10 * nodes, frame_kernels.HalfEdge.TOTAL), np.int32),
            block_count=np.zeros(structures, np.int32),
            block=aligned_zeros(structures, 5 * nodes, _SIDE, ROW_WIDTH),
            panel=aligned_zeros(structures, _SIDE * nodes, ROW_WIDTH),
            motion=aligned_zeros(structures, nodes, ROW_WIDTH),
        )
        self.load_arrays = frame_kernels.LoadArrays(
            acting=aligned_zeros(structures, docks * robots, ROW_WIDTH),
            support=np.empty((structures, beams, 3)),
            stress=np.empty((structures, beams)),
            section=np.empty((structures, beams, frame_kernels.ContactSection.TOTAL)),
            sensed=np.empty((structures, robots)),
        )

    def join(
        self,
        structure: int,
        center: Reals,
        docks: Reals,
        contacts: AnyInts,
        standing: AnyInts,
        foot: Reals,
    ) -> None:
        """Add a robot to a structure, in which dock k of robot i has the number n i + k.

        Args:
            structure: Number of the structure.
            center: Its center [R], shape (3,).
            docks: Its docks [R], shape (n, 3).
            contacts: Docks in contact, rows of (earlier dock, own dock), shape (c, 2).
            standing: Own docks that stand on the ground, shape (g,).
            foot: Where each of them touches it [R], shape (g, 3).
        """
        self.waiting.append((structure, center, docks, contacts, standing, foot))

    def remove(self, structure: int, robots: AnyInts) -> None:
        """Take robots that have joined out of a structure, with all their beams."""
        self._admit()
        self.gone[structure, robots] = True
        gone = self.gone[structure]
        frame = self.frame
        beams = frame.beam_count[structure]
        nodes = frame.weight.shape[1] // len(gone)
        robot_a, robot_b = frame.ends[structure, :beams, : frame_kernels.BeamEnds.DOCK_A].T // nodes
        self._keep(structure, ~(gone[robot_a] | (gone[robot_b] & (robot_b >= 0))))
        # Nothing joins their nodes now: what is found for these means nothing.
        frame.weight[structure].reshape(len(gone), -1)[gone] = 0.0

    def part(self, structure: int, ends: AnyInts) -> None:
        """Take a contact out of a structure, a row of `contact_loads`, shape (2,)."""
        self._admit()
        beams = self.frame.beam_count[structure]
        docks = self.frame.ends[structure, :beams, frame_kernels.BeamEnds.DOCK_A :]
        self._keep(structure, (docks != ends).any(axis=1))

    def _keep(self, structure: int, stays: Bools) -> None:
        """Keep some beams of a structure, in their order; `stays` has the shape (beams,)."""
        frame = self.frame
        beams = len(stays)
        remaining = np.count_nonzero(stays)
        frame.beam_count[structure] = remaining
        for table, rows_a_beam in ((frame.ends, 1), (frame.stiffness, 4), (frame.span, 1)):
            rows = table[structure, : rows_a_beam * beams][np.repeat(stays, rows_a_beam)]
            table[structure, : rows_a_beam * remaining] = rows

    def joints(self, structures: AnyInts) -> AnyInts:
        """List docks that touch in some structures, rows of (dock, dock), shape (C, 2).

        Docks of the structures are numbered in that order, one structure after the other.
        """
        self._admit()
        joints = [np.empty((0, 2), np.int64)]
        for place, structure in enumerate(structures.tolist()):
            beams = self.frame.beam_count[structure]
            docks = self.frame.ends[structure, :beams, frame_kernels.BeamEnds.DOCK_A :]
            touching = docks[docks[:, 1] >= 0].astype(np.int64)
            joints.append(touching + self.frame.arm.shape[1] * place)
        return np.concatenate(joints)

    def clear(self, structures: AnyInts) -> None:
        """Take all robots out of structures, shape (n,), as if none had joined."""
        self._admit()
        self.robots[structures] = 0
        self.gone[structures] = False
        self.frame.node_count[structures] = 0
        self.frame.beam_count[structures] = 0
        self.frame.weight[structures] = 0.0
        self.carrier[structures] = -1
        for structure in structures.tolist():
            self.stability[structure] = ""

    def _admit(self) -> None:
        """Build the beams of all robots that joined since the last solve."""
        if not self.waiting:
            return
        structure, center, docks, contacts, standing, foot = zip(*self.waiting, strict=True)
        self.waiting = []
        of = np.array(structure)
        robot = np.empty_like(of)
        for n, s in enumerate(structure):
            robot[n] = self.robots[s]
            self.robots[s] += 1
        self.dock[of, robot] = docks
        self.center[of, robot] = center
        arm = self.dock[of, robot] - np.array(center)[:, None]
        self.frame.arm.reshape(self.dock.shape)[of, robot] = arm
        if self.rigid:
            self._add_bodies(of, robot, arm)
        else:
            self._add_links(of, robot, arm)
        touching = np.repeat(of, [*map(len, contacts)])
        placed = np.repeat(of, [*map(len, foot)])
        joints = np.concatenate(contacts)
        feet = np.concatenate(standing)
        dock = self.dock.reshape(len(self.dock), -1, 3)
        self._add_contacts(
            np.r_[touching, placed],
            np.r_[joints[:, 0], feet],
            np.r_[joints[:, 1], np.full(len(feet), frame_kernels.GROUND)],
            np.concatenate([dock[touching, joints[:, 1]], np.concatenate(foot)]),
        )

    def _add_bodies(self, of: AnyInts, robot: AnyInts, arm: Reals) -> None:
        """Add rigid robots: a node each."""
        self.frame.node_count[:] = self.robots
        self.frame.weight[of, robot, :3] = arm.shape[1] * self.down
        # Docks weigh, not the center: their weights turn the body about it.
        self.frame.weight[of, robot, 3:_SIDE] = np.cross(arm.sum(axis=1), self.down)

    def _add_links(self, of: AnyInts, robot: AnyInts, arm: Reals) -> None:
        """Add robots that bend: a node for the center, one for each dock, and the links between."""
        docks = arm.shape[1]
        self.frame.node_count[:] = (docks + 1) * self.robots
        of = np.repeat(of, docks)
        center = np.repeat((docks + 1) * robot, docks)
        dock = center + np.tile(np.arange(1, docks + 1), len(robot))
        self.frame.weight[of, dock, :3] = self.down
        unused = np.full(len(of), frame_kernels.NO_DOCK)
        ends = np.column_stack([center, dock, unused, unused])
        span = arm.reshape(-1, 3)
        self._add_beams(of, ends, span, stiffness(span, self.params.link_axial, *self.shape))

    def _add_contacts(self, of: AnyInts, a: AnyInts, b: AnyInts, target: Reals) -> None:
        """Add a beam from each dock `a` to the dock `b`, or the ground, at `target` [R]."""
        span = target - self.dock.reshape(len(self.dock), -1, 3)[of, a]
        stiff = stiffness(span, self.params.contact_axial, *self.shape)
        if self.rests:
            stiff[b < 0] = _free_to_turn(stiff[b < 0])
        if self.rigid:
            # Ends of the contact move with the bodies' nodes: K becomes T^T K T.
            follow = np.tile(np.eye(12), (len(of), 1, 1))
            follow[:, :3, 3:6] = -_cross_matrix(self.frame.arm[of, a])
            follow[:, 6:9, 9:] = -_cross_matrix(self.frame.arm[of, b])
            stiff = follow.swapaxes(1, 2) @ stiff @ follow
        node_b = np.where(b < 0, frame_kernels.GROUND, self._node(b))
        ends = np.column_stack([self._node(a), node_b, a, b])
        self._add_beams(of, ends, span, stiff)

    def _node(self, dock: AnyInts) -> AnyInts:
        """Node that a dock moves with."""
        robot = dock // self.dock.shape[2]
        return robot if self.rigid else dock + robot + 1

    def _add_beams(self, of: AnyInts, ends: AnyInts, span: Reals, stiff: Reals) -> None:
        """Add beams to the structures given, shape (n,)."""
        order = np.argsort(of, kind="stable")
        of = of[order]
        count = self.frame.beam_count
        # Several beams may go to one structure: each gets the next place behind those before it.
        place = count[of] + np.arange(len(of)) - np.searchsorted(of, of)
        while place.max(initial=-1) >= self.frame.ends.shape[1]:
            self.frame = _doubled(self.frame, "ends", "stiffness", "span")
            self.load_arrays = _doubled(self.load_arrays, "support", "stress", "section")
        frame = self.frame
        frame.ends[of, place] = ends[order]
        frame.span[of, place] = span[order]
        parts = stiff[order].reshape(-1, 2, _SIDE, 2, _SIDE).swapaxes(2, 3)
        row = 4 * place[:, None] + np.arange(4)
        frame.stiffness[of[:, None], row] = parts.reshape(-1, 4, _SIDE, _SIDE)
        np.add.at(count, of, 1)

    @backend.exclusive()
    def solve(self, structures: Sequence[int]) -> None:
        """Find the forces at rest in some structures under their weight and payloads."""
        self._admit()
        backend.processor()
        due = np.array(structures, np.int32)
        if self.params.payload is not None:
            for number in due.tolist():
                self._put_payload(number, self.params.payload)
        self.frame.slip[due] = 0.0
        self._find_loads(due)
        if self.rests:
            self._let_slip(due)

    def _find_loads(self, due: NDArray[np.int32]) -> None:
        """Solve some structures with the slips of their feet."""
        if self.params.is_dissected:
            self._solve_by_panels(due)

        def find_loads(due: NDArray[np.int32]) -> None:
            frame_kernels.find_loads(
                self.params.beam_radius,
                *self.down.tolist(),
                self.robots,
                due,
                self.params.is_dissected,
                *self.frame,
                *self.work,
                *self.load_arrays,
            )

        self._with_room(due, find_loads)

    def _with_room(
        self, due: NDArray[np.int32], eliminate: Callable[[NDArray[np.int32]], None]
    ) -> None:
        """Eliminate nodes of some structures; again, with more room, where fill-in needs it."""
        while len(due):
            with optimized_by_llvm(), native_vectors():
                eliminate(due)
            # The kernel counted the blocks that fill-in needs: what had too little room is due.
            due = due[self.work.block_count[due] > self.work.block.shape[1]]
            if len(due):
                self.work = _doubled(self.work, "half", "block")

    def _solve_by_panels(self, due: NDArray[np.int32]) -> None:
        """Find how the nodes of some structures move, in an order by METIS."""
        frame = self.frame

        def strip(due: NDArray[np.int32]) -> None:
            frame_kernels.strip_to_core(
                _LEAF, due, frame.node_count, frame.beam_count, frame.ends, *self.work
            )

        self._with_room(due, strip)
        for structure in due.tolist():
            nodes = int(frame.node_count[structure])
            beams = int(frame.beam_count[structure])
            self.work.motion[structure, :nodes] = self.panels.solve(
                self._dissected(structure, nodes),
                frame.ends[structure, :beams],
                frame.stiffness[structure, : 4 * beams],
                frame.weight[structure, :nodes],
            )

    def _dissected(self, structure: int, nodes: int) -> NDArray[np.int32]:
        """Order nodes for elimination: leaves by minimum degree, then the core by METIS.

        Structures are nearly trees: without leaves a third of the nodes is left to METIS, and the
        order fills in less than either way alone. `strip_to_core` has listed the leaves.
        """
        degree = self.work.node[structure, :nodes, frame_kernels.Node.DEGREE]
        is_left = degree != frame_kernels.ELIMINATED
        edges = slice(2 * nodes, 2 * self.work.block_count[structure])
        pairs = self.work.half[structure, edges, frame_kernels.HalfEdge.TARGET].reshape(-1, 2)
        core = np.flatnonzero(is_left)
        order: NDArray[np.int32]
        order = self.work.order[structure, :nodes, frame_kernels.NodeList.PIVOT].copy()
        order[nodes - len(core) :] = dissection.dissected(core, pairs[is_left[pairs].all(axis=1)])
        return order

    def _put_payload(self, structure: int, payload: PayloadParams) -> None:
        """Put the payload of a structure on the robot that carries it now."""
        able = np.flatnonzero(~self.gone[structure, : self.robots[structure]])
        robots, docks = self.gone.shape[1], self.dock.shape[2]
        # The center is the first node of a robot; in the rigid model its docks weigh on it, too.
        center = self.frame.weight[structure].reshape(robots, -1, ROW_WIDTH)[:, 0, :3]
        before = self.carrier[structure]
        weight_of_one = docks * self.down if self.rigid else np.zeros(3)
        if before >= 0:
            center[before] = 0.0 if self.gone[structure, before] else weight_of_one
        self.carrier[structure] = -1
        if len(able):
            carrier = payload.carrier(self.center[structure], able)
            center[carrier] = weight_of_one + payload.weight_for(docks) * self.down
            self.carrier[structure] = carrier

    def _weight(self, structure: int) -> float:
        """Sum the weight of a structure and its payload [weight of a dock]."""
        present = ~self.gone[structure, : self.robots[structure]]
        docks = self.dock.shape[2]
        weight = float(np.count_nonzero(present) * docks)
        if self.params.payload is not None and self.carrier[structure] >= 0:
            weight += self.params.payload.weight_for(docks)
        return weight

    def _let_slip(self, due: NDArray[np.int32]) -> None:
        """Let feet of some structures, solved as if the ground held them, open and slide."""
        friction = self.params.friction or 0.0
        feet = {}
        for number in due.tolist():
            beams = self._feet(number)
            held = self.load_arrays.support[number, beams]
            normal = self._normal(number, beams)
            excess, _ = rest.sliding(held, normal, friction)
            press = (held * normal).sum(axis=1)
            slack = rest.TOLERANCE * self._weight(number)
            if not self._is_spread(number, beams):
                self._fall(number, "tipped")
            elif press.min() >= -slack and excess.max() <= slack:
                self.stability[number] = "stands"
            else:
                feet[number] = beams
        if not feet:
            return
        for (number, beams), stiff in zip(feet.items(), self._foot_stiffness(feet), strict=True):
            held = self.load_arrays.support[number, beams]
            normal = self._normal(number, beams)
            resting = rest.find_slips(stiff, held, normal, friction, self._weight(number))
            dock = self.frame.ends[number, beams, frame_kernels.BeamEnds.DOCK_A]
            self.frame.slip[number, dock] = resting.slip
            self.stability[number] = resting.stability
        standing = [number for number in feet if self.stability[number] == "stands"]
        self._find_loads(np.array(standing, np.int32))
        for number in feet.keys() - standing:
            self._fall(number, self.stability[number])

    def _feet(self, structure: int) -> Ints:
        """List the beams of a structure to the ground, shape (G,)."""
        beams = self.frame.beam_count[structure]
        dock_b = self.frame.ends[structure, :beams, frame_kernels.BeamEnds.DOCK_B]
        return np.flatnonzero(dock_b == frame_kernels.GROUND)

    def _normal(self, structure: int, beams: Ints) -> Reals:
        """Find the unit vectors out of the ground at feet, shape (G, 3).

        A foot is the place on the ground that is nearest to its dock.
        """
        span = self.frame.span[structure, beams]
        normal: Reals = -span / np.linalg.norm(span, axis=1, keepdims=True)
        return normal

    def _is_spread(self, structure: int, beams: Ints) -> bool:
        """Whether the feet of each part that contacts join are not all on one line."""
        robots = int(self.robots[structure])
        docks = self.dock.shape[2]
        ends = self.frame.ends[structure, :, frame_kernels.BeamEnds.DOCK_A :]
        joined = ends[: self.frame.beam_count[structure]]
        part = parts(joined[(joined >= 0).all(axis=1)] // docks, robots)
        dock = ends[beams, 0]
        foot = self.dock[structure].reshape(-1, 3)[dock] + self.frame.span[structure, beams]
        present = np.unique(part[~self.gone[structure, :robots]]).tolist()
        return all(rest.are_spread(foot[part[dock // docks] == number]) for number in present)

    def _foot_stiffness(self, feet: Mapping[int, Ints]) -> Iterator[Reals]:
        """Yield the forces on the feet of each structure from slips of the ground under them."""
        count = np.array([*map(len, feet.values())], np.int32)
        beam = np.zeros((len(count), count.max()), np.int32)
        for row, beams in zip(beam, feet.values(), strict=True):
            row[: len(beams)] = beams
        response = np.zeros((len(count), 3 * beam.shape[1], 3 * beam.shape[1]))
        with optimized_by_llvm(), native_vectors():
            frame_kernels.find_foot_stiffness(
                np.array([*feet], np.int32), count, beam, *self.frame, *self.work, response
            )
        for unknowns, of_structure in zip((3 * count).tolist(), response, strict=True):
            yield of_structure[:unknowns, :unknowns]

    def _fall(self, structure: int, stability: rest.Stability | Literal[""]) -> None:
        """Note that a structure falls: it has no loads at rest."""
        self.stability[structure] = stability
        for loads in self.load_arrays:
            loads[structure] = np.nan

    def has_fallen(self, structure: int) -> bool:
        """Whether a structure on docks that rest tipped or slid when it was solved last."""
        return self.stability[structure] in {"tipped", "slid"}

    def contact_loads(self, structure: int) -> tuple[AnyInts, ContactLoads]:
        """Return the loads in contacts that the last solve of a structure found.

        Returns:
            Rows of (dock, dock or -1 for the ground), shape (C, 2), and the loads.
        """
        beams = slice(self.frame.beam_count[structure])
        docks = self.frame.ends[structure, beams, frame_kernels.BeamEnds.DOCK_A :]
        is_contact = docks[:, 0] >= 0
        section = self.load_arrays.section[structure, beams][is_contact]
        stress = self.load_arrays.stress[structure, beams][is_contact]
        axial, shear, bending, torsion = section.T
        return docks[is_contact], ContactLoads(axial, shear, bending, torsion, stress)

    def loads(self, structure: int) -> Loads:
        """Return what the last solve of a structure found.

        Raises:
            StructureFailure: nothing supports the structure or a part of it, or it tips or slides.
        """
        if self.has_fallen(structure):
            last = self.robots[structure] - 1
            raise StructureFailure(
                f"the structure {self.stability[structure]} once robot {last} had joined"
            )
        beams = slice(self.frame.beam_count[structure])
        robots = int(self.robots[structure])
        dock_b = self.frame.ends[structure, beams, frame_kernels.BeamEnds.DOCK_B]
        standing = dock_b == frame_kernels.GROUND
        stress = self.load_arrays.stress[structure, beams]
        ground_force = self.load_arrays.support[structure, beams][standing]
        gone = self.gone[structure, :robots]
        weight = self._weight(structure)
        surplus = ground_force.sum(axis=0) + weight * self.down
        imbalance = float(np.abs(surplus).max() / weight)
        # Rounding hides that a matrix is singular, but not that nothing bears the weight.
        if not imbalance <= MAX_UNBORNE:
            raise StructureFailure("a part of the structure is held by nothing")
        return Loads(
            sensed=np.where(gone, np.nan, self.load_arrays.sensed[structure, :robots]),
            contact_stress=stress[dock_b >= 0],
            ground_stress=stress[standing],
            ground_force=ground_force,
            imbalance=imbalance,
        )


def _doubled(arrays: Any, *names: str) -> Any:  # noqa: ANN401 - a bundle
    """Double the room of some arrays of a bundle along their second axis."""
    doubled = {}
    for name in names:
        array = getattr(arrays, name)
        rows, columns, *rest = array.shape
        doubled[name] = aligned_zeros(rows, 2 * columns, *rest, dtype=array.dtype)
        doubled[name][:, :columns] = array
    return arrays._replace(**doubled)


def parts(pairs: AnyInts, count: int) -> Ints:
    """Number the parts that pairs join so many things to; the part of each, shape (count,)."""
    a, b = pairs.T
    graph = coo_array((np.ones(len(pairs)), (a, b)), shape=(count, count))
    _, part = connected_components(graph, directed=False)
    return np.asarray(part, np.int64)


def _free_to_turn(stiff: Reals) -> Reals:
    """Let the second ends of beams, stiffness of shape (n, 12, 12), turn freely."""
    freed = np.zeros_like(stiff)
    turn = stiff[:, 9:, :9]
    follow = turn.swapaxes(1, 2) @ np.linalg.solve(stiff[:, 9:, 9:], turn)
    freed[:, :9, :9] = stiff[:, :9, :9] - follow
    return freed


def _cross_matrix(vector: Reals) -> Reals:
    """Build the matrices of v x, shape (n, 3, 3), for vectors v, shape (n, 3)."""
    return np.asarray(np.cross(vector[:, None], np.eye(3)).swapaxes(1, 2), np.float64)


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
    parts = [
        [push, couple, -push, couple],
        [turned, near, -turned, far],
        [-push, -couple, push, -couple],
        [turned, far, -turned, near],
    ]
    return np.block(parts)
