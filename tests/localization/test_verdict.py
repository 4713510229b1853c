"""All methods are judged by the same rules, as far as they know what these ask for."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.structures import NOISY, Rule, grown, silent, structure
from tiswarm.base.robot import RobotGeometry
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.methods import localize
from tiswarm.localization.mixture import verdict
from tiswarm.localization.mixture.assessment import Assessment, assess
from tiswarm.localization.mixture.ends import Posed
from tiswarm.localization.mixture.verdict import Evidence, InlierFit, judge, widened
from tiswarm.localization.online.settings import OnlineParams
from tiswarm.localization.online.tracker import Tracker
from tiswarm.localization.peers.settings import HopByHopParams, LeastSquaresParams
from tiswarm.localization.settings import LARGE, JointParams
from tiswarm.measurements.cues import measure
from tiswarm.records.estimate import MOST_MISFIT_SD, Convergence
from tiswarm.records.sensing_file import lines_of
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.params import TowerParams

ROBOTS = 12
NEARER = (
    "positions nearby fit the measurements better: their chi-square is 99 less, and noise explains "
    "73.6"
)


@pytest.fixture(scope="module")
def known() -> Evidence:
    """What a method knows of a good estimate of robots that touch only the one before."""
    log, _ = structure(Rule(kind="chain"), ROBOTS, 0)
    rows = measure(log, ["contacts"])
    return Evidence(
        log=log,
        rows=rows,
        outlier=np.zeros(len(rows), np.bool_),
        is_guess=np.zeros(ROBOTS, np.bool_),
        chi_square=40.0,
        unknowns=3 * (ROBOTS - 1),
        freedom=40,
    )


@pytest.mark.parametrize(("spare", "is_testable"), [(0, False), (1, True)])
def test_one_spare_measurement_can_contradict(known, spare, is_testable):
    """As many measurements as unknowns always agree; one more can disagree."""
    few = replace(known, unknowns=3 + spare, freedom=spare, chi_square=0.0)

    found = judge(few)

    assert found.testable is is_testable
    assert found.consistent is (True if is_testable else None)


@pytest.mark.parametrize(("robots", "some"), [(ROBOTS, 1.0), (LARGE, 1.0), (2 * LARGE, 30.0)])
def test_of_a_large_swarm_a_few_robots_may_overlap(known, robots, some):
    """As many as may miss contacts: half a percent, each with what one alone must not exceed."""
    many = replace(known, is_guess=np.zeros(robots, np.bool_))
    most = 25.0 * some

    found = [judge(replace(many, overlap=share * most)).converged for share in (0.99, 1.01)]

    assert found == [True, False]


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ({}, ""),
        ({"all_failed": True}, "all chains ended out of reach of their contacts, or ran hot"),
        ({"is_alone": True}, "no two chains ended at the same least cost"),
        ({"is_guess": np.ones(ROBOTS, np.bool_)}, "all positions are guesses"),
        ({"is_single": True}, ""),
        ({"overlap": 24.0}, ""),
        (
            {"overlap": 26.0},
            "docks overlap at the least cost found, which no measurement error explains",
        ),
        ({"missed": 50}, "the best chain misses 50 contacts or ranges"),
        ({"excess": 99.0}, ""),
        (
            {"excess": 99.0, "is_within": False},
            NEARER,
        ),
    ],
)
def test_a_rule_asks_for_what_a_method_knows(known, what, reason):
    """Nothing speaks against an estimate unless its method knows it."""
    found = judge(replace(known, **what))

    is_lost = reason.startswith(("all chains", "no two chains", "docks overlap", NEARER))
    assert found.converged == (not reason)
    assert found.consistent is (None if is_lost else True)
    assert found.reason == reason


@pytest.mark.parametrize(("length", "torn"), [(10.0, False), (3.0, True)])
def test_a_robot_that_an_outlier_alone_ties_is_disconnected(length, torn):
    """Known planes hold its x and y; only a range says how high it is, which may be too short."""
    log = ranged_pair(length)
    place, sd = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]), np.array([0.0, 0.5])

    found = assess(log, ("fixes", "ranges"), place, is_guess=np.zeros(2, np.bool_), sd=sd)
    other = localize(log, JointParams(chains=2, steps=300, hold_steps=100))

    assert found.torn.tolist() == other.disconnected.tolist() == [False, torn]
    assert found.fields(np.zeros(2, np.bool_), 1.0)["disconnected"].tolist() == [False, torn]
    assert found.convergence.converged != torn
    assert found.sd[1] >= 0.5


def ranged_pair(length: float) -> SensingLog:
    """Log two robots 10 R apart: x and y of the second are known, and so is a range of theirs."""
    fixes = [[1, 1, 0, 0, 10.0, 1e-9, -1], [1, 0, 1, 0, 0.0, 1e-9, -1]]
    return silent(
        np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]),
        fixes=np.array(fixes, np.float64),
        ranges=np.array([[1, 0, length, 0.01, -1]]),
    )


def test_few_robots_that_outliers_alone_tie_do_not_end_a_search(known):
    """They are listed; most robots are somewhere, unless outliers alone tie more than half."""
    few, most = (judge(replace(known, torn=torn)) for torn in (ROBOTS // 2, ROBOTS // 2 + 1))

    assert few.converged
    assert not most.converged
    assert most.reason == "outliers alone tie 7 of 12 robots to the anchor"


@given(st.lists(st.floats(0.0, 20.0), min_size=2, max_size=9), st.floats(1.0, 1e3))
def test_no_factor_makes_an_error_wider_than_the_swarm(sd, factor):
    """Otherwise it multiplies; what a method itself states stays."""
    position = np.arange(len(sd))[:, None] * np.array([3.0, 0.0, 0.0])
    apart = np.linalg.norm(position[:, None] - position, axis=2)

    found = widened(np.array(sd), factor, position)

    bound = np.sqrt((apart**2).mean(axis=1)) * (1.0 + 1e-9)
    assert (found >= np.array(sd)).all()
    assert (found <= np.maximum(sd, bound)).all()
    is_within = factor * np.array(sd) < bound
    np.testing.assert_allclose(found[is_within], factor * np.array(sd)[is_within])


@pytest.mark.parametrize("off", [0.0, 0.3])
@pytest.mark.parametrize("sd", [0.01, 2.0])
def test_a_method_states_no_less_than_measurements_leave_open(off, sd):
    """Three fixes of .1 R hold a robot, and the estimate may lie beside where they say."""
    axes = [[1, *row, 10.0 * row[0], 0.1, -1] for row in np.eye(3).tolist()]
    place = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
    log = silent(place, fixes=np.array(axes))
    position = place + np.array([[0.0, 0.0, 0.0], [0.0, off, 0.0]])

    found = assess(
        log, ("fixes",), position, is_guess=np.zeros(2, np.bool_), sd=np.array([0.0, sd])
    )

    oracle = np.sqrt(3.0 * 0.1**2 + off**2)
    assert found.sd[1] == pytest.approx(max(sd, oracle), rel=0.3)  # of 64 draws, which may count


def test_an_arm_of_hinges_is_as_uncertain_as_a_random_walk(known):
    """Each robot touches the one before it, at one dock: errors add up along the arm."""
    sd = np.full(ROBOTS, 1e-3)

    found = assess(
        known.log, ("contacts",), structure(Rule(kind="chain"), ROBOTS, 0)[1],
        is_guess=np.zeros(ROBOTS, np.bool_), sd=sd,
    )  # fmt: skip

    assert found.sd[1] > 1.0
    assert found.sd[-1] > 2.0 * found.sd[1]


def test_noise_that_explains_no_rows_widens_stated_errors_alone(known):
    """The Birge ratio is that of the chi-square to its degrees of freedom."""
    wide = replace(known, chi_square=360.0)

    found, silent = judge(wide), judge(replace(wide, has_sd=False))

    assert (found.converged, found.consistent, found.testable) == (True, False, True)
    assert found.reason == "noise as stated does not explain all rows"
    assert (found.sd_factor, silent.sd_factor) == (3.0, 1.0)


def test_one_chain_alone_finds_nothing_wrong_with_a_log(known):
    """A misfit that no second chain confirms is one of the search, and widens sd all the same."""
    bad = replace(known, chi_square=360.0)

    confirmed, single = judge(bad), judge(replace(bad, is_single=True))

    assert (confirmed.converged, confirmed.consistent) == (True, False)
    assert (single.converged, single.consistent) == (False, None)
    assert (
        single.reason == f"only one chain leads to the least cost found, where {confirmed.reason}"
    )
    assert single.sd_factor == confirmed.sd_factor == 3.0


@pytest.mark.trial
def test_a_right_log_is_searched_again_before_it_is_called_wrong():
    """Without noise all robots can be where they are measured; first chains do not get there."""
    robot, params = RobotGeometry(rho=3.0), TowerParams(plane=True)
    for seed, robots in [(100062, 60), (100104, 60), (100102, 80)]:
        (history,) = grow(params, robots=robots, seeds=[seed], robot=robot)
        log = observe(history, SensingParams(stances=False, ground_docks=False))

        found = localize(log, JointParams())

        assert found.convergence.consistent
        if found.convergence.converged:
            off = np.linalg.norm(found.position - history.position, axis=1)
            assert (off <= 1.6 * found.sd + 0.01).mean() > 0.8


def ranging(readings: int, error: Callable[[np.random.Generator, NDArray], NDArray]) -> SensingLog:
    """Log ranges of sd 1 R between four known corners and six robots, each read several times."""
    rng = np.random.default_rng(100_000)
    corner = 40.0 * np.concatenate([np.zeros((1, 3)), np.eye(3)])
    place = np.concatenate([corner, rng.uniform(5.0, 35.0, (6, 3))])
    fixes = [
        [1 + k, *axis, float(axis @ corner[1 + k]), 1e-3, -1]
        for k in range(3)
        for axis in np.eye(3)
    ]
    pair = np.array([(i, j) for i in range(4, 10) for j in range(i)])
    length = np.linalg.norm(place[pair[:, 0]] - place[pair[:, 1]], axis=1)
    read = np.repeat(length + error(rng, pair), readings)
    read += rng.normal(size=len(read))
    columns = [np.repeat(pair, readings, axis=0), read, np.ones(len(read)), np.full(len(read), -1)]
    return silent(place, fixes=np.array(fixes), ranges=np.column_stack(columns))


def none(_rng: np.random.Generator, pair: NDArray) -> NDArray:
    """Read each range without an error of its own."""
    return np.zeros(len(pair))


def of_each_pair(rng: np.random.Generator, pair: NDArray) -> NDArray:
    """Add an error that all readings of a pair share, half as large as their noise."""
    return 0.5 * rng.normal(size=len(pair))


def of_one_pair(_rng: np.random.Generator, pair: NDArray) -> NDArray:
    """Add 1.5 R to all readings of the last pair."""
    return np.where(np.arange(len(pair)) == len(pair) - 1, 1.5, 0.0)


METHODS = {
    "joint": JointParams(chains=2, steps=300, hold_steps=100),
    "least-squares": LeastSquaresParams(),
    "hop-by-hop": HopByHopParams(),
    "online": OnlineParams(),
}
SHARED = "; readings of one pair share an error: state it as a source with shared_sd"


@pytest.mark.parametrize(
    ("name", "readings"),
    [
        *((name, 40) for name in METHODS if name != "online"),
        ("online", 12),
        pytest.param("online", 40, marks=pytest.mark.trial),
    ],
)
@pytest.mark.parametrize(("error", "fault"), [(none, ""), (of_each_pair, "all rows")])
def test_an_error_that_readings_share_is_no_noise(name, readings, error, fault):
    """However often a pair is read: of 1,560 readings, 18 means say whether it is there."""
    log = ranging(readings, error)

    found = localize(log, METHODS[name]).convergence

    assert found.spare == 39 - 18  # means, and what they determine
    assert found.consistent == (not fault)
    assert (
        fault == ""
        or (found.reason == f"noise as stated does not explain {fault}{SHARED}")
        or (not found.converged)
    )


def test_readings_that_scatter_more_than_stated_are_said_to():
    """Their means may fit all the same."""
    log = ranging(40, none)
    pair, first = np.unique(log.ranges[:, :2], axis=0, return_inverse=True)
    mean = np.bincount(first, log.ranges[:, 2]) / 40.0
    ranges = log.ranges.copy()
    ranges[:, 2] = mean[first] + 1.5 * (ranges[:, 2] - mean[first])

    found = localize(replace(log, ranges=ranges), METHODS["least-squares"]).convergence

    assert len(pair) == 39
    assert (found.consistent, found.converged) == (False, True)
    assert found.reason == "readings of one quantity scatter more than their stated noise"
    assert found.sd_factor == 3.0  # that of all estimates of least-squares that are not trusted


def test_a_wrong_kind_is_named_though_all_others_hide_it():
    """Of 2,400 coordinates that fit, the sum does not show one pair that is read with an error."""
    log = ranging(81, of_one_pair)
    rng = np.random.default_rng(0)
    further = np.repeat(np.arange(4, 10), 400)
    direction = rng.normal(size=(len(further), 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    place = localize(ranging(400, none), METHODS["least-squares"]).position
    value = (direction * place[further]).sum(axis=1) + 30.0 * rng.normal(size=len(further))
    many = np.column_stack(
        [further, direction, value, np.full(len(further), 30.0), np.full(len(further), -1)]
    )
    log = replace(log, fixes=np.concatenate([log.fixes, many]))

    found = localize(log, METHODS["least-squares"]).convergence

    assert abs(found.misfit_sd) < MOST_MISFIT_SD
    assert (found.consistent, found.converged) == (False, True)
    assert found.reason == f"noise as stated does not explain ranges and displacements{SHARED}"


def test_all_methods_have_one_judge(monkeypatch):
    """What it says of a misfit, each of them says."""
    log = ranging(1, none)
    bad = Convergence(
        converged=False, consistent=False, misfit_sd=9.0, chains=1, restarted=0, reason="as judged"
    )
    for room in ("mixture", "assessment"):
        monkeypatch.setattr(f"tiswarm.localization.mixture.{room}.judge", lambda _: bad)

    for params in METHODS.values():
        assert localize(log, params).convergence.reason == "as judged"
    header, lines = lines_of(log)
    tracker = Tracker(header, OnlineParams())
    for line in lines:
        tracker.join(line)
    assert tracker.estimate().convergence.reason == "as judged"


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.floats(0.0, 1e4), st.floats(0.0, 1e4), st.integers(0, 200), st.integers(0, 60),
    st.integers(0, 12),
)  # fmt: skip
def test_no_further_fault_makes_a_bad_verdict_good(known, less, more, missed, further, torn):
    """Of chi-square, of contacts that are missed, of outliers, of robots that these alone tie."""
    rows = len(known.rows)
    some = np.arange(rows) < missed % rows
    worse = np.arange(rows) < min(missed % rows + further, rows)
    one = replace(known, chi_square=less, missed=missed, outlier=some, torn=torn)
    two = replace(
        known, chi_square=less + more, missed=missed + further, outlier=worse, torn=torn + further
    )

    before, after = judge(one), judge(two)

    assert before.converged or not after.converged
    assert before.consistent or not after.consistent


@pytest.fixture(scope="module")
def walked() -> tuple[Posed, InlierFit]:
    """Measurements of a tower of 12 robots and their walks, at their minimum from the truth."""
    history = grown(TowerParams(), robots=12, seed=1000)
    log = observe(history, NOISY)
    params = JointParams()
    posed = Posed(log, params, pose_problem(log, params))
    cost = posed.cost(posed.problem.rows)
    start = cost.at(history.position, np.zeros(12))
    inlier = np.ones(len(posed.problem.rows), np.bool_)
    return posed, InlierFit(inlier, cost, *cost.refine(start))


def test_simulated_measurements_miss_their_fit_by_as_much_as_noise_explains(walked):
    """The mean of a chi-square is its degrees of freedom; 40 draws show it to 5 standard errors."""
    _, fit = walked

    square = [fit.simulated(number).linear.chi_square for number in range(40)]

    freedom = fit.linear.freedom()
    assert np.mean(square) == pytest.approx(freedom, abs=5.0 * (2.0 * freedom / 40.0) ** 0.5)
    assert fit.simulated(7).linear.chi_square == square[7]
    assert len({*square}) == 40


def evidence_of(posed: Posed, fit: InlierFit) -> Evidence:
    """Gather what a method knows that ends at a state."""
    return Evidence(
        log=posed.log,
        rows=posed.problem.rows,
        outlier=~fit.inlier,
        is_guess=np.zeros(12, np.bool_),
        chi_square=fit.linear.chi_square,
        inlier_fit=fit,
        unknowns=33,
        freedom=fit.linear.freedom(),
    )


def test_strain_that_a_search_leaves_is_no_misfit(walked):
    """A method may end 0.1 R beside the minimum; the verdict is about the minimum."""
    posed, rest = walked
    aside = 0.1 * np.random.default_rng(0).normal(size=(12, 3))
    state = rest.state._replace(position=rest.state.position + aside)
    strained = InlierFit(rest.inlier, rest.cost, state, rest.cost.linearized(state))

    found = judge(evidence_of(posed, strained))

    assert strained.linear.chi_square > 10.0 * rest.linear.chi_square
    assert found.consistent
    assert found.misfit_sd < MOST_MISFIT_SD


@pytest.mark.parametrize(("rarest", "is_consistent"), [(1e-9, True), (1e-3, False)])
def test_right_logs_may_look_as_wrong_as_simulated_ones(walked, monkeypatch, rarest, is_consistent):
    """Chances of groups hold for linear problems; others look worse at all draws of errors."""
    posed, fit = walked
    chances = iter([1e-8, 1e-8, 1e-3, rarest, *[1e-3] * 40])
    monkeypatch.setattr(verdict, "_worst_group", lambda *_: (next(chances), "robot 3", 1))

    found = judge(evidence_of(posed, fit))

    assert found.consistent is is_consistent
    assert found.reason == ("" if is_consistent else "noise as stated does not explain robot 3")


def test_few_spare_measurements_show_that_noise_is_stated_at_half(known):
    """Four times the expected chi-square is too rare, whatever the number of unknowns."""
    found = judge(replace(known, freedom=10, chi_square=40.0, unknowns=300))

    assert found.consistent is False
    assert found.sd_factor == 2.0


def test_a_doubt_of_a_method_ends_what_it_says_of_outliers(known):
    """Whether noise explains the rows stands."""
    nothing = np.zeros(ROBOTS, np.bool_)
    good = Assessment(
        judge(known), None, np.empty((0, 5), int), np.empty((0, 3), int), nothing, None, {}
    )

    found = good.doubted("robots search near each other only")

    assert (found.convergence.converged, found.convergence.consistent) == (False, True)
    assert found.outlier_contacts is found.outlier_places is None
