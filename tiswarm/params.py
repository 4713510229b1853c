"""How every parameter set checks itself.

A parameter is defined once, in the room that uses it, as a frozen dataclass:

    @dataclass(frozen=True, kw_only=True, config=STRICT)
    class VirtualForceParams: ...

with `dataclass` from pydantic. The scenario nests these classes, so a YAML file and a Python
caller meet the same checks, and the JSON Schema quotes their field docstrings.
"""

from pydantic import ConfigDict

STRICT = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)
