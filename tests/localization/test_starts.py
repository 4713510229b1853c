"""Starts where measured distances fit as a whole."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests import foreign
from tests.structures import with_ranges
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.mixture import frames
from tiswarm.localization.mixture.ends import Posed, further_starts
from tiswarm.localization.mixture.frames import scaled_distances
from tiswarm.localization.settings import LARGE, JointParams
from tiswarm.sensing import SensingParams, observe

PARAMS = JointParams()
EXACT = 1e-6
"""Of coordinates from the square root of a sum of squares, relative to their size [1]."""


def starts_of(log):
    """Both images by multidimensional scaling [R]."""
    return scaled_distances(pose_problem(log, PARAMS), log.anchor_position / log.dock_radius)


def off_after_turn(position, place):
    """Distance of each robot to the truth after the best turn about the anchor (Kabsch)."""
    arm, there = position - position[0], place - place[0]
    turn = Rotation.align_vectors(there, arm)[0]
    return np.linalg.norm(turn.apply(arm) - there, axis=1)


@pytest.mark.parametrize("robots", [4, 9, 20])
def test_all_exact_distances_give_the_truth_up_to_turn_and_hand(robots):
    """Two images, of which one is the truth turned about the anchor."""
    log, place = foreign.without_beacons(robots, 1, sd=0.0)

    found = starts_of(log)

    off = sorted(off_after_turn(image, place / log.dock_radius).max() for image in found)
    assert len(found) == 2
    assert off[0] < EXACT * 50.0
    assert off[1] > 0.1
    for image in found:
        np.testing.assert_allclose(image[0], log.anchor_position / log.dock_radius, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_known_robots_say_how_the_shape_is_turned_and_which_hand_it_has(seed):
    """Beacons of several heights: one of both images is the truth."""
    log, place = foreign.room_of_tags(foreign.ROOM, seed, sd=0.0, stated=0.1)
    place = place / log.dock_radius
    apart = np.linalg.norm(place[:4, None] - place[None, :4], axis=2)
    pair = np.array([[i, j, apart[i, j] * 0.1, 0.1, -1.0] for i in range(4) for j in range(i)])
    every = replace(log, ranges=np.concatenate([pair, log.ranges]))

    found = starts_of(every)

    off = [np.linalg.norm(image - place, axis=1).max() for image in found]
    assert min(off) < 1e-3
    assert max(off) > 1.0


def test_shortest_ways_stand_in_for_distances_that_nothing_measured(tall_towers):
    """With a few known robots the tower is found to a few R, which chains then mend."""
    history = tall_towers[0]
    log = observe(history, SensingParams())
    log = replace(log, stances=None, contacts=log.contacts[:0], noise=None)
    log = with_ranges(log, history, reach=8.0, sd=0.01)
    log = foreign.with_places(log, history.position, [4, 11, 18, 25])

    off = [
        np.sqrt(((image - history.position) ** 2).sum(axis=1).mean()) for image in starts_of(log)
    ]

    size = np.sqrt(((history.position - history.position.mean(axis=0)) ** 2).sum(axis=1).mean())
    assert min(off) < 0.5 * size


def test_contacts_alone_and_too_many_robots_have_no_such_start(tall_towers, monkeypatch):
    """Contacts say too little of distances, and all distances of many robots take too long."""
    contacts = observe(tall_towers[0], SensingParams())
    ranged = with_ranges(contacts, tall_towers[0], reach=6.0, sd=0.1)
    few = pose_problem(ranged, PARAMS)
    anchor = ranged.anchor_position

    assert starts_of(contacts) == []
    assert len(scaled_distances(few, anchor)) == 2
    assert further_starts(Posed(ranged, JointParams(refine=False), few)) == []
    assert PARAMS.refines(LARGE)
    monkeypatch.setattr(frames, "MOST_ROBOTS", 29)
    assert scaled_distances(few, anchor) == []


def test_nothing_measured_is_no_trouble():
    """Neither an anchor alone nor fixes alone have distances to fit."""
    _, place = foreign.without_beacons(4, 0)
    silent = foreign.silent(place)
    fixed = foreign.with_places(silent, place, [1, 2, 3])

    found = [
        further_starts(Posed(log, PARAMS, pose_problem(log, PARAMS)))
        for log in (silent, fixed, foreign.silent(place[:1]))
    ]

    assert found == [[], [], []]


def test_starts_are_minima_and_an_image_that_is_excluded_is_left_out():
    """Beacons in one plane leave both; with those of several heights all starts are right."""
    one, place = foreign.room_of_tags(foreign.ROOM, 0)
    two, level = foreign.room_of_tags(foreign.CEILING, 0)

    room, ceiling = (
        further_starts(Posed(log, PARAMS, pose_problem(log, PARAMS))) for log in (one, two)
    )

    off = [np.linalg.norm(start - place / one.dock_radius, axis=1).max() for start in room]
    assert 0.0 < max(off) < 5.0
    assert len(ceiling) == 2
    image = level * [1.0, 1.0, -1.0] + [0.0, 0.0, 5.0]
    for at in (level, image):
        off = [np.linalg.norm(start - at / two.dock_radius, axis=1).max() for start in ceiling]
        assert min(off) < 5.0


@pytest.mark.parametrize("seed", range(4))
def test_the_likelier_image_comes_first(seed):
    """Of a wavy ring of beacons; the more it waves, the more it excludes the other image."""
    least = 5.0
    for amplitude in (1.0, 0.1):
        log, place = foreign.nearly_flat(amplitude, seed)

        found = further_starts(Posed(log, PARAMS, pose_problem(log, PARAMS)))

        off = [np.linalg.norm(start - place / log.dock_radius, axis=1).max() for start in found]
        assert off[0] < least
        assert amplitude < 1.0 or max(off) < least


def test_robots_that_no_range_ties_have_a_start_too():
    """They stand as far off as any other; nothing is NaN."""
    log, _ = foreign.without_beacons(8, 0, sd=0.0)
    some = replace(log, ranges=log.ranges[log.ranges[:, 0] < 6])

    found = starts_of(some)

    for image in found:
        assert np.isfinite(image).all()
        size = np.linalg.norm(image[:6] - image[0], axis=1).max()
        assert np.linalg.norm(image[6:] - image[0], axis=1).min() > 0.3 * size


def test_ranges_below_what_they_share_are_ways_of_no_length(recwarn):
    """A range less the shift of all ranges may be negative; no way is shorter than none."""
    log, _ = foreign.without_beacons(9, 1, sd=0.0)
    ranges = log.ranges.copy()
    ranges[:3, 2] *= -1.0

    images = starts_of(replace(log, ranges=ranges))

    assert len(images) == 2
    assert np.isfinite(images).all()
    assert [str(warning.message) for warning in recwarn] == []
