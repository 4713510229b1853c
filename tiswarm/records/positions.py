"""True and estimated positions, and their tables `robot,x_R,y_R,z_R`.

The table of an estimate may also have the columns `sd_R`, `within_1R`, `known`, `yaw_deg` and
`undetermined`. No localizer may import this module, which holds the truth.
"""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.records.estimate import WITHIN, Estimate, Observability, position_columns
from tiswarm.records.io import CsvFile, Opener, replacing
from tiswarm.records.sensing_log import SensingLog

_WORDS = {
    "known": ("yes", "mirrored", "floppy", "disconnected"),
    "gone": ("yes", "no"),
    "undetermined": ("x", "y", "z", "xy", "xz", "yz", "xyz"),
}
"""Words that the cells of a column may have, besides none."""


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
    opened: Opener = replacing,
) -> None:
    """Write a table of positions; each number has the shortest form that reads back exactly.

    Args:
        path: File to write.
        robot_id: Name of each robot, shape (N,).
        position: Centers, shape (N, 3).
        further: Further columns, by name.
        length_unit: Unit of all lengths; part of the column names.
        opened: Opens the file.

    Raises:
        ValueError: a position is not finite.
    """
    columns = position_columns(robot_id, position, length_unit) | dict(further or {})
    _write(path, position, columns, opened)


def write_estimate(path: Path, estimate: Estimate, *, opened: Opener = replacing) -> None:
    """Write an estimate with its standard deviations, observability and yaw, where it has them."""
    _write(path, estimate.position, estimate.columns(), opened)


def _write(
    path: Path, position: Reals, columns: Mapping[str, Sequence[object]], opened: Opener
) -> None:
    """Write columns by name; numbers that are NaN are empty cells."""
    if not np.isfinite(position).all():
        raise ValueError(f"{path.name}: positions must be finite")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow(["" if cell != cell else cell for cell in row])  # noqa: PLR0124 - NaN
    with opened(path) as file:
        file.write(text.getvalue().encode())


def read_positions_of(log: SensingLog, path: Path) -> Reals:
    """Read the positions of a log's robots, in its unit and join order, shape (N, 3).

    Raises:
        InputError: the table cannot be read, is malformed, or has other robots than the log.
    """
    robot, position, _ = read_positions(path, log.length_unit)
    return position[_join_order(log, robot, path)]


def read_estimate(log: SensingLog, path: Path) -> Estimate:
    """Read an estimate of a log; the table has neither solutions, outliers nor residuals.

    Probabilities are computed again from `sd`.

    Raises:
        InputError: the table cannot be read, is malformed, or has other robots than the log.
    """
    robot, position, further = read_positions(path, log.length_unit)
    order = _join_order(log, robot, path)
    robots = log.robot_count
    status = further.get("known", np.full(robots, ""))[order]
    sd = further.get(f"sd_{log.length_unit}")
    yaw_deg = further.get("yaw_deg")
    axes = further.get("undetermined")
    undetermined = None
    if axes is not None:
        open_axes = [[axis in word for axis in "xyz"] for word in axes[order]]
        undetermined = np.array(open_axes, np.bool_)
    disconnected = status == "disconnected"
    return Estimate(
        robot_id=log.robot_id,
        position=position[order],
        disconnected=disconnected,
        sd=None if sd is None else sd[order],
        undetermined=undetermined,
        yaw=None if yaw_deg is None else np.radians(yaw_deg[order]),
        gone=log.is_gone if log.gone.size else None,
        mirrored=status == "mirrored" if (status != "").all() else None,
        observability=Observability(
            cues=(),
            yaw_unknown=yaw_deg is not None,
            unknowns=(3 if yaw_deg is None else 4) * (robots - 1),
            gauge_yaw_sd=None,
            floppy_modes=None,
            floppy=status == "floppy" if (status != "").all() else None,
            disconnected=disconnected,
        ),
        iteration=np.empty(0, np.int64),
        trace=np.empty((0, robots, 3)),
        residual=np.empty(0),
        length_unit=log.length_unit,
        dock_radius=log.dock_radius,
    )


def read_positions(
    path: Path, length_unit: str = "R"
) -> tuple[Ints, Reals, dict[str, NDArray[Any]]]:
    """Read names, (N,), positions, (N, 3), and further columns by name of a table of positions.

    Raises:
        InputError: the table cannot be read or a row is malformed; names file and line.
    """
    table = CsvFile(path)
    within = [name for name in table.columns if name.startswith(WITHIN)]
    columns = _header(length_unit, within or [f"{WITHIN}1R"])
    required = columns[:4]
    optional = columns[4:]
    if table.columns != [name for name in columns if name in {*required, *table.columns}]:
        wanted = ",".join(required) + "".join(f"[,{name}]" for name in optional)
        raise InputError(f"the columns are not {wanted}; rename them", path=path, line=1)
    robot = table.integers("robot")
    position = np.column_stack([table.numbers(name) for name in required[1:]])
    further: dict[str, NDArray[Any]] = {
        name: table.words(name) if name in _WORDS else table.numbers(name, empty=math.nan)
        for name in table.columns[4:]
    }
    for name, words in _WORDS.items():
        for row, word in enumerate(further.get(name, np.empty(0)).tolist()):
            if word not in {"", *words}:
                wanted = f"{', '.join(words[:-1])} or {words[-1]}"
                problem = f"{word[:40]!r} should be {wanted}; correct it"
                raise InputError(problem, path=path, line=table.line(row), key=name)
    seen: set[int] = set()
    for row, name in enumerate(robot.tolist()):
        if name in seen:
            problem = f"robot {name} has a row already; keep one"
            raise InputError(problem, path=path, line=table.line(row), key="robot")
        seen.add(name)
    return robot, position, further


def _join_order(log: SensingLog, robot: Ints, path: Path) -> Ints:
    """Return the row of each robot of a log, shape (N,)."""
    missing = np.setxor1d(robot, log.robot_id)
    if len(missing):
        problem = f"robot {missing[0]} is only here or only in the log; give a table of its robots"
        raise InputError(problem, path=path, key="robot")
    order = np.empty(len(robot), np.int64)
    order[log.robot_id.argsort()] = robot.argsort()
    return order


def read_length_unit(path: Path) -> str:
    """Read the unit of a table of positions from the names of its columns.

    Raises:
        InputError: the table cannot be read or its columns name no unit.
    """
    axis, _, unit = [*CsvFile(path).columns, "", ""][1].partition("_")
    if axis != "x" or not unit:
        problem = "the columns name no unit of length; write them like robot,x_R,y_R,z_R"
        raise InputError(problem, path=path, line=1)
    return unit


def _header(length_unit: str, within: Sequence[str]) -> list[str]:
    """List the columns of a table in order; `within` are those of probabilities."""
    lengths = [f"{name}_{length_unit}" for name in ("x", "y", "z", "sd")]
    return ["robot", *lengths, *within, "known", "gone", "yaw_deg", "undetermined"]
