"""Checks and measures a graphics card, in eight minutes.

    make gpu
    python -m benchmarks.gpu --arch cuda
    python -m benchmarks.gpu --arch vulkan --brief --sizes 1e3 --joint-sizes 20 40 --study-sizes 12

It runs the doctor's trial and the tests of devices, times the swarm step beside Warp (where it is
installed), times steps of `joint` beside the processor, and runs a study on processor and card. The
report is one file of JSON, written anew after each row. Each part has a share of the time: rows
that would begin later are `left_out`. Its `faults` are empty if all is well, else the exit status
is 1.
"""

import argparse
import functools
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.swarm_step import reference
from benchmarks.swarm_step.__main__ import FEW_STEPS, FULL_SIZES, ROUNDINGS, STEPS, STILL
from benchmarks.swarm_step.engines.registry import ENGINES
from benchmarks.swarm_step.machine import describe
from benchmarks.swarm_step.process import EngineProcess
from benchmarks.swarm_step.scenes import Scene, StepParams, make
from tiswarm.app import doctor
from tiswarm.base.params import ARCHS
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend, machine
from tiswarm.compute.lang import LIBRARY, ti
from tiswarm.localization.chains.annealer import annealer_of
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.settings import JointParams
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
UNTIL = {
    "doctor": 0.06, "bandwidth": 0.08, "swarm_step": 0.4, "joint": 0.5, "study": 0.6, "tests": 0.9
}  # fmt: skip
"""Share of the time by which the last row of a part has to begin, most telling parts first."""
COPIED = 2**25
"""Numbers of 4 B that are copied to measure the bandwidth."""
MOST_LONG = 50
"""Times as many steps as usual, at most, of the run from which the step alone is read."""

Job = tuple[str, Callable[[], dict[str, Any]]]
"""Name of a row, and what measures it."""


def main() -> None:
    """Measure everything, store the report, and say what is wrong."""
    options = _options()
    arch, begin = options.arch, time.perf_counter()
    running, card = backend.start(arch), machine.find_card(arch)
    report: dict[str, Any] = {
        "arch": arch,
        "card": running.card,
        "driver": card.driver if card else "",
        "multiprocessors": card.multiprocessors if card else 0,
        "library": running.library,
        "precision": running.precision,
        **describe(),
        "faults": [],
        "left_out": [],
    }
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for part, jobs in _jobs(options, Path(folder)).items():
            report[part] = []
            for name, measure in jobs:
                if time.perf_counter() - begin > UNTIL[part] * options.seconds:
                    report["left_out"].append(f"{part}: {name}")
                    continue
                since = time.perf_counter()
                report[part].append(row := measure())
                row["took_s"] = round(time.perf_counter() - since, 1)
                report["faults"] = faults(report)
                print(part, json.dumps(row), flush=True)
                options.out.write_text(json.dumps(report, indent=1) + "\n")
    options.out.write_text(json.dumps(report, indent=1) + "\n")
    print(f"{options.out}: {'; '.join(report['faults']) or 'all is well'}")
    for row in report["left_out"]:
        print(f"left out: {row}")
    sys.exit(bool(report["faults"]))


def _jobs(options: argparse.Namespace, folder: Path) -> dict[str, list[Job]]:
    """List the rows of each part, small ones first."""
    arch, rest = options.arch, functools.partial
    ours = ("tiswarm-", "warp-") if LIBRARY == "taichi" else ("quadrants-", "warp-")
    peers = [name for name in ENGINES if f"-{arch}-" in name and name.startswith(ours)]
    if arch == "cpu":
        peers = ["tiswarm-f64", "tiswarm-f32", "warp-f64", "warp-f32"]
    engines = itertools.product(sorted(options.sizes), peers)
    jobs: dict[str, list[Job]] = {
        "doctor": [(arch, lambda: {"line": str(doctor.try_backend(arch))})],
        "bandwidth": [("copy", rest(measure_bandwidth, arch))],
        "swarm_step": [(f"{e}, {n:,}", rest(time_swarm, e, n, folder)) for n, e in engines],
        "joint": [(f"{n:,}", rest(time_joint, arch, n)) for n in sorted(options.joint_sizes)],
        "study": [
            (f"{n:,}", rest(study, arch, n, brief=options.brief)) for n in options.study_sizes
        ],
        "tests": [(arch, rest(run_tests, arch, 0.4 * options.seconds))],
    }
    return {part: jobs[part] for part in options.parts or jobs}


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    size = {"type": lambda text: int(float(text)), "nargs": "+", "metavar": "N"}
    parser.add_argument("--arch", choices=ARCHS, default="cuda")
    parser.add_argument(
        "--sizes", **size, default=[10**4, 10**5, 10**6], help="robots of the swarm step"
    )
    parser.add_argument("--joint-sizes", **size, default=[10**5], help="robots of joint")
    parser.add_argument("--study-sizes", **size, default=[10**4], help="robots of the study")
    parser.add_argument("--parts", nargs="+", choices=UNTIL, help="only these parts")
    parser.add_argument("--brief", action="store_true", help="short runs of joint in the study")
    parser.add_argument("--seconds", type=float, default=480.0, help="time for all (480)")
    parser.add_argument("--out", type=Path, default=Path("reports/gpu.json"))
    return parser.parse_args()


def faults(report: Mapping[str, Any]) -> list[str]:
    """List what a card may not do."""
    found = ["tests of devices fail" for row in report.get("tests", ()) if not row["passed"]]
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
    for row in report.get("study", ()):
        for what, text in (("repeats", "two runs differ"), ("equal_truth", "growth differs")):
            if not row[what]:
                found.append(f"study, {row['robots']} robots: {text}")
    return found


def run_tests(arch: str, seconds: float) -> dict[str, Any]:
    """Run the tests of devices that compute on this card, by the library that computes here."""
    only = ["-m", "trial", "-k", LIBRARY]
    options = ["-q", "-n", "0", *only, "tests/compute/test_devices.py"]
    try:
        done = subprocess.run(  # noqa: S603 - our own tests
            [sys.executable, "-m", "pytest", *options],
            env=os.environ | {"TISWARM_TEST_ARCH": arch},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
            timeout=seconds,
        )
    except subprocess.TimeoutExpired:
        return {"passed": False, "output": [f"not done after {seconds:g} s"]}
    return {"passed": done.returncode == 0, "output": done.stdout.splitlines()[-12:]}


def measure_bandwidth(arch: str) -> dict[str, Any]:
    """Copy an array on the device: the bytes a second of a kernel that only reads and writes."""

    @ti.kernel
    def copy(source: ti.types.ndarray(dtype=ti.f32, ndim=1), to: ti.types.ndarray(ti.f32, ndim=1)):  # noqa: ANN202 - a kernel
        for k in range(source.shape[0]):
            to[k] = source[k]

    backend.start(arch)
    source, to = ti.ndarray(ti.f32, COPIED), ti.ndarray(ti.f32, COPIED)
    taken = []
    for _ in range(1 + ROUNDS):
        begin = time.perf_counter()
        for _ in range(8):
            copy(source, to)
        ti.sync()
        taken.append((time.perf_counter() - begin) / 8)
    return {"GB_per_s": 2 * 4e-9 * COPIED / min(taken)}


@functools.cache
def scene_file(robots: int, folder: Path) -> tuple[Path, float, float]:
    """Write a scene with its initial forces; return file, largest coordinate, entries a robot."""
    params, base = StepParams(), make("block", min(robots, TILE), seed=0)
    copies = robots // len(base.position)
    scene = tiled(base, copies)
    force = np.tile(reference.force(base, params, base.position), (copies, 1))
    file = folder / f"{robots}.npz"
    np.savez(file, **vars(scene), force=force, steps=_steps(robots))
    dock = (base.position[:, None] + base.dock_offset).reshape(-1, 3)
    pairs = len(cKDTree(dock).query_pairs(params.spacing + params.skin, output_type="ndarray"))
    return file, float(np.abs(scene.position).max()), 2.0 * pairs / len(base.position)


def _steps(robots: int) -> int:
    """Steps of a run."""
    return FEW_STEPS if robots >= FULL_SIZES[-1] else STEPS


def time_swarm(engine: str, robots: int, folder: Path) -> dict[str, Any]:
    """Time the swarm step of an engine, and check its initial forces.

    A run of one step is mostly work of the host, the intercept. The slope of longer runs without
    stale lists is the step alone; what moving robots add to it is lists. Their steps take
    as long as the host's work, or are `MOST_LONG` times as many as those of a usual run.
    """
    params, steps = StepParams(), _steps(robots)
    file, farthest, entries = scene_file(robots, folder)
    process = EngineProcess(engine, file)
    row: dict[str, Any] = {"engine": engine, "robots": robots, "note": process.missing}
    if process.missing:
        return row

    def run(count: int, max_step: float) -> tuple[float, int]:
        """Return wall-clock time and the number of lists."""
        answer = process.ask(do="run", steps=count, max_step=max_step)
        return answer["wall_s"], answer["builds"]

    run(steps, params.max_step)  # warms up
    row |= process.ask(do="check")
    precision = np.finfo(ENGINES[engine].precision)
    allowed = ROUNDINGS * precision.eps * (farthest + 1.0)
    row["note"] = "" if row["force_error"] <= allowed else "WRONG"
    longer, host = steps, run(1, STILL)[0]
    while longer < MOST_LONG * steps and run(1 + longer, STILL)[0] < 2.0 * host:
        longer = min(4 * longer, MOST_LONG * steps)
    runs = (1, STILL), (1 + longer, STILL), (1 + longer, params.max_step), (steps, params.max_step)
    taken = np.median([[run(*each) for each in runs] for _ in range(ROUNDS)], axis=0)
    process.stop()
    (one, _), (long, _), (moving, lists), (whole, _) = taken
    # Of a robot: entries and its two rows' numbers; centers and docks, read and written; arms.
    moved = 4.0 * (entries + 6.0) + precision.bits / 8.0 * (6.0 + 3.0 + 9.0 + 24.0)
    alone = 1e9 * (long - one) / (robots * longer)
    row |= {"step_ns": 1e9 * whole / (robots * steps), "step_alone_ns": alone, "call_of_one_s": one}
    row["list_ns"] = 1e9 * (moving - long) / (robots * max(lists - 1, 1))
    row["step_alone_GB_per_s"] = moved / row["step_alone_ns"]
    return row


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


def study(arch: str, robots: int, *, brief: bool) -> dict[str, Any]:
    """Run `together` and `joint` of a study that sweeps `arch`, then once more on the device.

    Returns:
        Time of localization [s] and RMSE [R] by device and method; whether structures are the same
        in both runs, and whether the device gives the same bytes again.
    """
    joint = "chains: 2, steps: 20, hold_steps: 10" if brief else "chains: 4"
    joint = f"localization: {{method: joint, {joint}}}"
    settings = [
        f"structure.movers={max(robots // 100, 1)}",
        f"structure.solve_every={max(robots // 50, 1)}", "seeds=1",
        f"conditions={{together: {{localization.schedule: together}}, joint: {{{joint}}}}}",
    ]  # fmt: skip
    runs: list[dict[tuple[str, str], dict[str, Any]]] = []
    for archs in (dict.fromkeys(("cpu", arch)), (arch,)):
        swept = f"sweep={{robots: [{robots}], arch: [{', '.join(archs)}]}}"
        with tempfile.TemporaryDirectory() as out:
            command = ["run", "scenarios/scaling.yaml", "--no-pictures", "--quiet", "--out", out]
            command += [part for text in (swept, *settings) for part in ("--set", text)]
            subprocess.run(  # noqa: S603 - our own command
                [sys.executable, "-m", "tiswarm", *command], check=True
            )
            folders = sorted(Path(out).glob("*/cases/*"))
            named = {folder: folder.name.split(",")[1:] for folder in folders}
            runs.append({(on[5:], method): _case(f) for f, (on, method) in named.items()})
    row: dict[str, Any] = {"robots": robots}
    for key, file in (("equal_truth", "truth.csv"), ("repeats", "estimate.csv")):
        files = [{place: case["files"][file] for place, case in run.items()} for run in runs]
        row[key] = all(files[0][place] == found for place, found in files[1].items())
    for (on, method), case in runs[0].items():
        row[f"{on}_{method}_s"] = case["localize_s"]
        row[f"{on}_{method}_rmse_R"] = case["scores"]["rmse_R"]
    return row


def _case(folder: Path) -> dict[str, Any]:
    """Read scores, digests and time of localization of a case."""
    cost = json.loads((folder / "cost.json").read_text())
    return json.loads((folder / "case.json").read_text()) | {
        "localize_s": cost["localize"]["wall_s"]
    }


if __name__ == "__main__":
    main()
