"""Sets finished runs side by side: `comparison.csv` and `paired.csv`, from their files alone."""

import itertools
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from tiswarm.errors import InputError
from tiswarm.evaluation.metrics import paired_difference
from tiswarm.records.io import make_folder
from tiswarm.study.storage import DONE, CaseRecord, RunFolder, write_table
from tiswarm.study.tables import ACCURACY

FEWEST = 2
TABLE = "comparison.csv"
PAIRED = "paired.csv"
PAIRED_COLUMNS = ["run", "series", "against_run", "against_series", "measure"]


def compare(runs: Sequence[Path], out: Path) -> None:
    """Write every row of the runs' `table.csv` into one table, and differences into another.

    Two runs, or two conditions, are held against each other on the structures that both have: those
    whose true positions are the same to the last bit, whatever the scenarios call them.

    Raises:
        InputError: for less than two different runs, or a folder without one.
        EnvironmentTroubleError: where `out` cannot be made.
    """
    if len({run.resolve() for run in runs}) < max(FEWEST, len(runs)):
        msg = "give two or more different run folders"
        raise InputError(msg, key="RUN")
    names = _names(runs)
    tables = [_table(run).assign(run=name) for run, name in zip(runs, names, strict=True)]
    swept = [list(table.columns[1 : table.columns.get_loc("cases")]) for table in tables]
    first = ["run", "condition", *dict.fromkeys(itertools.chain.from_iterable(swept))]
    both = pd.concat(tables, ignore_index=True)
    make_folder(out)
    write_table(both[[*first, *both.columns.difference(first, sort=False)]], out / TABLE)
    write_table(_paired(dict(zip(names, runs, strict=True))), out / PAIRED)


def _names(runs: Sequence[Path]) -> list[str]:
    """Name of each run's folder, with the folders above where two have the same."""
    names = [run.resolve().name for run in runs]
    return names if len(set(names)) == len(names) else [str(run) for run in runs]


def _table(run: Path) -> pd.DataFrame:
    try:
        return pd.read_csv(run / "table.csv")
    except (OSError, ValueError) as error:
        msg = "holds no table.csv; name a folder that `tiswarm run` made"
        raise InputError(msg, path=run) from error


def _paired(runs: dict[str, Path]) -> pd.DataFrame:
    """One row a measure, for each two series that have structures in common."""
    series = {
        (run, name): accuracy
        for run, folder in runs.items()
        for name, accuracy in _by_series(RunFolder(folder)).items()
    }
    rows = []
    for (first, a), (second, b) in itertools.combinations(series.items(), 2):
        if first[0] == second[0] or a.index.intersection(b.index).empty:
            continue
        x, y = a.align(b, join="inner", axis=0)
        against = dict(zip(PAIRED_COLUMNS, (*second, *first), strict=False))
        rows += [
            {
                **against,
                "measure": name,
                **paired_difference(x[name].to_numpy(float), y[name].to_numpy(float)),
            }
            for name in ACCURACY
        ]
    return pd.DataFrame(rows, columns=None if rows else PAIRED_COLUMNS)


def _by_series(folder: RunFolder) -> dict[str, pd.DataFrame]:
    """Of each series of a run, the accuracy by structure, identified by the digest of its truth."""
    names = sorted(path.name for path in folder.cases.glob("[!.]*"))
    rows: dict[str, dict[str, CaseRecord]] = {}
    for name in names:
        record = folder.recorded(name)
        if record is not None and record.status == DONE:
            structure = record.files["truth.csv"]
            rows.setdefault(record.series, {})[structure] = record
    return {
        series: pd.DataFrame(
            [dict(record.scores) for record in records.values()],
            index=pd.Index(records),
            columns=list(ACCURACY),
        )
        for series, records in rows.items()
    }
