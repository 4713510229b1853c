"""A log, and an estimate of its robots, as a caller has them: each explains and shows itself.

They are the records of the same content with methods that draw and export. Records stand below the
rooms that do so, and a localizer reads them: so these are classes of their own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tiswarm.app.console import ConsoleProgress
from tiswarm.app.explanation import Explanation, explain, show_one
from tiswarm.app.inspection import AdviceTable, Findings
from tiswarm.app.results import Figures, File, Overrides, PageFile, as_path, as_texts, plain
from tiswarm.base.aliases import Reals
from tiswarm.base.errors import warn
from tiswarm.base.params import AnyArch, AnyPrecision
from tiswarm.base.parts import load
from tiswarm.records.estimate import Estimate
from tiswarm.records.positions import read_estimate, read_positions_of, write_estimate
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.records.sensing_log import SensingLog

if TYPE_CHECKING:
    from tiswarm.localization.params import LocalizationParams
    from tiswarm.report.swarm_view import SwarmView

Truth = Reals | File | None
"""True centers [log unit] in join order, shape (N, 3), or their table; None where unknown."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Log(SensingLog):
    """A sensing log that knows its file, and localizes and shows its robots."""

    path: Path = Path("sensing log")
    """Name of the log in messages and on pages: its file, if it has one."""

    @classmethod
    def of(cls, log: SensingLog) -> "Log":
        """Make a log of what was sensed, unless it is one."""
        return log if isinstance(log, Log) else cls(**_fields(SensingLog, log))

    def localize(
        self,
        method: str = "joint",
        *,
        cues: Sequence[str] | None = None,
        overrides: Overrides = (),
        solution: int | None = None,
        arch: AnyArch = "cpu",
        threads: int | None = None,
        precision: AnyPrecision = "auto",
        quiet: bool = True,
        **settings: object,
    ) -> "Localized":
        """Estimate the robots' positions; `tiswarm.localize` explains the arguments."""
        from tiswarm.compute import backend  # noqa: PLC0415 - slow to import
        from tiswarm.localization import registry  # noqa: PLC0415 - slow to import

        params = method_params(method, cues, overrides, settings)
        progress = ConsoleProgress(quiet=quiet)
        titles = [registry.title(params)]
        running = registry.start_device(titles, arch, threads=threads, precision=precision)
        if arch != "cpu":
            progress.info(registry.where(titles, running))
        name = "compile, localize" if backend.current().is_cold else "localize"
        with progress.task(name, self.robot_count) as advance:
            found = self.with_estimate(registry.localize(self, params, on_progress=advance))
        if solution is not None:
            found = found.with_solution(solution)
        if doubt := found.findings.doubt:
            warn(doubt)
        return found

    def with_estimate(
        self, estimate: Estimate | File | None = None, *, quiet: bool = True
    ) -> "Localized":
        """Join an estimate, or its table, to its log; `joint` localizes the log if None."""
        if estimate is None:
            return self.localize(quiet=quiet)
        if isinstance(estimate, Localized):
            return replace(estimate, log=self)
        if not isinstance(estimate, Estimate):
            estimate = read_estimate(self, as_path(estimate, "estimate"))
        return Localized(**_fields(Estimate, estimate), log=self)

    def view(
        self,
        estimate: Estimate | File | None = None,
        truth: Truth = None,
        *,
        out: File = "view.html",
        quiet: bool = True,
    ) -> PageFile:
        """Write a page with a 3D view of an estimate; `joint` localizes the log if None."""
        true = self.positions(truth)  # a mistake in it is found before the log is localized
        return self.with_estimate(estimate, quiet=quiet).view(true, out=out)

    def render(
        self,
        estimate: Estimate | File | None = None,
        truth: Truth = None,
        *,
        renderer: str | None = None,
        out: File = "renders",
        quiet: bool = False,
    ) -> Figures:
        """Draw 3D pictures of an estimate; `joint` localizes the log if None."""
        true = self.positions(truth)
        found = self.with_estimate(estimate, quiet=quiet)
        return found.render(true, renderer=renderer, out=out, quiet=quiet)

    def export(
        self,
        form: str = "gltf",
        estimate: Estimate | File | None = None,
        truth: Truth = None,
        *,
        out: File = "export",
        quiet: bool = False,
    ) -> Path:
        """Write structure, contacts and an estimate for other programs.

        `joint` localizes the log if there is no estimate.
        """
        true = self.positions(truth)
        found = self.with_estimate(estimate, quiet=quiet)
        return found.export(form, true, out=out, quiet=quiet)

    def positions(self, truth: Truth) -> Reals | None:
        """Read true centers [log unit] in join order, shape (N, 3), unless they are an array."""
        if truth is None or isinstance(truth, np.ndarray):
            return truth
        return read_positions_of(self, as_path(truth, "truth"))


@dataclass(frozen=True, kw_only=True, repr=False)
class Localized(Estimate):
    """An estimate with its log: it explains and shows itself, and prints as its findings."""

    log: Log
    """Log that the estimate is of."""

    chosen: int | None = None
    """Number of the solution that the positions are, counted from 1; None for the mean of all."""

    @cached_property
    def findings(self) -> Findings:
        """The estimate in words: whether to trust it, and what the log leaves unknown."""
        return Findings(self.log, self.log.path, self, chosen=self.chosen)

    @property
    def advice(self) -> AdviceTable:
        """Further measurements that would constrain most robots."""
        return self.findings.advice

    def explain(self, robot: int) -> Explanation:
        """Say how the measurements of one robot, by its name, narrow the places it may have."""
        return explain(self.log, self, robot)

    def __str__(self) -> str:
        """Say in lines what the log leaves unknown, and whether to trust the estimate."""
        return str(self.findings)

    def with_solution(self, number: int) -> "Localized":
        """Return the positions and sd of one solution, counted from 1, without the mean's yaw.

        Raises:
            InputError: there is no such solution.
        """
        return replace(self.log.with_estimate(super().with_solution(number)), chosen=number)

    def write(self, out: File = "estimate.csv") -> Path:
        """Write the table of positions; return its path."""
        path = as_path(out, "out")
        write_estimate(path, self)
        return path

    def view(self, truth: Truth = None, *, out: File = "view.html") -> PageFile:
        """Write a page with a 3D view, the uncertainty, and what the log leaves open.

        Args:
            truth: Table of true positions, or true centers [log unit], shape (N, 3).
            out: Page to write.

        Returns:
            The page, which a notebook shows.
        """
        from tiswarm.app.drawing import draw_log  # noqa: PLC0415 - slow to import

        page, findings = as_path(out, "out"), self.findings
        draw_log(
            page, self.log, self, name=f"{findings.solution}{self.log.path.name}",
            true=self.log.positions(truth), warnings=findings.warnings, notes=findings.notes,
            advice=findings.advice, figures=show_one(self.log, self),
        )  # fmt: skip
        return PageFile(page)

    def render(
        self,
        truth: Truth = None,
        *,
        renderer: str | None = None,
        out: File = "renders",
        quiet: bool = False,
    ) -> Figures:
        """Draw 3D pictures into a folder.

        Args:
            truth: Table of true positions, or true centers [log unit], shape (N, 3).
            renderer: "open3d" or "taichi"; the first that works if None.
            out: Folder to write to.
            quiet: Whether to hide progress.

        Returns:
            The pictures by name.
        """
        from tiswarm.app.drawing import render_log  # noqa: PLC0415 - slow to import

        shown, progress = self._shown(truth), ConsoleProgress(quiet=quiet)
        return Figures.of(render_log(shown, as_path(out, "out"), progress, renderer=renderer))

    def export(
        self,
        form: str = "gltf",
        truth: Truth = None,
        *,
        out: File = "export",
        quiet: bool = False,
    ) -> Path:
        """Write structure, contacts and estimate for other programs.

        Args:
            form: File format.
            truth: Table of true positions, or true centers [log unit], shape (N, 3).
            out: Folder to write to.
            quiet: Whether to hide progress.

        Returns:
            The folder with the files.
        """
        export_view = load("tiswarm.interop.exports:export_view", f"format {form}")
        folder = as_path(out, "out")
        export_view(self._shown(truth), form, folder, ConsoleProgress(quiet=quiet))
        return folder

    def _shown(self, truth: Truth) -> "SwarmView":
        from tiswarm.report.swarm_view import view_log  # noqa: PLC0415 - slow to import

        return view_log(self.log, self, self.log.positions(truth))


def method_params(
    method: str, cues: Sequence[str] | None, overrides: Overrides, settings: Mapping[str, object]
) -> "LocalizationParams":
    """Check the settings of a method; `tiswarm.localize` explains the arguments."""
    from tiswarm.scenario.validation import localization_params  # noqa: PLC0415 - slow to import

    return localization_params(method, as_texts(overrides), cues=cues, values=plain(settings))


def open_log(log: SensingLog | File) -> Log:
    """Read a log, unless it is one.

    Raises:
        InputError: the file cannot be read or a line is malformed, with file, line and key.
    """
    if isinstance(log, SensingLog):
        return Log.of(log)
    path = as_path(log, "log")
    return Log(**_fields(SensingLog, read_sensing_log(path)), path=path)


def _fields(kind: type, record: object) -> dict[str, Any]:
    """Take the fields of a record that its class or a base class has."""
    return {field.name: getattr(record, field.name) for field in fields(kind)}
