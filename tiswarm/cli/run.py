"""The command that runs all cases of a scenario."""

import re
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from tiswarm.base.errors import CasesFailedError, InputError
from tiswarm.cli import options
from tiswarm.cli.options import app

ScenarioFile = Annotated[
    Path, Argument(metavar="SCENARIO", help="Scenario file, or name of a shipped one.")
]


def _computing(*name: str, **shown: Any) -> Any:  # noqa: ANN401 - an option of typer
    """Return an option of where and how to compute."""
    return Option(*name, rich_help_panel=options.COMPUTING, **shown)


@app.command(
    cls=options.Grouped,
    epilog="Example: tiswarm run scenarios/tower.yaml --set robots=20 --set seeds=2",
)
def run(
    scenario: ScenarioFile,
    overrides: options.Overrides = [],  # noqa: B006 - typer never changes it
    out: Annotated[Path, Option(help="Parent of the run folder.")] = Path("reports"),
    plugins: options.Plugins = [],  # noqa: B006 - typer never changes it
    *,
    only_plan: Annotated[
        bool, Option("--plan", help="Print an estimate of time and memory, and run nothing.")
    ] = False,
    overwrite: Annotated[
        bool, Option("--overwrite", help="Take a folder that no run made, and replace files there.")
    ] = False,
    live: Annotated[
        bool, Option("--live", help="Write live.html, which shows robots while they join.")
    ] = False,
    opened: options.Open = False,
    debug: options.Debug = False,
    quiet: options.Quiet = False,
    pictures: Annotated[
        bool,
        Option(help="Draw figures, renders and report.html.", rich_help_panel=options.PICTURES),
    ] = True,
    pdf: options.Pdf = False,
    animate: options.Animate = False,
    movie: options.Movie = None,
    arch: options.OneArch = "cpu",
    threads: options.Threads = None,
    workers: Annotated[
        int | None, _computing(min=1, help="Number of worker processes; 1 for little work.")
    ] = None,
    scheduler: Annotated[
        str | None, _computing(metavar="ADDRESS", help="Dask scheduler to compute on.")
    ] = None,
    shard: Annotated[str, _computing(metavar="I/N", help="Compute part I of N only.")] = "1/1",
    case_limit: Annotated[
        float | None, _computing(min=0.001, metavar="SECONDS", help="Abort a case after this time.")
    ] = None,
    fail_fast: Annotated[
        bool, _computing("--fail-fast", help="Stop at the first failed case.")
    ] = False,
) -> None:
    """Run a scenario: grow, sense, localize, evaluate and draw.

    An interrupted run continues where it stopped.
    """
    from tiswarm import api

    animated = options.chosen_movie(movie, animate=animate)
    execution: dict[str, Any] = {
        "workers": workers,
        "scheduler": scheduler,
        "shard": _shard(shard),
        "case_limit_s": case_limit,
        "fail_fast": fail_fast,
    }
    if only_plan:
        typer.echo(api.forecast(scenario, overrides, plugins=plugins, **execution))
        return
    result = api.run(
        scenario,
        overrides,
        out=out,
        arch=arch,
        threads=threads,
        pictures=pictures,
        pdf=pdf,
        movie=animated,
        plugins=plugins,
        overwrite=overwrite,
        live=live,
        quiet=quiet,
        **execution,
    )
    if not quiet:
        typer.echo(result)
    if not result.missing and (opened or not quiet):
        options.show_page(result.page, opened=opened)
    if result.failed:
        options.show_tracebacks(result.folder, debug=debug)
        raise typer.Exit(CasesFailedError.exit_status)


def _shard(text: str) -> tuple[int, int]:
    numbers = re.fullmatch(r"(\d+)/(\d+)", text)
    if not numbers:
        raise InputError(f"invalid shard {text}: use I/N with 1 <= I <= N")
    return int(numbers[1]), int(numbers[2])
