"""Digest of the computing code: it changes with that code and with nothing else."""

import shutil
from pathlib import Path

import pytest

from tiswarm.version import code_digest

PACKAGE = Path(__file__).parents[1] / "tiswarm"


@pytest.fixture
def copy(tmp_path) -> Path:
    """Copy of the package."""
    return Path(shutil.copytree(PACKAGE, tmp_path / "tiswarm"))


@pytest.mark.parametrize("name", ["world/growth.py", "robot.py", "evaluation/metrics.py"])
def test_any_byte_of_computing_code_moves_the_digest(copy, name):
    """A changed letter, a renamed file and a removed file change the digest."""
    digests = {code_digest(copy)}
    path = copy / name
    path.write_bytes(path.read_bytes().replace(b"e", b"a", 1))
    digests.add(code_digest(copy))
    path.rename(path.with_stem("renamed"))
    digests.add(code_digest(copy))
    path.with_stem("renamed").unlink()
    digests.add(code_digest(copy))

    assert len(digests) == (4 if "/" in name else 3)


def test_code_that_computes_nothing_leaves_the_digest(copy):
    """Changes of the report, of line ends, of caches and of the folder leave the digest."""
    (copy / "report" / "page.py").write_text("")
    path = copy / "world" / "growth.py"
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    (copy / "world" / "__pycache__").mkdir(exist_ok=True)
    (copy / "world" / "__pycache__" / "growth.pyc").write_text("cache")

    assert code_digest(copy) == code_digest(PACKAGE)
