"""The robots of a swarm, checked before anything is computed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.base.robot import Robot
from tiswarm.compute.neighbor_list import MOST_ITEMS

_NORM_SLACK = 1e-6
"""Largest deviation of a quaternion's norm from 1."""


@dataclass(frozen=True, kw_only=True)
class Swarm:
    """N robots as the caller numbers them; lengths in the unit of D."""

    position: Reals
    """Centers, shape (N, 3)."""

    orientation_wxyz: Reals
    """Body to world, shape (N, 4)."""

    contacts: Ints
    """Connected docks, each pair once: rows of (robot, dock, robot, dock), shape (C, 4)."""

    structure: Ints
    """Number of each robot's structure, from 0 on without a gap, shape (N,)."""

    height: Reals
    """Height that each robot is pulled toward, NaN for none, shape (N,), or (1,) if unused."""

    mobility: Reals | None
    """Step along each axis for a force of 1 [1], shape (N, 3); None if the swarm is not guided."""

    dock_offset_body: Reals
    """Center to dock, body frame, shape (docks, 3)."""

    spacing: float
    """D."""

    @property
    def reach(self) -> float:
        """How far docks are from the center."""
        return float(np.linalg.norm(self.dock_offset_body, axis=1).max())

    @classmethod
    def check(
        cls,
        position: ArrayLike,
        orientation_wxyz: ArrayLike,
        contacts: ArrayLike,
        *,
        robot: Robot,
        height: ArrayLike | None,
        mobility: ArrayLike | None,
        structure: ArrayLike | None,
    ) -> "Swarm":
        """Check robots; arguments as for `PreparedSwarm`.

        Raises:
            InputError: an argument makes no sense.
        """
        center = _shaped("position", position, ("N", 3))
        robots = len(center)
        orientation = _shaped("orientation_wxyz", orientation_wxyz, (robots, 4))
        norm = np.linalg.norm(orientation, axis=1)
        if not (np.isfinite(center).all() and (np.abs(norm - 1.0) < _NORM_SLACK).all()):
            raise InputError(
                "positions must be finite and orientations unit quaternions (w, x, y, z)"
            )
        ids: Ints = np.zeros(robots, np.int64)
        if structure is not None:
            named = _shaped("structure", structure, (robots,))
            ids = np.unique(named, return_inverse=True)[1].astype(np.int64)
        return cls(
            position=center,
            orientation_wxyz=orientation,
            contacts=_checked_contacts(contacts, len(robot.dock_offset_body), ids),
            structure=ids,
            height=np.full(1, np.nan) if height is None else _shaped("height", height, (robots,)),
            mobility=None if mobility is None else _shaped("mobility", mobility, (robots, 3)),
            dock_offset_body=robot.dock_offset_body,
            spacing=robot.spacing,
        )


def _shaped(name: str, values: ArrayLike, shape: tuple[int | str, ...]) -> Reals:
    """Copy an array of this shape; a length that is a letter may be any."""
    expected = str(shape).replace("'", "")
    try:
        array = np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{name} is no table of numbers; give an array of shape {expected}"
        ) from error
    if array.size == 0:
        array = array.reshape(0, *(int(length) for length in shape[1:]))
    wanted = tuple(len(array) if isinstance(n, str) else n for n in shape) if array.ndim else ()
    if array.shape != wanted:
        raise InputError(f"{name} has shape {array.shape}; expected {expected}")
    return array


def _checked_contacts(contacts: ArrayLike, docks: int, structure: Ints) -> Ints:
    """Contacts between docks that exist, of different robots of one structure, each once."""
    given = _shaped("contacts", contacts, ("C", 4))
    odd = given[~(np.abs(given) < MOST_ITEMS) | (given != np.rint(given))]
    if odd.size:
        raise InputError(f"contacts holds {odd[0]:g}; give whole numbers: robot, dock, robot, dock")
    rows = given.astype(np.int64)
    first, second = rows[:, [0, 2]].T
    beyond = (rows < 0) | (rows >= np.array([len(structure), docks] * 2))
    wrong = beyond.any(axis=1) | (first == second)
    if not wrong.any():
        wrong = structure[first] != structure[second]
    if wrong.any():
        raise InputError(
            f"contact {tuple(rows[wrong][0].tolist())} is not between docks 0 to {docks - 1} of "
            f"two of the {len(structure)} robots in one structure"
        )
    # One number a pair sorts far faster than rows of four do.
    one, other = first * docks + rows[:, 1], second * docks + rows[:, 3]
    most = len(structure) * docks
    pair = np.unique(np.minimum(one, other) * most + np.maximum(one, other))
    one, other = np.divmod(pair, most)
    return np.column_stack([one // docks, one % docks, other // docks, other % docks])
