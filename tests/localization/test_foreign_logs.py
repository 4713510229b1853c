"""Small logs of other systems: an estimate is right, or says in what way it is not."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests import foreign
from tiswarm.localization.methods import localize, localize_many
from tiswarm.localization.settings import JointParams

pytestmark = pytest.mark.unchecked

SEEDS = [0, 1]
NEAR = 0.05
"""Error of tags where many distances measure them, or exact ones [m]."""


def found_in(log, place):
    """Localize, and compute how far off each robot is [m]."""
    estimate = localize(log, JointParams())
    return estimate, np.linalg.norm(estimate.position - place, axis=1)


def assert_honest(estimate, off):
    """No robot of a trusted estimate is off by more than 3 sd; that is 1e-5 of normal errors."""
    is_off = off > 3.0 * estimate.sd + 1e-9
    assert not (estimate.convergence.trusted and is_off.any())


def rms(off):
    """Root mean square."""
    return np.sqrt((off**2).mean())


@pytest.mark.parametrize("seed", SEEDS)
def test_tags_among_beacons_of_all_heights_are_found(seed):
    """Ranges are exact and stated as 0.1 m; beacons are fixed to 1 mm.

    A mirror image of the room meets all ranges, and misses fixes by meters.
    """
    log, place = foreign.room_of_tags(foreign.ROOM, seed, sd=0.0, stated=0.1)

    estimate, off = found_in(log, place)

    assert estimate.convergence.trusted
    assert len(estimate.solutions) == 1
    assert off.max() < NEAR
    assert_honest(estimate, off)


@pytest.mark.parametrize("seed", SEEDS)
def test_beacons_in_one_plane_leave_two_images(seed):
    """Both are solutions, as likely as each other; sd spans them, and robots are mirrored."""
    log, place = foreign.room_of_tags(foreign.CEILING, seed)

    estimate, off = found_in(log, place)

    image = place * [1.0, 1.0, -1.0] + [0.0, 0.0, 5.0]
    apart = np.linalg.norm(image - place, axis=1)[4:]
    first, second = (solution.position[4:] for solution in estimate.solutions)
    assert np.linalg.norm(first - second, axis=1) == pytest.approx(apart, abs=0.6)
    assert min(rms(np.linalg.norm(s - place[4:], axis=1)) for s in (first, second)) < 0.3
    assert [s.weight for s in estimate.solutions] == pytest.approx([0.5, 0.5], abs=0.01)
    assert estimate.known[4:] == ["mirrored"] * 6
    half = 0.5 * np.linalg.norm(first - second, axis=1)
    assert (estimate.sd[4:] >= 0.99 * half).all()
    assert estimate.convergence.trusted
    assert_honest(estimate, off)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("amplitude", [0.3, 0.1, 0.06])
def test_the_less_likely_image_weighs_what_its_chi_square_says(amplitude, seed):
    """Beacons that are nearly in a plane exclude it, or leave it the odds exp(-chi-square / 2)."""
    log, place = foreign.nearly_flat(amplitude, seed)

    estimate, off = found_in(log, place)

    likely = estimate.solutions
    away = [np.linalg.norm(s.position - place, axis=1).max() for s in likely]
    assert min(away) < NEAR
    assert len(likely) == 1 or amplitude < 0.3
    if len(likely) == 1:
        assert off.max() < NEAR
        assert not estimate.mirrored.any()
    else:
        odds = np.exp(0.5 * (likely[0].chi_square - likely[1].chi_square))
        assert likely[1].weight / likely[0].weight == pytest.approx(odds, rel=0.2)
        assert np.flatnonzero(estimate.mirrored).tolist() == [30]
        share = np.sqrt(likely[0].weight * likely[1].weight)
        apart = np.linalg.norm(likely[0].position[30] - likely[1].position[30])
        assert estimate.sd[30] >= 0.99 * share * apart
    assert estimate.convergence.trusted
    assert_honest(estimate, off)


def aligned(position, place):
    """Turn positions about the anchor, mirrored or not, to be nearest to true ones (Kabsch)."""
    arm, there = position - position[0], place - place[0]
    u, _, vt = np.linalg.svd(arm.T @ there)
    return place[0] + arm @ (u @ vt)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("robots", [6, 12])
def test_without_beacons_the_shape_is_known_and_the_frame_is_free(robots, seed):
    """Chains that are turned against each other have a mean that is too small."""
    log, place = foreign.without_beacons(robots, seed)

    estimate, _ = found_in(log, place)

    off = np.linalg.norm(aligned(estimate.position, place) - place, axis=1)
    assert estimate.free_frame == ("rotation", "hand")
    assert rms(off) < 0.2
    assert estimate.convergence.trusted
    assert_honest(estimate, off)


def test_sd_without_beacons_is_that_of_the_shape():
    """By the pseudo-inverse of the information: turns about the anchor are left out."""
    for seed in SEEDS:
        log, place = foreign.without_beacons(12, seed)

        estimate, _ = found_in(log, place)

        robot, other = log.ranges[:, :2].astype(int).T
        way = estimate.position[robot] - estimate.position[other]
        way /= 0.1 * np.linalg.norm(way, axis=1, keepdims=True)
        jacobian = np.zeros((len(robot), 12, 3))
        jacobian[np.arange(len(robot)), robot] = way
        jacobian[np.arange(len(robot)), other] = -way
        jacobian = jacobian[:, 1:].reshape(len(robot), -1)
        covariance = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-9, hermitian=True)
        shape = np.sqrt(np.diag(covariance).reshape(-1, 3).sum(axis=1))
        assert np.median(estimate.sd[1:] / shape) == pytest.approx(1.0, rel=0.5)


REFLECTED = {(1, 6): 32.2}
AROUND = {(1, 6): 1.5, (2, 8): 2.0, (4, 9): 1.0}


def attainable(log, place, late):
    """Least squares from the truth without ranges that are late, with beacons where they are."""
    other, robot = log.ranges[:, 1].astype(int), log.ranges[:, 0].astype(int)
    right = [pair not in late for pair in zip(other.tolist(), robot.tolist(), strict=True)]

    def missed(tags):
        at = np.concatenate([place[:4], tags.reshape(-1, 3)])
        gap = np.linalg.norm(at[robot] - at[other], axis=1) - log.ranges[:, 2]
        return gap[right]

    tags = least_squares(missed, place[4:].ravel()).x.reshape(-1, 3)
    return np.concatenate([place[:4], tags])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("late", [REFLECTED, AROUND], ids=["reflected", "around a corner"])
def test_late_ranges_are_named_and_do_not_count(late, seed):
    """The other ranges place robots as well as they can where nobody errs but by noise."""
    log, place = foreign.room_of_tags(foreign.ROOM, seed, late=late)

    estimate, off = found_in(log, place)

    best = attainable(log, place, late)
    assert estimate.outlier_contacts.tolist() == [
        [robot, 0, -1, other, -1] for other, robot in sorted(late, key=lambda pair: pair[1])
    ]
    assert len(estimate.outlier_places) == 0
    # A third of sd: a wide prior keeps robots a little nearer to where chains ended.
    assert np.linalg.norm(estimate.position - best, axis=1).max() < 0.05
    assert rms(off) < 0.3
    assert estimate.convergence.trusted
    assert_honest(estimate, off)


def test_an_open_chain_without_compasses_is_as_far_off_as_sd():
    """Errors of connections add up along it, and nothing contradicts them."""
    pairs = [foreign.open_chain(24, seed) for seed in range(8)]

    estimates = localize_many([log for log, _ in pairs], [JointParams()] * len(pairs))

    both = zip(estimates, pairs, strict=True)
    off = [np.linalg.norm(estimate.position - place, axis=1) for estimate, (_, place) in both]
    sd = np.concatenate([e.sd for e in estimates])
    assert 0.7 < rms(np.concatenate(off)) / rms(sd) < 1.4
    # A turn of 1 deg shifts the end by the distance to it, and a direction by 1 m.
    lever = np.arange(24)
    expected = np.radians(1.0) * np.sqrt(2.0 * (np.square(lever).sum() + len(lever) - 1))
    assert [e.sd[-1] for e in estimates] == pytest.approx([expected] * len(estimates), rel=0.15)
    for estimate, away in zip(estimates, off, strict=True):
        assert estimate.convergence.trusted
        assert_honest(estimate, away)
