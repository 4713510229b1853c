"""Results of a run as a caller has them: tables as data frames, figures that notebooks show."""

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from tiswarm.errors import InputError
from tiswarm.records.messages import did_you_mean

if TYPE_CHECKING:
    import pandas as pd

File = str | PathLike[str]
"""Path of a file or folder."""

_MOST_NAMED = 9
"""Names that an error lists."""


@dataclass(frozen=True)
class Figure:
    """A picture of a run; notebooks show it."""

    path: Path

    def _repr_png_(self) -> bytes:
        return self.path.read_bytes()


class Figures(dict[str, Figure]):
    """Pictures by name."""

    @classmethod
    def of(cls, paths: Iterable[Path]) -> "Figures":
        """Name pictures after their files."""
        return cls((path.stem, Figure(path)) for path in sorted(paths))

    def __missing__(self, name: str) -> Figure:
        """Refuse a name that is not among these."""
        choose(name, [*self], "name")
        raise KeyError(name)


@dataclass(frozen=True)
class Run:
    """Results of a run, as data frames and figures."""

    folder: Path

    @property
    def table(self) -> "pd.DataFrame":
        """Results by condition, `table.csv`."""
        return self.frame("table")

    @property
    def summary(self) -> "pd.DataFrame":
        """Results by case, with the reason of each failure, `summary.csv`."""
        return self.frame("summary")

    def frame(self, name: str, *, case: str | None = None) -> "pd.DataFrame":
        """Read another table of the run, or one of a case.

        Raises:
            InputError: the run has no table or case of that name; names those that it has.
        """
        from tiswarm.records.frames import read_frame  # noqa: PLC0415 - slow to import

        cases = [path.name for path in sorted(self.folder.glob("cases/*"))]
        if case is not None:
            choose(case, cases, "case")
        folder = self.folder if case is None else self.folder / "cases" / case
        choose(name, [path.stem for path in sorted(folder.glob("*.csv"))], "name")
        return read_frame(folder / f"{name}.csv", empty=True)

    @property
    def figures(self) -> Figures:
        """Figures and renders by name; none after a run without pictures."""
        return Figures.of([*self.folder.glob("figures/*.png"), *self.folder.glob("renders/*.png")])

    def _repr_html_(self) -> str:
        page, table = self.folder / "report.html", self.table
        name = html.escape(self.folder.name)
        link = f'<a href="{quote(page.as_posix())}">{name}</a>' if page.exists() else name
        errors = table.filter(["rmse_R_mean", "procrustes_disparity_mean"])
        return link + table.loc[:, :"cases"].join(errors).to_html(index=False)


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
        InputError: the argument is of another type.
    """
    try:
        return Path(file)
    except TypeError as error:
        problem = f"a value of type {type(file).__name__} is no file; give the path of one"
        raise InputError(problem, argument=argument) from error


def choose(name: str, names: Sequence[str], argument: str) -> None:
    """Refuse a name that is not among some."""
    if name not in names:
        some = ", ".join([*names[:_MOST_NAMED], *["..."] * (len(names) > _MOST_NAMED)])
        problem = f"there is no {name!r}; choose one of {some}" if some else f"there is no {name!r}"
        raise InputError(f"{problem}{did_you_mean(name, names)}", argument=argument)
