"""Imports poses of other simulators as a sensing log and a truth.

A gap is the distance between the surfaces of two docks; overlaps are negative gaps. Each likely
cause of few contacts is tried, and what docks would then do shows it. No cause is corrected unless
an option says so: two errors may look alike.
"""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError
from scipy.optimize import least_squares
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError, require_name
from tiswarm.base.registry import BUILT_IN, get, registered
from tiswarm.base.robot import FIREANT_RHO, TANGENT_RHO, docks_in_plane
from tiswarm.compute.math import dock_offsets
from tiswarm.formats.clocks import ClockShift, shifted_clocks
from tiswarm.formats.columns import EULER, refuse_other_files, turns_by
from tiswarm.formats.geometry import DockGeometry, fit_ground, fit_scale, standing_docks
from tiswarm.formats.motion import (
    LOUDEST,
    Rests,
    find_rests,
    stances_of,
    step_of_noise,
    with_final_rests,
    without_glitches,
)
from tiswarm.formats.poses import (
    TOLERANCE,
    UPWARD,
    Assumptions,
    Poses,
    PoseTable,
    first_names,
    horizontal_mirror,
    poses_by_run,
    read_contacts,
    read_dock_offsets,
    upward,
    with_earlier_first,
)
from tiswarm.formats.ranges import read_ranges
from tiswarm.formats.recordings import read_recording
from tiswarm.formats.rest_noise import noise_of_rests
from tiswarm.formats.segments import Noise
from tiswarm.measurements.contacts import dock_pairs
from tiswarm.measurements.odometry import ASSUMED
from tiswarm.records import sensing_log
from tiswarm.records.io import at_line, make_folder, refuse_special
from tiswarm.records.messages import counted, explain
from tiswarm.records.outputs import NEW, Outputs
from tiswarm.records.positions import write_positions
from tiswarm.records.sensing_file import check_header, write_sensing_log
from tiswarm.records.sensing_format import MOST_CONTACTS

GAINS = (
    "on towers of 100 robots, joint's mean RMSE is 1.0 R from contacts and ground, 0.7 R with "
    "heights, 0.2 R with contacts of stances too (docs/accuracy.md)"
)
"""What heights and stances gain."""


class Imported(NamedTuple):
    """What became of a table of poses."""

    log: sensing_log.SensingLog  # what the robots would have sensed at rest
    position: Reals  # true centers in join order, (N, 3); NaN where they are unknown
    notes: list[str]  # contacts, gaps and what was assumed, in lines
    warnings: list[str]  # why contacts or final poses are probably wrong, in lines


def convert(
    path: Path,
    assumed: Mapping[str, Any],
    *,
    docks: Path | None = None,
    out: Path | None = None,
    overwrite: bool = False,
) -> dict[str, Imported]:
    """Import poses, and write what became of them if `out` is given.

    Args:
        path: File or folder of poses.
        assumed: Fields of `Assumptions`.
        docks: Table of the docks in the body frame, in place of `dock_offset_body`.
        out: Folder to write to; nothing is written if None.
        overwrite: Whether to replace files that exist.

    Raises:
        InputError: a table is malformed, there is no such field, or an output is an
            input, or exists and is to stay.
    """
    for name in assumed:
        require_name(name, [field.name for field in fields(Assumptions)], "assumed")
    body = {} if docks is None else {"dock_offset_body": read_dock_offsets(docks)}
    facts = {name: value for name, value in assumed.items() if value is not None}
    stated = Assumptions(**{**facts, **body})
    if stated.beacons is not None:
        imports = {"": _import_ranges(path, stated, facts.get("dock_radius"))}
    elif stated.orientations is not None:
        imports = {"": _import_recording(path, stated)}
    else:
        imports = import_poses(path, stated)
    if out is not None:
        poses = path.iterdir() if path.is_dir() else [path]
        inputs = [*poses, stated.contacts, docks, stated.beacons]
        inputs += [stated.orientations, stated.ground]
        write_imports(imports, out, Outputs(inputs=inputs, overwrite=overwrite))
    return imports


def import_poses(path: Path, assumed: Assumptions) -> dict[str, Imported]:
    """Turn a table of poses, as `read_table` describes it, into sensing logs and truths.

    Returns:
        What became of each structure, by its name in the column `run`, or "" without that column.

    Raises:
        InputError: a table is malformed or does not contain the anchors.
    """
    table = _read(path, assumed)
    runs = poses_by_run(table, path, shape_error=assumed.largest_gap)
    if assumed.contacts is not None and len(runs) > 1:
        problem = "the poses have several runs; import each with its own contacts"
        raise InputError(problem, path=path, argument="contacts")
    imports = {run: _import_run(path, poses, assumed) for run, poses in runs.items()}
    for imported in imports.values():
        advised = f"--up {assumed.up}"  # what the user did needs no advice
        imported.notes[:0] = [note for note in table.notes if not note.endswith(advised)]
    return imports


def _import_ranges(path: Path, assumed: Assumptions, radius: float | None) -> Imported:
    """Turn tables of ranges and beacons into a log; places of tags are unknown."""
    log, notes, warnings = read_ranges(
        path,
        Path(str(assumed.beacons)),
        columns=assumed.columns,
        sd=assumed.range_sd,
        radius=radius,
        drop_incomplete=assumed.drop_incomplete,
    )
    with at_line(path, 1):
        check_header(log)
    return Imported(log, np.full((log.robot_count, 3), np.nan), notes, warnings)


_OF_RECORDINGS = frozenset(
    {
        *("orientations", "ground", "columns", "anchors", "dock_offset_body", "dock_radius"),
        *("first_dock", "ground_z", "length_unit", "tilt_deg", "yaw_deg"),
    }
)
"""Assumptions that matter where robots recorded contacts and orientations themselves."""


def _import_recording(path: Path, assumed: Assumptions) -> Imported:
    """Turn what robots recorded themselves into a log; their places are unknown."""
    for stated in fields(assumed):
        if stated.name not in _OF_RECORDINGS and getattr(assumed, stated.name) != stated.default:
            problem = "needs poses, which a recording with --orientations lacks; leave it out"
            raise InputError(problem, argument=stated.name)
    log, notes = read_recording(path, assumed)
    log = replace(log, noise=_noise(assumed))
    with at_line(path, 1):
        check_header(log)
    refuse_crowds(log, path)
    notes += [*_describe(log, assumed), log.size]
    return Imported(log, np.full((log.robot_count, 3), np.nan), notes, [])


def _read(path: Path, assumed: Assumptions) -> PoseTable:
    """Read poses in the first format that their file or folder has."""
    return next(table for table in _tables(path, assumed) if table is not None)


def _tables(path: Path, assumed: Assumptions) -> Iterator[PoseTable | None]:
    """Read poses in each format, those of plug-ins first; None where the file has another one."""
    for name in registered("import_format"):
        yield get("import_format", name)(path, assumed)
    refuse_other_files(path)
    for file in path.iterdir() if path.is_dir() else ():
        if file.exists():  # a link to nothing may stand beside what is read
            refuse_special(file)
    for name in BUILT_IN["import_format"]:
        yield get("import_format", name)(path, assumed)


def write_imports(imports: Mapping[str, Imported], out: Path, outputs: Outputs = NEW) -> None:
    """Write `sensing.jsonl` and `truth.csv` of each structure to a folder of its name in `out`.

    There is no truth of tags with ranges.

    Args:
        imports: What became of each structure, by its name.
        out: Folder, which is made if need be.
        outputs: What may be written.

    Raises:
        InputError: an output is an input, or exists and is to stay; then nothing is written.
        EnvironmentTroubleError: `out` cannot be made or written to.
    """
    files = [out / run / "sensing.jsonl" for run in imports]
    files += [out / run / "truth.csv" for run in imports if _is_known(imports[run])]
    outputs.check({"out": files})
    for run, (log, position, *_) in imports.items():
        make_folder(out / run)
        write_sensing_log(log, out / run / "sensing.jsonl", opened=outputs.opened)
        if _is_known(imports[run]):
            write_positions(
                out / run / "truth.csv",
                log.robot_id,
                position,
                length_unit=log.length_unit,
                opened=outputs.opened,
            )


def _is_known(imported: Imported) -> bool:
    """Whether all true positions are known; those of tags with ranges are not."""
    return not np.isnan(imported.position).any()


def _import_run(path: Path, poses: Poses, assumed: Assumptions) -> Imported:
    if assumed.up not in {"z", *UPWARD}:
        problem = f"{assumed.up!r} is no axis; use z, {', '.join(UPWARD)}"
        raise InputError(problem, argument="up")
    if assumed.left_handed:
        poses = poses.right_handed(assumed.up)
        docks = assumed.dock_offset_body
        if docks is not None:
            assumed = replace(assumed, dock_offset_body=docks * horizontal_mirror(assumed.up))
    if assumed.up != "z":
        poses = poses.upright(assumed.up)
    if assumed.conjugate:
        poses = poses.conjugate()
    poses, order_of_numbers = in_likely_order(poses, assumed)
    poses, guessed = with_docks(poses, assumed, path)
    poses, glitches = without_glitches(poses, with_limits(poses, assumed)[0])
    moving, _ = with_limits(poses, assumed)
    is_sure = not any(note.startswith(_NO_OFFSET) for note in guessed)
    at_rest = _at_rest(poses, moving, is_sure=is_sure)
    poses, rests = at_rest.poses, at_rest.rests
    guessed = at_rest.fitted or guessed
    assumed, widened = with_limits(poses, assumed, at_rest.noise_share)
    contacts, gaps, overlaps = find_contacts(poses, assumed)
    if rests is not None:
        assumed, stated = with_noise(assumed, poses, rests, contacts, at_rest.factor)
        widened += stated
    anchors = _anchors(poses, rests, assumed.anchors, path)
    order, joined = _join_order(
        poses, contacts, anchors, rests, drop_disconnected=assumed.drop_disconnected
    )
    stances = None
    early = 0
    shifts: Sequence[ClockShift] = ()
    if rests is not None:
        stances, early = stances_of(rests, poses, order, assumed, moving)
        shifts = shifted_clocks(rests, poses, moving)
    log = _log(poses, contacts, anchors, order, stances, assumed)
    with at_line(path, 1):
        check_header(log)
    refuse_crowds(log, path)
    if log.stances is None:
        size = f"{counted(log.robot_count, 'robot')}, {counted(len(log.contacts), 'contact')}"
    else:
        size = log.size
    notes = [*order_of_numbers, *guessed, *glitches, *widened, *gaps, *joined]
    notes += [*_describe_rests(poses, rests), *_describe(log, assumed), size]
    # Docks at wrong places stand nowhere, so the ground says nothing more.
    in_motion = 0 if rests is None else len(rests.in_motion)
    warnings = at_rest.doubts or few_contacts(poses, assumed, len(contacts), overlaps, in_motion)
    warnings = warnings or _in_one_place(poses, assumed) or off_the_ground(poses, assumed)
    warnings = warnings or doubted_ground(poses, rests, assumed)
    warnings += _unrested(poses, rests)
    warnings += _contradicted(poses, shifts, early)
    return Imported(log, poses.position[order], notes, warnings)


class _AtRest(NamedTuple):
    """Robots at rest."""

    poses: Poses  # final ones
    rests: Rests | None  # None where each robot has one pose
    noise_share: float  # part of the noise of samples that final poses have [1]
    factor: float  # distance of docks by flips and contacts, per that of `poses`
    fitted: list[str]  # what was fitted, in lines
    doubts: list[str]  # what disagrees with what is stated, in lines


def _at_rest(poses: Poses, assumed: Assumptions, *, is_sure: bool) -> _AtRest:
    """Find rests, and the distance of docks from the center where it is not stated.

    Segments of motion need that distance, and it follows from them, so we repeat both.

    Args:
        poses: Robots, whose docks are known or guessed.
        assumed: Limits of contacts, and docks if they are given.
        is_sure: Whether contacts state where docks are.
    """
    is_guess = assumed.dock_offset_body is None and not poses.docks_are_spheres
    least = _SETTLED * assumed.dock_radius
    for _ in range(_FITS if is_guess else 1):
        rests = find_rests(poses, assumed)
        poses, noise_share = with_final_rests(poses, rests)
        scale = fit_scale(poses, rests, assumed)
        is_stated = scale.flips > 0 or is_sure
        if scale.factor is None or poses.docks_are_spheres or not is_stated:
            return _AtRest(poses, rests, noise_share, 1.0, [], [])
        distance = float(np.linalg.norm(poses.dock_offset_body, axis=1).mean())
        offset = scale.factor.scaled(distance)
        if not is_guess:
            doubts = doubted_geometry(poses, scale, assumed)
            return _AtRest(poses, rests, noise_share, scale.factor.value, [], doubts)
        step = abs(offset.value - distance)
        poses = poses._replace(dock_offset_body=docks_in_plane(offset.value))
        if step < least:
            break
    unit = poses.length_unit
    note = f"dock offset {offset} {unit}"
    if scale.flips and scale.contacts:
        rows = f"{counted(scale.flips, 'flip')} and {counted(scale.contacts, 'contact')}"
        note += f", by {rows}"
    elif scale.flips:
        note += f", by {counted(scale.flips, 'flip')}"
    else:
        note += ": most docks touch there"
    if _DOUBTFUL * offset.sd > TOLERANCE * assumed.dock_radius:
        note += "; too uncertain for contacts: record more flips, with rests of a second, or "
        note += "measure it (--dock-offset)"
    doubts = doubted_geometry(poses, scale, assumed)
    return _AtRest(poses, rests, noise_share, 1.0, [note], doubts)


_NO_OFFSET = "no dock offset stands out"

_SETTLED = 1e-3
"""Change of the distance of docks from which on rests are found again [dock radii]."""

_FITS = 4
"""Most times that rests and the distance of docks are found."""

_DOUBTFUL = 2.0
"""Standard deviations of the distance of docks that are to be within the limits of contacts."""

_LEAST_DOUBT = 0.005
"""Largest error of a stated length that is no doubt [dock radii]."""


def doubted_geometry(poses: Poses, scale: DockGeometry, assumed: Assumptions) -> list[str]:
    """Warn of a distance and a radius of docks that flips and contacts contradict."""
    unit = poses.length_unit
    radius = assumed.dock_radius
    least = _LEAST_DOUBT * radius
    distance = float(np.linalg.norm(poses.dock_offset_body, axis=1).mean())
    doubts = []
    factor = scale.factor
    if assumed.dock_offset_body is not None and factor is not None and scale.flips:
        offset = factor.scaled(distance)
        if offset.disagrees(distance, least):
            doubts.append(
                f"docks are {distance:.5g} {unit} from the center as stated, but "
                f"{counted(scale.flips, 'flip')} say {offset}: correct --dock-offset or --docks"
            )
    if not doubts and scale.radius is not None and scale.radius.disagrees(radius, least):
        doubts.append(
            f"docks have a radius of {radius:g} {unit} as stated, but "
            f"{counted(scale.radius.rows, 'contact')} say {scale.radius}: correct --dock-radius"
        )
    return doubts


def doubted_ground(poses: Poses, rests: Rests | None, assumed: Assumptions) -> list[str]:
    """Warn of ground at another height than is stated, or that is tilted."""
    if assumed.ground_z is None:
        return []
    radius = assumed.dock_radius
    ground = fit_ground(standing_docks(poses, rests), assumed.ground_z, radius)
    if ground is None:
        return []
    docks = counted(ground.height.rows, "dock")
    if ground.tilt_deg is not None and ground.tilt_deg.disagrees(0.0, _LEAST_TILT_DEG):
        problem = f"{docks} stand on ground that is tilted by {ground.tilt_deg} deg: "
        return [f"{problem}set the vertical of the recording anew, or turn the poses"]
    if ground.height.disagrees(assumed.ground_z, 0.5 * TOLERANCE * radius):
        return [
            f"{docks} stand at z = {ground.height}, not at {assumed.ground_z:g}: correct --ground-z"
        ]
    return []


_LEAST_TILT_DEG = 0.1
"""Largest tilt of the ground that is no doubt [deg]."""


def _anchors(poses: Poses, rests: Rests | None, names: tuple[int, ...], path: Path) -> list[int]:
    """Find the rows of the robots at known positions; the first is the anchor, and joins first."""
    row = {name: row for row, name in enumerate(poses.robot_id.tolist())}
    for name in names:
        if name not in row:
            problem = f"there is no robot {name}; name one of the file"
            raise InputError(problem, path=path, argument="anchor")
    if poses.join is not None:
        key = "join"
        first = int(poses.join.argmin())
        is_first = np.arange(len(row)) == first
    elif rests is not None:
        key = "time"
        first = int(np.lexsort(rests.arrival)[0])
        is_first = (rests.arrival == rests.arrival[:, [first]]).all(axis=0)
    else:
        key = "anchor"
        first = 0
        is_first = np.ones(len(row), np.bool_)
    anchors = [*dict.fromkeys(row[name] for name in names)] or [first]
    if not is_first[anchors[0]]:
        problem = f"robot {poses.robot_id[first]} joined first, not {names[0]}; name it first"
        raise InputError(problem, path=path, key=key)
    return anchors


def _join_order(
    poses: Poses,
    contacts: Ints,
    anchors: list[int],
    rests: Rests | None,
    *,
    drop_disconnected: bool,
) -> tuple[Ints, list[str]]:
    """Sort robots by join index, or as they reach their final poses, or by hops; say which."""
    neighbors: list[list[int]] = [[] for _ in poses.robot_id]
    for i, _, j, _ in contacts.tolist():
        neighbors[i].append(j)
        neighbors[j].append(i)
    tied = dict.fromkeys(anchors)
    waiting = deque(anchors)
    while waiting:
        new = sorted(
            {neighbor for neighbor in neighbors[waiting.popleft()] if neighbor not in tied}
        )
        tied |= dict.fromkeys(new)
        waiting.extend(new)
    notes = []
    outward = np.array([*tied | dict.fromkeys(range(len(neighbors)))])
    if poses.join is not None:
        order = np.argsort(poses.join, kind="stable")
    elif rests is not None:
        order = outward[np.lexsort(rests.arrival[:, outward])]
        notes.append("no column join: robots join as they reach their final poses")
    else:
        order = outward
        name = poses.robot_id[anchors[0]]
        notes.append(f"no column join: robots join outward from robot {name}, by contacts")
    disconnected = len(neighbors) - len(tied)
    if disconnected:
        fate = "dropped" if drop_disconnected else "kept: drop them with --drop-disconnected"
        notes.append(f"{counted(disconnected, 'robot')} disconnected from the anchor {fate}")
    if drop_disconnected:
        order = order[np.isin(order, [*tied])]
    return order, notes


def _log(
    poses: Poses,
    contacts: Ints,
    anchors: list[int],
    order: Ints,
    stances: sensing_log.Stances | None,
    assumed: Assumptions,
) -> sensing_log.SensingLog:
    """Derive what the robots in `order` would have sensed at rest."""
    count = len(order)
    join_index = np.full(len(poses.robot_id), -1)
    join_index[order] = np.arange(count)
    logged = contacts.astype(np.int32)
    logged[:, [0, 2]] = join_index[contacts[:, [0, 2]]]
    logged = logged[(logged[:, [0, 2]] >= 0).all(axis=1)]
    least, greatest = assumed.level
    height = poses.docks[order, :, 2]
    standing = np.argwhere((height >= least) & (height <= greatest)).astype(np.int32)
    further_anchors = sorted(anchors[1:], key=lambda row: join_index[row])
    fixes = [
        (join_index[row], *axis, coordinate, sensing_log.KNOWN_SD * assumed.dock_radius, -1)
        for row in further_anchors
        for axis, coordinate in zip(np.eye(3), poses.position[row], strict=True)
    ]
    return sensing_log.SensingLog(
        robot_id=poses.robot_id[order],
        dock_radius=assumed.dock_radius,
        dock_offset_body=poses.dock_offset_body,
        anchor_position=poses.position[order[0]],
        orientation_wxyz=poses.orientation_wxyz[order],
        contacts=sensing_log.canonical_contacts(with_earlier_first(logged)),
        ground_z=assumed.ground_z,
        ground_docks=standing,
        fixes=np.array(fixes).reshape(-1, 7),
        flip_height=poses.position[order, 2] if assumed.heights else np.full(count, np.nan),
        spawn_position=np.full((count, 3), np.nan),
        stances=stances,
        noise=_noise(assumed),
        length_unit=poses.length_unit,
    )


def _noise(assumed: Assumptions) -> sensing_log.SensingNoise | None:
    """State the noise of orientations if it is given."""
    tilt = assumed.tilt_deg
    yaw = assumed.yaw_deg
    if tilt is None and yaw is None:
        return None
    try:
        return sensing_log.SensingNoise(
            tilt_deg=ASSUMED.tilt_deg if tilt is None else tilt,
            yaw_deg=ASSUMED.yaw_deg if yaw is None else yaw,
        )
    except ValidationError as error:
        mistake = error.errors(include_url=False)[0]
        raise InputError(explain(mistake), key=str(mistake["loc"][0])) from error


def _describe_rests(poses: Poses, rests: Rests | None) -> Iterator[str]:
    """Say in lines what became of poses over time."""
    if rests is None or poses.samples is None:
        return
    stances = counted(len(rests.position) - len(poses.robot_id), "stance")
    samples = counted(len(poses.samples.time), "pose")
    yield f"{stances} before the final poses, from {samples} over time"
    if rests.unseen:
        yield f"{counted(rests.unseen, 'stance')} without a pose: where flips beside a gap lead"
    if len(rests.cut):
        why = "no flip about a dock leads from them to later ones"
        yield f"earlier poses of {_named(poses, rests.cut)} left out: {why}"


def _unrested(poses: Poses, rests: Rests | None) -> Iterator[str]:
    """Warn of robots that move to the end of their tracks."""
    if rests is not None and len(rests.in_motion):
        robots = _named(poses, rests.in_motion)
        yield f"the tracks of {robots} end in motion, not at final poses; record until they rest"


_MOST_SHIFTS = 3
"""Robots whose clocks a warning names."""


def _contradicted(poses: Poses, shifts: Sequence[ClockShift], early: int) -> Iterator[str]:
    """Warn of clocks that contradict one another, and of the contacts that they cost."""
    problems = []
    if early:
        contacts = f"{counted(early, 'contact')} of stances left out"
        problems.append(f"{contacts}: by the time, the other robot had not arrived")
    if shifts:
        named = [
            f"time shift of robot {poses.robot_id[shift.robot]} against "
            f"{first_names(poses.robot_id[shift.others].tolist())}: at least {shift.least:+.3g}, "
            f"by {counted(shift.flips, 'flip')}"
            for shift in shifts
        ]
        problems.append(
            f"flips hold on to robots that arrive later: {'; '.join(named[:_MOST_SHIFTS])}"
        )
    if problems:
        remedy = "if robots have clocks of their own, set them to one, or give a column join"
        yield "; ".join([*problems, remedy])


def _in_one_place(poses: Poses, assumed: Assumptions) -> list[str]:
    """Warn of robots whose docks are in one place, as of a body that changed its name."""
    pair = dock_pairs(poses.docks, assumed.dock_radius)[:, [0, 2]]
    if not len(pair):
        return []
    robots = [f"{a} and {b}" for a, b in np.unique(poses.robot_id[pair], axis=0).tolist()]
    problem = (
        f"docks of these robots are in one place: {first_names(robots)}; if they are one body, "
    )
    return [f"{problem}give it one name"]


def _named(poses: Poses, robots: Ints) -> str:
    """Count robots and name the first ones."""
    return f"{counted(len(robots), 'robot')} ({first_names(poses.robot_id[robots].tolist())})"


def _describe(log: sensing_log.SensingLog, assumed: Assumptions) -> Iterator[str]:
    """Say in lines what a log lacks, by which options it would have it, and what it would gain."""
    has_poses = assumed.orientations is None
    ground = "--ground-z" if has_poses else "--ground"
    has_ground = assumed.ground_z is not None if has_poses else assumed.ground is not None
    lacking = []
    if not len(log.ground_docks):
        lacking.append("ground contacts" if has_ground else f"ground contacts ({ground})")
    if np.isnan(log.flip_height).all():
        lacking.append("heights (--heights)" if has_poses else "heights")
    if log.stances is None:
        lacking.append("stances")
    if log.noise is None:
        lacking.append("noise (--tilt-deg, --yaw-deg)")
    if lacking:
        yield f"the log lacks {', '.join(lacking)}"
    if log.stances is None:
        yield GAINS


FARTHEST_SHOWN = 0.5
"""Gaps and overlaps up to this many dock radii are in the histogram."""

_EDGES = np.array([-0.5, -0.2, -0.1, -0.05, -0.02, -0.01, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5])
"""Edges of its bins [dock radii]."""

_LONGEST_BAR = 40
_LONGEST_OFFSET = 10.0
"""Dock offsets up to this many dock radii are guessed."""

_NEAREST = 12
"""Nearest robots whose docks may touch a robot's docks when the offset is guessed."""

_STANDS_OUT = 2.0
"""A guess has at least this many times the contacts of any other offset."""


_WIDEST = 0.25
"""Largest limit of gaps and overlaps that is found [dock radii]."""

_STEPS_OF_NOISE = 2.0
"""Largest error of a gap, in the median step of the dock that moves most: about 3.5 standard
deviations of a gap."""

_STEP = 1.1
"""Ratio of limits that are tried."""

_FEWEST_OVERLAPS = 10
"""Overlaps in the peak from which on there is a limit to find."""

_MARGIN = 1.3
"""Largest error of a gap, per largest error that was seen as an overlap."""

_RARE = 0.02
"""Share of overlaps in the valley, up to twice the limit, beside those within it."""


def surface_gaps(docks: Reals, pair: Ints, radius: float) -> Reals:
    """Measure gaps from surface to surface, shape (n,).

    Args:
        docks: Centers of the docks, shape (N, D, 3).
        pair: Rows of (robot, its dock, other robot, its dock), shape (n, 4).
        radius: Radius of a dock sphere.
    """
    i, a, j, b = pair.T
    gap: Reals = np.linalg.norm(docks[i, a] - docks[j, b], axis=1) - 2.0 * radius
    return gap


def guess_dock_offset(
    position: Reals, orientation_wxyz: Reals, radius: float, width: float
) -> float | None:
    """Guess how far three docks in a plane are from the center: where most docks touch.

    Docks p + rho u of two robots touch at the roots rho of |p' - p + rho (u' - u)| = 2 radius. We
    return the median of the densest window of roots, if there are enough: one for every second
    robot, and twice as many as in any other window.

    Args:
        position: Centers, shape (N, 3).
        orientation_wxyz: Body to world, unit quaternions, shape (N, 4).
        radius: Radius of a dock sphere.
        width: Sum of the largest gap and the largest overlap of a contact.
    """
    count = len(position)
    _, near = cKDTree(position).query(position, k=min(count, _NEAREST + 1))
    robot = np.repeat(np.arange(count), near.size // count)
    pairs = np.unique(np.sort(np.stack([robot, near.ravel()]), axis=0), axis=1)
    i, j = pairs[:, pairs[0] != pairs[1]]
    arm = dock_offsets(orientation_wxyz, docks_in_plane(1.0))
    between = (position[j] - position[i])[:, None, None]
    spread = arm[j][:, None] - arm[i][:, :, None]
    # The roots of a rho^2 + 2 b rho + c.
    a = (spread**2).sum(axis=-1)
    b = (between * spread).sum(axis=-1)
    c = (between**2).sum(axis=-1) - 4.0 * radius**2
    square = b**2 - a * c
    has_roots = (a > 1e-9) & (square >= 0.0)  # noqa: PLR2004 - parallel arms have no root
    a = a[has_roots]
    b = b[has_roots]
    half = np.sqrt(square[has_roots])
    roots = np.sort(np.concatenate([-b - half, -b + half]) / np.tile(a, 2))
    roots = roots[(roots > (TANGENT_RHO - 1e-3) * radius) & (roots < _LONGEST_OFFSET * radius)]
    if not roots.size:
        return None
    counts = np.searchsorted(roots, roots + width, side="right") - np.arange(roots.size)
    best = counts.argmax()
    offset = float(np.median(roots[best : best + counts[best]]))
    counts_elsewhere = counts[np.abs(roots - offset) > 2.0 * width]
    if counts[best] < max(0.5 * count, _STANDS_OUT * counts_elsewhere.max(initial=0)):
        return None
    return float(f"{offset:.4g}")


def contact_limit(gap: Reals, radius: float, least: float) -> float | None:
    """Find the limit of the gaps and overlaps of contacts in the valley beyond their peak.

    Rigid docks do not overlap: overlaps are errors, as of rounded poses, and gaps of contacts have
    errors of the same size. The valley is where hardly any larger overlaps follow.

    Args:
        gap: Gaps of close docks.
        radius: Radius of a dock sphere.
        least: Least limit.

    Returns:
        The limit; None if there are too few overlaps or no valley, as for a wrong robot geometry.
    """
    overlap = -gap[gap < 0.0]
    limit = least
    while limit <= _WIDEST * radius:
        inside = (overlap <= limit).sum()
        beyond = overlap[(overlap > limit) & (overlap <= 2.0 * limit)]
        if inside >= _FEWEST_OVERLAPS and len(beyond) <= _RARE * inside:
            return limit if limit == least else float(f"{_MARGIN * max([limit, *beyond]):.2g}")
        limit *= _STEP
    return None


def histogram(
    gap: Reals, radius: float, *, largest_gap: float, largest_overlap: float, unit: str
) -> Iterator[str]:
    """Draw how many docks have which gap, in lines; contacts have bars of `#`, other gaps of `.`.

    Args:
        gap: Gaps of close docks.
        radius: Radius of a dock sphere.
        largest_gap: Largest gap of a contact; a further edge of the bins.
        largest_overlap: Largest overlap of a contact; a further edge of the bins.
        unit: Name of the unit of all lengths.
    """
    edges = np.unique(
        np.concatenate([_EDGES * radius, [0.0 - largest_overlap, largest_gap]]).round(12)
    )
    number, _ = np.histogram(gap, edges)
    filled = np.flatnonzero(number)
    if not filled.size:
        return
    yield f"gaps between docks [{unit}], contacts marked #:"
    for k in range(filled[0], filled[-1] + 1):
        touches = edges[k] >= -largest_overlap and edges[k + 1] <= largest_gap
        length = int(np.ceil(_LONGEST_BAR * number[k] / number.max()))
        bar = length * ("#" if touches else ".")
        yield f"{edges[k]:>9.3g} to {edges[k + 1]:<8.3g}{number[k]:>6} {bar}".rstrip()


_LEAST_NOISE_DEG = 1e-3
"""Orientations that vary by less are exact, but for rounding [deg]."""

ENOUGH = 0.5
"""Fewer contacts per robot point to a wrong robot geometry."""

FAR_MORE = 2.0
"""Contacts by another meaning of the poses, per contact as stated, that point to that meaning."""


def with_docks(
    poses: Poses, assumed: Assumptions, path: Path | None = None
) -> tuple[Poses, list[str]]:
    """Add the docks in the body frame, and say where they are a guess.

    Raises:
        InputError: the file has docks, and offsets of docks are given.
    """
    radius = assumed.dock_radius
    body = assumed.dock_offset_body
    poses = poses._replace(length_unit=poses.length_unit or assumed.length_unit)
    if len(poses.dock_offset_body):
        if body is None:
            return poses, []
        problem = "the spheres are the docks; leave out offsets of docks"
        raise InputError(problem, path=path, key="sphere")
    if body is not None:
        return poses._replace(dock_offset_body=body), []
    width = assumed.largest_gap + assumed.largest_overlap
    offset = guess_dock_offset(poses.position, poses.orientation_wxyz, radius, width)
    if offset is not None:
        note = f"dock offset {offset:g} {poses.length_unit}: most docks touch there"
    else:
        offset = FIREANT_RHO * radius
        note = f"{_NO_OFFSET}: {offset:g} {poses.length_unit}, FireAntV3's, is assumed"
    return poses._replace(dock_offset_body=docks_in_plane(offset)), [note]


def with_limits(
    poses: Poses, assumed: Assumptions, noise_share: float = 1.0
) -> tuple[Assumptions, list[str]]:
    """Set limits of gap and overlap that are not given, and say so where errors widen them.

    Args:
        poses: Robots, whose docks are known.
        assumed: Limits that are given.
        noise_share: Part of the noise of samples that final poses have [1].
    """
    if assumed.gap is not None and assumed.overlap is not None:
        return assumed, []
    radius = assumed.dock_radius
    least = TOLERANCE * radius
    samples = poses.samples
    why = "about as far, docks overlap by errors of the poses"
    if samples is not None:
        docks = samples.docks(poses.dock_offset_body)
        step = noise_share * step_of_noise(docks, samples.robot, LOUDEST * radius)
        if _STEPS_OF_NOISE * step > least:
            least = float(f"{_STEPS_OF_NOISE * step:.2g}")
            why = f"docks at rest vary by about {0.5 * step:.2g}"
    pair = dock_pairs(poses.docks, (2.0 + FARTHEST_SHOWN) * radius)
    limit = contact_limit(surface_gaps(poses.docks, pair, radius), radius, least) or least
    if limit == TOLERANCE * radius:
        return assumed, []
    gap = limit if assumed.gap is None else assumed.gap
    overlap = limit if assumed.overlap is None else assumed.overlap
    text = f"contacts have gaps up to {gap:g} and overlaps up to {overlap:g} {poses.length_unit}"
    return replace(assumed, gap=gap, overlap=overlap), [f"{text}: {why}"]


def with_noise(
    assumed: Assumptions, poses: Poses, rests: Rests, contacts: Ints, factor: float
) -> tuple[Assumptions, list[str]]:
    """State the noise of orientations at rest, unless it is given or none is seen, and say so.

    Arguments as for `noise_of_rests`.
    """
    missing = [name for name in ("tilt", "yaw") if getattr(assumed, f"{name}_deg") is None]
    noise = noise_of_rests(poses, rests, contacts, factor) if missing else None
    if noise is None or rests.noise is None:
        return assumed, []
    of_samples = _in_degrees(rests.noise)
    if max(of_samples.values()) < _LEAST_NOISE_DEG:
        return assumed, []
    at_rest = _in_degrees(noise)

    def listed(angles: Mapping[str, float], names: Sequence[str]) -> str:
        return " and ".join(f"{angles[name]:g} deg of {name}" for name in names)

    text = f"orientations vary by {listed(of_samples, [*of_samples])} (1 sd); the log states what "
    text += f"their means at rest vary by, {listed(at_rest, missing)}; "
    text += f"{' and '.join(f'--{name}-deg' for name in missing)} state others"
    if "tilt" in missing:
        assumed = replace(assumed, tilt_deg=at_rest["tilt"])
    if "yaw" in missing:
        assumed = replace(assumed, yaw_deg=at_rest["yaw"])
    return assumed, [text]


def _in_degrees(noise: Noise) -> dict[str, float]:
    """Return noise of tilt and yaw [deg], to two digits."""
    angles = {"tilt": noise.tilt, "yaw": noise.yaw}
    return {name: float(f"{np.degrees(angle):.2g}") for name, angle in angles.items()}


def in_likely_order(poses: Poses, assumed: Assumptions) -> tuple[Poses, list[str]]:
    """Read quaternions in the other order where far more docks touch so, and say so."""
    if poses.other_order == 0:
        return poses, []
    robots = len(poses.robot_id)
    as_written = count_touching(poses, assumed)
    if as_written >= ENOUGH * robots:
        return poses, []
    reordered = poses.reordered()
    as_reordered = count_touching(reordered, assumed)
    if as_reordered < max(ENOUGH * robots, FAR_MORE * as_written):
        return poses, []
    names = "x, y, z, w" if poses.other_order == 1 else "w, x, y, z"
    gain = f"{counted(as_reordered, 'contact')} instead of {as_written}"
    note = f"quaternions read as {names}, though columns have the other order: {gain}"
    return reordered, [f"{note}; rename the columns"]


def count_touching(poses: Poses, assumed: Assumptions) -> int:
    """Count docks in contact, at offsets that are given or guessed.

    The count is 0 if no offset stands out, or if more docks overlap: they are rigid.
    """
    radius = assumed.dock_radius
    dock_offset_body = assumed.dock_offset_body
    if dock_offset_body is None:
        width = assumed.largest_gap + assumed.largest_overlap
        offset = guess_dock_offset(poses.position, poses.orientation_wxyz, radius, width)
        if offset is None:
            return 0
        dock_offset_body = docks_in_plane(offset)
    docks = poses._replace(dock_offset_body=dock_offset_body).docks
    gap = surface_gaps(docks, dock_pairs(docks, 2.0 * radius + assumed.largest_gap), radius)
    touching = int((gap >= -assumed.largest_overlap).sum())
    return touching if 2 * touching >= len(gap) else 0


def find_contacts(poses: Poses, assumed: Assumptions) -> tuple[Ints, list[str], int]:
    """Find contacts, describe gaps, and count the docks that overlap by more.

    Contacts are rows of (robot, dock, later robot, its dock), shape (n, 4).
    """
    radius = assumed.dock_radius
    unit = poses.length_unit
    largest_gap = assumed.largest_gap
    largest_overlap = assumed.largest_overlap
    if assumed.contacts is None:
        shown = max(largest_gap, FARTHEST_SHOWN * radius)
        pair = dock_pairs(poses.docks, 2.0 * radius + shown)
    else:
        pair = read_contacts(assumed.contacts, poses)
    gap = surface_gaps(poses.docks, pair, radius)
    is_apart = gap > largest_gap
    overlaps = gap < -largest_overlap
    notes = [
        *histogram(gap, radius, largest_gap=largest_gap, largest_overlap=largest_overlap, unit=unit)
    ]
    if overlaps.any():
        count = counted(overlaps.sum(), "overlap")
        notes.append(f"{count} of two docks by more than {largest_overlap:g} {unit}")
    if assumed.contacts is None:
        pair = pair[~is_apart & ~overlaps]
    elif is_apart.any():
        count = counted(is_apart.sum(), "listed contact")
        notes.append(f"{count} with a gap of more than {largest_gap:g} {unit}")
    return pair, notes, int(overlaps.sum())


def refuse_crowds(log: sensing_log.SensingLog, path: Path) -> None:
    """Refuse more contacts of a dock than a log may have."""
    docks = len(log.dock_offset_body)
    ends = log.contacts.reshape(-1, 2) @ [docks, 1]
    number = np.bincount(ends, minlength=1)
    most = int(number.max())
    if most > MOST_CONTACTS:
        robot, dock = divmod(int(number.argmax()), docks)
        problem = f"dock {dock} of robot {log.robot_id[robot]} has {most} contacts, more than "
        remedy = f"{MOST_CONTACTS}; correct radius and offset of docks, or give smaller limits"
        raise InputError(problem + remedy, path=path)


_MOST_ROBOTS = 200
"""Robots for which causes are tried; more would show nothing else."""

_OFF_CENTER = 1.0
"""Largest coordinate of a tracked point in the body frame that is tried [dock radii]."""

_SHIFT = 0.5
"""Step between tried coordinates of that point [dock radii]."""

_NEAR = 0.4
"""Largest gap and overlap of docks that a step may put in contact [dock radii]."""

_BEST = 12
"""Number of tried points that are refined: those that put most docks in contact."""

_UNKNOWNS = 3


def few_contacts(
    poses: Poses, assumed: Assumptions, contacts: int, overlaps: int, in_motion: int = 0
) -> list[str]:
    """Warn of too few contacts, or more overlaps than contacts, and say what may be the cause.

    Args:
        poses: Robots, whose docks are known or guessed.
        assumed: Limits of contacts, and docks if they are given.
        contacts: Number of docks in contact.
        overlaps: Number of docks that overlap by more.
        in_motion: Number of robots that move at the end, and touch nothing yet.
    """
    robots = len(poses.robot_id)
    at_rest = robots - in_motion
    if at_rest <= 1 or (contacts >= ENOUGH * at_rest and contacts >= overlaps):
        return []
    counts = f"{counted(contacts, 'contact')} and {counted(overlaps, 'overlap')}"
    problem = f"{counted(robots, 'robot')} have {counts} of docks; "
    usual = "correct --dock-radius and --dock-offset, or give larger --gap and --overlap"
    # Spheres are docks wherever the frame of the body is.
    # Where more docks overlap, contacts are chance.
    believed = contacts if contacts >= overlaps else 0
    cause = "" if poses.docks_are_spheres else _likely_cause(poses, assumed, believed)
    return [problem + (cause or usual)]


_SCALES = (1000.0, 100.0, 10.0, 25.4, 2.0)
"""Ratios of units that are mixed up, and of a diameter to a radius."""


def _likely_cause(poses: Poses, assumed: Assumptions, contacts: int) -> str:
    """Name the other meaning of poses that would make far more docks touch; empty if none would."""
    poses = poses.nearest(_MOST_ROBOTS)
    least = max(ENOUGH * len(poses.robot_id), FAR_MORE * contacts, 1.0)
    tree = len(poses.robot_id) - 1.0  # contacts of a structure without cycles
    for reading, what, remedy in _readings(poses, assumed):
        touching = count_touching(reading, assumed)
        if touching >= max(least, tree):
            return f"{what} {touching}: {remedy}"
    if assumed.dock_offset_body is not None:
        for scale in (*_SCALES, *(1.0 / scale for scale in _SCALES)):
            docks = assumed.dock_offset_body * scale
            touching = count_touching(poses, replace(assumed, dock_offset_body=docks))
            if touching >= max(least, tree):
                return (
                    f"docks {scale:.4g} times as far from the center give {touching}: give them "
                    f"in {poses.length_unit}, the unit of the poses"
                )
    quarter_turns = Rotation.create_group("O")
    for k in range(1, len(quarter_turns)):
        turn = quarter_turns[k]
        turned = poses.turned(turn)
        touching = count_touching(turned, assumed)
        if touching >= least:
            without_docks = turned._replace(dock_offset_body=np.empty((0, 3)))
            with_guess, _ = with_docks(without_docks, assumed)
            return _by_docks(turn.apply(with_guess.dock_offset_body), touching)
    moved = poses.dock_offset_body + _off_center(poses, assumed)
    touching = count_touching(poses, replace(assumed, dock_offset_body=moved))
    # Fitted unknowns put as many docks in contact by chance.
    if touching >= max(least, tree + _UNKNOWNS):
        return _by_docks(moved, touching)
    return ""


def _readings(poses: Poses, assumed: Assumptions) -> Iterator[tuple[Poses, str, str]]:
    """Yield poses as they would be by another convention, what would give contacts, and a remedy.

    These are conventions of orientations first, then of units and of handedness.
    """
    turned, remedy = "world to body", "add --conjugate"
    if assumed.conjugate:
        turned, remedy = "body to world", "leave --conjugate out"
    yield poses.conjugate(), f"quaternions that turn {turned} give", remedy
    if poses.other_order:
        statement = f"quaternions in the other order that turn {turned} give"
        yield poses.reordered().conjugate(), statement, f"rename the columns, and {remedy}"
    if poses.angles is not None:
        yield from _readings_of_angles(poses, poses.angles)
    for scale in (*_SCALES, *(1.0 / scale for scale in _SCALES)):
        size = f"{assumed.dock_radius / scale:.4g}"
        remedy = f"give --dock-radius {size}, and docks in that unit"
        scaled = poses._replace(position=poses.position * scale)
        yield scaled, f"a dock radius of {size} in the unit of the poses gives", remedy
    for axis, name in enumerate("xyz"):
        for scale in (*_SCALES[:-1], *(1.0 / scale for scale in _SCALES[:-1])):
            position = poses.position * np.where(np.arange(3) == axis, scale, 1.0)
            remedy = f"the axes have different units; multiply {name} by {scale:.4g}"
            yield poses._replace(position=position), f"{name} times {scale:.4g} gives", remedy
        position = poses.position * np.where(np.arange(3) == axis, -1.0, 1.0)
        remedy = "positions and orientations have frames of different hands; export both alike"
        yield poses._replace(position=position), f"{name} reversed gives", remedy
    if assumed.dock_offset_body is not None:
        mirrored = poses.right_handed("z")  # the docks are not
        yield mirrored, "docks of the mirror image give", "reverse y in --docks"


def _readings_of_angles(poses: Poses, angles: Reals) -> Iterator[tuple[Poses, str, str]]:
    """Yield poses by angles in each order and unit, what would give contacts, and a remedy."""
    orders = [*EULER, *(order.swapcase() for order in EULER), "rotvec"]
    for scale, unit in ((1.0, ""), (np.pi / 180.0, "deg"), (180.0 / np.pi, "rad")):
        for order in orders:
            turned = poses._replace(orientation_wxyz=turns_by(scale * angles, order))
            if unit:
                what = f"angles in {unit}, read as {order}, give"
                remedy = f"write [{unit}] behind their names, and give --euler {order}"
            else:
                what = f"angles read as {order} give"
                remedy = f"give --euler {order}"
            yield turned, what, remedy


def _by_docks(offset: Reals, touching: int) -> str:
    """Name the offsets at which docks would touch, and the remedy."""
    places = ", ".join(f"({x:.4g}, {y:.4g}, {z:.4g})" for x, y, z in (offset + 0.0).tolist())
    statement = f"docks at {places} in the body frame give {touching}: "
    return f"{statement}measure them, and give them by --docks"


def off_the_ground(poses: Poses, assumed: Assumptions) -> list[str]:
    """Warn if no dock stands on the ground, or if far more do with another axis up."""
    if assumed.ground_z is None:
        return []
    standing, below = _on_ground(poses, assumed)
    by_axis = {up: _on_ground(poses.upright(up), assumed) for up in UPWARD}
    standing_by_axis = {
        up: count.standing if count.below == 0 else 0 for up, count in by_axis.items()
    }
    up = max(by_axis, key=standing_by_axis.__getitem__)
    most_standing = standing_by_axis[up]
    explains = below > 0 and most_standing >= max(1, FAR_MORE * standing)
    if standing and not explains:
        return []
    docks = f"{standing or 'no'} dock{'s stand' if standing > 1 else ' stands'}"
    problem = f"{docks} on the ground at z = {assumed.ground_z:g}, and {below} of "
    problem += f"{poses.docks[..., 0].size} are below it"
    if explains:
        problem += f"; with {up} up, {most_standing} stand and none is below: "
        axis = _axis_of_file(up, assumed.up)
        return [problem + ("leave --up out" if axis == "z" else f"give --up {axis}")]
    lowest = float(poses.docks[..., 2].min()) - assumed.dock_radius
    return [f"{problem}; the lowest reaches to z = {lowest:.4g}: correct --ground-z or --up"]


def _axis_of_file(up: str, turned: str) -> str:
    """Name an axis of poses as it was before another axis of theirs became z.

    >>> _axis_of_file("-z", "y"), _axis_of_file("y", "y")
    ('-y', '-z')
    """
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    names = ["x", "y", "z", "-x", "-y", "-z"]
    along = axes[names.index(up)]
    if turned != "z":
        along = upward(turned).inv().apply(along)
    return names[int((axes @ along).argmax())]


class _OnGround(NamedTuple):
    """Numbers of docks."""

    standing: int
    below: int


def _on_ground(poses: Poses, assumed: Assumptions) -> _OnGround:
    """Count the docks that stand on the ground and those below it."""
    least, greatest = assumed.level
    height = poses.docks[..., 2]
    below = height < least
    return _OnGround(int((~below & (height <= greatest)).sum()), int(below.sum()))


def _off_center(poses: Poses, assumed: Assumptions) -> Reals:
    """Find by how much docks are off their places in the body frame, all alike, shape (3,).

    Steps at which most docks nearly touch, and none, are refined by the docks that do.
    """
    turn = Rotation.from_quat(poses.orientation_wxyz, scalar_first=True).as_matrix()
    axis = assumed.dock_radius * np.arange(-_OFF_CENTER, _OFF_CENTER + 0.5 * _SHIFT, _SHIFT)
    grid = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    order = np.argsort([-len(_close(poses.docks, turn, step, assumed)) for step in grid])
    refined = []
    for step in [np.zeros(3), *grid[order[:_BEST]]]:
        offset = step
        for _ in range(2):  # docks that touch are others after the first time
            pair = _close(poses.docks, turn, offset, assumed)
            if len(pair) >= _UNKNOWNS:
                offset = _refined(poses.docks, turn, offset, pair, assumed.dock_radius)
        refined.append(offset)

    def touching(offset: Reals) -> int:
        moved = poses.dock_offset_body + offset
        return count_touching(poses, replace(assumed, dock_offset_body=moved))

    return max(refined, key=touching)


def _close(docks: Reals, turn: Reals, offset: Reals, assumed: Assumptions) -> Ints:
    """List the docks that nearly touch where all are off by a vector in the body frame."""
    docks = docks + (turn @ offset)[:, None]
    pair = dock_pairs(docks, (2.0 + _NEAR) * assumed.dock_radius)
    return pair[surface_gaps(docks, pair, assumed.dock_radius) >= -_NEAR * assumed.dock_radius]


def _refined(docks: Reals, turn: Reals, offset: Reals, pair: Ints, radius: float) -> Reals:
    """Let most of the docks of some pairs touch, shape (3,)."""

    def misfit(offset: Reals) -> Reals:
        return surface_gaps(docks + (turn @ offset)[:, None], pair, radius) / radius

    solution = least_squares(  # type: ignore[operator]
        misfit, offset, loss="cauchy", f_scale=TOLERANCE
    )
    return np.asarray(solution.x)
