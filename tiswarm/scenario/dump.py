"""From a scenario back to text, and to the short name of its content."""

import json
from hashlib import sha256

import yaml

from tiswarm.scenario.document import plain_scalar
from tiswarm.scenario.model import Scenario, plain


class _Dumper(yaml.SafeDumper):
    """Writes values out wherever they occur, and quotes text that would not read as text."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002
        return True


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = None if isinstance(plain_scalar(text), str) else "'"
    if not text.isprintable():  # some line breaks do not survive other styles
        style = '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _represent_text)


def dump_scenario(scenario: Scenario) -> str:
    """Write a scenario as YAML, every default included; it loads back to an equal scenario."""
    data = plain(scenario)
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)


def scenario_hash(scenario: Scenario) -> str:
    """Eight hex digits that stand for all a scenario says, but for its description.

    The order of keys, comments and what was left at its default make no difference.
    """
    data = plain(scenario)
    del data["description"]
    text = json.dumps(data, sort_keys=True, separators=(",", ":"))
    return sha256(text.encode()).hexdigest()[:8]
