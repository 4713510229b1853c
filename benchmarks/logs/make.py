"""Makes the logs of the benchmark and their limits anew.

    python -m benchmarks.logs.make

The files of `benchmarks/logs/data` change only where tiswarm grows, senses or minimizes otherwise
than before; commit them only if a log is added. Kernels must compute in f64 on a processor.
"""

import tempfile
from dataclasses import asdict
from pathlib import Path

import pandas as pd

import tiswarm
from benchmarks.logs.catalog import SOURCES, Source
from benchmarks.logs.grade import Bound
from benchmarks.logs.limit import limit
from tests.foreign import Log
from tiswarm.compute import backend
from tiswarm.records.positions import read_positions_of, write_positions
from tiswarm.records.sensing_file import write_sensing_log

FOLDER = Path(__file__).parent / "data"


def main() -> None:
    """Write all logs, their true positions, and `limits.csv`."""
    backend.start()
    bounds = []
    for source in SOURCES:
        log, truth = made(source)
        write_sensing_log(log, FOLDER / f"{source.name}.jsonl")
        write_positions(
            FOLDER / f"{source.name}.truth.csv", log.robot_id, truth, length_unit=log.length_unit
        )
        found = limit(log, truth, source.frame)
        bounds.append(
            Bound(
                log=source.name,
                group=source.group,
                about=source.about,
                unit=log.length_unit,
                dock_radius=log.dock_radius,
                robots=log.robot_count,
                tied=int(found.tied.sum()),
                floppy=found.floppy,
                images=source.images,
                limit=float(f"{round(found.optimum, 9):.4g}"),
                frame=source.frame,
            )
        )
        print(f"{source.name}: limit {found.optimum:.4g} {log.length_unit}", flush=True)
    pd.DataFrame([asdict(each) for each in bounds]).to_csv(FOLDER / "limits.csv", index=False)


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
