"""Commands on a user's data, sensing logs, poses and estimates, and on run folders."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from tiswarm.base.params import METHOD, AnyPrecision
from tiswarm.base.registry import BUILT_IN
from tiswarm.cli import options
from tiswarm.cli.options import app

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
            help=f"One of {', '.join(BUILT_IN['method'])}, or that of a plug-in; joint is the most "
            "accurate, virtual-force the paper's."
        ),
    ] = METHOD,
    cues: Annotated[
        str | None, Option(metavar="CUE,...", help="Cues to use (default: the method's own).")
    ] = None,
    seed: Annotated[int | None, Option(help="Seed of joint.")] = None,
    solution: Annotated[
        int | None,
        Option(metavar="K", help="Write solution K, the likeliest first, not their mean."),
    ] = None,
    overrides: options.Overrides = [],  # noqa: B006 - typer never changes it
    out: Annotated[Path, Option(help="Table of positions to write.")] = Path("estimate.csv"),
    report: Annotated[
        Path | None, Option(metavar="PAGE", help="Also write a page with a 3D view.")
    ] = None,
    arch: options.OneArch = "cpu",
    threads: options.Threads = None,
    precision: Annotated[
        AnyPrecision, Option(help="Floating-point type of joint; f32 is slower on processors.")
    ] = "auto",
    within: Annotated[
        float | None,
        Option(
            metavar="LENGTH",
            help="Distance, in the log's unit: state the probability that each robot is within it "
            "of its estimated position (default: the radius of a dock).",
            show_default=False,
        ),
    ] = None,
    plugins: options.Plugins = [],  # noqa: B006 - typer never changes it
    *,
    verbose: Annotated[bool, Option("--verbose", "-v", help="List the solutions.")] = False,
    overwrite: options.Overwrite = False,
    opened: options.Open = False,
    debug: options.Debug = False,
    quiet: options.Quiet = False,
) -> None:
    """Estimate the robots' positions from a sensing log.

    Simulators and real swarms write such logs (docs/files.md). The exit status is 4 if the estimate
    did not converge, or if noise as stated does not explain the measurements; it is written all the
    same.
    """
    from tiswarm import api
    from tiswarm.base.errors import NOT_TRUSTED, InputError

    if opened and report is None:
        raise InputError("needs a page; add --report PAGE", key="--open")
    names = None if cues is None else [cue.strip() for cue in cues.split(",")]
    seeded = {} if seed is None else {"seed": seed}
    with options.showing_traceback(debug=debug):
        localized = api.localize(
            log,
            method,
            cues=names,
            overrides=overrides,
            solution=solution,
            arch=arch,
            threads=threads,
            precision=precision,
            within=within,
            plugins=plugins,
            out=out,
            report=report,
            overwrite=overwrite,
            quiet=quiet,
            **seeded,
        )
    if not quiet:
        typer.echo(f"{localized.findings.statement} -> {out}")
        for line in localized.findings.reasons:
            typer.echo(line)
        if verbose:
            for line in localized.findings.solutions:
                typer.echo(line)
        count = len(localized.solutions)
        if count > 1 and solution is None:
            typer.echo(
                f"the positions are the mean of {count} solutions; --solution 1 writes the "
                "likeliest consistent configuration, --verbose lists all"
            )
    if report is not None and (opened or not quiet):
        options.show_page(report, opened=opened)
    if localized.findings.doubt:
        raise typer.Exit(NOT_TRUSTED)


@app.command(epilog="Example: radio-receiver | tiswarm track - > changes.jsonl")
def track(
    source: Annotated[
        str, Argument(metavar="LOG|-", help="Sensing log, or - for lines of standard input.")
    ],
    out: Annotated[
        Path | None,
        Option(
            help="File for the answers, which appears at the end of the input (default: print each "
            "answer at once).",
            show_default=False,
        ),
    ] = None,
    estimate: Annotated[
        Path | None, Option(metavar="TABLE", help="Table of positions to write at the end.")
    ] = None,
    overrides: options.Overrides = [],  # noqa: B006 - typer never changes it
    *,
    overwrite: options.Overwrite = False,
    quiet: options.Quiet = False,
) -> None:
    """Estimate the robots' positions while they join, line by line.

    Each line of the input has an answer, a JSON object: who moved, by how much, and how certain
    each now is. A malformed line is refused by its number and skipped. The same lines give the same
    answers: to start again, feed them from the first one.
    """
    import sys

    from tiswarm import api
    from tiswarm.base.errors import InputError

    if source == "-" and sys.stdin is None:
        raise InputError("standard input is closed; send lines to it, or name a LOG", key="-")
    lines = sys.stdin.buffer if source == "-" else Path(source)
    tracker = api.track(
        lines, out=out or sys.stdout, estimate=estimate, overrides=overrides, overwrite=overwrite
    )
    if out and not quiet:
        typer.echo(f"{len(tracker.names)} robots -> {out}")


@app.command(epilog="Example: tiswarm view sensing.jsonl estimate.csv --truth truth.csv")
def view(
    log: Annotated[
        Path, Argument(metavar="LOG|RUN", help="Sensing log, or for --live run folder.")
    ],
    estimate: EstimateTable = None,
    truth: Truth = None,
    explained: Annotated[
        list[int],
        Option("--explain", metavar="ROBOT", help="Show how measurements place it (repeatable)."),
    ] = [],  # noqa: B006 - typer never changes it
    color: options.Colors = [],  # noqa: B006 - typer never changes it
    out: Annotated[
        Path | None, Option(help="Page to write (default: view.html).", show_default=False)
    ] = None,
    port: Annotated[
        int | None, Option(min=1, max=65535, help="Port of --live (default: a free one).")
    ] = None,
    plugins: options.Plugins = [],  # noqa: B006 - typer never changes it
    *,
    live: Annotated[bool, Option("--live", help="Serve a run to this machine's browser.")] = False,
    overwrite: options.Overwrite = False,
    opened: options.Open = False,
    quiet: options.Quiet = False,
) -> None:
    """Show an estimate on a page with a 3D view.

    The page has the estimate's uncertainty, and what the log leaves open. With --live, it has the
    cases of a run that is still computed, and the 3D view of one. Ctrl-C ends the command.
    """
    if live:
        from tiswarm.app.live import serve
        from tiswarm.base.plugins import load_plugins

        of_log: dict[str, object] = {"ESTIMATE": estimate, "--truth": truth, "--out": out}
        of_log |= {"--explain": explained, "--color": color}
        options.refuse(of_log, "--live shows a run")
        load_plugins(plugins)
        serve(log, port or 0, lambda page: options.show_page(page, opened=opened))
        return
    from tiswarm import api

    options.refuse({"--port": port, "--plugin": plugins}, "only --live serves a page")
    page = api.view(
        log,
        estimate,
        truth,
        explain=explained,
        color=color,
        out=out,
        overwrite=overwrite,
        quiet=quiet,
    )
    if opened or not quiet:
        options.show_page(page, opened=opened)


@app.command(epilog="Example: tiswarm advise sensing.jsonl estimate.csv --budget 5")
def advise(
    log: Annotated[Path, Argument(metavar="LOG", help="Sensing log.")],
    estimate: EstimateTable = None,
    budget: Annotated[
        int | None, Option(metavar="K", help="Also list the K measurements best together.")
    ] = None,
    kinds: Annotated[
        str,
        Option(
            metavar="KIND,...", help="Kinds of these: contact, height, position, range, anchor."
        ),
    ] = "",
) -> None:
    """List the measurements to make next, best first.

    Candidates are contacts, heights and known positions. The expected RMSE is computed for up to
    1,000 robots. More are ranked by floppy modes. Without ESTIMATE, solutions of joint count, too:
    where robots are mirrored, a column has the difference between the two likeliest, and further
    ranges are candidates if LOG has some. --budget chooses a set one by one, each the best beside
    those before it; with --kinds anchor, robots on the ground that are to be anchors.
    """
    from tiswarm import api
    from tiswarm.base.errors import InputError

    if kinds and budget is None:
        raise InputError("needs a number of measurements; add --budget K", key="--kinds")
    chosen: Any = [kind.strip() for kind in kinds.split(",") if kind]
    typer.echo(api.advise(log, estimate, budget=budget, kinds=chosen, quiet=False))


@app.command("import", epilog="Example: tiswarm import poses.csv --dock-radius 0.5 --out imported")
def import_(
    poses: Annotated[
        Path,
        Argument(
            help="Table of poses, a robot or all robots a row; a folder with a table for each "
            "robot; .tum; .gsd; .bag; an export of Motive, Qualisys or Vicon."
        ),
    ],
    out: Annotated[
        Path | None, Option(help="Folder for sensing.jsonl and truth.csv; needless with --check.")
    ] = None,
    dock_radius: Annotated[
        float | None, Option(min=1e-9, max=1e9, help="Radius of a dock sphere (default: 1).")
    ] = None,
    beacons: Annotated[
        Path | None,
        Option(metavar="CSV", help="Import ranges tag,beacon,range instead: beacon,x,y,z."),
    ] = None,
    range_sd: Annotated[float | None, Option(min=0.0, help="Noise of a range, 1 sd.")] = None,
    orientations: Annotated[
        Path | None,
        Option(metavar="CSV", help="Import robots' own contacts instead: robot,time,qw,qx,qy,qz."),
    ] = None,
    ground: Annotated[
        Path | None, Option(metavar="CSV", help="Docks on the ground beside them: robot,dock,time.")
    ] = None,
    first_dock: Annotated[
        int | None, Option(min=0, max=1, help="Number of the first dock there: 0 or 1.")
    ] = None,
    report: Annotated[
        Path | None, Option(metavar="PAGE", help="Also localize by joint, and write a page.")
    ] = None,
    dock_offset: Annotated[
        float | None,
        Option(min=0.0, max=1e12, help="Center to dock (default: as contacts and flips say)."),
    ] = None,
    docks: Annotated[
        Path | None, Option(metavar="CSV", help="Docks in the body frame: dock,x,y,z.")
    ] = None,
    gap: Annotated[
        float | None,
        Option(min=0.0, help="Largest gap of a contact (default: 2 % of the radius, or noise)."),
    ] = None,
    overlap: Annotated[
        float | None, Option(min=0.0, help="Largest overlap of a contact (default: the same).")
    ] = None,
    contacts: Annotated[
        Path | None,
        Option(metavar="CSV", help="All contacts: robot,dock,other,other_dock (default: found)."),
    ] = None,
    anchor: Annotated[
        str, Option(metavar="ID,...", help="Anchor, and further robots at known positions.")
    ] = "",
    up: Annotated[
        str, Option(metavar="AXIS", help="Axis that is up: x, y, z, -x, -y, -z; it becomes z.")
    ] = "z",
    euler: Annotated[
        str, Option(help="Order of angles as in SciPy: ZYX (of the body), zyx (fixed) or rotvec.")
    ] = "",
    column: Annotated[
        str, Option(metavar="NAME=COLUMN,...", help="Columns, such as x=center_x,robot=label.")
    ] = "",
    topic: Annotated[
        str,
        Option(metavar="PATTERN", help="Topics of a bag that have the poses, as '/bot_*/pose'."),
    ] = "",
    bodies: Annotated[
        str, Option(metavar="PATTERN", help="Bodies of a bag that are robots, such as 'bot_*'.")
    ] = "",
    ground_z: Annotated[float | None, Option(help="Height of flat ground.")] = None,
    glitch_frames: Annotated[
        int, Option(min=0, help="Most poses in a row to leave out as one error of tracking.")
    ] = 10,
    tilt_deg: Annotated[float | None, Option(help="Noise of orientations: tilt, 1 sd.")] = None,
    yaw_deg: Annotated[float | None, Option(help="Noise of orientations: yaw, 1 sd.")] = None,
    length_unit: Annotated[
        str, Option(help="Length unit, unless columns name it, such as x_mm.")
    ] = "unit",
    plugins: options.Plugins = [],  # noqa: B006 - typer never changes it
    *,
    check: Annotated[
        bool, Option("--check", help="Print what would be imported, and write nothing.")
    ] = False,
    heights: Annotated[bool, Option("--heights", help="Log the height of each robot.")] = False,
    conjugate: Annotated[
        bool, Option("--conjugate", help="Read quaternions as world to body, not body to world.")
    ] = False,
    left_handed: Annotated[
        bool, Option("--left-handed", help="Turn a left-handed frame to a right-handed one.")
    ] = False,
    drop_disconnected: Annotated[
        bool,
        Option("--drop-disconnected", help="Drop robots that no contacts connect to an anchor."),
    ] = False,
    drop_incomplete: Annotated[
        bool, Option("--drop-incomplete", help="Drop rows with empty cells or NaN.")
    ] = False,
    overwrite: options.Overwrite = False,
    debug: options.Debug = False,
    quiet: options.Quiet = False,
) -> None:
    """Convert poses, ranges or recordings of robots to a sensing log.

    A column `run` names the structure of each row; each then has a folder of its own in --out.
    """
    from tiswarm import api
    from tiswarm.base.errors import InputError
    from tiswarm.base.robot import docks_in_plane
    from tiswarm.records.outputs import Outputs

    if dock_offset is not None and docks is not None:
        raise InputError("choose only one of --docks, --dock-offset")
    folder = _folder_of_log(out, report, check=check)
    estimate = folder / "estimate.csv"
    if report is not None:  # refuse it before a log is written beside it
        Outputs(overwrite=overwrite).check({"out": estimate, "report": report})
    body = None if dock_offset is None else docks_in_plane(dock_offset)
    named = dict(pair.partition("=")[::2] for pair in column.split(",") if pair)
    with options.showing_traceback(debug=debug):
        imports = api.import_poses(
            poses,
            out=out,
            plugins=plugins,
            overwrite=overwrite,
            dock_radius=dock_radius,
            dock_offset_body=body,
            docks=docks,
            gap=gap,
            overlap=overlap,
            contacts=contacts,
            anchors=_robots_of(anchor),
            up=up,
            euler=euler,
            columns=named,
            topic=topic,
            bodies=bodies,
            left_handed=left_handed,
            conjugate=conjugate,
            ground_z=ground_z,
            heights=heights,
            drop_disconnected=drop_disconnected,
            drop_incomplete=drop_incomplete,
            glitch_frames=glitch_frames,
            tilt_deg=tilt_deg,
            yaw_deg=yaw_deg,
            length_unit=length_unit,
            orientations=orientations,
            ground=ground,
            first_dock=first_dock,
            beacons=beacons,
            range_sd=range_sd,
        )
    if not quiet:
        for run, imported in imports.items():
            written = "" if out is None else f" -> {out / run}"
            typer.echo("\n".join(imported.notes) + written)
    if report is not None:
        localize(
            folder / "sensing.jsonl",
            out=estimate,
            report=report,
            overwrite=overwrite,
            debug=debug,
            quiet=quiet,
        )


def _folder_of_log(out: Path | None, report: Path | None, *, check: bool) -> Path:
    """Return the folder that an import writes to; refuse one that nothing is written to."""
    from tiswarm.base.errors import InputError

    if check and (out is not None or report is not None):
        raise InputError("writes nothing; leave --out and --report away", argument="check")
    if out is None and not check:
        raise InputError("give a folder for the log, or --check", argument="out")
    return Path() if out is None else out


def _robots_of(anchor: str) -> tuple[int, ...]:
    """Read a list of robots, such as 0,5."""
    from tiswarm.base.errors import InputError

    try:
        return tuple(map(int, anchor.split(","))) if anchor else ()
    except ValueError:
        problem = f"{anchor!r} is not a list of robots; write it like 0,5"
        raise InputError(problem, argument="anchor") from None


@app.command(epilog="Example: tiswarm score truth.csv estimate.csv")
def score(
    truth: Annotated[Path, Argument(help="Table of true positions.")],
    estimate: Annotated[Path, Argument(help="Table of estimated positions.")],
    out: Annotated[
        Path | None,
        Option(
            help="Figure to draw, .png or .pdf (default: ESTIMATE-score.png).", show_default=False
        ),
    ] = None,
    *,
    overwrite: options.Overwrite = False,
    quiet: options.Quiet = False,
) -> None:
    """Print and draw the errors of an estimate.

    Errors are those as it is and after alignment. The figure has the error of each robot in join
    order, and truth and estimate from two sides.
    """
    from tiswarm import api

    figure = out or estimate.with_name(f"{estimate.name.removesuffix('.csv')}-score.png")
    typer.echo(api.score(truth, estimate, out=figure, overwrite=overwrite, quiet=quiet))


@app.command(epilog="Example: tiswarm redraw reports/tower-1a2b3c4d --animate")
def redraw(
    run: options.RunFolderPath,
    renderer: Annotated[
        str | None, Option(help="open3d or taichi (default: the first that works).")
    ] = None,
    case: Annotated[
        str | None, Option(help="Case of the 3D pictures (default: the largest).")
    ] = None,
    color: options.Colors = [],  # noqa: B006 - typer never changes it
    plugins: options.Plugins = [],  # noqa: B006 - typer never changes it
    *,
    pdf: options.Pdf = False,
    animate: options.Animate = False,
    movie: options.Movie = None,
    opened: options.Open = False,
    quiet: options.Quiet = False,
) -> None:
    """Draw tables, pictures and page of a run again."""
    from tiswarm import api

    redrawn = api.redraw(
        run,
        plugins=plugins,
        pdf=pdf,
        movie=options.chosen_movie(movie, animate=animate),
        renderer=renderer,
        case=case,
        color=color,
        quiet=quiet,
    )
    if not quiet:
        typer.echo(redrawn)
    if opened or not quiet:
        options.show_page(redrawn.page, opened=opened)


@app.command(epilog="Example: tiswarm table reports/paper-1a2b3c4d --latex > table.tex")
def table(
    run: options.RunFolderPath,
    plugins: options.Plugins = [],  # noqa: B006 - typer never changes it
    *,
    latex: Annotated[bool, Option("--latex", help="Print LaTeX, for booktabs.")] = False,
    markdown: Annotated[bool, Option("--markdown", help="Print Markdown (default).")] = False,
    csv: Annotated[bool, Option("--csv", help="Print CSV.")] = False,
) -> None:
    """Print the table of errors of a run for a paper."""
    import tiswarm
    from tiswarm.base.errors import InputError
    from tiswarm.base.plugins import load_plugins

    if latex + markdown + csv > 1:
        raise InputError("choose only one of --latex, --markdown, --csv")
    load_plugins(plugins)
    form: Any = "markdown"
    if latex:
        form = "latex"
    elif csv:
        form = "csv"
    typer.echo(tiswarm.open_run(run).paper_text(form), nl=False)


@app.command(
    epilog="Example: tiswarm figure reports/scaling-1a2b3c4d scaling --panel rmse_R --width 3.5"
)
def figure(
    run: options.RunFolderPath,
    name: Annotated[str, Argument(help="Figure, such as scaling or accuracy.")],
    out: Annotated[Path | None, Option(help="File; NAME.png here if left out.")] = None,
    panel: Annotated[list[str], Option(help="Panel, such as rmse_R; all if left out.")] = [],  # noqa: B006 - typer never changes it
    series: Annotated[list[str], Option(help="Series, as the legend names it.")] = [],  # noqa: B006
    width: Annotated[float | None, Option(help="Width [inch], such as 3.5 for a column.")] = None,
    plugins: options.Plugins = [],  # noqa: B006
    *,
    pdf: Annotated[bool, Option("--pdf", help="Write vectors, NAME.pdf.")] = False,
    overwrite: options.Overwrite = False,
    quiet: options.Quiet = False,
) -> None:
    """Draw a figure of a run for a paper.

    It has the panels and series that you name, or all. Letters have 7 pt in any width.
    """
    import tiswarm
    from tiswarm.base.plugins import load_plugins

    load_plugins(plugins)
    file = out or Path(f"{name}.pdf" if pdf else f"{name}.png")
    tiswarm.open_run(run).figure(
        name, panels=panel, series=series, width=width, out=file, overwrite=overwrite
    )
    if not quiet:
        typer.echo(file)


@app.command(epilog="Example: tiswarm compare reports/tower-1a2b3c4d reports/joint-5e6f7a8b")
def compare(
    runs: Annotated[list[Path], Argument(metavar="RUN RUN ...", help="Run folders.")],
    out: Annotated[Path, Option(help="Folder to write to.")] = Path("reports/comparison"),
    *,
    overwrite: options.Overwrite = False,
    quiet: options.Quiet = False,
) -> None:
    """Compare runs in a table, a figure and a page of all cases.

    paired.csv has differences on the structures that the runs share. comparison.html plots, sorts
    and selects cases by any column.
    """
    from tiswarm import api

    comparison = api.compare(*runs, out=out, overwrite=overwrite)
    if not quiet:
        typer.echo(comparison)


@app.command(epilog="Example: tiswarm export reports/tower-1a2b3c4d --format gltf")
def export(
    source: Annotated[Path, Argument(metavar="RUN|LOG", help="Run folder or sensing log.")],
    form: Annotated[
        str,
        Option(
            "--format",
            help="csv, gltf, gsd, mcap, mjcf, parquet, ply, pyfg, tum, wbt; png for 3D pictures; "
            "gif, mp4 or webp for growth; or that of a plug-in.",
        ),
    ] = "gltf",
    estimate: EstimateTable = None,
    truth: Truth = None,
    out: Annotated[
        Path | None, Option(help="Folder to write to (default: export, in RUN if there is one).")
    ] = None,
    case: Annotated[str | None, Option(help="Case to export (default: the largest).")] = None,
    color: options.Colors = [],  # noqa: B006 - typer never changes it
    plugins: options.Plugins = [],  # noqa: B006 - typer never changes it
    *,
    overwrite: options.Overwrite = False,
    debug: options.Debug = False,
    quiet: options.Quiet = False,
) -> None:
    """Export a case, or a log and its estimate, for other programs.

    The files have structure, contacts and estimate.
    """
    from tiswarm import api

    with options.showing_traceback(debug=debug):
        api.export(
            source,
            form,
            estimate,
            truth,
            out=out,
            case=case,
            color=color,
            plugins=plugins,
            overwrite=overwrite,
            quiet=quiet,
        )
