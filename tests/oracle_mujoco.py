"""Exported structures in MuJoCo, and the springs that its welds are, assembled by hand."""

import re
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pytest

from tests.frames import LinkLoads, Standing, split_loads

mujoco = pytest.importorskip("mujoco", reason="the developers' tools have it from Python 3.11 on")

_JOINT = re.compile(r"(?:contact|foot)_(\d+)\.(\d+)(?:_(\d+)\.(\d+))?")
"""A joint by robot and dock, and for a contact the other robot and dock."""


@dataclass(frozen=True, kw_only=True)
class Weld:
    """A weld of the file."""

    ends: tuple[tuple[int, int], ...]
    """Robot and dock of each end; one end if the other is the ground."""

    place: np.ndarray
    """Its anchor [m], shape (3,)."""


class Simulation:
    """A file of MJCF in MuJoCo; the robots are bodies 1, 2, ... in join order."""

    def __init__(self, xml: bytes, keep: Collection[str] | None = None, gravity: float = 1.0):
        """Load a file; only the welds `keep` hold, or all. Gravity is scaled."""
        self.model = mujoco.MjModel.from_xml_string(xml.decode())
        self.gravity = gravity
        self.model.opt.gravity *= gravity
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.radius = float(self.model.numeric_data[self.model.numeric("R").adr[0]])
        self.start = self.data.xpos.copy()
        self.names = [self.model.eq(e).name for e in range(self.model.neq)]
        if keep is not None:
            self.data.eq_active[:] = [name in keep for name in self.names]
        self.welds = [self._weld(e) for e in range(self.model.neq)]

    def _weld(self, e: int) -> Weld:
        one, dock, other, other_dock = _JOINT.fullmatch(self.names[e]).groups()
        ends = ((int(one), int(dock)), *([(int(other), int(other_dock))] if other else []))
        # The anchor of a weld is in the frame of its second body, of a ball in that of its first.
        is_weld = self.model.eq_type[e] == mujoco.mjtEq.mjEQ_WELD
        body = (self.model.eq_obj2id if is_weld else self.model.eq_obj1id)[e]
        turn = self.data.xmat[body].reshape(3, 3)
        place = self.data.xpos[body] + turn @ self.model.eq_data[e, :3]
        return Weld(ends=ends, place=place)

    def run(self, seconds: float) -> None:
        """Simulate."""
        for _ in range(round(seconds / self.model.opt.timestep)):
            mujoco.mj_step(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)

    def settle(self) -> None:
        """Simulate until nothing moves by more than 1e-12 m/s, for at most ten seconds."""
        self.run(0.2)
        while np.abs(self.data.qvel).max() > 1e-12 and self.data.time < 10.0:
            self.run(0.2)

    @property
    def moved(self) -> float:
        """Largest distance of a robot from where it started [R]."""
        return float(np.linalg.norm(self.data.xpos - self.start, axis=1).max()) / self.radius

    @property
    def ground_force(self) -> np.ndarray:
        """Sum of what welds to the ground exert on robots [weight of a dock], shape (3,)."""
        # Contacts act on pairs of robots: in the sum over all robots they cancel.
        return self.data.qfrc_constraint.reshape(-1, 6)[:, :3].sum(axis=0)

    def acting(self, docks: int) -> np.ndarray:
        """Force and moment of welds and weight on each dock, for all of gravity, (docks N, 6).

        J' f of the rows of a weld is what it does to the coordinates of each free body: the force
        on it, and the moment about its center in its own frame.
        """
        self.model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        mujoco.mj_forward(self.model, self.data)
        data, rows = self.data, self.data.nefc
        jacobian = data.efc_J.reshape(rows, -1)
        acting = np.zeros((self.model.nbody - 1, docks, 6))
        acting[:, :, 2] = -1.0
        for e, weld in enumerate(self.welds):
            own = (data.efc_id[:rows] == e) & (
                data.efc_type[:rows] == mujoco.mjtConstraint.mjCNSTR_EQUALITY
            )
            for robot, dock in weld.ends:
                part = jacobian[own, 6 * robot : 6 * robot + 6].T @ data.efc_force[:rows][own]
                part /= self.gravity
                turn = data.xmat[robot + 1].reshape(3, 3)
                arm = data.geom(f"dock_{robot}.{dock}").xpos - data.xpos[robot + 1]
                moment = turn @ part[3:] - np.cross(arm, part[:3])
                acting[robot, dock] += [*part[:3], *(moment / self.radius)]
        return acting.reshape(-1, 6)

    def loads(self, structure: Standing) -> LinkLoads:
        """Loads of the links at rest."""
        return split_loads(structure, self.acting(len(structure.body)))

    def springs(self, structure: Standing) -> LinkLoads:
        """Loads of rigid robots on springs of the stiffness that MuJoCo documents for its welds."""
        time, impedance = self.model.eq_solref[0, 0], self.model.eq_solimp[0, 0]
        robots, docks = len(structure.center), len(structure.body)
        center = self.start[1:]
        dock = self.radius * structure.dock.reshape(robots, docks, 3)
        dock += center[0] - self.radius * structure.center[0]  # files are relative to the anchor
        stiffness, pulls = np.zeros((6 * robots, 6 * robots)), []
        for weld, active in zip(self.welds, self.data.eq_active, strict=True):
            way, weight = np.zeros((6, 6 * robots)), np.zeros(2)
            for sign, (robot, _) in zip((1.0, -1.0), weld.ends, strict=False):
                at = slice(6 * robot, 6 * robot + 6)
                way[:, at] += sign * _follow(weld.place - center[robot])
                weight += self.model.body_invweight0[robot + 1]
            along, about = active / (time**2 * (1.0 - impedance) * weight) / [1.0, 4.0]
            spring = np.diag([along] * 3 + [about] * 3)
            stiffness += way.T @ spring @ way
            pulls.append(spring @ way)
        load = np.zeros((robots, 6))
        load[:, 2] = -docks
        load[:, 3:] = np.cross((dock - center[:, None]).sum(axis=1), [0.0, 0.0, -1.0])
        motion = np.linalg.solve(stiffness, load.ravel())
        acting = np.zeros((robots, docks, 6))
        acting[:, :, 2] = -1.0
        for weld, pull in zip(self.welds, pulls, strict=True):
            force, moment = np.split(-pull @ motion, 2)
            for sign, (robot, d) in zip((1.0, -1.0), weld.ends, strict=False):
                about = moment + np.cross(weld.place - dock[robot, d], force)
                acting[robot, d] += sign * np.array([*force, *(about / self.radius)])
        return split_loads(structure, acting.reshape(-1, 6))


def _follow(arm: np.ndarray) -> np.ndarray:
    """From the motion of a body's center to that of a point of it, shape (6, 6)."""
    follow = np.eye(6)
    for k, axis in enumerate(np.eye(3)):
        follow[:3, 3 + k] = np.cross(axis, arm)
    return follow
