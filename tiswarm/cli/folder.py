"""Commands on run folders: redraw, compare, export."""

from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from tiswarm.cli.app import Animate, Movie, Pdf, Quiet, RunFolderPath, app
from tiswarm.console import ConsoleProgress
from tiswarm.progress import Progress


@app.command(epilog="Example: tiswarm report reports/tower-1a2b3c4d")
def report(run: RunFolderPath, *, pdf: Pdf = False, quiet: Quiet = False) -> None:
    """Redraw all tables, figures and report.html of a run from its stored data."""
    from tiswarm import study
    from tiswarm.drawing import draw
    from tiswarm.report.run_data import load_run

    progress = ConsoleProgress(quiet=quiet)
    study.tabulate(run, progress)
    draw(load_run(run), progress, figures=True, pdf=pdf)
    if not quiet:
        typer.echo(study.headline(run))


@app.command(epilog="Example: tiswarm render reports/tower-1a2b3c4d --renderer open3d")
def render(
    run: RunFolderPath,
    renderer: Annotated[
        str | None, Option(help="open3d or taichi (default: the first that works).")
    ] = None,
    case: Annotated[str | None, Option(help="Case to draw (default: the largest).")] = None,
    *,
    animate: Animate = False,
    movie: Movie = "gif",
    quiet: Quiet = False,
) -> None:
    """Draw 3D pictures of a run from its stored data, and add them to report.html."""
    from tiswarm.drawing import draw
    from tiswarm.report.run_data import load_run

    draw(
        load_run(run), ConsoleProgress(quiet=quiet),
        renders=True, movie=movie if animate else None, renderer=renderer, case=case,
    )  # fmt: skip


@app.command(epilog="Example: tiswarm compare reports/tower-1a2b3c4d reports/joint-5e6f7a8b")
def compare(
    runs: Annotated[list[Path], Argument(metavar="RUN RUN ...", help="Run folders.")],
    out: Annotated[Path, Option(help="Folder to write to.")] = Path("reports/comparison"),
    *,
    quiet: Quiet = False,
) -> None:
    """Compare runs: a table, a figure, and differences on the structures that they share."""
    from tiswarm import study
    from tiswarm.report.table_figures import draw_comparison

    study.compare(runs, out)
    draw_comparison(out, Progress())
    if not quiet:
        typer.echo(f"comparison.csv, paired.csv and comparison.png in {out}")


@app.command(epilog="Example: tiswarm export reports/tower-1a2b3c4d --format gltf")
def export(
    run: RunFolderPath,
    form: Annotated[
        Literal["csv", "gltf", "parquet", "ply"], Option("--format", help="File format.")
    ],
    out: Annotated[Path | None, Option(help="Folder to write to (default: RUN/export).")] = None,
    case: Annotated[str | None, Option(help="Case to export (default: the largest).")] = None,
    *,
    quiet: Quiet = False,
) -> None:
    """Export structure, contacts and estimate of a case for other programs."""
    from tiswarm.interop.exports import export_case

    progress = ConsoleProgress(quiet=quiet)
    export_case(run, form, run / "export" if out is None else out, case, progress)
