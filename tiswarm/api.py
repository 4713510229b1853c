"""Functions of `import tiswarm`: localize a log, run a scenario.

import tiswarm

log = tiswarm.read_log("sensing.jsonl")
estimate = tiswarm.localize(log, "joint", cues=["contacts", "height"], chains=4)
estimate.position, estimate.observability.known

run = tiswarm.run("scenarios/tower.yaml", {"robots": 20, "seeds": 2})
run.table, run.frame("estimate", case="0-baseline"), run.figures["convergence"]
"""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tiswarm.compute import backend
from tiswarm.console import ConsoleProgress
from tiswarm.errors import InputError
from tiswarm.inspection import convergence_warning
from tiswarm.localization import registry
from tiswarm.params import Arch, Precision
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_log import SensingLog
from tiswarm.scenario.validation import localization_params

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Figure:
    """A picture of a run; notebooks show it."""

    path: Path

    def _repr_png_(self) -> bytes:
        return self.path.read_bytes()


@dataclass(frozen=True)
class Run:
    """Results of a run, as data frames and figures."""

    folder: Path

    @property
    def table(self) -> "pd.DataFrame":
        """Results by condition, `table.csv`."""
        return self.frame("table")

    @property
    def summary(self) -> "pd.DataFrame":
        """Results by case, with the reason of each failure, `summary.csv`."""
        return self.frame("summary")

    def frame(self, name: str, *, case: str | None = None) -> "pd.DataFrame":
        """Read another table of the run, or one of a case.

        Raises:
            InputError: the run has no table of that name.
        """
        from tiswarm.records.frames import read_frame  # noqa: PLC0415 - slow to import

        folder = self.folder if case is None else self.folder / "cases" / case
        return read_frame(folder / f"{name}.csv", empty=True)

    @property
    def figures(self) -> dict[str, Figure]:
        """Figures and renders by name; none after a run without pictures."""
        drawn = [*self.folder.glob("figures/*.png"), *self.folder.glob("renders/*.png")]
        return {path.stem: Figure(path) for path in sorted(drawn)}


def _plain(values: Mapping[str, object]) -> dict[str, object]:
    """Convert values to plain data, with lists and numbers for arrays and scalars of NumPy."""
    found: dict[str, object] = {}
    for key, value in values.items():
        try:
            found[key] = json.loads(json.dumps(value, default=_from_numpy))
        except TypeError as error:
            problem = f"{error}; give numbers, strings, lists or dictionaries"
            raise InputError(problem, key=key) from error
    return found


def _from_numpy(value: object) -> object:
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"is of type {type(value).__name__}")


def read_log(path: str | PathLike[str]) -> SensingLog:
    """Read a sensing log, `sensing.jsonl`.

    Raises:
        InputError: the file cannot be read or a line is malformed, with file, line and key.
    """
    return read_sensing_log(Path(path))


def localize(
    log: SensingLog | str | PathLike[str],
    method: str = "joint",
    *,
    cues: Sequence[str] | None = None,
    arch: Arch = "cpu",
    threads: int | None = None,
    precision: Precision = "f64",
    **settings: object,
) -> Estimate:
    """Estimate the robots' positions from a log, as `tiswarm localize` does.

    Args:
        log: Sensing log, or its file.
        method: Name of the method.
        cues: Cues to use; the method's own choice if None.
        arch: Compute device.
        threads: CPU threads; all that this process may use if None.
        precision: Floating-point type of the kernels.
        settings: Settings of the method by name, nested ones as dictionaries.

    Returns:
        The estimate; a warning is issued if it did not converge.

    Raises:
        InputError: the log, method, a cue or a setting is invalid.
        EnvironmentTroubleError: the machine lacks the device.
    """
    params = localization_params(method, cues=cues, values=_plain(settings))
    sensed = log if isinstance(log, SensingLog) else read_log(log)
    backend.start(arch, threads=threads, precision=precision)
    estimate = registry.localize(sensed, params)
    if warning := convergence_warning(sensed, estimate):
        warnings.warn(warning, stacklevel=2)
    return estimate


def run(
    scenario: str | PathLike[str],
    overrides: Mapping[str, object] | None = None,
    *,
    out: str | PathLike[str] = "reports",
    arch: Arch = "cpu",
    threads: int | None = None,
    workers: int | None = None,
    pictures: bool = True,
    quiet: bool = False,
) -> Run:
    """Grow, sense, localize, evaluate and draw all cases of a scenario, as `tiswarm run` does.

    Cases that an earlier call finished are not computed again. A warning names failed cases.

    Args:
        scenario: YAML file.
        overrides: Values by dotted key that replace the file's.
        out: Parent of the run folder.
        arch: Compute device.
        threads: CPU threads; all that this process may use if None.
        workers: Number of worker processes; none if None.
        pictures: Whether to draw figures, renders and report.html.
        quiet: Whether to hide progress.

    Raises:
        InputError: the scenario has a mistake.
        EnvironmentTroubleError: the machine lacks the device.
    """
    from tiswarm import study  # noqa: PLC0415 - slow to import
    from tiswarm.drawing import draw_all  # noqa: PLC0415 - slow to import
    from tiswarm.scenario.expansion import load_scenario  # noqa: PLC0415 - slow to import

    texts = [f"{key}={json.dumps(value)}" for key, value in _plain(overrides or {}).items()]
    plan, progress = load_scenario(Path(scenario), texts), ConsoleProgress(quiet=quiet)
    execution = study.Execution(workers=workers)
    result = study.run(
        plan, Path(out), progress=progress, arch=arch, threads=threads, execution=execution
    )
    draw_all(result, progress, pictures=pictures)
    if result.failed:
        warnings.warn(result.what_failed, stacklevel=2)
    return Run(result.folder)
