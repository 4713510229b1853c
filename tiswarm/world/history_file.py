"""Histories as arrays, as files of these, and the faults that one may have."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import astuple, fields, replace
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tiswarm.base.errors import InputError
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.math import dock_offsets
from tiswarm.records.io import DAMAGED, replacing, run_file
from tiswarm.world.history import DIED, LEFT, History, Walk
from tiswarm.world.mechanics import MAX_UNBORNE, LoadSummary
from tiswarm.world.params import StructureParams, structure_ground
from tiswarm.world.rest import Stability

_SINGLE = ("recruited", "round")
"""Fields of a walk that are one value each; the others are arrays."""

_TABLES = tuple(field.name for field in fields(Walk) if field.name not in _SINGLE)
_LATER = ("departures", "departure_round", "sent", "broken", "loaded_contacts", "contact_load")
"""Tables of a structure that are not written where they are empty."""

_FACTS = ("seed", "spawns", "crossed", "ended")
_LATER_FACTS = ("stability",)
"""Facts of a structure that are not written where they are empty."""

_FARTHEST = 1e9
"""Largest coordinate of a center that is read [R]; mechanics of such a structure have no digits."""

LARGEST_SEED = 2**63 - 1
"""Largest seed of a structure."""

_NOT_UNIT = 1e-6
"""Largest difference from 1 of the length of a quaternion that is read."""

_MAX_OVERLAP = 1e-9
"""Deepest overlap that rounding may leave [R]."""


def write_history(history: History, path: Path) -> None:
    """Write a structure of at least one robot as `.npz`.

    Raises:
        EnvironmentTroubleError: it cannot be written.
    """
    arrays: dict[str, Any] = to_arrays(history)
    with replacing(path) as file:
        np.savez(file, **arrays)


def read_history(path: Path, params: StructureParams, robot: RobotGeometry) -> History | None:
    """Read a structure that was grown by these settings; None where it is missing or damaged."""
    try:
        with run_file(path).open("rb") as file, np.load(file) as tables:
            history = from_arrays(dict(tables), params, robot)
    except (InputError, *DAMAGED):
        return None
    if find_fault(history, contact_gap=params.climb.contact_gap):
        return None
    return history


def to_arrays(history: History) -> dict[str, NDArray[Any]]:
    """Convert a structure of at least one robot to arrays, which `from_arrays` reads back."""
    facts = {name: getattr(history, name) for name in _FACTS}
    facts |= {name: getattr(history, name) for name in _LATER_FACTS if getattr(history, name)}
    arrays: dict[str, NDArray[Any]] = {
        "facts": np.array(json.dumps(facts)),
        "sensed": history.sensed,
        "strain": np.array([astuple(load) for load in history.loads]),
    }
    for name in _SINGLE:
        arrays[name] = np.array([getattr(walk, name) for walk in history.walks])
    for name in _TABLES:
        rows = [getattr(walk, name) for walk in history.walks]
        arrays[name] = np.concatenate(rows)
        arrays[f"{name}_end"] = np.cumsum([len(of_walk) for of_walk in rows])
    for name in _LATER:
        if len(getattr(history, name)):
            arrays[name] = getattr(history, name)
    return arrays


def from_arrays(
    arrays: Mapping[str, NDArray[Any]], params: StructureParams, robot: RobotGeometry
) -> History:
    """Build a structure that was grown by these settings from its arrays.

    Types, shapes, indices and finiteness are checked here, once; whether robots stand where they
    can stand is up to `find_fault`.

    Raises:
        LookupError, TypeError, ValueError: the arrays are damaged.
    """
    geometry = params.robot(robot)
    columns = {name: _column(arrays, name) for name in (*_SINGLE, *_TABLES)}
    robots = len(columns["round"])
    _require(robots > 0 and len(columns["recruited"]) == robots, "a walk for each robot")
    _require((columns["round"] >= 0).all(), "rounds from 0")
    fields_of: dict[str, list[Any]] = {name: columns[name].tolist() for name in _SINGLE}
    for name in _TABLES:
        end = _array(arrays[f"{name}_end"], "i", 0)
        total = np.diff(end, prepend=0)
        _require(len(end) == robots and (total >= 0).all(), f"rows of {name} by robot")
        _require(int(end[-1]) == len(columns[name]), f"all rows of {name}")
        fields_of[name] = np.split(columns[name], end[:-1])
    rows = zip(*fields_of.values(), strict=True)
    walks = [Walk(**dict(zip(fields_of, row, strict=True))) for row in rows]
    for number, walk in enumerate(walks):
        _check_walk(walk, number, robots=robots, docks=geometry.dock_count)
    strain = _array(arrays["strain"], "f", len(fields(LoadSummary)))
    _require(len(strain) == robots, "loads after each join")
    loads = [LoadSummary(*row) for row in strain.tolist()]
    sensed = _array(arrays["sensed"], "f", 0)
    _require(len(sensed) <= robots, "loads that robots sense")
    departures = _array(arrays.get("departures", np.empty((0, 3), np.int32)), "i", 3)
    robot_of, joined, event = departures.T
    _require_within(robot_of, 0, robots, "departures")
    _require_within(joined, 1, robots + 1, "departures")
    _require_within(event, LEFT, DIED + 1, "departures")
    departure_round = _array(arrays.get("departure_round", np.empty(0, np.int32)), "i", 0)
    _require(len(departure_round) in {0, len(departures)}, "a round of each departure")
    _require((departure_round >= 0).all(), "rounds of departures from 0")
    sent = _array(arrays.get("sent", np.empty(0, np.int32)), "i", 0)
    _require(len(sent) in {0, robots} and (sent >= 0).all(), "bytes that robots sent")
    broken = _array(arrays.get("broken", np.empty((0, 5), np.int32)), "i", 5)
    _check_contacts(broken[:, :4], robots, geometry.dock_count, "broken")
    _require_within(broken[:, 4], 1, robots + 1, "broken")
    loaded = _array(arrays.get("loaded_contacts", np.empty((0, 4), np.int32)), "i", 4)
    _check_contacts(loaded, robots, geometry.dock_count, "loaded_contacts")
    contact_load = _array(arrays.get("contact_load", np.empty((0, 6))), "f", 6)
    _require(len(contact_load) == len(loaded), "loads of contacts")
    return History(
        **_facts(str(arrays["facts"])),
        robot=geometry,
        terrain=structure_ground(params),
        anchors=params.anchor_count,
        walks=tuple(walks),
        loads=tuple(replace(load, calling=int(load.calling)) for load in loads),
        sensed=sensed,
        departures=departures,
        departure_round=departure_round,
        may_lose=params.may_lose,
        sent=sent.astype(np.int64),
        broken=broken,
        loaded_contacts=loaded,
        contact_load=contact_load,
    )


def _check_contacts(contacts: NDArray[np.int32], robots: int, docks: int, what: str) -> None:
    """Refuse rows of (robot, dock, robot, dock) with robots or docks that are not there.

    Raises:
        ValueError: there are some.
    """
    robot_a, dock_a, robot_b, dock_b = contacts.T
    _require_within(robot_a, 0, robots, what)
    _require_within(dock_a, 0, docks, what)
    _require_within(robot_b, -1, robots, what)
    _require_within(dock_b, -1, docks, what)
    _require(((robot_b < 0) == (dock_b < 0)).all(), what)


class _Layout(NamedTuple):
    """What the array of a field of all walks is."""

    kind: str  # b, i or f, as NumPy calls truth values, whole numbers and others
    width: int  # numbers in a row; 0 where a row is a number


_LAYOUTS = {
    "recruited": _Layout("b", 0),
    "round": _Layout("i", 0),
    "center": _Layout("f", 3),
    "orientation_wxyz": _Layout("f", 4),
    "pivot_dock": _Layout("i", 0),
    "contacts": _Layout("i", 4),
    "ground_docks": _Layout("i", 2),
    "edge_docks": _Layout("i", 2),
    "planned_robot": _Layout("i", 0),
    "failed_flips": _Layout("i", 0),
    "belief": _Layout("f", 0),
}

_LARGEST = 1e100
"""No number of a structure comes near it; squares of larger ones would overflow."""

_BELIEFS = 5
"""Numbers that a walk's `belief` has, unless it is empty."""


def _column(arrays: Mapping[str, NDArray[Any]], name: str) -> NDArray[Any]:
    return _array(arrays[name], *_LAYOUTS[name])


def _array(array: NDArray[Any], kind: str, width: int) -> NDArray[Any]:
    """Return an array of numbers of some kind in rows of some width, as growth would have it."""
    row_shape = (width,) if width else ()
    is_rows = array.ndim > 0 and array.shape[1:] == row_shape
    _require(array.dtype.kind == kind and is_rows, "types and shapes")
    if kind == "b":
        return array.astype(np.bool_)
    if kind == "f":
        numbers = array.astype(np.float64)
        _require((np.isnan(numbers) | (np.abs(numbers) < _LARGEST)).all(), "numbers within range")
        return numbers
    _require((np.abs(array.astype(np.float64)) < 2.0**31).all(), "whole numbers of 32 bits")
    return array.astype(np.int32)


def _facts(text: str) -> dict[str, Any]:
    """Read the facts of a structure that are no arrays."""
    facts: dict[str, Any] = json.loads(text)
    _require(isinstance(facts, dict) and {*facts} - {*_LATER_FACTS} == {*_FACTS}, "facts")
    for name in ("seed", "spawns"):
        number = facts[name]
        _require(type(number) is int and 0 <= number <= LARGEST_SEED, name)
    _require(isinstance(facts["crossed"], bool) and isinstance(facts["ended"], str), "facts")
    _require(facts.get("stability", "stands") in get_args(Stability), "facts")
    return facts


def _check_walk(walk: Walk, number: int, *, robots: int, docks: int) -> None:
    """Refuse a walk whose numbers cannot be those of robot `number`.

    Raises:
        ValueError: they cannot.
    """
    stances = walk.stance_count
    _require(stances > 0 and len(walk.orientation_wxyz) == stances, "poses of each stance")
    _require((np.abs(walk.center) <= _FARTHEST).all(), "centers")  # also false of NaN
    length = np.linalg.norm(walk.orientation_wxyz, axis=1)
    _require((np.abs(length - 1.0) <= _NOT_UNIT).all(), "unit quaternions")
    _require(len(walk.pivot_dock) == stances - 1, "a pivot of each flip")
    _require_within(walk.pivot_dock, 0, docks, "pivot_dock")
    for name, limits in (
        ("contacts", (stances, docks, number, docks)),
        ("ground_docks", (stances, docks)),
        ("edge_docks", (stances, docks)),
    ):
        for column, limit in zip(getattr(walk, name).T, limits, strict=True):
            _require_within(column, 0, limit, name)
    _require_within(walk.planned_robot, -1, robots, "planned_robot")
    _require(len(walk.planned_robot) < stances, "planned_robot")
    _require((walk.failed_flips >= 0).all() and len(walk.failed_flips) <= stances, "failed_flips")
    _require(len(walk.belief) in {0, _BELIEFS}, "belief")


def _require_within(numbers: NDArray[Any], least: int, end: int, what: str) -> None:
    _require(((numbers >= least) & (numbers < end)).all(), what)


def _require(is_right: object, what: str) -> None:
    if not is_right:
        raise ValueError(f"damaged: {what}")


def find_fault(history: History, *, contact_gap: float) -> str:
    """Find what is wrong with a structure.

    Args:
        history: The structure as it grew.
        contact_gap: Docks closer than this count as touching [R].

    Returns:
        The first fault, or an empty string where there is none.
    """
    return next(_faults(history, contact_gap), "")


def _faults(history: History, contact_gap: float) -> Iterator[str]:
    robot = history.robot
    contacts = history.contacts
    stays = ~history.is_gone
    turned = dock_offsets(history.orientation_wxyz, robot.dock_offset_body)
    docks = history.position[:, None, :] + turned
    dock = docks.reshape(-1, 3)
    count = robot.dock_count

    pairs = cKDTree(dock).query_pairs(robot.spacing - _MAX_OVERLAP, output_type="ndarray")
    pairs = pairs[pairs[:, 0] // count != pairs[:, 1] // count]
    pairs = pairs[stays[pairs // count].all(axis=1)]
    if len(pairs):
        depth = robot.spacing - np.linalg.norm(dock[pairs[:, 0]] - dock[pairs[:, 1]], axis=1)
        worst = int(np.argmax(depth))
        i, j = pairs[worst] // count
        yield f"robots {i} and {j} overlap by {depth[worst]:.3g} R"

    depth = history.terrain.depth(dock, robot.dock_radius)
    if not depth.max() <= _MAX_OVERLAP:
        yield f"robot {np.argmax(depth) // count} is {depth.max():.3g} R deep in the ground"

    i, a, j, b = contacts.T
    distance = np.linalg.norm(docks[i, a] - docks[j, b], axis=1)
    for k in np.flatnonzero(distance > robot.spacing + contact_gap):
        yield f"robots {i[k]} and {j[k]} are in contact {distance[k]:.3g} R apart"

    joined = history.is_held | ~stays
    if not joined.all():
        yield f"robot {np.argmin(joined)} touches neither an earlier robot nor the ground"

    imbalance = max((load.imbalance for load in history.loads), default=0.0)
    if imbalance > MAX_UNBORNE:
        yield f"weight and ground forces differ by {imbalance:.3g} of the weight"
