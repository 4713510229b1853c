"""Where robots believe they are while they build: what the method of the case estimates by then.

The physics of growth stays with the true structure; this is the only way from an estimate to it.
"""

from collections.abc import Sequence

from tiswarm.base.aliases import Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.localization.registry import localize_many
from tiswarm.measurements.orientations import with_orientations
from tiswarm.scenario.model import Scenario
from tiswarm.sensing import observe
from tiswarm.world.growth import Believe
from tiswarm.world.history import History


def believe_by(settings: Scenario) -> Believe:
    """Return how the robots of a case come to know where docks are.

    Robots sense with the noise of the case, and its method localizes all that have joined, again
    after each join. A dock is believed where the estimated center and the sensed orientation of its
    robot put it.
    """
    def believe(grown: Sequence[History]) -> list[Reals]:
        logs = [observe(history, settings.sensing) for history in grown]
        estimates = localize_many(logs, [settings.localization] * len(logs))
        docks: list[Reals] = []
        for log, estimate in zip(logs, estimates, strict=True):
            offset = dock_offsets(with_orientations(log).orientation_wxyz, log.dock_offset_body)
            docks.append((estimate.position[:, None] + offset).reshape(-1, 3))
        return docks

    return believe
