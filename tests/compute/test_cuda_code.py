"""What taichi compiles for CUDA, read without a card: a stub of the driver writes it down.

Limits are what the kernels needed as this was written. A change that needs more says why here.
"""

import os
import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import tiswarm
from tests.devices import require, run_child
from tests.engine.test_relax import GAINS, ROBOT, swarm
from tiswarm.base.errors import EnvironmentTroubleError
from tiswarm.compute import backend, dlpack
from tiswarm.engine import kernels
from tiswarm.engine.kernels import Control
from tiswarm.localization.chains.annealer import annealer_of
from tiswarm.localization.chains.kernels import note_places
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.methods import localize
from tiswarm.localization.settings import JointParams, VirtualForceParams
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.sensing import SensingParams, observe


class Limits(NamedTuple):
    """What one call of a kernel may need."""

    launches: int
    registers_f64: int
    registers_f32: int
    atomics: int


KERNELS = {  # registers rounded up to eights, in which a card grants them
    "turn_docks": Limits(2, 40, 32, 0),
    "place_docks": Limits(2, 32, 32, 0),
    "sort_docks": Limits(11, 40, 32, 2),
    "fill_rows": Limits(2, 72, 72, 1),
    "start_interval": Limits(2, 24, 24, 0),
    "step_robots": Limits(17, 80, 56, 16),  # 16 steps; numbers of a step come from a table
    "step_robots, guided": Limits(17, 88, 56, 16),  # 81: a step is one launch, before two
    "note_places": Limits(2, 16, 16, 0),
    "take_steps_on_card": Limits(17, 176, 96, 0),  # two steps
}
BLOCKS = 8 * 132
"""Most blocks of a launch, on the card that the stub describes."""


@pytest.fixture(scope="module")
def stub(tmp_path_factory) -> Path:
    """Folder with a CUDA driver that drops every launch."""
    compiler = shutil.which("cc")
    require(compiler, "gcc libc6-dev")
    folder = tmp_path_factory.mktemp("driver")
    source = Path(__file__).with_name("libcuda_stub.c")
    driver = folder / "libcuda.so.1"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", driver, source], check=True)
    (folder / "libcuda.so").symlink_to(driver)
    return folder


def compile_all(precision: str, log_file: str) -> None:
    """Launch the kernels of relax and joint on a card that does nothing."""
    with pytest.raises(EnvironmentTroubleError, match=f"does not compute in {precision}"):
        backend.start("cuda", precision=precision)
    probe, backend.probe_arithmetic = backend.probe_arithmetic, _answer
    with pytest.raises(EnvironmentTroubleError, match="its driver is faulty"):
        tiswarm.relax(
            *swarm(50), robot=ROBOT, ramp=0.5, steps=3, height=np.ones(50), height_gain=0.1,
            arch="cuda", precision=precision, **GAINS,
        )  # fmt: skip
    log = tiswarm.read_log(log_file)
    with pytest.raises(EnvironmentTroubleError, match="its driver is faulty"):
        localize(log, VirtualForceParams(schedule="together"))
    with pytest.raises(EnvironmentTroubleError, match=r"4000.* GB of memory and 8\.0 GB of cuda"):
        backend.current().require_memory(4e12, 9)
    params = JointParams(chains=2, steps=20, hold_steps=10, solve_yaw=True)
    annealer = annealer_of([log], [params], [pose_problem(log, params)])
    note_places(annealer.swarm.position, annealer.blocks.listed)
    with pytest.raises(EnvironmentTroubleError, match="its driver is faulty"):
        annealer.advance(5)
    backend.probe_arithmetic = probe


def _answer(value):
    """Answer in place of a card that works."""
    value *= 2.0


_COMPILE = """
import os, sys
from tests.compute.test_cuda_code import compile_all
from tiswarm.compute import backend, machine
card = machine.find_card("cuda")
assert card == ("stub of an H100", "CUDA 12.8", False, True, 132)
folder, log = sys.argv[1:]
for precision in ("f64", "f32"):
    os.environ["CUDA_STUB"] = os.path.join(folder, precision)
    os.mkdir(os.environ["CUDA_STUB"])
    compile_all(precision, log)
"""


@pytest.mark.trial
def test_every_kernel_of_a_card_assembles_and_needs_no_more_than_before(stub, towers, tmp_path):
    """Each compiles without a loop of compare-and-swap, and no launch floods the card.

    Where NVIDIA's assembler is installed, it accepts the code, and no register is spilled. A card
    that drops launches is refused by the start, by relax and by joint.
    """
    log = observe(towers[0], SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0, yaw_bias_deg=5.0))
    write_sensing_log(log, tmp_path / "sensing.jsonl")

    run_child(
        _COMPILE, str(tmp_path), str(tmp_path / "sensing.jsonl"),
        LD_LIBRARY_PATH=str(stub), TISWARM_BACKEND="taichi",
    )  # fmt: skip

    for precision in ("f64", "f32"):
        codes: dict[str, Path] = {}
        for file in sorted((tmp_path / precision).glob("*.ptx")):
            name = _name(file.read_text())
            codes[f"{name}, guided" if name in codes else name] = file  # relax came first
        assert codes.keys() >= KERNELS.keys()
        for name, limits in KERNELS.items():
            code = codes[name].read_text()
            assert precision == "f64" or ".f64" not in code
            atomics = Counter(re.findall(r"\b(?:atom|red)\.[.a-z0-9]+", code))
            assert not [each for each in atomics if ".cas." in each]
            assert sum(atomics.values()) <= limits.atomics
            assert code.count(".entry ") <= limits.launches
            most = limits.registers_f64 if precision == "f64" else limits.registers_f32
            assert _registers(codes[name]) <= most, name
        launches = (tmp_path / precision / "launches").read_text().splitlines()
        loops = [line.split() for line in launches if "_range_for" in line]
        assert {int(blocks) for _, blocks, _ in loops} == {BLOCKS}


def stay_on_card(folder: str) -> None:
    """Let robots go on twice on a card of which we know how far it came, and hand them out."""
    step_robots = kernels.step_robots

    def advance(*arguments):
        step_robots(*arguments)
        steps, first_t, numbers, control = arguments[1], arguments[8], arguments[9], arguments[-2]
        control[Control.TAKEN] = min(first_t + steps, numbers.shape[0])

    kernels.step_robots = advance
    backend.probe_arithmetic = _answer
    result = tiswarm.relax(
        *swarm(STAYING), robot=ROBOT, ramp=0.5, steps=STEPS, arch="cuda", precision="f64", **GAINS
    )
    for phase in ("resume", "step", "read"):
        os.environ["CUDA_STUB"] = str(Path(folder) / phase)
        Path(folder, phase).mkdir()
        if phase == "resume":
            result = result.resume()
        elif phase == "step":
            result.swarm.step(STEPS, ramp=0.5, **GAINS)
        else:
            assert result.__dlpack_device__() == (dlpack.CUDA, 0)
            assert "dltensor" in repr(result.__dlpack__())
            os.environ["CUDA_STUB"] = folder
            assert result.position.shape == (STAYING, 3)


STAYING = 3_000
STEPS = 16
_STAY = """
import os, sys
from tests.compute.test_cuda_code import stay_on_card
os.environ["CUDA_STUB"] = sys.argv[1]
stay_on_card(sys.argv[1])
"""


@pytest.mark.trial
def test_robots_on_a_card_go_on_there(stub, tmp_path):
    """No copy is as long as a number a robot, and an interval is 16 launches and 20 for its rows.

    A call adds what copies centers, docks, numbers and moves of its steps.
    """
    run_child(_STAY, str(tmp_path), LD_LIBRARY_PATH=str(stub), TISWARM_BACKEND="taichi")

    for phase, launches in (("resume", 46), ("step", 46), ("read", 4)):
        copies = (tmp_path / phase / "copies").read_text().split()
        assert max(map(int, copies)) < 4 * STAYING, phase
        launched = (tmp_path / phase / "launches").read_text().splitlines()
        assert len(launched) <= launches, Counter(line.split()[0] for line in launched)


def _name(code: str) -> str:
    """Return the name of the kernel in some PTX, or of a part of taichi's runtime."""
    return re.search(r"\.entry (\w+?)(_c\d+_\d+_kernel_\d+_\w+)?\(", code)[1]


def _registers(file: Path) -> int:
    """Return the most registers of a launch by NVIDIA's assembler, or 0 where there is none."""
    assembler = shutil.which("ptxas")
    if assembler is None:
        return 0
    command = [assembler, "-arch=sm_90", "-v", "-o", "/dev/null", file]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert set(re.findall(r"(\d+) bytes spill stores", done.stderr)) == {"0"}
    return max(map(int, re.findall(r"Used (\d+) registers", done.stderr)))
