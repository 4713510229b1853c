"""Solutions, their weights, and two verdicts: from the ends of chains to one estimate."""

import tracemalloc
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests import foreign
from tests.structures import NOISY, grown
from tiswarm.base.robot import RobotGeometry
from tiswarm.localization.chains.annealer import Annealed
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.chains.views import place_disconnected
from tiswarm.localization.methods import localize, localize_many
from tiswarm.localization.mixture import MIXTURE, SD_CALIBRATION
from tiswarm.localization.mixture import ends as ends_module
from tiswarm.localization.mixture import mixture as mixture_module
from tiswarm.localization.mixture.ends import Fit, aligned, ranked
from tiswarm.localization.mixture.mixture import deviation, gathered, minimum, mixed
from tiswarm.localization.settings import JointParams
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.params import ClimbParams, TowerParams

pytestmark = pytest.mark.unchecked

ALL = JointParams()
AS_ENDED = JointParams(refine=False, robust=False)
"""Chains are ranked by their squares where they ended."""
SIGMA = 0.025
SOUND = np.zeros(4, np.bool_)


def chains_at(position, *, within=1e-6):
    """Chains that ended at some positions [R], shape (K, N, 3)."""
    chains, robots = position.shape[:2]
    return Annealed(
        mean=position,
        within=np.full((chains, robots), within),
        last=position,
        mean_yaw=np.zeros((chains, robots)),
        last_yaw=np.zeros((chains, robots)),
        sigma=SIGMA,
        temperature=np.ones(chains),
        iteration=np.arange(2),
        trace=position[:1].repeat(2, axis=0),
        yaw_trace=np.zeros((2, robots)),
    )


def fixed(robots=4):
    """Robots that fixes hold, to 0.01 R along each axis, and where they are [R]."""
    _, place = foreign.without_beacons(robots, 0)
    log = foreign.with_places(foreign.silent(place), place, range(1, robots))
    return log, place / log.dock_radius


def ends_of(log, position, has_failed=None):
    """Rank chains where they ended, without moving them to a minimum."""
    known = pose_problem(log, AS_ENDED)
    failed = np.zeros(len(position), np.bool_) if has_failed is None else has_failed
    return ranked(Fit(log, AS_ENDED, known, chains_at(position), failed))


@given(off=st.lists(st.floats(0.0, 3.0), min_size=1, max_size=9))
def test_the_less_a_chain_misses_the_more_it_weighs(off):
    """Weights add up to 1, fall with the cost, and are not dust."""
    log, place = fixed()
    position = np.tile(place, (len(off), 1, 1))
    position[:, 1, 0] += off

    ends = ends_of(log, position)

    width = pose_problem(log, AS_ENDED).rows.variance()[0] + (MIXTURE.tempered * SIGMA) ** 2
    np.testing.assert_allclose(ends.cost, np.square(off) / width, atol=1e-9)
    order = np.argsort(ends.cost)
    assert (np.diff(ends.weight[order]) <= 1e-15).all()
    assert ends.weight.sum() == pytest.approx(1.0)
    assert (ends.weight[ends.weight > 0.0] >= MIXTURE.least_weight).all()
    is_far = ends.cost > ends.cost.min() + 200.0
    assert not ends.weight[is_far].any()


def test_chains_with_equal_costs_weigh_alike():
    """And each less than it, the farther beyond chance its cost is."""
    log, place = fixed()
    position = np.tile(place, (8, 1, 1))
    position[4:, 1, 0] += 99.0

    ends = ends_of(log, position)

    np.testing.assert_allclose(ends.weight, [0.25] * 4 + [0.0] * 4)


def test_failed_chains_have_no_weight_unless_all_failed():
    """Then they are all there is, and the verdict says so."""
    log, place = fixed()
    position = np.tile(place, (3, 1, 1))
    some = np.array([True, False, False])

    one, every = (ends_of(log, position, failed) for failed in (some, ~np.zeros(3, np.bool_)))

    assert one.weight.tolist() == [0.0, 0.5, 0.5]
    assert one.cost[0] == np.inf
    np.testing.assert_allclose(every.weight, 1.0 / 3.0)


@given(order=st.permutations(range(6)))
def test_solutions_do_not_depend_on_the_order_of_chains(order):
    """The weightiest is 0; ends within a dock's width of its best one belong to it."""
    log, place = fixed()
    position = np.tile(place, (6, 1, 1))
    position[:, 2, 1] += [0.01, 0.02, 5.0, 0.03, 5.01, 11.0]
    loose = replace(log, fixes=log.fixes[log.fixes[:, 0] != 2])  # so that all have equal costs
    position[:, 1, 0] += [0.0, 0.01, 0.02, 0.03, 0.04, 0.05]

    found, expected = (ends_of(loose, each) for each in (position[order], position))

    assert expected.solution.tolist() == [0, 0, 1, 0, 1, 2]
    assert found.solution.tolist() == expected.solution[order].tolist()
    np.testing.assert_allclose(found.weight, expected.weight[order], rtol=1e-12)


def test_an_estimate_does_not_depend_on_the_order_of_chains():
    """Positions, sd, weights and verdict of the mixture stay as they are."""
    log, place = foreign.room_of_tags(foreign.CEILING, 0)
    known, place = pose_problem(log, ALL), place / log.dock_radius
    image = place * [1.0, 1.0, -1.0] + [0.0, 0.0, 50.0]
    position = np.array([place, place + 0.3 * (np.arange(10) > 3)[:, None], image, image])
    mixtures = [
        mixed(Fit(log, ALL, known, chains_at(position[list(order)]), SOUND))
        for order in list(permutations(range(4)))[::5]
    ]

    first = mixtures[0]

    for other in mixtures[1:]:
        np.testing.assert_allclose(other.position, first.position, atol=1e-6)
        np.testing.assert_allclose(other.sd, first.sd, rtol=1e-6)
        assert other.convergence == first.convergence
        assert [s.weight for s in other.solutions] == pytest.approx(
            [s.weight for s in first.solutions]
        )


DISTANCE, SD = 2.1, 0.1


def _two_minima():
    """Log a tag 1 m above or below the anchor, and one on a rail that measures how far that is.

    The second tag is known to 1 mm but along the rail: there to half a meter. Where the first one
    is below, their range is nearly across the rail.
    """
    place = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [DISTANCE, 0.0, 1.0]])
    log = foreign.silent(place)
    fixes = [(1, 0, 0.0, 1e-3), (1, 1, 0.0, 1e-3), (2, 0, 1.5, 0.5), (2, 1, 0.0, 1e-3),
             (2, 2, 1.0, 1e-3)]  # fmt: skip
    rows = [[robot, *np.eye(3)[axis], value, sd, -1.0] for robot, axis, value, sd in fixes]
    ranges = [[1, 0, 1.0, SD, -1.0], [2, 1, DISTANCE, SD, -1.0]]
    return replace(log, fixes=np.array(rows), ranges=np.array(ranges))


def test_solutions_weigh_the_probability_of_their_minima():
    """By numerical integration, where two minima differ in cost and in width."""
    z, x = np.meshgrid(np.linspace(-2.0, 2.0, 801), np.linspace(-1.0, 4.0, 1001), indexing="ij")
    away = np.hypot(x, z - 1.0)
    square = (np.abs(z) - 1.0) ** 2 / SD**2 + (away - DISTANCE) ** 2 / SD**2
    square += (x - 1.5) ** 2 / 0.5**2
    mass = np.exp(-0.5 * square)
    above = mass[(z > 0.0) & (x > 0.0)].sum() / mass.sum()

    estimate = localize(_two_minima(), replace(ALL, chains=16))

    weight = {solution.position[1, 2] > 0.0: solution.weight for solution in estimate.solutions}
    assert 0.2 < above < 0.8
    assert np.exp(0.5 * abs(np.diff([s.chi_square for s in estimate.solutions])[0])) > 1.3
    assert weight[True] == pytest.approx(above, abs=0.05)
    assert weight[False] == pytest.approx(1.0 - above, abs=0.05)


@pytest.mark.parametrize(
    "case", [foreign.room_of_tags(foreign.CEILING, 2), foreign.nearly_flat(0.06, 1)],
    ids=["ceiling", "ring"],
)  # fmt: skip
def test_the_estimate_is_the_mean_of_its_solutions(case):
    """Its sd is their root mean square deviation, within each and between them."""
    log, _ = case

    estimate = localize(log, ALL)

    weight = np.array([solution.weight for solution in estimate.solutions])
    at = np.array([solution.position for solution in estimate.solutions])
    within = np.array([solution.sd for solution in estimate.solutions]) ** 2
    mean = np.tensordot(weight, at, 1)
    between = weight @ ((at - mean) ** 2).sum(axis=2)
    assert len(weight) > 1
    assert (np.diff(weight) <= 0.0).all()
    assert weight.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(estimate.position, mean, atol=1e-9)
    np.testing.assert_allclose(estimate.sd**2, weight @ within + between, rtol=1e-6, atol=1e-12)
    np.testing.assert_array_equal(estimate.mirrored, between > weight @ within + 1e-12)
    assert estimate.known == [
        "mirrored" if is_mirrored else "yes" for is_mirrored in estimate.mirrored
    ]


def test_the_second_solution_can_be_chosen():
    """It is one configuration, not a mean, and with no robot mirrored."""
    log, _ = foreign.room_of_tags(foreign.CEILING, 0)
    estimate = localize(log, ALL)

    second = estimate.with_solution(2)

    np.testing.assert_array_equal(second.position, estimate.solutions[1].position)
    np.testing.assert_array_equal(second.sd, estimate.solutions[1].sd)
    assert "mirrored" not in second.known


def test_a_wrong_height_and_a_wrong_fix_are_outliers(tall_towers):
    """Each is listed by robot and stance, flips from the first on; others hold the robots."""
    history = tall_towers[0]
    log = observe(history, SensingParams(tilt_noise_deg=0.5, yaw_noise_deg=1.0))
    height = log.flip_height.copy()
    height[17] += 3.0
    robot, axis = np.repeat([9, 21], 3), np.tile(np.arange(3), 2)
    value = history.position[robot, axis] + [0.0, 4.0, 0.0, 0.0, 0.0, 0.0]
    rows = [robot, np.eye(3)[axis], value, np.full(6, 0.05), np.full(6, -1.0)]
    log = replace(log, flip_height=height, fixes=np.column_stack(rows))

    estimate = localize(log, ALL)

    last = history.walks[9].stance_count - 1
    assert sorted(estimate.outlier_places.tolist()) == [[9, last, -1], [17, 0, -1]]
    assert estimate.convergence.trusted
    off = np.linalg.norm(estimate.position - history.position, axis=1)
    assert np.sqrt((off**2).mean()) < 1.0


@pytest.fixture(scope="module", params=[12, pytest.param(50, marks=pytest.mark.trial)])
def tower(request):
    """A tower of 12 robots, and of 50 in a trial."""
    return grown(TowerParams(), robots=request.param, seed=0)


def test_a_clean_tower_converges_and_is_consistent(tower):
    """With nothing to give a reason for, and sd as it is."""
    verdict = localize(observe(tower, NOISY), ALL).convergence

    assert (verdict.converged, verdict.consistent, verdict.trusted) == (True, True, True)
    assert verdict.reason == ""
    assert verdict.sd_factor == 1.0
    assert verdict.misfit_sd < 5.0
    assert verdict.testable
    assert verdict.spare > 3 * len(tower.position)


def test_docks_of_another_length_are_not_consistent(tower):
    """Walks contradict contacts; the verdict says how long docks would have to be.

    sd grows by the Birge ratio, so that chance explains the rest.
    """
    log = observe(tower, NOISY)
    longer = replace(log, dock_offset_body=1.15 * log.dock_offset_body)

    estimate = localize(longer, ALL)

    verdict = estimate.convergence
    assert not verdict.consistent
    assert not verdict.trusted
    assert verdict.misfit_sd > 5.0
    assert verdict.sd_factor > 1.2
    if verdict.converged:
        assert verdict.reason.startswith("a dock offset of 1.50")
    assert estimate.misfit.sum() > 1.2 * len(estimate.misfit)


def _stated(sd, seed):
    """Twelve tags that measure distances to 0.1 m, and state another sd."""
    return foreign.room_of_tags(foreign.ROOM, seed, count=12, stated=sd)[0]


@pytest.mark.parametrize("logs_of_each", [2, pytest.param(4, marks=pytest.mark.trial)])
def test_sd_is_what_residuals_show_where_a_log_states_too_little_noise(logs_of_each):
    """Ranges that are stated 2.5 times too good make an sd as if they were stated right."""
    logs = [_stated(sd, seed) for sd in (0.1, 0.04) for seed in range(logs_of_each)]

    estimates = localize_many(logs, [ALL] * len(logs))

    verdicts = [estimate.convergence for estimate in estimates]
    sd = np.array([np.median(estimate.sd[4:]) for estimate in estimates])
    right, wrong = slice(logs_of_each), slice(logs_of_each, None)
    assert [v.sd_factor for v in verdicts[right]] == [1.0] * logs_of_each
    assert not any(v.consistent for v in verdicts[wrong])
    assert np.mean([v.sd_factor for v in verdicts[wrong]]) == pytest.approx(2.5, rel=0.2)
    assert np.mean(sd[wrong] / sd[right]) == pytest.approx(1.0, rel=0.3)


def test_the_factor_of_sd_is_the_birge_ratio():
    """sqrt(chi-square / k), where chi-square exceeds k by the misfit in sqrt(2 k)."""
    estimate = localize(_stated(0.04, 0), ALL)

    verdict = estimate.convergence
    ranges, fixes, unknowns = 114 - len(estimate.outlier_contacts), 9, 3 * 15
    excess = np.sqrt(2.0 / (ranges + fixes - unknowns)) * verdict.misfit_sd
    assert verdict.misfit_sd > 5.0
    assert verdict.sd_factor == pytest.approx(np.sqrt(1.0 + excess))


def test_a_least_cost_that_one_chain_alone_found_is_said(monkeypatch):
    """Other chains would have found it, too, if the search could."""
    monkeypatch.setattr(ends_module, "MIXTURE", replace(MIXTURE, rounds=0))  # they are trapped
    log, place = fixed()
    position = np.tile(place, (4, 1, 1))
    position[1:, 1, 0] += [3.0, 4.0, 5.0]
    params = replace(AS_ENDED, refine=True)
    known = pose_problem(log, params)

    alone, agreed = (
        mixed(Fit(log, params, known, chains_at(ends), SOUND)).convergence
        for ends in (position, position[[0, 0, 1, 2]])
    )

    assert (alone.converged, alone.reason) == (
        False, "no two chains ended at the same least cost",
    )  # fmt: skip
    assert (agreed.converged, agreed.reason) == (True, "")


def test_chains_that_all_failed_are_said():
    """Before anything else that may be wrong with them."""
    log, place = fixed()
    known = pose_problem(log, AS_ENDED)
    position = np.tile(place, (4, 1, 1))
    position[1:, 1, 0] += [3.0, 4.0, 5.0]

    verdict = mixed(Fit(log, AS_ENDED, known, chains_at(position), ~SOUND)).convergence

    assert not verdict.converged
    assert verdict.reason == "all chains ended out of reach of their contacts, or ran hot"


def test_too_many_outliers_are_said():
    """Where more than a fifth of all ranges are wrong it is not known which."""
    pairs = [(i, j) for j in range(4, 10) for i in range(j)][::3]
    log, place = foreign.room_of_tags(foreign.ROOM, 0, late=dict.fromkeys(pairs, 30.0))
    known = pose_problem(log, AS_ENDED)
    position = np.tile(place / log.dock_radius, (4, 1, 1))

    verdict = mixed(Fit(log, AS_ENDED, known, chains_at(position), SOUND)).convergence

    assert not verdict.converged
    assert verdict.reason == f"{len(pairs)} of 39 contacts and ranges are outliers"


def _minimum(log, known, position, sd, inlier=None):
    """Refine one chain."""
    annealed = chains_at(position[None])
    ends = ranked(Fit(log, AS_ENDED, known, annealed, SOUND[:1]))
    counts = np.ones(len(known.rows), np.bool_) if inlier is None else inlier
    ends = replace(ends, fit=replace(ends.fit, params=ALL))
    return minimum(ends, np.ones(1), counts, sd)


def test_measurements_that_are_no_inliers_do_not_pull(towers):
    """A contact with a dock that is far off moves nobody, and carries no part of chi-square."""
    history = towers[0]
    log = observe(history, NOISY)
    known = pose_problem(log, ALL)
    last = len(known.neighbor) - 1
    other_dock = known.rows.distances.other_dock.copy()
    other_dock[last] = (other_dock[last] + 1) % 3
    contacts = log.contacts.copy()
    number = np.flatnonzero(contacts[:, 2] == known.robot[last])[-1:]
    assert len(number) == 1
    contacts[number, 1] = (contacts[number, 1] + 1) % 3
    misled = replace(log, contacts=contacts)
    wrong = pose_problem(misled, ALL)
    missed = np.abs(wrong.rows.residual(history.position)) > 0.5
    sd = np.full(log.robot_count, 0.3)

    right, without, pulled = (
        _minimum(log, known, history.position, sd),
        _minimum(misled, wrong, history.position, sd, ~missed),
        _minimum(misled, wrong, history.position, sd),
    )

    assert missed.sum() >= 1
    off = [np.abs(each.position - right.position).max() for each in (without, pulled)]
    assert off[1] > 2.0 * off[0]
    assert not without.square[missed].any()
    assert without.chi_square < pulled.chi_square


def test_where_measurements_leave_a_robot_open_its_chains_say_how_far_off_it_is(towers):
    """A robot of one contact and no height turns about it, as well as others are known."""
    log = observe(towers[0], NOISY)
    known = pose_problem(log, ALL)
    alone = log.robot_count - 1
    inlier = known.rows.robot != alone
    inlier[: len(known.rows.neighbor)] &= known.rows.neighbor != alone
    sd = np.full(log.robot_count, 0.3)

    found = _minimum(log, known, towers[0].position, sd, inlier)

    assert found.sd[alone] == sd[alone]
    assert not found.is_held[alone]
    assert found.is_held[1:alone].mean() > 0.7
    assert np.median(found.sd[1:alone] / sd[1:alone]) < 0.5


@pytest.mark.parametrize("robots", [40, pytest.param(300, marks=pytest.mark.trial)])
def test_chains_do_not_hold_back_what_many_robots_share(robots):
    """All that moved alike go back, though each by itself was off by what is likely."""
    off = 0.3
    params = TowerParams(force_threshold=1e9)
    history = grown(params, robots=robots, seed=5)
    log = observe(history, NOISY)
    known = pose_problem(log, replace(ALL, contact_sd=np.sqrt(0.1)))
    moved = history.position.copy()
    moved[1:, 0] += off

    there, back = (
        _minimum(log, known, at, np.full(robots, off)).position for at in (history.position, moved)
    )

    assert np.linalg.norm(back - there, axis=1).mean() < 0.03 * off


@pytest.mark.parametrize("robots", [16, pytest.param(30, marks=pytest.mark.trial)])
def test_refined_robots_end_nearer_and_sd_says_how_near(robots):
    """Than where chains that know nothing of shared errors ended.

    Robots that settled touch so many others that no mirror image is in the way.
    """
    settled = TowerParams(climb=ClimbParams(settle=1.0))
    far, near, sd = [], [], []
    for history in grow(settled, robots=robots, seeds=[0, 1, 2], robot=RobotGeometry()):
        log = observe(history, NOISY)
        before, after = (localize(log, replace(ALL, refine=choice)) for choice in (False, True))
        far, near = (
            [*total, *np.linalg.norm(estimate.position - history.position, axis=1)[1:]]
            for total, estimate in ((far, before), (near, after))
        )
        sd = [*sd, *after.sd[1:]]
        np.testing.assert_array_equal(after.trace[-1], after.position)

    assert np.mean(np.square(near)) < 0.5 * np.mean(np.square(far))
    assert 0.6 < np.sqrt(np.mean(np.square(np.array(near) / sd))) < 1.4


def test_of_structures_that_are_not_refined_the_mean_of_chains_is_moved(towers):
    """To the one minimum of the cost, however far chains are from it; its curvature says the sd."""
    log = observe(towers[0], NOISY)
    known = pose_problem(log, AS_ENDED)
    rng = np.random.default_rng(0)
    # A strain that all chains share, and noise of each.
    position = 1.02 * towers[0].position + 0.05 * rng.normal(size=(4, log.robot_count, 3))
    position[:, 0] = towers[0].position[0]
    chains = chains_at(position)

    mixture = mixed(Fit(log, AS_ENDED, known, chains, SOUND))

    cost = Fit(log, AS_ENDED, known, chains, SOUND).cost(
        known.rows, are_independent=True, further_variance=(MIXTURE.tepid * SIGMA) ** 2
    )
    least, linear = cost.refine(cost.at(towers[0].position, np.zeros(log.robot_count)))
    off = np.linalg.norm(mixture.position / log.dock_radius - least.position, axis=1)
    sd = np.sqrt(linear.variance(draws=1000))
    assert mixture.convergence.converged
    # Robots that touch one other, or that overlaps alone hold, stay with their chains.
    assert np.mean(off[1:] <= 0.1 * sd[1:]) > 0.75
    ratio = mixture.sd[1:] / log.dock_radius / sd[1:]
    assert np.mean(np.abs(ratio - 1.0) < 0.4) > 0.75
    (only,) = mixture.solutions
    assert only.weight == 1.0
    assert not mixture.mirrored.any()


def test_chains_of_many_robots_that_differ_make_no_outlier():
    """Their mean tears what each of them meets: that is no wrong measurement."""
    log, place = fixed()
    known = pose_problem(log, AS_ENDED)
    position = np.array([place] * 4)
    position[:, 1, 0] += [-0.4, -0.4, 0.4, 0.4]
    ends = ranked(Fit(log, AS_ENDED, known, chains_at(position), SOUND))

    met = gathered(replace(ends, missed=np.zeros_like(ends.missed)))

    assert not met.missed.any()
    np.testing.assert_array_equal(met.position, met.position[:1].repeat(4, axis=0))
    np.testing.assert_array_equal(met.weight, ends.weight)


@pytest.mark.parametrize("chains", [1, 2, 3])
def test_robots_that_few_chains_tear_stay_where_these_put_them(chains):
    """A chain alone tears measurements that are right; three that agree find wrong ones."""
    log, place = fixed(5)
    log = replace(
        log,
        fixes=log.fixes[log.fixes[:, 0] < 4],
        ranges=np.array([[4.0, 1.0, 3.0, 0.01, -1.0], [4.0, 1.0, 9.0, 0.01, -1.0]]),
    )
    position = np.array([place] * chains)
    position[:, 4] = position[:, 1] + [60.0, 0.0, 0.0]  # between both lengths

    mixture = mixed(
        Fit(log, AS_ENDED, pose_problem(log, AS_ENDED), chains_at(position), SOUND[:chains])
    )

    assert mixture.disconnected.tolist() == [False] * 4 + [True]
    stays = np.allclose(mixture.position[4] / log.dock_radius, position[0, 4])
    assert stays == (chains < 3)
    assert mixture.sd[4] > 2.0 * log.dock_radius  # as a guess in any case


@settings(max_examples=10)
@given(seed=st.integers(0, 99), angle=st.floats(-3.0, 3.0), hand=st.booleans())
def test_chains_that_differ_by_a_free_motion_are_one_solution(seed, angle, hand):
    """Ranges alone do not say how robots are turned; shapes are averaged after alignment."""
    log, place = foreign.without_beacons(6, seed, sd=0.01)
    known, place = pose_problem(log, ALL), place / log.dock_radius
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0],
                     [0.0, 0.0, -1.0 if hand else 1.0]])  # fmt: skip
    copy = place[0] + (place - place[0]) @ turn
    position = np.array([place, copy, place, copy])

    mixture = mixed(Fit(log, ALL, known, chains_at(position), SOUND))

    assert mixture.free_frame == ("rotation", "hand")
    assert len(mixture.solutions) == 1
    center = mixture.position / log.dock_radius
    apart = np.linalg.norm(center[:, None] - center, axis=2)
    true = np.linalg.norm(place[:, None] - place, axis=2)
    np.testing.assert_allclose(apart, true, atol=2.0)
    assert not mixture.mirrored.any()


@pytest.mark.parametrize("first", [0, 1])
def test_ends_are_aligned_with_the_one_of_least_cost(first):
    """It stays where it is, and an end that misses more comes as near to it as a turn allows."""
    log, place = foreign.without_beacons(6, 0, sd=0.01)
    place = place / log.dock_radius
    turned = place[0] + (place - place[0]) @ Rotation.from_rotvec([0.0, 0.0, 0.5]).as_matrix()
    turned[-1] += [0.0, 0.0, 2.0]
    position = np.roll([place, turned], first, axis=0)
    ends = ends_of(log, position)

    found = aligned(ends)

    np.testing.assert_allclose(found.position[first], place, rtol=1e-12)
    away, before = (np.linalg.norm(each - place) for each in (found.position[1 - first], turned))
    assert away < 0.2 * before


def test_structures_that_are_not_refined_count_no_chain_that_failed(towers):
    """Three of four chains are in the mean."""
    log = observe(towers[0], NOISY)
    position = np.array([towers[0].position] * 4)

    chains, is_failed = chains_at(position), np.arange(4) == 2
    mixture = mixed(Fit(log, AS_ENDED, pose_problem(log, AS_ENDED), chains, is_failed))

    assert mixture.solutions[0].chains == 3


def test_hinges_make_no_robot_less_sure_that_nothing_ties():
    """Its error is that of its chains, and of a guess where it may have joined."""
    log = foreign.silent(0.5 * np.arange(4)[:, None] * [1.0, 0.0, 0.0])
    known = pose_problem(log, ALL)
    chains = chains_at(np.random.default_rng(0).normal(0.0, 5.0, (4, 4, 3)), within=4.0)

    mixture = mixed(Fit(log, ALL, known, chains, SOUND))

    own = deviation(known, chains.mean, chains.within, np.full(4, 0.25), SIGMA) ** 2
    guess = place_disconnected(mixture.position[None] / log.dock_radius, known)[1][0]
    assert known.untied[1:].all()
    square = (SD_CALIBRATION.chains * own + guess) * log.dock_radius**2
    np.testing.assert_allclose(mixture.sd[1:] ** 2, square[1:], rtol=1e-9)


def test_a_long_trace_takes_little_more_memory_than_its_configurations(tall_towers):
    """Residuals of all of them at once set the peak of swarms of 10,000 robots."""
    log = observe(tall_towers[0], NOISY)
    known = pose_problem(log, AS_ENDED)
    place = tall_towers[0].position[None]
    peaks = []
    for length in (4, 404):
        chains = replace(
            chains_at(place),
            iteration=np.arange(length),
            trace=place.repeat(length, axis=0),
            yaw_trace=np.zeros((length, log.robot_count)),
        )
        fit = Fit(log, AS_ENDED, known, chains, np.zeros(1, np.bool_))
        tracemalloc.start()
        estimate = mixed(fit)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()

        at_end = known.residual(estimate.trace[-1:] / log.dock_radius, np.zeros((1, 30)))
        assert len(estimate.residual) == length
        assert estimate.residual[-1] == pytest.approx(
            log.dock_radius * np.sqrt((at_end**2).mean()), rel=1e-9
        )

    assert peaks[1] - peaks[0] < 6 * 400 * place.nbytes


def test_the_minimum_of_one_solution_is_searched_for_once(tall_towers, monkeypatch):
    """Its ends agree, and images that fall back to it are not described."""
    log = observe(tall_towers[0], SensingParams(tilt_noise_deg=0.5, spawn_noise=0.1))
    known = pose_problem(log, ALL)
    chains = chains_at(tall_towers[0].position[None].repeat(3, axis=0))
    described = []
    describe = mixture_module._described  # noqa: SLF001 - the time of a minimum is spent there

    def counting(*arguments):
        described.append(describe(*arguments))
        return described[-1]

    monkeypatch.setattr(mixture_module, "_described", counting)

    estimate = mixed(Fit(log, ALL, known, chains, SOUND[:3]))

    assert described[0].is_held.all()
    assert len(described) == len(estimate.solutions) == 1
