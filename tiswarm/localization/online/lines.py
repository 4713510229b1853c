"""Lines of robots as a tracker takes them: what it refuses, and what it leaves out."""

from collections.abc import Iterator

from tiswarm.base.errors import InputError
from tiswarm.records.sensing_builder import Contact
from tiswarm.records.sensing_format import (
    CONTACT_LISTS,
    STANCE_LISTS,
    HeaderLine,
    RobotLine,
    StanceEntry,
)


def standing(line: RobotLine) -> RobotLine:
    """Leave of a robot that it stands, and whether it is planar."""
    return RobotLine.model_construct(
        robot=line.robot, orientation_wxyz=line.orientation_wxyz, contacts=[], fixes=line.fixes
    )


def entries(line: RobotLine) -> Iterator[RobotLine | StanceEntry]:
    """Yield the stances of a robot, the final one first."""
    yield line
    yield from line.stances or []


def named(entry: RobotLine | StanceEntry) -> list[int]:
    """List the robots that a stance names."""
    lists = [(getattr(entry, key) or [], kinds) for key, kinds in STANCE_LISTS.items()]
    pairs = [
        (item, kinds.index("robot")) for items, kinds in lists if "robot" in kinds for item in items
    ]
    return [item[place] for item, place in pairs]


def released(line: RobotLine, contact: Contact) -> RobotLine:
    """Drop the items of the final stance that begin with these docks in contact."""
    kept = {
        key: [item for item in items if tuple(item[:3]) != contact]
        for key in CONTACT_LISTS
        if (items := getattr(line, key))
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
    if any(entry.touches for entry in entries(line)):
        problem = "online cannot find docks that are unknown; leave touches out, or choose joint"
        raise InputError(problem, key="touches")
