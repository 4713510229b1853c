"""Structures of many settings and seeds, as tables: what laws are measured on.

F is `force_threshold` [weight of a dock], B `recruit_base` [1], J `recruit_limit` [1], N the
number of robots in a structure.
"""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

F, B, J = "force_threshold", "recruit_base", "recruit_limit"
STANDARD = {F: 10.0, B: 3.0, J: 5.0}
"""Settings of whatever is not swept."""

SETTLED = 25
"""N from which on growth was published to follow a law of N."""

FULL = 100
"""N of a finished structure; a bridge of as many has failed."""

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
"""What laws look at, of all that `summary.csv` holds."""

POINTS = ("x", "mean", "std", "structures")

WITHIN = 1.0
"""A sphere is part of a cross-section if its center is this close to its height [R]."""

Setting = str | float


@dataclass(frozen=True, kw_only=True)
class Grown:
    """What has grown: one table by structure, one by join, one by sphere."""

    structures: pd.DataFrame
    """One row a structure: `case`, SETTINGS (NaN where a kind has no such thing), TOTALS."""

    joins: pd.DataFrame
    """One row a join: `case` and the columns of `growth.csv`, of which `robots` is N."""

    spheres: pd.DataFrame
    """One row a dock sphere of the finished structures: `case` and its height `z_R` [R]."""

    def where(self, **settings: Setting) -> "Grown":
        """Keep structures with these settings."""
        kept = self.structures
        for name, value in settings.items():
            kept = kept[kept[name] == value]
        return replace(self, structures=kept)

    def swept(self, kind: str, *free: str, **fixed: float) -> "Grown":
        """Keep a kind at the standard settings, but for those left free or fixed here."""
        standard = {name: value for name, value in STANDARD.items() if name not in free}
        return self.where(kind=kind, **{**standard, **fixed})

    @property
    def count(self) -> int:
        """Number of structures."""
        return len(self.structures)

    def mean(self, column: str) -> float:
        """Mean of a total over structures; NaN where there are none."""
        return float(self.structures[column].mean())

    def over(self, setting: str, column: str) -> pd.DataFrame:
        """Mean of a total over structures, by a setting.

        Returns:
            Columns x (the setting), mean, std, structures; in rising x.
        """
        totals = self.structures[[setting, column]].astype(np.float64).dropna()
        return _statistics(totals[setting], totals[column])

    def over_robots(self, column: str, *, least: int) -> pd.DataFrame:
        """Mean of a column of `growth.csv`, by the number N of robots that have joined.

        Only structures that grew to the greatest N are counted, so that the same ones are
        behind every point.

        Args:
            column: Which.
            least: Smallest N.

        Returns:
            Columns x (N), mean, std, structures; in rising x.
        """
        full = self.structures[self.structures["robots"] == self.structures["robots"].max()]
        joins = self.joins[self.joins["case"].isin(full["case"])]
        joins = joins[joins["robots"] >= least].dropna(subset=[column])
        return _statistics(joins["robots"], joins[column])

    def cross_sections(self) -> pd.DataFrame:
        """Mean number of spheres in a cross-section, by its distance d from the top.

        The top of a structure is its highest sphere center. At d = 0, 1, 2, ... [R] below it,
        the spheres are counted whose centers are at most 1 R higher or lower; down to the
        lowest sphere of the structure that is least tall, so that all are behind every point.

        Returns:
            Columns x (d), mean, std, structures; in rising x.
        """
        wanted = self.spheres[self.spheres["case"].isin(self.structures["case"])]
        heights = [group.to_numpy(np.float64) for _, group in wanted.groupby("case")["z_R"]]
        if not heights:
            return pd.DataFrame(columns=POINTS, dtype=np.float64)
        distance = np.arange(int(min(np.ptp(z) for z in heights)) + 1, dtype=np.float64)
        counts = [(np.abs(z.max() - distance[:, None] - z) <= WITHIN).sum(axis=1) for z in heights]
        return _statistics(
            pd.Series(np.tile(distance, len(heights))), pd.Series(np.concatenate(counts))
        )


def _statistics(x: pd.Series, value: pd.Series) -> pd.DataFrame:
    """Mean, standard deviation and number of values at each x."""
    table = value.astype(np.float64).groupby(x.to_numpy(np.float64)).agg(["mean", "std", "count"])
    return table.rename_axis("x").reset_index().set_axis(list(POINTS), axis=1)
