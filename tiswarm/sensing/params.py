"""Settings of what robots sense, and with which noise."""

from dataclasses import fields, replace
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, Strict, model_validator
from pydantic.dataclasses import dataclass
from pydantic_core import ArgsKwargs

from tiswarm.base.params import STRICT, UNLESS_SET
from tiswarm.base.registry import get, names
from tiswarm.base.sections import NameOf, SendsPlugins
from tiswarm.records.sensing_log import Angle, Fraction, SensingNoise

USUAL = "fireant-v3"
"""Name of the suite that has the defaults."""

_Coordinate = Annotated[float, Strict(), Field(ge=-1e6, le=1e6)]
# A setting of a suite passes through Python, where strict checks accept no list for a tuple.
_Point = Annotated[tuple[_Coordinate, _Coordinate, _Coordinate], Strict(False)]  # noqa: FBT003
_Points = Annotated[tuple[_Point, ...], Strict(False), Field(max_length=64)]  # noqa: FBT003
_OwnSense = Literal["contacts", "ground_docks", "heights", "stances", "compass"]
_Length = Annotated[float, Field(ge=1e-6, le=1e6)]

Failure = Literal["mute", "deaf", "drift", "stuck"]
"""Ways in which robots fail, each a setting: the fraction of robots that do."""


def _not_tiny(length: float) -> float:
    if 0.0 < length < 1e-6:  # noqa: PLR2004 - the least that a log states
        raise ValueError(f"{length:g} should be 0 or at least 1e-6; correct it")
    return length


_Bias = Annotated[float, Field(ge=0.0, le=1e6), AfterValidator(_not_tiny)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Vibration:
    """How robots learn the names of others in contact: each vibrates in a time slot of its own."""

    slots: Annotated[int, Field(ge=1)] = 64
    """Time slots. The slot of a robot is the remainder of its number in join order."""

    hearing: Annotated[int, Field(ge=1, le=64)] = 2
    """Contacts that a vibration passes until it cannot be sensed; 1 is the neighbors alone."""

    fading: Fraction = 0.5
    """Strength of a vibration after a further contact, and so its chance among those in a slot."""

    missed: Fraction = 0.0
    """Fraction of vibrations of neighbors that a robot does not sense [1]."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SensingParams(SendsPlugins):
    """What robots sense, and the noise of their senses; none by default, as in the paper.

    A suite sets defaults of all other settings; those listed are of `fireant-v3`. Each contact of
    each stance has its own random draw. Gravity gives planar robots their whole
    orientation: it has the noise of tilt about the normal of the plane, and no noise of yaw.
    """

    suite: Annotated[str, NameOf("sensor")] = USUAL
    """Sensors of a system in the paper's Table I."""

    touch: bool = False
    """Add FireAntV3's own senses to those of the suite: contacts, docks on the ground, heights,
    stances, orientations."""

    contacts: bool = True
    """Sense contacts."""

    contact_docks: Literal["both", "own", "none"] = "both"
    """Docks that a robot knows of its contacts: its own and the other, its own only, or none, so
    that it knows which robots it touches and not where."""

    ground_docks: bool = True
    """Sense docks on flat ground, whose height is known."""

    heights: bool = True
    """Infer heights from flips."""

    stances: bool = True
    """Record the stances before the final one, and what robots sensed there."""

    compass: bool = True
    """Sense orientations; without, they follow from those of robots in contact, and those of
    anchors are known."""

    tilt_noise_deg: Annotated[Angle, Field(le=90.0)] = 0.0
    """Standard deviation of the sensed orientation about each horizontal axis, with a new draw at
    each stance [deg]."""

    yaw_noise_deg: Angle = 0.0
    """Standard deviation of the sensed orientation about the vertical, with a new draw at each
    stance [deg]."""

    yaw_bias_deg: Angle = 0.0
    """Standard deviation of a further turn about the vertical, with one draw a robot [deg]."""

    spawn_noise: Annotated[float, Field(ge=0.0, le=1e9)] | None = None
    """Standard deviation of each coordinate of the sensed spawn position [R]; if null, robots do
    not sense where they spawn."""

    missed_contacts: Fraction = 0.0
    """Fraction of contacts that are not sensed [1]."""

    wrong_docks: Fraction = 0.0
    """Fraction of contacts sensed at the wrong dock of the right neighbor [1]."""

    false_contacts: Fraction = 0.0
    """Sensed contacts that do not exist, with a random dock of a random earlier robot, per true
    contact [1]."""

    vibration: Annotated[Vibration | None, UNLESS_SET] = None
    """Vibrations that name the robots in contact; if null, a robot knows whom it touches."""

    mute: Fraction = 0.0
    """Fraction of robots that sense and send nothing; what later robots sense of them stays.
    Anchors never fail, here and below [1]."""

    deaf: Fraction = 0.0
    """Fraction of robots that sense no robots: neither contacts nor what goes with them [1]."""

    drift: Fraction = 0.0
    """Fraction of robots whose sensed orientation turns further at each flip [1]."""

    drift_deg: Angle = 3.0
    """Angle by which it turns at a flip, about an axis drawn for each robot [deg]."""

    stuck: Fraction = 0.0
    """Fraction of robots whose orientation sensor repeats its first value [1]."""

    beacons: _Points = ()
    """Places of beacons, tags or projectors [R]. Robots in line of sight of one get fixes."""

    beacon_kind: Literal["plan", "sweep"] = "plan"
    """Fixes that beacons give: x and y, the same from one or several (plan), or two slanted planes
    through each beacon and the robot, as of a lighthouse (sweep)."""

    fix_noise: _Length = 0.5
    """Standard deviation of each fix, with a new draw at each stance [R]."""

    fix_bias: _Bias = 0.0
    """Standard deviation of a further error of planes, with one draw for each of a beacon's two
    [R]. The planes are sources of the log, and this is their shared error."""

    seed_robots: Annotated[int, Field(ge=0)] = 0
    """Robots, the first to join, whose final positions are known by three fixes."""

    range_reach: Annotated[float, Field(gt=0.0, le=1e6)] | None = None
    """Largest distance of centers at which robots in line of sight measure it [R]; if null, they
    measure none."""

    range_noise: _Length = 0.06
    """Standard deviation of a range [R]."""

    range_bias: _Bias = 0.0
    """Standard deviation of a further error of all ranges, with one draw a structure, as of the
    delay of radios of one kind [R]. Ranges are a source of the log, with this shared error."""

    direction_noise_deg: Angle | None = None
    """Standard deviation of the direction of a contact about each axis perpendicular to it [deg];
    if null, directions are not sensed. They are those of true contacts."""

    connection_noise_deg: Angle | None = None
    """Standard deviation of the orientation of a robot in contact about each axis [deg]; if null,
    it is not sensed. It is that of true contacts."""

    sight_at: Literal["end", "stances"] = "end"
    """Time of fixes and ranges: once, when the structure is complete and all robots block sight
    (end), or at each stance, where only robots that joined earlier do (stances)."""

    def __post_init__(self) -> None:
        """Refuse settings without effect, and stances that no compass leads through."""
        if not self.senses("compass") and (self.stances or self.heights):
            raise ValueError("stances and heights need a compass; set both to false")
        if not self.senses("compass") and (self.drift or self.stuck):
            raise ValueError("drift and stuck are failures of compasses; set both to 0")
        if self.fix_bias and self.beacon_kind == "plan":
            problem = "fix_bias is an error of planes; set beacon_kind to sweep or remove it"
            raise ValueError(problem)
        if self.range_bias and self.range_reach is None:
            raise ValueError("range_bias is an error of ranges; set range_reach or remove it")
        is_named = not self.direction_noise_deg is self.connection_noise_deg is None
        if self.contact_docks != "both" and is_named:
            raise ValueError("directions and connections name docks; set contact_docks to both")

    @model_validator(mode="before")
    @classmethod
    def _with_suite(cls, data: Any) -> Any:  # noqa: ANN401 - not checked yet
        """Put a suite's settings beneath those that are given."""
        settings = data.kwargs or {} if isinstance(data, ArgsKwargs) else data
        name = settings.get("suite") if isinstance(settings, dict) else None
        if name == USUAL or name not in names("sensor"):
            return data
        return {**get("sensor", name).settings, **settings}

    def senses(self, name: _OwnSense) -> bool:
        """Whether robots have one of FireAntV3's own senses."""
        return self.touch or bool(getattr(self, name))

    @property
    def added(self) -> tuple[str, ...]:
        """Lists of the log that other senses fill."""
        is_filled = {
            "fixes": bool(self.beacons) or self.seed_robots > 0,
            "ranges": self.range_reach is not None,
            "directions": self.direction_noise_deg is not None,
            "connections": self.connection_noise_deg is not None,
        }
        return tuple(name for name in is_filled if is_filled[name])

    @property
    def sources(self) -> dict[str, float]:
        """Sources as the header of a log states them: the shared error of each by its name [R].

        The two planes of each beacon come first, in the order of `beacons`.
        """
        count = len(self.beacons) if self.fix_bias else 0
        planes = [f"beacon {number} plane {plane}" for number in range(count) for plane in (0, 1)]
        ranges = ["ranges"] if self.range_bias else []
        return dict.fromkeys(planes, self.fix_bias) | dict.fromkeys(ranges, self.range_bias)

    @property
    def noise(self) -> SensingNoise:
        """Noise as the header of a log states it; known orientations have none."""
        names = {field.name.replace("_noise", ""): field.name for field in fields(self)}
        stated = {field.name for field in fields(SensingNoise)} & set(names)
        noise = SensingNoise(**{key: getattr(self, names[key]) for key in stated})
        if self.vibration:
            missed = self.missed_contacts + (1.0 - self.missed_contacts) * self.vibration.missed
            noise = replace(noise, missed_contacts=missed)
        if self.senses("compass"):
            return noise
        return replace(noise, tilt_deg=0.0, yaw_deg=0.0, yaw_bias_deg=None)
