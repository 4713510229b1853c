"""Commands on run folders: redraw, compare, export. Pictures and exports show logs, too."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from tiswarm.cli.app import (
    Animate,
    Movie,
    Open,
    Pdf,
    Quiet,
    RunFolderPath,
    app,
    chosen_movie,
    refuse,
    show_page,
)
from tiswarm.cli.log import EstimateTable, Truth, read_estimated
from tiswarm.console import ConsoleProgress
from tiswarm.params import AnyFormat
from tiswarm.progress import Progress

_RunOrLog = Annotated[Path, Argument(metavar="RUN|LOG", help="Run folder or sensing log.")]


@app.command(epilog="Example: tiswarm report reports/tower-1a2b3c4d")
def report(
    run: RunFolderPath, *, pdf: Pdf = False, opened: Open = False, quiet: Quiet = False
) -> None:
    """Redraw tables, figures and report.html of a run."""
    from tiswarm import study
    from tiswarm.drawing import PAGE, draw
    from tiswarm.report.headline import headline
    from tiswarm.report.run_data import load_run

    progress = ConsoleProgress(quiet=quiet)
    study.tabulate(run, progress)
    draw(load_run(run), progress, figures=True, pdf=pdf)
    if not quiet:
        typer.echo(headline(run))
    if opened or not quiet:
        show_page(run / PAGE, opened=opened)


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
    quiet: Quiet = False,
) -> None:
    """Draw 3D pictures of a run, or of a log and its estimate."""
    from tiswarm.drawing import draw, render_log
    from tiswarm.report.run_data import load_run
    from tiswarm.report.swarm_view import view_log

    progress, animated = ConsoleProgress(quiet=quiet), chosen_movie(movie, animate=animate)
    if not source.is_dir():
        refuse({"--animate": animate, "--case": case}, "a log is no run")
        view = view_log(*read_estimated(source, estimate, progress, truth))
        render_log(view, out or Path("renders"), progress, renderer=renderer)
        return
    refuse({"ESTIMATE": estimate, "--truth": truth, "--out": out}, "a run has its own")
    draw(
        load_run(source), progress,
        renders=True, movie=animated, renderer=renderer, case=case,
    )  # fmt: skip


@app.command(epilog="Example: tiswarm compare reports/tower-1a2b3c4d reports/joint-5e6f7a8b")
def compare(
    runs: Annotated[list[Path], Argument(metavar="RUN RUN ...", help="Run folders.")],
    out: Annotated[Path, Option(help="Folder to write to.")] = Path("reports/comparison"),
    *,
    quiet: Quiet = False,
) -> None:
    """Compare runs in a table and a figure.

    paired.csv has differences on the structures that the runs share.
    """
    from tiswarm import study
    from tiswarm.report.table_figures import draw_comparison

    study.compare(runs, out)
    draw_comparison(out, Progress())
    if not quiet:
        typer.echo(f"comparison.csv, paired.csv and comparison.png in {out}")


@app.command(epilog="Example: tiswarm export reports/tower-1a2b3c4d --format gltf")
def export(
    source: _RunOrLog,
    form: Annotated[AnyFormat, Option("--format", help="File format.")] = "gltf",
    estimate: EstimateTable = None,
    truth: Truth = None,
    out: Annotated[
        Path | None, Option(help="Folder to write to (default: export, in RUN if there is one).")
    ] = None,
    case: Annotated[str | None, Option(help="Case to export (default: the largest).")] = None,
    *,
    quiet: Quiet = False,
) -> None:
    """Export a case, or a log and its estimate, for other programs.

    The files have structure, contacts and estimate.
    """
    from tiswarm.interop.exports import export_view
    from tiswarm.report.run_data import load_run
    from tiswarm.report.swarm_view import read_case_view, view_log

    progress = ConsoleProgress(quiet=quiet)
    if source.is_dir():
        refuse({"ESTIMATE": estimate, "--truth": truth}, "a run has its own")
        folder, view = source / "export", read_case_view(load_run(source).choose(case))
    else:
        refuse({"--case": case}, "a log is no run")
        folder, view = Path("export"), view_log(*read_estimated(source, estimate, progress, truth))
    export_view(view, form, out or folder, progress)
