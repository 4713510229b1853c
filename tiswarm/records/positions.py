"""True and estimated positions, and their tables `robot,x_R,y_R,z_R`.

The table of an estimate may also have the columns `sd_R`, `known` and `yaw_deg`. No localizer may
import this module, which holds the truth.
"""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiswarm.aliases import Ints, Reals
from tiswarm.errors import InputError
from tiswarm.records.estimate import Estimate
from tiswarm.records.io import Table, write_text


@dataclass(frozen=True, kw_only=True)
class Truth:
    """True poses of N robots, in join order."""

    robot_id: Ints  # name of each robot, shape (N,)
    position: Reals  # centers [R], shape (N, 3)
    orientation_wxyz: Reals  # body to world, unit quaternion, shape (N, 4)


def write_positions(
    path: Path,
    robot_id: Ints,
    position: Reals,
    further: Mapping[str, Sequence[object]] | None = None,
    *,
    length_unit: str = "R",
) -> None:
    """Write a table of positions; each number has the shortest form that reads back exactly.

    Args:
        path: File to write.
        robot_id: Name of each robot, shape (N,).
        position: Centers, shape (N, 3).
        further: Further columns, by name.
        length_unit: Unit of all lengths; part of the column names.

    Raises:
        ValueError: a position is not finite.
    """
    if not np.isfinite(position).all():
        raise ValueError(f"{path.name}: positions must be finite")
    places = [robot_id.tolist(), *position.T.tolist()]
    columns = dict(zip(_header(length_unit), places, strict=False)) | dict(further or {})
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    write_text(path, text.getvalue())


def write_estimate(path: Path, estimate: Estimate, *, length_unit: str = "R") -> None:
    """Write an estimate with its standard deviations, observability and yaw, where it has them."""
    further: dict[str, Sequence[object]] = {}
    if estimate.sd is not None:
        sds = estimate.sd.tolist()
        further[f"sd_{length_unit}"] = ["" if math.isnan(sd) else sd for sd in sds]
    if estimate.observability is not None:
        further["known"] = estimate.observability.known
    if estimate.yaw is not None:
        further["yaw_deg"] = np.degrees(estimate.yaw).tolist()
    write_positions(path, estimate.robot_id, estimate.position, further, length_unit=length_unit)


def read_positions(path: Path, *, length_unit: str = "R") -> tuple[Ints, Reals]:
    """Read the names, shape (N,), and the positions, shape (N, 3), in a table of positions.

    Raises:
        InputError: the table cannot be read or a row is malformed; names file and line.
    """
    table = Table(path)
    columns = _header(length_unit)
    required, optional = columns[:4], columns[4:]
    if table.columns != [name for name in columns if name in {*required, *table.columns}]:
        wanted = ",".join(required) + "".join(f"[,{name}]" for name in optional)
        raise InputError(f"the columns are not {wanted}; rename them", path=path, line=1)
    robot = table.integers("robot")
    position = np.column_stack([table.numbers(name) for name in required[1:]])
    for name in table.columns[4:]:
        if name != "known":
            table.numbers(name, empty=math.nan)
    seen: set[int] = set()
    for row, name in enumerate(robot.tolist()):
        if name in seen:
            problem = f"robot {name} has a row already; keep one"
            raise InputError(problem, path=path, line=table.line(row), key="robot")
        seen.add(name)
    return robot, position


def read_length_unit(path: Path) -> str:
    """Read the unit of a table of positions from the names of its columns.

    Raises:
        InputError: the table cannot be read or its columns name no unit.
    """
    axis, _, unit = [*Table(path).columns, "", ""][1].partition("_")
    if axis != "x" or not unit:
        problem = "the columns name no unit of length; write them like robot,x_R,y_R,z_R"
        raise InputError(problem, path=path, line=1)
    return unit


def _header(length_unit: str) -> list[str]:
    lengths = [f"{name}_{length_unit}" for name in ("x", "y", "z", "sd")]
    return ["robot", *lengths, "known", "yaw_deg"]
