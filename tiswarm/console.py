"""How a run is shown: progress bars on a terminal, plain lines otherwise, nothing if quiet."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


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
            yield lambda _steps: None
            self.say(f"{name}: {total} in {time.perf_counter() - begun:.1f} s")

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
