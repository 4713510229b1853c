"""Robots learn ways from messages that come, go by timers, and join while others still send."""

from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.localization.distributed.test_distributed import grown
from tests.structures import NOISY
from tiswarm.base.robot import RobotGeometry
from tiswarm.localization.distributed import wire
from tiswarm.localization.distributed.channel import Channel, Message
from tiswarm.localization.distributed.routes import ROUTE
from tiswarm.localization.distributed.settings import DistributedParams
from tiswarm.localization.methods import localize_many
from tiswarm.sensing import observe
from tiswarm.world.growth import grow
from tiswarm.world.params import BridgeParams, CantileverParams, TowerParams

QUICK = {"chains": 0}

GRAPHS = st.integers(2, 10).flatmap(
    lambda n: st.tuples(*(st.sets(st.integers(0, i - 1), min_size=1) for i in range(1, n)))
)
"""By robot after the first, the earlier ones that it touches."""


@pytest.fixture(scope="module")
def log(towers):
    """Log of a noisy tower."""
    return observe(towers[0], NOISY)


class _Swarm:
    """A channel whose robots write down which parts they heard."""

    def __init__(self, links, **given_settings):
        self.heard = []
        params = DistributedParams(routes="learned", **given_settings)
        self.channel = Channel(params, self._hear)
        for touching in [set(), *links]:
            self.channel.join(touching)

    def _hear(self, number, message):
        self.heard += [number] * (number in message.parts)
        return message

    def send(self, sender, *receivers):
        """Send a message, and return how often each robot heard a part of its own, and hops."""
        before = sum(self.channel.messages)
        self.heard = []
        parts = {receiver: b"%d" % receiver for receiver in receivers}
        self.channel.send(Message("place", sender, b"", parts))
        self.channel.settle()
        return sorted(self.heard), sum(self.channel.messages) - before


def _distance(links, start, end):
    """Count contacts from one robot to another, by breadth-first search."""
    touching = [set(), *links]
    contacts, queue = {start: 0}, deque([start])
    while queue:
        robot = queue.popleft()
        for neighbor in range(len(touching)):
            is_near = neighbor in touching[robot] or robot in touching[neighbor]
            if is_near and neighbor not in contacts:
                contacts[neighbor] = contacts[robot] + 1
                queue.append(neighbor)
    return contacts[end]


@settings(max_examples=60)
@given(GRAPHS, st.data())
def test_without_routes_a_message_finds_its_receivers_and_an_answer_its_way_back(links, data):
    """Each receiver hears its part once; answers take as many hops as there are contacts."""
    robots = len(links) + 1
    sender = data.draw(st.integers(0, robots - 1))
    others = [robot for robot in range(robots) if robot != sender]
    receivers = data.draw(st.sets(st.sampled_from(others), min_size=1))
    swarm = _Swarm(links)

    heard, _ = swarm.send(sender, *receivers)

    assert heard == sorted(receivers)
    for receiver in receivers:
        assert swarm.send(receiver, sender) == ([sender], _distance(links, sender, receiver))


@settings(max_examples=40)
@given(
    GRAPHS,
    st.sampled_from([
        {"channel": "radio", "radio_reach": "ranged"}, {"delay": 3},
        {"loss": 0.2, "retries": 100}, {"loss": 0.3, "burst": 3.0, "retries": 100},
    ]),
    st.data(),
)  # fmt: skip
def test_over_any_channel_each_part_comes_once(links, given_settings, data):
    """Robots that send to random others, one after the other, all are heard."""
    swarm = _Swarm(links, **given_settings)
    robots = st.integers(0, len(links))

    for sender in data.draw(st.lists(robots, min_size=1, max_size=5)):
        receivers = data.draw(st.sets(robots, min_size=1)) - {sender}
        heard, _ = swarm.send(sender, *receivers)
        assert heard == sorted(receivers)


def test_a_message_goes_around_a_robot_that_left():
    """In a ring of five, the way over the robot that left is found anew over the other side."""
    swarm = _Swarm([{0}, {1}, {2}, {0, 3}])
    swarm.send(0, 2)
    assert swarm.send(2, 0) == ([0], 2)

    swarm.channel.leave([1])

    heard, hops = swarm.send(2, 0)
    assert heard == [0]
    assert hops == 3


def test_a_message_to_nobody_in_reach_ends():
    """It is flooded, and no robot passes it on twice."""
    swarm = _Swarm([{0}, {0, 1}, set()])

    assert swarm.send(0, 3) == ([], 4)  # both neighbors hear it, and pass it to each other


def test_routes_count_as_memory():
    """A robot that heard of two senders holds two routes; one that touches all needs none."""
    swarm = _Swarm([{0}, {1}])
    swarm.send(0, 2)
    swarm.send(1, 2)

    assert swarm.channel.memory.tolist() == [0, ROUTE, 2 * ROUTE]


def test_learned_routes_change_no_estimate(log):
    """What robots hear is the same, they only send more."""
    known, learned = localize_many(
        [log] * 2, [DistributedParams(**QUICK), DistributedParams(routes="learned", **QUICK)]
    )

    np.testing.assert_allclose(learned.position, known.position, atol=1e-3 * log.dock_radius)
    assert learned.traffic["sent"].sum() > known.traffic["sent"].sum()


def test_timers_that_never_run_out_change_nothing(log):
    """All that robots send, and where they take themselves to be, is that of perfect timers."""
    perfect, timed = localize_many(
        [log] * 2, [DistributedParams(**QUICK), DistributedParams(timer=100_000, **QUICK)]
    )

    np.testing.assert_array_equal(timed.position, perfect.position)
    for name, counts in perfect.traffic.items():
        np.testing.assert_array_equal(timed.traffic[name], counts)


@pytest.mark.parametrize("timer", [1, 4, 16])
def test_robots_that_ask_too_soon_still_end(log, timer):
    """Answers and walks that come late are no new ones; robots only send more."""
    perfect, hasty = localize_many(
        [log] * 2, [DistributedParams(**QUICK), DistributedParams(timer=timer, **QUICK)]
    )

    assert np.isfinite(hasty.position).all()
    assert hasty.traffic["sent"].sum() > perfect.traffic["sent"].sum()


@settings(max_examples=5, deadline=None)
@given(
    timer=st.integers(1, 40),
    join_rounds=st.integers(1, 60),
    loss=st.sampled_from([0.0, 0.3]),
)
def test_all_three_together_end(log, timer, join_rounds, loss):
    """Without known routes, perfect timers and one join at a time, all have a place."""
    params = DistributedParams(
        routes="learned", timer=timer, join_rounds=join_rounds, loss=loss, **QUICK
    )

    (estimate,) = localize_many([log], [params])

    assert np.isfinite(estimate.position).all()


class _Logs(list):
    """Logs that a failing example does not print."""

    def __repr__(self):
        return f"{len(self)} logs"


@pytest.fixture(scope="module")
def many_logs():
    """Noisy logs of towers, cantilevers, and bridges whose sides meet."""
    kinds = (TowerParams(), CantileverParams(), BridgeParams(gap=20.0))
    return _Logs(
        observe(history, NOISY)
        for kind in kinds
        for history in grow(kind, robots=30, seeds=[1000, 1001, 1002], robot=RobotGeometry())
    )


@pytest.mark.trial
@settings(max_examples=60, deadline=None)
@given(
    number=st.integers(0, 8),
    given_settings=st.fixed_dictionaries({
        "routes": st.sampled_from(["known", "learned"]),
        "timer": st.sampled_from([None, 1, 8, 60]),
        "join_rounds": st.sampled_from([None, 1, 3, 10, 30]),
        "loss": st.sampled_from([0.0, 0.1, 0.6]),
        "retries": st.sampled_from([0, 5]),
        "solver": st.sampled_from(["keeper", "base", "joiner"]),
        "reviews": st.integers(0, 3),
    }),
)  # fmt: skip
def test_no_order_of_messages_goes_on_without_end(many_logs, number, given_settings):
    """Walks and shifts went around, where bodies join that touch each other already."""
    params = DistributedParams(**given_settings, **QUICK)

    (estimate,) = localize_many([many_logs[number]], [params])

    assert np.isfinite(estimate.position).all()
    # None goes around: with 60 % lost, each is sent several times.
    assert estimate.traffic["messages"].sum() < 1_000_000


def test_robots_join_while_others_still_send(log):
    """With a round from join to join, no more rounds pass than robots join; then all ends."""
    one_by_one = grown(log, DistributedParams(**QUICK))
    at_once = grown(log, DistributedParams(join_rounds=1, **QUICK))

    assert at_once.channel.rounds <= log.robot_count < one_by_one.channel.rounds
    at_once.settle()
    assert not at_once.channel.is_busy
    assert np.isfinite(at_once.positions).all()


@pytest.mark.parametrize("walk", range(wire.WALKS))
def test_walks_are_earlier_up_to_half_of_the_numbers_back(walk):
    """Numbers begin anew: three of eight are earlier, one is the same, the others come later."""
    earlier = [(walk - back) % wire.WALKS for back in (1, 2, 3)]

    assert [n for n in range(wire.WALKS) if wire.is_earlier(n, walk)] == sorted(earlier)
