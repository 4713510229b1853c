"""Functions of `import tiswarm`: they call what the commands call.

import tiswarm

log = tiswarm.read_log("sensing.jsonl")
estimate = tiswarm.localize(log, "joint", cues=["contacts", "height"], chains=4)
estimate.position, estimate.observability.known, estimate.to_frame()
tiswarm.view(log, estimate, out="view.html")
tiswarm.score("truth.csv", estimate)["RMSE"]

run = tiswarm.run("scenarios/tower.yaml", {"robots": 20, "seeds": 2})
run.table, run.frame("estimate", case="0-baseline"), run.figures["convergence"]
"""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from tiswarm.console import ConsoleProgress
from tiswarm.errors import InputError
from tiswarm.inspection import Inspection, explain_estimate, inspect
from tiswarm.localization import registry
from tiswarm.params import AnyArch, AnyFormat, AnyPrecision
from tiswarm.records.estimate import Estimate
from tiswarm.records.positions import read_estimate, read_positions_of
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_log import SensingLog
from tiswarm.results import Figures, File, Run, as_path, choose, open_run
from tiswarm.scenario.validation import localization_params
from tiswarm.verdicts import distrust

if TYPE_CHECKING:
    import pandas as pd

    from tiswarm.aliases import Reals
    from tiswarm.interop.imports import Imported
    from tiswarm.report.swarm_view import SwarmView


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


def read_log(path: File) -> SensingLog:
    """Read a sensing log, `sensing.jsonl`.

    Raises:
        InputError: the file cannot be read or a line is malformed, with file, line and key.
    """
    return read_sensing_log(as_path(path, "path"))


def localize(
    log: SensingLog | File,
    method: str = "joint",
    *,
    cues: Sequence[str] | None = None,
    arch: AnyArch = "cpu",
    threads: int | None = None,
    precision: AnyPrecision = "auto",
    **settings: object,
) -> Estimate:
    """Estimate the robots' positions from a log, as `tiswarm localize` does.

    Args:
        log: Sensing log, or its file.
        method: Name of the method.
        cues: Cues to use; the method's own choice if None.
        arch: Compute device of `joint`, and of `virtual-force` under the schedule `together`;
            other methods run on the processor. `auto` takes a graphics card if one works.
        threads: CPU threads; all that this process may use if None.
        precision: Floating-point type on that device; `auto` takes f64 where it computes that at
            half the rate of f32. Other methods compute in f64.
        settings: Settings of the method by name, nested ones as dictionaries.

    Returns:
        The estimate. A warning is issued if it did not converge, or if noise as stated does not
        explain the measurements: `estimate.convergence` has both verdicts and the reason.

    Raises:
        InputError: the log, method, a cue or a setting is invalid.
        EnvironmentTroubleError: the machine lacks the device.
    """
    params = localization_params(method, cues=cues, values=_plain(settings))
    sensed = log if isinstance(log, SensingLog) else read_log(log)
    registry.start_device([registry.title(params)], arch, threads=threads, precision=precision)
    estimate = registry.localize(sensed, params)
    if warning := distrust(sensed, estimate):
        warnings.warn(warning, stacklevel=2)
    return estimate


def run(
    scenario: File,
    overrides: Mapping[str, object] | None = None,
    *,
    out: File = "reports",
    arch: AnyArch = "cpu",
    threads: int | None = None,
    workers: int | None = None,
    pictures: bool = True,
    quiet: bool = False,
) -> Run:
    """Grow, sense, localize, evaluate and draw all cases of a scenario, as `tiswarm run` does.

    Cases that an earlier call finished are not computed again. A warning names failed cases.

    Args:
        scenario: YAML file, or the name of a shipped scenario.
        overrides: Values by dotted key that replace the file's.
        out: Parent of the run folder.
        arch: Compute device, as for `localize`.
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
    plan, progress = (
        load_scenario(as_path(scenario, "scenario"), texts),
        ConsoleProgress(quiet=quiet),
    )
    execution = study.Execution(workers=workers)
    result = study.run(
        plan,
        as_path(out, "out"),
        progress=progress,
        arch=arch,
        threads=threads,
        execution=execution,
    )
    draw_all(result, progress, pictures=pictures)
    if result.failed:
        warnings.warn(result.what_failed, stacklevel=2)
    return Run(result.folder)


def check(path: File) -> Inspection:
    """Check a scenario (.yaml) or a sensing log (.jsonl).

    Returns:
        Its mistakes, as errors, and if there are none a summary.
    """
    return inspect(as_path(path, "path"))


def import_poses(
    poses: File,
    *,
    out: File | None = None,
    **assumed: Any,  # noqa: ANN401 - types of their own
) -> "dict[str, Imported]":
    """Convert robot poses of any simulator to sensing logs and true positions.

    Args:
        poses: Table `robot,x,y,z,qw,qx,qy,qz` or `robot,sphere,x,y,z`.
        out: Folder for `sensing.jsonl` and `truth.csv`; nothing is written if None.
        assumed: Fields of `tiswarm.interop.imports.Assumptions`, such as `dock_radius`.

    Returns:
        Log, positions and notes of each structure by its name in the column `run`, or by "".

    Raises:
        InputError: the table is malformed, or there is no such field.
    """
    from tiswarm.interop import imports  # noqa: PLC0415 - slow to import

    for name in assumed:
        choose(name, [field.name for field in fields(imports.Assumptions)], "assumed")
    found = imports.import_poses(as_path(poses, "poses"), imports.Assumptions(**assumed))
    if out is not None:
        for run, imported in found.items():
            imports.write_import(imported, as_path(out, "out") / run)
    return found


def score(truth: File, estimate: Estimate | File) -> dict[str, float]:
    """Compare an estimate, or its table, with a table of true positions.

    Returns:
        Errors in the truth's unit by name, as it is and after alignment.

    Raises:
        InputError: a table is malformed, or the estimate has another unit or other robots.
    """
    from tiswarm.evaluation.tables import score_files  # noqa: PLC0415 - slow to import

    found = estimate if isinstance(estimate, Estimate) else as_path(estimate, "estimate")
    return score_files(as_path(truth, "truth"), found)[1]


def advise(log: SensingLog | File, estimate: Estimate | File | None = None) -> "pd.DataFrame":
    """List which further contact, height or known position would constrain most robots.

    Where the estimate has robots that are mirrored, the list says what excludes one of the images.

    Args:
        log: Sensing log, or its file.
        estimate: Estimate, or its table, which has no solutions; `joint` localizes the log if None.
    """
    import pandas as pd  # noqa: PLC0415 - slow to import

    sensed, found = _estimated(log, estimate)
    path = Path("log") if isinstance(log, SensingLog) else as_path(log, "log")
    rows = pd.DataFrame(explain_estimate(sensed, path, found).advice)
    for name in rows.columns.drop(["further measurement", "robots determined"], errors="ignore"):
        rows[name] = pd.to_numeric(rows[name])
    return rows


def view(
    log: SensingLog | File,
    estimate: Estimate | File | None = None,
    truth: File | None = None,
    *,
    out: File = "view.html",
) -> Path:
    """Show an estimate on a page with a 3D view, its uncertainty and what the log leaves open.

    Args:
        log: Sensing log, or its file.
        estimate: Estimate, or its table; `joint` localizes the log if None.
        truth: Table of true positions, if there is one.
        out: Page to write.

    Returns:
        The page.

    Raises:
        InputError: a file is malformed, or a table has other robots than the log.
    """
    from tiswarm.drawing import draw_log  # noqa: PLC0415 - slow to import

    sensed, found = _estimated(log, estimate)
    true = _true_positions(sensed, truth)
    path = Path("sensing log" if isinstance(log, SensingLog) else as_path(log, "log"))
    findings = explain_estimate(sensed, path, found)
    draw_log(as_path(out, "out"), sensed, found, name=path.name, true=true, **findings._asdict())
    return as_path(out, "out")


def _estimated(
    log: SensingLog | File, estimate: Estimate | File | None
) -> tuple[SensingLog, Estimate]:
    """Read a log and its estimate as far as they are files; localize without an estimate."""
    sensed = log if isinstance(log, SensingLog) else read_log(log)
    if isinstance(estimate, Estimate):
        return sensed, estimate
    if estimate is None:
        return sensed, localize(sensed)
    return sensed, read_estimate(sensed, as_path(estimate, "estimate"))


def render(
    source: Run | SensingLog | File,
    estimate: Estimate | File | None = None,
    truth: File | None = None,
    *,
    renderer: str | None = None,
    case: str | None = None,
    movie: Literal["gif", "mp4"] | None = None,
    out: File | None = None,
    quiet: bool = False,
) -> Figures:
    """Draw 3D pictures of a run, which its report.html shows too, or of a log and its estimate.

    Args:
        source: Run or its folder, or a sensing log or its file.
        estimate: Estimate of a log, or its table; `joint` localizes the log if None.
        truth: Table of a log's true positions, if there is one.
        renderer: "open3d" or "taichi"; the first that works if None.
        case: Case of a run; the largest if None.
        movie: File format of an animation of a run's growth; none if None.
        out: Folder for pictures of a log; `renders` if None.
        quiet: Whether to hide progress.

    Returns:
        Figures and renders of the run, or pictures of the log, by name.
    """
    from tiswarm.drawing import draw, render_log  # noqa: PLC0415 - slow to import
    from tiswarm.report.run_data import load_run  # noqa: PLC0415 - slow to import

    progress = ConsoleProgress(quiet=quiet)
    if run := _as_run(source):
        _refuse("a run has its own", estimate=estimate, truth=truth, out=out)
        data = load_run(run.folder)
        draw(data, progress, renders=True, movie=movie, renderer=renderer, case=case)
        return run.figures
    _refuse("a log is no run", case=case, movie=movie)
    view, folder = _view_of(source, estimate, truth), as_path(out or "renders", "out")
    written = render_log(view, folder, progress, renderer=renderer)
    return Figures.of(written)


def export(
    source: Run | SensingLog | File,
    form: AnyFormat = "gltf",
    estimate: Estimate | File | None = None,
    truth: File | None = None,
    *,
    out: File | None = None,
    case: str | None = None,
    quiet: bool = False,
) -> Path:
    """Export structure, contacts and estimate of a case, or of a log, for other programs.

    Args:
        source: Run or its folder, or a sensing log or its file.
        form: File format.
        estimate: Estimate of a log, or its table; `joint` localizes the log if None.
        truth: Table of a log's true positions, if there is one.
        out: Folder to write to; `export`, in the run's folder if there is one, if None.
        case: Case of a run; the largest if None.
        quiet: Whether to hide progress.

    Returns:
        The folder with the files.
    """
    from tiswarm.interop.exports import export_view  # noqa: PLC0415 - slow to import
    from tiswarm.report.run_data import load_run  # noqa: PLC0415 - slow to import
    from tiswarm.report.swarm_view import read_case_view  # noqa: PLC0415 - slow to import

    if run := _as_run(source):
        _refuse("a run has its own", estimate=estimate, truth=truth)
        shown = read_case_view(load_run(run.folder).choose(case))
    else:
        _refuse("a log is no run", case=case)
        shown = _view_of(source, estimate, truth)
    folder = as_path(out or (run.folder / "export" if run else "export"), "out")
    export_view(shown, form, folder, ConsoleProgress(quiet=quiet))
    return folder


def _as_run(source: Run | SensingLog | File) -> Run | None:
    """Open a run; None if the source is a log."""
    if isinstance(source, Run | SensingLog):
        return source if isinstance(source, Run) else None
    return open_run(source) if as_path(source, "source").is_dir() else None


def _refuse(reason: str, **given: object) -> None:
    """Refuse the first argument that has a value."""
    for name, value in given.items():
        if value is not None:
            raise InputError(f"{reason}; leave it out", argument=name)


def _view_of(
    log: Any,  # noqa: ANN401 - what is left of a source
    estimate: Estimate | File | None,
    truth: File | None,
) -> "SwarmView":
    """Gather what pictures show of a log, its estimate, and the truth if there is one."""
    from tiswarm.report.swarm_view import view_log  # noqa: PLC0415 - slow to import

    sensed, found = _estimated(log, estimate)
    return view_log(sensed, found, _true_positions(sensed, truth))


def _true_positions(log: SensingLog, truth: File | None) -> "Reals | None":
    return None if truth is None else read_positions_of(log, as_path(truth, "truth"))
