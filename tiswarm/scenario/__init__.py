"""Scenarios: YAML files that define studies."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tiswarm.scenario.expansion import Variant, find_mistakes, load_scenario, variants
    from tiswarm.scenario.model import Scenario, dump_scenario, scenario_hash, scenario_schema
    from tiswarm.scenario.validation import localization_params

__all__ = [
    "Scenario",
    "Variant",
    "dump_scenario",
    "find_mistakes",
    "load_scenario",
    "localization_params",
    "scenario_hash",
    "scenario_schema",
    "variants",
]

_HOMES = {
    "expansion": ("Variant", "find_mistakes", "load_scenario", "variants"),
    "model": ("Scenario", "dump_scenario", "scenario_hash", "scenario_schema"),
    "validation": ("localization_params",),
}


def __getattr__(name: str) -> object:
    """Import a name when it is used: `localization_params` needs neither world nor sensing."""
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"tiswarm.scenario.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
