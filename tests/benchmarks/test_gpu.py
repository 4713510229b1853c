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
    report = {
        "tests": {"passed": False},
        "swarm_step": swarm,
        "joint": [{"robots": 10, "deviation_R": np.nan}],
        "digests": ["a", "b"],
    }

    assert gpu.faults(report) == [
        "tests of devices fail",
        "tiswarm-cuda-f32, 10 robots: WRONG",
        "joint, 10 robots: off by nan R",
        "two runs differ",
    ]
    assert gpu.faults({}) == []


@pytest.mark.trial
def test_the_command_writes_one_report(tmp_path):
    """On the processor, beside itself, since tests have no card."""
    out = tmp_path / "report.json"

    done = call("gpu", "--arch", "cpu", "--parts", "joint", "--joint-sizes", 20, "--out", out)

    assert done.returncode == 0, done.stderr
    report = json.loads(out.read_text())
    assert report["faults"] == []
    assert report["library"].startswith(("taichi", "quadrants"))
    assert report["joint"][0]["deviation_R"] == 0.0
