"""Compares errors that designs predict with those that whole runs find on fresh structures.

    python -m benchmarks.design --out calibration.csv      # four kinds, 50 suites of each
    python -m benchmarks.design --suites 4 --robots 20 --seeds 2
    python -m benchmarks.design --table calibration.csv --figure docs/images/design.png

Suites are drawn from all combinations of `VALUES`. Each is predicted on the structures that a
design searches on, and run by `joint` on fresh structures of its own: with common ones all suites
would share their luck. Nothing was fitted on either. Errors are roots of mean squares over
structures and robots [R].
"""

import argparse
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import tiswarm
from tiswarm.app.design import USUAL_SEEDS
from tiswarm.base.progress import ignore
from tiswarm.records.intervals import share_ci95
from tiswarm.records.outputs import Outputs
from tiswarm.report.figure_style import PAGE_WIDTH, Drawing, Panels, dot_style, write
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study.design.candidates import list_candidates
from tiswarm.study.design.search import FIRST_FRESH_SEED, FIRST_SEED, predict

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tiswarm.app.swarms import Swarms

KINDS: Mapping[str, Mapping[str, Any]] = {
    "tower": {"kind": "tower"},
    "cantilever": {"kind": "cantilever"},
    "bridge": {"kind": "bridge"},
    "planar tower": {"kind": "tower", "plane": True},
}

VALUES: Mapping[str, Sequence[Any]] = {
    "tilt_noise_deg": (0.5, 1.0, 2.0, 4.0),
    "yaw_noise_deg": (1.0, 2.0, 5.0, 10.0),
    "stances": (False, True),
    "heights": (False, True),
    "range_reach": (None, 6.0, 12.0),
    "direction_noise_deg": (None, 5.0),
}
"""Values of `sensing` that suites combine; ranges have a noise of `_RANGE_NOISE`."""

NEAR = 0.3
"""Relative difference up to which a prediction counts as near."""

_RANGE_NOISE = 0.3
"""Noise of ranges [R]."""


def draw_suites(count: int) -> list[dict[str, Any]]:
    """Draw suites without repetition from all combinations of `VALUES`."""
    every = [
        dict(zip(VALUES, values, strict=True)) for values in itertools.product(*VALUES.values())
    ]
    chosen = np.random.default_rng(0).choice(len(every), count, replace=False)
    return [{**every[number], "range_noise": _RANGE_NOISE} for number in chosen.tolist()]


def compare(
    kind: Mapping[str, Any], suites: Sequence[Mapping[str, Any]], *, robots: int, seeds: int
) -> pd.DataFrame:
    """Predict suites on the structures of a search, and run each on fresh ones of its own.

    Returns:
        A row for each suite: its values, `predicted_R`, the same prediction on the fresh structures
        `predicted_there_R`, and `found_R` on these.
    """
    base = load_scenario({
        "name": "calibration", "robots": robots, "structure": dict(kind),
        "localization": {"method": "joint"},
    })  # fmt: skip
    searched = _grow(kind, robots, FIRST_SEED, USUAL_SEEDS["sensing"])
    rows = []
    for number, suite in enumerate(suites):
        vary = {f"sensing.{key}": [value] for key, value in suite.items()}
        candidates = list_candidates(base, vary, None)
        fresh = _grow(kind, robots, FIRST_FRESH_SEED + number * seeds, seeds)
        estimates = [structure.sense(**suite).localize("joint", threads=1) for structure in fresh]
        rows.append(
            {
                **suite,
                "predicted_R": predict(candidates, [*searched], ignore)[0],
                "predicted_there_R": predict(candidates, [*fresh], ignore)[0],
                "found_R": np.sqrt((fresh.score(estimates)["rmse_R"] ** 2).mean()),
                "robots": robots,
                "structures": seeds,
            }
        )
    return pd.DataFrame(rows)


def _grow(kind: Mapping[str, Any], robots: int, first: int, count: int) -> "Swarms":
    return tiswarm.grow(dict(kind), robots, range(first, first + count), threads=1, quiet=True)


def draw_calibration(table: pd.DataFrame) -> "Figure":
    """Draw found errors by predicted ones."""

    def paint(axes: "Axes", panel: str, series: Sequence[str]) -> None:  # noqa: ARG001 - one panel
        ends = np.array([table[["predicted_R", "found_R"]].min().min(), table["found_R"].max()])
        ends *= (0.8, 1.25)
        axes.fill_between(ends, ends * (1 - NEAR), ends * (1 + NEAR), color="0.9", lw=0)
        axes.plot(ends, ends, color="0.5", lw=0.8)
        for number, (kind, of_kind) in enumerate(table.groupby("kind", sort=False)):
            axes.plot(of_kind["predicted_R"], of_kind["found_R"], label=kind, **dot_style(number))
        axes.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
        axes.set_xlabel("predicted RMSE [R]")
        axes.set_ylabel("RMSE of joint on fresh structures [R]")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")

    def complete(panels: Panels) -> list[str]:
        panels.legend(structures=int(table["structures"].max()))
        return []

    drawing = Drawing(
        panels=["calibration"], paint=paint, complete=complete, row_height=3.4, head_height=0.0,
        alone=PAGE_WIDTH,
    )  # fmt: skip
    return drawing.draw()


def summarize(table: pd.DataFrame) -> pd.DataFrame:
    """Count near predictions of each kind and of all, with the median ratio found / predicted."""
    rows = []
    for kind, of_kind in [*table.groupby("kind", sort=False), ("all", table)]:
        row: dict[str, Any] = {"kind": kind, "suites": len(of_kind)}
        for name in ("predicted_R", "predicted_there_R"):
            ratio = of_kind["found_R"] / of_kind[name]
            is_near = ((ratio - 1.0).abs() <= NEAR).to_numpy(np.float64)
            low, high = share_ci95(is_near).values()
            row[f"near_{name}"] = f"{is_near.sum():.0f} ({low:.0%} to {high:.0%})"
            row[f"median_{name}"] = ratio.median()
        rows.append(row)
    return pd.DataFrame(rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print how many predictions are near, and write the table and figure that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--suites", type=int, default=50, help="of each kind")
    parser.add_argument("--robots", type=int, default=40)
    parser.add_argument("--seeds", type=int, default=6, help="fresh structures of each suite")
    parser.add_argument("--out", type=Path, help="table of all suites (.csv)")
    parser.add_argument("--table", type=Path, help="a table of before, in place of runs")
    parser.add_argument("--figure", type=Path, help="picture of the table")
    options = parser.parse_args(arguments)
    if options.table:
        table = pd.read_csv(options.table)
    else:
        suites = draw_suites(options.suites)
        tables = []
        for name, kind in KINDS.items():
            of_kind = compare(kind, suites, robots=options.robots, seeds=options.seeds)
            of_kind.insert(0, "kind", name)
            tables.append(of_kind)
            table = pd.concat(tables, ignore_index=True)
            if options.out:
                table.to_csv(options.out, index=False)
            print(of_kind.round(3).to_string(index=False), flush=True)
    print(summarize(table).round(2).to_string(index=False))
    if options.figure:
        write(options.figure, lambda: draw_calibration(table), Outputs(overwrite=True))


if __name__ == "__main__":
    main()
