"""Recordings of known swarms, as motion capture makes them, and what the import finds in them.

    python -m benchmarks.recordings                     # the table of docs/accuracy.md
    python -m benchmarks.recordings --seeds 1 --localize
    python -m benchmarks.recordings --wrong-offsets     # who notices a wrong dock offset
    python -m benchmarks.recordings --write take.csv    # one recording, a row for each pose

A tower grows; robots walk to their places one after the other. Each robot rests at a stance, then
turns about its pivot by a smooth ramp. Cameras record all robots at one rate, with noise, and lose
single poses. The table counts the stances that come back: those with the orientation, within 3 deg,
and the pivot of a true one, in the order of time. `invented` are stances beside these. Errors of
the dock offset have the unit of the recording, mm. Orientations are those of stances and final
poses, about all three axes; the log states their sd, for tilt and yaw.
"""

import argparse
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation, Slerp

import tiswarm
from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.evaluation.metrics import robot_errors
from tiswarm.formats.imports import Imported, import_poses
from tiswarm.formats.poses import Assumptions
from tiswarm.localization.methods import localize
from tiswarm.localization.settings import JointParams
from tiswarm.records.estimate import MOST_WITHIN
from tiswarm.records.sensing_log import SensingLog, SensingNoise

RADIUS_MM = 32.9
RHO = 1.45
"""Distance of docks from the center [R]: no robot that the import could assume has it."""

_SAME_DEG = 3.0
"""Largest angle between two orientations of one stance."""

_LAST_S = 2.0
"""Time for which all robots are recorded at rest in the end."""


class Camera(NamedTuple):
    """How motion is recorded."""

    noise_mm: float = 0.3  # sd of each coordinate of a center
    noise_deg: float = 0.2  # sd of an orientation about each axis
    rate_hz: float = 30.0
    lost: float = 0.02  # share of poses
    flip_s: float = 1.5  # time of a flip
    rest_s: float = 1.0  # time at a stance
    bias_mm: float = 0.0  # sd of what all poses of a rest share, of each coordinate of a center
    bias_deg: float = 0.0  # and of an orientation about each axis


class Walks(NamedTuple):
    """The S stances of all robots, the final ones too, by robot and then by time."""

    robot: Ints  # (S,)
    center: Reals  # [mm], (S, 3)
    orientation_wxyz: Reals  # (S, 4)
    pivot: Ints  # dock that stays put as the robot leaves, (S,)


def grown(robots: int, seed: int, rho: float = RHO) -> Walks:
    """Grow a tower, whose robots rest at known poses.

    Args:
        robots: Number of robots.
        seed: Seed of growth.
        rho: Distance of docks from the center [R].
    """
    swarm = tiswarm.grow("tower", robots=robots, seeds=[seed], robot={"rho": rho}, quiet=True)
    stances = swarm.stances
    return Walks(
        np.asarray(stances.robot, np.int64),
        RADIUS_MM * np.asarray(stances.center),
        np.asarray(stances.orientation_wxyz),
        np.asarray(stances.pivot_dock, np.int64),
    )


def recorded(walks: Walks, camera: Camera, seed: int, rho: float = RHO) -> pd.DataFrame:
    """Record the walks of all robots, a row for each pose.

    Args:
        walks: Stances of all robots.
        camera: Noise, rate and losses.
        seed: Seed of noise and losses.
        rho: Distance of docks from the center [R].

    Returns:
        Columns time [s], robot, x_mm to z_mm, qw to qz.
    """
    offset = RADIUS_MM * RobotGeometry(rho=rho).dock_offset_body
    tracks = []
    first_frame = []
    frame = 0
    for robot in range(int(walks.robot.max()) + 1):
        track = _track(walks, np.flatnonzero(walks.robot == robot), camera, offset)
        tracks.append(track)
        first_frame.append(frame)
        frame += len(track.stage)
    last_frame = frame + int(_LAST_S * camera.rate_hz)
    rng = np.random.default_rng(seed)
    parts = []
    for robot, (stage, center, turn) in enumerate(tracks):
        all_frames = np.arange(first_frame[robot], last_frame)
        frames = all_frames[rng.random(len(all_frames)) >= camera.lost]
        row = np.minimum(frames - first_frame[robot], len(center) - 1)
        noise = rng.normal(0.0, 1.0, (2, len(row), 3))
        shift = camera.noise_mm * noise[0]
        swing = camera.noise_deg * noise[1]
        if camera.bias_mm or camera.bias_deg:
            bias = _interpolated(rng.normal(0.0, 1.0, (2, int(stage[-1]) + 1, 3)), stage[row])
            shift += camera.bias_mm * bias[0]
            swing += camera.bias_deg * bias[1]
        wxyz = (Rotation.from_rotvec(np.radians(swing)) * turn[row]).as_quat(scalar_first=True)
        pose = np.column_stack([center[row] + shift, wxyz])
        part = pd.DataFrame(pose, columns=["x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"])
        part.insert(0, "robot", robot)
        part.insert(0, "time", (frames / camera.rate_hz).tolist())
        parts.append(part)
    return pd.concat(parts, ignore_index=True)


class _Track(NamedTuple):
    """A robot at each of F frames, from its first stance on."""

    stage: Reals  # number of its stance, with the share of the way to the next one, (F,)
    center: Reals  # [mm], (F, 3)
    turn: Rotation  # body to world, (F,)


def _interpolated(values: Reals, stage: Reals) -> Reals:
    """Interpolate values at stances, (2, stances, 3), for the flips between, (2, F, 3)."""
    before = stage.astype(np.int64)
    after = np.minimum(before + 1, values.shape[1] - 1)
    share = (stage - before)[:, None]
    return np.asarray((1.0 - share) * values[:, before] + share * values[:, after])


def _track(walks: Walks, rows: Ints, camera: Camera, offset: Reals) -> _Track:
    """Let a robot rest at its stances, and flip between them."""
    turn = Rotation.from_quat(walks.orientation_wxyz[rows], scalar_first=True)
    rest_frames = max(1, round(camera.rest_s * camera.rate_hz))
    ramp = np.linspace(0.0, 1.0, max(2, round(camera.flip_s * camera.rate_hz)))[1:-1]
    share = ramp * ramp * (3.0 - 2.0 * ramp)
    stages = []
    centers = []
    turns = []
    for k, row in enumerate(rows.tolist()):
        stages.append(np.full(rest_frames, float(k)))
        centers.append(np.repeat(walks.center[[row]], rest_frames, axis=0))
        turns.append(Rotation.concatenate([turn[k]] * rest_frames))
        if k + 1 < len(rows) and len(share):
            arm = offset[walks.pivot[row]]
            pivot = walks.center[row] + turn[k].apply(arm)
            moving = Slerp([0.0, 1.0], turn[k : k + 2])(share)
            stages.append(k + share)
            centers.append(pivot - moving.apply(arm))
            turns.append(moving)
    return _Track(np.concatenate(stages), np.concatenate(centers), Rotation.concatenate(turns))


class Count(NamedTuple):
    """Stances before the final poses."""

    true: int
    found: int  # true ones that the import has
    invented: int  # further ones that it has


def counted_stances(walks: Walks, log: SensingLog) -> Count:
    """Compare the stances of a log, whose robots have the numbers of the walks, with the truth."""
    true = 0
    found = 0
    listed = 0
    row_of = {name: row for row, name in enumerate(log.robot_id.tolist())}
    for robot in range(int(walks.robot.max()) + 1):
        rows = np.flatnonzero(walks.robot == robot)[:-1]
        true += len(rows)
        if log.stances is None or robot not in row_of:
            continue
        row = row_of[robot]
        of_robot = slice(*log.stances.start[row : row + 2])
        listed += of_robot.stop - of_robot.start
        turn = Rotation.from_quat(walks.orientation_wxyz[rows], scalar_first=True)
        logged = log.stances.orientation_wxyz[of_robot]
        if len(rows) and len(logged):
            imported = Rotation.from_quat(logged, scalar_first=True)
            angle = np.stack([(turn[k] * imported.inv()).magnitude() for k in range(len(rows))])
            same = angle <= np.radians(_SAME_DEG)
            same &= walks.pivot[rows][:, None] == log.stances.pivot_dock[of_robot]
            found += _longest_common(same)
    return Count(true, found, int(listed) - found)


def _longest_common(same: Any) -> int:  # noqa: ANN401 - Bools
    """Return the length of the longest common subsequence of rows and columns."""
    length = np.zeros(np.add(same.shape, 1), np.int64)
    for i, j in np.ndindex(same.shape):
        longer = length[i, j] + 1 if same[i, j] else 0
        length[i + 1, j + 1] = max(longer, length[i, j + 1], length[i + 1, j])
    return int(length[-1, -1])


def orientation_errors(walks: Walks, log: SensingLog) -> Reals:
    """Compare orientations at rest with the nearest true ones [deg], shape (n, 3)."""
    row_of = {name: row for row, name in enumerate(log.robot_id.tolist())}
    errors = []
    for robot in range(int(walks.robot.max()) + 1):
        rows = np.flatnonzero(walks.robot == robot)
        true = Rotation.from_quat(walks.orientation_wxyz[rows], scalar_first=True)
        row = row_of[robot]
        earlier = log.earlier.orientation_wxyz[slice(*log.earlier.start[row : row + 2])]
        logged = Rotation.from_quat([*earlier, log.orientation_wxyz[row]], scalar_first=True)
        for k in range(len(logged)):
            apart = (logged[k] * true.inv()).as_rotvec(degrees=True)
            nearest = apart[np.linalg.norm(apart, axis=1).argmin()]
            if np.linalg.norm(nearest) <= _SAME_DEG:
                errors.append(nearest)
    return np.array(errors).reshape(-1, 3)


def imported(recording: pd.DataFrame, folder: Path, **assumed: Any) -> Imported:  # noqa: ANN401
    """Import a recording of robots of the radius of `grown`, on the ground."""
    file = folder / "recording.csv"
    recording.to_csv(file, index=False, float_format="%.6f")
    facts = {"dock_radius": RADIUS_MM, "ground_z": 0.0, "heights": True, **assumed}
    return import_poses(file, Assumptions(**facts))[""]


CASES = {
    "no noise": Camera(0.0, 0.0, lost=0.0),
    "0.1 mm, 0.05 deg": Camera(0.1, 0.05),
    "**0.3 mm, 0.2 deg, 30 Hz, 2 % lost, flips of 1.5 s**": Camera(),
    "1 mm, 0.5 deg": Camera(1.0, 0.5),
    "10 Hz": Camera(rate_hz=10.0),
    "120 Hz": Camera(rate_hz=120.0),
    "none lost": Camera(lost=0.0),
    "10 % lost": Camera(lost=0.1),
    "flips of 0.5 s": Camera(flip_s=0.5),
    "flips of 3 s": Camera(flip_s=3.0),
    "rests of 0.2 s": Camera(rest_s=0.2),
    "bias of 0.1 mm and 0.07 deg": Camera(bias_mm=0.1, bias_deg=0.07),
    "bias of 0.2 mm": Camera(bias_mm=0.2),
    "bias of 0.1 deg": Camera(bias_deg=0.1),
}
"""Recordings of the table; what a row does not name is as in the third one. A bias is the sd of an
error that all poses of a rest share."""


def main() -> None:
    """Print a row for each kind of recording."""
    options = _options()
    backend.start(threads=1)
    if options.write:
        recording = recorded(grown(options.robots, 0), Camera(), 0)
        recording.to_csv(options.write, index=False, float_format="%.6f")
        return
    if options.wrong_offsets:
        _tell_wrong_offsets(options)
        return
    columns = "| recording | true stances | found % | invented % | offset off by mm | stated +- |"
    columns += " orientations off by deg | stated +- |"
    columns += " error / with true geometry |" if options.localize else ""
    print(columns)
    print("|---" * (columns.count("|") - 1) + "|")
    for name in options.cases or CASES:
        print(f"| {' | '.join([name, *_row(CASES[name], options)])} |", flush=True)


def _row(camera: Camera, options: argparse.Namespace) -> Iterator[str]:
    """Yield the cells of a row."""
    counts = []
    errors = []
    stated = []
    turns = []
    stated_turns = []
    ratios = []
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        walks = grown(options.robots, seed)
        recording = recorded(walks, camera, seed)
        with tempfile.TemporaryDirectory() as folder:
            result = imported(recording, Path(folder))
            counts.append(counted_stances(walks, result.log))
            offset = float(np.linalg.norm(result.log.dock_offset_body, axis=1).mean())
            errors.append(abs(offset - RHO * RADIUS_MM))
            stated += _stated_sd(result.notes)
            turns.append(orientation_errors(walks, result.log))
            if result.log.noise is not None:
                stated_turns.append(_stated_turn(result.log.noise))
            if options.localize:
                body = RADIUS_MM * RobotGeometry(rho=RHO).dock_offset_body
                exact = imported(recording, Path(folder), dock_offset_body=body)
                ratios.append((median_error(walks, result), median_error(walks, exact)))
    true, found, invented = np.sum(counts, axis=0).tolist()
    yield f"{true}"
    yield f"{100 * found / true:.1f}"
    yield f"{100 * invented / true:.1f}"
    yield f"{np.max(errors):.3f}"
    yield f"{np.max(stated):.3f}" if stated else "-"
    yield f"{_rms(np.concatenate(turns)):.3f}"
    yield f"{_rms(np.array(stated_turns)):.3f}" if stated_turns else "-"
    if options.localize:
        ours, best = np.mean(ratios, axis=0).tolist()
        yield f"{ours:.2f} / {best:.2f} mm"


def _stated_sd(notes: list[str]) -> list[float]:
    """Return what the import says of the uncertainty of the dock offset."""
    stated = (re.match(r"dock offset \S+ \+- (\S+) ", note) for note in notes)
    return [float(match[1]) for match in stated if match]


def _stated_turn(noise: SensingNoise) -> float:
    """Return the root of the mean square about three axes [deg]."""
    return float(np.sqrt((2.0 * noise.tilt_deg**2 + noise.yaw_deg**2) / 3.0))


def _rms(values: Reals) -> float:
    return float(np.sqrt((values**2).mean()))


_OFFSET_ERRORS_MM = (0.0, 0.2, 0.35, 0.5)


def _tell_wrong_offsets(options: argparse.Namespace) -> None:
    """Print a row for each error of a stated dock offset: who names it, and what sd is worth."""
    print("| offset off by mm | recordings | import warns | localize: not consistent |", end="")
    print(" offset named, within 3 sd | trusted | of these within 90 % spheres |")
    print("|---" * 7 + "|")
    body = RADIUS_MM * RobotGeometry(rho=RHO).dock_offset_body
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    for error in _OFFSET_ERRORS_MM:
        warned = doubted = named = trusted = 0
        inside: list[bool] = []
        for seed in seeds:
            walks = grown(options.robots, seed)
            recording = recorded(walks, Camera(), seed)
            stated = (1.0 + error / (RHO * RADIUS_MM)) * body
            with tempfile.TemporaryDirectory() as folder:
                result = imported(recording, Path(folder), dock_offset_body=stated)
            estimate = localize(result.log, JointParams())
            verdict = estimate.convergence
            warned += any("from the center as stated" in text for text in result.warnings)
            doubted += verdict is not None and verdict.consistent is False
            named += any(
                cause.parameter == "dock offset"
                and abs(cause.value - RHO * RADIUS_MM) <= 3.0 * cause.sd
                for cause in estimate.common_causes
            )
            if verdict is not None and verdict.trusted and estimate.sd is not None:
                trusted += 1
                off = robot_errors(estimate.position, _truth(walks, result.log))
                inside += (off <= MOST_WITHIN * estimate.sd)[1:].tolist()
        share = f"{100.0 * np.mean(inside):.0f} % of {len(inside)}" if inside else "-"
        print(
            f"| {error:g} | {len(seeds)} | {warned} | {doubted} | {named} | {trusted} | {share} |"
        )


def _truth(walks: Walks, log: SensingLog) -> Reals:
    """Return the true final centers of the robots of a log [mm], shape (N, 3)."""
    last = np.flatnonzero(np.append(np.diff(walks.robot) > 0, True))
    return walks.center[last][log.robot_id]


def median_error(walks: Walks, result: Imported) -> float:
    """Localize a log, and return the median distance from true places [mm]."""
    estimate = localize(result.log, JointParams())
    return float(np.median(robot_errors(estimate.position, _truth(walks, result.log))))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--cases", nargs="*", choices=CASES, help="rows (default: all)")
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--seeds", type=int, default=3, help="towers of each row")
    parser.add_argument("--first-seed", type=int, default=11)
    parser.add_argument("--localize", action="store_true", help="also localize, with joint")
    parser.add_argument("--wrong-offsets", action="store_true", help="state dock offsets wrongly")
    parser.add_argument("--write", type=Path, help="write the recording of seed 0, and stop")
    return parser.parse_args()


if __name__ == "__main__":
    main()
