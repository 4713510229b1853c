"""Commands on somebody's own data: sensing logs, poses, estimates."""

from pathlib import Path
from typing import Annotated

import typer

from tiswarm.cli.options import OneArch, Overrides, Quiet, Threads, app
from tiswarm.console import ConsoleProgress
from tiswarm.params import Precision


@app.command(epilog="Example: tiswarm localize sensing.jsonl --method joint --out estimate.csv")
def localize(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Sensing log, sensing.jsonl.")],
    method: Annotated[
        str,
        typer.Option(help="virtual-force, the paper's; joint, the most accurate; least-squares."),
    ] = "virtual-force",
    cues: Annotated[
        str | None, typer.Option(metavar="CUE,...", help="What of the log to use, and no more.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the method, where it has one.")] = None,
    overrides: Overrides = [],  # noqa: B006 - typer never changes it
    out: Annotated[Path, typer.Option(help="Where to write.")] = Path("estimate.csv"),
    arch: OneArch = "cpu",
    threads: Threads = None,
    precision: Annotated[Precision, typer.Option(help="Real type of the kernels.")] = "f64",
    *,
    quiet: Quiet = False,
) -> None:
    """Work out where the robots of a sensing log are; any simulator's, or a real swarm's.

    Exits with status 4 where the estimate is written, but did not converge.
    """
    from tiswarm.compute import backend
    from tiswarm.errors import NOT_CONVERGED
    from tiswarm.inspection import (
        ambiguities,
        doubts,
        failed_to_converge,
        judged_wrong,
        outcome,
    )
    from tiswarm.localization import registry
    from tiswarm.records.positions import write_estimate
    from tiswarm.records.sensing_file import read_sensing_log
    from tiswarm.scenario import localization_params

    chosen = [] if seed is None else [f"seed={seed}"]
    names = None if cues is None else [cue.strip() for cue in cues.split(",")]
    params = localization_params(method, [*chosen, *overrides], cues=names)
    sensed = read_sensing_log(log)
    backend.start(arch, threads=threads, precision=precision)
    estimate = registry.localize(sensed, params)
    write_estimate(out, estimate, length_unit=sensed.length_unit)
    problem = failed_to_converge(sensed, estimate)
    if problem is not None:
        typer.echo(f"tiswarm: warning: {problem}", err=True)
    if not quiet:
        for line in doubts(sensed, log, filter(None, [estimate.observability])):
            typer.echo(line)
        for line in [*judged_wrong(sensed, log, estimate), *ambiguities(sensed, estimate)]:
            typer.echo(line)
        typer.echo(f"{outcome(sensed, estimate)} -> {out}")
    if problem is not None:
        raise typer.Exit(NOT_CONVERGED)


@app.command("import", epilog="Example: tiswarm import poses.csv --dock-radius 0.5 --out imported")
def import_(
    poses: Annotated[
        Path, typer.Argument(help="Table: robot,x,y,z,qw,qx,qy,qz or robot,sphere,x,y,z.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for sensing.jsonl and truth.csv.")],
    dock_radius: Annotated[float, typer.Option(min=1e-9, help="Radius of a dock sphere.")] = 1.0,
    dock_offset: Annotated[
        float | None,
        typer.Option(help="Center to each of three docks, 120 degrees apart; not for spheres."),
    ] = None,
    tolerance: Annotated[
        float | None, typer.Option(min=0.0, help="Gap or overlap that still is a contact.")
    ] = None,
    anchor: Annotated[int | None, typer.Option(help="Robot of known place; the first one.")] = None,
    ground_z: Annotated[float | None, typer.Option(help="Height of flat ground.")] = None,
    length_unit: Annotated[
        str, typer.Option(help="Unit where no column names it, as x_mm does.")
    ] = "unit",
    *,
    quiet: Quiet = False,
) -> None:
    """Turn poses from any simulator into a sensing log and a truth, deriving who touches whom."""
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
    truth: Annotated[Path, typer.Argument(help="Where the robots are, as truth.csv.")],
    estimate: Annotated[Path, typer.Argument(help="Where they are thought to be.")],
) -> None:
    """Say how far an estimate is from a truth, as it is and after alignment."""
    from tiswarm.evaluation.tables import score_files

    unit, scores = score_files(truth, estimate)
    for name, value in scores.items():
        typer.echo(f"{name:<28} {value:.4g}{'' if 'disparity' in name else f' {unit}'}")
