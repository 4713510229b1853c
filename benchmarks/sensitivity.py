"""States what each number of `joint` and of growth does at half and at twice its value.

    python -m benchmarks.sensitivity                          # all numbers, eight structures a kind
    python -m benchmarks.sensitivity joint --structures 4     # those of `joint` alone
    python -m benchmarks.sensitivity growth --out reports
    python -m benchmarks.sensitivity --page docs/notes/sensitivity.md   # of the tables in reports

Structures are training ones, seeds 1000 and on: results are reported of others, so this table may
be used to choose a number. One that changes no byte at half and at twice its value, on any log,
does nothing here.

For `joint`, each structure is localized as it senses in several ways. A change is stated in the
geometric mean of RMSE, the median of `sd`, estimates that converged and are consistent, and CPU
time. For growth it is stated in what structures are built for, the largest load, and flips a robot.
"""

import argparse
import dataclasses
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic import ValidationError

from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.evaluation.metrics import rmse
from tiswarm.localization import mixture
from tiswarm.localization.chains.views import ANNEALING
from tiswarm.localization.methods import localize_many
from tiswarm.localization.settings import JointParams
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.params import CantileverParams, GrowthParams, TowerParams

Row = dict[str, object]

FIRST_SEED = 1000
ROBOTS = 40
FACTORS = (0.5, 2.0)

SENSES: Mapping[str, SensingParams] = {
    "final contacts": SensingParams(stances=False),
    "walks, 1 and 2 deg": SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0),
    "5 % wrong docks": SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0, wrong_docks=0.05),
    "2 robots drift": SensingParams(tilt_noise_deg=1.0, yaw_noise_deg=2.0, drift=0.05),
    "ranges": SensingParams(
        contacts=False, ground_docks=False, heights=False, stances=False,
        range_reach=8.0, seed_robots=4, fix_noise=0.01,
    ),
    "no compass": SensingParams(
        ground_docks=False, heights=False, stances=False, compass=False,
        direction_noise_deg=0.5, connection_noise_deg=0.5,
    ),
}  # fmt: skip
"""Ways to sense a structure: each part of `joint` has work in one of them."""

CONSTANTS = (
    ANNEALING,
    mixture.CONVERGENCE,
    mixture.MIXTURE,
    mixture.SD_CALIBRATION,
    mixture.REFINEMENT,
    mixture.OUTLIER_ROBOTS,
)
"""Constants of `joint`, one object each, which all of its modules share."""


@dataclass(frozen=True, kw_only=True)
class Number:
    """A number that can be given another value while a function is called."""

    group: str
    """Class that has it."""

    name: str
    value: float
    call: Callable[[float, Callable[[Any], Any]], Any]
    """Calls a function with settings in which the number has a value."""

    def at(self, factor: float) -> float:
        """Multiply the value, a whole number to the nearest one from 1 up."""
        scaled = self.value * factor
        return max(1, round(scaled)) if isinstance(self.value, int) else scaled


def constants() -> Iterator[Number]:
    """Yield the numbers of `CONSTANTS`."""
    for constant in CONSTANTS:
        for field in fields(constant):

            def call(
                value: float,
                use: Callable[[Any], Any],
                constant: Any = constant,  # noqa: ANN401 - frozen settings of any class
                name: str = field.name,
            ) -> Any:  # noqa: ANN401 - as the function
                before = getattr(constant, name)
                object.__setattr__(constant, name, value)
                try:
                    return use(JointParams())
                finally:
                    object.__setattr__(constant, name, before)

            yield Number(
                group=type(constant).__name__,
                name=field.name,
                value=getattr(constant, field.name),
                call=call,
            )


def settings(params: Any, group: str, **resolved: float) -> Iterator[Number]:  # noqa: ANN401
    """Yield the numbers of settings, and of settings in them; `resolved` has those left null."""
    for field in fields(params):
        value = resolved.get(field.name, getattr(params, field.name))
        if dataclasses.is_dataclass(value):
            for inner in settings(value, f"{group}.{field.name}"):

                def nested(
                    scaled: float,
                    use: Callable[[Any], Any],
                    inner: Number = inner,
                    name: str = field.name,
                ) -> Any:  # noqa: ANN401 - as the function
                    return inner.call(scaled, lambda part: use(replace(params, **{name: part})))

                yield replace(inner, call=nested)
        elif isinstance(value, int | float) and not isinstance(value, bool):

            def call(scaled: float, use: Callable[[Any], Any], name: str = field.name) -> Any:  # noqa: ANN401 - as the function
                return use(replace(params, **{name: scaled}))

            yield Number(group=group, name=field.name, value=value, call=call)


def structures(params: GrowthParams, count: int) -> list[History]:
    """Grow training structures."""
    seeds = range(FIRST_SEED, FIRST_SEED + count)
    return grow(params, robots=ROBOTS, seeds=seeds, robot=RobotGeometry())


@dataclass(frozen=True, kw_only=True)
class Located:
    """Estimates of all logs by `joint`, in the order of `logs_of`."""

    estimates: Sequence[Estimate]
    error: np.ndarray[Any, Any]
    """RMSE of each [R]."""

    cpu_s: float

    def beside(self, usual: "Located") -> dict[str, object]:
        """State what differs from the usual settings."""
        ratio = np.exp(np.mean(np.log(self.error / usual.error)))
        sd = np.median([_mean_sd(e) for e in self.estimates])
        usual_sd = np.median([_mean_sd(e) for e in usual.estimates])
        return {
            "bytes": "same" if self._same_as(usual) else "other",
            "rmse_percent": round(100.0 * (ratio - 1.0), 1),
            "sd_percent": round(100.0 * (sd / usual_sd - 1.0), 1),
            "converged": self.count("converged") - usual.count("converged"),
            "consistent": self.count("consistent") - usual.count("consistent"),
            "cpu_percent": round(100.0 * (self.cpu_s / usual.cpu_s - 1.0)),
        }

    def _same_as(self, usual: "Located") -> bool:
        pairs = zip(self.estimates, usual.estimates, strict=True)
        return all(
            one.position.tobytes() == other.position.tobytes()
            and np.array_equal(_sd(one), _sd(other), equal_nan=True)
            and one.convergence == other.convergence
            for one, other in pairs
        )

    def count(self, verdict: str) -> int:
        """Count the estimates with a verdict."""
        return sum(bool(getattr(e.convergence, verdict)) for e in self.estimates)


def _sd(estimate: Estimate) -> np.ndarray[Any, Any]:
    return np.asarray(estimate.sd, float)


def _mean_sd(estimate: Estimate) -> float:
    return float(np.nanmean(_sd(estimate)))


def located(
    logs: Sequence[SensingLog], truth: Sequence[np.ndarray[Any, Any]]
) -> Callable[[JointParams], Located]:
    """Return a function that localizes all logs by settings."""

    def compute(params: JointParams) -> Located:
        begun = time.process_time()
        estimates = localize_many(logs, [params] * len(logs))
        cpu_s = time.process_time() - begun
        errors = [rmse(e.position, t) for e, t in zip(estimates, truth, strict=True)]
        return Located(estimates=estimates, error=np.array(errors), cpu_s=cpu_s)

    return compute


def of_joint(count: int) -> Iterator[Row]:
    """Yield what each number of `joint` does."""
    histories = [*structures(TowerParams(), count), *structures(CantileverParams(), count)]
    logs = [observe(history, params) for params in SENSES.values() for history in histories]
    truth = [history.position for _ in SENSES for history in histories]
    compute = located(logs, truth)
    compute(JointParams())  # compiles kernels
    usual = compute(JointParams())
    plain = JointParams()
    resolved = {"chains": plain.chains_for(ROBOTS), "steps": plain.steps_for(ROBOTS)}
    numbers = [*constants(), *settings(plain, "JointParams", **resolved)]
    yield from rows_of(numbers, lambda params: compute(params).beside(usual))


def of_growth(count: int) -> Iterator[Row]:
    """Yield what each number of growth does."""
    for kind in (TowerParams(), CantileverParams()):
        usual = _built(structures(kind, count))

        def beside(params: GrowthParams, usual: "pd.Series[float]" = usual) -> dict[str, object]:
            built = _built(structures(params, count))
            changed = (100.0 * (built / usual - 1.0)).round(1)
            return {"bytes": "same" if built.equals(usual) else "other", **changed.to_dict()}

        yield from rows_of([*settings(kind, type(kind).__name__)], beside)


def _built(histories: Sequence[History]) -> "pd.Series[float]":
    """Return means over structures: height, reach, largest sensed load, flips of a robot."""
    top = [float(h.position[:, 2].max()) for h in histories]
    out = [float(h.position[:, 0].max()) for h in histories]
    load = [float(np.max(h.sensed)) for h in histories]
    flips = [float(np.mean([walk.stance_count - 1 for walk in h.walks])) for h in histories]
    names = ("height_percent", "reach_percent", "load_percent", "flips_percent")
    return pd.Series(
        {name: float(np.mean(v)) for name, v in zip(names, (top, out, load, flips), strict=True)}
    )


def rows_of(numbers: Sequence[Number], beside: Callable[[Any], dict[str, object]]) -> Iterator[Row]:
    """Call a function with each number at each factor, and yield a row each.

    A number that has no half or no double, as 0 has none, is not tried there.
    """
    for place, number in enumerate(numbers):
        verdicts = []
        for factor in FACTORS:
            value = number.at(factor)
            row: Row = {"group": number.group, "name": number.name, "value": number.value}
            row |= {"factor": factor, "tried": value}
            try:
                row |= {"bytes": ""} if value == number.value else number.call(value, beside)
            except (ValidationError, ValueError):
                row["bytes"] = "refused"
            verdicts.append(row["bytes"] or "not tried")
            yield row
        done = f"{place + 1} of {len(numbers)}: {number.group}.{number.name}"
        print(done, *verdicts, file=sys.stderr, flush=True)


MEASURES: Mapping[str, Mapping[str, str]] = {
    "growth": {
        "height_percent": "height",
        "reach_percent": "reach",
        "load_percent": "load",
        "flips_percent": "flips",
    },
    "joint": {"rmse_percent": "RMSE", "sd_percent": "sd"},
}
"""Columns of each table that its page shows, and their words."""

BEGIN = "<!-- tables: python -m benchmarks.sensitivity --page -->"
END = "<!-- end of tables -->"


def page_tables(folder: Path) -> str:
    """Write the tables of a folder as Markdown, a row a number."""
    parts = []
    for name, measures in MEASURES.items():
        path = folder / f"sensitivity-{name}.csv"
        if not path.exists():
            continue
        table = pd.read_csv(path, keep_default_na=False)
        lines = [
            f"## {name.capitalize()}",
            "",
            f"Changes of {', '.join(measures.values())} [%].",
            "",
            "| number | value | at half | at twice |",
            "|---|---|---|---|",
        ]
        for (group, number), rows in table.groupby(["group", "name"], sort=False):
            cells = [_cell(row, measures) for _, row in rows.sort_values("factor").iterrows()]
            value = f"{float(rows['value'].iloc[0]):.4g}"
            lines.append(f"| `{group}.{number}` | {value} | {' | '.join(cells)} |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def _cell(row: "pd.Series[Any]", measures: Mapping[str, str]) -> str:
    """Write what a number does at one value: the changes, or why there are none."""
    if row["bytes"] == "other":
        return ", ".join(f"{float(row[column]):+.1f}" for column in measures)
    return {"same": "same bytes", "refused": "refused"}.get(str(row["bytes"]), "not tried")


def write_page(page: Path, folder: Path) -> None:
    """Replace the tables of a page by those of a folder; the text around them stays."""
    before, _, rest = page.read_text().partition(BEGIN)
    after = rest.partition(END)[2]
    page.write_text(f"{before}{BEGIN}\n\n{page_tables(folder)}\n\n{END}{after}")


def main() -> None:
    """Write a table for each part, and print what changes nothing."""
    parts = {"joint": of_joint, "growth": of_growth}
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("parts", nargs="*", choices=[*parts, []], help="both if none is named")
    parser.add_argument("--structures", type=int, default=8, help="of each kind")
    parser.add_argument("--out", type=Path, default=Path("reports"), help="folder of the tables")
    parser.add_argument("--page", type=Path, help="write the tables of that folder on this page")
    asked = parser.parse_args()
    if asked.page:
        write_page(asked.page, asked.out)
        return
    backend.start()
    for name in asked.parts or parts:
        path = asked.out / f"sensitivity-{name}.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        rows: list[Row] = []
        for row in parts[name](asked.structures):
            rows.append(row)  # a run that ends early leaves those that it has
            table = pd.DataFrame(rows)
            table.to_csv(path, index=False, lineterminator="\n")
        same = table.groupby(["group", "name"], sort=False)["bytes"].agg(set) == {"same"}
        print(f"{path}: of {len(same)} numbers, {int(same.sum())} change nothing:")
        print(*(f"  {group}.{number}" for group, number in same.index[same]), sep="\n")


if __name__ == "__main__":
    main()
