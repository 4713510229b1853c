"""A receiver of progress reports that keeps them."""

from tiswarm.base.progress import Progress


class Recorder(Progress):
    """Keeps every line, and the name of every task."""

    def __init__(self) -> None:
        """Start without lines and tasks."""
        self.lines: list[str] = []
        self.tasks: list[str] = []

    def info(self, text: str) -> None:
        """Keep one line."""
        self.lines.append(text)

    def task(self, name, total, note=lambda: "", done=0):
        """Keep the name of a task."""
        self.tasks.append(name)
        return super().task(name, total, note, done)
