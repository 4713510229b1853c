"""The logs of the benchmark: what each asks of a method, and how it was made."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from tests import foreign
from tests.structures import Rule, structure, with_heights

Made = Callable[[], foreign.Log]
"""Makes a log, and the true centers of its robots [log unit], shape (N, 3)."""

_NOISE = {"tilt_noise_deg": 1.0, "yaw_noise_deg": 2.0}
_FINAL = {"stances": False}
_CONTACTS_ALONE = {**_FINAL, "heights": False}


@dataclass(frozen=True, kw_only=True)
class Source:
    """Where a log comes from: a scenario, or a function."""

    group: str
    """What the log asks of a method."""

    name: str
    about: str
    """What robots sensed, in words."""

    scenario: dict[str, Any] = field(default_factory=dict)
    """Settings beside those that all scenarios share; none if a function makes the log."""

    make: Made | None = None
    images: int = 1
    """Configurations that fit what was sensed as well as the truth does."""

    frame: Literal["known", "free"] = "known"
    """Whether measurements say where the structure stands, or its shape alone, up to reflection."""


def _grown(
    group: str,
    name: str,
    about: str,
    seed: int,
    *,
    robots: int = 40,
    robot: dict[str, Any] | None = None,
    sensing: dict[str, Any] | None = None,
    **structure: object,
) -> Source:
    settings = {
        "name": name,
        "robots": robots,
        "seeds": [seed],
        "structure": structure,
        "sensing": _NOISE if sensing is None else sensing,
        "localization": {"method": "hop-by-hop"},
    }
    if robot is not None:
        settings["robot"] = robot
    return Source(group=group, name=name, about=about, scenario=settings)


def _ruled(name: str, about: str, seed: int, *, heights: bool, **rule: Any) -> Source:  # noqa: ANN401
    def make() -> foreign.Log:
        log, truth = structure(Rule(**rule), 40, seed)
        return (with_heights(log, truth) if heights else log), truth

    return Source(group="other structures", name=name, about=about, make=make)


SOURCES = (
    # Structures of ReactiveBuild, and what FireAntV3 senses.
    _grown("FireAntV3", "tower-a", "F = 10, every stance", 9100, kind="tower"),
    _grown("FireAntV3", "tower-b", "F = 10, every stance", 9101, kind="tower"),
    _grown("FireAntV3", "cantilever-a", "F = 10, every stance", 9102, kind="cantilever"),
    _grown("FireAntV3", "cantilever-b", "F = 10, every stance", 9103, kind="cantilever"),
    _grown("FireAntV3", "bridge", "closed, gap of 20 R", 9104, kind="bridge", gap=20.0),
    _grown("FireAntV3", "chain", "hanging", 9105, kind="chain"),
    _grown("low F", "tower-low-a", "F = 2.5", 9110, kind="tower", force_threshold=2.5),
    _grown("low F", "tower-low-b", "F = 2.5", 9111, kind="tower", force_threshold=2.5),
    _grown("low F", "cantilever-low-a", "F = 2.5", 9112, kind="cantilever", force_threshold=2.5),
    _grown("low F", "cantilever-low-b", "F = 2.5", 9113, kind="cantilever", force_threshold=2.5),
    _grown("planar", "planar-tower", "robots in a plane", 9120, kind="tower", plane=True),
    _grown("planar", "planar-bridge", "gap of 20 R", 9121, kind="bridge", plane=True, gap=20.0),
    # Less and less is sensed of the same kinds.
    _grown(
        "rungs", "tower-final", "final stances", 9130, kind="tower", sensing={**_NOISE, **_FINAL}
    ),
    _grown(
        "rungs",
        "cantilever-final",
        "final stances",
        9131,
        kind="cantilever",
        sensing={**_NOISE, **_FINAL},
    ),
    _grown(
        "rungs",
        "tower-contacts",
        "final contacts, without noise",
        9132,
        kind="tower",
        sensing=_CONTACTS_ALONE,
    ),
    _grown(
        "rungs",
        "cantilever-contacts",
        "final contacts, without noise",
        9133,
        kind="cantilever",
        sensing=_CONTACTS_ALONE,
    ),
    _grown(
        "rungs",
        "tower-own-dock",
        "the partner's dock is unknown",
        9134,
        kind="tower",
        sensing={**_NOISE, "contact_docks": "own"},
    ),
    _grown(
        "rungs",
        "cantilever-own-dock",
        "the partner's dock is unknown",
        9135,
        kind="cantilever",
        sensing={**_NOISE, "contact_docks": "own"},
    ),
    _grown(
        "rungs",
        "tower-yaw-bias",
        "compasses off by 15 deg each",
        9136,
        kind="tower",
        sensing={**_NOISE, "yaw_bias_deg": 15.0},
    ),
    _grown(
        "rungs",
        "cantilever-yaw-bias",
        "compasses off by 15 deg each",
        9137,
        kind="cantilever",
        sensing={**_NOISE, "yaw_bias_deg": 15.0},
    ),
    # Sensors of other systems.
    _grown(
        "other sensors",
        "tower-ranges",
        "final ranges to 12 R, 0.1 R",
        9140,
        kind="tower",
        sensing={**_NOISE, **_FINAL, "range_reach": 12.0, "range_noise": 0.1},
    ),
    _grown(
        "other sensors",
        "tower-directions",
        "directions of contacts, 1 deg",
        9141,
        kind="tower",
        sensing={**_NOISE, **_FINAL, "direction_noise_deg": 1.0},
    ),
    _grown(
        "other sensors",
        "tower-no-compass",
        "directions and turns of contacts, 1 deg",
        9142,
        kind="tower",
        sensing={
            "compass": False,
            "direction_noise_deg": 1.0,
            "connection_noise_deg": 1.0,
            **_CONTACTS_ALONE,
        },
    ),
    Source(
        group="other sensors",
        name="chain-no-compass",
        about="24 robots in a row, 1 deg",
        make=lambda: foreign.open_chain(24, 9143),
    ),
    Source(
        group="other sensors",
        name="room",
        about="4 beacons, 6 tags, ranges to 0.1 m",
        make=lambda: foreign.room_of_tags(foreign.ROOM, 9144, sd=0.1),
    ),
    Source(
        group="other sensors",
        name="ceiling",
        about="the same, beacons in one plane: two images",
        images=2,
        make=lambda: foreign.room_of_tags(foreign.CEILING, 9145, sd=0.1),
    ),
    Source(
        group="other sensors",
        name="ring",
        about="1 tag above 30 beacons of nearly one height",
        make=lambda: foreign.nearly_flat(0.3, 9146),
    ),
    Source(
        group="other sensors",
        name="ranges-alone",
        about="12 robots, all distances, no beacon",
        make=lambda: foreign.without_beacons(12, 9147),
        frame="free",
    ),
    # Robots that fail, which headers do not state, and measurements that are wrong.
    _grown(
        "failures", "tower-mute", "10 % mute", 9150, kind="tower", sensing={**_NOISE, "mute": 0.1}
    ),
    _grown(
        "failures", "tower-deaf", "10 % deaf", 9151, kind="tower", sensing={**_NOISE, "deaf": 0.1}
    ),
    _grown(
        "failures",
        "tower-drift",
        "10 % of the IMUs drift, 3 deg a flip",
        9152,
        kind="tower",
        sensing={**_NOISE, "drift": 0.1},
    ),
    _grown(
        "failures",
        "cantilever-stuck",
        "10 % of the IMUs are stuck",
        9153,
        kind="cantilever",
        sensing={**_NOISE, "stuck": 0.1},
    ),
    _grown(
        "failures",
        "tower-false",
        "5 % false contacts",
        9154,
        kind="tower",
        sensing={**_NOISE, "false_contacts": 0.05},
    ),
    _grown(
        "failures",
        "cantilever-wrong-docks",
        "5 % wrong docks",
        9155,
        kind="cantilever",
        sensing={**_NOISE, "wrong_docks": 0.05},
    ),
    Source(
        group="failures",
        name="room-no-sight",
        about="3 of 39 ranges 1 to 2 m too long",
        make=lambda: foreign.room_of_tags(
            foreign.ROOM, 9156, sd=0.1, late={(1, 6): 1.5, (2, 8): 2.0, (4, 9): 1.0}
        ),
    ),
    # Other bodies, and structures that robots did not climb.
    _grown(
        "other structures",
        "tetrahedra",
        "robots of 4 docks",
        9160,
        kind="tower",
        robot={"shape": "tetrahedron"},
    ),
    _ruled("tree", "one contact each, heights", 9161, heights=True, kind="tree"),
    _ruled("loops", "two contacts each", 9162, heights=False, kind="loops"),
    _ruled("loops-heights", "two contacts each, heights", 9163, heights=True, kind="loops"),
    _ruled("ball", "5 docks, two contacts each, heights", 9164, heights=True, kind="ball", docks=5),
)
