"""Structures to try localizers on: grown ones, and ones that no robot of this project would build.

For the latter, robots with any number of docks are put down one by one, so that one dock touches
a dock that is there, and turn about it until another one touches. Lengths in R.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import AnyInts
from tiswarm.base.registry import BUILT_IN, get
from tiswarm.base.robot import RobotGeometry
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import SensingParams
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.params import StructureParams

SUITES = {name: get("sensor", name) for name in BUILT_IN["sensor"]}
"""Every sensor suite of the package by its name."""

NOISY = SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0)
"""Senses with the usual noise of orientation."""

SPACING = 2.0
GAP = 1e-3
"""Docks this much farther apart still touch."""
TRIES = 400
ANGLES = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)[1:]


def grown(params: StructureParams, *, robots: int, seed: int) -> History:
    """Grow one structure of FireAntV3 robots."""
    [history] = grow(params, robots=robots, seeds=[seed], robot=RobotGeometry())
    return history


@dataclass(frozen=True, kw_only=True)
class Rule:
    """How robots are put down."""

    kind: str = "tree"
    """tree: one contact each; loops: two; ball: two, near the anchor; chain: on the last robot."""

    docks: int = 3
    offset: float = 1.506
    """Center to dock."""

    untied: float = 0.0
    """Share of the robots whose contacts with earlier ones are not in the log."""

    missed: float = 0.0
    """Share of the contacts that are not in the log."""

    wrong: float = 0.0
    """Share of the contacts that name another robot."""


def structure(rule: Rule, robots: int, seed: int) -> tuple[SensingLog, NDArray[np.float64]]:
    """Put down robots without overlap.

    Returns:
        What they sensed, without noise, and their true centers, shape (N, 3).
    """
    rng = np.random.default_rng(seed)
    body = docks_around(rule.docks, rule.offset)
    turns, centers = [Rotation.random(random_state=rng)], [np.zeros(3)]
    taken = turns[0].apply(body)
    for robot in range(1, robots):
        for attempt in range(TRIES):
            # Where there is no room left robots stand anywhere, held by one contact.
            kind = rule.kind if attempt < TRIES // 4 else "tree"
            target, own = _target(kind, rng, taken, rule.docks), int(rng.integers(rule.docks))
            pivot, turn = (
                taken[target] + SPACING * _direction(rng),
                Rotation.random(random_state=rng),
            )
            if kind in {"loops", "ball"} and rule.docks > 1:
                about, arm = _direction(rng), turn.apply(body)
                angle = _first_touch(taken, pivot, arm - arm[own], about)
                if angle is None:
                    continue
                turn = Rotation.from_rotvec(angle * about) * turn
            center = pivot - turn.apply(body[own])
            docks = center + turn.apply(body)
            if cKDTree(taken).query(docks)[0].min() > SPACING - 1e-9:
                break
        else:
            message = f"no room for robot {robot}"
            raise AssertionError(message)
        turns.append(turn)
        centers.append(center)
        taken = np.concatenate([taken, docks])
    truth = np.array(centers)
    return _log(rule, rng, truth, Rotation.concatenate(turns), body, taken), truth


def docks_around(docks: int, offset: float) -> NDArray[np.float64]:
    """Docks evenly around the center; from four on, over a sphere."""
    if docks <= 3:
        angle = 2.0 * np.pi * np.arange(docks) / docks
        return offset * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    k = np.arange(docks) + 0.5
    z, angle = 1.0 - 2.0 * k / docks, np.pi * (1.0 + 5.0**0.5) * k
    level = np.sqrt(1.0 - z**2)
    return offset * np.column_stack([level * np.cos(angle), level * np.sin(angle), z])


def _direction(rng: np.random.Generator) -> NDArray[np.float64]:
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def _target(kind: str, rng: np.random.Generator, taken: NDArray[np.float64], docks: int) -> int:
    if kind == "chain":
        return len(taken) - 1 - int(rng.integers(docks))
    if kind == "ball":
        away = np.linalg.norm(taken, axis=1)
        return int((away + rng.exponential(0.2 * away.max(), len(taken))).argmin())
    return int(rng.integers(len(taken)))


def _first_touch(
    taken: NDArray[np.float64],
    pivot: NDArray[np.float64],
    arm: NDArray[np.float64],
    about: NDArray[np.float64],
) -> float | None:
    """Angle by which a robot turns about its pivot dock until another dock touches one."""
    far = SPACING + np.linalg.norm(arm, axis=1).max()
    close = taken[np.linalg.norm(taken - pivot, axis=1) < far]
    swinging = arm[np.linalg.norm(arm, axis=1) > GAP]

    def clearance(angle: float) -> float:
        docks = pivot + Rotation.from_rotvec(angle * about).apply(swinging)
        return float(np.linalg.norm(docks[:, None] - close, axis=2).min() - SPACING)

    if clearance(0.0) < 0.0:
        return None
    last = 0.0
    for angle in ANGLES.tolist():
        if clearance(angle) < 0.0:
            low, high = last, angle
            for _ in range(50):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if clearance(middle) >= 0.0 else (low, middle)
            return low
        last = angle
    return None


def _log(
    rule: Rule,
    rng: np.random.Generator,
    center: NDArray[np.float64],
    turn: Rotation,
    body: NDArray[np.float64],
    taken: NDArray[np.float64],
) -> SensingLog:
    robots, docks = len(center), rule.docks
    pair = np.sort(cKDTree(taken).query_pairs(SPACING + GAP, output_type="ndarray"), axis=1)
    pair = pair[pair[:, 0] // docks != pair[:, 1] // docks].reshape(-1, 2)
    pair = pair[np.lexsort(pair.T)]
    pair = pair[rng.random(len(pair)) >= rule.missed]
    is_untied = rng.random(robots) < rule.untied
    pair = pair[~is_untied[pair[:, 1] // docks]]
    is_wrong = (rng.random(len(pair)) < rule.wrong) & (pair[:, 1] // docks > 1)
    other = rng.integers(0, pair[:, 1] // docks * docks)
    pair[:, 0] = np.where(is_wrong, other, pair[:, 0])
    pair = np.unique(pair, axis=0)
    contacts = np.column_stack([pair[:, 0] // docks, pair[:, 0] % docks,
                                pair[:, 1] // docks, pair[:, 1] % docks])  # fmt: skip
    return silent(
        center,
        dock_offset_body=body,
        orientation_wxyz=turn.as_quat(scalar_first=True),
        contacts=contacts,
    )


def silent(place: ArrayLike, **sensed: Any) -> SensingLog:
    """Log robots that sensed nothing but their orientation.

    Args:
        place: True centers [log unit], shape (N, 3); the log knows the first.
        sensed: Other fields of the log.
    """
    place = np.asarray(place, np.float64)
    robots, angle = len(place), 2.0 * np.pi * np.arange(3) / 3.0
    fields: dict[str, Any] = {
        "robot_id": np.arange(robots),
        "dock_radius": 1.0,
        "dock_offset_body": 1.506 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]),
        "anchor_position": place[0].copy(),
        "orientation_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (robots, 1)),
        "contacts": (),
        "ground_docks": np.empty((0, 2), np.int32),
        "flip_height": np.full(robots, np.nan),
        "spawn_position": np.full((robots, 3), np.nan),
        **sensed,
    }
    fields["contacts"] = np.array(fields["contacts"], np.int32).reshape(-1, 4)
    return SensingLog(**fields)


def exact_estimate(log: SensingLog, position: NDArray[np.float64], **known: Any) -> Estimate:
    """Return an estimate without iterations, by default one that knows no uncertainty.

    Args:
        log: Log that the estimate is of.
        position: Estimated centers [log unit], shape (N, 3).
        known: Other fields of the estimate.
    """
    fields: dict[str, Any] = {
        "disconnected": np.zeros(log.robot_count, bool),
        "iteration": np.zeros(1, np.int64),
        "trace": position[None],
        "residual": np.zeros(1),
        **known,
    }
    return Estimate(robot_id=log.robot_id, position=position, **fields)


def with_fixes(
    log: SensingLog, history: History, robots: Iterable[int], *, each: int, sd: float
) -> SensingLog:
    """Add to a log fixes of final centers, along random directions, with random errors."""
    rng = np.random.default_rng(0)
    robot = np.repeat([*robots], each)
    direction = rng.normal(size=(len(robot), 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    value = (direction * history.position[robot]).sum(axis=1) + sd * rng.normal(size=len(robot))
    every = np.ones(len(robot))
    return replace(log, fixes=np.column_stack([robot, direction, value, sd * every, -every]))


def with_ranges(log: SensingLog, history: History, *, reach: float, sd: float) -> SensingLog:
    """Add to a log ranges of all robots within reach of each other, with random errors."""
    rng = np.random.default_rng(0)
    pair = cKDTree(history.position).query_pairs(reach, output_type="ndarray")
    other, robot = np.sort(pair, axis=1)[np.lexsort(np.sort(pair, axis=1).T)].T
    length = np.linalg.norm(history.position[robot] - history.position[other], axis=1)
    length += sd * rng.normal(size=len(robot))
    every = np.ones(len(robot))
    return replace(log, ranges=np.column_stack([robot, other, length, sd * every, -every]))


def with_heights(log: SensingLog, truth: NDArray[np.float64]) -> SensingLog:
    """Add the true height of each robot to a log."""
    return replace(log, flip_height=truth[:, 2].copy())


def with_directions(
    log: SensingLog,
    history: History,
    *,
    sd_deg: float,
    walks: bool = True,
    robots: Iterable[int] | None = None,
) -> SensingLog:
    """Add to a log the directions that some robots measure of all true contacts, with errors."""
    rng = np.random.default_rng([1, history.seed])
    robot, stance, own, other, its = history.table("contacts").T
    at, frame = _poses(history, robot, stance)
    body = history.robot.dock_offset_body
    apart = history.position[other] + _turned(history, other).apply(body[its])
    apart = frame.inv().apply(apart - at - frame.apply(body[own]))
    unit = apart / np.linalg.norm(apart, axis=1, keepdims=True)
    error = np.radians(sd_deg) * rng.normal(size=(len(unit), 3))
    error -= (error * unit).sum(axis=1, keepdims=True) * unit
    unit = Rotation.from_rotvec(error).apply(unit)
    rows = np.column_stack([own, other, its, unit])
    return _with_list(log, history, "directions", rows, walks=walks, robots=robots)


def with_connections(log: SensingLog, history: History, *, sd_deg: float) -> SensingLog:
    """Add to a log the relative orientation at each true final contact, with errors."""
    rng = np.random.default_rng([2, history.seed])
    robot, stance, own, other, its = history.table("contacts").T
    turn = _poses(history, robot, stance)[1].inv() * _turned(history, other)
    error = Rotation.from_rotvec(np.radians(sd_deg) * rng.normal(size=(len(robot), 3)))
    wxyz = (error * turn).as_quat(scalar_first=True)
    rows = np.column_stack([own, other, its, wxyz])
    return _with_list(log, history, "connections", rows, walks=False)


def _with_list(
    log: SensingLog,
    history: History,
    key: str,
    items: NDArray[np.float64],
    *,
    walks: bool,
    robots: Iterable[int] | None = None,
) -> SensingLog:
    """Add items of all true contacts to a list, those of earlier stances if the log has them."""
    robot, stance = history.table("contacts").T[:2]
    at_rest = stance == np.array([walk.stance_count for walk in history.walks])[robot] - 1
    chosen = np.isin(robot, range(log.robot_count) if robots is None else [*robots])
    final = np.column_stack([robot, items])[at_rest & chosen]
    stances = log.stances
    if stances is not None and walks:
        earlier = np.column_stack([stances.start[robot] + stance, items])[~at_rest & chosen]
        stances = replace(stances, **{key: earlier})
    return replace(log, stances=stances, **{key: final})


def _poses(
    history: History, robot: AnyInts, stance: AnyInts
) -> tuple[NDArray[np.float64], Rotation]:
    """Centers and orientations of robots at some of their stances."""
    poses = [
        (history.walks[i].center[k], history.walks[i].orientation_wxyz[k])
        for i, k in zip(robot.tolist(), stance.tolist(), strict=True)
    ]
    center, wxyz = map(np.array, zip(*poses, strict=True))
    return center, Rotation.from_quat(wxyz, scalar_first=True)


def _turned(history: History, robot: AnyInts) -> Rotation:
    return Rotation.from_quat(history.orientation_wxyz[robot], scalar_first=True)
