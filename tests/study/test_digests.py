"""The digest of the computing code changes with code that computes results, and nothing else."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tiswarm.study import provenance
from tiswarm.study.provenance import case_code, package_code, structure_code

PACKAGE = Path(__file__).parents[2] / "tiswarm"


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    """Copy of the package; a test that changes it undoes that."""
    ignored = shutil.ignore_patterns("__pycache__")
    return Path(
        shutil.copytree(PACKAGE, tmp_path_factory.mktemp("copy") / "tiswarm", ignore=ignored)
    )


@pytest.fixture
def copy(package, monkeypatch) -> Iterator[Path]:
    """Copy of the package, which digests are computed of."""
    monkeypatch.setattr(provenance, "__file__", str(package / "study" / "provenance.py"))
    yield package
    package_code.cache_clear()  # it may have been asked for first here


def digest() -> str:
    """Digest of the code as it is now."""
    return package_code.__wrapped__()


@contextmanager
def _edited(path, old=b"e", new=b"a", *, count=1):
    """Replace bytes of a file within; afterwards it is as before."""
    text = path.read_bytes()
    assert old in text
    path.write_bytes(text.replace(old, new, count))
    try:
        yield
    finally:
        path.write_bytes(text)


@pytest.mark.parametrize(
    "name",
    [
        "base/robot.py",
        "engine/kernels.py",
        "evaluation/metrics.py",
        "localization/distributed/wire.py",
        "localization/joint.py",
        "measurements/flips.py",
        "records/sensing_file.py",
        "scenario/validation.py",
        "sensing/ranges.py",
        "study/runner.py",
        "world/rules.py",
    ],
)
def test_an_edit_of_computing_code_changes_the_digest(copy, name):
    """Cases are computed again after any change that may change them."""
    before = digest()

    with _edited(copy / name):
        after = digest()

    assert before != after


@pytest.mark.parametrize(
    "name", ["report/page.py", "cli/run.py", "app/logs.py", "formats/poses.py"]
)
def test_an_edit_of_what_shows_results_leaves_the_digest(copy, name):
    """Nobody computes a study again because a page changed."""
    before = digest()

    with _edited(copy / name):
        after = digest()

    assert before == after


def test_a_renamed_file_changes_the_digest(copy):
    """A missing file and one of another name are other code."""
    path = copy / "evaluation" / "metrics.py"
    before = digest()

    renamed = path.rename(path.with_stem("renamed"))
    after = digest()
    renamed.rename(path)

    assert before != after


def test_line_ends_and_caches_leave_the_digest(copy, monkeypatch):
    """So does the folder of the package."""
    before = digest()

    (copy / "world" / "__pycache__").mkdir(exist_ok=True)
    (copy / "world" / "__pycache__" / "growth.pyc").write_text("cache")
    with _edited(copy / "world" / "growth.py", b"\n", b"\r\n", count=-1):
        after = digest()

    monkeypatch.undo()
    assert before == after == digest()


def test_cases_and_structures_state_the_digest():
    """A record may state any word as its method; none of them makes its case current."""
    assert case_code("joint") == structure_code("tower", "reactive-build") == package_code()
    assert case_code("no such method") == ""
