"""Measured coordinates and distances place robots, with contacts or without."""

import dataclasses

import numpy as np
import pytest

from tests import foreign
from tests.structures import with_fixes, with_ranges
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.chains.views import start_sigma
from tiswarm.localization.methods import localize
from tiswarm.localization.mixture.assessment import assess
from tiswarm.localization.peers.settings import HopByHopParams, LeastSquaresParams
from tiswarm.localization.settings import Cues, CuesOfNamedDocks, JointParams
from tiswarm.measurements.observability import observability
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import SensingParams, observe

pytestmark = pytest.mark.unchecked

METHODS = [
    JointParams(chains=2, steps=600, hold_steps=200, cues=Cues(non_overlap=False)),
    LeastSquaresParams(cues=Cues(non_overlap=False)),
    HopByHopParams(cues=CuesOfNamedDocks(non_overlap=False)),
]
CONTACTS = ("contacts", "height", "ground", "walk_contacts")


def _without_contacts(params):
    """Settings of a method in which coordinates and distances alone count."""
    cues = dataclasses.replace(params.cues, **dict.fromkeys(CONTACTS, False))
    return dataclasses.replace(params, cues=cues)


@pytest.fixture(scope="module")
def log(towers) -> SensingLog:
    """What the robots of a small tower sensed, without noise."""
    return observe(towers[0], SensingParams())


@pytest.mark.parametrize("params", METHODS, ids=lambda p: p.method)
def test_fixes_alone_place_robots_as_well_as_they_can(log, towers, params):
    """Five planes of one robot meet in a point, with the error that their directions imply."""
    fixed = with_fixes(log, towers[0], range(1, log.robot_count), each=5, sd=0.1)
    alone = _without_contacts(params)

    found = localize(fixed, alone)

    error = found.position - towers[0].position
    rows = fixed.fixes.reshape(log.robot_count - 1, 5, 7)
    information = np.einsum("nki,nkj->nij", rows[:, :, 1:4], rows[:, :, 1:4]) / 0.1**2
    squares = np.einsum("ni,nij,nj->n", error[1:], information, error[1:])
    assert 0.6 < squares.mean() / 3.0 < 1.6
    assert found.observability.floppy_modes == 0
    assert not found.disconnected.any()


@pytest.mark.parametrize("params", METHODS, ids=lambda p: p.method)
def test_a_walk_carries_a_fix_to_where_it_ends(log, towers, params):
    """Robots whose first stances were found are known at their last, at any yaw of the fixes."""
    stances = log.stances
    robot = np.flatnonzero(np.diff(stances.start))
    center = np.array([towers[0].walks[i].center[0] for i in robot])
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    rows = [
        np.column_stack([stances.start[robot], np.tile(n, (len(robot), 1)), center @ n,
                         np.tile([0.01, -1.0], (len(robot), 1))])
        for n in turn
    ]  # fmt: skip
    fixes = np.concatenate(rows)
    fixes = fixes[np.lexsort(fixes.T[::-1])]
    fixed = dataclasses.replace(log, stances=dataclasses.replace(stances, fixes=fixes))
    alone = _without_contacts(params)

    found = localize(fixed, alone)

    error = np.linalg.norm(found.position - towers[0].position, axis=1)
    assert error[robot].max() < 0.1


def test_fixes_remove_floppy_modes(log, towers):
    """One fix along any direction removes one mode of a robot that contacts alone leave loose."""
    before = observability(log, ["contacts"])
    loose = np.flatnonzero(before.floppy)[:1]

    fixed = with_fixes(log, towers[0], loose, each=1, sd=0.1)

    after = observability(fixed, ["contacts", "fixes"])
    assert after.floppy_modes == before.floppy_modes - 1


@pytest.mark.parametrize("params", [JointParams(), *METHODS[1:]], ids=lambda p: p.method)
def test_ranges_place_robots_among_some_that_are_known(log, towers, params):
    """With four known robots here and there, distances within 12 R determine the others."""
    here_and_there = range(2, log.robot_count, log.robot_count // 4)
    known = with_fixes(log, towers[0], here_and_there, each=5, sd=0.02)
    ranged = with_ranges(known, towers[0], reach=12.0, sd=0.02)

    found = localize(ranged, _without_contacts(params))

    error = np.linalg.norm(found.position - towers[0].position, axis=1)
    assert found.observability.floppy_modes == 0
    assert np.median(error) < 0.05


def test_chains_unfold_what_ranges_alone_tie(towers):
    """Robots whose positions ranges determine are placed there, though the first guess folds."""
    ranged = observe(towers[1], SensingParams(suite="kilobot"))

    found = localize(ranged, JointParams(chains=8))

    error = np.linalg.norm(found.position - towers[1].position, axis=1)
    assert found.convergence.converged
    assert np.sqrt((error[~found.observability.floppy] ** 2).mean()) < 0.5


@pytest.mark.parametrize("seed", [1, 2])
def test_many_readings_of_a_range_hold_no_chain_where_it_begins(seed):
    """A hundred readings of each range by four beacons; the mean of a hundred is off by 1 cm."""
    rng = np.random.default_rng(seed)
    tags = foreign.apart(rng, [1.0, 1.0, 0.3], [5.0, 4.0, 1.5], 8)
    log, truth = foreign.tags_among(foreign.ROOM, tags, sd=0.0, seed=seed)
    every = log.ranges[log.ranges[:, 1] < len(foreign.ROOM)].repeat(100, axis=0)
    every[:, 2] += 0.1 * rng.normal(size=len(every))
    every[:, 3] = 0.1
    log = dataclasses.replace(log, ranges=every)

    estimate = localize(log, JointParams())

    assert estimate.convergence.trusted
    assert np.linalg.norm(estimate.position - truth, axis=1).max() < 0.1


@pytest.mark.parametrize(("touch", "sigma"), [(False, [2.0, 5.0]), (True, [0.6, 5.0])])
def test_chains_start_hotter_where_ranges_alone_tie_robots(towers, touch, sigma):
    """Contacts tie them as firmly as ever, with ranges beside them or without."""
    ranged = observe(towers[1], SensingParams(suite="kilobot", touch=touch))
    settings = [JointParams(), JointParams(start_sigma=5.0)]

    found = [start_sigma(pose_problem(ranged, params), params) for params in settings]

    assert found == sigma


def test_a_robot_on_a_beam_is_near_those_that_joined_before(towers):
    """Two planes of one lighthouse leave a line; `joint` takes its point near earlier robots."""
    params = SensingParams(suite="coachbot-v2", beacons=((100.0, 100.0, 90.0),))

    found = localize(observe(towers[0], params), METHODS[0])

    away = np.linalg.norm(found.position - towers[0].position, axis=1)
    size = np.linalg.norm(towers[0].position - towers[0].position.mean(axis=0), axis=1)
    assert found.disconnected[1:].all()
    assert (away**2).mean() < 2.0 * (size**2).mean()


@pytest.mark.parametrize(("miss", "outliers"), [(0.0, []), (3.5, []), (7.0, [[3, 0, -1, 1, -1]])])
def test_an_assessed_range_is_an_outlier_from_five_sd_on(miss, outliers):
    """Fixes hold the robots; the range from robot 3 to robot 1 is too long by so many sd."""
    _, place = foreign.without_beacons(5, 0)
    log = foreign.with_places(foreign.silent(place), place, range(1, 5))
    late = {(1, 3): 0.1 * miss}
    log = foreign.with_all_ranges(log, place, sd=0.0, seed=0, stated=0.1, late=late)

    found = assess(log, ("fixes", "ranges"), place / log.dock_radius, is_guess=np.zeros(5, bool))

    assert found.outlier_contacts.tolist() == outliers


@pytest.mark.parametrize(("off", "converged"), [(0.0, True), (3.0, True), (8.0, False)])
def test_the_sd_of_others_excuses_no_robot_that_is_far_off(off, converged):
    """Eleven robots are where their fixes say; the last one is off by so many of its own sd.

    All chi-square beyond noise is that of one robot, which nine of ten robots would hide.
    """
    _, place = foreign.without_beacons(13, 0)
    log = foreign.with_places(foreign.silent(place), place, range(1, 13))
    sd = np.full(13, 4.0 * foreign.BEACON_SD / log.dock_radius)
    position = place / log.dock_radius
    position[12] += off * sd[12] / np.sqrt(3.0)

    found = assess(log, ("fixes",), position, is_guess=np.zeros(13, bool), sd=sd)

    assert found.convergence.converged == converged


@pytest.mark.parametrize("ranged", [False, True])
def test_consistency_is_testable_only_with_spare_measurements(ranged):
    """Three fixes a robot fit any lie; a range between any two of five robots shows one."""
    _, place = foreign.without_beacons(5, 0)
    log = foreign.with_places(foreign.silent(place), place, range(1, 5))
    log = foreign.with_all_ranges(log, place, sd=0.0, seed=0, stated=0.1) if ranged else log

    found = assess(log, ("fixes", "ranges"), place / log.dock_radius, is_guess=np.zeros(5, bool))

    verdict = found.convergence
    assert verdict.consistent is (True if ranged else None)
    assert (verdict.testable, verdict.spare) == (ranged, 10 * ranged)
