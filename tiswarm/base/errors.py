"""Errors for users, each with its exit status."""

import sys
import warnings
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

_LONGEST = 1000
"""Characters of the longest message."""


class TiswarmError(Exception):
    """Base of all errors that users see in one line, without a traceback."""

    exit_status = 1

    def __init__(self, message: str = "") -> None:
        """Escape what a terminal would obey instead of printing it, and cut a long middle out."""
        letters = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in message)
        line = "".join(letters)
        if len(line) > _LONGEST:  # its end says what to do
            line = f"{line[: _LONGEST - 205]} ... {line[-200:]}"
        super().__init__(line)

    def as_option(self) -> "TiswarmError":
        """Return the error with a command's option in place of a function's argument."""
        return self


class InputError(TiswarmError):
    """A file, option or value of the user is invalid; nothing was written."""

    exit_status = 2

    def __init__(
        self,
        problem: str,
        *,
        path: Path | None = None,
        line: int | None = None,
        column: int | None = None,
        argument: str = "",
        key: str = "",
    ) -> None:
        """Compose `file:line: argument: key: problem` from the known parts.

        Args:
            problem: What is wrong, a semicolon, and how to fix it.
            path: File at fault.
            line: Line in the file, counted from 1.
            column: Column in the line, counted from 1; not part of the message.
            argument: Argument of a function at fault.
            key: Dotted key at fault.
        """
        place = "" if path is None else str(path)
        if place and line is not None:
            place = f"{path}:{line}"
        super().__init__(": ".join(part for part in (place, argument, key, problem) if part))
        self.problem = problem
        self.path = path
        self.line = line
        self.column = column
        self.argument = argument
        self.key = key

    def as_option(self) -> "InputError":
        """Return the error with a command's option in place of a function's argument."""
        if not self.argument:
            return self
        differs = {
            "overrides": f"--set {self.key}",
            "estimate": "ESTIMATE",
            "movie": "--animate",
            "form": "--format",
            "goals": "--goal",
            "prices": "--price",
            "case_limit_s": "--case-limit",
        }
        option = differs.get(self.argument, f"--{self.argument}")
        return InputError(
            self.problem, path=self.path, line=self.line, column=self.column, key=option
        )


class OutputExistsError(InputError):
    """A file that was to be written exists, and stays as it is."""

    def __init__(self, files: Mapping[Path, str]) -> None:
        """Name the files, the first one in full.

        Args:
            files: The argument that names each file; empty where it is unknown.
        """
        first, *others = files
        names = [str(file) if file.parent != first.parent else file.name for file in others]
        if len(names) > _MOST_NAMED:
            names = [*names[:_MOST_NAMED], f"{len(names) - _MOST_NAMED} more"]
        also = ""
        if names:
            *before, last = names
            listed = f"{', '.join(before)} and {last}" if before else last
            also = f", {'as does' if len(others) == 1 else 'as do'} {listed}"
        self._problem = f"exists already{also}"
        self._arguments = [argument for argument in dict.fromkeys(files.values()) if argument]
        super().__init__(self._advised("overwrite=True", ""), path=first)

    def as_option(self) -> InputError:
        """Return the error with a command's options in place of a function's arguments."""
        return InputError(self._advised("--overwrite", "--"), path=self.path)

    def _advised(self, overwrite: str, dashes: str) -> str:
        """Say what to do; `dashes` stand before the name of an argument."""
        changes = [f"another {dashes}{argument}" for argument in self._arguments]
        return f"{self._problem}; give {overwrite} or {' and '.join(changes) or 'another name'}"


class EnvironmentTroubleError(TiswarmError):
    """The machine lacks something: a backend, a library, a writable folder."""


class OutOfMemoryError(EnvironmentTroubleError):
    """The memory did not suffice; that of fewer robots may."""


NOT_TRUSTED = 4
"""Exit status of `tiswarm localize` if the estimate that it wrote did not converge, or if noise as
stated does not explain the measurements."""


class CasesFailedError(TiswarmError):
    """Cases of a study failed; the results of all others are kept."""

    exit_status = 3


class ResultWarning(UserWarning):
    """A result is there, but part of it is missing, or not to be trusted."""


def warn(text: str) -> None:
    """Warn of a result, at the line of the caller's own code."""
    depth = 1
    frame = sys._getframe()  # noqa: SLF001 - each Python that we support has it
    while frame.f_back and frame.f_globals.get("__name__", "").startswith("tiswarm."):
        depth += 1
        frame = frame.f_back
    warnings.warn(text, ResultWarning, stacklevel=depth)


def did_you_mean(name: object, names: Collection[str]) -> str:
    """Return the name that is nearest to a wrong one as the end of a message, or nothing."""
    import difflib  # noqa: PLC0415 - few need it

    near = difflib.get_close_matches({"gpu": "cuda"}.get(str(name), str(name)), names, n=1)
    return f"; did you mean {near[0]}?" if near else ""


_MOST_NAMED = 9
"""Names that an error lists."""


def require_name(name: str, names: Sequence[str], argument: str) -> None:
    """Refuse a name that is not among some.

    Args:
        name: What a caller gave.
        names: Names to choose from.
        argument: Argument of a function that has the name.

    Raises:
        InputError: the name is not one of them.
    """
    if name in names:
        return
    problem = f"there is no {name!r}"
    if names:
        listed = ", ".join(names[:_MOST_NAMED])
        more = ", ..." if len(names) > _MOST_NAMED else ""
        problem += f"; choose one of {listed}{more}"
    raise InputError(f"{problem}{did_you_mean(name, names)}", argument=argument)
