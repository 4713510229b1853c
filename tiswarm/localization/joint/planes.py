"""Planes on which robots were measured to be: their coordinates and fixes. Lengths in R."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tiswarm.aliases import Ints, Reals
from tiswarm.measurements.model import Measurements


class Planes(NamedTuple):
    """P planes on which robots were measured to be, by robot."""

    robot: Ints
    """Robot of each, shape (P,)."""

    direction: Reals
    """Unit vector perpendicular to it, shape (P, 3)."""

    point: Reals
    """A point of it [R], with the robot's walk, see `walk`, shape (P, 3)."""

    precision: Reals
    """Precision of the distance from it [R^-2], shape (P,)."""

    walk: Reals
    """Part of `point` which turns with the robot, x and y to be subtracted [R], shape (P, 2)."""

    crowd: Reals
    """1 where other planes of the robot are perpendicular to it, 3 elsewhere, shape (P,)."""

    @classmethod
    def joined(cls, parts: "Sequence[Planes]") -> "Planes":
        """Concatenate planes."""
        return cls._make(np.concatenate(columns) for columns in zip(*parts, strict=True))


def fixed_planes(rows: Measurements, *, is_solved: bool) -> Planes:
    """Turn fixes into planes; if yaw is solved for, their walks turn with the robots."""
    direction, level = rows.places.direction, rows.arm * np.array([1.0, 1.0, 0.0]) * is_solved
    value = rows.places.value - (direction * (rows.arm - level)).sum(axis=1)
    return Planes(
        robot=rows.robot,
        direction=direction,
        point=direction * value[:, None],
        precision=1.0 / rows.variance(),
        walk=level[:, :2],
        crowd=np.ones(len(rows)),
    )
