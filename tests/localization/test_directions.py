"""Measured directions of contacts place robots, in every method that uses them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.localization.test_problem import true_yaw
from tests.structures import NOISY, with_directions
from tiswarm.localization.methods import localize, localize_many
from tiswarm.localization.peers.settings import HopByHopParams, LeastSquaresParams
from tiswarm.localization.settings import Cues, JointParams
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import SensingParams, observe

pytestmark = pytest.mark.unchecked

QUICK = JointParams(chains=3, steps=600, hold_steps=200)
METHODS = [QUICK, LeastSquaresParams(cues=Cues(non_overlap=False))]
PEERS = [LeastSquaresParams(), HopByHopParams()]


def directed(history, params=NOISY, **options) -> SensingLog:
    """Sense directions and contacts of final stances, and orientations, but no heights."""
    log = observe(history, params)
    log = replace(log, stances=None, flip_height=np.full(log.robot_count, np.nan))
    log = with_directions(log, history, **{"sd_deg": 1.0, **options})
    return replace(log, noise=replace(log.noise, direction_deg=1.0))


@pytest.mark.parametrize("params", METHODS, ids=lambda p: p.method)
def test_directions_alone_place_robots(towers, params):
    """Errors of 1 deg add up along three contacts or so, each 2 R long, and arms."""
    for history in towers[:2]:
        found = localize(directed(history), params)

        error = np.linalg.norm(found.position - history.position, axis=1)
        assert np.sqrt((error**2).mean()) < 0.2
        assert found.observability.floppy_modes == 0
        assert "directions" in found.observability.cues


def test_directions_are_ignored_where_they_are_switched_off(towers):
    """Then a log has the bytes of an estimate that it would have without them."""
    log = directed(towers[0])
    without = replace(log, directions=log.directions[:0])

    off, none = (
        localize(one, replace(QUICK, cues=Cues(directions=False))) for one in (log, without)
    )

    assert off.position.tobytes() == none.position.tobytes()


def test_logs_without_directions_do_not_notice_others(towers):
    """An estimate is the same beside logs with directions as alone, byte by byte."""
    plain = observe(towers[1], NOISY)
    logs = [directed(towers[0]), plain, directed(towers[2])]

    together = localize_many(logs, [QUICK] * 3)[1]
    alone = localize_many([plain], [QUICK])[0]

    assert together.position.tobytes() == alone.position.tobytes()
    assert together.sd.tobytes() == alone.sd.tobytes()


def test_yaw_is_solved_for_with_directions(towers):
    """Directions turn with their robot, and so measure its yaw where it has two contacts."""
    noise = SensingParams(tilt_noise_deg=0.5, yaw_bias_deg=8.0)
    log = directed(towers[0], noise)
    log = replace(log, flip_height=towers[0].position[:, 2].copy())

    solved = localize(log, QUICK)
    taken = localize(log, replace(QUICK, solve_yaw=False))

    bias = true_yaw(log, towers[0])
    error = [np.linalg.norm(e.position - towers[0].position, axis=1) for e in (solved, taken)]
    assert np.median(error[0]) < 0.7 * np.median(error[1])
    assert np.median(np.abs(solved.yaw - bias)) < 0.7 * np.median(np.abs(bias))


def _most_checked(log):
    """Return the row of a direction whose robot has the most directions."""
    degree = np.bincount(log.directions[:, [0, 2]].astype(int).ravel())
    return int(degree[log.directions[:, 0].astype(int)].argmax())


def test_a_wrong_direction_is_an_outlier(towers):
    """All three rows of it give way, and it is listed once; others hold the robot."""
    log = directed(towers[0])
    row = _most_checked(log)
    robot = int(log.directions[row, 0])
    rows = log.directions.copy()
    rows[row, 4:] *= -1.0

    found = localize(replace(log, directions=rows), replace(QUICK, steps=1500))

    wrong = [robot, 0, *log.directions[row, 1:4].astype(int).tolist()]
    assert wrong in found.outlier_contacts.tolist()
    assert len(found.outlier_contacts) <= 2
    assert np.linalg.norm(found.position - towers[0].position, axis=1).max() < 1.0


@pytest.mark.parametrize("params", PEERS, ids=lambda p: p.method)
@pytest.mark.parametrize("turn_deg", [20, 30, 40])
def test_three_rows_of_a_direction_are_outliers_together(towers, params, turn_deg):
    """Where one component is missed by far, all three give way, and the direction is listed."""
    log = directed(towers[0])
    row = _most_checked(log)
    rows = log.directions.copy()
    across = np.cross(rows[row, 4:], [0.3, 0.5, 0.8])
    turn = np.radians(turn_deg) * across / np.linalg.norm(across)
    rows[row, 4:] = Rotation.from_rotvec(turn).apply(rows[row, 4:])

    estimate = localize(replace(log, directions=rows), params)

    assert np.isfinite(estimate.position).all()
    if estimate.outlier_contacts is not None:
        wrong = [int(rows[row, 0]), 0, *rows[row, 1:4].astype(int).tolist()]
        assert estimate.outlier_contacts.tolist() == [wrong]


def test_the_error_is_as_large_as_sd(towers):
    """Over three towers, mean squared errors are those that `sd` states, to a factor of two."""
    squares = []
    for history in towers:
        found = localize(directed(history), QUICK)
        error = np.linalg.norm(found.position - history.position, axis=1)[1:]
        squares.append(((error / found.sd[1:]) ** 2).mean())

    assert 0.5 < np.mean(squares) < 2.0
