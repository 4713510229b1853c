"""Robots that left are in nobody's way, and trackers know what changed as a log does."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.localization.online.test_online import QUICK, fed, lines_of
from tests.structures import NOISY
from tiswarm.localization.cost.cost import State
from tiswarm.localization.methods import localize, localize_many
from tiswarm.localization.online.tracker import Tracker
from tiswarm.localization.peers.settings import HopByHopParams, LeastSquaresParams
from tiswarm.localization.settings import JointParams, VirtualForceParams
from tiswarm.measurements.advice.further import advise
from tiswarm.records.sensing_file import SensingLogBuilder
from tiswarm.records.sensing_format import parse_header, parse_line
from tiswarm.sensing import observe

LEFT = 3
"""Robot whose place another one takes."""


def log_of(lines):
    """Read a log from its lines."""
    header, *others = [line if isinstance(line, str) else json.dumps(line) for line in lines]
    builder = SensingLogBuilder(parse_header(header))
    for line in others:
        builder.take(parse_line(line, builder.header))
    return builder.log()


def followed(lines):
    """Let a robot leave a log, and another one join where it stood, by the same contacts."""
    header, *robots = map(json.loads, lines)
    touched = [
        [its, line["robot"], dock]
        for line in robots
        for dock, other, its in line["contacts"]
        if other == LEFT
    ]
    own = robots[LEFT]
    touched += own["contacts"]
    follower = {**own, "robot": 100, "contacts": touched, "stances": []}
    return [{**header, "version": 3}, *robots, {"event": "leave", "robot": LEFT}, follower]


@pytest.fixture(scope="module")
def lines(towers):
    """Lines of a noisy tower."""
    return lines_of(observe(towers[0], NOISY))


@pytest.mark.parametrize(
    "params",
    [
        JointParams(chains=2, steps=400),
        LeastSquaresParams(),
        HopByHopParams(),
        QUICK,
        VirtualForceParams(),
    ],
    ids=lambda params: params.method,
)
def test_a_robot_may_stand_where_another_one_stood(lines, params):
    """Both touch the same docks. Unless one has left, all methods put them apart."""
    after = log_of(followed(lines))

    estimate = localize(after, params)

    def apart(found):
        return float(np.linalg.norm(found.position[LEFT] - found.position[-1]))

    assert apart(estimate) < 0.3
    assert estimate.gone.tolist() == [row == LEFT for row in range(after.robot_count)]
    assert estimate.columns()["gone"][LEFT] == "yes"
    nobody = np.empty(0, np.int64)
    both = localize(replace(after, gone=nobody, left_after=nobody), params)
    assert both.gone is None
    assert apart(both) > 0.5


def test_a_log_beside_one_with_robots_that_left_keeps_its_estimate(towers, lines):
    """Each is annealed by kernels of its own, so that no bit of one depends on the other."""
    log, params = observe(towers[1], NOISY), JointParams(chains=2, steps=60)

    beside, _ = localize_many([log, log_of(followed(lines))], [params] * 2)

    assert beside.position.tobytes() == localize(log, params).position.tobytes()


def events_of(lines):
    """List events of 11 robots of a tower: contacts released, robots that leave or sense more."""
    robots = [json.loads(line) for line in lines[1:12]]
    dock, other, its = robots[8]["contacts"][0]
    own, third, there = robots[10]["contacts"][-1]
    turned = {**robots[5], "orientation_wxyz": [0.0, 1.0, 0.0, 0.0]}
    fewer = {**robots[7], "stances": robots[7]["stances"][1:]}
    return [
        {"event": "release", "robot": robots[8]["robot"], "contacts": [[dock, other, its]]},
        {"event": "replace", **turned},
        {"event": "release", "robot": third, "contacts": [[there, robots[10]["robot"], own]]},
        {"event": "leave", "robot": robots[6]["robot"]},
        {"event": "replace", **fewer},
    ]


def test_a_tracker_after_events_has_the_rows_of_the_log_after_them(lines):
    """At any state, cost and derivatives are those of a tracker that began with that log."""
    header = {**json.loads(lines[0]), "version": 3}
    events = events_of(lines)
    tracker = fed([header, *lines[1:12]])

    for event in events:
        tracker.take(event)
    tracker.take(lines[12])

    log = log_of([header, *lines[1:12], *events, lines[12]])
    fresh = Tracker(header, QUICK)
    for line in lines_of(log)[1:]:
        fresh.take(line)
    rng = np.random.default_rng(0)
    state = State(3.0 * rng.normal(size=(12, 3)), rng.normal(size=(12, 3)))
    state.position[0] = 0.0
    every = np.arange(12)
    ours, theirs = (each.neighborhood(every).linearized(state) for each in (tracker, fresh))
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-12)
    assert ours.overlap.max() > 0.0
    np.testing.assert_allclose(ours.information, theirs.information, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(ours.slope, theirs.slope, rtol=1e-9, atol=1e-6)
    assert tracker.gone.tolist() == fresh.gone.tolist()


def test_nobody_measures_a_robot_that_left(towers):
    """Advice names those that are there, though the other one is as uncertain."""
    log = observe(towers[0], NOISY)
    gone = np.arange(5, log.robot_count)
    position = towers[0].position * log.dock_radius
    cues = ["contacts", "ground"]

    before = advise(log, cues, position)
    after = advise(replace(log, gone=gone), cues, position)

    def named(advice):
        found = [(each.robot, *each.contact[1:2]) for each in advice]
        return {robot for robots in found for robot in robots}

    assert named(before) & {*gone.tolist()}
    assert after
    assert not named(after) & {*gone.tolist()}
