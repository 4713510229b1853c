"""Where robots believe they are while they build: what the method of the case estimates by then.

Growth by itself is physics; this is the only way from an estimate to it.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from tiswarm.base.aliases import Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.localization.registry import joining, localize_many
from tiswarm.measurements.orientations import with_orientations
from tiswarm.records.sensing_file import log_entries
from tiswarm.records.sensing_log import SensingLog
from tiswarm.scenario.model import Scenario
from tiswarm.sensing import observe
from tiswarm.world.growth import Believe
from tiswarm.world.history import History


class _Joining(Protocol):
    """What localizes the robots of one structure as they join."""

    def join(self, robot: Mapping[str, Any], /) -> object:
        """Add the next robot by its line of a sensing file."""

    @property
    def positions(self) -> Reals:
        """Estimated centers in join order [log unit], shape (n, 3)."""


def believe_by(settings: Scenario) -> Believe:
    """Return how the robots of a case come to know where docks are.

    Robots sense with the noise of the case. Its method places each as it joins, or localizes all
    again after each join. A dock is believed where the estimated center and the sensed orientation
    of its robot put it.
    """
    swarms: dict[int, _Joining] = {}

    def believe(grown: Sequence[History]) -> list[Reals]:
        logs = [observe(history, settings.sensing) for history in grown]
        docks: list[Reals] = []
        for log, center in zip(logs, centers(grown, logs), strict=True):
            offset = dock_offsets(with_orientations(log).orientation_wxyz, log.dock_offset_body)
            docks.append((center[:, None] + offset).reshape(-1, 3))
        return docks

    def centers(grown: Sequence[History], logs: Sequence[SensingLog]) -> list[Reals]:
        params = settings.localization
        if not (joins := joining(params)):
            estimates = localize_many(logs, [params] * len(logs))
            return [estimate.position for estimate in estimates]
        for history, log in zip(grown, logs, strict=True):
            header, *robots = log_entries(log)
            if history.seed not in swarms:
                # What robots sense later may need the newer version.
                swarms[history.seed] = joins(header | {"version": 2}, params)
            for robot in robots[len(swarms[history.seed].positions) :]:
                swarms[history.seed].join(robot)
        return [swarms[history.seed].positions for history in grown]

    return believe
