"""Functions of `import tiswarm`, and all that the commands call.

import tiswarm

log = tiswarm.read_log("sensing.jsonl")
estimate = log.localize(cues=["contacts", "height"], chains=4)
print(estimate)
estimate.position, estimate.observability.known, estimate.to_frame()
estimate.view(out="view.html")
tiswarm.score("truth.csv", estimate)["RMSE"]

run = tiswarm.run("scenarios/tower.yaml", {"robots": 20, "seeds": 2})
run.table, run.frame("estimate", case="0-baseline"), run.figures["convergence"]
run.export("ply")
"""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import fields
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

from tiswarm.app.console import ConsoleProgress
from tiswarm.app.inspection import Inspection, inspect
from tiswarm.app.logs import Localized, Log, Truth, method_params, open_log
from tiswarm.app.results import (
    Color,
    CueChoice,
    File,
    Overrides,
    PageFile,
    Run,
    Section,
    as_path,
    as_texts,
    open_run,
    plain,
)
from tiswarm.base.errors import InputError, require_name, warn
from tiswarm.base.params import METHOD, AnyArch, AnyMovie, AnyPrecision
from tiswarm.base.plugins import load_plugins
from tiswarm.records.estimate import Estimate, refuse_distance
from tiswarm.records.outputs import Outputs, refuse_same
from tiswarm.records.positions import write_estimate
from tiswarm.records.sensing_file import log_lines
from tiswarm.records.sensing_log import SensingLog

if TYPE_CHECKING:
    from typing import BinaryIO, TextIO

    from tiswarm.app.comparison import Comparison
    from tiswarm.app.design import Design
    from tiswarm.app.navigation import Believer
    from tiswarm.app.swarms import Swarms
    from tiswarm.evaluation.tables import Scores
    from tiswarm.formats.imports import Imported
    from tiswarm.localization.online.settings import OnlineParams
    from tiswarm.localization.online.tracker import Tracker
    from tiswarm.measurements.advice.further import AdviceTable, Kind
    from tiswarm.scenario.model import Scenario
    from tiswarm.study.executors import Execution
    from tiswarm.study.forecast import Forecast


def read_log(path: File) -> Log:
    """Read a sensing log, `sensing.jsonl`.

    Raises:
        InputError: the file cannot be read or a line is malformed, with file, line and key.
    """
    return open_log(as_path(path, "path"))


def localize(
    log: SensingLog | File,
    method: str = METHOD,
    *,
    cues: CueChoice = None,
    overrides: Overrides = (),
    solution: int | None = None,
    arch: AnyArch = "cpu",
    threads: int | None = None,
    precision: AnyPrecision = "auto",
    within: float | None = None,
    plugins: Sequence[File] = (),
    out: File | None = None,
    report: File | None = None,
    overwrite: bool = False,
    quiet: bool = True,
    **settings: object,
) -> Localized:
    """Estimate the robots' positions from a log, as `tiswarm localize` does.

    Args:
        log: Sensing log, or its file.
        method: Name of the method.
        cues: Cues to use, all others being off, or a dictionary that switches some on or off, as
            `{"walk_contacts": False}` does; the method's own choice if None.
        overrides: Settings of the method by dotted key, or as texts `KEY=VALUE`.
        solution: Return this solution, the likeliest being 1, instead of the mean of all.
        arch: Compute device of `joint`, and of `virtual-force` under the schedule `together`;
            other methods run on the processor. `auto` takes a graphics card if one works.
        threads: CPU threads; all that this process may use if None.
        precision: Floating-point type on that device; `auto` takes f64 where it computes that at
            half the rate of f32. f32 is slower on processors. Other methods compute in f64.
        within: Distance [log unit]: table, verdict and page state for each robot the probability
            that it is within this distance of its estimated position; R if None.
        plugins: Python files that register methods, see `tiswarm.method`.
        out: Table of positions to write; none if None.
        report: Page to write; none if None.
        overwrite: Whether to replace files that exist.
        quiet: Whether to hide progress.
        settings: Settings of the method by name, nested ones as dictionaries.

    Returns:
        The estimate. A warning is issued if it did not converge, or if noise as stated does not
        explain the measurements: `estimate.convergence` has both verdicts and the reason.

    Raises:
        InputError: the log, method, a cue or a setting is invalid, there is no such solution, or an
            output is an input, or exists and is to stay.
        EnvironmentTroubleError: the machine lacks the device.
    """
    table = None if out is None else as_path(out, "out")
    page = None if report is None else as_path(report, "report")
    Outputs(inputs=[log, *plugins], overwrite=overwrite).check({"out": table, "report": page})
    load_plugins(plugins)
    # Before a log is read, which may take long.
    method_params(method, cues, overrides, settings)
    if within is not None:
        refuse_distance(within)
    found = open_log(log).localize(
        method, cues=cues, overrides=overrides, solution=solution, arch=arch, threads=threads,
        precision=precision, within=within, quiet=quiet, **settings,
    )  # fmt: skip
    if table is not None:
        found.write(table, overwrite=overwrite)
    if page is not None:
        found.view(out=page, overwrite=overwrite)
    return found


def run(
    scenario: File | Mapping[str, object],
    overrides: Overrides | None = None,
    *,
    out: File = "reports",
    overwrite: bool = False,
    arch: AnyArch = "cpu",
    threads: int | None = None,
    workers: int | None = None,
    plugins: Sequence[File] = (),
    pictures: bool = True,
    pdf: bool = False,
    movie: AnyMovie | None = None,
    live: bool = False,
    quiet: bool = False,
    **execution: Any,  # noqa: ANN401 - types of their own
) -> Run:
    """Grow, sense, localize, evaluate and draw all cases of a scenario, as `tiswarm run` does.

    Cases that an earlier call finished are not computed again. A warning names failed cases.

    Args:
        scenario: YAML file, the name of a shipped scenario, or a dictionary as such a file has.
        overrides: Values by dotted key that replace the file's, or texts `KEY=VALUE`.
        out: Parent of the run folder.
        overwrite: Whether to take a folder of that name that no run made, and replace files there.
        arch: Compute device, as for `localize`.
        threads: CPU threads; all that this process may use if None.
        workers: Number of worker processes; none if None. One process computes what takes less than
            20 s of processor time.
        plugins: Python files that register methods, sensors, structures, measures or figures.
        pictures: Whether to draw figures, renders and report.html.
        pdf: Whether to draw figures as vector PDF, too.
        movie: File format of an animation of the growth; none if None.
        live: Whether to show structures while they grow: in a notebook, or on the page
            `live.html` in the run's folder, whose path is printed. Results are the same.
        quiet: Whether to hide progress.
        execution: Other fields of `tiswarm.study.Execution`, such as `scheduler` and `shard`.

    Raises:
        InputError: the scenario has a mistake, or there is no such field.
        EnvironmentTroubleError: the machine lacks the device.
        CasesFailedError: a case failed, and `fail_fast` stops at failures.
    """
    from tiswarm import study  # noqa: PLC0415 - slow to import
    from tiswarm.app.drawing import draw_all  # noqa: PLC0415 - slow to import
    from tiswarm.study.forecast import fewer  # noqa: PLC0415 - slow to import

    load_plugins(plugins)
    where = study.Execution(workers=workers, **_fields(execution))
    settings, progress = _load(scenario, overrides), ConsoleProgress(quiet=quiet)
    if live:
        progress = _live(settings, where, quiet=quiet)
    where = fewer(settings, where, progress)
    with progress:
        result = study.run(
            settings, as_path(out, "out"),
            progress=progress, arch=arch, threads=threads, execution=where, overwrite=overwrite,
        )  # fmt: skip
        if not result.missing:
            draw_all(result, progress, pictures=pictures, pdf=pdf, movie=movie)
    if result.failed:
        warn(result.what_failed)
    return Run(result.folder, failed=result.what_failed, missing=result.missing)


def grow(
    structure: Section = "tower",
    robots: int = 100,
    seeds: int | Sequence[int] = 1,
    *,
    rule: Section | None = None,
    robot: Section | None = None,
    navigate_by: str | None = None,
    belief_error: Section | None = None,
    believe: "Section | Believer | None" = None,
    sensing: Mapping[str, object] | None = None,
    threads: int | None = None,
    plugins: Sequence[File] = (),
    live: bool = False,
    quiet: bool = False,
) -> "Swarms":
    """Grow structures side by side, as `tiswarm run` grows them.

    Args:
        structure: Kind of structure, the section `structure` of a scenario, such as
            `{"kind": "tower", "goal_height": 40.0}`, or the class or an instance of its settings.
        robots: Robots in each structure.
        seeds: Seeds, one structure each, or their number: 0, 1, ...
        rule: Rule of growth, given in the same ways; that of the structure if None.
        robot: Shape of the robots, given in the same ways; FireAntV3 if None.
        navigate_by: What robots build by, `structure.navigate_by`: "truth", "estimate" or "error";
            as the structure or the next two arguments say if None.
        belief_error: Kind and size of the error of the places that robots believe, with "error",
            such as `{"kind": "independent", "size": 0.5}`.
        believe: By what robots estimate where they are, with "estimate": a method, such as "online"
            or `{"method": "distributed", "chains": 1}`, or a function of the `Log` of robots that
            have joined, in join order. It returns centers [R], shape (n, 3), or a pair of these and
            their standard deviations [R], shape (n,), or what `log.localize` returns. It is called
            after each join, for each side of a gap by itself.
        sensing: What robots that do not know the truth sense, and with which noise: settings of
            `sensing`, such as `{"tilt_noise_deg": 1.0}`.
        threads: CPU threads; all that this process may use if None.
        plugins: Python files that register structures, rules and sensors.
        live: Whether to show structures while they grow: in a notebook below its cell, elsewhere on
            a page in a new folder, whose path is printed. What grows is the same.
        quiet: Whether to hide progress.

    Returns:
        The structures, a `Swarms`: arrays of all, and a sequence of single ones. They sense, score,
        show, export and save themselves. `ended` says why growth of one stopped early.

    Raises:
        InputError: an argument has a mistake, or no robot joined a structure.
        PluginError: code of a plug-in failed.
    """
    from tiswarm.app import swarms  # noqa: PLC0415 - slow to import
    from tiswarm.app.navigation import Navigation  # noqa: PLC0415 - slow to import

    load_plugins(plugins)
    navigation = Navigation(
        navigate_by=navigate_by, belief_error=belief_error, believe=believe, sensing=sensing
    )
    scenario = swarms.growth_scenario(
        structure, robots, seeds, rule=rule, robot=robot, navigation=navigation
    )
    return swarms.grow(scenario, place=navigation.place, threads=threads, quiet=quiet, live=live)


def check_local(
    rule: Section,
    structure: Section = "tower",
    robots: int = 12,
    seeds: int | Sequence[int] = 1,
    *,
    robot: Section | None = None,
    plugins: Sequence[File] = (),
) -> int:
    """Check that robots of a local rule decide by nothing that they cannot know.

    Structures grow by the rule, by the truth. Each climber, and each robot that acts, decides by
    itself, too, once places, loads, uncertainty and messages of robots that it does not touch have
    changed. It has to choose, remember, say and leave as among the others.

    Args:
        rule: Rule of growth, as `tiswarm.grow` takes it, that `local=True` registers.
        structure: Kind of structure, as `tiswarm.grow` takes it.
        robots: Robots in each structure.
        seeds: Seeds, one structure each, or their number: 0, 1, ...
        robot: Shape of the robots; FireAntV3 if None.
        plugins: Python files that register structures and rules.

    Returns:
        Decisions that were compared.

    Raises:
        InputError: an argument has a mistake, or the rule is not local.
        PluginError: a robot decides otherwise alone, or the rule failed.
    """
    from tiswarm.app import swarms  # noqa: PLC0415 - slow to import
    from tiswarm.world.locality import compare_alone  # noqa: PLC0415 - slow to import

    load_plugins(plugins)
    scenario = swarms.growth_scenario(structure, robots, seeds, rule=rule, robot=robot)
    return compare_alone(
        scenario.structure,
        robots=scenario.robots,
        seeds=scenario.seed_list,
        robot=scenario.robot,
    )


def open_swarms(path: File, *, plugins: Sequence[File] = ()) -> "Swarms":
    """Read structures that `Swarms.save` wrote.

    Args:
        path: File, `.npz`.
        plugins: Python files that register their kind of structure.

    Raises:
        InputError: there is no such file, or it is damaged.
    """
    from tiswarm.app import swarms  # noqa: PLC0415 - slow to import

    load_plugins(plugins)
    return swarms.open_swarms(as_path(path, "path"))


def forecast(
    scenario: File | Mapping[str, object],
    overrides: Overrides | None = None,
    *,
    workers: int | None = None,
    plugins: Sequence[File] = (),
    **execution: Any,  # noqa: ANN401 - types of their own
) -> "Forecast":
    """Estimate time and memory of the run of a scenario, and compute nothing.

    Returns:
        A named tuple: cases, robots, start_s, grow_s, localize_s, rest_s [s] and memory_mb [MB].

    Args:
        scenario: As for `run`.
        overrides: As for `run`.
        workers: Number of worker processes; none if None.
        plugins: As for `run`.
        execution: As for `run`.

    Raises:
        InputError: the scenario has a mistake, or there is no such field.
    """
    from tiswarm import study  # noqa: PLC0415 - slow to import
    from tiswarm.study import forecast as forecasts  # noqa: PLC0415 - slow to import

    load_plugins(plugins)
    where = study.Execution(workers=workers, **_fields(execution))
    return forecasts.forecast(_load(scenario, overrides), where)


def redraw(
    run: Run | File,
    *,
    plugins: Sequence[File] = (),
    pdf: bool = False,
    movie: AnyMovie | None = None,
    renderer: str | None = None,
    case: str | None = None,
    color: Color = (),
    quiet: bool = False,
) -> Run:
    """Write tables, figures, 3D pictures and page of a run again, from its stored cases.

    Args:
        run: Run, or its folder.
        plugins: Python files that register what the run used, or further measures and figures.
        pdf: Whether to draw figures as vector PDF, too.
        movie: File format of an animation of the growth; none if None.
        renderer: "open3d" or "taichi"; the first that works if None.
        case: Case of the 3D pictures; the largest if None.
        color: Values that color its robots, as `view` takes them.
        quiet: Whether to hide progress.

    Raises:
        InputError: it is not the folder of a run, no case is intact, or there is no such case.
    """
    load_plugins(plugins)
    found = run if isinstance(run, Run) else Run(as_path(run, "run"))
    found.redraw(pdf=pdf, movie=movie, renderer=renderer, case=case, color=color, quiet=quiet)
    return found


def check(
    given: File | Mapping[str, object],
    overrides: Overrides | None = None,
    *,
    plugins: Sequence[File] = (),
) -> Inspection:
    """Check a scenario or a sensing log (.jsonl).

    Args:
        given: A scenario as for `run`, or the file of a log.
        overrides: As for `run`; none for a log.
        plugins: As for `run`.

    Returns:
        Its mistakes, as errors, and if there are none a summary.
    """
    load_plugins(plugins)
    return inspect(_scenario(given), as_texts(overrides or ()))


def import_poses(
    poses: File,
    *,
    docks: File | None = None,
    out: File | None = None,
    plugins: Sequence[File] = (),
    overwrite: bool = False,
    **assumed: Any,  # noqa: ANN401 - types of their own
) -> "dict[str, Imported]":
    """Convert robot poses of any simulator to sensing logs and true positions.

    Args:
        poses: Table `robot,x,y,z,qw,qx,qy,qz` or `robot,sphere,x,y,z`, in motion with a column
            `time`; a GSD file; a folder of trajectories; an export of motion capture; or, with
            `beacons`, a table of ranges.
        docks: Table `dock,x,y,z` of the docks in the body frame, in place of `dock_offset_body`.
        out: Folder for `sensing.jsonl` and `truth.csv`; nothing is written if None.
        plugins: Python files that register formats, see `tiswarm.import_format`.
        overwrite: Whether to replace files that exist.
        assumed: What the poses do not state, such as `dock_radius`.

    Returns:
        Log, positions and notes of each structure by its name in the column `run`, or by "".
        Warnings say why contacts or final poses are probably wrong.

    Raises:
        InputError: the table is malformed, there is no such field, or an output is an
            input, or exists and is to stay.
    """
    from tiswarm.formats.imports import convert  # noqa: PLC0415 - slow to import

    load_plugins(plugins)
    found = convert(
        as_path(poses, "poses"), assumed,
        docks=None if docks is None else as_path(docks, "docks"),
        out=None if out is None else as_path(out, "out"), overwrite=overwrite,
    )  # fmt: skip
    for run, imported in found.items():
        for warning in imported.warnings:
            warn(f"run {run}: {warning}" if run else warning)
    return found


def score(
    truth: File,
    estimate: Estimate | File,
    *,
    out: File | None = None,
    overwrite: bool = False,
    quiet: bool = True,
) -> "Scores":
    """Compare an estimate, or its table, with a table of true positions.

    Args:
        truth: Table of true positions.
        estimate: Estimate, or its table.
        out: Figure to draw, .png or .pdf: the error of each robot in join order, and truth and
            estimate from two sides; none if None.
        overwrite: Whether to replace files that exist.
        quiet: Whether to hide the name of the figure.

    Returns:
        Errors in the truth's unit by name, as it is and after alignment.

    Raises:
        InputError: a table is malformed, the estimate has another unit or other robots, or the
            figure has another format, is a table, or exists and is to stay.
    """
    from tiswarm.evaluation.tables import score_files  # noqa: PLC0415 - slow to import

    figure = None if out is None else as_path(out, "out")
    outputs = Outputs(inputs=[truth, estimate], overwrite=overwrite)
    outputs.check({"out": figure})
    found = estimate if isinstance(estimate, Estimate) else as_path(estimate, "estimate")
    scores = score_files(as_path(truth, "truth"), found)
    if figure is not None:
        from tiswarm.report.pictures.swarm_figures import write_score  # noqa: PLC0415

        write_score(figure, scores.true, scores.estimated, scores.errors, scores.unit, outputs)
        ConsoleProgress(quiet=quiet).info(str(figure))
    return scores


def compare(
    *runs: Run | File, out: File = "reports/comparison", overwrite: bool = False
) -> "Comparison":
    """Compare runs in tables, a figure and a page of all cases.

    Args:
        runs: Two or more runs, or their folders.
        out: Folder to write to.
        overwrite: Whether to replace files that exist.

    Returns:
        A comparison, with data frames `table` and `paired`, a `figure` and a `page`, which prints
        its table.

    Raises:
        InputError: there are fewer than two different runs, one has no results, or an output
            exists and is to stay.
    """
    from tiswarm.app import comparison  # noqa: PLC0415 - slow to import

    folder = as_path(out, "out")
    folders = [run.folder if isinstance(run, Run) else as_path(run, "runs") for run in runs]
    files = [folder / name for name in comparison.FILES]
    outputs = Outputs(inputs=[run / "cases" for run in folders], overwrite=overwrite)
    outputs.check({"out": files})
    return comparison.compare(folders, folder, outputs)


def advise(
    log: SensingLog | File,
    estimate: Estimate | File | None = None,
    *,
    budget: int | None = None,
    kinds: "Sequence[Kind]" = (),
    quiet: bool = True,
) -> "AdviceTable":
    """List which further contact, height or known position would constrain most robots.

    Where the estimate has robots that are mirrored, the list says what excludes one of the images.

    Args:
        log: Sensing log, or its file.
        estimate: Estimate, or its table, which has no solutions; `joint` localizes the log if None.
        budget: Number of measurements in a set that helps most together; no set if None.
        kinds: Kinds of measurements in the set: contact, height, position, range, anchor; all but
            anchor if none.
        quiet: Whether to hide progress.

    Returns:
        Rows of cells by heading, the best first; `to_frame()` makes them a data frame. The set is
        the table `together`.

    Raises:
        InputError: the budget is not positive, a kind is unknown, or the log has too many robots.
    """
    from tiswarm.measurements.advice.further import require_set  # noqa: PLC0415 - slow to import

    require_set(budget, kinds)
    return open_log(log).with_estimate(estimate, quiet=quiet).findings.advise(budget, kinds)


def design(
    scenario: File | Mapping[str, object],
    goals: str | Sequence[str],
    vary: "Mapping[str, Sequence[Any]]",
    prices: "File | Mapping[str, Mapping[object, float]] | None" = None,
    *,
    overrides: Overrides | None = None,
    condition: str | None = None,
    seeds: int | None = None,
    fresh: int = 5,
    out: File | None = None,
    overwrite: bool = False,
    arch: AnyArch = "cpu",
    threads: int | None = None,
    plugins: Sequence[File] = (),
    quiet: bool = False,
) -> "Design":
    """Find sensors, or settings of growth, that reach a goal, as `tiswarm design` does.

    Values of `sensing` make sensor suites. Their RMSE is predicted from the information in what
    robots would sense at their true positions; no robot is localized. Values of `structure`,
    `robot` and `robots` are grown, on few seeds at first, the better half on more. The best
    candidates are then run on fresh seeds.

    Args:
        scenario: As for `run`.
        goals: Goals such as "rmse_R<0.2", "height_R>60", "min:price" or "max:reach_R". Results are
            `rmse_R` of sensors, and all of a structure in `summary.csv`; with prices also `price`.
        vary: Values to choose from by dotted key.
        prices: Prices by key and value, or their table `key,value,price` or YAML file; the price of
            a candidate is the sum over its values.
        overrides: As for `run`.
        condition: Condition of the scenario to design for; the only one if None.
        seeds: Structures to search on; 3 for sensors and 8 for growth if None.
        fresh: Structures to run the best candidates on.
        out: Folder for `design.yaml`, the best scenario, `design.csv`, all candidates,
            `design.png`, the front of several objectives, and the runs on fresh seeds; nothing is
            written if None.
        overwrite: Whether to replace files that exist.
        arch: As for `run`.
        threads: As for `run`.
        plugins: As for `run`.
        quiet: Whether to hide progress.

    Returns:
        The candidates, a data frame `table`, those of the `front` and those `verified` on fresh
        seeds, and the best `scenario`.

    Raises:
        InputError: a goal, key, value or price is wrong, no result has the name of a goal, no
            candidate reaches the goals, or an output exists and is to stay.
        CasesFailedError: no candidate could be run.
    """
    from tiswarm.app import design as designs  # noqa: PLC0415 - slow to import
    from tiswarm.study.design.prices import Prices  # noqa: PLC0415 - slow to import

    load_plugins(plugins)
    priced: Prices | None = None
    if isinstance(prices, Mapping):
        priced = Prices.of(prices)
    elif prices is not None:
        priced = Prices.read(as_path(prices, "prices"))
    return designs.design(
        _load(scenario, overrides),
        [goals] if isinstance(goals, str) else goals,
        cast("dict[str, Sequence[Any]]", plain({key: [*values] for key, values in vary.items()})),
        priced,
        condition=condition,
        seeds=seeds,
        fresh=fresh,
        out=None if out is None else as_path(out, "out"),
        overwrite=overwrite,
        arch=arch,
        threads=threads,
        quiet=quiet,
    )


def _fields(execution: Mapping[str, Any]) -> Mapping[str, Any]:
    """Check names of fields of `study.Execution`."""
    from tiswarm import study  # noqa: PLC0415 - slow to import

    for name in execution:
        require_name(name, [field.name for field in fields(study.Execution)], "execution")
    return execution


def _live(settings: "Scenario", where: "Execution", *, quiet: bool) -> ConsoleProgress:
    """Return progress that shows structures of a run while they grow.

    Raises:
        InputError: other processes are to grow them.
    """
    from tiswarm.app.growing import LiveProgress  # noqa: PLC0415 - slow to import

    if where.scheduler is not None or where.processes:
        problem = "structures that other processes grow are not shown; leave out"
        raise InputError(f"{problem} workers, scheduler and case limit", argument="live")
    return LiveProgress(quiet=quiet, name=settings.name)


def _load(scenario: File | Mapping[str, object], overrides: Overrides | None) -> "Scenario":
    from tiswarm.scenario.expansion import load_scenario  # noqa: PLC0415 - slow to import

    return load_scenario(_scenario(scenario), as_texts(overrides or ()))


def _scenario(given: File | Mapping[str, object]) -> Path | dict[str, Any]:
    """Return the path of a scenario, or its plain data."""
    return plain(given) if isinstance(given, Mapping) else as_path(given, "scenario")


Source = Run | SensingLog | File
"""What can be shown: a run or its folder, or a log or its file."""


def open_source(
    source: Source,
    *,
    of_log: Mapping[str, object] = MappingProxyType({}),
    of_run: Mapping[str, object] = MappingProxyType({}),
) -> Run | Log:
    """Open a run or a log, unless it is open.

    Args:
        source: Run or its folder, or a log or its file.
        of_log: Arguments by name that only a log takes; None where they are not given.
        of_run: Arguments by name that only a run takes.

    Raises:
        InputError: the source does not take an argument, is not the folder of a run, or cannot be
            read.
    """
    if isinstance(source, Run):
        _refuse("a run has its own (sensing.jsonl of a case takes others)", of_log)
        return source
    if not isinstance(source, SensingLog) and as_path(source, "source").is_dir():
        _refuse("a run has its own (sensing.jsonl of a case takes others)", of_log)
        return open_run(source)
    _refuse("a log is no run", of_run)
    return open_log(source)


def view(
    source: Source,
    estimate: Estimate | File | None = None,
    truth: Truth = None,
    *,
    explain: Sequence[int] = (),
    color: Color = (),
    out: File | None = None,
    overwrite: bool = False,
    quiet: bool = True,
) -> PageFile:
    """Show an estimate on a page with a 3D view, its uncertainty and what the log leaves open.

    Args:
        source: Sensing log or its file, or a run or its folder.
        estimate: Estimate of a log, or its table; `joint` localizes the log if None.
        truth: True positions of a log, or their table, if there are any.
        explain: Names of robots of a log: the page shows how measurements place each; the one that
            is least certain if none.
        color: Values that color robots, as "values.csv:charge" or as a series of pandas whose index
            has the names of robots; several in a list. A unit stands in brackets: `charge [V]`.
        out: Page to write for a log; `view.html` if None.
        overwrite: Whether to replace files that exist.
        quiet: Whether to hide progress.

    Returns:
        The page, which a notebook shows; that of a run is its `report.html`.

    Raises:
        InputError: a file is malformed, or a table has other robots than the log.
    """
    of_log: dict[str, object] = {"estimate": estimate, "truth": truth, "out": out}
    of_log |= {"explain": explain or None, "color": color if len(color) else None}
    shown = open_source(source, of_log=of_log)
    if isinstance(shown, Run):
        return shown.view(quiet=quiet)
    page = as_path(out or "view.html", "out")
    Outputs(inputs=[shown.path, estimate, truth], overwrite=overwrite).check({"out": page})
    shown.positions(truth)  # mistakes are found before the log is localized
    shown.colorings(color)
    found = shown.with_estimate(estimate, quiet=quiet)
    return found.view(truth, explain=explain, color=color, out=page, overwrite=overwrite)


def export(
    source: Source,
    form: str = "gltf",
    estimate: Estimate | File | None = None,
    truth: Truth = None,
    *,
    out: File | None = None,
    case: str | None = None,
    color: Color = (),
    plugins: Sequence[File] = (),
    overwrite: bool = False,
    quiet: bool = False,
) -> Path:
    """Export structure, contacts and estimate of a case, or of a log, for other programs.

    Args:
        source: Run or its folder, or a sensing log or its file.
        form: File format; "png" draws 3D pictures, "gif", "mp4" and "webp" the growth.
        estimate: Estimate of a log, or its table; `joint` localizes the log if None.
        truth: True positions of a log, or their table, if there are any.
        out: Folder to write to; `export`, in the run's folder if there is one, if None.
        case: Case of a run; the largest if None.
        color: Values that color robots, as `view` takes them.
        plugins: Python files that register formats, see `tiswarm.export_format`.
        overwrite: Whether to replace files that exist.
        quiet: Whether to hide progress.

    Returns:
        The folder with the files.
    """
    from tiswarm.app.formats import check_export  # noqa: PLC0415 - slow to import

    load_plugins(plugins)
    of_log = {"estimate": estimate, "truth": truth}
    shown = open_source(source, of_log=of_log, of_run={"case": case})
    if isinstance(shown, Run):
        return shown.export(form, out=out, case=case, color=color, overwrite=overwrite, quiet=quiet)
    folder = as_path(out or "export", "out")
    outputs = Outputs(inputs=[shown.path, estimate, truth], overwrite=overwrite)
    check_export(form, folder, outputs)  # before the log is localized
    shown.positions(truth)
    shown.colorings(color)
    return shown.with_estimate(estimate, quiet=quiet).export(
        form, truth, color=color, out=folder, overwrite=overwrite, quiet=quiet
    )


def _refuse(reason: str, given: Mapping[str, object]) -> None:
    """Refuse the first argument that has a value."""
    for name, value in given.items():
        if value is not None:
            raise InputError(f"{reason}; leave it out", argument=name)


_NAME = (str, PathLike)


def track(
    source: "File | BinaryIO",
    *,
    out: "File | TextIO | None" = None,
    estimate: File | None = None,
    overrides: Overrides = (),
    overwrite: bool = False,
    **settings: object,
) -> "Tracker":
    """Estimate robots' positions from a stream of a log's lines, as `tiswarm track` does.

    A line that is malformed is skipped, with a warning.

    Args:
        source: Sensing file, or an open binary input.
        out: Open text output that receives the answer of each line, a JSON object, before the next
            line is read; or file for all answers, which appears at the end of the input; none if
            None.
        estimate: Table of positions to write at the end, of the final answer; none if None.
        overrides: Settings of the method `online`, as for `localize`.
        overwrite: Whether to replace files that exist.
        settings: Settings of the method by name.

    Returns:
        The tracker, with the positions of all robots.

    Raises:
        InputError: the input cannot be read, its header or a setting is invalid, or an output is an
            input, or exists and is to stay.
    """
    from tiswarm.localization.online.tracker import follow  # noqa: PLC0415 - slow to import

    file, terminal = (as_path(out, "out"), None) if isinstance(out, _NAME) else (None, out)
    table = None if estimate is None else as_path(estimate, "estimate")
    outputs = Outputs(inputs=[source], overwrite=overwrite)
    outputs.check({"out": file, "estimate": table})
    refuse_same(terminal, source)
    params = method_params("online", None, overrides, settings)
    if isinstance(source, _NAME):
        path = as_path(source, "source")
        lines = log_lines(path)
    else:
        path = Path("-")
        lines = log_lines(path, source)
    with outputs.opened(file) if file else nullcontext() as whole:

        def answer(text: str) -> None:
            if whole is not None:
                whole.write(text.encode())
            elif terminal is not None:
                terminal.write(text)
                terminal.flush()

        tracker = follow(
            lines, path, params=cast("OnlineParams", params), on_answer=answer, on_refused=warn
        )
        final = None if table is None else tracker.estimate(final=True)
    if table is not None and final is not None:
        write_estimate(table, final, opened=outputs.opened)
    return tracker
