"""Checks and measures a graphics card.

    make gpu
    python -m benchmarks.gpu --arch cuda
    python -m benchmarks.gpu --arch vulkan --brief --sizes 1e3 --joint-sizes 20 40

It runs the doctor's trial and the tests of devices, times the swarm step beside Warp (where it is
installed) and steps of `joint` beside the processor, and repeats a run to compare its bytes. The
report is one file of JSON; its `faults` are empty if all is well, else the exit status is 1.
"""

import argparse
import functools
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.swarm_step import reference
from benchmarks.swarm_step.__main__ import FEW_STEPS, FULL_SIZES, ROUNDINGS, STEPS
from benchmarks.swarm_step.engines.registry import ENGINES
from benchmarks.swarm_step.machine import describe
from benchmarks.swarm_step.process import EngineProcess
from benchmarks.swarm_step.scenes import Scene, StepParams, make
from tiswarm.base.params import ARCHS
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend, machine
from tiswarm.localization.chains.annealer import annealer_of
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.settings import JointParams
from tiswarm.parts import doctor
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.mechanics import MechanicsParams
from tiswarm.world.params import TowerParams

TILE, TOWER = 100_000, 10_000
"""Most robots of a scene, and of a tower, that are made anew; larger ones repeat them."""
ROUNDS = 3
FIRST_STEPS, TIMED_STEPS = 5, 20
LARGEST_DEVIATION = 1e-3
"""Of robots after the first steps of `joint`, from the processor in f64 [R]."""

_RUN = "{joint: {localization: {method: joint, %s}}}"
_BRIEF = "chains: 2, steps: 20, hold_steps: 10"


def main() -> None:
    """Measure everything, store the report, and say what is wrong."""
    options = _options()
    arch, report = options.arch, {}
    parts: dict[str, Callable[[], Any]] = {
        "doctor": lambda: doctor.try_backend(arch),
        "tests": lambda: run_tests(arch),
        "swarm_step": lambda: _shown(row for n in options.sizes for row in time_swarm(arch, n)),
        "joint": lambda: _shown(time_joint(arch, n) for n in options.joint_sizes),
        "digests": lambda: compare_runs(arch, brief=options.brief),
    }
    running, card = backend.start(arch), machine.find_card(arch)
    report |= {
        "arch": arch,
        "card": running.card,
        "driver": card.driver if card else "",
        "multiprocessors": card.multiprocessors if card else 0,
        "library": running.library,
        "precision": running.precision,
        **describe(),
        "faults": [],
    }
    for name in options.parts or parts:
        begin = time.perf_counter()
        report[name] = parts[name]()
        report[f"{name}_s"] = round(time.perf_counter() - begin, 1)
        report["faults"] = faults(report)
        print(name, json.dumps(report[name], indent=1), flush=True)
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(json.dumps(report, indent=1) + "\n")
    print(f"{options.out}: {'; '.join(report['faults']) or 'all is well'}")
    sys.exit(bool(report["faults"]))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    size = {"type": lambda text: int(float(text)), "nargs": "+", "metavar": "N"}
    parser.add_argument("--arch", choices=ARCHS, default="cuda")
    parser.add_argument(
        "--sizes", **size, default=[10**4, 10**5, 10**6, 10**7], help="robots of the swarm step"
    )
    parser.add_argument("--joint-sizes", **size, default=[10**4, 10**5], help="robots of joint")
    parser.add_argument("--parts", nargs="+", metavar="PART", help="only these parts")
    parser.add_argument("--brief", action="store_true", help="repeat a short run only")
    parser.add_argument("--out", type=Path, default=Path("reports/gpu.json"))
    return parser.parse_args()


def _shown(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Print rows as they are measured, which takes minutes."""
    found = []
    for row in rows:
        print(json.dumps(row), flush=True)
        found.append(row)
    return found


def faults(report: dict[str, Any]) -> list[str]:
    """List what a card may not do."""
    found = []
    if not report.get("tests", {"passed": True})["passed"]:
        found.append("tests of devices fail")
    found += [
        f"{row['engine']}, {row['robots']} robots: {row['note']}"
        for row in report.get("swarm_step", ())
        if row["note"] and not row["engine"].startswith(("warp", "quadrants"))
    ]
    found += [
        f"joint, {row['robots']} robots: off by {row['deviation_R']:.2g} R"
        for row in report.get("joint", ())
        if not row["deviation_R"] <= LARGEST_DEVIATION
    ]
    if len(set(report.get("digests", ()))) > 1:
        found.append("two runs differ")
    return found


def run_tests(arch: str) -> dict[str, Any]:
    """Run the tests of devices on this card."""
    # An empty -m takes tests at full size, too: those of devices are.
    options = ["-q", "-n", "0", "-m", "", "tests/compute/test_devices.py"]
    done = subprocess.run(  # noqa: S603 - our own tests
        [sys.executable, "-m", "pytest", *options],
        env=os.environ | {"TISWARM_TEST_ARCH": arch},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return {"passed": done.returncode == 0, "output": done.stdout.splitlines()[-12:]}


def time_swarm(arch: str, robots: int) -> Iterator[dict[str, Any]]:
    """Time the swarm step of every engine of a device, and check its initial forces."""
    params, base = StepParams(), make("block", min(robots, TILE), seed=0)
    copies = robots // len(base.position)
    scene = tiled(base, copies)
    steps = FEW_STEPS if robots >= FULL_SIZES[-1] else STEPS
    force = np.tile(reference.force(base, params, base.position), (copies, 1))
    farthest = float(np.abs(scene.position).max())
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.npz"
        np.savez(file, **vars(scene), force=force, steps=steps)
        for engine in (name for name in ENGINES if f"-{arch}-" in name):
            process = EngineProcess(engine, file)
            row = {"engine": engine, "robots": robots, "note": process.missing}
            if not process.missing:
                process.ask(do="run", steps=steps, max_step=params.max_step)  # warms up
                row |= process.ask(do="check")
                allowed = ROUNDINGS * np.finfo(ENGINES[engine].precision).eps * (farthest + 1.0)
                row["note"] = "" if row["force_error"] <= allowed else "WRONG"
                taken = [
                    process.ask(do="run", steps=steps, max_step=params.max_step)["wall_s"]
                    for _ in range(ROUNDS)
                ]
                row["step_ns"] = 1e9 * float(np.median(taken)) / (len(scene.position) * steps)
                process.stop()
            yield row


def tiled(base: Scene, copies: int) -> Scene:
    """Repeat a scene, side by side in a cube, as one structure whose parts do not touch."""
    side = int(np.ceil(copies ** (1 / 3)))
    corner = np.stack(np.unravel_index(np.arange(copies), (side, side, side)), axis=1)
    corner = (np.ptp(base.position, axis=0).max() + 10.0) * corner
    first = len(base.position) * np.arange(copies, dtype=np.int32)
    shift = first[:, None, None] * np.array([1, 0, 1, 0], np.int32)
    return Scene(
        position=(corner[:, None] + base.position).reshape(-1, 3),
        orientation_wxyz=np.tile(base.orientation_wxyz, (copies, 1)),
        contacts=(base.contacts + shift).reshape(-1, 4),
        structure=np.zeros(copies * len(base.position), np.int32),
    )


@functools.cache
def tower_log(robots: int) -> SensingLog:
    """Grow a tower; return what its robots sensed."""
    params = TowerParams(
        movers=max(robots // 100, 1), solve_every=2_000, mechanics=MechanicsParams(model="rigid")
    )
    [grown] = grow(params, robots=robots, seeds=[1000], robot=RobotGeometry())
    return observe(grown, SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0))


def time_joint(arch: str, robots: int) -> dict[str, Any]:
    """Time steps of `joint` on a device and on the processor, and compare the first of them."""
    log, params = tower_log(min(robots, TOWER)), JointParams()
    logs = [log] * (robots // log.robot_count)
    problems = [pose_problem(log, params)] * len(logs)
    row: dict[str, Any] = {"robots": robots, "towers": len(logs)}
    places = []
    for name in ("cpu", arch):
        backend.start(name)
        annealer = annealer_of(logs, [params] * len(logs), problems)
        annealer.advance(FIRST_STEPS)
        places.append(annealer.by_robot(annealer.swarm.position))
        begin = time.perf_counter()
        annealer.advance(FIRST_STEPS + TIMED_STEPS)
        annealer.by_robot(annealer.swarm.position)
        row[f"{name}_step_s"] = (time.perf_counter() - begin) / TIMED_STEPS
    deviation = float(np.abs(places[0] - places[1]).max())
    return row | {"chains": annealer.chains, "deviation_R": deviation}


def compare_runs(arch: str, *, brief: bool) -> list[str]:
    """Run a scenario twice; return the digests of its estimates."""
    digests = []
    for _ in range(2):
        with tempfile.TemporaryDirectory() as out:
            settings = [
                f"robots={12 if brief else 100}", "seeds=1",
                f"conditions={_RUN % (_BRIEF if brief else 'chains: 8')}",
            ]  # fmt: skip
            command = ["run", "scenarios/tower.yaml", "--no-pictures", "--quiet", "--arch", arch]
            command += ["--out", out, *(part for text in settings for part in ("--set", text))]
            subprocess.run(  # noqa: S603 - our own command
                [sys.executable, "-m", "tiswarm", *command], check=True
            )
            [estimate] = Path(out).glob("*/cases/*/estimate.csv")
            digests.append(hashlib.sha256(estimate.read_bytes()).hexdigest())
    return digests


if __name__ == "__main__":
    main()
