"""Lines of PyFG, the text format of range-aided SLAM, as numbers; `factor_graph` explains it.

Besides what `factor_graph` writes there are relative poses, priors of points, graphs in a plane:

    EDGE_SE3:QUAT time pose pose x y z qx qy qz qw covariance(6 x 6)
    VERTEX_XYZ:PRIOR time point x y z covariance(3 x 3)
    VERTEX_SE2 time name x y theta, and in the same way :PRIOR, EDGE_SE2, VERTEX_XY, EDGE_SE2_XY
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.records.io import LARGEST, numbered_lines
from tiswarm.records.sensing_builder import FAR_FROM_UNIT

_MOST_BYTES = 2**28
"""Largest content of a graph [byte], whose lines are all in memory."""


class _Form(NamedTuple):
    """What stands in a line of some kind, after its name."""

    has_time: bool
    names: int
    values: int
    spread: int  # rows of the covariance


_FORMS = {
    "VERTEX_SE3:QUAT": _Form(has_time=True, names=1, values=7, spread=0),
    "VERTEX_SE2": _Form(has_time=True, names=1, values=3, spread=0),
    "VERTEX_XYZ": _Form(has_time=False, names=1, values=3, spread=0),
    "VERTEX_XY": _Form(has_time=False, names=1, values=2, spread=0),
    "VERTEX_SE3:QUAT:PRIOR": _Form(has_time=True, names=1, values=7, spread=6),
    "VERTEX_SE2:PRIOR": _Form(has_time=True, names=1, values=3, spread=3),
    "VERTEX_XYZ:PRIOR": _Form(has_time=True, names=1, values=3, spread=3),
    "VERTEX_XY:PRIOR": _Form(has_time=True, names=1, values=2, spread=2),
    "EDGE_SE3:QUAT": _Form(has_time=True, names=2, values=7, spread=6),
    "EDGE_SE2": _Form(has_time=True, names=2, values=3, spread=3),
    "EDGE_SE3_XYZ": _Form(has_time=True, names=2, values=3, spread=3),
    "EDGE_SE2_XY": _Form(has_time=True, names=2, values=2, spread=2),
    "EDGE_RANGE": _Form(has_time=True, names=2, values=1, spread=1),
}
_PLANAR = ("VERTEX_SE2", "EDGE_SE2")
_POSES = ("VERTEX_SE3:QUAT", "VERTEX_SE2", "EDGE_SE3:QUAT", "EDGE_SE2")
"""Kinds, and beginnings of kinds, that have an orientation."""


class GraphLine(NamedTuple):
    """A variable or a measurement of a graph."""

    line: int
    kind: str
    """Vertex, prior, pose, point or range: the last three are edges, named by what they measure."""

    names: tuple[str, ...]
    """The variable, or two of them: an edge is from the first to the second."""

    vector: Reals
    """Position, or vector in the frame of the first, shape (3,); of a range, x is its length."""

    spread: Reals
    """Covariance of the vector, shape (3, 3); 0 along z in a plane, and of a vertex."""

    wxyz: Reals
    """Orientation, body to world or of the second in the frame of the first; NaN without one."""

    turn_variance: float
    """Mean variance of the orientation [rad^2]; NaN without one."""


class Graph(NamedTuple):
    """The lines of a file."""

    lines: list[GraphLine]
    is_planar: bool
    unknown: dict[str, list[int]]
    """Lines of other kinds, by kind."""


def read_graph(path: Path) -> Graph:
    """Read the lines of a graph; a bad line raises InputError."""
    lines: list[GraphLine] = []
    unknown: dict[str, list[int]] = {}
    is_planar = False
    for number, text in numbered_lines(path, _MOST_BYTES):
        cells = text.split()
        if not cells or cells[0].startswith("#"):
            continue
        form = _FORMS.get(cells[0])
        if form is None:
            unknown.setdefault(cells[0][:40], []).append(number)
            continue
        is_planar |= cells[0].startswith(_PLANAR)
        lines.append(_parsed(path, number, cells, form))
    if not any(line.kind == "vertex" for line in lines):
        raise InputError("there are no variables; start with lines VERTEX_...", path=path, line=1)
    return Graph(lines, is_planar, unknown)


def _parsed(path: Path, number: int, cells: list[str], form: _Form) -> GraphLine:
    """Read the numbers of a line of a known kind."""
    kind, rest = cells[0], cells[1 + form.has_time :]
    names, rest = tuple(rest[: form.names]), rest[form.names :]
    size = form.values + form.spread * (form.spread + 1) // 2
    try:
        numbers = np.array([*map(float, rest)])
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) != size or not (np.abs(numbers) <= LARGEST).all():
        after = "time, " * form.has_time + f"{form.names} of the names, " * (form.names > 1)
        problem = f"{kind} should have {after or 'its name, '}then {size} numbers; correct it"
        raise InputError(problem, path=path, line=number)
    values, triangle = numbers[: form.values], numbers[form.values :]
    covariance: Reals = np.zeros((form.spread, form.spread))
    covariance[np.triu_indices(form.spread)] = triangle
    covariance = np.triu(covariance) + np.triu(covariance, 1).T
    if np.linalg.eigvalsh(covariance).min(initial=0.0) < -1e-9 * np.abs(covariance).max(
        initial=0.0
    ):
        raise InputError(
            "the covariance has negative variances; correct it", path=path, line=number
        )
    is_planar = kind.startswith((*_PLANAR, "VERTEX_XY:")) or kind == "VERTEX_XY"
    axes = 1 if kind == "EDGE_RANGE" else 2 if is_planar else 3
    vector, spread = np.zeros(3), np.zeros((3, 3))
    vector[:axes], part = values[:axes], covariance[:axes, :axes]
    spread[: len(part), : len(part)] = part
    turn_variance = math.nan
    wxyz: Reals = np.full(4, math.nan)
    if kind.removesuffix(":PRIOR") in _POSES:
        wxyz = _orientation(values[axes:], path, number)
        turn_variance = float(np.diag(covariance)[axes:].mean()) if form.spread else math.nan
    return GraphLine(number, _kind(kind), names, vector, spread, wxyz, turn_variance)


def _orientation(values: Reals, path: Path, line: int) -> Reals:
    """Turn x, y, z, w or an angle about z [rad] into a unit quaternion."""
    if len(values) == 1:
        half = 0.5 * float(values[0])
        return np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
    length = float(np.linalg.norm(values))
    if not abs(length - 1.0) <= FAR_FROM_UNIT:
        problem = f"the quaternion has length {length:.6g}; scale it to 1"
        raise InputError(problem, path=path, line=line)
    wxyz: Reals = np.roll(values / length, 1)
    return wxyz


def _kind(name: str) -> str:
    if name.startswith("VERTEX"):
        return "prior" if name.endswith(":PRIOR") else "vertex"
    if name == "EDGE_RANGE":
        return "range"
    return "pose" if name in _POSES else "point"
