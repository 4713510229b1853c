"""Runs methods on generated logs, and writes the error and the sd of each robot."""

import csv
import time
import warnings
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

import tiswarm
from benchmarks.estimates.grade import as_claimed, is_beacon
from benchmarks.estimates.sets import GROWN_SETS, SETS, TRAINING, Case
from benchmarks.logs.grade import claims
from tiswarm.base.errors import TiswarmError
from tiswarm.evaluation.metrics import robot_errors
from tiswarm.records.estimate import Estimate

ALL_SETS = {**SETS, **GROWN_SETS}
"""Number of logs of each set, and what makes a log from its number."""

METHODS = ("joint", "least-squares", "hop-by-hop", "online", "distributed")
"""Methods that state an sd."""

MOST_JOINED = 50
"""Largest number of robots of logs for methods that solve as each robot joins, since these take
tens of seconds a log beyond."""

_ONE_BY_ONE = ("online", "distributed")
_WRONG_BEACON = 0.01
"""Error beyond which a robot of known position counts [R]."""


class RobotError(NamedTuple):
    """One robot in an estimate of one method."""

    set: str
    number: int
    kind: str
    lie: str
    method: str
    robot: int
    error_R: float  # noqa: N815 - a column with its unit
    sd_R: float  # noqa: N815 - a column with its unit
    known: str
    is_guess: bool
    trusted: bool


COLUMNS = RobotError._fields


def errors_of(
    case: Case, estimate: Estimate, *, name: str, number: int, method: str
) -> Iterator[RobotError]:
    """List the errors of robots, without the anchor and beacons that are where the log says."""
    unit = case.log.dock_radius
    off = robot_errors(as_claimed(case.log, estimate, case.truth), case.truth) / unit
    counts = ~is_beacon(case.log) | (off > _WRONG_BEACON)
    counts[0] = False
    words = estimate.known or [""] * len(off)
    sd = np.full(len(off), np.nan) if estimate.sd is None else estimate.sd / unit
    is_guess = ~claims(estimate)
    trusted = estimate.convergence is None or estimate.convergence.trusted
    for robot in np.flatnonzero(counts).tolist():
        yield RobotError(
            name, number, case.kind, case.lie, method, robot, float(off[robot]), float(sd[robot]),
            words[robot], bool(is_guess[robot]), trusted,
        )  # fmt: skip


def measure(
    path: Path,
    *,
    names: Collection[str],
    methods: Sequence[str],
    logs: int,
    training: bool,
    seconds: float,
) -> None:
    """Add the errors of methods to a table, log by log; what it has is not computed again.

    Args:
        path: Table to write or continue.
        names: Sets of logs.
        methods: Methods.
        logs: Largest number of logs of a set.
        training: Whether to take training logs.
        seconds: Time after which no further log is begun [s].
    """
    begun = time.monotonic()
    path.parent.mkdir(parents=True, exist_ok=True)
    done: set[tuple[str, int, str]] = set()
    if path.exists():
        table = pd.read_csv(path, usecols=["set", "number", "method"]).drop_duplicates()
        done = {(str(s), int(n), str(m)) for s, n, m in table.itertuples(index=False)}
    with path.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if not done:
            writer.writerow(COLUMNS)
        for number in range(logs):
            for name in names:
                count, make = ALL_SETS[name]
                if number >= count:
                    continue
                shown = number + TRAINING * training
                wanted = [method for method in methods if (name, shown, method) not in done]
                if not wanted:
                    continue
                if time.monotonic() - begun > seconds:
                    return
                writer.writerows(_errors(make(shown), wanted, name=name, number=shown))
                file.flush()


def _errors(case: Case, methods: Sequence[str], *, name: str, number: int) -> Iterator[RobotError]:
    for method in methods:
        if method in _ONE_BY_ONE and case.log.robot_count > MOST_JOINED:
            continue
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # verdicts are in the table
                estimate = tiswarm.localize(case.log, method, threads=1)
        except TiswarmError:  # the method cannot use the log
            continue
        yield from errors_of(case, estimate, name=name, number=number, method=method)
