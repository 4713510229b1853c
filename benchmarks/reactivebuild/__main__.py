"""Compares grown structures with the published laws of ReactiveBuild.

    python -m benchmarks.reactivebuild                        # 1,650 structures, minutes
    python -m benchmarks.reactivebuild --set seeds=2 --set robots=40
    python -m benchmarks.reactivebuild reports/reactivebuild-laws-1a2b3c4d

A scenario is run first; a run that was interrupted continues. A run folder is read as it is.
The results go into the subfolder `reactivebuild` of the run folder: `laws.csv` (a row a number),
`law-points.csv` (the means behind the numbers), a figure for each kind, and `laws.html`.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import yaml

import tiswarm
from benchmarks.reactivebuild.figures import CAPTIONS, draw_figures
from benchmarks.reactivebuild.laws import count_verdicts, curves_of, law_points, measure, scorecard
from benchmarks.reactivebuild.structures import read_structures
from tiswarm.base.errors import TiswarmError
from tiswarm.records.messages import counted
from tiswarm.report.page import Page, show_pictures
from tiswarm.report.page_tables import PageTable

SCENARIO = Path("scenarios/reactivebuild-laws.yaml")

SOURCE = (
    "Published values: Swissler and Rubenstein, ReactiveBuild (DARS 2021). Numbers are means over "
    "structures, or fits to means."
)
WORDS = ["verdict", "law", "quantity", "published", "band", "fit"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run scenarios where necessary and compare their structures; return the exit status."""
    options = _options(arguments)
    try:
        for path in options.paths:
            folder = path if path.is_dir() else _run(path, options)
            print(compare(folder))
    except TiswarmError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_status
    return 0


def compare(folder: Path) -> str:
    """Write the scorecard of a run folder; return a line that sums it up.

    Raises:
        InputError: if `folder` is not a run folder.
    """
    structures = read_structures(folder)
    rows = measure(structures)
    table, curves = scorecard(rows), curves_of(rows)
    place = folder / "reactivebuild"
    place.mkdir(exist_ok=True)
    table.to_csv(place / "laws.csv", index=False, lineterminator="\n")
    law_points(curves).to_csv(place / "law-points.csv", index=False, lineterminator="\n")
    summary = count_verdicts(table)
    if structures.failed:
        summary += f"; {counted(structures.failed, 'case')} failed"
    draw_figures(curves, place)
    page = Page(
        name=f"Structures against published laws: {folder.resolve().name}",
        result=f"Published quantities: {summary}.",
        what=SOURCE,
        headline=_verdicts(table),
        figures=[
            picture._replace(caption=CAPTIONS[Path(picture.file).stem])
            for picture in show_pictures(place)
        ],
    )
    (place / "laws.html").write_text(page.html(), encoding="utf-8")
    return f"results in {place}\nlaws.csv: {summary}"


def _verdicts(table: pd.DataFrame) -> PageTable:
    """Format the scorecard, verdicts first."""
    words = table[WORDS].fillna("").astype(str)
    numbers = table[["ours", "r2", "structures"]].astype(float)
    cells = numbers.map(lambda value: "" if math.isnan(value) else f"{value:.4g}")
    shown = ["verdict", "law", "quantity", "ours", "published", "band", "fit", "r2", "structures"]
    return PageTable(frame=words.join(cells)[shown], words=WORDS, title="Verdicts")


def _run(scenario: Path, options: argparse.Namespace) -> Path:
    overrides: dict[str, object] = {}
    for text in options.set:
        key, _, value = text.partition("=")
        overrides[key] = yaml.safe_load(value)
    run = tiswarm.run(scenario, overrides, out=options.out, workers=options.workers, pictures=False)
    return run.folder


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.reactivebuild",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("paths", nargs="*", type=Path, default=[SCENARIO], metavar="PATH",
                        help=f"scenario or run folder (default: {SCENARIO})")  # fmt: skip
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE",
                        help="override a key of the scenario (repeatable)")  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("reports"),
                        help="folder for the run folders (default: reports)")  # fmt: skip
    parser.add_argument("--workers", type=int, help="processes to compute in (default: this one)")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
