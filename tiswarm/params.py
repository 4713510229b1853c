"""How every parameter set checks itself, and the settings of the backend.

A parameter is defined once, in the room that uses it, as a frozen dataclass:

    @dataclass(frozen=True, kw_only=True, config=STRICT)
    class VirtualForceParams: ...

with `dataclass` from pydantic. The scenario nests these classes, so a YAML file and a Python
caller meet the same checks, and the JSON Schema quotes their field docstrings.
"""

from typing import Literal, get_args

from pydantic import ConfigDict

STRICT = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)

Arch = Literal["cpu", "cuda", "vulkan", "metal"]
"""Device that computes; here, so that the command line can name it without loading kernels."""

Precision = Literal["f64", "f32"]
"""Type of the kernels' own real numbers."""

ARCHS: tuple[Arch, ...] = get_args(Arch)
"""Every device."""
