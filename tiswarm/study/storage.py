"""The run folder: cases appear whole or not at all, and are recognised by their content."""

import fcntl
import hashlib
import json
import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from tiswarm.errors import EnvironmentTroubleError
from tiswarm.records.estimate import Estimate
from tiswarm.records.io import make_folder, write_text
from tiswarm.records.positions import Truth, write_estimate, write_positions
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.records.sensing_log import SensingLog
from tiswarm.scenario import Scenario, dump_scenario, scenario_hash
from tiswarm.study.cases import Case, series_text, structure_key
from tiswarm.study.costs import Cost
from tiswarm.version import __version__, code_digest
from tiswarm.world.history import History
from tiswarm.world.history_file import read_history, write_history

CODE = code_digest()
"""Digest of the code that computes here."""

DONE = "done"
FAILED = "failed"
COST = "cost.json"
STRUCTURES = "structures"
TABLES = ("robots", "convergence", "growth", "relative")
"""Tables of a finished case; one without them all was stored by an older version."""


@dataclass(frozen=True, kw_only=True)
class CaseRecord:
    """What `case.json` says; nothing in it depends on the machine or the clock."""

    case: str
    seed: int
    """Seed of the structure and of every noise."""

    condition: str
    point: Mapping[str, Any]
    """Values of the swept keys."""

    status: str
    """"done" or "failed"."""

    reason: str = ""
    """Why it failed, or why growth ended early."""

    scores: Mapping[str, float | int | None] = field(default_factory=dict)
    """What evaluation made of it."""

    version: str = __version__
    """Version of the package that computed it."""

    code: str = field(default_factory=lambda: CODE)
    """Digest of the code that computed it; other code need not give the same bytes."""

    files: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of each of the case's other files, but for its cost."""

    @property
    def series(self) -> str:
        """Point and condition, which cases of other seeds share."""
        return series_text(self.point, self.condition)


class RunFolder:
    """One run's folder, named after the scenario and its content."""

    def __init__(self, path: Path) -> None:
        """Take an existing or future folder at `path`."""
        self.path = path

    @classmethod
    def of(cls, scenario: Scenario, parent: Path) -> "RunFolder":
        """Make the folder of a scenario below `parent`, or open it where it exists."""
        folder = cls(parent / f"{scenario.name}-{scenario_hash(scenario)}")
        make_folder(folder.path)
        make_folder(folder.cases)
        write_text(folder.path / "scenario.yaml", dump_scenario(scenario))
        return folder

    @property
    def cases(self) -> Path:
        """Folder of the cases."""
        return self.path / "cases"

    @contextmanager
    def held(self, shard: str = "") -> Iterator[None]:
        """Keep other runs out of the folder, but for those of other shards.

        The system frees a lock when its process ends, in whatever way.

        Args:
            shard: Name of the part that is computed; all of it if empty.

        Raises:
            EnvironmentTroubleError: another run is at work.
        """
        with ExitStack() as locks:
            self._lock(locks, ".lock", fcntl.LOCK_SH if shard else fcntl.LOCK_EX)
            if shard:
                self._lock(locks, f".lock-{shard}", fcntl.LOCK_EX)
            else:
                self._tidy()
            yield

    def _lock(self, locks: ExitStack, name: str, kind: int) -> None:
        path = self.path / name
        try:
            fcntl.flock(locks.enter_context(path.open("a+")), kind | fcntl.LOCK_NB)
        except BlockingIOError as error:
            msg = f"{self.path}: another run is at work here; wait for it, or choose another --out"
            raise EnvironmentTroubleError(msg) from error
        except OSError as error:
            msg = f"{path}: cannot be locked: {error.strerror}; choose another --out"
            raise EnvironmentTroubleError(msg) from error

    def _tidy(self) -> None:
        """Remove what killed runs left half-written."""
        for half in [*self.cases.glob(".*.part"), *self.path.rglob(".*.tmp")]:
            if half.is_dir():
                shutil.rmtree(half, ignore_errors=True)
            else:
                half.unlink(missing_ok=True)

    def stored(self, name: str) -> CaseRecord | None:
        """Read a finished case; None where it is missing, damaged or computed by other code."""
        record = self.recorded(name)
        fit = record is not None and (record.status, record.code) == (DONE, CODE)
        return record if fit else None

    def is_outdated(self, name: str) -> bool:
        """Whether other code computed a finished case."""
        record = self.recorded(name)
        return record is not None and record.status == DONE and record.code != CODE

    def recorded(self, name: str) -> CaseRecord | None:
        """Read a case, finished or failed; None where its files are not what it says."""
        folder = self.cases / name
        try:
            record = CaseRecord(
                **{"version": "", "code": ""} | json.loads((folder / "case.json").read_text())
            )
            intact = all(_digest(folder / file) == sha for file, sha in record.files.items())
        except (OSError, ValueError, TypeError):
            return None
        whole = record.status == FAILED or {f"{name}.csv" for name in TABLES} <= set(record.files)
        return record if intact and whole else None

    def cost(self, name: str) -> Mapping[str, Cost]:
        """Read by stage what a case has cost; nothing where that is unknown."""
        return _read_json(self.cases / name / COST)

    def store_cost(self, name: str, cost: Mapping[str, Cost]) -> None:
        """Write by stage what a stored case has cost, which no run repeats."""
        _write_json(self.cases / name / COST, cost)

    def grown(self, case: Case) -> tuple[History, Cost] | None:
        """Read the structure of a case, and what growing it cost; None where it was not kept."""
        path = self._structure(case)
        cost = _read_json(path.with_suffix(".json"))
        settings = case.settings
        history = read_history(path, settings.structure, settings.robot)
        return None if history is None or not cost else (history, cost)

    def keep_grown(self, case: Case, history: History, cost: Cost) -> None:
        """Keep a structure that took long to grow until all cases of the run are done."""
        path = self._structure(case)
        make_folder(path.parent)
        _write_json(path.with_suffix(".json"), cost)
        write_history(history, path)

    def forget_grown(self) -> None:
        """Remove all structures that were kept."""
        shutil.rmtree(self.path / STRUCTURES, ignore_errors=True)

    def _structure(self, case: Case) -> Path:
        return self.path / STRUCTURES / f"{structure_name(case)}.npz"

    def store_failure(self, record: CaseRecord) -> None:
        """Write down that a case failed; the next run tries it again."""
        self._publish(record, self._workplace(record.case))

    def store(
        self,
        record: CaseRecord,
        *,
        truth: Truth,
        log: SensingLog,
        estimate: Estimate,
        tables: Mapping[str, pd.DataFrame],
        cost: Mapping[str, Cost],
    ) -> CaseRecord:
        """Write a case and make it appear at once; return its record with the digests."""
        work = self._workplace(record.case)
        write_sensing_log(log, work / "sensing.jsonl")
        write_positions(work / "truth.csv", truth.robot_id, truth.position)
        write_estimate(work / "estimate.csv", estimate)
        for name in TABLES:
            write_table(tables[name], work / f"{name}.csv")
        files = {path.name: _digest(path) for path in sorted(work.iterdir())}
        _write_json(work / COST, cost)
        complete = CaseRecord(**{**asdict(record), "files": files})
        self._publish(complete, work)
        return complete

    def _workplace(self, name: str) -> Path:
        """Make an empty folder that a killed run may leave behind without harm."""
        work = self.cases / f".{name}.{secrets.token_hex(4)}.part"
        work.mkdir()
        return work

    def _publish(self, record: CaseRecord, work: Path) -> None:
        _write_json(work / "case.json", asdict(record))
        target = self.cases / record.case
        shutil.rmtree(target, ignore_errors=True)
        try:
            work.rename(target)
        except OSError:
            if not target.is_dir():
                raise
            # A worker that outlived its run has stored the same case a moment ago.
            shutil.rmtree(work, ignore_errors=True)


def structure_name(case: Case) -> str:
    """Name the structure that a case shares with others, by all that it grows from."""
    grown_by = repr((structure_key(case), CODE))
    return f"seed{case.seed}-{hashlib.sha256(grown_by.encode()).hexdigest()[:12]}"


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write a CSV whose numbers read back to the same bits."""
    write_text(path, table.to_csv(index=False, lineterminator="\n"))


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    write_text(path, json.dumps(content, indent=1) + "\n")


def _read_json(path: Path) -> dict[str, Any]:
    """Read what such a file says; nothing where it is missing or damaged."""
    try:
        content: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return content


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
