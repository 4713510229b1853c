"""Robots localize themselves by their own rows and by what they hear, and bytes are counted."""

import copy
import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.localization.online.test_online import LOCAL, lines_of
from tests.structures import NOISY, silent, with_directions, with_fixes, with_ranges
from tiswarm.base.errors import InputError
from tiswarm.base.robot import RobotGeometry
from tiswarm.localization.distributed.channel import (
    ACKNOWLEDGMENT,
    ADDRESS,
    HEADER,
    Channel,
    Message,
    pause,
)
from tiswarm.localization.distributed.method import PeerSwarm, PublishedSwarm
from tiswarm.localization.distributed.settings import DistributedParams
from tiswarm.localization.distributed.wire import (
    Reader,
    Writer,
    line_bytes,
    read_line,
    rounding_sd,
    step,
    write_place,
)
from tiswarm.localization.methods import centered, localize_many
from tiswarm.localization.online.tracker import Tracker
from tiswarm.localization.settings import BackPropagation, VirtualForceParams
from tiswarm.records.sensing_format import parse_header, parse_robot
from tiswarm.sensing import observe
from tiswarm.world.growth import grow
from tiswarm.world.params import BridgeParams

QUICK = DistributedParams(chains=2, steps=40)
EXACT = DistributedParams(
    bits=None, hops=1000, asked=1000, robots=1000, chains=0, solver="joiner", channel="radio"
)
"""Settings with which a robot that joins knows all that a tracker knows."""


@pytest.fixture(scope="module")
def log(towers):
    """Log of a noisy tower."""
    return observe(towers[0], NOISY)


def grown(log, params, robots=None):
    """Let robots of a log join."""
    header, *lines = lines_of(centered(replace(log, robot_id=np.arange(log.robot_count))))
    swarm = PeerSwarm(parse_header(header), params)
    for line in lines[:robots]:
        swarm.join(parse_robot(line))
    return swarm


class _Local(Tracker):
    """The local layers of a tracker, which never anneals."""

    def _settle(self, numbers, places=None):
        for number in numbers:
            self._layers.solve_near(number, places)
        return False


def test_robots_that_hear_everything_are_where_the_local_layers_put_them(log):
    """Without losses, rounding and limits, messages change nothing."""
    header, *lines = lines_of(log)
    tracker = _Local(header, LOCAL)
    for line in lines:
        tracker.join(line)

    swarm = grown(log, EXACT)

    state = tracker._layers.state  # noqa: SLF001 - what messages are compared with
    place = np.array([robot.place.position for robot in swarm.robots])
    turn = np.array([robot.place.turn for robot in swarm.robots])
    np.testing.assert_allclose(place, state.position, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(turn, state.turn, rtol=0.0, atol=1e-9)


def test_a_robot_reads_its_own_memory_only(log):
    """All other robots may be spoiled, or the robot be sent away alone: it does the same."""
    swarm = grown(log, QUICK, 12)
    sender, robot = swarm.robots[11], swarm.robots[10]
    message = Message("join", 11, b"", {10: sender.records[11].line})
    alone = pickle.loads(pickle.dumps(robot))  # noqa: S301 - made here
    for other in swarm.robots:
        if other is not robot:
            for known in other.records.values():
                known.line, known.place, known.sharing = b"\xff", None, {3000}

    robot.hear(copy.deepcopy(message))
    alone.hear(message)

    assert robot.outbox
    assert robot.outbox == alone.outbox


def test_a_keeper_solves_until_it_is_out_of_reach(log):
    """The line of a robot goes on to who solved for the one that it touches, or stays there."""
    solvers = []
    far = {"reach": 254, "tenure": 99}
    for settings in ({"reach": 0}, far, {"solver": "joiner"}):
        swarm = grown(log, replace(QUICK, **settings), 16)
        solvers.append({robot.number for robot in swarm.robots if robot.operations})

    assert len(solvers[0]) > 2
    assert solvers[1] == {0}
    assert solvers[2] == {*range(1, len(swarm.robots))}


@pytest.mark.parametrize(("beyond", "receivers"), [(0, [{"task", 7}]), (1, [])])
def test_a_keeper_at_the_limit_of_reach_still_solves(log, beyond, receivers):
    """A reach of n contacts includes n; one contact farther, the host solves itself."""
    swarm = grown(log, replace(QUICK, reach=3, tenure=99), 12)
    host, joiner = swarm.robots[10], swarm.robots[11]
    host.keepers = {7: 3 + beyond}

    host.find_keeper(11, joiner.record.line)

    tasks = [message for message in host.outbox if message.kind == "task"]
    assert [{message.kind, *message.parts} for message in tasks] == receivers


def test_who_moved_a_robot_last_hears_when_another_moves_it(log):
    """It knows where it put the robot, so only the next move is news to it."""
    robot = grown(log, QUICK, 12).robots[11]
    robot.watchers = {3, 5}
    robot.outbox.clear()

    robot.warn(5)
    robot.warn(7)

    receivers = [{*message.parts} for message in robot.outbox]
    assert receivers == [{3}, {5}]


def test_a_base_solves_however_far_it_is(log):
    """A host sends a line to the anchor, though another robot that moved it is nearer."""
    swarm = grown(log, replace(QUICK, solver="base"), 12)

    assert {robot.number for robot in swarm.robots if robot.operations} == {0}
    host, joiner = swarm.robots[10], swarm.robots[11]
    host.keepers = {7: 1}
    host.hear(Message("join", 11, b"", {10: joiner.records[11].line}))
    assert [(each.kind, {*each.parts}) for each in host.outbox] == [("task", {0})]


def test_a_reach_without_keepers_is_refused():
    """It would have no effect."""
    with pytest.raises(ValueError, match="reach is of solver keeper"):
        DistributedParams(solver="base", reach=5)


def test_no_robot_solves_for_more_than_its_tenure(log):
    """All join, and each is solved for once."""
    swarm = grown(log, replace(QUICK, tenure=2), 12)

    kept = [robot.kept for robot in swarm.robots]
    assert max(map(len, kept)) == 2
    assert sorted(number for each in kept for number in each) == [*range(1, 12)]
    assert all(robot.place is not None for robot in swarm.robots)
    assert swarm.solution().traffic["joins"].tolist() == [*map(len, kept)]


def test_a_walk_comes_to_all_robots_that_hang_on_one_before_it_leaves(log):
    """Spans nest along first contacts, and count all robots."""
    swarm = grown(log, replace(QUICK, tenure=2), 12)

    swarm.review()

    spans = [robot.records[robot.number].span for robot in swarm.robots]
    assert sorted(enter for enter, _ in spans) == [*range(12)]
    assert spans[0] == (0, 12)
    for robot in swarm.robots[1:]:
        (enter, leave), (first, last) = spans[robot.number], spans[robot.touching[0]]
        assert first < enter < leave <= last


def test_a_review_moves_what_hangs_on_a_robot(log):
    """All but the first keeper's robots were put aside by one shift, which rows there deny."""
    swarm = grown(log, replace(QUICK, tenure=4), 12)
    before = np.array([robot.place.position for robot in swarm.robots])
    aside = np.array([0.6, 0.0, 0.0])
    for robot in swarm.robots[5:]:
        mine = robot.records[robot.number]
        mine.place = mine.place._replace(position=mine.place.position + aside)
        robot.warn(robot.number)  # as if it had been moved
        swarm._send(robot)  # noqa: SLF001
    swarm.channel.settle()

    for _ in range(3):
        swarm.review()

    after = np.array([robot.place.position for robot in swarm.robots])
    left = np.linalg.norm((after - before)[5:], axis=1).mean()
    assert left < 0.3


def _deaf(swarm, is_deaf):
    """Let the channel lose what a function of listener, sender and round picks, by hand."""
    swarm.channel._hears = lambda now, sender, listener, *_: np.array([  # noqa: SLF001
        not is_deaf(heard, said, now) for said, heard in zip(sender, listener, strict=True)
    ])  # fmt: skip


def test_a_robot_that_heard_of_no_partner_asks_again_in_the_review(towers, log):
    """It hears nothing as it joins, but the robot it touches hears that it hangs on it."""
    header, *lines = lines_of(centered(replace(log, robot_id=np.arange(log.robot_count))))
    swarm = PeerSwarm(parse_header(header), QUICK)
    for line in lines[:12]:
        _deaf(swarm, lambda heard, *_: heard == 11)
        swarm.join(parse_robot(line))
    _deaf(swarm, lambda *_: False)
    alone = swarm.solution()
    assert np.flatnonzero(alone.lost).tolist() == [11]
    assert alone.doubtful[11]

    swarm.review()

    assert not swarm.solution().lost.any()
    history = towers[0]
    true = (history.position[11] - history.position[0]) / log.dock_radius
    assert np.linalg.norm(swarm.robots[11].place.position - true) < 3.0
    assert np.linalg.norm(alone.position[11] - true) > 3.0


def test_a_lost_walk_is_resumed_by_who_waits_for_it(log):
    """What the sixth robot hears is lost until its transmissions and repetitions have ended."""
    spans = []
    for rounds in (0, 400):
        swarm = grown(log, replace(QUICK, tenure=2), 12)
        begin = swarm.channel.rounds
        _deaf(swarm, lambda heard, _, now, end=begin + rounds: heard == 5 and now < end)

        swarm.review()

        spans.append([robot.records[robot.number].span for robot in swarm.robots])
        assert not any(robot.waits for robot in swarm.robots)
    assert spans[0] == spans[1]
    assert spans[0][0] == (0, 12)


def test_who_waits_for_a_walk_goes_on_without_it(log):
    """The sixth robot hears nothing any more: a walk comes to those that do not hang on it."""
    swarm = grown(log, QUICK, 12)
    hang, queue = {5}, [5]
    while queue:
        after = swarm.robots[queue.pop()].children
        hang |= after
        queue += after
    _deaf(swarm, lambda heard, *_: heard == 5)

    swarm.review()

    walked = {robot.number for robot in swarm.robots if robot.records[robot.number].span}
    assert walked == {*range(12)} - hang


@pytest.fixture(scope="module")
def bridges():
    """Bridges that closed, each with the robots whose first contacts lead to the far side."""
    found = []
    for history in grow(BridgeParams(), robots=40, seeds=[100_001, 100_004], robot=RobotGeometry()):
        log, root = observe(history, NOISY), np.arange(history.robot_count)
        for earlier, _, robot, _ in sorted(log.contacts.tolist(), key=lambda row: (row[2], row[0])):
            if root[robot] == robot:
                root[robot] = root[earlier]
        assert {*root[:-1]} == {0, 1}
        found.append((history, log, root > 0))
    return found


def test_the_far_side_of_a_bridge_learns_where_it_is(bridges):
    """Who closes it touches both sides: what each knows of that robot ties them."""
    for history, log, is_far in bridges:
        [found] = localize_many([log], [QUICK])

        off = np.linalg.norm(found.position - history.position, axis=1)
        assert np.sqrt((off[is_far] ** 2).mean()) < 4.0  # 16 R and more without it
        assert not found.disconnected.any()
        # Errors of a whole side are within what its robots state.
        assert np.sqrt((off**2).mean()) < 3.0 * np.sqrt((found.sd**2).mean())


def test_before_a_bridge_closes_its_far_side_doubts(bridges):
    """It knows where its robots are relative to each other only."""
    for history, log, is_far in bridges:
        swarm = grown(log, QUICK, log.robot_count - 1)

        solution = swarm.solution()
        far = np.flatnonzero(is_far[:-1])
        assert np.flatnonzero(solution.lost).tolist() == far.tolist()
        assert solution.doubtful[far].all()
        away = (solution.position - history.position[:-1])[far]
        assert np.sqrt(away.var(axis=0).sum()) < 3.0


@pytest.mark.parametrize("settings", [{}, {"channel": "radio"}, {"loss": 0.2}])
def test_after_a_bridge_closes_a_walk_comes_to_all(bridges, settings):
    """The far side hangs on the robot that closed it, and that one on the near side."""
    for _, log, _ in bridges:
        swarm = grown(log, replace(QUICK, **settings))

        assert {robot.place.body for robot in swarm.robots} == {0}
        parents = [robot.parent for robot in swarm.robots]
        for robot in swarm.robots:
            number, steps = robot.number, 0
            while parents[number] is not None:
                assert number in swarm.robots[parents[number]].children
                number, steps = parents[number], steps + 1
                assert steps < len(parents)
            assert number == 0
        assert sum(len(robot.children) for robot in swarm.robots) == len(parents) - 1


def test_robots_of_a_base_are_not_reviewed(log):
    """The anchor has solved for all at once."""
    once, again = localize_many(
        [log] * 2, [replace(QUICK, solver="base", reviews=k) for k in (0, 1)]
    )

    np.testing.assert_array_equal(once.traffic["sent"], again.traffic["sent"])


def test_a_robot_that_another_one_moved_is_asked_again(log):
    """Who moves it is its keeper from then on; who else holds its place learns of that."""
    swarm = grown(log, replace(QUICK, tenure=99), 12)
    robot, former = swarm.robots[11], swarm.robots[0]
    place = Writer(QUICK.bits)
    place.number(0, 2)
    write_place(place, robot.place)
    former.records[11].is_current = True

    robot.hear(Message("place", 5, b"\3", {11: place.to_bytes()}))
    [notice] = robot.outbox
    former.hear(notice)

    assert (notice.kind, {*notice.parts}) == ("moved", {0})
    assert not former.records[11].is_current


def test_a_message_counts_the_contacts_that_it_takes(log):
    """Each robot on the way adds one, and notes it if the place is its own."""
    swarm = grown(log, QUICK, 12)
    place = Writer(QUICK.bits)
    place.number(0, 2)
    write_place(place, swarm.robots[7].place)
    message = Message("place", 3, b"\1", {7: place.to_bytes()})

    on = swarm.robots[6].hear(message)

    assert on.common == b"\2"
    assert swarm.robots[6].records[7].place.position == pytest.approx(
        swarm.robots[7].place.position
    )


@pytest.mark.parametrize("channel", ["touch", "radio"])
def test_losses_depend_on_the_seed(log, channel):
    """What robots send, hear and conclude; some is sent again."""
    params = replace(QUICK, loss=0.3, delay=1, channel=channel)

    one, again, other, lossless = (
        localize_many([log], [each])[0]
        for each in (params, params, replace(params, seed=1), replace(params, loss=0.0))
    )

    assert one.position.tobytes() == again.position.tobytes()
    assert one.traffic["sent"].tobytes() == again.traffic["sent"].tobytes()
    assert one.traffic["sent"].tobytes() != other.traffic["sent"].tobytes()
    assert other.traffic["messages"].sum() > lossless.traffic["messages"].sum()


def test_a_lost_swarm_says_so(log):
    """If next to nothing is heard, robots doubt where they are."""
    [estimate] = localize_many([log], [replace(QUICK, loss=0.99, retries=0)])

    assert np.isfinite(estimate.position).all()
    assert estimate.doubtful.sum() > log.robot_count // 2
    assert not estimate.convergence.converged
    assert "doubt" in estimate.convergence.reason


@pytest.mark.parametrize("coordinates", [0, 1, 3])
def test_a_robot_without_contacts_joins(coordinates):
    """It may have sensed nothing at all, its height alone, or all coordinates of its center."""
    truth = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 1.0], [9.0, 0.0, 2.0]])
    one_range = [2.0, 1.0, np.linalg.norm(truth[2] - truth[1]), 0.1, -1.0]
    sensed = silent(truth, ranges=np.array([one_range]))
    axes = np.eye(3)[::-1][:coordinates]
    fixes = [[1.0, *axis, axis @ truth[1], 0.01, -1.0] for axis in axes]
    log = replace(sensed, fixes=np.array(fixes).reshape(-1, 7))

    [estimate] = localize_many([log], [QUICK])

    assert np.isfinite(estimate.position).all()
    assert np.isfinite(estimate.sd).all()
    assert estimate.disconnected[1] == (coordinates < 3)


def test_who_never_annealed_does_not_converge(log):
    """Residuals of a wrong mirror image may be as small as those of the right one."""
    [estimate] = localize_many([log], [replace(QUICK, chains=0)])

    assert not estimate.convergence.converged


@given(
    values=st.lists(st.floats(-1000.0, 1000.0), min_size=1, max_size=9),
    bits=st.sampled_from([8, 12, 16, 32]),
)
def test_rounding_is_within_half_a_step(values, bits):
    """Lengths come back within half a step of the range that they were sent in."""
    to = Writer(bits)
    to.lengths(values)

    back = Reader(to.to_bytes(), bits).lengths(len(values))

    farthest = max(1.0, *map(abs, values))
    half = 0.5 * step(2.0 ** np.ceil(np.log2(farthest)), bits)
    np.testing.assert_allclose(back, values, rtol=0.0, atol=half * (1.0 + 1e-6))
    assert rounding_sd(farthest, bits) == pytest.approx(2.0 * half / np.sqrt(12.0))


def test_numbers_without_a_limit_of_bits_are_exact():
    """Not a bit changes."""
    values = [0.1, -1e-300, 7e9, 1.0 / 3.0]
    to = Writer(None)
    to.lengths(values)

    assert Reader(to.to_bytes(), None).lengths(4).tolist() == values


@pytest.mark.parametrize("kind", ["walks", "directions", "fixes"])
@pytest.mark.parametrize("bits", [None, 16])
def test_lines_survive_the_way(towers, kind, bits):
    """Contacts and grounds as they are; orientations within their rounding."""
    log = observe(towers[0], NOISY)
    if kind == "directions":
        log = with_directions(log, towers[0], sd_deg=1.0)
    if kind == "fixes":
        log = with_fixes(log, towers[0], [3, 5, 7], each=2, sd=0.1)
    _, *lines = lines_of(log)

    for text in lines:
        line = parse_robot(text)
        back = read_line(line_bytes(line, 3, bits), 3, bits)
        assert sorted(back.contacts) == sorted(line.contacts)
        assert back.ground_docks == sorted(line.ground_docks or [])
        # Angles take fewer bits than lengths: half the last digit of a tenth of a degree is left.
        assert json.dumps(back.directions) == json.dumps(line.directions or None)
        for mine, its in zip(line.stances or [], back.stances or [], strict=True):
            assert sorted(mine.contacts) == sorted(its.contacts)
            assert mine.pivot_dock == its.pivot_dock
            along = abs(np.dot(mine.orientation_wxyz, its.orientation_wxyz))
            assert along == pytest.approx(1.0, abs=1e-12 if bits is None else 5e-6)


def _five(log, **settings):
    """Localize five robots by Algorithm 1; return their traffic."""
    keep = (log.contacts < 5)[:, [0, 2]].all(axis=1)
    header, *lines = lines_of(log)
    tracker = Tracker(header, LOCAL)
    for line in lines[:5]:
        tracker.join(line)
    assert keep.any()
    params = DistributedParams(scheme="algorithm-1", **settings)
    [estimate] = localize_many([tracker.log], [params])
    return estimate.traffic


def test_bytes_of_algorithm_1_are_those_counted_by_hand(log):
    """5 + 3 x 16 bits of a position, 2 + 3 x 16 of an orientation: 13 bytes after the header."""
    once = _five(log, channel="radio", poses="once")
    every = _five(log, channel="radio")
    rounds = _five(log, channel="radio", back_propagation=BackPropagation(every=2, sweeps=10))
    relayed = _five(log, channel="touch", poses="once")

    pose, position = 4 + 13, 4 + 7
    assert once["sent"].tolist() == [pose] * 5
    assert once["heard"].tolist() == [4 * pose] * 5
    assert every["sent"].tolist() == [5 * pose, 4 * pose, 3 * pose, 2 * pose, pose]
    # Rounds follow the joins of robots 2, 4 and 5.
    after = [10 * position * times for times in (3, 3, 2, 2, 1)]
    assert (rounds["sent"] - every["sent"]).tolist() == after
    assert once["messages"].tolist() == [1] * 5
    # By touch, four transmissions bring a pose to all four, if all five hang together.
    assert relayed["sent"].sum() <= 5 * 4 * (pose + ACKNOWLEDGMENT)


@pytest.mark.parametrize("channel", ["touch", "radio"])
def test_without_undocked_repulsion_robots_hear_of_those_they_touch(log, channel):
    """Each contact of two robots carries one pose, and one position for each step of a round."""
    five = {"channel": channel, "undocked_repulsion": False}
    joined = _five(log, **five)
    rounds = _five(log, **five, back_propagation=BackPropagation(every=5, sweeps=10))
    pairs = {(int(max(i, j)), int(min(i, j))) for i, _, j, _ in log.contacts.tolist() if i < 5 > j}
    later, earlier = np.zeros(5), np.zeros(5)
    for j, i in pairs:
        later[i] += 1
        earlier[j] += 1

    pose, position = 4 + 13, 4 + 7
    step = position * np.ones(5)
    acknowledged = 0.0
    if channel == "touch":
        step = (position + ACKNOWLEDGMENT) * (earlier + later)
        acknowledged = ACKNOWLEDGMENT * earlier
    np.testing.assert_array_equal(joined["sent"], pose * later + acknowledged)
    np.testing.assert_array_equal(rounds["sent"] - joined["sent"], 10 * step)
    np.testing.assert_array_equal(joined["memory"], (1 + earlier + later) * 13)
    local = {"undocked_repulsion": False}
    estimates = localize_many(
        [log] * 2, [DistributedParams(scheme="algorithm-1", **local), VirtualForceParams(**local)]
    )
    np.testing.assert_array_equal(estimates[0].position, estimates[1].position)


RADIO = DistributedParams(scheme="algorithm-1", channel="radio")
ASKED = replace(RADIO, poses="asked", radio_reach="ranged")


def _published(log, params):
    """Let robots join by Algorithm 1, and return them with their lines."""
    header, *lines = lines_of(centered(replace(log, robot_id=np.arange(log.robot_count))))
    swarm, robots = PublishedSwarm(parse_header(header), params), [*map(parse_robot, lines)]
    for line in robots:
        swarm.join(line)
    return swarm, robots


@pytest.mark.parametrize("params", [RADIO, replace(RADIO, undocked_repulsion=False)])
def test_who_hears_all_poses_is_where_algorithm_1_puts_it(monkeypatch, log, params):
    """So many slots that none collides, and so few steps that they add up little of rounding."""
    few = VirtualForceParams(undocked_repulsion=params.undocked_repulsion, iterations=3)
    monkeypatch.setattr(DistributedParams, "published", property(lambda _: few))
    heard = replace(params, slots=1_000_000)

    one, other = localize_many([log] * 2, [params, heard])

    np.testing.assert_allclose(one.position, other.position, rtol=0.0, atol=1e-6)
    np.testing.assert_array_equal(one.traffic["sent"], other.traffic["sent"])


@pytest.mark.parametrize("params", [RADIO, ASKED])
def test_who_touches_a_robot_asks_until_it_hears_it(towers, log, params):
    """With so many retries each hears all that it touches, and some others."""
    log = with_ranges(log, towers[0], reach=8.0, sd=0.1)
    swarm, lines = _published(log, replace(params, loss=0.5, burst=4.0, retries=100))

    for line, heard in zip(lines, swarm.heard, strict=True):
        assert {other for _, other, _ in line.contacts} <= heard
        assert heard <= {*range(line.robot)}


def test_a_question_is_repeated_after_pauses_that_double(log):
    """Nobody hears the second robot: it asks in the rounds 1, 1 + 1 + 2 and so on, by hand."""
    header, *lines = lines_of(centered(log))
    params = replace(RADIO, undocked_repulsion=False, loss=0.3, retries=4)
    swarm, asked = PublishedSwarm(parse_header(header), params), []

    def hear(now, sender, *_):
        asked.extend([now] * (1 in sender))
        return np.zeros(len(sender), np.bool_)

    for line in lines[:2]:
        swarm.channel._hears = hear  # noqa: SLF001
        swarm.join(parse_robot(line))

    assert np.diff(asked).tolist() == [pause(k) + 2 for k in (2, 3, 4)]


def test_a_question_costs_its_numbers(log):
    """Robot 1 touches robot 0 and hears it at the second question. By hand.

    Each question names who was heard, of 12 bits: none, none, one. A pose has 4 + 13 bytes.
    """
    header, *lines = lines_of(centered(log))
    swarm = PublishedSwarm(parse_header(header), replace(ASKED, loss=0.3))
    decided = iter([True, False, True, True, True])
    swarm.channel._hears = lambda _, sender, *__: np.array([next(decided)] * len(sender))  # noqa: SLF001
    for line in lines[:2]:
        swarm.join(parse_robot(line))

    assert swarm.heard == [set(), {0}]
    assert swarm.channel.sent == [4 + 2 * 17, 4 + 4 + 6]


@pytest.mark.parametrize("params", [RADIO, ASKED])
def test_who_hears_nothing_still_joins(log, params):
    """Positions are numbers, and worse than with all poses."""
    deaf, hearing = localize_many([log] * 2, [replace(params, loss=0.99, retries=0), params])

    assert np.isfinite(deaf.position).all()
    assert deaf.traffic["memory"].sum() < hearing.traffic["memory"].sum()


@pytest.mark.parametrize("local", [{}, {"undocked_repulsion": False}])
def test_the_scheme_of_the_paper_uses_the_cues_of_algorithm_1(local):
    """Tables do not put it beside methods that use contacts on the way, too."""
    paper = DistributedParams(scheme="algorithm-1", **local)

    assert paper.used_cues == VirtualForceParams(**local).used_cues
    assert "walk_contacts" not in paper.used_cues
    assert "walk_contacts" in DistributedParams().used_cues


def test_branches_carry_the_parts_of_those_behind_them():
    """Three robots in a row: the first transmission has both parts, the second one is left."""
    heard = []
    channel = Channel(DistributedParams(), lambda n, m: (heard.append((n, dict(m.parts))), m)[1])
    for touching in ({*()}, {0}, {1}, {*()}):
        channel.join(touching)

    channel.send(Message("place", 0, b"", {1: b"ab", 2: b"cde", 3: b"lost"}))
    channel.settle()

    assert heard == [(1, {1: b"ab", 2: b"cde"}), (2, {2: b"cde"})]
    both, last = HEADER + 2 * ADDRESS + 5, HEADER + ADDRESS + 3
    assert channel.sent == [both, last + ACKNOWLEDGMENT, ACKNOWLEDGMENT, 0]
    assert channel.heard == [ACKNOWLEDGMENT, both + ACKNOWLEDGMENT, last, 0]


def test_a_log_that_robots_cannot_send_is_refused(log):
    """The message names the key and a method that can do it."""
    unknown = replace(log, touches=np.array([[5, -1, 3, -1]], np.int32))

    with pytest.raises(InputError, match="touches"):
        localize_many([unknown], [QUICK])
