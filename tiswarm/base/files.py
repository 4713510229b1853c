"""Which files of users are read."""

import stat
from pathlib import Path

from tiswarm.base.errors import InputError


def refuse_special(path: Path, mode: int) -> None:
    """Refuse what is neither file nor folder: a pipe may block, a device never end.

    Args:
        path: File that a user names; whether a folder can be read is up to the reader.
        mode: Its mode, as `os.stat` returns it, behind links.

    Raises:
        InputError: it is a pipe, a socket or a device.
    """
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        problem = "is a pipe or a device; write its content to a file, and name that"
        raise InputError(problem, path=path)
