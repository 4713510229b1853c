"""Contacts that robots sense: missed, wrong and false ones, and docks that are not known."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Reals
from tiswarm.compute.math import uniform
from tiswarm.sensing.params import SensingParams
from tiswarm.world.history import History


def sensed_contacts(history: History, params: SensingParams) -> NDArray[np.int32]:
    """Return the contacts sensed at all stances, sorted and unique, shape (K, 5).

    A row is (robot, stance, own dock, other robot, other dock).
    """
    true = history.table("contacts")
    if params.missed_contacts == params.wrong_docks == params.false_contacts == 0.0:
        return true
    robot = true[:, 0]
    place = np.concatenate([np.arange(len(walk.contacts)) for walk in history.walks])

    def draw(stream: str, which: int) -> Reals:
        return uniform(history.seed, stream, robot, 4 * place + which)

    docks = len(history.robot.dock_offset_body)
    false = true.copy()
    false[:, 2] = draw("false contact", 1) * docks
    false[:, 3] = draw("false contact", 2) * robot
    false[:, 4] = draw("false contact", 3) * docks
    false = false[draw("false contact", 0) < params.false_contacts]
    is_wrong = draw("wrong dock", 0) < params.wrong_docks
    turned = 1 + (draw("wrong dock", 1) * (docks - 1)).astype(np.int32)
    sensed = true.copy()
    sensed[is_wrong, 4] = (sensed[:, 4] + turned)[is_wrong] % docks
    sensed = sensed[draw("missed contact", 0) >= params.missed_contacts]
    rows: NDArray[np.int32] = np.unique(np.concatenate([sensed, false]), axis=0)
    return rows


def felt_part(history: History) -> History:
    """Leave out of final stances the contacts that broke: robots feel them no more."""
    if not len(history.broken):
        return history
    walks = []
    for robot, walk in enumerate(history.walks):
        is_last = walk.contacts[:, 0] == walk.stance_count - 1
        touched = np.insert(walk.contacts[:, [2, 3, 1]], 2, robot, axis=1)
        contacts = walk.contacts[~(is_last & history.is_broken(touched))]
        stands = np.insert(walk.ground_docks[:, 1:], 0, robot, axis=1)
        is_last = walk.ground_docks[:, 0] == walk.stance_count - 1
        ground_docks = walk.ground_docks[~(is_last & history.is_broken(stands))]
        walks.append(replace(walk, contacts=contacts, ground_docks=ground_docks))
    return replace(history, walks=tuple(walks))


def split_touches(contacts: NDArray[np.int32], params: SensingParams) -> dict[str, NDArray[Any]]:
    """Split contacts into those with docks and touches, whose docks robots do not all know."""
    touches = contacts.copy()
    touches[:, 4] = -1
    if params.contact_docks == "none":
        touches[:, 2] = -1
    has_docks = params.contact_docks == "both"
    return {
        "contacts": contacts if has_docks else contacts[:0],
        "touches": touches[:0] if has_docks else np.unique(touches, axis=0),
    }
