"""Localizers keep planar robots in the plane that their log states."""

from dataclasses import replace

import numpy as np
import pytest

import tiswarm
from tests.runs import REPOSITORY
from tests.structures import grown
from tiswarm.localization.methods import localize
from tiswarm.localization.peers.settings import LeastSquaresParams
from tiswarm.localization.settings import (
    BackPropagation,
    Cues,
    JointParams,
    Together,
    VirtualForceParams,
)
from tiswarm.measurements.cues import in_plane
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.history import History
from tiswarm.world.params import TowerParams

NOISY = SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=3.0, yaw_bias_deg=5.0)
FORCE = VirtualForceParams(iterations=60, initial_offset_axis="body")


@pytest.fixture(scope="module")
def tower() -> History:
    """A planar tower of 25 robots."""
    return grown(TowerParams(plane=True), robots=25, seed=1000)


def _moved(log: SensingLog, y: float) -> SensingLog:
    """The same log with the plane at another y."""
    fixes = log.fixes.copy()
    fixes[:, 4] = y
    anchor = log.anchor_position + np.array([0.0, y, 0.0])
    return replace(log, anchor_position=anchor, fixes=fixes)


def test_a_log_states_the_plane_of_each_robot_and_no_yaw(tower):
    """Gravity gives the whole orientation: noise turns robots about y alone."""
    log = observe(tower, NOISY)

    assert log.fixes[:, :5].tolist() == [[i, 0.0, 1.0, 0.0, 0.0] for i in range(25)]
    assert in_plane(log).all()
    for orientation in (log.orientation_wxyz, log.stances.orientation_wxyz):
        np.testing.assert_array_equal(orientation[:, [1, 3]], 0.0)
    assert not np.array_equal(log.orientation_wxyz, tower.orientation_wxyz)
    assert (log.noise.tilt_deg, log.noise.yaw_deg, log.noise.yaw_bias_deg) == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "way",
    [
        {},
        {"back_propagation": BackPropagation(every=5, sweeps=12)},
        {"schedule": "together", "together": Together(steps=100)},
    ],
)
@pytest.mark.parametrize("turn", [0.0, 0.1])
def test_virtual_force_keeps_planar_robots_at_the_anchors_y(tower, way, turn):
    """To the bit, even where docks lean out of the plane and forces push across it."""
    log = _moved(observe(tower, NOISY), 0.3)
    lean = np.array([np.cos(turn), np.sin(turn)])
    w, y = log.orientation_wxyz[:, [0, 2]].T
    leaning = np.column_stack([np.outer(w, lean), np.outer(y, lean)])
    params = replace(FORCE, **way)

    found = localize(replace(log, orientation_wxyz=leaning), params)

    assert (found.position[:, 1] == 0.3).all()
    assert (found.trace[:, :, 1] == 0.3).all()
    assert found.observability.cues[-1] == "plane"
    assert found.observability.floppy_modes < 25


def test_robots_are_planar_up_to_the_first_that_is_not(tower):
    """One at another y, or without a fix, ends the plane; a camera's log has none."""
    log = observe(tower, SensingParams())
    rng = np.random.default_rng(0)
    other, camera = log.fixes.copy(), log.fixes.copy()
    other[10, 4] = 1e-9
    camera[:, 4] = rng.normal(size=25)

    assert in_plane(replace(log, fixes=other)).tolist() == [True] * 10 + [False] * 15
    assert in_plane(replace(log, fixes=np.delete(log.fixes, 3, axis=0))).sum() == 3
    assert not in_plane(replace(log, fixes=camera)).any()
    assert not in_plane(replace(log, fixes=log.fixes[1:])).any()


@pytest.mark.filterwarnings("ignore:.*converged")
@pytest.mark.parametrize("robots", [25, 7])
def test_planar_robots_that_join_are_placed_as_in_the_whole_log(tower, tmp_path, robots):
    """The same bytes as offline, also where only the first robots are planar."""
    log = _moved(observe(tower, NOISY), 0.3)
    path = tmp_path / "sensing.jsonl"
    write_sensing_log(replace(log, fixes=log.fixes[:robots]), path)
    settings = {"iterations": 60, "initial_offset_axis": "body"}
    whole = tiswarm.localize(path, "virtual-force", **settings)
    header, *lines = path.read_text().splitlines()

    localizer = tiswarm.Localizer(header, FORCE)
    joined = [localizer.join(line) for line in lines]

    assert np.array(joined).tobytes() == whole.position.tobytes()


@pytest.mark.parametrize(
    "params",
    [
        JointParams(chains=4, steps=1500, cues=Cues(walk_contacts=False)),
        LeastSquaresParams(cues=Cues(walk_contacts=False)),
    ],
    ids=lambda p: p.method,
)
def test_the_plane_is_a_measurement(tower, params):
    """Robots stay within its standard deviation; with it, nothing is floppy."""
    found = localize(observe(tower, SensingParams()), params)

    assert np.abs(found.position[:, 1]).max() < 0.05
    # An image of the last robot, 1 R from its place, fits as well.
    assert np.sqrt(((found.position - tower.position) ** 2).sum(axis=1).mean()) < 0.4
    assert found.observability.floppy_modes == 0


def test_without_the_plane_robots_swing_about_their_contacts(tower):
    """The switch `plane` takes the measurement out."""
    params = JointParams(chains=2, steps=600, hold_steps=200, cues=Cues(plane=False))

    found = localize(observe(tower, SensingParams()), params)

    assert np.abs(found.position[:, 1]).max() > 0.2
    assert "plane" not in found.observability.cues


def test_the_log_for_a_bench_is_read_and_localized(tiswarm, tmp_path):
    """Three planar robots in mm: checked without a warning, and put where they stand."""
    log = REPOSITORY / "scenarios" / "examples" / "fireant2d-log.jsonl"
    out = tmp_path / "estimate.csv"

    checked = tiswarm("check", log)
    localized = tiswarm("localize", log, "--out", out)

    assert checked.returncode == localized.returncode == 0, checked.stderr + localized.stderr
    assert "plane: 0 floppy modes" in checked.stdout
    heading, *rows = (line.split(",") for line in out.read_text().splitlines())
    assert heading[:4] == ["robot", "x_mm", "y_mm", "z_mm"]
    assert [row[0] for row in rows] == ["21", "7", "12"]
    found = np.array([row[1:4] for row in rows], float)
    standing = [[0.0, 0.0, 57.7], [151.6, 0.0, 57.7], [75.8, 0.0, 189.0]]
    np.testing.assert_allclose(found, standing, atol=0.5)


def test_the_scenario_runs_from_the_command_line(tiswarm, tmp_path):
    """Planar towers, cantilevers and bridges are grown, sensed, localized and scored."""
    conditions = "conditions={flat: {localization: {method: virtual-force, iterations: 60}}}"
    small = ("--set", "robots=8", "--set", "seeds=1", "--set", conditions)

    done = tiswarm(
        "run", "scenarios/fireant2d.yaml", *small, "--no-pictures", "--out", tmp_path
    )  # fmt: skip

    assert done.returncode == 0, done.stderr
    cases = sorted(tmp_path.glob("*/cases/*"))
    assert len(cases) == 4
    for case in cases:
        for table in ("truth.csv", "estimate.csv"):
            rows = [row.split(",") for row in (case / table).read_text().splitlines()[1:]]
            assert {float(row[2]) for row in rows} == {0.0}
