"""A run as a caller has it: data frames, figures that notebooks show, pictures and exports."""

import html
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, is_dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias
from urllib.parse import quote

import numpy as np

from tiswarm.app.console import ConsoleProgress
from tiswarm.base.errors import InputError, require_name
from tiswarm.base.params import AnyMovie
from tiswarm.records.measures import MAIN, MEASURES, PAGE
from tiswarm.records.messages import counted
from tiswarm.records.outputs import Outputs

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import pandas as pd

    from tiswarm.report.page_tables import PageTable
    from tiswarm.report.run_data import RunData

if TYPE_CHECKING:
    _Path = Path
else:
    _Path = type(Path())  # before Python 3.12, `Path` itself has no subclasses

File = str | PathLike[str]
"""Path of a file or folder."""

Section = str | Mapping[str, object] | object
"""Section of a scenario: the name that selects it, its keys, or its settings as an object."""

Overrides = Mapping[str, object] | Sequence[str]
"""Values by dotted key, or as texts `KEY=VALUE`."""

CueChoice = Sequence[str] | Mapping[str, bool] | None
"""Cues to use alone, or those that are switched on or off; all of the method's if None."""

Color: TypeAlias = "str | pd.Series[Any] | Sequence[str | pd.Series[Any]]"
"""Values that color robots: columns `FILE:COLUMN` of tables, or series of pandas by robot."""

FRAME = 'style="width: 100%; height: 720px; border: 1px solid #8888; box-sizing: border-box"'
"""Look of a page within a notebook."""


@dataclass(frozen=True)
class Figure:
    """A picture of a run; notebooks show it."""

    path: Path

    def _repr_png_(self) -> bytes:
        return self.path.read_bytes()


class PageFile(_Path):
    """The path of a page; notebooks show the page itself."""

    def _repr_html_(self) -> str | None:
        if self.suffix != ".html" or not self.is_file():  # such as the folder of a page
            return None
        page = html.escape(self.read_text(encoding="utf-8"))
        return f'<iframe srcdoc="{page}" {FRAME}></iframe>'


class Figures(dict[str, Figure]):
    """Pictures by name."""

    @classmethod
    def of(cls, paths: Iterable[Path]) -> "Figures":
        """Name pictures after their files."""
        return cls((path.stem, Figure(path)) for path in sorted(paths))

    def __missing__(self, name: str) -> Figure:
        """Refuse a name that is not among these."""
        require_name(name, [*self], "name")
        raise KeyError(name)


@dataclass(frozen=True)
class Run:
    """Results of a run, as data frames and figures."""

    folder: Path
    failed: str = field(default="", compare=False)
    """How many cases the call failed to compute, and why; empty if none."""
    missing: int = field(default=0, compare=False)
    """Cases that the call left to other parts of the run; tables come with the last part."""

    @property
    def page(self) -> Path:
        """The page of the run, or its folder while it has no page."""
        page = self.folder / "report.html"
        return page if page.exists() else self.folder

    @property
    def table(self) -> "pd.DataFrame":
        """Results by series that the page shows; `frame("table")` has all statistics.

        The column `series` has the names that figures use.
        """
        from tiswarm.report.run_data import joined_words, with_points  # noqa: PLC0415

        full = self.frame("table")
        shown = {measure for headings in PAGE.values() for measure in headings}
        hidden = {measure.mean for measure in MEASURES.values() if measure not in shown}
        ranges = {name for m in MAIN for name in (m.ci95, m.least, m.most)}
        kept = []
        for name in map(str, full):
            is_shown_mean = name.endswith("_mean") and name not in hidden
            if (name in ranges or is_shown_mean) and full[name].notna().any():
                kept.append(name)
        shown_table = full.loc[:, :"failed"].join(full[kept])
        labeled = with_points(self._labeled_table())
        shown_table.insert(0, "series", joined_words(labeled, ["point", "condition"]))
        return shown_table

    @property
    def summary(self) -> "pd.DataFrame":
        """Results by case, with the reason of each failure, `summary.csv`."""
        return self.frame("summary")

    def paper_table(self) -> "pd.DataFrame":
        """Return the first table of the page, in words: points, conditions and errors."""
        return self._accuracy().frame

    def paper_text(self, form: Literal["latex", "markdown", "csv"]) -> str:
        """Write that table for a paper: "latex" with rules of booktabs, "markdown" or "csv"."""
        from tiswarm.report.page_tables import paper_text  # noqa: PLC0415 - slow to import

        return paper_text(self._accuracy(), form, self.folder.name.rpartition("-")[0])

    def _accuracy(self) -> "PageTable":
        table = self._labeled_table()
        if not table["cases"].any():
            problem = "no case of this run is done; correct the scenario and run it again"
            raise InputError(problem, path=self.folder)
        return self._headline(table, best_first=False)

    def _labeled_table(self) -> "pd.DataFrame":
        return self._data().table("table.csv", ["condition"], ["cases"], after="cases")

    def _headline(
        self, table: "pd.DataFrame", *, with_verdicts: bool = False, best_first: bool = True
    ) -> "PageTable":
        from tiswarm.report.page_tables import headline_table  # noqa: PLC0415 - slow to import
        from tiswarm.report.run_data import stated_scenario  # noqa: PLC0415 - slow to import

        return headline_table(
            table,
            stated_scenario(self.folder).get("question", ""),
            powers=self._data().powers,
            with_verdicts=with_verdicts,
            best_first=best_first,
        )

    def frame(self, name: str, *, case: str | None = None) -> "pd.DataFrame":
        """Read another table of the run, or one of a case.

        Raises:
            InputError: the run has no table or case of that name; names those that it has.
        """
        from tiswarm.records.frames import read_frame  # noqa: PLC0415 - slow to import

        cases = [path.name for path in sorted(self.folder.glob("cases/*"))]
        if case is not None:
            require_name(case, cases, "case")
        folder = self.folder if case is None else self.folder / "cases" / case
        require_name(name, [path.stem for path in sorted(folder.glob("*.csv"))], "name")
        return read_frame(folder / f"{name}.csv", empty=True)

    @property
    def figures(self) -> Figures:
        """Figures and renders by name; none after a run without pictures."""
        return Figures.of([*self.folder.glob("figures/*.png"), *self.folder.glob("renders/*.png")])

    def figure(
        self,
        name: str,
        *,
        panels: Sequence[str] = (),
        series: Sequence[str] = (),
        width: float | None = None,
        out: File | None = None,
        overwrite: bool = False,
    ) -> "matplotlib.figure.Figure":
        """Draw a figure again, as matplotlib has it: change its axes, and save it.

        Letters have 7 pt in any width.

        Args:
            name: Name of the figure, such as "scaling".
            panels: Names of its panels, such as "rmse_R"; all if empty.
            series: Names of its series, as the legend has them; all if empty.
            width: Width [inch]: 3.5 for a column of a paper; that of a page if None.
            out: File to write, .png or .pdf; none if None.
            overwrite: Whether to replace the file if it exists.

        Raises:
            InputError: the run has no such figure, panel or series, which names those that it has,
                or the file has another format or exists and is to stay.
        """
        from tiswarm.report.figure_style import write  # noqa: PLC0415 - slow to import
        from tiswarm.report.figures import find_drawing  # noqa: PLC0415 - slow to import

        path = None if out is None else as_path(out, "out")
        outputs = Outputs(inputs=[self.folder / "cases"], overwrite=overwrite)
        outputs.check({"out": path})
        figure = find_drawing(self._data(), name).draw(width, panels, series)
        if path is not None:
            write(path, lambda: figure, outputs)
        return figure

    def draw_panel(
        self, axes: "matplotlib.axes.Axes", name: str, panel: str, *, series: Sequence[str] = ()
    ) -> None:
        """Draw one panel of a figure on axes of yours.

        Args:
            axes: Axes of matplotlib.
            name: Name of the figure, such as "scaling".
            panel: Name of the panel, such as "rmse_R".
            series: Names of the series; all if empty.

        Raises:
            InputError: the run has no such figure, panel or series, or the figure has no panels.
        """
        from tiswarm.report.figure_style import Drawing  # noqa: PLC0415 - slow to import
        from tiswarm.report.figures import find_drawing  # noqa: PLC0415 - slow to import

        drawing = find_drawing(self._data(), name)
        if not isinstance(drawing, Drawing):
            raise InputError(f"the figure {name} of a plug-in has no panels", argument="name")
        drawing.paint_panel(axes, panel, series)

    def view(self, *, quiet: bool = False) -> PageFile:
        """Return the run's page, `report.html`; write it if there is none."""
        from tiswarm.app.drawing import PAGE, draw  # noqa: PLC0415 - slow to import

        page = self.folder / PAGE
        if not page.exists():
            draw(self._data(), ConsoleProgress(quiet=quiet))
        return PageFile(page)

    def redraw(
        self,
        *,
        pdf: bool = False,
        movie: AnyMovie | None = None,
        renderer: str | None = None,
        case: str | None = None,
        color: Color = (),
        quiet: bool = False,
    ) -> None:
        """Write tables, pictures and page again from the stored cases, as `tiswarm.redraw` does."""
        from tiswarm import study  # noqa: PLC0415 - slow to import
        from tiswarm.app.drawing import draw  # noqa: PLC0415 - slow to import

        progress = ConsoleProgress(quiet=quiet)
        study.tabulate(self.folder, progress)
        data = self._data(color, case)
        renders = any(stored.done for stored in data.cases)
        draw(
            data,
            progress,
            figures=True,
            renders=renders,
            pdf=pdf,
            movie=movie,
            renderer=renderer,
            case=case,
        )

    def export(
        self,
        form: str = "gltf",
        *,
        out: File | None = None,
        case: str | None = None,
        color: Color = (),
        overwrite: bool = False,
        quiet: bool = False,
    ) -> Path:
        """Write structure, contacts and estimate of a case for other programs.

        Args:
            form: File format, as for `tiswarm.export`.
            out: Folder to write to; `export` in the run's folder if None.
            case: Case; the largest if None.
            color: Values that color robots, as `tiswarm.view` takes them.
            overwrite: Whether to replace files that exist.
            quiet: Whether to hide progress.

        Returns:
            The folder with the files.
        """
        from tiswarm.app.formats import check_export, export_view  # noqa: PLC0415 - slow to import
        from tiswarm.report.swarm_view import read_case_view  # noqa: PLC0415 - slow to import

        folder = as_path(out or self.folder / "export", "out")
        outputs = Outputs(inputs=[self.folder / "cases"], overwrite=overwrite)
        check_export(form, folder, outputs)
        shown = read_case_view(self._data(color, case).choose(case))
        export_view(shown, form, folder, ConsoleProgress(quiet=quiet), outputs)
        return folder

    def _data(self, color: Color = (), case: str | None = None) -> "RunData":
        from tiswarm.formats.colors import colored  # noqa: PLC0415 - slow to import
        from tiswarm.report.run_data import load_run  # noqa: PLC0415 - slow to import

        run = load_run(self.folder)
        return colored(run, color, case) if len(color) else run

    @property
    def answer(self) -> "pd.DataFrame":
        """The answer to the question of the scenario, a table: what `run` prints at its end."""
        return self._headline(self._labeled_table(), with_verdicts=True).frame

    def __str__(self) -> str:
        """Write the first table of the page, or how many cases parts lack."""
        from tiswarm.report.page_tables import console_text, statement_of  # noqa: PLC0415

        if self.missing:
            return f"this part is done; other parts still lack {counted(self.missing, 'case')}"
        table = self._labeled_table()
        if not table["cases"].any():
            return "no case was finished"
        text = console_text(self._headline(table, with_verdicts=True))
        statement = statement_of(self._data().summary)
        return "\n".join(filter(None, [statement, text]))

    def _repr_html_(self) -> str:
        if self.missing:
            return html.escape(str(self))
        page = self.page
        name = html.escape(self.folder.name)
        link = f'<a href="{quote(page.as_posix())}">{name}</a>' if page.is_file() else name
        return link + self.paper_table().to_html(index=False)


def open_run(folder: File) -> Run:
    """Open the folder of a run.

    Raises:
        InputError: it is not the folder of a run.
    """
    run = Run(as_path(folder, "folder"))
    if not (run.folder / "table.csv").is_file():
        raise InputError("is no run folder with results; name one", path=run.folder)
    return run


def as_path(file: File, argument: str) -> Path:
    """Return the path of a file or folder, or refuse an argument that names none.

    Raises:
        InputError: the argument is of another type, or has a NUL character.
    """
    try:
        path = Path(file)
    except TypeError as error:
        problem = f"a value of type {type(file).__name__} is no file; give the path of one"
        raise InputError(problem, argument=argument) from error
    if "\0" in str(path):
        problem = "the path has a NUL character, as no file may have; delete it"
        raise InputError(problem, argument=argument)
    return path


def plain(values: Mapping[str, object]) -> dict[str, object]:
    """Convert values to plain data, with lists and numbers for arrays and scalars of NumPy."""
    plain_values: dict[str, object] = {}
    for key, value in values.items():
        try:
            plain_values[key] = json.loads(json.dumps(value, default=_from_numpy))
        except (TypeError, ValueError) as error:
            problem = f"{error}; give numbers, strings, lists or dictionaries"
            raise InputError(problem, key=key) from error
    return plain_values


def as_section(settings: object, key: str) -> object:
    """Write a section of a scenario as plain data; `key` selects which settings it has."""
    if isinstance(settings, str):
        return {key: settings}
    if is_dataclass(settings):
        return asdict(settings() if isinstance(settings, type) else settings)
    return settings


def as_texts(overrides: Overrides) -> Sequence[str]:
    """Write overrides as texts `KEY=VALUE`."""
    if isinstance(overrides, Mapping):
        return [f"{key}={json.dumps(value)}" for key, value in plain(overrides).items()]
    return overrides


def _from_numpy(value: object) -> object:
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"is of type {type(value).__name__}")
