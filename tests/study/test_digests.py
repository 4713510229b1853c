"""Digests of the computing code: they change with the code of a case and with nothing else."""

import shutil
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from tiswarm.base.parts import PARTS
from tiswarm.study import provenance
from tiswarm.study.provenance import (
    all_code,
    case_code,
    code_digest,
    growth_code,
    method_code,
)

PACKAGE = Path(__file__).parents[2] / "tiswarm"
METHODS = tuple(PARTS["method"])
trial = partial(pytest.param, marks=pytest.mark.trial)


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    """Copy of the package; a test that changes it undoes that."""
    ignored = shutil.ignore_patterns("__pycache__")
    return Path(
        shutil.copytree(PACKAGE, tmp_path_factory.mktemp("copy") / "tiswarm", ignore=ignored)
    )


@pytest.fixture(scope="module")
def before(package) -> dict[str, str]:
    """Digests of the copy before an edit."""
    with pytest.MonkeyPatch.context() as patch:
        _use(package, patch)
        return digests()


@pytest.fixture
def copy(package, before, monkeypatch) -> Path:
    """Copy of the package, whose digests `case_code` and the like return."""
    _use(package, monkeypatch)
    return package


def _use(package, patch):
    """Let digests be those of a copy of the package."""

    def of_copy(modules, apart=None):
        return code_digest(modules, apart, package)

    patch.setattr(provenance, "code_digest", of_copy)


def digests():
    """Digest of the cases of each method, of structures and of all code, by name."""
    method_code.cache_clear()
    found = {name: case_code(name) for name in METHODS}
    return found | {"structures": growth_code.__wrapped__(), "all": all_code.__wrapped__()}


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
    ("name", "changed"),
    [
        ("world/growth.py", {*METHODS, "structures", "all"}),
        trial("base/robot.py", {*METHODS, "structures", "all"}),
        trial("evaluation/metrics.py", {*METHODS, "all"}),
        ("sensing/observation.py", {*METHODS, "all"}),
        trial("study/runner.py", {*METHODS, "all"}),
        ("scenario/validation.py", {*METHODS, "all"}),
        trial("localization/methods.py", {*METHODS, "all"}),
        ("localization/mixture/ends.py", {*METHODS, "all"}),
        ("localization/joint.py", {"joint", "online", "all"}),
        ("parts/peers/hop_by_hop.py", {"hop-by-hop", "least-squares", "all"}),
        ("localization/virtual_force/method.py", {"virtual-force", "distributed", "all"}),
        ("parts/online/layers.py", {"online", "distributed", "all"}),
        ("parts/between/wire.py", {"distributed", "all"}),
        trial("parts/suites/senses.py", {*METHODS, "all"}),
        ("parts/peers/least_squares.py", {"least-squares", "all"}),
        ("report/page.py", set()),
        trial("study/executors.py", set()),
        trial("cli/run.py", set()),
    ],
)
def test_an_edit_changes_the_digests_of_the_cases_that_use_it(copy, before, name, changed):
    """Cases of another method stay current: nobody computes them again for nothing."""
    with _edited(copy / name):
        after = digests()

    assert {key for key in before if before[key] != after[key]} == changed


def test_any_byte_of_computing_code_moves_the_digest(copy, before):
    """A changed letter and a missing file change the digest."""
    found = {before["joint"]}
    path = copy / "evaluation" / "metrics.py"
    with _edited(path):
        found.add(digests()["joint"])
    renamed = path.rename(path.with_stem("renamed"))
    found.add(digests()["joint"])
    renamed.rename(path)

    assert len(found) == 3


def test_code_that_computes_nothing_leaves_the_digest(copy):
    """Line ends, caches and the folder leave the digest."""
    (copy / "world" / "__pycache__").mkdir(exist_ok=True)
    (copy / "world" / "__pycache__" / "growth.pyc").write_text("cache")
    with _edited(copy / "world" / "growth.py", b"\n", b"\r\n", count=-1):
        found = digests()

    assert found == {name: case_code(name) for name in METHODS} | {
        "structures": growth_code(),
        "all": all_code(),
    }


def test_an_unknown_method_has_no_digest():
    """A record may state any word; none of them makes its case current."""
    assert case_code("no such method") == ""
