"""What the page's view in space needs: poses and errors of a few cases, as plain data."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tiswarm.report.folder import Case, read_columns
from tiswarm.report.render.build import ESTIMATED_POSE, POSE, read_header

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
    shown: list[dict[str, Any]] = []
    robots = 0
    for case in chosen[:MOST_CASES]:
        data = _data(case)
        robots += len(data["robot"])
        if robots > MOST_ROBOTS:
            break
        shown.append(data)
    if not shown:
        return None
    header = read_header(chosen[0])
    offsets = np.array(header.dock_offsets) / header.dock_radius
    done = sum(case.done for case in cases)
    left_out = f"{len(shown)} of {done} cases are here." if len(shown) < done else ""
    return View(
        data={"offsets": offsets.round(DIGITS).tolist(), "cases": shown},
        note=left_out,
    )


def _data(case: Case) -> dict[str, Any]:
    """Poses and errors of the robots that have an estimate."""
    names = ["robot", "error_R", *POSE, *ESTIMATED_POSE]
    table = read_columns(case.folder / "robots.csv", names)
    table = table[np.isfinite(table).all(axis=1)].round(DIGITS)
    return {
        "name": case.name,
        "robot": table[:, 0].astype(int).tolist(),
        "error": table[:, 1].tolist(),
        "worst": max(float(table[:, 1].max(initial=0.0)), 1e-3),
        "true": table[:, 2:5].tolist(),
        "turn": table[:, 5:9].tolist(),
        "estimate": table[:, 9:12].tolist(),
        "sensed": table[:, 12:16].tolist(),
    }
