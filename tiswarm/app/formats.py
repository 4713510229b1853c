"""Formats of other programs: what plug-ins add, and the files of an export.

Solids and particles have float32 numbers, relative to the place of the anchor: files state it as
the translation of nodes (glTF), `comment origin` (PLY) and `log/origin` (GSD).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from tiswarm.base.plugins import call_plugin
from tiswarm.base.progress import Progress
from tiswarm.base.registry import get, register
from tiswarm.records.outputs import NEW, Outputs
from tiswarm.report.swarm_view import SwarmView

if TYPE_CHECKING:
    from tiswarm.formats.poses import Assumptions, PoseTable

_Encode = TypeVar("_Encode", bound=Callable[[SwarmView], bytes])
_Read = TypeVar("_Read", bound=Callable[[Path], Any])


def export_format(name: str, suffix: str) -> Callable[[_Encode], _Encode]:
    """Register a function as a format to export to.

    The function takes a `tiswarm.report.swarm_view.SwarmView`, which has poses, errors and the log,
    and returns the bytes of the file `case` with a suffix.

    Args:
        name: Name of the format.
        suffix: End of the file's name, such as ".xyz".

    Raises:
        InputError: the name is taken.
    """

    def add(encode: _Encode) -> _Encode:
        encoder = _PluginEncoder(name=name, file=f"case{suffix}", encode=encode)
        register("export_format", name, encoder, encode)
        return encode

    return add


@dataclass(frozen=True, kw_only=True)
class _PluginEncoder:
    """Format of a plug-in, which exports one file."""

    name: str
    file: str
    """Name of the file."""

    encode: Callable[[SwarmView], bytes]

    def __call__(self, view: SwarmView) -> Mapping[str, bytes]:
        """Return the bytes of the file by its name."""
        encoded = call_plugin("export_format", self.name, lambda: bytes(self.encode(view)))
        return {self.file: encoded}


def import_format(name: str, suffix: str) -> Callable[[_Read], _Read]:
    """Register a function as a format to import poses from.

    The function takes the path of a file and returns a data frame, or a dictionary of columns, as a
    table of poses has them: `robot,x,y,z,qw,qx,qy,qz`, in motion with a column `time`.

    Args:
        name: Name of the format.
        suffix: End of the names of its files, such as ".xyz".

    Raises:
        InputError: the name is taken.
    """

    def add(read: _Read) -> _Read:
        def read_poses(path: Path, assumed: "Assumptions") -> "PoseTable | None":
            import pandas as pd  # noqa: PLC0415 - slow to import

            from tiswarm.formats.columns import Sheet, read_table  # noqa: PLC0415 - slow to import

            if not path.name.endswith(suffix):
                return None
            table = call_plugin("import_format", name, lambda: pd.DataFrame(read(path)))
            return read_table(path, assumed, Sheet(table.to_csv(index=False)))

        register("import_format", name, read_poses, read)
        return read

    return add


_CERTAIN = {
    "csv": "contacts.csv",
    "parquet": "contacts.parquet",
    "png": "contact-graph.png",
    "gsd": "{pose}.gsd",
    "ply": "{pose}.ply",
    "tum": "{pose}.tum",
    "gif": "growth.gif",
    "mp4": "growth.mp4",
    "webp": "growth.webp",
    "gltf": "case.glb",
    "mcap": "case.mcap",
    "mjcf": "case.xml",
    "pyfg": "case.pyfg",
    "wbt": "case.wbt",
}
"""A file that an export has in any case, by its format."""


def check_export(
    form: str, out: Path, outputs: Outputs, pose: Literal["estimate", "structure"] = "estimate"
) -> None:
    """Refuse an export that cannot be written, before what it is of takes long to compute.

    Args:
        form: Name of the format.
        out: Folder to write to.
        outputs: What may be written.
        pose: Poses that are known for certain: those of the estimate, or the true ones.

    Raises:
        InputError: there is no such format, or a file that the export has in any case is an input,
            or exists and is to stay.
    """
    value = get("export_format", form, "form")
    name = value.file if isinstance(value, _PluginEncoder) else _CERTAIN[form].format(pose=pose)
    outputs.check({"out": out / name})


def export_view(
    view: SwarmView,
    form: str,
    out: Path,
    progress: Progress,
    outputs: Outputs = NEW,
) -> None:
    """Write the structure, if the truth is known, the estimate and the contacts.

    Args:
        view: What to export.
        form: Name of the format.
        out: Folder to write to.
        progress: Receives progress reports.
        outputs: What may be written.

    Raises:
        InputError: there is no such format, the log of the view is damaged, or a file of the export
            is an input, or exists and is to stay.
        EnvironmentTroubleError: `out` cannot be made or a library is missing.
        PluginError: a format of a plug-in failed.
    """
    files = get("export_format", form, "form")(replace(view, progress=progress))
    for path in outputs.write_folder(out, files):
        progress.info(str(path))
