"""Sensing: from the true history of a structure to the log that localizers read."""

from tiswarm.sensing.observation import observe
from tiswarm.sensing.params import SensingParams

__all__ = ["SensingParams", "observe"]
