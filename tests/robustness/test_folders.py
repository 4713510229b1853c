"""Commands on a run folder that somebody else has prepared: one line of error at most, and soon."""

import csv
import io
import json
import os
import resource
import shutil
from pathlib import Path

import psutil
import pytest
from PIL import Image

from tests.robustness.mutations import as_json_lines, damaged, mutated
from tests.runs import call_here

pytestmark = pytest.mark.slow

SECRET = b"7.125e-3,outside-of-the-run\n"
"""Content of a file beside the run that no command may copy into it."""

COMMANDS = [
    ["redraw"],
    ["export", "--format", "png"],
    ["export", "--format", "csv"],
    ["export", "--format", "gltf"],
    ["compare", "--out", "compared"],
]
REPLACEMENTS = {
    "missing": lambda _: None,
    "a folder": Path.mkdir,
    "a FIFO": os.mkfifo,
    "a link to a FIFO": lambda path: path.symlink_to(_outside(path) / "fifo"),
    "a link to a secret": lambda path: path.symlink_to(_outside(path) / "secret.csv"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "a link to endless zeros": lambda path: path.symlink_to("/dev/zero"),
    "64 GiB": lambda path: (path.touch(), os.truncate(path, 2**36)),
    "a huge picture": lambda path: Image.new("1", (20_000, 20_000)).save(path, "PNG"),
    "a TIFF": lambda path: Image.new("RGB", (9, 9)).save(path, "TIFF"),
}
CASE_NAMES = [
    "/etc",
    "../../outside",
    "..",
    ".",
    "",
    "two\nlines",
    "\x1b[2J",
    "\0",
    "x" * 5000,
    "~",
]
MEMORY = 6 * 2**30
"""Address space that a command may take beyond what the tests have [byte]."""


def _outside(path: Path) -> Path:
    return next(folder for folder in path.parents if folder.name == "run").with_name("outside")


@pytest.fixture
def prepared(tmp_path, coarse_pictures) -> Path:
    """Folder of a run with pictures; figures are coarse and pictures empty, so that it is quick."""
    done = call_here(
        "run", "tests/tower.yaml", "--set", "robots=6",
        "--set", "seeds=2", "--set", "conditions={a: {}, b: {localization.iterations: 20}}",
        "--out", tmp_path / "made",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return next((tmp_path / "made").iterdir())


@pytest.fixture
def _little_memory():
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (psutil.Process().memory_info().vms + MEMORY, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, limits)


def _rewrite(random, path: Path) -> None:
    """Change values, keys, cells, rows or columns of a file of plain data; else its bytes."""
    raw = path.read_bytes()
    if path.suffix == ".csv":
        rows = mutated(random, [*csv.reader(io.StringIO(raw.decode()))])
        if path.name == "summary.csv" and random.random() < 0.3:
            rows = [rows[0], *([random.choice(CASE_NAMES), *row[1:]] for row in rows[1:])]
        cells = [row if isinstance(row, list) else [row] for row in rows]
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(cells)
        path.write_text(text.getvalue())
    elif path.suffix == ".json":
        path.write_text(json.dumps(mutated(random, json.loads(raw))))
    elif path.suffix == ".jsonl":
        path.write_bytes(as_json_lines(mutated(random, [*map(json.loads, raw.splitlines())])))
    else:
        path.write_bytes(damaged(random, raw))


def _prepare(random, run: Path) -> tuple[Path, str]:
    """Change one file or folder of a run; return it and what it is now."""
    case = run / "cases" / "0-a"  # the first one, which commands draw
    files = [path for path in run.rglob("[!.]*") if case in path.parents or path.parent == run]
    path = random.choice(sorted([*files, *run.glob("*/*.png")]))
    if path.is_dir() or random.random() < 0.3:
        what = random.choice([*REPLACEMENTS])
        shutil.rmtree(path) if path.is_dir() else path.unlink()
        REPLACEMENTS[what](path)
        return path, what
    _rewrite(random, path)
    return path, "changed"


@pytest.mark.usefixtures("_little_memory")
def test_a_folder_of_somebody_else_is_read_or_refused(trial, prepared, tmp_path):
    """No file of it crashes or stops a command, reaches another folder or brings one in."""
    run, outside = tmp_path / "run", tmp_path / "outside"
    outside.mkdir()
    (outside / "secret.csv").write_bytes(SECRET)
    os.mkfifo(outside / "fifo")
    for number in trial.numbers(500):
        random = trial.random(number)
        shutil.rmtree(run, ignore_errors=True)
        shutil.copytree(prepared, run)
        path, state = _prepare(random, run)
        name, *options = random.choice(COMMANDS)
        runs = [run, prepared] if name == "compare" else [run]
        with trial.attempt(number, path, what=f"{name}: {path.relative_to(run)} is {state}"):
            done = call_here(name, *runs, *options, cwd=tmp_path)
            status, said = done.returncode, done.stderr
            assert status in {0, 1, 2}, said
            assert all(line.isprintable() for line in said.splitlines()), said
            errors = [line for line in said.splitlines() if line.startswith("tiswarm: error: ")]
            assert errors == said.splitlines()[-1:] * (status > 0), said
            assert sorted(path.name for path in outside.iterdir()) == ["fifo", "secret.csv"]
            whole = (path for path in run.rglob("*") if path.is_file() and not path.is_symlink())
            small = (path for path in whole if path.stat().st_size < 10**8)
            assert not [path for path in small if SECRET in path.read_bytes()], said
            trial.outcomes["refused" if status else "read"] += 1

    assert trial.failures == []
