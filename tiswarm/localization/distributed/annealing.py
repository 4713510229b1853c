"""One chain of annealing by all robots at once, which send each other where they are.

1. Once it has joined, a robot sends its pose, so that others know where its docks are. It begins
   where its first contact puts it.
2. It sends each partner the rows that they share.
3. In each round, it steps by its rows and by overlaps with what it heard last, and sends its
   position. Who misses a position takes the next one: none is repeated.

Lengths in R, relative to the anchor.
"""

from collections import deque
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Reals
from tiswarm.localization.distributed.chain_kernels import ChainRows
from tiswarm.localization.distributed.chains import docks_of, rows_of, schedule
from tiswarm.localization.distributed.channel import HEADER, Channel, Message
from tiswarm.localization.distributed.conclusion import Found
from tiswarm.localization.distributed.heard_kernels import SENT, Hearing, step_as_heard
from tiswarm.localization.distributed.local import OF_PAIR, OF_ROW, Known, LocalSwarm, Program
from tiswarm.localization.distributed.settings import CHAINS
from tiswarm.localization.distributed.wire import line_bytes, pose_bytes
from tiswarm.localization.online.configuration import Configuration, Shapes
from tiswarm.localization.params import DistributedParams
from tiswarm.measurements.rows import SPACING
from tiswarm.records.sensing_format import RobotLine

_AXES = 3
_ROW_VALUES = 5
"""Numbers of a row that a partner is sent: where docks or centers are, a length, a variance."""


def annealed_by_messages(
    program: Program, lines: Sequence[RobotLine], on_progress: Callable[[float], None]
) -> Found:
    """Let all robots of a swarm anneal at once, after the last of them has joined."""
    params, robots = program.params, len(lines)
    known = {
        line.robot: Known(content, sharing=program.partners(content))
        for line in lines
        for content in [line_bytes(line, program.docks, params.bits)]
    }
    # Each block follows from the line of its robot and the orientations that this one hears.
    layers = LocalSwarm(program, known).layers
    every = np.arange(robots)
    problem = layers.neighborhood(every)
    rows, shapes = rows_of(problem, robots), problem.shapes
    links = _links(shapes)
    channel = Channel(params, robots, lambda _, message: message)
    for number in range(robots):
        channel.join({other for other in links[number] if other < number})
    channel.broadcast(HEADER + pose_bytes(params.bits, with_orientation=True))
    for number in range(robots):
        _send_rows(channel, number, rows, params)
    channel.settle()
    position = _run(params, rows, docks_of(problem), shapes, links, on_progress)
    steps = params.all_steps
    channel.broadcast(HEADER + pose_bytes(params.bits, with_orientation=False), steps)
    layers.state = Configuration(position, np.zeros_like(position))
    sd = np.zeros(robots)
    for number in range(1, robots):
        # What a robot knows alone: its own rows, and others where it heard them last.
        alone = layers.neighborhood(np.array([number]))
        sd[number] = alone.sd(alone.linearized(layers.state))[0] if alone.number else np.inf
    count = np.diff(rows.start)
    bytes_of_row = -(-_ROW_VALUES * (params.bits or 64) // 8)
    memory = robots * pose_bytes(params.bits, with_orientation=True) + bytes_of_row * count
    operations = steps * (OF_ROW * count + OF_PAIR * robots).astype(np.float64)
    traffic = channel.traffic(memory, operations)
    traffic["rounds"] += steps
    return Found(
        position=position,
        at_join=None,
        sd=np.minimum(sd, np.linalg.norm(position, axis=1).max(initial=1.0)),
        lost=np.zeros(robots, np.bool_),
        doubtful=np.array(layers.surprising(every), np.bool_),
        traffic=traffic,
        steps=steps,
        reason="one chain was annealed, and many robots at once may be in a mirror image",
    )


def _links(shapes: Shapes) -> list[set[int]]:
    """List the robots that each one touches."""
    links: list[set[int]] = [set() for _ in shapes.arm]
    for later, (first, last) in enumerate(pairwise(shapes.touch_start.tolist())):
        for other in shapes.touch[first:last, 1].tolist():
            links[later].add(other)
            links[other].add(later)
    return links


def _send_rows(channel: Channel, number: int, rows: ChainRows, params: DistributedParams) -> None:
    """Let a robot send each earlier one the rows that they share."""
    partner = rows.partner[rows.start[number] : rows.start[number + 1]]
    shared, count = np.unique(partner[(partner >= 0) & (partner < number)], return_counts=True)
    size = _ROW_VALUES * (params.bits or 64)
    parts = {
        other: bytes(-(-size * times // 8))
        for other, times in zip(shared.tolist(), count.tolist(), strict=True)
    }
    if parts:
        channel.send(Message("rows", number, b"", parts))


def _run(
    params: DistributedParams,
    rows: ChainRows,
    docks: Sequence[NDArray[np.generic]],
    shapes: Shapes,
    links: list[set[int]],
    on_progress: Callable[[float], None],
) -> Reals:
    """Anneal, and return the mean of each robot over the steps at the end temperature, (N, 3)."""
    place = begin_of(shapes)
    hops = _hops(links, radio=params.channel == "radio")
    history = int(hops.max(initial=1)) * (1 + params.delay) + 2
    hearing = Hearing(
        hops, np.zeros((history, len(place), SENT)), np.tile(place, (len(place), 1, 1))
    )
    speed, total = np.zeros_like(place), np.zeros_like(place)
    held = round(CHAINS.held * params.all_steps)
    cooling = schedule(params.sigma, params.all_steps - held)
    for t in range(params.all_steps):
        counts = int(t >= len(cooling))
        step_as_heard(
            params.seed % 2**31, t, counts, float(cooling[min(t, len(cooling) - 1)]),
            CHAINS.memory, shapes.reach, params.loss, params.delay, params.bits or 0,
            *rows, *docks, *hearing, place, speed, total,
        )  # fmt: skip
        if t % 100 == 0:
            on_progress(t / params.all_steps)
    mean: Reals = total / held if held else place
    return mean


def begin_of(shapes: Shapes) -> Reals:
    """Put each robot where its first contact with an earlier one puts it, docks D apart, (N, 3)."""
    begin = np.zeros((len(shapes.arm), _AXES))
    for robot, (first, last) in enumerate(pairwise(shapes.touch_start.tolist())):
        if first == last:
            begin[robot] = begin[max(robot - 1, 0)]
            continue
        own, other, its = shapes.touch[first]
        out = shapes.arm[other, its] - shapes.arm[robot, own]
        far = float(np.linalg.norm(out))
        begin[robot] = begin[other] + out * (1.0 + SPACING / max(far, 1e-9))
    return begin


def _hops(links: list[set[int]], *, radio: bool) -> NDArray[np.int32]:
    """Count transmissions between any two robots; 0 where there is no way, shape (N, N)."""
    robots = len(links)
    if radio:
        return (1 - np.eye(robots)).astype(np.int32)
    hops = np.zeros((robots, robots), np.int32)
    for root in range(robots):
        queue = deque([root])
        while queue:
            here = queue.popleft()
            for other in links[here]:
                if not hops[root, other] and other != root:
                    hops[root, other] = hops[root, here] + 1
                    queue.append(other)
    return hops
