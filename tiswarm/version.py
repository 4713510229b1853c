"""The version of the package, and a digest of the code that computes results."""

from hashlib import sha256
from pathlib import Path

__version__ = "0.1.0"

COMPUTING = (
    "compute", "engine", "evaluation", "localization", "measurements", "params.py", "records",
    "robot.py", "sensing", "sensing.py", "world",
)  # fmt: skip
"""Modules and rooms of the package that decide what a case stores; those there are count."""


def code_digest(package: Path = Path(__file__).parent) -> str:
    """Return twelve hex digits of the source of all computing modules.

    Results of code with another digest may differ. The way line ends are written does not count.

    Args:
        package: Folder of the package.
    """
    found = sha256()
    files = [file for name in COMPUTING for file in _sources(package / name)]
    for file in sorted(files):
        text = file.read_bytes().replace(b"\r\n", b"\n")
        found.update(f"{file.relative_to(package).as_posix()} {len(text)}\n".encode() + text)
    return found.hexdigest()[:12]


def _sources(path: Path) -> list[Path]:
    return [path] if path.is_file() else [*path.rglob("*.py")]
