"""The structures of a run as tables, from the files of its folder.

F is `force_threshold` [weight of a dock], B `recruit_base` [1], J `recruit_limit` [1], N the
number of robots in a structure. Standard deviations and means are over structures.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from tiswarm.base.errors import InputError
from tiswarm.compute.math import dock_offsets
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study import plan

F, B, J = "force_threshold", "recruit_base", "recruit_limit"
STANDARD = {F: 10.0, B: 3.0, J: 5.0}
"""Settings of a structure unless a sweep changes them."""

FULL = 100
"""Largest N; a bridge that needs this many robots has failed."""

SETTINGS = ("kind", F, B, J, "gap")
TOTALS = (
    "robots",
    "height_R",
    "reach_R",
    "depth_R",
    "rms_radius_R",
    "peak_stress",
    "crossed",
)
"""Columns of `summary.csv` that the laws use."""

JOINS = ("robots", "height_R", "reach_R", "depth_R", "peak_stress")
"""Columns of `growth.csv` that the laws use."""

ORIENTATION = ["qw", "qx", "qy", "qz"]
POINTS = ("x", "mean", "std", "structures")
SECTION_HALF_HEIGHT = 1.0
"""Largest vertical distance from a cross-section to a sphere center that counts in it [R]."""


@dataclass(frozen=True, kw_only=True)
class Structures:
    """Finished structures of many settings and seeds."""

    totals: pd.DataFrame
    """One row a structure: `case`, SETTINGS (NaN where a kind lacks one), TOTALS."""

    joins: pd.DataFrame
    """One row a join: `case` and JOINS, where `robots` is N after the join."""

    spheres: pd.DataFrame
    """One row a dock sphere: `case` and the height `z_R` of its center [R]."""

    failed: int = 0
    """Number of cases that failed, so that their structures are missing."""

    def where(self, **settings: str | float) -> "Structures":
        """Keep structures with these settings."""
        kept = self.totals
        for name, value in settings.items():
            kept = kept[kept[name] == value]
        return replace(self, totals=kept)

    def of(self, kind: str, *free: str, **fixed: float) -> "Structures":
        """Keep one kind at the standard settings, except those in `free` and `fixed`."""
        standard = {name: value for name, value in STANDARD.items() if name not in free}
        return self.where(kind=kind, **{**standard, **fixed})

    def mean(self, column: str) -> float:
        """Average a total over structures; NaN without structures."""
        return float(self.totals[column].mean())

    def means(self, x: str, y: str) -> pd.DataFrame:
        """Average y over structures at each x.

        Args:
            x: A setting; or `robots`, for every N during growth; or `distance`, for every
                distance from the top of a structure.
            y: A total or an expression of totals; with x = `robots`, a column of `growth.csv`;
                ignored with x = `distance`, where y is the number of spheres.

        Returns:
            Columns x, mean, std, structures; x ascends.
        """
        if x == "robots":
            return self._means_over_robots(y)
        if x == "distance":
            return self._cross_sections()
        value: pd.Series = self.totals.eval(y, engine="python")  # type: ignore[assignment]
        values = pd.DataFrame({"x": self.totals[x], "y": value}, dtype=np.float64).dropna()
        return _statistics(values["x"], values["y"])

    def _means_over_robots(self, column: str) -> pd.DataFrame:
        """Average over complete structures only: the same structures are behind every point."""
        complete = self.totals[self.totals["robots"] == self.totals["robots"].max()]
        joins = self.joins[self.joins["case"].isin(complete["case"])].dropna(subset=[column])
        return _statistics(joins["robots"], joins[column])

    def _cross_sections(self) -> pd.DataFrame:
        """Count the spheres at distances 0, 1, 2, ... [R] below the highest sphere center.

        The least tall structure limits the distance: all structures are behind every point.
        """
        wanted = self.spheres[self.spheres["case"].isin(self.totals["case"])]
        heights = [group.to_numpy(np.float64) for _, group in wanted.groupby("case")["z_R"]]
        if not heights:
            return pd.DataFrame(columns=POINTS, dtype=np.float64)
        distance = np.arange(int(min(np.ptp(z) for z in heights)) + 1, dtype=np.float64)
        counts = [
            (np.abs(z.max() - distance[:, None] - z) <= SECTION_HALF_HEIGHT).sum(axis=1)
            for z in heights
        ]
        return _statistics(
            pd.Series(np.tile(distance, len(heights))), pd.Series(np.concatenate(counts))
        )


def read_structures(folder: Path) -> Structures:
    """Read the structures of a run folder.

    Conditions share their structures, so only the cases of the first condition count.

    Raises:
        InputError: if `folder` is not a run folder.
    """
    try:
        summary = pd.read_csv(folder / "summary.csv")
        summary = summary.set_index("case")
        summary["robots"] = summary["joined"]  # the laws are about robots that joined
    except OSError as error:
        msg = "this is not a run folder: it has no summary.csv; name a folder of `tiswarm run`"
        raise InputError(msg, path=folder) from error
    cases = plan(load_scenario(folder / "scenario.yaml")).cases
    done = set(summary.index[summary["status"] == "done"])
    cases = [case for case in cases if case.variant.condition == cases[0].variant.condition]
    totals: list[dict[str, object]] = []
    joins = [pd.DataFrame(columns=["case", *JOINS], dtype=float)]
    spheres = [pd.DataFrame(columns=["case", "z_R"], dtype=float)]
    for case in cases:
        if case.name not in done:
            continue
        settings = {name: getattr(case.settings.structure, name, None) for name in SETTINGS}
        scores = {name: summary.loc[case.name, name] for name in TOTALS}
        totals.append({"case": case.name, **settings, **scores})
        growth = pd.read_csv(folder / "cases" / case.name / "growth.csv", usecols=list(JOINS))
        joins.append(growth.assign(case=case.name))
        robots = pd.read_csv(folder / "cases" / case.name / "robots.csv")
        body = case.settings.robot.dock_offset_body
        docks = dock_offsets(robots[ORIENTATION].to_numpy(), body)
        height = robots["z_R"].to_numpy()[:, None] + docks[:, :, 2]
        spheres.append(pd.DataFrame({"case": case.name, "z_R": height.ravel()}))
    return Structures(
        totals=pd.DataFrame(totals, columns=["case", *SETTINGS, *TOTALS]),
        joins=pd.concat(joins[1:] or joins),
        spheres=pd.concat(spheres[1:] or spheres),
        failed=len(cases) - len(totals),
    )


def _statistics(x: pd.Series, value: pd.Series) -> pd.DataFrame:
    table = value.astype(np.float64).groupby(x.to_numpy(np.float64)).agg(["mean", "std", "count"])
    return table.rename_axis("x").reset_index().set_axis(list(POINTS), axis=1)
