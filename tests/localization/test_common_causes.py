"""One parameter that is stated wrongly for all robots is named before any robot is."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.estimates.lies import COMMON, drifting_robot, with_ranges
from tests.structures import grown
from tiswarm.localization.methods import localize
from tiswarm.localization.mixture import common_causes
from tiswarm.localization.peers.settings import LeastSquaresParams
from tiswarm.localization.settings import JointParams
from tiswarm.measurements.verdicts import describe_outliers, distrust
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.params import TowerParams

pytestmark = pytest.mark.unchecked

SURELY = 4.0
"""Standard deviations within which a value is right."""

PRECISE = SensingParams(tilt_noise_deg=0.2, yaw_noise_deg=0.2)
"""Orientations as motion capture knows them."""

MM = 32.9
"""Radius of docks of a log in mm."""

METHODS = {"joint": JointParams(), "least-squares": LeastSquaresParams()}

QUICK = [("dock offset", "joint"), ("turn of all docks in the body frame", "least-squares")]
"""Parameters and methods of each test run; the others are slow."""

PAIRS = [
    pytest.param(name, method, marks=[] if (name, method) in QUICK else pytest.mark.slow)
    for name in COMMON
    for method in METHODS
]


def rng():
    """Start the random numbers of an error."""
    return np.random.default_rng(3)


@pytest.fixture(scope="module")
def tower():
    """A tower of 14 robots, with the log of what they sensed."""
    history = grown(TowerParams(), robots=14, seed=2003)
    return history.position, observe(history, PRECISE)


@pytest.fixture(scope="module")
def log(tower):
    """The log, with ranges."""
    truth, log = tower
    return with_ranges(log, truth, rng())


@pytest.mark.parametrize(("name", "method"), PAIRS)
def test_a_parameter_that_is_off_for_all_robots_is_named_with_its_value(log, name, method):
    """Its right value is within its uncertainty, and no robot is named."""
    parameter = COMMON[name]
    wrong = parameter.stated(log, parameter.large, rng())

    estimate = localize(wrong, METHODS[method])

    cause = estimate.common_causes[0]
    text = distrust(wrong, estimate)
    assert cause.parameter == name
    assert abs(cause.value - parameter.value(wrong, parameter.large)) <= SURELY * cause.sd
    assert estimate.convergence.consistent is False
    assert f"{cause} would explain all measurements" in text
    assert "carried by" not in text
    assert estimate.outlier_robots is None
    assert not [*describe_outliers(wrong, "log", estimate)]


def test_a_right_log_has_no_cause(log, monkeypatch):
    """Nothing is searched for where nothing speaks against the estimate."""
    searched = []
    monkeypatch.setattr(common_causes, "_causes", lambda *_: searched.append(1) or ())

    estimate = localize(log, JointParams())

    assert estimate.convergence.trusted
    assert estimate.common_causes == ()
    assert not searched


def test_one_robot_that_drifts_is_no_common_cause(tower):
    """What is wrong in one robot is not explained by what all share: the robot is named."""
    truth, log = tower
    drifted = drifting_robot(log, truth, rng())
    robot = int(np.diff(log.stances.start).argmax())

    estimate = localize(drifted, JointParams())

    assert estimate.common_causes == ()
    assert not estimate.convergence.trusted
    assert robot in (estimate.outlier_robots if estimate.outlier_robots is not None else [])


def test_values_have_the_unit_of_the_log_and_heights_its_origin(tower):
    """A log in mm, whose anchor is a metre above the origin, gets the same cause in mm."""
    _, log = tower
    up = np.array([0.0, 0.0, 1000.0])
    in_mm = replace(
        log,
        dock_radius=MM,
        dock_offset_body=MM * log.dock_offset_body,
        anchor_position=MM * log.anchor_position + up,
        flip_height=MM * log.flip_height + up[2],
        ground_z=MM * log.ground_z + up[2] + 0.5 * MM,
        length_unit="mm",
    )

    estimate = localize(in_mm, JointParams())

    cause = estimate.common_causes[0]
    assert cause.parameter == "ground height"
    assert cause.unit == "mm"
    assert cause.stated == pytest.approx(1000.0 + 0.5 * MM)
    assert abs(cause.value - 1000.0) <= SURELY * cause.sd
    assert 0.0 < cause.sd < 1.0
    assert "--ground-z" in distrust(in_mm, estimate)


def test_parameters_that_fit_as_well_are_named_beside_it(tower):
    """Contacts alone measure the dock offset in units of the radius: either may be wrong."""
    _, log = tower
    stances = replace(log.stances, ground_docks=log.stances.ground_docks[:0])
    wrong = replace(
        log,
        dock_offset_body=1.05 * log.dock_offset_body,
        flip_height=np.full_like(log.flip_height, np.nan),
        ground_docks=log.ground_docks[:0],
        ground_z=None,
        stances=stances,
    )

    estimate = localize(wrong, LeastSquaresParams())

    names = [cause.parameter for cause in estimate.common_causes]
    assert {"dock offset", "dock radius"} <= set(names)
    assert "and so would a" in distrust(wrong, estimate)
