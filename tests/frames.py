"""Structures as their mechanics sees them: random ones, and those that were grown."""

import dataclasses
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.structures import exact_estimate
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.numerics import aligned_zeros
from tiswarm.report.swarm_view import SwarmView, view_log
from tiswarm.sensing.observation import observe
from tiswarm.sensing.params import SensingParams
from tiswarm.world.block_kernels import ROW_WIDTH
from tiswarm.world.history import DIED, History
from tiswarm.world.mechanics import Frames, Loads, MechanicsParams

BODY = RobotGeometry().dock_offset_body

needs_metis = pytest.mark.skipif(
    find_spec("pymetis") is None, reason="needs pymetis, which has no wheel for every system"
)


@dataclass(frozen=True, kw_only=True)
class Standing:
    """Robots of n docks that touch each other and the ground; dock k of robot i is n i + k."""

    center: np.ndarray
    """Centers [R], shape (N, 3)."""

    turn: np.ndarray
    """Orientations, body to world, shape (N, 3, 3)."""

    contacts: np.ndarray
    """Docks that touch, shape (C, 2), in the order in which the later robot joins."""

    standing: np.ndarray
    """Docks on the ground, in the order in which their robots join, shape (G,)."""

    foot: np.ndarray
    """Where they touch it [R], shape (G, 3)."""

    body: np.ndarray = field(default_factory=lambda: BODY)
    """Center to dock in the body frame [R], shape (n, 3)."""

    @property
    def dock(self):
        """Dock centers [R], shape (n N, 3)."""
        return (self.center[:, None] + self.body @ self.turn.swapaxes(1, 2)).reshape(-1, 3)


def solve(structure: Standing, params: MechanicsParams | None = None, **settings: object) -> Loads:
    """Loads of a structure, mechanics being as usual except for `settings`."""
    return solved(structure, params or MechanicsParams(**settings)).loads(0)


def solved(structure: Standing, params: MechanicsParams) -> Frames:
    """Frames of a structure, solved."""
    robots, docks = len(structure.center), len(structure.body)
    frames = Frames(params, docks=docks, robots=robots)
    for j in range(robots):
        join(frames, 0, structure, j)
    frames.solve([0])
    return frames


def in_rows(numbers: np.ndarray) -> np.ndarray:
    """Append zeros to the six numbers of the last axis, as rows of blocks have them."""
    rows = aligned_zeros(*numbers.shape[:-1], ROW_WIDTH)
    rows[..., : numbers.shape[-1]] = numbers
    return rows


class LinkLoads(NamedTuple):
    """What the links of N robots bear [weight of a dock, R]."""

    axial: np.ndarray
    """Size of the axial force, shape (N, docks)."""

    bending: np.ndarray
    """Size of the bending moment at the dock, shape (N, docks)."""


def link_loads(structure: Standing, **settings: object) -> LinkLoads:
    """Axial force and bending moment in each link, mechanics being as usual but for `settings`."""
    frames = solved(structure, MechanicsParams(**settings))
    return split_loads(structure, frames.load_arrays.acting[0, :, :6])


def split_loads(structure: Standing, acting: np.ndarray) -> LinkLoads:
    """Split forces and moments on all docks, shape (n N, 6), by the directions of their links."""
    link = structure.dock.reshape(len(structure.center), -1, 3) - structure.center[:, None]
    link /= np.linalg.norm(link, axis=2, keepdims=True)
    force, moment = np.split(acting.reshape(*link.shape[:2], 6), 2, axis=2)
    along = (moment * link).sum(axis=2, keepdims=True) * link
    return LinkLoads(
        axial=np.abs((force * link).sum(axis=2)), bending=np.linalg.norm(moment - along, axis=2)
    )


def tree(structure: Standing) -> Standing:
    """Keep the first contact of each robot, and one foot of each that has none: no loops."""
    docks = len(structure.body)
    later, first = np.unique(structure.contacts[:, 1] // docks, return_index=True)
    alone = ~np.isin(structure.standing // docks, later)
    _, foot = np.unique(structure.standing[alone] // docks, return_index=True)
    foot = np.flatnonzero(alone)[foot]
    return dataclasses.replace(
        structure,
        contacts=structure.contacts[first],
        standing=structure.standing[foot],
        foot=structure.foot[foot],
    )


def join(frames: Frames, number: int, structure: Standing, j: int) -> None:
    """Let one robot join, the ones before it having done so."""
    docks = len(structure.body)
    own = structure.standing // docks == j
    frames.join(
        number,
        structure.center[j],
        structure.dock[docks * j : docks * (j + 1)],
        structure.contacts[structure.contacts[:, 1] // docks == j],
        structure.standing[own],
        structure.foot[own],
    )


def grown(history, robots: int | None = None) -> Standing:
    """Those of the first robots of a structure that are left once so many have joined, or all."""
    count = min(robots or history.robot_count, history.robot_count)
    n = history.robot.dock_count
    stays = remaining(history, count)
    number = {robot: place for place, robot in enumerate(stays.tolist())}
    contacts, standing = [], []
    for j in stays.tolist():
        walk = history.walks[j]
        for own, i, dock in walk.at_rest(walk.contacts).tolist():
            if i in number:
                contacts.append((n * number[i] + dock, n * number[j] + own))
        for rows in (walk.ground_docks, walk.edge_docks):
            standing += [n * number[j] + dock for (dock,) in walk.at_rest(rows).tolist()]
    turn = Rotation.from_quat(history.orientation_wxyz[stays], scalar_first=True)
    whole = Standing(
        center=history.position[stays],
        turn=turn.as_matrix(),
        contacts=np.array(contacts, np.int32).reshape(-1, 2),
        standing=np.array(standing, np.int32),
        foot=np.empty((0, 3)),
        body=history.robot.dock_offset_body,
    )
    foot = history.terrain.foot(whole.dock[whole.standing])
    return dataclasses.replace(whole, foot=foot)


def joint_names(structure: Standing) -> set[str]:
    """Names that worlds of physics engines give to the contacts of a structure and to its feet."""
    docks = len(structure.body)
    contacts = {
        "contact_{}.{}_{}.{}".format(*divmod(one, docks), *divmod(other, docks))
        for one, other in structure.contacts.tolist()
    }
    return contacts | {"foot_{}.{}".format(*divmod(dock, docks)) for dock in structure.standing}


def view_of(history: History, **sensing: object) -> SwarmView:
    """Show a grown structure and its ground as the folder of a run does, with an exact estimate."""
    log = observe(history, SensingParams(**sensing))
    view = view_log(log, exact_estimate(log, history.position), history.position)
    return dataclasses.replace(view, terrain=None if log.ground_z is None else history.terrain)


def remaining(history, joined: int) -> np.ndarray:
    """Robots that have joined and not left or fallen once so many have joined, ascending."""
    gone = {
        r for r, after, event in history.departures.tolist() if after <= joined and event < DIED
    }
    return np.array([j for j in range(joined) if j not in gone])
