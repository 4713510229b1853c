"""Where robots believe they are while they build: what the method of the case estimates by then.

A belief may also be the truth with an error of a given kind, which shows what such errors cost.
Growth by itself is physics; this is the only way from an estimate to it. The first robot of each
side of a gap stands alone and is the anchor of its side: robots of a side localize each other, and
nobody knows where the other side is until both meet, unless `structure.anchors` states it. Robots
that climb plan by the orientation that they sense.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.math import dock_offsets, normal
from tiswarm.localization import methods
from tiswarm.measurements.odometry import with_orientations
from tiswarm.records.sensing_file import SensingLogBuilder, lines_of
from tiswarm.records.sensing_format import HeaderLine, RobotLine
from tiswarm.records.sensing_log import SensingLog
from tiswarm.scenario.model import Scenario
from tiswarm.sensing import observe
from tiswarm.sensing.imu import of_shape, sensed_turn
from tiswarm.world.history import History
from tiswarm.world.params import BeliefErrorParams
from tiswarm.world.walks import Belief, Believe, Turn

_DRAWS = 3
"""Numbers of the draw of a robot."""


class _Side:
    """The n robots of a side in join order, and what they have sensed of each other."""

    def __init__(
        self, history: History, robots: Ints, header: HeaderLine, lines: Sequence[RobotLine]
    ) -> None:
        """Choose from the lines of a whole log."""
        founder = int(robots[0])
        self.key = (history.seed, founder)
        self.robots = robots
        anchor = history.walks[founder].center[-1].tolist()
        # What robots sense later may need the newer version.
        self.header = header.model_copy(update={"version": 2, "anchor_position": anchor})
        builder = SensingLogBuilder(self.header, of_some=True)
        for robot in robots.tolist():
            builder.add(lines[robot])
        # Robots go by their numbers in join order, as they would in a log of their own.
        self.log = replace(builder.log(), robot_id=np.arange(len(robots)))


def navigate(settings: Scenario) -> dict[str, Any]:
    """Return the arguments `believe` and `turn` of `tiswarm.world.growth.grow` for a case."""
    error = settings.structure.belief_error
    return {
        "believe": believe_by(settings) if error is None else believe_with(error),
        "turn": _turn_by(settings),
    }


def _turn_by(settings: Scenario) -> Turn:
    """Return how orientations that climbing robots sense are turned, as their log has them.

    A robot that climbs beside others counts as the last of them to join.
    """
    plane = settings.structure.plane
    params = of_shape(settings.sensing, is_planar=plane)

    def turn(seed: int, robot: int, stances: int) -> Reals:
        stance = np.arange(stances)
        turned = sensed_turn(seed, np.full(stances, robot), stance, params, is_planar=plane)
        quaternion: Reals = turned.as_quat(scalar_first=True)
        return quaternion

    return turn


def believe_with(error: BeliefErrorParams) -> Believe:
    """Return beliefs that are the truth plus an error of a kind."""

    def believe(grown: Sequence[History]) -> list[Belief]:
        beliefs: list[Belief] = []
        for history in grown:
            offset = dock_offsets(history.orientation_wxyz, history.robot.dock_offset_body)
            center = history.position + error_of(history, error)
            beliefs.append(Belief((center[:, None] + offset).reshape(-1, 3)))
        return beliefs

    return believe


def error_of(history: History, error: BeliefErrorParams) -> Reals:
    """Draw the errors of the robots of a structure that has grown so far [R], shape (N, 3).

    A robot keeps its draw as the structure grows. Draws of planar robots lead out of their plane,
    too.
    """
    robot = np.arange(history.robot_count)
    size = error.size
    first = _touched_first(history)
    is_anchor = first == robot
    draw = normal(history.seed, "belief error", robot[:, None], np.arange(_DRAWS))
    draw = np.where(is_anchor[:, None], 0.0, draw * size / np.sqrt(3.0))
    if error.kind == "shift":
        way = normal(history.seed, "belief shift", 0, np.arange(_DRAWS))
        draw[~is_anchor] = size * way / np.linalg.norm(way)
    elif error.kind == "turn":
        x, y, _ = (history.position - history.position[founders_of(history)]).T
        sine = np.sin(size)
        cosine_less_1 = np.cos(size) - 1.0  # an error is the turned position less the true one
        draw = np.column_stack(
            [cosine_less_1 * x - sine * y, sine * x + cosine_less_1 * y, 0.0 * x]
        )
    elif error.kind == "adding-up":
        for j in np.flatnonzero(~is_anchor):
            draw[j] += draw[first[j]]
    return draw


def _touched_first(history: History) -> Ints:
    """Return the robot that each one touched first where it stayed; itself if there is none."""
    at_rest = [walk.at_rest(walk.contacts)[:, 1].tolist() for walk in history.walks]
    is_anchor = history.is_anchor
    return np.array([j if is_anchor[j] else [*met, j][0] for j, met in enumerate(at_rest)])


def founders_of(history: History) -> Ints:
    """Return the founder to which the first contact of each robot leads, shape (N,).

    Anchors are in one frame, so they count as one founder.
    """
    founder: list[int] = []
    for j, i in enumerate(_touched_first(history).tolist()):
        if i != j:
            founder.append(founder[i])
        elif j < history.anchors:
            founder.append(0)
        else:
            founder.append(j)
    return np.array(founder)


def believe_by(settings: Scenario) -> Believe:
    """Return how the robots of a case come to know where docks are.

    Robots sense with the noise of the case. Its method places each as it joins, or localizes all
    again after each join. A dock is believed where the estimated center and the sensed orientation
    of its robot put it.
    """
    params = settings.localization
    swarms: dict[tuple[int, int], Any] = {}

    def believe(grown: Sequence[History]) -> list[Belief]:
        logs = [observe(history, settings.sensing) for history in grown]
        structures = [_sides(history, log) for history, log in zip(grown, logs, strict=True)]
        localized = localize([side for sides in structures for side in sides])
        beliefs: list[Belief] = []
        for log, sides in zip(logs, structures, strict=True):
            order = np.argsort(np.concatenate([side.robots for side in sides]))
            center = np.concatenate([localized[side.key][0] for side in sides])
            sent = np.concatenate([localized[side.key][1] for side in sides])
            offset = dock_offsets(with_orientations(log).orientation_wxyz, log.dock_offset_body)
            docks = (center[order, None] + offset).reshape(-1, 3)
            beliefs.append(Belief(docks, sent[order]))
        return beliefs

    def localize(sides: Sequence[_Side]) -> dict[tuple[int, int], tuple[Reals, Reals]]:
        """Find where robots believe they are [R], and what each has sent for that [B]."""
        open_swarm = methods.joining(params)
        if not open_swarm:
            logs = [side.log for side in sides]
            estimates = methods.localize_many(logs, [params for _ in logs])
            return {
                side.key: _with_bytes(e.position, e.traffic["sent"] if e.traffic else None)
                for side, e in zip(sides, estimates, strict=True)
            }
        for side in sides:
            if side.key not in swarms:
                swarms[side.key] = open_swarm(side.header, params)
            swarm = swarms[side.key]
            for line in lines_of(side.log)[1][len(swarm.positions) :]:
                swarm.join(line)
        return {
            side.key: _with_bytes(
                swarms[side.key].positions, getattr(swarms[side.key], "sent", None)
            )
            for side in sides
        }

    return believe


def _with_bytes(center: Reals, sent: Reals | None) -> tuple[Reals, Reals]:
    """Pair positions with the bytes that robots sent for them, NaN without messages."""
    return center, np.full(len(center), np.nan) if sent is None else 1.0 * sent


def _sides(history: History, log: SensingLog) -> list[_Side]:
    """Split a structure by the founder to which the first contact of each robot leads."""
    founders = founders_of(history)
    header, lines = lines_of(log)
    return [
        _Side(history, np.flatnonzero(founders == founder), header, lines)
        for founder in np.unique(founders)
    ]
