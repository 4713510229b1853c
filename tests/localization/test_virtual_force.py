"""Algorithm 1 does what the paper says, in any frame, batch or number of threads."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests import oracle
from tests.strategies import rotations, vectors
from tests.structures import silent
from tiswarm.base.errors import EnvironmentTroubleError
from tiswarm.compute import backend
from tiswarm.compute.lang import Ints1, Ints2, Reals2, Reals3, ti
from tiswarm.compute.math import dock_offsets
from tiswarm.compute.neighbor_kernels import CellList, cube_of, first_item, link
from tiswarm.localization.methods import localize, localize_many
from tiswarm.localization.settings import BackPropagation, Together, VirtualForceParams
from tiswarm.localization.virtual_force import method
from tiswarm.localization.virtual_force.kernels import (
    LogArrays,
    PlacedRobots,
    VirtualForceGains,
    _dock_at,
    _gains_of,
    _move,
)
from tiswarm.records.sensing_log import SensingLog, SensingNoise
from tiswarm.sensing import SensingParams, observe

SHORT = VirtualForceParams(  # gentle gains, for stronger ones make rounding grow without bound
    iterations=40,
    attraction_gain=0.1,
    repulsion_gain=0.2,
    height_gain=0.1,
    initial_offset=2.0,
)
TOGETHER = VirtualForceParams(schedule="together", together=Together(steps=12))
CUES = [
    SHORT,
    dataclasses.replace(SHORT, z_correction=False),
    dataclasses.replace(SHORT, z_correction=False, undocked_repulsion=False),
    dataclasses.replace(
        SHORT, z_correction=False, undocked_repulsion=False, neighbor_repulsion=True
    ),
    dataclasses.replace(SHORT, initial_offset_axis="body", initial_offset=1.0, max_step=0.3),
    dataclasses.replace(SHORT, z_correction=False, ground=False),
    dataclasses.replace(SHORT, height_order="after-docks"),
    dataclasses.replace(SHORT, stop_error=0.1),
    dataclasses.replace(
        SHORT, back_propagation=BackPropagation(every=5, sweeps=12, repulsion_share=0.7)
    ),
    dataclasses.replace(
        SHORT,
        height_order="after-docks",
        back_propagation=BackPropagation(every=5, sweeps=12, recent=4, repulsion_share=0.7),
    ),
]


@pytest.fixture(scope="module")
def log(towers) -> SensingLog:
    """What the robots of a small tower sensed, said to be biased."""
    log = _first(observe(towers[0], SensingParams(tilt_noise_deg=1.0)), 12)
    return dataclasses.replace(log, noise=SensingNoise(tilt_deg=1.0, yaw_deg=3.0, yaw_bias_deg=4.0))


def _first(log: SensingLog, count: int) -> SensingLog:
    """The log as it was when `count` robots had joined."""
    return dataclasses.replace(
        log,
        robot_id=log.robot_id[:count],
        orientation_wxyz=log.orientation_wxyz[:count],
        contacts=log.contacts[log.contacts[:, 2] < count],
        ground_docks=log.ground_docks[log.ground_docks[:, 0] < count],
        flip_height=log.flip_height[:count],
        spawn_position=log.spawn_position[:count],
        stances=None,
    )


@pytest.mark.parametrize("params", CUES)
def test_algorithm_1_matches_the_paper_written_out_slowly(log, params):
    """Every robot ends where loops over all docks put it, whichever cues are on."""
    estimate = localize(log, params)

    # Docks that just overlap or just do not make rounding grow, to some 1e-8 by robot 11.
    place, steps = oracle.localize(log, params)
    np.testing.assert_allclose(estimate.position, place, atol=1e-6)
    np.testing.assert_array_equal(estimate.steps, steps)


def test_a_robot_without_located_neighbors_starts_from_the_anchor(log):
    """Before the gap to the anchor closes, robots have no located neighbor to start from."""
    touches_earlier = np.isin(log.contacts[:, 2], [4, 5])
    log = dataclasses.replace(log, contacts=log.contacts[~touches_earlier])
    params = dataclasses.replace(SHORT, initial_offset_axis="body")

    estimate = localize(log, params)

    np.testing.assert_allclose(estimate.position, oracle.localize(log, params)[0], atol=1e-6)


def test_a_wrong_reference_would_be_noticed(log):
    """The cues matter here, so agreement with the slow version is no accident."""
    places = [localize(log, params).position for params in CUES]

    for a in range(len(places)):
        for b in range(a):
            assert np.abs(places[a] - places[b]).max() > 0.01


@pytest.mark.parametrize("params", [SHORT, TOGETHER], ids=lambda params: params.schedule)
@settings(max_examples=6)
@given(shift=vectors)
def test_moving_the_anchor_moves_the_estimate(log, params, shift):
    """Nothing but the anchor, the ground and the heights says where the world's origin is."""
    moved = dataclasses.replace(
        log,
        anchor_position=log.anchor_position + shift,
        ground_z=log.ground_z + shift[2],
        flip_height=log.flip_height + shift[2],
    )

    estimate = localize(moved, params).position - shift

    np.testing.assert_allclose(estimate, localize(log, params).position, atol=1e-6)


@settings(max_examples=6)
@given(turn=rotations)
def test_turning_the_world_turns_the_estimate(log, turn):
    """Without a height and with a body-fixed start no direction is special."""
    params = dataclasses.replace(
        SHORT, z_correction=False, ground=False, initial_offset_axis="body"
    )
    rotation = Rotation.from_quat(turn, scalar_first=True)
    orientation = rotation * Rotation.from_quat(log.orientation_wxyz, scalar_first=True)
    turned = dataclasses.replace(
        log,
        anchor_position=rotation.apply(log.anchor_position),
        orientation_wxyz=orientation.as_quat(scalar_first=True),
    )

    estimate = rotation.inv().apply(localize(turned, params).position)

    np.testing.assert_allclose(estimate, localize(log, params).position, atol=1e-6)


@settings(max_examples=4)
@given(angle=st.floats(-4.0, 4.0))
def test_turning_the_world_about_the_vertical_turns_all_robots_alike(log, angle):
    """Docks and forces turn with it, those of back-propagation too."""
    rotation = Rotation.from_rotvec([0.0, 0.0, angle])
    orientation = rotation * Rotation.from_quat(log.orientation_wxyz, scalar_first=True)
    turned = dataclasses.replace(
        log,
        anchor_position=rotation.apply(log.anchor_position),
        orientation_wxyz=orientation.as_quat(scalar_first=True),
    )

    estimate = localize(turned, CUES[-1])

    expected = localize(log, CUES[-1])
    np.testing.assert_allclose(
        rotation.inv().apply(estimate.position), expected.position, atol=1e-6
    )


def test_company_does_not_change_a_byte(towers):
    """Alone and in a batch of mixed settings: the same bits."""
    logs = [observe(history, SensingParams()) for history in towers] * len(CUES)
    params = [p for p in CUES for _ in towers]

    together = localize_many(logs, params)
    alone = [localize(log, p) for log, p in zip(logs, params, strict=True)]

    for a, b in zip(together, alone, strict=True):
        assert a.trace.tobytes() == b.trace.tobytes()


def test_the_order_of_contacts_within_a_robot_is_of_no_account(log):
    """Rows of the log say the same in any order, to rounding."""
    rng = np.random.default_rng(0)
    order = np.lexsort([rng.random(len(log.contacts)), log.contacts[:, 2]])

    shuffled = localize(dataclasses.replace(log, contacts=log.contacts[order]), SHORT)

    np.testing.assert_allclose(shuffled.position, localize(log, SHORT).position, atol=1e-9)


def test_docks_that_overlap_move_apart():
    """A robot that starts inside another one, connected to nothing near it, is pushed out."""
    log = _pair(contacts=[])
    params = VirtualForceParams(z_correction=False, initial_offset=0.7, repulsion_gain=0.05)

    estimate = localize(log, params)

    frames = estimate.trace[:, 1] - estimate.trace[:, 0]
    gap = np.array([_least_gap(log, frame) for frame in frames])
    assert gap[-1] > gap[0] + 0.1
    assert estimate.disconnected[1]


def test_the_precision_of_the_device_changes_nothing(log):
    """Robots are placed one after the other, on the processor in f64."""
    expected = localize(log, SHORT).position
    backend.choose(precision="f32")

    found = localize(log, SHORT).position

    np.testing.assert_array_equal(found, expected)


@ti.kernel
def _step_once(
    gains_table: Reals2, step: Reals2, head: Ints2, following: Ints2, dock_offset: Reals3,
    position: Reals2, is_gone: Ints1, found: Ints1,
):  # fmt: skip
    cells = ti.static(CellList(head, following))
    robots = ti.static(PlacedRobots(dock_offset, position))
    measured = ti.static(LogArrays(found, found, found, found, found, is_gone, found))
    gains = _gains_of(gains_table, 0)
    ti.loop_config(serialize=True)
    for i in range(position.shape[0]):
        link(cells, 0, i, cube_of(_dock_at(robots, i, 0), 1.0 / gains.spacing))
        move = ti.Vector([step[i, 0], step[i, 1], step[i, 2]])
        _move(gains, i, 0, 0, move, measured, robots, cells)
        item = first_item(cells, 0, cube_of(_dock_at(robots, i, 0), 1.0 / gains.spacing), 13)
        while item >= 0:
            found[i] += item == i
            item = following[0, item]


def test_docks_that_rounding_moves_across_a_face_are_found_again():
    """A dock is listed in the cube of its rounded place, where the next step unlinks it."""
    place, arm = np.random.default_rng(0).uniform(-9.0, 9.0, (2, 20_000, 3))
    step = 2.0 - arm - place
    across = np.floor((place + arm + step) / 2.0) != np.floor((place + step + arm) / 2.0)
    at_face = across.any(axis=1)
    place, arm, step = place[at_face], arm[at_face, None], step[at_face]
    gains = np.array([[getattr(SHORT, name, 2.0) for name in VirtualForceGains._fields]], float)
    found = np.zeros(len(place), np.int32)

    _step_once(
        gains,
        step,
        *CellList.allocate(1, len(place)),
        arm,
        place,
        np.zeros(len(place), np.int32),
        found,
    )

    assert len(place) > 100
    assert (found == 1).all()


def test_a_launch_that_does_nothing_is_noticed(log, monkeypatch):
    """Some drivers return without having run the kernel; that is no estimate."""
    monkeypatch.setattr(method.kernels, "localize_in_join_order", lambda *_arrays: None)

    with pytest.raises(EnvironmentTroubleError, match="use --arch cpu"):
        localize(log, SHORT)


def test_missing_heights_switch_the_height_force_off(log):
    """A log without flip heights is localized as if the cue were off."""
    blind = dataclasses.replace(log, flip_height=np.full(log.robot_count, np.nan))

    estimate = localize(blind, SHORT)

    expected = localize(log, dataclasses.replace(SHORT, z_correction=False))
    np.testing.assert_array_equal(estimate.position, expected.position)


@pytest.mark.parametrize(
    ("rounds", "frames"),
    [
        (None, [0, 4, 8, 11]),
        (BackPropagation(sweeps=1), [0, 4, 8, 11, 12]),
        (BackPropagation(sweeps=8), [0, 4, 8, 11, 15, 19]),
    ],
)
def test_the_trace_ends_at_the_estimate(log, rounds, frames):
    """Frames run from the start to the last iteration, then through the last round."""
    params = dataclasses.replace(SHORT, iterations=11, trace_every=4, back_propagation=rounds)

    estimate = localize(log, params)

    assert estimate.iteration.tolist() == frames
    np.testing.assert_array_equal(estimate.trace[-1], estimate.position)
    np.testing.assert_array_equal(
        estimate.trace[:, 0], np.tile(log.anchor_position, (len(frames), 1))
    )
    assert np.isfinite(estimate.residual).all()


def test_robots_that_a_round_leaves_alone_keep_their_place(log):
    """A round of the last four moves no other robot, in the estimate or in its trace."""
    rounds = BackPropagation(every=100, sweeps=8, recent=4)
    params = dataclasses.replace(SHORT, iterations=11, trace_every=4, back_propagation=rounds)

    estimate = localize(log, params)

    alone = localize(log, dataclasses.replace(params, back_propagation=None))
    for frame in estimate.trace[len(alone.iteration) :]:
        np.testing.assert_array_equal(frame[:-4], alone.position[:-4])
        assert np.abs(frame[-4:] - alone.position[-4:]).max() > 1e-3


def test_a_robot_that_fits_stops_early(log):
    """It takes fewer steps, and its misfit is below the threshold."""
    params = dataclasses.replace(SHORT, iterations=400, undocked_repulsion=False, stop_error=0.02)

    estimate = localize(log, params)

    assert 1 <= estimate.steps[1:].min() < 400
    stopped = np.flatnonzero(estimate.steps[1:] < 400) + 1
    dock = estimate.position[:, None] + dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    i, a, j, b = log.contacts.T
    gap = np.linalg.norm(dock[j, b] - dock[i, a], axis=1) - log.spacing
    for robot in stopped:
        assert np.abs(gap[j == robot]).max(initial=0.0) < 0.02 * np.sqrt((j == robot).sum() + 1)


def test_later_robots_correct_earlier_ones(log):
    """Contacts that were left stretched by robots placed too early close when rounds follow."""
    params = dataclasses.replace(SHORT, z_correction=False, undocked_repulsion=False)
    rounds = BackPropagation(every=4, sweeps=200, repulsion_share=0.0)

    before = _stretch(log, localize(log, params))
    after = _stretch(log, localize(log, dataclasses.replace(params, back_propagation=rounds)))

    assert before > 0.05
    assert after < 0.1 * before


def _pair(contacts):
    """Two robots, turned alike."""
    return silent(np.zeros((2, 3)), contacts=contacts)


def _least_gap(log, offset):
    dock = log.dock_offset_body
    return np.linalg.norm(dock[:, None] + offset - dock[None], axis=2).min()


def _stretch(log, estimate):
    """Root mean square distance by which docks in contact are too far apart [R]."""
    i, a, j, b = log.contacts.T
    dock = estimate.position[:, None] + dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    gap = np.linalg.norm(dock[j, b] - dock[i, a], axis=1) - log.spacing
    return np.sqrt(np.mean(np.maximum(gap, 0.0) ** 2))
