"""Counts false alarms on right logs, and wrong logs that no verdict warns of.

    python -m benchmarks.estimates.alarms clean --sizes 30 100 --logs 200
    python -m benchmarks.estimates.alarms anchor half false --logs 40
    python -m benchmarks.estimates.alarms common drifting --logs 108
    python -m benchmarks.estimates.alarms clean --sizes 100 --training    # to fit constants on

A false alarm is a verdict "not consistent" on a log whose errors are as stated. A wrong common
parameter is named right if it is the first cause that is named, or one that fits as well, and its
value is within 3 sd. Logs are made from the name of their family, their size and a number. --out
has a row a log, and the tables.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

import tiswarm
from benchmarks.estimates import lies
from benchmarks.estimates.grade import FAR_SD, as_claimed, is_beacon, share
from benchmarks.estimates.sets import (
    KINDS,
    NONE,
    TRAINING,
    Case,
    drawn,
    grown,
    noisy,
    random,
)
from tests.structures import Rule, structure
from tiswarm.base.aliases import Reals
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.measurements.verdicts import distrust
from tiswarm.records.estimate import MOST_WITHIN, Estimate
from tiswarm.records.sensing_log import KNOWN_SD, SensingLog, canonical_contacts
from tiswarm.sensing import SensingParams
from tiswarm.world.params import BridgeParams, CantileverParams, StructureParams, TowerParams

TILT_DEG, YAW_DEG = 1.0, 2.0
"""Noise of orientations of right logs [deg]."""

SPAWN_SD = 0.2
"""Noise of spawn positions [R]."""

FIRST_SEED = 7_000_000
"""Seed of the first grown structure."""

ANCHOR_OFF = 2.0
"""Distance between a wrong anchor and where it is said to be [R]."""

HONEST = 0.6
"""Least share of robots in their 90 % spheres; a trusted estimate with fewer is silent."""

_FEWEST, _MOST = 15, 40
"""Robots of a log with a lie."""

_LEAST_TILT, _MOST_TILT = 1.0, 3.0
_FALSE_CONTACTS = 3
_NAMED = ("right", "beside", "value", "other")
_SAME_SD = 3.0
"""Standard deviations within which a value that is named is right."""

_PRECISE_DEG = 0.2
"""Noise of orientations by motion capture [deg]."""

_PRECISE_ROBOTS = (12, 25)
_GROWN: Mapping[str, StructureParams] = {
    "tower": TowerParams(),
    "cantilever": CantileverParams(),
    "bridge": BridgeParams(),
}
"""Robots, and kinds of structures, that motion capture records."""
_RANGES = (10, 31)

CUE_SETS: Mapping[str, SensingParams] = {
    "final contacts, ground": SensingParams(stances=False, heights=False),
    "final contacts, ground, heights": SensingParams(stances=False),
    "walk contacts too": SensingParams(),
    "walk contacts and spawn positions too": SensingParams(spawn_noise=SPAWN_SD),
}
"""What robots sense of right logs."""

_OTHER_CUES = ("contacts", "contacts, heights")
_RULES = {"tree": (3, 1.8), "loops": (4, 2.0), "ball": (6, 2.4)}
"""Docks of each rule, and the distance from center to dock [R]."""


@dataclass(frozen=True, kw_only=True)
class Alarm:
    """What `joint` said of one log."""

    family: str
    robots: int
    cues: str
    number: int
    kind: str
    converged: bool
    consistent: bool
    is_tested: bool
    reason: str

    silent: bool
    """Trusted, with fewer than `HONEST` of the robots in their 90 % spheres."""

    beyond: bool
    """Trusted, with a robot farther than 5 sd from where it truly is."""

    named: str
    """What is named as the common cause: the "right" one, the right one "beside" a first one that
    fits as well, the right one with a wrong "value", an "other" one, or "none"."""

    robots_named: int
    """Robots that are named as outliers, or as those that carry the misfit."""

    within_90: float
    rmse: float
    """Root mean square error of all robots [dock radii]."""

    cpu_s: float


def clean(robots: int, number: int) -> tuple[str, Case]:
    """Make a right log of any structure with one of the sets of cues; returns these, too."""
    rng = random(f"clean-{robots}", number)
    turn = number % (len(CUE_SETS) + len(_OTHER_CUES))
    if turn < len(CUE_SETS):
        cues = list(CUE_SETS)[turn]
        noise = {"tilt_noise_deg": TILT_DEG, "yaw_noise_deg": YAW_DEG}
        kind = "tower" if rng.random() < 0.5 else "cantilever"  # noqa: PLR2004 - half of them
        params = TowerParams() if kind == "tower" else CantileverParams()
        sensed = replace(CUE_SETS[cues], **noise)
        log, truth = grown(params, robots, FIRST_SEED + number, sensed, RobotGeometry())
        return cues, Case(kind=kind, lie=NONE, log=log, truth=truth)
    cues = _OTHER_CUES[turn - len(CUE_SETS)]
    kind = list(_RULES)[number // (len(CUE_SETS) + len(_OTHER_CUES)) % len(_RULES)]
    docks, offset = _RULES[kind]
    made = structure(Rule(kind=kind, docks=docks, offset=offset), robots, FIRST_SEED + number)
    heights = cues == "contacts, heights"
    log, truth = noisy(made, rng, tilt_deg=TILT_DEG, yaw_deg=YAW_DEG, heights=heights)
    return f"generated: {cues}", Case(kind=kind, lie=NONE, log=log, truth=truth)


def _small(family: str, number: int) -> tuple[Case, np.random.Generator]:
    rng = random(family, number)
    tilt, yaw = rng.uniform(_LEAST_TILT, _MOST_TILT, 2)
    kind = KINDS[number % len(KINDS)]
    heights = bool(rng.integers(2))
    log, truth = drawn(
        kind, FIRST_SEED + number, rng, (tilt, yaw), heights=heights, sizes=(_FEWEST, _MOST)
    )
    return Case(kind=kind, lie=family, log=log, truth=truth), rng


def half(_robots: int, number: int) -> tuple[str, Case]:
    """State half of the noise of a small log: of final contacts, of few ranges, or of walks."""
    case, rng = _small("half", number)
    log, truth = case.log, case.truth
    turn = number % 3
    cues = ("final contacts", "final contacts, few ranges", "walk contacts")[turn]
    if turn == 1:
        ranges = lies.with_ranges(log, truth, rng).ranges
        kept = rng.choice(len(ranges), min(len(ranges), int(rng.integers(*_RANGES))), replace=False)
        ranges = ranges[np.sort(kept)]
        ranges[:, 3] *= 0.5
        log = replace(log, ranges=ranges)
    if turn == 2:  # noqa: PLR2004 - the third
        tilt, yaw = rng.uniform(_LEAST_TILT, _MOST_TILT, 2)
        sensed = SensingParams(tilt_noise_deg=tilt, yaw_noise_deg=yaw)
        robots = int(rng.integers(_FEWEST, _MOST + 1))
        log, truth = grown(TowerParams(), robots, FIRST_SEED + number, sensed, RobotGeometry())
    log = lies.understated_noise(log, truth, rng)
    return f"noise stated at half: {cues}", replace(case, log=log, truth=truth)


def anchor(_robots: int, number: int) -> tuple[str, Case]:
    """Know two further positions of a small log, one of them wrongly."""
    return "one of two further anchors is off", _anchored("anchor", number, ANCHOR_OFF)


def right_anchor(_robots: int, number: int) -> tuple[str, Case]:
    """Know two further positions of a small log, both rightly."""
    return "two further anchors", _anchored("anchor", number, 0.0)


def _anchored(family: str, number: int, off: float) -> Case:
    case, rng = _small(family, number)
    two = rng.choice(np.arange(1, case.log.robot_count), 2, replace=False)
    stated = case.truth[two].copy()
    toward = rng.normal(size=3)
    stated[0] += off * toward / np.linalg.norm(toward)
    rows = [
        [robot, *axis, float(axis @ place), KNOWN_SD, -1]
        for robot, place in zip(two.tolist(), stated, strict=True)
        for axis in np.eye(3)
    ]
    kept = case.log.fixes[~np.isin(case.log.fixes[:, 0], two)]
    fixes = np.concatenate([kept, np.array(rows)])
    return replace(case, log=replace(case.log, fixes=fixes[np.argsort(fixes[:, 0], kind="stable")]))


def false(_robots: int, number: int) -> tuple[str, Case]:
    """Add three contacts of random docks to a small log."""
    case, rng = _small("false", number)
    log, docks = case.log, len(case.log.dock_offset_body)
    later = rng.integers(1, log.robot_count, _FALSE_CONTACTS)
    wrong = [rng.integers(0, later), rng.integers(0, docks, len(later)), later,
             rng.integers(0, docks, len(later))]  # fmt: skip
    every = np.concatenate([log.contacts, np.column_stack(wrong).astype(np.int32)])
    log = replace(log, contacts=canonical_contacts(every))
    return "three false contacts", replace(case, log=log)


def common(_robots: int, number: int) -> tuple[str, Case]:
    """State a common parameter of a tower, a cantilever or a bridge by a small or a large error."""
    name = [*lies.COMMON][number % len(lies.COMMON)]
    turn = number // len(lies.COMMON)
    size = ("small", "large")[turn % 2]
    kind = [*_GROWN][turn // 2 % 3]
    rng = random("common", number)
    log, truth = _precise(kind, number, rng, with_ranges=name in _OF_RANGES)
    parameter = lies.COMMON[name]
    error = getattr(parameter, size) * (1.0 if rng.integers(2) else -1.0)
    wrong = parameter.stated(log, error, rng)
    cause = (name, parameter.value(wrong, error))
    return f"{name}: {size}", Case(kind=kind, lie=name, log=wrong, truth=truth, cause=cause)


_OF_RANGES = ("scale of measured lengths", "shift of all ranges")


def _precise(
    kind: str, number: int, rng: np.random.Generator, *, with_ranges: bool
) -> tuple[SensingLog, Reals]:
    """Grow a structure whose robots know their orientations as by motion capture."""
    sensed = SensingParams(tilt_noise_deg=_PRECISE_DEG, yaw_noise_deg=_PRECISE_DEG)
    robots = int(rng.integers(*_PRECISE_ROBOTS))
    log, truth = grown(_GROWN[kind], robots, FIRST_SEED + number, sensed, RobotGeometry())
    if with_ranges:
        log = lies.with_ranges(log, truth, rng)
    return log, truth


def drifting(_robots: int, number: int) -> tuple[str, Case]:
    """Let one robot of a tower, a cantilever or a bridge drift, or turn all it has."""
    kind = [*_GROWN][number % 3]
    rng = random("drifting", number)
    log, truth = _precise(kind, number, rng, with_ranges=False)
    log = lies.drifting_robot(log, truth, rng)
    return "one robot drifts", Case(kind=kind, lie="drift", log=log, truth=truth)


def precise(_robots: int, number: int) -> tuple[str, Case]:
    """Make a right log of a tower, a cantilever or a bridge, with ranges in every second round."""
    kind = [*_GROWN][number % 3]
    rng = random("precise", number)
    log, truth = _precise(kind, number, rng, with_ranges=number // 3 % 2 == 1)
    return "right, by motion capture", Case(kind=kind, lie=NONE, log=log, truth=truth)


def _named(estimate: Estimate, cause: tuple[str, float] | None) -> str:
    """Compare the common causes that an estimate names with the true one."""
    if not estimate.common_causes:
        return "none"
    for rank, one in enumerate(estimate.common_causes):
        if cause is not None and one.parameter == cause[0]:
            if abs(one.value - cause[1]) > _SAME_SD * one.sd:
                return "value"
            return "beside" if rank else "right"
    return "other"


FAMILIES: Mapping[str, Callable[[int, int], tuple[str, Case]]] = {
    "clean": clean,
    "right-anchor": right_anchor,
    "anchor": anchor,
    "half": half,
    "false": false,
    "common": common,
    "drifting": drifting,
    "precise": precise,
}
"""What makes a log, from its size, which those with a lie do not use, and its number."""


def judged(family: str, robots: int, number: int, method: str) -> Alarm:
    """Make a log, localize it, and compare what the estimate says with the truth."""
    cues, case = FAMILIES[family](robots, number)
    log = case.log
    begun = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # verdicts are in the table
        estimate = tiswarm.localize(log, method, threads=1)
    spent = time.process_time() - begun
    off = _errors(log, estimate, case.truth)
    sd = np.full(len(off), np.inf) if estimate.sd is None else estimate.sd / log.dock_radius
    counts = ~is_beacon(log) | (np.arange(len(off)) > 0) & (family == "anchor")
    verdict = estimate.convergence
    if verdict is None:
        message = f"{method} gives no verdict"
        raise SystemExit(message)
    within = float((off <= MOST_WITHIN * sd + 1e-2)[counts].mean())
    return Alarm(
        family=family,
        robots=robots or log.robot_count,
        cues=cues,
        number=number,
        kind=case.kind,
        converged=verdict.converged,
        consistent=verdict.consistent is not False,
        is_tested=verdict.testable,
        reason=verdict.reason,
        silent=verdict.trusted and within < HONEST,
        beyond=verdict.trusted and bool((off > FAR_SD * sd + 1e-2)[counts].any()),
        named=_named(estimate, case.cause),
        robots_named=_robots_named(log, estimate),
        within_90=within,
        rmse=float(np.sqrt((off**2).mean())),
        cpu_s=spent,
    )


def _robots_named(log: SensingLog, estimate: Estimate) -> int:
    """Count robots that are named as outliers, or as those that carry a misfit."""
    suspects = estimate.outlier_robots
    count = 0 if suspects is None else len(suspects)
    return count + ("carried by" in distrust(log, estimate))


def _errors(log: SensingLog, estimate: Estimate, truth: Reals) -> Reals:
    placed = as_claimed(log, estimate, truth)
    return np.asarray(np.linalg.norm(placed - truth, axis=1) / log.dock_radius)


def summary(alarms: pd.DataFrame) -> pd.DataFrame:
    """Count verdicts by family, size and cues."""
    rows = []
    alarms = alarms.assign(size=alarms["robots"].where(alarms["family"] == "clean", "15 to 40"))
    for key, logs in alarms.groupby(["family", "size", "cues"], sort=False):
        trusted = logs["converged"] & logs["consistent"]
        rows.append(
            {
                **dict(zip(("family", "robots", "cues"), key, strict=True)),
                "logs": len(logs),
                "not consistent": share(int((~logs["consistent"]).sum()), len(logs)),
                "not converged": int((~logs["converged"]).sum()),
                "tested": int(logs["is_tested"].sum()),
                "trusted": int(trusted.sum()),
                "silent": int(logs["silent"].sum()),
                "beyond 5 sd": int(logs["beyond"].sum()),
                **{f"named {what}": int((logs["named"] == what).sum()) for what in _NAMED},
                "names robots": int((logs["robots_named"] > 0).sum()),
                "within 90": logs["within_90"].mean(),
                "median R": logs["rmse"].median(),
                "CPU s": logs["cpu_s"].mean(),
            }
        )
    return pd.DataFrame(rows)


def main() -> int:
    """Judge all logs, and print and write the tables."""
    options = _options()
    backend.start(threads=1)
    first = options.first + TRAINING * options.training
    alarms = []
    for family, robots in _runs(options):
        for number in range(first, first + options.logs):
            alarm = judged(family, robots, number, options.method)
            alarms.append(alarm)
            if not alarm.consistent or alarm.silent or alarm.beyond:
                print(asdict(alarm), flush=True)
            table = pd.DataFrame([asdict(one) for one in alarms])
            options.out.mkdir(parents=True, exist_ok=True)
            table.to_csv(options.out / "alarms.csv", index=False, float_format="%.5g")
    total = summary(table)
    total.to_csv(options.out / "summary.csv", index=False, float_format="%.4g")
    print(total.to_string(index=False, float_format="{:.3g}".format))
    return 0


def _runs(options: argparse.Namespace) -> Iterator[tuple[str, int]]:
    for family in options.families:
        for robots in options.sizes if family == "clean" else [0]:
            yield family, robots


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.estimates.alarms",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("families", nargs="+", choices=[*FAMILIES], metavar="FAMILY",
                        help=f"some of {', '.join(FAMILIES)}")  # fmt: skip
    parser.add_argument("--sizes", nargs="+", type=int, default=[30, 100], metavar="N")
    parser.add_argument("--logs", type=int, default=200, metavar="N", help="logs of each")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first log")
    parser.add_argument("--method", default="joint")
    parser.add_argument("--training", action="store_true", help="logs to fit constants on")
    parser.add_argument("--out", type=Path, default=Path("reports/alarms"))
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
