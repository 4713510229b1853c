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
from tiswarm.app.inspection import Findings
from tiswarm.app.results import (
    Color,
    CueChoice,
    File,
    Overrides,
    PageFile,
    as_path,
    as_texts,
    plain,
)
from tiswarm.base.aliases import Reals
from tiswarm.base.errors import warn
from tiswarm.base.params import METHOD, AnyArch, AnyPrecision
from tiswarm.records.estimate import Estimate, refuse_distance
from tiswarm.records.messages import counted
from tiswarm.records.outputs import Outputs
from tiswarm.records.positions import read_estimate, read_positions_of, write_estimate
from tiswarm.records.sensing_file import read_sensing_log, write_sensing_log
from tiswarm.records.sensing_log import SensingLog

if TYPE_CHECKING:
    from tiswarm.localization.methods import LocalizationParams
    from tiswarm.measurements.advice.further import AdviceTable
    from tiswarm.report.explanation import Explanation
    from tiswarm.report.swarm_view import Coloring, SwarmView

Truth = Reals | File | None
"""True centers [log unit] in join order, shape (N, 3), or their table; None where unknown."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Log(SensingLog):
    """A sensing log that knows its file, and localizes and shows its robots."""

    path: Path = Path("sensing log")
    """Name of the log in messages and on pages: its file, if it has one."""

    structure: str = ""
    """Digest of the grown structure that sensed it; empty for a log of a file."""

    @classmethod
    def of(cls, log: SensingLog, path: Path = path, structure: str = structure) -> "Log":
        """Make a log of what was sensed, by its name in messages, unless it is one."""
        if isinstance(log, Log):
            return log
        return cls(**_fields(SensingLog, log), path=path, structure=structure)

    def write(self, out: File = "sensing.jsonl", *, overwrite: bool = False) -> Path:
        """Write the log to a file, which `tiswarm.read_log` reads; return its path.

        Raises:
            InputError: the file exists, and is to stay.
        """
        path = as_path(out, "out")
        outputs = Outputs(overwrite=overwrite)
        outputs.check({"out": path})
        write_sensing_log(self, path, opened=outputs.opened)
        return path

    def localize(
        self,
        method: str = METHOD,
        *,
        cues: CueChoice = None,
        overrides: Overrides = (),
        solution: int | None = None,
        arch: AnyArch = "cpu",
        threads: int | None = None,
        precision: AnyPrecision = "auto",
        within: float | None = None,
        quiet: bool = True,
        **settings: object,
    ) -> "Localized":
        """Estimate the robots' positions; `tiswarm.localize` explains the arguments."""
        from tiswarm.compute import backend  # noqa: PLC0415 - slow to import
        from tiswarm.localization import methods  # noqa: PLC0415 - slow to import

        if within is not None:
            refuse_distance(within)
        params = method_params(method, cues, overrides, settings)
        progress = ConsoleProgress(quiet=quiet)
        running = methods.start_device([params], arch, threads=threads, precision=precision)
        if arch != "cpu":
            progress.info(methods.where([params], running))
        name = "compile, localize" if backend.current().is_cold else "localize"
        with progress.task(name, self.robot_count) as advance:
            estimate = methods.localize(self, params, on_progress=advance)
        localized = self.with_estimate(replace(estimate, tolerance=within))
        localized = replace(localized, method=method)
        if solution is not None:
            localized = localized.with_solution(solution)
        if localized.findings.doubt:
            warn(localized.findings.doubt)
        return localized

    def with_estimate(
        self, estimate: Estimate | File | None = None, *, quiet: bool = True
    ) -> "Localized":
        """Join an estimate, or its table, to its log; `joint` localizes the log if None."""
        if estimate is None:
            return self.localize(quiet=quiet)
        if isinstance(estimate, Localized):
            return replace(estimate, log=self)
        table = None
        if not isinstance(estimate, Estimate):
            table = as_path(estimate, "estimate")
            estimate = read_estimate(self, table)
        return Localized(**_fields(Estimate, estimate), log=self, table=table)

    def colorings(self, color: Color) -> "tuple[Coloring, ...]":
        """Read values that color robots, in join order."""
        from tiswarm.formats.colors import read_colorings  # noqa: PLC0415 - slow to import

        return read_colorings(color, self.robot_id) if len(color) else ()

    def positions(self, truth: Truth) -> Reals | None:
        """Read true centers [log unit] in join order, shape (N, 3), unless they are an array."""
        if truth is None or isinstance(truth, np.ndarray):
            return truth
        return read_positions_of(self, as_path(truth, "truth"))


_USUAL_NAME = "sensing"
"""Name of logs that runs and imports write, so that their folder matters."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Localized(Estimate):
    """An estimate with its log: it explains and shows itself, and prints as its findings."""

    log: Log
    """Log that the estimate is of."""

    table: Path | None = None
    """Table that the positions were read from, if they were."""

    method: str = ""
    """Name of the method; empty where the positions were read from a table."""

    chosen: int | None = None
    """Number of the solution that the positions are, counted from 1; None for the mean of all."""

    @property
    def title(self) -> str:
        """Heading of its page: solution, log, number of robots, and method."""
        path = self.log.path
        is_usual = path.name.partition(".")[0] == _USUAL_NAME
        folder = path.absolute().parent.name if is_usual else ""
        log = f"{folder}/{path.name}" if folder else path.name
        by = f" by {self.method}" if self.method else ""
        return f"{self.findings.solution}{log}, {counted(self.robot_count, 'robot')}{by}"

    @cached_property
    def findings(self) -> Findings:
        """The estimate in words: whether to trust it, and what the log leaves unknown."""
        return Findings(self.log, self.log.path, self, chosen=self.chosen)

    @property
    def advice(self) -> "AdviceTable":
        """Further measurements that would constrain most robots."""
        return self.findings.advice

    def explain(self, robot: int) -> "Explanation":
        """Say how the measurements of one robot, by its name, narrow the places it may have."""
        from tiswarm.report.explanation import explain  # noqa: PLC0415 - slow to import

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

    def write(self, out: File = "estimate.csv", *, overwrite: bool = False) -> Path:
        """Write the table of positions; return its path.

        Raises:
            InputError: the file is the log, or exists and is to stay.
        """
        path = as_path(out, "out")
        outputs = self._outputs(overwrite=overwrite)
        outputs.check({"out": path})
        write_estimate(path, self, opened=outputs.opened)
        return path

    def view(
        self,
        truth: Truth = None,
        *,
        explain: Sequence[int] = (),
        color: Color = (),
        out: File = "view.html",
        overwrite: bool = False,
    ) -> PageFile:
        """Write a page with a 3D view, the uncertainty, and what the log leaves open.

        Args:
            truth: True positions or their table, or true centers [log unit], shape (N, 3).
            explain: Names of robots: the page shows how measurements place each; the one that is
                least certain if none.
            color: Values that color robots, as `tiswarm.view` takes them.
            out: Page to write.
            overwrite: Whether to replace files that exist.

        Returns:
            The page, which a notebook shows.
        """
        from tiswarm.app.drawing import draw_log  # noqa: PLC0415 - slow to import
        from tiswarm.report.explanation import show  # noqa: PLC0415 - slow to import

        page = as_path(out, "out")
        outputs = self._outputs(truth, overwrite=overwrite)
        outputs.check({"out": page})
        findings = self.findings
        figures = show(self.log, self, explain)
        draw_log(
            page,
            self.log,
            self,
            name=self.title,
            true=self.log.positions(truth),
            warnings=findings.warnings,
            notes=findings.notes,
            advice=findings.advice,
            figures=figures,
            user_colorings=self.log.colorings(color),
            outputs=outputs,
        )
        return PageFile(page)

    def export(
        self,
        form: str = "gltf",
        truth: Truth = None,
        *,
        color: Color = (),
        out: File = "export",
        overwrite: bool = False,
        quiet: bool = False,
    ) -> Path:
        """Write structure, contacts and estimate for other programs.

        Args:
            form: File format, as for `tiswarm.export`.
            truth: True positions or their table, or true centers [log unit], shape (N, 3).
            color: Values that color robots, as `tiswarm.view` takes them.
            out: Folder to write to.
            overwrite: Whether to replace files that exist.
            quiet: Whether to hide progress.

        Returns:
            The folder with the files.
        """
        from tiswarm.app.formats import check_export, export_view  # noqa: PLC0415 - slow to import

        folder = as_path(out, "out")
        outputs = self._outputs(truth, overwrite=overwrite)
        check_export(form, folder, outputs)
        shown = self._shown(truth, color)
        export_view(shown, form, folder, ConsoleProgress(quiet=quiet), outputs)
        return folder

    def _outputs(self, truth: Truth = None, *, overwrite: bool) -> Outputs:
        """Say what may be written beside the files of log, estimate and truth."""
        return Outputs(inputs=[self.log.path, self.table, truth], overwrite=overwrite)

    def _shown(self, truth: Truth, color: Color) -> "SwarmView":
        from tiswarm.report.swarm_view import view_log  # noqa: PLC0415 - slow to import

        colorings = self.log.colorings(color)
        return view_log(self.log, self, self.log.positions(truth), user_colorings=colorings)


def method_params(
    method: str, cues: CueChoice, overrides: Overrides, settings: Mapping[str, object]
) -> "LocalizationParams":
    """Check the settings of a method; `tiswarm.localize` explains the arguments."""
    from tiswarm.scenario.validation import localization_params  # noqa: PLC0415 - slow to import

    chosen = plain(cues) if isinstance(cues, Mapping) else cues
    return localization_params(method, as_texts(overrides), cues=chosen, values=plain(settings))


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
