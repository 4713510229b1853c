"""Outputs that would cost a user a file, and streams that end anywhere: no file is lost."""

import io
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import patch

import pytest

from tests.robustness.mutations import damaged
from tests.runs import REPOSITORY, call_here, environment

pytestmark = pytest.mark.slow

QUICK = ["--set", "chains=1", "--set", "steps=5", "--set", "hold_steps=2"]
RUN = ["--set", "robots=4", "--set", "seeds=1", "--set", "conditions={a: {}}", "--no-pictures"]
ESTIMATE, TRUTH, LOG = "estimate.csv", "truth.csv", "sensing.jsonl"
TABLES = {f"{name}.csv" for name in ("estimate", "structure", "contacts")}

COMMANDS = {
    "localize --out": (["localize", LOG, "--method", "hop-by-hop", "--out"], [LOG], ".csv"),
    "localize --report": (
        ["localize", LOG, "--method", "hop-by-hop", "--out", "new/e.csv", "--report"],
        [LOG],
        ".html",
    ),
    "view": (["view", LOG, ESTIMATE, "--truth", TRUTH, "--out"], [LOG, ESTIMATE, TRUTH], ".html"),
    "score": (["score", TRUTH, ESTIMATE, "--out"], [TRUTH, ESTIMATE], ".png"),
    "track --out": (["track", LOG, *QUICK, "--out"], [LOG], ".jsonl"),
    "track --estimate": (["track", LOG, *QUICK, "--estimate"], [LOG], ".csv"),
}  # fmt: skip
"""By name: a command that lacks the name of a file to write, its inputs, and the file's suffix."""

FOLDERS = {
    "import": (["import", "poses.csv", "--dock-radius", "0.5", "--out"], {LOG, TRUTH}),
    "export csv": (["export", LOG, ESTIMATE, "--truth", TRUTH, "--format", "csv", "--out"], TABLES),
    "export ply": (["export", LOG, ESTIMATE, "--format", "ply", "--out"], {"case.ply"}),
    "export run": (["export", "run", "--format", "csv", "--out"], TABLES),
    "export png": (
        ["export", LOG, ESTIMATE, "--format", "png", "--out"],
        {"estimate.png", "contact-graph.png"},
    ),
    "compare": (
        ["compare", "run", "other", "--out"],
        {"comparison.csv", "paired.csv", "comparison.png", "cases.csv", "comparison.html"},
    ),
}  # fmt: skip
"""By name: a command that lacks the name of a folder, and files that it writes there."""


@pytest.fixture(scope="module")
def world(small_run, tmp_path_factory) -> Path:
    """Folder of a user: inputs, runs, and files of their own under names that commands write."""
    world = tmp_path_factory.mktemp("world")
    case = small_run / "cases" / "0-baseline"
    for name in (LOG, ESTIMATE, TRUTH):
        shutil.copy(case / name, world)
    shutil.copy(REPOSITORY / "scenarios" / "examples" / "foreign-poses.csv", world / "poses.csv")
    for name in ("run", "other"):
        shutil.copytree(small_run, world / name)
    for name in ("figures/mine.pdf", "renders/mine.txt", "cases/0-baseline/plot.png", "notes.txt"):
        (world / "run" / name).write_bytes(b"mine")
    mine = {f"mine{suffix}" for _, _, suffix in COMMANDS.values()} | {"view.html"}
    mine |= {f"folder/{name}" for _, names in FOLDERS.values() for name in names}
    mine |= {"folder/folder/mine.csv"}
    for name in mine:
        (world / name).parent.mkdir(parents=True, exist_ok=True)
        (world / name).write_bytes(f"{name} is mine\n".encode())
    shutil.copy(case / ESTIMATE, world / "like-ours.csv")
    (world / "new").mkdir()
    return world


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """Folder of a run."""
    out = tmp_path_factory.mktemp("made")
    assert call_here("run", "tower", *RUN, "--out", out).returncode == 0
    return next(out.glob("tower-*"))


def _linked(random, here: Path, target: str, link) -> str:
    """Link a new name to a file or folder."""
    name = f"link{random.randrange(10**6)}{Path(target).suffix}"
    link(here / name, target)
    return name


def _file(random, here: Path, inputs: list[str], suffix: str) -> str:
    """Name an output that is something else."""
    given = random.choice(inputs)
    mine = random.choice([f"mine{suffix}", "like-ours.csv", "view.html"])
    kinds = [
        lambda: given,
        lambda: f"folder/../{given}",
        lambda: str(here / given),
        lambda: _linked(random, here, given, Path.symlink_to),
        lambda: _linked(random, here, given, lambda name, to: name.hardlink_to(here / to)),
        lambda: f"{_linked(random, here, '.', Path.symlink_to)}/{given}",
        lambda: mine,
        lambda: _linked(random, here, mine, Path.symlink_to),
        lambda: _linked(random, here, "nowhere", Path.symlink_to),
        lambda: "folder",
        lambda: "run/table.csv",
        lambda: "run/cases/0-baseline/robots.csv",
        lambda: f"new/fifo{suffix}",
        lambda: random.choice(["/dev/full", "/dev/null", "/dev/zero"]),
        lambda: f"{given}/below{suffix}",
        lambda: f"no/folder{suffix}",
        lambda: f"new/{random.randrange(10**6)}{suffix}",
    ]  # fmt: skip
    return random.choice(kinds)()


def _folder(random, here: Path) -> str:
    """Name a folder for outputs that has files of somebody else, or is none."""
    kinds = [
        lambda: ".", lambda: "folder", lambda: str(here / "folder"), lambda: "run/cases/0-baseline",
        lambda: _linked(random, here, "folder", Path.symlink_to), lambda: LOG, lambda: "poses.csv",
        lambda: "/dev/full", lambda: "mine.csv/below", lambda: f"new/{random.randrange(10**6)}",
    ]  # fmt: skip
    return random.choice(kinds)()


def _contents(here: Path) -> dict[Path, object]:
    """Read what is in a folder: bytes of files, ends of links."""
    found: dict[Path, object] = {}
    for path in here.rglob("*"):
        if path.is_symlink():
            found[path] = path.readlink()
        elif path.is_file():
            found[path] = path.read_bytes()
        elif not path.is_dir():
            found[path] = "special"
    return found


def _check(before: dict[Path, object], here: Path, done, allowed: set[Path]) -> None:
    """Refuse a lost or changed file that was not to be replaced, and errors of many lines."""
    assert done.returncode in {0, 1, 2, 4}, done.stderr
    if done.returncode in {1, 2}:
        assert done.stderr.splitlines()[-1].startswith("tiswarm: error: "), done.stderr
        assert "Traceback" not in done.stderr
        allowed = set()
    after = _contents(here)
    changed = {path for path, content in before.items() if after.get(path, None) != content}
    assert changed <= allowed, (done.args, done.returncode, changed, done.stderr)
    assert not [*here.rglob(".*.tmp")]


@pytest.mark.usefixtures("coarse_pictures")
def test_no_output_costs_a_file_of_somebody_else(trial, world, tmp_path):
    """Inputs, links, devices and files of the user, as outputs of every command that writes."""
    for number in trial.numbers(200):
        random, here = trial.random(number), tmp_path / "here"
        shutil.copytree(world, here, symlinks=True)
        os.mkfifo(here / "new" / "fifo.csv")
        name = random.choice([*COMMANDS, *FOLDERS])
        force = random.random() < 0.3
        if name in COMMANDS:
            command, inputs, suffix = COMMANDS[name]
            out = _file(random, here, inputs, suffix)
            allowed = {here / out}
        else:
            command, names = FOLDERS[name]
            out = _folder(random, here)
            inputs = [each for each in (LOG, ESTIMATE, TRUTH, "poses.csv") if each in command]
            allowed = {(here / out).resolve() / each for each in names}
        allowed -= {here / each for each in inputs}
        if "run" in command:
            allowed -= {path for path in allowed if (here / "run" / "cases") in path.parents}
        before = _contents(here)
        with trial.attempt(number, what=f"{name} to {out}, {force=}"):
            done = call_here(*command, out, *["--overwrite"] * force, cwd=here)
            _check(before, here, done, allowed if force else set())
            if done.returncode == 0:
                written = _contents(here)
                again = call_here(*command, out, cwd=here)
                assert again.returncode == 2, again.stderr
                assert _contents(here) == written
            trial.outcomes["refused" if done.returncode in {1, 2} else "written"] += 1
        shutil.rmtree(here)

    assert trial.failures == []


@pytest.mark.usefixtures("coarse_pictures")
def test_a_run_changes_its_own_files_alone(trial, world, made, tmp_path):
    """A folder of its name that no run made is refused; in its own one, files of others stay."""
    for number in trial.numbers(20):
        random, here = trial.random(number), tmp_path / "here"
        shutil.copytree(world, here)
        mine = [path for path, content in _contents(here).items() if content == b"mine"]
        kind = random.choice(["redraw", "run", "foreign"])
        command = [kind, "run"] if kind == "redraw" else ["run", "tower", *RUN]
        command += ["--out", "runs"] * (kind in {"run", "foreign"})
        if kind == "foreign":
            folder = here / "runs" / made.name
            for name in random.sample(["scenario.yaml", "table.csv", "cases/0-a/case.json"], 2):
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(b"mine")
        before = _contents(here)
        with trial.attempt(number, what=kind):
            done = call_here(*command, cwd=here)
            own = {path for path in before if here / "run" in path.parents} - {*mine}
            assert (done.returncode == 2) == (kind == "foreign"), done.stderr
            _check(before, here, done, own)
            trial.outcomes[kind] += 1
        shutil.rmtree(here)

    assert trial.failures == []


def _stream(random, raw: bytes) -> bytes:
    """Damage the lines of a log, or end them anywhere."""
    place = random.randrange(len(raw))
    return random.choice([
        damaged(random, raw), damaged(random, raw), b"", raw[:place], raw[place:], b"\n" + raw,
        raw.rstrip(b"\n"), b"\xef\xbb\xbf" + raw.replace(b"\n", b"\r\n"), raw + b"\0" * 10**6,
    ])  # fmt: skip


def test_streams_end_anywhere(trial, world, tmp_path):
    """Each line of damaged input has an answer, in its order, or the command ends in one line."""
    raw = (world / LOG).read_bytes()
    for number in trial.numbers(80):
        random, here = trial.random(number), tmp_path / "here"
        here.mkdir()
        for name in ("mine.jsonl", "like-ours.csv"):
            shutil.copy(world / name, here)
        data = _stream(random, raw)
        out = random.choice(["", "", "new.jsonl", "mine.jsonl", "like-ours.csv", "/dev/full"])
        before = _contents(here)
        stdin = io.TextIOWrapper(io.BytesIO(data))
        with trial.attempt(number, what=f"{len(data)} bytes to {out!r}"), patch("sys.stdin", stdin):
            options = ["--out", out] if out else []
            done = call_here("track", "-", *QUICK, *options, cwd=here)
            _check(before, here, done, set())
            if done.returncode == 0:
                text = (here / out).read_text() if out else done.stdout
                answers = [json.loads(line)["line"] for line in text.splitlines()]
                lines = data.count(b"\n") + (data[-1:] != b"\n")
                assert answers == [*range(1, lines + 1)]
            trial.outcomes["answered" if done.returncode == 0 else "refused"] += 1
        shutil.rmtree(here)

    assert trial.failures == []


TRACK = f"{sys.executable} -m tiswarm track"


@pytest.mark.parametrize(
    ("command", "status", "said"),
    [
        ("track log.jsonl > /dev/full", 1, "No space left on device"),
        ("track log.jsonl --out /dev/full", 1, "/dev/full: this is no regular file"),
        ("track log.jsonl >> log.jsonl", 2, "the output is the input"),
        ("track - < log.jsonl >> log.jsonl", 2, "the output is the input"),
        ("track - < log.jsonl 1<> log.jsonl", 2, "the output is the input"),
        ("track - <&-", 2, "standard input is closed"),
        ("head -c 300M /dev/zero | track -", 2, "-:1: the line is longer than 64 MiB"),
        ("(head -1 log.jsonl; cat /dev/zero) | track -", 2, "-:2: the line is longer than 64 M"),
    ],
)
def test_shells_cannot_damage_a_log(world, tmp_path, command, status, said):
    """Redirections are outputs and inputs, too; memory is bounded."""
    log = Path(shutil.copy(world / LOG, tmp_path / "log.jsonl"))
    before = log.read_bytes()

    done = subprocess.run(
        ["bash", "-c", f"ulimit -v 6000000; {command.replace('track', TRACK)}"],  # noqa: S607
        cwd=tmp_path, env=environment(), capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip

    assert done.returncode == status, done.stderr
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert log.read_bytes() == before


def test_two_commands_never_mix_their_answers(world, tmp_path):
    """Both write whole files: the output is of the one that ends last; kills leave no part.

    Without `--overwrite` it is of the one that ends first, and the other is refused.
    """
    out = tmp_path / "changes.jsonl"
    command = [sys.executable, "-m", "tiswarm", "track", world / LOG, "--out", out, *QUICK]

    def start(steps, *more):
        chosen = ["--set", f"steps={steps}", *more]
        return subprocess.Popen([*command, *chosen], env=environment(), stderr=subprocess.DEVNULL)

    whole = set()
    for steps in (5, 9):
        assert start(steps, "--overwrite").wait() == 0
        whole.add(out.read_bytes())
    for kill in range(6):
        both = [start(5, "--overwrite"), start(9, "--overwrite")]
        time.sleep(0.7 * kill)
        both[kill % 2].kill()
        assert [each.wait() for each in both].count(0) >= 1
        assert out.read_bytes() in whole
    out.unlink()
    both = [start(5), start(9)]
    assert sorted(process.wait() for process in both) == [0, 2]
    assert out.read_bytes() in whole
