"""Files appear whole or not at all: written under a temporary name, flushed, renamed."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from tiswarm.errors import EnvironmentTroubleError


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
