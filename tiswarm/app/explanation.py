"""How the measurements of one robot narrow its place: as lines, and as a picture."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.base.parts import load
from tiswarm.compute.math import dock_offsets
from tiswarm.records.estimate import Estimate
from tiswarm.records.messages import three_digits
from tiswarm.records.sensing_log import SensingLog

_USE = "explain"


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """The places that a robot may have after each of its measurements."""

    robot: int
    """Name of the robot."""

    places: Mapping[str, Reals]
    """By measurement, the first one first, places of the center that remain [R], shape (n, 3)."""

    spread: Mapping[str, float]
    """By measurement, the rms distance of these places from their mean [log unit]."""

    unit: str
    """Length unit of the log."""

    center: Reals
    """Estimated center of the robot [R], shape (3,)."""

    docks: Reals
    """Estimated docks of the robots that joined earlier [R], shape (n, 3)."""

    def __str__(self) -> str:
        """Give a line for each measurement."""
        lines = [
            f"{name:<28} {three_digits(spread):>8} {self.unit}"
            for name, spread in self.spread.items()
        ]
        return "\n".join([f"robot {self.robot}: spread of the places that remain", *lines])

    def draw(self, out: Path) -> Path:
        """Draw the places that remain after each measurement; return the picture."""
        panel = load("tiswarm.report.placement_figure:Panel", _USE)
        write = load("tiswarm.report.placement_figure:write_placement", _USE)
        panels = [
            panel(f"{name}\n{three_digits(self.spread[name])} {self.unit}", places)
            for name, places in self.places.items()
        ]
        write(out, panels, self.center, self.docks)
        return out


def explain(log: SensingLog, estimate: Estimate, robot: int) -> Explanation:
    """Narrow the places of a robot by its measurements.

    Args:
        log: What was sensed.
        estimate: Estimate of its robots.
        robot: Name of a robot in the log.

    Raises:
        InputError: there is no such robot, it is the anchor, or it touches none that joined
            earlier.
    """
    found = np.flatnonzero(log.robot_id == robot)
    if not len(found):
        problem = f"there is no robot {robot}; choose one of the {log.robot_count} of the log"
        raise InputError(problem, argument="robot")
    index = int(found[0])
    position = estimate.position / log.dock_radius
    arms = dock_offsets(log.orientation_wxyz, log.dock_offset_body / log.dock_radius)
    steps = load("tiswarm.measurements.placement:narrow", _USE)(log, index, position)
    return Explanation(
        robot=robot,
        places={step.name: step.places for step in steps},
        spread={step.name: step.spread * log.dock_radius for step in steps},
        unit=log.length_unit,
        center=position[index],
        docks=(position[:index, None] + arms[:index]).reshape(-1, 3),
    )
