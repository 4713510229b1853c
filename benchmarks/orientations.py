"""Measures how flips limit orientations, and how vibrations name neighbors.

    python -m benchmarks.orientations              # all tables; four minutes
    python -m benchmarks.orientations names --seeds 2

The tables are those of docs/notes/orientations.md. Structures have the default settings. Noise is
1 deg of tilt, and 2 deg of yaw where a table has no other. Seeds count from 0.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from tiswarm.base.robot import RobotGeometry
from tiswarm.measurements.flips import fit_orientations, flip_axes
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import SensingParams, observe
from tiswarm.sensing.params import Vibration
from tiswarm.world.growth import grow
from tiswarm.world.history import History, Walk
from tiswarm.world.params import CantileverParams, ClimbParams, TowerParams

KINDS = {"tower": TowerParams, "cantilever": CantileverParams}
AXES = 6
"""Axes of each dock that FireAntV3 flips about."""

YAWS = (2.0, 5.0, 10.0)
TURNS = (0.0, 0.5, 1.0, 2.0, 4.0)
"""Standard deviations of turns that are no flips [deg]."""

SLOTS = (8, 16, 32, 64)
ROBOTS = (25, 50, 100, 200)
FLIPS = 4
_FLIP = ClimbParams()
_ROUNDING = 1e-9
_LEVEL = 1e-6
"""Height [R] up to which a dock is on the ground."""

Row = dict[str, Any]


@cache
def grown(kind: str, seeds: int, robots: int = 100) -> tuple[History, ...]:
    """Grow structures of the default settings."""
    return tuple(
        grow(KINDS[kind](), robots=robots, seeds=list(range(seeds)), robot=RobotGeometry())
    )


def angles(seeds: int) -> Iterator[Row]:
    """Count angles of flips that end on the ground alone, and of those that end at a robot."""
    for kind in KINDS:
        found: dict[bool, list[float]] = {False: [], True: []}
        for walk in (each for history in grown(kind, seeds) for each in history.walks):
            touching = {*walk.contacts[:, 0].tolist()}
            q = Rotation.from_quat(walk.orientation_wxyz, scalar_first=True)
            turns = (q[:-1].inv() * q[1:]).magnitude() if walk.pivot_dock.size else ()
            for k, turn in enumerate(turns):
                found[k + 1 in touching].append(np.degrees(turn))
        for at_robot, each in found.items():
            equal = len({*np.round(each, 3)})
            end = "at a robot" if at_robot else "on the ground alone"
            yield {"structure": kind, "flips that end": end, "flips": len(each), "angles": equal}


def lattice(_: int) -> Iterator[Row]:
    """Count orientations that robots alone on flat ground can have, by flips since the spawn."""
    start = Rotation.identity()
    seen, last = {_key(start)}, [start]
    body = RobotGeometry().dock_offset_body
    for flips in range(1, FLIPS + 1):
        new = {}
        for q in last:
            for end in _landed(q, body):
                if _key(end) not in seen:
                    seen.add(_key(end))
                    new[_key(end)] = end
        last = [*new.values()]
        q = np.array([*seen])
        half = KDTree(np.concatenate([q, -q])).query(q, k=2)[0][:, 1] / 2
        nearest = np.degrees(4 * np.arcsin(np.minimum(half, 1)))
        median = round(float(np.median(nearest)), 1)
        yield {"flips": flips, "orientations": len(seen), "nearest other one [deg]": median}


def _key(q: Rotation) -> tuple[float, ...]:
    """Name an orientation, equal within rounding."""
    return tuple(np.round(q.as_quat(canonical=True), 6) + 0.0)


def _landed(q: Rotation, body: np.ndarray) -> Iterator[Rotation]:
    """List the orientations after a flip on flat ground, until another dock comes down to it."""
    height = q.apply(body)[:, 2]
    for pivot in np.flatnonzero(height < height.min() + _LEVEL):
        for axis in q.apply(flip_axes(body, AXES)[pivot]):
            for about in (axis, -axis):
                arms = q.apply(np.delete(body, pivot, axis=0) - body[pivot])
                ends = [end for arm in arms for end in _down(arm, about)]
                if ends:
                    yield Rotation.from_rotvec(min(ends) * about) * q


def _down(arm: np.ndarray, axis: np.ndarray) -> Iterator[float]:
    """List the angles [rad] at which the end of an arm that turns comes down to its start."""
    along = arm @ axis * axis
    across = arm - along
    side = np.cross(axis, arm)
    # The height of the end is across cos(t) + side sin(t) + along.
    size = np.hypot(across[2], side[2])
    if abs(along[2]) > size + _ROUNDING or size < _ROUNDING:
        return
    middle, half = np.arctan2(side[2], across[2]), np.arccos(np.clip(-along[2] / size, -1, 1))
    for t in ((middle + half) % (2 * np.pi), (middle - half) % (2 * np.pi)):
        sinks = side[2] * np.cos(t) - across[2] * np.sin(t) < _ROUNDING
        if sinks and _FLIP.min_flip_deg < np.degrees(t) < _FLIP.max_flip_deg:
            yield t


def fitted(seeds: int) -> Iterator[Row]:
    """Compare errors of sensed and fitted final orientations."""
    for kind in KINDS:
        for yaw in YAWS:
            row: Row = {"structure": kind, "yaw noise [deg]": yaw}
            yield row | _errors(
                grown(kind, seeds), SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=yaw)
            )


def slipped(seeds: int) -> Iterator[Row]:
    """Fit orientations of robots that slip at each flip, or that their structure turns later."""
    changes: dict[str, Callable[[int], slice]] = {
        "each flip": lambda stances: slice(1, stances),
        "after the last flip": lambda stances: slice(stances - 1, stances),
    }
    for kind in KINDS:
        for when, those in changes.items():
            for sd in TURNS:
                rng = np.random.default_rng(1)
                changed = [
                    replace(each, walks=tuple(_turned(w, sd, those, rng) for w in each.walks))
                    for each in grown(kind, seeds)
                ]
                row: Row = {"structure": kind, "turned at": when, "by, 1 sd [deg]": sd}
                yield row | _errors(changed, SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0))
    settled = grow(
        TowerParams(climb=ClimbParams(settle=1.0)),
        robots=100, seeds=list(range(seeds)), robot=RobotGeometry(),
    )  # fmt: skip
    row = {"structure": "tower", "turned at": "all settle", "by, 1 sd [deg]": np.nan}
    yield row | _errors([*settled], SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0))


def _turned(walk: Walk, sd: float, those: Callable[[int], slice], rng: np.random.Generator) -> Walk:
    """Turn a robot about random axes at some stances, and by as much at all later ones."""
    turns = np.radians(sd) * rng.normal(size=(walk.stance_count, 3))
    is_turned = np.zeros((walk.stance_count, 1), bool)
    is_turned[those(walk.stance_count)] = walk.stance_count > 1
    sensed = Rotation.from_quat(walk.orientation_wxyz, scalar_first=True)
    so_far, after = Rotation.identity(), []
    for k, turn in enumerate(turns * is_turned):
        so_far = Rotation.from_rotvec(turn) * so_far
        after.append((so_far * sensed[k]).as_quat(scalar_first=True))
    return replace(walk, orientation_wxyz=np.array(after))


def _errors(histories: Sequence[History], sensing: SensingParams) -> Row:
    """Return the rms of tilt and yaw, sensed and fitted, and who keep what they sensed."""
    sensed, found, kept = [], [], []
    for history in histories:
        log = observe(history, sensing)
        fit = fit_orientations(log, AXES)
        true = np.array([walk.orientation_wxyz[-1] for walk in history.walks])
        sensed.append(_off(log, true))
        found.append(_off(fit, true))
        kept.append((fit.orientation_wxyz == log.orientation_wxyz).all(axis=1))
    names = ("sensed", np.concatenate(sensed)), ("fitted", np.concatenate(found))
    row: Row = {}
    for name, off in names:
        row[f"{name} tilt [deg]"] = float(f"{np.sqrt((off[:, :2] ** 2).mean()):.2g}")
        row[f"{name} yaw [deg]"] = float(f"{np.sqrt((off[:, 2] ** 2).mean()):.2g}")
    return row | {"kept [%]": round(100 * np.concatenate(kept).mean())}


def _off(log: SensingLog, true: np.ndarray) -> np.ndarray:
    """Return the turns from true orientations to those of a log, about x, y, z [deg]."""
    q = Rotation.from_quat(log.orientation_wxyz, scalar_first=True)
    return np.degrees((q * Rotation.from_quat(true, scalar_first=True).inv()).as_rotvec())


def names(seeds: int) -> Iterator[Row]:
    """Count contacts of final poses that vibrations in time slots miss, or name wrongly."""
    for kind in KINDS:
        for robots in ROBOTS:
            row: Row = {"structure": kind, "robots": robots}
            for slots in SLOTS:
                missing, wrong = [], []
                for history in grown(kind, seeds, robots):
                    true = {*map(tuple, history.contacts.tolist())}
                    log = observe(history, SensingParams(vibration=Vibration(slots=slots)))
                    named = {*map(tuple, log.contacts.tolist())}
                    missing.append((len(true) - len(named)) / len(true))
                    wrong.append(len(named - true) / len(true))
                row[f"{slots} slots: missing, wrong [%]"] = (
                    f"{100 * np.mean(missing):.1f}, {100 * np.mean(wrong):.1f}"
                )
            yield row


TABLES: dict[str, Callable[[int], Iterator[Row]]] = {
    each.__name__: each for each in (angles, lattice, fitted, slipped, names)
}


def main() -> None:
    """Print tables, row by row."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("tables", nargs="*", choices=[*TABLES, []], metavar="TABLE", default=[])
    parser.add_argument("--seeds", type=int, default=8)
    arguments = parser.parse_args()
    for name in arguments.tables or TABLES:
        for k, row in enumerate(TABLES[name](arguments.seeds)):
            if not k:
                print(f"\n{name}\n\n| {' | '.join(row)} |\n|{'---|' * len(row)}")
            print(f"| {' | '.join(map(str, row.values()))} |", flush=True)


if __name__ == "__main__":
    main()
