"""Writes pages, each a self-contained file; that of a run is made from the run's files alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from tiswarm.base.progress import Progress
from tiswarm.records.io import run_file, write_bytes
from tiswarm.records.messages import counted
from tiswarm.records.run_folder import Manifest, read_manifest
from tiswarm.report.figure_style import ERROR_COLORS, JOIN_COLORS, TRUE_BLUE
from tiswarm.report.headline import read_pairs, result_of
from tiswarm.report.page_pictures import LARGEST, Shown, show_pictures
from tiswarm.report.page_tables import (
    PageTable,
    case_table,
    headline_table,
    machine_table,
    result_tables,
)
from tiswarm.report.remarks import notes_of, warnings_of
from tiswarm.report.run_data import RunData, relabeled, stated_scenario
from tiswarm.report.space import View, build_view

_ACCURACY = "figures/accuracy.png"
_MOST_BESIDE = 8  # rows of the figure of accuracy beside the 3D view


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
    figures: Sequence[Shown] = ()
    renders: Sequence[Shown] = ()
    rows: PageTable | None = None  # a row for each case or robot, which readers filter
    rows_example: str = ""  # words that a reader may filter the rows by
    reproduction: _Reproduction | None = None

    @property
    def accuracy(self) -> Shown | None:
        """The figure of accuracy, if it has few rows: it is on the first screen."""
        few = self.headline is not None and len(self.headline.frame) <= _MOST_BESIDE
        figures = (figure for figure in self.figures if figure.narrow and few)
        return next((figure for figure in figures if figure.file == _ACCURACY), None)

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
    room -= sum(picture.size for picture in page.figures)
    case = run.choose(None).name if run.series else ""
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
    numbers = ["cases", "paper_rmse_radii"]
    table = run.table("table.csv", ["condition"], numbers, after="cases")
    pairs = relabeled(read_pairs(run.folder), run.labels)
    words = ["condition", "suite", "way", "needs"]
    suites = run.table("suites.csv", words, ["rmse_R_mean"], after="cases", optional=True)
    arch = manifest.backend.get("arch", "cpu")
    return Page(
        name=stated.get("name", run.folder.name),
        description=stated.get("description", ""),
        result=result_of(run.folder, table, run.labels),
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
