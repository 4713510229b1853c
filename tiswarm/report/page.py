"""Writes pages, each a self-contained file; that of a run is made from the run's files alone."""

import base64
import io
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from PIL import Image

from tiswarm.base.errors import InputError
from tiswarm.base.progress import Progress
from tiswarm.records.io import damaged, run_file, write_text
from tiswarm.records.messages import counted
from tiswarm.records.run_folder import Manifest, read_manifest
from tiswarm.report.captions import caption_of
from tiswarm.report.figure_style import ERROR_COLORS, JOIN_COLORS, TRUE_BLUE
from tiswarm.report.headline import read_pairs, result_of
from tiswarm.report.page_tables import (
    PageTable,
    case_table,
    headline_table,
    machine_table,
    notes_of,
    result_tables,
    warnings_of,
)
from tiswarm.report.run_data import RunData
from tiswarm.report.space import View, build_view
from tiswarm.scenario.yaml_source import read_yaml

LARGEST = 7_900_000
"""Largest page [bytes]; pictures beyond it remain in files of their own."""

_FIRST = (
    "price",
    "accuracy",
    "convergence",
    "structure",
    "truth-and-estimate",
    "error",
    "sd",
    "contact",
)
"""Beginnings of the names of the first pictures; others follow by name."""


class _Shown(NamedTuple):
    """A picture within the page; sizes in pixels."""

    source: str  # the picture as a data URL, or the path of its file
    file: str
    caption: str
    width: int
    height: int
    wide: int  # width on the page


class _Reproduction(NamedTuple):
    """How to repeat a run."""

    version: str
    command: str
    machine: PageTable
    scenario: str


@dataclass(frozen=True, kw_only=True)
class Page:
    """Content of a page; the page leaves out what is empty."""

    name: str
    result: str  # one sentence
    what: str = ""  # one line: what was computed
    description: str = ""
    headline: PageTable | None = None  # beside the 3D view
    warnings: Sequence[str] = ()
    notes: Sequence[str] = ()
    tables: Sequence[PageTable] = ()
    view: View | None = None
    figures: Sequence[_Shown] = ()
    renders: Sequence[_Shown] = ()
    rows: PageTable | None = None  # a row for each case or robot, which readers filter
    rows_example: str = ""  # words that a reader may filter the rows by
    reproduction: _Reproduction | None = None

    def html(self) -> str:
        """Render the page."""
        colors = {"true": TRUE_BLUE, "errors": ERROR_COLORS, "joins": JOIN_COLORS}
        return render("report.html", page=self, colors=colors)


def render(template: str, **content: object) -> str:
    """Fill in one of the templates of pages; text is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415 - slow

    environment = Environment(
        loader=PackageLoader("tiswarm.report"), undefined=StrictUndefined,
        autoescape=True, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "sort_keys": True}
    return environment.get_template(template).render(content) + "\n"


def write_page(run: RunData, progress: Progress) -> Path:
    """Write `report.html` into the folder of a run."""
    page = _gather(run)
    room = LARGEST - len(page.html().encode())
    page = replace(page, figures=show_pictures(run.folder / "figures", room))
    room -= sum(len(picture.source) for picture in page.figures)
    case = run.choose(None).name if run.series else ""
    page = replace(page, renders=show_pictures(run.folder / "renders", room, case=case))
    path = run.folder / "report.html"
    write_text(path, page.html())
    progress.info(path.name)
    return path


def _gather(run: RunData) -> Page:
    """Gather what the page shows, except for the pictures."""
    path = run_file(run.folder / "scenario.yaml")
    stated = read_yaml(path).data
    if not isinstance(stated, dict):
        raise damaged(path, "it is no mapping of keys to values")
    manifest = read_manifest(run.folder)
    numbers = ["cases", "paper_rmse_radii"]
    table = run.table("table.csv", ["condition"], numbers, after="cases")
    pairs = read_pairs(run.folder)
    words = ["condition", "suite", "way", "needs"]
    suites = run.table("suites.csv", words, ["rmse_R_mean"], after="cases", optional=True)
    arch = manifest.backend.get("arch", "cpu")
    return Page(
        name=stated.get("name", run.folder.name),
        description=stated.get("description", ""),
        result=result_of(table, pairs),
        what=_in_words(run, manifest),
        warnings=warnings_of(run.summary),
        notes=notes_of(run.summary, manifest),
        headline=headline_table(table),
        tables=result_tables(table, pairs, suites),
        view=build_view(run),
        rows=case_table(run.summary),
        rows_example=f"{table['condition'].iloc[0]} done",
        reproduction=_Reproduction(
            version=manifest.tiswarm or "of the same version",
            command=f"tiswarm run scenario.yaml --out again --arch {arch}",
            machine=machine_table(manifest),
            scenario=path.read_text(encoding="utf-8"),
        ),
    )


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


def show_pictures(folder: Path, room: int = LARGEST, *, case: str = "") -> list[_Shown]:
    """Embed the pictures of a folder that fit into the room [bytes]; link the others.

    `case` is what pictures show whose names do not say it.
    """
    pictures = []
    paths = sorted([*folder.glob("*.png"), *folder.glob("*.gif")], key=_place)
    encode = partial(_encoded, lossless=folder.name != "renders")
    with warnings.catch_warnings(), ThreadPoolExecutor() as pool:
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        encoded = list(pool.map(encode, paths))
    for path, (kind, data, (width, height)) in zip(paths, encoded, strict=True):
        # GIFs have a screen's resolution
        share = 0.72 if kind == "gif" else 0.36 if folder.name == "renders" else 0.42
        source = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
        file, caption = f"{folder.name}/{path.name}", caption_of(path.stem, case)
        room -= len(source)
        if room <= 0:
            source, caption = file, f"{caption} Separate file {file}: page size limit."
        pictures.append(_Shown(source, file, caption, width, height, wide=round(width * share)))
    return pictures


def _place(path: Path) -> tuple[int, str]:
    """Return the place of a picture among others: first the ones that show most."""
    first = (place for place, name in enumerate(_FIRST) if path.stem.startswith(name))
    return next(first, len(_FIRST)), path.name


def _encoded(path: Path, *, lossless: bool) -> tuple[str, bytes, tuple[int, int]]:
    """Read a picture; returns its format on the page, its data and its size [pixels]."""
    form = path.suffix[1:].upper()
    run_file(path)
    try:
        with Image.open(path, formats=[form]) as image:
            if form == "GIF":
                return "gif", path.read_bytes(), image.size
            stream = io.BytesIO()
            image.convert("RGB").save(stream, "WEBP", lossless=lossless, quality=85, method=4)
            return "webp", stream.getvalue(), image.size
    except Exception as error:  # a damaged picture can raise any error
        problem = f"is no {form} picture that can be shown: {error}; delete it, or draw it again"
        raise InputError(problem, path=path) from error
