"""Commands on a user's data: sensing logs, poses, estimates."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from tiswarm.cli.app import OneArch, Overrides, Quiet, Threads, app
from tiswarm.console import ConsoleProgress
from tiswarm.params import Precision


@app.command(epilog="Example: tiswarm localize sensing.jsonl --out estimate.csv")
def localize(
    log: Annotated[Path, Argument(metavar="LOG", help="Sensing log.")],
    method: Annotated[
        str, Option(help="joint (most accurate), virtual-force (the paper's) or least-squares.")
    ] = "joint",
    cues: Annotated[
        str | None, Option(metavar="CUE,...", help="Cues to use (default: the method's own).")
    ] = None,
    seed: Annotated[int | None, Option(help="Seed of joint.")] = None,
    overrides: Overrides = [],  # noqa: B006 - typer never changes it
    out: Annotated[Path, Option(help="Table of positions to write.")] = Path("estimate.csv"),
    arch: OneArch = "cpu",
    threads: Threads = None,
    precision: Annotated[Precision, Option(help="Floating-point type.")] = "f64",
    *,
    quiet: Quiet = False,
) -> None:
    """Estimate the robots' positions from a sensing log of any simulator or real swarm.

    The exit status is 4 if the estimate did not converge; it is written all the same.
    """
    from tiswarm.compute import backend
    from tiswarm.errors import NOT_CONVERGED
    from tiswarm.inspection import convergence_warning, describe_estimate
    from tiswarm.localization import registry
    from tiswarm.records.positions import write_estimate
    from tiswarm.records.sensing_file import read_sensing_log
    from tiswarm.scenario.validation import localization_params

    chosen = [] if seed is None else [f"seed={seed}"]
    names = None if cues is None else [cue.strip() for cue in cues.split(",")]
    params = localization_params(method, [*chosen, *overrides], cues=names)
    sensed = read_sensing_log(log)
    backend.start(arch, threads=threads, precision=precision)
    estimate = registry.localize(sensed, params)
    write_estimate(out, estimate, length_unit=sensed.length_unit)
    warning = convergence_warning(sensed, estimate)
    if warning:
        typer.echo(f"tiswarm: warning: {warning}", err=True)
    if not quiet:
        typer.echo("\n".join(describe_estimate(sensed, log, estimate)) + f" -> {out}")
    if warning:
        raise typer.Exit(NOT_CONVERGED)


@app.command("import", epilog="Example: tiswarm import poses.csv --dock-radius 0.5 --out imported")
def import_(
    poses: Annotated[Path, Argument(help="Table: robot,x,y,z,qw,qx,qy,qz or robot,sphere,x,y,z.")],
    out: Annotated[Path, Option(help="Folder for sensing.jsonl and truth.csv.")],
    dock_radius: Annotated[float, Option(min=1e-9, help="Radius of a dock sphere.")] = 1.0,
    dock_offset: Annotated[
        float | None,
        Option(help="Distance from robot center to docks; not for a table of spheres."),
    ] = None,
    tolerance: Annotated[
        float | None, Option(min=0.0, help="Largest gap or overlap of a contact (default: 2 %).")
    ] = None,
    anchor: Annotated[int | None, Option(help="Id of the anchor robot (default: first).")] = None,
    ground_z: Annotated[float | None, Option(help="Height of flat ground.")] = None,
    length_unit: Annotated[
        str, Option(help="Length unit, unless columns name it, such as x_mm.")
    ] = "unit",
    *,
    quiet: Quiet = False,
) -> None:
    """Convert robot poses of any simulator to a sensing log with contacts, and a truth."""
    from tiswarm.interop.imports import Assumptions, import_poses
    from tiswarm.robot import FIREANT_RHO, docks_in_plane

    assumed = Assumptions(
        dock_radius=dock_radius,
        tolerance=0.02 * dock_radius if tolerance is None else tolerance,
        anchor=anchor,
        ground_z=ground_z,
        length_unit=length_unit,
    )
    offset = FIREANT_RHO * dock_radius if dock_offset is None else dock_offset
    progress = ConsoleProgress(quiet=quiet)
    import_poses(poses, out, docks_in_plane(offset), assumed, progress)


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
