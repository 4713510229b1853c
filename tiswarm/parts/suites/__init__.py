"""Optional: sensor suites of FireAntV3 and of the systems that the paper's Table I compares.

A suite is a set of settings for `sensing.*`. All suites sense the same structures, so a suite of
another system stands for FireAntV3 robots that carry its sensors. Lengths in R; where a source
gives millimeters, 33 mm are 1 R. `docs/suites.md` has the source of each number.
"""

from tiswarm.sensing.plugins import TOUCH_USD, Suite

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
    senses="contacts with docks, docks on the ground, orientation, flips",
    settings={},
    robot_usd=TOUCH_USD,
)  # fmt: skip

COACHBOT_V1 = Suite(
    senses="x, y and heading from wall tags that an onboard camera sees",
    settings=_NO_TOUCH | {"beacons": WALL_TAGS, "fix_noise": 0.5},
    robot_usd=20.0,
    needs="printed tags on the walls",
)  # fmt: skip

COACHBOT_V2 = Suite(
    senses="two sweep planes of each lighthouse in sight",
    settings=_NO_TOUCH | {
        "beacons": STATIONS, "beacon_kind": "sweep", "fix_noise": 0.03, "fix_bias": 0.5,
        "yaw_noise_deg": 0.4,
    },
    robot_usd=20.0,
    infrastructure_usd=150.0,
    needs="lighthouse stations; Table I does not say how many its $150 are for",
)  # fmt: skip

ZOOIDS = Suite(
    senses="x and y from the Gray code of a projector in sight",
    settings=_NO_TOUCH | {"beacons": (CEILING,), "fix_noise": 0.03},
    robot_usd=1.0,
    infrastructure_usd=1000.0,
    needs="a projector on the ceiling; x and y as if its rays were parallel",
)  # fmt: skip

KILOBOT = Suite(
    senses="distances to robots in sight",
    settings=_NO_TOUCH | {
        "range_reach": 8.0, "range_noise": 0.06, "seed_robots": 4, "fix_noise": 0.01,
    },
    robot_usd=0.0,
    needs="four seed robots at known positions",
)  # fmt: skip

FREESN = Suite(
    senses="direction of each connection, and orientation",
    settings=_NO_TOUCH | {"contacts": True, "direction_noise_deg": 1.0},
    robot_usd=150.0,
    needs="a central computer",
)  # fmt: skip

M_BLOCKS = Suite(
    senses="pose of each connected robot, by face tags; no compass",
    settings=_NO_TOUCH | {
        "contacts": True, "compass": False,
        "direction_noise_deg": 0.5, "connection_noise_deg": 0.5,
    },
    robot_usd=50.0,
)  # fmt: skip

ATRON = Suite(
    senses="pose of each connected robot, by the infrared of its connectors; no compass",
    settings=_NO_TOUCH | {
        "contacts": True, "compass": False,
        "direction_noise_deg": 1.0, "connection_noise_deg": 1.0,
    },
    robot_usd=0.0,
)  # fmt: skip

SWARMBANG = Suite(
    senses="x, y and heading from a beacon on the ceiling, as a robot moves and joins",
    settings=_NO_TOUCH | {
        "beacons": (CEILING,), "fix_noise": 0.58, "sight_at": "stances", "yaw_noise_deg": 1.44,
    },
    robot_usd=50.0,
    infrastructure_usd=None,
    needs="a navigator robot that projects the beacon and moves it along",
)  # fmt: skip
