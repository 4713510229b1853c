"""The page of a log and its estimate: what was found, how certain it is, and what remains open."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Ints, Reals
from tiswarm.measurements.contacts import contact_count
from tiswarm.measurements.verdicts import IMAGES_APART, distrust, headline, verdict
from tiswarm.records.estimate import Estimate
from tiswarm.records.messages import counted, percent
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
        tables=[*_solutions(view, estimate), *_advice(advice)],
        view=_space(view, estimate),
        figures=figures,
        rows=_robots(view, estimate),
        rows_example="mirrored" if "mirrored" in estimate.known else "floppy",
    )


def _result(view: SwarmView, estimate: Estimate, scores: Mapping[str, float]) -> str:
    """State in a sentence what was found."""
    unit = view.log.length_unit
    accuracy = []
    if len(sd := _tied_sd(view, estimate)):
        accuracy.append(f"a standard deviation of {np.median(sd):.2g} {unit} in the median")
    if scores:
        accuracy.append(f"an RMSE of {scores['RMSE']:.3g} {unit}")
    left, known = len(view.log.gone), f" with {' and '.join(accuracy)}" if accuracy else ""
    located = f"{counted(len(view.robot) - left, 'robot')} located{known}."
    return f"{located} {left} left." if left else located


def _in_words(log: SensingLog, estimate: Estimate) -> str:
    """State in a line whether to trust the estimate, and what limits it."""
    text = (
        f"{verdict(estimate)}: see Warnings" if distrust(log, estimate) else headline(log, estimate)
    )
    found = [text[:1].upper() + text[1:]] if text else []
    words = estimate.known
    if floppy := words.count("floppy"):
        found.append(f"Floppy modes move {counted(floppy, 'robot')}")
    if lost := words.count("disconnected"):
        found.append(f"No measurement ties {counted(lost, 'robot')} to the anchor")
    outliers = (estimate.outlier_contacts, estimate.outlier_places)
    judged = [counted(many, "measurement")] if (many := sum(map(_count, outliers))) else []
    if turned := _count(estimate.outlier_robots):
        judged.append(counted(turned, "orientation"))
    if judged:
        found.append(f"The estimate judges {' and '.join(judged)} wrong")
    return " ".join(f"{sentence}." for sentence in found)


def _count(rows: Ints | None) -> int:
    return 0 if rows is None else len(rows)


def _tied_sd(view: SwarmView, estimate: Estimate) -> Reals:
    """Return the known sd of robots that are tied to the anchor, without it [log unit]."""
    sd: Reals = view.sd[1:][~estimate.disconnected[1:]] * view.log.dock_radius
    known: Reals = sd[np.isfinite(sd)]
    return known


def _summary(view: SwarmView, estimate: Estimate, scores: Mapping[str, float]) -> PageTable:
    """Tabulate sizes, uncertainty and, where the truth is known, accuracy."""
    unit = view.log.length_unit
    rows = {"robots": str(len(view.robot)), "contacts": str(len(view.log.contacts))}
    rows |= {"robots that left, not scored": str(len(left))} if len(left := view.log.gone) else {}
    if len(sd := _tied_sd(view, estimate)):
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


def _solutions(view: SwarmView, estimate: Estimate) -> Iterator[PageTable]:
    """Tabulate the solutions that the method found, if there are several."""
    log, found = view.log, estimate.solutions
    if len(found) < 2:  # noqa: PLR2004
        return
    unit = log.length_unit
    place = [each.position[~log.is_gone] for each in found]
    away = [np.linalg.norm(each - place[0], axis=1) for each in place]
    more = [each.chi_square - found[0].chi_square for each in found]
    frame = pd.DataFrame(
        {
            "solution": [str(number) for number in range(1, len(found) + 1)],
            "weight [%]": [percent(each.weight) for each in found],
            "chi-square": ["" if math.isnan(v) else f"{v:+.3g}" if v else "0" for v in more],
            "chains": [str(each.chains) for each in found],
            f"residual [{unit}]": [f"{each.residual:.3g}" for each in found],
            f"largest distance from solution 1 [{unit}]": [f"{each.max():.3g}" for each in away],
            "robots farther than D from there": [str(int((a > log.spacing).sum())) for a in away],
        }
    )
    note = (
        "The estimate is the mean of these configurations, by weight; solution 1 is the likeliest "
        "one that is consistent in itself. Chi-square is relative to that of solution 1; 4.6 more "
        "leave a tenth of the weight, where solutions are equally precise. The 3D view shows each."
    )
    frame = frame.loc[:, (frame != "").any()]
    yield PageTable(frame=frame, words=[], title="Solutions", note=note)


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
    radius, unit = view.log.dock_radius, view.log.length_unit
    tied = replace(view, name="estimate", sd=np.where(estimate.disconnected, np.nan, view.sd))
    shown = [view_data(tied, tied.colorings)]
    solutions = estimate.solutions if len(estimate.solutions) > 1 else ()
    room = MOST_ROBOTS // len(view.robot) - len(shown)
    for number, each in enumerate(solutions[: max(room, 0)], start=1):
        pose = np.column_stack([each.position / radius, view.estimated_pose[:, 3:]])
        moved = replace(
            view, estimated_pose=pose, name=f"solution {number}", read_trace=lambda: None
        )
        away = np.linalg.norm(each.position - estimate.position, axis=1)
        sd = np.full(len(away), np.nan) if each.sd is None else each.sd
        values = [("distance from the estimate", away), (SD, sd)]
        ours = [Coloring(label, unit, value) for label, value in values]
        shown.append(view_data(moved, [*view.own, *ours]))
    notes = []
    if estimate.sd is not None and estimate.disconnected.any():
        notes.append("Where sd is the color, robots disconnected from the anchor are gray.")
    if len(view.robot) > MOST_ROBOTS:
        notes.append(f"It contains the first {MOST_ROBOTS} of {len(view.robot)} robots.")
    if (left := len(solutions) - max(room, 0)) > 0:
        notes.append(f"It lacks {counted(left, 'solution')}, so that the page stays small.")
    return View(
        data=space_data(view.dock_offset_body, shown, radius=radius, unit=unit),
        title="Estimated positions",
        choice="Shown",
        note=" ".join(notes),
    )


def _robots(view: SwarmView, estimate: Estimate) -> PageTable:
    """Tabulate each robot in join order."""
    log, unit, size = view.log, view.log.length_unit, view.log.dock_radius
    digits = max(0, math.ceil(2.0 - math.log10(size)))
    columns: dict[str, Sequence[str]] = {"robot": [str(name) for name in log.robot_id]}
    for axis, values in zip("xyz", estimate.position.T.tolist(), strict=True):
        columns[f"{axis} [{unit}]"] = [f"{value:.{digits}f}" for value in values]
    for label, values in [("sd", view.sd * size), ("error", view.error * size)]:
        if np.isfinite(values).any():
            columns[f"{label} [{unit}]"] = ["" if math.isnan(v) else f"{v:.3g}" for v in values]
    columns["contacts"] = [str(many) for many in contact_count(log)]
    if estimate.gone is not None:
        columns["gone"] = ["yes" if gone else "" for gone in estimate.gone.tolist()]
    if estimate.observability is not None:
        columns["known"] = estimate.known
    left_out = len(view.robot) - MOST_ROWS
    mirrored = (
        "mirrored if configurations that fit put the robot farther apart than its sd; "
        if "mirrored" in estimate.known
        else ""
    )
    note = (
        f"Known: yes if the measurements determine the position; {mirrored}floppy if a motion that "
        "changes no measurement moves the robot; disconnected if at most a height ties it to the "
        "anchor."
    )
    note += f" {counted(left_out, 'more robot')} in the estimate's file." if left_out > 0 else ""
    return PageTable(
        frame=pd.DataFrame(columns).head(MOST_ROWS),
        words=["gone", "known"],
        title="Robots",
        note=note,
    )
