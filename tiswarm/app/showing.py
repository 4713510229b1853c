"""Shows and exports what can be shown: a run or its folder, or a log or its file."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from tiswarm.app.logs import Log, Truth, open_log
from tiswarm.app.results import Figures, File, PageFile, Run, as_path, open_run
from tiswarm.base.errors import InputError
from tiswarm.base.params import AnyMovie
from tiswarm.base.parts import load_plugins
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

Source = Run | SensingLog | File
"""What can be shown: a run or its folder, or a log or its file."""


def open_source(
    source: Source,
    *,
    of_log: Mapping[str, object] = MappingProxyType({}),
    of_run: Mapping[str, object] = MappingProxyType({}),
) -> Run | Log:
    """Open a run or a log, unless it is open.

    Args:
        source: Run or its folder, or a log or its file.
        of_log: Arguments by name that only a log takes; None where they are not given.
        of_run: Arguments by name that only a run takes.

    Raises:
        InputError: the source does not take an argument, is not the folder of a run, or cannot be
            read.
    """
    if isinstance(source, Run):
        _refuse("a run has its own", of_log)
        return source
    if not isinstance(source, SensingLog) and as_path(source, "source").is_dir():
        _refuse("a run has its own", of_log)
        return open_run(source)
    _refuse("a log is no run", of_run)
    return open_log(source)


def view(
    source: Source,
    estimate: Estimate | File | None = None,
    truth: Truth = None,
    *,
    out: File | None = None,
    overwrite: bool = False,
    quiet: bool = True,
) -> PageFile:
    """Show an estimate on a page with a 3D view, its uncertainty and what the log leaves open.

    Args:
        source: Sensing log or its file, or a run or its folder.
        estimate: Estimate of a log, or its table; `joint` localizes the log if None.
        truth: True positions of a log, or their table, if there are any.
        out: Page to write for a log; `view.html` if None.
        overwrite: Whether to replace files that no tiswarm command wrote.
        quiet: Whether to hide progress.

    Returns:
        The page, which a notebook shows; that of a run is its `report.html`.

    Raises:
        InputError: a file is malformed, or a table has other robots than the log.
    """
    of_log = {"estimate": estimate, "truth": truth, "out": out}
    shown = open_source(source, of_log=of_log)
    if isinstance(shown, Run):
        return shown.view(quiet=quiet)
    page = out or "view.html"
    return shown.view(estimate, truth, out=page, overwrite=overwrite, quiet=quiet)


def render(
    source: Source,
    estimate: Estimate | File | None = None,
    truth: Truth = None,
    *,
    renderer: str | None = None,
    case: str | None = None,
    movie: AnyMovie | None = None,
    out: File | None = None,
    overwrite: bool = False,
    quiet: bool = False,
) -> Figures:
    """Draw 3D pictures of a run, which its report.html shows too, or of a log and its estimate.

    Args:
        source: Run or its folder, or a sensing log or its file.
        estimate: Estimate of a log, or its table; `joint` localizes the log if None.
        truth: True positions of a log, or their table, if there are any.
        renderer: "open3d" or "taichi"; the first that works if None.
        case: Case of a run; the largest if None.
        movie: File format of an animation of a run's growth; none if None.
        out: Folder for pictures of a log; `renders` if None.
        overwrite: Whether to replace files that no tiswarm command wrote.
        quiet: Whether to hide progress.

    Returns:
        Figures and renders of the run, or pictures of the log, by name.
    """
    of_log = {"estimate": estimate, "truth": truth, "out": out}
    shown = open_source(source, of_log=of_log, of_run={"case": case, "movie": movie})
    if isinstance(shown, Run):
        return shown.render(renderer=renderer, case=case, movie=movie, quiet=quiet)
    return shown.render(
        estimate, truth,
        renderer=renderer, out=out or "renders", overwrite=overwrite, quiet=quiet,
    )  # fmt: skip


def export(
    source: Source,
    form: str = "gltf",
    estimate: Estimate | File | None = None,
    truth: Truth = None,
    *,
    out: File | None = None,
    case: str | None = None,
    plugins: Sequence[File] = (),
    overwrite: bool = False,
    quiet: bool = False,
) -> Path:
    """Export structure, contacts and estimate of a case, or of a log, for other programs.

    Args:
        source: Run or its folder, or a sensing log or its file.
        form: File format.
        estimate: Estimate of a log, or its table; `joint` localizes the log if None.
        truth: True positions of a log, or their table, if there are any.
        out: Folder to write to; `export`, in the run's folder if there is one, if None.
        case: Case of a run; the largest if None.
        plugins: Python files that register formats, see `tiswarm.export_format`.
        overwrite: Whether to replace files that no tiswarm command wrote.
        quiet: Whether to hide progress.

    Returns:
        The folder with the files.
    """
    load_plugins(plugins)
    of_log = {"estimate": estimate, "truth": truth}
    shown = open_source(source, of_log=of_log, of_run={"case": case})
    if isinstance(shown, Run):
        return shown.export(form, out=out, case=case, overwrite=overwrite, quiet=quiet)
    folder = out or "export"
    return shown.export(form, estimate, truth, out=folder, overwrite=overwrite, quiet=quiet)


def _refuse(reason: str, given: Mapping[str, object]) -> None:
    """Refuse the first argument that has a value."""
    for name, value in given.items():
        if value is not None:
            raise InputError(f"{reason}; leave it out", argument=name)
