"""Recruitment: robots that bear much call others to their aid, through their neighbors.

A robot that senses s sends recruit = min(floor(B^(s/F - 1)), J), and nothing below F. Each of
its three zones passes on the greatest of that, what comes in at the same zone less 1, and what
comes in at another zone less 2; so a call fades with distance (Swissler and Rubenstein,
ReactiveBuild, DARS 2021).
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from tiswarm.params import STRICT
from tiswarm.robot import DOCK_COUNT


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RecruitParams:
    """When robots call for help, and how far the call carries."""

    force_threshold: Annotated[
        float,
        Field(gt=0.0, description="F: what a robot may sense before it calls [weight of a dock]."),
    ] = 10.0

    recruit_base: Annotated[
        float, Field(gt=1.0, description="B: how fast the call grows with what is sensed [1].")
    ] = 3.0

    recruit_limit: Annotated[
        int, Field(ge=0, le=1_000_000, description="J: greatest call; 0 switches recruitment off.")
    ] = 5


def recruit(sensed: NDArray[np.float64], params: RecruitParams) -> NDArray[np.int32]:
    """What each robot calls for itself, shape (N,)."""
    ratio = sensed / params.force_threshold
    # Past the power that reaches J the call is J; capping the power avoids overflow.
    power = np.minimum(
        ratio - 1.0, np.log(params.recruit_limit + 2.0) / np.log(params.recruit_base)
    )
    call = np.floor(params.recruit_base**power)
    return np.where(ratio < 1.0, 0, np.minimum(call, params.recruit_limit)).astype(np.int32)


def relay(call: NDArray[np.int32], contacts: NDArray[np.integer]) -> NDArray[np.int32]:
    """What each dock passes on once every call has spread, from zero.

    Args:
        call: What each robot calls for itself, shape (N,).
        contacts: Docks that touch, rows of (dock, dock) as 3 i + k, shape (C, 2).

    Returns:
        Shape (3 N,).
    """
    one = np.concatenate([contacts[:, 0], contacts[:, 1]])
    other = np.concatenate([contacts[:, 1], contacts[:, 0]])
    own = np.repeat(call, DOCK_COUNT)
    out = own
    while True:
        incoming = np.zeros_like(out)
        np.maximum.at(incoming, one, out[other])
        zones = incoming.reshape(-1, DOCK_COUNT)
        others = np.maximum(np.roll(zones, 1, axis=1), np.roll(zones, -1, axis=1)).ravel()
        spread = np.maximum(own, np.maximum(incoming - 1, others - 2))
        if np.array_equal(spread, out):
            return out
        out = spread
