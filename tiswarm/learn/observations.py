"""What a climber observes, as arrays of fixed size, and its actions.

All of it a robot may know: the goal, its own walk, what its docks touch or would touch at the end
of a flip, and the loads that the robots which it touches have sensed.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import AnyInts, Ints, Reals
from tiswarm.world.choices import STAY, ClimbStep

Singles = NDArray[np.float32]
Mask = NDArray[np.int8]


class Feature(NamedTuple):
    """A number of an observation; it is cut off at its bounds."""

    name: str
    """Name."""

    unit: str
    """Unit."""

    low: float
    """Least value."""

    high: float
    """Greatest value."""

    meaning: str
    """What it is."""


FLIP_FEATURES = (
    Feature("possible", "1", 0, 1, "whether there is such a flip; all others are 0 if not"),
    Feature("distance", "R", 0, 200, "distance to the goal where it ends"),
    Feature("gain", "R", -20, 20, "by how much it comes nearer to the goal"),
    Feature("dx", "R", -10, 10, "how far its center goes along x"),
    Feature("dy", "R", -10, 10, "how far its center goes along y"),
    Feature("dz", "R", -10, 10, "how far its center goes up"),
    Feature("angle", "rad", -7, 7, "angle of the flip"),
    Feature("visited", "1", 0, 1, "whether the walk has been where it ends"),
    Feature("called", "1", 0, 1, "whether a dock that passes a call on is touched at its end"),
    Feature("touches", "1", 0, 12, "docks of robots that are touched at its end"),
    Feature("ground", "1", 0, 12, "docks of the climber on the ground at its end"),
    Feature("load", "weight of a dock", 0, 100, "greatest load sensed by robots touched there"),
)
"""Features of each flip."""

ROBOT_FEATURES = (
    Feature("climbs", "1", 0, 1, "whether there is a climber; all others are 0 if not"),
    Feature("distance", "R", 0, 200, "distance to the goal"),
    Feature("to_x", "R", -200, 200, "goal from its center, along x"),
    Feature("to_y", "R", -200, 200, "goal from its center, along y"),
    Feature("to_z", "R", -200, 200, "goal from its center, up"),
    Feature("best", "R", 0, 200, "least distance to the goal in its walk"),
    Feature("flips", "1", 0, 1000, "flips that it has taken"),
    Feature("since_best", "1", 0, 1000, "flips since it was nearest to the goal"),
    Feature("called", "1", 0, 1, "whether it touches a dock that passes a call on"),
    Feature("touches", "1", 0, 12, "docks of robots that it touches"),
    Feature("ground", "1", 0, 12, "docks on the ground"),
    Feature("load", "weight of a dock", 0, 100, "greatest load sensed by robots that it touches"),
)
"""Features of the climber."""


class Observation(NamedTuple):
    """What rows of climbers observe; a row without a climber is 0, and may only stay."""

    flips: Singles
    """`FLIP_FEATURES` of each of K flips, shape (rows, K, F)."""

    robot: Singles
    """`ROBOT_FEATURES`, shape (rows, G)."""

    action_mask: Mask
    """Whether each action is possible, shape (rows, K + 2)."""


def observation_of(step: ClimbStep, rows: int) -> Observation:
    """Return what climbers observe, by their slots, rows of them."""
    flip_count = step.possible.shape[1]
    flips = np.zeros((rows, flip_count, len(FLIP_FEATURES)), np.float32)
    robot = np.zeros((rows, len(ROBOT_FEATURES)), np.float32)
    mask = np.zeros((rows, flip_count + 2), np.int8)
    mask[:, flip_count:] = 1
    flips[step.slot] = _flips(step)
    robot[step.slot] = _robot(step)
    mask[step.slot, :flip_count] = step.possible
    return Observation(flips, robot, mask)


def choice_of(action: AnyInts, step: ClimbStep) -> Ints:
    """Return the choices of M climbers from the actions in their slots, shape (rows,).

    Of K flips, action K is to stay, K + 1 to go back to where the walk was nearest to the goal and
    stay there. A flip that is not possible is to stay.
    """
    flip_count = step.possible.shape[1]
    chosen = np.asarray(action, np.int64)[step.slot]
    flip = np.minimum(chosen, flip_count - 1)
    goes = (chosen < flip_count) & step.possible[np.arange(len(flip)), flip]
    goes_back = chosen == flip_count + 1
    choice: Ints = np.where(goes, flip, STAY)
    if goes_back.any():
        choice = np.where(goes_back, step.back(_best(step)), choice)
    return choice


def action_of(choice: AnyInts, step: ClimbStep, rows: int) -> Ints:
    """Return actions by slot, shape (rows,), for choices of M climbers; to stay where none is.

    Choices to go back are those to the stance nearest to the goal, as ReactiveBuild makes them.
    """
    flip_count = step.possible.shape[1]
    stays = (choice == STAY) | (choice == step.back(step.stance))
    action = np.full(rows, flip_count)
    action[step.slot] = np.where(choice >= 0, choice, np.where(stays, flip_count, flip_count + 1))
    return action


def _best(step: ClimbStep) -> Ints:
    """Return the stance of each walk that is nearest to the goal, shape (M,)."""
    walked = np.linalg.norm(step.walk - step.goal[:, None], axis=-1)
    return np.nanargmin(walked, axis=1) if len(walked) else np.empty(0, np.int64)


def _flips(step: ClimbStep) -> Reals:
    """Compute `FLIP_FEATURES`, shape (M, K, F)."""
    moved = step.end - step.center[:, None]
    distance = np.linalg.norm(step.end - step.goal[:, None], axis=-1)
    now = np.linalg.norm(step.center - step.goal, axis=-1)
    touching = step.end_touching
    columns = [
        step.possible,
        distance,
        now[:, None] - distance,
        *np.moveaxis(moved, -1, 0),
        step.angle,
        step.visited,
        step.end_called,
        (touching >= 0).sum(axis=(-2, -1)),
        (step.end_on_ground > 0).sum(axis=-1),
        _greatest_load(step, touching),
    ]
    features = np.stack(np.broadcast_arrays(*columns), axis=-1, dtype=np.float64)
    return np.where(step.possible[..., None], _cut(features, FLIP_FEATURES), 0.0)


def _robot(step: ClimbStep) -> Reals:
    """Compute `ROBOT_FEATURES`, shape (M, G)."""
    to_goal = step.goal - step.center
    best = _best(step)
    nearest = step.walk[np.arange(len(best)), best] - step.goal
    columns = [
        np.ones(len(best)),
        np.linalg.norm(to_goal, axis=-1),
        *to_goal.T,
        np.linalg.norm(nearest, axis=-1),
        step.stance,
        step.stance - best,
        step.called,
        (step.touching >= 0).sum(axis=(-2, -1)),
        (step.on_ground > 0).sum(axis=-1),
        _greatest_load(step, step.touching[:, None])[:, 0],
    ]
    return _cut(np.stack(columns, axis=-1, dtype=np.float64), ROBOT_FEATURES)


def _greatest_load(step: ClimbStep, touching: AnyInts) -> Reals:
    """Find the greatest load that touched robots sensed, shape (M, K).

    Args:
        step: What climbers see.
        touching: Docks that are touched, or -1, shape (M, K, n, most).
    """
    docks = touching.shape[2]
    sensed = np.nan_to_num(step.sensed)  # dead robots sense nothing
    greatest = np.zeros(touching.shape[:2])
    for rank in range(touching.shape[3]):
        dock = touching[..., rank]
        if not (dock >= 0).any():
            break
        load = sensed[step.structure[:, None, None], dock // docks]
        greatest = np.maximum(greatest, np.max(load, axis=-1, where=dock >= 0, initial=0.0))
    return greatest


def _cut(values: Reals, features: tuple[Feature, ...]) -> Reals:
    """Cut values off at the bounds of their features."""
    low = [feature.low for feature in features]
    high = [feature.high for feature in features]
    return np.clip(values, low, high)
