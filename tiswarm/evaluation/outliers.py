"""Outliers that a method detected among the contacts, compared with the true contacts."""

from collections.abc import Collection

import numpy as np

from tiswarm.aliases import AnyInts, Ints
from tiswarm.measurements.contacts import sensed_contacts
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog
from tiswarm.world.history import History


def outlier_scores(
    history: History, log: SensingLog, estimate: Estimate, *, cues: Collection[str]
) -> dict[str, float | int]:
    """Return precision and recall of the detected outliers, and the counts behind them.

    A contact is wrong if the robots did not touch with these docks in that stance.

    Args:
        history: True contacts of every stance.
        log: Sensed contacts.
        estimate: Detected outliers.
        cues: Cues of the log that the localizer used.

    Returns:
        Scores by name; NaN where no contact is wrong or detected; empty where the method detects
        no outliers.
    """
    if estimate.outlier_contacts is None:
        return {}
    touched = [np.insert(walk.contacts, 0, j, axis=1) for j, walk in enumerate(history.walks)]
    felt = sensed_contacts(log, cues)
    size = tuple(np.concatenate([*touched, felt]).max(axis=0, initial=0) + 1)
    outlier = _key(estimate.outlier_contacts, size)
    wrong = np.setdiff1d(_key(felt, size), _key(np.concatenate(touched), size))
    hits = np.isin(outlier, wrong).sum()
    return {
        "wrong_contacts": len(wrong),
        "outliers": len(outlier),
        "outlier_precision": hits / len(outlier) if len(outlier) else np.nan,
        "outlier_recall": hits / len(wrong) if len(wrong) else np.nan,
    }


def _key(rows: AnyInts, size: tuple[int, ...]) -> Ints:
    """Encode each row as one number, shape (K,)."""
    key: Ints = np.ravel_multi_index(tuple(rows.astype(np.int64).T), size)
    return key
