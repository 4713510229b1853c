"""A design as a caller has it: a table of candidates, the best scenario, and files."""

import json
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tiswarm.app.console import ConsoleProgress
from tiswarm.base.errors import InputError
from tiswarm.base.params import AnyArch
from tiswarm.records.frames import write_frame
from tiswarm.records.messages import counted, shown
from tiswarm.records.outputs import Outputs
from tiswarm.report.design_figure import draw_front
from tiswarm.report.design_page import design_page
from tiswarm.report.figure_style import write
from tiswarm.scenario.model import Scenario, dump_scenario, to_plain
from tiswarm.study.design.candidates import (
    PRICE,
    Candidate,
    base_scenario,
    list_candidates,
    part_of,
    require_sensing,
    study_of,
)
from tiswarm.study.design.goals import Goal, parse_goals
from tiswarm.study.design.prices import Prices
from tiswarm.study.design.search import (
    FIRST_FRESH_SEED,
    FIRST_SEED,
    MOST_SEEDS,
    SearchResult,
    require_results,
    search,
)
from tiswarm.study.design.verification import choose, verify
from tiswarm.study.store import refuse_run_as_parent

FILES = ("design.yaml", "design.csv", "design.png", "design.html")
"""Files of a design: its scenario, its table, with several objectives a figure of the front, and a
page of all candidates."""

USUAL_SEEDS = {"sensing": 12, "growth": 8}
"""Structures that a candidate is tried on, by what is designed."""


@dataclass(frozen=True)
class Design:
    """The candidates of a design, and the best of them."""

    table: pd.DataFrame
    """A row for each candidate, the best first: its values, price, predicted results, whether it
    reaches the goals and is on the front; of those that were run, results on fresh seeds."""

    scenario: Mapping[str, Any]
    """The scenario with the best candidate and the fresh seeds, which `tiswarm.run` takes."""

    goals: tuple[str, ...]
    """The goals."""

    note: str
    """Which structures the search saw, and which ones the best candidates were run on."""

    folder: Path | None = None
    """Folder with `design.yaml`, `design.csv`, the page `design.html`, with several objectives
    `design.png`, and the runs on fresh seeds; None without one."""

    @property
    def front(self) -> pd.DataFrame:
        """The candidates that no other one surpasses."""
        return self.table[self.table["front"]].reset_index(drop=True)

    @property
    def verified(self) -> pd.DataFrame:
        """The candidates that were run on fresh seeds."""
        return self.table[self.table["fresh_structures"] > 0].reset_index(drop=True)

    @property
    def verdict(self) -> str:
        """Whether the best candidate reaches the goals on fresh seeds, in a sentence."""
        is_reached = bool(self.table["found_reaches"].iloc[0])
        return f"on fresh seeds the first {'reaches' if is_reached else 'does not reach'} the goals"

    def __str__(self) -> str:
        """Tabulate the candidates that were run, and say on what."""
        text = _shortened(self.verified).to_string(index=False, na_rep="")
        lines = [self.summary, text, self.note, self.verdict]
        if self.folder is not None:
            written = [name for name in FILES if (self.folder / name).exists()]
            lines.append(f"{', '.join(written)} in {self.folder}")
        return "\n".join(lines)

    @property
    def summary(self) -> str:
        """How many candidates reach the bounds, and what else was asked for."""
        count = counted(len(self.table), "candidate")
        bounds = " and ".join(goal for goal in self.goals if ":" not in goal)
        best = " and ".join(goal for goal in self.goals if ":" in goal)
        reached = f"{self.table['reaches'].sum()} of {count} reach {bounds}" if bounds else count
        return f"{reached}, for {best}" if best else reached

    def _repr_html_(self) -> str:
        return f"{_shortened(self.verified).to_html(index=False, na_rep='')}<p>{self.note}</p>"


def _shortened(table: pd.DataFrame) -> pd.DataFrame:
    """Leave out columns that all rows share or that files have, and round numbers."""
    kept = [
        name
        for name in table.columns
        if name not in {"reaches", "front", "structures", "fresh_structures"}
        and not name.startswith(("least_", "most_"))
    ]
    short = table[kept].copy()
    for name in short.select_dtypes("number"):
        short[name] = [float(f"{value:.3g}") for value in short[name]]
    short.columns = [name.removeprefix("sensing.").removeprefix("structure.") for name in kept]
    return short


def design(
    scenario: Scenario,
    goals: Sequence[str],
    vary: Mapping[str, Sequence[Any]],
    prices: Prices | None,
    *,
    condition: str | None,
    seeds: int | None,
    fresh: int,
    out: Path | None,
    overwrite: bool,
    arch: AnyArch,
    threads: int | None,
    quiet: bool,
) -> Design:
    """Find the best candidates of a scenario; `tiswarm.design` explains the arguments."""
    part = part_of([*vary])
    base = base_scenario(scenario, condition)
    wanted = parse_goals(goals)
    require_results(wanted, part, priced=prices is not None)
    if part == "sensing":
        require_sensing(base, wanted)
    count = USUAL_SEEDS[part] if seeds is None else seeds
    for argument, number in (("seeds", count), ("fresh", fresh)):
        if not 1 <= number <= MOST_SEEDS:
            problem = f"{number} should be from 1 to {MOST_SEEDS:,}; correct it"
            raise InputError(problem, argument=argument)
    outputs = Outputs(overwrite=overwrite)
    if out is not None:
        refuse_run_as_parent(out)
        outputs.check({"out": [out / name for name in FILES]})
    candidates = list_candidates(base, vary, prices)
    progress = ConsoleProgress(quiet=quiet) if out is not None else _Unwatched(quiet=quiet)
    search_result = search(
        base, candidates, part, wanted, seeds=count, threads=threads, progress=progress
    )
    _require_reached(candidates, wanted, search_result)
    objectives = [goal.name for goal in wanted]
    if prices is not None:
        objectives = [PRICE, *(name for name in objectives if name != PRICE)]
    numbers = choose(search_result, len(objectives))
    studies = [
        study_of(candidates[number], place, first_seed=FIRST_FRESH_SEED, count=fresh)
        for place, number in enumerate(numbers, start=1)
    ]
    with ExitStack() as stack:
        # Without a folder of the user, the runs leave nothing behind but their results.
        parent = out or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        verified = verify(
            studies, wanted, parent=parent, progress=progress, arch=arch, threads=threads
        ).set_index(pd.Index(numbers))
    result = Design(
        table=_tabulate(candidates, wanted, search_result, verified, priced=prices is not None),
        scenario=to_plain(studies[0]),
        goals=tuple(map(str, wanted)),
        note=_note(part, count, fresh),
        folder=out,
    )
    if out is not None:
        outputs.write(out / FILES[0], dump_scenario(studies[0]).encode())
        write_frame(result.table, out / FILES[1], opened=outputs.opened)
        if len(objectives) > 1:
            write(out / FILES[2], lambda: draw_front(result.table, objectives), outputs)
        page = design_page(
            result.table,
            [*vary],
            objectives,
            title=f"Design of {base.name}",
            result=result.summary,
            note=f"{result.note}; {result.verdict}",
            file=FILES[1],
        )
        outputs.write(out / FILES[3], page.encode())
    return result


class _Unwatched(ConsoleProgress):
    """Progress of runs in a temporary folder, which is gone before a user could watch it."""

    def begun(self, run: Path) -> None:
        """Report nothing."""


def _note(part: str, seeds: int, fresh: int) -> str:
    searched = f"seeds {FIRST_SEED} to {FIRST_SEED + seeds - 1}"
    run = f"seeds {FIRST_FRESH_SEED} to {FIRST_FRESH_SEED + fresh - 1}"
    how = "predicted" if part == "sensing" else "searched"
    return f"{how} on {counted(seeds, 'structure')} ({searched}), found on {fresh} fresh ({run})"


def _require_reached(
    candidates: Sequence[Candidate], goals: Sequence[Goal], search_result: SearchResult
) -> None:
    """Refuse goals that no candidate reaches, and name the best that one has.

    Raises:
        InputError: no candidate reaches all goals.
    """
    if search_result.reaches.any():
        return
    full = search_result.structures == search_result.structures.max()
    reached = np.sum([goal.is_reached(search_result.results[goal.name]) for goal in goals], axis=0)
    bounded = [goal for goal in goals if not np.isnan(goal.bound)]
    costs = [goal.cost(search_result.results[goal.name]) for goal in bounded]
    number = int(np.lexsort([*costs[::-1], -reached, ~full])[0])
    best = " and ".join(
        f"{goal.name} {search_result.results[goal.name][number]:.3g}" for goal in goals
    )
    values = ", ".join(f"{key}={shown(value)}" for key, value in candidates[number].point.items())
    problem = (
        f"no candidate of {len(candidates)} reaches {' and '.join(map(str, goals))}; the best has "
        f"{best}, with {values}; vary other values, or ask for less"
    )
    raise InputError(problem, argument="goals")


def _tabulate(
    candidates: Sequence[Candidate],
    goals: Sequence[Goal],
    search_result: SearchResult,
    verified: pd.DataFrame,
    *,
    priced: bool,
) -> pd.DataFrame:
    """Tabulate candidates, the best first, with what was found on fresh seeds of those run."""
    keys = [*candidates[0].point]
    table = pd.DataFrame(
        {key: [_cell(candidate.point[key]) for candidate in candidates] for key in keys}
    )
    if priced:
        table[PRICE] = search_result.results[PRICE]
    names = [goal.name for goal in goals if goal.name != PRICE]
    for name in names:
        table[f"predicted_{name}"] = search_result.results[name]
    table["structures"] = search_result.structures
    table["reaches"] = search_result.reaches
    table["front"] = search_result.front
    reached = [
        goal.is_reached(verified[f"found_{goal.name}"].to_numpy())
        for goal in goals
        if goal.name != PRICE
    ]
    # A goal of the price alone needs no run to be reached.
    on_fresh = verified.assign(found_reaches=np.all(reached, axis=0) if reached else True)
    return table.join(on_fresh).loc[search_result.order].reset_index(drop=True)


def _cell(value: object) -> object:
    """Write a value for a table: numbers as they are, all else as a scenario has it."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return value if is_number or isinstance(value, str) else json.dumps(value)
