"""The errors a user can cause or must hear about, each with the exit status it ends in."""

from pathlib import Path


class TiswarmError(Exception):
    """Base of every error that is told in one line instead of a traceback."""

    exit_status = 1


class InputError(TiswarmError):
    """A file, option or value given by the user cannot be used; nothing was written."""

    exit_status = 2

    def __init__(
        self, problem: str, *, path: Path | None = None, line: int | None = None, key: str = ""
    ) -> None:
        """Compose `file:line: key: problem`, leaving out what is not known.

        Args:
            problem: What is wrong, a semicolon, and what to do about it.
            path: The file at fault.
            line: Line in that file, counted from 1.
            key: Dotted key at fault.
        """
        place = "" if path is None else str(path) if line is None else f"{path}:{line}"
        super().__init__(": ".join(part for part in (place, key, problem) if part))
        self.problem = problem
        self.path = path
        self.line = line
        self.key = key


class EnvironmentTroubleError(TiswarmError):
    """The machine lacks something: a backend, a library, memory, a writable folder."""


NOT_CONVERGED = 4
"""Exit status of `tiswarm localize` where it wrote an estimate that did not converge."""


class CasesFailedError(TiswarmError):
    """Some cases of a study failed; the others are kept."""

    exit_status = 3
