"""What a page says beside its tables: what is wrong with results, and what a reader should know."""

import re
from collections.abc import Iterable, Iterator

import pandas as pd

from tiswarm.measurements.verdicts import describe_misfit
from tiswarm.records.messages import counted
from tiswarm.records.run_folder import Manifest

_MOST_REASONS = 5
_NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_VERDICTS = ("converged", "consistent", "misfit_sd", "sd_factor", "distrust")


def warnings_of(summary: pd.DataFrame) -> list[str]:
    """List what makes results of a run wrong or incomplete."""
    done = summary[summary["status"] == "done"]
    failed = summary[summary["status"] != "done"]
    found = []
    if len(failed):
        why = _some(failed["reason"].dropna().unique(), "; ")
        found.append(f"{len(failed)} of {len(summary)} cases failed: {why}.")
    found += _untrusted(done)
    if "disconnected" in done and (lost := done["disconnected"].fillna(0)).any():
        robots, cases = counted(int(lost.sum()), "robot"), counted(int((lost > 0).sum()), "case")
        found.append(
            f"No measurement that was used ties {robots} in {cases} to the anchor; their positions "
            "are guesses."
        )
    return found


def notes_of(summary: pd.DataFrame, manifest: Manifest) -> list[str]:
    """List what a reader of the results should know."""
    done = summary[summary["status"] == "done"]
    found = []
    ended = done["reason"].dropna()
    if len(ended):
        why = _some(ended.unique(), "; ")
        found.append(
            f"Growth ended before all robots joined in {counted(len(ended), 'case')}: {why}."
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


def _merged(texts: Iterable[str]) -> list[str]:
    """Merge texts that differ in numbers only, into one with the range of each number."""
    alike: dict[str, list[list[str]]] = {}
    for text in texts:
        alike.setdefault(_NUMBER.sub("0", text), []).append(_NUMBER.findall(text))
    merged = []
    for form, found in alike.items():
        ranges = map(_range, zip(*found, strict=True))
        merged.append(_NUMBER.sub(lambda _, some=ranges: next(some), form))  # type: ignore[misc]
    return merged


def _range(numbers: Iterable[str]) -> str:
    """Write the least and the greatest of some numbers, as they are written."""
    least, *_, most = sorted({*numbers}, key=float) * 2
    return least if least == most else f"{least} to {most}"


def _untrusted(done: pd.DataFrame) -> Iterator[str]:
    """Name the cases whose estimate did not converge, or is not consistent, and why."""
    found = done.reindex(columns=[*done, *{*_VERDICTS} - {*done}])
    lost = found["converged"].eq(False)  # noqa: FBT003 - other methods leave it empty
    if lost.any():
        text = f"{_share(found, lost, 'did not converge')}. All tables include their errors."
        yield f"{text} Try more steps or chains."
    at_odds = found["consistent"].eq(False) & ~lost  # noqa: FBT003
    if at_odds.any():
        misfit, factor = found["misfit_sd"][at_odds].dropna(), found["sd_factor"][at_odds].max()
        sizes = [describe_misfit(max(misfit, key=abs, default=0.0))]
        sizes += [f"sd is multiplied by {factor:.2g}"] if factor > 1.0 else []
        most = " and ".join(filter(None, sizes))
        text = _share(found, at_odds, "are not consistent with the noise that their logs state")
        yield f"{text}.{f' At most, {most}.' if most else ''}"


def _share(every: pd.DataFrame, some: pd.Series, what: str) -> str:
    """Count and name cases, or a series that is among them as a whole, and state the reasons."""
    series, reasons = every["series"], every["distrust"][some].dropna().unique()
    whole = some.groupby(series).transform("all") & (series.groupby(series).transform("size") > 1)
    names = [f"all of {name}" for name in series[whole].unique()]
    names += every["case"][some & ~whole].to_list()
    why = f": {_some(_merged(reasons), '; ')}" if len(reasons) else ""
    return f"{some.sum()} of {counted(len(every), 'case')} {what} ({_some(names, ', ')}){why}"
