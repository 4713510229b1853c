"""The `tiswarm` command: parse, call, print.

What a command needs is imported when it runs, so that `tiswarm --help` stays quick.
"""

import json
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.exceptions import TyperException

import tiswarm
from tiswarm.compute.choices import Arch, Precision
from tiswarm.console import ConsoleWatcher, fail
from tiswarm.errors import CasesFailedError, InputError, TiswarmError

if TYPE_CHECKING:
    from tiswarm import study

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Grow swarms of modular robots and let them find out where they are by touch.",
    epilog="Example: tiswarm run scenarios/tower.yaml",
)

Overrides = Annotated[
    list[str],
    typer.Option("--set", metavar="KEY=VALUE", help="Override a key; may be given often."),
]
OneArch = Annotated[Arch, typer.Option("--arch", help="Device; never another than asked for.")]
Threads = Annotated[
    int | None, typer.Option(help="CPU threads; all cores if not given.", show_default=False)
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")]
RunFolderPath = Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.")]
Pdf = Annotated[bool, typer.Option("--pdf", help="Draw figures as vector PDF too.")]
Animate = Annotated[bool, typer.Option("--animate", help="Draw how the first structure grew.")]
Movie = Annotated[Literal["gif", "mp4"], typer.Option(help="What --animate writes.")]
ExportFormat = Literal["csv", "gltf", "parquet", "ply"]
INTERRUPTED = 130


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    *,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        typer.echo(f"tiswarm {tiswarm.__version__}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command(epilog="Example: tiswarm run scenarios/tower.yaml --set robots=20 --set seeds=2")
def run(
    scenario: Annotated[Path, typer.Argument(help="Scenario file.")],
    overrides: Overrides = [],  # noqa: B006 - typer never changes it
    out: Annotated[Path, typer.Option(help="Folder for the run's own folder.")] = Path("reports"),
    arch: OneArch = "cpu",
    threads: Threads = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes to compute in, side by side.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler to compute on.")
    ] = None,
    shard: Annotated[
        str, typer.Option(metavar="I/N", help="Compute the I-th of N parts only.")
    ] = "1/1",
    case_limit: Annotated[
        float | None,
        typer.Option(min=0.001, metavar="SECONDS", help="Give a case up that takes longer."),
    ] = None,
    *,
    only_plan: Annotated[
        bool, typer.Option("--plan", help="Say what it would take, and run nothing.")
    ] = False,
    fail_fast: Annotated[bool, typer.Option("--fail-fast", help="Stop at a failed case.")] = False,
    pictures: Annotated[bool, typer.Option(help="Draw figures, renders and report.html.")] = True,
    pdf: Pdf = False,
    animate: Animate = False,
    movie: Movie = "gif",
    quiet: Quiet = False,
) -> None:
    """Grow, sense, localize, score and draw every case of a scenario.

    A run that was interrupted goes on where it was.
    """
    from tiswarm import study
    from tiswarm.scenario import load_scenario

    watcher = ConsoleWatcher(quiet=quiet)
    plan = load_scenario(scenario, overrides)
    if only_plan:
        typer.echo(study.forecast(study.plan(plan)))
        return
    dispatch = study.Dispatch(
        workers=workers,
        scheduler=scheduler,
        shard=_shard(shard),
        case_limit_s=case_limit,
        fail_fast=fail_fast,
    )
    result = study.run(plan, out, watcher=watcher, arch=arch, threads=threads, dispatch=dispatch)
    if result.missing:
        watcher.say(f"part {shard} is done; {result.missing} cases of other parts are missing")
    else:
        _show(result, watcher, pictures=pictures, pdf=pdf, movie=movie if animate else None)
    if result.failed:
        first = result.failed[0]
        msg = f"{len(result.failed)} cases failed, the first: {first.case}: {first.reason}"
        raise CasesFailedError(msg)


def _shard(text: str) -> tuple[int, int]:
    """Read I/N."""
    found = re.fullmatch(r"(\d+)/(\d+)", text)
    number, count = map(int, found.groups()) if found else (0, 0)
    if not 1 <= number <= count:
        msg = "is no part of a whole; give it as 2/8, from 1/8 to 8/8"
        raise InputError(msg, key=f"--shard {text}")
    return number, count


def _show(
    result: "study.RunResult",
    watcher: ConsoleWatcher,
    *,
    pictures: bool,
    pdf: bool,
    movie: Literal["gif", "mp4"] | None,
) -> None:
    """Draw what a run came to and say it in a few lines."""
    from tiswarm import study

    some_done = len(result.failed) < result.computed + result.found
    there = (result.folder / "report.html").exists()
    drawn = pictures and (pdf or result.computed > 0 or not there)
    if drawn:
        _draw_figures(result.folder, watcher, pdf=pdf)
        if some_done:
            _draw_renders(result.folder, watcher)
    if movie and some_done:
        _animate(result.folder, watcher, movie)
    if drawn or movie:
        _write_page(result.folder, watcher)
    if not watcher.quiet:
        typer.echo(study.headline(result.folder))


@app.command(epilog="Example: tiswarm localize sensing.jsonl --set z_correction=false")
def localize(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Sensing log, sensing.jsonl.")],
    method: Annotated[str, typer.Option(help="Localization method.")] = "virtual-force",
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
    """Work out where the robots of a sensing log are; any simulator's, or a real swarm's."""
    from tiswarm.compute import backend
    from tiswarm.inspection import doubts
    from tiswarm.localization import registry
    from tiswarm.records.sensing_file import read_sensing_log
    from tiswarm.records.tables import write_estimate
    from tiswarm.scenario import localization_params

    chosen = [] if seed is None else [f"seed={seed}"]
    params = localization_params(
        method, [*chosen, *overrides], cues=None if cues is None else cues.split(",")
    )
    sensed = read_sensing_log(log)
    backend.start(arch, threads=threads, precision=precision)
    estimate = registry.localize(sensed, params)
    write_estimate(out, estimate, length_unit=sensed.length_unit)
    if not quiet:
        for line in doubts(sensed, log, filter(None, [estimate.certainty])):
            typer.echo(line)
        for line in estimate.notes:
            typer.echo(line)
        typer.echo(
            f"{estimate.robot_count} robots, residual {estimate.residual[-1]:.2g} "
            f"{sensed.length_unit} rms -> {out}"
        )


@app.command(epilog="Example: tiswarm tune scenarios/paper.yaml --trials 200 --out fit.json")
def tune(
    scenario: Annotated[Path, typer.Argument(help="Scenario file.")],
    overrides: Overrides = [],  # noqa: B006 - typer never changes it
    trials: Annotated[int, typer.Option(min=1, help="Trials, those of the record included.")] = 200,
    training_seeds: Annotated[
        int, typer.Option(min=1, help="Structures of each sweep point, from seed 1000 on.")
    ] = 25,
    condition: Annotated[
        list[str], typer.Option(help="Condition that counts; may be given often; all if not.")
    ] = [],  # noqa: B006 - typer never changes it
    out: Annotated[Path, typer.Option(help="Record of the fit.")] = Path("fit.json"),
    arch: OneArch = "cpu",
    threads: Threads = None,
    *,
    quiet: Quiet = False,
) -> None:
    """Fit the gains of virtual-force on structures that the scenario does not report on.

    A fit that was interrupted goes on where it was.
    """
    from tiswarm import study
    from tiswarm.scenario import load_scenario

    record = study.tune(
        load_scenario(scenario, overrides), out,
        trials=trials, training_seeds=training_seeds, conditions=condition,
        watcher=ConsoleWatcher(quiet=quiet), arch=arch, threads=threads,
    )  # fmt: skip
    if not quiet:
        for name in ("best", "chosen"):
            gains = {key: value for key, value in record[name].items() if key in record["ranges"]}
            told = ", ".join(f"{key} {value:.3g}" for key, value in gains.items())
            typer.echo(f"{name}: RMSE {record[name]['rmse_R']:.3f} R with {told}")
        typer.echo(f"record in {out}")


@app.command(epilog="Example: tiswarm report reports/tower-1a2b3c4d")
def report(run: RunFolderPath, *, pdf: Pdf = False, quiet: Quiet = False) -> None:
    """Redraw every table, every figure and report.html of a run from its stored data."""
    from tiswarm import study

    watcher = ConsoleWatcher(quiet=quiet)
    study.tabulate(run)
    _draw_figures(run, watcher, pdf=pdf)
    _write_page(run, watcher)
    if not quiet:
        typer.echo(study.headline(run))


@app.command(epilog="Example: tiswarm render reports/tower-1a2b3c4d --renderer open3d")
def render(
    run: RunFolderPath,
    renderer: Annotated[
        str | None, typer.Option(help="open3d, open3d-raycast or taichi; the first that works.")
    ] = None,
    case: Annotated[str | None, typer.Option(help="Case to draw; the first one.")] = None,
    *,
    animate: Animate = False,
    movie: Movie = "gif",
    quiet: Quiet = False,
) -> None:
    """Draw offscreen 3D pictures of a run from its stored data, and put them on report.html."""
    watcher = ConsoleWatcher(quiet=quiet)
    _draw_renders(run, watcher, renderer=renderer, case=case)
    if animate:
        _animate(run, watcher, movie, renderer=renderer, case=case)
    _write_page(run, watcher)


@app.command(epilog="Example: tiswarm compare reports/tower-1a2b3c4d reports/joint-5e6f7a8b")
def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN RUN ...", help="Run folders.")],
    out: Annotated[Path, typer.Option(help="Where to write.")] = Path("reports/comparison"),
    *,
    quiet: Quiet = False,
) -> None:
    """Set runs side by side: one table, differences on the structures they share, one figure."""
    from tiswarm.report.comparison_figure import draw_comparison
    from tiswarm.study.comparison import compare as tabulate

    tabulate(runs, out)
    draw_comparison(out, ConsoleWatcher(quiet=True).say)
    if not quiet:
        typer.echo(f"comparison.csv, paired.csv and comparison.png in {out}")


@app.command("import", epilog="Example: tiswarm import poses.csv --dock-radius 0.5 --out imported")
def import_(
    poses: Annotated[
        Path, typer.Argument(help="Table: robot,x,y,z,qw,qx,qy,qz or robot,sphere,x,y,z.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for sensing.jsonl and truth.csv.")],
    dock_radius: Annotated[float, typer.Option(min=1e-9, help="Radius of a dock sphere.")] = 1.0,
    dock_offset: Annotated[
        float | None,
        typer.Option(help="Centre to each of three docks, 120 degrees apart; not for spheres."),
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
    from tiswarm.interop.importing import Assumptions, import_poses
    from tiswarm.robot import FIREANT_RHO, docks_in_plane

    assumed = Assumptions(
        dock_radius=dock_radius,
        tolerance=0.02 * dock_radius if tolerance is None else tolerance,
        anchor=anchor,
        ground_z=ground_z,
        length_unit=length_unit,
    )
    offset = FIREANT_RHO * dock_radius if dock_offset is None else dock_offset
    tell = ConsoleWatcher(quiet=quiet).say
    import_poses(poses, out, docks_in_plane(offset), assumed, tell)


@app.command(epilog="Example: tiswarm score truth.csv estimate.csv")
def score(
    truth: Annotated[Path, typer.Argument(help="Where the robots are, as truth.csv.")],
    estimate: Annotated[Path, typer.Argument(help="Where they are thought to be.")],
) -> None:
    """Say how far an estimate is from a truth, as it is and after alignment."""
    from tiswarm.evaluation.scoring import score_files

    unit, scores = score_files(truth, estimate)
    for name, value in scores.items():
        typer.echo(f"{name:<28} {value:.4g}{'' if 'disparity' in name else f' {unit}'}")


@app.command(epilog="Example: tiswarm export reports/tower-1a2b3c4d --format gltf")
def export(
    run: RunFolderPath,
    form: Annotated[ExportFormat, typer.Option("--format", help="What to write.")],
    out: Annotated[Path | None, typer.Option(help="Folder to write to; RUN/export.")] = None,
    case: Annotated[str | None, typer.Option(help="Case to export; the first one.")] = None,
    *,
    quiet: Quiet = False,
) -> None:
    """Write structure, contacts and estimate of a case for other programs."""
    from tiswarm.interop.exporting import export_case

    tell = ConsoleWatcher(quiet=quiet).say
    export_case(run, form, run / "export" if out is None else out, case, tell)


@app.command(epilog="Example: tiswarm check scenarios/*.yaml sensing.jsonl")
def check(
    files: Annotated[list[Path], typer.Argument(help="Scenarios (.yaml) and logs (.jsonl).")],
) -> None:
    """Look for mistakes in scenarios and sensing logs, without running anything."""
    from tiswarm.inspection import inspect

    mistakes: list[InputError] = []
    for path in files:
        finding = inspect(path)
        mistakes += finding.mistakes
        if not finding.mistakes:
            typer.echo(f"{path}: {finding.summary}")
    for mistake in mistakes[:-1]:
        fail(str(mistake))
    if mistakes:
        raise mistakes[-1]


@app.command(epilog="Example: tiswarm schema > scenario.schema.json")
def schema() -> None:
    """Print the JSON Schema of a scenario, for editors that complete and check YAML."""
    from tiswarm.scenario import scenario_schema

    typer.echo(json.dumps(scenario_schema(), indent=2))


@app.command(epilog="Example: tiswarm doctor")
def doctor(
    *,
    missing_packages: Annotated[
        bool,
        typer.Option(
            "--missing-packages", help="Print only the system packages to install, in one line."
        ),
    ] = False,
) -> None:
    """Say what works on this machine, and what to install for what does not."""
    from tiswarm import doctor as examination

    if missing_packages:
        typer.echo(" ".join(examination.missing_packages()), nl=True)
        return
    for finding in examination.examine():
        mark = "ok" if finding.works else "--"
        typer.echo(f"{mark}  {finding.subject:<24} {finding.detail}")


def _draw_figures(folder: Path, watcher: ConsoleWatcher, *, pdf: bool) -> None:
    from tiswarm.report.figures import draw_figures

    draw_figures(folder, watcher.say, vector=pdf)


def _write_page(folder: Path, watcher: ConsoleWatcher) -> None:
    from tiswarm.report.page import write_page

    write_page(folder, watcher.say)


def _draw_renders(
    folder: Path, watcher: ConsoleWatcher, *, renderer: str | None = None, case: str | None = None
) -> None:
    from tiswarm.report.render import render_run
    from tiswarm.study.manifest import write_manifest

    drawn = render_run(folder, tell=watcher.say, renderer=renderer, case=case)
    write_manifest(
        folder,
        {
            "renders": {
                picture.path.name: {"renderer": picture.renderer, "reason": picture.reason}
                for picture in drawn
            }
        },
    )


def _animate(
    folder: Path,
    watcher: ConsoleWatcher,
    movie: Literal["gif", "mp4"],
    *,
    renderer: str | None = None,
    case: str | None = None,
) -> None:
    from tiswarm.report.render.animation import animate_run

    animate_run(folder, movie, tell=watcher.say, renderer=renderer, case=case)


def main() -> None:
    """Run the command line; errors that a user can mend end in one line, not a traceback."""
    sys.exit(_status(sys.argv[1:]))


def _status(arguments: list[str]) -> int:
    """Run a command and return its exit status."""
    try:
        status: Any = app(arguments, standalone_mode=False)
    except TiswarmError as error:
        fail(str(error))
        return error.exit_status
    except TyperException as error:
        fail(" ".join(error.format_message().split()))
        return InputError.exit_status
    except (KeyboardInterrupt, typer.Abort):
        fail("interrupted; what was finished is kept, and the same command goes on from there")
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return 1
    return status if isinstance(status, int) else 0
