"""Exports structures and estimates; each format is a function of its own.

Solids and particles have float32 numbers, relative to the place of the anchor: files state it as
the translation of nodes (glTF), `comment origin` (PLY) and `log/origin` (GSD).
"""

from pathlib import Path

from tiswarm.base.params import AnyFormat
from tiswarm.base.parts import load
from tiswarm.base.progress import Progress
from tiswarm.records.io import make_folder, write_bytes
from tiswarm.report.swarm_view import SwarmView

FORMATS: dict[str, str] = {
    "csv": "tiswarm.interop.pose_tables:encode_csv",
    "gltf": "tiswarm.interop.solids:encode_gltf",
    "gsd": "tiswarm.interop.particles:encode_gsd",
    "mcap": "tiswarm.interop.pose_tables:encode_mcap",
    "parquet": "tiswarm.interop.pose_tables:encode_parquet",
    "ply": "tiswarm.interop.solids:encode_ply",
    "pyfg": "tiswarm.interop.factor_graph:encode_pyfg",
    "tum": "tiswarm.interop.pose_tables:encode_tum",
}
"""By name of a format, a function of a view that returns bytes by name of file."""


def export_view(view: SwarmView, form: AnyFormat, out: Path, progress: Progress) -> None:
    """Write the structure, if the truth is known, the estimate and the contacts.

    Raises:
        InputError: the log of the view is damaged.
        EnvironmentTroubleError: `out` cannot be made or a library is missing.
    """
    files = load(FORMATS[form], f"format {form}")(view)
    make_folder(out)
    for file, data in files.items():
        write_bytes(out / file, data)
        progress.info(str(out / file))
