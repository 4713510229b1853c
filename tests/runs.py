"""The command line, in a process of its own or in this one, and comparisons of its results."""

import filecmp
import io
import os
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from unittest.mock import patch

from tiswarm import study
from tiswarm.base.progress import Progress
from tiswarm.base.registry import BUILT_IN
from tiswarm.cli import main
from tiswarm.records.run_folder import ENGINE_METHOD, NO_METHOD
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study.run import RunResult

REPOSITORY = Path(__file__).parents[1]
MEASURED = {"manifest.json", "cost.json", "report.html"}
"""Files of a run that depend on the machine and the clock."""

LOCALIZERS = [name for name in BUILT_IN["method"] if name not in {NO_METHOD, ENGINE_METHOD}]
"""Methods that localize robots by their logs."""

QUIET = Progress()
"""Shows nothing."""

_SILENT = DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning
"""Warnings that Python itself does not show to users; pytest does."""

Command = Callable[..., "subprocess.CompletedProcess[str]"]


def environment(**env: str) -> dict[str, str]:
    """Return the environment of a user's process, whose kernels run without bounds checks."""
    return {name: value for name, value in os.environ.items() if name != "TISWARM_DEBUG"} | env


@contextmanager
def interruptible() -> Iterator[None]:
    """Let Ctrl-C end children that start within, also where this process ignores it: under nohup.

    A child inherits that a signal is ignored, but not its handler.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def python(*arguments: object, cwd: Path = REPOSITORY, **env: str):
    """Run Python with some arguments in a process of its own; return status and what it prints."""
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env=environment(**env),
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def call(*arguments: object, cwd: Path = REPOSITORY, **env: str):
    """Call `tiswarm` with some arguments, as a user does: in a process of its own."""
    return python("-m", "tiswarm", *arguments, cwd=cwd, **env)


def call_here(*arguments: object, cwd: Path = REPOSITORY):
    """Call `tiswarm` with some arguments in this process, which has compiled its kernels.

    A process of its own takes seconds to import libraries and to compile. Here kernels also check
    the bounds of their arrays. What children write themselves is not in the result.
    """
    command = ["tiswarm", *map(str, arguments)]
    out, err = io.StringIO(), io.StringIO()
    before = Path.cwd(), signal.getsignal(signal.SIGTERM)
    with (
        patch.object(sys, "argv", command),
        patch.dict(os.environ),
        warnings.catch_warnings(),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        warnings.simplefilter("default")
        for kind in _SILENT:
            warnings.simplefilter("ignore", kind)
        os.chdir(cwd)
        try:
            main()
        except SystemExit as end:
            status = end.code
        finally:
            os.chdir(before[0])
            signal.signal(signal.SIGTERM, before[1])
    return subprocess.CompletedProcess(command, status, out.getvalue(), err.getvalue())


def run_tower(
    out: Path, settings: Iterable[str], *, progress: Progress = QUIET, **execution: object
) -> RunResult:
    """Run the scenario of the tests under some settings, in this process unless `execution` says.

    Args:
        out: Parent of the run's folder.
        settings: Overrides `KEY=VALUE`.
        progress: Receives progress reports.
        execution: Fields of `tiswarm.study.Execution`.
    """
    scenario = load_scenario(REPOSITORY / "tests" / "tower.yaml", [*settings])
    return study.run(scenario, out, progress=progress, execution=study.Execution(**execution))


def assert_same_results(a: Path, b: Path) -> None:
    """Compare every byte that does not depend on the machine, but hidden locks."""
    found = [
        {p.relative_to(run) for p in run.rglob("[!.]*") if p.is_file() and p.name not in MEASURED}
        for run in (a, b)
    ]
    assert found[0] == found[1]
    different = filecmp.cmpfiles(a, b, found[0], shallow=False)[1:]
    assert different == ([], []), different
    assert not [*b.rglob(".*.part"), *b.rglob(".*.tmp")]


def repeated_files(folder: Path) -> dict[Path, bytes]:
    """Read all files of runs that must repeat: those that are neither measured nor drawn."""
    return {
        path.relative_to(folder): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
        and path.name not in MEASURED
        and not {"figures", "renders"} & set(path.parts)
    }


def assert_same_bytes(a: Path, b: Path) -> None:
    """Compare every byte of two runs that is neither measured nor drawn."""
    one, other = repeated_files(a), repeated_files(b)
    assert one
    assert one.keys() == other.keys()
    assert [path for path, content in one.items() if other[path] != content] == []
