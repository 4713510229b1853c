"""Chooses the rule of growth whose structures have most in common with the paper's.

What *Contact-Driven Localization in a Freeform Robotic Self-Assembled Structure* says of its
structures counts here, and nothing else: no structure has to be localized. Lengths are in rho, the
larger of the two lengths that the paper's "robot radius" may be.

1. Structures have 100 robots (Section IV). At least 90 % of those of a rule have to.
2. The rms radius is at most RMSE / sqrt(d), with any errors, for a rigid alignment only lowers
   the SSE (Eqs. 4 to 7). The smallest of the three bounds of a kind holds (Table II). RMSE
   and d are means over structures, so 5 % more are allowed: a standard deviation of .3 of the mean
   raises the root mean square by 4 %.
3. Robots 2 and 3 of towers attach directly to the anchor (IV-C, V): the larger the share of towers
   in which both do, the better. Shares that differ by .1 or less are equal.
4. The first robot on a cantilever's anchor often comes much later, for example as the 13th (IV-C),
   the 12th of ours. An example is no median: index 12 has to lie between the quartiles.
5. Near but unconnected docks are many in towers, and rarer in cantilevers (IV-C, V).
6. Towers are like pyramids: the cross-section narrows with height (IV-B). Shares of towers whose
   thirds hold ever fewer robots are equal, too, if they differ by .1 or less.
7. A cantilever "projects horizontally" (IV-C); its robots "extend into free space" (V). More than
   half of its robots are beyond the edge, in the mean over structures.
8. Towers grow "to a target height of 65", cantilevers toward a goal "45 units horizontally outward"
   (IV-B, IV-C). Nothing says that they reach it. The larger the smaller one of the two shares of
   the goal, the better; shares that differ by .1 or less are equal.

The paper has one kind of robot and one algorithm of growth, so F, B, J and the share that settles
are the same in both kinds. Rules of towers have to keep 1 and 2, of cantilevers 1, 2, 4 and 7. Of
the sets for which both kinds have such rules, the ones with the best towers by 3 remain; of these
the best by 8; of these the ones that keep 5, if any do; of these the best by 6; of these the one
with the fewest changes from tiswarm's defaults, and the F nearest to its default; of sets that are
still equal the best by 8 without slack. In the rules of that set left, robots start behind
`leading` before `placed` before `rear`, as the text says; then the anchor climbs if it may; then
the median of the first robot on it is nearest to 12, where 1 is equal; then it is nearest to the
edge.
"""

import math

import numpy as np
import pandas as pd

from tiswarm.evaluation.paper import PAPER
from tiswarm.world.params import ClimbParams, RecruitParams

SHARED = ("force_threshold", "recruit_base", "recruit_limit", "settle")
"""What both kinds have in common."""

COMPLETE = 0.9
"""Least share of structures with all robots."""

SLACK = 1.05
"""How far the mean size may exceed the bound of the mean errors."""

PROJECTING = 0.5
"""Share of a cantilever's robots beyond the edge that has to be exceeded."""

EQUAL_SHARES = 0.1
EQUAL_MEDIANS = 1.0
FIRST = 12.0
"""Join index of the first robot on a cantilever's anchor, counted from 0."""

_STARTS = ("leading", "placed", "rear")


def size_bound(kind: str) -> float:
    """Return the largest rms radius that the paper's errors allow [rho].

    >>> round(size_bound("tower"), 2), round(size_bound("cantilever"), 2)
    (7.73, 9.6)
    """
    cells = [cell for (of, *_), cell in PAPER.items() if of == kind]
    return min(cell.rmse_radii / math.sqrt(cell.disparity) for cell in cells)


def kept(table: pd.DataFrame) -> pd.Series:
    """Say which rules keep the facts that have to hold, one row a rule."""
    bound = SLACK * table["kind"].map(size_bound)
    late = table["kind"] == "cantilever"
    spans = table["first_quartile"].le(FIRST) & table["third_quartile"].ge(FIRST)
    projects = table["beyond_edge"].gt(PROJECTING)
    whole = table["complete"].ge(COMPLETE) & table["rms_radius_rho"].le(bound)
    return whole & (spans & projects | ~late)


def choose(table: pd.DataFrame) -> pd.DataFrame:
    """Choose a rule of towers and one of cantilevers; empty if no set has both.

    Args:
        table: Facts of each rule, columns of `benchmarks.reactivebuild.anchor`.
    """
    left = table[kept(table)]
    towers, cantilevers = (left[left["kind"] == kind] for kind in ("tower", "cantilever"))
    both = towers.merge(cantilevers, on=[*SHARED], suffixes=("", "_c"))
    both = _most(both, "both_at_once", EQUAL_SHARES)
    both["of_goal"] = both[["of_goal", "of_goal_c"]].min(axis=1)
    both = _most(both, "of_goal", EQUAL_SHARES)
    rarer = both["near_docks_c"] < both["near_docks"]
    both = _most(both[rarer] if rarer.any() else both, "pyramids", EQUAL_SHARES)
    both = both.assign(
        changes=sum(both[key] != usual for key, usual in _usual().items()),
        farther=abs(np.log(both["force_threshold"] / _usual()["force_threshold"])),
    )
    both = _most(_least(_least(both, "changes"), "farther"), "of_goal", 0.0)
    both = both[[*SHARED]].drop_duplicates().head(1)
    return pd.concat([_place(rules.merge(both, on=[*SHARED])) for rules in (towers, cantilevers)])


def _usual() -> dict[str, float]:
    """Return tiswarm's defaults of what both kinds have in common."""
    recruit = RecruitParams()
    return {name: float(getattr(recruit, name)) for name in SHARED[:3]} | {
        "settle": ClimbParams().settle
    }


def _place(rules: pd.DataFrame) -> pd.DataFrame:
    """Choose where the anchor is and robots start, among rules of one kind and set."""
    start = rules["spawn_behind"].fillna("rear").map(_STARTS.index)
    rules = _least(rules.assign(start=start, put=rules["anchor"].notna()), "start")
    rules = _least(rules, "put")
    off = abs(rules["first_on_anchor"] - FIRST)
    rules = _least(rules.assign(off=off), "off", EQUAL_MEDIANS)
    return rules.sort_values("anchor").head(1)[[*rules.columns[: rules.columns.get_loc("start")]]]


def _most(table: pd.DataFrame, column: str, equal: float) -> pd.DataFrame:
    best: pd.DataFrame = table[table[column] >= table[column].max() - equal]
    return best


def _least(table: pd.DataFrame, column: str, equal: float = 0.0) -> pd.DataFrame:
    best: pd.DataFrame = table[table[column] <= table[column].min() + equal]
    return best
