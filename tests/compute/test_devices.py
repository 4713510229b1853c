"""What graphics cards compute agrees with the processor; software Vulkan stands in for them."""

import json

import numpy as np
import pytest

import tiswarm
from tests import runs
from tests.devices import ARCH, LIBRARIES, device_environment, run_child
from tests.engine.test_relax import GAINS, ROBOT, swarm
from tiswarm import study
from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.base.progress import Progress
from tiswarm.compute import backend
from tiswarm.engine import kernels
from tiswarm.engine.relax import PreparedSwarm
from tiswarm.localization import methods
from tiswarm.localization.chains import annealer
from tiswarm.localization.chains.annealer import annealer_of
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.settings import JointParams, VirtualForceParams
from tiswarm.records.positions import write_estimate
from tiswarm.scenario.expansion import load_scenario
from tiswarm.sensing import SensingParams, observe

TOWER = runs.REPOSITORY / "tests" / "tower.yaml"

BATCH = np.repeat(np.arange(10), 100)
"""Structures of the scene `batch`."""

on_each_library = pytest.mark.parametrize("library", LIBRARIES)


def _relaxed(arch: str, scene: str, steps: int):
    structure = BATCH if scene == "batch" else None
    position, orientation, contacts = swarm(1_000, 6)
    if scene == "batch":
        contacts = contacts[BATCH[contacts[:, 0]] == BATCH[contacts[:, 2]]]
    return position, tiswarm.relax(
        position, orientation, contacts, robot=ROBOT, ramp=0.5, steps=steps,
        structure=structure, arch=arch, **GAINS,
    )  # fmt: skip


_RELAX = """
import json, sys
from tests.compute.test_devices import _relaxed
from tests.devices import ARCH
from tiswarm.app import doctor
from tiswarm.compute import backend, machine
from tiswarm.base.errors import EnvironmentTroubleError
card = machine.find_card(ARCH)
assert backend.start("auto").arch == ("cpu" if card and card.is_software else ARCH)
if ARCH == "vulkan":
    try: backend.start(ARCH, precision="f64")
    except EnvironmentTroubleError as error: assert "--arch cpu, or precision auto" in str(error)
    else: raise AssertionError
print(doctor.try_backend(ARCH), file=sys.stderr)
found = {}
for scene in ("block", "batch"):
    for steps in (1, 10, 10):
        _, result = _relaxed(ARCH, scene, steps)
        row = [result.position.tolist(), result.list_builds, result.precision, result.force_error]
        found.setdefault(f"{scene} {steps}", []).append(row)
print(json.dumps(found))
"""


_STAY = """
import numpy as np
from tests.compute.test_devices import _relaxed
from tests.devices import ARCH
from tiswarm.base.errors import InputError
further = []
for arch in ("cpu", ARCH):
    start, result = _relaxed(arch, "block", 5)
    result.swarm.step(5, **{name: result.arguments[name] for name in
        ("attraction_gain", "repulsion_gain", "ramp", "max_step")})
    moved = result.swarm.position
    further.append(result.resume().position)
    longest = np.abs(moved - start).max()
    assert np.abs(moved - further[-1]).max() <= 10 * result.force_error * longest
assert 0.0 < np.abs(further[1] - further[0]).max() <= 10 * result.force_error * longest
if ARCH != "cuda":
    try: np.from_dlpack(result)
    except InputError as error: assert "read `position`" in str(error)
    else: raise AssertionError
"""


@pytest.mark.trial
@on_each_library
def test_robots_that_stay_on_a_device_go_on_there(library):
    """By `resume` and `step`, as on the processor, to the stated error of forces."""
    run_child(_STAY, **device_environment(library))


@pytest.mark.trial
@on_each_library
def test_a_device_takes_the_steps_of_the_processor(library):
    """A swarm and a batch, to the stated error of forces; lists as often, the same bytes twice.

    The doctor is content with it; Vulkan is refused in f64, and `auto` takes no software.
    """
    found = json.loads(run_child(_RELAX, **device_environment(library)))

    for key, rows in found.items():
        scene, steps = key.split()
        start, expected = _relaxed("cpu", scene, int(steps))
        for position, list_builds, precision, force_error in rows:
            assert precision == "f32" or ARCH == "cuda"
            assert list_builds == expected.list_builds
            longest = np.abs(expected.position - start).max()
            np.testing.assert_allclose(
                position, expected.position, rtol=0, atol=int(steps) * force_error * longest
            )
        assert all(row == rows[0] for row in rows)


def _annealed(logs, by_block):
    """Take five steps of two chains, blocks as for `Annealer`; return the places."""
    params = [JointParams(chains=2, steps=20, hold_steps=10)] * len(logs)
    problems = [pose_problem(log, p) for log, p in zip(logs, params, strict=True)]
    annealer = annealer_of(logs, params, problems, by_block=by_block)
    annealer.advance(5)
    return annealer.by_robot(annealer.swarm.position)


_JOINT = """
import numpy as np
from tests.compute.test_devices import _annealed
from tests.devices import ARCH
from tiswarm.compute import backend
from tiswarm.base.robot import RobotGeometry
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.params import TowerParams
noise = SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0)
towers = grow(TowerParams(), robots=20, seeds=[0, 1], robot=RobotGeometry())
logs = [observe(tower, noise) for tower in towers]
right = [_annealed(logs, by_block) for by_block in (True, False)]
assert np.array_equal(*right)
backend.start(ARCH)
print(np.abs(_annealed(logs, None) - right[0]).max())
"""


@pytest.mark.trial
@on_each_library
def test_a_device_anneals_as_the_processor_does(library):
    """Five steps of two chains and two towers; later, rounding makes all chains differ."""
    deviation = float(run_child(_JOINT, **device_environment(library)))

    assert deviation < 1e-4


_TOGETHER = """
import numpy as np, sys
from tests.devices import ARCH
from tiswarm.compute import backend
from tiswarm.localization.settings import Together, VirtualForceParams
from tiswarm.localization.methods import localize, localize_many
from tiswarm.base.robot import RobotGeometry
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.params import TowerParams
params = VirtualForceParams(schedule="together", together=Together(steps=12))
towers = grow(TowerParams(), robots=20, seeds=[0, 1], robot=RobotGeometry())
logs = [observe(tower, SensingParams(tilt_noise_deg=1.0)) for tower in towers]
right = localize_many(logs, [params] * 2)
running = backend.start(ARCH)
found = localize_many(logs, [params] * 2)
assert backend.current() == running
assert [e.trace.tobytes() for e in found] == [localize(log, params).trace.tobytes() for log in logs]
away = [np.abs(a.trace - b.trace).max() for a, b in zip(found, right, strict=True)]
assert running.precision == "f64" or min(away) > 0.0
print(max(away))
"""


@pytest.mark.trial
@on_each_library
def test_a_device_moves_all_robots_together_as_the_processor_does(library):
    """Twelve steps of two towers; each has the bytes that it has alone."""
    deviation = float(run_child(_TOGETHER, **device_environment(library)))

    assert deviation < 1e-4


_JOINT_BRIEFLY = "{method: joint, chains: 2, steps: 10, hold_steps: 5, refine: false}"
_TOGETHER_BRIEFLY = "{method: virtual-force, schedule: together, together: {steps: 10}}"
_CONDITIONS = (
    f"{{annealed: {{localization: {_JOINT_BRIEFLY}}}, "
    f"at-once: {{localization: {_TOGETHER_BRIEFLY}}}, "
    "algorithm-1: {localization: {method: virtual-force}}}"
)


@pytest.mark.trial
@on_each_library
def test_a_study_uses_the_device_for_joint_and_together_alone(tmp_path, library):
    """Its manifest says so, and the other method gives the bytes of the processor."""
    done = runs.call(
        "run", "scenarios/tower.yaml", "--arch", ARCH, "--no-pictures", "--out", tmp_path,
        "--set", "robots=12", "--set", "seeds=1", "--set", f"conditions={_CONDITIONS}",
        **device_environment(library),
    )  # fmt: skip

    assert done.returncode == 0, done.stderr
    assert f"joint and virtual-force together compute on {ARCH}" in done.stderr
    [run] = tmp_path.iterdir()
    manifest = json.loads((run / "manifest.json").read_text())
    for title in ("joint", "virtual-force together"):
        assert manifest["devices"].pop(f"localize by {title}").startswith(ARCH)
    assert manifest["devices"] == dict.fromkeys(["grow", "localize by virtual-force"], "cpu in f64")
    assert 0.0 < manifest["force_error"] < 1e-3
    case = run / "cases" / "0-algorithm-1"
    with pytest.warns(UserWarning, match="not con"):
        estimate = tiswarm.localize(case / "sensing.jsonl", "virtual-force")
    write_estimate(tmp_path / "here.csv", estimate)
    assert (tmp_path / "here.csv").read_bytes() == (case / "estimate.csv").read_bytes()


@pytest.mark.parametrize("method", ["virtual-force", "least-squares"])
def test_a_device_that_no_stage_uses_is_refused(towers, tmp_path, method):
    """Before it is looked for; the message names the method that uses one."""
    log = observe(towers[0], SensingParams())
    with pytest.raises(InputError, match=f"{method} always computes on cpu in f64; .* together"):
        tiswarm.localize(log, method, arch="metal")
    with pytest.raises(InputError, match=r"precision: f32 has no use"):
        tiswarm.localize(log, method, precision="f32")
    for each in (method, "joint"):
        with pytest.raises(InputError, match=r"precision 'float64'; did you mean f64"):
            tiswarm.localize(log, each, precision="float64")
    assert methods.start_device([methods.settings_of(method)()], "auto").arch == "cpu"

    with pytest.raises(InputError, match="vulkan has no use"):
        tiswarm.run(TOWER, {"robots": 4}, out=tmp_path, arch="vulkan", quiet=True)
    changed = [f"localization={{method: {method}}}", "conditions={baseline: {}}"]
    plan, elsewhere = load_scenario(TOWER, changed), study.Execution(scheduler="tcp://here:1")
    with pytest.raises(InputError, match="cuda has no use"):
        study.run(plan, tmp_path, progress=Progress(), arch="cuda", execution=elsewhere)
    assert list(tmp_path.iterdir()) == []


def test_stages_change_the_device_and_back():
    """The choice of the user outlasts stages that run on the processor in f64."""
    backend.start(precision="f32", threads=1)

    assert str(backend.processor()) == "cpu in f64"
    assert str(backend.device()) == "cpu in f32"
    assert methods.start_for(VirtualForceParams()).precision == "f64"
    assert methods.start_for(VirtualForceParams(schedule="together")).precision == "f32"
    assert methods.start_for(JointParams()).precision == "f32"
    assert backend.current().threads == 1


def test_a_swarm_on_a_device_that_stopped_is_refused():
    """Its arrays are gone; a launch would read other memory."""
    position, orientation, contacts = swarm(2_001)
    prepared = PreparedSwarm(position, orientation, contacts, robot=ROBOT, precision="f32")
    backend.processor()

    with pytest.raises(InputError, match="prepare it again"):
        prepared.relax(ramp=0.5, steps=1, **GAINS)


def test_a_device_that_returns_without_working_is_refused(monkeypatch):
    """Its memory is as it was; neither the start, nor steps, nor annealings wait for ever."""
    nothing = lambda *arguments: None  # noqa: E731
    monkeypatch.setattr(backend, "probe_arithmetic", nothing)
    with pytest.raises(EnvironmentTroubleError, match="cpu does not compute in f32"):
        backend.start(precision="f32")
    monkeypatch.undo()
    backend.start()

    monkeypatch.setattr(kernels, "step_robots", nothing)
    with pytest.raises(EnvironmentTroubleError, match="its driver is faulty"):
        tiswarm.relax(*swarm(2_001), robot=ROBOT, ramp=0.5, steps=3, **GAINS)


def test_an_annealing_without_steps_is_refused(towers, monkeypatch):
    """As on a device that drops its launches."""
    logs = [observe(towers[0], SensingParams())]
    monkeypatch.setattr(annealer, "take_steps", lambda *arguments: None)
    with pytest.raises(EnvironmentTroubleError, match="its driver is faulty"):
        _annealed(logs, by_block=False)
