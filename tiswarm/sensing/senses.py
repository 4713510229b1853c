"""Senses beside touch: fixes, ranges, directions of contacts, orientations of neighbors, names.

Fixes and ranges need line of sight, which docks of other robots and the ground block. The two
planes of a lighthouse are sources: what one measures has an error in common.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import AnyInts, Bools, Ints, Reals
from tiswarm.compute.math import dock_offsets, normal, uniform
from tiswarm.sensing.noise import NO_SOURCE
from tiswarm.sensing.params import SensingParams, Vibration
from tiswarm.world.history import History

_EDGE = 2.5
"""Edge of a cell [dock radii]."""

_ROUNDING = 1e-3
"""Part of a radius by which cells and boxes are larger than they must be."""


class Views(NamedTuple):
    """K segments that robots look along, and who may block them."""

    start: Reals
    """Where each begins [R], shape (K, 3)."""

    end: Reals
    """Where each ends [R], shape (K, 3)."""

    joined: Ints
    """Robots that are part of the structure by then, and block; later ones do not, shape (K,)."""

    robot: Ints
    """Robot that looks, and does not block, shape (K,)."""

    other: Ints
    """Robot at the end, which does not block either; -1 for none, shape (K,)."""


class Lookouts(NamedTuple):
    """V stances at which robots look around."""

    robot: Ints
    """Robot, shape (V,)."""

    stance: Ints
    """Its stance, counted from its spawn, shape (V,)."""

    center: Reals
    """Its center there [R], shape (V, 3)."""

    joined: Ints
    """Robots that are part of the structure by then, shape (V,)."""

    def select(self, chosen: Bools) -> "Lookouts":
        """Return those where `chosen`, shape (V,), is true."""
        robot, stance, center, joined = self
        return Lookouts(robot[chosen], stance[chosen], center[chosen], joined[chosen])

    def toward(self, point: Reals) -> Views:
        """Look from each toward one point, shape (3,)."""
        nobody = np.full(len(self.robot), -1)
        return Views(self.center, np.tile(point, (len(nobody), 1)), self.joined, self.robot, nobody)


def find_lookouts(history: History, params: SensingParams) -> Lookouts:
    """List the stances at which robots have fixes and ranges."""
    length = np.array([walk.stance_count for walk in history.walks])
    robot = np.repeat(np.arange(history.robot_count), length)
    stance = np.concatenate([np.arange(count) for count in length])
    center = np.concatenate([walk.center for walk in history.walks])
    is_last = stance == length[robot] - 1
    if params.sight_at == "end":
        complete = np.full(len(robot), history.robot_count)
        return Lookouts(robot, stance, center, complete).select(is_last)
    is_kept = is_last | params.senses("stances")
    return Lookouts(robot, stance, center, robot).select(is_kept)


def in_sight(history: History, views: Views) -> Bools:
    """Find which segments neither meet docks of robots, where these end up, nor the ground.

    A segment that only touches a dock is free.

    Returns:
        Whether each is free, shape (K,).
    """
    if not len(views.robot):
        return np.empty(0, np.bool_)
    from tiswarm.compute import backend  # noqa: PLC0415 - slow to import
    from tiswarm.compute.neighbor_kernels import CellList  # noqa: PLC0415
    from tiswarm.sensing.sight_kernels import Segments, SightLimits, find_blocked  # noqa: PLC0415

    radius = history.robot.dock_radius
    turned = dock_offsets(history.orientation_wxyz, history.robot.dock_offset_body)
    dock = (history.position[:, None, :] + turned).reshape(-1, 3)
    limits = SightLimits(
        radius=radius,
        edge=_EDGE * radius,
        stride=2.0 * (np.sqrt(_EDGE**2 - 1.0) - _ROUNDING) * radius,
        docks=turned.shape[1],
    )
    reach = (1.0 + _ROUNDING) * radius
    near = _near_part(views, dock.min(axis=0) - reach, dock.max(axis=0) + reach)
    robots = np.column_stack([views.joined, views.robot, views.other]).astype(np.int32)
    blocked = np.empty(len(robots), np.int32)
    with backend.exclusive():
        backend.processor()
        find_blocked(
            limits, dock, *Segments(views.start, views.end, near, robots),
            *CellList.allocate(1, len(dock)), blocked,
        )  # fmt: skip
    is_free: Bools = (blocked == 0) & ~history.terrain.hides(views.start, views.end)
    return is_free


def _near_part(views: Views, low: Reals, high: Reals) -> Reals:
    """Clip segments to a box; from and to as parts of each segment, shape (K, 2)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = (np.stack([low, high])[:, None] - views.start) / (views.end - views.start)
    enter, leave = np.fmin(*sides), np.fmax(*sides)  # NaN: within a side, so beyond all docks
    first = np.fmax.reduce(enter, axis=1, initial=0.0)
    last = np.fmin.reduce(leave, axis=1, initial=1.0)
    return np.column_stack([first, last])


_SLANT = np.radians(30.0)
"""Slant of both planes of a lighthouse to the vertical axis about which they sweep; that of
version 2 [rad]."""


def sense_fixes(history: History, params: SensingParams) -> Reals:
    """Measure coordinates of centers.

    Returns:
        Rows of (robot, stance, direction (3), value, standard deviation, source), shape (F, 8). The
        source is a place in `params.sources`, or -1.
    """
    rows, lookouts = [_seeds(history, params)], find_lookouts(history, params)
    views = [lookouts.toward(np.array(beacon)) for beacon in params.beacons]
    seen = [in_sight(history, view) for view in views]
    if params.beacon_kind == "sweep":
        for number, is_seen in enumerate(seen):
            rows += _planes(history.seed, lookouts.select(is_seen), number, params)
    elif seen:
        rows += _coordinates(history.seed, lookouts.select(np.any(seen, axis=0)), params)
    return np.concatenate(rows)


def _seeds(history: History, params: SensingParams) -> Reals:
    """Measure the final centers of the first robots but the anchor, which is known."""
    robot = np.repeat(np.arange(1, min(params.seed_robots, history.robot_count)), 3)
    axis = np.arange(len(robot)) % 3
    last = np.array([walk.stance_count for walk in history.walks])[robot] - 1
    error = params.fix_noise * normal(history.seed, "seed robot", robot, axis)
    known = np.tile([params.fix_noise, NO_SOURCE], (len(robot), 1))
    return np.column_stack(
        [robot, last, np.eye(3)[axis], history.position[robot, axis] + error, known]
    )


def _coordinates(seed: int, lookouts: Lookouts, params: SensingParams) -> Iterator[Reals]:
    """Measure x and y."""
    robot, stance, center, _ = lookouts
    known = np.tile([params.fix_noise, NO_SOURCE], (len(robot), 1))
    for axis in (0, 1):
        error = params.fix_noise * normal(seed, "fix", robot, 2 * stance + axis)
        direction = np.tile(np.eye(3)[axis], (len(robot), 1))
        yield np.column_stack([robot, stance, direction, center[:, axis] + error, known])


def _planes(seed: int, lookouts: Lookouts, number: int, params: SensingParams) -> Iterator[Reals]:
    """Measure two planes through a lighthouse and the center, which sweep about a vertical axis.

    A plane whose normal is (cos t cos f, cos t sin f, +-sin t), with slant t, meets the center at
    the angle f where the normal is perpendicular to the way there. Centers steeper above or below
    the lighthouse than 90 deg - t are never met.
    """
    station = np.array(params.beacons[number])
    way = lookouts.center - station
    rise, level = np.tan(_SLANT) * way[:, 2], np.hypot(way[:, 0], way[:, 1])
    is_met = np.abs(rise) < level
    robot, stance, _, _ = lookouts.select(is_met)
    bearing, slope = np.arctan2(way[:, 1], way[:, 0])[is_met], rise[is_met] / level[is_met]
    for plane, sign in enumerate((1.0, -1.0)):
        angle = bearing + np.arccos(-sign * slope)
        part = np.column_stack([np.cos(angle), np.sin(angle), np.full(len(robot), sign)])
        direction = part * [np.cos(_SLANT), np.cos(_SLANT), np.sin(_SLANT)]
        draw = 2 * (64 * stance + number) + plane
        error = params.fix_noise * normal(seed, "sweep", robot, draw)
        error += params.fix_bias * normal(seed, "beacon", number, plane)
        source = 2 * number + plane if params.fix_bias else NO_SOURCE
        known = np.tile([params.fix_noise, source], (len(robot), 1))
        yield np.column_stack([robot, stance, direction, direction @ station + error, known])


def sense_ranges(history: History, params: SensingParams) -> Reals:
    """Measure the distance of centers to that of earlier robots within reach and in sight.

    Returns:
        Rows of (robot, stance, other robot, distance, standard deviation, source), shape (D, 6).
        The source is a place in `params.sources`, or -1. An error that makes a distance negative
        leaves no row.
    """
    if params.range_reach is None:
        return np.empty((0, 6))
    lookouts = find_lookouts(history, params)
    here, there = cKDTree(lookouts.center), cKDTree(history.position)
    pairs = here.sparse_distance_matrix(there, params.range_reach, output_type="ndarray")
    place, other = pairs["i"], pairs["j"]
    is_earlier = other < lookouts.robot[place]
    place, other = place[is_earlier], other[is_earlier]
    robot, stance, center, joined = (column[place] for column in lookouts)
    views = Views(center, history.position[other], joined, robot, other)
    seen = in_sight(history, views)
    length = np.linalg.norm(views.end - center, axis=1)
    length += params.range_noise * normal(history.seed, "range", robot, (stance << 31) + other)
    length += params.range_bias * normal(history.seed, "ranges", 0, 0)
    source = len(params.sources) - 1 if params.range_bias else -1  # the last one
    known = np.tile([params.range_noise, source], (len(robot), 1))
    every = np.column_stack([robot, stance, other, length, known])
    rows: Reals = every[seen & (length > 0.0)]
    return rows


def sense_directions(history: History, params: SensingParams) -> Reals:
    """Measure where the other dock of each true contact lies, as seen from the own dock.

    Returns:
        Rows of (robot, stance, own dock, other robot, other dock, unit vector in the own body
        frame (3)), shape (U, 8).
    """
    if params.direction_noise_deg is None:
        return np.empty((0, 8))
    contacts = history.table("contacts")
    _, _, own, other, dock = contacts.T
    body, place = history.robot.dock_offset_body, _place(history, contacts)
    center = np.concatenate([walk.center for walk in history.walks])[place]
    way = history.position[other] + _turn(history.orientation_wxyz[other]).apply(body[dock])
    way = _own_turn(history, place).inv().apply(way - center) - body[own]
    way = _error(history, "direction", params.direction_noise_deg).apply(way)
    return np.column_stack([contacts, way / np.linalg.norm(way, axis=1, keepdims=True)])


def sense_connections(history: History, params: SensingParams) -> Reals:
    """Measure the orientation of the other robot of each true contact.

    Returns:
        Rows of (robot, stance, own dock, other robot, other dock, unit quaternion from the other
        body to the own (4)), shape (Q, 9).
    """
    if params.connection_noise_deg is None:
        return np.empty((0, 9))
    contacts = history.table("contacts")
    other = _turn(history.orientation_wxyz[contacts[:, 3]])
    turn = _own_turn(history, _place(history, contacts)).inv() * other
    turn = _error(history, "connection", params.connection_noise_deg) * turn
    return np.column_stack([contacts, turn.as_quat(canonical=True, scalar_first=True)])


def _turn(wxyz: Reals) -> Rotation:
    return Rotation.from_quat(wxyz, scalar_first=True)


def _place(history: History, contacts: AnyInts) -> Ints:
    """Place of each contact's stance among all stances."""
    length = [walk.stance_count for walk in history.walks]
    return np.asarray(np.cumsum([0, *length])[contacts[:, 0]] + contacts[:, 1])


def _own_turn(history: History, place: Ints) -> Rotation:
    return _turn(np.concatenate([walk.orientation_wxyz for walk in history.walks])[place])


def _error(history: History, stream: str, sd_deg: float) -> Rotation:
    """Draw a small turn for each contact, with the same deviation about every axis."""
    count = [len(walk.contacts) for walk in history.walks]
    robot = np.repeat(np.arange(history.robot_count), count)
    draw = 3 * np.concatenate([np.arange(n) for n in count])[:, None] + np.arange(3)
    turn = np.radians(sd_deg) * normal(history.seed, stream, robot[:, None], draw)
    return Rotation.from_rotvec(turn)


def named_contacts(
    history: History, contacts: NDArray[np.int32], params: Vibration
) -> NDArray[np.int32]:
    """Name the robots in contact by their vibrations: leave out some contacts, and rename others.

    A robot that vibrates senses nothing, so it never learns the name of a neighbor of its own slot.
    Where several robots in reach vibrate in one slot, it may take another one for the neighbor.
    A vibration says which dock it comes from, by its place in the slot.

    Args:
        history: True history of the whole structure.
        contacts: Contacts, rows of (robot, stance, own dock, other robot, other dock), (K, 5).
        params: Slots, and how far vibrations are sensed.

    Returns:
        Sensed contacts of the same form, sorted and unique.
    """
    if not len(contacts):
        return contacts
    robot, _, _, other, _ = contacts.T.astype(np.int64)
    # A number for each contact; other measurements do not change it.
    docks, robots = len(history.robot.dock_offset_body), history.robot_count
    shape = (int(contacts[:, 1].max(initial=0)) + 1, docks, robots, docks)
    number = np.ravel_multi_index(tuple(contacts[:, 1:].T), shape)
    slot, left = params.slots, history.left_after
    is_sensed = uniform(history.seed, "missed vibration", robot, number) >= params.missed
    is_sensed &= robot % slot != other % slot
    draw, named = uniform(history.seed, "vibration", robot, number), contacts.copy()
    near = _neighbors(history)
    _, begins = np.unique(contacts[:, :2], axis=0, return_index=True)
    for rows in np.split(np.arange(len(contacts)), begins[1:]):  # of each stance
        i, touched = int(robot[rows[0]]), set(other[rows].tolist())
        hops = _heard(near, touched, params.hearing, i, left)
        for row in rows[is_sensed[rows]].tolist():
            rivals = sorted(each for each in hops if each % slot == other[row] % slot)
            strength = np.cumsum([params.fading ** (hops[each] - 1) for each in rivals])
            place = np.searchsorted(strength, draw[row] * strength[-1], "right")
            named[row, 3] = rivals[int(place)]
    found: NDArray[np.int32] = np.unique(named[is_sensed], axis=0)
    return found


def _neighbors(history: History) -> list[list[int]]:
    """List the robots that each robot of a structure touched as they joined."""
    near: list[list[int]] = [[] for _ in range(history.robot_count)]
    for i, j in history.contacts_at_join[:, ::2].tolist():
        near[i].append(j)
        near[j].append(i)
    return near


def _heard(
    near: list[list[int]], touched: set[int], reach: int, robot: int, left: Ints
) -> dict[int, int]:
    """Count the contacts from a robot to each earlier robot within reach, breadth first.

    Args:
        near: Robots that each robot touches.
        touched: Robots that the robot touches.
        reach: Most contacts that a vibration passes.
        robot: The robot.
        left: Robots that had joined when each left, shape (N,).
    """
    hops = dict.fromkeys(touched, 1)
    edge = touched
    for count in range(2, reach + 1):
        edge = {k for j in edge for k in near[j] if k < robot < left[k]} - hops.keys()
        hops |= dict.fromkeys(edge, count)
    return hops
