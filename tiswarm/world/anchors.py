"""Where anchors are put, and whether they can stand there."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial.distance import pdist, squareform

from tiswarm.base.aliases import Reals
from tiswarm.base.robot import RobotGeometry
from tiswarm.world.params import StructureParams


def anchor_places(params: StructureParams, shape: RobotGeometry) -> Reals:
    """Place robots of a shape as anchors on the ground [R], shape (k, 2); none for a climber."""
    if isinstance(params.anchors, int):
        return params.spread(params.anchors, _clearance(params, shape))
    if params.anchors is not None:
        return np.array(params.anchors)
    return np.array([] if params.anchor is None else [[0.0 - params.anchor, 0.0]]).reshape(-1, 2)


def anchor_fault(params: StructureParams, robots: int, shape: RobotGeometry) -> str:
    """Find why so many robots of a shape cannot have these anchors; empty if they can."""
    return "" if params.anchors is None else next(_faults(params, robots, shape), "")


def _faults(params: StructureParams, robots: int, shape: RobotGeometry) -> Iterator[str]:
    places, terrain = anchor_places(params, shape), params.terrain
    if len(places) > robots:
        yield f"{len(places)} anchors are more than {robots} robots; give fewer"
    clearance = _clearance(params, shape)
    for j, (x, y) in enumerate(places.tolist()):
        where = f"anchor {j} at [{x:g}, {y:g}]"
        if terrain.left_edge - clearance < x < terrain.right_edge + clearance:
            yield f"{where} is off the ground; keep it {clearance:.4g} R behind the edge"
        if params.plane and y != 0.0:
            yield f"{where} is not in the plane; set its y to 0"
    apart, least = squareform(pdist(places)), 2.0 * clearance + shape.spacing
    for i, j in np.argwhere(np.triu(apart < least, 1)):
        near = f"anchors {i} and {j} are {apart[i, j]:.4g} R apart and may overlap"
        yield f"{near}; place them {least:.4g} R apart or more"
    is_right = places[:, 0] > 0.0
    if params.sides > 1 and (is_right.all() or not is_right.any()):
        yield "both sides need an anchor; add one"


def _clearance(params: StructureParams, shape: RobotGeometry) -> float:
    """Bound how far a robot's docks are from where it is put [R]."""
    # An upright robot is put down by its lowest dock: others are up to twice as far from that.
    return shape.extent * (2.0 if params.plane else 1.0)
