"""Algorithm 1 of the paper between robots: what it sends, beside the estimate of `virtual-force`.

A robot that joins needs the poses of those that it touches, and for undocked repulsion of all near
it: the paper's minimal global channel, on which robots "periodically broadcast an estimated pose
proxy (e.g., center and dock position)". Without that repulsion, those that it touches answer it. In
a round of back-propagation each robot sends its position after each of its steps. By touch, robots
pass on what they hear.
"""

from dataclasses import replace

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.localization.params import BackPropagation, DistributedParams, VirtualForceParams
from tiswarm.localization.virtual_force.method import localize_batch
from tiswarm.measurements.contacts import contact_count
from tiswarm.parts.between.channel import HEADER, Channel
from tiswarm.parts.between.wire import pose_bytes
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

_OF_DISTANCE = 8
"""Operations for the distance of two docks [1]."""

_OF_FORCE = 30
"""Operations for the force between them [1]."""


def algorithm_1(log: SensingLog, params: DistributedParams) -> Estimate:
    """Localize a log by Algorithm 1, and count what robots send.

    Returns:
        The estimate without losses and rounding, with the traffic of the channel. Robots do not
        judge for themselves.
    """
    settings = params.published
    [found] = localize_batch([log], [settings])
    robots = log.robot_count
    channel = Channel(params, robots, lambda _, message: message)
    touching: list[set[int]] = [set() for _ in range(robots)]
    for i, _, j, _ in log.contacts.tolist():
        touching[max(i, j)].add(min(i, j))
    pose = HEADER + pose_bytes(params.bits, with_orientation=True)
    moved = HEADER + pose_bytes(params.bits, with_orientation=False)
    rounds = params.back_propagation
    for number in range(robots):
        channel.join(touching[number])
        if not params.undocked_repulsion:
            channel.answer(number, pose)
        elif params.poses == "every-join" or number == robots - 1:
            channel.broadcast(pose)
        if rounds is not None and _follows(rounds, number + 1, robots):
            channel.broadcast(moved, rounds.sweeps, by_all=params.undocked_repulsion)
    heard_of = np.full(robots, robots) if params.undocked_repulsion else 1 + channel.degree
    memory = heard_of * (pose - HEADER)
    traffic = channel.traffic(memory, _operations(log, settings, found.steps))
    return replace(found, traffic=traffic)


def _follows(rounds: BackPropagation, joined: int, robots: int) -> bool:
    """Judge whether a round follows a join."""
    return joined % rounds.every == 0 or joined == robots


def _operations(log: SensingLog, params: VirtualForceParams, steps: Ints | None) -> Reals:
    """Count the operations of each robot, shape (N,); for Eq. (2) it looks at all docks."""
    taken = np.full(log.robot_count, params.iterations) if steps is None else steps
    docks = len(log.dock_offset_body)
    # Only robots that have joined before are heard.
    pairs = docks**2 * np.arange(log.robot_count) * params.undocked_repulsion
    per_step = _OF_DISTANCE * pairs + _OF_FORCE * contact_count(log)
    return np.asarray(taken * per_step, np.float64)
