"""Grown structures as a caller has them: arrays; they sense, score, show and save themselves.

swarms = tiswarm.grow("tower", robots=100, seeds=8)
swarms.position, swarms[0].position                 # of all structures, of one
estimates = [log.localize() for log in swarms.sense(tilt_noise_deg=1.0)]
swarms.score(estimates)
"""

import math
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar, overload

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tiswarm.app.console import ConsoleProgress
from tiswarm.app.formats import check_export, export_view
from tiswarm.app.growing import LiveProgress
from tiswarm.app.logs import Localized, Log
from tiswarm.app.navigation import Navigation
from tiswarm.app.results import Figures, File, PageFile, Section, as_path, as_section, plain
from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.base.errors import InputError, require_name, warn
from tiswarm.base.params import METHOD, AnyMovie
from tiswarm.compute import backend
from tiswarm.evaluation import tables
from tiswarm.measurements.cues import cue_names
from tiswarm.records.io import DAMAGED, open_input
from tiswarm.records.measures import (
    BROKEN,
    DISPARITY,
    HEIGHT,
    JOINED,
    MARGIN,
    PEAK_STRESS,
    REACH,
    RMSE,
    STANDING,
)
from tiswarm.records.messages import counted
from tiswarm.records.outputs import Outputs
from tiswarm.report.page import Page
from tiswarm.report.page_tables import MOST_ROWS, PageTable
from tiswarm.report.swarm_view import (
    MOST_ROBOTS,
    Coloring,
    SwarmView,
    View,
    space_data,
    view_data,
)
from tiswarm.scenario.expansion import load_scenario
from tiswarm.scenario.model import Scenario, dump_scenario, to_plain
from tiswarm.scenario.yaml_source import parse_yaml
from tiswarm.sensing import SensingParams, observe
from tiswarm.study.navigation import Place, navigate
from tiswarm.world import growth
from tiswarm.world.ground.surface import shown_ground
from tiswarm.world.history import History, StanceRows
from tiswarm.world.history_file import find_fault, from_arrays, to_arrays

_Value = TypeVar("_Value", bound=np.generic)

FORMAT = "tiswarm-swarms 1"
"""First entry of a file of structures."""

_SHOWN = [
    "seed",
    JOINED.column,
    HEIGHT.column,
    REACH.column,
    PEAK_STRESS.column,
    "growth_rounds",
    "ended",
]
"""Columns of the table that structures print."""

_MOST_ROWS = 10
"""Rows of that table."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GrownStructure(History):
    """The history of a structure of N robots, in join order, with what can be done with it."""

    scenario: Scenario
    """Settings that it was grown by."""

    @classmethod
    def of(cls, history: History, scenario: Scenario) -> "GrownStructure":
        """Take a history that was grown by the settings of a scenario."""
        values = {entry.name: getattr(history, entry.name) for entry in fields(History)}
        return cls(**values, scenario=scenario)

    @property
    def history(self) -> History:
        """All stances of all robots, and the loads after each join: the structure itself."""
        return self

    @property
    def name(self) -> str:
        """Kind and seed."""
        return f"{self.scenario.structure.kind}-seed-{self.seed}"

    @cached_property
    def digest(self) -> str:
        """Sixteen hex digits of the seed and of where robots stand, which its logs state."""
        content = [np.int64(self.seed), self.position, self.orientation_wxyz, self.contacts]
        digest = sha256()
        for array in content:
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()[:16]

    @property
    def growth(self) -> pd.DataFrame:
        """Size and loads after each join, `growth.csv` of a run."""
        return tables.by_join(self)

    @property
    def load_table(self) -> pd.DataFrame:
        """Loads of each contact in the end, from the weakest contact on, `loads.csv` of a run.

        Margins are NaN where docks hold any load.
        """
        return tables.by_contact(self, self.scenario.structure.strength)

    @cached_property
    def totals(self) -> Mapping[str, float | int | str]:
        """Size and loads in the end by name, as in `summary.csv` of a run; rounds and flips."""
        return {
            "seed": self.seed,
            JOINED.column: self.robot_count,
            **tables.totals(self),
            "flips": int(self.flips.sum()),
            "growth_rounds": int(self.join_round[-1]) + 1,
            "ended": self.ended,
        }

    def sense(self, **settings: object) -> Log:
        """Sense the structure; `Swarms.sense` explains the arguments."""
        return _sense(self, _sensing(self.scenario, settings))

    def score(self, estimate: Localized) -> dict[str, float]:
        """Compare an estimate with the structure; `Swarms.score` explains it."""
        return _score(self, estimate)

    def view(self, out: File = "view.html", *, overwrite: bool = False) -> PageFile:
        """Write a page with a 3D view; `Swarms.view` explains the arguments."""
        return self._alone.view(out, overwrite=overwrite)

    def render(
        self,
        out: File = "renders",
        *,
        renderer: str | None = None,
        movie: AnyMovie | None = None,
        overwrite: bool = False,
        quiet: bool = False,
    ) -> Figures:
        """Draw 3D pictures into a folder.

        Args:
            out: Folder to write to.
            renderer: "open3d" or "taichi"; the first that works if None.
            movie: File format of an animation of the growth; none if None.
            overwrite: Whether to replace files that exist.
            quiet: Whether to hide progress.

        Returns:
            The pictures by name.

        Raises:
            InputError: there is no such renderer, or a picture exists and is to stay.
            EnvironmentTroubleError: the folder cannot be made, or the renderer does not work.
        """
        from tiswarm.report.pictures.pictures import picture_files  # noqa: PLC0415 - slow to import

        folder = as_path(out, "out")
        outputs = Outputs(overwrite=overwrite)
        for form in ("png", movie):
            if form:
                check_export(form, folder, outputs, "structure")
        progress = ConsoleProgress(quiet=quiet)
        files = picture_files(self._shown(), progress, renderer=renderer, movie=movie)
        written = outputs.write_folder(folder, files)
        for path in written:
            progress.info(str(path))
        return Figures.of(written)

    def export(
        self,
        form: str = "gltf",
        *,
        out: File = "export",
        overwrite: bool = False,
        quiet: bool = False,
    ) -> Path:
        """Write the structure and its contacts for other programs; return the folder.

        Args:
            form: File format, as for `tiswarm.export`.
            out: Folder to write to.
            overwrite: Whether to replace files that exist.
            quiet: Whether to hide progress.

        Raises:
            InputError: there is no such format, or a file exists and is to stay.
            EnvironmentTroubleError: the folder cannot be made, or a library is missing.
        """
        folder = as_path(out, "out")
        outputs = Outputs(overwrite=overwrite)
        check_export(form, folder, outputs, "structure")
        export_view(self._shown(), form, folder, ConsoleProgress(quiet=quiet), outputs)
        return folder

    def save(self, path: File = "swarms.npz", *, overwrite: bool = False) -> Path:
        """Write the structure to a file; `Swarms.save` explains the arguments."""
        return self._alone.save(path, overwrite=overwrite)

    @property
    def _alone(self) -> "Swarms":
        return Swarms([self], self.scenario)

    def _shown(self) -> SwarmView:
        unknown = np.full((self.robot_count, 7), np.nan)
        unit = self.robot.dock_radius
        pose = np.column_stack([self.position / unit, self.orientation_wxyz])
        return SwarmView(
            name=self.name,
            robot=np.arange(self.robot_count),
            pose=np.where(self.is_gone[:, None], np.nan, pose),  # robots that left are not shown
            estimated_pose=unknown,
            error=unknown[:, 0],
            force=self.sensed_load,
            margin=self.margin,
            sd=unknown[:, 0],
            stood=pose,
            dock_offset_body=self.robot.dock_offset_body / unit,
            terrain=shown_ground(self),
            read_log=lambda: observe(self, SensingParams()),
            read_loads=self._read_loads,
        )

    def _read_loads(self) -> pd.DataFrame | None:
        """Return the loads of contacts; None where docks hold any load."""
        return None if self.scenario.structure.strength is None else self.load_table

    def __str__(self) -> str:
        """Describe the structure in a line."""
        return str(self._alone)

    __repr__ = __str__


class Swarms(Sequence[GrownStructure]):
    """S grown structures of up to N robots: a batch with arrays, and a sequence of structures.

    Arrays of all robots have the shape (S, N, ...). Where growth ended early, and fewer robots
    joined, real numbers are NaN, integers are -1 and truth values are False. Lists of contacts and
    docks have a row for each, which starts with the index of the structure in the batch.
    """

    def __init__(self, swarms: Sequence[GrownStructure], scenario: Scenario) -> None:
        """Take structures that were grown by the settings of a scenario."""
        self._swarms = tuple(swarms)
        self.scenario = scenario

    def __len__(self) -> int:
        """S."""
        return len(self._swarms)

    @overload
    def __getitem__(self, index: int) -> GrownStructure: ...
    @overload
    def __getitem__(self, index: slice) -> "Swarms": ...
    def __getitem__(self, index: int | slice) -> "GrownStructure | Swarms":
        """Return one structure, or a batch of some."""
        if isinstance(index, slice):
            return Swarms(self._swarms[index], self.scenario)
        return self._swarms[index]

    def __iter__(self) -> Iterator[GrownStructure]:
        """Yield the structures in the order of their seeds."""
        return iter(self._swarms)

    @property
    def seed(self) -> Ints:
        """Seed of each structure, shape (S,)."""
        return np.array([structure.seed for structure in self], np.int64)

    @property
    def robot_count(self) -> Ints:
        """Robots that joined each structure, shape (S,)."""
        return np.array([structure.robot_count for structure in self], np.int64)

    @property
    def ended(self) -> list[str]:
        """Reason why growth of each structure stopped early; empty where it did not."""
        return [structure.ended for structure in self]

    @property
    def height(self) -> Reals:
        """Height of the highest center above the ground [R], shape (S,)."""
        return self._total(HEIGHT.column)

    @property
    def reach(self) -> Reals:
        """Largest x of any center [R], shape (S,)."""
        return self._total(REACH.column)

    @property
    def position(self) -> Reals:
        """Final centers [R], shape (S, N, 3)."""
        return self._padded(lambda structure: structure.position)

    @property
    def orientation_wxyz(self) -> Reals:
        """Final orientations, body to world, shape (S, N, 4)."""
        return self._padded(lambda structure: structure.orientation_wxyz)

    @property
    def join_round(self) -> Ints:
        """Round of growth in which each robot joined, from 0, shape (S, N).

        In a round, every robot that climbs walks until it joins, is turned away, or an earlier join
        of the round disturbs its walk.
        """
        return self._padded(lambda structure: structure.join_round)

    @property
    def leave_round(self) -> Ints:
        """Round in which each robot left, fell or died; -1 if none, shape (S, N).

        Rounds in which robots of a complete structure act follow those of growth.
        """
        return self._padded(lambda structure: structure.leave_round)

    @property
    def departures(self) -> Ints:
        """Who left, fell or died, shape (D, 4).

        Rows of (structure, robot, robots that had joined by then, event); the event is 0 if the
        robot left, 1 if it fell as others left, and 2 if it died where it stands.
        """
        return self._rows(lambda structure: structure.departures)

    @property
    def is_gone(self) -> Bools:
        """Whether each robot left or fell; positions are then where it last stood, shape (S, N)."""
        return self._padded(lambda structure: structure.is_gone)

    @property
    def flips(self) -> Ints:
        """Flips of each robot, the way back to its best stance included, shape (S, N)."""
        return self._padded(lambda structure: structure.flips)

    @property
    def is_anchor(self) -> Bools:
        """Whether the position of each robot is known to all, shape (S, N)."""
        return self._padded(lambda structure: structure.is_anchor)

    @property
    def is_recruited(self) -> Bools:
        """Whether each robot stays because it was called for, shape (S, N)."""
        return self._padded(lambda structure: structure.is_recruited)

    @property
    def sensed_load(self) -> Reals:
        """Load that each robot senses in its links in the end [weight of a dock], shape (S, N)."""
        return self._padded(lambda structure: structure.sensed_load)

    @property
    def peak_stress(self) -> Reals:
        """Largest stress in any contact after each join [weight of a dock / R^2], shape (S, N).

        NaN where the mechanics were not solved after that join.
        """
        return self._padded(lambda structure: structure.peak_stress)

    @property
    def margin(self) -> Reals:
        """Least strength of a robot's contacts in parts of their load in the end [1], shape (S, N).

        NaN of robots without contacts, and where docks hold any load.
        """
        return self._padded(lambda structure: structure.margin)

    @property
    def stability(self) -> list[str]:
        """Whether each structure on docks that rest stands, tipped or slid; empty where held."""
        return [structure.stability for structure in self]

    @property
    def sent(self) -> Ints:
        """Bytes that robots sent by the rule of growth, shape (S, N).

        0 without messages, and of robots that did not join.
        """
        sent = np.zeros((len(self), self.scenario.robots), np.int64)
        for number, structure in enumerate(self):
            sent[number, : len(structure.sent)] = structure.sent
        return sent

    @property
    def broken(self) -> Ints:
        """Contacts that broke, in order, shape (B, 6).

        Rows of (structure, robot, dock, robot, dock, robots that had joined by then), the earlier
        robot first; robot and dock are -1 for the ground.
        """
        return self._rows(lambda structure: structure.broken)

    @property
    def loaded_contacts(self) -> Ints:
        """Contacts when the mechanics were solved last; `contact_load` has their loads.

        Rows of (structure, robot, dock, robot, dock), the earlier robot first; robot and dock are
        -1 for the ground, shape (L, 5).
        """
        return self._rows(lambda structure: structure.loaded_contacts)

    @property
    def contact_load(self) -> Reals:
        """Loads of `loaded_contacts` at rest, shape (L, 6).

        Columns are the pull along a contact, negative where docks press, and the force across it
        [weight of a dock], bending moment and torsion [weight of a dock times R], largest von Mises
        stress [weight of a dock / R^2], and the load in parts of the strength [1], NaN where docks
        hold any load.
        """
        return np.concatenate([structure.contact_load for structure in self])

    @property
    def contacts(self) -> Ints:
        """Docked pairs, rows of (structure, i, dock of i, j, dock of j), i < j, shape (C, 5)."""
        return self._rows(lambda structure: structure.contacts)

    @property
    def ground_docks(self) -> Ints:
        """Docks on flat ground, rows of (structure, robot, dock), shape (G, 3)."""
        return self._rows(lambda structure: structure.ground_docks)

    @property
    def edge_docks(self) -> Ints:
        """Docks on an edge or underside, rows of (structure, robot, dock), shape (E, 3)."""
        return self._rows(lambda structure: structure.edge_docks)

    @property
    def stance_contacts(self) -> Ints:
        """Contacts at each stance of each walk, shape (K, 6).

        Rows of (structure, robot, stance, own dock, other robot, other dock).
        """
        return self._rows(lambda structure: structure.stance_contacts)

    @property
    def stances(self) -> StanceRows:
        """All stances of all robots of all structures."""
        stances = [structure.stances for structure in self]
        rows = [np.concatenate(columns) for columns in zip(*stances, strict=True)]
        number = np.repeat(np.arange(len(self)), [len(of_one.robot) for of_one in stances])
        return StanceRows(number, *rows[1:])

    @property
    def growth(self) -> pd.DataFrame:
        """Size and loads after each join, by seed; columns as in `growth.csv` of a run."""
        return self._by_seed(lambda structure: structure.growth)

    @property
    def load_table(self) -> pd.DataFrame:
        """Loads of each contact in the end, by seed; columns as in `loads.csv` of a run.

        Margins are NaN where docks hold any load.
        """
        return self._by_seed(lambda structure: structure.load_table)

    @property
    def table(self) -> pd.DataFrame:
        """Size and loads of each structure in the end, columns as in `summary.csv` of a run.

        Flips and rounds of growth, `growth_rounds`, stand beside them.
        """
        return pd.DataFrame([structure.totals for structure in self])

    def sense(self, **settings: object) -> list[Log]:
        """Sense each structure; the logs are those of a run with these settings and seeds.

        Args:
            settings: Settings of the section `sensing` of a scenario, such as `tilt_noise_deg`.

        Returns:
            One log a structure.

        Raises:
            InputError: there is no such setting, or its value is invalid.
        """
        params = _sensing(self.scenario, settings)
        return [_sense(structure, params) for structure in self]

    def score(self, estimates: Iterable[Localized]) -> pd.DataFrame:
        """Compare estimates with the structures.

        Args:
            estimates: One for each structure: what `log.localize` returned, or `log.with_estimate`.
                Estimates of logs that structures sensed may have any order. Others, of files, are
                matched by the contacts in their logs; those without contacts need the structures'
                order.

        Returns:
            A row for each structure: its seed, RMSE and disparity, then the other measures of
            `summary.csv` of a run.

        Raises:
            InputError: their number is another, one has no log, or is of another structure, or they
                cannot be matched.
        """
        all_estimates = list(estimates)
        if len(all_estimates) != len(self):
            problem = (
                f"{len(all_estimates)} estimates are not {len(self)}, one for each structure; "
            )
            raise InputError(
                f"{problem}score a part of the batch by its slice", argument="estimates"
            )
        ordered = _matched(self, all_estimates)
        scores = [{"seed": s.seed, **_score(s, e)} for s, e in zip(self, ordered, strict=True)]
        table = pd.DataFrame(scores)
        first = ["seed", RMSE.column, DISPARITY.column]
        return table[[*first, *table.columns.difference(first, sort=False)]]

    def view(self, out: File = "view.html", *, overwrite: bool = False) -> PageFile:
        """Write a page with structures in 3D, colored by loads, and a table of all.

        Args:
            out: File to write.
            overwrite: Whether to replace a file that exists.

        Returns:
            The page, which a notebook shows.

        Raises:
            InputError: the page exists, and is to stay.
        """
        path = as_path(out, "out")
        outputs = Outputs(overwrite=overwrite)
        outputs.check({"out": path})
        outputs.write(path, _page(self).html().encode())
        return PageFile(path)

    def render(self, out: File = "renders", *, seed: int | None = None, **how: Any) -> Figures:  # noqa: ANN401
        """Draw 3D pictures of one structure into a folder.

        Args:
            out: Folder to write to.
            seed: Seed of the structure; the first of the largest if None.
            how: Further arguments of `GrownStructure.render`.
        """
        return self._chosen(seed).render(out, **how)

    def export(self, form: str = "gltf", *, seed: int | None = None, **how: Any) -> Path:  # noqa: ANN401
        """Write one structure for other programs; return the folder.

        Args:
            form: File format, as for `tiswarm.export`.
            seed: Seed of the structure; the first of the largest if None.
            how: Further arguments of `GrownStructure.export`.
        """
        return self._chosen(seed).export(form, **how)

    def save(self, path: File = "swarms.npz", *, overwrite: bool = False) -> Path:
        """Write the batch to a file, which `tiswarm.open_swarms` reads; return its path.

        Args:
            path: File to write, NumPy's `.npz`.
            overwrite: Whether to replace a file that exists.

        Raises:
            InputError: the file exists, and is to stay.
            EnvironmentTroubleError: it cannot be written.
        """
        file = as_path(path, "path")
        outputs = Outputs(overwrite=overwrite)
        outputs.check({"path": file})
        arrays = {"format": np.array(FORMAT), "scenario": np.array(dump_scenario(self.scenario))}
        for number, structure in enumerate(self):
            arrays |= {f"{number}/{name}": v for name, v in to_arrays(structure).items()}
        with outputs.opened(file) as stream, zipfile.ZipFile(stream, "w") as z:
            for name, values in arrays.items():
                # Without a time of its own, an entry has the same bytes each time.
                with z.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as entry:
                    np.lib.format.write_array(entry, values, allow_pickle=False)  # type: ignore[no-untyped-call]
        return file

    def _total(self, name: str) -> Reals:
        return np.array([structure.totals[name] for structure in self], np.float64)

    def _by_seed(self, table_of: Callable[[GrownStructure], pd.DataFrame]) -> pd.DataFrame:
        """Join the tables of all structures, each with its seed in the first column."""
        tables_by_seed = {structure.seed: table_of(structure) for structure in self}
        return pd.concat(tables_by_seed, names=["seed", None]).reset_index(level=0)

    def _padded(self, values_of: Callable[[GrownStructure], NDArray[_Value]]) -> NDArray[_Value]:
        """Stack the values of all robots of each structure, shape (S, N, ...)."""
        robots = self.scenario.robots
        return np.array([_filled(values_of(structure), robots) for structure in self])

    def _rows(self, rows_of: Callable[[GrownStructure], AnyInts]) -> Ints:
        """Join the rows of all structures, each with the index of its structure before it."""
        numbered = [
            np.insert(rows_of(structure), 0, number, axis=1)
            for number, structure in enumerate(self)
        ]
        return np.concatenate(numbered).astype(np.int64)

    def _chosen(self, seed: int | None) -> GrownStructure:
        if seed is None:
            return max(self, key=lambda structure: structure.robot_count)
        require_name(str(seed), [str(choice) for choice in self.seed], "seed")
        return next(structure for structure in self if structure.seed == seed)

    def __str__(self) -> str:
        """Tabulate the structures: robots, height, reach, largest stress, rounds, early ends."""
        table = self._short.to_string(index=False, max_rows=_MOST_ROWS, na_rep="")
        return f"{self._heading}\n{table}"

    __repr__ = __str__

    def _repr_html_(self) -> str:
        table = self._short.to_html(index=False, max_rows=_MOST_ROWS, na_rep="")
        return f"<p>{self._heading}</p>{table}"

    @property
    def _heading(self) -> str:
        kind = self.scenario.structure.kind
        robots = counted(self.scenario.robots, "robot")
        return f"{counted(len(self), 'structure')} ({kind}) of {robots}"

    @property
    def _short(self) -> pd.DataFrame:
        stress = PEAK_STRESS.column
        shown = self.table[_SHOWN].round(1)
        shown = shown.rename(columns={stress: f"{stress} [{PEAK_STRESS.unit}]"})
        return shown if any(self.ended) else shown.drop(columns="ended")


_BY_STRUCTURE = Navigation()
"""Robots that build by what the structure says."""


def growth_scenario(
    structure: Section,
    robots: int,
    seeds: int | Sequence[int],
    *,
    rule: Section | None = None,
    robot: Section | None = None,
    navigation: Navigation = _BY_STRUCTURE,
) -> Scenario:
    """Write a scenario that grows structures, from what `tiswarm.grow` takes.

    Raises:
        InputError: an argument has a mistake.
    """
    kind = as_section(structure, "kind")
    if rule is not None and isinstance(kind, Mapping):
        kind = {**kind, "rule": rule}
    if isinstance(kind, Mapping) and "rule" in kind:
        kind = {**kind, "rule": _as_rule(kind["rule"])}
    sections: dict[str, object] = {"structure": kind, "localization": {"method": METHOD}}
    if isinstance(kind, Mapping):
        sections = navigation.sections(kind)
    if robot is not None:
        sections["robot"] = as_section(robot, "shape")
    if isinstance(seeds, range | tuple):
        seeds = [*seeds]
    return load_scenario(plain({"name": "grow", "robots": robots, "seeds": seeds, **sections}))


def _as_rule(given: Any) -> object:  # noqa: ANN401 - as a caller gives it
    """Write a rule that a caller gives as a name, a class, settings or data, as plain data.

    Raises:
        InputError: it is none of these.
    """
    rule = as_section(given, "name")
    if rule is None or isinstance(rule, Mapping):
        return rule
    named = getattr(given, "__name__", f"a value of type {type(given).__name__}")
    ways = 'its name, {"name": ..., settings}, or a class that @tiswarm.rule(name) decorates'
    raise InputError(f"{named} is no rule; give {ways}", key="structure.rule")


def grow(
    scenario: Scenario,
    *,
    place: Place | None = None,
    threads: int | None,
    quiet: bool,
    live: bool = False,
) -> Swarms:
    """Grow the structures of a scenario; `tiswarm.grow` explains it.

    Args:
        scenario: What to grow.
        place: Places robots that navigate by estimates, in place of the method of the scenario.
        threads: CPU threads; all that this process may use if None.
        quiet: Whether to hide progress.
        live: Whether to show structures while they grow.

    Raises:
        InputError: no robot joined a structure.
    """
    structure = scenario.structure
    backend.choose(threads=threads)
    backend.processor()
    name = "compile, grow" if backend.current().is_cold else "grow"
    seeds = scenario.seed_list
    progress = (
        LiveProgress(quiet=quiet, name=structure.kind) if live else ConsoleProgress(quiet=quiet)
    )
    total = len(seeds) * scenario.robots
    names = [f"seed {seed}" for seed in seeds]
    watched = progress.watch(names, scenario.robots)
    with progress, progress.task(name, total) as advance, watched as watch:
        histories = growth.grow(
            structure,
            robots=scenario.robots,
            seeds=seeds,
            robot=scenario.robot,
            on_progress=advance,
            watch=watch,
            **navigate(scenario, place),
        )
    for history in histories:
        if not history.walks:
            raise InputError(f"seed {history.seed}: no robot joined: {history.ended}")
        fault = find_fault(history, contact_gap=structure.climb.contact_gap)
        if fault:
            warn(f"seed {history.seed}: the structure is invalid: {fault}")
    # A bridge that closes has reached its aim, with any number of robots.
    early = [history for history in histories if history.ended and not history.crossed]
    if early:
        count = counted(len(histories), "structure")
        reasons = {history.ended for history in early}
        more = f" (and {counted(len(reasons) - 1, 'more reason')})" if len(reasons) > 1 else ""
        warn(f"{len(early)} of {count} ended before all robots joined: {early[0].ended}{more}")
    return Swarms([GrownStructure.of(history, scenario) for history in histories], scenario)


def open_swarms(path: Path) -> Swarms:
    """Read structures that were saved; `tiswarm.open_swarms` explains it."""
    try:
        with open_input(path) as file, np.load(file) as entries:
            arrays: dict[str, NDArray[Any]] = dict(entries)
        if str(arrays.pop("format")) != FORMAT:
            raise ValueError("unknown format")
        stated = parse_yaml(str(arrays.pop("scenario"))).data
    except DAMAGED as error:
        problem = "is damaged, or no file of structures; name a file that Swarms.save wrote"
        raise InputError(problem, path=path) from error
    try:
        scenario = load_scenario(stated)
    except InputError as error:
        # A call has no option of the command.
        remedy = "import its file first, or name it in plugins=[...]"
        problem = error.problem.replace("(--plugin FILE)", f"({remedy})")
        raise InputError(problem, path=path, key=error.key) from error
    by_structure: dict[str, dict[str, NDArray[Any]]] = {}
    for name, values in arrays.items():
        number, _, entry = name.partition("/")
        by_structure.setdefault(number, {})[entry] = values
    try:
        if [*by_structure] != [str(number) for number in range(max(1, len(by_structure)))]:
            raise ValueError("not numbered in order")
        histories = [
            from_arrays(entries, scenario.structure, scenario.robot)
            for entries in by_structure.values()
        ]
        for history in histories:
            _refuse_fault(history, scenario)
    except DAMAGED as error:
        problem = "is damaged; grow the structures again, and save them"
        raise InputError(problem, path=path) from error
    return Swarms([GrownStructure.of(history, scenario) for history in histories], scenario)


def _refuse_fault(history: History, scenario: Scenario) -> None:
    """Refuse a structure that growth by a scenario would not leave.

    Raises:
        ValueError: it has more robots, or a robot where none can stand.
    """
    gap = scenario.structure.climb.contact_gap
    fault = find_fault(history, contact_gap=gap)
    if history.robot_count > scenario.robots or fault:
        raise ValueError(fault)


def _sensing(scenario: Scenario, settings: Mapping[str, object]) -> SensingParams:
    """Check settings of sensing as those of a scenario."""
    return load_scenario({**to_plain(scenario), "sensing": plain(settings)}).sensing


def _sense(swarm: GrownStructure, params: SensingParams) -> Log:
    return Log.of(observe(swarm, params), Path(swarm.name), swarm.digest)


def _matched(swarms: Swarms, estimates: Sequence[Localized]) -> list[Localized]:
    """Put estimates into the order of their structures.

    Raises:
        InputError: an estimate is of none of the structures, or two are of the same one.
    """
    estimate_of: dict[int, int] = {}
    for number, estimate in enumerate(estimates):
        structure = _structure_of(swarms, number, estimate)
        if structure in estimate_of:
            numbers = f"{estimate_of[structure]} and {number}"
            problem = f"estimates {numbers} are both of {swarms[structure].name}; give one of each"
            raise InputError(problem, argument="estimates")
        estimate_of[structure] = number
    return [estimates[estimate_of[structure]] for structure in range(len(swarms))]


def _structure_of(swarms: Swarms, number: int, estimate: Localized) -> int:
    """Return the index of the structure that an estimate is of; `number` is its place in a list."""
    log = _log_of(estimate)
    if log.structure:
        digests = [swarm.digest for swarm in swarms]
        if log.structure not in digests:
            raise _other_structure(log)
        return digests.index(log.structure)
    shares = [_shared_contacts(swarm, log) for swarm in swarms]
    largest = max(shares)
    if shares[number] == largest:  # which of equal ones, only the order says
        return number
    if shares.count(largest) > 1:
        problem = f"estimate {number} ({log.path}) may be of several structures, but not of "
        problem += f"{swarms[number].name}; give estimates in the order of structures"
        raise InputError(problem, argument="estimates")
    return shares.index(largest)


def _shared_contacts(swarm: GrownStructure, log: Log) -> float:
    """Return the share of the contacts of a log that a structure has; 0 where there are none."""
    contacts = {*map(tuple, swarm.contacts.tolist())}
    sensed = [tuple(contact) for contact in log.contacts.tolist()]
    return sum(contact in contacts for contact in sensed) / max(len(sensed), 1)


def _other_structure(log: Log) -> InputError:
    problem = f"the estimate of {log.path} is of another structure; give that of one of these"
    return InputError(problem, argument="estimates")


def _log_of(estimate: Localized) -> Log:
    if not isinstance(estimate, Localized):
        problem = (
            f"a value of type {type(estimate).__name__} has no log; give what log.localize or "
        )
        raise InputError(f"{problem}log.with_estimate returned", argument="estimates")
    return estimate.log


def _score(swarm: GrownStructure, estimate: Localized) -> dict[str, float]:
    log = _log_of(estimate)
    if log.structure not in ("", swarm.digest):
        raise _other_structure(log)
    if estimate.robot_count != swarm.robot_count:
        robots = counted(estimate.robot_count, "robot")
        problem = f"{robots}, but {swarm.robot_count} joined {swarm.name}; keep the order"
        raise InputError(problem, argument="estimates")
    cues = cue_names() if estimate.observability is None else estimate.observability.cues
    evaluation = tables.evaluate(swarm, estimate.log, estimate, cues)
    parts = {
        "truth": evaluation.truth,
        "estimate": estimate,
        "log": estimate.log,
        "history": swarm,
        "settings": swarm.scenario,
    }
    return {**evaluation.scores, **tables.plugin_scores(parts.__getitem__)}


def _filled(values: NDArray[_Value], length: int) -> NDArray[_Value]:
    """Fill an array up to a length along its first axis."""
    blank = {"f": math.nan, "i": -1, "b": False}[values.dtype.kind]
    whole = np.full((length, *values.shape[1:]), blank, values.dtype)
    whole[: len(values)] = values
    return whole


_COLUMNS = {
    "seed": "seed",
    JOINED.column: "robots",
    HEIGHT.column: "height [R]",
    REACH.column: "reach [R]",
    PEAK_STRESS.column: "peak stress [dock weight / R^2]",
    "sensed_max": "largest load [dock weights]",
    "recruited": "recruited",
    STANDING.column: "standing",
    BROKEN.column: "broken contacts",
    MARGIN.column: "least margin",
    "flips": "flips",
    "growth_rounds": "rounds",
    "ended": "ended early",
}
"""Columns of the table of structures on their page, if they have them, and their headings."""

_MOST_STRUCTURES = 100
"""Structures in the 3D view of that page."""


def _page(swarms: Swarms) -> Page:
    """Gather what the page of structures shows."""
    table = swarms.table
    stated = [name for name in _COLUMNS if name in table and table[name].notna().any()]
    frame = table[stated].rename(columns=_COLUMNS)
    numbers = frame.drop(columns=["seed", "ended early"])
    spread = numbers.agg(["mean", "min", "max"]).T.map("{:.4g}".format)
    summary = pd.DataFrame({"quantity": spread.index, "mean": spread["mean"]})
    summary["range"] = spread["min"] + " to " + spread["max"]
    cells = numbers.map("{:.4g}".format)
    cells.insert(0, "seed", frame["seed"].astype(str))
    if any(swarms.ended):
        cells["ended early"] = swarms.ended
    height = swarms.height
    sizes = f"{height.mean():.3g} R in the mean, {height.min():.3g} to {height.max():.3g} R"
    if len(swarms) == 1:
        sizes = f"{height[0]:.3g} R"
        summary = summary[["quantity", "mean"]].rename(columns={"mean": "value"})
    omitted = len(swarms) - MOST_ROWS
    return Page(
        name=swarms[0].name if len(swarms) == 1 else swarms.scenario.structure.kind,
        result=f"{swarms._heading}: height {sizes}.",  # noqa: SLF001 - of this module
        headline=PageTable(frame=summary, words=["quantity", "range"], title="Summary"),
        view=_space(swarms),
        rows=PageTable(
            frame=cells.head(MOST_ROWS),
            words=["ended early"],
            title="Structures",
            note=f"{counted(omitted, 'more structure')} in the table." if omitted > 0 else "",
        ),
        rows_example="robots",
    )


def _space(swarms: Swarms) -> View:
    """Show the first structures, as many as a page has room for."""
    room = 1 + np.searchsorted(np.cumsum(swarms.robot_count)[1:], MOST_ROBOTS, side="right")
    views = [structure._shown() for structure in swarms[: min(int(room), _MOST_STRUCTURES)]]  # noqa: SLF001
    shown = [
        view_data(
            v, [Coloring("sensed load", "dock weights", v.force, "forces"), v.margin_coloring]
        )
        for v in views
    ]
    lacks = len(views) < len(swarms)
    return View(
        data=space_data(views[0].dock_offset_body, shown),
        title="Structures",
        choice="Structure",
        note=f"It contains the first {len(views)} of {len(swarms)} structures." if lacks else "",
        robots="robots",
    )
