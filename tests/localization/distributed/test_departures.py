"""Robots that leave neither send nor hear; the others know, and localize on."""

from dataclasses import replace

import numpy as np
import pytest

from tests.localization.online.test_online import lines_of
from tests.structures import NOISY
from tiswarm.base.robot import RobotGeometry
from tiswarm.localization.distributed.method import PeerSwarm, localize
from tiswarm.localization.distributed.settings import DistributedParams
from tiswarm.localization.methods import centered
from tiswarm.records.sensing_format import parse_header, parse_robot
from tiswarm.sensing import observe
from tiswarm.world.growth import grow
from tiswarm.world.params import DepartureParams, TowerParams

QUICK = DistributedParams(chains=2, steps=40)


@pytest.fixture(scope="module")
def history():
    """Tower of 16 robots, of which some leave or fall."""
    params = TowerParams(departures=DepartureParams(rate=0.4, kind="leave"))
    [history] = grow(params, robots=16, seeds=[5], robot=RobotGeometry())
    return history


@pytest.fixture(scope="module")
def log(history):
    """What its robots sensed."""
    return observe(history, NOISY)


def joined(log, robots, settings=QUICK):
    """Let some robots of a log join, before any leaves."""
    header, *lines = lines_of(centered(replace(log, robot_id=np.arange(log.robot_count))))
    swarm = PeerSwarm(parse_header(header), settings)
    for line in [line for line in lines if '"event"' not in line][:robots]:
        swarm.join(parse_robot(line))
    return swarm


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"channel": "radio", "loss": 0.1},
        {"solver": "base"},
    ],
)
def test_robots_that_remain_are_localized_although_others_left(history, log, settings):
    """The root mean square of their errors is below a dock radius."""
    estimate = localize(log, replace(QUICK, **settings))

    from_anchor = estimate.position - estimate.position[0]
    error = np.linalg.norm(from_anchor - (history.position - history.position[0]), axis=1)
    remains = ~history.is_gone
    assert 4 <= remains.sum() <= 12
    assert np.sqrt((error[remains] ** 2).mean()) < 1.0


def test_a_robot_that_left_neither_sends_nor_hears(log):
    """Its bytes stay as they were, while those of others go on."""
    swarm = joined(log, 6)
    swarm.leave([3])
    before = swarm.channel.sent[3], swarm.channel.heard[3]

    swarm.review()

    assert (swarm.channel.sent[3], swarm.channel.heard[3]) == before
    assert 3 not in swarm.channel.present


@pytest.mark.parametrize("channel", ["touch", "radio"])
def test_all_in_reach_hear_of_a_robot_that_left(log, channel):
    """Whoever touched it says so; nobody asks it, and its place is free for others."""
    swarm = joined(log, 6, replace(QUICK, channel=channel))
    sent = sum(swarm.channel.sent)

    swarm.leave([5])

    assert all(swarm.robots[number].memory.has_left(5) for number in range(5))
    assert sum(swarm.channel.sent) > sent
    assert not any(5 in swarm.robots[number].children for number in range(5))


def test_algorithm_1_counts_no_messages_of_robots_that_left(history, log):
    """The same structure with all robots costs more."""
    settings = DistributedParams(scheme="algorithm-1", channel="radio")
    everyone = replace(log, gone=log.gone[:0], left_after=log.left_after[:0])

    sent = localize(log, settings).traffic["sent"]

    sent_by_all = localize(everyone, settings).traffic["sent"]
    assert (sent <= sent_by_all).all()
    assert (sent < sent_by_all)[history.is_gone].any()
