"""The `tiswarm` application, its exit status, and options that several commands share."""

import atexit
import contextlib
import gc
import json
import os
import re
import signal
import sys
import warnings
import webbrowser
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option
from typer.core import TyperCommand, TyperGroup

import tiswarm
from tiswarm.app.console import fail
from tiswarm.base.errors import EnvironmentTroubleError, InputError, ResultWarning, TiswarmError
from tiswarm.base.params import AnyArch, AnyMovie
from tiswarm.base.plugins import PluginError
from tiswarm.base.process import naming_shortage, require_address_space

_INTERRUPTED = {128 + signal.SIGINT, 128 + signal.SIGTERM}
_COMMAND_LINE_ERROR: type[Any] = typer.BadParameter.__mro__[2]
"""What typer raises for a wrong command line: click's `ClickException`, or that of typer's own copy
of click, which has no public name before typer 0.28."""

_LIBRARIES_MB = 700
"""Address space that the libraries of any command take."""

_PYTHON = warnings.showwarning

COMPUTING = "Where and how to compute"
PICTURES = "Pictures"
"""Headings of options in the help of commands that have many."""


class Grouped(TyperCommand):
    """A command whose help lists options under their headings."""

    def format_options(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401 - typer's own click
        """Write arguments, options without a heading, and those of each heading."""
        groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            usual = "Options" if parameter.param_type_name == "option" else "Arguments"
            heading = getattr(parameter, "rich_help_panel", None) or usual
            record = parameter.get_help_record(ctx)
            if record:
                groups.setdefault(heading, []).append(record)
        for heading, records in groups.items():
            if records:
                with formatter.section(heading):
                    formatter.write_dl(records)


_INSTEAD = {"report": "redraw", "render": "redraw", "explain": "view --explain", "show": "view"}
"""Commands by names under which users look for them."""


class Commands(TyperGroup):
    """All commands; names that they once had, or may have, lead to them."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401 - typer's own click
        """Find the command that arguments begin with."""
        if args[0] in _INSTEAD:
            problem = f"there is no such command; use tiswarm {_INSTEAD[args[0]]}"
            raise InputError(problem, key=args[0])
        return super().resolve_command(ctx, args)


app = typer.Typer(
    cls=Commands,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Grow swarms of modular robots, and localize the robots by their contacts.",
    epilog="Example: tiswarm run scenarios/tower.yaml",
)

Overrides = Annotated[
    list[str], Option("--set", metavar="KEY=VALUE", help="Override a key (repeatable).")
]
OneArch = Annotated[
    AnyArch,
    Option(
        "--arch",
        rich_help_panel=COMPUTING,
        help="Compute device of joint, and of virtual-force with schedule together; "
        "fails if unavailable.",
    ),
]
Threads = Annotated[
    int | None,
    Option(help="CPU threads (default: all cores).", show_default=False, rich_help_panel=COMPUTING),
]
Quiet = Annotated[bool, Option("--quiet", "-q", help="Print only warnings and errors.")]
Plugins = Annotated[
    list[Path],
    Option("--plugin", metavar="FILE", help="Load a plug-in of yours from a file (repeatable)."),
]
Colors = Annotated[
    list[str],
    Option("--color", metavar="FILE:COLUMN", help="Color robots by a table of yours (repeatable)."),
]
Debug = Annotated[bool, Option("--debug", help="Print the traceback if a plug-in fails.")]
RunFolderPath = Annotated[Path, Argument(metavar="RUN", help="Run folder.")]
Overwrite = Annotated[bool, Option("--overwrite", help="Replace files that exist.")]
Open = Annotated[bool, Option("--open", help="Open the page in the browser.")]
Pdf = Annotated[
    bool, Option("--pdf", help="Also write figures as vector PDF.", rich_help_panel=PICTURES)
]
Animate = Annotated[
    bool,
    Option(
        "--animate", help="Animate the growth of the largest structure.", rich_help_panel=PICTURES
    ),
]
Movie = Annotated[
    AnyMovie | None,
    Option(
        help="Animate into this file format (default: mp4, or else webp).", rich_help_panel=PICTURES
    ),
]


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    *,
    version: Annotated[bool, Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        typer.echo(f"tiswarm {tiswarm.__version__}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())
    else:
        require_address_space(_LIBRARIES_MB)
        _enter_working_folder()


def _drop_output() -> None:
    """Send to nowhere what standard output could not take: Python flushes it once more at exit."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _enter_working_folder() -> None:
    """Raise EnvironmentTroubleError in a folder that is gone or closed; libraries cannot load."""
    try:
        os.chdir(Path.cwd())
    except OSError as error:
        msg = f"the working folder cannot be used: {error.strerror}; change to another one"
        raise EnvironmentTroubleError(msg) from error


def show_page(page: Path | str, *, opened: bool) -> None:
    """Print how to open a page, a file or an address, or open it in the user's browser.

    Raises:
        EnvironmentTroubleError: there is no browser.
    """
    if not opened:
        typer.echo(f"open {page}")
    elif not webbrowser.open(page if isinstance(page, str) else page.absolute().as_uri()):
        raise EnvironmentTroubleError(f"no browser to open {page}; copy it to a machine with one")


def chosen_movie(movie: AnyMovie | None, *, animate: bool) -> AnyMovie | None:
    """Return the file format of an animation, the best one if none was chosen; None without one."""
    if movie or not animate:
        return movie
    from tiswarm.report.pictures.pictures import best_movie

    return best_movie()


@contextlib.contextmanager
def showing_traceback(*, debug: bool) -> Iterator[None]:
    """Print the traceback of a plug-in that fails within the block, if a user debugs it."""
    try:
        yield
    except PluginError as error:
        if debug:
            typer.echo(error.details, nl=False, err=True)
        raise


def show_tracebacks(run: Path, *, debug: bool) -> None:
    """Print the tracebacks of cases that failed in a plug-in, if a user debugs it."""
    for file in sorted(run.glob("cases/*/traceback.txt")) if debug else ():
        typer.echo(file.read_text(), nl=False, err=True)


def refuse(arguments: Mapping[str, object], reason: str) -> None:
    """Refuse the first argument that has a value."""
    for name, value in arguments.items():
        if value:
            raise InputError(f"{reason}; leave it out", key=name)


def _show_warning(
    message: Warning | str, category: type[Warning], *place: object, **options: object
) -> None:
    """Print warnings of tiswarm in one line, and those of libraries as Python does."""
    if issubclass(category, ResultWarning):
        sys.stderr.write(f"tiswarm: warning: {message}\n")
    else:
        _PYTHON(message, category, *place, **options)  # type: ignore[arg-type]


def main() -> None:
    """Run the command line; errors that a user can fix are one line, not a traceback."""
    sys.exit(_status(sys.argv[1:]))


def _status(arguments: list[str]) -> int:
    """Run a command and return its exit status."""
    warnings.showwarning = _show_warning
    warnings.simplefilter("always", ResultWarning)  # PYTHONWARNINGS hides none
    os.environ["MPLBACKEND"] = "agg"  # figures go to files; an unknown name would be refused
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # idle threads would still reserve memory
    gc.set_threshold(50_000, 20, 100)  # most objects of a command live until it ends
    atexit.register(gc.freeze)  # and the search at its end would take half a second
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # nohup ignores it
        signal.signal(signal.SIGINT, _interrupt_once)
    try:
        with naming_shortage():
            status: Any = app(arguments, standalone_mode=False)
    except TiswarmError as error:
        fail(error)
        return error.exit_status
    except _COMMAND_LINE_ERROR as error:
        text = _as_setting(error, arguments) or error.format_message()
        if text.startswith("Missing ") and error.ctx:
            example = error.ctx.command.epilog.partition(": ")[2]
            text = f"{text.rstrip('.')}; give it as in {example}"
        fail(" ".join(text.replace("Value error, ", "").split()))
        return InputError.exit_status
    except OSError as error:
        what = error.filename or "cannot read or write"
        fail(f"{what}: {error.strerror or error}; check the disk and its permissions")
        _drop_output()
        return EnvironmentTroubleError.exit_status
    except SystemExit as end:  # of SIGTERM, or because nobody reads the output
        status = end.code
    if status in _INTERRUPTED:
        if arguments[:1] == ["run"]:
            fail("interrupted; the same command again lets a run go on from its finished cases")
        else:
            fail("interrupted; outputs are whole, or as before")
    return status if isinstance(status, int) else 0


def _interrupt_once(*_: object) -> None:
    """End the command; a second Ctrl-C would cut the end short that stores kernels and tables."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise KeyboardInterrupt


def _as_setting(error: Any, arguments: list[str]) -> str:  # noqa: ANN401 - typer's own click
    """Lead from an unknown option that is a key to `--set`; empty if it is none."""
    option = getattr(error, "option_name", "")
    context = getattr(error, "ctx", None)
    if not option or not context or "overrides" not in [p.name for p in context.command.params]:
        return ""
    from tiswarm.scenario.model import scenario_schema

    section = "localization." if context.command.name in {"localize", "track"} else ""
    name = option.lstrip("-").replace("-", "_")
    schema = scenario_schema()
    paths = sorted(_keys(schema, schema), key=lambda path: path.count("."))
    ends = (f".{name}", f".{name}s")
    keys = [path for path in paths if path.startswith(section) and f".{path}".endswith(ends)]
    words = [word for argument in arguments for word in argument.split("=", 1)]
    if not keys or option not in words:
        return ""
    value = [*words[words.index(option) + 1 :], "VALUE"][0]
    return f"No such option: {option}; use --set {keys[0].removeprefix(section)}={value}"


def _keys(section: Any, schema: Any, path: str = "") -> Iterator[str]:  # noqa: ANN401 - JSON
    """List the keys of a scenario's section in its JSON Schema, with the keys that hold them."""
    for name, entry in section.get("properties", {}).items():
        yield path + name
        for definition in dict.fromkeys(re.findall(r"#/\$defs/(\w+)", json.dumps(entry))):
            yield from _keys(schema["$defs"][definition], schema, f"{path}{name}.")
