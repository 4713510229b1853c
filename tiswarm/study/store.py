"""The run folder: cases appear whole or not at all, and are identified by their content."""

import errno
import fcntl
import json
import os
import shutil
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import pandas as pd
from pydantic import ConfigDict, TypeAdapter
from pydantic.dataclasses import dataclass

from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.base.params import STRICT
from tiswarm.base.progress import Progress
from tiswarm.base.version import __version__
from tiswarm.compute import backend, numerics
from tiswarm.records import io
from tiswarm.records.estimate import Estimate
from tiswarm.records.frames import write_frame, write_trace
from tiswarm.records.positions import Truth, write_estimate, write_positions
from tiswarm.records.run_folder import (
    ENGINE_METHOD,
    NO_METHOD,
    Manifest,
    cell_of,
    check_folders,
    is_run,
    read_manifest,
    write_manifest,
)
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.records.sensing_log import SensingLog
from tiswarm.records.surface import SURFACE_FILE, GroundSurface, write_surface
from tiswarm.scenario.expansion import Case
from tiswarm.scenario.model import Scenario, dump_scenario, scenario_hash
from tiswarm.study.provenance import Cost, Used, is_current, manifest, structure_code
from tiswarm.world.history import History
from tiswarm.world.history_file import read_history, write_history

_COST = "cost.json"
_STRUCTURES = "structures"
TRACEBACK = "traceback.txt"
"""File of a case that failed in a plug-in."""

_LOCK = ".lock"
_OF_STRUCTURE = ("robots", "growth")
"""Tables of a finished case."""

_TABLES = (*_OF_STRUCTURE, "convergence", "relative")
"""Tables of a finished case whose robots were localized."""

_FURTHER_TABLES = ("loads",)
"""Tables that a finished case may have: loads where docks have a strength."""

_OF_ENGINE = ("robots", "docks", "contacts", "moves")
"""Tables of a finished case of the engine."""

_REQUIRED = {NO_METHOD: _OF_STRUCTURE, ENGINE_METHOD: _OF_ENGINE}
"""Tables of a finished case by its method, if these are not `_TABLES`."""

_CASE_FILES = {
    *("sensing.jsonl", "truth.csv", "estimate.csv", "trace.csv", "case.json", _COST, TRACEBACK),
    SURFACE_FILE,
    *(f"{name}.csv" for name in (*_TABLES, *_FURTHER_TABLES, *_OF_ENGINE, "trajectory")),
}
"""All files that a case may have."""

_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL}
"""Errors of a file system that has no locks."""

_REPLACED = {errno.ENOENT, errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR}
"""Errors of a write while another run replaces the folder."""

_WAITS_S = (0.05, 0.2, 1.0)
"""Times to wait until it has [s]."""

_COST_KIND = TypeAdapter(Cost, config=STRICT)
_COSTS_KIND = TypeAdapter(Mapping[str, Cost], config=STRICT)


@dataclass(frozen=True, kw_only=True, config=ConfigDict(strict=True, extra="forbid"))
class CaseRecord:
    """Content of `case.json`; of machine and clock, it has the kind of machine alone."""

    case: str
    seed: int
    condition: str
    point: Mapping[str, Any]  # values of the swept keys
    status: Literal["done", "failed"]
    reason: str = ""  # reason of the failure, or of the early end of growth
    measurements: str = ""  # cues that the method used and the log has
    distrust: str = ""  # why the estimate did not converge, or is not consistent
    scores: Mapping[str, float | int | bool | None] = field(default_factory=dict)  # None: unknown
    version: str = __version__  # version of the package that computed the case
    method: str  # localization method
    code: str  # digest of the code that computed the case
    computed_on: str = ""  # device, precision and key of what rounded numbers, if it was computed
    files: Mapping[str, str] = field(default_factory=dict)  # SHA-256 of all others but the cost
    digest: str = ""  # SHA-256 of the record without it

    @property
    def point_cells(self) -> dict[str, str]:
        """Values of the swept keys as YAML has them, as `{kind: tower}` or `true`, by key."""
        return {key: cell_of(value) for key, value in self.point.items()}

    @property
    def point_text(self) -> str:
        """The point in one line, as `robots=300, structure={kind: tower}`."""
        return ", ".join(f"{key}={value}" for key, value in self.point_cells.items())

    @property
    def series(self) -> str:
        """Point and condition, which cases of other seeds share."""
        return ", ".join(filter(None, [self.point_text, self.condition]))

    @property
    def is_done(self) -> bool:
        """Whether the case was computed."""
        return self.status == "done"

    @property
    def is_current(self) -> bool:
        """Whether the code of this process computed the case, or failed to."""
        return is_current(self.method, self.code)

    def sealed(self) -> "CaseRecord":
        """Return the record with its digest."""
        content = json.dumps(asdict(replace(self, digest="")))
        return replace(self, digest=sha256(content.encode()).hexdigest())


_RECORD_KIND = TypeAdapter(CaseRecord)


def refuse_run_as_parent(parent: Path) -> None:
    """Refuse the folder of a run as the parent of another one.

    Raises:
        InputError: a run made `parent`.
    """
    if is_run(parent):
        problem = f"{parent} is the folder of a run; name its parent {parent.parent} to continue it"
        raise InputError(f"{problem}, or another folder", argument="out")


class RunFolder:
    """Folder of one run, named after the scenario and its content."""

    def __init__(self, path: Path) -> None:
        """Take an existing or future folder at `path`.

        Raises:
            InputError: a link or file is where the run has a folder.
        """
        check_folders(path)
        self.path = path
        self.cases = path / "cases"

    @staticmethod
    def _refuse_foreign(scenario: Scenario, parent: Path, *, overwrite: bool = False) -> None:
        """Refuse a folder of the scenario's name that has files, but was not made by a run.

        A run states in its manifest that it made the folder. Before it writes that, it has written
        the scenario.

        Raises:
            InputError: the folder has such files, and they are not to be replaced.
        """
        path = _folder_of(scenario, parent)
        if overwrite or not path.is_dir() or is_run(path):
            return
        with suppress(InputError, OSError):
            stated = io.run_file(path / "scenario.yaml").read_bytes()
            if stated == dump_scenario(scenario).encode():
                return
        if any(not file.is_dir() for file in path.rglob("[!.]*")):
            problem = "this folder has files, and no run made it; choose another --out, or replace"
            raise InputError(f"{problem} files of a run in it (--overwrite)", path=path)

    @classmethod
    def of(cls, scenario: Scenario, parent: Path) -> "RunFolder":
        """Make the folder of a scenario below `parent`, or open it where it exists."""
        folder = cls(_folder_of(scenario, parent))
        io.make_folder(folder.cases)
        return folder

    @classmethod
    @contextmanager
    def opened(
        cls,
        scenario: Scenario,
        parent: Path,
        progress: Progress,
        shard: str = "",
        *,
        overwrite: bool = False,
    ) -> "Iterator[RunFolder]":
        """Make or open the folder of a scenario, and keep other runs out while the block runs.

        Raises:
            InputError: the folder has files, no run made it, and they are not to be replaced; or
                the parent is the folder of a run.
            EnvironmentTroubleError: another run computes there.
        """
        refuse_run_as_parent(parent)
        cls._refuse_foreign(scenario, parent, overwrite=overwrite)
        folder = cls.of(scenario, parent)
        with folder.locked(shard) as has_locks:
            if not has_locks:
                progress.info(
                    f"{folder.path}: no file locks here; start this run only once at a time"
                )
            # Its description may be new; a run that is at work here keeps its own.
            io.write_bytes(folder.path / "scenario.yaml", dump_scenario(scenario).encode())
            yield folder

    @contextmanager
    def locked(self, shard: str = "") -> Iterator[bool]:
        """Keep other runs out of the folder, except those of other shards, which have names.

        The system releases a lock when its process ends, in any way. What such processes left half
        written is removed at both ends of the block. Locks may not reach other machines, and some
        file systems have none: two equal runs then do the same work and store the same bytes.

        Yields:
            Whether the file system has locks.

        Raises:
            EnvironmentTroubleError: another run computes here.
        """
        with ExitStack() as locks:
            has_locks = self._lock(locks, _LOCK, fcntl.LOCK_SH if shard else fcntl.LOCK_EX)
            if shard:
                self._lock(locks, f".lock-{shard}", fcntl.LOCK_EX)
            else:
                self._remove_partial_files()
                locks.callback(self._remove_partial_files)
            yield has_locks

    def _lock(self, locks: ExitStack, name: str, kind: int) -> bool:
        """Lock a file until the stack ends; return whether the file system has locks."""
        path = self.path / name
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        except OSError as error:
            msg = f"{path}: cannot be locked: {error.strerror}; choose another --out"
            raise EnvironmentTroubleError(msg) from error
        file = locks.enter_context(os.fdopen(descriptor))
        try:
            fcntl.flock(file, kind | fcntl.LOCK_NB)
        except BlockingIOError as error:
            msg = f"{self.path}: another run is at work here; wait for it, or choose another --out"
            raise EnvironmentTroubleError(msg) from error
        except OSError as error:
            if error.errno in _NO_LOCKS:
                return False
            msg = f"{path}: cannot be locked: {error.strerror}; choose another --out"
            raise EnvironmentTroubleError(msg) from error
        return True

    def _remove_partial_files(self) -> None:
        for partial in [*self.cases.glob(".*.part"), *self.path.rglob(".*.tmp")]:
            if io.is_abandoned(partial):
                remove(partial)

    def read_case(self, name: str) -> CaseRecord | None:
        """Read a case, finished or failed; None where a file is missing or damaged, or a link."""
        folder = self.cases / name
        path = folder / "case.json"
        record = io.read_json(path, _RECORD_KIND, exact=True)
        if record is None or record.case != name or folder.is_symlink():
            return None
        if record.digest != record.sealed().digest:
            return None
        tables = _REQUIRED.get(record.method, _TABLES)
        complete = not record.is_done or {f"{name}.csv" for name in tables} <= set(record.files)
        intact = all(io.digest(folder / file) == sha for file, sha in record.files.items())
        return record if intact and complete else None

    def read_cases(self, cases: Sequence[Case]) -> dict[str, CaseRecord]:
        """Read the cases that are stored, finished or failed, by name."""
        records = {case.name: self.read_case(case.name) for case in cases}
        return {name: record for name, record in records.items() if record is not None}

    def store_failure(self, record: CaseRecord, traceback: str = "") -> CaseRecord:
        """Store a case that failed, with its traceback if it has one; the next run tries again."""
        with self._new_folder(record.case) as folder:
            if traceback:
                why = f"{record.reason}; cases/{record.case}/{TRACEBACK} has the traceback"
                record = replace(record, reason=why)
                io.write_bytes(folder / TRACEBACK, traceback.encode())
            self._publish(record, folder)
        return record

    def store(
        self,
        record: CaseRecord,
        *,
        tables: Mapping[str, pd.DataFrame],
        cost: Mapping[str, Cost],
        truth: Truth | None = None,
        log: SensingLog | None = None,
        estimate: Estimate | None = None,
        surface: GroundSurface | None = None,
    ) -> CaseRecord:
        """Write a case, make it appear at once, and return its record with the digests."""
        with self._new_folder(record.case) as folder:
            if log is not None:
                write_sensing_log(log, folder / "sensing.jsonl")
            if truth is not None:
                write_positions(folder / "truth.csv", truth.robot_id, truth.position)
            for name, table in tables.items():
                write_frame(table, folder / f"{name}.csv")
            if estimate is not None:
                write_estimate(folder / "estimate.csv", estimate)
                write_trace(folder / "trace.csv", estimate)
            if surface is not None:
                write_surface(folder / SURFACE_FILE, surface)
            files = {path.name: io.digest(path) for path in sorted(folder.iterdir())}
            io.write_json(folder / _COST, cost)
            complete = replace(record, files=files)
            self._publish(complete, folder)
        return complete

    @contextmanager
    def _new_folder(self, name: str) -> Iterator[Path]:
        """Make an empty folder for a case, which is gone at the end unless it was published."""
        folder = io.path_for(self.cases / name, "part")
        folder.mkdir()
        try:
            yield folder
        finally:
            remove(folder)

    def _publish(self, record: CaseRecord, folder: Path) -> None:
        """Give the folder of a case its name, unless another run has just stored the same case."""
        record = record.sealed()
        io.write_json(folder / "case.json", asdict(record))

        def publish() -> None:
            if record.is_done and self.read_case(record.case) == record:
                return
            target = self.cases / record.case
            _keep_others(target, folder)
            remove(target)
            folder.rename(target)

        _again_while_replaced(publish)

    def read_cost(self, name: str) -> Mapping[str, Cost]:
        """Read the cost of a case by stage; empty where it is unknown."""
        return io.read_json(self.cases / name / _COST, _COSTS_KIND) or {}

    def read_costs(self, cases: Sequence[Case]) -> dict[str, Mapping[str, Cost]]:
        """Read the costs of cases by name and stage."""
        return {case.name: self.read_cost(case.name) for case in cases}

    def store_cost(self, name: str, cost: Mapping[str, Cost]) -> None:
        """Write the cost of a stored case by stage."""
        _again_while_replaced(lambda: io.write_json(self.cases / name / _COST, cost))

    def read_structure(self, case: Case) -> tuple[History, Cost] | None:
        """Read the structure of a case, and the cost of growing it; None where it is not kept."""
        path = self._structure_path(case)
        cost = io.read_json(path.with_suffix(".json"), _COST_KIND)
        if cost is None:
            return None
        history = read_history(path, case.settings.structure, case.settings.robot)
        return None if history is None else (history, cost)

    def keep_structure(self, case: Case, history: History, cost: Cost) -> None:
        """Keep a structure that took long to grow until all cases of the run are done."""
        path = self._structure_path(case)

        def keep() -> None:
            io.make_folder(path.parent)
            io.write_json(path.with_suffix(".json"), cost)
            write_history(history, path)

        _again_while_replaced(keep)

    def reopen(self, progress: Progress, *, computes: bool) -> None:
        """Remove what describes a complete run, as cases are to be computed.

        The manifest keeps what rounded the numbers of stored cases, and which drawings there are;
        a run that is killed leaves it.

        Args:
            progress: Receives how that differs from what rounds numbers here.
            computes: Whether this machine computes cases, or others alone.
        """
        earlier = self._manifest()
        new_facts = [numerics.current().facts] if computes else []
        stored_facts = [facts for facts in earlier.numerics if facts not in new_facts]
        remove(self.path / "report.html")
        rounding = (*stored_facts, *new_facts)
        self._write_manifest(Manifest(numerics=rounding, outdated=earlier.ever_drawn))
        if stored_facts and computes:
            progress.info(
                "stored cases may be rounded otherwise than those to come: "
                f"{numerics.difference(stored_facts[0])}; remove {self.path} to compute all alike"
            )

    def complete(
        self, cases: Sequence[Case], used: Collection[Used]
    ) -> dict[str, Mapping[str, Cost]]:
        """Write the manifest of a run whose cases are all stored, unless it has one.

        Args:
            cases: All cases.
            used: What computed them, as far as this process knows.

        Returns:
            Their costs by name and stage.
        """
        costs = self.read_costs(cases)
        earlier = self._manifest()
        if not earlier.tiswarm:
            used = used or {Used("grow", backend.current())}
            complete = manifest(used, [*costs.values()], earlier.numerics)
            self._write_manifest(replace(complete, outdated=earlier.ever_drawn))
        return costs

    def forget_structures(self) -> None:
        """Remove kept structures, once no case of the run has to be tried again."""
        for kept in self.path.glob(f"{_STRUCTURES}/seed*-*.*"):
            remove(kept)
        with suppress(OSError):  # there is none, or somebody keeps files in it
            (self.path / _STRUCTURES).rmdir()

    def _manifest(self) -> Manifest:
        """Read the manifest; an empty one where it is missing or damaged."""
        try:
            return read_manifest(self.path)
        except InputError:
            return Manifest()

    def _write_manifest(self, manifest: Manifest) -> None:
        """Write the manifest, also in place of a folder or link that has its name."""
        path = self.path / "manifest.json"
        if path.is_dir():
            remove(path)
        write_manifest(self.path, manifest)

    def _structure_path(self, case: Case) -> Path:
        structure = case.settings.structure
        code = structure_code(structure.kind, structure.rule.name)
        key = sha256(repr((case.structure_key, code)).encode()).hexdigest()[:12]
        return self.path / _STRUCTURES / f"seed{case.seed}-{key}.npz"


def _folder_of(scenario: Scenario, parent: Path) -> Path:
    return parent / f"{scenario.name}-{scenario_hash(scenario)}"


def _keep_others(old: Path, new: Path) -> None:
    """Move files of somebody else from the folder of a case to the one that is to replace it."""
    if old.is_dir() and not old.is_symlink():
        for path in old.iterdir():
            if path.name not in _CASE_FILES and not io.is_temporary(path):
                path.rename(new / path.name)


def _again_while_replaced(write: Callable[[], None]) -> None:
    """Write, and again soon after where an equal run has just removed or made the folder."""
    for wait in _WAITS_S:
        try:
            return write()
        except (EnvironmentTroubleError, OSError) as error:
            if getattr(error.__cause__ or error, "errno", None) not in _REPLACED:
                raise
            time.sleep(wait)
    return write()


def remove(path: Path) -> None:
    """Remove a folder with its content, a file, or a link itself; nothing where there is none."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
