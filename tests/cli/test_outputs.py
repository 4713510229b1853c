"""No command replaces an input, or a file that exists unless `--overwrite` says so."""

import json
import shutil

import pytest

from tests.runs import REPOSITORY
from tiswarm.localization import methods

LOG, ESTIMATE, TRUTH = "sensing.jsonl", "estimate.csv", "truth.csv"
EXPORT = ["export", LOG, ESTIMATE, "--truth", TRUTH, "--format", "csv", "--out", "."]
IMPORT = ["import", "poses.csv", "--dock-radius", "0.5", "--out", "."]
STAYS = "exists already"


@pytest.fixture(scope="module")
def given(small_run, tmp_path_factory):
    """Folder of a user with a log, a table of each kind, and poses."""
    folder = tmp_path_factory.mktemp("given")
    for name in (LOG, ESTIMATE, TRUTH):
        shutil.copy(small_run / "cases" / "0-baseline" / name, folder)
    shutil.copy(REPOSITORY / "scenarios" / "examples" / "foreign-poses.csv", folder / "poses.csv")
    with (folder / LOG).open() as file:
        header = json.loads(file.readline())
    del header["lines"]  # as robots write it that have yet to join
    (folder / "header.jsonl").write_text(f"{json.dumps(header)}\n")
    (folder / "linked").symlink_to(".")
    return folder


@pytest.mark.parametrize(
    ("command", "problem"),
    [
        (["localize", LOG, "--out", LOG], f"{LOG}: --out: this is an input"),
        (
            ["localize", LOG, "--report", f"linked/{LOG}", "--out", "a"],
            "--report: this is an input",
        ),
        (["localize", LOG, "--out", TRUTH], f"{TRUTH}: {STAYS}; give --overwrite or another --out"),
        (["localize", LOG], f"{ESTIMATE}: {STAYS}; give --overwrite or another --out"),
        (["localize", LOG, "--out", "a", "--report", "a"], "a: --report: out names the same file"),
        (["track", LOG, "--out", LOG], f"{LOG}: --out: this is an input"),
        (["track", LOG, "--out", "poses.csv"], f"poses.csv: {STAYS}; give --overwrite"),
        (
            ["localize", LOG, "--report", "poses.csv"],
            f"{ESTIMATE}: {STAYS}, as does poses.csv; give --overwrite or another --out and an",
        ),
        (["track", LOG, "--estimate", TRUTH], f"{TRUTH}: {STAYS}; give --overwrite or another --e"),
        (["track", "header.jsonl", "--out", "a", "--estimate", "b"], "no robot has joined"),
        (["view", LOG, ESTIMATE, "--out", ESTIMATE], f"{ESTIMATE}: --out: this is an input"),
        (["score", TRUTH, ESTIMATE, "--out", TRUTH], f"{TRUTH}: --out: this is an input"),
        (EXPORT, f"{ESTIMATE}: --out: this is an input"),
        ([*EXPORT, "--overwrite"], f"{ESTIMATE}: --out: this is an input"),
        (IMPORT, f"{LOG}: {STAYS}, as does {TRUTH}; give --overwrite or another --out"),
        (
            [*IMPORT[:-1], "new", "--report", "poses.csv"],
            f"poses.csv: {STAYS}; give --overwrite or another --report",
        ),
        (["export", LOG, ESTIMATE, "--out", LOG], "case.glb: --out: its folder is a file"),
        (["run", "tower", "--out", LOG], "cases: cannot be made: Not a directory; choose another"),
    ],
    ids=lambda value: " ".join(value[:1] + value[-2:]) if isinstance(value, list) else "",
)
def test_an_output_that_would_cost_a_file_is_refused(tiswarm, given, command, problem):
    """The error names the file and the remedy; no byte of the folder differs."""
    before = {path: path.read_bytes() for path in given.iterdir() if path.is_file()}

    done = tiswarm(*command, cwd=given)

    (line,) = done.stderr.splitlines()
    assert problem in line
    assert done.returncode in {1, 2}
    assert {path: path.read_bytes() for path in given.iterdir() if path.is_file()} == before


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (["localize", LOG, "--method", "hop-by-hop", "--out", "new.csv"], "new.csv"),
        (
            ["localize", LOG, "--method", "hop-by-hop", "--out", "{0}.csv", "--report", "new.html"],
            "new.html",
        ),
        (["track", LOG, "--set", "chains=1", "--set", "steps=5", "--out", "a.jsonl"], "a.jsonl"),
        (["view", LOG, ESTIMATE, "--truth", TRUTH], "view.html"),
        (["score", TRUTH, ESTIMATE], "estimate-score.png"),
        (["score", TRUTH, ESTIMATE, "--out", "new.pdf"], "new.pdf"),
        ([*EXPORT[:-1], "csv"], "csv/contacts.csv"),
        (["export", LOG, ESTIMATE], "export/case.glb"),
        (["export", "run"], "run/export/case.glb"),
        ([*IMPORT[:-1], "imported"], "imported/truth.csv"),
        (["compare", "run", "other"], "reports/comparison/paired.csv"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_repeated_command_keeps_what_it_wrote(tiswarm, given, small_run, tmp_path, command, name):
    """A user may have edited the output; with `--overwrite` it is written again."""
    folder = tmp_path / "user"
    shutil.copytree(given, folder, symlinks=True)
    for run in {"run", "other"}.intersection(command):
        shutil.copytree(small_run, folder / run)

    def call(number: int, *more: str):
        return tiswarm(*[word.format(number) for word in command], *more, cwd=folder)

    first = call(1)
    output = folder / name
    whole = output.read_bytes()
    output.write_bytes(whole + b"a note of the user")
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    again = call(2)
    after = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    forced = call(2, "--overwrite")

    assert first.returncode == 0, first.stderr
    [line] = again.stderr.splitlines()
    assert STAYS in line
    assert "; give --overwrite or another --" in line
    assert again.returncode == 2
    assert after == before
    assert forced.returncode == 0, forced.stderr
    assert output.read_bytes() == whole


@pytest.mark.parametrize("command", [
    ["localize", LOG],
    ["export", LOG, "--format", "tum", "--out", "."],
    ["view", LOG, "--out", TRUTH],
])  # fmt: skip
def test_a_refused_command_does_not_localize(tiswarm, given, monkeypatch, command):
    """A user would wait long for nothing."""
    (given / "estimate.tum").touch()
    monkeypatch.setattr(methods, "localize", lambda *_, **__: pytest.fail("it is localized"))

    done = tiswarm(*command, cwd=given)

    assert done.returncode == 2
    assert STAYS in done.stderr
