"""Imports factor graphs of range-aided SLAM (PyFG) as sensing logs.

Each variable becomes a robot: a pose of a trajectory, or a landmark. Ranges remain ranges, and
priors become fixes along the axes of their covariance. A relative translation becomes a
displacement, or fixes if it starts at the anchor; its length becomes a range where no line
determines how its pose is turned. If each point is a dock, as in graphs that `tiswarm export`
writes, poses are robots with these docks, and ranges between docks contacts.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.interop.assumptions import Assumptions
from tiswarm.interop.graph_lines import Graph, GraphLine, read_graph
from tiswarm.interop.graph_turns import Turn, find_turns
from tiswarm.interop.pose_table import line_ranges
from tiswarm.records.messages import counted
from tiswarm.records.sensing_log import SensingLog, SensingNoise, canonical_contacts

_NEAREST = 0.1
"""Radius of a dock of points, per shortest measured distance: points must not push each other."""

_UNKNOWN_SD = 1e5
"""Priors of positions with a greater standard deviation [dock radii] state none."""

_SD = (1e-6, 1e6)
"""Least and greatest standard deviation of a measurement [dock radii]."""

_FIRM_TURN = 0.3
"""Greatest standard deviation of an orientation that gives vectors directions [rad]."""

_SAME = 1e-6
"""Relative difference of lengths that are equal but for rounding."""


_EXACT = SensingNoise(tilt_deg=0.0, yaw_deg=0.0)
_NOT_TURNED = Turn(np.eye(4)[0], math.nan)
_OPEN = "poses whose orientation no line determines, whose lengths are ranges"


class _Docks(NamedTuple):
    """Points of a graph that are docks of its poses."""

    offset: Reals  # center to dock, body frame, shape (D, 3)
    radius: float
    place: dict[str, tuple[str, int]]  # pose and dock of each point


def import_graph(path: Path, assumed: Assumptions) -> tuple[SensingLog, Reals, list[str]]:
    """Turn a graph into a log, with the positions at its vertices, (N, 3), and notes in lines.

    Raises:
        InputError: a line is malformed, names an unknown variable, or an option does not apply.
    """
    for name in ("ground_z", "heights", "anchors", "contacts", "dock_offset_body"):
        if getattr(assumed, name) not in (None, False, ()):
            raise InputError("a factor graph states its measurements; leave it out", argument=name)
    graph = read_graph(path)
    vertex = _vertices(graph, path)
    docks = _docks(graph)
    radius = _point_radius(graph, assumed) if docks is None else docks.radius
    robots = [name for name in vertex if docks is None or name not in docks.place]
    priors = [line for line in graph.lines if line.kind == "prior"]
    anchor = min(
        (line for line in priors if line.names[0] in robots and _states_place(line, radius)),
        key=lambda line: float(np.trace(line.spread)),
        default=None,
    )
    first = robots[0] if anchor is None else anchor.names[0]
    order = {name: index for index, name in enumerate([first, *(n for n in robots if n != first)])}
    turns = _orientations(graph, order, first, vertex, radius)
    start = vertex[first] if anchor is None else anchor
    maker = _LogMaker(graph, order, start, docks, radius, turns)
    log = maker.log(assumed.length_unit)
    notes = [f"robots are numbered from 0 as variables are listed, the anchor {first} first"]
    if anchor is None:
        notes.append(f"no prior of a position: the anchor {first} is at its vertex")
    notes += maker.left_out()
    size = f"{counted(log.robot_count, 'robot')}, {counted(len(log.contacts), 'contact')}, "
    size += f"{counted(len(log.ranges), 'range')}, {counted(len(log.fixes), 'fix')}"
    if len(log.displacements):
        size += f", {counted(len(log.displacements), 'displacement')}"
    truth = np.array([vertex[name].vector for name in order])
    return log, truth, [*notes, size.replace("fixs", "fixes")]


def _vertices(graph: Graph, path: Path) -> dict[str, GraphLine]:
    """Find the line of each variable; refuse repeated and unknown ones."""
    vertex: dict[str, GraphLine] = {}
    for line in graph.lines:
        if line.kind == "vertex" and line.names[0] in vertex:
            problem = f"{line.names[0]} is a variable already; give it another name"
            raise InputError(problem, path=path, line=line.line)
        if line.kind == "vertex":
            vertex[line.names[0]] = line
    for line in graph.lines:
        if unknown := [name for name in line.names if name not in vertex]:
            problem = f"there is no variable {unknown[0][:40]}; add its vertex"
            raise InputError(problem, path=path, line=line.line)
        if len({*line.names}) < len(line.names):
            problem = f"{line.names[0]} is measured from itself; name another variable"
            raise InputError(problem, path=path, line=line.line)
        if line.kind == "range" and not line.vector[0] > 0.0:
            problem = f"the distance {line.vector[0]:g} should be positive; correct it"
            raise InputError(problem, path=path, line=line.line)
    return vertex


def _docks(graph: Graph) -> _Docks | None:
    """Find out whether each point is a dock: every pose has points at the same places."""
    arms: dict[str, list[GraphLine]] = {}
    for line in graph.lines:
        if line.kind == "point":
            arms.setdefault(line.names[0], []).append(line)
    points = [line.names[1] for lines in arms.values() for line in lines]
    poses = [
        line.names[0]
        for line in graph.lines
        if line.kind == "vertex" and not np.isnan(line.wxyz).any()
    ]
    if not points or len({*points}) < len(points) or {*arms} != {*poses}:
        return None
    shapes = [np.array([line.vector for line in lines]) for lines in arms.values()]
    if any(s.shape != shapes[0].shape or not np.allclose(s, shapes[0]) for s in shapes):
        return None
    place = {
        line.names[1]: (pose, dock)
        for pose, lines in arms.items()
        for dock, line in enumerate(lines)
    }
    spacing = [
        line.vector[0]
        for line in graph.lines
        if line.kind == "range" and all(name in place for name in line.names)
    ]
    if not spacing or not np.allclose(spacing, spacing[0], rtol=_SAME, atol=0.0):
        return None
    return _Docks(shapes[0], 0.5 * spacing[0], place)


def _point_radius(graph: Graph, assumed: Assumptions) -> float:
    """Choose the radius of the docks of points."""
    measured = [
        float(np.linalg.norm(line.vector))
        for line in graph.lines
        if line.kind in {"range", "pose", "point"}
    ]
    shortest = min([length for length in measured if length > 0.0], default=math.inf)
    return min(assumed.dock_radius, _NEAREST * shortest)


def _states_place(prior: GraphLine, radius: float) -> bool:
    """Whether a prior states a position, not an orientation only."""
    return bool(np.diag(prior.spread).max() <= (_UNKNOWN_SD * radius) ** 2)


def _orientations(
    graph: Graph, order: dict[str, int], anchor: str, vertex: dict[str, GraphLine], radius: float
) -> dict[str, Turn]:
    """Take orientations and places of priors, and find how all other poses are turned."""
    known = {
        line.names[0]: Turn(line.wxyz, line.turn_variance)
        for line in graph.lines
        if line.kind == "prior" and line.names[0] in order and not np.isnan(line.wxyz).any()
    }
    if anchor not in known and not np.isnan(vertex[anchor].wxyz).any():
        known[anchor] = Turn(vertex[anchor].wxyz, 0.0)
    places = {
        line.names[0]: line
        for line in graph.lines
        if line.kind == "prior" and _states_place(line, radius)
    }
    return find_turns(graph, known, places)


class _LogMaker:
    """Collects the rows of a log from the lines of a graph, and what it has to leave out."""

    def __init__(
        self,
        graph: Graph,
        order: dict[str, int],
        anchor: GraphLine,
        docks: _Docks | None,
        radius: float,
        turns: dict[str, Turn],
    ) -> None:
        self._graph, self._order, self._anchor, self._docks = graph, order, anchor, docks
        self._radius, self._turns = radius, turns
        self._displacements: list[tuple[float, ...]] = []
        self._ranges: list[tuple[float, ...]] = []
        self._fixes: list[tuple[float, ...]] = []
        self._contacts: list[tuple[int, ...]] = []
        self._lost: dict[str, list[int]] = {
            f"lines {kind}, which are unknown": lines for kind, lines in graph.unknown.items()
        }
        for line in graph.lines:
            self._add(line)
        if graph.is_planar:
            level = (*np.eye(3)[2], 0.0, 1e-3 * self._radius, -1)
            self._fixes += [(index, *level) for index in range(1, len(order))]

    def log(self, length_unit: str) -> SensingLog:
        """Make the log."""
        turns = [self._turns.get(name, _NOT_TURNED).wxyz for name in self._order]
        count = len(self._order)
        dock = np.zeros((1, 3)) if self._docks is None else self._docks.offset
        contacts = np.array(self._contacts, np.int32).reshape(-1, 4)
        return SensingLog(
            robot_id=np.arange(count),
            dock_radius=self._radius,
            dock_offset_body=dock,
            anchor_position=self._anchor.vector,
            orientation_wxyz=np.array(turns),
            contacts=canonical_contacts(contacts),
            ground_docks=np.empty((0, 2), np.int32),
            fixes=np.array(sorted(self._fixes)).reshape(-1, 7),
            ranges=np.array(sorted(self._ranges)).reshape(-1, 5),
            displacements=np.array(sorted(self._displacements)).reshape(-1, 6),
            # Displacements have the noise of orientations; points have no arms for it to turn.
            noise=_EXACT if self._displacements and self._docks is None else None,
            flip_height=np.full(count, np.nan),
            spawn_position=np.full((count, 3), np.nan),
            length_unit=length_unit,
        )

    def left_out(self) -> list[str]:
        """Say in lines what the log has no place for, with numbers of lines."""
        return [
            f"left out: {what}, {counted(len(lines), 'line')} ({line_ranges(lines)})"
            for what, lines in self._lost.items()
        ]

    def _add(self, line: GraphLine) -> None:
        if line.kind == "prior":
            self._add_prior(line)
        elif line.kind == "range":
            self._add_range(line)
        elif line.kind in {"pose", "point"} and not self._is_arm(line):
            self._add_vector(line)

    def _is_arm(self, line: GraphLine) -> bool:
        return self._docks is not None and line.names[1] in self._docks.place

    def _add_prior(self, line: GraphLine) -> None:
        name = line.names[0]
        if name not in self._order:
            self._lose("priors of docks", line)
        elif line is not self._anchor and _states_place(line, self._radius):
            self._add_fixes(self._order[name], line.vector, line.spread)

    def _add_range(self, line: GraphLine) -> None:
        places = [] if self._docks is None else [*map(self._docks.place.get, line.names)]
        (a, b), variance = line.names, line.spread[0, 0]
        if not any(places):
            self._measure(a, b, line.vector[0], variance)
        elif (first := places[0]) is not None and (second := places[1]) is not None:
            ends = sorted((self._order[pose], dock) for pose, dock in (first, second))
            self._contacts.append((*ends[0], *ends[1]))
        else:
            self._lose("ranges between a dock and another variable", line)

    def _add_vector(self, line: GraphLine) -> None:
        (a, b), anchor, turn = line.names, self._anchor, self._turns.get(line.names[0])
        if line.kind == "pose":
            self._lose("covariances of relative orientations, which are chained", line)
        length = float(np.linalg.norm(line.vector))
        is_firm = not anchor.turn_variance > _FIRM_TURN**2 and not np.isnan(anchor.wxyz).any()
        if a == anchor.names[0] and is_firm:
            matrix = Rotation.from_quat(anchor.wxyz, scalar_first=True).as_matrix()
            across = np.eye(3) * length**2 - np.outer(line.vector, line.vector)
            spread = line.spread + across * (np.nan_to_num(anchor.turn_variance))
            place = anchor.vector + matrix @ line.vector
            self._add_fixes(self._order[b], place, matrix @ spread @ matrix.T)
        elif length > 0.0 and turn is not None and turn.variance <= _FIRM_TURN**2:
            self._displace(a, b, line, turn)
        elif length > 0.0:
            along = line.vector / length
            self._measure(a, b, length, float(along @ line.spread @ along))
            self._lose(f"directions of relative translations from {_OPEN}", line)
        else:
            self._lose("relative translations of length 0", line)

    def _displace(self, a: str, b: str, line: GraphLine, turn: Turn) -> None:
        """Add the vector from b to a, or to b, in the frame of the later robot."""
        seen, across = turn.rotation.apply(line.vector), np.dot(line.vector, line.vector)
        later, other, sign = (b, a, -1.0) if self._order[b] > self._order[a] else (a, b, 1.0)
        vector = self._turns.get(later, _NOT_TURNED).rotation.inv().apply(sign * seen)
        # A turn moves the end along two of three axes.
        variance = float(np.trace(line.spread) + 2.0 * across * turn.variance) / 3.0
        ends = float(self._order[later]), float(self._order[other])
        self._displacements.append((*ends, *vector.tolist(), self._sd(variance)))

    def _measure(self, first: str, second: str, length: float, variance: float) -> None:
        later, earlier = sorted((self._order[first], self._order[second]), reverse=True)
        self._ranges.append((later, earlier, float(length), self._sd(variance), -1.0))

    def _add_fixes(self, robot: int, place: Reals, spread: Reals) -> None:
        """Add a fix along each axis of a covariance."""
        if robot == 0:
            return  # the anchor is known
        variances, axes = np.linalg.eigh(spread)
        for variance, axis in zip(variances, axes.T, strict=True):
            row = (robot, *axis.tolist(), float(axis @ place), self._sd(variance), -1.0)
            self._fixes.append(row)

    def _sd(self, variance: float) -> float:
        """Take a standard deviation within what a log may have."""
        least, most = (bound * self._radius for bound in _SD)
        return min(max(math.sqrt(max(variance, 0.0)), least), most)

    def _lose(self, what: str, line: GraphLine) -> None:
        self._lost.setdefault(what, []).append(line.line)
