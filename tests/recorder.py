"""A receiver of progress reports that keeps them."""

from tiswarm.base.progress import Progress


class Recorder(Progress):
    """Keeps every line."""

    def __init__(self) -> None:
        """Start without lines."""
        self.lines: list[str] = []

    def info(self, text: str) -> None:
        """Keep one line."""
        self.lines.append(text)
