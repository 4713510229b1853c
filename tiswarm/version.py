"""The version of the package, and a digest of the code that computes results."""

from hashlib import sha256
from pathlib import Path

__version__ = "0.1.0"

_COMPUTING = (
    "compute", "engine", "evaluation", "localization", "measurements", "params.py", "records",
    "robot.py", "sensing", "world",
)  # fmt: skip
"""Modules and rooms of the package that decide what a case stores."""


def code_digest(package: Path = Path(__file__).parent) -> str:
    """Return twelve hex digits of the source of all computing modules of a package folder.

    Results of code with another digest may differ. The way line ends are written does not count.
    """
    found = sha256()
    for file in sorted(package.rglob("*.py")):
        name = file.relative_to(package)
        if name.parts[0] in _COMPUTING:
            text = file.read_bytes().replace(b"\r\n", b"\n")
            found.update(f"{name.as_posix()} {len(text)}\n".encode() + text)
    return found.hexdigest()[:12]
