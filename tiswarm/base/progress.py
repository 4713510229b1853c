"""What long work reports while it runs."""

import shlex
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

Advance = Callable[[float], None]
"""Receives the steps that were just done."""

Note = Callable[[], str]
"""Returns what to show beside the steps of a task, such as `2 failed`; empty for nothing."""

Watch = Callable[[Sequence[Any]], None]
"""Receives the structures that grow, after each round."""


class Progress:
    """Receiver of progress reports; this one ignores them, `tiswarm.app.console` shows them."""

    def info(self, text: str) -> None:
        """Report one line."""

    def begun(self, run: Path) -> None:
        """Report that cases are computed from now on into the folder of a run, where it stays."""
        self.info(f"to watch: tiswarm view --live {shlex.quote(str(run))}")

    def task(
        self,
        name: str,  # noqa: ARG002 - for those that show it
        total: int,  # noqa: ARG002
        note: Note = lambda: "",  # noqa: ARG002
        done: int = 0,  # noqa: ARG002
    ) -> AbstractContextManager[Advance]:
        """Start a task of `total` steps; the block calls the result with the steps just done.

        A task may run within the block of another one.

        Args:
            name: What is done.
            total: Steps in all.
            note: What to show beside the steps.
            done: Steps that were done before, and say nothing of the time that others take.
        """
        return nullcontext(ignore)

    def watch(
        self,
        names: Sequence[str],  # noqa: ARG002 - for those that show structures
        robots: int,  # noqa: ARG002
        folder: Path | None = None,  # noqa: ARG002
    ) -> AbstractContextManager[Watch]:
        """Watch structures while they grow; the block calls the result after each round.

        Args:
            names: Name of each structure.
            robots: Robots that each is to have.
            folder: Folder of the run that they are grown for; None without one.
        """
        return nullcontext(ignore)


def ignore(_news: object) -> None:
    """Report nothing."""
