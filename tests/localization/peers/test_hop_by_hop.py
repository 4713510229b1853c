"""Hop by hop, each robot solves for itself; what it cannot know is reported."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tests.structures import (
    Rule,
    silent,
    structure,
    with_directions,
    with_fixes,
    with_heights,
    with_ranges,
)
from tiswarm.compute.math import dock_offsets
from tiswarm.localization.methods import localize, localize_many
from tiswarm.localization.peers.settings import HopByHopParams
from tiswarm.localization.settings import CuesOfNamedDocks
from tiswarm.records.sensing_log import SensingLog, SensingNoise
from tiswarm.sensing import SensingParams, observe

EVERY_AXIS = np.eye(3)
SHARP = 1e-6
HOPS = HopByHopParams(cues=CuesOfNamedDocks(non_overlap=False))  # points at random overlap
METHODS = [HOPS, dataclasses.replace(HOPS, order="join")]


def fixed(log: SensingLog, truth: np.ndarray, robots, axes=EVERY_AXIS, sd=SHARP) -> SensingLog:
    """Add exact fixes of some robots along some directions."""
    robot, n = np.repeat(robots, len(axes)), np.tile(axes, (len(robots), 1))
    value = (n * truth[robot]).sum(axis=1)
    return dataclasses.replace(
        log, fixes=np.column_stack([robot, n, value, np.tile([sd, -1.0], (len(robot), 1))])
    )


def ranging(seed: int, robots: int = 20) -> tuple[SensingLog, np.ndarray]:
    """Make a log of robots anywhere with exact ranges; the anchor and three others are known."""
    truth = np.random.default_rng(seed).uniform(-4.0, 4.0, (robots, 3))
    log = fixed(silent(truth), truth, [1, 2, 3])
    ranged = with_ranges(log, SimpleNamespace(position=truth), reach=7.0, sd=0.0)
    ranged.ranges[:, 3] = 0.05
    return ranged, truth


@pytest.mark.parametrize("params", METHODS, ids=lambda p: p.order)
@pytest.mark.parametrize("seed", range(5))
def test_four_noisy_ranges_are_solved_as_by_least_squares(params, seed):
    """A general optimizer finds the same point from many starts, with weights by variance."""
    rng = np.random.default_rng(seed)
    truth = np.concatenate([rng.uniform(-4.0, 4.0, (4, 3)), rng.uniform(-2.0, 2.0, (1, 3))])
    sd = np.array([0.02, 0.05, 0.1, 0.2])
    reach = np.linalg.norm(truth[4] - truth[:4], axis=1) + sd * rng.normal(size=4)
    ranges = np.column_stack([np.full(4, 4), np.arange(4), reach, sd, np.full(4, -1)])
    log = dataclasses.replace(fixed(silent(truth), truth, [1, 2, 3]), ranges=ranges)

    found = localize(log, params)

    def misfit(point):
        return [(np.linalg.norm(point - truth[k]) - reach[k]) / sd[k] for k in range(4)]

    close = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    ends = [least_squares(misfit, rng.uniform(-5.0, 5.0, 3), **close) for _ in range(20)]
    best = min(ends, key=lambda end: end.cost)
    # Gauss-Newton steps converge the more slowly the worse the ranges fit.
    np.testing.assert_allclose(found.position[4], best.x, atol=0.02 * found.sd[4])
    # From each partner, any direction is as likely as another.
    prior = sum(3.0 / max(length, 2.0) ** 2 for length in reach)
    covariance = np.linalg.inv(best.jac.T @ best.jac + prior * np.eye(3))
    np.testing.assert_allclose(found.sd[4], np.trace(covariance) ** 0.5, rtol=0.01)


@pytest.mark.parametrize("params", METHODS, ids=lambda p: p.order)
def test_two_sweep_planes_and_a_height_cross(params):
    """Two planes of a lighthouse and a height are three linear equations."""
    truth = np.array([[0.0, 0.0, 1.0], [3.0, -2.0, 5.0]])
    sweeps = np.array([[0.6, 0.0, 0.8], [0.48, 0.6, 0.64]])
    log = fixed(silent(truth), truth + 0.1, [1], sweeps, sd=0.1)
    log.flip_height[1] = 5.2

    found = localize(log, params)

    planes = np.vstack([sweeps, [0.0, 0.0, 1.0]])
    crossing = np.linalg.solve(planes, [*log.fixes[:, 4], 5.2])
    np.testing.assert_allclose(found.position[1], crossing, atol=1e-9)
    assert found.located.all()


@pytest.mark.parametrize("params", METHODS, ids=lambda p: p.order)
def test_directions_are_averaged_as_the_equations_say(tall_towers, params):
    """A robot with directions alone is at the weighted mean of the points that they lead to."""
    log = with_directions(
        observe(tall_towers[0], SensingParams()), tall_towers[0], sd_deg=5.0, walks=False
    )
    log = dataclasses.replace(log, noise=SensingNoise(tilt_deg=0.0, yaw_deg=0.0, direction_deg=5.0))
    log = with_fixes(log, tall_towers[0], range(1, 29), each=8, sd=SHARP)
    alone = CuesOfNamedDocks(
        contacts=False, height=False, ground=False, walk_contacts=False, odometry=False
    )

    found = localize(log, dataclasses.replace(params, cues=alone))

    rows = [row for row in log.directions if row[0] == 29]
    offsets = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    turn = Rotation.from_quat(log.orientation_wxyz[29], scalar_first=True)
    precision, moment = np.zeros((3, 3)), np.zeros(3)
    for _, own, other, its, *body in rows:
        u = turn.apply(body)
        across = np.eye(3) - np.outer(u, u)
        weight = np.outer(u, u) / 0.006**2 + across / (0.006**2 + (2.0 * np.radians(5.0)) ** 2)
        point = found.position[int(other)] + offsets[int(other), int(its)]
        precision += weight
        moment += weight @ (point - 2.0 * u - offsets[29, int(own)])
    assert len(rows) > 1
    expected = np.linalg.solve(precision, moment)
    np.testing.assert_allclose(found.position[29], expected, atol=1e-6)
    assert found.located[29]


def test_a_chain_of_directions_locates_a_tower(tall_towers):
    """The rivals' own way: connections of one degree, robot after robot."""
    for history in tall_towers:
        log = with_directions(observe(history, SensingParams()), history, sd_deg=1.0, walks=False)

        found = localize(
            log, HopByHopParams(cues=CuesOfNamedDocks(walk_contacts=False, height=False))
        )

        error = np.linalg.norm(found.position - history.position, axis=1)
        assert found.located.mean() > 0.8
        assert (error[found.located] ** 2).mean() ** 0.5 < 0.5


def test_errors_that_partners_share_do_not_average_out():
    """A robot that twelve partners of sd 0.3 R tie exactly is as uncertain as each of them."""
    truth = np.random.default_rng(0).uniform(-6.0, 6.0, (14, 3))
    partners = np.arange(1, 13)
    log = fixed(silent(truth), truth, partners, sd=0.3)
    reach = np.linalg.norm(truth[13] - truth[partners], axis=1)
    known = np.tile([SHARP, -1.0], (12, 1))
    ranges = np.column_stack([np.full(12, 13), partners, reach, known])

    found = localize(dataclasses.replace(log, ranges=ranges), HOPS)

    np.testing.assert_allclose(found.sd[1:13], 0.3 * 3**0.5, rtol=0.1)
    np.testing.assert_allclose(found.sd[13], 0.3 * 3**0.5, rtol=0.1)


def test_intervals_of_directions_hold_about_as_many_robots_as_they_should(tall_towers):
    """Robots that directions tie to several partners count on them all being off alike."""
    params = SensingParams(suite="freesn", tilt_noise_deg=1.0, yaw_noise_deg=2.0)

    found = [localize(observe(tower, params), HopByHopParams()) for tower in tall_towers]

    away = [
        np.linalg.norm(f.position - t.position, axis=1)
        for f, t in zip(found, tall_towers, strict=True)
    ]
    ratio = np.concatenate([a[1:] / f.sd[1:] for a, f in zip(away, found, strict=True)])
    assert 0.3 < (ratio < 0.85).mean() < 0.7
    assert (ratio < 1.6).mean() > 0.8


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000))
def test_exact_ranges_give_exact_positions(seed):
    """Robots that count as located are where they are."""
    log, truth = ranging(seed)

    found = localize(log, HOPS)

    error = np.linalg.norm(found.position - truth, axis=1)
    assert error[found.located].max() < 1e-9


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000), turn=st.floats(-3.0, 3.0))
def test_a_turned_and_shifted_swarm_gives_turned_and_shifted_positions(seed, turn):
    """No axis is special but the vertical, and no place."""
    log, _ = ranging(seed)
    yaw, by = Rotation.from_euler("z", turn), np.array([30.0, -20.0, 10.0])
    fixes = log.fixes.copy()
    fixes[:, 1:4] = yaw.apply(log.fixes[:, 1:4])
    fixes[:, 4] += fixes[:, 1:4] @ by
    moved = dataclasses.replace(
        log,
        fixes=fixes,
        anchor_position=yaw.apply(log.anchor_position) + by,
        orientation_wxyz=np.tile(yaw.as_quat(scalar_first=True), (log.robot_count, 1)),
    )

    found, same = localize(log, HOPS), localize(moved, HOPS)

    located = found.located
    np.testing.assert_array_equal(same.located, located)
    expected = yaw.apply(found.position[located]) + by
    np.testing.assert_allclose(same.position[located], expected, atol=1e-7)


@settings(max_examples=15)
@example(seed=4361)  # the far crossing converges in two steps more than there are
@given(seed=st.integers(0, 10_000))
def test_names_and_join_order_do_not_matter_by_hops(seed):
    """Robots in another join order are located at the same points."""
    log, _ = ranging(seed)
    rng = np.random.default_rng(seed)
    order = np.r_[0, 1 + rng.permutation(log.robot_count - 1)]  # new place of each robot
    pair = np.sort(order[log.ranges[:, :2].astype(int)], axis=1)[:, ::-1]
    ranges = np.column_stack([pair, log.ranges[:, 2:]])
    fixes = np.column_stack([order[log.fixes[:, 0].astype(int)], log.fixes[:, 1:]])
    other = dataclasses.replace(log, ranges=ranges, fixes=fixes)

    found, same = localize(log, HOPS), localize(other, HOPS)

    located = found.located
    np.testing.assert_array_equal(same.located[order], located)
    np.testing.assert_allclose(same.position[order][located], found.position[located], atol=1e-7)


@pytest.mark.parametrize("seed", range(100))
def test_whatever_numbers_are_sensed_positions_are_finite(seed):
    """Sensors may contradict each other by any amount that a log may have."""
    rng = np.random.default_rng(seed)
    pair = rng.permutation([(i, j) for i in range(1, 6) for j in range(i)])[: rng.integers(1, 16)]
    robot = rng.integers(1, 6, rng.integers(0, 9))
    direction = np.array([*EVERY_AXIS, [0.6, 0.0, 0.8]])[rng.integers(0, 4, len(robot))]

    def any_numbers(count):
        length = 10.0 ** rng.uniform(-12.0, 10.0, count)
        length = np.choose(rng.integers(0, 6, count), [0.0, 2.0, 1e10, 5e-324, length, length])
        return length, 10.0 ** rng.uniform(-6.0, 6.0, count), rng.integers(-1, 2, count)

    log = dataclasses.replace(
        silent(np.zeros((6, 3))),
        ranges=np.column_stack([pair, *any_numbers(len(pair))]),
        fixes=np.column_stack([robot, direction, *any_numbers(len(robot))]),
        source_name=("camera", "radio"),
        source_sd=10.0 ** rng.uniform(-6.0, 6.0, 2),
    )

    for order in ("hops", "join"):
        found = localize_many([log], [HopByHopParams(order=order)])[0]

        assert np.isfinite(found.position).all()
        assert np.isfinite(found.sd).all()


def test_in_join_order_later_robots_change_nothing():
    """The log of the first robots gives them the same positions as the whole log."""
    log, truth = structure(Rule(kind="loops"), 30, 0)
    log = with_heights(log, truth)
    params, first = METHODS[1], 18
    early = dataclasses.replace(
        log,
        **{
            key: getattr(log, key)[:first]
            for key in ("robot_id", "orientation_wxyz", "flip_height", "spawn_position")
        },
        contacts=log.contacts[log.contacts[:, 2] < first],
    )

    whole, part = localize_many([log, early], [params, params])

    assert whole.position[:first].tobytes() == part.position.tobytes()


@pytest.mark.parametrize("params", METHODS, ids=lambda p: p.order)
def test_a_robot_that_is_not_located_is_guessed_by_one_that_was_guessed(params):
    """A chain of contacts alone: docks touch, though no position is determined."""
    chain = np.array([[0, 0, 1, 1], [1, 0, 2, 1], [2, 2, 3, 0]], np.int32)
    log = dataclasses.replace(silent(np.zeros((4, 3))), contacts=chain)

    found = localize(log, params)

    i, a, j, b = chain.T
    docks = found.position[:, None] + log.dock_offset_body
    np.testing.assert_allclose(np.linalg.norm(docks[i, a] - docks[j, b], axis=1), 2.0, atol=1e-6)
    assert not found.located[1:].any()


def test_open_coordinates_are_reported():
    """Robots that no rows determine name the axes, and so do those that depend on them."""
    truth = np.array([[0.0, 0.0, 1.0], [3.0, 0.0, 1.0], [0.0, 3.0, 1.0], [3.0, 3.0, 4.0]])
    log = silent(truth)
    level = fixed(log, truth, [1], EVERY_AXIS[:2], sd=0.5).fixes
    upright = fixed(log, truth, [2], EVERY_AXIS[2:], sd=0.5).fixes
    tied = fixed(log, truth, [3], EVERY_AXIS[1:], sd=0.1).fixes
    ranges = np.array([[3.0, 1.0, np.linalg.norm(truth[3] - truth[1]), 0.1, -1.0]])
    log = dataclasses.replace(log, fixes=np.concatenate([level, upright, tied]), ranges=ranges)

    found = localize(log, HopByHopParams())

    assert found.columns()["undetermined"] == ["", "z", "xy", "x"]
    np.testing.assert_allclose(found.position[1, :2], truth[1, :2], atol=1e-9)
    np.testing.assert_allclose(found.position[2, 2], truth[2, 2], atol=1e-9)
    assert found.sd[1] > 1.0


def test_of_two_mirror_images_the_upper_is_taken_but_not_called_located():
    """Three ranges to robots on the ground have a solution below it, too."""
    truth = np.array([[0.0, 0.0, 1.0], [16.0, 0.0, 1.0], [0.0, 16.0, 1.0], [8.0, 8.0, 5.0]])
    log = fixed(silent(truth), truth, [1, 2])
    log = with_ranges(log, SimpleNamespace(position=truth), reach=13.0, sd=0.0)
    log.ranges[:, 3] = 0.05

    found = localize(log, HopByHopParams())

    np.testing.assert_allclose(found.position[3], truth[3], atol=1e-9)
    assert found.columns()["undetermined"] == ["", "", "", "z"]
    # At even odds the robot is at the other image, 8 R away, half of the time.
    assert found.sd[3] == pytest.approx(8.0 * 0.5**0.5, rel=0.01)
    assert found.convergence.trusted  # what is said is of the others


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000), times=st.integers(2, 50))
def test_readings_that_say_the_same_together_place_robots_alike(seed, times):
    """A range read n times with sqrt(n) times the noise is the range read once.

    Each reading as a tie of its own would count the error of its partner, and the prior, anew.
    """
    log, _ = ranging(seed)
    ranges = np.repeat(log.ranges, times, axis=0)
    ranges[:, 3] *= np.sqrt(times)

    found, same = localize(log, HOPS), localize(dataclasses.replace(log, ranges=ranges), HOPS)

    located = found.located
    np.testing.assert_array_equal(same.located, located)
    np.testing.assert_allclose(same.position[located], found.position[located], atol=1e-6)
    np.testing.assert_allclose(same.sd[located], found.sd[located], rtol=1e-4)


def test_the_error_of_a_source_does_not_average_out():
    """However often a camera finds a robot, its own place is no better known."""
    truth = np.array([[0.0, 0.0, 1.0], [9.0, 0.0, 1.0]])
    log = fixed(silent(truth), truth, [1], sd=0.1)
    fixes = np.repeat(log.fixes, 100, axis=0)
    fixes[:, 6] = 0
    source = {"source_name": ("camera",), "source_sd": np.array([0.5])}

    found = localize(dataclasses.replace(log, fixes=fixes, **source), HOPS)

    # The prior is that robots are within 2 R or so.
    information = 1.0 / (0.5**2 + 0.1**2 / 100) + 3.0 / 2.0**2
    assert found.sd[1] == pytest.approx(np.sqrt(3.0 / information), rel=1e-6)


@pytest.mark.parametrize("reach", [6.0, 10.0])
def test_a_robot_with_one_range_is_as_unsure_as_its_sphere_is_large(reach):
    """From one point of a sphere, the mean square distance of all is twice that of its center."""
    log = silent(np.zeros((2, 3)))
    log = dataclasses.replace(log, ranges=np.array([[1, 0, reach, 0.1, -1.0]]))

    found = localize(log, HOPS)

    assert np.linalg.norm(found.position[1]) == pytest.approx(reach)
    assert found.sd[1] == pytest.approx(np.sqrt(2.0 * reach**2), rel=0.01)


def test_a_dock_in_the_way_excludes_a_mirror_image():
    """A robot that stands where the other image would be decides."""
    truth = np.array(
        [[0.0, 0.0, 1.0], [4.0, 0.0, 1.0], [0.0, 4.0, 1.0], [2.0, 2.0, -2.0], [2.0, 2.0, 4.0]]
    )
    log = fixed(silent(truth), truth, [1, 2, 4])
    reach = np.linalg.norm(truth[3] - truth[:3], axis=1)
    known = np.tile([0.05, -1.0], (3, 1))
    ranges = np.column_stack([np.full(3, 3), np.arange(3), reach, known])
    log = dataclasses.replace(log, ranges=ranges)

    blind, found = [
        localize(log, HopByHopParams(cues=CuesOfNamedDocks(non_overlap=on))) for on in (False, True)
    ]

    assert not blind.located[3]
    np.testing.assert_allclose(blind.position[3], truth[4], atol=1e-9)
    assert found.located.all()
    np.testing.assert_allclose(found.position[3], truth[3], atol=1e-9)


@pytest.mark.parametrize("params", METHODS, ids=lambda p: p.order)
def test_robots_of_a_tower_that_are_located_are_right(tall_towers, params):
    """Contacts of every stance locate them to what contacts are sensed across."""
    for history in tall_towers:
        log = observe(history, SensingParams())

        found = localize(log, params)

        error = np.linalg.norm(found.position - history.position, axis=1)
        assert np.isfinite(found.sd).all()
        assert np.quantile(error[found.located], 0.95) < 0.05
        assert found.columns()["undetermined"][0] == ""


def test_fixes_come_first_and_contacts_pass_them_on(tall_towers):
    """Robots that see a camera are located by it, the others by contacts, heights and ground."""
    log = observe(tall_towers[0], SensingParams())
    seen = np.arange(1, 30, 2)
    log = with_fixes(log, tall_towers[0], seen, each=3, sd=0.01)

    found = localize(log, HopByHopParams(cues=CuesOfNamedDocks(walk_contacts=False)))

    assert found.located[seen].all()
    assert found.located.sum() > len(seen) + 3


def test_estimates_repeat_alone_and_side_by_side(tall_towers):
    """Each structure has the same bytes alone and in a batch."""
    logs = [observe(history, SensingParams(tilt_noise_deg=1.0)) for history in tall_towers]

    together = localize_many(logs, [HopByHopParams()] * 3)

    for log, found in zip(logs, together, strict=True):
        alone = localize_many([log], [HopByHopParams()])[0]
        assert alone.position.tobytes() == found.position.tobytes()
        assert alone.sd.tobytes() == found.sd.tobytes()
