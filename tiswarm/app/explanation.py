"""How the measurements of one robot narrow its place: as lines, and as a picture."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.base.parts import load
from tiswarm.compute.math import dock_offsets
from tiswarm.measurements.odometry import with_orientations
from tiswarm.records.estimate import Estimate
from tiswarm.records.messages import counted, three_digits
from tiswarm.records.sensing_log import SensingLog

_USE = "explain"

_ENOUGH = 2
"""Docks of earlier robots to touch that make a robot worth explaining."""


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

    radius: float
    """R in the log's unit."""

    def __str__(self) -> str:
        """Give a line for each measurement."""
        lines = [
            f"{name:<28} {three_digits(spread):>8} {self.unit}"
            for name, spread in self.spread.items()
        ]
        return "\n".join([f"robot {self.robot}: spread of the places that remain", *lines])

    def draw(self, out: Path, *, overwrite: bool = False) -> Path:
        """Draw the places that remain after each measurement; return the picture."""
        _figure("write_placement")(out, self._placement(), overwrite=overwrite)
        return out

    def show(self, why: str) -> Any:  # noqa: ANN401 - a type of an optional part's room
        """Draw the same for a page; `why` says in a sentence why this robot is shown."""
        caption = (
            f"How the measurements of robot {self.robot} narrow its place: blue points are places "
            "that remain after one more measurement, numbers their rms distance from their mean. "
            "The cross is the estimate. Gray circles are docks of robots that joined earlier, "
            f"where they are estimated. {why} The command tiswarm explain draws any robot."
        )
        return _figure("show_placement")(self._placement(), caption)

    def _placement(self) -> Any:  # noqa: ANN401 - a type of an optional part
        panel = _figure("Panel")
        panels = [
            panel(f"{name}\n{three_digits(self.spread[name])} {self.unit}", places)
            for name, places in self.places.items()
        ]
        return _figure("Placement")(panels, self.center, self.docks, self.radius, self.unit)


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
    log = with_orientations(log)
    arms = dock_offsets(log.orientation_wxyz, log.dock_offset_body / log.dock_radius)
    steps = load("tiswarm.measurements.placement:narrow", _USE)(log, index, position)
    return Explanation(
        robot=robot,
        places={step.name: step.places for step in steps},
        spread={step.name: step.spread * log.dock_radius for step in steps},
        unit=log.length_unit,
        center=position[index],
        docks=(position[:index, None] + arms[:index]).reshape(-1, 3),
        radius=log.dock_radius,
    )


def show_one(log: SensingLog, estimate: Estimate) -> list[Any]:
    """Draw for a page the explanation of one robot; none if no robot touches an earlier one.

    That is the one with the largest standard deviation of those that touch two or more docks of
    earlier robots, or one if none touches more; without standard deviations, the one that touches
    most.
    """
    touched = np.bincount(log.contacts[:, 2], minlength=log.robot_count)
    least = min(_ENOUGH, int(touched.max()))
    if not least:
        return []
    more = " or more" if least == _ENOUGH else ""
    which = f"Of the robots that touch {counted(least, 'dock')}{more} of earlier robots"
    sd = np.full(log.robot_count, np.nan) if estimate.sd is None else estimate.sd
    known = np.isfinite(sd) & ~estimate.disconnected & (touched >= least)
    if known.any():
        index = int(np.argmax(np.where(known, sd, -1.0)))
        why = f"{which}, this one has the largest standard deviation, "
        why += f"{three_digits(sd[index])} {log.length_unit}."
    else:
        index = int(np.argmax(touched))
        why = f"No robot touches more docks of earlier robots than this one, {touched[index]}."
    return [explain(log, estimate, int(log.robot_id[index])).show(why)]


def _figure(name: str) -> Any:  # noqa: ANN401 - of many types
    """Load a name of the optional part that draws explanations."""
    return load(f"tiswarm.report.placement_figure:{name}", _USE)
