"""A measured direction makes three rows, which say where the other dock is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial.transform import Rotation

from tests.strategies import rotations, vectors
from tests.structures import NOISY, with_directions
from tiswarm.measurements.contacts import disconnected
from tiswarm.measurements.cues import cue_names, measure
from tiswarm.measurements.model import SPACING, Measurements
from tiswarm.measurements.observability import observability
from tiswarm.measurements.odometry import Odometry
from tiswarm.measurements.rigidity import weld
from tiswarm.records.sensing_log import SensingNoise
from tiswarm.sensing import SensingParams, observe

NOISE = SensingNoise(tilt_deg=1.0, yaw_deg=2.0, direction_deg=3.0)


@pytest.fixture(scope="module")
def log(towers):
    """What the robots of a small tower sensed, true directions of all stances included."""
    exact = observe(towers[0], SensingParams(spawn_noise=0.0))
    return replace(with_directions(exact, towers[0], sd_deg=0.0), noise=NOISE)


@pytest.fixture(scope="module")
def rows(log):
    """Make the rows of all cues."""
    return measure(log, cue_names())


def test_the_true_positions_have_no_residual(towers, rows):
    """Across a contact the residual is 0; along it docks may be 0.02 R farther apart than D."""
    residual = rows.residual(towers[0].position)

    offsets = residual[len(rows.distances.stance) : len(rows.neighbor)].reshape(-1, 3)
    np.testing.assert_allclose(offsets[:, 1:], 0.0, atol=1e-9)
    np.testing.assert_allclose(offsets[:, 0], 0.0, atol=0.021)
    assert len(offsets) > 100


@pytest.mark.parametrize("yaw_sd", [0.0, 0.5])
def test_derivatives_are_those_of_the_residuals(rows, yaw_sd):
    """Central differences agree at any positions, and at any yaws."""
    rng = np.random.default_rng(0)
    position, yaw = rng.normal(size=(30, 3)), yaw_sd * rng.normal(size=30)
    step, turn = rng.normal(size=(30, 3)), rng.normal(size=30)

    ahead = rows.residual(position + 1e-6 * step, yaw + 1e-6 * turn)
    behind = rows.residual(position - 1e-6 * step, yaw - 1e-6 * turn)

    slope = rows.jacobian(position, yaw) @ np.concatenate([step.ravel(), turn])
    np.testing.assert_allclose(slope, (ahead - behind) / 2e-6, atol=1e-6)


@settings(max_examples=20)
@given(wxyz=rotations, shift=vectors)
def test_a_swarm_seen_from_elsewhere_has_the_same_residuals(log, wxyz, shift):
    """Directions are in the body frame: a rigid motion of the world changes no residual."""
    motion = Rotation.from_quat(wxyz, scalar_first=True)

    def moved(quaternions):
        turned = motion * Rotation.from_quat(quaternions, scalar_first=True)
        return turned.as_quat(scalar_first=True)

    stances = replace(log.stances, orientation_wxyz=moved(log.stances.orientation_wxyz))
    elsewhere = replace(log, orientation_wxyz=moved(log.orientation_wxyz), stances=stances)
    position = np.random.default_rng(0).normal(size=(30, 3))

    here = measure(log, ["directions"]).vectors(position)
    there = measure(elsewhere, ["directions"]).vectors(motion.apply(position) + shift)

    np.testing.assert_allclose(there, motion.apply(here), atol=1e-9)


@settings(max_examples=20)
@given(wxyz=rotations)
def test_a_turn_of_all_robots_about_the_vertical_changes_no_residual(rows, wxyz):
    """Axes along which offsets are measured turn with their robot."""
    angle = float(np.arctan2(wxyz[1], wxyz[0]))
    offset = slice(len(rows.distances.stance), len(rows.neighbor))
    position = np.random.default_rng(0).normal(size=(30, 3))

    turned = Rotation.from_rotvec([0.0, 0.0, angle]).apply(position)

    np.testing.assert_allclose(
        rows.residual(turned, np.full(30, angle))[offset],
        rows.residual(position)[offset],
        atol=1e-9,
    )


def test_variance_is_that_of_noisy_logs(towers, log):
    """Over logs with noise of orientations and directions, squared residuals average to it."""
    squares = []
    for seed in range(40):
        history = replace(towers[0], seed=seed)
        noisy = observe(history, NOISY)
        exact = measure(replace(log, orientation_wxyz=noisy.orientation_wxyz,
                                stances=replace(log.stances,
                                                orientation_wxyz=noisy.stances.orientation_wxyz)),
                        ["directions"])  # fmt: skip
        squares.append(exact.residual(history.position) ** 2)
    rows = measure(log, ["directions"])
    expected = rows.variance() - rows.own_variance

    ratio = np.mean(squares, axis=0).reshape(-1, 3).sum(axis=0) / expected.reshape(-1, 3).sum(
        axis=0
    )

    # 40 draws of some 60 stances; the gap of docks adds to the first.
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)


def test_noise_of_directions_is_across(log):
    """Along a contact docks are D apart as ever; across it the stated noise counts, times D."""
    own = measure(log, ["directions"]).own_variance.reshape(-1, 3)
    unstated = measure(replace(log, noise=None), ["directions"]).own_variance.reshape(-1, 3)

    np.testing.assert_allclose(np.sqrt(own[:, 0]), 0.006)
    np.testing.assert_allclose(np.sqrt(own[:, 1:]), SPACING * np.radians(3.0), rtol=0.01)
    np.testing.assert_allclose(np.sqrt(unstated[:, 1:]), SPACING * np.radians(1.0), rtol=0.02)


def test_a_contact_counts_once(log, rows):
    """Rows of a direction replace the distance of the contact, at each stance."""
    without = measure(replace(log, directions=log.directions[:0]), cue_names())
    alone = measure(log, ["directions"])
    contacts = measure(replace(log, directions=log.directions[:0], stances=replace(
        log.stances, directions=log.stances.directions[:0])), cue_names())  # fmt: skip

    assert not len(rows.distances.stance)
    assert np.array_equal(alone.sensed_contacts, rows.sensed_contacts)
    assert np.array_equal(rows.sensed_contacts[::3], contacts.sensed_contacts)
    assert 0 < len(without.distances.stance) < len(contacts.neighbor)
    # A contact whose direction was measured only at the stance before counts there.
    assert len(np.unique(without.sensed_contacts, axis=0)) == len(contacts.neighbor)


def test_directions_need_no_contacts(log):
    """A direction says that docks touch, whether or not the contact is listed."""
    silent = replace(
        log,
        contacts=log.contacts[:0],
        stances=replace(log.stances, contacts=log.stances.contacts[:0]),
    )

    np.testing.assert_array_equal(
        measure(silent, cue_names()).sensed_contacts, measure(log, cue_names()).sensed_contacts
    )


def test_rows_are_selected_and_gathered_alike(log, rows):
    """A selection has the residuals of its rows, and can be gathered again."""
    chosen = rows.any_of_vector(np.random.default_rng(0).random(len(rows)) < 0.2)
    position = np.random.default_rng(1).normal(size=(30, 3))

    some = rows.select(chosen)
    again = Measurements.gather(Odometry(log), [some.distances], [some.places], [some.offsets])

    for part in (some, again):
        np.testing.assert_array_equal(part.residual(position), rows.residual(position)[chosen])
        np.testing.assert_array_equal(part.variance(), rows.variance()[chosen])
        assert len(part) == chosen.sum()


def test_a_vector_is_chosen_whole(rows):
    """Its three rows are flagged together; a choice of one or two of them is refused."""
    vector = len(rows.distances.stance) + 3
    flag = np.zeros(len(rows), np.bool_)
    flag[[vector + 1, -1]] = True

    flagged = np.flatnonzero(rows.any_of_vector(flag))

    assert flagged.tolist() == [vector, vector + 1, vector + 2, len(rows) - 1]
    with pytest.raises(ValueError, match="one measurement"):
        rows.select(flag)


@pytest.mark.parametrize("turning", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_floppy_modes_are_the_null_space(towers, log, share, turning):
    """Some directions remove some modes, all of them all; where yaws are unknown, robots swing."""
    chosen = np.random.default_rng(0).random(len(log.directions)) < share
    some = replace(log, directions=log.directions[chosen], stances=None)
    rows = measure(some, ["contacts", "directions"])
    matrix = rows.jacobian(towers[0].position).toarray()
    free = np.delete(matrix, [0, 1, 2], axis=1)[:, : 87 + 30 * turning]

    null = free.shape[1] - np.linalg.matrix_rank(free, tol=1e-5)

    bodies = weld(rows, towers[0].position, yaw_unknown=turning)
    assert bodies.floppy_modes == null - bodies.has_gauge_yaw
    assert (null == 0) == (share == 1.0 and not turning)


def test_directions_constrain_whom_they_reach(log):
    """Robots that neither contacts nor directions reach stay disconnected; others are known."""
    final = replace(log, contacts=log.contacts[:0], stances=None)
    cut = replace(final, directions=log.directions[(log.directions[:, [0, 2]] != 7).all(axis=1)])

    assert observability(final, ["contacts", "directions"]).known == ["yes"] * 30
    assert disconnected(measure(cut, ["directions"]))[7]
