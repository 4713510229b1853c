"""Robots sense what is there, and nothing that would give their place away."""

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import SensingParams, observe

NOISY = SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0)


def test_a_log_holds_only_what_robots_sense():
    """Adding a field to the log needs a deliberate edit here."""
    allowed = {
        "robot_id", "dock_radius", "dock_offset_body", "anchor_position", "orientation_wxyz",
        "contacts", "ground_z", "ground_docks", "flip_height", "spawn_position", "stances",
        "noise", "length_unit",
    }  # fmt: skip

    assert {field.name for field in dataclasses.fields(SensingLog)} == allowed


def test_flips_give_the_true_height_to_perfect_senses(towers):
    """Without noise the height implied by the flips is the true one, to rounding."""
    for history in towers:
        log = observe(history, SensingParams())

        np.testing.assert_allclose(log.flip_height, history.position[:, 2], atol=1e-11)
        np.testing.assert_array_equal(log.orientation_wxyz, history.orientation_wxyz)


def test_the_flip_history_leads_from_the_spawn_to_the_final_place(towers):
    """Walking a robot's stances by its pivots alone ends where the robot really is."""
    history = towers[0]
    log = observe(history, SensingParams())

    for j, walk in enumerate(history.walks):
        rows = slice(log.stances.start[j], log.stances.start[j + 1])
        poses = [*log.stances.orientation_wxyz[rows], log.orientation_wxyz[j]]
        turn = Rotation.from_quat(poses, scalar_first=True)
        here = walk.center[0]
        for step, k in enumerate(log.stances.pivot_dock[rows]):
            body = log.dock_offset_body[k]
            here = here + turn[step].apply(body) - turn[step + 1].apply(body)
        np.testing.assert_allclose(here, history.position[j], atol=1e-11)


def test_noise_has_the_stated_size(towers):
    """Tilt about each horizontal axis and yaw are as wide as asked, in every stance."""
    turns = []
    for history in towers:
        perfect = observe(history, SensingParams()).stances.orientation_wxyz
        sensed = observe(history, NOISY).stances.orientation_wxyz
        difference = (
            Rotation.from_quat(sensed, scalar_first=True)
            * Rotation.from_quat(perfect, scalar_first=True).inv()
        )
        turns.append(np.degrees(difference.as_rotvec()))
    spread = np.concatenate(turns).std(axis=0)

    # Some 1,500 stances: five standard errors of a standard deviation are 10 %.
    np.testing.assert_allclose(spread, [1.0, 1.0, 2.0], rtol=0.1)


def test_noise_depends_on_the_seed_alone(towers):
    """Sensing twice gives the same log; another seed's noise is another."""
    first, again = observe(towers[0], NOISY), observe(towers[0], NOISY)
    other = observe(dataclasses.replace(towers[0], seed=99), NOISY)

    np.testing.assert_array_equal(first.orientation_wxyz, again.orientation_wxyz)
    assert (first.orientation_wxyz != other.orientation_wxyz).any(axis=1).all()


def test_stances_feel_what_the_walk_felt(towers):
    """Contacts of every stance but the last are in the flip history, the last's in contacts."""
    history = towers[1]
    log = observe(history, SensingParams())

    for j, walk in enumerate(history.walks):
        first, last = log.stances.start[j], log.stances.start[j + 1]
        rows = log.stances.contacts[
            (log.stances.contacts[:, 0] >= first) & (log.stances.contacts[:, 0] < last)
        ]
        expected = walk.contacts[walk.contacts[:, 0] < walk.stance_count - 1]
        np.testing.assert_array_equal(rows - [first, 0, 0, 0], expected)
    assert len(log.contacts) == sum(
        (w.contacts[:, 0] == w.stance_count - 1).sum() for w in history.walks
    )
