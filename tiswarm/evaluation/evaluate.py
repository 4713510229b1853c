"""All that a study keeps of an estimate against the truth."""

from collections.abc import Collection, Mapping
from typing import NamedTuple

import pandas as pd

from tiswarm.evaluation import tables
from tiswarm.evaluation.profiles import by_hops_apart
from tiswarm.measurements.cues import Measured
from tiswarm.records.estimate import Estimate
from tiswarm.records.positions import Truth
from tiswarm.records.sensing_log import SensingLog
from tiswarm.world.history import History


class Evaluation(NamedTuple):
    """An estimate against the truth: scores and tables, each by name."""

    truth: Truth
    scores: Mapping[str, float | int]
    measurements: str
    """Cues that the method used and the log has."""

    tables: Mapping[str, pd.DataFrame]


def evaluate(
    history: History, log: SensingLog, estimate: Estimate, cues: Collection[str]
) -> Evaluation:
    """Compare the estimate of a log, localized by these cues, with the structure it is of."""
    truth = Truth(
        robot_id=log.robot_id,
        position=history.position,
        orientation_wxyz=history.orientation_wxyz,
    )
    measured = Measured(log)
    rows = measured.rows(cues)
    scores = tables.score(truth, log, estimate, history.robot, rows=rows)
    scores |= tables.outlier_scores(history, estimate, rows=rows) | tables.totals(history)
    return Evaluation(
        truth=truth,
        scores=scores,
        measurements=", ".join(measured.used(cues)),
        tables={
            "robots": tables.by_robot(truth, log, estimate, history.sensed),
            "convergence": tables.by_iteration(truth, estimate),
            "growth": tables.by_join(history),
            "relative": by_hops_apart(truth, log, estimate),
        },
    )
