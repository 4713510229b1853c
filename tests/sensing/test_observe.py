"""The log of a structure: its fields, its noise, and agreement with the true history."""

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from tests.structures import NOISY
from tiswarm.records.sensing_log import SensingLog, SensingNoise
from tiswarm.sensing import SensingParams, observe


def test_a_log_holds_only_what_robots_sense():
    """Adding a field to the log needs a deliberate edit here."""
    allowed = {
        "robot_id", "dock_radius", "dock_offset_body", "anchor_position", "orientation_wxyz",
        "contacts", "ground_z", "ground_form", "ground_docks", "flip_height", "spawn_position",
        "stances",
        "noise", "length_unit", "fixes", "ranges", "directions", "connections", "touches",
        "displacements",
        "orientation_sd",  # follows from connections
        "source_name", "source_sd",
        "gone", "left_after",  # who said that it left, and when
        "line",  # where the file says so, for messages
    }  # fmt: skip

    assert {field.name for field in dataclasses.fields(SensingLog)} == allowed


def test_noiseless_flips_imply_the_true_height(towers):
    """Without noise the flips imply the true height, up to rounding."""
    for history in towers:
        log = observe(history, SensingParams())

        np.testing.assert_allclose(log.flip_height, history.position[:, 2], atol=1e-11)
        np.testing.assert_array_equal(log.orientation_wxyz, history.orientation_wxyz)


def test_a_robot_may_start_in_any_stance_on_the_ground(towers):
    """Docks on the ground at first give the height, whether the robot lies flat or stands."""
    history = towers[0]
    starts = [max(walk.ground_docks[:, 0], default=0) for walk in history.walks]
    cut = dataclasses.replace(history, walks=tuple(map(_begun_later, history.walks, starts)))
    turn = Rotation.from_quat([w.orientation_wxyz[0] for w in cut.walks], scalar_first=True)
    assert (turn.apply([0, 0, 1])[:, 2] < 0.9).any()  # some do not lie flat

    log = observe(cut, SensingParams())

    np.testing.assert_allclose(log.flip_height, history.position[:, 2], atol=1e-11)


def _begun_later(walk, stance):
    """The walk from a stance on."""

    def later(rows):
        return rows[rows[:, 0] >= stance] - np.eye(1, rows.shape[1], dtype=np.int32) * stance

    return dataclasses.replace(
        walk,
        center=walk.center[stance:],
        orientation_wxyz=walk.orientation_wxyz[stance:],
        pivot_dock=walk.pivot_dock[stance:],
        contacts=later(walk.contacts),
        ground_docks=later(walk.ground_docks),
        edge_docks=later(walk.edge_docks),
    )


def test_the_flip_history_leads_from_the_spawn_to_the_final_place(towers):
    """Odometry along the stances and pivots ends at the true position."""
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
    """Tilt and yaw noise have the standard deviations of the settings."""
    turns = []
    for history in towers:
        perfect = observe(history, SensingParams()).stances.orientation_wxyz
        sensed = observe(history, NOISY).stances.orientation_wxyz
        turns.append(_turn(sensed, perfect))
    spread = np.concatenate(turns).std(axis=0)

    # Some 1,500 stances: five standard errors of a standard deviation are 10 %.
    np.testing.assert_allclose(spread, [1.0, 1.0, 2.0], rtol=0.1)


def test_noise_depends_on_the_seed_alone(towers):
    """The same seed gives the same log; another seed gives other noise."""
    first, again = observe(towers[0], NOISY), observe(towers[0], NOISY)
    other = observe(dataclasses.replace(towers[0], seed=99), NOISY)

    np.testing.assert_array_equal(first.orientation_wxyz, again.orientation_wxyz)
    assert (first.orientation_wxyz != other.orientation_wxyz).any(axis=1).all()


def test_a_yaw_bias_stays_with_its_robot(towers):
    """A bias turns all stances of a robot equally; its spread is that of the settings."""
    params = SensingParams(yaw_bias_deg=10.0)
    biases = []
    for seed in range(20):
        history = dataclasses.replace(towers[0], seed=seed)
        log, perfect = observe(history, params), observe(history, SensingParams())
        at_rest = _turn(log.orientation_wxyz, perfect.orientation_wxyz)
        walking = _turn(log.stances.orientation_wxyz, perfect.stances.orientation_wxyz)

        owner = np.repeat(np.arange(log.robot_count), np.diff(log.stances.start))
        np.testing.assert_allclose(walking, at_rest[owner], atol=1e-9)
        np.testing.assert_allclose(at_rest[:, :2], 0.0, atol=1e-9)
        biases.append(at_rest[:, 2])

    # 600 robots: five standard errors are 15 %.
    np.testing.assert_allclose(np.std(biases), 10.0, rtol=0.15)


def _turn(sensed, true):
    """Turn from one orientation to another [deg], shape (rows, 3)."""
    turn = Rotation.from_quat(sensed, scalar_first=True)
    return np.degrees((turn * Rotation.from_quat(true, scalar_first=True).inv()).as_rotvec())


def test_robots_sense_their_spawn_only_if_set(towers):
    """By default the log has no spawns; otherwise their noise is that of the settings."""
    history = towers[0]
    start = np.array([walk.center[0] for walk in history.walks])

    silent, exact, vague = (
        observe(history, SensingParams(spawn_noise=noise)) for noise in (None, 0.0, 0.5)
    )

    assert np.isnan(silent.spawn_position).all()
    np.testing.assert_array_equal(exact.spawn_position, start)
    # 90 coordinates: five standard errors are 37 %.
    np.testing.assert_allclose((vague.spawn_position - start).std(), 0.5, rtol=0.37)
    assert [log.noise.spawn for log in (silent, exact, vague)] == [None, 0.0, 0.5]


def _sensed(history, **noise):
    """Return all contacts of a log as (robot, stance, own dock, other robot, other dock)."""
    log = observe(history, SensingParams(**noise))
    start = log.stances.start
    robot = np.searchsorted(start, log.stances.contacts[:, 0], side="right") - 1
    rows = {(int(j), *map(int, row)) for j, row in zip(robot, log.stances.contacts, strict=True)}
    rest = {(j, int(start[j + 1]), own, i, dock) for i, dock, j, own in log.contacts.tolist()}
    assert len(rows) == len(log.stances.contacts)
    assert len(rest) == len(log.contacts)
    return rows | rest


def test_shares_of_wrong_contacts_match_the_settings(towers):
    """The shares of missed, wrong and false contacts are those of the settings."""
    missed = wrong = false = total = 0
    for seed in range(5):
        history = dataclasses.replace(towers[2], seed=seed)
        true = _sensed(history)
        fewer = _sensed(history, missed_contacts=0.1)
        assert _sensed(history, missed_contacts=0.2) < fewer < true
        total += len(true)
        missed += len(true - fewer)

        mistaken = _sensed(history, wrong_docks=0.1)
        assert {row[:4] for row in mistaken} == {row[:4] for row in true}
        wrong += len(true - mistaken)

        more = _sensed(history, false_contacts=0.1)
        assert true < more
        assert all(other < robot for robot, _, _, other, _ in more)
        false += len(more - true)

    # Some 5,000 contacts: five standard errors of a tenth are 0.021.
    np.testing.assert_allclose([missed, wrong, false], 0.1 * total, atol=0.021 * total)
    assert _sensed(history, missed_contacts=1.0) == set()


def test_one_noise_does_not_change_another(towers):
    """Each kind of noise has its own random numbers, and the header states them all."""
    everything = {
        "yaw_bias_deg": 3.0,
        "spawn_noise": 0.1,
        "missed_contacts": 0.1,
        "wrong_docks": 0.02,
        "false_contacts": 0.01,
    }
    alone, together = observe(towers[0], NOISY), observe(towers[0], SensingParams(**everything))
    both = observe(towers[0], dataclasses.replace(NOISY, **everything))

    np.testing.assert_array_equal(both.contacts, together.contacts)
    np.testing.assert_array_equal(both.spawn_position, together.spawn_position)
    np.testing.assert_allclose(
        _turn(both.orientation_wxyz, alone.orientation_wxyz),
        _turn(together.orientation_wxyz, towers[0].orientation_wxyz),
        atol=1e-9,
    )
    assert both.noise == SensingNoise(
        tilt_deg=1.0,
        yaw_deg=2.0,
        yaw_bias_deg=3.0,
        spawn=0.1,
        missed_contacts=0.1,
        wrong_docks=0.02,
        false_contacts=0.01,
    )


def test_stances_sense_the_contacts_of_the_walk(towers):
    """The flip history has the contacts of every stance except the last."""
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
