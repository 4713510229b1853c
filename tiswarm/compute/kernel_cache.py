"""The folder of compiled kernels, and a seal that shows damage.

The kernel library believes what it reads there: a flipped bit can crash it. Hence each process that
lets it write also writes a seal, the digest of all files. A folder that does not fit its seal is
put aside, and kernels are compiled again. Others may use the folder meanwhile: they compile what
they no longer find.
"""

import atexit
import contextlib
import fcntl
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

from tiswarm.base.errors import EnvironmentTroubleError

_SEAL = "seal"


def find_folder(library: str) -> Path:
    """Find a folder for the kernels of a library; one that cannot be written would crash at exit.

    Raises:
        EnvironmentTroubleError: no folder can be written.
    """
    folders = [os.environ.get("TI_OFFLINE_CACHE_FILE_PATH"), os.environ.get("XDG_CACHE_HOME")]
    home = os.environ.get("HOME")
    if home:
        folders.append(str(Path(home) / ".cache"))
    for folder in filter(None, folders):
        choice = Path(folder) / "tiswarm" / "kernels" / library
        with contextlib.suppress(OSError):
            choice.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=choice.parent):
                return choice
    try:
        temporary = Path(tempfile.mkdtemp(prefix="tiswarm-kernels-"))
    except OSError as error:
        problem = "no folder can be written, not even a temporary one; set XDG_CACHE_HOME to one"
        raise EnvironmentTroubleError(problem) from error
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return temporary / library


@contextlib.contextmanager
def sealed(folder: Path) -> Iterator[None]:
    """Let the library write to the folder within the block, and no other process meanwhile.

    If the folder does not fit its seal, it is cleared first, and a line says so.
    """
    with _locked(folder):
        if not _fits_seal(folder) and _put_aside(folder):
            sys.stderr.write(
                f"tiswarm: warning: {folder}: damaged kernel cache cleared; compiling again\n"
            )
        try:
            yield
        finally:
            _seal(folder)


def seal(folder: Path) -> None:
    """Seal what the library has just written on somebody else's order, if the folder is there."""
    with contextlib.suppress(OSError), _locked(folder):
        _seal(folder)


def _seal(folder: Path) -> None:
    with contextlib.suppress(OSError):  # without a seal it will be cleared
        (folder / _SEAL).write_text(_digest(folder), encoding="ascii")


def clear(folder: Path) -> bool:
    """Remove all kernels; return whether there were any."""
    with _locked(folder):
        return _put_aside(folder)


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    folder.mkdir(parents=True, exist_ok=True)
    with (folder.parent / f"{folder.name}.lock").open("w") as lock:
        with contextlib.suppress(OSError):  # a file system may know no locks
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _put_aside(folder: Path) -> bool:
    """Empty the folder, at once for others that use it; return whether it held kernels."""
    aside = Path(tempfile.mkdtemp(prefix=f"{folder.name}-", dir=folder.parent))
    with contextlib.suppress(FileNotFoundError):  # where locks do not reach each other
        folder.rename(aside)
    folder.mkdir(exist_ok=True)
    had_any = any(file.name != _SEAL for file in aside.iterdir())
    shutil.rmtree(aside, ignore_errors=True)
    return had_any


def _fits_seal(folder: Path) -> bool:
    try:
        return (folder / _SEAL).read_text(encoding="ascii") == _digest(folder)
    except (OSError, ValueError):
        return False


def _digest(folder: Path) -> str:
    """Return a digest of the names and contents of all files and folders but the seal."""
    digest = sha256()
    for path in sorted(set(folder.rglob("*")) - {folder / _SEAL}):  # quadrants has a folder within
        content = b"" if path.is_dir() else path.read_bytes()
        digest.update(f"{path.relative_to(folder)} {len(content)}\n".encode() + content)
    return digest.hexdigest()
