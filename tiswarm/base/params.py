"""Base configuration of all parameter classes, and options that commands and calls share.

A parameter is defined once, in the room that uses it, as a frozen dataclass:

    @dataclass(frozen=True, kw_only=True, config=STRICT)
    class VirtualForceParams: ...

with `dataclass` from pydantic. The scenario nests these classes, so YAML files and Python calls
undergo the same checks. `tiswarm schema` quotes the docstrings of the fields.
"""

from typing import Literal, get_args

from pydantic import ConfigDict, Field

STRICT = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)

UNLESS_SET = Field(exclude_if=lambda value: value is None)
"""Of a key that is not written where it is null: runs without it keep their hashes, which name
folders."""

Arch = Literal["cpu", "cuda", "vulkan", "metal"]
"""Compute device; defined here so that the command line need not load kernels."""

AnyArch = Literal[Arch, "auto"]
"""Compute device that users name; `auto` takes a graphics card where one works, else the CPU."""

Precision = Literal["f64", "f32"]
"""Floating-point type of the kernels."""

AnyPrecision = Literal["auto", Precision]
"""Type that users name; `auto` takes f64 where the device computes it at half the rate of f32."""

ARCHS: tuple[Arch, ...] = get_args(Arch)
"""All compute devices."""

AnyMovie = Literal["mp4", "webp", "gif"]
"""File formats of an animation."""

METHOD = "joint"
"""Method of calls and commands that name none."""
