"""Small logs as other systems write them: beacons and tags, rooms, chains without compass.

Lengths in m; docks have a radius of 0.1 m. Robots with fixes are beacons, robots with ranges tags.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests import structures
from tiswarm.records.sensing_log import SensingLog, SensingNoise

Log = tuple[SensingLog, NDArray[np.float64]]
"""What was sensed, and where robots truly are [m], shape (N, 3)."""

BEACON_SD = 1e-3
CLEARANCE = 0.5
ROOM = np.array([[0.0, 0.0, 0.2], [6.0, 0.0, 2.5], [6.0, 5.0, 0.2], [0.0, 5.0, 2.5]])
"""Four beacons in corners, two of them high."""
CEILING = np.array([[0.0, 0.0, 2.5], [6.0, 0.0, 2.5], [6.0, 5.0, 2.5], [0.0, 5.0, 2.5]])
"""Four beacons in one plane."""


def silent(place: NDArray[np.float64], *, radius: float = 0.1) -> SensingLog:
    """Log robots that sensed nothing but their orientation, without noise."""
    angle = 2.0 * np.pi * np.arange(3) / 3.0
    docks = 1.2 * radius * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    return structures.silent(
        place,
        dock_radius=radius,
        dock_offset_body=docks,
        noise=SensingNoise(tilt_deg=0.0, yaw_deg=0.0),
        length_unit="m",
    )


def with_places(log: SensingLog, place: NDArray[np.float64], robots: Sequence[int]) -> SensingLog:
    """Add fixes of some robots along all axes."""
    robot = np.repeat(np.array(robots, np.int64), 3)
    axis, every = np.tile(np.arange(3), len(robots)), np.ones(len(robot))
    fixes = [robot, np.eye(3)[axis], place[robot, axis], BEACON_SD * every, -every]
    return replace(log, fixes=np.column_stack(fixes))


def with_all_ranges(
    log: SensingLog,
    place: NDArray[np.float64],
    *,
    first: int = 1,
    sd: float,
    seed: int,
    stated: float | None = None,
    late: Mapping[tuple[int, int], float] | None = None,
) -> SensingLog:
    """Let robots from `first` on measure how far all robots before them are.

    Args:
        log: Log without ranges.
        place: True centers [m], shape (N, 3).
        first: First robot that measures.
        sd: Standard deviation of errors [m].
        seed: Seed of errors.
        stated: Standard deviation that the log states; the true one if None.
        late: What single ranges, by (earlier, later) robot, are too long by [m].
    """
    robot, other = np.tril_indices(len(place), -1)
    robot, other = robot[robot >= first], other[robot >= first]
    length = np.linalg.norm(place[robot] - place[other], axis=1)
    length += sd * np.random.default_rng(seed).normal(size=len(robot))
    pairs = zip(other.tolist(), robot.tolist(), strict=True)
    length += [(late or {}).get(pair, 0.0) for pair in pairs]
    every = np.ones(len(robot))
    width = max(sd, BEACON_SD) if stated is None else stated
    ranges = np.column_stack([robot, other, length, width * every, -every])
    return replace(log, ranges=ranges)


def apart(
    rng: np.random.Generator, low: Sequence[float], high: Sequence[float], count: int
) -> NDArray[np.float64]:
    """Draw places in a box that are so far from each other that no docks overlap."""
    place: list[NDArray[np.float64]] = []
    while len(place) < count:
        drawn = rng.uniform(low, high)
        if all(np.linalg.norm(drawn - other) > CLEARANCE for other in place):
            place.append(drawn)
    return np.array(place)


def tags_among(
    beacons: NDArray[np.float64],
    tags: NDArray[np.float64],
    *,
    sd: float,
    seed: int,
    radius: float = 0.1,
    stated: float | None = None,
    late: Mapping[tuple[int, int], float] | None = None,
) -> Log:
    """Log tags that measure their distance to beacons, the first of which is the anchor."""
    place = np.concatenate([beacons, tags])
    log = with_places(silent(place, radius=radius), place, range(1, len(beacons)))
    return (
        with_all_ranges(log, place, first=len(beacons), sd=sd, seed=seed, stated=stated, late=late),
        place,
    )


def room_of_tags(
    beacons: NDArray[np.float64],
    seed: int,
    *,
    count: int = 6,
    sd: float = 0.1,
    stated: float | None = None,
    late: Mapping[tuple[int, int], float] | None = None,
) -> Log:
    """Log some tags below head height in a room of four beacons."""
    tags = apart(np.random.default_rng([1, seed]), [1.0, 1.0, 0.3], [5.0, 4.0, 1.5], count)
    return tags_among(beacons, tags, sd=sd, seed=seed, stated=stated, late=late)


def nearly_flat(amplitude: float, seed: int) -> Log:
    """Log one tag above a wavy ring of thirty beacons."""
    turn = 2.0 * np.pi * np.arange(30) / 30.0
    wave = amplitude * (np.cos(3.0 * turn) + 0.5)
    ring = np.column_stack([5.0 * np.cos(turn), 5.0 * np.sin(turn), wave])
    tag = np.array([[0.7, -0.4, 1.5]]) + np.random.default_rng([2, seed]).uniform(-0.2, 0.2, 3)
    return tags_among(ring, tag, sd=0.05, seed=seed, radius=0.02)


def without_beacons(robots: int, seed: int, *, sd: float = 0.1) -> Log:
    """Log robots in a flat box that know all their distances and nothing else."""
    place = apart(np.random.default_rng([3, seed]), [0.0, 0.0, 0.0], [4.0, 4.0, 2.0], robots)
    return with_all_ranges(silent(place), place, sd=sd, seed=seed), place


def open_chain(robots: int, seed: int, *, sd_deg: float = 1.0) -> Log:
    """Log robots of one dock in a row, each turned as its connection to the one before says."""
    rng = np.random.default_rng([4, seed])
    place = np.outer(np.arange(robots), [1.0, 0.0, 0.0])
    turn = Rotation.random(robots, random_state=seed)
    error = np.radians(sd_deg) * rng.normal(size=(2, robots - 1, 3))
    seen = turn[1:].inv() * turn[:-1] * Rotation.from_rotvec(error[0])
    toward = turn[1:].inv().apply(place[:-1] - place[1:])
    toward = Rotation.from_rotvec(error[1]).apply(toward)
    later = np.arange(1, robots)
    pair = np.column_stack([later, 0 * later, later - 1, 0 * later])
    wxyz = turn.as_quat(scalar_first=True)
    wxyz[1:] = np.nan
    log = replace(
        silent(place, radius=0.5),
        dock_offset_body=np.zeros((1, 3)),
        orientation_wxyz=wxyz,
        contacts=pair[:, [2, 3, 0, 1]].astype(np.int32),
        directions=np.column_stack([pair, toward]),
        connections=np.column_stack([pair, seen.as_quat(scalar_first=True)]),
        noise=SensingNoise(tilt_deg=0.0, yaw_deg=0.0, connection_deg=sd_deg, direction_deg=sd_deg),
    )
    return log, place
