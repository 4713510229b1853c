"""No command replaces an input or a file of somebody else; each replaces its own output."""

import shutil

import pytest

from tests.runs import REPOSITORY

LOG, ESTIMATE, TRUTH = "sensing.jsonl", "estimate.csv", "truth.csv"
EXPORT = ["export", LOG, ESTIMATE, "--truth", TRUTH, "--format", "csv", "--out", "."]
IMPORT = ["import", "poses.csv", "--dock-radius", "0.5", "--out", "."]


@pytest.fixture(scope="module")
def given(small_run, tmp_path_factory):
    """Folder of a user with a log, a table of each kind, and poses."""
    folder = tmp_path_factory.mktemp("given")
    for name in (LOG, ESTIMATE, TRUTH):
        shutil.copy(small_run / "cases" / "0-baseline" / name, folder)
    shutil.copy(REPOSITORY / "scenarios" / "examples" / "foreign-poses.csv", folder / "poses.csv")
    with (folder / LOG).open() as file:
        (folder / "header.jsonl").write_text(file.readline())
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
        (["localize", LOG, "--out", TRUTH], f"{TRUTH}: --out: no tiswarm command wrote this file"),
        (["localize", LOG], f"{ESTIMATE}: --out: no tiswarm command wrote this file"),
        (["localize", LOG, "--out", "a", "--report", "a"], "a: --report: out names the same file"),
        (["track", LOG, "--out", LOG], f"{LOG}: --out: this is an input"),
        (["track", LOG, "--out", "poses.csv"], "poses.csv: --out: no tiswarm command wrote"),
        (["track", "header.jsonl", "--out", "a", "--estimate", "b"], "no robot has joined"),
        (["view", LOG, ESTIMATE, "--out", ESTIMATE], f"{ESTIMATE}: --out: this is an input"),
        (["score", TRUTH, ESTIMATE, "--out", TRUTH], f"{TRUTH}: --out: this is an input"),
        (EXPORT, f"{ESTIMATE}: --out: this is an input"),
        ([*EXPORT, "--overwrite"], f"{ESTIMATE}: --out: this is an input"),
        (IMPORT, f"{LOG}: --out: no tiswarm command wrote this file"),
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


def test_a_repeated_command_replaces_its_output_and_no_edit(tiswarm, given, tmp_path):
    """An edited output is somebody's; an option replaces it."""
    command, log = [*IMPORT[:-1], tmp_path], tmp_path / LOG

    statuses = [tiswarm(*command, cwd=given).returncode for _ in range(2)]
    whole = log.read_bytes()
    log.write_bytes(whole + b"a note of mine")
    statuses.append(tiswarm(*command, cwd=given).returncode)
    edited = log.read_bytes()
    statuses.append(tiswarm(*command, "--overwrite", cwd=given).returncode)

    assert statuses == [0, 0, 2, 0]
    assert edited == whole + b"a note of mine"
    assert log.read_bytes() == whole
