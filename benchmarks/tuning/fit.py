"""Fits the gains of a method on training structures, and records the fit.

A seeded sampler draws each trial from those before it. To resume a fit, the trials of its record
are replayed to a new sampler; the fit then ends in the bytes of an uninterrupted one. A storage of
the sampler's library would not: a sampler that is loaded from it draws other trials.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.base.progress import Progress
from tiswarm.base.version import __version__
from tiswarm.compute import backend
from tiswarm.evaluation import metrics
from tiswarm.localization.methods import localize_many
from tiswarm.localization.settings import VirtualForceParams
from tiswarm.records.io import write_bytes
from tiswarm.records.sensing_log import SensingLog
from tiswarm.scenario.expansion import Variant, variants
from tiswarm.scenario.model import Scenario
from tiswarm.sensing import observe
from tiswarm.study.provenance import package_code
from tiswarm.world.growth import grow
from tiswarm.world.history import History

if TYPE_CHECKING:
    from optuna import Study, Trial

_Ranges = Mapping[str, tuple[float, float]]
_FIRST_TRAINING_SEED = 1000
_SAMPLER_SEED = 0

GAINS = {
    "attraction_gain": (0.05, 2.0),
    "repulsion_gain": (0.5, 200.0),
    "height_gain": (0.005, 1.0),
    "initial_offset": (0.5, 8.0),
    "max_step": (0.25, 4.0),
}
"""Range of each gain, on a logarithmic scale; units as in `VirtualForceParams`."""

STABLE_GAINS = {
    "attraction_gain": (0.1, 0.6),
    "repulsion_gain": (0.02, 0.2),
    "height_gain": (0.1, 1.0),
    "initial_offset": (1.0, 8.0),
}
"""Ranges of a stable fit, in which a step seldom overshoots, so that none needs a cap."""

NO_CAP = 1e9
"""Longest step of a stable fit, which no step reaches [R]."""

_NUDGE = 1e-9  # how far the anchor is raised to see whether estimates move with it [R]
_STABLE = 1e6  # how many times as far estimates may move: then rounding moves them by some 1e-9 R

_ROUND_GAINS = {"repulsion_share": (0.001, 1.0)}
"""Ranges of the gains of `BackPropagation`, where a condition has it."""

Objective = Literal["sse", "rmse"]


class _Score(NamedTuple):
    """A quantity that a fit minimizes."""

    column: str  # of a trial
    text: str
    as_good: float
    """Value relative to the least, up to which a trial counts as equally good: other seeds would
    rank such trials otherwise. Of these the trial with the weakest repulsion is chosen, since
    rounding errors grow with it."""


_SCORES: Mapping[Objective, _Score] = {
    "sse": _Score("sse_R2", "mean SSE over structures [R^2]", 1.02**2),
    "rmse": _Score("rmse_R", "mean RMSE over structures [R]", 1.02),
}


class TrainingCase(NamedTuple):
    """A training structure at a point of the sweep and condition, with its true centers [R]."""

    label: str
    log: SensingLog
    true: Reals
    params: VirtualForceParams


def tune(
    scenario: Scenario,
    path: Path,
    *,
    trials: int,
    training_seeds: int,
    conditions: Sequence[str],
    progress: Progress,
    objective: Objective = "sse",
    stable: bool = False,
    threads: int | None = None,
) -> dict[str, Any]:
    """Fit gains to the least error over training structures, one set for all conditions.

    With the default ranges Algorithm 1 is chaotic: rounding decides where single robots end. In a
    stable fit nothing caps a step, and gains count only if a nudge of the anchor by 1e-9 R grows at
    most a million times.

    Args:
        scenario: What to grow and how to localize it; its own seeds are excluded.
        path: Record of the fit, written after every trial; the fit of an existing one is resumed.
        trials: Trials in all.
        training_seeds: Structures of each sweep point, from seed 1000 on.
        conditions: Conditions to include; all if empty.
        progress: Receives progress reports.
        objective: What to minimize: the mean of the SSE, as the paper does, or of the RMSE.
        stable: Whether to fit stable gains.
        threads: CPU threads; all if None.

    Returns:
        The record.

    Raises:
        InputError: for seeds that the scenario reports on, settings without gains, or a record
            of another fit.
        EnvironmentTroubleError: the sampler is not installed.
    """
    score = _SCORES[objective]
    seeds = _training_seeds(scenario, training_seeds)
    points = _points(scenario, conditions)
    wanted = (STABLE_GAINS if stable else GAINS) | _ROUND_GAINS
    start = _current_gains(points, wanted)
    ranges = {name: limits for name, limits in wanted.items() if name in start}
    record: dict[str, Any] = {
        "tiswarm": __version__,
        "code": package_code(),
        "scenario": scenario.name,
        "points": [point.label for point in points],
        "robots": [point.settings.robots for point in points],
        "training_seeds": seeds,
        "objective": score.text,
        "sampler": f"CMA-ES of optuna {_optuna_version()}, seed {_SAMPLER_SEED}",
        "ranges": {name: list(limits) for name, limits in ranges.items()},
    }
    if stable:
        record["stable"] = f"no cap, and a nudge of {_NUDGE} R grows at most {_STABLE:g} times"
    done = _read_trials(path, record)
    first = {name: done[0][name] for name in ranges} if done else start
    study = _replayed_study(first, done, ranges, score, path)
    backend.start(threads=threads)
    if len(done) < trials:
        cases = _training_cases(points, seeds, progress)
        with progress.task("fit", trials - len(done)) as advance:
            for _ in range(trials - len(done)):
                trial = study.ask()
                values = _suggested(trial, ranges)
                done.append(values | _errors(cases, values))
                if stable:
                    done[-1]["growth"] = growth_of_a_nudge(cases, values)
                study.tell(trial, done[-1][score.column])
                _write(path, record | _outcome(done, score), done)
                advance(1)
    return record | _outcome(done, score)


def _training_seeds(scenario: Scenario, count: int) -> list[int]:
    seeds = list(range(_FIRST_TRAINING_SEED, _FIRST_TRAINING_SEED + count))
    if shared := set(seeds) & set(scenario.seed_list):
        problem = (
            f"the scenario reports on seed {min(shared)}, which the fit would train on; "
            f"keep its seeds below {_FIRST_TRAINING_SEED}"
        )
        raise InputError(problem, key="seeds")
    return seeds


def _points(scenario: Scenario, conditions: Sequence[str]) -> list[Variant]:
    for name in conditions:
        if name not in scenario.conditions:
            problem = f"no condition {name!r}; choose among {', '.join(scenario.conditions)}"
            raise InputError(problem, argument="condition")
    return [v for v in variants(scenario) if not conditions or v.condition in conditions]


def _params(point: Variant) -> VirtualForceParams:
    """Return the settings of a point, if they have gains."""
    params = point.settings.localization
    if not isinstance(params, VirtualForceParams):
        problem = f"{params.method} has no gains to fit; name conditions of virtual-force"
        raise InputError(problem, argument="condition")
    return params


def _current_gains(points: Sequence[Variant], ranges: _Ranges) -> dict[str, float]:
    """Return the gains of the settings that have ranges, clipped to them."""
    params = [_params(point) for point in points]
    values = {name: getattr(params[0], name) for name in ranges if name not in _ROUND_GAINS}
    if rounds := next((p.back_propagation for p in params if p.back_propagation), None):
        values |= {name: getattr(rounds, name) for name in _ROUND_GAINS}
    return {name: float(np.clip(value, *ranges[name])) for name, value in values.items()}


def _training_cases(
    points: Sequence[Variant], seeds: list[int], progress: Progress
) -> list[TrainingCase]:
    """Grow every training structure once, and sense it under each condition."""
    grown: dict[str, list[History]] = {}
    cases = []
    for point in points:
        settings = point.settings
        structure, robot, robots = settings.structure, settings.robot, settings.robots
        kind = repr((structure, robot, robots))
        if kind not in grown:
            with progress.task("grow", len(seeds) * robots) as advance:
                grown[kind] = grow(
                    structure, robots=robots, seeds=seeds, robot=robot, on_progress=advance
                )
        for history in grown[kind]:
            log = observe(history, settings.sensing)
            cases.append(TrainingCase(point.label, log, history.position, _params(point)))
    return cases


def _errors(cases: Sequence[TrainingCase], values: Mapping[str, float]) -> dict[str, Any]:
    """Return the mean errors with such gains, over all cases and over those of each label."""
    params = [_with_gains(case.params, values) for case in cases]
    estimates = localize_many([case.log for case in cases], params)
    of_point: dict[str, list[float]] = {}
    sse = []
    for case, estimate in zip(cases, estimates, strict=True):
        sse.append(metrics.sse(estimate.position, case.true))
        of_point.setdefault(case.label, []).append(metrics.rmse(estimate.position, case.true))
    every = np.concatenate(list(of_point.values()))
    means = [round(float(np.mean(errors)), 4) for errors in of_point.values()]
    return {
        "sse_R2": round(float(np.mean(sse)), 4),
        "rmse_R": round(float(every.mean()), 6),
        "by_point_R": means,
    }


def growth_of_a_nudge(cases: Sequence[TrainingCase], values: Mapping[str, float]) -> float:
    """Return how many times as far as the anchor any robot moves, if that is raised a little."""
    params = [_with_gains(case.params, values) for case in cases]
    logs = [case.log for case in cases]
    up = np.array([0.0, 0.0, _NUDGE])
    raised = [replace(log, anchor_position=log.anchor_position + up) for log in logs]
    both = zip(localize_many(logs, params), localize_many(raised, params), strict=True)
    return max(float(np.abs(a.position - b.position).max()) for a, b in both) / _NUDGE


def _with_gains(params: VirtualForceParams, values: Mapping[str, float]) -> VirtualForceParams:
    gains: dict[str, Any] = {name: values.get(name, NO_CAP) for name in GAINS}
    if rounds := params.back_propagation:
        of_rounds: dict[str, Any] = {name: values[name] for name in _ROUND_GAINS}
        gains["back_propagation"] = replace(rounds, **of_rounds)
    return replace(params, **gains)


def _optuna_version() -> str:
    try:
        import cmaes  # noqa: F401, PLC0415 - slow to import, and of the extra
        import optuna  # noqa: PLC0415
    except ImportError as error:
        msg = f"{error.name} is not installed; pip install '.[bench]'"
        raise EnvironmentTroubleError(msg) from error
    return str(optuna.__version__)


def _replayed_study(
    first: dict[str, float],
    done: Sequence[Mapping[str, Any]],
    ranges: _Ranges,
    score: _Score,
    path: Path,
) -> "Study":
    """Make a sampler that starts with the gains `first`, and bring it past the trials done."""
    import optuna  # noqa: PLC0415 - slow to import, and an extra

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(sampler=optuna.samplers.CmaEsSampler(seed=_SAMPLER_SEED))
    study.enqueue_trial(first)
    for row in done:
        trial = study.ask()
        if _suggested(trial, ranges) != {name: row[name] for name in ranges}:
            raise InputError("its trials do not repeat here; give another --out", path=path)
        study.tell(trial, row[score.column])
    return study


def _suggested(trial: "Trial", ranges: _Ranges) -> dict[str, Any]:
    return {name: trial.suggest_float(name, *ends, log=True) for name, ends in ranges.items()}


def _read_trials(path: Path, record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Read the trials of an earlier record of the same fit; none where there is no record."""
    if not path.exists():
        return []
    try:
        earlier = json.loads(path.read_text(encoding="utf-8"))
        trials: list[dict[str, Any]] = earlier["trials"]
        same = all(earlier.get(name) == value for name, value in record.items())
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError("is no record of a fit; give another --out", path=path) from error
    if not same:
        problem = "is the record of a fit with other settings or other code; give another --out"
        raise InputError(problem, path=path)
    return trials


def _outcome(done: Sequence[dict[str, Any]], score: _Score) -> dict[str, Any]:
    """Return the best trial, and the chosen one, of those that are stable if any are."""
    done = [row for row in done if row.get("growth", 0.0) <= _STABLE] or done
    best = min(done, key=lambda row: row[score.column])
    limit = score.as_good * best[score.column]
    as_good = [row for row in done if row[score.column] <= limit]
    return {"best": best, "chosen": min(as_good, key=lambda row: row["repulsion_gain"])}


def _write(path: Path, record: Mapping[str, Any], done: Sequence[Mapping[str, Any]]) -> None:
    """Write the record, one line for each entry and each trial."""
    entries = [f" {json.dumps(name)}: {json.dumps(value)}" for name, value in record.items()]
    rows = ",\n".join(f"  {json.dumps(row)}" for row in done)
    text = ",\n".join([*entries, f' "trials": [\n{rows}\n ]'])
    write_bytes(path, f"{{\n{text}\n}}\n".encode())
