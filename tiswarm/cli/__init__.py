"""The `tiswarm` command: parse, call, print.

A command imports its dependencies when it runs, so that `tiswarm --help` stays fast.
"""

import json
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from tiswarm.app.console import fail
from tiswarm.base.errors import InputError
from tiswarm.cli.options import Overrides, Plugins, app, main

# Each module adds its commands, in the order of the help.
# isort: off
from tiswarm.cli import run, commands, design  # noqa: F401
# isort: on

__all__ = ["main"]


@app.command(epilog="Example: tiswarm check scenarios/*.yaml sensing.jsonl")
def check(
    files: Annotated[
        list[Path], Argument(help="Scenarios (.yaml) and logs (.jsonl, .jsonl.zst, .mcap).")
    ],
    overrides: Overrides = [],  # noqa: B006 - typer never changes it
    plugins: Plugins = [],  # noqa: B006 - typer never changes it
) -> None:
    """Check scenarios and sensing logs for mistakes."""
    from tiswarm import api

    mistakes: list[InputError] = []
    for path in files:
        finding = api.check(path, overrides, plugins=plugins)
        mistakes += finding.mistakes
        if not finding.mistakes:
            typer.echo(f"{path}: {finding}")
    for mistake in mistakes[:-1]:
        fail(mistake)
    if mistakes:
        raise mistakes[-1]


@app.command(epilog="Example: tiswarm scenarios tower > my-tower.yaml")
def scenarios(
    name: Annotated[
        str | None, Argument(help="Scenario to print (default: list some).", show_default=False)
    ] = None,
    *,
    every: Annotated[bool, Option("--all", help="List all of them.")] = False,
) -> None:
    """List the scenarios that come with tiswarm, or print one."""
    from tiswarm.scenario.yaml_source import describe_scenarios, shipped_scenarios

    shipped = shipped_scenarios()
    if name is None:
        typer.echo("\n".join(describe_scenarios(every=every)))
        if not every:
            typer.echo(f"tiswarm scenarios --all lists all {len(shipped)}")
    elif name in shipped:
        typer.echo(shipped[name].read_text(), nl=False)
    else:
        raise InputError("there is no such scenario; tiswarm scenarios --all lists all", key=name)


@app.command(epilog="Example: tiswarm schema > scenario.schema.json")
def schema(
    plugins: Plugins = [],  # noqa: B006 - typer never changes it
    *,
    of_log: Annotated[bool, Option("--log", help="Of a line of a sensing log instead.")] = False,
) -> None:
    """Print the JSON Schema of a scenario or of a log.

    Editors complete and check files with it.
    """
    from tiswarm.base.plugins import load_plugins
    from tiswarm.records.sensing_format import line_schema
    from tiswarm.scenario.model import scenario_schema

    load_plugins(plugins)
    typer.echo(json.dumps(line_schema() if of_log else scenario_schema(), indent=2))


@app.command(epilog="Example: tiswarm doctor")
def doctor(
    *,
    only_packages: Annotated[
        bool, Option("--missing-packages", help="Print only the missing system packages.")
    ] = False,
) -> None:
    """List the devices and renderers that work on this machine.

    The list names what to install for the others.
    """
    from tiswarm.app import doctor as checks

    if only_packages:
        typer.echo(" ".join(checks.missing_packages()))
        return
    for finding in checks.examine():
        mark = "ok" if finding.works else "--"
        typer.echo(f"{mark}  {finding.subject:<24} {finding.detail}")
