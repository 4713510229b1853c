"""The check of graphics cards runs, and states what is wrong."""

import json

import numpy as np
import pytest

from benchmarks import gpu
from benchmarks.swarm_step import reference
from benchmarks.swarm_step.scenes import StepParams, make
from tests.benchmarks.commands import call


def test_a_repeated_scene_has_the_forces_of_each_part():
    """Its parts do not touch, so that the reference computes one of them only."""
    base, params = make("block", 40, seed=0), StepParams()

    scene = gpu.tiled(base, 3)

    force = reference.force(scene, params, scene.position)
    expected = reference.force(base, params, base.position)
    np.testing.assert_allclose(force, np.tile(expected, (3, 1)), atol=1e-12)


def test_faults_are_listed():
    """A wrong engine of ours, an annealing that is off, runs that differ; not a missing peer."""
    swarm = [
        {"engine": "warp-cuda-f32", "robots": 10, "note": "ImportError"},
        {"engine": "tiswarm-cuda-f32", "robots": 10, "note": "WRONG"},
    ]
    study = {"robots": 10, "repeats": False, "equal_truth": False}
    report = {
        "tests": [{"passed": False}],
        "swarm_step": swarm,
        "joint": [{"robots": 10, "deviation_R": np.nan}],
        "study": [study],
    }

    assert gpu.faults(report) == [
        "tests of devices fail",
        "tiswarm-cuda-f32, 10 robots: WRONG",
        "joint, 10 robots: off by nan R",
        "study, 10 robots: two runs differ",
        "study, 10 robots: growth differs",
    ]
    assert gpu.faults({}) == []


@pytest.mark.trial
@pytest.mark.parametrize("parts", [("doctor", "bandwidth", "swarm_step"), ("joint", "study")])
def test_the_command_writes_one_report(tmp_path, parts):
    """On the processor, beside itself, since tests have no card; all but the tests of devices."""
    out = tmp_path / "report.json"

    sizes = ("--sizes", 300, "--joint-sizes", 20, "--study-sizes", 12)
    done = call("gpu", "--arch", "cpu", "--brief", "--parts", *parts, *sizes, "--out", out)

    assert done.returncode == 0, done.stderr
    report = json.loads(out.read_text())
    assert report["faults"] == report["left_out"] == []
    assert report["library"].startswith(("taichi", "quadrants"))
    assert all(report[part] for part in parts)
    ours = [row for row in report.get("swarm_step", ()) if row["engine"].startswith("tiswarm")]
    # The step alone is a difference of two short runs here, which may have either sign.
    assert all({"step_alone_GB_per_s", "list_ns"} <= row.keys() for row in ours)
    assert all(row["step_ns"] > 0.0 for row in ours)
    assert [row["deviation_R"] for row in report.get("joint", ())] in ([], [0.0])
    for row in report.get("study", ()):
        for method in ("joint", "together"):
            assert row[f"cpu_{method}_rmse_R"] > 0.0


@pytest.mark.trial
def test_rows_beyond_the_time_are_left_out(tmp_path):
    """And named, in a report that is written all the same."""
    out = tmp_path / "report.json"

    sizes = ("--joint-sizes", 20, 10)
    done = call("gpu", "--arch", "cpu", "--parts", "joint", *sizes, "--seconds", 0, "--out", out)

    assert done.returncode == 0, done.stderr
    assert json.loads(out.read_text())["left_out"] == ["joint: 10", "joint: 20"]
