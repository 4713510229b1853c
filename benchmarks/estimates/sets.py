"""Sets of logs on which no constant was fitted, each log made from the set's name and a number.

Training logs have numbers from 100,000 on, those for reports numbers from 0 on. Lengths in R,
those of beacons and tags in m.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.estimates import assembly, lies
from benchmarks.estimates.assembly import CannotBuildError, Made
from tests import foreign
from tests.structures import Rule, structure
from tiswarm.base.aliases import Reals
from tiswarm.base.robot import RobotGeometry, Shape
from tiswarm.measurements.contacts import connected_parts
from tiswarm.measurements.cues import measure
from tiswarm.records.sensing_log import SensingLog, SensingNoise
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.params import (
    BridgeParams,
    CantileverParams,
    StructureParams,
    TowerParams,
)

TRAINING = 100_000
"""Number of the first training log."""

FLIPS = 10
"""Flips that heights come from, in the mean."""

NONE = "none"

Late = dict[tuple[int, int], float]
"""What ranges, by (earlier, later) robot, are too long by [m]."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One log with its truth."""

    kind: str
    """Kind of structure, or what robots sensed."""

    lie: str
    """What is wrong and not stated; "none" if nothing is."""

    log: SensingLog
    truth: Reals
    """True centers [log unit], shape (N, 3)."""

    cause: tuple[str, float] | None = None
    """Common parameter that the log states wrongly, with its right value; None if there is none."""


def random(name: str, number: int) -> np.random.Generator:
    """Return the generator of random numbers of a log."""
    return np.random.default_rng([zlib.crc32(name.encode()), number])


def noisy(
    made: Made, rng: np.random.Generator, *, tilt_deg: float, yaw_deg: float, heights: bool
) -> Made:
    """Add noise to orientations, and heights as of flips, with the noise that logs state.

    Planar robots have the noise of tilt about the normal of the plane, and none of yaw.
    """
    log, truth = made
    planar = lies.is_planar(log)
    yaw_deg *= not planar
    sd = np.radians([0.0, tilt_deg, 0.0] if planar else [tilt_deg, tilt_deg, yaw_deg])
    turn = Rotation.from_rotvec(sd * rng.normal(size=truth.shape))
    wxyz = turn * Rotation.from_quat(log.orientation_wxyz, scalar_first=True)
    height = np.full(len(truth), np.nan)
    if heights:
        arm = float(np.linalg.norm(log.dock_offset_body, axis=1).max())
        flips = rng.integers(0, 2 * FLIPS + 1, len(truth))
        of_flips = np.sqrt(flips) * 2.0 * arm * np.radians(tilt_deg)
        height = truth[:, 2] + of_flips * rng.normal(size=len(truth))
    noise = SensingNoise(tilt_deg=tilt_deg, yaw_deg=yaw_deg)
    orientation = wxyz.as_quat(canonical=True, scalar_first=True)
    return replace(log, orientation_wxyz=orientation, flip_height=height, noise=noise), truth


def grown(
    params: StructureParams, robots: int, seed: int, sensing: SensingParams, robot: RobotGeometry
) -> Made:
    """Grow a structure and sense it."""
    [history] = grow(params, robots=robots, seeds=[seed], robot=robot)
    return observe(history, sensing), history.position


_PLANNED: Mapping[str, Callable[[int, np.random.Generator], assembly.Plan]] = {
    "ring": assembly.ring,
    "star": assembly.star,
    "ladder": assembly.ladder,
    "arch": assembly.arch,
}
_RULES = {"growth": "tree", "ball": "ball", "loops": "loops", "thin arm": "chain"}
KINDS = (*_RULES, *_PLANNED, "planar", "tower")
"""Kinds of generated structures."""

_FEWEST_DOCKS = {"ladder": 3}
_SHAPES: Mapping[int, Shape] = {3: "triangle", 4: "tetrahedron", 6: "octahedron", 8: "cube"}
_RANGES_EACH = 6
"""One in so many logs without a lie has ranges."""

_RHO = 2.0
"""Distance from center to dock of towers' robots: docks of a cube do not overlap."""

_TRIES = 50


def generated(number: int) -> Case:
    """Make a structure of any kind; every second ten logs have a lie."""
    tens, kind = number // 10, KINDS[number % 10]
    rng = random("generated", number)
    lie = NONE
    if tens % 2:
        lie = list(lies.LIES)[(10 * (tens // 2) + number % 10) % len(lies.LIES)]
    tilt, yaw = rng.uniform(0.0, 3.0), rng.uniform(0.0, 5.0)
    if lie == "noise understated":
        tilt, yaw = max(tilt, 1.0), max(yaw, 1.0)
    log, truth = drawn(kind, number, rng, (tilt, yaw), heights=rng.random() < 0.5)  # noqa: PLR2004
    if lie != NONE:
        log = lies.LIES[lie](log, truth, rng)
    elif rng.integers(_RANGES_EACH) == 0:
        log = lies.with_ranges(log, truth, rng)
    return Case(kind=kind, lie=lie, log=log, truth=truth)


_SMALL = (8, 12)
_SMALL_TILT, _SMALL_YAW = (0.5, 3.0), (0.5, 5.0)


def small(number: int) -> Case:
    """Make 8 to 12 robots of any kind of structure, with final stances alone and no lie."""
    rng = random("posterior", number)
    kind = KINDS[number % len(KINDS)]
    noise_deg = float(rng.uniform(*_SMALL_TILT)), float(rng.uniform(*_SMALL_YAW))
    heights = bool(rng.random() < 0.5)  # noqa: PLR2004 - half of them
    log, truth = drawn(kind, number, rng, noise_deg, heights=heights, sizes=_SMALL)
    return Case(kind=kind, lie=NONE, log=log, truth=truth)


def drawn(
    kind: str,
    seed: int,
    rng: np.random.Generator,
    noise_deg: tuple[float, float],
    *,
    heights: bool,
    sizes: tuple[int, int] = (10, 100),
    docks_of_towers: Sequence[int] = (*_SHAPES,),
) -> Made:
    """Draw robots and docks of a structure until one can be built."""
    tilt, yaw = noise_deg
    sensed = SensingParams(
        tilt_noise_deg=tilt, yaw_noise_deg=yaw, heights=heights, stances=False, ground_docks=False
    )
    for _ in range(_TRIES):
        robots = round(float(np.exp(rng.uniform(*np.log(sizes)))))
        if kind == "tower":
            docks = int(rng.choice(docks_of_towers))
            robot = RobotGeometry(shape=_SHAPES[docks], rho=_RHO)
            return grown(TowerParams(), robots, seed, sensed, robot)
        if kind == "planar" and rng.random() < 0.5:  # noqa: PLR2004 - half of them
            return grown(TowerParams(plane=True), robots, seed, sensed, RobotGeometry())
        try:
            made = _put_together(kind, robots, rng)
        except CannotBuildError:
            continue
        return noisy(made, rng, tilt_deg=tilt, yaw_deg=yaw, heights=heights)
    message = f"{kind} {seed} cannot be built"
    raise AssertionError(message)


def _put_together(kind: str, robots: int, rng: np.random.Generator) -> Made:
    """Put robots of a random number of docks together.

    Raises:
        CannotBuildError: there is no room, or no try ends as planned.
    """
    if kind == "planar":
        docks = int(rng.integers(3, 5))
        return assembly.built(assembly.lattice(robots, docks, rng), docks, rng)
    docks = int(rng.integers(_FEWEST_DOCKS.get(kind, 2), 9))
    if kind in _PLANNED:
        return assembly.built(_PLANNED[kind](robots, rng), docks, rng)
    offset = float(np.linalg.norm(assembly.dock_offsets(docks)[0]))
    rule = Rule(kind=_RULES[kind], docks=docks, offset=offset)
    try:
        return structure(rule, robots, int(rng.integers(TRAINING, 2**31)))
    except AssertionError as problem:
        raise CannotBuildError(str(problem)) from problem


_PLANAR: Mapping[str, RobotGeometry] = {
    "triangle": RobotGeometry(),
    "wide triangle": RobotGeometry(rho=3.0),
    "square": RobotGeometry(shape="square", rho=1.6),
}
_SIZES = (10, 20, 30)
_HALF_DEG = SensingParams(tilt_noise_deg=0.5, stances=False, ground_docks=False)


def planar(number: int) -> Case:
    """Grow a tower in a plane, of robots of one of three shapes."""
    kind = list(_PLANAR)[number % 3]
    robots = _SIZES[number // 3 % 3]
    log, truth = grown(TowerParams(plane=True), robots, number, _HALF_DEG, _PLANAR[kind])
    return Case(kind=kind, lie=NONE, log=log, truth=truth)


def _box(rng: np.random.Generator, count: int) -> Reals:
    """Draw tags in a room, below its beacons [m]."""
    return foreign.apart(rng, [1.0, 1.0, 0.3], [5.0, 4.0, 1.5], count)


def _measured(
    beacons: Reals, tags: Reals, rng: np.random.Generator, *, sd: float, among_tags: bool = True
) -> Made:
    """Let tags measure how far beacons are, and the tags before them [m]."""
    log, truth = foreign.tags_among(beacons, tags, sd=sd, seed=int(rng.integers(TRAINING, 2**31)))
    kept = log.ranges if among_tags else log.ranges[log.ranges[:, 1] < len(beacons)]
    return replace(log, ranges=kept), truth


READING_SD = 0.1
"""Standard deviation of one of many readings [m]."""

LEAST_PAIR_BIAS, MOST_PAIR_BIAS = 0.03, 0.06
"""Standard deviation of the constant bias of each pair of robots [m]."""

_FEWEST_READINGS, _MOST_READINGS = 30, 300


def readings(number: int) -> Case:
    """Let tags read each range many times; in three of four logs each pair has its own bias."""
    rng = random("readings", number)
    beacons = foreign.ROOM + rng.uniform(-0.3, 0.3, foreign.ROOM.shape)
    tags = _box(rng, int(rng.integers(3, 9)))
    log, truth = _measured(beacons, tags, rng, sd=0.0, among_tags=bool(rng.integers(2)))
    each = int(rng.integers(_FEWEST_READINGS, _MOST_READINGS + 1))
    pairs, every = len(log.ranges), log.ranges.repeat(each, axis=0)
    bias = rng.uniform(LEAST_PAIR_BIAS, MOST_PAIR_BIAS) * rng.normal(size=pairs)
    is_biased = number % 4 > 0
    every[:, 2] += is_biased * bias.repeat(each) + READING_SD * rng.normal(size=len(every))
    every[:, 3] = READING_SD
    return Case(
        kind="biased" if is_biased else "unbiased",
        lie="biased pairs" if is_biased else NONE,
        log=replace(log, ranges=every),
        truth=truth,
    )


CIRCLES = ("one beacon", "two beacons", "beacons in a line", "beacons in a plane")
"""Beacons that leave each tag a sphere, a circle, or two points."""


def circles(number: int) -> Case:
    """Place tags among beacons that do not determine where they are."""
    rng = random("circles", number)
    kind = CIRCLES[number % len(CIRCLES)]
    along = np.linspace(0.0, rng.uniform(4.0, 9.0), 1 + number % len(CIRCLES))
    if kind == "beacons in a line":
        along = np.linspace(0.0, rng.uniform(4.0, 9.0), int(rng.integers(3, 6)))
    beacons = np.column_stack([along, 0.0 * along, 0.0 * along])
    if kind == "beacons in a plane":
        beacons = foreign.CEILING - foreign.CEILING[0]
    turn = Rotation.random(None, rng)
    tags = foreign.apart(rng, [0.5, 0.5, -3.0], [4.0, 4.0, -1.0], int(rng.integers(1, 7)))
    log, truth = _measured(
        turn.apply(beacons),
        turn.apply(tags),
        rng,
        sd=rng.uniform(0.02, 0.2),
        among_tags=bool(rng.integers(2)),
    )
    return Case(kind=kind, lie=NONE, log=log, truth=truth)


_TORN = {"tower": "exchanged names", "ring": "exchanged names", "growth": "wrong tie"}
_WRONG = {"exchanged names": lies.exchanged_names, "wrong tie": lies.wrong_tie}


def torn(number: int) -> Case:
    """Make a structure with a part that wrong contacts alone tie, in most logs."""
    rng = random("torn", number)
    kind = list(_TORN)[number % len(_TORN)]
    noise_deg = rng.uniform(0.0, 2.0), rng.uniform(0.0, 3.0)
    heights = bool(rng.integers(2))
    log, truth = drawn(
        kind, number, rng, noise_deg, heights=heights, sizes=(20, 60), docks_of_towers=[8]
    )
    lie = _TORN[kind]
    return Case(kind=kind, lie=lie, log=_WRONG[lie](log, truth, rng), truth=truth)


_HOME: Mapping[str, StructureParams] = {"tower": TowerParams(), "cantilever": CantileverParams()}
_HOME_ROBOTS = 100


def home(number: int) -> Case:
    """Grow 100 robots as `scenarios/joint.yaml` does, and sense final or all stances."""
    kind = list(_HOME)[number % 2]
    walks = number // 2 % 2 == 1
    sensed = SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0, stances=walks)
    first = TRAINING * (number >= TRAINING)
    seed = first + (number - first) // 4
    log, truth = grown(_HOME[kind], _HOME_ROBOTS, seed, sensed, RobotGeometry())
    return Case(
        kind=f"{kind}, {'all' if walks else 'final'} stances", lie=NONE, log=log, truth=truth
    )


def _late(rng: np.random.Generator, tags: int, by: tuple[float, float], count: int) -> Late:
    """Draw ranges that are too long, and by how much [m]."""
    robot = 4 + rng.integers(0, tags, count)
    other = rng.integers(0, robot)
    much = rng.uniform(*by, count)
    return dict(zip(zip(other.tolist(), robot.tolist(), strict=True), much.tolist(), strict=True))


def _room(rng: np.random.Generator, seed: int, **options: Any) -> Made:  # noqa: ANN401 - of room_of_tags
    beacons = options.pop("beacons", foreign.ROOM)
    return foreign.room_of_tags(beacons, seed, count=int(rng.integers(3, 9)), **options)


_CASES: Mapping[str, Callable[[np.random.Generator, int], Made]] = {
    "room": lambda rng, seed: _room(rng, seed, sd=0.0, stated=0.1),
    "ceiling": lambda rng, seed: _room(rng, seed, beacons=foreign.CEILING, sd=0.1),
    "one outlier": lambda rng, seed: _room(rng, seed, late=_late(rng, 3, (5.0, 40.0), 1)),
    "no line of sight": lambda rng, seed: _room(rng, seed, late=_late(rng, 3, (1.0, 2.0), 3)),
    "nearly flat": lambda rng, seed: foreign.nearly_flat(float(rng.uniform(0.05, 0.4)), seed),
    "no beacon": lambda rng, seed: foreign.without_beacons(int(rng.integers(5, 15)), seed),
    "chain without compass": lambda rng, seed: foreign.open_chain(
        int(rng.integers(8, 41)), seed, sd_deg=float(rng.uniform(0.5, 2.0))
    ),
}


def cases(number: int) -> Case:
    """Make a small log of other sensors, of random size."""
    rng = random("cases", number)
    kind = list(_CASES)[number % len(_CASES)]
    log, truth = _CASES[kind](rng, int(rng.integers(TRAINING, 2**31)))
    lie = "late ranges" if kind in {"one outlier", "no line of sight"} else NONE
    return Case(kind=kind, lie=lie, log=log, truth=truth)


_FEWEST, _MOST = 20, 80
_NARROW, _WIDE = 6.0, 11.0
_BRIDGE_ROBOTS = 120
_MOSTLY_TIED = 0.8


def _bridge(rng: np.random.Generator, sensed: SensingParams) -> Made:
    """Grow bridges over gaps of random width until one is closed by enough robots."""
    for _ in range(_TRIES):
        params = BridgeParams(gap=float(rng.uniform(_NARROW, _WIDE)))
        seed = int(rng.integers(TRAINING, 2**31))
        [history] = grow(params, robots=_BRIDGE_ROBOTS, seeds=[seed], robot=RobotGeometry())
        log = observe(history, sensed)
        if history.crossed and history.robot_count >= _FEWEST and _is_tied(log):
            return log, history.position
    message = "no bridge closed"
    raise AssertionError(message)


def _is_tied(log: SensingLog) -> bool:
    """Judge whether contacts tie most robots to the anchor."""
    rows = measure(log, ["contacts"])
    part = connected_parts(rows)
    return float((part == part[0]).mean()) >= _MOSTLY_TIED


def bridges(number: int) -> Case:
    """Grow a bridge until its sides meet, and sense final or all stances."""
    rng = random("bridges", number)
    walks = number % 2 == 1
    log, truth = _bridge(rng, _sensing(walks=walks))
    return Case(
        kind=f"bridge, {'all' if walks else 'final'} stances", lie=NONE, log=log, truth=truth
    )


def _sensing(*, walks: bool, **failures: float) -> SensingParams:
    return SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0, stances=walks, **failures)


_FAILURES: Mapping[str, Mapping[str, float]] = {"drift": {"drift": 0.1}, "mute": {"mute": 0.1}}
_WRONG_LOGS: Mapping[str, lies.Lie] = {
    "exchanged names": lies.exchanged_names,
    "wrong anchor": lies.wrong_anchor,
    "noise understated": lies.understated_noise,
}
_GROWN: Mapping[str, StructureParams] = {
    "tower": TowerParams(),
    "cantilever": CantileverParams(),
    "planar": TowerParams(plane=True),
}


def wrong(number: int) -> Case:
    """Grow a structure of one of four kinds, whose log has one of five lies."""
    rng = random("wrong", number)
    lie = [*_WRONG_LOGS, *_FAILURES][number % 5]
    kind = [*_GROWN, "bridge"][number // 5 % 4]
    sensed = _sensing(walks=number // 20 % 2 == 1, **_FAILURES.get(lie, {}))
    if kind == "bridge":
        log, truth = _bridge(rng, sensed)
    else:
        robots = int(rng.integers(_FEWEST, _MOST + 1))
        seed = int(rng.integers(TRAINING, 2**31))
        log, truth = grown(_GROWN[kind], robots, seed, sensed, RobotGeometry())
    if lie in _WRONG_LOGS:
        log = _WRONG_LOGS[lie](log, truth, rng)
    return Case(kind=kind, lie=lie, log=log, truth=truth)


SETS: Mapping[str, tuple[int, Callable[[int], Case]]] = {
    "generated": (160, generated),
    "planar": (120, planar),
    "readings": (40, readings),
    "circles": (48, circles),
    "torn": (42, torn),
    "home": (100, home),
    "cases": (56, cases),
}
"""Number of logs of each set, and what makes a log from its number."""

GROWN_SETS: Mapping[str, tuple[int, Callable[[int], Case]]] = {
    "bridges": (100, bridges),
    "wrong": (100, wrong),
}
"""Sets of `benchmarks.within` alone, as `SETS`."""
