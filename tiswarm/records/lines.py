"""Text files read line by line, with every trouble told by file and line."""

from codecs import BOM_UTF8
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tiswarm.errors import InputError

MAX_LINE_BYTES = 64 * 2**20


def numbered_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield each line with its number, counted from 1; only one line is held at a time.

    Raises:
        InputError: the file cannot be read, is not UTF-8, or has a line beyond all measure.
    """
    try:
        with path.open("rb") as file:
            number = 0
            while raw := file.readline(MAX_LINE_BYTES + 1):
                number += 1
                if number == 1:
                    raw = raw.removeprefix(BOM_UTF8)
                if len(raw) > MAX_LINE_BYTES:
                    problem = "the line is longer than 64 MiB; write one robot a line"
                    raise InputError(problem, path=path, line=number)
                yield number, decode(raw, path, number)
    except OSError as error:
        raise unreadable(path, error) from error


def decode(raw: bytes, path: Path, first_line: int = 1) -> str:
    """Turn bytes that start at a line of a file into text."""
    try:
        return raw.decode()
    except UnicodeDecodeError as error:
        line = first_line + raw.count(b"\n", 0, error.start)
        problem = f"byte 0x{raw[error.start]:02x} is not UTF-8; save the file as UTF-8"
        raise InputError(problem, path=path, line=line) from error


def unreadable(path: Path, error: OSError) -> InputError:
    """Say why a file cannot be opened."""
    if isinstance(error, FileNotFoundError):
        return InputError("there is no such file; check the path", path=path)
    if isinstance(error, IsADirectoryError):
        return InputError("this is a folder; name a file", path=path)
    reason = error.strerror or str(error)
    return InputError(f"cannot be read: {reason}; check its permissions", path=path)


@contextmanager
def placed(path: Path, line: int) -> Iterator[None]:
    """Add file and line to an InputError that was raised without them."""
    try:
        yield
    except InputError as error:
        raise InputError(error.problem, path=path, line=line, key=error.key) from error
