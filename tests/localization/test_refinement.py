"""The cost of configurations, its derivatives, and the steps to its minimum."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.structures import (
    NOISY,
    Rule,
    silent,
    structure,
    with_connections,
    with_directions,
    with_fixes,
    with_heights,
    with_ranges,
)
from tiswarm.compute.math import dock_offsets
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.cost import OVERLAP_SD
from tiswarm.localization.cost.cost import HINGE_SD, SETTLED, STRAIN_SD, State, WholeCost
from tiswarm.localization.cost.linear import NOMINAL
from tiswarm.localization.settings import LARGE, Cues, JointParams
from tiswarm.measurements.observability import observability
from tiswarm.measurements.odometry import CENTER, connections_of, with_orientations
from tiswarm.records.sensing_log import SensingNoise
from tiswarm.sensing import SensingParams, observe

BIASED = replace(NOISY, yaw_bias_deg=20.0, spawn_noise=0.0)
ALL = JointParams()
UNIT = 1e-6
SOURCE_SD = (0.2, 0.5)
ROBUST_SD = 3.0
KINDS = ["walks", "biased", "directions", "turned", "sources", "chained"]
INDEPENDENT = {"are_independent": True, "robust_sd": ROBUST_SD, "further_variance": 0.02**2}


def sensed(history, kind):
    """Sense a tower: walks, biased yaw, directions, both, sources, or without compasses."""
    log = observe(history, BIASED if kind in {"biased", "turned"} else NOISY)
    if kind in {"directions", "turned"}:
        return with_directions(log, history, sd_deg=1.0)
    if kind == "sources":
        return with_sources(with_ranges(log, history, reach=5.0, sd=0.1), history)
    if kind == "chained":
        linked = with_directions(log, history, sd_deg=1.0, walks=False)
        linked = with_connections(linked, history, sd_deg=1.0)
        blind = linked.orientation_wxyz.copy()
        blind[1:] = np.nan
        noise = replace(linked.noise, connection_deg=1.0)
        return replace(linked, orientation_wxyz=blind, stances=None, noise=noise)
    return log


def with_sources(log, history):
    """Let two sources measure robots along two or three axes, and every other range."""
    log = with_fixes(log, history, range(2, 30, 3), each=3, sd=0.05)
    fixes, ranges = log.fixes.copy(), log.ranges.copy()
    fixes[:, 6], ranges[::2, 4] = np.arange(len(fixes)) % 3 - 1, 1
    return replace(
        log, fixes=fixes, ranges=ranges, source_name=("a", "b"), source_sd=np.array(SOURCE_SD)
    )


def cost_of(log, params=ALL, **options):
    """Pose the problem of a log and its cost."""
    known = pose_problem(log, params)
    options = {"yaw_precision": known.yaw_precision, "links": known.connections, **options}
    return known, WholeCost(log, known.rows, **options)


def state_at(cost, position, draw=None, *, turn=1.0):
    """State at some positions, its other parts drawn in their standard deviations."""
    robots = len(position)
    if draw is None:
        return cost.at(position, np.zeros(robots))
    yaw = draw.normal(size=robots) * (cost.precision[6 * robots] > 0.0)
    turns = turn * draw.normal(size=(len(cost.walks.owner), 3))
    shared = draw.normal(size=len(cost.rows.shared_sd))
    found = cost.at(position, yaw, turns[cost.walks.final], turns[cost.is_earlier])
    return found._replace(shared=shared)


def residuals(cost, state):
    """Residuals of measurements, with what turns of earlier stances add to them."""
    linear = cost.linearized(state)
    missed = linear.residual[: len(cost.rows)]
    return missed + by_turns(linear) @ state.earlier.ravel()


def unknowns(cost, state):
    """Concatenate the unknowns of a state: positions, turns of final stances, yaw, and sources."""
    return np.concatenate([state.position.ravel(), state.turn.ravel(), state.yaw, state.shared])


def with_prior(cost, width):
    """Add a prior of all positions around the start."""
    return cost.held(np.full(cost.rows.robots, width))


def by_turns(linear):
    """Derivatives B of all measurements by turns of earlier stances, one after the other."""
    noise = linear.noise
    turns = np.eye(3 * noise.earlier).reshape(noise.earlier, 3, 3 * noise.earlier)
    every = np.zeros((len(linear.tables[0].residual), 3 * noise.earlier))
    every[linear.walked] = noise.errors(turns)
    return every


def dense(linear):
    """Inverse covariance of all rows, B B^T + diag inverted, by numpy."""
    of_measurements = by_turns(linear)
    noise = np.zeros((len(linear.residual), of_measurements.shape[1]))
    noise[: len(of_measurements)] = of_measurements
    return np.linalg.inv(noise @ noise.T + np.diag(linear.own_variance))


def _orientations(log):
    """Orientations in the order of the walks: a robot's stances, its final one last."""
    if log.stances is None:
        return Rotation.from_quat(log.orientation_wxyz, scalar_first=True)
    start, every = log.stances.start, log.stances.orientation_wxyz
    rows = []
    for j in range(log.robot_count):
        rows += [*every[start[j] : start[j + 1]], log.orientation_wxyz[j]]
    return Rotation.from_quat(np.array(rows), scalar_first=True)


def _walked_slowly(log, walks, state):
    """Docks and centers at every stance, flip by flip, back from where robots stand at last."""
    sd = walks.turn_sd[:, [0, 0, 1]]
    yaw = Rotation.from_rotvec(np.array([0.0, 0.0, 1.0]) * state.yaw[walks.owner, None])
    turn, final = np.empty((len(sd), 3)), np.isin(np.arange(len(sd)), walks.final)
    turn[final], turn[~final] = state.turn, state.earlier
    true = Rotation.from_rotvec(-turn * sd) * yaw * _orientations(log)
    center = np.zeros((len(walks.owner), 3))
    dock = np.array([true.apply(d) for d in log.dock_offset_body]).swapaxes(0, 1)
    pivot = iter([] if log.stances is None else log.stances.pivot_dock[::-1])
    for s in range(len(walks.owner) - 1, -1, -1):
        if s == walks.final[walks.owner[s]]:
            center[s] = state.position[walks.owner[s]]
        else:
            held = next(pivot)
            center[s] = center[s + 1] + dock[s + 1, held] - dock[s, held]
    return center[:, None] + dock, center, true


def _residuals_slowly(log, rows, state):
    """Residuals of distances, directions and coordinates, row by row."""
    walks, shared = rows.odometry, np.append(rows.shared_sd * state.shared, 0.0)
    dock, center, true = _walked_slowly(log, walks, state)

    def point(stance, number):
        return center[stance] if number == CENTER else dock[stance, number]

    expected = []
    for s, own, t, its, length, source in zip(
        *rows.distances[:5], rows.distances.source, strict=True
    ):
        expected.append(np.linalg.norm(point(s, own) - point(t, its)) - length + shared[source])
    o = rows.offsets
    sensed_turn = _orientations(log)
    for k in range(len(o.stance)):
        s, t = o.stance[k], o.other_stance[k]
        vector = (true[s] * sensed_turn[s].inv()).apply(o.vector[k])
        about = Rotation.from_rotvec([0.0, 0.0, state.yaw[walks.owner[s]]])
        apart = point(s, o.dock[k]) + vector - point(t, o.other_dock[k])
        expected.append(about.apply(o.axis[k]) @ apart)
    p = rows.places
    for stance, own, way, value, source in zip(
        p.stance, p.dock, p.direction, p.value, p.source, strict=True
    ):
        expected.append(way @ point(stance, own) - value + shared[source])
    return np.array(expected)


@pytest.mark.parametrize("kind", KINDS)
def test_residuals_are_those_of_walks_taken_flip_by_flip(tall_towers, kind):
    """Wherever robots are, and however wrong orientations and sources are."""
    log = with_orientations(sensed(tall_towers[0], kind))
    known, cost = cost_of(log)
    draw = np.random.default_rng(1)
    at = tall_towers[0].position + draw.normal(size=(log.robot_count, 3))
    state = state_at(cost, at, draw)

    found = residuals(cost, state)

    assert len(known.rows) > 60
    np.testing.assert_allclose(found, _residuals_slowly(log, known.rows, state), atol=1e-9)


@pytest.mark.parametrize("robots", [[], range(0, 30, 2), None])
def test_nothing_is_left_where_robots_truly_are(tall_towers, robots):
    """With the turns that orientations were sensed with, however large, and with directions."""
    noise = SensingParams(tilt_noise_deg=10.0, yaw_noise_deg=20.0, spawn_noise=0.0)
    for history in tall_towers:
        log = with_directions(observe(history, noise), history, sd_deg=0.0, robots=robots)
        known, cost = cost_of(log, replace(ALL, cues=Cues(height=False)))
        true = np.concatenate([walk.orientation_wxyz for walk in history.walks])
        wrong = _orientations(log) * Rotation.from_quat(true, scalar_first=True).inv()
        turn = wrong.as_rotvec() / np.radians([10.0, 10.0, 20.0])
        turns = turn[cost.walks.final], turn[cost.is_earlier]
        state = cost.at(history.position, np.zeros(log.robot_count), *turns)

        left = residuals(cost, state)

        offsets = len(known.rows.offsets.stance)
        assert offsets == 0 or robots != []
        # Gaps of docks shorten what is left of a vector of length D.
        assert -1e-9 - 0.02 * (offsets > 0) < left.min() <= left.max() < 0.02 + 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_those_of_the_residuals(tall_towers, kind):
    """By shifts, turns, yaw and errors of sources, and by turns of earlier stances, at no turn."""
    log = with_orientations(sensed(tall_towers[0], kind))
    known, cost = cost_of(log, non_overlap=False)
    draw = np.random.default_rng(2)
    robots = log.robot_count
    position = tall_towers[0].position + 0.1 * draw.normal(size=(robots, 3))
    at = state_at(cost, position, draw, turn=0.0)
    motion = state_at(cost, draw.normal(size=(robots, 3)), draw)
    motion.position[0] = 0.0
    linear = cost.linearized(at)
    slope = linear.jacobian @ unknowns(cost, motion)[cost.free]
    slope[: len(known.rows)] += by_turns(linear) @ motion.earlier.ravel()

    def moved(by):
        state = State(*(a + by * d for a, d in zip(at, motion, strict=True)))
        connections = cost.linearized(state).residual[len(known.rows) :]
        return np.concatenate([residuals(cost, state), connections])

    change = (moved(UNIT) - moved(-UNIT)) / (2.0 * UNIT)
    assert (len(change) > len(known.rows)) == (kind == "chained")
    np.testing.assert_allclose(slope, change, atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_of_overlaps_are_those_of_distances(tall_towers, kind):
    """Docks move with their robot, and turn with it by all that its orientation is corrected by."""
    log = with_orientations(sensed(tall_towers[0], kind))
    _, cost = cost_of(log)
    draw = np.random.default_rng(8)
    robots = log.robot_count
    position = tall_towers[0].position + 0.3 * draw.normal(size=(robots, 3))
    at = state_at(cost, position, draw, turn=0.0)
    motion = state_at(cost, draw.normal(size=(robots, 3)), draw)
    motion.position[0] = 0.0
    linear = cost.linearized(at)
    overlap = len(cost.rows) + np.arange(len(linear.tables[1].residual))
    slope = (linear.jacobian @ unknowns(cost, motion)[cost.free])[overlap]

    def moved(by):
        state = State(*(a + by * d for a, d in zip(at, motion, strict=True)))
        return cost.linearized(state).tables[1].residual

    change = (moved(UNIT) - moved(-UNIT)) / (2.0 * UNIT)
    assert len(change) > 4
    np.testing.assert_allclose(slope, change, atol=1e-5)


def test_a_prior_does_not_move_the_minimum(tall_towers):
    """However far off the search begins; else chains would decide where measurements are weak."""
    log = with_orientations(sensed(tall_towers[0], "chained"))
    _, cost = cost_of(log, non_overlap=False)
    yaw, draw = np.zeros(log.robot_count), np.random.default_rng(9)
    near = tall_towers[0].position + 0.05 * draw.normal(size=tall_towers[0].position.shape)
    near[0] = tall_towers[0].position[0]

    free, least = cost.refine(cost.at(near, yaw), 30)
    _, found = with_prior(cost, 0.3).refine(cost.at(near, yaw), 30)

    assert np.linalg.norm(free.position - near, axis=1).max() > 0.05
    assert found.cost == pytest.approx(least.cost, abs=0.2)


def test_residuals_of_connections_are_those_of_the_turned_robots(tall_towers):
    """To first order in how far all robots are turned from what connections chained."""
    log = with_orientations(sensed(tall_towers[0], "chained"))
    known, cost = cost_of(log, non_overlap=False)
    draw = np.random.default_rng(3)
    small = state_at(cost, tall_towers[0].position, draw, turn=1e-4)

    linear = cost.linearized(small)

    sd = known.rows.odometry.turn_sd[known.rows.odometry.final][:, [0, 0, 1]]
    turn = Rotation.from_rotvec(-small.turn * sd)
    right = (turn * _orientations(log)).as_quat(scalar_first=True)
    turned = connections_of(replace(log, orientation_wxyz=right))
    changed = linear.residual[len(known.rows) :] - known.connections.residual.ravel()
    expected = (turned.residual - known.connections.residual).ravel()
    assert np.abs(expected).max() > 1e-6
    np.testing.assert_allclose(changed, expected, atol=0.1 * np.abs(expected).max())
    np.testing.assert_allclose(
        linear.own_variance[len(known.rows) :], np.radians(1.0) ** 2, rtol=1e-12
    )


@pytest.mark.parametrize("kind", KINDS)
def test_steps_and_variances_are_those_of_generalized_least_squares(tall_towers, kind):
    """Written out with dense matrices, with overlaps and a prior of positions."""
    log = with_orientations(sensed(tall_towers[0], kind))
    known, cost = cost_of(log)
    robots = log.robot_count
    draw = np.random.default_rng(4)
    begin = state_at(cost, tall_towers[0].position)
    at = state_at(cost, begin.position + 0.01 * draw.normal(size=(robots, 3)), draw, turn=0.1)
    at.position[0] = begin.position[0]
    linear = with_prior(cost, 0.7).linearized(at)
    jacobian, weight = linear.jacobian.toarray(), dense(linear)
    prior = with_prior(cost, 0.7).precision[cost.free]
    posterior = np.linalg.inv(jacobian.T @ weight @ jacobian + np.diag(prior))
    slope = jacobian.T @ weight @ linear.residual + prior * linear.off
    step = -posterior @ slope
    left = (weight @ (linear.residual + jacobian @ step))[: len(known.rows)]

    found, turn = linear.step(np.inf)
    variance = linear.variance()

    # Every motion is damped a little, in case that nothing else resists it.
    np.testing.assert_allclose(found, step, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(turn, -(by_turns(linear).T @ left), atol=1e-5)
    shift = 3 * (robots - 1)
    true = np.diag(posterior)[:shift].reshape(-1, 3).sum(axis=1)
    assert variance[0] == 0.0
    # Of 64 draws in three dimensions each is uncertain by a tenth or so, their mean by less.
    assert np.abs(np.log(variance[1:] / true)).max() < 0.6
    assert np.mean(variance[1:] / true) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("kind", KINDS)
def test_the_width_of_a_minimum_is_the_root_of_a_determinant(tall_towers, kind):
    """Of the covariance of all unknowns; solutions are weighed by it."""
    log = with_orientations(sensed(tall_towers[0], kind))
    _, cost = cost_of(log, non_overlap=False)
    volumes, expected = [], []

    for width in (0.1, 0.5):
        start = (tall_towers[0].position, np.zeros(30))
        linear = with_prior(cost, width).linearized(cost.at(*start))
        volumes.append(linear.log_volume)
        information = linear.jacobian.T @ dense(linear) @ linear.jacobian.toarray()
        information += np.diag(linear.precision)
        expected.append(-0.5 * np.linalg.slogdet(information)[1])

    assert np.diff(volumes) == pytest.approx(np.diff(expected), rel=1e-6)
    assert volumes[0] < volumes[1]


@pytest.mark.parametrize("radius", [0.01, 1.0])
def test_steps_within_a_radius_are_those_with_a_prior_of_that_width(tall_towers, radius):
    """As Levenberg and Marquardt damp them: turns and errors of sources are not."""
    log = sensed(tall_towers[0], "sources")
    _, cost = cost_of(log)
    draw = np.random.default_rng(4)
    at = state_at(cost, tall_towers[0].position + 0.3 * draw.normal(size=(30, 3)), draw, turn=0.1)
    linear = cost.linearized(at)

    found, _ = linear.step(radius)

    weight, jacobian = dense(linear), linear.jacobian.toarray()
    prior = with_prior(cost, radius).precision[cost.free]
    posterior = np.linalg.inv(jacobian.T @ weight @ jacobian + np.diag(prior))
    np.testing.assert_allclose(found, -posterior @ linear.slope, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_a_round_goes_where_its_step_leads(tall_towers, kind, monkeypatch):
    """Each unknown moves by its own part of the step; the start is left as it was."""
    log = with_orientations(sensed(tall_towers[0], kind))
    _, cost = cost_of(log, non_overlap=False)
    begin = state_at(cost, tall_towers[0].position)
    width = 1e-3
    free, earlier = with_prior(cost, width).linearized(begin).step(np.inf)
    step = np.zeros(len(cost.precision))
    step[cost.free] = free
    monkeypatch.setattr(WholeCost, "most_rounds", 1)

    state, _ = with_prior(cost, width).refine(cost.at(begin.position, begin.yaw), 1)

    assert 1e-4 < np.abs(step[: 3 * log.robot_count]).max() < 0.5  # none is cut
    moved = State(*(a - b for a, b in zip(state, begin, strict=True)))
    np.testing.assert_allclose(unknowns(cost, moved), step, atol=1e-9)
    np.testing.assert_allclose(state.earlier.ravel(), earlier, atol=1e-9)
    np.testing.assert_array_equal(begin.position, tall_towers[0].position)


@pytest.mark.parametrize("kind", KINDS)
def test_the_cost_is_the_chi_square_written_out(tall_towers, kind):
    """r^T C^-1 r with numpy's inverse, and squares of unknowns in their priors.

    A prior of positions does not count: it would draw the minimum to where the search began.
    """
    log = with_orientations(sensed(tall_towers[0], kind))
    known, cost = cost_of(log)
    draw = np.random.default_rng(5)
    at = state_at(
        cost, tall_towers[0].position + 0.3 * draw.normal(size=(log.robot_count, 3)), draw
    )

    linear = with_prior(cost, 0.7).linearized(at)

    weight = dense(linear)
    inverse = linear.weighted(np.eye(len(weight)))
    np.testing.assert_allclose(inverse, weight, atol=1e-9 * np.abs(weight).max())
    measured, overlaps = len(known.rows), len(linear.tables[1].residual)
    pull = weight @ linear.residual
    square = linear.residual * pull
    unknown = unknowns(cost, at) ** 2 @ cost.precision
    overlap = square[measured : measured + overlaps].sum()
    assert overlaps > 0
    np.testing.assert_allclose(linear.square, square[:measured], rtol=1e-6, atol=1e-6)
    assert linear.overlap == pytest.approx(overlap)
    assert linear.chi_square == pytest.approx(square.sum() - overlap + unknown)
    assert linear.cost == pytest.approx(square.sum() + unknown)


@pytest.mark.parametrize("kind", ["walks", "directions", "sources"])
def test_the_robust_cost_is_cauchys_loss_written_out(tall_towers, kind):
    """c^2 log(1 + e^2 / c^2 v) of each row, or of the three rows of a direction together."""
    log = sensed(tall_towers[0], kind)
    known, cost = cost_of(log, non_overlap=False, **INDEPENDENT)
    draw = np.random.default_rng(6)
    far = draw.normal(size=(log.robot_count, 3)) * draw.choice([0.01, 3.0], (log.robot_count, 1))
    at = state_at(cost, tall_towers[0].position + far, draw)

    linear = cost.linearized(at)

    rows = known.rows
    variance = rows.variance() - rows.shared_variance + 0.02**2
    missed = rows.residual(at.position) + np.append(rows.shared_sd * at.shared, 0.0)[rows.source]
    square = missed**2 / variance
    first, last = len(rows.distances.stance), len(rows.neighbor)
    loss = sum(_cauchy(each) for each in [*square[:first], *square[last:]])
    loss += sum(_cauchy(square[k : k + 3].sum()) for k in range(first, last, 3))
    assert square.max() > 10.0 * ROBUST_SD**2
    assert (last > first) == (kind == "directions")
    assert linear.chi_square - at.shared @ at.shared == pytest.approx(loss)
    assert linear.square.sum() == pytest.approx(loss)


def _cauchy(square):
    """Cauchy's loss of a squared residual in variances."""
    return ROBUST_SD**2 * np.log(1.0 + square / ROBUST_SD**2)


@pytest.mark.parametrize("kind", ["walks", "directions", "sources"])
def test_the_slope_of_the_robust_cost_is_its_derivative(tall_towers, kind):
    """Else steps would lead past the minimum, and rounds would end short of it."""
    log = sensed(tall_towers[0], kind)
    _, cost = cost_of(log, **INDEPENDENT)
    draw = np.random.default_rng(7)
    motion = state_at(cost, draw.normal(size=(log.robot_count, 3)), draw, turn=0.0)
    motion.position[0] = 0.0
    for width in (0.01, 0.3):
        moved = width * draw.normal(size=(log.robot_count, 3))
        at = state_at(cost, tall_towers[0].position + moved, draw, turn=0.0)

        slope = cost.linearized(at).slope

        def total(by, at=at):
            state = State(*(a + by * d for a, d in zip(at, motion, strict=True)))
            return cost.linearized(state).cost

        change = (total(UNIT) - total(-UNIT)) / (2.0 * UNIT)
        assert 2.0 * slope @ unknowns(cost, motion)[cost.free] == pytest.approx(change, rel=1e-4)


CONTACTS_ONLY = JointParams(
    cues=Cues(height=False, ground=False, walk_contacts=False, odometry=False)
)


@settings(max_examples=30)
@given(
    kind=st.sampled_from(["tree", "loops", "chain"]),
    docks=st.integers(1, 5),
    robots=st.integers(2, 12),
    seed=st.integers(0, 99),
    level=st.booleans(),
)
def test_freedom_is_rows_less_the_rank_of_their_derivatives(kind, docks, robots, seed, level):
    """By numpy, floppy structures included; the motions left are those that change no row."""
    log, truth = structure(Rule(kind=kind, docks=docks, offset=2.0), robots, seed)
    log = replace(log, noise=SensingNoise(tilt_deg=0.0, yaw_deg=0.0))
    log = with_heights(log, truth) if level else log
    known, cost = cost_of(log, ALL if level else CONTACTS_ONLY, non_overlap=False)
    linear = cost.refine(cost.at(truth, np.zeros(robots)), 0)[1]
    weighted = linear.jacobian.toarray() / np.sqrt(linear.own_variance)[:, None]
    size = np.linalg.svd(weighted)[1]
    assume(not ((size > 1e-6 * size[0]) & (size < 1e-3 * size[0])).any())  # hardly floppy

    freedom = linear.freedom()

    rank = (size > 1e-4 * size[0]).sum()
    left = observability(log, (ALL if level else CONTACTS_ONLY).used_cues)
    assert freedom == len(known.rows) - rank
    assert left.floppy_modes == 3 * robots - 3 - rank


@pytest.mark.parametrize("kind", KINDS)
def test_freedom_counts_priors_as_rows(tall_towers, kind):
    """Turns, yaw and errors of sources are known beforehand to so much; positions are not.

    Chained turns are not, either: connections alone say what they are.
    """
    log = with_orientations(sensed(tall_towers[0], kind))
    _, cost = cost_of(log, non_overlap=False)
    start = (tall_towers[0].position, np.zeros(30))
    linear = cost.linearized(cost.at(*start))
    held = with_prior(cost, 0.1).linearized(cost.at(*start))

    freedom = linear.freedom()

    assert held.freedom() == freedom
    precision = cost.precision[cost.free]
    prior = np.diag(np.sqrt(precision))[precision > NOMINAL]
    weighted = np.linalg.cholesky(dense(linear)).T @ linear.jacobian.toarray()
    every = np.concatenate([weighted, prior])
    assert freedom == len(every) - np.linalg.matrix_rank(every)
    assert 0 < freedom < len(every)


@settings(max_examples=20)
@given(seed=st.integers(0, 999), far=st.sampled_from([0.1, 1.0, 10.0]), robust=st.booleans())
def test_rounds_never_raise_the_cost(seed, far, robust):
    """However far off the start is: a step that does is shortened, or not taken."""
    log, truth = structure(Rule(kind="loops"), 15, seed % 5)
    log = with_heights(log, truth)
    _, cost = cost_of(log, robust_sd=ROBUST_SD if robust else None)
    start = truth + far * np.random.default_rng(seed).normal(size=truth.shape)
    start[0] = truth[0]
    last = np.inf

    for rounds in (0, 1, 3, 10):
        state, linear = cost.refine(cost.at(start, np.zeros(15)), rounds)

        assert linear.cost <= last + SETTLED
        last = linear.cost
        again = cost.linearized(state)
        assert again.cost == pytest.approx(linear.cost)


@pytest.mark.parametrize("kind", KINDS)
def test_rounds_end_where_no_step_is_left(tall_towers, kind):
    """Turns, yaw and errors of sources add up from round to round as positions do."""
    log = with_orientations(sensed(tall_towers[0], kind))
    _, cost = cost_of(log, non_overlap=False)
    draw = np.random.default_rng(10)
    start = tall_towers[0].position + 0.02 * draw.normal(size=(30, 3))
    start[0] = tall_towers[0].position[0]

    state, linear = with_prior(cost, 0.3).refine(cost.at(start, np.zeros(30)), 40)

    gain = -linear.slope @ linear.step(np.inf)[0]
    assert np.abs(state.turn).max() > 0.1
    assert 0.0 <= gain < 0.05 < 1e-3 * cost.refine(cost.at(start, np.zeros(30)), 0)[1].cost


def test_no_round_moves_a_robot_far(monkeypatch):
    """Half an R, or half of a usual distance: derivatives are those of where it was."""
    log, truth = structure(Rule(kind="tree"), 15, 1)
    log = with_heights(log, truth)
    _, cost = cost_of(log, non_overlap=False)
    start = truth + 8.0 * np.random.default_rng(0).normal(size=truth.shape)
    start[0] = truth[0]
    monkeypatch.setattr(WholeCost, "most_rounds", 1)

    state, _ = cost.refine(cost.at(start, np.zeros(15)), 1)

    moved = np.linalg.norm(state.position - start, axis=1)
    assert moved.max() == pytest.approx(1.0)  # docks that touch are 2 R apart


def test_only_connections_hold_the_turns_of_robots_without_a_compass(tall_towers):
    """What chained them is in the rows; a prior of their own would count it twice."""
    compass, chained = (
        cost_of(with_orientations(sensed(tall_towers[0], kind)))[1].precision[93:180]
        for kind in ("directions", "chained")
    )

    assert set(compass) == {1.0}
    assert 0.0 < chained.max() < 1e-5


@given(seed=st.integers(0, 99), robots=st.integers(2, 40))
@pytest.mark.parametrize("has_heights", [False, True])
def test_offsets_of_an_open_chain_share_a_strain(has_heights, seed, robots):
    """Errors grow with the distance from the anchor, and upward unless heights are known."""
    step = np.random.default_rng(seed).normal(0.0, 3.0, (robots, 3))
    place = np.cumsum(step, axis=0)
    log = silent(place)
    if has_heights:
        height = np.column_stack([np.arange(robots), np.tile([0.0, 0.0, 1.0], (robots, 1))])
        every = np.ones((robots, 1))
        log = replace(log, fixes=np.hstack([height, place[:, 2:], 0.01 * every, -every]))
    one = np.arange(1, robots)
    cost = cost_of(log, hinged=np.column_stack([one, one - 1]), non_overlap=False)[1]

    shared = cost.open_variance(place, np.zeros(robots), part=0.0)
    every_way = cost.open_variance(place, np.zeros(robots)) - shared

    axes = 2 if has_heights else 3
    far = ((place - place[0])[:, :axes] ** 2).sum(axis=1)
    np.testing.assert_allclose(shared, STRAIN_SD**2 * far, rtol=0.02, atol=0.01)
    # A random walk, in the mean over draws, which is off by chance.
    assert every_way.sum() == pytest.approx(HINGE_SD**2 * axes * np.arange(robots).sum(), rel=0.8)


def _overlap_slowly(log, position):
    """Squared overlaps of all docks of different robots that do not touch, in variances."""
    count = len(log.dock_offset_body)
    docks = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    place = (position[:, None] + docks).reshape(-1, 3)
    touching = {(count * i + a, count * j + b) for i, a, j, b in log.contacts.tolist()}
    total = 0.0
    for a, b in combinations(range(len(place)), 2):
        if a // count != b // count and (a, b) not in touching:
            total += max(0.0, 2.0 - np.linalg.norm(place[a] - place[b])) ** 2
    return total / OVERLAP_SD**2


@pytest.mark.parametrize(
    "angle",
    [1.0, 3.0],
)  # fmt: skip
def test_docks_that_overlap_are_pushed_apart(angle):
    """Where an arm is folded back; the cost of overlaps is that of all pairs written out."""
    log, truth = structure(Rule(kind="chain", docks=2), 8, 2)
    _, cost = cost_of(log)
    folded, turn = truth.copy(), Rotation.from_rotvec([0.0, 0.0, angle])
    folded[5:] = truth[4] + turn.apply(truth[5:] - truth[4])

    before = cost.refine(cost.at(folded, np.zeros(8)), 0)[1]
    state, after = cost.refine(cost.at(folded, np.zeros(8)), 30)

    turned = Rotation.from_quat(log.orientation_wxyz, scalar_first=True)
    turn_sd = cost.walks.turn_sd[cost.walks.final][:, [0, 0, 1]]
    turned = Rotation.from_rotvec(-state.turn * turn_sd) * turned
    right = replace(log, orientation_wxyz=turned.as_quat(scalar_first=True))
    assert before.overlap == pytest.approx(_overlap_slowly(log, folded))
    assert after.overlap == pytest.approx(_overlap_slowly(right, state.position))
    assert after.overlap < 0.1 * before.overlap


def _blind(history):
    """Sense orientations only."""
    log = observe(history, SensingParams())
    return replace(
        log, stances=None, contacts=log.contacts[:0], ground_docks=log.ground_docks[:0],
        ground_z=None, flip_height=np.full(log.robot_count, np.nan),
    )  # fmt: skip


def test_an_error_that_fixes_share_is_found(tall_towers):
    """Robots of one source are off alike; one whose place is known otherwise says by how much."""
    history, sd, shared = tall_towers[0], 0.05, np.array([0.6, -0.9])
    log = _blind(history)
    draw = np.random.default_rng(8)
    robot, axis = np.repeat(np.arange(1, 30), 3), np.tile(np.arange(3), 29)
    source = np.where(axis < 2, axis, -1)
    value = history.position[robot, axis] + np.append(shared, 0.0)[source]
    value += sd * draw.normal(size=len(robot))
    fixes = np.column_stack([robot, np.eye(3)[axis], value, np.full(len(robot), sd), source])
    ranges = np.array([[1, 0, np.linalg.norm(history.position[1] - history.position[0]), sd, -1]])
    known = np.array([[1, *way, way @ history.position[1], sd, -1] for way in np.eye(3)[:2]])
    log = replace(
        log, fixes=np.concatenate([fixes, known]), ranges=ranges,
        source_name=("x", "y"), source_sd=np.ones(2),
    )  # fmt: skip
    _, cost = cost_of(log, non_overlap=False)
    start = history.position + 0.1 * draw.normal(size=(30, 3))

    state, linear = cost.refine(cost.at(start, np.zeros(30)), 8)

    np.testing.assert_allclose(state.shared, shared, atol=0.15)
    off = np.linalg.norm(state.position - history.position, axis=1)[1:]
    assert np.sqrt((off**2).mean()) < 3.0 * sd
    assert np.sqrt((off**2 / linear.variance()[1:]).mean()) < 2.0


@pytest.mark.parametrize("sources", [1, 2, 4])
def test_what_fixes_share_does_not_average_out(tall_towers, sources):
    """However many fixes a robot has of each source, sd is the shared one over sqrt(sources)."""
    history, each, shared = tall_towers[0], 50, 0.4
    log = _blind(history)
    robot = np.repeat(np.arange(1, 30), 3 * each * sources)
    axis = np.tile(np.arange(3), 29 * each * sources)
    source = axis * sources + np.tile(np.repeat(np.arange(sources), 3), 29 * each)
    value = history.position[robot, axis] + 0.05 * np.random.default_rng(9).normal(size=len(robot))
    fixes = np.column_stack([robot, np.eye(3)[axis], value, np.full(len(robot), 0.05), source])[
        np.lexsort((axis, robot))
    ]
    log = replace(
        log, fixes=fixes, source_name=tuple(map(str, range(3 * sources))),
        source_sd=np.full(3 * sources, shared),
    )  # fmt: skip
    _, cost = cost_of(log, non_overlap=False)

    sd = np.sqrt(cost.refine(cost.at(history.position, np.zeros(30)), 4)[1].variance()[1:])

    floor = np.sqrt(3.0) * shared / np.sqrt(sources)
    assert sd == pytest.approx(floor, rel=0.25)  # of 64 draws, all robots alike
    assert np.ptp(sd) < 0.1 * floor


def test_settings_choose_which_structures_are_refined():
    """If they say nothing, those that take less time to refine than to anneal."""
    assert ALL.refines(LARGE)
    assert not ALL.refines(LARGE + 1)
    assert replace(ALL, refine=True).refines(LARGE + 1)
    assert not replace(ALL, refine=False).refines(2)


@pytest.mark.parametrize("kind", sorted({*KINDS} - {"sources"}))
@pytest.mark.parametrize("robust_sd", [None, ROBUST_SD])
def test_robots_that_stay_are_constants(tall_towers, kind, robust_sd):
    """Their rows and columns are left out of the normal equations, and nothing else."""
    history = tall_towers[0]
    log, draw = sensed(history, kind), np.random.default_rng(100_000)
    moves = draw.random(len(history.position)) < 0.3
    position = history.position + 0.1 * draw.normal(size=history.position.shape)
    position[0] = history.position[0]
    _, whole = cost_of(log, robust_sd=robust_sd)
    _, part = cost_of(log, robust_sd=robust_sd, moves=moves)
    states = [state_at(whole, position, draw, turn=0.3)]
    # Only robots that move move on.
    shift = np.where(moves[:, None], 0.05 * draw.normal(size=position.shape), 0.0)
    states.append(states[0]._replace(position=position + shift * (np.arange(30) > 0)[:, None]))

    of_whole, of_part = ([cost.linearized(state) for state in states] for cost in (whole, part))

    at = np.searchsorted(whole.free, part.free)
    assert (whole.free[at] == part.free).all()
    assert set(part.free) == {*whole.free} & {
        *np.flatnonzero(np.concatenate([np.repeat(np.tile(moves, 2), 3), moves]))
    }
    known, some = (
        linear.information @ np.eye(len(linear.precision)) + np.diag(linear.precision)
        for linear in (of_whole[0], of_part[0])
    )
    np.testing.assert_allclose(some, known[np.ix_(at, at)], atol=1e-9 * np.abs(known).max())
    slope = of_whole[0].slope
    np.testing.assert_allclose(of_part[0].slope, slope[at], atol=1e-9 * np.abs(slope).max())
    fall, its = (there.cost - here.cost for here, there in (of_whole, of_part))
    assert its == pytest.approx(fall, rel=1e-7)
    variance = of_part[0].variance()
    assert variance.shape == moves.shape
    assert (variance[~moves] == 0.0).all()
    assert (variance[moves & (np.arange(30) > 0)] > 0.0).all()
