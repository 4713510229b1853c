"""The C sources of a robot's steps compute what tiswarm computes."""

import shutil

import numpy as np
import pytest

from benchmarks.robot_step import __main__ as command
from benchmarks.robot_step import programs
from benchmarks.robot_step.inputs import inputs
from tests.devices import require
from tiswarm.sensing import SensingParams, observe


def _places(history):
    """Say where all but the last robot take themselves to be, off by .2 R [R], shape (N - 1, 3)."""
    place = history.position[:29] - history.position[0]
    return place + np.random.default_rng(0).normal(0.0, 0.2 / 3**0.5, place.shape)


@pytest.fixture(scope="module")
def results(towers, tmp_path_factory):
    """Results in a noisy tower of 30, by the compiler of this machine, and those of tiswarm."""
    require(shutil.which("cc"), "gcc libc6-dev")
    log = observe(towers[0], SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0))
    text, expected = inputs(log, _places(towers[0]), 12, command.STABLE)
    return programs.on_host(text, tmp_path_factory.mktemp("steps")), expected


@pytest.fixture(scope="module")
def off(results):
    """Differences between the two."""
    return command.differences(*results)


def test_virtual_forces_lead_to_the_same_places(off):
    """Where gains are stable, single precision moves each of 29 joining robots as float64 does."""
    assert off["places"].shape == (29,)
    # 300 steps of places up to 30 R, each rounded to 2e-6 R.
    assert off["places"].max() < 1e-3


def test_candidates_are_the_same(off):
    """The search finds as many places as tiswarm, and each where its last step of 1e-3 R led."""
    assert off["candidates"].max() < 2e-3


def test_rounds_lead_to_the_same_minimum(off):
    """Rounding to 6e-8 does not show beside standard deviations of .01 R and more."""
    assert off["centers of the neighborhood"].max() < 1e-3
    assert off["turns of the neighborhood"].max() < 1e-3
    assert off["cost of the neighborhood"] < 1e-4


def test_rounds_move_robots_and_turn_them(results):
    """The comparison is not one of robots that stay where they are held."""
    found, expected = results

    gains = [each.values[0] for each in found if each.what == "step"]

    assert gains[0] > 1.0
    assert np.abs(expected.state[:, 3:]).max() > 0.1


def test_a_robot_without_memory_for_a_neighborhood_is_refused(towers):
    """Sizes of arrays in C are checked before anything is compiled."""
    log = observe(towers[0], SensingParams(tilt_noise_deg=1.0))

    with pytest.raises(ValueError, match=r"MOST_HELD of robot.h is 24; this structure needs 30"):
        inputs(log, _places(towers[0]), 29, command.STABLE)


def test_a_missing_tool_is_named(tmp_path, monkeypatch):
    """The command ends with one line, which says what to install."""
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("sys.argv", ["robot_step"])

    with pytest.raises(SystemExit, match="run: apt-get install gcc-arm-none-eabi"):
        command.main()
