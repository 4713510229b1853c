"""Robots that fail: mute or deaf ones, and those whose orientation sensors drift or are stuck.

The header of the log states no failure: robots do not know of them. Anchors never fail.
"""

from dataclasses import replace

import numpy as np

from tiswarm.base.aliases import Bools
from tiswarm.compute.math import uniform
from tiswarm.sensing.params import Failure, SensingParams
from tiswarm.world.history import History, Walk


def failing(history: History, params: SensingParams, name: Failure) -> Bools:
    """Choose the robots that fail in one way, shape (N,).

    The draw of a robot depends on the seed and the robot alone: a larger share adds robots, and
    those of a structure fail as its first robots did before more joined.
    """
    robot = np.arange(history.robot_count)
    fails: Bools = uniform(history.seed, name, robot, 0) < getattr(params, name)
    return fails & ~history.is_anchor


def sensed_part(history: History, params: SensingParams) -> History:
    """Leave out of a history what deaf and mute robots do not sense: contacts, or all but the end.

    A mute robot keeps its final stance, where later robots touch it.
    """
    is_deaf = failing(history, params, "deaf")
    is_mute = failing(history, params, "mute")
    if not (is_deaf | is_mute).any():
        return history
    walks = list(history.walks)
    for robot in np.flatnonzero(is_deaf):
        walks[robot] = replace(walks[robot], contacts=walks[robot].contacts[:0])
    for robot in np.flatnonzero(is_mute):
        walks[robot] = _mute(walks[robot])
    return replace(history, walks=tuple(walks))


def _mute(walk: Walk) -> Walk:
    return replace(
        walk,
        center=walk.center[-1:],
        orientation_wxyz=walk.orientation_wxyz[-1:],
        pivot_dock=walk.pivot_dock[:0],
        contacts=walk.contacts[:0],
        ground_docks=walk.ground_docks[:0],
        edge_docks=walk.edge_docks[:0],
    )
