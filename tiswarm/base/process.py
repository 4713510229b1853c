"""This process and its children: memory that is short, and the command that starts a child.

Where memory is short, the program refuses before libraries load; later, it reports every shortage
as one error.
"""

import errno
import re
import resource
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

from tiswarm.base.errors import EnvironmentTroubleError, OutOfMemoryError

_SHORTAGE = re.compile(
    r"memory allocation|out of (device |host )?memory|malloc fails", re.IGNORECASE
)
"""Words of libraries that report a shortage by an error of another type."""


def require_address_space(megabytes: int) -> None:
    """Refuse a limit (`ulimit -v`) under which libraries would hang or abort without a word.

    Raises:
        EnvironmentTroubleError: the limit leaves this process less than `megabytes`.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return
    import psutil  # noqa: PLC0415 - slow to import, and few set a limit

    need = megabytes + psutil.Process().memory_info().vms // 2**20
    if limit < need * 2**20:
        raise EnvironmentTroubleError(
            f"ulimit -v allows {limit // 2**20} MB of address space, but the start takes {need} MB"
            "; raise the limit"
        )


@contextmanager
def naming_shortage() -> Iterator[None]:
    """Raise the same error for all the ways in which libraries run out of memory."""
    try:
        yield
    except (MemoryError, OSError, RuntimeError) as error:
        is_shortage = isinstance(error, MemoryError) or _SHORTAGE.search(str(error))
        if not is_shortage and getattr(error, "errno", None) != errno.ENOMEM:
            raise
        traceback.clear_frames(error.__traceback__)  # frees the arrays of what failed
        need = re.sub(r"^\[\S+\] ", "", str(error)).rstrip(".") or type(error).__name__
        raise OutOfMemoryError(
            f"memory ran out: {need}; compute fewer robots, seeds, chains or workers "
            "(`run --plan` estimates the need)"
        ) from error


def child_command(code: str, *arguments: str) -> list[str]:
    """Return the command of a child of our own interpreter that runs `code`.

    No module of the working folder runs in it. The child uses PYTHONPATH as its parent does.
    """
    if sys.version_info >= (3, 11):  # Python 3.13 imports modules of its own before the code
        return [sys.executable, "-P", "-c", code, *arguments]
    return [sys.executable, "-c", f"import sys; sys.path.remove('')\n{code}", *arguments]
