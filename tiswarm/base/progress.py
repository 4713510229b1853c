"""What long work reports while it runs."""

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

Advance = Callable[[float], None]
"""Receives the steps that were just done."""

Note = Callable[[], str]
"""Returns what to show beside the steps of a task, such as `2 failed`; empty for nothing."""

_PARTS = 64
"""Parts of a step that are reported: a power of 2, so that sums of them are exact."""


class Progress:
    """Receiver of progress reports; this one ignores them, `tiswarm.app.console` shows them."""

    def info(self, text: str) -> None:
        """Report one line."""

    def task(
        self,
        name: str,  # noqa: ARG002 - for those that show it
        total: int,  # noqa: ARG002
        note: Note = lambda: "",  # noqa: ARG002
    ) -> AbstractContextManager[Advance]:
        """Start a task of `total` steps; the block calls the result with the steps just done.

        A task may run within the block of another one.
        """
        return nullcontext(ignore)


def ignore(_steps: float) -> None:
    """Report nothing."""


def by_share(advance: Advance, steps: int) -> Callable[[float], None]:
    """Return a function that reports the share [1] that is done of some steps."""
    reported = 0.0

    def report(share: float) -> None:
        nonlocal reported
        done = steps * math.floor(_PARTS * share) / _PARTS
        advance(done - reported)
        reported = done

    return report
