"""What is wrong in a log and not stated there: exchanged names, wrong docks, biased ranges.

Each lie takes a log and a random generator, and returns the log with the lie. True positions stay.
A wrong common parameter, such as the dock offset, is stated by an error of a size of its own.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.records.sensing_log import (
    KNOWN_SD,
    SensingLog,
    SensingNoise,
    canonical_contacts,
)

WRONG_DEG = 20.0
"""Turn of orientations that are off [deg]."""

DRIFT_DEG = 9.0
"""Turn that the orientation of a robot that drifts gains at each stance [deg]."""

YAW_BIAS_DEG = 10.0
"""Standard deviation of the bias of yaw that a log does not state [deg]."""

REACH, RANGE_SD = 12.0, 0.1
"""Longest range, and standard deviation of its error [R]."""

LEAST_BIAS, MOST_BIAS = 0.3, 1.0
"""Bias of all ranges of a log [R]."""

ANCHORS, ANCHOR_OFF = 2, 2.0
"""Further anchors, and how far from its stated place one of them is [R]."""

TENTH, TWENTIETH, FIFTH = 0.1, 0.05, 0.2

Lie = Callable[[SensingLog, Reals, np.random.Generator], SensingLog]


def exchanged_names(log: SensingLog, _truth: Reals, rng: np.random.Generator) -> SensingLog:
    """Exchange two robots in what later robots sensed of them."""
    robot, _, later, _ = log.contacts.T
    pairs = [
        (one, two)
        for one, two in combinations(np.unique(robot[robot > 0]).tolist(), 2)
        if (np.isin(robot, [one, two]) & (later > two)).any()
    ]
    one, two = pairs[rng.integers(len(pairs))]
    swapped = np.where(robot == one, two, np.where(robot == two, one, robot))
    contacts = log.contacts.copy()
    contacts[:, 0] = np.where(later > two, swapped, robot)
    return replace(log, contacts=canonical_contacts(contacts))


def turned(log: SensingLog, angle: Reals, rng: np.random.Generator) -> SensingLog:
    """Turn orientations by angles [rad], shape (N,), about random axes; in a plane about y."""
    axis = rng.normal(size=(log.robot_count, 3))
    if is_planar(log):
        axis[:, [0, 2]] = 0.0
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    turn = Rotation.from_rotvec(angle[:, None] * axis)
    wxyz = (turn * Rotation.from_quat(log.orientation_wxyz, scalar_first=True)).as_quat(
        canonical=True, scalar_first=True
    )
    return replace(log, orientation_wxyz=np.where(angle[:, None], wxyz, log.orientation_wxyz))


def is_planar(log: SensingLog) -> bool:
    """Judge whether fixes put all robots in the plane y = 0."""
    return len(np.unique(log.fixes[log.fixes[:, 2] == 1.0, 0])) == log.robot_count


def wrong_orientations(log: SensingLog, _truth: Reals, rng: np.random.Generator) -> SensingLog:
    """Turn a tenth of the orientations by 20 deg."""
    return turned(log, np.radians(WRONG_DEG) * _some(log.robot_count, TENTH, rng), rng)


def wrong_yaw(log: SensingLog, _truth: Reals, rng: np.random.Generator) -> SensingLog:
    """Turn each robot but the anchor about the vertical by a bias; about y in a plane."""
    bias = np.radians(YAW_BIAS_DEG) * rng.normal(size=(log.robot_count, 1))
    bias[0] = 0.0
    turn = Rotation.from_rotvec(bias * ([0.0, 1.0, 0.0] if is_planar(log) else [0.0, 0.0, 1.0]))
    wxyz = turn * Rotation.from_quat(log.orientation_wxyz, scalar_first=True)
    return replace(log, orientation_wxyz=wxyz.as_quat(canonical=True, scalar_first=True))


def understated_noise(log: SensingLog, _truth: Reals, _rng: np.random.Generator) -> SensingLog:
    """State half of the noise of orientations."""
    tilt, yaw = (0.5 * (log.stated(key) or 0.0) for key in ("tilt_deg", "yaw_deg"))
    return replace(log, noise=SensingNoise(tilt_deg=tilt, yaw_deg=yaw))


def wrong_docks(log: SensingLog, _truth: Reals, rng: np.random.Generator) -> SensingLog:
    """Name another dock of the earlier robot in a tenth of the contacts."""
    contacts, docks = log.contacts.copy(), len(log.dock_offset_body)
    wrong = _some(len(contacts), TENTH, rng, first=0)
    contacts[wrong, 1] = (contacts[wrong, 1] + rng.integers(1, docks, wrong.sum())) % docks
    return replace(log, contacts=canonical_contacts(contacts))


def wrong_robots(log: SensingLog, _truth: Reals, rng: np.random.Generator) -> SensingLog:
    """Name another earlier robot in a twentieth of the contacts."""
    contacts = log.contacts.copy()
    later = contacts[:, 2]
    wrong = _some(int((later > 1).sum()), TWENTIETH, rng, first=0)
    row = np.flatnonzero(later > 1)[wrong]
    contacts[row, 0] = (contacts[row, 0] + rng.integers(1, later[row])) % later[row]
    return replace(log, contacts=canonical_contacts(contacts))


def false_contacts(log: SensingLog, _truth: Reals, rng: np.random.Generator) -> SensingLog:
    """Add contacts of random docks, two and a twentieth of the true ones."""
    docks = len(log.dock_offset_body)
    count = 2 + int(TWENTIETH * len(log.contacts))
    later = rng.integers(1, log.robot_count, count)
    false = [rng.integers(0, later), rng.integers(0, docks, count), later,
             rng.integers(0, docks, count)]  # fmt: skip
    return replace(
        log,
        contacts=canonical_contacts(
            np.concatenate([log.contacts, np.column_stack(false).astype(np.int32)])
        ),
    )


def biased_ranges(log: SensingLog, truth: Reals, rng: np.random.Generator) -> SensingLog:
    """Add ranges that are all too long by one bias."""
    return with_ranges(log, truth, rng, bias=rng.uniform(LEAST_BIAS, MOST_BIAS))


def with_ranges(
    log: SensingLog, truth: Reals, rng: np.random.Generator, bias: float = 0.0
) -> SensingLog:
    """Add ranges of robots near each other, too long by a bias [R]."""
    pair = cKDTree(truth).query_pairs(REACH, output_type="ndarray")
    other, robot = np.sort(pair, axis=1)[np.lexsort(np.sort(pair, axis=1).T)].T
    length = np.linalg.norm(truth[robot] - truth[other], axis=1)
    length += bias + RANGE_SD * rng.normal(size=len(robot))
    every = np.ones(len(robot))
    return replace(log, ranges=np.column_stack([robot, other, length, RANGE_SD * every, -every]))


def missed_contacts(log: SensingLog, _truth: Reals, rng: np.random.Generator) -> SensingLog:
    """Leave out a fifth of the contacts."""
    return replace(log, contacts=log.contacts[~_some(len(log.contacts), FIFTH, rng, first=0)])


def mute_robots(log: SensingLog, _truth: Reals, rng: np.random.Generator) -> SensingLog:
    """Leave out all that a tenth of the robots sensed; what others sensed of them stays."""
    mute = np.flatnonzero(_some(log.robot_count, TENTH, rng))
    wxyz, height = log.orientation_wxyz.copy(), log.flip_height.copy()
    wxyz[mute] = height[mute] = np.nan
    kept = log.contacts[~np.isin(log.contacts[:, 2], mute)]
    return replace(log, orientation_wxyz=wxyz, flip_height=height, contacts=kept)


def cut_off(log: SensingLog, _truth: Reals, rng: np.random.Generator) -> SensingLog:
    """Leave out all contacts between a part and the others."""
    is_part = part_behind(log, rng)
    robot, other = log.contacts[:, 0], log.contacts[:, 2]
    return replace(log, contacts=log.contacts[is_part[robot] == is_part[other]])


def wrong_tie(log: SensingLog, _truth: Reals, rng: np.random.Generator) -> SensingLog:
    """Leave out the contacts that tie a part to the others, but one, which names a wrong robot."""
    is_part = part_behind(log, rng)
    robot, _, other, _ = log.contacts.T
    ties = np.flatnonzero(is_part[robot] != is_part[other])
    rest = np.flatnonzero(~is_part)
    inside = np.flatnonzero(is_part)
    pairs = [(a, b) for a in rest.tolist() for b in inside.tolist() if a < b]
    touching = set(map(tuple, log.contacts[:, [0, 2]].tolist()))
    wrong = [pair for pair in pairs if pair not in touching]
    one, two = wrong[rng.integers(len(wrong))]
    docks = len(log.dock_offset_body)
    false = np.array([[one, rng.integers(docks), two, rng.integers(docks)]], np.int32)
    kept = np.delete(log.contacts, ties, axis=0)
    return replace(log, contacts=canonical_contacts(np.concatenate([kept, false])))


def wrong_anchor(log: SensingLog, truth: Reals, rng: np.random.Generator) -> SensingLog:
    """Add anchors, one of them 2 R off its stated place; in a plane it is off in the plane."""
    robot = rng.choice(np.arange(1, log.robot_count), ANCHORS, replace=False)
    off = rng.normal(size=3) * ([1.0, 0.0, 1.0] if is_planar(log) else [1.0, 1.0, 1.0])
    place = truth[robot]
    place[0] += ANCHOR_OFF * off / np.linalg.norm(off)
    one = np.ones(len(robot))
    fixes = [
        np.column_stack([robot, *(one * (k == axis) for k in range(3)), place[:, axis],
                         KNOWN_SD * one, -one])
        for axis in range(3)
    ]  # fmt: skip
    return replace(log, fixes=np.unique(np.concatenate([log.fixes, *fixes]), axis=0))


class WrongParameter(NamedTuple):
    """A parameter that all robots share, which a log states wrongly."""

    stated: Callable[[SensingLog, float, np.random.Generator], SensingLog]
    """Returns the log that states it with an error [R, 1, deg]."""

    small: float
    large: float
    """Sizes of the error [R, 1, deg]."""

    value: Callable[[SensingLog, float], float]
    """Returns its right value, from the log that states it with an error [log unit, 1, deg]."""


def _wrong_offset(log: SensingLog, error: float, _rng: np.random.Generator) -> SensingLog:
    offset = np.linalg.norm(log.dock_offset_body, axis=1, keepdims=True)
    return replace(log, dock_offset_body=log.dock_offset_body * (1.0 + error / offset))


def _right_offset(log: SensingLog, error: float) -> float:
    return float(np.linalg.norm(log.dock_offset_body, axis=1).mean()) - error


def _wrong_scale(log: SensingLog, error: float, _rng: np.random.Generator) -> SensingLog:
    """Multiply ranges and heights, and the place of the anchor and the ground."""
    ranges = log.ranges.copy()
    ranges[:, 2] *= 1.0 + error
    return replace(
        log,
        ranges=ranges,
        flip_height=log.flip_height * (1.0 + error),
        anchor_position=log.anchor_position * (1.0 + error),
        ground_z=None if log.ground_z is None else log.ground_z * (1.0 + error),
    )


def _wrong_ranges(log: SensingLog, error: float, _rng: np.random.Generator) -> SensingLog:
    ranges = log.ranges.copy()
    ranges[:, 2] += error
    return replace(log, ranges=ranges)


def _wrong_anchor_height(log: SensingLog, error: float, _rng: np.random.Generator) -> SensingLog:
    return replace(log, anchor_position=log.anchor_position + error * np.eye(3)[2])


def _wrong_world(log: SensingLog, error: float, rng: np.random.Generator) -> SensingLog:
    """Tilt all orientations about a random horizontal axis."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    tilt = Rotation.from_rotvec(np.radians(error) * np.array([np.cos(angle), np.sin(angle), 0.0]))

    def tilted(wxyz: Reals) -> Reals:
        return (tilt * Rotation.from_quat(wxyz, scalar_first=True)).as_quat(scalar_first=True)

    stances = log.earlier
    stances = replace(stances, orientation_wxyz=tilted(stances.orientation_wxyz))
    return replace(log, orientation_wxyz=tilted(log.orientation_wxyz), stances=stances)


def _wrong_docks(log: SensingLog, error: float, rng: np.random.Generator) -> SensingLog:
    """Turn all docks about a random axis of the body."""
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(np.radians(error) * axis / np.linalg.norm(axis))
    return replace(log, dock_offset_body=turn.apply(log.dock_offset_body))


COMMON: Mapping[str, WrongParameter] = {
    "dock offset": WrongParameter(_wrong_offset, 0.01, 0.1, _right_offset),
    "dock radius": WrongParameter(
        lambda log, error, _: replace(log, dock_radius=log.dock_radius + error),
        0.01, 0.05, lambda log, error: log.dock_radius - error,
    ),
    "scale of measured lengths": WrongParameter(
        _wrong_scale, 0.01, 0.05, lambda _, error: 1.0 / (1.0 + error)
    ),
    "ground height": WrongParameter(
        lambda log, error, _: replace(log, ground_z=(log.ground_z or 0.0) + error),
        0.05, 0.5, lambda log, error: (log.ground_z or 0.0) - error,
    ),
    "shift of all heights": WrongParameter(
        lambda log, error, _: replace(log, flip_height=log.flip_height + error),
        0.05, 0.5, lambda _, error: -error,
    ),
    "shift of all ranges": WrongParameter(_wrong_ranges, 0.1, 0.5, lambda _, error: -error),
    "anchor height": WrongParameter(
        _wrong_anchor_height, 0.05, 0.5, lambda log, error: float(log.anchor_position[2]) - error
    ),
    "turn of the world frame of all orientations": WrongParameter(
        _wrong_world, 1.0, 8.0, lambda _, error: abs(error)
    ),
    "turn of all docks in the body frame": WrongParameter(
        _wrong_docks, 1.0, 8.0, lambda _, error: abs(error)
    ),
}  # fmt: skip
"""Wrong common parameters by the names that estimates give them."""


def drifting_robot(log: SensingLog, _truth: Reals, rng: np.random.Generator) -> SensingLog:
    """Let the orientation of the robot with most stances, or of one of all, drift from its spawn.

    With one stance each, it is turned by 20 deg.
    """
    stances = log.earlier
    count = np.diff(stances.start)
    robot = int(count.argmax()) if count.any() else int(rng.integers(1, log.robot_count))
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    rows = np.arange(*stances.start[robot : robot + 2])
    step = np.radians(DRIFT_DEG if len(rows) else WRONG_DEG)
    of_stance = stances.orientation_wxyz.copy()
    final = log.orientation_wxyz.copy()
    for number, row in enumerate(rows.tolist()):
        drift = Rotation.from_rotvec(number * step * axis)
        of_stance[row] = (drift * Rotation.from_quat(of_stance[row], scalar_first=True)).as_quat(
            scalar_first=True
        )
    drift = Rotation.from_rotvec(max(len(rows), 1) * step * axis)
    final[robot] = (drift * Rotation.from_quat(final[robot], scalar_first=True)).as_quat(
        scalar_first=True
    )
    turned_stances = None
    if log.stances is not None:
        turned_stances = replace(stances, orientation_wxyz=of_stance)
    return replace(log, orientation_wxyz=final, stances=turned_stances)


def part_behind(log: SensingLog, rng: np.random.Generator) -> Bools:
    """Choose robots that are reached through one: a fifth to a half of all if there are such."""
    robot, other = log.contacts[:, 0], log.contacts[:, 2]
    robots = log.robot_count
    graph = coo_array((np.ones(len(robot)), (robot, other)), (robots, robots)).tocsr()
    order, before = breadth_first_order(graph, 0, directed=False)
    size = np.ones(robots, np.int64)
    for each in order[:0:-1].tolist():
        size[before[each]] += size[each]
    share = size / robots
    fit = np.flatnonzero((share >= FIFTH) & (share <= 0.5))  # noqa: PLR2004 - see the docstring
    fit = fit[fit > 0] if (fit > 0).any() else np.argsort(np.abs(share - FIFTH))[:1]
    return _reached(order, before, int(rng.choice(fit)))


def _reached(order: AnyInts, before: AnyInts, first: int) -> Bools:
    found = np.zeros(len(before), np.bool_)
    found[first] = True
    for each in order[1:].tolist():
        found[each] |= found[before[each]]
    return found


def _some(count: int, share: float, rng: np.random.Generator, *, first: int = 1) -> Bools:
    """Choose a share of items from `first` on, one at least."""
    chosen = np.zeros(count, np.bool_)
    number: Ints | int = max(1, round(share * (count - first)))
    chosen[rng.choice(np.arange(first, count), number, replace=False)] = True
    return chosen


LIES: Mapping[str, Lie] = {
    "exchanged names": exchanged_names,
    "orientations off": wrong_orientations,
    "noise understated": understated_noise,
    "wrong docks": wrong_docks,
    "wrong robots": wrong_robots,
    "false contacts": false_contacts,
    "biased ranges": biased_ranges,
    "missed contacts": missed_contacts,
    "mute robots": mute_robots,
    "cut off": cut_off,
    "yaw off": wrong_yaw,
}
"""Lies of half of the generated logs, by name."""
