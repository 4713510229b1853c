"""The command that finds sensors, or settings of growth, for a task."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from tiswarm.cli import options
from tiswarm.cli.options import app
from tiswarm.cli.run import ScenarioFile


@app.command(
    cls=options.Grouped,
    epilog="Example: tiswarm design tower --condition joint-with-walks "
    "--goal 'rmse_R<0.2' --vary sensing.tilt_noise_deg=0.5,1,2",
)
def design(
    scenario: ScenarioFile,
    goals: Annotated[
        list[str],
        Option(
            "--goal",
            metavar="GOAL",
            help="rmse_R<0.2, height_R>60, min:price, max:reach_R or the like (repeatable).",
        ),
    ] = [],  # noqa: B006 - typer never changes it
    vary: Annotated[
        list[str],
        Option(
            "--vary",
            metavar="KEY=VALUE,...",
            help="Values to choose from, of sensing, or of structure, robot and robots "
            "(repeatable).",
        ),
    ] = [],  # noqa: B006 - typer never changes it
    prices: Annotated[
        Path | None,
        Option("--price", metavar="TABLE", help="Prices of these values: key,value,price."),
    ] = None,
    condition: Annotated[
        str | None, Option(help="Condition of SCENARIO to design for (default: the only one).")
    ] = None,
    overrides: options.Overrides = [],  # noqa: B006 - typer never changes it
    seeds: Annotated[
        int | None,
        Option(
            help="Structures to search on (default: 12 for sensing, else 8).", show_default=False
        ),
    ] = None,
    fresh: Annotated[int, Option(help="Structures to run the best candidates on.")] = 5,
    out: Annotated[
        Path | None,
        Option(
            metavar="FOLDER",
            help="Folder for design.yaml, design.csv and the runs on fresh seeds (default: print "
            "only).",
            show_default=False,
        ),
    ] = None,
    plugins: options.Plugins = [],  # noqa: B006 - typer never changes it
    *,
    overwrite: options.Overwrite = False,
    quiet: options.Quiet = False,
    arch: options.OneArch = "cpu",
    threads: options.Threads = None,
) -> None:
    """Find sensors, or settings of growth, that reach a goal.

    The RMSE of sensor suites is predicted from the information in what robots would sense; settings
    of growth are grown, the better half on more seeds. The best candidates are run on fresh seeds.
    With prices, the front of price against result counts.
    """
    from tiswarm import api

    result = api.design(
        scenario,
        goals,
        _values(vary),
        prices,
        overrides=overrides,
        condition=condition,
        seeds=seeds,
        fresh=fresh,
        out=out,
        overwrite=overwrite,
        arch=arch,
        threads=threads,
        plugins=plugins,
        quiet=quiet,
    )
    typer.echo(result)


def _values(texts: list[str]) -> dict[str, Any]:
    """Read the values of each key.

    Raises:
        InputError: a text has no values, or two are of the same key.
    """
    from tiswarm.base.errors import InputError
    from tiswarm.scenario.yaml_source import parse_yaml

    values: dict[str, Any] = {}
    for text in texts:
        key, equals, listed = text.partition("=")
        key = key.strip()
        if not (key and equals and listed.strip()):
            problem = f"{text!r} has no values; write it like sensing.tilt_noise_deg=1,2,4"
            raise InputError(problem, argument="vary")
        if key in values:
            raise InputError(f"{key}: has values twice; list all at once", argument="vary")
        try:
            values[key] = parse_yaml(f"[{listed}]").data
        except InputError as error:
            raise InputError(f"{key}: {error.problem}", argument="vary") from error
    return values
