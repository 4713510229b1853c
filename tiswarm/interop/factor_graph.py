"""PyFG, the text format of range-aided SLAM: a log and its estimate as a factor graph.

PyFactorGraph writes and reads it (github.com/MarineRoboticsGroup/PyFactorGraph, `io/pyfg_text.py`),
and the solver CORA reads it (Papalia et al., "Certifiably correct range-aided SLAM", T-RO 2024).
A line is a variable or a measurement; covariances are upper triangles, row by row:

    VERTEX_SE3:QUAT time name x y z qx qy qz qw
    VERTEX_XYZ name x y z
    VERTEX_SE3:QUAT:PRIOR time name x y z qx qy qz qw covariance(6 x 6)
    EDGE_SE3_XYZ time pose point x y z covariance(3 x 3)
    EDGE_RANGE time name name distance variance

Robots are the poses A0, A1, ... in join order, docks the points L0, L1, ...: dock d of robot i of
robots with D docks is point D i + d. Variables start at the truth if it is known, else at the
estimate. The time is the join index.
"""

from collections.abc import Iterator

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.measurements.odometry import ASSUMED
from tiswarm.report.swarm_view import SwarmView

_EXACT_SD = 1e-3
"""Standard deviation [dock radii] of arms and of contacts, which have no noise in our model."""

_LEAST_ANGLE_SD = 1e-4
"""Least standard deviation of an orientation [rad]; the format has no exact measurements."""

_UNKNOWN_SD = 1e6
"""Standard deviation of the unknown position in a prior of orientation [dock radii]."""


def encode_pyfg(view: SwarmView) -> dict[str, bytes]:
    """Encode the robots whose pose is known, and what the log says of them, in its unit.

    Contacts are ranges of two dock radii between docks; `ranges` of the log are ranges between
    robots; each sensed orientation is a prior, and the anchor's has its position. The format has
    no measurements of heights, fixes and flips: these are left out. Nor has it shared errors: the
    variance of a range includes that of its source.
    """
    return {"case.pyfg": "".join(f"{line}\n" for line in _lines(view)).encode()}


def _lines(view: SwarmView) -> Iterator[str]:
    log, unit, pose = view.log, view.log.dock_radius, view.best_pose
    known = np.asarray(np.isfinite(pose).all(axis=1))
    robots = np.flatnonzero(known).tolist()
    docks = len(log.dock_offset_body)
    center = pose[known, :3]
    dock = unit * (center[:, None] + dock_offsets(pose[known, 3:], view.dock_offset_body))
    exact = (_EXACT_SD * unit) ** 2
    for i in robots:
        yield f"VERTEX_SE3:QUAT {i} A{i} {_text(unit * pose[i, :3])} {_text(_xyzw(pose[i, 3:]))}"
    for k, i in enumerate(robots):
        for d in range(docks):
            yield f"VERTEX_XYZ L{docks * i + d} {_text(dock[k, d])}"
    noise = log.noise or ASSUMED
    angle = np.radians([noise.tilt_deg, noise.tilt_deg, noise.yaw_deg])
    turn = np.maximum(angle, _LEAST_ANGLE_SD) ** 2
    for i in filter(lambda i: np.isfinite(log.orientation_wxyz[i]).all(), robots):
        spread = exact if i == 0 else (_UNKNOWN_SD * unit) ** 2
        at = f"{_text(log.anchor_position)} {_text(_xyzw(log.orientation_wxyz[i]))}"
        covariance = _triangle(np.diag([spread] * 3 + turn.tolist()))
        yield f"VERTEX_SE3:QUAT:PRIOR {i} A{i} {at} {covariance}"
    arm = _triangle(exact * np.eye(3))
    for i in robots:
        for d, offset in enumerate(log.dock_offset_body):
            yield f"EDGE_SE3_XYZ {i} A{i} L{docks * i + d} {_text(offset)} {arm}"
    for i, a, j, b in log.contacts[known[log.contacts[:, [0, 2]]].all(axis=1)].tolist():
        yield f"EDGE_RANGE {j} L{docks * i + a} L{docks * j + b} {log.spacing!r} {exact!r}"
    shared = np.append(log.source_sd, 0.0)  # a source of -1 is none
    for i, j, distance, sd, source in log.ranges.tolist():
        if known[int(i)] and known[int(j)]:
            variance = sd**2 + float(shared[int(source)]) ** 2
            yield f"EDGE_RANGE {int(i)} A{int(i)} A{int(j)} {distance!r} {variance!r}"


def _xyzw(quaternion: Reals) -> Reals:
    """Put the real part last."""
    return np.roll(quaternion, -1)


def _triangle(covariance: Reals) -> str:
    return _text(covariance[np.triu_indices(len(covariance))])


def _text(numbers: Reals) -> str:
    """Write numbers in the shortest form that reads back as the same ones."""
    return " ".join(map(repr, numbers.tolist()))
