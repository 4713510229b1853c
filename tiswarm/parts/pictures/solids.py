"""glTF and PLY: robots as solids with colors, and contacts as lines."""

from typing import Any

import numpy as np

from tiswarm.parts.pictures.scene import TRUE_SIZE, build_scene, capsule_normals, mesh_capsules
from tiswarm.records.sensing_log import SensingLog
from tiswarm.report.figure_style import ERROR_COLORS, colors_from_zero
from tiswarm.report.swarm_view import DrawnRobots, SwarmView

_SIDES = 10  # of a dock sphere's equator: a compromise of roundness and file size
_EDGE_GRAY = (51, 51, 51, 255)  # color of contacts: red, green, blue, opacity
_MATTE = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.7}}
_Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Turns our z axis into the y axis, which is up in glTF."""


def encode_gltf(view: SwarmView) -> dict[str, bytes]:
    """Encode structure, estimate and contacts as one file."""
    return {"case.glb": _gltf(_shapes(view, gamma=2.2), view.log)}


def encode_ply(view: SwarmView) -> dict[str, bytes]:
    """Encode structure, estimate and contacts, each as a file."""
    return {f"{name}.ply": _ply(shape, view.log) for name, shape in _shapes(view).items()}


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
