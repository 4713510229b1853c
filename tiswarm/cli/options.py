"""The `tiswarm` command, and the options that several of its subcommands share."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import tiswarm
from tiswarm.params import Arch

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Grow swarms of modular robots and let them find out where they are by touch.",
    epilog="Example: tiswarm run scenarios/tower.yaml",
)

Overrides = Annotated[
    list[str],
    typer.Option("--set", metavar="KEY=VALUE", help="Override a key; may be given often."),
]
OneArch = Annotated[Arch, typer.Option("--arch", help="Device; never another than asked for.")]
Threads = Annotated[
    int | None, typer.Option(help="CPU threads; all cores if not given.", show_default=False)
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")]
RunFolderPath = Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.")]
Pdf = Annotated[bool, typer.Option("--pdf", help="Draw figures as vector PDF too.")]
Animate = Annotated[bool, typer.Option("--animate", help="Draw how the largest structure grew.")]
Movie = Annotated[Literal["gif", "mp4"], typer.Option(help="What --animate writes.")]


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    *,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        typer.echo(f"tiswarm {tiswarm.__version__}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())
