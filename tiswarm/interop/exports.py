"""Exports structures and estimates: as tables, solids in space, particles or a factor graph.

Solids and particles have float32 numbers, relative to the place of the anchor: files state it as
the translation of nodes (glTF), `comment origin` (PLY) and `log/origin` (GSD).
"""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tiswarm.base.errors import EnvironmentTroubleError
from tiswarm.base.params import AnyFormat
from tiswarm.base.progress import Progress
from tiswarm.compute.math import dock_offsets
from tiswarm.interop.factor_graph import encode_factor_graph
from tiswarm.interop.particles import encode_gsd
from tiswarm.records.io import make_folder, write_bytes
from tiswarm.records.mcap_file import SENSING, encode_messages
from tiswarm.records.sensing_file import log_entries
from tiswarm.records.sensing_log import SensingLog
from tiswarm.report.figure_style import ERROR_COLORS, colors_from_zero
from tiswarm.report.render.mesh import mesh_capsules
from tiswarm.report.render.scene import TRUE_SIZE, DrawnRobots, build_scene, capsule_normals
from tiswarm.report.swarm_view import POSE, SwarmView

_SIDES = 10  # of a dock sphere's equator: a compromise of roundness and file size
_EDGE_GRAY = (51, 51, 51, 255)  # color of contacts: red, green, blue, opacity
_MATTE = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.7}}
_Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Turns our z axis into the y axis, which is up in glTF."""


def export_view(view: SwarmView, form: AnyFormat, out: Path, progress: Progress) -> None:
    """Write the structure, if the truth is known, the estimate and the contacts.

    Raises:
        InputError: the log of the view is damaged.
        EnvironmentTroubleError: `out` cannot be made or a library is missing.
    """
    files: dict[str, bytes] = {}
    if form == "gltf":
        files["case.glb"] = _gltf(_shapes(view, gamma=2.2), view.log)
    elif form == "ply":
        files = {f"{name}.ply": _ply(s, view.log) for name, s in _shapes(view).items()}
    elif form == "gsd":
        files = encode_gsd(view)
    elif form == "mcap":
        files["case.mcap"] = _messages(view)
    elif form == "pyfg":
        files["case.pyfg"] = encode_factor_graph(view)
    elif form == "tum":
        files = {f"{name}.tum": _trajectory(table) for name, table in _pose_tables(view).items()}
    else:
        files = {f"{name}.{form}": _encoded(t, form) for name, t in _tables(view).items()}
    make_folder(out)
    for file, data in files.items():
        write_bytes(out / file, data)
        progress.info(str(out / file))


def _shapes(view: SwarmView, *, gamma: float = 1.0) -> dict[str, Any]:
    """Build trimesh solids of structure and estimate, and a path of the contacts if there are any.

    Robots of the structure are colored by join, those of the estimate by error or, where the truth
    is unknown, by standard deviation. Contacts connect the centers of robots. The exponent `gamma`
    = 2.2 turns sRGB into linear colors for glTF. Lengths are in the unit of the log, from the
    anchor.
    """
    from trimesh.path import Path3D, entities  # noqa: PLC0415 - slow to import

    doubt, _ = colors_from_zero(view.error if view.has_truth else view.sd, ERROR_COLORS)
    estimated = view.robots(view.from_origin(view.estimated_pose), doubt, TRUE_SIZE)
    shapes = {"estimate": _solid(estimated, gamma)}
    if view.has_truth:
        structure = view.robots(view.from_origin(view.pose), view.color_by_join, TRUE_SIZE)
        shapes = {"structure": _solid(structure, gamma), **shapes}
    center, pairs = view.from_origin(view.best_pose)[:, :3], view.log.contacts[:, [0, 2]]
    line: Any = entities.Line
    lines = [line(pair) for pair in pairs[np.isfinite(center[pairs]).all(axis=(1, 2))]]
    gray = np.tile(np.array(_EDGE_GRAY, np.uint8), (len(lines), 1))
    if lines:
        place = np.nan_to_num(center)  # no line ends where the place is unknown
        shapes["contacts"] = Path3D(lines, place, colors=gray, process=False)
    for shape in shapes.values():
        shape.apply_scale(view.log.dock_radius)
    return shapes


def _solid(robots: DrawnRobots, gamma: float) -> Any:  # noqa: ANN401 - Trimesh, imported late
    """Mesh robots with colors and normals."""
    from trimesh import Trimesh  # noqa: PLC0415 - slow to import

    scene = build_scene(robots, None)
    mesh = mesh_capsules(scene, sides=_SIDES)
    return Trimesh(
        mesh.point,
        mesh.triangle,
        vertex_normals=capsule_normals(scene, mesh.point_capsule, mesh.point),
        vertex_colors=np.round(255.0 * scene.color[mesh.point_capsule] ** gamma).astype(np.uint8),
        process=False,
    )


def _ply(shape: Any, log: SensingLog) -> bytes:  # noqa: ANN401 - of trimesh, imported late
    """Encode a shape as PLY, whose comments state the unit and where the log has its origin."""
    normals = {"vertex_normal": True} if hasattr(shape, "vertex_normals") else {}
    kind, encoding, rest = shape.export(file_type="ply", **normals).split(b"\n", 2)
    origin = " ".join(map(repr, log.anchor_position.tolist()))
    comments = f"comment length_unit {log.length_unit}\ncomment origin {origin}"
    return b"\n".join([kind, encoding, comments.encode(), rest])


def _gltf(shapes: dict[str, Any], log: SensingLog) -> bytes:
    """Encode shapes as the nodes of one binary glTF file, y up, moved to the anchor."""
    from trimesh import Scene  # noqa: PLC0415 - slow to import

    scene = Scene(metadata={"length_unit": log.length_unit})
    place = _Y_UP.astype(np.float64)
    place[:3, 3] = place[:3, :3] @ log.anchor_position
    for name, shape in shapes.items():
        scene.add_geometry(shape, node_name=name, geom_name=name, transform=place)

    def add_matte(tree: dict[str, Any]) -> None:
        tree["materials"] = [_MATTE]  # the default of glTF is metal
        for mesh in tree["meshes"]:
            mesh["primitives"][0]["material"] = 0

    export: Any = scene.export
    data: bytes = export(file_type="glb", include_normals=True, tree_postprocessor=add_matte)
    return data


def _tables(view: SwarmView) -> dict[str, pd.DataFrame]:
    """Tabulate poses in the format of `tiswarm import`, and contacts with their positions."""
    radius, unit = view.log.dock_radius, view.log.length_unit
    i, a, j, b = view.log.contacts.T
    offsets = dock_offsets(view.best_pose[:, 3:], view.dock_offset_body)
    dock = view.best_pose[:, None, :3] + offsets
    contacts = pd.DataFrame(
        {"robot": view.robot[j], "dock": b, "other_robot": view.robot[i], "other_dock": a}
    )
    contacts[_places(unit)] = (dock[i, a] + dock[j, b]) / 2.0 * radius
    tables = {"contacts": contacts, **_pose_tables(view)}
    for name, values in [("error", view.error), ("sd", view.sd)]:
        if np.isfinite(values).any():
            tables["estimate"][f"{name}_{unit}"] = values * radius
    return tables


def _pose_tables(view: SwarmView) -> dict[str, pd.DataFrame]:
    """Tabulate the poses of the structure, if the truth is known, and of the estimate."""
    places = _places(view.log.length_unit)
    poses = {"structure": view.pose} if view.has_truth else {}
    tables = {}
    for name, pose in {**poses, "estimate": view.estimated_pose}.items():
        table = pd.DataFrame({"robot": view.robot, "join": np.arange(len(view.robot))})
        table[places], table[POSE[3:]] = pose[:, :3] * view.log.dock_radius, pose[:, 3:]
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


def _messages(view: SwarmView) -> bytes:
    """Encode the log and the poses as MCAP. Robots whose pose is unknown have no message."""
    topics: dict[str, Any] = {
        SENSING: ((max(0, line - 1), entry) for line, entry in enumerate(log_entries(view.log)))
    }
    for name, table in _pose_tables(view).items():
        topics[name] = [(row["join"], row) for row in table.dropna().to_dict("records")]
    return encode_messages(topics)


def _encoded(table: pd.DataFrame, form: AnyFormat) -> bytes:
    if form == "csv":
        return table.to_csv(index=False, lineterminator="\n").encode()
    try:
        from pyarrow import Table, parquet  # noqa: PLC0415 - an extra
    except ImportError as error:
        problem = "parquet needs the library pyarrow; pip install 'tiswarm[parquet]'"
        raise EnvironmentTroubleError(problem) from error
    stream = io.BytesIO()
    parquet.write_table(Table.from_pandas(table, preserve_index=False), stream)
    return stream.getvalue()
