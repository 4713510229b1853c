"""No method holds a hidden length: logs in any unit give the same places in that unit."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.localization.methods import localize
from tiswarm.localization.peers.settings import HopByHopParams, LeastSquaresParams
from tiswarm.localization.settings import BackPropagation, JointParams, Together, VirtualForceParams
from tiswarm.measurements.units import contradictions
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.params import ClimbParams, TowerParams

SHORT = VirtualForceParams(iterations=40)
METHODS = [
    dataclasses.replace(SHORT, back_propagation=BackPropagation(every=5, sweeps=12)),
    VirtualForceParams(schedule="together", together=Together(steps=40)),
    JointParams(chains=2, steps=300, hold_steps=100),
    LeastSquaresParams(starts=2, rounds=4),
    HopByHopParams(),
]
UP = np.array([0.0, 0.0, 3.0])


@pytest.fixture(scope="module")
def log() -> SensingLog:
    """What slender robots that climb without regard for loads sensed on a table, some of it wrong.

    Their docks are twice as far from the center as wide.
    """
    climb = ClimbParams(patience=1, settle=1.0)
    params = TowerParams(force_threshold=1e9, climb=climb)
    history = grow(params, robots=12, seeds=[5000], robot=RobotGeometry(rho=2.0))[0]
    noise = SensingParams(
        tilt_noise_deg=1.0, yaw_noise_deg=2.0, spawn_noise=0.2, false_contacts=0.1
    )
    felt = observe(history, noise)
    return dataclasses.replace(
        felt,
        ground_z=felt.ground_z + UP[2],
        anchor_position=felt.anchor_position + UP,
        flip_height=felt.flip_height + UP[2],
        spawn_position=felt.spawn_position + UP,
        fixes=np.array([[3, 0.0, 0.0, 1.0, history.position[3, 2] + UP[2], 0.1, 0]]),
        ranges=np.array(
            [[5, 1, np.linalg.norm(history.position[5] - history.position[1]), 0.1, 1]]
        ),
        source_name=("camera", "radio"),
        source_sd=np.array([0.3, 0.05]),
    )


def _in_unit(log: SensingLog, scale: float) -> SensingLog:
    """Say the same in a unit of which a dock radius has `scale`."""
    return dataclasses.replace(
        log,
        dock_radius=scale * log.dock_radius,
        dock_offset_body=scale * log.dock_offset_body,
        anchor_position=scale * log.anchor_position,
        ground_z=scale * log.ground_z,
        flip_height=scale * log.flip_height,
        spawn_position=scale * log.spawn_position,
        fixes=log.fixes * [1.0, 1.0, 1.0, 1.0, scale, scale, 1.0],
        ranges=log.ranges * [1.0, 1.0, scale, scale, 1.0],
        source_sd=scale * log.source_sd,
        noise=dataclasses.replace(log.noise, spawn=scale * log.noise.spawn),
    )


@pytest.mark.parametrize(
    "precision",
    ["f64", pytest.param("f32", marks=pytest.mark.program(precision="f32"))],
)
@pytest.mark.parametrize("params", METHODS, ids=lambda p: p.method)
def test_an_anchor_far_from_the_origin_costs_no_precision(log, params, precision):
    """Map coordinates in meters with docks of 2 cm are 2e8 dock radii."""
    backend.start(precision=precision)
    far = np.array([2e8, -1e8, 3e6])
    # In whole parts of 2^-20 the sums below are exact, so that chains take the same steps.
    near, there = (_moved(log, by, 2.0**-20) for by in (0.0 * far, far))

    found, same = localize(near, params), localize(there, params)

    np.testing.assert_allclose(same.position - far, found.position, rtol=0.0, atol=1e-7)
    assert same.residual.tobytes() == found.residual.tobytes()


def _moved(log: SensingLog, by: np.ndarray, part: float) -> SensingLog:
    """Move a swarm, its coordinates rounded to whole parts."""

    def whole(value):
        return np.round(np.asarray(value) / part) * part

    return dataclasses.replace(
        log,
        anchor_position=whole(log.anchor_position) + by,
        ground_z=float(whole(log.ground_z) + by[2]),
        flip_height=whole(log.flip_height) + by[2],
        spawn_position=whole(log.spawn_position) + by,
        fixes=np.column_stack([log.fixes[:, :4], whole(log.fixes[:, 4]) + by[2], log.fixes[:, 5:]]),
    )


@pytest.mark.parametrize("params", METHODS, ids=lambda p: p.method)
@settings(max_examples=2)
@given(power=st.integers(-10, 10))
def test_the_unit_of_length_does_not_matter(log, params, power):
    """Places, their certainty and what is told of the log; bit for bit, as scales are exact."""
    scale = 2.0**power
    other = _in_unit(log, scale)

    found, same = localize(log, params), localize(other, params)

    assert same.position.tobytes() == (scale * found.position).tobytes()
    assert same.trace.tobytes() == (scale * found.trace).tobytes()
    assert same.residual.tobytes() == (scale * found.residual).tobytes()
    assert same.observability.known == found.observability.known
    assert same.observability.floppy_modes == found.observability.floppy_modes
    if found.sd is not None:
        assert same.sd.tobytes() == (scale * found.sd).tobytes()
    lines = [contradiction.line for contradiction in contradictions(log)]
    assert [contradiction.line for contradiction in contradictions(other)] == lines
