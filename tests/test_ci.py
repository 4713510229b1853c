"""`.ci/run` runs both parts of the tests and adds up what they say."""

import re
import shutil
import subprocess

import pytest

from tests.runs import REPOSITORY

PASSED = "===== 3000 passed, 12 skipped, 1 warning in 310.50s (0:05:10) ====="
FAILED = "=== 1 failed, 2999 passed, 1 error in 310.50s (0:05:10) ==="
LESS = "= 500 passed, 1 skipped in 9.25s ="
NOTHING = "ruff: no such rule"


@pytest.mark.parametrize(
    ("test", "trial", "status", "closing"),
    [
        ((PASSED, 0), (LESS, 0), 0, "3500 passed, 13 skipped, 1 warning in 319.75s (0:05:19)"),
        ((FAILED, 1), (LESS, 0), 2, "1 failed, 3499 passed, 1 skipped, 1 error in 319.75s"),
        ((LESS, 0), (FAILED, 1), 2, "1 failed, 3499 passed, 1 skipped, 1 error in 319.75s"),
        ((NOTHING, 1), (LESS, 0), 2, "500 passed, 1 skipped, 1 error in 9.25s"),
        ((LESS, 0), ("= no tests ran in 0.02s =", 5), 2, "500 passed, 1 skipped, 1 error in 9.27s"),
        ((NOTHING, 1), (NOTHING, 1), 2, "0 passed, 2 errors in 0.00s"),
    ],
    ids=["both pass", "test fails", "trial fails", "lint fails", "nothing ran", "neither ran"],
)
def test_one_closing_line_sums_both_parts(tmp_path, test, trial, status, closing):
    """A reader of the last line and the exit status alone misses no failure.

    Both parts run in any case, and make's own exit status for a failure is 2.
    """
    (tmp_path / ".ci").mkdir()
    shutil.copy(REPOSITORY / ".ci" / "run", tmp_path / ".ci")
    (tmp_path / "Makefile").write_text(
        "".join(
            f"{part}:\n\t@echo '{line}'; exit {code}\n"
            for part, (line, code) in {"test": test, "trial": trial}.items()
        )
    )

    done = subprocess.run(
        ["/bin/sh", tmp_path / ".ci" / "run"],
        cwd=tmp_path.parent, capture_output=True, text=True, check=False,
    )  # fmt: skip

    assert done.returncode == status
    assert [line for line in done.stdout.splitlines() if line in {test[0], trial[0]}] == [
        test[0],
        trial[0],
    ]
    assert re.fullmatch(rf"=+ {re.escape(closing)}.* =+", done.stdout.splitlines()[-1])
