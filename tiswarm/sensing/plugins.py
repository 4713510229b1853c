"""Sensors of plug-ins: a function that fills a list of the log becomes a sensor suite.

@tiswarm.sensor("radar", fills="ranges")
def sense(history, sensing):
    return rows  # (robot, stance, other robot, distance, standard deviation, source)
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.base.parts import PluginError, fault_of_numbers, guarded, register, registered
from tiswarm.records.sensing_log import FARTHEST, LISTS
from tiswarm.world.history import History

COLUMNS = {name: 2 + len(key.columns) for name, key in LISTS.items() if not key.is_whole}
"""Numbers in a row of each list of the log that a sensor may fill, with robot and stance."""

TOUCH_USD = 20.0
"""Price of the sensors of a FireAntV3 by Table I of the paper [USD]."""

_Sense = TypeVar("_Sense", bound=Callable[..., Any])


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Sensors of one system and their price."""

    senses: str
    """What robots sense."""

    settings: Mapping[str, Any]
    """Settings of `sensing.*` that differ from the defaults."""

    robot_usd: float
    """Price of the sensors of a robot by Table I of the paper [USD]."""

    infrastructure_usd: float | None = 0.0
    """Price of what stands around the robots by Table I; None if it states none [USD]."""

    needs: str = "nothing"
    """What has to stand around the robots."""

    def price(self, robots: int, *, touch: bool = False) -> float:
        """Compute the price of the sensors of a swarm, and of what stands around it, if stated.

        `touch` adds the sensors of FireAntV3 to robots without them [USD].
        """
        has_touch = not self.settings
        added = TOUCH_USD if touch and not has_touch else 0.0
        return robots * (self.robot_usd + added) + (self.infrastructure_usd or 0.0)


@dataclass(frozen=True, kw_only=True)
class OwnSuite(Suite):
    """A sensor suite that a plug-in registered; its price has no source."""

    fills: str
    sense: Callable[..., Any]


def sensor(
    name: str,
    *,
    fills: str,
    settings: Mapping[str, Any] = MappingProxyType({}),
    robot_usd: float = 0.0,
) -> Callable[[_Sense], _Sense]:
    """Register a function as a sensor, which scenarios choose as `sensing.suite`.

    The function takes the history of a structure, `tiswarm.world.history.History`, and the settings
    of `sensing`. It returns rows of (robot, stance, ...) as the lists of a log have them.
    Random numbers should depend on `history.seed` alone.

    Args:
        name: Name of the suite.
        fills: List of the log that the rows are of.
        settings: Settings of `sensing` that differ from the defaults.
        robot_usd: Price of the sensors of a robot [USD]; 0 where unknown.

    Raises:
        InputError: the name is taken, or the log has no such list.
    """
    if fills not in COLUMNS:
        raise InputError(f"fills: the log has no list {fills}; use {', '.join(COLUMNS)}")

    def add(sense: _Sense) -> _Sense:
        suite = OwnSuite(
            senses=fills, settings=dict(settings), robot_usd=robot_usd, needs="unknown",
            fills=fills, sense=sense,
        )  # fmt: skip
        register("sensor", name, suite, sense)
        return sense

    return add


def own_rows(history: History, params: Any) -> Iterator[tuple[str, Reals]]:  # noqa: ANN401
    """Yield the list that the sensor of a plug-in fills, and its rows, if the suite is one.

    Args:
        history: True history of the structure.
        params: Settings of `sensing`.

    Raises:
        PluginError: the sensor failed, or returned something else than rows.
    """
    found = registered("sensor").get(params.suite)
    if found is None:
        return
    suite: OwnSuite = found.value
    rows = guarded(found.plugin, params.suite, lambda: np.asarray(suite.sense(history, params)))
    if wrong := _fault(rows, COLUMNS[suite.fills], history):
        problem = f"{found.plugin.file}: {params.suite} returned {wrong}"
        raise PluginError(problem, f"{problem}\n")
    yield suite.fills, rows.astype(np.float64)


def _fault(rows: NDArray[Any], columns: int, history: History) -> str:
    """Say what is wrong with the rows of a sensor, and what is wanted; empty if nothing is."""
    if rows.ndim != 2 or rows.shape[1] != columns:  # noqa: PLR2004 - rows and columns
        return f"shape {rows.shape}; return rows of {columns} numbers"
    if wrong := fault_of_numbers(rows, FARTHEST, f"within {FARTHEST:g}"):
        return f"numbers that are {wrong}; leave out what was not measured"
    stances = np.array([walk.stance_count for walk in history.walks])
    robot = rows[:, 0].astype(np.int64)
    is_robot = (robot >= 0) & (robot < len(stances))
    is_stance = (rows[:, 1] >= 0) & (rows[:, 1] < stances[np.where(is_robot, robot, 0)])
    if not (is_robot & is_stance).all():
        return "a robot or stance that the structure lacks; start rows with (robot, stance)"
    return ""
