"""Poses of robots, of any simulator or motion-capture system, and tables of docks and contacts."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.compute.math import dock_offsets
from tiswarm.records.io import CsvFile
from tiswarm.records.sensing_file import FAR_FROM_UNIT

_Contacts = TypeVar("_Contacts", NDArray[np.int32], NDArray[np.int64])

TOLERANCE = 0.02
"""Largest gap and overlap of a contact unless stated otherwise [dock radii]."""


@dataclass(frozen=True, kw_only=True)
class Assumptions:
    """Facts that a table of poses does not state; lengths in its own unit."""

    dock_radius: float = 1.0
    dock_offset_body: Reals | None = None
    """Center to dock in the body frame, shape (D, 3); None for the three docks in a plane at which
    most docks touch. A table of spheres needs none."""

    gap: float | None = None
    """Largest gap of two docks in contact; if None, 2 % of the dock radius, or more where errors
    of the poses make docks overlap by more."""

    overlap: float | None = None
    """Largest overlap of two docks in contact; as for `gap` if None."""

    contacts: Path | None = None
    """Table `robot,dock,other,other_dock` of all contacts; found from the gaps if None."""

    anchors: tuple[int, ...] = ()
    """Names of robots at known positions, the anchor first; the first robot to join, or of the
    file, if there are none."""

    up: str = "z"
    """Axis of the poses that is up: x, y, z, -x, -y or -z; it becomes z."""

    conjugate: bool = False
    """Whether quaternions turn the world frame to the body's, instead of body to world."""

    ground_z: float | None = None
    """Height of flat ground; None where there is none."""

    heights: bool = False
    """Whether the robots know the heights of their centers."""

    left_handed: bool = False
    """Whether the frame of the poses is left-handed; one horizontal axis is then reversed."""

    euler: str = ""
    """Order of angles, as `turns_by` has it; empty where the file or its columns imply it."""

    columns: Mapping[str, str] = field(default_factory=dict)
    """Columns of the table by what they mean, `x` or `robot` for example, where names do not say
    so."""

    topic: str = ""
    """Topics of a bag of ROS that have the poses, as a shell's pattern; found if empty."""

    bodies: str = ""
    """Names of the bodies of a bag of ROS that are robots, as a shell's pattern; all if empty."""

    orientations: Path | None = None
    """Table of orientations over time, where the file has contacts that robots recorded."""

    ground: Path | None = None
    """Table of docks on the ground beside it."""

    first_dock: int | None = None
    """Number of the first dock in these tables, 0 or 1; found if None."""

    beacons: Path | None = None
    """Table of beacons, where the file has ranges instead of poses."""

    range_sd: float | None = None
    """Standard deviation of a range, where the file states none."""

    drop_disconnected: bool = False
    """Whether to drop the robots that contacts do not connect to an anchor."""

    drop_incomplete: bool = False
    """Whether to drop rows that lack a number, instead of refusing them."""

    glitch_frames: int = 10
    """Most poses in a row that are left out as one error of tracking; 0 keeps all."""

    tilt_deg: float | None = None
    """Standard deviation of orientations about horizontal axes [deg]; stated if not None."""

    yaw_deg: float | None = None
    """Standard deviation of orientations about the vertical [deg]; stated if not None."""

    length_unit: str = "unit"
    """Unit of lengths where the columns do not name it."""

    @property
    def largest_gap(self) -> float:
        """Largest gap of two docks in contact."""
        return TOLERANCE * self.dock_radius if self.gap is None else self.gap

    @property
    def largest_overlap(self) -> float:
        """Largest overlap of two docks in contact."""
        return TOLERANCE * self.dock_radius if self.overlap is None else self.overlap

    @property
    def spacing(self) -> Reals:
        """Least and greatest distance of the centers of two docks in contact, shape (2,)."""
        return 2.0 * self.dock_radius + np.array([-self.largest_overlap, self.largest_gap])

    @property
    def level(self) -> Reals:
        """Least and greatest height of the center of a dock on the ground; NaN without, (2,)."""
        ground = math.nan if self.ground_z is None else self.ground_z
        return ground + self.dock_radius + np.array([-self.largest_overlap, self.largest_gap])


SD_PER_MEDIAN_DEVIATION = 1.4826
"""Standard deviation of a normal distribution, per median of its absolute deviations."""

QUATERNION = ["qw", "qx", "qy", "qz"]


class PoseTable(NamedTuple):
    """Poses, or spheres, of all robots in the order of their file."""

    rows: pd.DataFrame
    """Columns `robot`, `x`, `y`, `z`, then `qw`, `qx`, `qy`, `qz` or `sphere`; `join` and `time`
    where the file has them; `line`, and `run` with the name of the structure; `a1`, `a2`, `a3`
    [rad] where it has angles."""

    length_unit: str
    """Unit of lengths as the columns name it; empty where they do not."""

    quaternion_order: Sequence[str]
    """Columns of the quaternion in the order of the file; none of spheres and angles."""

    notes: Sequence[str] = ()
    """What was left out, in lines."""

    dock_offset_body: Reals | None = None
    """Center to dock in the body frame, shape (D, 3); None where the file has no docks."""


_OTHER_ORDER: dict[tuple[str, ...], int] = {
    ("qw", "qx", "qy", "qz"): 1,
    ("qx", "qy", "qz", "qw"): -1,
}
"""Places by which wxyz turn around where numbers in such columns have the other order."""


UPWARD = {
    "y": (0.5, "x"),
    "x": (-0.5, "y"),
    "-z": (1.0, "x"),
    "-y": (-0.5, "x"),
    "-x": (0.5, "y"),
}
"""By the axis that is up, the turn that makes it z: half turns, and the axis of the turn."""


def upward(up: str) -> Rotation:
    """Return the turn by which an axis, a key of `UPWARD`, becomes z."""
    half_turns, axis = UPWARD[up]
    return Rotation.from_euler(axis, 180.0 * half_turns, degrees=True)


def horizontal_mirror(up: str) -> Reals:
    """Return the signs of x, y and z that reverse a horizontal axis, shape (3,)."""
    return np.array([1.0, 1.0, -1.0] if up.endswith("y") else [1.0, -1.0, 1.0])


_MOST_NAMED = 5
"""Robots that a note names."""


def first_names(names: Sequence[object]) -> str:
    """List the first names, and count the others."""
    listed = ", ".join(str(name) for name in names[:_MOST_NAMED])
    if len(names) > _MOST_NAMED:
        return f"{listed} and {len(names) - _MOST_NAMED} more"
    return listed


class Samples(NamedTuple):
    """S poses over time, by robot and then by time."""

    robot: Ints  # row of the robot in `Poses`, (S,)
    time: Reals  # on one clock for all robots, (S,)
    position: Reals  # (S, 3)
    orientation_wxyz: Reals  # (S, 4)

    def docks(self, dock_offset_body: Reals) -> Reals:
        """Locate docks at offsets (D, 3) from the center, shape (S, D, 3)."""
        return self.position[:, None] + dock_offsets(self.orientation_wxyz, dock_offset_body)


class Poses(NamedTuple):
    """N robots in the order of their file, in its unit of length."""

    robot_id: Ints  # (N,)
    position: Reals  # centers, the last ones of poses over time, (N, 3)
    orientation_wxyz: Reals  # body to world, (N, 4)
    dock_offset_body: Reals  # (D, 3); no rows where the file has poses, not spheres
    join: Ints | None  # rank of each robot in join order, (N,); None where the file has none
    length_unit: str  # as the columns name it; empty where they do not
    samples: Samples | None = None  # all poses; None where each robot has one
    other_order: int = 0  # turns wxyz into the other order of the same numbers; 0 if there is none
    angles: Reals | None = None  # angles that state orientations [rad], (N, 3)
    docks_are_spheres: bool = False  # whether the file has the docks, not orientations

    @property
    def docks(self) -> Reals:
        """Centers of the docks, shape (N, D, 3)."""
        return self.position[:, None] + dock_offsets(self.orientation_wxyz, self.dock_offset_body)

    def reordered(self) -> "Poses":
        """Read the numbers of each quaternion in the other order."""
        return self._mapped(lambda wxyz: np.roll(wxyz, self.other_order, axis=1))

    def conjugate(self) -> "Poses":
        """Read quaternions as turns from world to body."""
        return self._mapped(lambda wxyz: wxyz * [1.0, -1.0, -1.0, -1.0])

    def turned(self, turn: Rotation) -> "Poses":
        """Turn the frame of each body."""
        return self._mapped(lambda wxyz: _wxyz(_rotation(wxyz) * turn))

    def upright(self, up: str) -> "Poses":
        """Turn the world so that an axis, a key of `UPWARD`, becomes z."""
        turn = upward(up)
        return self._mapped(lambda wxyz: _wxyz(turn * _rotation(wxyz)), turn.apply)

    def right_handed(self, up: str) -> "Poses":
        """Reverse the horizontal axis of a left-handed world, and that of bodies."""
        sign = horizontal_mirror(up)
        mirrored = self._mapped(
            lambda wxyz: wxyz * [1.0, *(-sign)],
            lambda position: position * sign,
        )
        return mirrored._replace(dock_offset_body=self.dock_offset_body * sign)

    def nearest(self, most: int) -> "Poses":
        """Return the robots that are nearest to the first one, without samples."""
        distance = np.linalg.norm(self.position - self.position[0], axis=1)
        near = np.sort(distance.argsort(kind="stable")[:most])
        return self._replace(
            robot_id=self.robot_id[near],
            position=self.position[near],
            orientation_wxyz=self.orientation_wxyz[near],
            angles=None if self.angles is None else self.angles[near],
            samples=None,
        )

    def _mapped(
        self,
        orientation: Callable[[Reals], Reals],
        position: Callable[[Reals], Reals] | None = None,
    ) -> "Poses":
        """Map all orientations, and positions."""
        mapped = self._replace(orientation_wxyz=orientation(self.orientation_wxyz))
        if position is not None:
            mapped = mapped._replace(position=position(self.position))
        samples = self.samples
        if samples is None:
            return mapped
        samples = samples._replace(orientation_wxyz=orientation(samples.orientation_wxyz))
        if position is not None:
            samples = samples._replace(position=position(samples.position))
        return mapped._replace(samples=samples)


def poses_by_run(table: PoseTable, path: Path, *, shape_error: float) -> dict[str, Poses]:
    """Gather the rows of each robot, structure by structure.

    A robot of spheres has its center at their mean; the first robot of a structure defines the body
    frame. One sphere is a dock at the center.

    Args:
        table: Poses or spheres.
        path: Their file.
        shape_error: Largest distance of a sphere from its place in the first robot's shape.

    Returns:
        Poses of each structure by its name, or by "" without a column `run`.

    Raises:
        InputError: a robot has several rows of a time, or none of a sphere, or a quaternion of
            another length than 1.
    """
    return {
        str(run): _poses(rows, table, path, shape_error)
        for run, rows in table.rows.groupby("run", sort=False)
    }


def read_dock_offsets(path: Path) -> Reals:
    """Read a table `dock,x,y,z` of a robot's docks in the body frame, shape (D, 3).

    Lengths are in the unit of the poses; docks are numbered from 0.

    Raises:
        InputError: the table is malformed.
    """
    table = CsvFile(path)
    if {*table.columns} != {"dock", *"xyz"}:
        problem = "the columns are not dock,x,y,z, in the unit of the poses; rename them"
        raise InputError(problem, path=path, line=1)
    number = table.integers("dock")
    offset = np.column_stack([table.numbers(axis) for axis in "xyz"])
    if sorted(number) != list(range(len(number))):
        problem = f"docks {sorted(number.tolist())} are not numbered 0, 1, ...; renumber them"
        raise InputError(problem, path=path, line=2, key="dock")
    ordered: Reals = offset[number.argsort()]
    return ordered


def read_contacts(path: Path, poses: Poses) -> Ints:
    """Read a table `robot,dock,other,other_dock` of docks in contact.

    Returns:
        Rows of (robot, its dock, later robot, its dock), robots counted from 0, shape (n, 4).

    Raises:
        InputError: the table is malformed, or a robot or dock does not exist.
    """
    table = CsvFile(path)
    columns = ["robot", "dock", "other", "other_dock"]
    if {*table.columns} != {*columns}:
        problem = f"the columns are not {','.join(columns)}; rename them"
        raise InputError(problem, path=path, line=1)
    contacts = np.column_stack([table.integers(name) for name in columns])
    docks = len(poses.dock_offset_body)
    row_of = {name: row for row, name in enumerate(poses.robot_id.tolist())}
    for k, (robot, dock, partner, partner_dock) in enumerate(contacts.tolist()):
        unknown = [name for name in (robot, partner) if name not in row_of]
        problem = ""
        if unknown:
            problem = f"there is no robot {unknown[0]} in the poses; correct it"
        elif robot == partner:
            problem = f"robot {robot} cannot touch itself; name another robot"
        elif not (0 <= dock < docks and 0 <= partner_dock < docks):
            problem = f"docks count from 0 to {docks - 1}; correct dock or other_dock"
        if problem:
            raise InputError(problem, path=path, line=table.line(k))
        contacts[k, [0, 2]] = [row_of[robot], row_of[partner]]
    return np.unique(with_earlier_first(contacts), axis=0)


def with_earlier_first(contacts: _Contacts) -> _Contacts:
    """Turn rows of (robot, its dock, robot, its dock), (n, 4), so that the earlier robot leads."""
    turned = contacts.copy()
    is_later = contacts[:, 0] > contacts[:, 2]
    turned[is_later] = contacts[is_later][:, [2, 3, 0, 1]]
    return turned


def _rotation(wxyz: Reals) -> Rotation:
    return Rotation.from_quat(wxyz, scalar_first=True)


def _wxyz(turn: Rotation) -> Reals:
    return turn.as_quat(scalar_first=True)


def _poses(rows: pd.DataFrame, table: PoseTable, path: Path, shape_error: float) -> Poses:
    keys = ["robot", "time"] if "time" in rows else ["robot"]
    rows = _by_robot(rows, keys, path)
    pose = rows.drop_duplicates(keys)
    points = rows[[*"xyz"]].to_numpy(float).reshape(len(pose), -1, 3)
    position = points.mean(axis=1)
    if "sphere" in rows:
        dock_offset_body = points[0] - position[0]
        orientation = _align(points - position[:, None], pose, path, shape_error)
    else:
        dock_offset_body = np.empty((0, 3))
        if table.dock_offset_body is not None:
            dock_offset_body = table.dock_offset_body
        orientation = unit_quaternions(pose, path)
    robot, names = pd.factorize(pose["robot"])
    last = np.flatnonzero(~pose["robot"].duplicated(keep="last"))
    samples = None
    if len(last) < len(pose):
        samples = Samples(robot, pose["time"].to_numpy(float), position, orientation)
    return Poses(
        robot_id=np.asarray(names, np.int64),
        position=position[last],
        orientation_wxyz=orientation[last],
        dock_offset_body=dock_offset_body,
        join=pose["join"].to_numpy(np.int64)[last] if "join" in pose else None,
        length_unit=table.length_unit,
        samples=samples,
        other_order=_OTHER_ORDER.get(tuple(table.quaternion_order), 0),
        angles=pose[["a1", "a2", "a3"]].to_numpy(float)[last] if "a1" in pose else None,
        docks_are_spheres="sphere" in rows,
    )


def _by_robot(table: pd.DataFrame, keys: list[str], path: Path) -> pd.DataFrame:
    """Gather the rows of each robot, sorted by time and sphere; all have the same spheres."""
    has_spheres = "sphere" in table
    repeated = table[table.duplicated([*keys, "sphere"] if has_spheres else keys)]
    if len(repeated):
        first = repeated.iloc[0]
        what = f"sphere {first['sphere']} of robot" if has_spheres else "robot"
        when = f" at time {first['time']:g}" if "time" in keys else ""
        remedy = "keep one"
        if not when:
            remedy += ", or give the time of each in a column time (--column time=NAME)"
        problem = f"{what} {repeated['robot'].iloc[0]} has a row already{when}; {remedy}"
        file = Path(first.get("file", path))  # one of a folder
        raise InputError(problem, path=file, line=int(first["line"]))
    if not has_spheres and "time" not in keys:
        return table
    robot, _ = pd.factorize(table["robot"])
    sort_keys = ["sphere"] if has_spheres else []
    if "time" in keys:
        sort_keys.append("time")
    table = table.iloc[np.lexsort((*(table[name].to_numpy() for name in sort_keys), robot))]
    if has_spheres:
        _refuse_other_spheres(table, keys, path)
    return table


def _refuse_other_spheres(table: pd.DataFrame, keys: list[str], path: Path) -> None:
    """Raise InputError where a robot has other spheres than the first one."""
    first: list[int] = []
    for _, rows in table.groupby(keys, sort=False):
        spheres = rows["sphere"].tolist()
        first = first or spheres
        if spheres != first:
            robot = rows["robot"].iloc[0]
            problem = f"robot {robot} has spheres {spheres}, the first robot {first}; complete it"
            raise InputError(problem, path=path, line=int(rows["line"].min()), key="sphere")


def unit_quaternions(table: pd.DataFrame, path: Path) -> Reals:
    """Scale quaternions to length 1; refuse those whose length is far from it."""
    quaternion = table[QUATERNION].to_numpy()
    length = np.linalg.norm(quaternion, axis=1)
    far = np.flatnonzero(~(np.abs(length - 1.0) <= FAR_FROM_UNIT))
    if len(far):
        problem = f"the quaternion has length {length[far[0]]:.6g}; scale it to 1, write more "
        problem += "digits, or delete the row if the body was lost"
        raise InputError(problem, path=path, line=int(table["line"].iloc[far[0]]), key="qw")
    unit: Reals = quaternion / length[:, None]
    return unit


def _align(offset: Reals, first: pd.DataFrame, path: Path, shape_error: float) -> Reals:
    """Rotate the first robot's shape onto each robot, whose spheres are at `offset`, (N, D, 3).

    This is the best rotation (Kabsch 1976), and any of these where spheres are in one line.
    """
    u, _, vt = np.linalg.svd(np.einsum("nda,db->nab", offset, offset[0]))
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
    rotation = u @ vt
    misfit = np.linalg.norm(offset[0] @ rotation.swapaxes(1, 2) - offset, axis=2).max(axis=1)
    if not (misfit <= shape_error).all():
        worst = int(np.argmax(~(misfit <= shape_error)))
        row = first.iloc[worst]
        problem = (
            f"the spheres of robot {row['robot']} are up to {misfit[worst]:.3g} off the first "
            "robot's shape; give rigid robots of one shape, or a larger --gap"
        )
        raise InputError(problem, path=path, line=int(row["line"]))
    wxyz: Reals = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
    return wxyz
