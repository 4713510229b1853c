"""Outputs that users name: which files a command may replace, and how it knows them again.

A file is tiswarm's own if the ledger of its folder, `.tiswarm-outputs`, has its name with the
SHA-256 of its bytes. So a file that a user made, edited or put there is never taken for one, in any
format. The ledger is text as `sha256sum` writes it; if somebody deletes it, no file is own.

Files within the folder of a run belong to the run and have no ledger, but for figures.
"""

import os
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import BinaryIO

from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.records.io import digest, make_folder, replacing

LEDGER = ".tiswarm-outputs"
"""Name of the file that lists the outputs in its folder."""

_TITLE = b"# SHA-256 of the files in this folder that tiswarm wrote and may replace.\n"
_LARGEST = 2**24
"""Largest ledger that is read or grows [byte]; a line takes about a hundred."""


def check(
    outputs: Mapping[str, Path | Sequence[Path] | None],
    inputs: Iterable[object] = (),
    *,
    overwrite: bool,
) -> None:
    """Refuse outputs that are inputs or each other, or files that no tiswarm command wrote.

    Nothing is read of the inputs, and nothing is written.

    Args:
        outputs: File or files to write, by the name of their argument; None where there is none.
        inputs: What is read: files, folders, open files; arrays and the like are never an output.
        overwrite: Whether to replace files that no tiswarm command wrote.

    Raises:
        InputError: an output is refused.
        EnvironmentTroubleError: an output is a device or a pipe.
    """
    read = [*map(_place, inputs)]
    taken: dict[Path, str] = {}
    for argument, given in outputs.items():
        for path in [given] if isinstance(given, Path) else given or []:
            if any(_is_part(path, file) for file in read):
                problem = "this is an input, which an output never replaces; name another file"
                raise InputError(problem, path=path, argument=argument)
            if (other := taken.setdefault(_real(path), argument)) != argument:
                problem = f"{other} names the same file; name another one"
                raise InputError(problem, path=path, argument=argument)
            _refuse_foreign(path, overwrite=overwrite, argument=argument)


@contextmanager
def opened(path: Path, *, overwrite: bool = False) -> Iterator[BinaryIO]:
    """Open an output that appears whole when the block ends without an exception.

    Raises:
        InputError: there is a link, or a file that no tiswarm command wrote, before the block or
            after it.
        EnvironmentTroubleError: the file cannot be written, or is a device or a pipe.
    """

    def admit(whole: Path) -> None:
        _refuse_foreign(path, overwrite=overwrite)
        _record(path, digest(whole))

    _refuse_foreign(path, overwrite=overwrite)
    with replacing(path, on_whole=admit) as file:
        yield file


def write(path: Path, data: bytes, *, overwrite: bool = False) -> None:
    """Write a whole output at once; errors as for `opened`."""
    with opened(path, overwrite=overwrite) as file:
        file.write(data)


def write_own(path: Path, data: bytes) -> None:
    """Write a file of a run folder, in place of any other or of a link, so that `is_own` knows it.

    Raises:
        EnvironmentTroubleError: the file cannot be written.
    """
    with replacing(path, on_whole=lambda whole: _record(path, digest(whole))) as file:
        file.write(data)


def write_folder(
    folder: Path, files: Mapping[str, bytes], inputs: Iterable[object] = (), *, overwrite: bool
) -> list[Path]:
    """Write outputs by name into a folder, which is made if need be; none if one is refused.

    Raises:
        InputError: as for `check`.
        EnvironmentTroubleError: the folder cannot be made or written to.
    """
    paths = [folder / name for name in files]
    check({"out": paths}, inputs, overwrite=overwrite)
    make_folder(folder)
    for path, data in zip(paths, files.values(), strict=True):
        write(path, data, overwrite=overwrite)
    return paths


def is_own(path: Path) -> bool:
    """Whether a tiswarm command wrote this file, and nobody has changed it since."""
    entry = _entry(path, "")
    lines = _ledger_of(path) if entry else []
    return any(line.endswith(entry) for line in lines) and _entry(path, digest(path)) in lines


def _refuse_foreign(path: Path, *, overwrite: bool, argument: str = "") -> None:
    """Refuse to replace what is no file, or no own one, or a link, which may lead anywhere."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    except NotADirectoryError as error:
        problem = "its folder is a file; name a folder"
        raise InputError(problem, path=path, argument=argument) from error
    except OSError as error:
        problem = f"{path}: cannot be written: {error.strerror}; name another output"
        raise EnvironmentTroubleError(problem) from error
    if stat.S_ISLNK(mode):
        raise InputError("this is a link; name the file itself", path=path, argument=argument)
    if stat.S_ISDIR(mode):
        raise InputError("this is a folder; name a file", path=path, argument=argument)
    if not stat.S_ISREG(mode):
        raise EnvironmentTroubleError(f"{path}: this is no regular file; name another output")
    if not overwrite and not is_own(path):
        problem = "no tiswarm command wrote this file as it is; name another one, or overwrite it"
        raise InputError(f"{problem} (--overwrite)", path=path, argument=argument)


def refuse_same(written: object, read: object) -> None:
    """Refuse an open output that is an input, by any name, so that neither grows without end.

    Raises:
        InputError: they are the same file.
    """
    if _is_part(_place(written), _place(read)):
        raise InputError("the output is the input; send it to another file")


def _place(given: object) -> Path | int | None:
    """Return the path or descriptor of a file; None of what is no file."""
    if isinstance(given, (str, os.PathLike)):
        return Path(given)
    try:
        return given.fileno()  # type: ignore[attr-defined, no-any-return]
    except (AttributeError, OSError, ValueError):
        return None


def _is_part(output: Path | int | None, given: Path | int | None) -> bool:
    """Whether an output is an input, by any name, or a file that an input folder came with."""
    if output is None or given is None:
        return False
    try:
        mode = os.stat(given).st_mode  # noqa: PTH116 - also of a descriptor
        if stat.S_ISDIR(mode) and isinstance(output, Path) and isinstance(given, Path):
            is_within = output.exists() and _real(output).is_relative_to(_real(given))
            return is_within and not is_own(output)
        return stat.S_ISREG(mode) and os.path.samefile(output, given)  # noqa: PTH121
    except OSError:  # one of them does not exist
        return False


def _real(path: Path) -> Path:
    """Follow links of folders, so that one file has one name."""
    return Path(os.path.realpath(path))


def _entry(path: Path, digest: str) -> bytes:
    """Write the line of a ledger for a file; empty where a ledger cannot have its name."""
    name = os.fsencode(path.name)
    return b"" if b"\n" in name else b"%b  %b\n" % (digest.encode(), name)


def _ledger_of(path: Path) -> list[bytes]:
    """Read the ledger of a file's folder; empty where there is none that tiswarm wrote."""
    try:
        with _open_ledger(path.with_name(LEDGER), os.O_RDONLY) as file:
            return [*file.read(_LARGEST).splitlines(keepends=True)]
    except OSError:
        return []


def _record(path: Path, digest: str) -> None:
    """Add a file to the ledger of its folder before it appears; a kill in between does no harm."""
    entry = _entry(path, digest)
    if not entry or not digest or entry in _ledger_of(path):
        return
    flags, ledger = os.O_RDWR | os.O_APPEND | os.O_CREAT, path.with_name(LEDGER)
    with suppress(OSError), _open_ledger(ledger, flags) as file:  # or the file is not known again
        file.seek(-1, os.SEEK_END)
        cut = b"" if file.read(1) == b"\n" else b"\n"  # a kill left part of a line
        file.write(cut + entry)  # at once, so that entries of several processes do not mix


def _open_ledger(ledger: Path, flags: int) -> FileIO:
    """Open a ledger without buffer; raise OSError where the file is another's, or too large."""
    flags |= os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    descriptor = os.open(ledger, flags, 0o666)
    try:
        file = os.fdopen(descriptor, "r+b" if flags & os.O_RDWR else "rb", buffering=0)
    except OSError:  # a folder
        os.close(descriptor)
        raise
    found = os.fstat(descriptor)
    is_plain = stat.S_ISREG(found.st_mode) and found.st_nlink == 1 and found.st_size < _LARGEST
    if is_plain and found.st_size == 0 and flags & os.O_RDWR:
        file.write(_TITLE)
    elif not is_plain or file.read(len(_TITLE)) != _TITLE:
        file.close()
        raise OSError
    return file
