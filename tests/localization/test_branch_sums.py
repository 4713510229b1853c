"""Cards add up forces on branches in parallel; one thread of a processor walks along them."""

import dataclasses

import numpy as np
import pytest

from tests.structures import NOISY
from tiswarm.compute import backend
from tiswarm.localization.chains.annealer import annealer_of
from tiswarm.localization.chains.arrays import BlockProgress, BodyMotion, SubtreeMotion
from tiswarm.localization.chains.card_kernels import RUN, STEPS_A_LAUNCH
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.settings import JointParams
from tiswarm.sensing import observe

PARAMS = JointParams(chains=46, steps=40, hold_steps=20, robust=False, end_sigma=0.1)


@pytest.fixture
def logs(tall_towers):
    """What the robots of three towers sensed."""
    return [observe(h, NOISY) for h in tall_towers]


@pytest.fixture
def as_card(monkeypatch):
    """Let annealers take the processor for a card."""

    def start():
        running = dataclasses.replace(backend.start(), arch="vulkan")
        monkeypatch.setattr(backend, "current", lambda: running)

    return start


def annealer(logs):
    """Make the annealer of some logs."""
    return annealer_of(logs, [PARAMS] * len(logs), [pose_problem(log, PARAMS) for log in logs])


def test_cards_take_the_steps_of_processors(logs, as_card):
    """But for rounding, through rows that serve one step and rows that serve several."""
    here = annealer(logs)
    as_card()
    there = annealer(logs)
    assert there.on_card > here.on_card
    assert len(there.swarm.position.to_numpy()) > RUN * RUN

    for until in (1, 2, 9):
        here.advance(until)
        there.advance(until)

        place, other = (a.swarm.position.to_numpy() for a in (here, there))
        np.testing.assert_allclose(other, place, rtol=0, atol=1e-9)
    assert there.blocks.progress[0, BlockProgress.TAKEN] == 9


@pytest.mark.parametrize("scale", [1.0, 3000.0])
def test_sums_on_branches_are_as_precise_as_stated(logs, as_card, scale):
    """2^-36 R for each robot, however far apart robots are; masses, too."""
    as_card()
    sums = annealer(logs)
    sums.memory.refill(sums.swarm.position, scale * sums.swarm.position.to_numpy())

    sums.advance(1)

    of_robots = sums.by_robot(sums.swarm.motion)
    force, mass = of_robots[..., : BodyMotion.MASS], of_robots[..., BodyMotion.MASS]
    motion = sums.trees.motion.to_numpy().reshape(PARAMS.chains, -1, SubtreeMotion.WEIGHT + 1)
    pull = motion[..., : BodyMotion.VELOCITY]
    assert (np.abs(force).max() > 1e3) == (scale > 1.0)
    subtree = 0
    for view, first in zip(sums.views, sums.start[:-1], strict=True):
        tree = view.forest
        member = np.eye(len(tree.parent))
        for k in range(len(tree.parent) - 1, 0, -1):
            member[tree.parent[k]] += member[k]
        own = np.repeat(np.arange(len(tree.parent)), np.diff(tree.first))
        member = member[:, own]
        robots = first + tree.order
        every = np.einsum("tn,cnk->ctk", member, force[:, robots])
        found = pull[:, subtree : subtree + len(tree.parent)]
        rounding = 1e-15 * np.einsum("tn,cnk->ctk", member, np.abs(force[:, robots]))
        bound = 2.0**-36 * member.sum(axis=1)[:, None] + rounding
        assert (np.abs(found[..., :3] - every) <= bound).all()
        weight = motion[:, subtree : subtree + len(tree.parent), SubtreeMotion.WEIGHT]
        masses = np.add.reduceat(mass[:, robots], tree.first[:-1], axis=1)
        np.testing.assert_allclose(found[..., 3], weight * masses, rtol=1e-10)
        subtree += len(tree.parent)


def test_sums_on_branches_do_not_depend_on_company(logs, as_card):
    """Integers add up to the same bits in any order."""
    as_card()
    places = []
    for every in (logs, logs[:1]):
        sums = annealer(every)
        sums.advance(2 * STEPS_A_LAUNCH + 1)
        places.append(sums.by_robot(sums.swarm.position))

    assert places[0][:, : logs[0].robot_count].tobytes() == places[1].tobytes()
