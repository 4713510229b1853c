"""Where robots believe they are while they build: what the method of the case estimates by then.

Growth by itself is physics; this is the only way from an estimate to it. The first robot of each
side of a gap stands alone and is the anchor of its side: robots of a side localize each other, and
nobody knows where the other side is until both meet, unless `structure.anchors` states it.
"""

from collections.abc import Sequence

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.localization import methods
from tiswarm.measurements.odometry import with_orientations
from tiswarm.records.sensing_file import SensingLogBuilder, lines_of
from tiswarm.records.sensing_format import HeaderLine, RobotLine
from tiswarm.records.sensing_log import SensingLog
from tiswarm.scenario.model import Scenario
from tiswarm.sensing import observe
from tiswarm.world.growth import Believe
from tiswarm.world.history import History


class _Part:
    """The n robots of a side in join order, and what they have sensed of each other."""

    def __init__(
        self, history: History, robots: Ints, header: HeaderLine, lines: Sequence[RobotLine]
    ) -> None:
        """Choose from the lines of a whole log."""
        founder = int(robots[0])
        self.key = (history.seed, founder)
        self.robots = robots
        place = history.walks[founder].center[-1].tolist()
        # What robots sense later may need the newer version.
        self.header = header.model_copy(update={"version": 2, "anchor_position": place})
        builder = SensingLogBuilder(self.header, of_some=True)
        for robot in robots.tolist():
            builder.add(lines[robot])
        self.log = builder.log()


def believe_by(settings: Scenario) -> Believe:
    """Return how the robots of a case come to know where docks are.

    Robots sense with the noise of the case. Its method places each as it joins, or localizes all
    again after each join. A dock is believed where the estimated center and the sensed orientation
    of its robot put it.
    """
    params = settings.localization
    swarms: dict[tuple[int, int], methods.Joining] = {}

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
            logs = [part.log for part in parts]
            estimates = methods.localize_many(logs, [params] * len(logs))
            return {part.key: e.position for part, e in zip(parts, estimates, strict=True)}
        for part in parts:
            if part.key not in swarms:
                swarms[part.key] = joins(part.header, params)
            swarm = swarms[part.key]
            for line in lines_of(part.log)[1][len(swarm.positions) :]:
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
    founders, (header, lines) = np.array(founder), lines_of(log)
    every = [np.flatnonzero(founders == f) for f in np.unique(founders)]
    return [_Part(history, robots, header, lines) for robots in every]
