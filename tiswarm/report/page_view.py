"""What the page's view in space needs: poses and errors of a few cases, as plain data."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tiswarm.report.folder import Case
from tiswarm.report.render.pictures import CaseView, read_case_view

MOST_CASES = 12
MOST_ROBOTS = 10_000
"""Robots of all cases together; the page must stay small and quick."""

DIGITS = 4


@dataclass(frozen=True, kw_only=True)
class View:
    """Cases that can be looked at from all sides."""

    data: dict[str, Any]
    """Dock offsets [R], and of each case poses and errors [R] in join order."""

    note: str


def build_view(cases: Sequence[Case]) -> View | None:
    """Take the first case of each series, as many as there is room for; None if there is none.

    Raises:
        InputError: where a table of a case is missing or damaged.
    """
    first = {case.series: case for case in reversed(cases) if case.done}
    chosen = [case for case in cases if case.done and first[case.series] is case]
    if not chosen:
        return None
    view = read_case_view(chosen[0])
    shown = [_data(view)]
    for case in chosen[1:MOST_CASES]:
        data = _data(read_case_view(case))
        if sum(len(other["robot"]) for other in [*shown, data]) > MOST_ROBOTS:
            break
        shown.append(data)
    done, robots = sum(case.done for case in cases), len(view.pose)
    notes = [f"{len(shown)} of {done} cases are here."] if len(shown) < done else []
    if robots > MOST_ROBOTS:
        notes.append(f"Of {robots} robots, those that joined first are here.")
    return View(
        data={"offsets": view.dock_offset_body.round(DIGITS).tolist(), "cases": shown},
        note=" ".join(notes),
    )


def _data(view: CaseView) -> dict[str, Any]:
    """Poses and errors of the robots that have an estimate, the first to join if they are many."""
    table = np.column_stack([view.error, view.pose, view.estimated_pose])
    known = np.flatnonzero(np.isfinite(table).all(axis=1))[:MOST_ROBOTS]
    error, true, turn, estimate, sensed = np.split(
        table[known].round(DIGITS), [1, 4, 8, 11], axis=1
    )
    return {
        "name": view.case.name,
        "robot": view.robot[known].tolist(),
        "error": error[:, 0].tolist(),
        "worst": max(float(error.max(initial=0.0)), 1e-3),
        "true": true.tolist(),
        "turn": turn.tolist(),
        "estimate": estimate.tolist(),
        "sensed": sensed.tolist(),
    }
