"""The data of a page's 3D view: poses, contacts, ground and colors of each case."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.records.estimate import MOST_WITHIN
from tiswarm.report.ground import ground_pieces
from tiswarm.report.run_data import RunData
from tiswarm.report.swarm_view import SwarmView, read_case_view

_MOST_CASES = 12  # in the view
MOST_ROBOTS = 100_000
"""Robots in the view, in all cases together."""

ALGORITHM_1 = ("virtual-force", "distributed algorithm-1")
"""Methods, as `summary.csv` names them, that are the paper's Algorithm 1."""

SD = "sd"
"""Label of the coloring by standard deviation, which is also the size of the spheres."""

_DIGITS = 4  # decimals of positions
_TRACE_DIGITS = 2  # decimals of positions in motion
_MOST_PLACES = 100_000  # positions in motion, in all cases together


class View(NamedTuple):
    """The cases of the 3D view."""

    data: dict[str, Any]  # as `space_data` returns it; `compared` if it starts with two cases
    title: str
    choice: str  # what the menu offers
    note: str

    @property
    def has_truth(self) -> bool:
        """Whether a case has true poses."""
        return any(case["true"] for case in self.data["cases"])

    @property
    def has_sd(self) -> bool:
        """Whether a case has standard deviations, which spheres show."""
        return any(color["label"] == SD for case in self.data["cases"] for color in case["colors"])


class Coloring(NamedTuple):
    """A quantity that colors the estimate; the view adds hops and the join index."""

    label: str
    unit: str  # may be empty
    value: Reals  # NaN where unknown, shape (N,)


def build_view(run: RunData) -> View | None:
    """Take the first case of each series, within the limits; None if no case is done.

    The view opens on the first two.
    """
    shown: list[dict[str, Any]] = []
    notes = []
    first = first_series(run)
    series = [*first, *(name for name in run.series if name not in first)]
    for case in [run.series[name][0] for name in series][:_MOST_CASES]:
        seed = case.name.partition("-")[0]
        view = replace(read_case_view(case), name=f"{case.series or case.name}, seed {seed}")
        values = [("error", "R", view.error), (SD, "R", view.sd)]
        values.append(("sensed force", "dock weights", view.force))
        data = view_data(view, [Coloring(*value) for value in values])
        if sum(len(other["robot"]) for other in [*shown, data]) > MOST_ROBOTS:
            break
        if data["robot"]:
            places = sum(_places(each) for each in [*shown, data])
            shown.append(data if places <= _MOST_PLACES else {**data, "trace": None})
        if len(view.robot) > MOST_ROBOTS:
            notes = [f"It contains the first {MOST_ROBOTS} of {len(view.robot)} robots."]
    if not shown:
        return None
    if len(shown) < (done := sum(case.done for case in run.cases)):
        notes.insert(0, f"The view contains {len(shown)} of {done} cases.")
    return View(
        data=space_data(view.dock_offset_body, shown) | {"compared": True},
        title="True and estimated positions",
        choice="Case",
        note=" ".join(notes),
    )


def first_series(run: RunData) -> list[str]:
    """Choose the series of the greatest interest: the least mean RMSE, and Algorithm 1.

    Both are of the first point of the sweep that Algorithm 1 localizes; of the first point where
    it localizes none, and then the other series is that with the next least RMSE.
    """
    if "rmse_R" not in run.summary:
        return []
    error = run.summary.groupby("series", sort=False)["rmse_R"].mean()
    known = {name: cases[0] for name, cases in run.series.items() if math.isfinite(error[name])}
    rivals = [name for name, case in known.items() if case.method in ALGORITHM_1]
    start = known[next(iter([*rivals, *known]))].point if known else ""
    alike = sorted((name for name in known if known[name].point == start), key=lambda n: error[n])
    others = [name for name in rivals if name in alike[1:]] or alike[1:]
    return [*alike[:1], *others[:1]]


def _places(data: dict[str, Any]) -> int:
    """Count the positions in motion of a case."""
    return len(data["robot"]) * len(data["trace"]["iteration"]) if data["trace"] else 0


def space_data(
    offset: Reals, cases: Sequence[dict[str, Any]], *, radius: float = 1.0, unit: str = "R"
) -> dict[str, Any]:
    """Gather the data of the 3D view.

    Args:
        offset: Vectors from center to dock, body frame [R], shape (docks, 3).
        cases: Cases as `view_data` returns them.
        radius: R in the unit of the labels.
        unit: Unit of the labels along the axes.
    """
    return {
        "offsets": _rounded(offset),
        "cases": cases,
        "radius": radius,
        "unit": unit,
        "score": "RMSE" if any(case["true"] for case in cases) else "",
        "sphere": MOST_WITHIN,  # radius of a sphere [sd]
    }


def view_data(view: SwarmView, colorings: Sequence[Coloring] = ()) -> dict[str, Any]:
    """List what the 3D view needs of the robots that have an estimate, the first ones if too many.

    Without a true pose, the lists of true centers and turns are empty.
    """
    known = np.flatnonzero(np.isfinite(view.estimated_pose).all(axis=1))[:MOST_ROBOTS]
    estimated, true = view.estimated_pose[known], view.pose[known]
    if not np.isfinite(true).all():
        true = true[:0]
    return {
        "name": view.name,
        "robot": view.robot[known].tolist(),
        "true": _rounded(true[:, :3]),
        "turn": _rounded(true[:, 3:]),
        "estimate": _rounded(estimated[:, :3]),
        "sensed": _rounded(estimated[:, 3:]),
        "colors": [
            {"label": label, "unit": unit, "value": [_value(v) for v in value[known].tolist()]}
            for label, unit, value in colorings
            if np.isfinite(value[known]).any()
        ],
        "contacts": _contacts(view, known),
        "ground": _ground(view, true if len(true) else estimated),
        "trace": _trace(view, known),
    }


def _rounded(values: Reals) -> list[Any]:
    rounded: list[Any] = values.round(_DIGITS).tolist()
    return rounded


def _value(value: float) -> float | None:
    return None if math.isnan(value) else float(f"{value:.4g}")


def _contacts(view: SwarmView, known: Ints) -> list[list[int]]:
    """List contacts of known robots: their places in the list, and a dock of each."""
    place = np.full(len(view.robot), -1)
    place[known] = np.arange(len(known))
    contacts = view.log.contacts.copy()
    contacts[:, [0, 2]] = place[contacts[:, [0, 2]]]
    found: list[list[int]] = contacts[(contacts >= 0).all(axis=1)].tolist()
    return found


def _trace(view: SwarmView, known: Ints) -> dict[str, list[Any]] | None:
    """List the centers of known robots at some iterations; None where none are stored."""
    trace = view.read_trace()
    if trace is None:
        return None
    center = trace.center[:, known].round(_TRACE_DIGITS).tolist()
    return {"iteration": trace.iteration.tolist(), "center": center}


def _ground(view: SwarmView, pose: Reals) -> list[Any]:
    """List the pieces of ground around robots, each a list of faces with four corners [R]."""
    if view.terrain is None or not len(pose):
        return []
    dock = pose[:, None, :3] + dock_offsets(pose[:, 3:], view.dock_offset_body)
    return [_rounded(faces) for faces in ground_pieces(view.terrain, dock.reshape(-1, 3))]
