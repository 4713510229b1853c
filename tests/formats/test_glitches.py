"""Errors of tracking become neither final poses nor stances, and the import names them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.formats.test_stances import bring_in, rows_of, sampled
from tiswarm.formats.motion import step_of_noise
from tiswarm.records.sensing_file import log_entries


@pytest.fixture(scope="module")
def tracks(towers):
    """Rows of four robots of a tower, all tracked from their first frame to the last one."""
    few = replace(towers[0], walks=towers[0].walks[:4], loads=towers[0].loads[:4])
    return sampled(few, steps=5, dwell=4, waiting=False)


def rows_of_robot(tracks, robot):
    """Places of a robot's rows, in the order of time."""
    return [place for place, row in enumerate(tracks) if row[0] == robot]


def jumped(row, away, turn):
    """Move and turn the pose of a row."""
    robot, *place = row[:4]
    turned = (turn * Rotation.from_quat(row[4:8], scalar_first=True)).as_quat(scalar_first=True)
    return [robot, *(np.array(place) + away), *turned, *row[8:]]


@pytest.mark.parametrize("frames", [1, 2])
@pytest.mark.parametrize("when", [1, 6, 40, -1], ids=["at rest", "in a flip", "later", "last"])
def test_errors_of_tracking_change_no_log(tracks, tmp_path, when, frames):
    """Whether a marker jumps or the body turns, and wherever: poses before and after remain."""
    places = rows_of_robot(tracks, 3)
    first = len(places) - frames if when == -1 else when
    bad, random = list(tracks), np.random.default_rng(0)
    for place in places[first : first + frames]:
        turn = Rotation.from_rotvec(random.normal(0.0, 0.3, 3))
        bad[place] = jumped(tracks[place], random.normal(0.0, 0.5, 3), turn)

    found = bring_in(tmp_path, bad)

    assert [*log_entries(found.log)] == [*log_entries(bring_in(tmp_path, tracks).log)]
    start = f"{frames} pose{'s' * (frames > 1)} left out, robot 3 at time {bad[places[first]][8]}"
    assert [note.partition(":")[0] for note in found.notes if "left out" in note] == [start]


def test_errors_of_tracking_can_be_kept(tracks, tmp_path):
    """The limit is an option: with 0 the last pose is final, an error of tracking too."""
    last = rows_of_robot(tracks, 3)[-1]
    bad = list(tracks)
    bad[last] = jumped(tracks[last], [0.3, 0.4, 0.0], Rotation.identity())

    kept = bring_in(tmp_path, bad, glitch_frames=0)

    at = kept.log.robot_id.tolist().index(3)
    np.testing.assert_allclose(kept.position[at], bad[last][1:4])


def test_a_long_absence_from_the_track_is_no_error(tracks, tmp_path):
    """Somebody may have carried a robot: what lasts longer than the limit stays."""
    places = rows_of_robot(tracks, 3)[4:16]
    bad = list(tracks)
    for place in places:
        bad[place] = jumped(tracks[place], [3.0, 4.0, 0.0], Rotation.identity())

    notes = bring_in(tmp_path, bad).notes

    assert not any(" left out, robot 3 at time" in note for note in notes)


def test_poses_that_are_noisier_than_the_limits_are_no_errors(tracks, tmp_path):
    """Half of them would be left out; beyond what can be measured, the note says what to do."""
    random = np.random.default_rng(0)
    for sd in (0.03, 0.08):
        noisy = [jumped(row, random.normal(0.0, sd, 3), Rotation.identity()) for row in tracks]

        notes = bring_in(tmp_path, noisy).notes

        assert not any("pose left out" in note or "poses left out" in note for note in notes)
        advice = "noisier than the limits of contacts; give a larger --gap"
        assert any(advice in note for note in notes) == (sd == 0.08)


def test_a_table_of_stances_has_no_errors_of_tracking(tracks, towers, tmp_path):
    """A final pose that no flip explains stays final where rows follow no motion."""
    few = replace(towers[0], walks=towers[0].walks[:4], loads=towers[0].loads[:4])
    rows = [row for row in rows_of(few) for _ in range(2)]
    rows = [[*row[:-1], time] for time, row in enumerate(rows)]
    rows[-1] = jumped(rows[-1], [0.1, 0.1, 0.1], Rotation.identity())

    found = bring_in(tmp_path, rows)

    np.testing.assert_allclose(found.position[-1], rows[-1][1:4])


def test_tracks_that_end_in_motion_are_named(tracks, tmp_path):
    """Their last pose is none at which the robot rests, and no contact there counts."""
    cut = rows_of_robot(tracks, 3)[-6]
    ended = [row for place, row in enumerate(tracks) if row[0] != 3 or place <= cut]

    whole, found = bring_in(tmp_path, tracks), bring_in(tmp_path, ended)

    assert not any("motion" in warning for warning in whole.warnings)
    (warning,) = (each for each in found.warnings if "motion" in each)
    assert warning.startswith("the tracks of 1 robot (3) end in motion, not at final poses; record")


def test_a_last_pose_that_nothing_explains_is_named(tracks, tmp_path):
    """A robot that moved before it leaves no rest to go back to, so a person has to look."""
    end = rows_of_robot(tracks, 3)[-6]
    bad = [row for place, row in enumerate(tracks) if row[0] != 3 or place <= end]
    bad[end] = jumped(tracks[end], [0.3, 0.4, 0.0], Rotation.identity())

    found = bring_in(tmp_path, bad)

    assert any("robot (3) end in motion" in warning for warning in found.warnings)


@pytest.mark.parametrize(("rests", "is_found"), [(24, False), (25, True), (26, True)])
def test_noise_is_what_a_quarter_of_the_samples_show(rests, is_found):
    """Fewer samples that go back and forth may be motions that turn."""
    step = np.ones(101)
    step[: rests + 1] = (-1.0) ** np.arange(-rests, 1)  # turns as often as the robot rests
    docks = np.cumsum([0.0, *step])[:, None, None] * np.ones((1, 1, 3)) / np.sqrt(3.0)

    noise = step_of_noise(docks, np.zeros(102, int), most=2.0)

    assert (noise > 0.0) == is_found


def without(tracks, robot, first, last):
    """Drop some rows of a robot, from one to another of its frames."""
    gone = {*rows_of_robot(tracks, robot)[first : last + 1]}
    return [row for place, row in enumerate(tracks) if place not in gone]


@pytest.mark.parametrize("rest", [1, 2, 3])
def test_a_rest_that_the_cameras_missed_follows_from_the_flips_beside_it(tracks, tmp_path, rest):
    """Robots rest for four frames and flip in five steps; two frames of each flip are left."""
    whole = bring_in(tmp_path, tracks).log.stances

    imported = bring_in(tmp_path, without(tracks, 3, 8 * rest - 2, 8 * rest + 5))

    found = imported.log.stances
    assert "1 stance without a pose: where flips beside a gap lead" in imported.notes
    np.testing.assert_array_equal(found.pivot_dock, whole.pivot_dock)
    np.testing.assert_array_equal(found.contacts, whole.contacts)
    np.testing.assert_array_equal(found.ground_docks, whole.ground_docks)
    turn, true = (
        Rotation.from_quat(each.orientation_wxyz, scalar_first=True) for each in (found, whole)
    )
    assert (turn * true.inv()).magnitude().max() < 1e-4


def test_two_rests_that_the_cameras_missed_cut_the_history(tracks, tmp_path):
    """No flip leads over both, so earlier poses are left out as before, and a note says so."""
    imported = bring_in(tmp_path, without(tracks, 3, 6, 21))

    assert not any("without a pose" in note for note in imported.notes)
    assert any("earlier poses of 1 robot (3) left out" in note for note in imported.notes)
