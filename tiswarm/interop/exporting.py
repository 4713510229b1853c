"""Hands a case of a run to other programs: as tables or as shapes in space."""

import io
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tiswarm.compute.math import dock_offsets
from tiswarm.errors import EnvironmentTroubleError
from tiswarm.interop.files import Shape, write_gltf, write_ply
from tiswarm.progress import Progress
from tiswarm.records.io import make_folder, write_bytes
from tiswarm.report.figure_style import ERROR_COLORS, colors_along
from tiswarm.report.folder import choose_case, read_cases
from tiswarm.report.render.mesh import mesh_capsules
from tiswarm.report.render.pictures import POSE, TRUE_SIZE, CaseView, read_case_view
from tiswarm.report.render.scene import Robots, build_scene

Format = Literal["csv", "gltf", "parquet", "ply"]
SIDES = 10
"""Sides of a dock sphere's equator: round enough, and files stay small."""

EDGE_GRAY = 0.2


def export_case(run: Path, form: Format, out: Path, case: str | None, progress: Progress) -> None:
    """Write structure, estimate and contacts of one case of a run.

    Raises:
        InputError: for a damaged run, or a case that is not there.
        EnvironmentTroubleError: where `out` cannot be made or a library is missing.
    """
    view = read_case_view(choose_case(read_cases(run), case, run))
    make_folder(out)
    if form == "gltf":
        write_gltf(shapes_of(view), out / "case.glb")
        progress.info(str(out / "case.glb"))
    elif form == "ply":
        for shape in shapes_of(view):
            write_ply(shape, out / f"{shape.name}.ply")
            progress.info(str(out / f"{shape.name}.ply"))
    else:
        for name, table in tables_of(view).items():
            write_bytes(out / f"{name}.{form}", _encoded(table, form))
            progress.info(str(out / f"{name}.{form}"))


def shapes_of(view: CaseView) -> list[Shape]:
    """The structure, its estimate colored by error, and its contacts between true centers."""
    worst = max(np.nanmax(view.error, initial=0.0), 1e-9)
    by_error = colors_along(np.nan_to_num(view.error) / worst, ERROR_COLORS)
    pairs = view.log.contacts[:, [0, 2]].astype(np.uint32)
    center = view.pose[:, :3].astype(np.float32)
    return [
        _solid("structure", view.robots(view.pose, view.color_by_join, TRUE_SIZE)),
        _solid("estimate", view.robots(view.estimated_pose, by_error, TRUE_SIZE)),
        Shape(
            name="contacts",
            point=center,
            normal=None,
            color=np.full((len(center), 3), EDGE_GRAY, np.float32),
            index=pairs,
        ),
    ]


def _solid(name: str, robots: Robots) -> Shape:
    """Mesh robots; a point's normal leads away from the axis of its capsule."""
    scene = build_scene([robots], None)
    mesh = mesh_capsules(scene, sides=SIDES)
    start, end = scene.start[mesh.point_capsule], scene.end[mesh.point_capsule]
    span = end - start
    length = np.maximum(np.sum(span**2, axis=1), 1e-12)
    along = np.clip(np.sum((mesh.point - start) * span, axis=1) / length, 0.0, 1.0)
    away = mesh.point - start - along[:, None] * span
    return Shape(
        name=name,
        point=mesh.point,
        normal=(away / np.linalg.norm(away, axis=1, keepdims=True)).astype(np.float32),
        color=scene.color[mesh.point_capsule],
        index=mesh.triangle.astype(np.uint32),
    )


def tables_of(view: CaseView) -> dict[str, pd.DataFrame]:
    """Poses as `tiswarm import` reads them, and contacts with the place where docks meet."""
    log = view.log
    i, a, j, b = log.contacts.T
    offsets = dock_offsets(view.pose[:, 3:], view.dock_offset_body)
    dock = view.pose[:, None, :3] + offsets
    contacts = pd.DataFrame(
        {"robot": view.robot[j], "dock": b, "other_robot": view.robot[i], "other_dock": a}
    )
    contacts[POSE[:3]] = (dock[i, a] + dock[j, b]) / 2.0
    return {
        "structure": _poses(view, view.pose),
        "estimate": _poses(view, view.estimated_pose).assign(error_R=view.error),
        "contacts": contacts,
    }


def _poses(view: CaseView, pose: NDArray[np.float64]) -> pd.DataFrame:
    """Name, join index and pose of each robot."""
    table = pd.DataFrame({"robot": view.robot, "join": np.arange(len(pose))})
    table[POSE] = pose
    return table


def _encoded(table: pd.DataFrame, form: Format) -> bytes:
    if form == "csv":
        return table.to_csv(index=False, lineterminator="\n").encode()
    try:
        from pyarrow import Table, parquet  # noqa: PLC0415 - an extra
    except ImportError as error:
        msg = "parquet needs the library pyarrow; pip install 'tiswarm[parquet]'"
        raise EnvironmentTroubleError(msg) from error
    stream = io.BytesIO()
    parquet.write_table(Table.from_pandas(table, preserve_index=False), stream)
    return stream.getvalue()
