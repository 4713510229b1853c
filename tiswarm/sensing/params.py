"""Settings of what robots sense, and with which noise."""

from dataclasses import asdict
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from tiswarm.params import STRICT
from tiswarm.records.sensing_log import Angle, Fraction, SensingNoise


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SensingParams:
    """Noise of the robots' senses; none by default, as in the paper.

    Each contact of each stance has its own random draw. Gravity gives planar robots their whole
    orientation: it has the noise of tilt about the normal of the plane, and no noise of yaw.
    """

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

    @property
    def noise(self) -> SensingNoise:
        """Noise as the header of a log states it."""
        return SensingNoise(**{key.replace("_noise", ""): sd for key, sd in asdict(self).items()})
