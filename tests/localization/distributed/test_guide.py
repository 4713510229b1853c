"""The guide of messages lists the settings of `distributed` with their defaults."""

import re
from dataclasses import fields
from pathlib import Path

import yaml

from tiswarm.localization.distributed.settings import DistributedParams
from tiswarm.localization.settings import ChiSquareParams

GUIDE = Path(__file__).parents[3] / "docs" / "guides" / "distributed.md"


def test_the_guide_has_all_settings_with_their_defaults():
    """A table without defaults left readers to look for them in the code."""
    section = GUIDE.read_text().partition("## Settings")[2]
    rows = re.findall(r"^\| `(\w+)` \| ([^|]*)\|", section, re.MULTILINE)
    stated = {name: yaml.safe_load(default) for name, default in rows}

    common = {field.name for field in fields(ChiSquareParams)} | {"method"}
    defaults = {
        field.name: field.default for field in fields(DistributedParams) if field.name not in common
    }
    assert stated == defaults
