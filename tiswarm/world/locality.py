"""Whether a local rule is decentralized: each robot decides alone as it does among others.

A structure grows by the rule. Each climber and each member is asked by itself, too, once all that
it cannot know has changed: places, loads, uncertainty and messages of robots that it does not
touch. It has to choose, keep, say and leave as it does in company.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from tiswarm.base.aliases import AnyInts, Bools
from tiswarm.base.errors import InputError
from tiswarm.base.plugins import PluginError
from tiswarm.base.registry import registered
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.world.growth import GrowthBatch, SteeredGrowth, chosen_by
from tiswarm.world.members import LocalStep, Members
from tiswarm.world.params import StructureParams

_FAR = 9.0
"""Distance from a climber beyond which none of its flips meets a dock [R]."""

_SEED = 0
"""Seed of the changes."""


@backend.exclusive()
def compare_alone(
    params: StructureParams, *, robots: int, seeds: Sequence[int], robot: RobotGeometry
) -> int:
    """Grow structures by a local rule, and let each robot decide alone, too.

    Args:
        params: Settings of the structures; their robots know the truth.
        robots: Robots in each structure.
        seeds: One seed a structure.
        robot: The robots' shape.

    Returns:
        Decisions that were compared.

    Raises:
        InputError: the rule is not local.
        PluginError: a robot decides otherwise by what it cannot know.
    """
    rule = params.rule
    if not getattr(rule, "is_local", False):
        problem = f"{rule.name} sees all robots; register it with local=True"
        raise InputError(problem, argument="rule")
    backend.processor()
    batch = GrowthBatch([params] * len(seeds), robots, seeds, robot, None, None)
    compared = _Compared(rule)
    batch.rule = compared.watched()
    steered = SteeredGrowth(batch)
    change = np.random.default_rng(_SEED)
    while len(steered.observe().stance):
        step = steered.observe()
        alone = [
            _climber_alone(rule, batch, steered, row, change) for row in range(len(step.stance))
        ]
        step = steered.observe_again()
        choice = chosen_by(rule, step)
        together = [(int(choice[row]), step.memory[row].tolist()) for row in range(len(choice))]
        for row, (before, after) in enumerate(zip(together, alone, strict=True)):
            compared.note("choose", int(step.robot[row]), before, after)
        steered.step(choice)
    return compared.count


class _Compared:
    """Decisions of robots in company and alone."""

    def __init__(self, rule: Any) -> None:  # noqa: ANN401 - settings of any rule
        self._rule = rule
        self.count = 0

    def watched(self) -> SimpleNamespace:
        """Return what a batch takes as the rule of its members: it also lets each act alone."""
        shown = {"name": self._rule.name, "is_local": True}
        for name in ("memory", "message", "rounds_after"):
            shown[name] = getattr(self._rule, name, 0)
        if hasattr(self._rule, "act"):
            shown["act"] = self._act
        return SimpleNamespace(**shown)

    def _act(self, members: Members) -> Bools:
        alone = []
        for row in range(len(members.age)):
            one = members.alone(row)
            leaves = _leavers(self._rule.act(one), one)
            alone.append((bool(leaves[0]), one.memory[0].tolist(), str(one.say[0].tolist())))
        leaving = _leavers(self._rule.act(members), members)
        for row, after in enumerate(alone):
            before = (
                bool(leaving[row]),
                members.memory[row].tolist(),
                str(members.say[row].tolist()),
            )
            self.note("act", int(members.robot[row]), before, after)
        return leaving

    def note(self, method: str, robot: int, together: object, alone: object) -> None:
        """Count a decision.

        Raises:
            PluginError: the robot decides otherwise alone.
        """
        self.count += 1
        if together == alone:
            return
        file = registered("rule")[self._rule.name].plugin.file
        problem = (
            f"{file}: {self._rule.name}.{method} is not local: robot {robot} decides {together} "
            f"among others, and {alone} alone once what it cannot know had changed; let each row "
            "follow from its own row, and keep nothing but memory"
        )
        raise PluginError(problem, f"{problem}\n")


def _leavers(returned: object, members: Members) -> Bools:
    """Return who leaves, shape (P,), as `act` said."""
    nobody = np.zeros(len(members.age), np.bool_)
    return nobody if returned is None else np.asarray(returned, np.bool_)


def _climber_alone(
    rule: Any,  # noqa: ANN401 - settings of any rule
    batch: GrowthBatch,
    steered: SteeredGrowth,
    row: int,
    change: np.random.Generator,
) -> tuple[int, list[float]]:
    """Let one climber choose alone, while all that it cannot know is changed; put that back."""
    step = steered.observe()
    number = int(step.structure[row])
    unknown = _robots_but(batch, step.touching[row])
    # A climber that touches nobody is as uncertain as the robot that it touched last.
    walked = batch.walks.stances.touching[step.slot[row], : step.stance[row] + 1]
    unmet = _robots_but(batch, walked)
    arrays = (batch.arrays.dock, batch.sd, batch.sensed, batch.members.said)
    saved = [array.copy() for array in arrays]
    dock = batch.arrays.dock[number]
    is_far = np.linalg.norm(dock - step.center[row], axis=1) > _FAR
    is_far &= np.repeat(np.isin(np.arange(batch.robots), unknown), len(dock) // batch.robots)
    dock[is_far] += change.normal(size=(int(is_far.sum()), 3))
    batch.sd[number, unmet] = change.random(len(unmet))
    batch.members.said[number, unknown] = change.normal(size=batch.members.said.shape[2:])
    batch.sensed[:] = change.normal(size=batch.sensed.shape)
    one = LocalStep(steered.observe_again(), np.array([row]))
    choice = int(np.asarray(rule.choose(one))[0])
    for array, before in zip(arrays, saved, strict=True):
        array[:] = before
    return choice, one.memory[0].tolist()


def _robots_but(batch: GrowthBatch, docks: AnyInts) -> AnyInts:
    """List the robots that have none of some docks n i + k, -1 for none."""
    touched = docks[docks >= 0] // batch.robot.dock_count
    return np.setdiff1d(np.arange(batch.robots), touched)
