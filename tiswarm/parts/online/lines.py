"""Lines of robots as a tracker takes them: what it refuses, and what it leaves out."""

from typing import Any

from tiswarm.base.errors import InputError
from tiswarm.records.sensing_format import HeaderLine, RobotLine
from tiswarm.records.sensing_log import LISTS


def standing(line: RobotLine) -> RobotLine:
    """Leave of a robot that it stands, and whether it is planar."""
    stays: dict[str, Any] = {"contacts": []}
    stays |= {key: getattr(line, key) for key in ("robot", "orientation_wxyz", "fixes")}
    return RobotLine.model_construct(**stays)


def mentioned(line: RobotLine) -> set[int]:
    """List the robots that any stance of a robot names."""
    return {
        item[key.robot]
        for entry in (line, *(line.stances or []))
        for name, key in LISTS.items()
        if key.robot is not None
        for item in getattr(entry, name) or []
    }


def released(line: RobotLine, contact: tuple[int | None, int, int | None]) -> RobotLine:
    """Drop the items of the final stance that begin with these docks in contact."""
    kept = {
        name: [item for item in items if tuple(item[:3]) != contact]
        for name, key in LISTS.items()
        if key.is_of_docks and (items := getattr(line, name))
    }
    return line.model_copy(update=kept)


def refuse_header(head: HeaderLine) -> None:
    """Raise InputError where all robots share an error that a tracker cannot solve for."""
    if head.noise is not None and head.noise.yaw_bias_deg:
        problem = "online solves for no bias of yaw; choose method joint for the whole log"
        raise InputError(problem, key="noise.yaw_bias_deg")
    if any(source.shared_sd > 0.0 for source in (head.sources or {}).values()):
        problem = "online knows no errors that measurements share; choose method joint"
        raise InputError(problem, key="sources")


def refuse_line(line: RobotLine) -> None:
    """Raise InputError where a robot sensed what a tracker cannot use."""
    if line.orientation_wxyz is None:
        problem = "null follows from the lines of later robots, too; choose method joint"
        raise InputError(problem, key="orientation_wxyz")
    if line.touches or any(entry.touches for entry in line.stances or []):
        problem = "online cannot find docks that are unknown; leave touches out, or choose joint"
        raise InputError(problem, key="touches")
