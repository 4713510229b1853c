"""`report.html`: one self-contained page that shows a run, made from its files alone."""

import base64
import io
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import yaml
from PIL import Image

from tiswarm.errors import InputError
from tiswarm.progress import Progress
from tiswarm.records.io import write_text
from tiswarm.records.messages import counted
from tiswarm.report.folder import read_cases, read_table
from tiswarm.report.page_tables import (
    case_table,
    machine_table,
    result_tables,
    warnings_of,
)
from tiswarm.report.page_view import build_view

LARGEST = 7_900_000
"""Largest page [bytes]; pictures that do not fit are named instead."""

PHOTO_QUALITY = 85
ON_PAGE = {"figures": 0.42, "renders": 0.36}
"""Pixels on the page for each of a picture's own, which are many for print."""

SMALL_ON_PAGE = 0.72
"""The same for animations, which are small to begin with."""


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A picture within the page; sizes in pixels."""

    source: str
    """The picture itself, as a data URL, or its file."""

    caption: str
    width: int
    height: int
    wide: int
    """Width on the page."""


def write_page(folder: Path, progress: Progress) -> Path:
    """Write `report.html` into a run's folder.

    Raises:
        InputError: where the folder holds no run or a file is damaged.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415 - slow

    environment = Environment(
        loader=PackageLoader("tiswarm.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    template = environment.get_template("report.html")
    page = _gather(folder)
    room = LARGEST - len(template.render(page=page).encode())
    page["figures"] = list(_pictures(folder / "figures", room, lossless=True))
    room -= sum(len(picture.source) for picture in page["figures"])
    page["renders"] = list(_pictures(folder / "renders", room, lossless=False))
    path = folder / "report.html"
    write_text(path, template.render(page=page) + "\n")
    progress.info(path.name)
    return path


def _gather(folder: Path) -> dict[str, Any]:
    """Gather what the template puts on the page, but for the pictures."""
    cases = read_cases(folder)
    scenario, manifest = _read_text(folder / "scenario.yaml"), _manifest(folder)
    summary = read_table(folder / "summary.csv")
    table = read_table(folder / "table.csv")
    said = yaml.safe_load(scenario)
    arch = manifest.get("backend", {}).get("arch", "cpu")
    return {
        "name": said.get("name", folder.name),
        "description": said.get("description", ""),
        "what": _in_words(summary, manifest),
        "warnings": warnings_of(summary, manifest),
        "tables": result_tables(table, *_optional(folder, "paired.csv")),
        "view": build_view(cases),
        "figures": [],
        "renders": [],
        "cases": case_table(summary),
        "version": manifest.get("tiswarm", "of the same version"),
        "command": f"tiswarm run scenario.yaml --out again --arch {arch}",
        "machine": machine_table(manifest),
        "scenario": scenario,
    }


def _in_words(summary: pd.DataFrame, manifest: dict[str, Any]) -> str:
    """Say in a line what was computed, and in what time."""
    counts = [counted(len(summary), "case")]
    counts += [counted(summary[noun].nunique(), noun) for noun in ("seed", "condition")]
    if "robots" in summary:
        least, most = summary["robots"].min(), summary["robots"].max()
        alike = counted(int(least), "robot")
        counts += [alike if least == most else f"{least:g} to {most:g} robots"]
    spent = sum(stage["wall_s"] for stage in manifest.get("stages", {}).values())
    time = f", computed in {spent:.1f} s" if spent else ""
    each = " each" if len(summary) > 1 else ""
    return f"{', '.join(counts)}{each}{time}."


def _pictures(folder: Path, room: int, *, lossless: bool) -> Iterable[Shown]:
    """Embed the pictures of a folder, as far as there is room for them [bytes]."""
    for path in sorted([*folder.glob("*.png"), *folder.glob("*.gif")]):
        with Image.open(path) as image:
            width, height = image.size
            kind, data = "gif", path.read_bytes()
            if path.suffix == ".png":
                stream = io.BytesIO()
                image.convert("RGB").save(
                    stream, "WEBP", lossless=lossless, quality=PHOTO_QUALITY, method=4
                )
                kind, data = "webp", stream.getvalue()
        source = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
        room -= len(source)
        fits = room > 0
        where = f"{folder.name}/{path.name}"
        said = f"{path.stem.replace('-', ' ').capitalize()}: {where}"
        yield Shown(
            source=source if fits else where,
            caption=said if fits else f"{said} (beside this page, for want of room in it)",
            width=width,
            height=height,
            wide=round(width * (ON_PAGE[folder.name] if kind == "webp" else SMALL_ON_PAGE)),
        )


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeError) as error:
        problem = f"cannot be read: {error}; run the scenario again to restore it"
        raise InputError(problem, path=path) from error


def _manifest(folder: Path) -> dict[str, Any]:
    """Read the manifest; nothing where there is none."""
    path = folder / "manifest.json"
    if not path.exists():
        return {}
    try:
        content: dict[str, Any] = json.loads(_read_text(path))
    except ValueError as error:
        problem = f"is not JSON: {error}; run the scenario again to restore it"
        raise InputError(problem, path=path) from error
    return content


def _optional(folder: Path, *names: str) -> list[pd.DataFrame]:
    """Read tables that not every run has; empty where there is none."""
    return [
        read_table(folder / name) if (folder / name).exists() else pd.DataFrame() for name in names
    ]
