"""Logs of small swarms of many kinds, and logs in which rows are missing, doubled or swapped.

Logs are plain data, as in a file: a header, and then a line of each robot.
"""

import json
import random
from collections.abc import Callable, Iterable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.structures import (
    Rule,
    grown,
    silent,
    structure,
    with_connections,
    with_directions,
    with_fixes,
    with_heights,
    with_ranges,
)
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.records.sensing_log import KEYS, LISTS, SensingLog, SensingNoise
from tiswarm.sensing import SensingParams, observe
from tiswarm.sensing.suites import STATIONS
from tiswarm.world.params import BridgeParams, CantileverParams, TowerParams

Lines = list[dict[str, Any]]
Random = random.Random

ALL_SENSES = SensingParams(
    tilt_noise_deg=1.0,
    yaw_noise_deg=2.0,
    yaw_bias_deg=3.0,
    spawn_noise=0.1,
    false_contacts=0.1,
    beacons=STATIONS,
    beacon_kind="sweep",
    fix_bias=0.5,
    range_reach=6.0,
)
"""What robots can sense without a suite, with noise."""

NO_BIAS = replace(ALL_SENSES, yaw_bias_deg=0.0, fix_bias=0.0)
"""The same without errors that robots or measurements share, which some methods refuse."""


def logs_of_all_kinds(folder: Path) -> dict[str, Lines]:
    """Sense small swarms, and return their logs by name.

    Args:
        folder: Where files are written on the way.
    """
    path = folder / "sensing.jsonl"
    logs = {}
    for name, log in _sensed():
        write_sensing_log(log, path)
        header, *robots = [json.loads(line) for line in path.read_text().splitlines()]
        logs[name] = [{**header, "version": 2}, *robots]
    header, *robots = logs["tower, every key"]
    own, other, its = robots[7]["contacts"][0]
    events = [
        {**robots[5], "event": "replace", "stances": robots[5]["stances"][1:]},
        {"event": "leave", "robot": 4},
        {"event": "release", "robot": other, "contacts": [[its, 7, own]]},
    ]
    logs["tower, events"] = [{**header, "version": 3}, *robots, *events]
    return logs


def _sensed() -> Iterable[tuple[str, SensingLog]]:
    """Yield a log of each kind with its name."""
    tower = grown(TowerParams(), robots=8, seed=0)
    cantilever = grown(CantileverParams(), robots=12, seed=1)
    bridge = grown(BridgeParams(), robots=10, seed=2)
    yield "tower", observe(tower, NO_BIAS)
    yield "cantilever, biased", observe(cantilever, ALL_SENSES)
    yield "bridge, two anchors", observe(bridge, NO_BIAS)
    yield "tower, own docks", observe(tower, replace(NO_BIAS, contact_docks="own"))
    yield "tower, no docks", observe(tower, replace(NO_BIAS, contact_docks="none"))
    every = with_fixes(observe(tower, NO_BIAS), tower, [2, 5], each=2, sd=0.1)
    every = with_ranges(every, tower, reach=6.0, sd=0.1)
    every = with_connections(with_directions(every, tower, sd_deg=1.0), tower, sd_deg=1.0)
    yield "tower, every key", every
    final = observe(cantilever, SensingParams(stances=False, heights=False))
    yield "cantilever, directions", with_directions(final, cantilever, sd_deg=2.0)
    for suite in ("kilobot", "freesn", "m-blocks", "atron", "coachbot-v2", "swarmbang"):
        yield suite, observe(tower, SensingParams(suite=suite))
    yield "m-blocks, touch", observe(tower, SensingParams(suite="m-blocks", touch=True))
    for kind, docks in (("tree", 1), ("loops", 4), ("ball", 5), ("chain", 2)):
        yield (
            f"{kind} of {docks} docks",
            with_heights(*structure(Rule(kind=kind, docks=docks), 9, 1)),
        )
    yield "half untied", structure(Rule(kind="loops", untied=0.5, wrong=0.1), 12, 3)[0]
    yield "beacons and tags", _beacons_and_tags(planar=False)
    yield "planar tags", _beacons_and_tags(planar=True)
    yield "ring without compass", _ring(10)


def _beacons_and_tags(*, planar: bool) -> SensingLog:
    """Log robots with ranges to all before them; the first four state where they are."""
    rng = np.random.default_rng(planar)
    place = rng.uniform(-20.0, 20.0, (9, 3)) * [1.0, 1.0, not planar]
    place[0] = 0.0
    rows = [
        [i, j, max(0.1, np.linalg.norm(place[i] - place[j]) + rng.normal(0.0, 0.1)), 0.1, -1.0]
        for i in range(4, 9)
        for j in range(i)
    ]
    fixes = [[i, *axis, axis @ place[i], 0.01, -1.0] for i in range(1, 4) for axis in np.eye(3)]
    if planar:
        fixes += [[i, 0.0, 0.0, 1.0, 0.0, 0.001, -1.0] for i in range(4, 9)]
    noise = SensingNoise(tilt_deg=0.0, yaw_deg=0.0)
    return silent(place, ranges=np.array(rows), fixes=np.array(sorted(fixes)), noise=noise)


def _ring(robots: int) -> SensingLog:
    """Log a closed ring of robots of one dock, whose orientations connections chain."""
    rng = np.random.default_rng(0)
    angle = 2.0 * np.pi * np.arange(robots) / robots
    place = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]) / np.sin(angle[1] / 2.0)
    turn = Rotation.random(robots, random_state=0)
    pairs = [(i, i - 1) for i in range(1, robots)] + [(robots - 1, 0)]
    contacts, connections, directions = [], [], []
    for i, j in pairs:
        error = Rotation.from_rotvec(rng.normal(0.0, np.radians(2.0), (2, 3)))
        toward = error[0].apply(turn[i].inv().apply(place[j] - place[i]))
        relative = (error[1] * turn[i].inv() * turn[j]).as_quat(scalar_first=True)
        contacts.append([j, 0, i, 0])
        connections.append([i, 0, j, 0, *relative])
        directions.append([i, 0, j, 0, *(toward / np.linalg.norm(toward))])
    orientation = np.full((robots, 4), np.nan)
    orientation[0] = turn[0].as_quat(scalar_first=True)
    return silent(
        place,
        contacts=contacts,
        dock_offset_body=np.zeros((1, 3)),
        orientation_wxyz=orientation,
        connections=_sorted(connections),
        directions=_sorted(directions),
        noise=SensingNoise(tilt_deg=0.0, yaw_deg=0.0, direction_deg=2.0, connection_deg=2.0),
    )


def _sorted(rows: list[list[float]]) -> NDArray[np.float64]:
    return np.array(sorted(rows))


# --- damage ----------------------------------------------------------------------------------


def with_damaged_rows(random: Random, lines: Lines) -> Lines:
    """Return a log in which some rows are missing, doubled or swapped, or name another robot."""
    damaged = deepcopy(lines)
    for _ in range(random.choice([1, 1, 2, 3, 5, 8])):
        random.choice(DAMAGES)(random, damaged)
    return damaged


def _robots(lines: Lines) -> Lines:
    """List the lines of robots, the anchor's first."""
    return [line for line in lines[1:] if "contacts" in line and line.get("event") != "release"]


def _stances(robot: dict[str, Any]) -> Lines:
    """List what a robot sensed at each stance, the final one first."""
    return [robot, *(robot.get("stances") or [])]


def _lists(lines: Lines) -> list[tuple[dict[str, Any], str]]:
    """List all lists of rows that are not empty, as stances with keys."""
    stances = [stance for robot in _robots(lines) for stance in _stances(robot)]
    return [(stance, key) for stance in stances for key in LISTS if stance.get(key)]


def _without(stance: dict[str, Any], key: str) -> None:
    """Remove all rows of a key; a robot states its contacts, even where it has none."""
    if key in stance:
        stance[key] = [] if key == "contacts" else None


def _rows_removed(random: Random, lines: Lines) -> None:
    for stance, key in _some(random, _lists(lines)):
        share = random.choice([0.3, 0.7, 1.0])
        stance[key] = [row for row in stance[key] if random.random() > share]


def _rows_doubled(random: Random, lines: Lines) -> None:
    """Repeat rows, most often where a log may have several of a kind."""
    lists = _lists(lines)
    if random.random() < 0.8:
        lists = [(stance, key) for stance, key in lists if LISTS[key].repeats]
    for stance, key in _some(random, lists):
        stance[key] += [deepcopy(random.choice(stance[key]))]


def _rows_swapped(random: Random, lines: Lines) -> None:
    """Swap rows of two stances, which may be of two robots."""
    lists = _lists(lines)
    if lists:
        one, key = random.choice(lists)
        other = random.choice([stance for stance, name in lists if name == key])
        i, j = random.randrange(len(one[key])), random.randrange(len(other[key]))
        one[key][i], other[key][j] = other[key][j], one[key][i]


def _numbers_swapped(random: Random, lines: Lines) -> None:
    """Swap a column of two rows of a key, such as two distances."""
    lists = _lists(lines)
    if lists:
        one, key = random.choice(lists)
        other = random.choice([stance for stance, name in lists if name == key])
        i, j = random.randrange(len(one[key])), random.randrange(len(other[key]))
        kinds = ("distance", "value", "vector", "sd", "dock")
        columns = [k for k, name in enumerate(LISTS[key].columns) if name in kinds]
        first, second = one[key][i], other[key][j]
        if columns and isinstance(first, list):
            column = random.choice(columns)
            first[column], second[column] = second[column], first[column]


def _key_removed(random: Random, lines: Lines) -> None:
    """Remove what some robots sensed of a kind."""
    key = random.choice([*KEYS, "stances"])
    for robot in _some(random, _robots(lines)):
        for stance in _stances(robot):
            _without(stance, key)


def _robot_muted(random: Random, lines: Lines) -> None:
    for robot in random.sample(_robots(lines), k=1):
        for key in [*KEYS, "stances"]:
            _without(robot, key)


def _stance_removed(random: Random, lines: Lines) -> None:
    walked = [robot for robot in _robots(lines) if robot.get("stances")]
    for robot in _some(random, walked):
        del robot["stances"][random.randrange(len(robot["stances"]))]


def _orientation_removed(random: Random, lines: Lines) -> None:
    for robot in _some(random, _robots(lines)[1:]):
        robot["orientation_wxyz"] = None
        robot["stances"] = None


def _values_swapped(random: Random, lines: Lines) -> None:
    """Swap what two robots sensed, of one kind or all."""
    robots = _robots(lines)
    if len(robots) > 2:
        one, other = random.sample(robots[1:], 2)
        kinds = [*KEYS, "stances", "orientation_wxyz"]
        for key in random.choice([kinds, [random.choice(kinds)]]):
            one[key], other[key] = other.get(key), one.get(key)
        for robot in (one, other):
            robot["contacts"] = robot["contacts"] or []


def _other_robot_named(random: Random, lines: Lines) -> None:
    """Let a row name another earlier robot."""
    names = [robot["robot"] for robot in _robots(lines)]
    pairs = [(s, key) for s, key in _lists(lines) if "robot" in LISTS[key].columns]
    for stance, key in _some(random, pairs):
        row = random.choice(stance[key])
        column = LISTS[key].columns.index("robot")
        if row[column] in names:
            row[column] = random.choice(names[: names.index(row[column]) + 1])


def _robots_cut(random: Random, lines: Lines) -> None:
    """Keep the first robots alone."""
    count = len(_robots(lines))
    if len(lines) == count + 1:
        del lines[1 + random.choice([1, 2, count - 1, random.randint(1, count)]) :]


def _header_key_removed(random: Random, lines: Lines) -> None:
    lines[0].pop(random.choice(["ground_z", "noise", "noise"]), None)


DAMAGES: list[Callable[[Random, Lines], None]] = [
    _rows_removed, _rows_removed, _rows_removed, _rows_doubled, _rows_swapped, _numbers_swapped,
    _key_removed, _key_removed, _key_removed, _robot_muted, _stance_removed, _orientation_removed,
    _values_swapped, _other_robot_named, _robots_cut, _header_key_removed,
]  # fmt: skip
"""Ways to damage a log, the more likely ones several times."""


def _some(random: Random, items: list[Any]) -> list[Any]:
    """Choose one item, a few, or all."""
    if not items:
        return []
    return random.sample(items, random.choice([1, 1, random.randint(1, len(items)), len(items)]))
