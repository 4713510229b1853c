"""How a run is shown: progress bars on a terminal, plain lines otherwise, nothing if quiet."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

LINE_EVERY_S = 30.0
"""Time from one line on progress to the next, where there is no terminal to draw a bar on."""


class ConsoleWatcher:
    """Tells a person on standard error how work goes on; standard output stays for results."""

    def __init__(self, *, quiet: bool = False) -> None:
        """Show progress unless `quiet`."""
        self.quiet = quiet
        self.console = Console(stderr=True, highlight=False, soft_wrap=True)

    def say(self, text: str) -> None:
        """Show one line."""
        if not self.quiet:
            self.console.print(text, markup=False)

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Callable[[int], None]]:
        """Show a stage while the block runs; its value is told the steps done."""
        if self.quiet or total == 0:
            yield lambda _steps: None
        elif self.console.is_terminal:
            with self._bar() as bar:
                task = bar.add_task(name, total=total)
                yield lambda steps: bar.advance(task, steps)
        else:
            begun = time.perf_counter()
            yield self._lines(name, total, begun)
            self.say(f"{name}: {total} in {time.perf_counter() - begun:.1f} s")

    def _lines(self, name: str, total: int, begun: float) -> Callable[[int], None]:
        """Say now and then how much is done, so that the log of a long job shows it."""
        done, told = 0, begun

        def advance(steps: int) -> None:
            nonlocal done, told
            done += steps
            now = time.perf_counter()
            if now - told >= LINE_EVERY_S and done < total:
                left = (now - begun) * (total - done) / done
                self.say(f"{name}: {done} of {total}, about {left:.0f} s left")
                told = now

        return advance

    def _bar(self) -> Progress:
        return Progress(
            TextColumn("{task.description:<20}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(elapsed_when_finished=True),
            console=self.console,
        )


def fail(message: str) -> None:
    """Print the one line of an error."""
    sys.stderr.write(f"tiswarm: error: {message}\n")
