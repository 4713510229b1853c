"""Sensor suites: FireAntV3's own, and those of the systems that the paper's Table I compares.

A suite is a set of settings for `sensing.*`. All suites sense the same structures, so a suite of
another system stands for FireAntV3 robots that carry its sensors. Lengths in R; where a source
gives millimeters, 33 mm are 1 R.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

SuiteName = Literal[
    "fireant-v3", "coachbot-v1", "coachbot-v2", "zooids", "kilobot", "freesn", "m-blocks", "atron",
    "swarmbang",
]  # fmt: skip
"""Names of all suites."""

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


class Figure(NamedTuple):
    """A number of a suite and where it comes from."""

    quantity: str
    value: str
    kind: Literal["measured by its authors", "second-hand", "inferred"]
    source: str


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Sensors of one system, their price and the sources of its numbers."""

    name: SuiteName
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

    figures: tuple[Figure, ...]
    """Sources of its accuracy and reach."""

    def price(self, robots: int, *, touch: bool = False) -> float:
        """Compute the price of the sensors of a swarm, and of what stands around it, if stated.

        `touch` adds the sensors of FireAntV3 to robots without them [USD].
        """
        has_touch = not self.settings
        added = SUITES["fireant-v3"].robot_usd if touch and not has_touch else 0.0
        return robots * (self.robot_usd + added) + (self.infrastructure_usd or 0.0)


_SUITES = (
    Suite(
        name="fireant-v3",
        senses="contacts with docks, docks on the ground, orientation, flips",
        settings={},
        robot_usd=20.0,
        figures=(
            Figure("orientation", "exact unless set", "inferred", "the paper's simulations"),
            Figure("IMU", "1 deg tilt, 2 deg yaw", "second-hand", "Winer, SENtral sensor hub wiki"),
        ),
    ),
    Suite(
        name="coachbot-v1",
        senses="x, y and heading from wall tags that an onboard camera sees",
        settings=_NO_TOUCH | {"beacons": WALL_TAGS, "fix_noise": 0.5},
        robot_usd=20.0,
        needs="printed tags on the walls",
        figures=(
            Figure(
                "position", "10 to 30 mm at 1 to 2 m: 0.5 R", "second-hand",
                "Oscadal et al., Sensors 2020, 20, 4825",
            ),
        ),
    ),
    Suite(
        name="coachbot-v2",
        senses="two sweep planes of each lighthouse in sight",
        settings=_NO_TOUCH | {
            "beacons": STATIONS, "beacon_kind": "sweep", "fix_noise": 0.03, "fix_bias": 0.5,
            "yaw_noise_deg": 0.4,
        },
        robot_usd=20.0,
        infrastructure_usd=150.0,
        needs="lighthouse stations; Table I does not say how many its $150 are for",
        figures=(
            Figure(
                "jitter", "millimeters: 0.03 R", "second-hand",
                "Taffanel et al. 2021, arXiv 2104.11523",
            ),
            Figure(
                "error of a station", "mean error 2 to 4 cm: 0.5 R", "second-hand",
                "Taffanel et al. 2021, arXiv 2104.11523",
            ),
            Figure("heading", "0.4 deg", "second-hand", "Bauer et al., Sensors 2021, 21, 1622"),
        ),
    ),
    Suite(
        name="zooids",
        senses="x and y from the Gray code of a projector in sight",
        settings=_NO_TOUCH | {"beacons": (CEILING,), "fix_noise": 0.03},
        robot_usd=1.0,
        infrastructure_usd=1000.0,
        needs="a projector on the ceiling; x and y as if its rays were parallel",
        figures=(
            Figure("position", "a pixel, 1 mm: 0.03 R", "inferred", "pixels of the projected area"),
        ),
    ),
    Suite(
        name="kilobot",
        senses="distances to robots in sight",
        settings=_NO_TOUCH | {
            "range_reach": 8.0, "range_noise": 0.06, "seed_robots": 4, "fix_noise": 0.01,
        },
        robot_usd=0.0,
        needs="four seed robots at known positions",
        figures=(
            Figure("distance", "2 mm: 0.06 R", "second-hand", "Rubenstein et al. 2010"),
            Figure("reach", "three bodies: 8 R", "inferred", "7 cm of a robot of 33 mm, scaled"),
            Figure("position of a seed", "0.01 R", "inferred", "put down by hand, taken as exact"),
        ),
    ),
    Suite(
        name="freesn",
        senses="direction of each connection, and orientation",
        settings=_NO_TOUCH | {"contacts": True, "direction_noise_deg": 1.0},
        robot_usd=150.0,
        needs="a central computer",
        figures=(
            Figure("direction", "1 deg; 5 deg as a bad case", "inferred", "no published number"),
        ),
    ),
    Suite(
        name="m-blocks",
        senses="pose of each connected robot, by face tags; no compass",
        settings=_NO_TOUCH | {
            "contacts": True, "compass": False,
            "direction_noise_deg": 0.5, "connection_noise_deg": 0.5,
        },
        robot_usd=50.0,
        figures=(Figure("play", "0.5 deg, 1 mm", "inferred", "fit of magnetic faces"),),
    ),
    Suite(
        name="atron",
        senses="pose of each connected robot, by the infrared of its connectors; no compass",
        settings=_NO_TOUCH | {
            "contacts": True, "compass": False,
            "direction_noise_deg": 1.0, "connection_noise_deg": 1.0,
        },
        robot_usd=0.0,
        figures=(Figure("play", "1 deg", "inferred", "fit of hooks"),),
    ),
    Suite(
        name="swarmbang",
        senses="x, y and heading from a beacon on the ceiling, as a robot moves and joins",
        settings=_NO_TOUCH | {
            "beacons": (CEILING,), "fix_noise": 0.58, "sight_at": "stances", "yaw_noise_deg": 1.44,
        },
        robot_usd=50.0,
        infrastructure_usd=None,
        needs="a navigator robot that projects the beacon and moves it along",
        figures=(
            Figure(
                "position", "2.41 cm: 0.58 R an axis", "measured by its authors",
                "Duan et al., Sensors 2023, 23, 4926",
            ),
            Figure(
                "heading", "1.44 deg", "measured by its authors",
                "Duan et al., Sensors 2023, 23, 4926",
            ),
        ),
    ),
)  # fmt: skip

SUITES: dict[str, Suite] = {suite.name: suite for suite in _SUITES}
"""Every suite by its name."""
