"""Progress and errors on standard error; standard output stays for results."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import rich.progress
from rich.console import Console

from tiswarm.progress import Progress

_LINE_EVERY_S = 30.0
"""Least time between two progress lines where there is no terminal to draw a bar on."""


class ConsoleProgress(Progress):
    """Shows bars on a terminal, and lines elsewhere."""

    def __init__(self, *, quiet: bool = False) -> None:
        """Show progress unless `quiet`."""
        self.quiet = quiet
        self.console = Console(stderr=True, highlight=False, soft_wrap=True)

    def info(self, text: str) -> None:
        """Print one line."""
        if not self.quiet:
            self.console.print(text, markup=False)

    @contextmanager
    def task(self, name: str, total: int) -> Iterator[Callable[[int], None]]:
        """Show a task while the block runs; the block calls the result with the steps just done."""
        if self.quiet or total == 0:
            yield lambda _steps: None
        elif self.console.is_terminal:
            with self._bar() as bar:
                task = bar.add_task(name, total=total)
                yield lambda steps: bar.advance(task, steps)
        else:
            begun = time.perf_counter()
            yield self._lines(name, total, begun)
            self.info(f"{name}: {total} in {time.perf_counter() - begun:.1f} s")

    def _lines(self, name: str, total: int, begun: float) -> Callable[[int], None]:
        done, printed = 0, begun

        def advance(steps: int) -> None:
            nonlocal done, printed
            done += steps
            now = time.perf_counter()
            if now - printed >= _LINE_EVERY_S and done < total:
                left = (now - begun) * (total - done) / done
                self.info(f"{name}: {done} of {total}, about {left:.0f} s left")
                printed = now

        return advance

    def _bar(self) -> rich.progress.Progress:
        return rich.progress.Progress(
            rich.progress.TextColumn("{task.description:<20}"),
            rich.progress.BarColumn(),
            rich.progress.MofNCompleteColumn(),
            rich.progress.TimeRemainingColumn(elapsed_when_finished=True),
            console=self.console,
        )


def fail(message: str) -> None:
    """Print the one line of an error."""
    sys.stderr.write(f"tiswarm: error: {message}\n")
