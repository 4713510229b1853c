"""The scenario: a YAML file that says all there is to say about a study."""

from tiswarm.scenario.check import scenario_schema
from tiswarm.scenario.load import find_mistakes, load_scenario, localization_params
from tiswarm.scenario.model import Scenario, dump_scenario, scenario_hash
from tiswarm.scenario.variants import Variant, variants

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
