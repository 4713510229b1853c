"""The `tiswarm` command: parse, call, print.

What a command needs is imported when it runs, so that `tiswarm --help` stays quick.
"""

import sys
from typing import Any

import typer
from typer.exceptions import TyperException

from tiswarm.cli.options import app
from tiswarm.console import fail
from tiswarm.errors import InputError, TiswarmError

# Each module adds its commands, in the order of the help.
# isort: off
from tiswarm.cli import runs, logs, folders, advice  # noqa: F401
# isort: on

INTERRUPTED = 130


def main() -> None:
    """Run the command line; errors that a user can mend end in one line, not a traceback."""
    sys.exit(_status(sys.argv[1:]))


def _status(arguments: list[str]) -> int:
    """Run a command and return its exit status."""
    try:
        status: Any = app(arguments, standalone_mode=False)
    except TiswarmError as error:
        fail(str(error))
        return error.exit_status
    except TyperException as error:
        fail(" ".join(error.format_message().split()))
        return InputError.exit_status
    except (KeyboardInterrupt, typer.Abort):
        fail("interrupted; what was finished is kept, and the same command goes on from there")
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return 1
    return status if isinstance(status, int) else 0
