"""The method `distributed`: robots localize by what they send each other.

By default one robot solves for all that are within `reach` of it: the anchor, like a base.

The log is cut into lines, one for each robot; from then on a robot has its own line, and what it
hears. Under `touch` robots in contact at the end, as the log has it, hear each other.
"""

import json
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace

import numpy as np

from tiswarm.base.errors import InputError
from tiswarm.base.progress import ignore
from tiswarm.localization.params import DistributedParams
from tiswarm.parts.between.conclusion import estimate_of
from tiswarm.parts.between.local import Program
from tiswarm.parts.between.published import algorithm_1
from tiswarm.parts.between.swarm import PeerSwarm
from tiswarm.parts.between.wire import MOST_ROBOTS
from tiswarm.parts.online.lines import refuse_header, refuse_line
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_file import log_entries
from tiswarm.records.sensing_format import RobotLine, line_text, parse_header, parse_robot
from tiswarm.records.sensing_log import SensingLog


def batch_key(log: SensingLog, params: DistributedParams) -> Hashable:  # noqa: ARG001
    """Name what logs share that are localized in one batch, one after the other: the settings."""
    return repr(params)


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

        def report(share: float, begun: int = joined, robots: int = log.robot_count) -> None:
            on_progress((begun + share * robots) / total)

        estimates.append(_localized(log, p, header, lines, report))
        joined += log.robot_count
    return estimates


def _localized(
    log: SensingLog,
    params: DistributedParams,
    header: str,
    lines: list[RobotLine],
    on_progress: Callable[[float], None],
) -> Estimate:
    """Let robots localize themselves by the scheme that is asked for."""
    if params.scheme == "algorithm-1":
        return algorithm_1(log, params)
    program = Program(params, header)
    swarm = PeerSwarm(program, len(lines))
    for line in lines:
        swarm.join(line)
        on_progress((line.robot + 1) / len(lines))
    return estimate_of(log, params, swarm.found())
