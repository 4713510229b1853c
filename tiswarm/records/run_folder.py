"""What all rooms know of the folder of a run: its folders and its manifest."""

import json
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, field
from hashlib import sha256
from pathlib import Path

from pydantic import ConfigDict, TypeAdapter
from pydantic.dataclasses import dataclass

from tiswarm.base.errors import InputError
from tiswarm.records.io import read_json, write_json

LABEL = "label"
"""Key of a condition, or of a row of a sweep: what pages and figures call it."""

NO_METHOD = "none"
"""Method of cases whose robots are not localized."""

ENGINE_METHOD = "relax"
"""Method of cases that are runs of the engine."""

_FOLDERS = ("cases", "structures", "figures", "renders", "export")
_MANIFEST = "manifest.json"

FORMAT = "tiswarm-run 1"
"""First entry of a manifest, by which the folder of a run is known."""


_TOLERANT = ConfigDict(strict=True, allow_inf_nan=False)  # of entries of other versions

_Facts = Mapping[str, str | int | None]

TABLE_NOTES = ("measurements", "kind", "method")
"""Columns of text that `table.csv` has after its first numbers."""

MAX_VARIANT_NAME = 150
"""Most characters of the name of a case, without its seed."""


@dataclass(frozen=True, kw_only=True, config=_TOLERANT)
class Spent:
    """Time of all cases in a stage [s]."""

    wall_s: float
    cpu_s: float


@dataclass(frozen=True, kw_only=True, config=_TOLERANT)
class Origin:
    """Renderer of a picture, and why a better one failed."""

    renderer: str
    reason: str


@dataclass(frozen=True, kw_only=True, config=_TOLERANT)
class Manifest:
    """Content of `manifest.json`: what differs between machines, and what was drawn."""

    tiswarm: str = ""  # version of the package; empty until the run is complete
    code: str = ""  # digest of the code that computed the cases
    backend: _Facts = field(default_factory=dict)  # device of parallel stages
    devices: Mapping[str, str] = field(default_factory=dict)  # device and precision, by stage
    force_error: float = 0.0  # largest error of a force by rounding, relative to the largest force
    machine: _Facts = field(default_factory=dict)
    numerics: tuple[Mapping[str, str], ...] = ()  # what rounded numbers; one if machines agree
    python: str = ""
    libraries: Mapping[str, str] = field(default_factory=dict)  # versions
    stages: Mapping[str, Spent] = field(default_factory=dict)
    peak_memory_MB: int | None = None  # noqa: N815 - a key of the file
    cases: int = 0
    renders: Mapping[str, Origin] = field(default_factory=dict)  # by file name
    drawn: Mapping[str, str] = field(default_factory=dict)  # SHA-256 by path within the folder
    outdated: Mapping[str, str] = field(default_factory=dict)  # the same of earlier drawings

    @property
    def ever_drawn(self) -> dict[str, str]:
        """SHA-256 of all drawings by path within the folder, also of earlier ones."""
        return {**self.outdated, **self.drawn}


_KIND = TypeAdapter(Manifest)
_ANY = TypeAdapter(dict[str, object])


def read_manifest(run: Path) -> Manifest:
    """Read the manifest of a run; an empty one where it is missing.

    Raises:
        InputError: it is damaged.
    """
    path = run / _MANIFEST
    if not os.path.lexists(path):
        return Manifest()
    manifest = read_json(path, _KIND)
    if manifest is None:
        raise InputError("is damaged; run the scenario again to restore it", path=path)
    return manifest


def write_manifest(run: Path, manifest: Manifest) -> None:
    """Write the manifest of a run."""
    write_json(run / _MANIFEST, {"format": FORMAT, **asdict(manifest)})


def is_run(folder: Path) -> bool:
    """Whether a run made a folder, as its manifest states."""
    content = read_json(folder / _MANIFEST, _ANY)
    return content is not None and content.get("format") == FORMAT


def check_folders(run: Path) -> None:
    """Refuse a run whose folders are links or files, since links may lead anywhere.

    Raises:
        InputError: with the place to remove.
    """
    for place in (run / name for name in _FOLDERS):
        if place.is_symlink() or (place.exists() and not place.is_dir()):
            problem = "is a link or a file in place of a folder; remove it"
            raise InputError(problem, path=place)


def case_folder(run: Path, name: str) -> Path:
    """Return the folder of a case.

    Raises:
        InputError: it is a link, or the name cannot be that of a folder there.
    """
    cases = run / "cases"
    folder = cases / name
    is_within = name != ".." and name.isprintable() and folder.parent == cases
    if not is_within or folder.is_symlink():
        problem = f"case {name!r} has no folder in the run; run the scenario again to restore it"
        raise InputError(problem, path=run)
    return folder


def cell_of(value: object) -> str:
    """Write a swept value as tables have it: as YAML does, such as `{kind: tower}` or `true`."""
    return json.dumps(value).replace('"', "")


def variant_name(point: Mapping[str, object], condition: str) -> str:
    """Name a point of the sweep under a condition; any file system accepts its characters."""
    names = []
    for key, value in point.items():
        text = value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))
        text = re.sub(r"[^A-Za-z0-9._+-]+", "-", text)
        if isinstance(value, (dict, list)):
            text = text.strip("-")
        names.append(f"{key}={text}")
    label = ",".join([*names, condition])
    if len(label) <= MAX_VARIANT_NAME:
        return label
    return f"{label[: MAX_VARIANT_NAME - 9]}-{sha256(label.encode()).hexdigest()[:8]}"
