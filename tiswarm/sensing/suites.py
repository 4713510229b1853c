"""Sensor suites of FireAntV3 and of the systems that the paper's Table I compares.

A suite is a set of settings for `sensing.*`. All suites sense the same structures, so a suite of
another system stands for FireAntV3 robots that carry its sensors. Lengths in R; where a source
gives millimeters, 33 mm are 1 R. `docs/notes/sensors.md` has the source of each number.

A function that fills a list of the log becomes a sensor suite, too:

    @tiswarm.sensor("radar", fills="ranges")
    def sense(history, sensing):
        return rows  # (robot, stance, other robot, distance, standard deviation, source)
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import InputError
from tiswarm.base.plugins import call_plugin, fault_of_numbers
from tiswarm.base.registry import register
from tiswarm.records.sensing_log import FARTHEST
from tiswarm.sensing.observation import COLUMNS
from tiswarm.world.history import History

TOUCH_USD = 20.0
"""Price of the sensors of a FireAntV3 by Table I of the paper [USD]."""

_Sense = TypeVar("_Sense", bound=Callable[..., Any])


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Sensors of one system and their price."""

    senses: str
    """What robots sense."""

    title: str = ""
    """Name of the system, as figures have it; that of the suite if empty."""

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


Point = tuple[float, float, float]

CEILING: Point = (0.0, 0.0, 150.0)
"""Projector or beacon on the ceiling, 5 m above the axis of a tower or the edge of a slab [R]."""

WALL_TAGS: tuple[Point, ...] = (
    (100.0, 0.0, 30.0),
    (-100.0, 0.0, 30.0),
    (0.0, 100.0, 30.0),
    (0.0, -100.0, 30.0),
)
"""A tag on each wall of a room of 6.6 m by 6.6 m, 1 m up [R]."""

STATIONS: tuple[Point, ...] = ((100.0, 100.0, 90.0), (-100.0, -100.0, 90.0))
"""Lighthouse stations in opposite corners of the same room, 3 m up [R]."""

_NO_TOUCH = {"contacts": False, "ground_docks": False, "heights": False, "stances": False}


FIREANT_V3 = Suite(
    title="FireAntV3",
    senses="contacts with docks, docks on the ground, orientation, flips",
    settings={},
    robot_usd=TOUCH_USD,
)

COACHBOT_V1 = Suite(
    title="CoachBot V1",
    senses="x, y and heading from wall tags that an onboard camera sees",
    settings=_NO_TOUCH | {"beacons": WALL_TAGS, "fix_noise": 0.5},
    robot_usd=20.0,
    needs="printed tags on the walls",
)

COACHBOT_V2 = Suite(
    title="CoachBot V2",
    senses="two sweep planes of each lighthouse in sight",
    settings=_NO_TOUCH
    | {
        "beacons": STATIONS,
        "beacon_kind": "sweep",
        "fix_noise": 0.03,
        "fix_bias": 0.5,
        "yaw_noise_deg": 0.4,
    },
    robot_usd=20.0,
    infrastructure_usd=150.0,
    needs="lighthouse stations; Table I does not say how many its $150 are for",
)

ZOOIDS = Suite(
    title="Zooids",
    senses="x and y from the Gray code of a projector in sight",
    settings=_NO_TOUCH | {"beacons": (CEILING,), "fix_noise": 0.03},
    robot_usd=1.0,
    infrastructure_usd=1000.0,
    needs="a projector on the ceiling; x and y as if its rays were parallel",
)

KILOBOT = Suite(
    title="Kilobot",
    senses="distances to robots in sight",
    settings=_NO_TOUCH
    | {
        "range_reach": 8.0,
        "range_noise": 0.06,
        "seed_robots": 4,
        "fix_noise": 0.01,
    },
    robot_usd=0.0,
    needs="four seed robots at known positions",
)

FREESN = Suite(
    title="FreeSN",
    senses="direction of each connection, and orientation",
    settings=_NO_TOUCH | {"contacts": True, "direction_noise_deg": 1.0},
    robot_usd=150.0,
    needs="a central computer",
)

M_BLOCKS = Suite(
    title="M-Blocks",
    senses="pose of each connected robot, by face tags; no compass",
    settings=_NO_TOUCH
    | {
        "contacts": True,
        "compass": False,
        "direction_noise_deg": 0.5,
        "connection_noise_deg": 0.5,
    },
    robot_usd=50.0,
)

ATRON = Suite(
    title="ATRON",
    senses="pose of each connected robot, by the infrared of its connectors; no compass",
    settings=_NO_TOUCH
    | {
        "contacts": True,
        "compass": False,
        "direction_noise_deg": 1.0,
        "connection_noise_deg": 1.0,
    },
    robot_usd=0.0,
)

SWARMBANG = Suite(
    title="SwarmBang",
    senses="x, y and heading from a beacon on the ceiling, as a robot moves and joins",
    settings=_NO_TOUCH
    | {
        "beacons": (CEILING,),
        "fix_noise": 0.58,
        "sight_at": "stances",
        "yaw_noise_deg": 1.44,
    },
    robot_usd=50.0,
    infrastructure_usd=None,
    needs="a navigator robot that projects the beacon and moves it along",
)


@dataclass(frozen=True, kw_only=True)
class PluginSuite(Suite):
    """A sensor suite that a plug-in registered; its price has no source."""

    fills: str
    """List of the log that it fills."""

    sense: Callable[..., Any]
    """Function of a history and the settings of `sensing`, which returns rows of that list."""

    def rows(self, history: History, params: Any) -> Reals:  # noqa: ANN401
        """Return the rows of the list that the sensor fills.

        Args:
            history: True history of the structure.
            params: Settings of `sensing`.

        Raises:
            PluginError: the sensor failed, or returned something else than rows.
        """
        sense: Callable[..., Any] = self.sense
        rows = call_plugin(
            "sensor",
            params.suite,
            lambda: np.asarray(sense(history, params)),
            lambda returned: _fault(returned, COLUMNS[self.fills], history),
            repeats=sense,
        )
        real_rows: Reals = rows.astype(np.float64)
        return real_rows


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
        suite = PluginSuite(
            senses=fills,
            settings=dict(settings),
            robot_usd=robot_usd,
            needs="unknown",
            fills=fills,
            sense=sense,
        )
        register("sensor", name, suite, sense)
        return sense

    return add


def _fault(rows: NDArray[Any], columns: int, history: History) -> str:
    """Say what is wrong with the rows of a sensor, and what is wanted; empty if nothing is."""
    if rows.ndim != 2 or rows.shape[1] != columns:  # noqa: PLR2004 - rows and columns
        return f"shape {rows.shape}; return rows of {columns} numbers"
    wrong = fault_of_numbers(rows, FARTHEST, f"within {FARTHEST:g}")
    if wrong:
        return f"numbers that are {wrong}; leave out what was not measured"
    stances = np.array([walk.stance_count for walk in history.walks])
    robot = rows[:, 0].astype(np.int64)
    is_robot = (robot >= 0) & (robot < len(stances))
    is_stance = (rows[:, 1] >= 0) & (rows[:, 1] < stances[np.where(is_robot, robot, 0)])
    if not (is_robot & is_stance).all():
        return "a robot or stance that the structure lacks; start rows with (robot, stance)"
    return ""
