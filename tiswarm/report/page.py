"""Writes pages, each a self-contained file; that of a run is made from the run's files alone.

Figures are SVG in the colors of the page, renders are WebP.
"""

import base64
import io
import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree as ET

from PIL import Image

from tiswarm.base.errors import InputError
from tiswarm.base.progress import Progress
from tiswarm.records.io import run_file, write_bytes
from tiswarm.records.measures import FEWEST, RMSE
from tiswarm.records.messages import counted
from tiswarm.records.run_folder import Manifest, read_manifest
from tiswarm.report import page_tables
from tiswarm.report.figure_style import COLUMN_WIDTH, SCALES, TRUE_BLUE, svg
from tiswarm.report.figures import caption_of, drawings_of
from tiswarm.report.run_data import RunData, read_pairs, stated_scenario
from tiswarm.report.swarm_view import View, build_view, read_loads

if TYPE_CHECKING:
    from jinja2 import Environment

LARGEST = 7_900_000
"""Largest page [bytes]; pictures beyond it remain in files of their own."""

_FIRST = (
    *("color", "price", "grades", "scaling", "building", "traffic", "shape", "accuracy"),
    *("convergence", "best", "sizes", "structure", "truth-and-estimate", "error", "sd", "contact"),
)
"""Beginnings of the names of the first pictures; others follow by name."""

_SUFFIXES = {".png", ".gif", ".webp", ".mp4"}
_RENDER_SHARE = 0.5  # width on the page over that of the file
_MOVIE_WIDTH = 420  # of an animation on the page
_PIXELS = 96.0 / 72.0  # of a point of an SVG

_TAGS = {"svg", "g", "defs", "path", "use", "clipPath", "rect", "image", "text", "tspan"}
_ATTRIBUTES = {
    "viewBox",
    "id",
    "d",
    "style",
    "clip-path",
    "transform",
    "href",
    "x",
    "y",
    "width",
    "height",
}
_HREF = re.compile(r"#\w+|data:image/png;base64,[A-Za-z0-9+/=\s]+")
_STYLE = re.compile(r"[\w\s:;,.%#'-]*")
_CLIP = re.compile(r"url\(#\w+\)")
_COLORS = {
    "#000000": "currentColor",
    "#ffffff": "var(--page)",
    "#595959": "var(--soft)",
    "#666666": "var(--soft)",
    "#ebebeb": "var(--rule)",
    TRUE_BLUE.lower(): "var(--true)",
}
"""Color of a figure's file, and that on the page, which differs in the dark."""


class Shown(NamedTuple):
    """A picture within the page; sizes in pixels."""

    source: str  # the picture as a data URL, or the path of its file
    file: str
    caption: str
    width: int
    height: int
    wide: int  # width on the page
    drawing: str = ""  # instead of the source, an element <svg>
    narrow: str = ""  # the same figure, drawn for narrow screens

    @property
    def is_film(self) -> bool:
        """Whether it is a film, which the reader starts."""
        return self.file.endswith(".mp4")

    @property
    def size(self) -> int:
        """What it adds to the page [bytes]."""
        return len(self.source) + len(self.drawing) + len(self.narrow)


def show_pictures(
    folder: Path,
    room: int = LARGEST,
    *,
    case: str = "",
    few: bool = False,
    run: RunData | None = None,
) -> list[Shown]:
    """Embed the pictures of a folder that fit into the room [bytes]; link the others.

    `case` is what pictures show whose names do not say it. Figures of few structures have no bars.
    Figures of a run are drawn again in the width of a column, for narrow screens.
    """
    pictures = []
    paths = sorted([path for path in folder.glob("*") if path.suffix in _SUFFIXES], key=_order)
    with warnings.catch_warnings(), ThreadPoolExecutor() as pool:
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        shown = list(pool.map(_shown, paths))
    drawings = {}
    if run is not None and any(picture.drawing for picture in shown):
        drawings = drawings_of(run)
    for path, embedded in zip(paths, shown, strict=True):
        picture = embedded
        if picture.drawing and path.stem in drawings:
            column = svg(drawings[path.stem].draw(COLUMN_WIDTH))
            picture = picture._replace(narrow=_drawn(path, column)[0])
        file = f"{folder.name}/{path.name}"
        caption = caption_of(path.stem, case, few=few)
        room -= picture.size
        if room <= 0:
            picture = picture._replace(source=file, drawing="", narrow="")
            caption += f" Separate file {file}: page size limit."
        pictures.append(picture._replace(file=file, caption=caption))
    return pictures


def show_drawing(file: str, caption: str, drawing: bytes, narrow: bytes) -> Shown:
    """Embed a figure that was encoded as SVG, and the same one for narrow screens.

    `file` is the name that the page gives it.
    """
    wide, width = _drawn(Path(file), drawing)
    column, _ = _drawn(Path(file), narrow)
    return Shown("", file, caption, 0, 0, wide=round(width), drawing=wide, narrow=column)


def _order(path: Path) -> tuple[int, str]:
    """Return the rank of a picture among others: first the ones that show most; then its name."""
    ranks = (rank for rank, name in enumerate(_FIRST) if path.stem.startswith(name))
    return next(ranks, len(_FIRST)), path.name


def _shown(path: Path) -> Shown:
    """Read a picture, of a figure the SVG beside it, without its caption.

    Pictures that users put beside figures may have no SVG.
    """
    vector = path.with_suffix(".svg")
    if path.parent.name == "figures" and os.path.lexists(vector):
        drawing, width = _drawn(vector, _read(vector))
        return Shown("", "", "", 0, 0, wide=round(width), drawing=drawing)
    kind, data, (width, height) = _encoded(path)
    source = f"data:{kind};base64,{base64.b64encode(data).decode()}"
    wide = round(width * _RENDER_SHARE) if path.suffix == ".png" else _MOVIE_WIDTH
    return Shown(source, "", "", width, height, wide=wide)


def _encoded(path: Path) -> tuple[str, bytes, tuple[int, int]]:
    """Read a picture; returns its format on the page, its data and its size [pixels]."""
    form = path.suffix[1:].upper()
    run_file(path)
    if form == "MP4":
        return "video/mp4", path.read_bytes(), (0, 0)
    try:
        with Image.open(path, formats=[form]) as image:
            if form != "PNG":
                return f"image/{form.lower()}", path.read_bytes(), image.size
            stream = io.BytesIO()
            image.convert("RGBA").save(stream, "WEBP", quality=85, alpha_quality=100, method=2)
            return "image/webp", stream.getvalue(), image.size
    except Exception as error:  # a damaged picture can raise any error
        raise _unreadable(path, error) from error


def _read(vector: Path) -> bytes:
    """Read a file of an SVG."""
    return run_file(vector, LARGEST).read_bytes()


def _drawn(path: Path, data: bytes) -> tuple[str, float]:
    """Write an SVG as an element of the page, in its colors; returns its width too [pixels].

    What a figure does not need, such as a script, is left out: others may have made the file.
    """
    try:
        root = ET.fromstring(data)  # noqa: S314 - expat limits expansion
        width = float(root.attrib["viewBox"].split()[2]) * _PIXELS
        return "".join(_written(root)), width
    except (ET.ParseError, LookupError, ValueError) as error:
        raise _unreadable(path, error) from error


def _written(element: ET.Element) -> Iterator[str]:
    """Write an element of an SVG and what is in it."""
    tag = element.tag.rpartition("}")[2]
    if tag not in _TAGS:
        return
    attributes = {name.rpartition("}")[2]: value for name, value in element.attrib.items()}
    kept = {name: value for name, value in attributes.items() if _is_kept(tag, name, value)}
    style = re.sub(r"font-family:[^;]*;? ?", "", kept.pop("style", ""))
    if style:
        kept["style"] = re.sub(r"#[0-9a-f]{6}\b", lambda hit: _COLORS.get(hit[0], hit[0]), style)
    if attributes.get("id", "").startswith("PathCollection"):
        kept["class"] = "dots"
    words = [f' {name}="{escape(value)}"' for name, value in kept.items()]
    yield f"<{tag}{''.join(words)}>"
    yield escape((element.text or "").strip())
    for child in element:
        yield from _written(child)
    yield f"</{tag}>"


def _is_kept(tag: str, name: str, value: str) -> bool:
    """Whether the page needs an attribute; names of groups occur in each figure."""
    if name not in _ATTRIBUTES or (tag == "svg" and name != "viewBox"):
        return False
    patterns = {"href": _HREF, "style": _STYLE, "clip-path": _CLIP}
    if name == "id":
        return tag in {"path", "clipPath"}
    return name not in patterns or patterns[name].fullmatch(value) is not None


def _unreadable(path: Path, error: Exception) -> InputError:
    form = path.suffix[1:].upper()
    problem = f"is no {form} picture that can be shown: {error}; delete it, and redraw the run"
    return InputError(problem, path=path)


_ACCURACY = ("figures/accuracy.png", "figures/structures.png")
_OF_ROBOTS = re.compile(r"figures/(error-|profiles)")
_MOST_BESIDE = 8  # rows of the figure of accuracy beside the 3D view
_MOST_ROWS_BESIDE = 14  # rows of the table there
_MOST_COLUMNS_BESIDE = 7  # columns of that table


class _Reproduction(NamedTuple):
    """How to repeat a run."""

    version: str
    command: str
    machine: page_tables.PageTable
    scenario: str


@dataclass(frozen=True, kw_only=True)
class Page:
    """Content of a page; the page leaves out what is empty."""

    name: str
    result: str = ""  # one sentence
    what: str = ""  # one line: what was computed
    description: str = ""
    headline: page_tables.PageTable | None = None  # beside the 3D view
    warnings: Sequence[str] = ()
    notes: Sequence[str] = ()
    tables: Sequence[page_tables.PageTable] = ()
    more: Sequence[page_tables.PageTable] = ()  # tables that readers unfold
    view: View | None = None
    figures: Sequence[Shown] = ()
    renders: Sequence[Shown] = ()
    rows: page_tables.PageTable | None = None  # a row for each case or robot, which readers filter
    rows_example: str = ""  # words that a reader may filter the rows by
    reproduction: _Reproduction | None = None
    growth: Mapping[str, Any] | None = None  # of structures that grow: their `folder` or `news`

    @property
    def first_figures(self) -> list[Shown]:
        """Figures that readers see without a click, but for the one beside the first table.

        They are all, or those of conditions and points.
        """
        others = [*self.more_figures, self.accuracy]
        return [figure for figure in self.figures if figure not in others]

    @property
    def more_figures(self) -> list[Shown]:
        """Figures of single robots, of a page with a sweep."""
        if not self.is_sweep:
            return []
        return [figure for figure in self.figures if _OF_ROBOTS.match(figure.file)]

    @property
    def is_sweep(self) -> bool:
        """Whether the table of conditions has the whole width: of a sweep, long ones, wide ones."""
        table = self.headline
        if table is None:
            return False
        is_large = len(table.frame) > _MOST_ROWS_BESIDE or len(table.columns) > _MOST_COLUMNS_BESIDE
        return table.is_grouped or is_large

    @property
    def accuracy(self) -> Shown | None:
        """The figure of accuracy, or structures, if it has few rows: it is on the first screen."""
        few = self.headline is not None and len(self.headline.frame) <= _MOST_BESIDE
        few = few and not self.is_sweep
        figures = (figure for figure in self.figures if figure.narrow and few)
        return next((figure for figure in figures if figure.file in _ACCURACY), None)

    def html(self) -> str:
        """Render the page."""
        return render("report.html", page=self, colors={"true": [TRUE_BLUE], **SCALES})


def render(template: str, **content: object) -> str:
    """Fill in one of the templates of pages; text is escaped."""
    return _templates().get_template(template).render(content) + "\n"


@cache
def _templates() -> "Environment":
    """Find templates, which are compiled once."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415 - slow

    environment = Environment(
        loader=PackageLoader("tiswarm.report"),
        undefined=StrictUndefined,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "sort_keys": True}
    return environment


def write_page(run: RunData, progress: Progress) -> Path:
    """Write `report.html` into the folder of a run."""
    page = _gather(run)
    room = LARGEST - len(page.html().encode())
    few = max(map(len, run.series.values()), default=0) < FEWEST
    page = replace(page, figures=show_pictures(run.folder / "figures", room, few=few, run=run))
    room -= sum(picture.size for picture in page.figures)
    chosen = run.choose(None) if run.series else None
    case = chosen.title if chosen else ""
    page = replace(page, renders=show_pictures(run.folder / "renders", room, case=case))
    path = run.folder / "report.html"
    write_bytes(path, page.html().encode())
    progress.info(path.name)
    return path


def _gather(run: RunData) -> Page:
    """Gather what the page shows, except for the pictures."""
    path = run_file(run.folder / "scenario.yaml")
    stated = stated_scenario(run.folder)
    manifest = read_manifest(run.folder)
    numbers = ["cases"] if run.has_structures_alone else ["cases", RMSE.published]
    table = run.table("table.csv", ["condition"], numbers, after="cases")
    pairs = read_pairs(run.folder, run.labels)
    words = ["condition", "suite", "way", "needs"]
    suites = run.table("suites.csv", words, [RMSE.mean], after="cases", optional=True)
    tables = page_tables.result_tables(table, pairs, suites) + _weakest_contacts(run)
    if run.is_of_engine:
        speeds = run.table("throughput.csv", ["condition"], ["robot_count", "steps"], after="cases")
        tables = [page_tables.throughput_table(speeds), *tables]
    headline = page_tables.headline_table(table, stated.get("question", ""), powers=run.powers)
    arch = manifest.backend.get("arch", "cpu")
    return Page(
        name=stated.get("name", run.folder.name),
        description=stated.get("description", ""),
        result=page_tables.statement_of(run.summary),
        what=_in_words(run, manifest),
        warnings=page_tables.warnings_of(run.summary),
        notes=page_tables.notes_of(run.summary, manifest),
        headline=headline,
        tables=[page_table for page_table in tables if page_table.is_first],
        more=[page_table for page_table in tables if not page_table.is_first],
        view=build_view(run),
        rows=page_tables.case_table(run.summary, in_words=bool(run.summary["point"].notna().any())),
        rows_example=f"{table['condition'].iloc[0]} done",
        reproduction=_Reproduction(
            version=manifest.tiswarm or "of the same version",
            command=f"tiswarm run scenario.yaml --out again --arch {arch}",
            machine=page_tables.machine_table(manifest),
            scenario=path.read_text(encoding="utf-8"),
        ),
    )


def _weakest_contacts(run: RunData) -> list[page_tables.PageTable]:
    """Format the weakest contacts of the case that pictures show, or else of the first with loads.

    Empty if no contact of a series' first case has a load that its strength limits.
    """
    if not run.series:
        return []
    for case in (run.choose(None), *(cases[0] for cases in run.series.values())):
        loads = read_loads(case)
        if loads is not None and loads["margin"].notna().any():
            return [page_tables.weakest_contacts(loads, case.title)]
    return []


def _in_words(run: RunData, manifest: Manifest) -> str:
    """State in a line what was computed, and in what time."""
    counts = [counted(len(run.summary), "case")]
    counts += [counted(run.summary[noun].nunique(), noun) for noun in ("seed", "condition")]
    if "robots" in run.summary:
        least = run.summary["robots"].min()
        most = run.summary["robots"].max()
        if least == most:
            counts.append(counted(int(least), "robot"))
        else:
            counts.append(f"{least:,.0f} to {most:,.0f} robots")
    spent = sum(stage.wall_s for stage in manifest.stages.values())
    time = f", computed in {spent:.1f} s" if spent else ""
    distribution = " each" if len(run.summary) > 1 else ""
    return f"{', '.join(counts)}{distribution}{time}."
