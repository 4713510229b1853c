"""Second places of parts: found by mirroring, and solutions unless a mode is floppy."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components

from tests import foreign, structures
from tests.localization.test_mixture import chains_at
from tiswarm.base.robot import RobotGeometry
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.methods import localize
from tiswarm.localization.mixture import MIXTURE
from tiswarm.localization.mixture import mixture as mixture_module
from tiswarm.localization.mixture.ends import Fit
from tiswarm.localization.mixture.frames import PartImages, hanging_parts
from tiswarm.localization.mixture.mixture import mixed
from tiswarm.localization.settings import Cues, JointParams
from tiswarm.measurements.contacts import touching
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.params import TowerParams

pytestmark = pytest.mark.unchecked

FINAL = JointParams(cues=Cues(walk_contacts=False))
TILTED = SensingParams(tilt_noise_deg=0.5)
MET = 1e-3
"""Excess of a cost that rounding and a few steps leave."""


def tower(robots, seed, sensing=TILTED):
    """A planar tower of robots with wide triangles, and what it sensed."""
    params, robot = TowerParams(plane=True), RobotGeometry(rho=2.2)
    (history,) = grow(params, robots=robots, seeds=[seed], robot=robot)
    return observe(history, sensing), history.position


def ranging(pairs, seed):
    """A log of robots in the plane y = 0 that measure some distances of centers."""
    rng = np.random.default_rng(seed)
    robots = max(max(pair) for pair in pairs) + 1
    place = 4.0 * rng.normal(size=(robots, 3)) * [1.0, 0.0, 1.0]
    log = foreign.with_all_ranges(foreign.silent(place), place, sd=0.01, seed=seed)
    ends = [tuple(sorted(pair)) for pair in log.ranges[:, [0, 1]].astype(int).tolist()]
    kept = [n for n, pair in enumerate(ends) if pair in {tuple(sorted(p)) for p in pairs}]
    free = np.arange(1, robots)
    every = np.ones(robots - 1)
    fixes = np.column_stack(
        [free, np.outer(every, [0.0, 1.0, 0.0]), 0.0 * every, 0.01 * every, -every]
    )
    exact = np.linalg.norm(
        place[log.ranges[:, 0].astype(int)] - place[log.ranges[:, 1].astype(int)], axis=1
    )
    ranges = np.column_stack([log.ranges[:, :2], exact, log.ranges[:, 3:]])[kept]
    return replace(log, ranges=ranges, fixes=fixes), place / log.dock_radius


@settings(max_examples=50)
@given(
    pairs=st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), min_size=1, max_size=12).filter(
        lambda pairs: all(one != other for one, other in pairs)
    )
)
def test_parts_hang_on_one_robot_or_on_two(pairs):
    """They are the components that are left without these, but for that of the anchor."""
    log, _ = ranging([*pairs, (0, 5)], 0)
    rows = pose_problem(log, FINAL).rows
    pair = np.column_stack([rows.robot[: len(rows.neighbor)], rows.neighbor])
    whole = connected_components(touching(pair, 6), directed=False)[1]
    tied = {robot for robot in range(6) if whole[robot] == whole[0]}
    expected = {frozenset({robot}) for robot in range(1, 6)}
    for one in range(6):
        for other in range(6):
            kept = pair[~np.isin(pair, [one, other]).any(axis=1)]
            number = connected_components(touching(kept, 6), directed=False)[1]
            for part in range(number.max() + 1):
                robots = {*np.flatnonzero(number == part).tolist()}
                if 0 not in robots and not robots & {one, other} and robots <= tied:
                    expected.add(frozenset(robots))

    found = {frozenset(np.flatnonzero(part).tolist()) for part in hanging_parts(rows)}

    assert found == expected


@settings(max_examples=10)
@given(seed=st.integers(0, 500))
def test_an_image_meets_all_measurements_as_well_as_the_part_does(seed):
    """Where two distances hold a part in a plane; the image of the image is the part."""
    log, truth = tower(8, seed, SensingParams())
    rows = pose_problem(log, FINAL).rows
    pairs = len(rows.neighbor)
    images = PartImages(log, rows, 0.05**2, non_overlap=False)
    # Docks that are about to touch count as contacts.
    limit = np.abs(rows.residual(truth)).max() + MET

    for position, _ in images.of(truth, np.zeros(8)):
        moved = (position != truth).any(axis=1)
        crossing = moved[rows.robot[:pairs]] != moved[rows.neighbor]
        known = rows.places.direction[moved[rows.robot[pairs:]]]
        if crossing.sum() > 3 - np.linalg.matrix_rank(known):
            continue  # more distances than two points meet
        assert np.abs(rows.residual(position)).max() < limit
        shift = (position - truth)[moved]
        np.testing.assert_allclose(shift, shift[[0] * len(shift)], atol=1e-9)
        back = [np.abs(each - truth).max() for each, _ in images.of(position, np.zeros(8))]
        assert min(back) < MET


def test_parts_that_measure_centers_alone_are_mirrored():
    """Robots 3 and 4 hang on 1 and 2: both change sides, and their shape turns over."""
    pairs = [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3), (2, 4), (3, 4), (1, 4)]
    log, place = ranging(pairs, 3)
    rows = pose_problem(log, FINAL).rows

    found = [each for each, _ in PartImages(log, rows, non_overlap=False).of(place, np.zeros(5))]

    along = (place[2] - place[1]) / np.linalg.norm(place[2] - place[1])
    arm = place[3:] - place[1]
    expected = place.copy()
    expected[3:] = place[1] + 2.0 * np.outer(arm @ along, along) - arm
    assert min(np.abs(each - expected).max() for each in found) < MET


def test_robots_are_mirrored_in_the_plane_of_the_known_ones():
    """All tags together: ranges to three known robots exclude neither image."""
    log, place = foreign.room_of_tags(foreign.ROOM[:3], 2)
    rows, position = pose_problem(log, FINAL).rows, place / log.dock_radius
    parts = PartImages(log, rows, non_overlap=False)

    found = [each for each, _ in parts.of(position, np.zeros(len(position)))]

    alike = [np.abs(rows.residual(each) - rows.residual(position)).max() < MET for each in found]
    moved = [(each != position).any(axis=1).sum() for each in found]
    assert len(position) - 3 in np.array(moved)[alike]


@pytest.fixture(scope="module")
def mirrored():
    """A tower, chains that all end at the image of one part, and the part at the truth."""
    log, truth = tower(10, 100010)
    problem = pose_problem(log, FINAL)
    chains = chains_at(truth[None])
    fit = Fit(log, FINAL, problem, chains, np.zeros(1, np.bool_))
    best, *further = mixed(fit).solutions
    return fit, best, further


def _started(fit, *position):
    """The same fit, but its chains end at some solutions."""
    chains = chains_at(np.array([each.position for each in position]))
    return replace(fit, annealed=chains, has_failed=np.zeros(len(position), np.bool_))


def test_a_second_place_that_no_chain_finds_is_a_solution(mirrored):
    """From either place, with the weight that its cost and its width give it."""
    fit, best, further = mirrored
    assert further

    other = mixed(_started(fit, further[0])).solutions

    weight = {round(each.weight, 2) for each in (best, *further)}
    near = [np.linalg.norm(each.position - best.position, axis=1).max() for each in other]
    found = other[int(np.argmin(near))]
    assert min(near) < 0.1
    assert found.chains == 0
    assert found.weight == pytest.approx(best.weight, abs=0.1), weight
    # The truth was in no sphere of an estimate that knew of one place.
    apart = np.linalg.norm(further[0].position - best.position, axis=1)
    assert apart.max() > 1.0


def test_images_of_many_robots_move_alone_before_all_robots_do(monkeypatch):
    """Those that fall back are not searched for, and the others are solutions as before."""
    log, truth = tower(12, 100005)
    problem = pose_problem(log, FINAL)
    fit = Fit(log, FINAL, problem, chains_at(truth[None]), np.zeros(1, np.bool_))
    searched = []
    search = mixture_module._fitted  # noqa: SLF001 - the time of an image is spent there

    def counting(*arguments):
        searched[-1] += 1
        return search(*arguments)

    monkeypatch.setattr(mixture_module, "_fitted", counting)
    weights = []
    for most in (200, 0):
        monkeypatch.setattr(mixture_module, "MIXTURE", replace(MIXTURE, image_robots=most))
        searched.append(0)
        weights.append([solution.weight for solution in mixed(fit).solutions])

    assert len(weights[0]) > 1
    assert searched[1] < searched[0]
    np.testing.assert_allclose(weights[1], weights[0], atol=1e-6)


def test_chains_at_both_places_leave_the_same_mixture(mirrored):
    """Images are no chains: how often these found a place does not change its weight."""
    fit, best, further = mirrored

    once, often = (mixed(_started(fit, best, *[further[0]] * times)) for times in (1, 5))

    np.testing.assert_allclose(once.position, often.position, atol=0.02)
    np.testing.assert_allclose(once.sd, often.sd, rtol=0.05, atol=0.02)
    assert sorted(each.chains for each in often.solutions)[-2:] == [1, 5]


def test_ends_one_dock_apart_are_two_solutions(mirrored):
    """Less than two dock radii apart, and far beyond their sd."""
    fit, best, further = mirrored
    apart = np.linalg.norm(further[0].position - best.position, axis=1)
    assert 1.0 < apart.max() < 2.0

    found = mixed(_started(fit, best, further[0])).solutions

    assert [each.chains for each in found[:2]] == [1, 1]


def test_joint_lists_the_truth_where_all_chains_end_elsewhere():
    """Of eight chains on this tower none ends at the truth."""
    log, truth = tower(10, 100021)

    found = localize(log, FINAL)

    away = [np.linalg.norm(each.position - truth, axis=1).max() for each in found.solutions]
    assert min(away) < 0.3
    assert found.convergence.trusted


@pytest.mark.parametrize("docks", [3, 6])
def test_open_structures_are_left_to_their_chains(docks):
    """Where a mode is floppy, each solution has chains, and ends within a dock's width are one."""
    log, _ = structures.structure(structures.Rule(docks=docks), 12, 100000)

    found = localize(log, FINAL)

    assert all(each.chains > 0 for each in found.solutions)
    place = np.array([each.position for each in found.solutions])
    apart = np.linalg.norm(place[:, None] - place, axis=3).max(axis=2)
    assert (apart[np.triu_indices(len(place), 1)] > 1.0).all()
