"""The method `distributed`: robots join one by one, and localize themselves by what they send.

The log is cut into lines, one for each robot; from then on a robot has its own line, and what it
hears. Under `touch` robots in contact at the end, as the log has it, hear each other.
"""

import json
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace

import numpy as np

from tiswarm.base.errors import InputError
from tiswarm.base.progress import ignore
from tiswarm.localization.distributed.published import algorithm_1
from tiswarm.localization.distributed.swarm import PeerSwarm
from tiswarm.localization.distributed.wire import MOST_ROBOTS
from tiswarm.localization.online.lines import refuse_header, refuse_line
from tiswarm.localization.params import DistributedParams
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_file import log_entries
from tiswarm.records.sensing_format import line_text, parse_header, parse_robot
from tiswarm.records.sensing_log import SensingLog


def batch_key(log: SensingLog, params: DistributedParams) -> Hashable:  # noqa: ARG001
    """Name what logs must share to be localized in one batch: nothing."""
    return None


def localize_batch(
    logs: Sequence[SensingLog],
    params: Sequence[DistributedParams],
    on_progress: Callable[[float], None] = ignore,
) -> list[Estimate]:
    """Let the robots of each log join one after the other.

    Returns:
        One estimate a log, with what robots sent each other.

    Raises:
        InputError: a log has what robots cannot send, or more robots than have numbers.
    """
    estimates = []
    total, joined = sum(log.robot_count for log in logs), 0
    for log, p in zip(logs, params, strict=True):
        if log.robot_count > MOST_ROBOTS:
            problem = f"distributed numbers up to {MOST_ROBOTS} robots; choose method joint"
            raise InputError(problem)
        if log.gone.size:
            raise InputError("distributed takes robots that stay; choose joint", key="event")
        # Robots go by their numbers in join order.
        numbered = replace(log, robot_id=np.arange(log.robot_count))
        header, *robots = map(json.dumps, log_entries(numbered))
        refuse_header(parse_header(line_text(header)))
        lines = [parse_robot(line_text(robot)) for robot in robots]
        for line in lines:
            refuse_line(line)
        if p.scheme == "algorithm-1":
            found = algorithm_1(log, p)
        else:
            swarm = PeerSwarm(header, p, len(lines))
            for line in lines:
                swarm.join(line)
                on_progress((joined + line.robot + 1) / total)
            found = swarm.estimate(log)
        joined += log.robot_count
        estimates.append(found)
    return estimates
