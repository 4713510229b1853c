"""Distances of centers to those of earlier robots within reach and in sight."""

import numpy as np
from scipy.spatial import cKDTree

from tiswarm.base.aliases import Reals
from tiswarm.compute.math import normal
from tiswarm.sensing.params import SensingParams
from tiswarm.sensing.sight import Views, find_lookouts, in_sight
from tiswarm.world.history import History


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
    from_lookouts = cKDTree(lookouts.center)
    to_robots = cKDTree(history.position)
    pairs = from_lookouts.sparse_distance_matrix(
        to_robots, params.range_reach, output_type="ndarray"
    )
    is_earlier = pairs["j"] < lookouts.robot[pairs["i"]]
    lookout = pairs["i"][is_earlier]
    target = pairs["j"][is_earlier]
    robot, stance, center, joined = (column[lookout] for column in lookouts)
    views = Views(center, history.position[target], joined, robot, target)
    seen = in_sight(history, views)
    length = np.linalg.norm(views.end - center, axis=1)
    length += params.range_noise * normal(history.seed, "range", robot, (stance << 31) + target)
    length += params.range_bias * normal(history.seed, "ranges", 0, 0)
    source = len(params.sources) - 1 if params.range_bias else -1  # the last one
    sd_and_source = np.tile([params.range_noise, source], (len(robot), 1))
    measured = np.column_stack([robot, stance, target, length, sd_and_source])
    rows: Reals = measured[seen & (length > 0.0)]
    return rows
