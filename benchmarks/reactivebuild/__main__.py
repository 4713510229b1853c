"""Compares grown structures with the published laws of ReactiveBuild.

    python -m benchmarks.reactivebuild                        # 1,650 structures, minutes
    python -m benchmarks.reactivebuild --set seeds=2 --set robots=40
    python -m benchmarks.reactivebuild reports/reactivebuild-laws-1a2b3c4d

A scenario is run first; a run that was interrupted continues. A run folder is read as it is.
The results go into the subfolder `reactivebuild` of the run folder: `laws.csv` (a row a number),
`law-points.csv` (the means behind the numbers), a figure for each kind, and `laws.html`.
"""

import argparse
import html
import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import yaml

import tiswarm
from benchmarks.reactivebuild.figures import draw_figures
from benchmarks.reactivebuild.laws import count_verdicts, curves_of, law_points, measure, scorecard
from benchmarks.reactivebuild.structures import read_structures
from tiswarm.errors import TiswarmError
from tiswarm.records.messages import counted

SCENARIO = Path("scenarios/reactivebuild-laws.yaml")

PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>{title}</title>
<style>
body {{ font: 14px/1.4 sans-serif; margin: 2em auto; max-width: 75em; padding: 0 1em }}
table {{ border-collapse: collapse }}
td, th {{ border-bottom: 1px solid #ddd; padding: 0.2em 0.6em; text-align: left }}
img {{ display: block; margin: 1.5em 0; max-width: 100% }}
</style>
<h1>{title}</h1>
<p>{summary}. Published values: Swissler and Rubenstein, ReactiveBuild (DARS 2021). Numbers are
means over structures, or fits to means.</p>
{table}
{figures}
</html>
"""


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
    summary = f"laws.csv: {count_verdicts(table)}"
    if structures.failed:
        summary += f"; {counted(structures.failed, 'case')} failed"
    figures = [path.name for path in draw_figures(curves, place)]
    (place / "laws.html").write_text(_page(folder.resolve().name, summary, table, figures))
    return f"results in {place}\n{summary}"


def _page(name: str, summary: str, table: pd.DataFrame, figures: Sequence[str]) -> str:
    """Compose a page of the scorecard and its figures."""
    return PAGE.format(
        title=html.escape(f"Structures against published laws: {name}"),
        summary=html.escape(summary),
        table=table.to_html(index=False, na_rep="", float_format="{:.3f}".format, border=0),
        figures="\n".join(f'<img src="{name}" alt="{Path(name).stem}">' for name in figures),
    )


def _run(scenario: Path, options: argparse.Namespace) -> Path:
    overrides: dict[str, object] = {"scorecard": "none"}  # older scenarios ask for one
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
