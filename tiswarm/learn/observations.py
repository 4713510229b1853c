"""What a climber observes, as arrays of fixed size, and its actions."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import AnyInts, Ints
from tiswarm.compute import backend
from tiswarm.learn.features import features_of
from tiswarm.learn.kernels import observe
from tiswarm.world.choices import STAY, ClimbStep

Singles = NDArray[np.float32]
Mask = NDArray[np.int8]


class Observation(NamedTuple):
    """What rows of climbers observe; a row without a climber is 0, and may only stay."""

    flips: Singles
    """Features of each of K flips, shape (rows, K, F)."""

    robot: Singles
    """Features of the climber, shape (rows, G)."""

    action_mask: Mask
    """Whether each action is possible, shape (rows, K + 2)."""


@backend.exclusive()
def observation_of(step: ClimbStep, rows: int) -> Observation:
    """Return what climbers observe, by their slots, rows of them."""
    flip_count = step.possible.shape[1]
    of_flip, of_robot = features_of(by_belief=step.by_belief)
    observation = Observation(
        np.zeros((rows, flip_count, len(of_flip)), np.float32),
        np.zeros((rows, len(of_robot)), np.float32),
        np.zeros((rows, flip_count + 2), np.int8),
    )
    observation.action_mask[:, flip_count:] = 1
    observation.action_mask[step.slot, :flip_count] = step.possible
    walks, structures, sight, failures = step.for_kernels()
    climbers = walks.climbers
    stances = walks.stances
    backend.processor()
    observe(
        walks.limits,
        step.slot,
        step.called.astype(np.int32),
        step.sensed,
        *sight.obstacles.cells,
        sight.obstacles.dock,
        structures.relay,
        climbers.structure,
        climbers.goal,
        climbers.dock_offset_body,
        climbers.ground,
        climbers.of_structure,
        sight.walks.center,
        stances.touching,
        stances.on_ground,
        stances.last,
        failures.failed_count,
        *sight.flips,
        np.empty((rows, 1, *stances.touching.shape[2:]), np.int32),
        np.empty((rows, 1, walks.docks), np.int32),
        observation.flips,
        observation.robot,
        walks.laws,
    )
    if step.by_belief:
        # An sd that nobody knows is as large as it may be.
        most = of_robot[-1].high
        end_sd = np.nan_to_num(step.end_sd, nan=most).clip(max=most)
        observation.flips[step.slot, :, -1] = np.where(step.possible, end_sd, 0.0)
        observation.robot[step.slot, -1] = np.nan_to_num(step.sd, nan=most).clip(max=most)
    return observation


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
