"""Outputs that users name: no file that exists is replaced, unless the user says so.

Outputs are checked before long work begins. A file takes its name by a link, which fails where
another file has appeared meanwhile. So of two commands with the same output, one is refused.

Files within the folder of a run belong to the run, which replaces them: see `records.run_folder`.
"""

import errno
import os
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from tiswarm.base.errors import EnvironmentTroubleError, InputError, OutputExistsError
from tiswarm.records.io import make_folder, replacing

_NO_LINKS = {errno.EPERM, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL}
"""Errors of a file system that has no hard links, such as FAT."""


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """What a command or call may write."""

    inputs: Sequence[object] = ()
    """What it reads, which no output replaces: files, folders, open files; of arrays and the like,
    nothing is looked at."""

    overwrite: bool = False
    """Whether files that exist may be replaced."""

    def check(self, outputs: Mapping[str, Path | Sequence[Path] | None]) -> None:
        """Refuse outputs that are inputs or each other, or that exist and are to stay.

        Nothing is read of the inputs, and nothing is written.

        Args:
            outputs: File or files to write, by the name of their argument; None where there is
                none.

        Raises:
            InputError: an output is refused.
            EnvironmentTroubleError: an output is a device or a pipe.
        """
        arguments: dict[Path, str] = {}
        existing: dict[Path, str] = {}
        for argument, value in outputs.items():
            if value is None:
                continue
            for path in [value] if isinstance(value, Path) else value:
                self._refuse_input(path, argument)
                first = arguments.setdefault(_real(path), argument)
                if first != argument:
                    problem = f"{first} names the same file; name another one"
                    raise InputError(problem, path=path, argument=argument)
                if _is_file(path, argument):
                    existing[path] = argument
        if existing and not self.overwrite:
            raise OutputExistsError(existing)

    @contextmanager
    def opened(self, path: Path) -> Iterator[BinaryIO]:
        """Open an output that appears whole when the block ends without an exception.

        Raises:
            InputError: the file is an input, or exists and is to stay: before the block or after.
            EnvironmentTroubleError: the file cannot be written, or is a device or a pipe.
        """

        def take_name(whole: Path) -> None:
            self._refuse(path)
            if not self.overwrite:
                _link(whole, path)

        self._refuse(path)
        with replacing(path, on_whole=take_name) as file:
            yield file

    def write(self, path: Path, data: bytes) -> None:
        """Write a whole output at once; errors as for `opened`."""
        with self.opened(path) as file:
            file.write(data)

    def write_folder(self, folder: Path, files: Mapping[str, bytes]) -> list[Path]:
        """Write outputs by name into a folder, which is made if need be; none if one is refused.

        Raises:
            InputError: as for `check`.
            EnvironmentTroubleError: the folder cannot be made or written to.
        """
        paths = [folder / name for name in files]
        self.check({"out": paths})
        make_folder(folder)
        for path, data in zip(paths, files.values(), strict=True):
            self.write(path, data)
        return paths

    def _refuse(self, path: Path) -> None:
        self._refuse_input(path, "")
        if _is_file(path, "") and not self.overwrite:
            raise OutputExistsError({path: ""})

    def _refuse_input(self, path: Path, argument: str) -> None:
        if any(_is_part(path, _place(read)) for read in self.inputs):
            problem = "this is an input, which an output never replaces; name another file"
            raise InputError(problem, path=path, argument=argument)


NEW = Outputs()
"""Writes files that do not exist."""


def refuse_same(written: object, read: object) -> None:
    """Refuse an open output that is an input, by any name, so that neither grows without end.

    Raises:
        InputError: they are the same file.
    """
    if _is_part(_place(written), _place(read)):
        raise InputError("the output is the input; send it to another file")


def _is_file(path: Path, argument: str) -> bool:
    """Whether there is a file; what is none is refused, and so is a link, which leads anywhere."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return False
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
    return True


def _link(whole: Path, path: Path) -> None:
    """Give a whole file its name, unless another file has it.

    The temporary name remains, and its owner removes it: to rename one of two links of a file to
    the other does nothing. Where there are no links, an empty file keeps the name until then.

    Raises:
        OutputExistsError: a file has the name.
    """
    try:
        try:
            os.link(whole, path)
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            path.open("xb").close()
    except FileExistsError as error:
        raise OutputExistsError({path: ""}) from error


def _place(value: object) -> Path | int | None:
    """Return the path or descriptor of a file; None of what is no file."""
    if isinstance(value, (str, os.PathLike)):
        return Path(value)
    try:
        return value.fileno()  # type: ignore[attr-defined, no-any-return]
    except (AttributeError, OSError, ValueError):
        return None


def _is_part(output: Path | int | None, read: Path | int | None) -> bool:
    """Whether an output is an input, by any name, or a file within an input folder."""
    if output is None or read is None:
        return False
    try:
        mode = os.stat(read).st_mode  # noqa: PTH116 - also of a descriptor
        if stat.S_ISDIR(mode) and isinstance(output, Path) and isinstance(read, Path):
            return output.exists() and _real(output).is_relative_to(_real(read))
        return stat.S_ISREG(mode) and os.path.samefile(output, read)  # noqa: PTH121
    except OSError:  # one of them does not exist
        return False


def _real(path: Path) -> Path:
    """Follow links of folders, so that one file has one name."""
    return Path(os.path.realpath(path))
