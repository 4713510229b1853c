"""A newcomer types the commands of README.md and docs/start.md, in a fresh clone."""

import os
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
BLOCK = re.compile(r"^```(sh|python|yaml)\n(.*?)^```", re.MULTILINE | re.DOTALL)
NOT_TYPED = {"make test": "runs this test", "pip install .": "tests of packages install wheels"}
SHELL = """set -eE -o pipefail
trap 'echo "failed: $BASH_COMMAND" >&2' ERR
"""
INTERRUPTED = "timeout --signal INT 10 {} || test $? = 124  # Ctrl-C"
"""A server ends when its user interrupts it."""


def _git(clone, *arguments):
    return subprocess.run(
        ["git", *arguments],  # noqa: S607
        cwd=clone,
        check=True,
        capture_output=True,
        text=True,
    ).stdout


@pytest.fixture
def clone(tmp_path_factory):
    """The files of this repository as they are now, in a folder of each page, and an empty home.

    The environment has no package of its own: `make run` installs tiswarm there, and finds all
    others in the environment of this test, so that it downloads nothing.
    """
    place = tmp_path_factory.mktemp("fresh")
    (place / "home").mkdir()
    folder = place / "tiswarm"
    for name in _git(REPOSITORY, "ls-files", "-z", "-co", "--exclude-standard").split("\0"):
        if name and os.path.lexists(REPOSITORY / name):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(REPOSITORY / name, folder / name, follow_symlinks=False)
    _git(folder, "init", "--quiet")
    _git(folder, "add", "--all")
    venv.create(folder / ".venv", with_pip=False)
    [packages] = (folder / ".venv").glob("lib/python*/site-packages")
    (packages / "others.pth").write_text("".join(f"{path}\n" for path in sys.path if path))
    return folder


def _typed(page):
    """Return a shell's input: all blocks of a page, those of its section Start first."""
    text = (REPOSITORY / page).read_text()
    before, start, after = text.partition("\n## Start\n")
    for lang, block in BLOCK.findall(after + before if start else before):
        if lang == "python":
            # From beside the clone, whose name is that of the package.
            yield f"(cd .. && python - <<'END'\n{block}END\n)\n"
            continue
        if lang == "yaml":  # a scenario of the reader, in a file of its name
            name = block.partition("\n")[0].removeprefix("name: ")
            yield f"cat > {name}.yaml <<'END'\n{block}END\n"
            continue
        for line in block.splitlines():
            command = line.partition(" #")[0].strip()
            if command.startswith("tiswarm view --live"):
                yield INTERRUPTED.format(command)
            elif command not in NOT_TYPED:
                yield line


@pytest.mark.trial
@pytest.mark.parametrize("page", ["README.md", "docs/start.md"])
def test_commands_run_from_top_to_bottom(clone, page):
    """Six of eight commands once named files that a fresh clone lacks.

    The shell finds no tiswarm until the page says how. Git knows or ignores all files made.
    """
    env = {
        "HOME": str(clone.parent / "home"), "PATH": os.defpath, "PIP_NO_INDEX": "1",
        "MAKEFLAGS": "SYSTEM_LIBRARIES=no", "TERM": "dumb",
    }  # fmt: skip
    typed = [*_typed(page)]

    done = subprocess.run(
        ["bash"],  # noqa: S607
        input=SHELL + "\n".join(typed), cwd=clone, env=env, check=False,
        capture_output=True, text=True, timeout=1800,
    )  # fmt: skip

    assert done.returncode == 0, done.stderr[-2000:]
    assert "failed:" not in done.stderr
    assert len(typed) > 10
    assert "open reports/tower-70e9f7c1/report.html" in done.stdout
    assert (clone / "reports" / "tower-70e9f7c1" / "report.html").is_file()
    assert _git(clone, "ls-files", "--others", "--modified", "--exclude-standard") == ""
