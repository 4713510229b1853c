"""Search of a design: predicted errors of sensor suites, and structures grown by each setting.

The error of a suite is not measured but predicted: the measurements that robots would take,
linearized at their true positions, state how precise positions can be. No robot is localized.
Growth is tried by successive halving: all settings on few seeds, the better half, and all that
nothing surpasses, on twice as many.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiswarm.base.aliases import AnyInts, Bools, Reals
from tiswarm.base.errors import InputError, require_name
from tiswarm.base.progress import Advance, Progress
from tiswarm.compute import backend
from tiswarm.evaluation.tables import evaluate
from tiswarm.localization.mixture.assessment import expected_square
from tiswarm.records import measures
from tiswarm.records.measures import RMSE
from tiswarm.scenario.model import Scenario
from tiswarm.sensing import SensingParams, observe
from tiswarm.study.design.candidates import PRICE, Candidate, Part
from tiswarm.study.design.goals import Goal, on_front, surpassed_by
from tiswarm.study.navigation import navigate
from tiswarm.world import growth
from tiswarm.world.history import History
from tiswarm.world.history_file import find_fault

FIRST_SEED = 2_000_000
"""First seed of the structures that a search sees."""

FIRST_FRESH_SEED = 3_000_000
"""First seed of the structures that the best candidates are run on."""

MOST_SEEDS = 10_000
"""Most structures of either kind, so that their seeds are disjoint."""

_FIRST_SEEDS = 2
"""Seeds of the first stage of successive halving."""


@dataclass(frozen=True, kw_only=True)
class SearchResult:
    """What a search found of n candidates."""

    results: Mapping[str, Reals]
    """Results by name, means over structures, each of shape (n,); NaN where unknown."""

    structures: AnyInts
    """Structures that each candidate was tried on, shape (n,)."""

    reaches: Bools
    """Whether each reaches all goals, shape (n,)."""

    front: Bools
    """Whether no other candidate that reaches all goals surpasses it, shape (n,)."""

    order: AnyInts
    """Candidates from the best on, shape (n,): those that reach all goals, then by price if there
    are prices, then by the goals in their order."""


def require_results(goals: Sequence[Goal], part: Part, *, priced: bool) -> None:
    """Refuse goals that candidates have no result for.

    Args:
        goals: What results should be.
        part: What differs between candidates.
        priced: Whether they have prices.

    Raises:
        InputError: a goal has a name that no result has, or that of another part.
    """
    of_growth = [
        measure.column
        for measure in measures.MEASURES.values()
        if not (measure.needs_estimate or measure.is_of_engine)
    ]
    names = [RMSE.column] if part == "sensing" else of_growth
    for goal in goals:
        problem = ""
        if goal.name == PRICE and not priced:
            problem = "needs prices; add a table of them"
        elif part == "sensing" and goal.name in of_growth:
            problem = f"sensors do not change it; ask for {RMSE.column}, or vary structure"
        elif part == "growth" and goal.name == RMSE.column:
            problem = "is a goal of sensors; vary keys of sensing, or ask for a size or load"
        if problem:
            raise InputError(f"{goal.name}: {problem}", argument="goals")
        require_name(goal.name, [*names, PRICE], "goals")


def search(
    base: Scenario,
    candidates: Sequence[Candidate],
    part: Part,
    goals: Sequence[Goal],
    *,
    seeds: int,
    threads: int | None,
    progress: Progress,
) -> SearchResult:
    """Predict or grow the results of candidates, and order them.

    Args:
        base: Scenario that the candidates are of.
        candidates: What to choose from.
        part: What differs between them.
        goals: What their results should be.
        seeds: Structures that a candidate is tried on, at most.
        threads: CPU threads; all that this process may use if None.
        progress: Receives progress reports.

    Raises:
        InputError: no structure can be grown, or none has a result that a goal names.
    """
    backend.choose(threads=threads)
    backend.processor()
    seed_list = range(FIRST_SEED, FIRST_SEED + seeds)
    structures: AnyInts
    if part == "sensing":
        histories = _grow_alike(base, seed_list, progress)
        with progress.task("predict", len(candidates)) as advance:
            rmse = predict(candidates, histories, advance)
        results = {RMSE.column: rmse}
        structures = np.full(len(candidates), seeds)
    else:
        results, structures = _halve(candidates, goals, seed_list, progress)
    return _judged(candidates, goals, results, structures)


def predict(
    candidates: Sequence[Candidate], histories: Sequence[History], advance: Advance
) -> Reals:
    """Predict the RMSE of sensor suites on some structures.

    Returns:
        Root of the mean square error over structures and their robots [R], shape (n,).
    """
    rmse = np.zeros(len(candidates))
    for number, candidate in enumerate(candidates):
        sensing = without_errors(candidate.settings.sensing)
        cues = candidate.settings.localization.used_cues
        squares = []
        for history in histories:
            log = observe(history, sensing)
            unit = log.dock_radius
            squares.append(unit**2 * expected_square(log, cues, history.position / unit))
        rmse[number] = np.sqrt(np.mean(squares))
        advance(1)
    return rmse


def without_errors(sensing: SensingParams) -> SensingParams:
    """Return settings without contacts that are wrong, which robust methods leave out as outliers.

    One at a wrong dock counts as missed, a false one as never sensed.
    """
    right = (1.0 - sensing.missed_contacts) * (1.0 - sensing.wrong_docks)
    return replace(sensing, missed_contacts=1.0 - right, wrong_docks=0.0, false_contacts=0.0)


def _grow_alike(base: Scenario, seeds: Sequence[int], progress: Progress) -> list[History]:
    """Grow the structures of a scenario on some seeds.

    Raises:
        InputError: a structure is invalid, or no robot joined it.
    """
    with progress.task("grow", len(seeds) * base.robots) as advance:
        histories = growth.grow(
            base.structure,
            robots=base.robots,
            seeds=seeds,
            robot=base.robot,
            on_progress=advance,
            **navigate(base),
        )
    for history in histories:
        fault = _fault(history, base)
        if fault:
            problem = f"seed {history.seed}: {fault}; correct the scenario"
            raise InputError(problem, key="structure")
    return histories


def _fault(history: History, settings: Scenario) -> str:
    """Say why a structure cannot be used; empty if it can."""
    if history.robot_count < 2:  # noqa: PLR2004 - the anchor alone
        return history.ended or "only one robot joined"
    return find_fault(history, contact_gap=settings.structure.climb.contact_gap)


def _halve(
    candidates: Sequence[Candidate],
    goals: Sequence[Goal],
    seeds: Sequence[int],
    progress: Progress,
) -> tuple[dict[str, Reals], AnyInts]:
    """Grow candidates by successive halving.

    Returns:
        Results by the names of goals, and the structures that each candidate was tried on; results
        of a candidate with an invalid structure are NaN.
    """
    names = [goal.name for goal in goals if goal.name != PRICE]
    scores = np.full((len(candidates), len(seeds), len(names)), np.nan)
    tried = np.zeros(len(candidates), np.int64)
    remaining: AnyInts = np.arange(len(candidates))
    while True:
        begin = int(tried[remaining[0]])
        end = min(len(seeds), max(_FIRST_SEEDS, 2 * begin))
        chosen = [candidates[number] for number in remaining.tolist()]
        scores[remaining, begin:end] = _grow_and_score(chosen, names, seeds[begin:end], progress)
        tried[remaining] = end
        if not begin:
            _require_results(names, scores)
        means = {
            name: np.array([row[:count].mean() for row, count in zip(of_name, tried, strict=True)])
            for name, of_name in zip(names, np.moveaxis(scores, -1, 0), strict=True)
        }
        if end == len(seeds):
            return means, tried
        price = np.array([candidate.price for candidate in candidates])
        of_remaining = {name: of[remaining] for name, of in {**means, PRICE: price}.items()}
        remaining = remaining[better(goals, of_remaining)]


def _require_results(names: Sequence[str], scores: Reals) -> None:
    """Refuse a goal whose result no structure has.

    Raises:
        InputError: there is such a goal.
    """
    for name, of_name in zip(names, np.moveaxis(scores, -1, 0), strict=True):
        if np.isnan(of_name).all():
            meaning = measures.MEASURES[name].meaning
            problem = f"no structure of this scenario has {name}: {meaning}; give another goal"
            raise InputError(problem, argument="goals")


def _grow_and_score(
    candidates: Sequence[Candidate], names: Sequence[str], seeds: Sequence[int], progress: Progress
) -> Reals:
    """Grow each candidate on each seed, all that can be side by side; return named scores.

    Returns:
        Scores, shape (n, seeds, names); NaN of invalid structures.
    """
    batches: dict[tuple[int, str], list[int]] = {}
    for number, candidate in enumerate(candidates):
        settings = candidate.settings
        key = f"{growth.batch_key(settings.structure)} {settings.robot}"
        batches.setdefault((settings.robots, key), []).append(number)
    scores = np.full((len(candidates), len(seeds), len(names)), np.nan)
    total = sum(candidate.settings.robots for candidate in candidates) * len(seeds)
    with progress.task(f"grow {len(candidates)} candidates", total) as advance:
        for (robots, _), numbers in batches.items():
            first = candidates[numbers[0]].settings
            histories = growth.grow_each(
                [candidates[number].settings.structure for number in numbers for _ in seeds],
                robots=robots,
                seeds=[*seeds] * len(numbers),
                robot=first.robot,
                on_progress=advance,
                **navigate(first),
            )
            for place, history in enumerate(histories):
                number = numbers[place // len(seeds)]
                settings = candidates[number].settings
                scores[number, place % len(seeds)] = _scores(history, settings, names)
    return scores


def _scores(history: History, settings: Scenario, names: Sequence[str]) -> list[float]:
    """Measure a structure; NaN if it is invalid."""
    if _fault(history, settings):
        return [np.nan] * len(names)
    log = observe(history, SensingParams())
    measured = evaluate(history, log, None, (), settings.structure.strength).scores
    return [float(measured.get(name, np.nan)) for name in names]


def _judged(
    candidates: Sequence[Candidate],
    goals: Sequence[Goal],
    results: Mapping[str, Reals],
    structures: AnyInts,
) -> SearchResult:
    """Judge the results of candidates; those that were tried on fewer structures come last."""
    results = {**results, PRICE: np.array([candidate.price for candidate in candidates])}
    reaches = np.all([goal.is_reached(results[goal.name]) for goal in goals], axis=0)
    reaches &= structures == structures.max()
    cost = _costs(goals, results)
    front = np.zeros(len(candidates), np.bool_)
    front[reaches] = on_front(cost[reaches])
    order = np.lexsort([*cost.T[::-1], ~reaches, -structures])
    return SearchResult(
        results=results, structures=structures, reaches=reaches, front=front, order=order
    )


def better(goals: Sequence[Goal], results: Mapping[str, Reals]) -> AnyInts:
    """Choose the better half of candidates, and further ones that no other surpasses; sorted.

    Those that reach the goals come first, then those that few surpass. A front of several goals may
    be longer than half. Of candidates with the same results, one goes on beyond the half.
    """
    reaches = np.all([goal.is_reached(results[goal.name]) for goal in goals], axis=0)
    cost = _costs(goals, results)
    surpassed = surpassed_by(cost)
    order = np.lexsort([*cost.T[::-1], surpassed, ~reaches])
    half = order[: (len(order) + 1) // 2]
    front = np.flatnonzero((surpassed == 0) & reaches)
    _, first = np.unique(cost[front], axis=0, return_index=True)
    chosen: AnyInts = np.union1d(half, front[first])
    return chosen


def _costs(goals: Sequence[Goal], results: Mapping[str, Reals]) -> Reals:
    """Return costs of n candidates, the one that matters most first, shape (n, k).

    Where goals have bounds, it is the price: the cheapest candidate that reaches them is the best.
    Goals without bounds come before those with bounds, which are reached or not.
    """
    bounded = [goal for goal in goals if not np.isnan(goal.bound)]
    unbounded = [goal for goal in goals if np.isnan(goal.bound)]
    price = Goal(name=PRICE, larger=False)
    others = [*unbounded, *bounded]
    if any(goal.name == PRICE for goal in goals):
        ordered = others
    elif bounded:
        ordered = [price, *others]
    else:
        ordered = [*others, price]
    return np.column_stack([goal.cost(results[goal.name]) for goal in ordered])
