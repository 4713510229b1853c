"""The tables and warnings of a run's page: chosen columns, formatted, with units."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import pandas as pd

from tiswarm.records.messages import counted
from tiswarm.records.run_folder import Manifest
from tiswarm.report.run_data import swept_words

_MOST_CASES = 2_000  # rows of the table of cases; `summary.csv` has all
_MOST_REASONS = 5

# Label, name of the measure and decimals of each column.
_ACCURACY = [
    ("RMSE [R]", "rmse_R", 2),
    ("RMSE [rho]", "rmse_rho", 2),
    ("disparity", "procrustes_disparity", 4),
]
_LIMITS = [
    ("contacts per robot", "contacts_per_robot", 2),
    ("floppy modes", "floppy_modes", 1),
    ("rms radius [R]", "rms_radius_R", 1),
]
_ALIGNED = [
    ("not aligned", "rmse_R", 2),
    ("yaw and translation aligned", "rmse_yaw_aligned_R", 2),
    ("rigidly aligned", "rmse_rigid_aligned_R", 2),
    ("relative, robots in contact", "rmse_per_contact_R", 2),
]
_CALIBRATION = [
    ("robots in their 50 % interval", "coverage_50", 2),
    ("robots in their 90 % interval", "coverage_90", 2),
    ("precision of outliers", "outlier_precision", 2),
    ("recall of outliers", "outlier_recall", 2),
    ("converged estimates", "converged", 2),
]
_ANCHOR = [
    ("first robot", "first_on_anchor", 1),
    ("second robot", "second_on_anchor", 1),
    ("third robot", "third_on_anchor", 1),
]
_PUBLISHED = [
    ("published RMSE [robot radii]", "paper_rmse_radii", 2),
    ("RMSE [R]", "rmse_R_mean", 2),
    ("RMSE [rho]", "rmse_rho_mean", 2),
    ("RMSE [mm]", "rmse_mm_mean", 0),
    ("best structure [R]", "rmse_R_least", 2),
    ("published change [%]", "paper_rmse_change_percent", 0),
    ("change [%]", "rmse_change_percent", 0),
    ("published disparity", "paper_procrustes_disparity", 3),
    ("disparity", "procrustes_disparity_mean", 3),
]
_CASE = [
    ("robots", "robots", 0),
    *_ACCURACY[:1],
    ("yaw aligned [R]", "rmse_yaw_aligned_R", 2),
    ("rigidly aligned [R]", "rmse_rigid_aligned_R", 2),
    *_ACCURACY[2:],
    *_LIMITS,
    *[(f"{label} on the anchor", name, 0) for label, name, _ in _ANCHOR],
    ("height [R]", "height_R", 1),
    ("peak stress", "peak_stress", 0),
]
_MEASURES = {"rmse_R": "RMSE [R]", "procrustes_disparity": "disparity"}

_Column = tuple[str, str, int]


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of the page."""

    frame: pd.DataFrame  # formatted cells, all of them text
    words: Collection[str]  # columns of words, which are aligned left; the others contain numbers
    title: str = ""
    note: str = ""


def result_tables(table: pd.DataFrame, paired: pd.DataFrame) -> list[Table]:
    """Format the results of a run; `paired` may be empty."""
    words = swept_words(table)
    note = (
        "Alignment removes a rotated or shifted frame; the rest is a wrong shape. The last column "
        "is the error of one robot's position relative to a robot in contact."
    )
    aligned = _labeled(words, _means(table, _ALIGNED), "RMSE after alignment [R]", note)
    tables = [_localization(table), aligned]
    if table["paper_rmse_radii"].notna().any():
        tables.insert(1, _beside_the_paper(table))
    if anchor := _means(table, _ANCHOR):
        note = (
            "Join index of the robots that touch the anchor in the end; the anchor has index 0. "
            "Means are over structures in which so many robots touch it."
        )
        tables.append(_labeled(words, anchor, "Robots on the anchor", note))
    if calibration := _means(table, _CALIBRATION):
        note = (
            "Fractions. A robot is in its interval if its error is within the interval that its "
            "standard deviation implies. Precision: wrong contacts among those reported as "
            "outliers; recall: reported outliers among wrong contacts."
        )
        tables.append(_labeled(words, calibration, "Calibration", note))
    if len(paired):
        tables.append(_differences(paired))
    return tables


def _localization(table: pd.DataFrame) -> Table:
    """Format accuracy, and what limits it."""
    note = "Mean ± half width of its 95 % confidence interval over structures."
    columns = {"structures": _numbers(table["cases"], 0)} | _means(table, [*_ACCURACY, *_LIMITS])
    return _labeled(swept_words(table), columns, "Localization", note)


def _beside_the_paper(table: pd.DataFrame) -> Table:
    """Format the rows of the paper's settings beside its numbers."""
    rows = table[table["paper_rmse_radii"].notna()]
    note = (
        "R is the radius of a dock, rho the distance from a robot's center to a dock; 1 R is 32.9 "
        'mm, as in the paper\'s towers. The paper does not define its "robot radius". Changes are '
        "relative to the first condition."
    )
    columns = {label: _numbers(rows[name], n) for label, name, n in _PUBLISHED if name in rows}
    return _labeled(swept_words(rows), columns, "Beside the paper", note)


def _differences(paired: pd.DataFrame) -> Table:
    """Format differences between conditions on the same structures."""
    first = paired["against"] == paired["against"].iloc[0]
    rows = paired[first & paired["measure"].isin(list(_MEASURES))]
    words = swept_words(rows, before="measure").assign(measure=rows["measure"].map(_MEASURES))
    p = rows["wilcoxon_p"]
    columns = {
        "difference": _mean(rows, "difference", 3, sign="+"),
        "smaller in": rows["smaller"].astype(str) + " of " + rows["structures"].astype(str),
        "p": _numbers(p, 4).mask(p < 1e-4, "< 0.0001"),  # noqa: PLR2004 - four decimals
    }
    note = (
        "p of Wilcoxon's signed-rank test, not corrected for multiple comparisons. paired.csv "
        "contains all measures and pairs of conditions."
    )
    return _labeled(words, columns, "Differences on the same structures", note)


def case_table(summary: pd.DataFrame) -> Table:
    """Format a row for each case."""
    shown = summary.head(_MOST_CASES)
    words = shown[["case", "status"]].fillna("").astype(str)
    numbers = {label: _numbers(shown[name], n) for label, name, n in _CASE if name in shown}
    reason = {"reason": shown["reason"].fillna("").astype(str)}
    left_out = len(summary) - len(shown)
    note = f"{counted(left_out, 'more case')} in summary.csv." if left_out else ""
    return replace(_labeled(words, numbers | reason, "", note), words=[*words, "reason"])


def machine_table(manifest: Manifest) -> Table:
    """Format the machine, the versions and the computing times."""
    facts = {
        **manifest.machine,
        **manifest.backend,
        "peak_memory_MB": manifest.peak_memory_MB,
        "python": manifest.python,
        **manifest.libraries,
    }
    for name, spent in manifest.stages.items():
        facts[f"{name} [s wall, s CPU]"] = f"{spent.wall_s}, {spent.cpu_s}"
    rows = [
        (name.replace("_MB", " [MB]").replace("_", " "), str(value))
        for name, value in facts.items()
        if value not in {"", None}
    ]
    frame = pd.DataFrame(rows, columns=["item", "value"])
    return Table(frame=frame, words=["item", "value"], title="Machine and versions")


def _labeled(words: pd.DataFrame, columns: dict[str, pd.Series], title: str, note: str) -> Table:
    """Put columns of words beside columns of formatted numbers."""
    frame = pd.concat([words, pd.DataFrame(columns, index=words.index)], axis=1)
    return Table(frame=frame, words=words.columns.astype(str), title=title, note=note)


def _means(table: pd.DataFrame, columns: Sequence[_Column]) -> dict[str, pd.Series]:
    """Format the means that a table has, by label."""
    return {
        label: _mean(table, name, digits)
        for label, name, digits in columns
        if f"{name}_mean" in table and table[f"{name}_mean"].notna().any()
    }


def _mean(table: pd.DataFrame, name: str, digits: int, *, sign: str = "") -> "pd.Series[str]":
    """Format means with the half widths of their confidence intervals."""
    mean = _numbers(table[f"{name}_mean"], digits, sign=sign)
    width = table.get(f"{name}_ci95", pd.Series(float("nan"), table.index))
    return mean + (" ± " + _numbers(width, digits)).where(width.notna() & (mean != ""), "")


def _numbers(values: pd.Series, digits: int, *, sign: str = "") -> "pd.Series[str]":
    """Format numbers; unknown ones are empty."""
    texts = values.astype(float).map(lambda v: "" if pd.isna(v) else f"{v:{sign}.{digits}f}")
    return texts.astype(str)  # of no values too


def warnings_of(summary: pd.DataFrame, manifest: Manifest) -> list[str]:
    """List what limits the results of a run."""
    done = summary[summary["status"] == "done"]
    failed = summary[summary["status"] != "done"]
    found = []
    if len(failed):
        why = _some(failed["reason"].dropna().unique(), "; ")
        found.append(f"{len(failed)} of {len(summary)} cases failed: {why}.")
    found += _unconverged(done)
    ended = done["reason"].dropna()
    if len(ended):
        why = _some(ended.unique(), "; ")
        found.append(f"Growth ended early in {counted(len(ended), 'case')}: {why}.")
    if "disconnected" in done and (lost := done["disconnected"].fillna(0)).any():
        robots, cases = counted(int(lost.sum()), "robot"), counted(int((lost > 0).sum()), "case")
        found.append(
            f"No measurement that was used ties {robots} in {cases} to the anchor; their positions "
            "are guesses."
        )
    if "floppy_modes" in done and ((modes := done["floppy_modes"]) > 0).any():
        least, most = f"{modes.min():.0f}", f"{modes.max():.0f}"
        count = least if least == most else f"{least} to {most}"
        found.append(
            f"The measurements that the method uses leave {count} floppy modes a case: motions "
            "that change no measurement. No method can remove errors along them."
        )
    reasons = sorted({origin.reason for origin in manifest.renders.values() if origin.reason})
    return found + [f"A simpler renderer drew the pictures: {reason}." for reason in reasons]


def _some(items: Iterable[object], separator: str) -> str:
    """Join the first of some texts."""
    first = [*map(str, items)]
    more = ["..."] if len(first) > _MOST_REASONS else []
    return separator.join(first[:_MOST_REASONS] + more)


def _unconverged(done: pd.DataFrame) -> list[str]:
    """Name the cases whose estimate did not converge."""
    if "converged" not in done:
        return []
    lost = done[done["converged"].eq(False)]  # noqa: FBT003 - other methods leave it empty
    if not len(lost):
        return []
    warning = (
        f"{len(lost)} of {counted(len(done), 'case')} did not converge "
        f"({_some(lost['case'], ', ')}). The misfit of their best chain exceeds its expectation "
        f"by up to {lost['misfit_sd'].max():.0f} sd. All tables include their errors. Try more "
        "steps or chains."
    )
    return [warning]
