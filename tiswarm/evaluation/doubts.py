"""Contacts that a method judged wrong, held against what robots truly touched."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from tiswarm.measurements.contacts import sensed_contacts
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog
from tiswarm.world.history import History


def judgement(
    history: History, log: SensingLog, estimate: Estimate, *, cues: Collection[str]
) -> dict[str, float | int]:
    """Count wrong contacts and those that were taken for wrong; empty where none are judged.

    Args:
        history: What robots truly touched.
        log: What they felt.
        estimate: Which of it was judged wrong.
        cues: What of the log the localizer used.
    """
    if estimate.doubted is None:
        return {}
    touched = [np.insert(walk.contacts, 0, j, axis=1) for j, walk in enumerate(history.walks)]
    felt = sensed_contacts(log, cues)
    size = tuple(np.concatenate([*touched, felt]).max(axis=0, initial=0) + 1)
    key_felt, key_doubted = _key(felt, size), _key(estimate.doubted, size)
    wrong = np.setdiff1d(key_felt, _key(np.concatenate(touched), size))
    hits = np.isin(key_doubted, wrong).sum()
    return {
        "wrong_contacts": len(wrong),
        "doubted_contacts": len(key_doubted),
        "doubted_precision": hits / len(key_doubted) if len(key_doubted) else np.nan,
        "doubted_recall": hits / len(wrong) if len(wrong) else np.nan,
    }


def _key(rows: NDArray[np.integer], size: tuple[int, ...]) -> NDArray[np.int64]:
    """One number for each row, shape (K,)."""
    key: NDArray[np.int64] = np.ravel_multi_index(tuple(rows.astype(np.int64).T), size)
    return key
