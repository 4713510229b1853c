"""Advice gains what adding the measurement and counting anew shows."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.structures import Rule, structure
from tiswarm.compute.math import dock_offsets
from tiswarm.measurements import rigidity
from tiswarm.measurements.advice import further as advice
from tiswarm.measurements.advice.further import advise, advise_together
from tiswarm.measurements.cues import Precision, measure
from tiswarm.measurements.model import Coordinates, Distances, Measurements
from tiswarm.measurements.observability import observability
from tiswarm.measurements.odometry import CENTER
from tiswarm.measurements.rigidity import FloppyMotions, further_rows, weld
from tiswarm.records.sensing_log import canonical_contacts
from tiswarm.sensing import SensingParams, observe

CUES = ("contacts", "ground", "ranges")
BIAS_DEG = 9.0


@pytest.fixture(params=[None, BIAS_DEG], ids=["yaw-known", "yaw-biased"])
def swarm(request, towers):
    """A log with noise, and the true centers of its 30 robots."""
    log = observe(towers[1], SensingParams(tilt_noise_deg=1.0, yaw_bias_deg=request.param or 0.0))
    position = towers[1].position
    apart = float(np.linalg.norm(position[20] - position[5]))
    return replace(log, ranges=np.array([[20.0, 5.0, apart, 0.1, -1.0]])), position


@pytest.fixture
def every(monkeypatch):
    """Advise on every candidate, of little use or not."""
    monkeypatch.setattr(advice, "_EACH", 10**6)
    monkeypatch.setattr(advice, "_GAIN", -1.0)


def _rows(found, log, center):
    """Derivatives of what a candidate measures by x, y, z of each center, then by each yaw."""
    rows = np.zeros((3, 4 * log.robot_count))
    i = found.robot
    if found.kind == "range":
        _, j, _ = found.contact
        along = (center[i] - center[j]) / np.linalg.norm(center[i] - center[j])
        rows[0, 3 * i : 3 * i + 3], rows[0, 3 * j : 3 * j + 3] = along, -along
        return rows[:1]
    if found.kind != "contact":
        rows[:, 3 * i : 3 * i + 3] = np.eye(3)
        return rows if found.kind == "position" else rows[2:]
    own, j, its = found.contact
    arm = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    a, b = arm[i, own], arm[j, its]
    apart = center[i] + a - center[j] - b
    along = apart / np.linalg.norm(apart)
    for robot, sign, lever in ((i, 1.0, a), (j, -1.0, b)):
        rows[0, 3 * robot : 3 * robot + 3] = sign * along
        rows[0, 3 * log.robot_count + robot] = sign * (along @ [-lever[1], lever[0], 0.0])
    return rows[:1]


def _noise(found, log):
    """Variance of a candidate, with the noise of tilt in the arms of its docks."""
    if found.kind == "range":
        return log.ranges[0, 3] ** 2
    if found.kind != "contact":
        return Precision().height ** 2
    own, j, its = found.contact
    arm = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    total = 0.0
    for x, y, z in (arm[found.robot, own], arm[j, its]):
        total += np.radians(1.0) ** 2 * (2 * z**2 + x**2 + y**2) / 3.0  # mean over directions
    return Precision().contact ** 2 + total


def _free(log):
    """Columns of the unknowns."""
    return np.arange(3, (4 if log.yaw_bias else 3) * log.robot_count)


def _information(log, center):
    """Inverse covariance of the unknowns, contact by contact."""
    robots = log.robot_count
    noise = replace(log.noise, yaw_bias_deg=0.0)
    rows = measure(replace(log, noise=noise), CUES)
    jacobian = rows.jacobian(center).toarray()
    matrix = jacobian.T @ np.diag(1.0 / rows.variance()) @ jacobian
    for i, j, length in zip(rows.robot, rows.neighbor, rows.distances.length, strict=False):
        for axis in range(3):
            bond = np.zeros(4 * robots)
            bond[[3 * i + axis, 3 * j + axis]] = 1.0, -1.0
            matrix += 3.0 / length**2 * np.outer(bond, bond)
    extent = np.mean(np.sum((center - center.mean(axis=0)) ** 2, axis=1))
    prior = [1.0 / extent] * 3 * robots + [1.0 / log.yaw_bias**2 if log.yaw_bias else 0.0] * robots
    return (matrix + np.diag(prior))[np.ix_(_free(log), _free(log))]


@pytest.mark.usefixtures("every")
def test_expected_errors_follow_from_the_covariance(swarm):
    """The covariance is inverted anew with each candidate."""
    log, center = swarm
    before = _information(log, center)
    kinds = set()

    for found in advise(log, CUES, center):
        rows = _rows(found, log, center)[:, _free(log)]
        after = before + rows.T @ rows / _noise(found, log)

        kinds.add(found.kind)
        for matrix, rmse in ((before, found.rmse_before), (after, found.rmse_after)):
            trace = np.trace(np.linalg.inv(matrix)[:87, :87])
            np.testing.assert_allclose(rmse, np.sqrt(trace / 30), rtol=1e-6)
    assert kinds == {"contact", "height", "position"}


def _measured(found, log, center):
    """What a candidate would measure of robots at some place."""
    i = found.robot
    if found.kind in {"height", "position"}:
        return center[i] if found.kind == "position" else center[i, 2:]
    own, j, its = found.contact
    arm = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    ends = (arm[i, own], arm[j, its]) if found.kind == "contact" else (0.0, 0.0)
    return np.array([np.linalg.norm(center[i] + ends[0] - center[j] - ends[1])])


@pytest.mark.usefixtures("every")
def test_images_differ_by_what_a_candidate_would_measure(swarm):
    """In standard deviations of what is expected; the doubt that remains follows from them."""
    log, center = swarm
    other = center.copy()
    other[7] += [1.0, 0.5, -2.0]
    images = [
        SimpleNamespace(weight=weight, position=place)
        for weight, place in [(0.6, center), (0.2, other)]
    ]
    information = _information(log, center)
    doubt = 0.75 * 0.25 * (1.0 + 0.25 + 4.0) / 30
    kinds = set()

    for found in advise(log, CUES, 0.5 * (center + other), images):
        rows = _rows(found, log, center)[:, _free(log)]
        spread = rows @ np.linalg.solve(information, rows.T)
        spread += _noise(found, log) * np.eye(len(rows))
        change = _measured(found, log, other) - _measured(found, log, center)
        apart = np.sqrt(change @ np.linalg.solve(spread, change))
        after = information + rows.T @ rows / _noise(found, log)
        square = [np.trace(np.linalg.inv(each)[:87, :87]) / 30 for each in (information, after)]
        left = min(1.0, np.exp(-(apart**2) / 8.0) / 2.0 / np.sqrt(0.75 * 0.25))

        kinds.add(found.kind)
        np.testing.assert_allclose(found.images_apart_sd, apart, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found.rmse_before, np.sqrt(square[0] + doubt), rtol=1e-6)
        np.testing.assert_allclose(found.rmse_after, np.sqrt(square[1] + left * doubt), rtol=1e-6)
    assert kinds == {"contact", "height", "position", "range"}


def _beacons():
    """Three beacons on a ceiling, a tag that ranges to them, and both images of its place."""
    log, _ = structure(Rule(docks=1, offset=0.0), 4, 0)
    place = np.array([[0.0, 0, 50], [60, 0, 50], [0, 60, 50], [20, 20, 30]])
    fixes = [[i, *axis, place[i] @ axis, 0.1, -1.0] for i in (1, 2) for axis in np.eye(3)]
    ranges = [[3, j, np.linalg.norm(place[3] - place[j]), 0.1, -1.0] for j in range(3)]
    log = replace(
        log, anchor_position=place[0], contacts=log.contacts[:0], fixes=np.array(fixes),
        ranges=np.array(ranges),
    )  # fmt: skip
    return log, [
        SimpleNamespace(weight=0.5, position=place * [1, 1, side] + [0, 0, 50 - side * 50])
        for side in (1, -1)
    ]


def test_a_height_decides_between_images_below_and_above_a_ceiling():
    """Without the images, the tag counts as known, and nothing is worth measuring as much."""
    log, images = _beacons()

    best, *_ = advise(log, ["ranges", "fixes"], images[0].position, images)
    plain = advise(log, ["ranges", "fixes"], images[0].position)

    assert (best.robot, best.kind in {"height", "position"}) == (3, True)
    assert best.images_apart_sd > 100
    assert best.rmse_before > 5.0
    assert best.rmse_after < 0.5
    assert all(np.isnan(each.images_apart_sd) for each in plain)
    assert all(each.rmse_before < 0.5 for each in plain)
    assert all(each.floppy_modes or each.rmse_after < 0.99 * each.rmse_before for each in plain)
    single = advise(log, ["ranges", "fixes"], images[0].position, images[:1])
    assert [each[:4] for each in single] == [each[:4] for each in plain]


@pytest.mark.parametrize("unit", [1.0, 30.0])
def test_a_range_to_a_robot_off_the_mirror_plane_decides(unit):
    """Ranges to robots in the plane, which are there already, are the same in both images.

    One to a robot beyond the longest range would differ more, and cannot be measured.
    """
    log, images = _beacons()
    further = np.array([[40.0, 40.0, 10.0], [40.0, 40.0, -300.0]])
    fixes = [
        [i, *axis, p @ axis, 0.1, -1.0] for i, p in enumerate(further, 4) for axis in np.eye(3)
    ]
    names = ("orientation_wxyz", "flip_height", "spawn_position")
    more = {name: np.concatenate([getattr(log, name), getattr(log, name)[-2:]]) for name in names}
    lengths = ("dock_radius", "dock_offset_body", "anchor_position")
    scaled = {name: unit * getattr(log, name) for name in lengths}
    six = replace(
        log, robot_id=np.arange(6), stances=None,
        fixes=np.concatenate([log.fixes, fixes]) * [1, 1, 1, 1, unit, unit, 1],
        ranges=log.ranges * [1, 1, unit, unit, 1], **more, **scaled,
    )  # fmt: skip
    images = [
        SimpleNamespace(weight=0.5, position=unit * np.concatenate([each.position, further]))
        for each in images
    ]

    ranges = [each for each in advise(six, ["ranges", "fixes"], images[0].position, images)
              if each.kind == "range"]  # fmt: skip

    assert [(each.robot, each.contact[1]) for each in ranges] == [(4, 3)]
    assert ranges[0].images_apart_sd > 50


@pytest.mark.usefixtures("every")
def test_readings_that_say_the_same_together_get_the_same_advice(swarm):
    """A range read 25 times with five times the noise is the range read once.

    Counted one by one, each reading would bring the prior that the two robots are near each other.
    """
    log, center = swarm
    often = np.repeat(log.ranges, 25, axis=0) * [1.0, 1.0, 1.0, 5.0, 1.0]

    once, read = (advise(each, CUES, center) for each in (log, replace(log, ranges=often)))

    np.testing.assert_allclose(
        [[each.rmse_before, each.rmse_after] for each in read],
        [[each.rmse_before, each.rmse_after] for each in once],
        rtol=1e-9,
    )
    assert [each.floppy_modes for each in read] == [each.floppy_modes for each in once]


@pytest.mark.usefixtures("every")
def test_floppy_modes_are_those_of_the_whole_matrix(swarm):
    """Its rank grows by those that a candidate removes, but for a turn of the whole swarm."""
    log, center = swarm
    matrix = measure(log, CUES).jacobian(center).toarray()[:, _free(log)]
    rank = np.linalg.matrix_rank(matrix, tol=1e-5)
    removed = set()

    for found in advise(log, CUES, center):
        more = np.concatenate([matrix, _rows(found, log, center)[:, _free(log)]])
        gauge = bool(log.yaw_bias) and found.kind == "position"

        assert np.linalg.matrix_rank(more, tol=1e-5) - rank - gauge == found.floppy_modes
        removed.add(found.floppy_modes)
    assert removed >= {0, 1, 2}


@pytest.mark.usefixtures("every")
def test_determined_are_those_of_bodies_welded_anew(swarm):
    """An update of the factors finds what factoring all rows with the candidate's does."""
    log, center = swarm
    rows, yaw_unknown = measure(log, CUES), log.yaw_bias > 0.0
    walks = rows.odometry
    before = FloppyMotions(weld(rows, center, yaw_unknown=yaw_unknown))
    changed = set()

    for found in advise(log, CUES, center)[::5]:
        stance = walks.final[[found.robot]]
        distances, places = [], []
        if found.kind == "contact":
            own, other, its = np.array(found.contact)[:, None]
            distances = [Distances.of(stance, own, walks.final[other], its, length=2.0, sd=0.01)]
        else:
            axes = np.eye(3)[2 if found.kind == "height" else 0 :]
            at, none = np.repeat(stance, len(axes)), np.full(len(axes), CENTER)
            places = [Coordinates.of(at, none, axes, axes @ center[found.robot], variance=1e-4)]
        one = Measurements.gather(walks, distances, places)
        joined = Measurements.gather(
            walks, [rows.distances, *distances], [rows.places, *places], [rows.offsets]
        )
        anew = FloppyMotions(weld(joined, center, yaw_unknown=yaw_unknown))
        further = further_rows(before.bodies, one, center)

        np.testing.assert_array_equal(before.robots(further), anew.robots())
        determined = np.flatnonzero(before.robots() & ~anew.robots())
        np.testing.assert_array_equal(found.determined, determined)
        changed.add(len(determined))
    assert {0, 1} <= changed


def test_a_contact_gains_what_it_promises(towers):
    """A log with the contact has as many floppy modes and robots less."""
    log, center = observe(towers[1], SensingParams()), towers[1].position
    before = observability(log, CUES, center)

    for found in advise(log, CUES, center):
        if found.kind == "contact":
            own, j, its = found.contact
            row = [[j, its, found.robot, own]]
            contacts = canonical_contacts(np.concatenate([log.contacts, row]).astype(np.int32))
            after = observability(replace(log, contacts=contacts), CUES, center)

            assert len(contacts) > len(log.contacts)
            assert before.floppy_modes - after.floppy_modes == found.floppy_modes
            determined = np.flatnonzero(before.floppy & ~after.floppy)
            np.testing.assert_array_equal(found.determined, determined)


def test_the_best_comes_first(towers):
    """A few of each kind; lengths are in the log's unit."""
    log, center = observe(towers[1], SensingParams()), towers[1].position
    lengths = ("dock_radius", "dock_offset_body", "anchor_position", "flip_height")
    in_mm = replace(log, **{name: 30.0 * getattr(log, name) for name in lengths}, length_unit="mm")

    found, same = advise(log, CUES, center), advise(in_mm, CUES, 30.0 * center)

    assert 3 <= len(found) <= 9
    errors = [one.rmse_after for one in found]
    assert errors == sorted(errors)
    assert found[0].rmse_before > errors[-1]
    np.testing.assert_allclose([one.rmse_after for one in same], 30.0 * np.array(errors))


def test_large_swarms_are_ranked_by_floppy_modes(towers, monkeypatch):
    """Without expected errors; the largest swarms get no advice."""
    log, center = observe(towers[1], SensingParams()), towers[1].position

    monkeypatch.setattr(advice, "MOST_ROBOTS", 0)
    modes = [one.floppy_modes for one in advise(log, CUES, center)]
    monkeypatch.setattr(rigidity, "MOST_UNKNOWNS", -1)

    assert modes == sorted(modes, reverse=True)
    assert modes[0] > 1
    assert advise(log, CUES, center) is None


def test_an_anchor_alone_needs_no_advice():
    """Its position is known."""
    log, center = structure(Rule(), 1, 0)

    assert advise(log, CUES, center) == []


@pytest.mark.parametrize("robots", [30, 100])
def test_one_factorization_serves_all_candidates(monkeypatch, robots):
    """Factoring is what takes longest in large swarms."""
    log, center = structure(Rule(kind="loops"), robots, 0)
    factored = []
    factor = rigidity.factored
    monkeypatch.setattr(rigidity, "factored", lambda *a, **k: factored.append(1) or factor(*a, **k))

    assert len(advise(log, CUES, center)) > 3
    assert len(factored) == 1


@pytest.mark.parametrize("far", [1e7, 1e9, 1e22])
def test_advice_survives_a_robot_that_is_far_away(far):
    """A slip of a decimal point must not end the page that would show it.

    Two robots in contact with each other alone are within an extent whose inverse square rounding
    hides beside their contact.
    """
    log, truth = structure(Rule(kind="loops"), robots=8, seed=1)
    tied = log.contacts[(log.contacts[:, [0, 2]] < 6).all(axis=1)]
    apart = replace(log, contacts=np.concatenate([tied, np.array([[6, 0, 7, 1]], np.int32)]))
    position = truth.copy()
    position[3, 0] += far

    found = advise(apart, CUES, position)

    assert found
    assert all(np.isfinite([each.rmse_before, each.rmse_after]).all() for each in found)


def _together(log, center, further):
    """Expected RMSE with several candidates, whose covariance is inverted anew."""
    information = _information(log, center)
    for one in further:
        rows = _rows(one, log, center)[:, _free(log)]
        information = information + rows.T @ rows / _noise(one, log)
    return np.sqrt(np.trace(np.linalg.inv(information)[:87, :87]) / 30)


@pytest.mark.parametrize("kinds", [(), ("contact", "height")])
def test_errors_of_several_measurements_are_those_of_all_together(swarm, kinds):
    """The covariance is inverted anew with all so far; each step is from the one before."""
    log, center = swarm

    found = advise_together(log, CUES, center, budget=5, kinds=kinds)

    assert len(found) == 5
    assert {one.kind for one in found} <= set(kinds or ("position",))
    for count, one in enumerate(found):
        before, after = (_together(log, center, found[:k]) for k in (count, count + 1))
        np.testing.assert_allclose([one.rmse_before, one.rmse_after], [before, after], rtol=1e-6)


@pytest.mark.usefixtures("every")
def test_each_measurement_is_the_best_beside_those_before(swarm):
    """No other candidate leaves less error; a larger budget starts with the same ones."""
    log, center = swarm
    every = advise(log, CUES, center)

    found = advise_together(log, CUES, center, budget=3)

    for count, one in enumerate(found):
        others = [_together(log, center, [*found[:count], other]) for other in every]
        assert one.rmse_after <= min(others) * (1 + 1e-9)
    fewer = advise_together(log, CUES, center, budget=2)
    assert [(one.kind, one.robot) for one in fewer] == [(one.kind, one.robot) for one in found[:2]]


def test_several_measurements_remove_floppy_modes_once(towers):
    """Modes and robots of all add up to those of a log that has the measurements."""
    log, center = observe(towers[1], SensingParams()), towers[1].position

    found = advise_together(log, CUES, center, budget=4, kinds=("contact",))

    rows = [[one.contact[1], one.contact[2], one.robot, one.contact[0]] for one in found]
    contacts = canonical_contacts(np.concatenate([log.contacts, rows]).astype(np.int32))
    before = observability(log, CUES, center)
    after = observability(replace(log, contacts=contacts), CUES, center)
    assert len(contacts) == len(log.contacts) + 4
    assert sum(one.floppy_modes for one in found) == before.floppy_modes - after.floppy_modes
    np.testing.assert_array_equal(
        np.sort(np.concatenate([one.determined for one in found])),
        np.flatnonzero(before.floppy & ~after.floppy),
    )


def test_a_budget_beyond_all_candidates_takes_them_all():
    """An anchor alone has none."""
    log, center = structure(Rule(), 3, 0)
    alone, place = structure(Rule(), 1, 0)

    found = advise_together(log, CUES, center, budget=1000, kinds=("position",))

    assert [one.robot for one in found] in ([1, 2], [2, 1])
    assert advise_together(alone, CUES, place, budget=3) == []


def test_images_part_by_all_that_is_measured(swarm):
    """The difference of several candidates is that of their rows together, not of each alone."""
    log, center = swarm
    other = center.copy()
    other[10:, 2] += np.linspace(0.1, 1.0, len(center) - 10)
    images = [
        SimpleNamespace(weight=weight, position=at) for weight, at in [(2, center), (1, other)]
    ]

    found = advise_together(log, CUES, center, images, budget=3, kinds=("height",))

    covariance = np.linalg.inv(_information(log, center))
    for count, one in enumerate(found, start=1):
        rows = np.concatenate([_rows(each, log, center) for each in found[:count]])[:, _free(log)]
        change = [other[each.robot, 2] - center[each.robot, 2] for each in found[:count]]
        own = rows @ covariance @ rows.T + Precision().height ** 2 * np.eye(count)
        apart = np.sqrt(change @ np.linalg.solve(own, change))
        np.testing.assert_allclose(one.images_apart_sd, apart, rtol=1e-5)
