"""Hands a case of a run to other programs: as tables or as shapes in space."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tiswarm.compute.rotations import dock_offsets
from tiswarm.errors import EnvironmentTroubleError
from tiswarm.interop.files import write_gltf, write_ply
from tiswarm.interop.shapes import shapes_of
from tiswarm.records.atomic import write_bytes
from tiswarm.report.folder import choose_case, read_cases
from tiswarm.report.render.subjects import POSE, Subject, read_subject

Format = Literal["csv", "gltf", "parquet", "ply"]
Tell = Callable[[str], None]


def export_case(run: Path, form: Format, out: Path, case: str | None, tell: Tell) -> None:
    """Write structure, estimate and contacts of one case of a run.

    Args:
        run: The run folder.
        form: What to write.
        out: Folder for the files; made if need be.
        case: Name of the case; the first that is done if None.
        tell: Hears of each file.

    Raises:
        InputError: for a damaged run, or a case that is not there.
        EnvironmentTroubleError: where `out` cannot be made or a library is missing.
    """
    subject = read_subject(choose_case(read_cases(run), case, run))
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f"{out}: cannot be made: {error.strerror}; choose another --out"
        raise EnvironmentTroubleError(msg) from error
    if form == "gltf":
        write_gltf(shapes_of(subject), out / "case.glb")
        tell(str(out / "case.glb"))
    elif form == "ply":
        for shape in shapes_of(subject):
            write_ply(shape, out / f"{shape.name}.ply")
            tell(str(out / f"{shape.name}.ply"))
    else:
        for name, table in tables_of(subject).items():
            write_bytes(out / f"{name}.{form}", _encoded(table, form))
            tell(str(out / f"{name}.{form}"))


def tables_of(subject: Subject) -> dict[str, pd.DataFrame]:
    """Poses as `tiswarm import` reads them, and contacts with the place where docks meet."""
    log = subject.log
    i, a, j, b = log.contacts.T
    offsets = dock_offsets(subject.pose[:, 3:], subject.dock_offset_body)
    dock = subject.pose[:, None, :3] + offsets
    contacts = pd.DataFrame(
        {
            "robot": subject.robot[j],
            "dock": b,
            "other_robot": subject.robot[i],
            "other_dock": a,
        }
    )
    contacts[POSE[:3]] = (dock[i, a] + dock[j, b]) / 2.0
    return {
        "structure": _poses(subject, subject.pose),
        "estimate": _poses(subject, subject.estimated_pose).assign(error_R=subject.error),
        "contacts": contacts,
    }


def _poses(subject: Subject, pose: NDArray[np.float64]) -> pd.DataFrame:
    """Name, join index and pose of each robot."""
    table = pd.DataFrame({"robot": subject.robot, "join": np.arange(len(pose))})
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
