"""`comparison.csv` and `paired.csv` of several runs."""

import itertools
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pandas as pd

from tiswarm.base.errors import InputError
from tiswarm.records import outputs
from tiswarm.records.frames import read_frame, write_frame
from tiswarm.records.io import damaged, make_folder
from tiswarm.records.messages import shown
from tiswarm.records.run_folder import TABLE_NOTES
from tiswarm.study.store import CaseRecord, RunFolder
from tiswarm.study.tables import accuracy_by_key, differences

_COMPARED = ["run", "series", "against_run", "against_series", "measure"]


COMPARISON = ("comparison.csv", "paired.csv", "comparison.png")
"""Files of a comparison."""


def compare(runs: Sequence[Path], out: Path, *, overwrite: bool = False) -> None:
    """Write `comparison.csv`, all rows of the runs' `table.csv`, and `paired.csv`, differences.

    Differences are on the structures that two runs share: those with the same true positions to
    the last bit; names of scenarios do not matter.

    Raises:
        InputError: fewer than two different runs are given, a folder has no `table.csv`, or a table
            would replace a file that no tiswarm command wrote.
        EnvironmentTroubleError: `out` cannot be made.
    """
    if len({run.resolve() for run in runs}) < max(2, len(runs)):
        raise InputError("give two or more different run folders", key="RUN")
    names = [run.resolve().name for run in runs]
    if len(set(names)) < len(names):
        names = [str(run) for run in runs]
    tables = [_read_table(run).assign(run=name) for run, name in zip(runs, names, strict=True)]
    swept = [list(table.columns[1 : table.columns.get_loc("cases")]) for table in tables]
    first = ["run", "condition", *dict.fromkeys(itertools.chain.from_iterable(swept))]
    both = pd.concat(tables, ignore_index=True)
    series = {
        (name, label): accuracy
        for run, name in zip(runs, names, strict=True)
        for label, accuracy in _by_series(RunFolder(run)).items()
    }
    rows = []
    for (one, before), (other, after) in itertools.combinations(series.items(), 2):
        if one[0] != other[0] and not before.index.intersection(after.index).empty:
            pair = dict(zip(_COMPARED, (*other, *one), strict=False))
            rows += differences(pair, before, after)
    make_folder(out)
    opened = partial(outputs.opened, overwrite=overwrite)
    columns = [*first, *both.columns.difference(first, sort=False)]
    write_frame(both[columns], out / "comparison.csv", opened=opened)
    pairs = pd.DataFrame(rows, columns=None if rows else _COMPARED)
    write_frame(pairs, out / "paired.csv", opened=opened)


def _read_table(run: Path) -> pd.DataFrame:
    path = run / "table.csv"
    if not path.exists():
        msg = "has no table.csv; give a folder that `tiswarm run` made"
        raise InputError(msg, path=run)
    measures = ["rmse_R_mean", "rmse_R_ci95", "procrustes_disparity_mean"]
    table = read_frame(
        path, ["condition"], ["cases"], gaps=measures, notes=TABLE_NOTES, numbers_after="cases"
    )
    for text in map(str, [*table.columns, *table.to_numpy().ravel()]):
        if not text.isprintable():  # a terminal would obey it
            raise damaged(path, f"{shown(text)} is not printable")
    return table


def _by_series(folder: RunFolder) -> dict[str, pd.DataFrame]:
    """Return the accuracy of each series of a run, by the digest of each structure's truth."""
    series: dict[str, dict[str, CaseRecord]] = {}
    for path in sorted(folder.cases.glob("[!.]*")):
        record = folder.read_case(path.name)
        if record is not None and record.is_done:
            series.setdefault(record.series, {})[record.files["truth.csv"]] = record
    return {name: accuracy_by_key(records) for name, records in series.items()}
