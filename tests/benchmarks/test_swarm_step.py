"""The scenes and the reference of the swarm step are correct."""

import numpy as np
import pandas as pd
import pytest

from benchmarks.swarm_step import reference, scenes
from benchmarks.swarm_step.engines.registry import ENGINES
from benchmarks.swarm_step.scenes import StepParams
from benchmarks.swarm_step.worker import check
from tests import oracle
from tests.benchmarks.commands import call

PARAMS = StepParams()


def _forces_one_by_one(scene):
    """Sum the forces dock by dock, within each structure."""
    robots = len(scene.position)
    connected = {tuple(row) for row in scene.contacts.tolist()}
    force = np.zeros((robots, 3))
    for i in range(robots):
        for j in set(np.flatnonzero(scene.structure == scene.structure[i])) - {i}:
            for a in range(3):
                for b in range(3):
                    other = scene.position[j] + scene.dock_offset[j, b]
                    offset = other - scene.position[i] - scene.dock_offset[i, a]
                    touches = (i, a, j, b) in connected or (j, b, i, a) in connected
                    if touches or np.linalg.norm(offset) < PARAMS.spacing:
                        gains = PARAMS.attraction_gain, PARAMS.repulsion_gain
                        force[i] += oracle.dock_pair_force(
                            offset, *gains, PARAMS.spacing, PARAMS.ramp
                        )
    return force


@pytest.mark.parametrize("name", scenes.SCENES)
def test_the_reference_sums_the_forces_of_all_docks(name, monkeypatch):
    """The reference agrees with a loop over all pairs of docks, also for several structures."""
    monkeypatch.setattr(scenes, "BATCH", 8)
    scene = scenes.make(name, 20, seed=1)

    force = reference.force(scene, PARAMS, scene.position)

    assert len(scene.contacts) > 5
    np.testing.assert_allclose(force, _forces_one_by_one(scene), rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", ["block", "batch"])
@pytest.mark.parametrize("engine", ["tiswarm-f64", "kdtree-f64"])
def test_engines_pass_the_check(engine, name):
    """Initial forces, and positions after list rebuilds, agree with the reference."""
    scene, steps = scenes.make(name, 150, seed=2), 30
    files = {
        "force": reference.force(scene, PARAMS, scene.position),
        "steps": steps,
        "end": reference.run(scene, PARAMS, steps),
    }

    running = ENGINES[engine].load()(scene, PARAMS)
    found = check(running, scene, PARAMS, files, np.arange(150))

    assert found["force_error"] < 1e-12
    assert found["end_error_R"] < 1e-12
    assert running.builds > 1


@pytest.mark.trial
def test_the_benchmark_runs_from_the_command_line(tmp_path):
    """A small run measures, checks and draws our engines, and keeps earlier rows."""
    engines = ["--engines", "tiswarm-f64", "tiswarm-f64-call"]
    sizes = ["--sizes", 100, "--scenes", "batch", "--repeats", 1, "--out", tmp_path]
    earlier = "scene,robots,engine,note,cpu_ns,step_cpu_ns\nblock,100,c-f64,,7.0,5.0\n"
    (tmp_path / "swarm_step.csv").write_text(earlier)

    done = call("swarm_step", *engines, *sizes)

    assert done.returncode == 0, done.stderr
    assert {file.name for file in tmp_path.iterdir()} == {
        "machine.json", "swarm_step.csv", "swarm_step.png",
    }  # fmt: skip
    table = pd.read_csv(tmp_path / "swarm_step.csv")
    assert list(table["engine"]) == ["tiswarm-f64", "tiswarm-f64-call", "c-f64"]
    assert (table["cpu_ns"] > 0.0).all()
