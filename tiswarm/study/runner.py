"""Computes jobs, each a batch of cases: grow, sense, localize, evaluate, store.

Cases of the method `none` are not localized.
"""

from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import groupby
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np

from tiswarm.base.errors import InputError
from tiswarm.base.params import AnyPrecision, Arch
from tiswarm.base.process import naming_shortage
from tiswarm.base.progress import Advance, Progress, ignore
from tiswarm.base.registry import get, registered
from tiswarm.compute import backend, numerics
from tiswarm.compute.backend import Backend
from tiswarm.evaluation.tables import evaluate
from tiswarm.localization import methods
from tiswarm.localization.methods import LocalizationParams, localize_many
from tiswarm.localization.settings import JointParams
from tiswarm.records import measures
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog
from tiswarm.scenario.expansion import Case, Group
from tiswarm.sensing import observe
from tiswarm.sensing.params import SensingParams
from tiswarm.study.navigation import navigate
from tiswarm.study.provenance import Costs, Used, case_code, plugged
from tiswarm.study.store import CaseRecord, RunFolder
from tiswarm.world.ground.surface import ground_surface
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.history_file import find_fault

ROBOTS_AT_ONCE = 10_000
"""A job has about this many robots at most, and is stored before the next."""

_JOBS_EACH = 4
"""Jobs for each process, so that all processes end at about the same time."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """Structures of one kind with their cases, and where to compute and store them."""

    structures: Sequence[Group]
    folder: RunFolder
    arch: Arch
    threads: int | None  # CPU threads; all if None

    @property
    def cases(self) -> list[Case]:
        """All cases, those of a structure side by side."""
        return [case for group in self.structures for case in group]

    @property
    def halves(self) -> "list[Job]":
        """The job in two parts, split between structures if it has several."""
        middle = len(self.structures) // 2
        if middle:
            parts = [self.structures[:middle], self.structures[middle:]]
        else:
            [group] = self.structures
            parts = [[group[: len(group) // 2]], [group[len(group) // 2 :]]]
        return [replace(self, structures=part) for part in parts]


def batch(
    structures: Sequence[Group],
    folder: RunFolder,
    *,
    arch: Arch,
    threads: int | None,
    width: int = 1,
    alone: bool = False,
) -> list[Job]:
    """Make jobs of structures: large ones, but enough to keep `width` processes busy.

    All cases of a structure are in the same job, so each structure is grown once. Each has a job of
    its own if they are to be `alone`.
    """
    robots_at_once = ROBOTS_AT_ONCE
    if width > 1:
        robots = sum(group[0].settings.robots for group in structures)
        robots_at_once = min(ROBOTS_AT_ONCE, robots // (_JOBS_EACH * width) + 1)
    jobs: list[list[Group]] = []
    for _, same_kind in groupby(structures, key=lambda group: group[0].structure_key[:-1]):
        gathered: list[Group] = []
        robots = 0
        for group in same_kind:
            gathered.append(group)
            robots += group[0].settings.robots
            starts = width > 1 and len(jobs) < width  # small jobs are soon stored
            if alone or starts or robots >= robots_at_once:
                jobs.append(gathered)
                gathered = []
                robots = 0
        if gathered:
            jobs.append(gathered)
    return [
        Job(
            structures=job,
            folder=folder,
            arch=arch,
            threads=job[0][0].settings.threads or threads,
        )
        for job in jobs
    ]


def first_alone(jobs: Sequence[Job]) -> list[Job]:
    """Give the first structure a job of its own, which soon ends."""
    first, *rest = jobs
    if len(first.structures) == 1:
        return [first, *rest]
    parts = [first.structures[:1], first.structures[1:]]
    return [*(replace(first, structures=part) for part in parts), *rest]


KEPT_FROM_S = 10.0
"""Growth that took so long [s] is kept in case the run is stopped before its cases are stored.

Histories that measures of plug-ins ask for are kept, too, until the tables are written.
"""

SAMPLE_ROBOTS = 4
"""Size of the structure that warms up the kernels."""
SAMPLE_SEED = 2**31 - 1
"""Seed of the structure that warms up the kernels."""


class Outcome(NamedTuple):
    """Record of each case of a job, as stored, and what computed its stages."""

    records: Sequence[CaseRecord]
    used: Collection[Used]


OnStored = Advance
"""Receives the number of cases that were just stored."""


def run_job(
    job: Job,
    progress: Progress,
    on_ready: Callable[[], None] = lambda: None,
    on_stored: OnStored = ignore,
) -> Outcome:
    """Compute and store the cases of a job.

    Args:
        job: Cases, and where to store them.
        progress: Receives the stages of the job.
        on_ready: Called once the kernels of the job are compiled.
        on_stored: Called whenever cases are stored.
    """
    runner = _CaseRunner(job, progress, on_stored)
    with naming_shortage():
        runner.warm_up()
        on_ready()
        return Outcome(records=runner.run(), used=runner.used)


def grow_again(case: Case) -> History:
    """Grow the structure of a case as its job did; the kernels give the same bits."""
    settings = case.settings
    backend.processor()
    [history] = grow(
        settings.structure,
        robots=settings.robots,
        seeds=[case.seed],
        robot=settings.robot,
        **navigate(settings),
    )
    return history


def failure(case: Case, reason: str) -> CaseRecord:
    """Return the record of a case that could not be computed."""
    return _record(case, "failed", reason)


_compiled: dict[str, Backend] = {}
"""Backend that last compiled the kernels of a method, by the settings of the method."""


class _CaseRunner:
    """Computes the cases of a job stage by stage, and measures the cost of each stage."""

    def __init__(self, job: Job, progress: Progress, on_stored: OnStored) -> None:
        self.job = job
        self.progress = progress
        self.on_stored = on_stored
        self.costs = Costs()
        self.used: set[Used] = set()
        self._sample: History | None = None
        self._sampled_on: Backend | None = None

    def warm_up(self) -> None:
        """Compile the kernels of the job, so that no stage pays for them.

        A structure of a few robots is grown and localized by each method. Nothing of it is stored.
        """
        with self.progress.task("prepare kernels", int(not _compiled)) as advance:
            if not self.job.cases[0].settings.localization.runs_engine:
                self._warm_up_growth()
            for _, cases in groupby(sorted(self.job.cases, key=_device), key=_device):
                self._warm_up_methods(list(cases))
            advance(1)

    def run(self) -> list[CaseRecord]:
        """Compute and store all cases; return their records."""
        if self.job.cases[0].settings.localization.runs_engine:
            return [self._move(case) for case in self.job.cases]
        histories = self._grow()
        valid, records = self._store_invalid(histories)
        self.on_stored(len(records))
        logs = self._sense(valid, histories)
        for cases in _batches(valid, logs):
            sensed = [logs[case.name] for case in cases]
            estimates: Sequence[Estimate | None] = [None] * len(cases)
            if cases[0].settings.localization.places_robots:
                estimates = self._localize(cases, sensed)
            with self._stage("score and store", cases) as advance:
                for case, log, estimate in zip(cases, sensed, estimates, strict=True):
                    records.append(self._store(case, histories[case.seed], log, estimate))
                    advance(1)
                    self.on_stored(1)
            for case in cases:
                self.job.folder.store_cost(case.name, self.costs[case.name])
        return records

    @contextmanager
    def _stage(
        self, name: str, cases: Sequence[Case], total: int | None = None
    ) -> Iterator[Advance]:
        """Report and measure a stage of `total` steps, by default one for each case."""
        shared = self.costs.stage(name, [case.name for case in cases])
        with shared, self.progress.task(name + _where(cases), total or len(cases)) as advance:
            yield advance

    def _warm_up_growth(self) -> None:
        self._choose_device("", "auto")
        running = backend.processor()
        if self._sampled_on != running:
            settings = self.job.cases[0].settings
            structure = settings.structure
            if structure.kind in registered("structure"):  # code of plug-ins runs for cases alone
                structure = get("structure", "tower")(plane=structure.plane)
            if structure.rule.name in registered("rule"):
                structure = replace(structure, rule=get("rule", "reactive-build")())
            with suppress(Exception):  # a case that cannot be computed says why itself
                [self._sample] = grow(
                    structure, robots=SAMPLE_ROBOTS, seeds=[SAMPLE_SEED], robot=settings.robot
                )
            self._sampled_on = running

    def _warm_up_methods(self, cases: Sequence[Case]) -> None:
        """Choose device and precision of these cases, and compile their methods."""
        self._choose_device(*_device(cases[0]))
        for settings in [case.settings for case in cases]:
            # The code of plug-ins runs for cases alone, within their limits of time.
            if settings.localization.method in registered("method"):
                continue
            if not settings.localization.places_robots:
                continue
            is_own = settings.sensing.suite in registered("sensor")
            sensing = SensingParams() if is_own else settings.sensing
            method = repr(settings.localization)
            running = methods.start_for(settings.localization)
            if self._sample is not None and _compiled.get(method) != running:
                with suppress(Exception):
                    log = observe(self._sample, sensing)
                    localize_many([log], [_shortened(settings.localization)])
                _compiled[method] = running

    def _choose_device(self, arch: Arch | Literal[""], precision: AnyPrecision) -> None:
        backend.choose(arch or self.job.arch, threads=self.job.threads, precision=precision)

    def _grow(self) -> dict[int, History]:
        """Grow each structure once for all of its conditions; return them by seed."""
        settings = self.job.cases[0].settings
        histories = self._read_structures()
        missing = [case for case in self.job.cases if case.seed not in histories]
        first = {case.seed: case for case in reversed(missing)}
        seeds = sorted(first)
        if not seeds:
            return histories
        self._warm_up_growth()
        points = {seed: case.variant.point_words for seed, case in first.items()}
        names = [", ".join(filter(None, [points[seed], f"seed {seed}"])) for seed in seeds]
        watched = self.progress.watch(names, settings.robots, self.job.folder.path)
        total = len(seeds) * settings.robots
        with self._stage("grow", missing, total) as advance, watched as watch:
            grown = grow(
                settings.structure,
                robots=settings.robots,
                seeds=seeds,
                robot=settings.robot,
                on_progress=advance,
                watch=watch,
                **navigate(settings),
            )
        self.used.add(Used("grow", backend.processor(), rounding=numerics.current()))
        for seed, history in zip(seeds, grown, strict=True):
            share = self.costs[first[seed].name]["grow"]
            is_costly = share["wall_s"] * len(missing) > KEPT_FROM_S
            if history.walks and (is_costly or measures.need("history")):
                self.job.folder.keep_structure(first[seed], history, share)
        return histories | dict(zip(seeds, grown, strict=True))

    def _read_structures(self) -> dict[int, History]:
        """Read the structures that an earlier run grew, with their cost."""
        histories = {}
        for seed, case in {case.seed: case for case in self.job.cases}.items():
            stored = self.job.folder.read_structure(case)
            if stored is None:
                continue
            histories[seed], share = stored
            self.costs.add("grow", [c.name for c in self.job.cases if c.seed == seed], share)
            self.progress.info(f"seed {seed}: its structure was grown by an earlier run")
        return histories

    def _store_invalid(self, histories: dict[int, History]) -> tuple[list[Case], list[CaseRecord]]:
        """Store cases whose structure is invalid as failed; return the others, and the records."""
        cases = self.job.cases
        faults = {}
        gap = cases[0].settings.structure.climb.contact_gap
        for seed, history in histories.items():
            if history.robot_count > 1:
                faults[seed] = find_fault(history, contact_gap=gap)
            else:
                faults[seed] = history.ended or "only one robot joined"
        failures = [failure(case, faults[case.seed]) for case in cases if faults[case.seed]]
        for failed in failures:
            self.job.folder.store_failure(failed)
        return [case for case in cases if not faults[case.seed]], failures

    def _sense(self, cases: Sequence[Case], histories: dict[int, History]) -> dict[str, SensingLog]:
        logs = {}
        with self._stage("sense", cases) as advance:
            for case in cases:
                logs[case.name] = observe(histories[case.seed], case.settings.sensing)
                advance(1)
        return logs

    def _localize(self, cases: Sequence[Case], logs: Sequence[SensingLog]) -> list[Estimate]:
        """Localize a batch of cases, which share method and precision."""
        self._warm_up_methods(cases)
        with self._stage("localize", cases) as advance:
            chosen = [case.settings.localization for case in cases]
            estimates = localize_many(logs, chosen, with_observability=True, on_progress=advance)
        running = methods.start_for(chosen[0])
        farthest = [
            np.abs(estimate.position - log.anchor_position).max() / log.dock_radius
            for estimate, log in zip(estimates, logs, strict=True)
        ]
        error = running.force_error(max(farthest))
        stage = f"localize by {chosen[0].title}"
        self.used.add(Used(stage, running, error, numerics.current()))
        return estimates

    def _move(self, case: Case) -> CaseRecord:
        """Run the engine for a case, and store it; one whose forces diverge is stored as failed.

        Raises:
            InputError: a function of a user does not compile.
        """
        from tiswarm.study.relaxation import StudiedSwarm  # noqa: PLC0415 - slow to import

        self._choose_device(*_device(case))
        running = backend.device()
        swarm = StudiedSwarm(case)
        try:
            with self._stage("relax", [case], swarm.robot_steps) as advance:
                results, taken = swarm.move(advance)
        except InputError as error:
            self.on_stored(1)
            return self.job.folder.store_failure(failure(case, str(error)))
        self.used.add(Used("relax", running, 0.0, numerics.current()))
        with self._stage("score and store", [case]):
            moved = swarm.measure(results, taken)
            record = _record(case, "done", "", moved.scores)
            record = replace(record, computed_on=f"{running}, numerics {numerics.current().key}")
            cost = self.costs[case.name]
            stored = self.job.folder.store(record, tables=moved.tables, cost=cost)
        self.job.folder.store_cost(case.name, self.costs[case.name])
        self.on_stored(1)
        return stored

    def _store(
        self, case: Case, history: History, log: SensingLog, estimate: Estimate | None
    ) -> CaseRecord:
        """Evaluate and store one case; its structure alone if it has no estimate."""
        cues = case.settings.localization.used_cues
        evaluation = evaluate(history, log, estimate, cues, case.settings.structure.strength)
        record = _record(case, "done", history.ended, evaluation.scores)
        running = methods.start_for(case.settings.localization)
        on = f"{running}, numerics {numerics.current().key}"
        record = replace(record, measurements=evaluation.measurements, computed_on=on)
        if estimate is not None and estimate.convergence is not None:
            record = replace(record, distrust=estimate.convergence.reason)
        return self.job.folder.store(
            record,
            truth=evaluation.truth,
            log=log,
            estimate=estimate,
            tables=evaluation.tables,
            cost=self.costs[case.name],
            surface=ground_surface(history),
        )


_LONGEST_WHERE = 60
"""Letters of a condition and its point beside the name of a stage."""


def _where(cases: Sequence[Case]) -> str:
    """Name condition and point of some cases, the first of several, in parentheses.

    A study of one condition without a sweep has nothing to name.
    """
    first, *others = dict.fromkeys(case.variant.words for case in cases) or [""]
    if not first:
        return ""
    if len(first) > _LONGEST_WHERE:
        first = f"{first[:_LONGEST_WHERE]}..."
    more = f" and {len(others)} more" if others else ""
    return f" ({first}{more})"


def _shortened(params: LocalizationParams) -> LocalizationParams:
    """Cut the steps of `joint`: few of them compile the same kernels, and devices take longer."""
    return replace(params, steps=4, hold_steps=2) if isinstance(params, JointParams) else params


def _device(case: Case) -> tuple[Arch | Literal[""], AnyPrecision]:
    """Return device and precision of a case; the device of the job is empty."""
    return case.settings.arch or "", case.settings.precision


def _batches(cases: Sequence[Case], logs: Mapping[str, SensingLog]) -> Iterable[list[Case]]:
    """Gather cases that are localized side by side, and so share the cost of it."""
    batches: dict[tuple[Hashable, ...], list[Case]] = {}
    for case in sorted(cases, key=_method):
        key = methods.batch_key(logs[case.name], case.settings.localization)
        batches.setdefault((*_method(case), key), []).append(case)
    return batches.values()


def _method(case: Case) -> tuple[str, ...]:
    """Return method, schedule, device and precision, which cases of a batch share."""
    return case.settings.localization.title, *_device(case)


def _record(
    case: Case,
    status: Literal["done", "failed"],
    reason: str,
    scored: Mapping[str, float | int] = MappingProxyType({}),
) -> CaseRecord:
    method = case.settings.localization.method
    return CaseRecord(
        case=case.name,
        seed=case.seed,
        method=method,
        code=case_code(method, **plugged(case.settings)),
        condition=case.variant.condition,
        point=case.variant.point,
        status=status,
        reason=reason,
        scores={name: None if np.isnan(value) else value for name, value in scored.items()},
    )
