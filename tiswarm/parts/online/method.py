"""The method `online`: a log is fed to a tracker robot by robot, as if they joined now.

The trace has a frame after some joins. Robots that have not joined by then stand where they are
placed as they join: the first frame is the error at joining, the last one that of the final answer.

A stream is answered line by line. Each line of the input has one answer. Nothing is stored: the
same lines give the same answers, byte for byte, so a stream that was stopped is fed again from its
header on.
"""

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from tiswarm.base.errors import InputError
from tiswarm.base.progress import ignore
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.mixture.verdict import rms
from tiswarm.parts.online.settings import OnlineParams
from tiswarm.parts.online.tracker import Change, Tracker
from tiswarm.records.estimate import Estimate
from tiswarm.records.io import at_line, decode
from tiswarm.records.sensing_file import lines_of
from tiswarm.records.sensing_log import SensingLog

_FRAMES = 24
"""Frames of the trace at most, beside the last."""

_DIGITS = 6
"""Decimals of lengths in an answer."""


def localize(
    log: SensingLog, params: OnlineParams, on_progress: Callable[[float], None] = ignore
) -> Estimate:
    """Let the robots of a log join one after the other.

    Returns:
        The final answer of the tracker. An iteration of the trace is a number of joins. The
        residual is as for `joint`.

    Raises:
        InputError: orientations were chained by connections; robots share errors then.
    """
    if log.orientation_sd is not None and len(log.connections):
        shared = "robots share errors of orientations that were chained; choose method joint"
        raise InputError(shared, key="connections")
    header, robots = lines_of(log)
    tracker = Tracker(header, params)
    every = np.unique(np.linspace(1, len(robots), _FRAMES).astype(np.int64))
    at_join = np.empty((len(robots), 3))
    frames = []
    for count, line in enumerate(robots, start=1):
        tracker.join(line)
        # The log does not say when: a robot that will have left is in nobody's way.
        if count - 1 in log.gone:
            tracker.leave(int(log.robot_id[count - 1]))
        at_join[count - 1] = tracker.positions[-1]
        if count in every:
            frames.append(tracker.positions)
        on_progress(count / len(robots))
    found = tracker.estimate(final=True)
    trace = np.array([[*frame, *at_join[len(frame) :]] for frame in [*frames, found.position]])
    problem = pose_problem(log, params)
    gap = problem.residual(trace / log.dock_radius, np.zeros(trace.shape[:2]))
    last = len(robots) + 1  # the final answer comes after all joins
    return replace(
        found,
        at_join=at_join,
        iteration=np.append(every, last),
        trace=trace,
        residual=rms(gap) * log.dock_radius,
    )


def follow(
    lines: Iterable[tuple[int, bytes]],
    name: Path,
    *,
    params: OnlineParams | None = None,
    on_answer: Callable[[str], object],
    on_refused: Callable[[str], None],
) -> Tracker:
    """Track the robots of a stream to its end.

    Args:
        lines: Lines with their numbers, the header first, as `log_lines` yields them.
        name: Name of the input in messages.
        params: Settings of `online`; its defaults if None.
        on_answer: Called with the answer of each line, a JSON object that ends in a newline, before
            the next line is read.
        on_refused: Called with the mistake of a line that is skipped.

    Raises:
        InputError: the header is malformed, or the input cannot be read.
    """
    tracker: Tracker | None = None
    for number, raw in lines:
        if tracker is None:
            with at_line(name, number):
                tracker = Tracker(decode(raw, name, number), params)
            answer: dict[str, object] = {"line": number, "robots": 0}
        else:
            answer = _answered(tracker, number, raw.rstrip(b"\r\n"), name, on_refused)
        on_answer(f"{json.dumps(answer)}\n")
    if tracker is None:
        raise InputError("the input is empty; start it with a header line", path=name, line=1)
    return tracker


def _answered(
    tracker: Tracker, number: int, raw: bytes, name: Path, on_refused: Callable[[str], None]
) -> dict[str, object]:
    """Take a line, and say what changed; or say why the line is refused."""
    try:
        with at_line(name, number):
            change = tracker.take(decode(raw, name, number))
    except InputError as mistake:
        on_refused(f"{mistake}; skipped")
        return {"line": number, "refused": ": ".join(filter(None, (mistake.key, mistake.problem)))}
    return {"line": number, "robots": len(tracker.names), **_changed(change)}


def _changed(change: Change) -> dict[str, object]:
    """Write a change as JSON values; a robot that joined has null in place of a way."""
    columns = zip(
        change.robot.tolist(), change.position.tolist(), change.moved.tolist(), change.sd.tolist(),
        strict=True,
    )  # fmt: skip
    return {
        "annealed": change.annealed,
        "moved": [
            {
                "robot": robot,
                "position": [round(part, _DIGITS) for part in position],
                "moved": None if math.isnan(moved) else round(moved, _DIGITS),
                "sd": round(sd, _DIGITS),
            }
            for robot, position, moved, sd in columns
        ],
    }
