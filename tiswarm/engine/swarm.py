"""The checked arguments of the swarm step."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiswarm.compute.backend import Backend
from tiswarm.compute.neighbor_list import MOST_ITEMS
from tiswarm.errors import InputError
from tiswarm.robot import Robot

NORM_SLACK = 1e-6
"""A quaternion whose norm is this near to 1 is a rotation."""
FINEST = 0.01
"""A coordinate must be resolved this finely [D]."""


@dataclass(frozen=True, kw_only=True)
class Swarm:
    """Robots and what connects them, in the caller's order."""

    position: NDArray[np.float64]
    orientation_wxyz: NDArray[np.float64]
    contacts: NDArray[np.int64]
    height: NDArray[np.float64] | None
    structure: NDArray[np.int64]
    dock_offset_body: NDArray[np.float64]
    spacing: float

    @classmethod
    def checked(
        cls,
        position: ArrayLike,
        orientation_wxyz: ArrayLike,
        contacts: ArrayLike,
        *,
        robot: Robot,
        height: ArrayLike | None,
        structure: ArrayLike | None,
    ) -> "Swarm":
        """Refuse what has the wrong shape, is not finite, or contradicts itself."""
        center = _shaped("position", position, ("N", 3))
        robots = len(center)
        orientation = _shaped("orientation_wxyz", orientation_wxyz, (robots, 4))
        norm = np.linalg.norm(orientation, axis=1)
        if not (np.isfinite(center).all() and (np.abs(norm - 1.0) < NORM_SLACK).all()):
            msg = "positions must be finite and orientations unit quaternions (w, x, y, z)"
            raise InputError(msg)
        ids: NDArray[np.int64] = np.zeros(robots, np.int64)
        if structure is not None:
            named = _shaped("structure", structure, (robots,))
            ids = np.unique(named, return_inverse=True)[1].astype(np.int64)
        docks = robot.dock_offset_body
        return cls(
            position=center,
            orientation_wxyz=orientation,
            contacts=_checked_contacts(contacts, len(docks), ids),
            height=None if height is None else _shaped("height", height, (robots,)),
            structure=ids,
            dock_offset_body=docks,
            spacing=robot.spacing,
        )

    def check_resolution(self, running: Backend) -> None:
        """Refuse places so far from the origin that forces would be noise."""
        if not resolved(self.position, running, self.spacing):
            msg = (
                f"a robot {np.abs(self.position).max():.3g} from the origin is beyond what "
                f"{running.precision} resolves; move the swarm to the origin"
            )
            raise InputError(msg + (" or use precision f64" if running.precision == "f32" else ""))


def resolved(position: NDArray[np.float64], running: Backend, spacing: float) -> bool:
    """Whether every coordinate is a number that the precision resolves finely enough."""
    farthest = np.abs(position).max(initial=0.0)
    return bool(farthest * np.finfo(running.dtype).eps <= FINEST * spacing)


def _shaped(name: str, values: ArrayLike, shape: tuple[int | str, ...]) -> NDArray[np.float64]:
    """Copy an array of this shape; a length that is a letter may be any."""
    try:
        array = np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        msg = f"{name} is no table of numbers; give an array of shape {_text(shape)}"
        raise InputError(msg) from error
    if array.size == 0:
        array = array.reshape(0, *(int(length) for length in shape[1:]))
    fits = array.ndim == len(shape) and all(
        isinstance(wanted, str) or length == wanted
        for length, wanted in zip(array.shape, shape, strict=True)
    )
    if not fits:
        msg = f"{name} has shape {array.shape}; expected {_text(shape)}"
        raise InputError(msg)
    return array


def _text(shape: tuple[int | str, ...]) -> str:
    return f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"


def _checked_contacts(
    contacts: ArrayLike, docks: int, structure: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Contacts between docks that exist, of different robots of one structure, each once."""
    given = _shaped("contacts", contacts, ("C", 4))
    odd = given[~(np.abs(given) < MOST_ITEMS) | (given != np.rint(given))]
    if odd.size:
        msg = f"contacts holds {odd[0]:g}; give whole numbers: robot, dock, robot, dock"
        raise InputError(msg)
    rows = given.astype(np.int64)
    first, second = rows[:, [0, 2]].T
    beyond = (rows < 0) | (rows >= np.array([len(structure), docks] * 2))
    wrong = beyond.any(axis=1) | (first == second)
    if not wrong.any():
        wrong = structure[first] != structure[second]
    if wrong.any():
        msg = (
            f"contact {tuple(rows[wrong][0].tolist())} is not between docks 0 to {docks - 1} of "
            f"two of the {len(structure)} robots in one structure"
        )
        raise InputError(msg)
    # One number a pair sorts far faster than rows of four do.
    one, other = first * docks + rows[:, 1], second * docks + rows[:, 3]
    most = len(structure) * docks
    pair = np.unique(np.minimum(one, other) * most + np.maximum(one, other))
    one, other = np.divmod(pair, most)
    return np.column_stack([one // docks, one % docks, other // docks, other % docks])
