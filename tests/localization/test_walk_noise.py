"""Noise of earlier stances: the covariance of rows of long walks, in linear time and memory."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from tests.structures import NOISY, grown
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.cost.cost import WholeCost
from tiswarm.localization.cost.linear import DRAWS, Linear
from tiswarm.localization.cost.walk_noise import WalkCovariance, WalkNoise, WalkRows, summed
from tiswarm.localization.methods import localize
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.odometry import Odometry
from tiswarm.records.sensing_log import SensingNoise, Stances
from tiswarm.sensing import observe
from tiswarm.world.mechanics import MechanicsParams
from tiswarm.world.params import ClimbParams, TowerParams


def walked(history, flips, draw):
    """Sense a tower, and put walks of so many flips before each robot's own."""
    log = observe(history, NOISY)
    count = np.full(log.robot_count, flips) if np.ndim(flips) == 0 else np.asarray(flips)
    stances = int(count.sum())
    later = np.repeat(np.arange(log.robot_count), count)
    rows = np.flatnonzero(later > 0)
    contacts = np.column_stack(
        [
            rows,
            draw.integers(3, size=len(rows)),
            draw.integers(later[rows]),
            draw.integers(3, size=len(rows)),
        ]
    )
    docks = np.column_stack([np.arange(stances), draw.integers(3, size=stances)])
    walks = Stances(
        start=np.concatenate([[0], np.cumsum(count)]),
        orientation_wxyz=Rotation.random(stances, random_state=1).as_quat(scalar_first=True),
        pivot_dock=draw.integers(3, size=stances).astype(np.int32),
        contacts=contacts.astype(np.int32),
        ground_docks=docks.astype(np.int32),
    )
    return replace(log, stances=walks)


def noise_of(log, draw, *, every=1):
    """Derivatives of several rows at every so many stances of a log, drawn at random."""
    odometry = Odometry(log)
    earlier = np.flatnonzero(odometry.is_earlier)[::every]
    stance = np.repeat(earlier, draw.integers(1, 5, size=len(earlier)))
    stance = np.concatenate([stance, odometry.final])
    draw.shuffle(stance)
    rows = np.flatnonzero(odometry.is_earlier[stance])
    of = WalkRows(rows, odometry.owner[stance], stance, odometry)
    shift = 0.1 * draw.normal(size=(len(odometry.owner), 3, 3))
    shift[:, :, 2] = 0.0  # of a turn about the vertical that is known
    shift[odometry.final] = 0.0
    center, turn = draw.normal(size=(2, len(rows), 3))
    return WalkNoise(of, center, 0.1 * turn, shift)


def derivatives(noise):
    """Derivatives of rows by all turns of earlier stances, stance by stance, shape (n, 3 M)."""
    odometry = noise.of.odometry
    dense = np.zeros((len(noise.center), len(odometry.owner), 3))
    for row, stance in enumerate(noise.of.stance.tolist()):
        final = odometry.final[odometry.owner[stance]]
        dense[row, stance] = noise.turn[row]
        for later in range(stance + 1, final):
            dense[row, later] = noise.center[row] @ noise.shift[later]
    return dense[:, odometry.is_earlier].reshape(len(dense), -1)


@pytest.mark.parametrize(
    "flips", [3, [0, 1, 40, 0, 7, 90, 2] + [0] * 23, [0] * 29 + [120], [60] + [0] * 29]
)
@pytest.mark.parametrize("every", [1, 5])
def test_rows_are_weighed_by_the_inverse_of_their_dense_covariance(tall_towers, flips, every):
    """However long walks are, and whether or not robots sensed something at each stance."""
    draw = np.random.default_rng(3)
    noise = noise_of(walked(tall_towers[0], flips, draw), draw, every=every)
    rows = len(noise.center)
    own = 10.0 ** draw.uniform(-4.0, 0.0, rows)
    by_turns = derivatives(noise)
    inverse = np.linalg.inv(by_turns @ by_turns.T + np.diag(own))
    column = draw.integers(12, size=(rows, 4))
    jacobian = np.zeros((rows, 12))
    np.put_along_axis(jacobian, column, draw.normal(size=column.shape), axis=1)
    chosen = draw.permutation(rows)[: rows // 2]

    covariance = WalkCovariance(noise, own)

    precise = {"rtol": 1e-9, "atol": 1e-9 * np.abs(inverse).max()}
    np.testing.assert_allclose(covariance.weighted(np.eye(rows)), inverse, **precise)
    among = covariance.inverse_among(chosen)
    np.testing.assert_allclose(among, inverse[np.ix_(chosen, chosen)], **precise)
    parts = list(covariance.information(csr_array(jacobian)))
    information = jacobian.T @ inverse @ jacobian
    np.testing.assert_allclose(summed(parts, 12).toarray(), information, **precise)
    dense = np.zeros((12, 12))
    for columns, part in parts:
        dense[np.ix_(columns, columns)] += part
    np.testing.assert_allclose(dense, information, **precise)
    turns = draw.normal(size=(noise.earlier, 3, 2))
    errors = by_turns @ turns.reshape(-1, 2)
    np.testing.assert_allclose(noise.errors(turns), errors, rtol=1e-9, atol=1e-12)
    value = draw.normal(size=rows)
    transposed = (by_turns.T @ value).reshape(-1, 3)
    np.testing.assert_allclose(noise.by_turns(value), transposed, rtol=1e-9, atol=1e-12)


def test_the_factor_grows_in_proportion_to_flips(tall_towers):
    """A dense block of all rows of a robot has 100 times the entries for ten times the flips."""
    entries = []
    for flips in (10, 50, 100):
        draw = np.random.default_rng(4)
        log = walked(tall_towers[0], flips, draw)
        cost = WholeCost(log, pose_problem(log, JointParams()).rows, non_overlap=False)
        linear = cost.linearized(cost.at(tall_towers[0].position, np.zeros(log.robot_count)))
        rows = len(linear.walked)
        assert rows > flips * (log.robot_count - 1)
        entries.append(linear.covariance.size)

    assert entries[2] < 12.0 * entries[0]
    assert entries[2] < 2.2 * entries[1]


@pytest.mark.parametrize("flips", [4, [0, 40, 0, 7, 90] + [3] * 25])
def test_dense_and_sparse_information_solve_the_same_problem(tall_towers, flips, monkeypatch):
    """Which of them is computed and factored is a matter of time alone."""
    log = walked(tall_towers[0], flips, np.random.default_rng(6))
    cost = WholeCost(log, pose_problem(log, JointParams()).rows)
    position = tall_towers[0].position + 0.1 * np.random.default_rng(7).normal(size=(30, 3))
    position[0] = tall_towers[0].position[0]
    problems = []
    for least in (0.0, np.inf):
        monkeypatch.setattr("tiswarm.localization.cost.linear._DENSE", least)
        linear = cost.held(np.full(30, 3.0)).linearized(cost.at(position, np.zeros(30)))
        problems.append(linear)
        assert linear.is_dense == (least == 0.0)
        linear.undamped.solve(linear.slope)
    dense, sparse = problems

    largest = np.abs(dense.information).max()
    np.testing.assert_allclose(sparse.information.toarray(), dense.information, atol=1e-9 * largest)
    for radius in (np.inf, 0.5):
        for one, another in zip(dense.step(radius), sparse.step(radius), strict=True):
            np.testing.assert_allclose(one, another, rtol=1e-6, atol=1e-9)
    assert dense.log_volume == pytest.approx(sparse.log_volume, rel=1e-9)
    assert dense.freedom() == sparse.freedom()
    np.testing.assert_allclose(dense.variance(), sparse.variance(), rtol=1e-6)


def test_one_long_walk_makes_those_of_others_no_larger(tall_towers):
    """Most robots walk few flips, and some a hundred times as many."""
    draw = np.random.default_rng(5)
    short = noise_of(walked(tall_towers[0], [8] * 30, draw), draw)
    long = noise_of(walked(tall_towers[0], [8] * 29 + [800], draw), draw)

    sizes = [WalkCovariance(noise, np.ones(len(noise.center))).size for noise in (short, long)]

    grown = (len(long.center) - len(short.center)) / len(short.center)
    assert grown > 2.0
    assert sizes[1] < (1.5 + 1.5 * grown) * sizes[0]


def test_few_draws_at_a_time_are_those_of_all_at_once(tall_towers, monkeypatch):
    """Logs of many robots draw few errors at a time, which takes less memory."""
    log = observe(tall_towers[0], NOISY)
    cost = WholeCost(log, pose_problem(log, JointParams()).rows)
    linear = cost.linearized(cost.at(tall_towers[0].position, np.zeros(30)))
    at_once = [
        np.concatenate(parts, axis=-1) for parts in zip(*linear.residuals_of_draws(), strict=True)
    ]
    variance = linear.variance()
    widest = []
    drawn = Linear._drawn  # noqa: SLF001 - nothing else says how much memory it takes

    def counted(self, draws):
        for part in drawn(self, draws):
            widest.append(part[0].shape[1])
            yield part

    monkeypatch.setattr(Linear, "_drawn", counted)
    monkeypatch.setattr("tiswarm.localization.cost.linear._MOST_DRAWN", 5000)

    parts = [
        np.concatenate(parts, axis=-1) for parts in zip(*linear.residuals_of_draws(), strict=True)
    ]

    assert max(widest) < DRAWS // 4
    assert sum(widest) == DRAWS
    for part, whole in zip(parts, at_once, strict=True):
        np.testing.assert_allclose(part, whole, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(linear.variance(), variance, rtol=1e-9)


def test_stances_of_an_unknown_way_do_not_count(tall_towers):
    """Seen over 600 flips with noise, a contact may be in any direction."""
    log = walked(tall_towers[0], [0] * 29 + [600], np.random.default_rng(8))

    rows = pose_problem(log, JointParams()).rows

    way = rows.odometry.final[rows.robot] - rows.stance
    walk_sd = np.sqrt(rows.odometry.walked.sum(axis=1))
    assert walk_sd.max() > 1.2
    assert walk_sd[rows.stance].max() <= 1.0
    assert {*range(150)} <= {*way.tolist()}
    noiseless = replace(log, noise=SensingNoise(tilt_deg=0.0, yaw_deg=0.0))
    rows = pose_problem(noiseless, JointParams()).rows
    assert (rows.odometry.final[rows.robot] - rows.stance).max() == 600


@pytest.mark.parametrize("seed", [1, 4])
def test_walks_of_hundreds_of_flips_meet_their_noise(seed):
    """Rows of all stances led 1 R away, to a minimum that no noise explains."""
    settings = TowerParams(
        goal_height=500.0,
        force_threshold=400.0,
        climb=ClimbParams(patience=1000),
        mechanics=MechanicsParams(model="rigid"),
    )
    history = grown(settings, robots=12, seed=seed)
    log = observe(history, NOISY)
    assert np.diff(log.stances.start).max() > 600
    rows = pose_problem(log, JointParams()).rows
    cost = WholeCost(log, rows).held(np.full(12, 2.0))

    state, linear = cost.refine(cost.at(history.position, np.zeros(12)))

    freedom = linear.freedom()
    assert abs(linear.chi_square - freedom) < 5.0 * np.sqrt(2.0 * freedom)
    assert np.linalg.norm(state.position - history.position, axis=1).max() < 0.5


@pytest.mark.trial
def test_walks_of_fifty_flips_are_localized():
    """Turns that begin at zero led one walk to a wrong minimum, and the log looked wrong."""
    settings = TowerParams(
        goal_height=500.0,
        force_threshold=60.0,
        climb=ClimbParams(patience=64),
        mechanics=MechanicsParams(model="rigid"),
        movers=3,
        solve_every=6,
    )
    history = grown(settings, robots=300, seed=1)

    estimate = localize(observe(history, NOISY), JointParams(chains=1))

    assert estimate.convergence.trusted
    away = estimate.position - estimate.position[0] - (history.position - history.position[0])
    assert np.sqrt((away**2).sum(axis=1).mean()) < 0.15
