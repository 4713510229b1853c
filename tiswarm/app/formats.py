"""Formats of other programs: what plug-ins add, and the files of an export.

Solids and particles have float32 numbers, relative to the place of the anchor: files state it as
the translation of nodes (glTF), `comment origin` (PLY) and `log/origin` (GSD).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from tiswarm.base.progress import Progress
from tiswarm.base.registry import get, guarded, register, registered
from tiswarm.records import outputs
from tiswarm.report.swarm_view import SwarmView


class OwnFormat(NamedTuple):
    """A format that a plug-in registered."""

    file: str
    encode: Callable[[SwarmView], bytes]


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
        register("export_format", name, OwnFormat(f"case{suffix}", encode), encode)
        return encode

    return add


class OwnImport(NamedTuple):
    """A format to import that a plug-in registered."""

    suffix: str
    read: Callable[[Path], Any]


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
        register("import_format", name, OwnImport(suffix, read), read)
        return read

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
    if own := registered("export_format").get(form):
        file, encode = own.value
        files = {file: guarded(own.plugin, form, lambda: bytes(encode(view)))}
    else:
        files = get("export_format", form, "form")(replace(view, progress=progress))
    for path in outputs.write_folder(out, files, inputs, overwrite=overwrite):
        progress.info(str(path))
