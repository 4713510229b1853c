"""Chains of a whole log, and of what one robot heard, follow the same forces."""

from dataclasses import replace

import numpy as np
import pytest

from tests.localization.online.test_online import LOCAL, fed, lines_of, sensed
from tiswarm.localization.chains.annealer import Annealer
from tiswarm.localization.chains.arrays import BodyMotion
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.chains.views import view_of
from tiswarm.localization.distributed.annealing import view_near
from tiswarm.localization.distributed.settings import DistributedParams
from tiswarm.localization.methods import centered
from tiswarm.localization.settings import JointParams

PARAMS = JointParams(chains=2, steps=20, hold_steps=1, robust=False)


def stepped(view):
    """Take one step; return the forces and the masses, and how far each robot moved."""
    annealer = Annealer([view], seed=3, hold=1)
    annealer.advance(1)
    motion = annealer.by_robot(annealer.swarm.motion)
    moved = annealer.by_robot(annealer.swarm.position) - view.begin
    return motion[..., : BodyMotion.VELOCITY], np.linalg.norm(moved, axis=2)


@pytest.fixture(scope="module")
def whole(towers):
    """View of a noisy tower, from near where its robots are."""
    log = centered(sensed(towers[0], "walks"))
    place = towers[0].position - towers[0].position[0]
    start = place + 0.2 * np.random.default_rng(0).normal(size=(2, *place.shape))
    start[:, 0] = 0.0
    return view_of(log, PARAMS, pose_problem(log, PARAMS), start)


@pytest.mark.parametrize("kind", ["walks", "directions", "ranges"])
def test_what_a_robot_heard_pulls_as_the_log_does(towers, kind):
    """Blocks of all robots are the links and planes of the log, whoever lays them out."""
    log = centered(sensed(towers[0], kind))
    params = DistributedParams(chains=2, robust=False)
    layers = fed(lines_of(log), replace(LOCAL, robust=False))._layers  # noqa: SLF001
    every = np.arange(log.robot_count)
    heard = view_near(layers, every, layers.neighborhood(every), params)
    start = heard.begin + 0.2 * np.random.default_rng(1).normal(size=heard.begin.shape)
    start[:, 0] = 0.0

    expected = view_of(log, PARAMS, pose_problem(log, PARAMS), start)
    found = replace(heard, begin=start, sigma=expected.sigma)

    np.testing.assert_allclose(stepped(found)[0], stepped(expected)[0], atol=1e-9)


def test_robots_that_do_not_move_pull_others(whole):
    """They stay where they are, in no subtree either, and pull the others as before."""
    moves = whole.moves & (np.arange(len(whole.moves)) % 3 > 0)
    some = replace(whole, moves=moves, stops=whole.stops | ~moves[:, None])

    (force, moved), (all_forces, _) = stepped(some), stepped(whole)

    np.testing.assert_array_equal(force[:, moves], all_forces[:, moves])
    assert (moved[:, moves] > 0.0).all()
    assert (moved[:, ~moves] == 0.0).all()


def test_short_runs_have_the_same_bits(whole):
    """Arrays on the host change the time alone."""
    short, usual = (Annealer([whole], seed=3, hold=1, is_short=s).run() for s in (True, False))

    assert short[0].last.tobytes() == usual[0].last.tobytes()
