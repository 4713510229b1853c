"""Whole runs of the best candidates of a design, on structures that the search did not see."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from tiswarm.base.errors import CasesFailedError
from tiswarm.base.params import AnyArch
from tiswarm.base.progress import Progress
from tiswarm.records.frames import read_frame
from tiswarm.records.measures import RMSE
from tiswarm.scenario.model import Scenario
from tiswarm.study.design.candidates import PRICE
from tiswarm.study.design.goals import Goal
from tiswarm.study.design.search import SearchResult
from tiswarm.study.run import run

MOST_RUN = 8
"""Most candidates that are run."""


def choose(result: SearchResult, objectives: int) -> list[int]:
    """Choose the candidates to run, the best first.

    Of several objectives it is the front, and of a long front every so many. Of one objective it
    is the best candidates that reach the goal.

    Args:
        result: What the search found.
        objectives: Number of goals, and of prices.
    """
    wanted = result.front if objectives > 1 else result.reaches
    ordered = [int(number) for number in result.order if wanted[number]]
    if objectives == 1 or len(ordered) <= MOST_RUN:
        return ordered[:MOST_RUN]
    places = np.linspace(0, len(ordered) - 1, MOST_RUN).round().astype(int)
    return [ordered[place] for place in places.tolist()]


def verify(
    studies: Sequence[Scenario],
    goals: Sequence[Goal],
    *,
    parent: Path,
    progress: Progress,
    arch: AnyArch,
    threads: int | None,
) -> pd.DataFrame:
    """Run the studies of the best candidates, with the method of their scenario.

    Args:
        studies: A study for each candidate.
        goals: Goals whose results are tabulated.
        parent: Folder that holds the folders of the runs.
        progress: Receives progress reports.
        arch: Device of methods that are parallel.
        threads: CPU threads; all if None.

    Returns:
        A row for each candidate: number of structures, mean, least and greatest value of each goal.

    Raises:
        CasesFailedError: no case could be computed.
    """
    rows = []
    reasons = []
    for study in studies:
        result = run(study, parent, progress=progress, arch=arch, threads=threads)
        reasons.append(result.what_failed)
        summary = read_frame(result.folder / "summary.csv", empty=True)
        rows.append(_statistics(summary, goals))
    table = pd.DataFrame(rows)
    if not table["fresh_structures"].any():
        raise CasesFailedError(reasons[0])
    return table


def _statistics(cases: pd.DataFrame, goals: Sequence[Goal]) -> dict[str, float]:
    """Average the goals' results over the cases of a candidate; a failed case makes them NaN."""
    done = cases["status"] == "done"
    row: dict[str, float] = {"fresh_structures": int(done.sum())}
    for goal in goals:
        if goal.name == PRICE:
            continue
        column = cases.get(goal.name, pd.Series(np.nan, cases.index))
        values = column.astype(float).where(done).to_numpy()
        mean = values.mean()
        if goal.name == RMSE.column:
            mean = np.sqrt((values**2).mean())  # as the prediction is over structures and robots
        row[f"found_{goal.name}"] = float(mean)
        row[f"least_{goal.name}"] = float(values.min())
        row[f"most_{goal.name}"] = float(values.max())
    return row
