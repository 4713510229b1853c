"""Recordings with everyday noise give the stances, and the geometry, of the robots."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.recordings import (
    RADIUS_MM,
    RHO,
    Camera,
    Walks,
    counted_stances,
    grown,
    imported,
    median_error,
    orientation_errors,
    recorded,
)
from tiswarm.base.robot import RobotGeometry
from tiswarm.formats import imports
from tiswarm.formats.geometry import fit_scale
from tiswarm.formats.poses import TOLERANCE
from tiswarm.localization.methods import localize
from tiswarm.localization.settings import JointParams

OFFSET_MM = RHO * RADIUS_MM
BODY = RADIUS_MM * RobotGeometry(rho=RHO).dock_offset_body


@pytest.fixture(scope="module")
def walks():
    """Walks of five robots of a tower, with small flips and ways back."""
    return grown(5, 11)


@pytest.fixture(scope="module")
def recording(walks):
    """Their recording at 30 Hz, 0.3 mm and 0.2 deg, of which 2 % are lost."""
    return recorded(walks, Camera(), 0)


@pytest.fixture(scope="module")
def result(recording, tmp_path_factory):
    """What the import makes of it, without knowing the robot."""
    return imported(recording, tmp_path_factory.mktemp("recording"))


def test_stances_come_back_from_noise(walks, result):
    """At least 98 % of them are there, and at most 2 % are invented."""
    count = counted_stances(walks, result.log)

    assert count.true == 71
    assert count.found >= 0.98 * count.true
    assert count.invented <= 0.02 * count.true


def test_errors_are_near_those_with_the_true_geometry(walks, result, recording, tmp_path):
    """A dock offset that flips state costs joint less than half of its median error more."""
    exact = imported(recording, tmp_path, dock_offset_body=BODY)

    assert median_error(walks, result) < 1.5 * median_error(walks, exact)


def test_limits_of_contacts_are_those_of_means_at_rest(walks, result):
    """No dock that truly passes another one farther off than means of poses vary is a contact."""
    log = result.log
    turn = Rotation.from_quat(walks.orientation_wxyz, scalar_first=True)
    docks = walks.center[:, None] + np.stack([turn.apply(arm) for arm in BODY], axis=1)
    is_last = np.append(np.diff(walks.robot) > 0, True)
    stance, dock, robot, robot_dock = log.stances.contacts.T

    # All stances came back, and robots joined in the order of their names.
    touching = docks[~is_last][stance, dock]
    touched = docks[is_last][robot, robot_dock]
    gap = np.linalg.norm(touching - touched, axis=1) - 2.0 * RADIUS_MM
    assert len(gap) > 80
    # A dock varies by 0.35 mm, in the mean of 20 poses by 0.08 mm.
    assert gap.max() < TOLERANCE * RADIUS_MM + 3.0 * 0.08


def test_a_note_has_the_noise_of_the_recording(result):
    """Scatter within rests is measured, to some percent."""
    (note,) = [note for note in result.notes if note.startswith("orientations vary by")]

    tilt, yaw = map(float, re.findall(r"(\S+) deg of", note)[:2])
    assert tilt == pytest.approx(0.2, rel=0.1)
    assert yaw == pytest.approx(0.2, rel=0.1)


@pytest.mark.parametrize(
    "camera",
    [Camera(), Camera(bias_deg=0.1), Camera(bias_mm=0.1, bias_deg=0.07)],
    ids=["independent", "biased orientations", "both biased"],
)
def test_the_log_states_the_noise_of_poses_at_rest(walks, tmp_path, camera):
    """It is that of means of many samples, with what lasts over a rest."""
    log = imported(recorded(walks, camera, 0), tmp_path).log

    error = orientation_errors(walks, log)
    # 76 poses state an sd to 8 % or, about three axes, to 5 %; components of bias to some 20 %.
    stated = [log.noise.tilt_deg, log.noise.tilt_deg, log.noise.yaw_deg]
    assert len(error) == 76
    assert 0.7 < np.sqrt(np.mean((error / stated) ** 2)) < 1.4


def test_a_wrong_dock_offset_does_not_count_as_noise(result, recording, tmp_path):
    """It is stated as if the offset were right, and joint names the right one."""
    wrong = imported(recording, tmp_path, dock_offset_body=(1.0 + 0.35 / OFFSET_MM) * BODY)

    estimate = localize(wrong.log, JointParams())

    assert wrong.log.noise.tilt_deg == pytest.approx(result.log.noise.tilt_deg, rel=0.1)
    assert estimate.convergence.consistent is False
    (cause,) = [one for one in estimate.common_causes if one.parameter == "dock offset"]
    assert abs(cause.value - OFFSET_MM) < 4.0 * cause.sd


def test_flips_state_the_dock_offset_with_an_error_bar(result):
    """It is off by less than 0.05 mm, and the note says by how much it may be."""
    (note,) = [note for note in result.notes if note.startswith("dock offset")]
    value, sd = map(float, re.match(r"dock offset (\S+) \+- (\S+) mm, by \d+ flips", note).groups())

    assert abs(value - OFFSET_MM) < 0.05
    assert abs(value - OFFSET_MM) < 4.0 * sd
    assert result.warnings == []


def test_error_bars_of_the_dock_offset_cover_its_errors(walks, tmp_path):
    """Over seeds of noise, errors are about as large as stated."""
    errors = []

    for seed in range(12):
        few = recorded(first_robots(walks, 2), Camera(rest_s=0.5, flip_s=1.0, rate_hz=20.0), seed)
        notes = imported(few, tmp_path).notes
        match = next(filter(None, (re.match(r"dock offset (\S+) \+- (\S+)", n) for n in notes)))
        value, sd = map(float, match.groups())
        errors.append((value - OFFSET_MM) / sd)

    # Chi-square of 12 degrees of freedom: between these with a probability of 99.8 %.
    assert 2.2 < np.square(errors).sum() < 33.0


def first_robots(walks, count):
    """Choose the walks of the first robots."""
    return Walks(*(column[walks.robot < count] for column in walks))


def test_a_wrong_dock_offset_is_named_with_the_right_one(recording, tmp_path):
    """Flips contradict what the user states."""
    warnings = imported(recording, tmp_path, dock_offset_body=0.99 * BODY).warnings

    (warning,) = [text for text in warnings if "from the center as stated" in text]
    said = float(re.search(r"flips say (\S+) \+-", warning)[1])
    assert said == pytest.approx(OFFSET_MM, abs=0.05)


def test_a_wrong_dock_radius_is_named_with_the_right_one(recording, tmp_path):
    """Flips state the offset without the radius, and contacts state the radius then."""
    warnings = imported(recording, tmp_path, dock_radius=RADIUS_MM - 0.6).warnings

    (warning,) = [text for text in warnings if "have a radius of" in text]
    said = float(re.search(r"contacts? say (\S+) \+-", warning)[1])
    assert said == pytest.approx(RADIUS_MM, abs=0.1)


def test_ground_at_another_height_is_measured(recording, tmp_path):
    """Docks that stand say where the ground is."""
    lifted = recording.assign(z_mm=recording["z_mm"] + 0.5)

    warnings = imported(lifted, tmp_path).warnings

    (warning,) = [text for text in warnings if "correct --ground-z" in text]
    assert float(re.search(r"z = (\S+) \+-", warning)[1]) == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize(("share", "is_noted"), [(0.9, False), (1.1, True)])
def test_an_offset_that_is_too_uncertain_asks_for_more_flips(
    walks, tmp_path, monkeypatch, share, is_noted
):
    """Two standard deviations of it are to be within the largest gap of a contact."""
    few = recorded(first_robots(walks, 1), Camera(rest_s=0.5, flip_s=1.0), 0)
    limit = share * TOLERANCE * RADIUS_MM / 2.0

    def uncertain(*args):
        scale = fit_scale(*args)
        distance = float(np.linalg.norm(args[0].dock_offset_body, axis=1).mean())
        return scale._replace(factor=scale.factor._replace(sd=limit / distance))

    monkeypatch.setattr(imports, "fit_scale", uncertain)

    notes = imported(few, tmp_path).notes

    (note,) = [note for note in notes if note.startswith("dock offset")]
    assert ("record more flips" in note) is is_noted


def tilted(recording, deg):
    """Turn all poses of a recording about a horizontal axis."""
    turn = Rotation.from_rotvec([np.radians(deg), 0.0, 0.0])
    place = ["x_mm", "y_mm", "z_mm"]
    wxyz = ["qw", "qx", "qy", "qz"]
    orientation = Rotation.from_quat(recording[wxyz].to_numpy(), scalar_first=True)
    turned = recording.copy()
    turned[place] = turn.apply(recording[place].to_numpy())
    turned[wxyz] = (turn * orientation).as_quat(scalar_first=True)
    return turned


def test_a_tilted_vertical_is_measured(recording, tmp_path):
    """Docks that stand say by how many degrees the vertical of the recording is off."""
    warnings = imported(tilted(recording, 1.0), tmp_path).warnings

    (warning,) = [text for text in warnings if "tilted by" in text]
    value, sd = map(float, re.search(r"tilted by (\S+) \+- (\S+) deg", warning).groups())
    assert abs(value - 1.0) < 4.0 * sd
    assert sd < 0.1


def test_ground_that_is_level_is_not_called_tilted(recording, tmp_path):
    """A twentieth of a degree is within the noise of the docks that stand."""
    warnings = imported(tilted(recording, 0.05), tmp_path).warnings

    assert not [text for text in warnings if "tilted by" in text]


@pytest.mark.parametrize("samples", [1, 2, 5])
def test_exact_poses_state_no_noise(walks, tmp_path, samples):
    """Scatter between stances is motion, however many samples a rest has."""
    rows = np.repeat(np.arange(len(walks.robot)), samples)
    wxyz = walks.orientation_wxyz[rows]
    table = pd.DataFrame(
        np.column_stack([walks.center[rows], wxyz]),
        columns=["x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"],
    ).assign(robot=walks.robot[rows], time=np.arange(len(rows)))

    exact = imported(table, tmp_path)

    assert exact.log.noise is None
    assert counted_stances(walks, exact.log) == (71, 71, 0)
