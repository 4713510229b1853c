"""Reads text files line by line, and writes files that appear whole or not at all."""

import os
import secrets
from codecs import BOM_UTF8
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from tiswarm.errors import EnvironmentTroubleError, InputError

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
def at_line(path: Path, line: int) -> Iterator[None]:
    """Add file and line to an InputError that was raised without them."""
    try:
        yield
    except InputError as error:
        raise InputError(error.problem, path=path, line=line, key=error.key) from error


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a file that takes the place of `path` when the block ends without an exception.

    A reader, or a run that was killed, finds the old file or the new one, never a part.

    Raises:
        EnvironmentTroubleError: the folder is missing or not writable, or the disk is full.
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
        _flush_folder(path.parent)
    except OSError as error:
        reason = error.strerror or error
        problem = f"{path}: cannot be written: {reason}; check its folder and the free space"
        raise EnvironmentTroubleError(problem) from error
    finally:
        with suppress(OSError):  # still there only if something failed
            temporary.unlink(missing_ok=True)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a whole file at once."""
    with replacing(path) as file:
        file.write(data)


def write_text(path: Path, text: str) -> None:
    """Write a whole file at once, as UTF-8, line endings as they are."""
    write_bytes(path, text.encode())


def make_folder(folder: Path) -> None:
    """Make a folder for results, and those above it, unless it is there.

    Raises:
        EnvironmentTroubleError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = f"{folder}: cannot be made: {error.strerror}; choose another --out"
        raise EnvironmentTroubleError(problem) from error


def _flush_folder(folder: Path) -> None:
    """Make the new name outlive a power cut, where the system lets a folder be flushed."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
