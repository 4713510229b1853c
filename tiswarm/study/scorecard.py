"""`laws.csv`: the structures of a run held against the laws they should follow."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from tiswarm.compute.math import dock_offsets
from tiswarm.evaluation.grown import SETTINGS, TOTALS, Grown
from tiswarm.evaluation.laws import scorecard
from tiswarm.evaluation.verdicts import IN_BAND, NOT_MEASURED, REPORTED
from tiswarm.study.cases import Case
from tiswarm.study.storage import DONE, CaseRecord, RunFolder, write_table

Finished = Sequence[tuple[Case, CaseRecord]]

LAWS = "laws.csv"
POINTS = "law-points.csv"
JOINS = ["robots", "height_R", "reach_R", "depth_R", "peak_stress"]
POSITION = ["x_R", "y_R", "z_R"]
ORIENTATION = ["qw", "qx", "qy", "qz"]


def write_scorecard(
    folder: RunFolder, cases: Sequence[Case], records: Sequence[CaseRecord]
) -> None:
    """Write `laws.csv` and the means behind it, `law-points.csv`, from the stored cases.

    Of several conditions the first alone is looked at, for they share their structures.
    """
    first = cases[0].variant.condition if cases else ""
    finished = [
        (case, record)
        for case, record in zip(cases, records, strict=True)
        if record.status == DONE and record.condition == first
    ]
    grown = Grown(
        structures=_structures(finished),
        joins=_joins(folder, finished),
        spheres=_spheres(folder, finished),
    )
    laws, points = scorecard(grown)
    write_table(laws, folder.path / LAWS)
    write_table(points, folder.path / POINTS)


def summed_up(folder: Path) -> str:
    """Say how many numbers of a scorecard are in band; nothing for a run without one."""
    try:
        verdicts = pd.read_csv(folder / LAWS)["verdict"].value_counts()
    except FileNotFoundError:
        return ""
    reported, missing = (int(verdicts.get(verdict, 0)) for verdict in (REPORTED, NOT_MEASURED))
    judged = int(verdicts.sum()) - reported - missing
    missed = f", {missing} not measured" if missing else ""
    return f"{LAWS}: {verdicts.get(IN_BAND, 0)} of {judged} in band, {reported} reported{missed}"


def _structures(finished: Finished) -> pd.DataFrame:
    """One row a structure: settings and totals."""
    rows = [
        {
            "case": case.name,
            **{name: getattr(case.settings.structure, name, None) for name in SETTINGS},
            **{name: record.scores[name] for name in TOTALS},
        }
        for case, record in finished
    ]
    return pd.DataFrame(rows, columns=["case", *SETTINGS, *TOTALS])


def _joins(folder: RunFolder, finished: Finished) -> pd.DataFrame:
    """One row a join of every structure."""
    tables = [
        pd.read_csv(folder.cases / case.name / "growth.csv", usecols=JOINS).assign(case=case.name)
        for case, _ in finished
    ]
    return pd.concat(tables) if tables else pd.DataFrame(columns=["case", *JOINS], dtype=float)


def _spheres(folder: RunFolder, finished: Finished) -> pd.DataFrame:
    """One row a dock sphere of every structure: its height."""
    tables = []
    for case, _ in finished:
        robots = pd.read_csv(folder.cases / case.name / "robots.csv")
        body = case.settings.robot.dock_offset_body
        docks = dock_offsets(robots[ORIENTATION].to_numpy(), body)
        height = robots["z_R"].to_numpy()[:, None] + docks[:, :, 2]
        tables.append(pd.DataFrame({"case": case.name, "z_R": height.ravel()}))
    return pd.concat(tables) if tables else pd.DataFrame(columns=["case", "z_R"], dtype=float)
