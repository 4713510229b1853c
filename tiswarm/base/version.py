"""The version of the package, and digests of the code that computes results."""

import re
from collections.abc import Collection, Iterable, Mapping
from hashlib import sha256
from pathlib import Path

__version__ = "0.2.0"

_NAME = __name__.partition(".")[0]
_IMPORT = re.compile(
    rf"^[ \t]*(?:from ({_NAME}[\w.]*) import (\([^)]*\)|.*)|import ({_NAME}[\w.]*))", re.MULTILINE
)
_FOUND = re.compile(r'\bfind\("(\w+)", (?:"([^"]+)"\))?')
"""A kind, and a name if it is constant, of what is imported by the table of `base.parts`."""

_NAMED = re.compile(rf'"({_NAME}(?:\.\w+)+)(?::\w+)?"')
"""A module as settings of a method name it."""

_TYPES = re.compile(r"^if TYPE_CHECKING:\n(?:[ \t].*\n|\n)+", re.MULTILINE)
"""Imports that no running code needs."""


def code_digest(
    modules: Iterable[str],
    apart: Mapping[str, Collection[str]] | None = None,
    package: Path = Path(__file__).parents[1],
) -> str:
    """Return twelve hex digits of the source of modules and of all that they import.

    Results of code with another digest may differ. The way line ends are written does not count,
    and neither does a package if an import only names a module in it.

    Args:
        modules: Names of modules.
        apart: Imports that do not count, by importing module: a registry imports all methods, and
            a result needs one.
        package: Folder of the package.
    """
    found: dict[str, Path] = {}
    waiting = sorted(modules)
    while waiting:
        name = waiting.pop()
        file = _file(name, package)
        if name not in found and file is not None:
            found[name] = file
            waiting += _imports(file, package) - {*(apart or {}).get(name, ())}
    total = sha256()
    for name, file in sorted(found.items()):
        text = file.read_bytes().replace(b"\r\n", b"\n")
        total.update(f"{name} {len(text)}\n".encode() + text)
    return total.hexdigest()[:12]


def _imports(file: Path, package: Path) -> frozenset[str]:
    """List the modules of the package that a file imports, within functions too, or registers."""
    from tiswarm.base.parts import PARTS  # noqa: PLC0415 - slow, and `tiswarm` imports this module

    text = file.read_text(encoding="utf-8")
    names = {
        place.partition(":")[0]
        for kind, name in _FOUND.findall(text)
        for part, place in PARTS[kind].items()
        if name in {"", part}
    }
    if file != package / "base" / "parts.py":  # the table itself
        names |= {*_NAMED.findall(text)}
    for origin, parts, module in _IMPORT.findall(_TYPES.sub("", text)):
        names |= {module or origin, *(f"{origin}.{part}" for part in re.findall(r"\w+", parts))}
    return frozenset(name for name in names - {_NAME} if _file(name, package) is not None)


def _file(name: str, package: Path) -> Path | None:
    """Find the source of a module or package by its name; None if it is another name."""
    place = package.joinpath(*name.split(".")[1:])
    files = (place.with_suffix(".py"), place / "__init__.py")
    return next((file for file in files if file.is_file()), None)
