"""Exports structures and estimates; each format is a function of its own.

Solids and particles have float32 numbers, relative to the place of the anchor: files state it as
the translation of nodes (glTF), `comment origin` (PLY) and `log/origin` (GSD).
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

from tiswarm.base.errors import InputError
from tiswarm.base.parts import load
from tiswarm.base.plugins import guarded, register, registered
from tiswarm.base.progress import Progress
from tiswarm.records import outputs
from tiswarm.records.messages import did_you_mean
from tiswarm.report.swarm_view import SwarmView

_KIND = "format"


class OwnFormat(NamedTuple):
    """A format that a plug-in registered."""

    file: str
    encode: Callable[[SwarmView], bytes]


FORMATS: dict[str, str] = {
    "csv": "tiswarm.parts.formats.exports:encode_csv",
    "gltf": "tiswarm.parts.pictures.solids:encode_gltf",
    "gsd": "tiswarm.parts.formats.exports:encode_gsd",
    "mcap": "tiswarm.parts.formats.exports:encode_mcap",
    "parquet": "tiswarm.parts.formats.exports:encode_parquet",
    "ply": "tiswarm.parts.pictures.solids:encode_ply",
    "pyfg": "tiswarm.parts.formats.exports:encode_pyfg",
    "tum": "tiswarm.parts.formats.exports:encode_tum",
}
"""By name of a format, a function of a view that returns bytes by name of file."""

_Encode = TypeVar("_Encode", bound=Callable[[SwarmView], bytes])


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
    if name in FORMATS:
        raise InputError(f"format {name} is taken by tiswarm itself; choose another name")

    def add(encode: _Encode) -> _Encode:
        register(_KIND, name, OwnFormat(f"case{suffix}", encode), encode)
        return encode

    return add


def export_view(
    view: SwarmView,
    form: str,
    out: Path,
    progress: Progress,
    *,
    inputs: Sequence[object] = (),
    overwrite: bool = False,
) -> None:
    """Write the structure, if the truth is known, the estimate and the contacts.

    Args:
        view: What to export.
        form: Name of the format.
        out: Folder to write to.
        progress: Receives progress reports.
        inputs: Files and folders that were read, which no file replaces.
        overwrite: Whether to replace files that no tiswarm command wrote.

    Raises:
        InputError: there is no such format, the log of the view is damaged, or a file of the export
            would replace another one.
        EnvironmentTroubleError: `out` cannot be made or a library is missing.
        PluginError: a format of a plug-in failed.
    """
    own = registered(_KIND)
    if form in FORMATS:
        files = load(FORMATS[form], f"format {form}")(view)
    elif form in own:
        file, encode = own[form].value
        files = {file: guarded(own[form].plugin, form, lambda: bytes(encode(view)))}
    else:
        names = (*FORMATS, *own)
        problem = did_you_mean(form, names) or f"; use {', '.join(names)}"
        problem = f"there is no format {form}{problem}"
        raise InputError(problem, argument="form")
    for path in outputs.write_folder(out, files, inputs, overwrite=overwrite):
        progress.info(str(path))
