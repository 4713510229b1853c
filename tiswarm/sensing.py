"""Turns the true history of a structure into the noisy log that localizers read."""

from dataclasses import asdict, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass
from scipy.spatial.transform import Rotation

from tiswarm.aliases import Ints, Reals
from tiswarm.compute.math import dock_offsets, normal, uniform
from tiswarm.params import STRICT
from tiswarm.records.sensing_log import Angle, Fraction, SensingLog, SensingNoise, Stances
from tiswarm.world.history import History

_PLANE_SD = 0.01
"""Standard deviation of the plane that a planar robot is in [R]."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SensingParams:
    """Noise of the robots' senses; none by default, as in the paper.

    Each contact of each stance has its own random draw. Gravity gives planar robots their whole
    orientation: it has the noise of tilt about the normal of the plane, and no noise of yaw.
    """

    tilt_noise_deg: Annotated[Angle, Field(le=90.0)] = 0.0
    """Standard deviation of the sensed orientation about each horizontal axis, with a new draw at
    each stance [deg]."""

    yaw_noise_deg: Angle = 0.0
    """Standard deviation of the sensed orientation about the vertical, with a new draw at each
    stance [deg]."""

    yaw_bias_deg: Angle = 0.0
    """Standard deviation of a further turn about the vertical, with one draw a robot [deg]."""

    spawn_noise: Annotated[float, Field(ge=0.0, le=1e9)] | None = None
    """Standard deviation of each coordinate of the sensed spawn position [R]; if null, robots do
    not sense where they spawn."""

    missed_contacts: Fraction = 0.0
    """Fraction of contacts that are not sensed [1]."""

    wrong_docks: Fraction = 0.0
    """Fraction of contacts sensed at the wrong dock of the right neighbor [1]."""

    false_contacts: Fraction = 0.0
    """Sensed contacts that do not exist, with a random dock of a random earlier robot, per true
    contact [1]."""

    @property
    def noise(self) -> SensingNoise:
        """Noise as the header of a log states it."""
        return SensingNoise(**{key.replace("_noise", ""): sd for key, sd in asdict(self).items()})


def observe(history: History, params: SensingParams) -> SensingLog:
    """Sense the whole walk of every robot in a structure.

    A random draw depends on the seed of the history, the robot, and the stance or contact only.
    The only positions of the log are the anchor's and, with `spawn_noise`, the spawns'.

    >>> from tiswarm.robot import RobotGeometry
    >>> from tiswarm.world.growth import grow
    >>> from tiswarm.world.params import TowerParams
    >>> [history] = grow(TowerParams(), robots=3, seeds=[0], robot=RobotGeometry())
    >>> log = observe(history, SensingParams(tilt_noise_deg=1.0))
    >>> log.robot_count, log.noise.tilt_deg
    (3, 1.0)
    """
    if history.is_planar:
        params = replace(params, yaw_noise_deg=0.0, yaw_bias_deg=0.0)
    length = np.array([walk.stance_count for walk in history.walks])
    end = np.cumsum(length)
    sensed = _sensed_orientation(history, length, params)
    contacts = _sensed_contacts(history, params)
    at_rest = contacts[:, 1] == length[contacts[:, 0]] - 1
    return SensingLog(
        robot_id=np.arange(history.robot_count),
        dock_radius=history.robot.dock_radius,
        dock_offset_body=history.robot.dock_offset_body,
        anchor_position=history.walks[0].center[-1],
        orientation_wxyz=sensed[end - 1],
        contacts=np.ascontiguousarray(contacts[at_rest][:, [3, 4, 0, 2]]),
        ground_z=history.ground_z,
        ground_docks=history.ground_docks,
        fixes=_planes(history),
        flip_height=_flip_height(history, sensed, end),
        spawn_position=_spawn_position(history, params),
        stances=_stances(history, sensed, length, contacts[~at_rest]),
        noise=params.noise,
    )


def _sensed_orientation(history: History, length: Ints, params: SensingParams) -> Reals:
    """Return the orientation sensed at each stance of each robot, shape (all stances, 4)."""
    true = np.concatenate([walk.orientation_wxyz for walk in history.walks])
    if params.tilt_noise_deg == params.yaw_noise_deg == params.yaw_bias_deg == 0.0:
        return true
    robot = np.repeat(np.arange(len(length)), length)
    stance = np.concatenate([np.arange(count) for count in length])
    draw = 3 * stance[:, None] + np.arange(3)
    sd = np.radians([params.tilt_noise_deg, params.tilt_noise_deg, params.yaw_noise_deg])
    sd[0] *= not history.is_planar
    turn = sd * normal(history.seed, "orientation", robot[:, None], draw)
    bias = np.zeros_like(turn)
    bias[:, 2] = np.radians(params.yaw_bias_deg) * normal(history.seed, "yaw bias", robot, 0)
    turned = Rotation.from_rotvec(bias) * Rotation.from_rotvec(turn)
    sensed = turned * Rotation.from_quat(true, scalar_first=True)
    return sensed.as_quat(canonical=True, scalar_first=True)


def _sensed_contacts(history: History, params: SensingParams) -> NDArray[np.int32]:
    """Return the contacts sensed at all stances, sorted and unique, shape (K, 5).

    A row is (robot, stance, own dock, other robot, other dock).
    """
    true = history.table("contacts")
    if params.missed_contacts == params.wrong_docks == params.false_contacts == 0.0:
        return true
    robot = true[:, 0]
    place = np.concatenate([np.arange(len(walk.contacts)) for walk in history.walks])

    def draw(stream: str, which: int) -> Reals:
        return uniform(history.seed, stream, robot, 4 * place + which)

    docks = len(history.robot.dock_offset_body)
    false = true.copy()
    false[:, 2] = draw("false contact", 1) * docks
    false[:, 3] = draw("false contact", 2) * robot
    false[:, 4] = draw("false contact", 3) * docks
    false = false[draw("false contact", 0) < params.false_contacts]
    is_wrong = draw("wrong dock", 0) < params.wrong_docks
    turned = 1 + (draw("wrong dock", 1) * (docks - 1)).astype(np.int32)
    sensed = true.copy()
    sensed[is_wrong, 4] = (sensed[:, 4] + turned)[is_wrong] % docks
    sensed = sensed[draw("missed contact", 0) >= params.missed_contacts]
    rows: NDArray[np.int32] = np.unique(np.concatenate([sensed, false]), axis=0)
    return rows


def _spawn_position(history: History, params: SensingParams) -> Reals:
    """Return each robot's sensed spawn position [R], shape (N, 3); NaN without `spawn_noise`."""
    true = np.array([walk.center[0] for walk in history.walks])
    if params.spawn_noise is None:
        return np.full_like(true, np.nan)
    robot = np.arange(history.robot_count)[:, None]
    return true + params.spawn_noise * normal(history.seed, "spawn position", robot, np.arange(3))


def _planes(history: History) -> Reals:
    """Return y = 0 as a fix of each planar robot, rows as in `SensingLog.fixes`."""
    robot = np.arange(history.robot_count if history.is_planar else 0)
    return np.column_stack([robot, np.tile([0.0, 1.0, 0.0, 0.0, _PLANE_SD], (len(robot), 1))])


def _flip_height(history: History, sensed: Reals, end: Ints) -> Reals:
    """Return the height of each robot's center that its own flips imply, shape (N,).

    A robot starts on the ground, with its center above the docks that stand there. A flip about the
    dock at b moves its center by (R - R') b, where R and R' are the orientations sensed before and
    after. NaN for a robot that starts without a dock on the ground.
    """
    dock_height = dock_offsets(sensed, history.robot.dock_offset_body)[:, :, 2]
    height = np.full(len(end), history.ground_z + history.robot.dock_radius)
    for j, walk in enumerate(history.walks):
        rows = dock_height[end[j] - walk.stance_count : end[j]]
        standing = walk.ground_docks[walk.ground_docks[:, 0] == 0, 1]
        height[j] -= rows[0, standing].mean() if len(standing) else np.nan
        step = np.arange(walk.stance_count - 1)
        height[j] += np.sum(rows[step, walk.pivot_dock] - rows[step + 1, walk.pivot_dock])
    return height


def _stances(history: History, sensed: Reals, length: Ints, contacts: NDArray[np.int32]) -> Stances:
    """Gather every stance except each robot's last; `contacts` are those of these stances."""
    start = np.concatenate([[0], np.cumsum(length - 1)])
    ground = history.table("ground_docks")
    return Stances(
        start=start,
        orientation_wxyz=np.delete(sensed, np.cumsum(length) - 1, axis=0),
        pivot_dock=np.concatenate([walk.pivot_dock for walk in history.walks]),
        contacts=_numbered(contacts, start),
        ground_docks=_numbered(ground[ground[:, 1] < length[ground[:, 0]] - 1], start),
    )


def _numbered(rows: NDArray[np.int32], start: Ints) -> NDArray[np.int32]:
    """Replace (robot, stance) at the start of each row by the stance's index in the log."""
    stance = (start[rows[:, 0]] + rows[:, 1]).astype(np.int32)
    return np.column_stack([stance, rows[:, 2:]])
