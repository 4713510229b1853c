"""Commands on a user's data: sensing logs, poses, estimates."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from tiswarm.cli.app import OneArch, Open, Overrides, Quiet, Threads, app, refuse, show_page
from tiswarm.console import ConsoleProgress
from tiswarm.params import AnyPrecision
from tiswarm.progress import Progress

if TYPE_CHECKING:
    from tiswarm.aliases import Reals
    from tiswarm.localization.params import LocalizationParams
    from tiswarm.records.estimate import Estimate
    from tiswarm.records.sensing_log import SensingLog

EstimateTable = Annotated[
    Path | None,
    Argument(metavar="ESTIMATE", help="Table of estimated positions of LOG (default: by joint)."),
]
Truth = Annotated[Path | None, Option(help="Table of true positions of LOG.")]


@app.command(epilog="Example: tiswarm localize sensing.jsonl --report view.html")
def localize(
    log: Annotated[Path, Argument(metavar="LOG", help="Sensing log.")],
    method: Annotated[
        str,
        Option(
            help="joint (most accurate), virtual-force (the paper's), least-squares or hop-by-hop."
        ),
    ] = "joint",
    cues: Annotated[
        str | None, Option(metavar="CUE,...", help="Cues to use (default: the method's own).")
    ] = None,
    seed: Annotated[int | None, Option(help="Seed of joint.")] = None,
    solution: Annotated[
        int | None,
        Option(metavar="K", help="Write solution K, the likeliest first, not their mean."),
    ] = None,
    overrides: Overrides = [],  # noqa: B006 - typer never changes it
    out: Annotated[Path, Option(help="Table of positions to write.")] = Path("estimate.csv"),
    report: Annotated[
        Path | None, Option(metavar="PAGE", help="Also write a page with a 3D view.")
    ] = None,
    arch: OneArch = "cpu",
    threads: Threads = None,
    precision: Annotated[AnyPrecision, Option(help="Floating-point type of joint.")] = "auto",
    *,
    verbose: Annotated[bool, Option("--verbose", "-v", help="List the solutions.")] = False,
    opened: Open = False,
    quiet: Quiet = False,
) -> None:
    """Estimate the robots' positions from a sensing log.

    Simulators and real swarms write such logs (docs/files.md). The exit status is 4 if the estimate
    did not converge, or if noise as stated does not explain the measurements; it is written all the
    same.
    """
    from tiswarm.errors import NOT_TRUSTED, InputError
    from tiswarm.inspection import describe_estimate, explain_estimate
    from tiswarm.localization import registry
    from tiswarm.records.messages import counted
    from tiswarm.records.positions import write_estimate
    from tiswarm.records.sensing_file import read_sensing_log
    from tiswarm.scenario.validation import localization_params
    from tiswarm.verdicts import (
        cautions,
        describe_solutions,
        distrust,
        headline,
        solution_name,
        verdict,
    )

    if opened and report is None:
        raise InputError("needs a page; add --report PAGE", key="--open")
    values = {} if seed is None else {"seed": seed}
    names = None if cues is None else [cue.strip() for cue in cues.split(",")]
    params = localization_params(method, overrides, cues=names, values=values)
    sensed, progress = read_sensing_log(log), ConsoleProgress(quiet=quiet)
    titles = [registry.title(params)]
    running = registry.start_device(titles, arch, threads=threads, precision=precision)
    if arch != "cpu":
        progress.info(registry.where(titles, running))
    estimate = _localized(sensed, params, progress)
    chosen = ""
    if solution is not None:
        estimate = estimate.with_solution(solution)
        chosen = f"{solution_name(estimate, solution)}: "
    write_estimate(out, estimate)
    warning = distrust(sensed, estimate)
    if warning:
        typer.echo(f"tiswarm: warning: {warning}", err=True)
    notes = [*describe_estimate(sensed, log, estimate), *cautions(sensed, estimate)]
    found = verdict(estimate) if warning else headline(sensed, estimate)
    size = counted(estimate.robot_count, "robot")
    result = f"{chosen}{size}{f', {found}' if found else ''} -> {out}"
    listed = [*describe_solutions(sensed, estimate)] if verbose else []
    if (count := len(estimate.solutions)) > 1 and solution is None:
        listed.append(
            f"the positions are the mean of {count} solutions; --solution 1 writes the likeliest "
            "consistent configuration, --verbose lists all"
        )
    if not quiet:
        typer.echo("\n".join([*notes, result, *listed]))
    if report is not None:
        from tiswarm.drawing import draw_log

        findings = explain_estimate(sensed, log, estimate)
        draw_log(report, sensed, estimate, name=f"{chosen}{log.name}", **findings._asdict())
        if opened or not quiet:
            show_page(report, opened=opened)
    if warning:
        raise typer.Exit(NOT_TRUSTED)


@app.command(epilog="Example: tiswarm view sensing.jsonl estimate.csv --truth truth.csv")
def view(
    log: Annotated[
        Path, Argument(metavar="LOG|RUN", help="Sensing log, or with --live a run folder.")
    ],
    estimate: EstimateTable = None,
    truth: Truth = None,
    out: Annotated[
        Path | None, Option(help="Page to write (default: view.html).", show_default=False)
    ] = None,
    port: Annotated[
        int | None, Option(min=1, max=65535, help="Port of --live (default: a free one).")
    ] = None,
    *,
    live: Annotated[
        bool, Option("--live", help="Serve a run to this machine's browser as cases finish.")
    ] = False,
    opened: Open = False,
    quiet: Quiet = False,
) -> None:
    """Show an estimate on a page with a 3D view.

    The page has the estimate's uncertainty, and what the log leaves open. With --live, it has the
    cases of a run that is still computed, and the 3D view of one; Ctrl-C ends the command.
    """
    if live:
        from tiswarm.live import serve

        refuse({"ESTIMATE": estimate, "--truth": truth, "--out": out}, "--live shows a run")
        serve(log, port or 0, lambda page: show_page(page, opened=opened))
        return
    refuse({"--port": port}, "only --live serves a page")
    out = out or Path("view.html")
    from tiswarm.drawing import draw_log
    from tiswarm.inspection import explain_estimate

    progress = ConsoleProgress(quiet=quiet)
    sensed, found, true = read_estimated(log, estimate, progress, truth)
    findings = explain_estimate(sensed, log, found)
    draw_log(out, sensed, found, name=log.name, true=true, **findings._asdict())
    if opened or not quiet:
        show_page(out, opened=opened)


@app.command(epilog="Example: tiswarm advise sensing.jsonl estimate.csv")
def advise(
    log: Annotated[Path, Argument(metavar="LOG", help="Sensing log.")],
    estimate: EstimateTable = None,
) -> None:
    """List which further measurements would determine most.

    Candidates are contacts, heights and known positions. The expected RMSE is computed for up to
    1,000 robots. More are ranked by floppy modes. Without ESTIMATE, solutions of joint count, too:
    where robots are mirrored, a column has the difference between the two likeliest, and further
    ranges are candidates if LOG has some.
    """
    from tiswarm.inspection import advice_rows, describe_advice
    from tiswarm.localization.params import JointParams

    sensed, found, _ = read_estimated(log, estimate, ConsoleProgress())
    rows = advice_rows(sensed, JointParams().cues, found)
    typer.echo("\n".join(describe_advice(rows)))


def read_estimated(
    log: Path, estimate: Path | None, progress: Progress, truth: Path | None = None
) -> "tuple[SensingLog, Estimate, Reals | None]":
    """Read a log, its estimate, and the true positions if there are any.

    Without a table of the estimate, joint localizes the log.
    """
    from tiswarm.compute import backend
    from tiswarm.localization.params import JointParams
    from tiswarm.records.positions import read_estimate, read_positions_of
    from tiswarm.records.sensing_file import read_sensing_log
    from tiswarm.verdicts import distrust

    sensed = read_sensing_log(log)
    true = None if truth is None else read_positions_of(sensed, truth)
    if estimate is not None:
        return sensed, read_estimate(sensed, estimate), true
    backend.start()
    found = _localized(sensed, JointParams(), progress)
    if warning := distrust(sensed, found):
        typer.echo(f"tiswarm: warning: {warning}", err=True)
    return sensed, found, true


def _localized(
    sensed: "SensingLog", params: "LocalizationParams", progress: Progress
) -> "Estimate":
    """Localize a log and show progress; the backend runs."""
    from tiswarm.compute import backend
    from tiswarm.localization import registry

    name = "compile, localize" if backend.current().is_cold else "localize"
    with progress.task(name, sensed.robot_count) as advance:
        return registry.localize(sensed, params, on_progress=advance)


@app.command("import", epilog="Example: tiswarm import poses.csv --dock-radius 0.5 --out imported")
def import_(
    poses: Annotated[Path, Argument(help="Table: robot,x,y,z,qw,qx,qy,qz or robot,sphere,x,y,z.")],
    out: Annotated[Path, Option(help="Folder for sensing.jsonl and truth.csv.")],
    dock_radius: Annotated[float, Option(min=1e-9, max=1e9, help="Radius of a dock sphere.")] = 1.0,
    dock_offset: Annotated[
        float | None,
        Option(
            min=0.0,
            max=1e12,
            help="Distance from robot center to docks (default: where most docks touch, or 1.506 "
            "dock radii if none stands out); not for a table of spheres.",
        ),
    ] = None,
    docks: Annotated[
        Path | None, Option(metavar="CSV", help="Docks in the body frame: dock,x,y,z.")
    ] = None,
    gap: Annotated[
        float | None, Option(min=0.0, help="Largest gap of a contact (default: 2 % of the radius).")
    ] = None,
    overlap: Annotated[
        float | None, Option(min=0.0, help="Largest overlap of a contact (default: the same).")
    ] = None,
    contacts: Annotated[
        Path | None,
        Option(metavar="CSV", help="All contacts: robot,dock,other,other_dock (default: found)."),
    ] = None,
    anchor: Annotated[
        str,
        Option(
            metavar="ID,...",
            help="Anchor robot, and further robots at known positions (default: the first robot).",
        ),
    ] = "",
    ground_z: Annotated[float | None, Option(help="Height of flat ground.")] = None,
    tilt_deg: Annotated[float | None, Option(help="Noise of orientations: tilt, 1 sd.")] = None,
    yaw_deg: Annotated[float | None, Option(help="Noise of orientations: yaw, 1 sd.")] = None,
    length_unit: Annotated[
        str, Option(help="Length unit, unless columns name it, such as x_mm.")
    ] = "unit",
    *,
    heights: Annotated[bool, Option("--heights", help="Log the height of each robot.")] = False,
    keep_tied: Annotated[
        bool, Option("--keep-tied", help="Drop robots that no contacts connect to an anchor.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Convert poses of any simulator to a sensing log and a truth.

    A column `run` names the structure of each row; each then has a folder of its own in --out.
    """
    from tiswarm.errors import InputError
    from tiswarm.interop.imports import Assumptions, import_poses, write_import
    from tiswarm.interop.poses import read_dock_offsets
    from tiswarm.robot import docks_in_plane

    if dock_offset is not None and docks is not None:
        raise InputError("choose only one of --docks, --dock-offset")
    try:
        anchors = tuple(map(int, anchor.split(","))) if anchor else ()
    except ValueError:
        problem = f"{anchor!r} is not a list of robots; write it like 0,5"
        raise InputError(problem, argument="anchor") from None
    body = None if dock_offset is None else docks_in_plane(dock_offset)
    assumed = Assumptions(
        dock_radius=dock_radius,
        dock_offset_body=body if docks is None else read_dock_offsets(docks),
        gap=gap,
        overlap=overlap,
        contacts=contacts,
        anchors=anchors,
        ground_z=ground_z,
        heights=heights,
        keep_tied=keep_tied,
        tilt_deg=tilt_deg,
        yaw_deg=yaw_deg,
        length_unit=length_unit,
    )
    for run, imported in import_poses(poses, assumed).items():
        write_import(imported, out / run)
        if imported.warning:
            of_run = f"run {run}: " if run else ""
            typer.echo(f"tiswarm: warning: {of_run}{imported.warning}", err=True)
        if not quiet:
            typer.echo("\n".join(imported.notes) + f" -> {out / run}")


@app.command(epilog="Example: tiswarm score truth.csv estimate.csv")
def score(
    truth: Annotated[Path, Argument(help="Table of true positions.")],
    estimate: Annotated[Path, Argument(help="Table of estimated positions.")],
) -> None:
    """Print the errors of an estimate, as it is and after alignment."""
    from tiswarm.evaluation.tables import score_files

    unit, scores = score_files(truth, estimate)
    for name, value in scores.items():
        typer.echo(f"{name:<28} {value:.4g}{'' if 'disparity' in name else f' {unit}'}")
