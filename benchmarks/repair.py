"""Grows structures that lose robots by ReactiveBuild and by the rule of docs/guides/repair.md.

python -m benchmarks.repair --rates 0 0.05 0.1                # tables of the guide and notes
python -m benchmarks.repair --seeds 2 --robots 30
python -m benchmarks.repair --patience 16 --rates 0 0.1       # with more patience
"""

import argparse
import itertools
import math
import re
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

import tiswarm
from tiswarm.records.intervals import mean_std_ci95
from tiswarm.world.history import FELL
from tiswarm.world.params import ClimbParams

PAGE = Path("docs/guides/repair.md")
KINDS = {"tower": "height", "cantilever": "reach"}
"""Kinds of structures, and the size of each."""

RATES = (0.0, 0.02, 0.05, 0.1)
RULES: tuple[dict[str, Any] | None, ...] = (
    None, {"name": "repair"}, {"name": "repair", "every": 2},
)  # fmt: skip
"""ReactiveBuild, and the rule of the guide for each climber or each other one."""

NEAR = 2.0
"""Distance of a robot from the place of one that left at which it takes that place [R]."""

_CODE = re.compile(r"```python\n(.*?)```", re.DOTALL)


class Taken(NamedTuple):
    """Places that robots left, and others took."""

    places: int
    flips: int  # of the robots that took them


def taken(structure: Any) -> Taken:  # noqa: ANN401 - a `tiswarm.Swarms` of one
    """Count the places that a later robot stays within `NEAR` of, in join order."""
    vacant: list[Any] = []
    places = flips = 0
    for j, place in enumerate(structure.position[: structure.robot_count]):
        left = [each for each in vacant if np.linalg.norm(each - place) > NEAR]
        places += len(vacant) - len(left)
        flips += int(structure.flips[j]) * (len(left) < len(vacant))
        gone = [robot for robot, joined, _ in structure.departures.tolist() if joined == j + 1]
        vacant = left + [structure.position[robot] for robot in gone]
    return Taken(places, flips)


def write_rule(folder: Path, page: Path = PAGE) -> Path:
    """Write the rule of the guide into a file of a folder, and return the file."""
    file = folder / "repair.py"
    file.write_text(_CODE.findall(page.read_text(encoding="utf-8"))[0], encoding="utf-8")
    return file


def measure(
    kind: str,
    rate: float,
    rule: dict[str, Any] | None,
    *,
    file: Path,
    robots: int,
    seeds: int,
    patience: int,
) -> dict[str, str]:
    """Grow structures of one row of the table, and return its cells by heading.

    `file` has the rule of the guide.
    """
    by_rule = {"rule": rule, "plugins": [file]} if rule else {}
    structure = {"kind": kind, "departures": {"rate": rate}, "climb": {"patience": patience}}
    grown = tiswarm.grow(structure, robots, seeds, quiet=True, **by_rule)
    each = [grown[s] for s in range(len(grown))]
    found = [taken(one) for one in each]
    places, flips = (sum(getattr(one, name) for one in found) for name in Taken._fields)
    fell = [np.count_nonzero(one.departures[:, 2] == FELL) for one in each]
    every = f", `every: {rule['every']}`" if rule and "every" in rule else ""
    return {
        "structure": kind,
        "leave after joins [%]": f"{100 * rate:.0f}",
        "rule": f"`repair`{every}" if rule else "ReactiveBuild",
        "size [R]": _cell(getattr(grown, KINDS[kind]), 1),
        "fell": _cell(fell, 1),
        "places taken": f"{places / len(each):.1f}",
        "flips in all": _cell([one.flips.sum() for one in each], 0),
        "flips for each place": f"{flips / places:.0f}" if places else "",
        "peak at the end": _cell([one.peak_stress[-1] for one in each], 0),
        "greatest peak": _cell([np.nanmax(one.peak_stress) for one in each], 0),
    }


def _cell(values: Sequence[float], digits: int) -> str:
    """Write a mean with the half width of its 95 % confidence interval, if there is one."""
    found = mean_std_ci95(np.asarray(values, float))
    half = "" if math.isnan(found["ci95"]) else f" ± {found['ci95']:.{digits}f}"
    return f"{found['mean']:.{digits}f}{half}"


def main() -> None:
    """Print the table, row by row."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=64)
    parser.add_argument("--patience", type=int, default=ClimbParams().patience)
    parser.add_argument("--rates", type=float, nargs="+", default=RATES)
    arguments = vars(parser.parse_args())
    rates = arguments.pop("rates")
    rows: list[dict[str, str]] = []
    with TemporaryDirectory() as folder:
        file = write_rule(Path(folder))
        for kind, rate, rule in itertools.product(KINDS, rates, RULES):
            if not rate and rule:
                continue
            rows.append(measure(kind, rate, rule, file=file, **arguments))
            if len(rows) == 1:
                print(f"| {' | '.join(rows[0])} |\n|{'---|' * len(rows[0])}")
            print(f"| {' | '.join(rows[-1].values())} |", flush=True)


if __name__ == "__main__":
    main()
