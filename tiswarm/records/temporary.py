"""Names of files and folders that are being written, and whether their writer has ended."""

import os
import re
import secrets
import time
from hashlib import sha256
from pathlib import Path
from socket import gethostname

import psutil

_LENGTH = 200
"""Bytes of a name that its temporary name keeps; file systems allow 255 in all."""

_HOST = sha256(gethostname().encode()).hexdigest()[:6]
_START = secrets.token_hex(4)
_NAME = re.compile(
    r"\..+\.(?:(?P<host>[0-9a-f]{6})-(?P<process>\d+)-(?P<start>[0-9a-f]{8})-)?"
    r"[0-9a-f]{8}\.(?:part|tmp)"
)
"""Machine, process, random digits of the process and of the file; version 0.2 had these alone."""

_LONGEST_S = 3600.0
"""Time without a change after which a writer on another machine is taken for dead [s]."""


def path_for(path: Path, suffix: str) -> Path:
    """Return a hidden path beside one that nobody else writes to; it names the writer."""
    token = f"{_HOST}-{os.getpid()}-{_START}-{secrets.token_hex(4)}"
    kept = os.fsencode(path.name)[:_LENGTH].decode(errors="ignore")
    return path.with_name(f".{kept}.{token}.{suffix}")


def is_temporary(path: Path) -> bool:
    """Whether a file or folder has a temporary name."""
    return _NAME.fullmatch(path.name) is not None


def is_abandoned(path: Path) -> bool:
    """Whether a file or folder has a temporary name, and the process that wrote it has ended.

    Processes of other machines cannot be seen: what they write is abandoned after an hour.
    """
    writer = _NAME.fullmatch(path.name)
    if writer is None or writer["host"] is None:
        return writer is not None
    process = int(writer["process"])
    if writer["host"] != _HOST:
        return _age_s(path) > _LONGEST_S
    if process == os.getpid():
        return writer["start"] != _START  # numbers come again, in a container after each start
    try:
        return psutil.Process(process).status() == psutil.STATUS_ZOMBIE
    except psutil.Error as error:
        return isinstance(error, psutil.NoSuchProcess)


def _age_s(path: Path) -> float:
    """Return the time since the last change [s]; 0 where it has its own name by now."""
    try:
        return time.time() - path.lstat().st_mtime
    except OSError:
        return 0.0
