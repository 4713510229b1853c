"""A run folder that somebody else made or damaged is refused in one line, before it can do harm."""

import os
import resource
import shutil
from collections.abc import Callable
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.report.conftest import write_table
from tiswarm import study
from tiswarm.app.formats import export_view
from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.base.progress import Progress
from tiswarm.report.figures import draw_figures
from tiswarm.report.page import write_page
from tiswarm.report.pictures import pictures
from tiswarm.report.run_data import load_run
from tiswarm.report.swarm_view import read_case_view

ROBOTS = "cases/0-baseline/robots.csv"
LOADS = "cases/0-baseline/loads.csv"
LOG = "cases/0-baseline/sensing.jsonl"
TABLE = (
    "condition,cases,rmse_R_mean,rmse_R_ci95,procrustes_disparity_mean,procrustes_disparity_ci95,"
    "paper_rmse_radii,paper_procrustes_disparity"
)
ALIASES = "".join(f"{b}: &{b} [{9 * f'*{a}, '}]\n" for a, b in pairwise("abcdefghi"))


@pytest.fixture
def run(run_folder):
    """A whole run with a figure."""
    (run_folder / "scenario.yaml").write_text(
        "name: odd\nstructure: {kind: tower}\nlocalization: {method: joint}\n"
    )
    write_table(run_folder / "table.csv", TABLE, [["baseline", 2, 1.0, 0.1, 0.5, 0.2, "", ""]])
    header = "condition,against,measure,structures,difference_mean,smaller,wilcoxon_p"
    write_table(run_folder / "paired.csv", header, [["no-z", "baseline", "rmse_R", 2, 0.1, 1, 0.5]])
    header = "robot,dock,neighbor,neighbor_dock,axial_W,margin"
    rows = [[1, 0, "0", 2, -3.5, 1.5], [0, 1, "ground", "", -6.0, 4.0]]
    write_table(run_folder / LOADS, header, rows)
    (run_folder / "renders").mkdir()
    Image.new("RGB", (4, 4)).save(run_folder / "renders" / "error.png")
    return run_folder


def page(run):
    """Write the page of a run."""
    return write_page(load_run(run), Progress()).read_text()


def scenes(run):
    """Build all scenes of a run's first case."""
    return pictures.build_pictures(read_case_view(load_run(run).choose(None)))


def figures(run):
    """Draw the figures of a run."""
    draw_figures(load_run(run), Progress())


def renders(run):
    """Draw the 3D pictures of a run."""
    pictures.render_run(load_run(run), progress=Progress())


def movie(form):
    """Return a function that animates a run."""
    return lambda run: pictures.animate_run(load_run(run), form, progress=Progress())


@contextmanager
def no_room():
    """Let files of this process have no more than a hundred bytes, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def export(run):
    """Export a run's first case."""
    view = read_case_view(load_run(run).choose(None))
    export_view(view, "csv", run / "export", Progress())


def cell(column, value, *, row=-1):
    """Return a change of one cell of a table."""

    def change(path):
        header, *rows = [line.split(",") for line in path.read_text().splitlines()]
        rows[row][header.index(column)] = value
        write_table(path, ",".join(header), rows)

    return change


def swept(value):
    """Return a change of a summary: the number of robots is swept, and one is wrong."""

    def change(path):
        header, *rows = [line.split(",") for line in path.read_text().splitlines()]
        place = header.index("status")
        rows = [[*row[:place], value, *row[place:-1]] for row in rows]
        write_table(path, ",".join([*header[:place], "robots", *header[place:-1]]), rows)

    return change


def without(column):
    """Return a change of a table that takes a column out."""

    def change(path):
        rows = [line.split(",") for line in path.read_text().splitlines()]
        place = rows[0].index(column)
        path.write_text("".join(",".join(r[:place] + r[place + 1 :]) + "\n" for r in rows))

    return change


def lines(first, last):
    """Return a change of a file that keeps some of its lines."""
    return lambda path: path.write_text("\n".join(path.read_text().splitlines()[first:last]) + "\n")


def written(data):
    """Return a change that replaces the content of a file."""
    return lambda path: path.write_bytes(data if isinstance(data, bytes) else data.encode())


def replaced(make: Callable[[Path], object]):
    """Return a change that puts another kind of file in a file's place."""

    def change(path):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
        make(path)

    return change


def sparse(path):
    """Make a file look like 64 GiB, which take no room on the disk."""
    with path.open("ab") as file:
        file.truncate(2**36)


def large_picture(path):
    """Write a picture of 400 million pixels."""
    Image.new("1", (20_000, 20_000)).save(path)


KINDS = {
    "pipe": replaced(os.mkfifo),
    "device": replaced(lambda path: path.symlink_to("/dev/zero")),
    "sparse": sparse,
    "outside": replaced(lambda path: path.symlink_to("/etc/passwd")),
    "loop": replaced(lambda path: path.symlink_to(path.name)),
    "folder": replaced(Path.mkdir),
    "binary": written(bytes(range(256)) * 99),
}


@pytest.mark.parametrize(
    ("command", "file", "damage", "problem"),
    [
        (page, "scenario.yaml", written(f"a: &a [x]\n{ALIASES}name: *i\n"), ":1: anchors and"),
        (page, "scenario.yaml", written("- a\n"), ": cannot be read: it is no mapping"),
        (page, "scenario.yaml", written(f"name: {'[' * 3000}"), ":1: nested deeper"),
        (page, "scenario.yaml", written("name: !!python/name:os.sep\n"), ":1: tags such"),
        (page, "manifest.json", written("[" * 100_000), ": is damaged"),
        (page, "summary.csv", without("seed"), ":1: seed: there is no such column"),
        (page, "summary.csv", lines(0, 1), ":2: there are no rows"),
        (page, "summary.csv", cell("robots", "many", row=0), ":2: robots: 'many' is not a number"),
        (page, "summary.csv", swept("many"), ":2: robots: 'many' is not a number"),
        (page, "table.csv", cell("rmse_R_mean", "<b>"), ":2: rmse_R_mean: '<b>' is not a number"),
        (page, "table.csv", lines(0, 1), ":2: there are no rows"),
        (page, "table.csv", without("cases"), ":1: cases: there is no such column"),
        (page, "paired.csv", without("smaller"), ":1: smaller: there is no such column"),
        (page, "renders/error.png", written("no picture"), ": is no PNG picture"),
        (page, "renders/error.png", large_picture, ": is no PNG picture"),
        (scenes, ROBOTS, Path.unlink, ": cannot be read"),
        (scenes, ROBOTS, lines(0, 8), ":9: has 7 robots, the log 12"),
        (scenes, ROBOTS, lines(0, 1), ":2: there are no rows"),
        (scenes, ROBOTS, cell("x_R", "", row=3), ":5: x_R: an empty cell is not"),
        (scenes, ROBOTS, cell("z_R", "1e308", row=3), ":5: z_R: '1e.308' is not a number"),
        (scenes, ROBOTS, cell("qw", "inf"), ":13: qw: 'inf' is not a number"),
        (scenes, ROBOTS, without("sensed_force"), ":1: sensed_force: there is no such column"),
        (export, ROBOTS, lines(0, 8), ":9: has 7 robots, the log 12"),
        (page, LOADS, without("margin"), ":1: margin: there is no such column"),
        (page, LOADS, without("neighbor_dock"), ":1: neighbor_dock: there is no such column"),
        (page, LOADS, cell("axial_W", "much"), ":3: axial_W: 'much' is not a number"),
        (page, LOADS, cell("neighbor_dock", "0.5"), ":3: neighbor_dock: 0.5 is no dock"),
        (export, LOADS, cell("robot", ""), ":3: robot: an empty cell is not"),
        *[
            (command, file, damage, ":")
            for command, file in [
                (page, "scenario.yaml"),
                (page, "manifest.json"),
                (page, "summary.csv"),
                (page, "renders/error.png"),
                (page, ROBOTS),
                (page, LOADS),
                (scenes, LOG),
            ]
            for damage in KINDS.values()
        ],
    ],
)  # fmt: skip
def test_damage_is_refused_in_one_line(run, command, file, damage, problem):
    """The line names the file, and where possible the line and the key; nothing is written."""
    (run / "manifest.json").write_text("{}")
    damage(run / file)
    before = {path: path.lstat().st_mtime_ns for path in run.rglob("*")}

    with pytest.raises(InputError, match=rf"{file}{problem}") as refusal:
        command(run)

    assert "\n" not in str(refusal.value)
    assert "; " in refusal.value.problem
    assert {path: path.lstat().st_mtime_ns for path in run.rglob("*")} == before


@pytest.mark.parametrize("measure", ["", "other"])
def test_a_page_leaves_out_measures_that_it_does_not_know(run, measure):
    """No row of differences may be left."""
    cell("measure", measure)(run / "paired.csv")

    assert "Differences on the same structures" in page(run)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of imageio
@pytest.mark.parametrize("command", [figures, renders, movie("gif"), movie("mp4"), page, export])
def test_a_full_disk_ends_in_one_line(run, monkeypatch, command):
    """Pictures and tables appear whole or not at all, and cases stay as they are."""
    drawn = np.random.default_rng(0).integers(0, 255, (64, 64, 4), np.uint8)
    for name in ("draw_scenes", "draw_growth"):
        monkeypatch.setattr(pictures, name, lambda of, *_: ([drawn] * len(of), "none", ""))
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}

    with no_room(), pytest.raises(EnvironmentTroubleError, match="free space"):
        command(run)

    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


def test_a_report_of_a_pipe_is_refused(run):
    """To open a pipe that nobody writes to would wait for ever."""
    replaced(os.mkfifo)(run / "scenario.yaml")

    with pytest.raises(InputError, match=r"scenario\.yaml: cannot be read: "):
        study.tabulate(run, Progress())
