"""Ranges that leave circles and spheres: robots that are free to turn about others."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import null_space

from tests import foreign
from tests.strategies import unit_vectors
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.methods import localize, settings_of
from tiswarm.localization.online.settings import OnlineParams
from tiswarm.localization.online.tracker import Tracker
from tiswarm.localization.settings import JointParams
from tiswarm.measurements import turns
from tiswarm.measurements.advice.further import tabulate
from tiswarm.measurements.turns import Turn, Turns
from tiswarm.measurements.verdicts import cautions, in_brief
from tiswarm.records.sensing_file import lines_of

pytestmark = pytest.mark.unchecked

SD = 0.05
LINE = np.outer(np.arange(4), [1.0, 0.0, 0.0])
METHODS = ["joint", "least-squares", "hop-by-hop"]


def ranged(beacons, tags, pairs, *, sd=SD, seed=0):
    """Log beacons of known place, the anchor first, and tags that know these distances [m]."""
    place = np.concatenate([beacons, tags])
    log = foreign.silent(place, radius=0.05)
    if len(beacons) > 1:
        log = foreign.with_places(log, place, range(1, len(beacons)))
    noise = sd * np.random.default_rng(seed).normal(size=len(pairs))
    rows = [
        (max(i, j), min(i, j), np.linalg.norm(place[i] - place[j]) + error, sd, -1.0)
        for (i, j), error in zip(pairs, noise, strict=True)
    ]
    return replace(log, ranges=np.array(sorted(rows))), place


def each_to_all(beacons, tags):
    """Pairs of each tag with each beacon."""
    first = len(beacons)
    return [(first + k, j) for k in range(len(tags)) for j in range(first)]


def around(count, seed, *, radius=2.0):
    """Places of tags around the middle of the line."""
    rng = np.random.default_rng([5, seed])
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    far = radius * rng.uniform(0.5, 1.5, count)
    return np.column_stack([rng.uniform(0.0, 3.0, count), far * np.cos(angle), far * np.sin(angle)])


def turns_of(log, place):
    """Free turns at true positions."""
    return Turns.of(pose_problem(log, JointParams()).rows, place / log.dock_radius)


@given(
    axis=unit_vectors,
    arm=st.tuples(*[st.floats(-5.0, 5.0)] * 3).map(np.array),
    is_line=st.booleans(),
)
def test_the_mean_of_a_circle_or_a_sphere_is_its_center(axis, arm, is_line):
    """And the mean square distance from it is the square of the radius, by trigonometry."""
    about = np.array([0, 1]) if is_line else np.array([0])
    position = np.array([np.zeros(3), 3.0 * axis, arm])
    moves = np.array([False, False, True])
    turn = Turn(moves, about, axis[None] if is_line else np.eye(3), is_hand_free=True)

    mean, square = Turns([turn]).swept(position)

    along = axis @ arm if is_line else 0.0
    np.testing.assert_allclose(mean[2], along * axis, atol=1e-9)
    assert square[2] == pytest.approx(arm @ arm - along**2, abs=1e-9)
    assert (square[:2] == 0.0).all()
    np.testing.assert_array_equal(mean[:2], position[:2])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", [0, 1])
def test_two_beacons_leave_a_circle(method, seed):
    """Its center is the foot of two triangles, its radius their height: Heron's formula."""
    rng = np.random.default_rng([6, seed])
    beacons = np.array([[0.0, 0.0, 0.0], rng.normal(size=3)])
    beacons[1] *= 3.0 / np.linalg.norm(beacons[1])
    tags = rng.normal(scale=2.0, size=(3, 3))
    log, place = ranged(beacons, tags, each_to_all(beacons, tags), sd=0.01)

    estimate = localize(log, settings_of(method)())

    axis = beacons[1] / 3.0
    for k, (a, b) in enumerate(log.ranges[:, 2].reshape(3, 2), start=2):
        foot = (a**2 - b**2 + 9.0) / 6.0
        radius = np.sqrt(a**2 - foot**2)
        center = np.linalg.norm(estimate.position[k] - foot * axis)
        # The mean square distance from any point is that from the center and its own.
        assert estimate.sd[k] == pytest.approx(np.hypot(radius, center), rel=0.05)
        if method != "hop-by-hop":
            assert center < 0.05 * radius
    assert estimate.free_frame == ()
    assert estimate.observability.floppy_modes == 3
    (turn,) = estimate.turns
    assert (turn.about.tolist(), turn.robots.tolist()) == ([0, 1], [2, 3, 4])
    assert (np.linalg.norm(estimate.position - place, axis=1) <= 1.6 * estimate.sd + 1e-9).all()


def by_grid(beacons, length, sd, *, half=3.5, step=0.05):
    """Mean and sd of a position by its likelihood on a grid, written out."""
    axis = np.arange(-half, half, step)
    grid = np.stack(np.meshgrid(axis + 1.5, axis, axis, indexing="ij"), axis=-1)
    square = sum(
        ((np.linalg.norm(grid - beacon, axis=-1) - one) / sd) ** 2
        for beacon, one in zip(beacons, length, strict=True)
    )
    weight = np.exp(-0.5 * (square - square.min()))
    weight /= weight.sum()
    mean = (weight[..., None] * grid).sum(axis=(0, 1, 2))
    return mean, np.sqrt((weight * ((grid - mean) ** 2).sum(axis=-1)).sum())


@pytest.mark.parametrize("method", ["joint", "least-squares"])
@pytest.mark.parametrize("off", [0.0, 0.03, 0.1])
def test_sd_is_that_of_the_posterior_on_a_grid(method, off):
    """Of beacons in a line, and of some that are off it by about the noise of ranges.

    Grid and estimate agree to a quarter: rings of beacons off the line are taken as turns.
    """
    beacons = LINE + off * np.array([[0, 0, 0], [0, 1, 0.5], [0, -1, 0.7], [0, 0.4, -1.0]])
    log, _ = ranged(beacons, np.array([[1.2, 1.6, -1.1]]), [(4, j) for j in range(4)], sd=0.1)

    estimate = localize(log, settings_of(method)())

    mean, sd = by_grid(beacons, log.ranges[:, 2], 0.1)
    assert np.linalg.norm(estimate.position[4] - mean) < 0.25 * sd
    assert estimate.sd[4] == pytest.approx(sd, rel=0.25)


@pytest.mark.parametrize("method", METHODS)
def test_one_beacon_leaves_a_sphere(method):
    """The estimate is at its center, the beacon, and sd is the radius."""
    tags = np.array([[2.0, 0.0, 0.5], [0.0, -1.0, 0.8]])
    log, _ = ranged(LINE[:1], tags, each_to_all(LINE[:1], tags))

    estimate = localize(log, settings_of(method)())

    center = np.linalg.norm(estimate.position[1:], axis=1)
    np.testing.assert_allclose(estimate.sd[1:], np.hypot(log.ranges[:, 2], center), rtol=0.05)
    (turn,) = estimate.turns
    assert turn.axis is None
    assert turn.robots.tolist() == [1, 2]
    assert estimate.observability.floppy_modes == 4


def test_in_a_known_plane_one_beacon_leaves_a_circle_and_two_leave_images():
    """Planar robots: heights are known, so a turn is about the vertical, or there is none."""
    tag = np.array([[1.5, 2.0, 0.0]])
    logs = [ranged(LINE[:count], tag, [(count, j) for j in range(count)])[0] for count in (1, 2)]
    level = [replace(log, flip_height=np.zeros(log.robot_count), ground_z=0.0) for log in logs]

    circle, images = (localize(log, JointParams()) for log in level)

    assert circle.turns[0].about.tolist() == [0]
    np.testing.assert_allclose(np.abs(circle.turns[0].axis), [0.0, 0.0, 1.0], atol=1e-6)
    assert circle.sd[1] == pytest.approx(2.5, rel=0.05)
    assert images.turns == ()
    assert images.known[2] == "mirrored"
    assert images.sd[2] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("method", METHODS)
def test_tags_that_range_to_each_other_turn_as_one(method):
    """One motion of all of them; each is somewhere on its own circle."""
    tags = around(4, 0)
    pairs = [*each_to_all(LINE, tags), *[(i, j) for i in range(5, 8) for j in range(4, i)]]
    log, place = ranged(LINE, tags, pairs)

    estimate = localize(log, settings_of(method)())

    (turn,) = estimate.turns
    assert turn.robots.tolist() == [4, 5, 6, 7]
    assert sorted(turn.about.tolist()) == [0, 1, 2, 3]
    assert estimate.observability.floppy_modes == 1
    assert estimate.known[4:] == ["floppy"] * 4
    if method != "hop-by-hop":
        radius = np.linalg.norm(place[4:, 1:], axis=1)
        np.testing.assert_allclose(estimate.sd[4:], radius, rtol=0.1)
        np.testing.assert_allclose(estimate.position[4:, 1:], 0.0, atol=0.1)


def test_a_tag_that_ranges_to_a_turning_one_turns_about_it_too():
    """The last of a chain of tags may be anywhere in a ball: an oracle draws both angles."""
    tags = np.array([[1.0, 2.0, 0.0], [2.5, 2.5, 1.0]])
    pairs = [(4, 0), (4, 1), (4, 2), (5, 4), (5, 3)]
    log, _ = ranged(LINE, tags, pairs, sd=0.01)

    estimate = localize(log, JointParams())

    rng = np.random.default_rng(0)
    drawn = []
    for _ in range(4000):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        first = np.array([1.0, 2.0 * np.cos(angle), 2.0 * np.sin(angle)])
        a, b = np.linalg.norm(tags[1] - tags[0]), np.linalg.norm(tags[1] - LINE[3])
        axis = LINE[3] - first
        apart = np.linalg.norm(axis)
        axis /= apart
        foot = (a**2 - b**2 + apart**2) / (2.0 * apart)
        across = np.cross(axis, rng.normal(size=3))
        across /= np.linalg.norm(across)
        drawn.append(first + foot * axis + np.sqrt(a**2 - foot**2) * across)
    sd = np.sqrt(np.var(drawn, axis=0).sum())
    assert estimate.sd[5] == pytest.approx(sd, rel=0.1)
    np.testing.assert_allclose(estimate.position[5], np.mean(drawn, axis=0), atol=0.2 * sd)
    assert {tuple(turn.robots.tolist()) for turn in estimate.turns} == {(4, 5), (5,)}


@pytest.mark.parametrize("seed", [0, 1])
def test_where_ranges_determine_all_robots_nothing_turns(seed):
    """Beacons around a room, and robots without a beacon whose frame alone is free."""
    room, place = foreign.room_of_tags(foreign.ROOM, seed)
    shape, where = foreign.without_beacons(8, seed)

    (frame,) = turns_of(shape, where)

    assert turns_of(room, place) == ()
    assert frame.is_frame
    assert frame.names == ("rotation", "hand")


@given(seed=st.integers(0, 99), beacons=st.integers(2, 4), count=st.integers(1, 4))
def test_each_tag_turns_about_the_line_at_any_place(seed, beacons, count):
    """Tags do not range to each other: each has a turn of its own."""
    tags = around(count, seed)
    log, place = ranged(LINE[:beacons], tags, each_to_all(LINE[:beacons], tags))

    turns = turns_of(log, place)

    assert [np.flatnonzero(turn.moves).tolist() for turn in turns] == [
        [beacons + k] for k in range(count)
    ]
    _, square = turns.swept(place)
    np.testing.assert_allclose(
        np.sqrt(square[beacons:]), np.linalg.norm(tags[:, 1:], axis=1), rtol=1e-6
    )


def test_robots_between_two_others_turn_about_the_line_through_these():
    """Two tags that range to each other and to two tags of a rigid group have a circle for two."""
    beacons = 3.0 * np.concatenate([np.zeros((1, 3)), np.eye(3)])
    hinges = np.array([[1.0, 2.0, 0.5], [2.0, 0.5, 1.5]])
    pair = np.array([[3.0, 3.0, 2.0], [2.5, 2.0, 4.0]])
    pairs = each_to_all(beacons, hinges)
    pairs += [(6, 4), (6, 5), (7, 4), (7, 5), (7, 6)]
    log, place = ranged(beacons, np.concatenate([hinges, pair]), pairs)

    turning = turns_of(log, place)

    members = [(np.flatnonzero(turn.moves).tolist(), turn.about.tolist()) for turn in turning]
    assert members == [([6, 7], [4, 5])]


def test_a_late_range_does_not_hold_a_tag():
    """An outlier resists the turn, and does not count."""
    tags = around(3, 1)
    log, _ = ranged(LINE, tags, [*each_to_all(LINE, tags), (5, 4)])
    log.ranges[log.ranges[:, :2].tolist().index([5.0, 4.0]), 2] += 9.0

    estimate = localize(log, JointParams())

    (turn,) = estimate.turns
    assert turn.robots.tolist() == [4, 5, 6]


def test_a_tracker_and_its_final_answer_state_the_same_sd():
    """Up to how the first places its robots on their circles."""
    tags = around(3, 2)
    log, place = ranged(LINE, tags, each_to_all(LINE, tags))
    header, robots = lines_of(log)
    tracker = Tracker(header, OnlineParams())
    for line in robots:
        tracker.join(line)

    present, final = tracker.estimate(), tracker.estimate(final=True)

    radius = np.linalg.norm(place[4:, 1:], axis=1)
    for estimate in (present, final):
        assert [turn.robots.tolist() for turn in estimate.turns] == [[4, 5, 6]]
        assert (estimate.sd[4:] > 0.9 * radius).all()
        assert (estimate.sd[4:] < 1.6 * radius).all()


@pytest.mark.parametrize("growth", [0.1, 1e6], ids=["annealed", "local"])
@pytest.mark.parametrize("seed", [2, 3])
def test_a_tracker_states_at_each_join_how_wide_a_circle_is(seed, growth):
    """By hand: the mean square distance from a point is that to the axis and that of the circle.

    A position of one of two tags that range to each other ends the turn of both.
    """
    tags = around(3, seed)
    log, place = ranged(LINE, tags, [*each_to_all(LINE, tags), (6, 5)])
    known = foreign.with_places(log, place, [*range(1, len(LINE)), 6])
    header, robots = lines_of(log)
    tracker = Tracker(header, OnlineParams(chains=2, steps=60, anneal_growth=growth))

    for count, line in enumerate(robots, start=1):
        tracker.join(line)
        radius, away = (
            np.linalg.norm(x[4:, 1:], axis=1) for x in (place[:count], tracker.positions)
        )
        np.testing.assert_allclose(tracker.sd[4:], np.hypot(radius, away), rtol=0.15)
        assert (tracker.sd[:4] < SD).all()
    np.testing.assert_allclose(tracker.sd[4:], tracker.estimate().sd[4:], rtol=0.05)

    tracker.update(lines_of(known)[1][-1])

    assert tracker.sd[6] < SD
    assert tracker.sd[4] > 0.9 * radius[0]


def test_words_and_advice_name_the_line_and_what_excludes_the_turn():
    """A position of either tag removes the one motion of both; a range between them does not."""
    tags = around(2, 3)
    log, _ = ranged(LINE, tags, [*each_to_all(LINE, tags), (5, 4)])

    estimate = localize(log, JointParams())

    assert in_brief(log, estimate).endswith("free to turn: 2 robots (4, 5)")
    (text,) = cautions(log, estimate)
    assert text.startswith(
        "free to turn about the line through 4 robots (0, 1, 2, 3): 2 robots (4, 5); "
    )
    table = tabulate(log, JointParams().used_cues, estimate)
    assert {row["robots determined"] for row in table} == {"2 robots (4, 5)"}
    before = float(table[0]["expected RMSE [m]"])
    assert before == pytest.approx(np.sqrt((estimate.sd**2).mean()), rel=0.1)
    stored = replace(estimate, solutions=(), turns=(), observability=None)
    again = tabulate(log, JointParams().used_cues, stored)
    # Measurements that gain as much change places.
    assert {row["further measurement"] for row in again} == {
        row["further measurement"] for row in table
    }


@pytest.mark.parametrize("most", [1, 20_000])
def test_likelihoods_of_angles_are_those_of_dense_steps(monkeypatch, most):
    """A step to the nearest minimum, but not on by the turn, is least squares on what is left."""
    monkeypatch.setattr(turns, "_MOST_UNKNOWNS", most)
    tags = around(6, 3)
    pairs = [*each_to_all(LINE, tags), *((4 + k, 3 + k) for k in range(1, 6))]
    log, place = ranged(LINE + 0.02 * np.eye(4, 3), tags, pairs)
    rows, at = pose_problem(log, JointParams()).rows, place / log.dock_radius

    (turn,) = Turns.of(rows, at)

    rows = rows.averaged()
    sd, squares = np.sqrt(rows.variance()), []
    angles = np.arange(len(turn.chance), dtype=np.float64) + 0.5
    axis = np.tile(turn.pivot(at)[1][0], (len(angles), 1))
    matrices = turns._motions(axis, angles)  # noqa: SLF001 - what the method tries
    for there in turn.turned(np.tile(at, (len(angles), 1, 1)), matrices):
        center, axes = turn.pivot(there)
        along = np.cross(axes, (there - center)[turn.moves]).ravel()
        free = null_space(along[None])
        of_all = rows.jacobian(there).toarray()[:, : there.size].reshape(len(rows), -1, 3)
        slope = of_all[:, turn.moves].reshape(len(rows), -1) @ free / sd[:, None]
        wrong = rows.residual(there) / sd
        step = np.linalg.lstsq(slope, wrong, rcond=None)[0]
        squares.append(((wrong - slope @ step) ** 2).sum())
    expected = np.exp(0.5 * (min(squares) - np.array(squares)))
    assert expected.std() > 0.01
    # The dense steps lack the small stiffness that keeps solutions finite.
    np.testing.assert_allclose(turn.chance / turn.chance.max(), expected, atol=1e-3)
