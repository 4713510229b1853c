"""Every method with settings that keep an attempt short."""

from tiswarm.localization.settings import MethodParams
from tiswarm.scenario.validation import localization_params

_SETTINGS = {
    "virtual-force": ["iterations=20"],
    "virtual-force together": ["schedule=together", "together.steps=40"],
    "joint": ["steps=40", "chains=2"],
    "least-squares": [],
    "hop-by-hop": [],
    "online": ["steps=20", "hold_steps=5", "chains=1", "anneal_growth=0.5"],
    "distributed": ["steps=20", "chains=1"],
}

METHODS: dict[str, MethodParams] = {
    title: localization_params(title.partition(" ")[0], settings)
    for title, settings in _SETTINGS.items()
}
"""Settings by the title of a method."""

JOINING = {"distributed", "online"}
"""Methods that know of robots before a robot that joins alone."""
