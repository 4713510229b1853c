"""Virtual forces on all robots at once: the equations, and the same bytes in any company."""

import dataclasses

import numpy as np
import pytest

from tests.localization.test_virtual_force import _pair
from tests.oracle import swarm_step
from tiswarm.base.errors import InputError
from tiswarm.compute import backend
from tiswarm.compute.math import dock_offsets
from tiswarm.localization.methods import localize, localize_many
from tiswarm.localization.settings import BackPropagation, Together, VirtualForceParams
from tiswarm.measurements.contacts import hops
from tiswarm.records.sensing_log import SensingLog
from tiswarm.scenario.expansion import load_scenario
from tiswarm.sensing import SensingParams, observe

SHORT = VirtualForceParams(schedule="together", together=Together(steps=12))


@pytest.fixture(scope="module")
def log(towers) -> SensingLog:
    """What the robots of a small tower sensed."""
    return observe(towers[0], SensingParams(tilt_noise_deg=1.0))


def _steps(log, params):
    """Trace of all robots, a frame a step, by loops over robots and docks."""
    arm = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    place = [_start(log, arm)] * 2
    height = log.flip_height.copy()
    for robot in np.unique(log.ground_docks[:, 0]):
        docks = log.ground_docks[log.ground_docks[:, 0] == robot, 1]
        height[robot] = log.ground_z + 1.0 - arm[robot, docks, 2].mean()
    count = np.bincount(log.contacts[:, [0, 2]].ravel(), minlength=log.robot_count)
    mobility = np.repeat(params.together.gain / np.maximum(count, 1)[:, None], 3, axis=1)
    mobility[0] = 0.0
    (steps, momentum), share = params.together.pace(0), params.together.repulsion_share
    for t in range(steps):
        carried = momentum * (place[-1] - place[-2])
        step = swarm_step(
            place[-1], arm, log.contacts, np.zeros(log.robot_count), height,
            attraction_gain=params.attraction_gain, repulsion_gain=params.repulsion_gain,
            height_gain=params.height_gain, spacing=2.0, max_step=params.together.max_step,
            ramp=1.0 - share * (1.0 - t / (steps - 1)), parting_gain=params.attraction_gain,
            mobility=mobility, carried=carried,
        )  # fmt: skip
        place.append(step)
    return np.array(place[1:])


def _start(log, arm):
    """Robots across from those in contact that are one contact nearer to the anchor, their mean."""
    place = np.tile(log.anchor_position, (log.robot_count, 1))
    hop = hops(log, np.array([0]))[0]
    for robot in np.argsort(hop, kind="stable")[1:]:
        met = []
        for i, a, j, b in [*log.contacts, *log.contacts[:, [2, 3, 0, 1]]]:
            if j == robot and hop[i] < hop[j]:
                shift = arm[i, a] - arm[j, b]
                met.append(place[i] + shift + 2.0 * shift / max(np.linalg.norm(shift), 2.0))
        place[robot] = np.mean(met, axis=0)
    return place


def test_all_robots_step_by_the_equations_from_where_contacts_lead(log):
    """The start and every step, against loops over all docks; the anchor stays where it is."""
    estimate = localize(log, SHORT)

    np.testing.assert_allclose(estimate.trace, _steps(log, SHORT), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(estimate.position[0], log.anchor_position)
    assert estimate.steps.tolist() == [0] + [12] * (log.robot_count - 1)
    last = np.linalg.norm(estimate.trace[-1] - estimate.trace[-2], axis=1)
    assert estimate.residual[-1] == pytest.approx(np.sqrt(np.mean(last**2)), rel=1e-9)


def test_cues_count_as_far_as_they_are_on(log):
    """Each changes the estimate; what a log lacks counts as off."""
    off = [{"z_correction": False}, {"ground": False}, {"undocked_repulsion": False}]
    places = [localize(log, dataclasses.replace(SHORT, **change)).position for change in [{}, *off]]
    blind = dataclasses.replace(log, flip_height=np.full(log.robot_count, np.nan))

    for other in places[1:]:
        assert np.abs(other - places[0]).max() > 1e-6
    np.testing.assert_array_equal(localize(blind, SHORT).position, places[1])


def test_large_structures_take_more_steps_and_lose_motion_as_slowly():
    """Up to 1,000 robots take 700 steps, 8,000 twice as many; motion decays by e^-10.5 in each."""
    paces = [Together().pace(robots) for robots in (1, 1_000, 8_000, 1_000_000)]

    assert [steps for steps, _ in paces] == [700, 700, 1_400, 7_000]
    for steps, momentum in paces:
        assert momentum**steps == pytest.approx(np.exp(-10.5), rel=0.1)
    assert Together(steps=5).pace(10**6) == (5, 0.0)
    assert Together(steps=5, momentum=0.5).pace(10) == (5, 0.5)


def test_robots_that_nothing_ties_start_where_the_last_ones_joined(log):
    """They are marked as disconnected, and stay apart from each other."""
    is_kept = ~np.isin(log.contacts, [7, 9])[:, [0, 2]].any(axis=1)

    estimate = localize(dataclasses.replace(log, contacts=log.contacts[is_kept]), SHORT)

    first = estimate.trace[0]
    assert estimate.disconnected[[7, 9]].all()
    np.testing.assert_allclose(first[7], first[6] + [0.0, 0.0, 2.0])
    assert np.isfinite(estimate.position).all()


def test_robots_whose_docks_would_coincide_part():
    """Turned alike, with the same dock in contact, one starts above the other."""
    log = _pair(contacts=[[0, 1, 1, 1]])

    estimate = localize(log, dataclasses.replace(SHORT, together=Together(steps=1000)))

    np.testing.assert_allclose(estimate.position, [[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]], atol=1e-9)


def test_company_does_not_change_a_byte(towers, monkeypatch):
    """Small structures share a swarm, large ones have one each."""
    logs = [observe(history, SensingParams()) for history in towers]
    params = dataclasses.replace(SHORT, together=Together(steps=200))
    shares: list[float] = []
    for size in (2_000, 20):
        monkeypatch.setattr("tiswarm.engine.relax.SMALL", size)

        batch = localize_many(logs, [params] * len(logs), on_progress=shares.append)
        alone = [localize(log, params) for log in logs]

        for a, b in zip(batch, alone, strict=True):
            assert a.trace.tobytes() == b.trace.tobytes()
            assert a.steps.tolist() == b.steps.tolist() == [0] + [200] * (len(a.position) - 1)
    assert sum(shares) == pytest.approx(2 * len(logs))


@pytest.mark.program(precision="f32")
def test_company_does_not_change_a_byte_in_f32(towers):
    """Nor where a structure of the batch is so far away that it has a coarser unit."""
    logs = [observe(history, SensingParams()) for history in towers[:2]]
    height = np.where(np.arange(logs[1].robot_count) == 9, 5_000.0, logs[1].flip_height)
    logs[1] = dataclasses.replace(logs[1], flip_height=height)
    backend.start(precision="f64")
    in_f64 = localize(logs[0], SHORT)
    backend.start(precision="f32")

    batch = localize_many(logs, [SHORT] * 2)

    assert batch[0].trace.tobytes() == localize(logs[0], SHORT).trace.tobytes()
    assert 0.0 < np.abs(batch[0].trace - in_f64.trace).max() < 1e-4


@pytest.mark.parametrize(
    "change",
    [
        {"back_propagation": BackPropagation()},
        {"stop_error": 0.1},
        {"height_order": "after-docks"},
        {"neighbor_repulsion": True},
    ],
)
def test_what_moves_robots_one_by_one_is_refused(change):
    """In Python; a scenario names the line."""
    with pytest.raises(ValueError, match=f"{next(iter(change))} moves robots one by one"):
        VirtualForceParams(schedule="together", **change)


def test_a_scenario_with_rounds_of_robots_together_is_refused(tmp_path):
    """With its file and line, and what to do."""
    path = tmp_path / "s.yaml"
    path.write_text(
        "name: s\nstructure: {kind: tower}\nlocalization:\n  method: virtual-force\n"
        "  schedule: together\n  back_propagation: {every: 3}\n"
    )

    with pytest.raises(
        InputError, match=r"s\.yaml:\d+: .*back_propagation moves robots one by one;"
    ):
        load_scenario(path)
