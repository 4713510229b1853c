"""Commands on run folders: redraw, compare, export. Pictures and exports show logs, too."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from tiswarm.cli.app import (
    Animate,
    Debug,
    Movie,
    Open,
    Overwrite,
    Pdf,
    Plugins,
    Quiet,
    RunFolderPath,
    app,
    chosen_movie,
    show_page,
    showing_traceback,
)
from tiswarm.cli.log import EstimateTable, Truth

_RunOrLog = Annotated[Path, Argument(metavar="RUN|LOG", help="Run folder or sensing log.")]


@app.command(epilog="Example: tiswarm report reports/tower-1a2b3c4d")
def report(
    run: RunFolderPath,
    plugins: Plugins = [],  # noqa: B006 - typer never changes it
    *,
    pdf: Pdf = False,
    opened: Open = False,
    quiet: Quiet = False,
) -> None:
    """Redraw tables, figures and report.html of a run."""
    from tiswarm import api

    found = api.report(run, plugins=plugins, pdf=pdf, quiet=quiet)
    if not quiet:
        typer.echo(found)
    if opened or not quiet:
        show_page(found.page, opened=opened)


@app.command(epilog="Example: tiswarm render reports/tower-1a2b3c4d --renderer open3d")
def render(
    source: _RunOrLog,
    estimate: EstimateTable = None,
    truth: Truth = None,
    renderer: Annotated[
        str | None, Option(help="open3d or taichi (default: the first that works).")
    ] = None,
    case: Annotated[str | None, Option(help="Case to draw (default: the largest).")] = None,
    out: Annotated[
        Path | None, Option(help="With LOG: folder to write to (default: renders).")
    ] = None,
    *,
    animate: Animate = False,
    movie: Movie = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Draw 3D pictures of a run, or of a log and its estimate."""
    from tiswarm import api

    animated = chosen_movie(movie, animate=animate)
    api.render(
        source, estimate, truth,
        renderer=renderer, case=case, movie=animated, out=out, overwrite=overwrite, quiet=quiet,
    )  # fmt: skip


@app.command(epilog="Example: tiswarm compare reports/tower-1a2b3c4d reports/joint-5e6f7a8b")
def compare(
    runs: Annotated[list[Path], Argument(metavar="RUN RUN ...", help="Run folders.")],
    out: Annotated[Path, Option(help="Folder to write to.")] = Path("reports/comparison"),
    *,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Compare runs in a table and a figure.

    paired.csv has differences on the structures that the runs share.
    """
    from tiswarm import api

    found = api.compare(runs, out=out, overwrite=overwrite)
    if not quiet:
        typer.echo(found)


@app.command(epilog="Example: tiswarm export reports/tower-1a2b3c4d --format gltf")
def export(
    source: _RunOrLog,
    form: Annotated[
        str,
        Option(
            "--format",
            help="csv, gltf, gsd, mcap, parquet, ply, pyfg, tum, or that of a plug-in.",
        ),
    ] = "gltf",
    estimate: EstimateTable = None,
    truth: Truth = None,
    out: Annotated[
        Path | None, Option(help="Folder to write to (default: export, in RUN if there is one).")
    ] = None,
    case: Annotated[str | None, Option(help="Case to export (default: the largest).")] = None,
    plugins: Plugins = [],  # noqa: B006 - typer never changes it
    *,
    overwrite: Overwrite = False,
    debug: Debug = False,
    quiet: Quiet = False,
) -> None:
    """Export a case, or a log and its estimate, for other programs.

    The files have structure, contacts and estimate.
    """
    from tiswarm import api

    with showing_traceback(debug=debug):
        api.export(
            source, form, estimate, truth,
            out=out, case=case, plugins=plugins, overwrite=overwrite, quiet=quiet,
        )  # fmt: skip
