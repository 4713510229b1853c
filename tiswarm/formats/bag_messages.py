"""Reads the messages of bags of ROS 1 and ROS 2: poses, and what a message says of each.

A message of any type counts that has a position and an orientation, or a transform, alone or in a
list. It may state the robot (a name, an id, the child frame), the frame of the pose, and a stamp.
"""

import dataclasses
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.formats.frames import FrameTrack

_OTHER_WORDS = {
    *("path", "paths", "trajectory", "goal", "goals", "action", "plan", "waypoint", "waypoints"),
    *("setpoint", "setpoints", "command", "commands", "cmd", "target", "targets", "desired"),
    *("reference", "ref", "initial", "initialpose", "set", "grid", "map", "origin", "interactive"),
    *("marker", "markers"),
}
"""Words in the name of a type, of a topic or of a field that has no pose of a robot."""

_SHARED_FRAMES = ("earth", "map", "world")
"""Frames that all robots share, in any namespace of transforms (REP 105)."""

_PAIRS = (("position", "orientation"), ("translation", "rotation"))
"""Fields of a pose and of a transform."""


class _Origin(NamedTuple):
    """What the messages say of a pose."""

    topic: str
    kind: str  # type of the messages
    name: str = ""  # of the robot, as the message states it, or the place in a list
    child: str = ""  # frame whose pose it is
    is_counted: bool = False  # whether the name is the place in a list


class _Context(NamedTuple):
    """What the outer parts of a message say of the inner ones."""

    names: tuple[str, ...] = ()
    child: str = ""
    frame: str = ""
    stamp: int = 0  # [ns]
    is_counted: bool = False


@dataclass
class BodyTrack:
    """Poses that a topic has of one body, in the order of recording."""

    origin: _Origin
    stamp: list[int] = field(default_factory=list)  # [ns]; 0 where it is not set
    recorded: list[int] = field(default_factory=list)  # [ns]
    frame: list[str] = field(default_factory=list)  # in which each pose is
    numbers: list[list[float]] = field(default_factory=list)  # x, y, z, qw, qx, qy, qz

    @property
    def is_transform(self) -> bool:
        """Whether the poses are transforms of the tree of frames."""
        return self.origin.kind.endswith(("/TFMessage", "/tfMessage"))

    @property
    def is_static(self) -> bool:
        """Whether the poses are transforms that hold at all times."""
        return self.is_transform and self.origin.topic.endswith("_static")

    def by_time(self, *, stamped: bool) -> tuple[FrameTrack, int]:
        """Return the poses by time, and how many are of a lost body: no numbers, or no turn."""
        numbers = np.array(self.numbers, np.float64)
        length = np.linalg.norm(numbers[:, 3:], axis=1)
        is_seen = ~np.isnan(numbers).any(axis=1) & (length > 0.0)
        time = np.array(self.stamp if stamped else self.recorded, np.int64)
        order = np.argsort(time, kind="stable")
        order = order[is_seen[order]]
        frames = [self.frame[row] for row in order]
        turns = numbers[order, 3:]
        return FrameTrack(time[order], frames, numbers[order, :3], turns), int((~is_seen).sum())


def has_other_words(name: str) -> bool:
    """Whether the name of a type, topic or field says that it has no poses of robots.

    >>> has_other_words("PoseStamped"), has_other_words("/bot_3/goal_pose")
    (False, True)
    """
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)
    return any(word.lower() in _OTHER_WORDS for word in words)


def read_tracks(path: Path) -> list[BodyTrack]:
    """Read the poses of all bodies of a bag; types whose name says so are left out.

    Raises:
        InputError: the bag is damaged, or a list of poses does not state whose they are.
        EnvironmentTroubleError: the library rosbags is not installed.
    """
    try:
        from rosbags.highlevel import AnyReader  # noqa: PLC0415 - an extra
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415
    except ImportError as error:
        problem = "bags need the library rosbags; pip install 'tiswarm[ros]'"
        raise EnvironmentTroubleError(problem) from error
    tracks: dict[_Origin, BodyTrack] = {}
    counts: dict[str, int] = {}
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
            links = [link for link in bag.connections if not _is_other_type(link.msgtype)]
            for link, recorded, raw in bag.messages(links) if links else ():
                message = bag.deserialize(raw, link.msgtype)
                listed = 0
                for context, numbers in _poses_in(message, _Context(frame="")):
                    listed += context.is_counted
                    origin = _Origin(
                        link.topic,
                        link.msgtype,
                        "/".join(context.names),
                        _frame_of_topic(context.child, link.topic, link.msgtype),
                        context.is_counted,
                    )
                    track = tracks.setdefault(origin, BodyTrack(origin))
                    track.stamp.append(context.stamp)
                    track.recorded.append(recorded)
                    track.frame.append(_frame_of_topic(context.frame, link.topic, link.msgtype))
                    track.numbers.append(numbers)
                if listed:
                    _refuse_other_length(link.topic, listed, counts.setdefault(link.topic, listed))
    except InputError:
        raise
    except Exception as error:  # the library has many kinds, and bags are anybody's
        problem = f"not a whole bag ({type(error).__name__}: {str(error)[:80]}); record it again"
        raise InputError(problem) from error
    return [*tracks.values()]


def _is_other_type(kind: str) -> bool:
    """Whether a type of messages has no poses of robots; drawings may be chosen by their topic."""
    return has_other_words(kind.rpartition("/")[2]) and not re.fullmatch(r".*/Marker(Array)?", kind)


def _refuse_other_length(topic: str, listed: int, first: int) -> None:
    if listed != first:
        problem = (
            f"the lists of {topic} have {first} poses and {listed}, and no names: they do not "
        )
        problem += "say which robot has which pose; record names, or a topic for each robot"
        raise InputError(problem)


def _frame_of_topic(frame: str, topic: str, kind: str) -> str:
    """Return a frame's name; a tree in a namespace has frames of its own but for shared ones."""
    frame = frame.strip("/")
    namespace = topic.strip("/").rpartition("/")[0]
    is_tree = kind.endswith(("/TFMessage", "/tfMessage"))
    if not (is_tree and namespace and frame) or frame in _SHARED_FRAMES:
        return frame
    return frame if frame.startswith(f"{namespace}/") else f"{namespace}/{frame}"


def _poses_in(message: Any, context: _Context) -> Iterator[tuple[_Context, list[float]]]:  # noqa: ANN401 - of ROS
    """Yield the poses in a message: what it says of each, then x, y, z, qw, qx, qy, qz."""
    context = _refined(message, context)
    for position_key, turn_key in _PAIRS:
        if hasattr(message, position_key) and hasattr(message, turn_key):
            p = getattr(message, position_key)
            q = getattr(message, turn_key)
            if all(hasattr(q, axis) for axis in "wxyz") and all(hasattr(p, axis) for axis in "xyz"):
                yield context, [float(number) for number in (p.x, p.y, p.z, q.w, q.x, q.y, q.z)]
                return
    for part in dataclasses.fields(message):
        inner = getattr(message, part.name)
        if part.name.startswith("__") or (has_other_words(part.name) and part.name != "markers"):
            continue
        if dataclasses.is_dataclass(inner):
            yield from _poses_in(inner, context)
        elif isinstance(inner, list) and inner and dataclasses.is_dataclass(inner[0]):
            yield from _poses_in_list(message, part.name, inner, context)


def _poses_in_list(
    message: Any,  # noqa: ANN401 - of ROS
    key: str,
    items: Sequence[Any],
    context: _Context,
) -> Iterator[tuple[_Context, list[float]]]:
    """Yield the poses in a list, by the names beside it or in its items, else by their places."""
    names = _names_beside(message)
    if names and len(names) != len(items) and any(_poses_in(items[0], _Context())):
        problem = f"a list has {len(items)} {key} and {len(names)} names; record it whole"
        raise InputError(problem)
    for place, item in enumerate(items):
        stated = _refined(item, _Context())
        if names:
            outer = context._replace(names=(*context.names, names[place]))
        elif stated.names or stated.child:
            outer = context
        else:
            outer = context._replace(names=(*context.names, str(place)), is_counted=True)
        yield from _poses_in(item, outer)


def _names_beside(message: Any) -> list[str]:  # noqa: ANN401 - of ROS
    """Return the names, or ids, that a message lists beside poses."""
    for key in ("name", "names", "model_name", "model_names", "body_names", "id", "ids"):
        listed = getattr(message, key, None)
        if isinstance(listed, list | np.ndarray) and len(listed):
            return [str(name) for name in listed]
    return []


def _refined(message: Any, context: _Context) -> _Context:  # noqa: ANN401 - of ROS
    """Add what a message states itself: its head, its child frame, its names."""
    head = getattr(message, "header", None)
    if head is not None and hasattr(head, "frame_id"):
        stamp = head.stamp
        seconds = getattr(stamp, "sec", getattr(stamp, "secs", 0))
        parts = getattr(stamp, "nanosec", getattr(stamp, "nsecs", 0))
        context = context._replace(frame=head.frame_id, stamp=int(seconds) * 10**9 + int(parts))
    child = getattr(message, "child_frame_id", "")
    if child:
        context = context._replace(child=child)
    for part in dataclasses.fields(message):
        if part.name in {"ns", "name", "id"} or part.name.endswith(("_name", "_id")):
            stated = getattr(message, part.name)
            if part.name in {"frame_id", "child_frame_id"} or not isinstance(stated, str | int):
                continue
            if stated != "":
                context = context._replace(names=(*context.names, str(stated)))
    return context
