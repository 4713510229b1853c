"""What the page's view in space needs: poses and errors of a few cases, as plain data."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tiswarm.report.folder import Case
from tiswarm.report.render.subjects import Subject, read_subject

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
    """What is left out."""


def build_view(cases: Sequence[Case]) -> View | None:
    """Take the first case of each series, as many as there is room for; None if there is none.

    Raises:
        InputError: where a table of a case is missing or damaged.
    """
    first = {case.series: case for case in reversed(cases) if case.done}
    chosen = [case for case in cases if case.done and first[case.series] is case]
    subjects: list[Subject] = []
    for case in chosen[:MOST_CASES]:
        subjects.append(read_subject(case))
        if sum(len(subject.pose) for subject in subjects) > MOST_ROBOTS:
            subjects.pop()
            break
    if not subjects:
        return None
    done = sum(case.done for case in cases)
    log = subjects[0].log
    return View(
        data={
            "offsets": (log.dock_offset_body / log.dock_radius).round(DIGITS).tolist(),
            "cases": [_data(subject) for subject in subjects],
        },
        note=f"{len(subjects)} of {done} cases are here." if len(subjects) < done else "",
    )


def _data(subject: Subject) -> dict[str, Any]:
    """Poses and errors of the robots that have an estimate."""
    table = np.column_stack([subject.error, subject.pose, subject.estimated_pose])
    known = np.isfinite(table).all(axis=1)
    error, true, turn, estimate, sensed = np.split(
        table[known].round(DIGITS), [1, 4, 8, 11], axis=1
    )
    return {
        "name": subject.case.name,
        "robot": subject.robot[known].tolist(),
        "error": error[:, 0].tolist(),
        "worst": max(float(error.max(initial=0.0)), 1e-3),
        "true": true.tolist(),
        "turn": turn.tolist(),
        "estimate": estimate.tolist(),
        "sensed": sensed.tolist(),
    }
