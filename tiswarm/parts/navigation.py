"""Where robots believe they are while they build: what the method of the case estimates by then.

Growth by itself is physics; this is the only way from an estimate to it. The first robot of each
side of a gap stands alone and is the anchor of its side: robots of a side localize each other, and
nobody knows where the other side is until both meet, unless `structure.anchors` states it.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.localization import methods
from tiswarm.measurements.odometry import with_orientations
from tiswarm.records.sensing_file import SensingLogBuilder, log_entries
from tiswarm.records.sensing_format import parse_header, parse_robot
from tiswarm.records.sensing_log import LISTS, SensingLog
from tiswarm.scenario.model import Scenario
from tiswarm.sensing import observe
from tiswarm.world.growth import Believe
from tiswarm.world.history import History

_Line = Mapping[str, Any]
"""A line of a sensing file."""


class _Joining(Protocol):
    """What localizes robots as they join."""

    def join(self, robot: _Line, /) -> object:
        """Add the next robot."""

    @property
    def positions(self) -> Reals:
        """Estimated centers in join order [log unit], shape (n, 3)."""


class _Part:
    """The n robots of a side in join order, and what they have sensed of each other."""

    def __init__(self, history: History, robots: Ints, lines: Sequence[_Line]) -> None:
        """Choose from the lines of a whole log, the header first."""
        header, *every = lines
        founder, of_part = int(robots[0]), set(robots.tolist())
        self.key = (history.seed, founder)
        self.robots = robots
        place = history.walks[founder].center[-1]
        # What robots sense later may need the newer version.
        self.header = {**header, "version": 2, "anchor_position": place.tolist()}
        self.lines = [_about(every[robot], of_part) for robot in robots]

    def log(self) -> SensingLog:
        """Return what the robots have sensed, as a log of their own."""
        builder = SensingLogBuilder(parse_header(json.dumps(self.header)))
        for line in self.lines:
            builder.add(parse_robot(json.dumps(line)))
        return builder.log()


def believe_by(settings: Scenario) -> Believe:
    """Return how the robots of a case come to know where docks are.

    Robots sense with the noise of the case. Its method places each as it joins, or localizes all
    again after each join. A dock is believed where the estimated center and the sensed orientation
    of its robot put it.
    """
    params = settings.localization
    swarms: dict[tuple[int, int], _Joining] = {}

    def believe(grown: Sequence[History]) -> list[Reals]:
        logs = [observe(history, settings.sensing) for history in grown]
        parts = [_parts(history, log) for history, log in zip(grown, logs, strict=True)]
        found = centers([part for each in parts for part in each])
        docks: list[Reals] = []
        for log, each in zip(logs, parts, strict=True):
            center = np.empty((log.robot_count, 3))
            for part in each:
                center[part.robots] = found[part.key]
            offset = dock_offsets(with_orientations(log).orientation_wxyz, log.dock_offset_body)
            docks.append((center[:, None] + offset).reshape(-1, 3))
        return docks

    def centers(parts: Sequence[_Part]) -> dict[tuple[int, int], Reals]:
        if not (joins := methods.joining(params)):
            logs = [part.log() for part in parts]
            estimates = methods.localize_many(logs, [params] * len(logs))
            return {part.key: e.position for part, e in zip(parts, estimates, strict=True)}
        for part in parts:
            if part.key not in swarms:
                swarms[part.key] = joins(part.header, params)
            swarm = swarms[part.key]
            for line in part.lines[len(swarm.positions) :]:
                swarm.join(line)
        return {part.key: swarms[part.key].positions for part in parts}

    return believe


def _parts(history: History, log: SensingLog) -> list[_Part]:
    """Split a structure by the founder to which the first contact of each robot leads.

    Anchors are in one frame, so they count as one founder.
    """
    founder: list[int] = []
    for j, walk in enumerate(history.walks):
        touched = walk.at_rest(walk.contacts)[:, 1]
        alone = 0 if j < history.anchors else j
        founder.append(founder[touched[0]] if len(touched) else alone)
    lines, founders = [*log_entries(log)], np.array(founder)
    return [_Part(history, np.flatnonzero(founders == f), lines) for f in np.unique(founders)]


def _about(line: _Line, robots: set[int]) -> _Line:
    """Leave out what a robot, or a stance of it, sensed of robots that are not among these."""
    return dict(_kept(line, robots))


def _kept(line: _Line, robots: set[int]) -> Iterator[tuple[str, Any]]:
    for key, value in line.items():
        place = LISTS[key].robot if key in LISTS else None
        if key == "stances" and value:
            yield key, [_about(stance, robots) for stance in value]
        elif value and place is not None:
            yield key, [item for item in value if item[place] in robots]
        else:
            yield key, value
