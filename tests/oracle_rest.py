"""Rigid structures on feet that rest, by linear programs: do any forces balance their weight?"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog

from tests.frames import Standing
from tiswarm.world.mechanics import MechanicsParams

_SIDES = 64
"""Sides of the pyramids for cones; they are inside these, off by up to 0.12 %."""


class Verdict(NamedTuple):
    """What becomes of a structure that is rigid."""

    stability: str
    """As `rest.Stability`."""

    margin: float
    """How far the weight may grow sideways, or about an axis, until that changes [1]."""


def verdict(structure: Standing, params: MechanicsParams, carrier: int = 0) -> Verdict:
    """Say whether all of a structure, which one part is, stands, tips or slides."""
    for friction, stability in ((None, "tipped"), (params.friction, "slid")):
        slack = _slack(structure, params, friction, carrier)
        if slack > 0.0:
            return Verdict(stability, slack)
    return Verdict("stands", _room(structure, params, carrier))


def _wrench(structure, params, carrier):
    """Force and moment of the weight about the origin, per weight of the structure."""
    docks = len(structure.body)
    down = np.array(params.gravity) / np.linalg.norm(params.gravity)
    force, moment = np.zeros(3), np.zeros(3)
    for dock in structure.dock:
        force += down
        moment += np.cross(dock, down)
    if params.payload is not None:
        weight = params.payload.weight_for(docks) * down
        force += weight
        moment += np.cross(structure.center[carrier], weight)
    return np.concatenate([force, moment]) / np.linalg.norm(force)


def _rays(structure, friction):
    """Wrenches of forces of 1 along the edges of the cones of all feet, shape (n, 6)."""
    rays = []
    for dock, foot in zip(structure.standing, structure.foot, strict=True):
        normal = structure.dock[dock] - foot
        normal /= np.linalg.norm(normal)
        one = np.cross(normal, [1.0, 0.3, 0.2])
        one /= np.linalg.norm(one)
        two = np.cross(normal, one)
        forces = []
        for k in range(_SIDES):
            along = np.cos(2 * np.pi * k / _SIDES) * one + np.sin(2 * np.pi * k / _SIDES) * two
            forces.append(along if friction is None else normal + friction * along)
        if friction is None:
            forces.append(normal)  # along the ground any force, whatever presses
        rays += [np.concatenate([force, np.cross(foot, force)]) for force in forces]
    return np.array(rays)


def _slack(structure, params, friction, carrier):
    """Least sum of forces and moments that must help the feet to balance the weight [1]."""
    rays = _rays(structure, friction)
    wrench = _wrench(structure, params, carrier)
    helping = np.concatenate([np.eye(6), -np.eye(6)])
    cost = np.concatenate([np.zeros(len(rays)), np.ones(12)])
    found = linprog(cost, A_eq=np.concatenate([rays, helping]).T, b_eq=-wrench, method="highs")
    assert found.success
    return 0.0 if found.fun < 1e-7 else float(found.fun)


def _room(structure, params, carrier):
    """Largest part of the weight that may push along any axis, or turn about it, and be borne."""
    rays = _rays(structure, params.friction)
    wrench = _wrench(structure, params, carrier)
    room = np.inf
    for push in np.concatenate([np.eye(6), -np.eye(6)]):
        matrix = np.column_stack([rays.T, push])
        cost = np.zeros(len(rays) + 1)
        cost[-1] = -1.0
        found = linprog(cost, A_eq=matrix, b_eq=-wrench, method="highs")
        room = min(room, np.inf if found.status == 3 else -found.fun)  # 3: unbounded
    return float(room)
