"""What the steps compute on, from a grown structure, and what tiswarm finds there.

Lengths in R, relative to the anchor.
"""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.compute.math import dock_offsets
from tiswarm.localization.distributed.local import Known, LocalSwarm, Program
from tiswarm.localization.distributed.wire import Whereabouts, line_bytes
from tiswarm.localization.joint.settings import ANNEALING
from tiswarm.localization.online.arrays import (
    ARM,
    AXIS,
    COORDINATE,
    FIRST,
    KIND,
    MEMBER,
    OTHER_ARM,
    OWN_VARIANCE,
    VALUE,
    VARIANCE,
)
from tiswarm.localization.online.blocks import Block
from tiswarm.localization.online.candidates import SPHERE
from tiswarm.localization.online.configuration import Configuration
from tiswarm.localization.online.layers import LocalLayers
from tiswarm.localization.online.lines import mentioned
from tiswarm.localization.online.neighborhood import Neighborhood
from tiswarm.localization.online.settings import CANDIDATES, NEIGHBORS
from tiswarm.localization.params import DistributedParams, VirtualForceParams
from tiswarm.localization.virtual_force import Localizer
from tiswarm.records.sensing_file import log_entries
from tiswarm.records.sensing_format import line_text, parse_robot
from tiswarm.records.sensing_log import SensingLog

HEADER = Path(__file__).with_name("robot.h")


class Expected(NamedTuple):
    """What tiswarm finds in float64."""

    joins: Reals
    """Place of each robot by virtual forces, of those before it, shape (N - 1, 3)."""

    candidates: Reals
    """Where the last robot may be, the likeliest place first, shape (k, 3)."""

    cost: float
    """Least cost of the neighborhood [1]."""

    state: Reals
    """Center and turn of each robot that is held then, shape (M, 6)."""


def inputs(
    log: SensingLog, place: Reals, held: int, params: VirtualForceParams
) -> tuple[str, Expected]:
    """Write the inputs of all steps as C; the last robot of the log joins.

    Args:
        log: N robots.
        place: Centers of all but the last one, as they are known [R], shape (N - 1, 3).
        held: Robots that move beside it, the nearest ones by steps of sharing a row.
        params: Settings of Algorithm 1.

    Raises:
        ValueError: a block or the neighborhood is larger than the memory that robot.h sets aside.
    """
    joins, places = _joins(log, params)
    nearby, candidates, cost, state = _nearby(log, place, held)
    return f"{joins}\n{nearby}\n", Expected(places, candidates, cost, state)


def _joins(log: SensingLog, params: VirtualForceParams) -> tuple[str, Reals]:
    """Write each join by virtual forces to the robots that tiswarm placed before."""
    header, *lines = log_entries(log)
    localizer = Localizer(header, params)
    for line in lines:
        localizer.join(line)
    place = (localizer.positions - log.anchor_position) / log.dock_radius
    arm = dock_offsets(log.orientation_wxyz, log.dock_offset_body / log.dock_radius)
    joins: list[Any] = []
    touches: list[Any] = []
    for robot in range(1, log.robot_count):
        its = log.contacts[log.contacts[:, 2] == robot][:, [3, 0, 1]]
        standing = log.ground_docks[log.ground_docks[:, 0] == robot, 1]
        known = log.ground_z if len(standing) else log.flip_height[robot]
        height = (known - log.anchor_position[2]) / log.dock_radius
        if len(standing):
            height += (1.0 - arm[robot, standing, 2]).mean()
        at = f"touches + {len(touches)}"
        joins.append(("placed", at, robot, len(its), arm[robot], float(height)))
        touches += its.tolist()
    gains = (
        params.attraction_gain, params.repulsion_gain, params.height_gain,
        params.initial_offset, params.max_step,
    )  # fmt: skip
    text = [
        f"enum {{ JOINS = {len(joins)}, STEPS = {params.iterations} }};",
        _array("const struct placed", "placed", zip(place, arm, strict=True)),
        _array("const struct touch", "touches", touches),
        _array("const struct join", "joins", joins),
        f"static const struct gains gains = {_c(gains)};",
    ]
    return "\n".join(text), place[1:]


def _nearby(log: SensingLog, place: Reals, held: int) -> tuple[str, Reals, float, Reals]:
    """Write what the robot holds that solves for the last one; solve, too."""
    layers = _held(log, place, held)
    joiner = len(layers.blocks) - 1
    likeliest = layers.place(joiner)[0]
    touched = layers.state.position[layers.blocks[joiner].partners]
    candidates = layers.places[joiner] + touched.mean(axis=0)
    position, turn = layers.state
    position[joiner] = likeliest
    problem = layers.neighborhood(np.arange(joiner + 1)[-held - 1 :])
    text = _neighborhood(problem, layers.blocks, Configuration(position, turn))
    solved, linear = problem.solved(Configuration(position, turn))
    return text, candidates, linear.cost, np.hstack(solved)


def _neighborhood(problem: Neighborhood, blocks: list[Block], state: Configuration) -> str:
    """Write the robots that are held, their rows, and the settings of search and rounds."""
    shapes, moving = problem.shapes, problem.moving
    rows: list[Any] = []
    stances: list[Any] = []
    table: list[Any] = []
    for owner in problem.number:
        its_rows, its_stances = _tables(blocks[owner])
        at = f"rows + {len(rows)}", f"stances + {len(stances)}"
        table.append((*at, owner, len(its_rows), len(its_stances)))
        rows += its_rows
        stances += its_stances
    held, most_rows = len(state.position), max(len(blocks[owner]) for owner in problem.number)
    _check(MOST_HELD=held, MOST_MOVING=len(moving), MOST_ROWS=most_rows)
    column = np.full(_limit("MOST_HELD"), -1)
    column[moving] = np.arange(len(moving))
    later = np.repeat(np.arange(held), np.diff(shapes.touch_start))
    near = (
        ("robots", "contacts", held, len(later), shapes.reach), "blocks", len(table), len(moving),
        column, ANNEALING.outlier_sd**2, NEIGHBORS.damping, NEIGHBORS.longest_step,
    )  # fmt: skip
    search = (
        "sphere", CANDIDATES.rounds, CANDIDATES.merge_every, CANDIDATES.most, CANDIDATES.settled,
        CANDIDATES.alike, CANDIDATES.damping, CANDIDATES.longest_step, CANDIDATES.distinct,
        CANDIDATES.extension, CANDIDATES.worst,
    )  # fmt: skip
    robots = zip(*state, shapes.turn_sd, shapes.arm, strict=True)
    text = [
        f"enum {{ ROUNDS = {NEIGHBORS.rounds} }};",
        f"static const float SETTLED = {_c(NEIGHBORS.settled)};",
        _array("const struct row", "rows", rows),
        _array("const struct stance", "stances", stances),
        _array("const struct block", "blocks", table),
        _array("struct held", "robots", robots),
        _array("const struct contact", "contacts", np.column_stack([later, shapes.touch])),
        _array("const vec", "sphere", SPHERE),
        f"static struct neighborhood near = {_c(near)};",
        f"static const struct block joiner = {_c(table[-1])};",
        f"static const struct search search = {_c(search)};",
    ]
    return "\n".join(text)


def _held(log: SensingLog, place: Reals, count: int) -> LocalLayers:
    """Let a robot hold the lines of the last robot and of those nearest to it."""
    header, *entries = log_entries(log)
    lines = [parse_robot(line_text(entry)) for entry in entries]
    sharing: list[set[int]] = [mentioned(line) for line in lines]
    for robot, others in enumerate([*sharing]):
        for other in others:
            sharing[other].add(robot)
    last = len(lines) - 1
    near, ring = {last: None}, {last}
    while ring and len(near) <= count:
        ring = {other for robot in ring for other in sharing[robot]} - near.keys()
        near |= dict.fromkeys(sorted(ring, reverse=True))  # later ones are the least known
    program = Program(DistributedParams(bits=None), line_text(header))
    known = {}
    for robot in [*near][: count + 1]:
        line = line_bytes(lines[robot], program.docks, None)
        # Steps do not depend on standard deviations of places.
        at = None if robot == last else Whereabouts(place[robot], np.zeros(3), 0.0)
        known[robot] = Known(line=line, place=at, sharing=sharing[robot])
    return LocalSwarm(program, known).layers


def _tables(block: Block) -> tuple[list[Any], list[Any]]:
    """List the rows of a block, and its stances from the earliest one of a row on."""
    odometry = block.rows.odometry
    row, stance, part = block.rows.noisy_arms()[0]
    start = np.searchsorted(row, np.arange(len(block)))
    first, final = stance[start].min(), odometry.final[block.rows.robot[0]]
    turn_sd = odometry.turn_sd[:, [0, 0, 1]]
    stances = [(odometry.reached[s], turn_sd[s]) for s in range(first, final + 1)]
    kind, real = block.number[:, KIND], block.real
    other = np.zeros(len(block), int)
    paired = kind != COORDINATE
    other[paired] = block.partners[block.number[paired, MEMBER] - 1]
    rows = [
        (
            real[a, AXIS : AXIS + 3], real[a, ARM : ARM + 3], part[start[a]],
            real[a, OTHER_ARM : OTHER_ARM + 3], real[a, VALUE], real[a, OWN_VARIANCE],
            real[a, VARIANCE], kind[a], other[a], stance[start[a]] - first,
            a - block.number[a, FIRST],
        )
        for a in range(len(block))
    ]  # fmt: skip
    return rows, stances


def _limit(name: str) -> int:
    """Read a size of memory from robot.h."""
    [found] = re.findall(rf"\b{name} = (\d+)", HEADER.read_text())
    return int(found)


def _check(**needed: int) -> None:
    for name, count in needed.items():
        if count > _limit(name):
            raise ValueError(f"{name} of robot.h is {_limit(name)}; this structure needs {count}")


def _array(kind: str, name: str, items: Iterable[Any]) -> str:
    body = ",\n".join(f"    {_c(item)}" for item in items)
    return f"static {kind} {name}[] = {{\n{body},\n}};"


def _c(value: Any) -> str:  # noqa: ANN401 - numbers, names and what is made of them
    """Write a value in C; numbers are exact."""
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence | np.ndarray):
        return f"{{{', '.join(map(_c, value))}}}"
    if isinstance(value, int | np.integer):
        return str(value)
    return "NAN" if np.isnan(value) else f"{float(np.float32(value)).hex()}f"
