"""Shifts of the clock of one robot, and what the import of its recording says.

    python -m benchmarks.clocks                         # the table of docs/notes/formats.md
    python -m benchmarks.clocks --first-seed 1 --seeds 1

Robots of a tower walk to their places one after the other, and rest for a second at each stance;
flips take a second and a half. Poses are exact. One robot's times are shifted, which changes the
log if a contact of a stance is lost or gained. A shift is named right if the warning names it with
its sign, or against that robot alone, and no bound is beyond it.
"""

import argparse
import re
import tempfile
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.recordings import RADIUS_MM, RHO, Walks, grown, imported
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.records.sensing_log import SensingLog

_SHIFTS_S = (1.0, 3.0, 10.0, 30.0, 100.0)
_ROBOTS = (2, 4, 6)
_REST_S, _FLIP_S, _LAST_S = 1.0, 1.5, 2.0
_NAMED = re.compile(r"robot (\d+) against ([\d, ]+): at least ([-+.\de]+), by")


def _recorded(walks: Walks) -> pd.DataFrame:
    """List the poses of all robots at the beginning and the end of each rest."""
    time = np.zeros(len(walks.robot))
    is_new = np.append(False, np.diff(walks.robot) > 0)
    time[1:] = np.cumsum(_REST_S + _FLIP_S * ~is_new[1:])
    last = np.flatnonzero(np.append(is_new[1:], True))
    row = np.concatenate([np.arange(len(time)), np.arange(len(time)), last])
    end = time.max() + _REST_S + _LAST_S
    table = pd.DataFrame(
        np.column_stack([walks.center, walks.orientation_wxyz])[row],
        columns=["x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"],
    )
    times = np.concatenate([time, time + _REST_S, np.full(len(last), end)])
    return table.assign(robot=walks.robot[row], time=times).sort_values(["robot", "time"])


def _contacts(log: SensingLog) -> set[tuple[int, ...]]:
    """Name the contacts of stances, in any order of robots."""
    stances = log.earlier
    mover = np.searchsorted(stances.start, stances.contacts[:, 0], side="right") - 1
    stance = stances.contacts[:, 0] - stances.start[mover]
    named = [log.robot_id[mover], stance, stances.contacts[:, 1]]
    named += [log.robot_id[stances.contacts[:, 2]], stances.contacts[:, 3]]
    return set(map(tuple, np.column_stack(named).tolist()))


def _is_right(warnings: list[str], robot: int, shift_s: float) -> bool | None:
    """Judge the first shift that warnings name; None if they name none."""
    named = _NAMED.search(" ".join(warnings))
    if named is None:
        return None
    least = float(named[3])
    says = int(named[1]) == robot and least * shift_s > 0.0
    says_reverse = named[2] == str(robot) and least * shift_s < 0.0
    return (says or says_reverse) and abs(least) <= abs(shift_s)


def main() -> None:
    """Print a row for each size of shift."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=21)
    options = parser.parse_args()
    backend.start(threads=1)
    body = RADIUS_MM * RobotGeometry(rho=RHO).dock_offset_body
    cases = []
    clean = 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            table = _recorded(grown(8, seed))
            right = imported(table, Path(folder), dock_offset_body=body)
            clean += bool(right.warnings)
            for size, sign, robot in product(_SHIFTS_S, (1.0, -1.0), _ROBOTS):
                times = table["time"] + sign * size * (table["robot"] == robot)
                result = imported(table.assign(time=times), Path(folder), dock_offset_body=body)
                verdict = _is_right(result.warnings, robot, sign * size)
                cases.append(
                    {
                        "shift [s]": size,
                        "recordings": 1,
                        "changed": _contacts(result.log) != _contacts(right.log),
                        "warned": bool(result.warnings),
                        "named": verdict is not None,
                        "right": verdict is True,
                    }
                )
    print(f"{clean} of {options.seeds} recordings without a shift have a warning")
    frame = pd.DataFrame(cases)
    frame["changed without a word"] = frame["changed"] & ~frame["warned"]
    print(frame.groupby("shift [s]").sum().to_string())


if __name__ == "__main__":
    main()
