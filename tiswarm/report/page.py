"""Writes `report.html`: one self-contained page that shows a run, made from its files alone."""

import base64
import io
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image

from tiswarm.errors import InputError
from tiswarm.progress import Progress
from tiswarm.records.io import write_text
from tiswarm.records.messages import counted
from tiswarm.report.figure_style import ERROR_COLORS, ESTIMATE_ORANGE, TRUE_BLUE
from tiswarm.report.page_tables import case_table, machine_table, result_tables, warnings_of
from tiswarm.report.render.pictures import CaseView, read_case_view
from tiswarm.report.run_data import RunData

LARGEST = 7_900_000
"""Largest page [bytes]; pictures beyond it remain in files of their own."""

PHOTO_QUALITY = 85
ON_PAGE = {"figures": 0.42, "renders": 0.36}
"""Width on the page over the width of the picture, which has the resolution of print."""

SMALL_ON_PAGE = 0.72
"""The same ratio for animations, which have the resolution of a screen."""

MOST_CASES = 12
"""Cases in the 3D view."""

MOST_ROBOTS = 10_000
"""Robots in the 3D view, in all cases together."""

DIGITS = 4
"""Decimals of positions in the 3D view."""

CAPTIONS = {
    "accuracy": "Mean RMSE and Procrustes disparity with 95 % confidence intervals",
    "convergence": "RMSE against iteration",
    "error-against-height": "Error of each robot against its true height",
    "error-along-growth": "Error of each robot against its place along the structure",
    "profiles": "RMSE by join index, height, hops and contacts",
    "scaling": "Accuracy and cost against the number of robots",
    "contact-graph": "Contact graph, colored by hops from the anchor",
    "error": "True structure, colored by error",
    "growth": "Growth of the structure",
    "sensed-force": "True structure, colored by the force that robots sense in their links",
    "structure": "True structure, colored by join index",
    "truth-and-estimate": "True and estimated structure",
}
"""Captions by file name; a longer name adds a sweep point or a case."""


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A picture within the page; sizes in pixels."""

    source: str
    """The picture as a data URL, or the path of its file."""

    caption: str
    width: int
    height: int
    wide: int
    """Width on the page."""


@dataclass(frozen=True, kw_only=True)
class View:
    """The cases of the 3D view."""

    data: dict[str, Any]
    """Dock offsets [R], and for each case poses and errors [R] in join order."""

    note: str


def write_page(run: RunData, progress: Progress) -> Path:
    """Write `report.html` into the folder of a run.

    Raises:
        InputError: a file of the run is damaged.
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
    page = _gather(run)
    room = LARGEST - len(template.render(page=page).encode())
    page["figures"] = list(_pictures(run.folder / "figures", room, lossless=True))
    room -= sum(len(picture.source) for picture in page["figures"])
    page["renders"] = list(_pictures(run.folder / "renders", room, lossless=False))
    path = run.folder / "report.html"
    write_text(path, template.render(page=page) + "\n")
    progress.info(path.name)
    return path


def _gather(run: RunData) -> dict[str, Any]:
    """Gather what the template shows, except for the pictures."""
    scenario, manifest = _read_text(run.folder / "scenario.yaml"), _manifest(run.folder)
    stated = yaml.safe_load(scenario)
    arch = manifest.get("backend", {}).get("arch", "cpu")
    return {
        "name": stated.get("name", run.folder.name),
        "description": stated.get("description", ""),
        "what": _in_words(run, manifest),
        "warnings": warnings_of(run.summary, manifest),
        "tables": result_tables(run.table("table.csv"), run.table("paired.csv", optional=True)),
        "view": build_view(run),
        "colors": {"true": TRUE_BLUE, "estimate": ESTIMATE_ORANGE, "errors": ERROR_COLORS},
        "figures": [],
        "renders": [],
        "cases": case_table(run.summary),
        "version": manifest.get("tiswarm", "of the same version"),
        "command": f"tiswarm run scenario.yaml --out again --arch {arch}",
        "machine": machine_table(manifest),
        "scenario": scenario,
    }


def _in_words(run: RunData, manifest: dict[str, Any]) -> str:
    """State in a line what was computed, and in what time."""
    counts = [counted(len(run.summary), "case")]
    counts += [counted(run.summary[noun].nunique(), noun) for noun in ("seed", "condition")]
    if "robots" in run.summary:
        least, most = run.summary["robots"].min(), run.summary["robots"].max()
        equal = counted(int(least), "robot") if least == most else ""
        counts += [equal or f"{least:g} to {most:g} robots"]
    spent = sum(stage["wall_s"] for stage in manifest.get("stages", {}).values())
    time = f", computed in {spent:.1f} s" if spent else ""
    each = " each" if len(run.summary) > 1 else ""
    return f"{', '.join(counts)}{each}{time}."


def build_view(run: RunData) -> View | None:
    """Take the first case of each series, within the limits; None if no case is done.

    Raises:
        InputError: a table of a case is missing or damaged.
    """
    if not run.series:
        return None
    first = [cases[0] for cases in run.series.values()]
    view = read_case_view(first[0])
    shown = [_data(view)]
    for case in first[1:MOST_CASES]:
        data = _data(read_case_view(case))
        if sum(len(other["robot"]) for other in [*shown, data]) > MOST_ROBOTS:
            break
        shown.append(data)
    done, robots = sum(case.done for case in run.cases), len(view.pose)
    notes = [f"The view contains {len(shown)} of {done} cases."] if len(shown) < done else []
    if robots > MOST_ROBOTS:
        notes.append(f"It contains the first {MOST_ROBOTS} of {robots} robots.")
    return View(
        data={"offsets": view.dock_offset_body.round(DIGITS).tolist(), "cases": shown},
        note=" ".join(notes),
    )


def _data(view: CaseView) -> dict[str, Any]:
    """List poses and errors of the robots that have an estimate, the first ones if too many."""
    table = np.column_stack([view.error, view.pose, view.estimated_pose])
    known = np.flatnonzero(np.isfinite(table).all(axis=1))[:MOST_ROBOTS]
    error, true, turn, estimate, sensed = np.split(
        table[known].round(DIGITS), [1, 4, 8, 11], axis=1
    )
    return {
        "name": view.case.name,
        "robot": view.robot[known].tolist(),
        "error": error[:, 0].tolist(),
        "worst": max(float(error.max(initial=0.0)), 1e-3),
        "true": true.tolist(),
        "turn": turn.tolist(),
        "estimate": estimate.tolist(),
        "sensed": sensed.tolist(),
    }


def _pictures(folder: Path, room: int, *, lossless: bool) -> Iterable[Shown]:
    """Embed the pictures of a folder that fit into the room [bytes]; link the others."""
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
        caption = f"{caption_of(path.stem)} ({where})"
        yield Shown(
            source=source if fits else where,
            caption=caption if fits else f"{caption}; separate file: page size limit",
            width=width,
            height=height,
            wide=round(width * (ON_PAGE[folder.name] if kind == "webp" else SMALL_ON_PAGE)),
        )


def caption_of(name: str) -> str:
    """Describe a picture by the longest known part of its name."""
    known = max((key for key in CAPTIONS if f"{name}-".startswith(f"{key}-")), key=len, default="")
    rest = name.removeprefix(known).strip("-")
    return ", ".join(filter(None, [CAPTIONS.get(known, ""), rest]))


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeError) as error:
        problem = f"cannot be read: {error}; run the scenario again to restore it"
        raise InputError(problem, path=path) from error


def _manifest(folder: Path) -> dict[str, Any]:
    """Read the manifest; empty where there is none."""
    path = folder / "manifest.json"
    if not path.exists():
        return {}
    try:
        content: dict[str, Any] = json.loads(_read_text(path))
    except ValueError as error:
        problem = f"is not JSON: {error}; run the scenario again to restore it"
        raise InputError(problem, path=path) from error
    return content
