"""Where robots are placed at first, again if they are lost, and at last if nothing ties them."""

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Ints, Reals
from tiswarm.compute.math import normal
from tiswarm.localization.chains.problem import Problem
from tiswarm.localization.chains.settings import ANNEALING
from tiswarm.measurements.contacts import stand_across
from tiswarm.records.sensing_log import SensingLog

_TINY = 1e-9


def initial_guess(log: SensingLog, problem: Problem, seed: int, chains: int) -> Reals:
    """Place each robot where its contacts with robots already placed meet, give or take one R.

    Robots follow each other along the chains of contacts, from the first robot of each part on.
    Unless the direction is measured in which a dock lies from the one it touches, the guess takes
    robots to stand across from each other; otherwise thousands would begin in a heap. A robot
    with ranges to robots already placed moves to where these meet best.

    Returns:
        Positions, other ones for each chain [R], shape (chains, N, 3).
    """
    robot = np.arange(log.robot_count)
    draw = 3 * np.arange(chains)[:, None, None] + np.arange(3)
    guess = normal(seed, "first guess", robot[:, None], draw)
    across = _across(problem)
    toward = np.concatenate([across, -across])
    partner = np.concatenate([problem.other, problem.robot])
    rows = _rows(np.concatenate([problem.robot, problem.other]), log.robot_count)
    is_range = np.tile(~problem.rows.is_contact[problem.link] & ~problem.is_offset, 2)
    length = np.tile(problem.length, 2)
    place, is_measured = problem.sensed_place()
    guess[:, 0] = log.anchor_position / log.dock_radius
    is_placed = robot == 0
    # Nearest first along the contacts: each robot then finds neighbors that are placed.
    for i in np.argsort(problem.reach(), kind="stable").tolist():
        if is_placed[i]:
            continue
        mine = rows[i][is_placed[partner[rows[i]]]]
        met = guess[:, partner[mine]] - toward[mine] if len(mine) else guess[:, :1]
        guess[:, i] += met.mean(axis=1)
        ranged = mine[is_range[mine]]
        for _ in range(ANNEALING.trilateration if len(ranged) else 0):
            away = guess[:, i, None] - guess[:, partner[ranged]]
            short = length[ranged] / np.maximum(np.linalg.norm(away, axis=2), _TINY)
            guess[:, i] += ((short - 1.0)[:, :, None] * away).mean(axis=1)
        guess[:, i, is_measured[i]] = place[i, is_measured[i]]
        is_placed[i] = True
    return guess


def reinitialize_lost(problem: Problem, position: Reals, yaw: Reals) -> int:
    """Place robots anew that most of their contacts have lost: at the median of these contacts.

    While the temperature is high others may move in front of a robot; its contacts are then too far
    away to pull it back.

    Args:
        problem: Measurements of the structure.
        position: Read and written [R], shape (chains, N, 3).
        yaw: Yaw corrections [rad], shape (chains, N).

    Returns:
        How many robots moved.
    """
    gap = np.sqrt(problem.by_link(problem.residual(position, yaw) ** 2))
    count = np.bincount(problem.robot, minlength=position.shape[1])
    across = _across(problem)
    is_measured = problem.sensed_place()[1]
    rows = _rows(problem.robot, len(count))
    moved = 0
    sd = np.sqrt(problem.by_link(problem.variance))
    far = np.maximum(ANNEALING.lost, ANNEALING.lost_sd * sd)
    for here, missed in zip(position, gap > far, strict=True):
        # A single lost contact may be wrong; the majority of them is not.
        lost = np.bincount(problem.robot[missed], minlength=len(count)) > 0.5 * count
        for i in np.flatnonzero(lost).tolist():
            mine = rows[i]
            # The median: one wrong contact does not take the robot away from all others.
            met = np.median(here[problem.other[mine]] - across[mine], axis=0)
            here[i] = np.where(is_measured[i], here[i], met)
            moved += 1
    return moved


def place_disconnected(mean: Reals, problem: Problem) -> tuple[Reals, Reals]:
    """Place each part that nothing ties to the anchor where its first robot may have joined.

    That robot touched one that was there before, and robots join where the last ones did. The
    annealer keeps such parts away from all others, and shapes them alone.

    Args:
        mean: Mean position of each chain [R], shape (chains, N, 3).
        problem: Measurements of the structure.

    Returns:
        Positions with such parts placed [R], shape (chains, N, 3), and their mean square error, 0
        for all other robots [R^2], shape (chains, N).
    """
    placed, square = mean.copy(), np.zeros(mean.shape[:2])
    firsts = np.unique(problem.part, return_index=True)[1]
    for first in np.sort(firsts[problem.untied[firsts]]).tolist():
        window = slice(max(first - ANNEALING.join_window, 0), first)
        earlier = placed[:, window]
        weight = np.exp(np.arange(1 - earlier.shape[1], 1) / ANNEALING.join_memory)
        weight /= weight.sum()
        place = weight @ earlier
        away = (earlier - place[:, None]) @ problem.loose[first]
        part = problem.part == problem.part[first]
        placed[:, part] += ((place - placed[:, first]) @ problem.loose[first])[:, None]
        # The earlier ones may be of disconnected parts, too.
        uncertain = ANNEALING.join_variance * (away**2).sum(axis=2) + square[:, window]
        square[:, part] = (uncertain @ weight)[:, None]
    return placed, square


def set_apart(problem: Problem, position: Reals) -> Reals:
    """Move parts that nothing ties to the world to where no other part can be, shape (N, 3)."""
    first = np.unique(problem.part, return_index=True)[1][problem.part]
    away = (problem.sensed_place()[0] - position)[first]
    moved: Reals = position + (problem.loose @ away[:, :, None])[:, :, 0]
    return moved


def _rows(robot: Ints, robots: int) -> list[NDArray[np.intp]]:
    """List for each robot where it stands in an array of robots."""
    order = np.argsort(robot, kind="stable")
    return np.split(order, np.searchsorted(robot[order], np.arange(1, robots)))


def _across(problem: Problem) -> Reals:
    """From the center of the other robot back to that of one across from it [R], shape (C, 3).

    Of an offset it is measured.
    """
    return stand_across(problem.shift, is_contact=problem.is_final & ~problem.is_offset)
