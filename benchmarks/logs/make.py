"""Makes the logs of the benchmark and their limits anew.

    python -m benchmarks.logs.make
    python -m benchmarks.logs.make --limits    # of the logs as they are

The files of `benchmarks/logs/data` change only where tiswarm grows, senses or minimizes otherwise
than before; commit them only if a log is added. Kernels must compute in f64 on a processor.
"""

import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

import pandas as pd

import tiswarm
from benchmarks.logs.catalog import SOURCES, Source
from benchmarks.logs.grade import Bound
from benchmarks.logs.limit import limit
from tests.foreign import Log
from tiswarm.base.aliases import Reals
from tiswarm.compute import backend
from tiswarm.records.positions import read_positions_of, write_positions
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.records.sensing_log import SensingLog

FOLDER = Path(__file__).parent / "data"


def main() -> None:
    """Write all logs, their true positions, and `limits.csv`."""
    backend.start()
    bounds = []
    for source in SOURCES:
        log, path = FOLDER / f"{source.name}.jsonl", FOLDER / f"{source.name}.truth.csv"
        if "--limits" not in sys.argv[1:]:
            sensed, truth = made(source)
            write_sensing_log(sensed, log)
            write_positions(path, sensed.robot_id, truth, length_unit=sensed.length_unit)
        sensed = tiswarm.read_log(log)
        bounds.append(_bound(source, sensed, read_positions_of(sensed, path)))
        print(f"{source.name}: limit {bounds[-1].limit:.4g} {sensed.length_unit}", flush=True)
    pd.DataFrame([asdict(each) for each in bounds]).to_csv(FOLDER / "limits.csv", index=False)


def _bound(source: Source, log: SensingLog, truth: Reals) -> Bound:
    """Describe what can be known from a log."""
    found = limit(log, truth, source.frame)
    return Bound(
        log=source.name,
        group=source.group,
        about=source.about,
        unit=log.length_unit,
        dock_radius=log.dock_radius,
        robots=log.robot_count,
        tied=int(found.known.tied.sum()),
        floppy=found.floppy,
        images=source.images,
        determined=int(found.known.determined.sum()),
        limit=float(f"{round(found.optimum, 9):.4g}"),
        frame=source.frame,
    )


def made(source: Source) -> Log:
    """Make a log, and the true centers of its robots [log unit], shape (N, 3)."""
    if source.make is not None:
        return source.make()
    with tempfile.TemporaryDirectory() as scratch:
        run = tiswarm.run(source.scenario, out=scratch, pictures=False, quiet=True)
        [case] = run.folder.glob("cases/*")
        log = tiswarm.read_log(case / "sensing.jsonl")
        return log, read_positions_of(log, case / "truth.csv")


if __name__ == "__main__":
    main()
