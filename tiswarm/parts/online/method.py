"""The method `online`: a log is fed to a tracker robot by robot, as if they joined now.

The trace has a frame after some joins. Robots that have not joined by then stand where they are
placed as they join: the first frame is the error at joining, the last one that of the final answer.
"""

import json
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from tiswarm.base.errors import InputError
from tiswarm.base.progress import ignore
from tiswarm.localization.assessment import rms
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.params import OnlineParams
from tiswarm.parts.online.tracker import Tracker
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_file import log_entries
from tiswarm.records.sensing_log import SensingLog

_FRAMES = 24
"""Frames of the trace at most, beside the last."""


def joining(params: OnlineParams) -> type[Tracker]:  # noqa: ARG001
    """Return what places robots as they join."""
    return Tracker


def batch_key(log: SensingLog, params: OnlineParams) -> Hashable:  # noqa: ARG001
    """Name what logs share that are localized in one batch, one after the other: the settings."""
    return repr(params)


def localize_batch(
    logs: Sequence[SensingLog],
    params: Sequence[OnlineParams],
    on_progress: Callable[[float], None] = ignore,
) -> list[Estimate]:
    """Let the robots of each log join one after the other.

    Returns:
        One estimate a log: the final answer of its tracker. An iteration of the trace is a number
        of joins. The residual is as for `joint`.

    Raises:
        InputError: orientations were chained by connections; robots share errors then.
    """
    for log in logs:
        if log.orientation_sd is not None and len(log.connections):
            shared = "robots share errors of orientations that were chained; choose method joint"
            raise InputError(shared, key="connections")
    estimates = []
    total, joined = sum(log.robot_count for log in logs), 0
    for log, p in zip(logs, params, strict=True):
        # Through text, as the lines of real robots come: one way in.
        header, *robots = map(json.dumps, islice(log_entries(log), 1 + log.robot_count))
        tracker = Tracker(header, p)
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
            joined += 1
            on_progress(joined / total)
        found = tracker.estimate(final=True)
        trace = np.array([[*frame, *at_join[len(frame) :]] for frame in [*frames, found.position]])
        problem = pose_problem(log, p)
        gap = problem.residual(trace / log.dock_radius, np.zeros(trace.shape[:2]))
        last = len(robots) + 1  # the final answer comes after all joins
        estimates.append(
            replace(
                found,
                at_join=at_join,
                iteration=np.append(every, last),
                trace=trace,
                residual=rms(gap) * log.dock_radius,
            )
        )
    return estimates
