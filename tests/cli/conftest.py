"""The command line as a user calls it: in a process of its own."""

import filecmp
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
MEASURED = {"manifest.json", "cost.json", "report.html"}
Command = Callable[..., "subprocess.CompletedProcess[str]"]


def assert_same_results(a: Path, b: Path) -> None:
    """Compare every byte that does not depend on the machine, but hidden locks."""
    found = [
        {p.relative_to(run) for p in run.rglob("[!.]*") if p.is_file() and p.name not in MEASURED}
        for run in (a, b)
    ]
    assert found[0] == found[1]
    assert filecmp.cmpfiles(a, b, found[0], shallow=False)[1:] == ([], [])
    assert not [*b.rglob(".*.part"), *b.rglob(".*.tmp")]


@pytest.fixture(scope="session")
def tiswarm() -> Command:
    """Call `tiswarm` with some arguments; its own kernels run without bounds checks."""

    def call(*arguments: object, cwd: Path = REPOSITORY, **env: str):
        environment = {k: v for k, v in os.environ.items() if k != "TISWARM_DEBUG"} | env
        return subprocess.run(
            [sys.executable, "-m", "tiswarm", *map(str, arguments)],
            cwd=cwd,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )

    return call


@pytest.fixture(scope="session")
def small_run(tiswarm: Command, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a small run of the tower scenario, drawn."""
    out = tmp_path_factory.mktemp("runs")
    done = tiswarm(
        "run", "scenarios/tower.yaml", "--set", "robots=12", "--set", "seeds=2", "--out", out
    )
    assert done.returncode == 0, done.stderr
    return next(out.iterdir())
