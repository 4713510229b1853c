"""Reads bags of ROS: the topics that are poses of robots, with robot, frame and time.

    identity   what a message states: a name, an id, the child frame; else the topic
    frame      poses are composed up to the root of the tree that transforms form
    source     one set of topics: transforms, or topics of one type that differ by the robot
    time       stamps where all are set and rise, else times of recording

Paths, goals, setpoints, commands and drawings are never poses of robots. A bag states its fields,
so nothing is guessed: quaternions are read as named, and a list without names has one length.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from tiswarm.base.errors import InputError
from tiswarm.formats import columns, poses
from tiswarm.formats.bag_messages import BodyTrack, has_other_words, read_tracks
from tiswarm.formats.frames import FrameTrack, to_root
from tiswarm.records.messages import counted

_BODY_FRAMES = ("base_link", "base_footprint")
"""Frames of the body of a mobile robot; the first that a tree has counts (REP 105)."""

_LARGEST_LAG_S = 0.5
"""Difference of the delays from stamp to recording up to which robots have one clock [s]."""


class _Source(NamedTuple):
    """Topics that have the poses of robots, each of one robot or of all."""

    pattern: str  # of the topics, as a shell writes it
    tracks: list[BodyTrack]

    def __str__(self) -> str:
        kinds = sorted({track.origin.kind.rpartition("/")[2] for track in self.tracks})
        frames = _kinds(frame for track in self.tracks for frame in track.frame)
        poses_count = sum(len(track.numbers) for track in self.tracks)
        where = f"frame {poses.first_names(frames)}" if any(frames) else "no frame"
        size = f"{len(self.tracks)} bodies, {poses_count} poses"
        return f"{self.pattern} ({', '.join(kinds)}; {size}; {where})"


def read_bag(path: Path, assumed: poses.Assumptions) -> poses.PoseTable | None:
    """Read the poses of a bag of ROS; None if the path is no `.bag` and no folder of ROS 2.

    `topic` and `bodies` of `Assumptions` choose where a bag has several sources or bodies.

    Raises:
        InputError: the bag is damaged, has no poses, or several sources of them, or poses in
            frames that no transform joins, or does not state whose they are.
        EnvironmentTroubleError: the library rosbags is not installed.
    """
    if path.suffix != ".bag" and not (path / "metadata.yaml").is_file():
        for argument in ("topic", "bodies"):
            if getattr(assumed, argument):
                problem = "only bags of ROS have topics and bodies to choose; leave it out"
                raise InputError(problem, argument=argument)
        return None
    try:
        rows, notes = _read(read_tracks(path), assumed)
    except InputError as error:
        raise InputError(error.problem, path=path, argument=error.argument) from error
    columns.refuse_far(rows, path, assumed.dock_radius)
    return poses.PoseTable(rows, "m", (), notes)


def _read(
    tracks: Sequence[BodyTrack], assumed: poses.Assumptions
) -> tuple[pd.DataFrame, list[str]]:
    """Compose the poses of all robots; returns their rows, and what was assumed."""
    source, notes = _choose_source(tracks, assumed.topic)
    robots, left_out = _robots(source.tracks, assumed.bodies)
    transforms = [track for track in tracks if track.is_transform]
    used = [*(track for bodies in robots.values() for track in bodies), *transforms]
    stamped = all(_is_set(track) for track in used)
    if not stamped:
        left_out.append("stamps of messages are not set, or do not rise: times are of recording")
    else:
        left_out += _different_delays(robots)
    frames, lost = _frames(transforms, stamped=stamped)
    roots: dict[str, str] = {}
    tables = []
    for name, bodies in robots.items():
        for body in bodies:
            track, lost_of_body = body.by_time(stamped=stamped)
            track = to_root(track, frames)
            roots |= dict.fromkeys(track.parent, name)
            lost += lost_of_body
            numbers = np.column_stack([track.position, track.orientation_wxyz])
            table = pd.DataFrame(numbers, columns=[*"xyz", *poses.QUATERNION])
            tables.append(table.assign(name=name, time=track.time))
    _refuse_unjoined(roots)
    rows = pd.concat(tables, ignore_index=True)
    if not len(rows):
        raise InputError("all poses are of lost bodies; record them again")
    seen = [name for name in robots if (rows["name"] == name).any()]
    numbers_of_robots, numbered = columns.robot_numbers(seen)
    rows["robot"] = rows["name"].map(dict(zip(seen, numbers_of_robots, strict=True)))
    rows["time"] = (rows["time"] - rows["time"].min()) * 1e-9
    rows = rows.drop(columns="name").assign(line=1, run="").drop_duplicates(["robot", "time"])
    if not rows["robot"].duplicated().any():
        rows = rows.drop(columns="time")
    if lost:
        left_out.append(f"{counted(lost, 'pose')} of lost bodies left out")
    return rows, [*notes, *left_out, *numbered]


def _choose_source(tracks: Sequence[BodyTrack], topic: str) -> tuple[_Source, list[str]]:
    """Choose the topics that have the poses of robots; returns them, and notes."""
    sources = _sources(tracks)
    if topic:
        chosen = [track for track in tracks if fnmatchcase(track.origin.topic, topic)]
        if not chosen:
            problem = f"no topic with poses is {topic!r}; choose one of {_listed(sources)}"
            raise InputError(problem, argument="topic")
        source = _Source(topic, _robot_frames(chosen))
        rest = [track for track in tracks if track not in chosen and not track.is_transform]
        return source, [f"poses are of {source}", *_left_out(rest)]
    likely = [source for source in sources if not _is_other(source)]
    trees = [source for source in likely if source.tracks[0].is_transform]
    if trees:
        likely = _without_repeated(likely, trees[0])
    if not likely:
        problem = "the bag has no poses of robots; record odometry, poses or tf"
        if sources:
            problem += f", or choose --topic of {_listed(sources)}"
        raise InputError(problem)
    if len(likely) > 1:
        problem = f"there are several sources of poses: {_listed(likely)}; choose one by --topic"
        raise InputError(problem)
    used = {id(track) for track in likely[0].tracks}
    rest = [track for track in tracks if id(track) not in used and not track.is_transform]
    return likely[0], [f"poses are of {likely[0]}", *_left_out(rest)]


def _listed(sources: Sequence[_Source]) -> str:
    return poses.first_names([str(source) for source in sources])


def _kinds(names: Iterable[str]) -> list[str]:
    """List names once each, with a star for their numbers."""
    return sorted({_numberless(name) for name in names})


def _numberless(name: str) -> str:
    """Write a star for each number in a name."""
    return re.sub(r"\d+", "*", name)


def _left_out(tracks: Iterable[BodyTrack]) -> list[str]:
    topics = _kinds(track.origin.topic for track in tracks)
    return [f"topics left out: {poses.first_names(topics)}"] if topics else []


def _is_other(source: _Source) -> bool:
    """Whether the topics, or their types, say that the poses are not of robots."""
    origin = source.tracks[0].origin
    return has_other_words(origin.topic) or has_other_words(origin.kind.rpartition("/")[2])


def _sources(tracks: Sequence[BodyTrack]) -> list[_Source]:
    """Group the topics that have the same of different robots."""
    sources = []
    transforms = [track for track in tracks if track.is_transform]
    if transforms:
        pattern = _pattern([track.origin.topic for track in transforms])
        sources.append(_Source(pattern, _robot_frames(transforms)))
    groups: dict[tuple[str, ...], list[BodyTrack]] = {}
    for track in tracks:
        if track.is_transform:
            continue
        topic = track.origin.topic
        key = (track.origin.kind, _numberless(topic))
        groups.setdefault(key, []).append(track)
    sources += _by_letters([group for (_, topic), group in groups.items() if "*" not in topic])
    numbered = [group for (_, topic), group in groups.items() if "*" in topic]
    sources += [_Source(_pattern([t.origin.topic for t in group]), group) for group in numbered]
    return [source for source in sources if source.tracks]


def _by_letters(groups: Sequence[list[BodyTrack]]) -> list[_Source]:
    """Join topics without numbers, such as /alpha/pose and /bravo/pose.

    They are of one type with one body each, and each part of their names is that of all, or
    another in each topic. Any other topic stands alone.
    """
    alike: dict[tuple[str, int], list[BodyTrack]] = {}
    sources = []
    for group in groups:
        origin = group[0].origin
        if len(group) == 1 and not has_other_words(origin.topic):
            alike.setdefault((origin.kind, origin.topic.count("/")), []).extend(group)
        else:
            sources.append(_Source(origin.topic, group))
    for tracks in alike.values():
        parts = zip(*(track.origin.topic.split("/") for track in tracks), strict=True)
        if all(len({*words}) in {1, len(tracks)} for words in parts):
            sources.append(_Source(_pattern([track.origin.topic for track in tracks]), tracks))
        else:
            sources += [_Source(track.origin.topic, [track]) for track in tracks]
    return sources


def _pattern(topics: Sequence[str]) -> str:
    """Write topics as one pattern, with a star for each part in which they differ.

    >>> _pattern(["/bot_1/pose", "/bot_12/pose"])
    '/bot_*/pose'
    """
    shortest = min(topics, key=len)
    if all(topic.startswith(shortest) for topic in topics):
        return shortest
    parts = [topic.split("/") for topic in dict.fromkeys(topics)]
    if len({len(part) for part in parts}) > 1:
        return "*"
    merged = []
    for words in zip(*parts, strict=True):
        different = {*words}
        if len(different) > 1:
            different = {_numberless(word) for word in words}
        merged.append(different.pop() if len(different) == 1 else "*")
    return "/".join(merged)


def _robot_frames(tracks: Sequence[BodyTrack]) -> list[BodyTrack]:
    """Return the bodies that are robots: of transforms, those of the frames of bodies.

    These are the frames `base_link` if there are any, else the last ones of the tree that are not
    static. Frames that never move are parts of a robot, as docks and sensors are, where the frame
    that holds them moves, or holds several.
    """
    others = [track for track in tracks if not track.is_transform]
    if others:
        return others
    for name in _BODY_FRAMES:
        bodies = [track for track in tracks if track.origin.child.rpartition("/")[2] == name]
        if bodies:
            return bodies
    moving = [track for track in tracks if not track.is_static]
    fixed = [track.origin.child for track in moving if _is_fixed(track)]
    children = {track.origin.child for track in moving}
    holds = Counter(track.frame[0] for track in moving if track.origin.child in fixed)
    wholes = {frame for frame in children if frame not in fixed or holds[frame] > 1}
    parts = {
        track.origin.child
        for track in moving
        if track.origin.child in fixed and {*track.frame} <= wholes
    }
    candidates = [track for track in moving if track.origin.child not in parts] or [*tracks]
    above = {frame for track in candidates for frame in track.frame}
    return [track for track in candidates if track.origin.child not in above]


def _is_fixed(track: BodyTrack) -> bool:
    """Whether a frame never moves in its parent."""
    return all(before == after for before, after in pairwise(track.numbers))


def _without_repeated(sources: Sequence[_Source], tree: _Source) -> list[_Source]:
    """Leave out a source that repeats another: the same frames as topics and as transforms.

    Frames in which the poses of other sources are have no robots of their own.
    """
    robots = {track.origin.child for track in tree.tracks}
    others = [source for source in sources if source is not tree]
    parents = {frame for source in others for track in source.tracks for frame in track.frame}
    if robots and robots <= parents:
        return others
    kept = [
        source
        for source in others
        if not {track.origin.child or track.origin.name for track in source.tracks} <= robots
    ]
    return [tree, *kept]


def _robots(
    tracks: Sequence[BodyTrack], chosen: str
) -> tuple[dict[str, list[BodyTrack]], list[str]]:
    """Name the robots; returns their poses by name, and which bodies were left out.

    A robot has the name that its messages state, else that of its topic, else both. Bodies without
    the number that others have, such as the ground, are no robots.
    """
    stated = [track.origin.child or track.origin.name for track in tracks]
    if tracks[0].origin.name and not tracks[0].is_transform:
        stated = [track.origin.name for track in tracks]
    topics = [track.origin.topic for track in tracks]
    names = [f"{topic} {name}" for topic, name in zip(topics, stated, strict=True)]
    for labels in (stated, topics):
        if all(labels) and (len({*labels}) == len(tracks) or tracks[0].is_transform):
            names = labels
            break
    robots: dict[str, list[BodyTrack]] = {}
    for name, track in sorted(zip(names, tracks, strict=True), key=lambda pair: _natural(pair[0])):
        if not chosen or fnmatchcase(name, chosen):
            robots.setdefault(name, []).append(track)
    if not robots:
        problem = f"no body is {chosen!r}; there are {poses.first_names(sorted({*names}))}"
        raise InputError(problem, argument="bodies")
    numbered = [name for name in robots if re.search(r"\d", name)]
    others = [name for name in robots if name not in numbered]
    if not (numbered and others):
        others = []
    robots = {name: bodies for name, bodies in robots.items() if name not in others}
    kinds = Counter(_numberless(name) for name in numbered)
    if len(kinds) > 1 and not chosen:
        problem = f"bodies are of several kinds, {poses.first_names([*kinds])}; choose those of "
        usual, _ = kinds.most_common(1)[0]
        raise InputError(f"{problem}robots by --bodies, for example --bodies '{usual}'")
    notes = []
    if others:
        notes.append(f"bodies without a number left out: {poses.first_names(others)}")
    return robots, notes


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Key that sorts names with numbers by their numbers."""
    parts = re.findall(r"\d+|\D+", name)
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts]


def _is_set(track: BodyTrack) -> bool:
    """Whether stamps are set and rise; one stamp need not, and static transforms have no time."""
    if track.is_static:
        return True
    stamps = track.stamp
    rises = all(before <= after for before, after in pairwise(stamps))
    return stamps[-1] > 0 and rises and (len(stamps) == 1 or stamps[0] < stamps[-1])


def _different_delays(robots: Mapping[str, Sequence[BodyTrack]]) -> list[str]:
    """Say where robots were recorded later than others after their stamps."""
    delay = {
        name: 1e-9 * float(np.median(np.subtract(bodies[0].recorded, bodies[0].stamp)))
        for name, bodies in robots.items()
    }
    usual = float(np.median([*delay.values()]))
    late = [name for name in delay if abs(delay[name] - usual) > _LARGEST_LAG_S]
    if not late:
        return []
    most = max(abs(delay[name] - usual) for name in late)
    text = f"recorded up to {most:.3g} s apart from their stamps as others are: "
    return [f"{text}{poses.first_names(late)}; times are the stamps"]


def _frames(transforms: Sequence[BodyTrack], *, stamped: bool) -> tuple[dict[str, FrameTrack], int]:
    """Gather the poses of each frame of the tree, and count those of lost ones."""
    frames: dict[str, FrameTrack] = {}
    lost = 0
    for transform in transforms:
        track, lost_of_frame = transform.by_time(stamped=stamped)
        lost += lost_of_frame
        if len(track.time):
            child = transform.origin.child
            frames[child] = track if child not in frames else frames[child].merged(track)
    return frames, lost


def _refuse_unjoined(roots: Mapping[str, str]) -> None:
    """Raise InputError if poses are in several frames that no transform joins."""
    if len(roots) > 1:
        examples = [f"{name} in {frame or 'no frame'}" for frame, name in roots.items()]
        problem = f"no transform joins the frames of poses: {poses.first_names(examples)}; record "
        problem += "/tf and /tf_static, too, or poses in one frame"
        raise InputError(problem)
