"""The page of a log and its estimate: what was found, how certain it is, and what remains open."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Ints, Reals
from tiswarm.measurements.contacts import contact_count
from tiswarm.measurements.verdicts import IMAGES_APART, distrust, in_brief
from tiswarm.records.estimate import Estimate
from tiswarm.records.messages import counted, decimals_for, percent
from tiswarm.records.sensing_log import SensingLog
from tiswarm.report.page import Page, Shown
from tiswarm.report.page_tables import MOST_ROWS, PageTable
from tiswarm.report.swarm_view import (
    MOST_ROBOTS,
    SD,
    Coloring,
    SwarmView,
    View,
    space_data,
    view_data,
)


def gather_log_page(
    view: SwarmView,
    estimate: Estimate,
    *,
    name: str,
    scores: Mapping[str, float],
    warnings: Sequence[str],
    notes: Sequence[str],
    advice: Sequence[Mapping[str, str]],
    figures: Sequence[Shown],
) -> Page:
    """Gather what the page of a log shows.

    Args:
        view: The log's robots, with their true positions where these are known.
        estimate: The estimate that `view` shows.
        name: Heading of the page.
        scores: Accuracy measures by name, in the log's unit; empty where the truth is unknown.
        warnings: What makes the estimate doubtful.
        notes: What the log leaves open, and what the method found, in lines.
        advice: Further measurements that would help, as rows of cells by heading.
        figures: How measurements narrow the place of a robot.
    """
    return Page(
        name=name,
        result=_result(view, estimate, scores),
        what=_in_words(view.log, estimate),
        warnings=warnings,
        notes=notes,
        headline=_summary(view, estimate, scores),
        tables=[*_causes(estimate), *_solutions(view, estimate), *_advice(advice)],
        view=_space(view, estimate),
        figures=figures,
        rows=_robots(view, estimate),
        rows_example="mirrored" if "mirrored" in estimate.known else "floppy",
    )


def _result(view: SwarmView, estimate: Estimate, scores: Mapping[str, float]) -> str:
    """State in sentences how many robots are near where they are shown, and their error."""
    sentences = [_capital(estimate.statement)]
    if scores:
        sentences.append(f"The RMSE is {scores['RMSE']:.3g} {view.log.length_unit}")
    departed = len(view.log.gone)
    if departed:
        sentences.append(f"{departed} left")
    return " ".join(f"{sentence}." for sentence in sentences)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _in_words(log: SensingLog, estimate: Estimate) -> str:
    """State in a line why robots may not be where they are shown."""
    text = in_brief(log, estimate)
    if distrust(log, estimate):
        names = [cause.parameter for cause in estimate.common_causes]
        text += f": a wrong {' or '.join(names)}, see Warnings" if names else ": see Warnings"
    sentences = []
    if text:
        sentences.append(_capital(text))
    floppy = estimate.known.count("floppy")
    if floppy:
        sentences.append(f"Floppy modes move {counted(floppy, 'robot')}")
    disconnected = estimate.known.count("disconnected")
    if disconnected:
        sentences.append(f"No measurement ties {counted(disconnected, 'robot')} to the anchor")
    measurements = _count(estimate.outlier_contacts) + _count(estimate.outlier_places)
    orientations = _count(estimate.outlier_robots)
    outliers = []
    if measurements:
        outliers.append(counted(measurements, "measurement"))
    if orientations:
        outliers.append(counted(orientations, "orientation"))
    if outliers:
        sentences.append(f"The estimate judges {' and '.join(outliers)} wrong")
    return " ".join(f"{sentence}." for sentence in sentences)


def _count(rows: Ints | None) -> int:
    return 0 if rows is None else len(rows)


def _tied_sd(view: SwarmView, estimate: Estimate) -> Reals:
    """Return the known sd of robots that are tied to the anchor, without it [log unit]."""
    sd: Reals = view.sd[1:][~estimate.disconnected[1:]] * view.log.dock_radius
    finite_sd: Reals = sd[np.isfinite(sd)]
    return finite_sd


def _summary(view: SwarmView, estimate: Estimate, scores: Mapping[str, float]) -> PageTable:
    """Tabulate sizes, uncertainty and, where the truth is known, accuracy."""
    unit = view.log.length_unit
    rows = {"robots": str(len(view.robot)), "contacts": str(len(view.log.contacts))}
    if len(view.log.gone):
        rows["robots that left, not scored"] = str(len(view.log.gone))
    sd = _tied_sd(view, estimate)
    if len(sd):
        rows |= {
            f"median sd [{unit}]": f"{np.median(sd):.3g}",
            f"largest sd [{unit}]": f"{sd.max():.3g}",
        }
    for name, value in scores.items():
        rows[name if "disparity" in name else f"{name} [{unit}]"] = f"{value:.3g}"
    frame = pd.DataFrame(rows.items(), columns=["quantity", "value"])
    note = "sd: standard deviation of the position of a robot that is tied to the anchor"
    return PageTable(
        frame=frame, words=["quantity"], title="Summary", note=f"{note}." if len(sd) else ""
    )


def _causes(estimate: Estimate) -> Iterator[PageTable]:
    """Tabulate the parameters that may be wrong."""
    causes = estimate.common_causes
    if not causes:
        return

    def written(values: Iterable[float]) -> list[str]:
        pairs = zip(values, causes, strict=True)
        return [f"{value:.{decimals_for(cause.sd)}f}" for value, cause in pairs]

    frame = pd.DataFrame(
        {
            "parameter": [cause.parameter for cause in causes],
            "stated": written(cause.stated for cause in causes),
            "would agree": written(cause.value for cause in causes),
            "sd": written(cause.sd for cause in causes),
            "unit": [cause.unit for cause in causes],
            "key of the log": [cause.key for cause in causes],
        }
    )
    which = "this parameter" if len(causes) == 1 else "one of these parameters"
    note = (
        f"All measurements would agree, within their noise, if {which} had another value. Measure "
        "it, correct what is wrong, and localize again: positions on this page are those of the "
        "stated values."
    )
    words = ["parameter", "unit", "key of the log"]
    yield PageTable(frame=frame, words=words, title="Parameters that may be wrong", note=note)


def _solutions(view: SwarmView, estimate: Estimate) -> Iterator[PageTable]:
    """Tabulate the solutions that the method found, if there are several."""
    log = view.log
    solutions = estimate.solutions
    if len(solutions) <= 1:
        return
    unit = log.length_unit
    positions = [solution.position[~log.is_gone] for solution in solutions]
    distances = [np.linalg.norm(position - positions[0], axis=1) for position in positions]
    farther = [int((distance > log.spacing).sum()) for distance in distances]
    excess = [solution.chi_square - solutions[0].chi_square for solution in solutions]
    frame = pd.DataFrame(
        {
            "solution": [str(number) for number in range(1, len(solutions) + 1)],
            "weight [%]": [percent(solution.weight) for solution in solutions],
            "chi-square": [_signed(value) for value in excess],
            "chains": [str(solution.chains) for solution in solutions],
            f"residual [{unit}]": [f"{solution.residual:.3g}" for solution in solutions],
            f"largest distance from solution 1 [{unit}]": [
                f"{distance.max():.3g}" for distance in distances
            ],
            "robots farther than D from there": [str(count) for count in farther],
        }
    )
    note = (
        "The estimate is the mean of these configurations, by weight; solution 1 is the likeliest "
        "one that is consistent in itself. Chi-square is relative to that of solution 1; 4.6 more "
        "leave a tenth of the weight, where solutions are equally precise. The 3D view shows each."
    )
    frame = frame.loc[:, (frame != "").any()]
    yield PageTable(frame=frame, words=[], title="Solutions", note=note)


def _signed(value: float) -> str:
    """Write a difference with its sign; nothing if it is unknown."""
    if math.isnan(value):
        return ""
    return f"{value:+.3g}" if value else "0"


def _advice(rows: Sequence[Mapping[str, str]]) -> Iterator[PageTable]:
    """Tabulate further measurements that would help."""
    if rows:
        words = ["further measurement", "robots determined"]
        note = "One further measurement would constrain the swarm as follows."
        if any(IMAGES_APART in row for row in rows):
            note += (
                " Images apart: difference of the measurement between solutions 1 and 2, in "
                "standard deviations of what is expected; 5 or more exclude one of them."
            )
        yield PageTable(
            frame=pd.DataFrame(rows), words=words, title="What to measure next", note=note
        )


def _space(view: SwarmView, estimate: Estimate) -> View:
    """Show the estimate, then each solution."""
    radius = view.log.dock_radius
    unit = view.log.length_unit
    tied = replace(view, name="estimate", sd=np.where(estimate.disconnected, np.nan, view.sd))
    shown = [view_data(tied, tied.page_colorings)]
    solutions = estimate.solutions if len(estimate.solutions) > 1 else ()
    room = max(MOST_ROBOTS // len(view.robot) - len(shown), 0)
    for number, solution in enumerate(solutions[:room], start=1):
        pose = np.column_stack([solution.position / radius, view.estimated_pose[:, 3:]])
        moved = replace(
            view, estimated_pose=pose, name=f"solution {number}", read_trace=lambda: None
        )
        distance = np.linalg.norm(solution.position - estimate.position, axis=1)
        sd = np.full(len(distance), np.nan) if solution.sd is None else solution.sd
        colorings = [
            *view.user_colorings,
            Coloring("distance from the estimate", unit, distance),
            Coloring(SD, unit, sd),
        ]
        shown.append(view_data(moved, colorings))
    notes = []
    if estimate.sd is not None and estimate.disconnected.any():
        notes.append("Where sd is the color, robots disconnected from the anchor are gray.")
    if len(view.robot) > MOST_ROBOTS:
        notes.append(f"It contains the first {MOST_ROBOTS} of {len(view.robot)} robots.")
    omitted = len(solutions) - room
    if omitted > 0:
        notes.append(f"It lacks {counted(omitted, 'solution')}, so that the page stays small.")
    return View(
        data=space_data(view.dock_offset_body, shown, radius=radius, unit=unit),
        title="Estimated positions",
        choice="Shown",
        note=" ".join(notes),
    )


def _robots(view: SwarmView, estimate: Estimate) -> PageTable:
    """Tabulate each robot in join order."""
    log = view.log
    unit = log.length_unit
    size = log.dock_radius
    digits = max(0, math.ceil(2.0 - math.log10(size)))
    columns: dict[str, Sequence[str]] = {"robot": [str(name) for name in log.robot_id]}
    for axis, values in zip("xyz", estimate.position.T.tolist(), strict=True):
        columns[f"{axis} [{unit}]"] = [f"{value:.{digits}f}" for value in values]
    for label, values in [("sd", view.sd * size), ("error", view.error * size)]:
        if np.isfinite(values).any():
            columns[f"{label} [{unit}]"] = ["" if math.isnan(v) else f"{v:.3g}" for v in values]
    if view.within is not None:
        shares = view.within.tolist()
        columns[f"within {view.near} [%]"] = ["" if math.isnan(p) else percent(p) for p in shares]
    columns["contacts"] = [str(many) for many in contact_count(log)]
    if estimate.gone is not None:
        columns["gone"] = ["yes" if gone else "" for gone in estimate.gone.tolist()]
    if estimate.observability is not None:
        columns["known"] = estimate.known
    note = "Known: yes if the measurements determine the position; "
    if "mirrored" in estimate.known:
        note += "mirrored if configurations that fit put the robot farther apart than its sd; "
    note += (
        "floppy if a motion that changes no measurement moves the robot; disconnected if at most a "
        "height ties it to the anchor."
    )
    omitted = len(view.robot) - MOST_ROWS
    if omitted > 0:
        note += f" {counted(omitted, 'more robot')} in the estimate's file."
    return PageTable(
        frame=pd.DataFrame(columns).head(MOST_ROWS),
        words=["gone", "known"],
        title="Robots",
        note=note,
    )
