"""Cases of the method `relax`: a swarm moves by a force and an integrator, and is measured.

Positions, steps and measures repeat to the byte; times do not, and are the cost of the case alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.base.progress import Advance, ignore
from tiswarm.base.robot import Robot
from tiswarm.compute import backend
from tiswarm.engine import laws
from tiswarm.engine.forces import MovingSwarm
from tiswarm.engine.relax import RelaxResult
from tiswarm.engine.start import Ball, PlacedSwarm, are_connected, dock_pairs, place
from tiswarm.localization.relax import RelaxParams
from tiswarm.scenario.expansion import Case

_MOST_STEPS_AT_ONCE = 1000
"""Steps between two reports of progress."""

_SEEDS = 2**31
"""Number of seeds that the noise of an integrator can have."""


@dataclass(frozen=True, kw_only=True)
class SwarmResult:
    """What a swarm did: tables and scores of a case."""

    tables: Mapping[str, pd.DataFrame]
    scores: Mapping[str, float | int]


class StudiedSwarm:
    """The swarm of a case, on the device."""

    def __init__(self, case: Case) -> None:
        """Place the robots, and take a first step, which compiles the kernels.

        Forces that diverge in it do so again as the swarm moves.

        Raises:
            InputError: a function of a user does not compile, or returns NaN.
        """
        params = case.settings.localization
        assert isinstance(params, RelaxParams)  # noqa: S101 - the caller chooses such cases
        self._params = params
        self._seed = case.seed % _SEEDS
        self._robot: Robot = Ball() if params.body == "ball" else case.settings.robot
        start = params.start
        self._start = place(
            case.settings.robots,
            case.seed,
            robot=self._robot,
            pitch=start.pitch,
            jitter=start.jitter,
            turned=start.turned,
            band=start.contact_band,
        )
        asked = laws.numbers_of(params.force, params.integrator)
        numbers = {**asked, **params.parameters}
        force = laws.in_place_of("force", params.force)
        self._options: dict[str, Any] = {"max_step": params.max_step, "seed": self._seed}
        if force is None:
            gains = ("attraction_gain", "repulsion_gain", "ramp")
            self._options |= {name: numbers.pop(name) for name in gains}
        self._options["parameters"] = numbers
        self._swarm = MovingSwarm(
            self._start.position,
            self._start.orientation_wxyz,
            self._start.contacts,
            robot=self._robot,
            force=force,
            integrator=laws.in_place_of("integrator", params.integrator),
            cutoff=params.cutoff,
            running=backend.device(),
        )
        try:
            self._swarm.relax(steps=1, **self._options)
        except InputError as error:
            if error.path is not None:
                raise

    def move(self, advance: Advance = ignore) -> tuple[list[RelaxResult], Ints]:
        """Take all steps; return the result at each stored step, and these steps.

        The number of robot steps is reported as they are taken.

        Raises:
            InputError: the forces diverge, or a function of a user returns NaN.
        """
        params = self._params
        robots = len(self._start.position)
        every = params.trajectory.every if params.trajectory else _MOST_STEPS_AT_ONCE
        results = [self._swarm.relax(steps=0, **self._options)]
        taken = [0]
        while taken[-1] < params.steps:
            steps = min(every, params.steps - taken[-1])
            results.append(self._swarm.relax(steps=steps, resume=len(taken) > 1, **self._options))
            taken.append(taken[-1] + steps)
            advance(steps * robots)
        return results, np.array(taken)

    def measure(self, results: list[RelaxResult], taken: Ints) -> SwarmResult:
        """Tabulate and score the swarm at its last step."""
        end = results[-1]
        last = self._start._replace(position=end.position)
        moves = np.concatenate([result.largest_move for result in results])
        robots = pd.DataFrame({"robot": np.arange(len(last.position))})
        robots[["x_R", "y_R", "z_R"]] = last.position
        robots[["qw", "qx", "qy", "qz"]] = last.orientation_wxyz
        robots["moved_R"] = np.linalg.norm(last.position - self._start.position, axis=1)
        ends = last.contacts[:, [0, 2]].ravel()
        robots["contacts"] = np.bincount(ends, minlength=len(robots))
        robots["overlap_R"] = self._overlap(last)
        contacts = pd.DataFrame(
            last.contacts, columns=["robot", "dock", "other_robot", "other_dock"]
        )
        docks = pd.DataFrame(
            np.asarray(self._robot.dock_offset_body), columns=["x_R", "y_R", "z_R"]
        )
        tables = {
            "robots": robots,
            "docks": docks,
            "contacts": contacts,
            "moves": pd.DataFrame({"step": np.arange(1, len(moves) + 1), "largest_move_R": moves}),
        }
        if self._params.trajectory is not None:
            tables["trajectory"] = _trajectory(results, taken, self._params.trajectory.robots)
        scores = {
            "joined": len(robots),
            "settled": int(moves[-1] < self._params.settled_below),
            "last_move_R": float(moves[-1]),
            "greatest_overlap_R": float(robots["overlap_R"].max()),
            "contact_gap_R": self._contact_gap(last),
            "moved_R": _rms(robots["moved_R"].to_numpy()),
            "list_builds": sum(result.list_builds for result in results),
        }
        return SwarmResult(tables=tables, scores=scores)

    @property
    def robot_steps(self) -> int:
        """Steps of all robots together."""
        return len(self._start.position) * self._params.steps

    def _overlap(self, placed: PlacedSwarm) -> Reals:
        """Return by how much a dock of each robot is nearer than D to one not connected, (N,)."""
        spacing = self._robot.spacing
        pairs, distance = dock_pairs(placed, self._robot, spacing)
        docks = len(self._robot.dock_offset_body)
        free = ~are_connected(pairs, placed.contacts, docks)
        overlap = np.zeros(len(placed.position))
        for robot in (pairs[free, 0], pairs[free, 2]):
            np.maximum.at(overlap, robot, spacing - distance[free])
        return overlap

    def _contact_gap(self, placed: PlacedSwarm) -> float:
        """Return the root mean square by which connected docks miss D [R]; NaN without contacts."""
        if not len(placed.contacts):
            return float("nan")
        docks = placed.docks(self._robot)
        first, second = (docks[placed.contacts[:, k], placed.contacts[:, k + 1]] for k in (0, 2))
        return _rms(np.linalg.norm(first - second, axis=1) - self._robot.spacing)


def _trajectory(results: list[RelaxResult], taken: Ints, most: int) -> pd.DataFrame:
    """Tabulate the positions of at most so many robots at the stored steps."""
    robots = len(results[0].position)
    shown = np.arange(0, robots, -(-robots // most))
    center = np.stack([result.position[shown] for result in results])
    table = pd.DataFrame(
        {"step": np.repeat(taken, len(shown)), "robot": np.tile(shown, len(taken))}
    )
    table[["x_R", "y_R", "z_R"]] = center.reshape(-1, 3)
    return table


def _rms(values: Reals) -> float:
    return float(np.sqrt(np.mean(values**2)))
