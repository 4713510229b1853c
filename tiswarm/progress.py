"""What long work reports while it runs."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext


class Progress:
    """Receiver of progress reports; this one ignores them, `tiswarm.console` shows them."""

    def info(self, text: str) -> None:
        """Report one line."""

    def task(self, name: str, total: int) -> AbstractContextManager[Callable[[int], None]]:  # noqa: ARG002
        """Start a task of `total` steps; the block calls the result with the steps just done."""
        return nullcontext(lambda _steps: None)
