"""Where robots believe they are while they build: what the method of the case estimates by then.

A belief may also be the truth with an error of a given kind, which shows what such errors cost.
Growth by itself is physics; this is the only way from an estimate to it. The first robot of each
side of a gap stands alone and is the anchor of its side: robots of a side localize each other, and
nobody knows where the other side is until both meet, unless `structure.anchors` states it. Robots
that climb plan by the orientation that they sense.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.math import normal
from tiswarm.localization import methods
from tiswarm.measurements.odometry import with_orientations
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_file import SensingLogBuilder, lines_of
from tiswarm.records.sensing_format import HeaderLine, RobotLine
from tiswarm.records.sensing_log import SensingLog
from tiswarm.scenario.model import Scenario
from tiswarm.sensing import observe
from tiswarm.sensing.imu import of_shape, sensed_turn
from tiswarm.world.growth import Believe, GrowingStructure
from tiswarm.world.history import History
from tiswarm.world.params import BeliefErrorParams
from tiswarm.world.walks import Belief, Turn

_DRAWS = 3
"""Numbers of the draw of a robot."""


class BelievedPlaces(NamedTuple):
    """Where n robots in join order believe to be."""

    center: Reals
    """Centers [R], shape (n, 3)."""

    sd: Reals
    """Standard deviation of each, over all three axes [R], shape (n,); NaN if unknown."""

    sent: Reals
    """Bytes that each robot has sent for that, shape (n,); NaN without messages."""


Place = Callable[[SensingLog], BelievedPlaces]
"""Places the robots of a log."""


class _Side:
    """The n robots of a side in join order, and what they have sensed of each other."""

    def __init__(
        self, history: History, robots: Ints, header: HeaderLine, lines: Sequence[RobotLine]
    ) -> None:
        """Choose from the lines of a whole log."""
        self.founder = int(robots[0])
        self.robots = robots
        anchor = history.walks[self.founder].center[-1].tolist()
        # What robots sense later may need the newer version.
        self.header = header.model_copy(update={"version": 2, "anchor_position": anchor})
        builder = SensingLogBuilder(self.header, of_some=True)
        for robot in robots.tolist():
            builder.add(lines[robot])
        # Robots go by their numbers in join order, as they would in a log of their own.
        self.log = replace(builder.log(), robot_id=np.arange(len(robots)))


def navigate(settings: Scenario, place: Place | None = None) -> dict[str, Any]:
    """Return the arguments `believe` and `turn` of `tiswarm.world.growth.grow` for a case.

    Args:
        settings: Settings of the case.
        place: Places robots that navigate by estimates, in place of the method of the case.
    """
    by = settings.structure.navigate_by
    if by == "truth":
        return {"believe": None, "turn": None}
    believe: Believe = believe_with_error
    if by == "estimate":
        believe = believe_by(settings, place)
    return {"believe": believe, "turn": _turn_by(settings)}


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


def believe_with_error(grown: Sequence[GrowingStructure]) -> list[Belief]:
    """Return beliefs that are the truth plus the error of the settings of each structure."""
    beliefs: list[Belief] = []
    for structure in grown:
        history = structure.history()
        error = structure.params.belief_error
        assert error is not None  # noqa: S101 - settings without one are refused
        center: Reals = history.position + error_of(history, error)
        beliefs.append(
            Belief(
                center=center,
                orientation_wxyz=history.orientation_wxyz,
                sd=error_sd(history, error),
            )
        )
    return beliefs


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


def error_sd(history: History, error: BeliefErrorParams) -> Reals:
    """Compute the root mean square of the length of each robot's error [R], shape (N,)."""
    first = _touched_first(history)
    is_anchor = first == np.arange(history.robot_count)
    if error.kind == "turn":
        arm = history.position - history.position[founders_of(history)]
        turned_sd: Reals = 2.0 * abs(np.sin(0.5 * error.size)) * np.hypot(arm[:, 0], arm[:, 1])
        return turned_sd
    draws = np.where(is_anchor, 0, 1)
    if error.kind == "adding-up":
        for j in np.flatnonzero(~is_anchor):
            draws[j] += draws[first[j]]
    sd: Reals = error.size * np.sqrt(draws)
    return sd


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


def believe_by(settings: Scenario, place: Place | None = None) -> Believe:
    """Return how the robots of a case come to know where they are.

    Robots sense with the noise of the case. Its method places each as it joins, or localizes all
    again after each join. They believe to stand as they sense.

    Args:
        settings: Settings of the case.
        place: Places the robots of a log, again after each join, in place of the method.
    """
    params = settings.localization
    swarms = WeakKeyDictionary[GrowingStructure, dict[int, Any]]()
    """Robots that are placed as they join, by the structure and its founder."""

    def believe(grown: Sequence[GrowingStructure]) -> list[Belief]:
        histories = [structure.history() for structure in grown]
        logs = [observe(history, settings.sensing) for history in histories]
        structures = [_sides(history, log) for history, log in zip(histories, logs, strict=True)]
        placed = iter(locate(grown, structures))
        beliefs: list[Belief] = []
        for log, sides in zip(logs, structures, strict=True):
            order = np.argsort(np.concatenate([side.robots for side in sides]))
            columns = zip(*[next(placed) for _ in sides], strict=True)
            center, sd, sent = (np.concatenate(column)[order] for column in columns)
            orientation = with_orientations(log).orientation_wxyz
            beliefs.append(Belief(center, orientation, sd, sent))
        return beliefs

    def locate(
        grown: Sequence[GrowingStructure], structures: Sequence[Sequence[_Side]]
    ) -> list[BelievedPlaces]:
        """Place the robots of all sides of structures, side by side."""
        logs = [side.log for sides in structures for side in sides]
        if place is not None:
            return [place(log) for log in logs]
        open_swarm = methods.joining(params)
        if not open_swarm:
            return [placed_by(e) for e in methods.localize_many(logs, [params for _ in logs])]
        placed = []
        for structure, sides in zip(grown, structures, strict=True):
            of_structure = swarms.setdefault(structure, {})
            for side in sides:
                if side.founder not in of_structure:
                    of_structure[side.founder] = open_swarm(side.header, params)
                swarm = of_structure[side.founder]
                for line in lines_of(side.log)[1][len(swarm.positions) :]:
                    swarm.join(line)
                placed.append(
                    _placed(
                        swarm.positions, getattr(swarm, "sd", None), getattr(swarm, "sent", None)
                    )
                )
        return placed

    return believe


def placed_by(estimate: Estimate) -> BelievedPlaces:
    """Return where an estimate places robots, and what these sent for it."""
    sent = estimate.traffic["sent"] if estimate.traffic else None
    return _placed(estimate.position, estimate.sd, sent)


def _placed(center: Reals, sd: Reals | None, sent: Reals | None) -> BelievedPlaces:
    """Put positions together with their standard deviations and bytes, NaN where there are none."""
    unknown = np.full(len(center), np.nan)
    if sd is None:
        sd = unknown
    if sent is None:
        sent = unknown
    return BelievedPlaces(center, 1.0 * sd, 1.0 * sent)


def _sides(history: History, log: SensingLog) -> list[_Side]:
    """Split a structure by the founder to which the first contact of each robot leads."""
    founders = founders_of(history)
    header, lines = lines_of(log)
    return [
        _Side(history, np.flatnonzero(founders == founder), header, lines)
        for founder in np.unique(founders)
    ]
