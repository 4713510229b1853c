"""Our own interpreter as a child: the one way in which the package starts it."""

import sys


def child_command(code: str, *arguments: str) -> list[str]:
    """Return the command of a child that runs `code`; no module of the working folder runs in it.

    The child uses PYTHONPATH as its parent does.
    """
    if sys.version_info >= (3, 11):  # Python 3.13 imports modules of its own before the code
        return [sys.executable, "-P", "-c", code, *arguments]
    return [sys.executable, "-c", f"import sys; sys.path.remove('')\n{code}", *arguments]
