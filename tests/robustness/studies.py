"""Studies in processes of their own, to be killed or to meet each other."""

import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from tests.runs import REPOSITORY, environment

END_S = 600.0
"""Wall time in which a study ends that nobody disturbs [s]."""


class Study:
    """Command of a study, and its folder."""

    def __init__(self, out: Path, cache: Path, settings: Iterable[str]) -> None:
        """Name the parent of the run's folder, the cache of kernels and overrides `KEY=VALUE`."""
        self.out = out
        self.said = out.with_suffix(".txt")
        self.settings = [part for text in settings for part in ("--set", text)]
        # A separate cache of kernels, since a killed process may leave a damaged one.
        self.environment = environment(XDG_CACHE_HOME=str(cache))

    def start(
        self, *options: str, said: Path | None = None, **env: str
    ) -> "subprocess.Popen[bytes]":
        """Start the command in its own process group; `said` receives what it prints."""
        command = [sys.executable, "-m", "tiswarm", "run", "tests/tower.yaml", *self.settings]
        with (said or self.said).open("wb") as file:
            return subprocess.Popen(
                [*command, "--out", self.out, *options],
                cwd=REPOSITORY,
                env=self.environment | env,
                stdout=file,
                stderr=file,
                start_new_session=True,
            )

    def finish(self, *options: str, **env: str) -> None:
        """Run the command to its end, which is without errors."""
        assert self.start(*options, **env).wait(END_S) == 0, self.said.read_text()


def with_lines(folder: Path, lines: str) -> dict[str, str]:
    """Return variables of processes that run some lines of Python as they start."""
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(lines)
    return {"PYTHONPATH": f"{folder}{os.pathsep}{REPOSITORY}"}
