"""Progress and errors on standard error, or in one output of a notebook cell."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

import rich.progress
from rich.console import Console

from tiswarm.base.errors import InputError, TiswarmError
from tiswarm.base.progress import Advance, Note, Progress, ignore

if TYPE_CHECKING:
    from typing_extensions import Self

_LINE_EVERY_S = 30.0
"""Least time between two progress lines where there is no terminal to draw a bar on."""

_CELL_EVERY_S = 0.25
"""Least time between two changes of a notebook's output."""

_BAR = 30
"""Characters of a bar in a notebook."""

_EXCERPT = 72
"""Characters of a line of a file that are shown below an error."""

_AFTER = 12
"""Characters from the mistake on that are shown of a long line."""


class ConsoleProgress(Progress):
    """Shows bars on a terminal, lines and a bar in a notebook, and lines elsewhere."""

    def __init__(self, *, quiet: bool = False) -> None:
        """Show progress unless `quiet`."""
        self.quiet = quiet
        self.console = Console(stderr=True, highlight=False, soft_wrap=True)
        self.cell = _Cell() if self.console.is_jupyter else None
        self.bars: rich.progress.Progress | None = None  # of the tasks that run, on a terminal

    def __enter__(self) -> "Self":
        """Begin the work that is shown."""
        return self

    def __exit__(self, *error: object) -> None:
        """End it."""

    def info(self, text: str) -> None:
        """Print one line."""
        if self.quiet:
            return
        if self.cell:
            self.cell.add(text)
        else:
            self.console.print(text, markup=False)

    @contextmanager
    def task(
        self, name: str, total: int, note: Note = lambda: "", done: int = 0
    ) -> Iterator[Advance]:
        """Show a task while the block runs; the block calls the result with the steps just done."""
        if self.quiet or total == 0:
            yield ignore
            return
        steps = _Steps(total=total, before=done, begun_s=time.perf_counter())
        if self.cell:
            yield self.cell.bar(name, steps, note)
        elif self.console.is_terminal:
            with self._bar(name, steps, note) as advance:
                yield advance
        else:
            yield self._lines(name, steps, note)
        noted = ", ".join(filter(None, (f"{name}: {total}", note())))
        self.info(f"{noted} in {time.perf_counter() - steps.begun_s:.1f} s")

    def _lines(self, name: str, steps: "_Steps", note: Note) -> Advance:
        def show(done: float, remaining: str) -> None:
            about = f"about {remaining}" if remaining else ""
            words = (f"{name}: {done:.0f} of {steps.total}", note(), about)
            self.info(", ".join(filter(None, words)))

        return _paced(show, steps, _LINE_EVERY_S)

    @contextmanager
    def _bar(self, name: str, steps: "_Steps", note: Note) -> Iterator[Advance]:
        """Add a bar below those of the tasks that this one runs within."""
        is_outermost = self.bars is None
        if self.bars is None:
            self.bars = rich.progress.Progress(
                rich.progress.TextColumn("{task.description:<20}"),
                rich.progress.BarColumn(),
                rich.progress.TaskProgressColumn(),
                rich.progress.MofNCompleteColumn(),
                rich.progress.TextColumn("{task.fields[beside]}"),
                console=self.console,
                transient=True,
            )
            self.bars.start()
        bars = self.bars
        task = bars.add_task(name, total=steps.total, completed=steps.before, beside="")

        def show(done: float, remaining: str) -> None:
            bars.update(task, completed=done, beside=", ".join(filter(None, (note(), remaining))))

        try:
            yield _paced(show, steps, 0.0)
        finally:
            bars.remove_task(task)
            if is_outermost:
                bars.stop()
                self.bars = None


class _Cell:
    """The one output of a notebook cell that shows all lines and the bar of the running task."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.handle: Any = None

    def add(self, line: str) -> None:
        """Show a line more, and no bar."""
        self.lines.append(line)
        self.show()

    def show(self, *bar: str) -> None:
        """Replace the output."""
        content = {"text/plain": "\n".join([*self.lines, *bar])}
        if self.handle is None:
            display = import_module("IPython.display").display  # a notebook has it
            self.handle = display(content, raw=True, display_id=True)
        else:
            self.handle.update(content, raw=True)

    def bar(self, name: str, steps: "_Steps", note: Note) -> Advance:
        """Show a bar, and return what moves it."""

        def show(done: float, remaining: str) -> None:
            filled = "#" * int(_BAR * done / steps.total)
            words = ", ".join(filter(None, (f"{done:.0f} of {steps.total}", note(), remaining)))
            self.show(f"{name} [{filled:.<{_BAR}}] {words}")

        show(steps.before, "")
        return _paced(show, steps, _CELL_EVERY_S)


@dataclass(frozen=True, kw_only=True)
class _Steps:
    """The steps of a task, and when it began."""

    total: int
    before: int  # steps that were done before the task began
    begun_s: float  # by `time.perf_counter`


def _paced(show: Callable[[float, str], None], steps: _Steps, every_s: float) -> Advance:
    """Return what shows the steps done every so long, and the time left from a twentieth on."""
    to_do = steps.total - steps.before
    done = 0.0
    shown_s = steps.begun_s

    def advance(just_done: float) -> None:
        nonlocal done, shown_s
        done += just_done
        now_s = time.perf_counter()
        if now_s - shown_s >= every_s and done < to_do:
            is_known = done >= to_do / 20
            left_s = (now_s - steps.begun_s) * (to_do - done) / max(done, to_do / 20)
            show(steps.before + done, f"{left_s:.0f} s left" if is_known else "")
            shown_s = now_s

    return advance


def fail(error: TiswarmError | str) -> None:
    """Print the one line of an error and, on a terminal, the mistake in its file."""
    error = error.as_option() if isinstance(error, TiswarmError) else TiswarmError(error)
    sys.stderr.write(f"tiswarm: error: {error}\n")
    if isinstance(error, InputError) and sys.stderr.isatty():
        sys.stderr.write(_excerpt(error))


def _excerpt(error: InputError) -> str:
    """Show the line of a mistake and a caret below it; nothing where the column is unknown."""
    if error.path is None or error.line is None or error.column is None:
        return ""
    try:
        line = error.path.read_text(errors="replace").removesuffix("\n").split("\n")[error.line - 1]
    except (OSError, IndexError):  # the file has changed
        return ""
    start = max(0, error.column - _EXCERPT + _AFTER)
    shown = "".join(c if c.isprintable() else "?" for c in line[start : start + _EXCERPT])
    return f"    {shown}\n    {'^':>{error.column - start}}\n"
