"""Draws the paper's structures as they grow by each set of rules, and errors along cantilevers.

    tiswarm run scenarios/anchor-gap.yaml
    python -m benchmarks.reactivebuild.pictures                            # structures
    python -m benchmarks.reactivebuild.pictures --run reports/anchor-gap-* # errors

Both pictures are for `docs/images`. The second command also prints a table: by row of the run, the
join index of the first robot on the anchor; the RMSE of the robots that joined before it, and of
those from it on [R]; and Spearman's rank correlation of that index with the RMSE of a structure.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.stats import spearmanr

from tiswarm.compute import backend
from tiswarm.compute.math import dock_offsets
from tiswarm.report.figure_style import (
    ESTIMATE_ORANGE,
    PAGE_WIDTH,
    PALETTE,
    STYLE,
    entries_of,
    new_figure,
    png,
)
from tiswarm.report.run_data import load_run
from tiswarm.scenario.expansion import load_scenario, variants
from tiswarm.scenario.labels import row_labels
from tiswarm.world.growth import grow
from tiswarm.world.history import History

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

IMAGES, SCENARIOS = Path("docs/images"), Path("scenarios")

SEED = 0
"""Structure of each set that is drawn."""

TITLES = {
    "paper.yaml": ("J 1", "F 17", "B 1.5"),
    "paper-sets.yaml": ("F 3.5", "F 10: defaults"),
}
"""Names of the sets of a scenario, in its order: each has a tower, then a cantilever."""

_SPAN = {"tower": (-38.5, 38.5, 50.0), "cantilever": (-42.0, 35.0, 22.0)}
"""Part of the side view that a panel shows [R]: left, right, up."""

_BELOW = -10.0
_STEP = 5
"""Joins over which a line of the second picture takes means."""

_FEWEST = 10
"""Robots below which the second picture has no mean."""


def structures_of(scenario: str) -> list[History]:
    """Grow the drawn structure of each point of a scenario's sweep."""
    found: dict[str, History] = {}
    for each in variants(load_scenario(SCENARIOS / scenario, [])):
        settings = each.settings
        key = repr(settings.structure)
        if key not in found:
            [found[key]] = grow(
                settings.structure, robots=settings.robots, seeds=[SEED], robot=settings.robot
            )
    return list(found.values())


def draw_structures() -> "Figure":
    """Draw a tower and a cantilever of each set from the side, all to one scale."""
    columns = {
        title: pair
        for scenario, titles in TITLES.items()
        for title, pair in zip(titles, _pairs(structures_of(scenario)), strict=True)
    }
    heights = [up - _BELOW for *_, up in _SPAN.values()]
    left, right, _ = _SPAN["tower"]
    inch = PAGE_WIDTH / (len(columns) * (right - left))
    figure = new_figure(PAGE_WIDTH, sum(heights) * inch + 0.45)
    panels = figure.subplots(2, len(columns), height_ratios=heights, squeeze=False)
    for column, (title, pair) in enumerate(columns.items()):
        for axes, history in zip(panels[:, column], pair, strict=True):
            _draw_side(axes, history)
        panels[0, column].set_title(title, fontsize=8.0)
    return figure


def _pairs(structures: list[History]) -> list[list[History]]:
    return [structures[k : k + 2] for k in range(0, len(structures), 2)]


def _draw_side(axes: "Axes", history: History) -> None:
    """Draw docks as disks, the near ones over the far ones, over the ground."""
    from matplotlib.collections import EllipseCollection

    kind = "tower" if history.terrain.is_plane else "cantilever"
    left, right, up = _SPAN[kind]
    edge = min(history.terrain.left_edge, 200.0)
    level = history.ground_z
    axes.fill_between([-200.0, edge], level - 200.0, level, color="#D9D4CC", linewidth=0.0)
    offset = dock_offsets(history.orientation_wxyz, history.robot.dock_offset_body)
    dock = (history.position[:, None] + offset).reshape(-1, 3)
    robot = np.repeat(np.arange(history.robot_count), offset.shape[1])
    order = np.argsort(-dock[:, 1])  # seen from the side of negative y
    colors = np.where(robot == 0, ESTIMATE_ORANGE, "#9DB7D5")
    on_top = np.concatenate([order[robot[order] > 0], order[robot[order] == 0]])
    size = np.full(len(dock), 2.0 * history.robot.dock_radius)
    axes.add_collection(EllipseCollection(
        size, size, np.zeros(len(dock)), units="xy", offsets=dock[on_top][:, [0, 2]],
        offset_transform=axes.transData, facecolors=colors[on_top], edgecolors="#2B3F55",
        linewidths=0.25,
    ))  # fmt: skip
    axes.set_xlim(left, right)
    axes.set_ylim(_BELOW, up)
    axes.set_aspect("equal")
    axes.set_axis_off()
    if kind == "cantilever":
        x = left + 2.0
        axes.plot([x, x + 20.0], [_BELOW + 3.0] * 2, color="black", linewidth=1.2)
        axes.text(x + 10.0, _BELOW + 4.0, "20 R", ha="center", va="bottom", fontsize=6.0)


def read_errors(run: Path) -> pd.DataFrame:
    """Read the robots of a run with all cues: point, seed, join index, error, hops and first."""
    done = pd.read_csv(run / "summary.csv")
    done = done[(done["status"] == "done") & (done["condition"] == "all-cues")]
    folders = {case.name: case.folder for case in load_run(run).cases}
    labels = row_labels(load_scenario(run / "scenario.yaml", []).sweep)["structure"]
    tables = []
    for _, row in done.iterrows():
        robots = pd.read_csv(folders[row["case"]] / "robots.csv")
        tables.append(robots.assign(
            point=labels[row["structure"]], seed=row["seed"], first=row["first_on_anchor"],
            join=np.arange(len(robots)),
        ))  # fmt: skip
    return pd.concat(tables, ignore_index=True)


def summarize(errors: pd.DataFrame) -> pd.DataFrame:
    """Tabulate errors before and after the first robot on the anchor, by point."""
    return pd.DataFrame(
        [_row(str(name), each) for name, each in errors.groupby("point", sort=False)]
    )


def _row(name: str, errors: pd.DataFrame) -> dict[str, Any]:
    each = errors.groupby("seed")
    first = each["first"].first().fillna(errors["join"].max() + 1.0)
    rmse = each["error_R"].apply(_rms)
    early = errors["join"] < errors["first"].fillna(np.inf)
    found = spearmanr(first, rmse)
    return {
        "point": name,
        "first": first.median(),
        "quartiles": f"{first.quantile(0.25):.0f}-{first.quantile(0.75):.0f}",
        "RMSE_R": rmse.mean(),
        "before_R": _rms(errors[early & (errors["join"] > 0)]["error_R"]),
        "from_R": _rms(errors[~early]["error_R"]),
        "correlation": found.statistic,
        "p": found.pvalue,
    }


def _structures(errors: pd.DataFrame) -> pd.DataFrame:
    """Tabulate the first robot on the anchor and the RMSE of each structure."""
    return errors.groupby("seed").agg(first=("first", "first"), rmse=("error_R", _rms))


def _rms(values: "pd.Series[float]") -> float:
    return float(np.sqrt((values**2).mean()))


def draw_errors(errors: pd.DataFrame) -> "Figure":
    """Draw mean errors by join index and by hops, and RMSE by the first robot on the anchor."""
    figure = new_figure(PAGE_WIDTH, 2.7)
    by_join, by_hops, by_first = figure.subplots(1, 3, sharey=True)
    points = [point for point in dict.fromkeys(errors["point"]) if str(point).startswith("F ")]
    for color, point in zip(PALETTE, points, strict=False):
        mine = errors[errors["point"] == point]
        step = mine.groupby(mine["join"] // _STEP)["error_R"].mean()
        middle = _STEP * (step.index + 0.5)
        by_join.plot(middle, step, color=color, label=point)
        first = float(mine.groupby("seed")["first"].first().median())
        by_join.plot(
            [first], np.interp([first], middle, step), color=color, marker="o",
            markersize=6.0, markeredgecolor="black", linestyle="none",
        )  # fmt: skip
        hops = mine.groupby("hops_from_anchor")["error_R"].agg(["mean", "size"])
        hops = hops[hops["size"] >= _FEWEST]
        by_hops.plot(hops.index, hops["mean"], color=color)
        each = _structures(mine)
        look: dict[str, Any] = {"color": color, "marker": "o", "linestyle": "none"}
        by_first.plot(each["first"], each["rmse"], markersize=2.0, alpha=0.5, **look)
        by_first.plot(*each.mean(), markersize=6.0, markeredgecolor="black", zorder=3, **look)
    for point in dict.fromkeys(errors["point"]):
        if point not in points:
            each = _structures(errors[errors["point"] == point])
            look = {"color": "black", "marker": "D", "markersize": 4.0, "linestyle": "none"}
            by_first.plot(*each.mean(), label="anchor nearer to the edge", **look)
    by_join.set_ylabel("Error [R]")
    by_join.set_xlabel("Join index")
    by_hops.set_xlabel("Contacts from the anchor [hops]")
    by_first.set_xlabel("First robot on the anchor [join index]")
    by_first.set_title("RMSE of structures, and means", fontsize=7.0)
    by_join.set_ylim(bottom=0.0)
    by_first.set_xlim(left=0.0)
    entries = {**entries_of(by_join), **entries_of(by_first)}
    figure.legend(entries.values(), entries, loc="outside upper center", ncols=len(entries))
    return figure


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the structures, or the errors of a run; return the exit status."""
    from matplotlib import style

    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.reactivebuild.pictures",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--run", type=Path, help="folder of a run of anchor-gap.yaml")
    parser.add_argument("--out", type=Path, default=IMAGES, help="folder of the pictures")
    options = parser.parse_args(arguments)
    backend.start()
    with style.context(["default", STYLE]):
        if options.run is None:
            (options.out / "paper-structures.png").write_bytes(png(draw_structures()))
            return 0
        errors = read_errors(options.run)
        (options.out / "anchor-gap.png").write_bytes(png(draw_errors(errors)))
    print(summarize(errors).to_string(index=False, float_format="{:.3g}".format))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
