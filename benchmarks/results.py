"""Keeps the results that pages state in one file, `docs/results.csv`, taken from runs.

    tiswarm run scenarios/joint.yaml --no-pictures
    python -m benchmarks.results reports/joint-6470b495
    python -m benchmarks.results reports/joint-1a2b3c4d --kind "AMD EPYC, no FMA in libraries"
    python -m benchmarks.results --write

A row is the mean of a measure over the structures of a condition and point that have it, with its
95 % confidence interval: Wilson's of a share of structures, else Student's. Shares of robots that
differ between structures had Wilson's up to version 0.3.0, of as many zeros and ones as vary alike.
These rows have it still: those of scenarios other than anchor-gap, joint and paper-sets, and those
of libraries without AVX2 and FMA by Algorithm 1. Rows of the same structures, computed on the same
kind of processor, are replaced; all others stay. `--write` puts the numbers of the file between the
marks of pages: `benchmarks/statements.py` has the text of each mark.
`tests/benchmarks/test_results.py` claims that nothing is left to write.
"""

import argparse
import json
import re
import sys
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks import paper_facts
from benchmarks.marks import write_texts
from benchmarks.statements import texts_of
from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.records.intervals import ends_of, mean_std_ci95
from tiswarm.records.measures import FEWEST
from tiswarm.records.measures import MEASURES as ALL_MEASURES

REPOSITORY = Path(__file__).parents[1]
RESULTS = REPOSITORY / "docs" / "results.csv"

MEASURES = {
    "rmse_R": "R",
    "procrustes_disparity": "1",
    "floppy_modes": "1",
    "contacts_per_robot": "1",
    "rms_radius_R": "R",
    "height_R": "R",
    "reach_R": "R",
    "beyond_edge": "1",
    "first_on_anchor": "1",
    "within_dock": "1",
    "flips_as_planned": "1",
    "failed_flips": "1",
    "tries_per_robot": "1",
    "crossed": "1",
    "belief_building_R": "R",
    "belief_newest_R": "R",
    "belief_final_R": "R",
    "belief_per_contact_R": "R",
    "belief_sent_B": "B",
    "belief_worst_sent_B": "B",
    "sent_B": "B",
    "worst_sent_B": "B",
    "worst_memory_B": "B",
    "rounds": "1",
    "joined": "1",
    "located": "1",
    "rmse_located_R": "R",
    "above_crowd": "1",
    "peak_stress": "W/R^2",
    "rmse_per_contact_R": "R",
    "converged": "1",
    "consistent": "1",
}
"""Measures that are kept where a run has them, with their units."""

KEY = ("scenario", "condition", "point", "measure", "seeds", "kind")
"""Columns by which a row is found."""

_DIGITS = 4
"""Digits of stored numbers: pages state three at most."""


def rows_of(run: Path, kind: str = "") -> pd.DataFrame:
    """Take the results from the folder of a finished run.

    Args:
        run: Folder of the run.
        kind: Kind of processor; that of the manifest if empty.

    Raises:
        InputError: the folder has no summary or manifest.
    """
    try:
        cases = pd.read_csv(run / "summary.csv", keep_default_na=False, na_values=[""])
        manifest = json.loads((run / "manifest.json").read_text())
        written = (run / "manifest.json").stat().st_mtime
    except OSError as error:
        raise InputError("this is no finished run; give the folder of one", path=run) from error
    shared = {
        "version": manifest["tiswarm"],
        "kind": kind or _kind(manifest),
        "date": f"{datetime.fromtimestamp(written, timezone.utc):%Y-%m-%d}",
    }
    scenario = run.name.rpartition("-")[0]
    done = cases[cases["status"] == "done"].fillna({"point": ""})
    measures = MEASURES
    if scenario == paper_facts.SCENARIO:
        done = paper_facts.with_facts(run, done)
        measures = MEASURES | paper_facts.UNITS
    rows = []
    for (condition, point), group in done.groupby(["condition", "point"], sort=False):
        first, last = group["seed"].min(), group["seed"].max()
        seeds = {"seeds": f"{first}-{last}"}
        of = {"scenario": scenario, "condition": condition, "point": point}
        for name, unit in measures.items():
            if name not in group or group[name].isna().all():
                continue
            values = group[name].to_numpy(float)
            value, low, high = (float(f"{end:.{_DIGITS}g}") for end in _with_ends(name, values))
            structures = {"structures": int(np.isfinite(values).sum())}
            rows.append(
                of
                | {"measure": name, "value": value, "low": low, "high": high, "unit": unit}
                | seeds
                | structures
                | shared
            )
    if scenario == paper_facts.SCENARIO:
        together = paper_facts.of_groups(run, done)
        together["value"] = [float(f"{value:.{_DIGITS}g}") for value in together["value"]]
        of_all = pd.DataFrame(rows).drop_duplicates(["condition", "point"])
        of_all = of_all[["scenario", "condition", "point", "seeds", "structures", *shared]]
        rows += together.merge(of_all, on=["condition", "point"]).to_dict("records")
    return pd.DataFrame(rows)


def _with_ends(name: str, values: Reals) -> tuple[float, float, float]:
    """Return the mean of a measure with the ends of its 95 % confidence interval.

    Shares end at 0 and 1. Ends of means of fewer than `FEWEST` structures, shape (n,), are NaN.
    """
    statistics = mean_std_ci95(values)
    mean = statistics["mean"]
    measure = ALL_MEASURES.get(name)
    if measure is not None and measure.is_share and np.isfinite(values).sum() >= FEWEST:
        return mean, *ends_of(measure, values).values()
    return mean, mean - statistics["ci95"], mean + statistics["ci95"]


def _kind(manifest: Mapping[str, Any]) -> str:
    """Name a processor with its family and model, by which LLVM distinguishes it."""
    kernels = " ".join(each["kernels"] for each in manifest.get("numerics", ()))
    model = re.search(r"family \d+ model \d+", kernels)
    return " ".join(filter(None, [manifest["machine"]["processor"], model and model[0]]))


def merged(old: pd.DataFrame, new: pd.DataFrame) -> pd.DataFrame:
    """Replace rows by those with the same key, and sort all."""
    every = pd.concat([old, new]) if len(old) else new
    return every.drop_duplicates([*KEY], keep="last").sort_values([*KEY], ignore_index=True)


def read_results(path: Path = RESULTS) -> pd.DataFrame:
    """Read the file of results; without rows if there is none."""
    if not path.exists():
        return pd.DataFrame()
    # Rows of few structures have no interval; all other empty cells are texts.
    without = {"low": [""], "high": [""]}
    return pd.read_csv(path, keep_default_na=False, na_values=without)


def pages() -> list[Path]:
    """List the pages that may have marks."""
    return [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]


def write_pages(texts: Mapping[str, str]) -> list[Path]:
    """Write texts between the marks of all pages, and return the pages that changed.

    Raises:
        InputError: a mark is wrong; no page is written.
    """
    changed = {}
    for path in pages():
        page = path.read_text()
        written = write_texts(page, texts, path)
        if written != page:
            changed[path] = written
    for path, written in changed.items():
        path.write_text(written)
    return list(changed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Update the file of results from runs, or pages from the file; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.results",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("runs", type=Path, nargs="*", metavar="RUN", help="folder of a run")
    parser.add_argument("--kind", default="", help="kind of processor, if not the manifest's")
    parser.add_argument("--out", type=Path, default=RESULTS, help="file of results")
    parser.add_argument("--write", action="store_true", help="write the file's numbers to pages")
    options = parser.parse_args(arguments)
    if not options.runs and not options.write:
        parser.error("nothing to do; give the folder of a run, or --write")
    results = read_results(options.out)
    try:
        for run in options.runs:
            results = merged(results, rows_of(run, options.kind))
        if options.runs:
            results.to_csv(options.out, index=False, lineterminator="\n")
            print(f"{options.out}: {len(results)} results")
        if options.write:
            for path in write_pages(texts_of(results)):
                print(f"wrote {path}")
    except InputError as error:
        parser.error(str(error))
    return 0


if __name__ == "__main__":
    sys.exit(main())
