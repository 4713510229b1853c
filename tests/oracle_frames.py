"""Structures under their own weight by other means: a frame package, and bars and pins."""

import itertools
from dataclasses import dataclass

import numpy as np

from tests.frames import Standing
from tiswarm.world.mechanics import MechanicsParams

TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3.0)
"""Corners of a regular tetrahedron of circumradius 1, shape (4, 3)."""

IN_SPHERE, IN_ROBOT, BETWEEN_ROBOTS = 5e10, 2e9, 1e10
"""EA of the bars of the published truss [weight of a dock]."""


@dataclass(frozen=True, kw_only=True)
class Forces:
    """What a structure bears; shapes as in `Loads`."""

    sensed: np.ndarray
    contact_stress: np.ndarray
    ground_stress: np.ndarray
    ground_force: np.ndarray

    axial: np.ndarray
    """Size of the axial force in each link, shape (N, docks)."""

    bending: np.ndarray
    """Size of the bending moment in each link at the dock, shape (N, docks)."""


def beam_frame(structure: Standing, params: MechanicsParams, *, sparse: bool = False) -> Forces:
    """Build the frame in PyNite: centers, docks and feet as nodes, and solve it there."""
    from Pynite import FEModel3D  # noqa: PLC0415 - it takes most of a second to load

    model = FEModel3D()
    r, shear = params.beam_radius, 0.5 / (1.0 + params.poisson)
    for name, axial in (("link", params.link_axial), ("contact", params.contact_axial)):
        young = axial / (np.pi * r**2)
        model.add_material(name, young, young * shear, params.poisson, 0.0)
    model.add_section("round", np.pi * r**2, np.pi * r**4 / 4, np.pi * r**4 / 4, np.pi * r**4 / 2)
    for letter, nodes in (("C", structure.center), ("D", structure.dock), ("F", structure.foot)):
        for i, (x, y, z) in enumerate(nodes):
            model.add_node(f"{letter}{i}", x, y, z)
    links, contacts, footings, docks = [], [], [], len(structure.body)
    for d in range(len(structure.dock)):
        links.append(model.add_member(f"L{d}", f"C{d // docks}", f"D{d}", "link", "round"))
        model.add_node_load(f"D{d}", "FZ", -1.0)
    for c, (one, other) in enumerate(structure.contacts):
        contacts.append(model.add_member(f"K{c}", f"D{one}", f"D{other}", "contact", "round"))
    for g, d in enumerate(structure.standing):
        footings.append(model.add_member(f"G{g}", f"D{d}", f"F{g}", "contact", "round"))
        model.def_support(f"F{g}", *[True] * 6)
    model.analyze_linear(sparse=sparse)
    end = {name: member.f().ravel() for name, member in model.members.items()}
    axial = np.reshape([abs(end[name][6]) for name in links], (-1, docks))
    bending = np.reshape([np.hypot(*end[name][10:12]) for name in links], (-1, docks))
    reactions = [model.nodes[f"F{g}"] for g in range(len(footings))]
    return Forces(
        sensed=(axial + bending).mean(axis=1),
        axial=axial,
        bending=bending,
        # Bending changes evenly along a beam: halfway it is the mean of that at the ends.
        contact_stress=np.array(
            [_stress(f, 0.5 * (f[3:6] - f[9:]), r) for f in map(end.get, contacts)]
        ),
        ground_stress=np.array([_stress(f, f[9:], r) for f in map(end.get, footings)]),
        ground_force=np.array(
            [[n.RxnFX["Combo 1"], n.RxnFY["Combo 1"], n.RxnFZ["Combo 1"]] for n in reactions]
        ),
    )


def _stress(end, moment, radius):
    """Von Mises stress at the rim, from local end forces and the moment at a section."""
    area, second = np.pi * radius**2, np.pi * radius**4 / 4
    sigma = abs(end[0]) / area + np.hypot(moment[1], moment[2]) * radius / second
    tau = 4.0 / 3.0 * np.hypot(end[1], end[2]) / area + abs(moment[0]) * radius / (2 * second)
    return np.sqrt(sigma**2 + 3.0 * tau**2)


@dataclass(frozen=True, kw_only=True)
class TrussForces:
    """What the published truss bears."""

    sensed: np.ndarray
    """Mean over a robot's links of |axial force| + |bending moment| at the dock, shape (N,)."""

    axial: np.ndarray
    """Pull in the link of each dock, shape (3 N,)."""

    ground_force: np.ndarray
    """Force of the ground on each dock that stands on it, shape (G, 3)."""


def truss(structure: Standing, circumradius: float) -> TrussForces:
    """Solve the published truss: spheres, centers and feet as tetrahedra of pinned bars.

    Tetrahedra stand as the world does. All four corners of a dock's are joined to all four of
    its robot's center and of every dock and foot that it touches; those of feet do not move.
    """
    docks, robots = len(structure.dock), len(structure.center)
    spheres = np.concatenate([structure.dock, structure.center, structure.foot])
    node = (spheres[:, None] + circumradius * TETRAHEDRON).reshape(-1, 3)
    solid = [(s, s, IN_SPHERE) for s in range(docks + robots)]
    links = [(d, docks + d // 3, IN_ROBOT) for d in range(docks)]
    contacts = [(one, other, BETWEEN_ROBOTS) for one, other in structure.contacts]
    feet = [(d, docks + robots + g, BETWEEN_ROBOTS) for g, d in enumerate(structure.standing)]
    groups = [solid, links, contacts, feet]
    free = 3 * 4 * (docks + robots)
    stiffness = np.zeros((3 * len(node), 3 * len(node)))
    for bar in _bars(itertools.chain(*groups), node):
        at = np.r_[3 * bar.i : 3 * bar.i + 3, 3 * bar.j : 3 * bar.j + 3]
        stretch = np.r_[-bar.along, bar.along]
        stiffness[np.ix_(at, at)] += bar.stiffness * np.outer(stretch, stretch)
    load = np.zeros((len(node), 3))
    load[: 4 * docks, 2] = -0.25
    moved = np.zeros_like(node)
    moved.ravel()[:free] = np.linalg.solve(stiffness[:free, :free], load.ravel()[:free])

    def acting(pairs):
        """Force and moment on the first sphere of each pair, about its center."""
        total = np.zeros((len(pairs), 2, 3))
        for n, pair in enumerate(pairs):
            for bar in _bars([pair], node):
                force = bar.stiffness * (moved[bar.j] - moved[bar.i]) @ bar.along * bar.along
                total[n] += force, np.cross(node[bar.i] - spheres[pair[0]], force)
        return total[:, 0], total[:, 1]

    force, moment = acting(links)
    out = structure.dock - np.repeat(structure.center, 3, axis=0)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    axial = -np.sum(force * out, axis=1)
    bending = moment - np.sum(moment * out, axis=1, keepdims=True) * out
    felt = np.abs(axial) + np.linalg.norm(bending, axis=1)
    return TrussForces(
        sensed=felt.reshape(-1, 3).mean(axis=1), axial=axial, ground_force=acting(feet)[0]
    )


@dataclass(frozen=True)
class _Bar:
    i: int
    j: int
    along: np.ndarray
    stiffness: float


def _bars(pairs, node):
    """Bars between the tetrahedra of each pair, (sphere, sphere, EA), or within one."""
    for one, other, axial in pairs:
        for a, b in itertools.product(range(4), repeat=2):
            if one != other or a < b:
                i, j = 4 * one + a, 4 * other + b
                span = node[j] - node[i]
                length = np.linalg.norm(span)
                yield _Bar(i, j, span / length, axial / length)


def bundle(span: np.ndarray, axial: float, circumradius: float) -> np.ndarray:
    """Stiffness between rigid tetrahedra joined by 16 bars, as `beams.stiffness` orders it.

    Args:
        span: First tetrahedron to second [R], shape (n, 3).
        axial: EA of a bar [weight of a dock].
        circumradius: Of the tetrahedra [R].
    """
    total = np.zeros((len(span), 12, 12))
    for p, q in itertools.product(circumradius * TETRAHEDRON, repeat=2):
        bar = span + q - p
        length = np.linalg.norm(bar, axis=1, keepdims=True)
        along = bar / length
        stretch = np.concatenate([-along, -np.cross(p, along), along, np.cross(q, along)], axis=1)
        total += (axial / length)[:, :, None] * stretch[:, :, None] * stretch[:, None, :]
    return total
