"""Reads text and tables with errors by line, and writes files that appear whole or not at all.

Files whose names end in `.zst` are compressed by Zstandard, piece by piece.
"""

import csv
import json
import os
import re
import secrets
import stat
import sys
import time
import zipfile
import zlib
from codecs import BOM_UTF8
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import asdict
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from socket import gethostname
from typing import Any, BinaryIO, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from tiswarm.base import files
from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import EnvironmentTroubleError, InputError

DAMAGED = (
    OSError, EOFError, LookupError, TypeError, ValueError, RuntimeError, zipfile.BadZipFile,
    zlib.error,
)  # fmt: skip
"""Errors of reading a damaged file of arrays."""

_LENGTH = 200
"""Bytes of a name that its temporary name keeps; file systems allow 255 in all."""

_HOST = sha256(gethostname().encode()).hexdigest()[:6]
_START = secrets.token_hex(4)
_END_OF_NAME = re.compile(
    r"(?P<host>[0-9a-f]{6})-(?P<process>\d+)-(?P<start>[0-9a-f]{8})-[0-9a-f]{8}\.(?:part|tmp)"
)
"""Machine, process, random digits of the process and of the file."""

_NAME = re.compile(rf"\..+\.{_END_OF_NAME.pattern}")

_LONGEST_S = 3600.0
"""Time without a change after which a writer on another machine is taken for dead [s]."""


def path_for(path: Path, suffix: str) -> Path:
    """Return a hidden path beside one that nobody else writes to; it names the writer."""
    token = f"{_HOST}-{os.getpid()}-{_START}-{secrets.token_hex(4)}"
    return path.with_name(f"{_start_of_name(path)}{token}.{suffix}")


def _start_of_name(path: Path) -> str:
    """Return how the names of all temporary files of a path begin."""
    kept = os.fsencode(path.name)[:_LENGTH].decode(errors="ignore")
    return f".{kept}."


def is_temporary(path: Path) -> bool:
    """Whether a file or folder has a temporary name."""
    return _NAME.fullmatch(path.name) is not None


def is_abandoned(path: Path) -> bool:
    """Whether a file or folder has a temporary name, and the process that wrote it has ended.

    Processes of other machines cannot be seen: what they write is abandoned after an hour.
    """
    writer = _NAME.fullmatch(path.name)
    if writer is None:
        return False
    if writer["host"] != _HOST:
        return _age_s(path) > _LONGEST_S
    return _has_ended(writer)


def _has_ended(writer: re.Match[str]) -> bool:
    """Whether the process of this machine that a temporary name states has ended."""
    import psutil  # noqa: PLC0415 - slow to import

    process = int(writer["process"])
    if process == os.getpid():
        return writer["start"] != _START  # numbers come again, in a container after each start
    try:
        return psutil.Process(process).status() == psutil.STATUS_ZOMBIE
    except psutil.Error as error:
        return isinstance(error, psutil.NoSuchProcess)


def _remove_abandoned(path: Path) -> None:
    """Remove the temporary files that processes of this machine left when they were killed.

    Those of other machines stay: their processes cannot be seen.
    """
    start = _start_of_name(path)
    with suppress(OSError):  # the write itself names what is wrong with the folder
        for entry in os.scandir(path.parent):
            if not entry.name.startswith(start) or not entry.is_file(follow_symlinks=False):
                continue
            writer = _END_OF_NAME.fullmatch(entry.name, len(start))
            if writer and writer["host"] == _HOST and _has_ended(writer):
                Path(entry).unlink(missing_ok=True)


def _age_s(path: Path) -> float:
    """Return the time since the last change [s]; 0 where it has its own name by now."""
    try:
        return time.time() - path.lstat().st_mtime
    except OSError:
        return 0.0


if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

_Content = TypeVar("_Content")

Opener = Callable[[Path], AbstractContextManager[BinaryIO]]
"""Opens a file to write, as `replacing` does, or refuses to."""

LARGEST = 1e22
"""Larger numbers in tables are refused: no position is as large in any unit of a log."""

MAX_LINE_BYTES = 64 * 2**20
"""Longest line that is read [byte]."""

MAX_FILE_BYTES = 2**30
"""Largest file of a run that is read into memory [byte]; tables of a million robots are smaller."""

MAX_LOG_BYTES = 2**33
"""Largest file of a run that is read piece by piece [byte]."""

MAX_TABLE_BYTES = 2**28
"""Largest content of a compressed table [byte], whose rows are all in memory."""


def numbered_lines(path: Path, most: int = MAX_LOG_BYTES) -> Iterator[tuple[int, str]]:
    """Yield each line with its number, counted from 1; only one line is in memory at a time.

    Raises:
        InputError: as for `raw_lines`, or a line is not UTF-8.
    """
    for number, raw in raw_lines(path, most):
        yield number, decode(raw, path, number)


def raw_lines(
    path: Path,
    most: int = MAX_LOG_BYTES,
    *,
    source: BinaryIO | None = None,
    takes_pipe: bool = False,
) -> Iterator[tuple[int, bytes]]:
    r"""Yield the bytes of each line with its number, counted from 1; a byte-order mark is dropped.

    Lines end with `\n`, `\r\n` or, as in files of old programs for the Mac, with `\r`; the last one
    may have no end.

    Args:
        path: File, or what messages call an open input.
        most: Largest content of a compressed file [byte].
        source: Open input to read in place of the file; a line that arrives in parts is waited for.
        takes_pipe: Whether the file may be a pipe, as for `open_input`.

    Raises:
        InputError: the file cannot be opened, read or decompressed, has a line of more than 64 MiB,
            or is compressed and has more than `most` [byte].
    """
    number = 0
    is_packed = source is None and path.suffix == ".zst"
    try:
        opened = nullcontext(source) if source else _opened(path, takes_pipe=takes_pipe)
        with opened as file:
            for raw in _split_lines(file):
                number += 1
                if is_packed and file.tell() > most:
                    problem = f"has more than {most // 2**20} MiB; decompress it if that is right"
                    raise InputError(problem, path=path, line=number)
                if number == 1:
                    raw = raw.removeprefix(BOM_UTF8)  # noqa: PLW2901
                if len(raw) > MAX_LINE_BYTES:
                    problem = "the line is longer than 64 MiB; write one robot a line"
                    raise InputError(problem, path=path, line=number)
                yield number, raw
    except OSError as error:
        raise unreadable(path, error) from error
    except EOFError as error:
        problem = "the compressed file ends in the middle; copy it again"
        raise InputError(problem, path=path, line=number + 1) from error
    except zstd.ZstdError as error:
        reason = str(error).rpartition(": ")[2]
        problem = f"not a whole Zstandard file ({reason}); compress or copy it again"
        raise InputError(problem, path=path, line=number + 1) from error


def _split_lines(file: BinaryIO) -> Iterator[bytes]:
    """Yield the lines of a file; of one that is too long, the start.

    Several carriage returns before a newline are one end, as double conversion of a file leaves.
    """
    start = b""
    while part := file.readline(MAX_LINE_BYTES + 1):
        has_newline = part.endswith(b"\n")
        if has_newline and not start and b"\r" not in part:
            yield part
            continue
        text = start + part
        end = text[len(text.rstrip(b"\r\n")) :] if has_newline else b""
        *lines, last = text.removesuffix(end).split(b"\r")
        yield from (line + b"\n" for line in lines)
        if has_newline:
            yield last + end
        start = b"" if has_newline else last
        if len(start) > MAX_LINE_BYTES:
            break
    if start:
        yield start


@contextmanager
def _opened(path: Path, *, takes_pipe: bool) -> Iterator[Any]:
    """Open a file to read its content, which is compressed where the name says so."""
    with open_input(path, takes_pipe=takes_pipe) as file:
        if path.suffix != ".zst":
            yield file
            return
        with zstd.ZstdFile(file) as content:
            yield content


_OPENED_BY_SHELL = ("/dev/stdin", "/dev/fd/", "/proc/self/fd/")
"""How names begin of pipes that the shell has opened already, as for `<(...)`."""


def open_input(path: Path, *, takes_pipe: bool = False) -> BinaryIO:
    """Open a file of the user to read its bytes.

    Args:
        path: File.
        takes_pipe: Whether it may be a pipe that the shell has opened, which can be read once.

    Raises:
        InputError: there is no such file, it cannot be read, or it is a pipe or a device.
    """
    refuse_special(path, takes_pipe=takes_pipe)
    try:
        return path.open("rb")
    except OSError as error:
        raise unreadable(path, error) from error


def refuse_special(path: Path, *, takes_pipe: bool = False) -> None:
    """Refuse a file of the user that is no regular file: a pipe may block, a device never end.

    Args:
        path: File; whether a folder can be read is up to the reader.
        takes_pipe: Whether it may be a pipe that the shell has opened.

    Raises:
        InputError: there is no such file, or it is a pipe, a socket or a device.
    """
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise unreadable(path, error) from error
    except ValueError as error:  # of a NUL
        raise InputError("no path of a file; name a file", path=path) from error
    is_opened_by_shell = str(path).startswith(_OPENED_BY_SHELL)
    if not (takes_pipe and is_opened_by_shell):
        files.refuse_special(path, mode)


def unpacked(data: bytes, size: int) -> bytes:
    """Decompress a Zstandard frame up to a stated size; a frame of more stays unpacked beyond.

    Raises:
        ValueError: the frame is damaged or has another size.
    """
    try:
        content = zstd.ZstdDecompressor().decompress(data, size + 1)
    except zstd.ZstdError as error:
        raise ValueError(str(error)) from error
    if len(content) != size:
        raise ValueError("another size than stated")
    return content


def decode(raw: bytes, path: Path, first_line: int = 1) -> str:
    """Decode bytes that start at a given line of a file."""
    try:
        return raw.decode()
    except UnicodeDecodeError as error:
        line = first_line + raw.count(b"\n", 0, error.start)
        problem = f"byte 0x{raw[error.start]:02x} is not UTF-8; save the file as UTF-8"
        raise InputError(problem, path=path, line=line) from error


def unreadable(path: Path, error: OSError) -> InputError:
    """Explain why a file cannot be opened."""
    if isinstance(error, FileNotFoundError):
        return InputError("there is no such file; check the path", path=path)
    if isinstance(error, IsADirectoryError):
        return InputError("this is a folder; name a file", path=path)
    reason = error.strerror or str(error)
    check = "its permissions" if isinstance(error, PermissionError) else "the file and its disk"
    return InputError(f"cannot be read: {reason}; check {check}", path=path)


def run_file(path: Path, most: int = MAX_FILE_BYTES) -> Path:
    """Return the path of a file of a run once it is safe to read, since anybody may have made it.

    A link may lead to private files, a pipe blocks, a device or a sparse file may never end.

    Raises:
        InputError: the file is missing, larger than `most` [byte], or not a regular file.
    """
    try:
        status = path.lstat()
    except OSError as error:
        raise damaged(path, error.strerror) from error
    if not stat.S_ISREG(status.st_mode):
        raise damaged(path, "it is a link or no regular file")
    if status.st_size > most:
        raise damaged(path, f"it is larger than {most // 2**30} GiB")
    if not path.name.isprintable():
        raise damaged(path, "its name is not printable")
    return path


def damaged(path: Path, reason: object) -> InputError:
    """Explain why a file of a run cannot be read."""
    return InputError(f"cannot be read: {reason}; {way_back(path)}", path=path)


def way_back(path: Path) -> str:
    """Say how to restore a file of a run: its tables are made from its cases."""
    if path.suffix == ".csv" and path.parent.parent.name != "cases":
        return f"tiswarm redraw {path.parent} writes it again"
    return "run the scenario again to restore it"


@contextmanager
def at_line(path: Path, line: int) -> Iterator[None]:
    """Add file and line to an InputError that was raised without them."""
    try:
        yield
    except InputError as error:
        raise InputError(error.problem, path=path, line=line, key=error.key) from error


class CsvFile:
    """A CSV file whose cells stay text until a column is read; a bad line raises InputError.

    Cells are separated by commas, or as in the header by semicolons or tabs; numbers may then have
    a decimal comma, the same in all cells of a column. Lines that start with # are comments.
    """

    def __init__(self, path: Path, text: str | None = None) -> None:
        """Read the header; `text` is the content of the file if another reader made it."""
        self.path = path
        lines: Iterable[tuple[int, str]] = numbered_lines(path, MAX_TABLE_BYTES)
        if text is not None:
            lines = enumerate(text.removesuffix("\n").split("\n"), start=1)
        self._lines = ((line, text) for line, text in lines if not text.startswith("#"))
        first, header = next(self._lines, (1, ""))
        if header.startswith("{"):
            problem = "this is JSON, no table; give a table, such as estimate.csv or truth.csv"
            raise InputError(problem, path=path, line=first)
        self._separator = max(",;\t", key=header.count)
        self.columns = [name.strip() for name in self._split(first, header)]
        for number, name in enumerate(self.columns, start=1):
            problem = _fault_of_name(name)
            if problem:
                raise InputError(f"the name of column {number} {problem}", path=path, line=first)

    @cached_property
    def rows(self) -> dict[int, list[str]]:
        """Cells of each robot, by line."""
        rows = {}
        for line, text in self._lines:
            cells = rows[line] = self._split(line, text)
            if len(cells) != len(self.columns):
                problem = f"has {len(cells)} cells; {len(self.columns)} are needed"
                raise InputError(problem, path=self.path, line=line)
        if not rows:
            raise InputError("there are no robots; add a row for each", path=self.path, line=2)
        return rows

    def line(self, row: int) -> int:
        """Line of a row that is counted from 0."""
        return list(self.rows)[row]

    def incomplete(self, columns: Iterable[str]) -> list[int]:
        """List the lines where a cell of some columns is empty or NaN."""
        places = [*map(self.columns.index, columns)]
        return [
            line
            for line, cells in self.rows.items()
            if any(cells[place].strip().lower() in _NO_VALUE for place in places)
        ]

    def drop(self, lines: Iterable[int]) -> None:
        """Forget the rows of some lines; at least one is left."""
        gone = {*lines}
        if gone.issuperset(self.rows):
            problem = "no row is complete; add one for each robot"
            raise InputError(problem, path=self.path, line=min(gone))
        self.rows = {line: cells for line, cells in self.rows.items() if line not in gone}

    def integers(self, column: str) -> Ints:
        """Read a column of whole numbers of 64 bits, shape (rows,)."""
        return np.array(self._values(column, _integer, "a whole number; write it like 7"), np.int64)

    def numbers(self, column: str, *, empty: float | None = None) -> Reals:
        """Read a column of finite numbers, shape (rows,); empty cells are `empty`, or refused."""
        wanted = f"a finite number up to {LARGEST:g}; write it like 0.5 or 1e-3"
        return np.array(self._values(column, _real, wanted, empty), np.float64)

    def words(self, column: str) -> NDArray[np.str_]:
        """Read a column of text, shape (rows,)."""
        place = self.columns.index(column)
        return np.array([cells[place] for cells in self.rows.values()])

    def _values(
        self, column: str, parse: Callable[[str], float], wanted: str, empty: float | None = None
    ) -> list[float]:
        place = self.columns.index(column)
        values = []
        has_points = self._separator == "," or any(
            "." in cells[place] for cells in self.rows.values()
        )
        for line, cells in self.rows.items():
            cell = cells[place]
            number = cell if has_points else cell.replace(",", ".", 1)
            try:
                values.append(parse(number) if cell or empty is None else empty)
            except ValueError:
                problem = f"{cell[:40]!r} is not {wanted}"
                raise InputError(problem, path=self.path, line=line, key=column) from None
        return values

    def _split(self, line: int, text: str) -> list[str]:
        return split_cells(text, self._separator, self.path, line)


def split_cells(
    text: str, separator: str, path: Path, line: int, *, is_strict: bool = True
) -> list[str]:
    """Split a line of a table into its cells; some may be quoted.

    Args:
        text: The line.
        separator: Sign between cells.
        path: Its file.
        line: Its number.
        is_strict: Whether quotes at wrong places are refused.

    Raises:
        InputError: the line is damaged; names file and line.
    """
    if "\0" in text:
        problem = (
            "has NUL characters, as files after a power cut; restore the file, or export it anew"
        )
        raise InputError(problem, path=path, line=line)
    try:
        rows = csv.reader([text], delimiter=separator, strict=is_strict, skipinitialspace=True)
        return next(rows, [])
    except csv.Error as error:
        longest = csv.field_size_limit()
        problem = "a quote has no end, or text behind it; write numbers with commas between them"
        if len(text) > longest:
            problem += f", and at most {longest} characters a cell"
        raise InputError(f"not a row of a table: {problem}", path=path, line=line) from error


LONGEST_NAME = 200
"""Characters of the longest name of a column; longer ones are damage, and slow to understand."""

_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")


def _fault_of_name(name: str) -> str:
    """Say what is wrong with the name of a column; empty if nothing is."""
    if len(name) > LONGEST_NAME:
        return f"has {len(name)} characters; shorten it to at most {LONGEST_NAME}"
    control = _CONTROL.search(name)
    if control:
        return f"has the control character 0x{ord(control[0]):02x}; delete it"
    return ""


_NO_VALUE = (
    *("", "nan", "-nan", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#ind"),
    *("na", "n/a", "#n/a", "null", "none"),
)
"""Cells without a value, as programs write them, in lower case."""


def _integer(cell: str) -> int:
    number = int(cell)
    if "_" in cell or not -(2**63) <= number < 2**63:  # Python alone reads 1_0 as 10
        raise ValueError
    return number


def _real(cell: str) -> float:
    number = float(cell)
    if "_" in cell or not abs(number) <= LARGEST:
        raise ValueError
    return number


@contextmanager
def replacing(
    path: Path, *, on_whole: Callable[[Path], object] = lambda _: None
) -> Iterator[BinaryIO]:
    """Open a file that replaces `path` when the block ends without an exception.

    A reader finds the old file or the new one, never a part, even if the writer is killed. What a
    killed writer left of the same file is removed first.

    Args:
        path: File to write.
        on_whole: Called with the temporary file once it is whole, before it replaces `path`.

    Raises:
        EnvironmentTroubleError: the folder is missing or not writable, or the disk is full.
    """
    _remove_abandoned(path)
    temporary = path_for(path, "tmp")
    try:
        with temporary.open("xb") as file:
            with _compressing(file) if path.suffix == ".zst" else nullcontext(file) as content:
                yield content
            file.flush()
            os.fsync(file.fileno())
        on_whole(temporary)
        temporary.replace(path)
        with suppress(OSError):  # so the name survives a power cut, where that is possible
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
    except OSError as error:
        reason = error.strerror or error
        problem = f"{path}: cannot be written: {reason}; check its folder and the free space"
        raise EnvironmentTroubleError(problem) from error
    finally:
        with suppress(OSError):  # still there only if something failed
            temporary.unlink(missing_ok=True)


def _compressing(file: BinaryIO) -> Any:  # noqa: ANN401 - a file in all but its type
    """Compress what is written to the result, with a checksum that reveals damage."""
    return zstd.ZstdFile(file, "wb", options={zstd.CompressionParameter.checksum_flag: 1})


def write_bytes(path: Path, data: bytes) -> None:
    """Write a whole file at once."""
    with replacing(path) as file:
        file.write(data)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a whole JSON file at once."""
    write_bytes(path, as_json(content))


def as_json(content: Mapping[str, Any]) -> bytes:
    """Return the bytes of a JSON file."""
    return f"{json.dumps(content, indent=1)}\n".encode()


def read_json(path: Path, kind: TypeAdapter[_Content], *, exact: bool = False) -> _Content | None:
    """Read JSON of some kind; None where the file is missing or damaged.

    Args:
        path: File.
        kind: Type of the content; a dataclass where it is to be `exact`.
        exact: Whether bytes that `write_json` would not write are damage, too.
    """
    try:
        raw = run_file(path).read_bytes()
        content = kind.validate_json(raw)
    except (InputError, OSError, ValueError):
        return None
    is_changed = exact and raw != as_json(asdict(content))  # type: ignore[call-overload]
    return None if is_changed else content


def digest(path: Path) -> str:
    """Return the SHA-256 of a file; empty where it is missing or unreadable."""
    summed = sha256()
    try:
        with run_file(path, MAX_LOG_BYTES).open("rb") as file:
            while piece := file.read(2**20):
                summed.update(piece)
    except (InputError, OSError):
        return ""
    return summed.hexdigest()


def make_folder(folder: Path) -> None:
    """Make a folder for results and its parents, or raise EnvironmentTroubleError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = f"{folder}: cannot be made: {error.strerror}; choose another --out"
        raise EnvironmentTroubleError(problem) from error
