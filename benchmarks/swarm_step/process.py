"""Processes that run one engine each."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.swarm_step.engines.registry import ENGINES


class EngineProcess:
    """An engine that is ready to run; if it is not, `missing` says why."""

    def __init__(self, engine: str, scene: Path) -> None:
        entry = ENGINES[engine]
        count = str(entry.threads)
        threads = {"OMP_NUM_THREADS": count, "NUMBA_NUM_THREADS": count}
        self.process = subprocess.Popen(  # noqa: S603 - this very program
            [sys.executable, "-m", f"{__package__}.worker", engine, str(scene)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=os.environ | threads | dict(entry.environment),
        )
        self.missing: str = self._answer().get("missing", "")
        if self.missing:
            self.stop()

    def ask(self, **request: Any) -> dict[str, Any]:  # noqa: ANN401 - see worker.py
        """Send a request and wait for the answer."""
        print(json.dumps(request), file=self.process.stdin, flush=True)
        return self._answer()

    def stop(self) -> None:
        """End the process."""
        self.process.communicate()

    def _answer(self) -> dict[str, Any]:
        line = self.process.stdout.readline()
        if line:
            return dict(json.loads(line))
        self.stop()
        msg = f"{self.process.args} ended with status {self.process.returncode}"
        raise RuntimeError(msg)
