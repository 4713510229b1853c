"""Structures and estimates as tables (CSV, Parquet, TUM), messages (MCAP), particles and graphs.

GSD, the format of HOOMD-blue, has robots as rigid unions of spheres, and contacts as bonds. OVITO
shows such files, freud analyzes them. The schema is `hoomd`, with shapes as in
https://gsd.readthedocs.io/en/stable/shapes.html. A frame for each join shows the growth; `step`
counts the robots that have joined. GSD has float32 numbers: positions are relative to the anchor,
whose place is the logged quantity `origin`.

PyFG, the text format of range-aided SLAM, has a log and its estimate as a factor graph.
PyFactorGraph writes and reads it (github.com/MarineRoboticsGroup/PyFactorGraph, `io/pyfg_text.py`),
and the solver CORA reads it (Papalia et al., "Certifiably correct range-aided SLAM", T-RO 2024).
A line is a variable or a measurement; covariances are upper triangles, row by row:

    VERTEX_SE3:QUAT time name x y z qx qy qz qw
    VERTEX_XYZ name x y z
    VERTEX_SE3:QUAT:PRIOR time name x y z qx qy qz qw covariance(6 x 6)
    EDGE_SE3_XYZ time pose point x y z covariance(3 x 3)
    EDGE_RANGE time name name distance variance

Robots are the poses A0, A1, ... in join order, docks the points L0, L1, ...: dock d of robot i of
robots with D docks is point D i + d. Variables start at the truth if it is known, else at the
estimate. The time is the join index.
"""

import io
import re
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import EnvironmentTroubleError
from tiswarm.compute.math import dock_offsets
from tiswarm.measurements.odometry import ASSUMED
from tiswarm.records.frames import csv_text
from tiswarm.records.mcap import SENSING, encode_messages
from tiswarm.records.messages import exact_text
from tiswarm.records.sensing_file import log_entries
from tiswarm.records.sensing_log import SensingLog
from tiswarm.report.swarm_view import POSE, Coloring, SwarmView


def encode_csv(view: SwarmView) -> dict[str, bytes]:
    """Encode poses and contacts as comma-separated values."""
    return {f"{name}.csv": csv_text(table).encode() for name, table in _tables(view).items()}


def encode_parquet(view: SwarmView) -> dict[str, bytes]:
    """Encode poses and contacts as Parquet.

    Raises:
        EnvironmentTroubleError: the library pyarrow is not installed.
    """
    try:
        from pyarrow import Table, parquet  # noqa: PLC0415 - an extra
    except ImportError as error:
        problem = "parquet needs the library pyarrow; pip install 'tiswarm[parquet]'"
        raise EnvironmentTroubleError(problem) from error
    files = {}
    for name, table in _tables(view).items():
        stream = io.BytesIO()
        parquet.write_table(Table.from_pandas(table, preserve_index=False), stream)
        files[f"{name}.parquet"] = stream.getvalue()
    return files


def encode_tum(view: SwarmView) -> dict[str, bytes]:
    """Encode poses as TUM RGB-D does."""
    return {f"{name}.tum": _trajectory(table) for name, table in _pose_tables(view).items()}


def encode_mcap(view: SwarmView) -> dict[str, bytes]:
    """Encode the log and the poses. Robots whose pose is unknown have no message."""
    topics: dict[str, Any] = {
        SENSING: ((max(0, line - 1), entry) for line, entry in enumerate(log_entries(view.log)))
    }
    for name, table in _pose_tables(view).items():
        topics[name] = [(row["join"], row) for row in table.dropna().to_dict("records")]
    return {"case.mcap": encode_messages(topics)}


def _tables(view: SwarmView) -> dict[str, pd.DataFrame]:
    """Tabulate poses in the format of `tiswarm import`, and contacts with their positions.

    Where docks have a strength, the loads of contacts have a table, too.
    """
    radius = view.log.dock_radius
    unit = view.log.length_unit
    i, a, j, b = view.log.contacts.T
    pose = view.best_pose
    is_known = np.isfinite(pose).all(axis=1)
    dock = np.full((len(pose), len(view.dock_offset_body), 3), np.nan)  # of robots that left
    dock[is_known] = pose[is_known, None, :3] + dock_offsets(
        pose[is_known, 3:], view.dock_offset_body
    )
    contacts = pd.DataFrame(
        {"robot": view.robot[j], "dock": b, "other_robot": view.robot[i], "other_dock": a}
    )
    contacts[_places(unit)] = (dock[i, a] + dock[j, b]) / 2.0 * radius
    tables = {"contacts": contacts, **_pose_tables(view)}
    for name, values in [("error", view.error), ("sd", view.sd)]:
        if np.isfinite(values).any():
            tables["estimate"][f"{name}_{unit}"] = values * radius
    for name in view.poses:
        tables[name] = tables[name].assign(
            **{coloring.title: _cells(coloring) for coloring in view.user_colorings}
        )
    loads = view.read_loads()
    return tables if loads is None else tables | {"loads": loads}


def _cells(coloring: Coloring) -> Any:  # noqa: ANN401 - a column
    """Return numbers, or words, empty where unknown."""
    if not coloring.words:
        return coloring.value
    return ["" if np.isnan(number) else coloring.words[int(number)] for number in coloring.value]


def _pose_tables(view: SwarmView) -> dict[str, pd.DataFrame]:
    """Tabulate the poses of the structure and of the estimate, as far as they are known."""
    places = _places(view.log.length_unit)
    tables = {}
    for name, pose in view.poses.items():
        table = pd.DataFrame({"robot": view.robot, "join": np.arange(len(view.robot))})
        table[places] = pose[:, :3] * view.log.dock_radius
        table[POSE[3:]] = pose[:, 3:]
        tables[name] = table
    return tables


def _places(unit: str) -> list[str]:
    return [f"{axis}_{unit}" for axis in "xyz"]


def _trajectory(poses: pd.DataFrame) -> bytes:
    """Encode poses as TUM RGB-D does, so that evo reads them: time x y z qx qy qz qw.

    The time is the join index. Robots whose pose is unknown have no line.
    """
    table = poses[[*poses.columns[1:5], "qx", "qy", "qz", "qw"]].dropna()
    return table.to_csv(index=False, header=False, sep=" ", lineterminator="\n").encode()


_MOST_FRAMES = 200
"""Frames of a file; their size grows with frames x robots."""


def gsd_library() -> Any:  # noqa: ANN401 - no types
    """Import the module `gsd.hoomd`.

    Raises:
        EnvironmentTroubleError: the library gsd is not installed.
    """
    try:
        import gsd.hoomd  # noqa: PLC0415 - an extra
    except ImportError as error:
        problem = "GSD needs the library gsd; pip install 'tiswarm[gsd]'"
        raise EnvironmentTroubleError(problem) from error
    return gsd.hoomd


def encode_gsd(view: SwarmView) -> dict[str, bytes]:
    """Encode the structure and the estimate, as far as they are known: bytes by name of file.

    Lengths are in the unit of the log. Particles have the logged quantities `robot` and, where
    known, `error`, `sd` and values of the user, words as their numbers. Robots whose pose is
    unknown are left out.

    Raises:
        EnvironmentTroubleError: the library gsd is not installed.
    """
    hoomd = gsd_library()
    files = {}
    with TemporaryDirectory() as folder:  # the library writes to named files only
        for name, pose in view.poses.items():
            path = Path(folder) / f"{name}.gsd"
            with hoomd.open(path, mode="w") as file:
                _append_frames(file, view, pose)
            files[path.name] = path.read_bytes()
    return files


def _append_frames(file: Any, view: SwarmView, pose: Reals) -> None:  # noqa: ANN401 - no types
    """Append a frame for each join, or for `_MOST_FRAMES` of them."""
    from gsd.hoomd import Frame  # noqa: PLC0415 - an extra

    unit = view.log.dock_radius
    shown = np.flatnonzero(np.isfinite(pose).all(axis=1))
    position = unit * view.from_origin(pose)[shown, :3]
    logged = {"robot": view.robot} | {
        name: unit * values
        for name, values in [("error", view.error), ("sd", view.sd)]
        if np.isfinite(values).any()
    }
    logged |= {
        re.sub(r"\W+", "_", coloring.label): coloring.value for coloring in view.user_colorings
    }
    shape = {
        "type": "SphereUnion",
        "centers": (unit * view.dock_offset_body).tolist(),
        "diameters": [2.0 * unit] * len(view.dock_offset_body),
    }
    bonds = _bonds(view, shown)
    reach = unit * (1.0 + np.linalg.norm(view.dock_offset_body, axis=1).max())
    frames = min(len(shown), _MOST_FRAMES)
    for count in np.unique(np.linspace(1, len(shown), frames).round().astype(int)).tolist():
        frame = Frame()
        frame.configuration.step = int(shown[count - 1]) + 1
        # Positions have to be inside a box about the origin; no axis is periodic in fact.
        frame.configuration.box = [*(2.0 * (np.abs(position).max(axis=0) + reach)), 0.0, 0.0, 0.0]
        frame.particles.N = count
        frame.particles.types = ["robot"]
        frame.particles.type_shapes = [shape]
        frame.particles.position = position[:count]
        frame.particles.orientation = pose[shown[:count], 3:]
        frame.particles.diameter = np.full(count, 2.0 * reach)
        shown_bonds = bonds[bonds.max(axis=1, initial=0) < count]
        frame.bonds.N = len(shown_bonds)
        frame.bonds.types = ["contact"]
        frame.bonds.group = shown_bonds
        frame.log = {f"particles/{name}": values[shown[:count]] for name, values in logged.items()}
        frame.log["origin"] = view.log.anchor_position
        file.append(frame)


def _bonds(view: SwarmView, shown: Ints) -> Ints:
    """Pairs of robots in contact, each once, by their places among the known ones."""
    row_of = np.full(len(view.robot), -1)
    row_of[shown] = np.arange(len(shown))
    pairs: Ints = np.unique(row_of[view.log.contacts[:, [0, 2]]], axis=0)
    shown_pairs: Ints = pairs[(pairs >= 0).all(axis=1)]
    return shown_pairs


_EXACT_SD = 1e-3
"""Standard deviation [dock radii] of arms and of contacts, which have no noise in our model."""

_LEAST_ANGLE_SD = 1e-4
"""Least standard deviation of an orientation [rad]; the format has no exact measurements."""

_UNKNOWN_SD = 1e6
"""Standard deviation of the unknown position in a prior of orientation [dock radii]."""


def encode_pyfg(view: SwarmView) -> dict[str, bytes]:
    """Encode the robots whose pose is known, and what the log says of them, in its unit.

    Contacts are ranges of two dock radii between docks; `ranges` of the log are ranges between
    robots; each sensed orientation is a prior, and the anchor's has its position. The format has
    no measurements of heights, fixes and flips: these are left out. Nor has it shared errors: the
    variance of a range includes that of its source.
    """
    return {"case.pyfg": "".join(f"{line}\n" for line in _lines(view)).encode()}


def _lines(view: SwarmView) -> Iterator[str]:
    """Yield the lines of a factor graph: variables first, then measurements."""
    is_known = np.asarray(np.isfinite(view.best_pose).all(axis=1))
    yield from _variables(view, is_known)
    yield from _orientation_priors(view.log, is_known)
    yield from _measurements(view.log, is_known)


def _variables(view: SwarmView, is_known: Bools) -> Iterator[str]:
    """Yield robots and docks, where they start."""
    unit = view.log.dock_radius
    pose = view.best_pose
    robots = np.flatnonzero(is_known).tolist()
    docks = len(view.log.dock_offset_body)
    center = pose[is_known, :3]
    dock = unit * (center[:, None] + dock_offsets(pose[is_known, 3:], view.dock_offset_body))
    for i in robots:
        position = exact_text(unit * pose[i, :3])
        yield f"VERTEX_SE3:QUAT {i} A{i} {position} {exact_text(_xyzw(pose[i, 3:]))}"
    for k, i in enumerate(robots):
        for d in range(docks):
            yield f"VERTEX_XYZ L{docks * i + d} {exact_text(dock[k, d])}"


def _orientation_priors(log: SensingLog, is_known: Bools) -> Iterator[str]:
    """Yield a prior for each sensed orientation; that of the anchor has its position, too."""
    unit = log.dock_radius
    noise = log.noise or ASSUMED
    angle = np.radians([noise.tilt_deg, noise.tilt_deg, noise.yaw_deg])
    turn_variance = np.maximum(angle, _LEAST_ANGLE_SD) ** 2
    is_sensed = np.isfinite(log.orientation_wxyz).all(axis=1)
    for i in np.flatnonzero(is_known & is_sensed).tolist():
        position_sd = _EXACT_SD if i == 0 else _UNKNOWN_SD
        position_variance = (position_sd * unit) ** 2
        position = exact_text(log.anchor_position)
        turn = exact_text(_xyzw(log.orientation_wxyz[i]))
        covariance = _triangle(np.diag([position_variance] * 3 + turn_variance.tolist()))
        yield f"VERTEX_SE3:QUAT:PRIOR {i} A{i} {position} {turn} {covariance}"


def _measurements(log: SensingLog, is_known: Bools) -> Iterator[str]:
    """Yield arms from robots to docks, contacts of docks, and ranges between robots."""
    docks = len(log.dock_offset_body)
    exact = (_EXACT_SD * log.dock_radius) ** 2
    arm = _triangle(exact * np.eye(3))
    for i in np.flatnonzero(is_known).tolist():
        for d, offset in enumerate(log.dock_offset_body):
            yield f"EDGE_SE3_XYZ {i} A{i} L{docks * i + d} {exact_text(offset)} {arm}"
    for i, a, j, b in log.contacts[is_known[log.contacts[:, [0, 2]]].all(axis=1)].tolist():
        yield f"EDGE_RANGE {j} L{docks * i + a} L{docks * j + b} {log.spacing!r} {exact!r}"
    source_sd = np.append(log.source_sd, 0.0)  # a source of -1 is none
    for i, j, distance, sd, source in log.ranges.tolist():
        if is_known[int(i)] and is_known[int(j)]:
            variance = sd**2 + float(source_sd[int(source)]) ** 2
            yield f"EDGE_RANGE {int(i)} A{int(i)} A{int(j)} {distance!r} {variance!r}"


def _xyzw(quaternion: Reals) -> Reals:
    """Put the real part last."""
    return np.roll(quaternion, -1)


def _triangle(covariance: Reals) -> str:
    return exact_text(covariance[np.triu_indices(len(covariance))])
