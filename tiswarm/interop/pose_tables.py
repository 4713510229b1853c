"""CSV, Parquet, TUM and MCAP: poses and contacts as tables and messages."""

import io
from typing import Any

import numpy as np
import pandas as pd

from tiswarm.base.errors import EnvironmentTroubleError
from tiswarm.compute.math import dock_offsets
from tiswarm.records.mcap_file import SENSING, encode_messages
from tiswarm.records.sensing_file import log_entries
from tiswarm.report.swarm_view import POSE, SwarmView


def encode_csv(view: SwarmView) -> dict[str, bytes]:
    """Encode poses and contacts as comma-separated values."""
    return {
        f"{name}.csv": table.to_csv(index=False, lineterminator="\n").encode()
        for name, table in _tables(view).items()
    }


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
