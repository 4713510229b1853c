"""Writes `report.html`: one self-contained page that shows a run, made from its files alone."""

import base64
import io
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from tiswarm.errors import InputError
from tiswarm.progress import Progress
from tiswarm.records.io import damaged, run_file, write_text
from tiswarm.records.messages import counted
from tiswarm.records.run_folder import Manifest, read_manifest
from tiswarm.report.figure_style import ERROR_COLORS, ESTIMATE_ORANGE, TRUE_BLUE
from tiswarm.report.page_tables import (
    case_table,
    machine_table,
    result_tables,
    warnings_of,
)
from tiswarm.report.render.pictures import CaseView, read_case_view
from tiswarm.report.run_data import RunData
from tiswarm.scenario.yaml_source import read_yaml

_LARGEST = 7_900_000  # largest page [bytes]; pictures beyond it remain in files of their own
_MOST_CASES = 12  # in the 3D view
MOST_ROBOTS = 10_000
"""Robots in the 3D view, in all cases together."""

_DIGITS = 4  # decimals of positions in the 3D view
_ON_PAGE = {"figures": 0.42, "renders": 0.36}
"""Width on the page over the width of the picture, which has the resolution of print."""

_CAPTIONS = {
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


class _Shown(NamedTuple):
    """A picture within the page; sizes in pixels."""

    source: str  # the picture as a data URL, or the path of its file
    caption: str
    width: int
    height: int
    wide: int  # width on the page


class _View(NamedTuple):
    """The cases of the 3D view."""

    data: dict[str, Any]  # dock offsets [R], and for each case poses and errors [R] in join order
    note: str


def write_page(run: RunData, progress: Progress) -> Path:
    """Write `report.html` into the folder of a run."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415 - slow

    environment = Environment(
        loader=PackageLoader("tiswarm.report"), undefined=StrictUndefined,
        autoescape=True, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    template = environment.get_template("report.html")
    page = _gather(run)
    room = _LARGEST - len(template.render(page=page).encode())
    page["figures"] = _pictures(run.folder / "figures", room)
    room -= sum(len(picture.source) for picture in page["figures"])
    page["renders"] = _pictures(run.folder / "renders", room)
    path = run.folder / "report.html"
    write_text(path, template.render(page=page) + "\n")
    progress.info(path.name)
    return path


def _gather(run: RunData) -> dict[str, Any]:
    """Gather what the template shows, except for the pictures."""
    path = run_file(run.folder / "scenario.yaml")
    stated = read_yaml(path).data
    if not isinstance(stated, dict):
        raise damaged(path, "it is no mapping of keys to values")
    manifest = read_manifest(run.folder)
    numbers = ["cases", "paper_rmse_radii"]
    table = run.table("table.csv", ["condition"], numbers, after="cases")
    words = ["condition", "against", "measure"]
    numbers = ["structures", "difference_mean", "smaller", "wilcoxon_p"]
    paired = run.table("paired.csv", words, numbers, after="measure", optional=True)
    arch = manifest.backend.get("arch", "cpu")
    return {
        "name": stated.get("name", run.folder.name),
        "description": stated.get("description", ""),
        "what": _in_words(run, manifest),
        "warnings": warnings_of(run.summary, manifest),
        "tables": result_tables(table, paired),
        "view": build_view(run),
        "colors": {"true": TRUE_BLUE, "estimate": ESTIMATE_ORANGE, "errors": ERROR_COLORS},
        "figures": [],
        "renders": [],
        "cases": case_table(run.summary),
        "version": manifest.tiswarm or "of the same version",
        "command": f"tiswarm run scenario.yaml --out again --arch {arch}",
        "machine": machine_table(manifest),
        "scenario": path.read_text(encoding="utf-8"),
    }


def _in_words(run: RunData, manifest: Manifest) -> str:
    """State in a line what was computed, and in what time."""
    counts = [counted(len(run.summary), "case")]
    counts += [counted(run.summary[noun].nunique(), noun) for noun in ("seed", "condition")]
    if "robots" in run.summary:
        least, most = run.summary["robots"].min(), run.summary["robots"].max()
        equal = counted(int(least), "robot") if least == most else ""
        counts += [equal or f"{least:g} to {most:g} robots"]
    spent = sum(stage.wall_s for stage in manifest.stages.values())
    time = f", computed in {spent:.1f} s" if spent else ""
    each = " each" if len(run.summary) > 1 else ""
    return f"{', '.join(counts)}{each}{time}."


def build_view(run: RunData) -> _View | None:
    """Take the first case of each series, within the limits; None if no case is done."""
    if not run.series:
        return None
    first = [cases[0] for cases in run.series.values()]
    view = read_case_view(first[0])
    shown = [_data(view)]
    for case in first[1:_MOST_CASES]:
        data = _data(read_case_view(case))
        if sum(len(other["robot"]) for other in [*shown, data]) > MOST_ROBOTS:
            break
        shown.append(data)
    done, robots = sum(case.done for case in run.cases), len(view.pose)
    notes = [f"The view contains {len(shown)} of {done} cases."] if len(shown) < done else []
    if robots > MOST_ROBOTS:
        notes.append(f"It contains the first {MOST_ROBOTS} of {robots} robots.")
    return _View(
        data={"offsets": view.dock_offset_body.round(_DIGITS).tolist(), "cases": shown},
        note=" ".join(notes),
    )


def _data(view: CaseView) -> dict[str, Any]:
    """List poses and errors of the robots that have an estimate, the first ones if too many."""
    table = np.column_stack([view.error, view.pose, view.estimated_pose])
    known = np.flatnonzero(np.isfinite(table).all(axis=1))[:MOST_ROBOTS]
    parts = np.split(table[known].round(_DIGITS), [1, 4, 8, 11], axis=1)
    error, true, turn, estimate, sensed = (part.tolist() for part in parts)
    return {
        "name": view.case.name,
        "robot": view.robot[known].tolist(),
        "error": [value for (value,) in error],
        "worst": max(float(parts[0].max(initial=0.0)), 1e-3),
        "true": true,
        "turn": turn,
        "estimate": estimate,
        "sensed": sensed,
    }


def _pictures(folder: Path, room: int) -> list[_Shown]:
    """Embed the pictures of a folder that fit into the room [bytes]; link the others."""
    pictures = []
    for path in sorted([*folder.glob("*.png"), *folder.glob("*.gif")]):
        kind, data, (width, height) = _encoded(path, lossless=folder.name == "figures")
        share = 0.72 if kind == "gif" else _ON_PAGE[folder.name]  # GIFs have a screen's resolution
        source = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
        where = f"{folder.name}/{path.name}"
        caption = f"{caption_of(path.stem)} ({where})"
        room -= len(source)
        if room <= 0:
            source, caption = where, f"{caption}; separate file: page size limit"
        pictures.append(_Shown(source, caption, width, height, wide=round(width * share)))
    return pictures


def _encoded(path: Path, *, lossless: bool) -> tuple[str, bytes, tuple[int, int]]:
    """Read a picture; returns its format on the page, its data and its size [pixels]."""
    form = path.suffix[1:].upper()
    run_file(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path, formats=[form]) as image:
                if form == "GIF":
                    return "gif", path.read_bytes(), image.size
                stream = io.BytesIO()
                image.convert("RGB").save(stream, "WEBP", lossless=lossless, quality=85, method=4)
                return "webp", stream.getvalue(), image.size
    except Exception as error:  # a damaged picture can raise any error
        problem = f"is no {form} picture that can be shown: {error}; delete it, or draw it again"
        raise InputError(problem, path=path) from error


def caption_of(name: str) -> str:
    """Describe a picture by the longest known part of its name."""
    known = max((key for key in _CAPTIONS if f"{name}-".startswith(f"{key}-")), key=len, default="")
    rest = name.removeprefix(known).strip("-")
    return ", ".join(filter(None, [_CAPTIONS.get(known, ""), rest]))
