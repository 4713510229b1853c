"""Base configuration of all parameter classes, and options that commands and calls share.

A parameter is defined once, in the room that uses it, as a frozen dataclass:

    @dataclass(frozen=True, kw_only=True, config=STRICT)
    class VirtualForceParams: ...

with `dataclass` from pydantic. The scenario nests these classes, so YAML files and Python calls
undergo the same checks. The JSON Schema quotes the docstrings of the fields.
"""

import ast
import inspect
import textwrap
from collections.abc import Mapping
from dataclasses import MISSING, field, fields
from itertools import pairwise
from typing import Annotated, Any, Literal, get_args, get_type_hints

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as checked_dataclass
from pydantic.errors import PydanticSchemaGenerationError

from tiswarm.base.errors import InputError

STRICT = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)

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


def own_section(
    name: str,
    key: str,
    settings: type[Any] | None,
    base: type[Any],
    namespace: Mapping[str, object],
) -> Any:  # noqa: ANN401 - a class
    """Make the parameter class of a section of scenarios from a class of a plug-in.

    Args:
        name: Name by which scenarios select the section.
        key: Key of that name.
        settings: Dataclass whose fields are further keys, described by the docstrings below them.
        base: Base class of the section.
        namespace: Further attributes.

    Raises:
        InputError: a field cannot be checked.
    """
    selects: Any = Annotated[Literal[name], Field(description=f"Name of the {key}.")]
    kinds: dict[str, Any] = {key: selects}
    given: dict[str, Any] = {key: name, **namespace}
    if settings is not None:
        hints, texts = get_type_hints(settings, include_extras=True), _texts(settings)
        for each in fields(settings):
            if each.name != key:
                text = texts.get(each.name) or _inherited(settings, each.name)
                kinds[each.name] = Annotated[hints[each.name], Field(description=text)]
                if each.default is not MISSING:
                    given[each.name] = each.default
                elif each.default_factory is not MISSING:
                    given[each.name] = field(default_factory=each.default_factory)
    title = f"Own{''.join(word.capitalize() for word in name.split('-'))}Params"  # in the schema
    given["__doc__"] = (settings and settings.__doc__) or f"Settings of {name}."
    given |= {"__module__": base.__module__, "__annotations__": kinds}
    made = type(title, (base,), given)
    config = ConfigDict(**{**STRICT, "use_attribute_docstrings": False})
    try:
        return checked_dataclass(made, frozen=True, kw_only=True, config=config)
    except PydanticSchemaGenerationError as error:
        problem = f"settings of {name}: {str(error).splitlines()[0]}; use types like float or str"
        raise InputError(problem) from error


def _inherited(settings: Any, name: str) -> str | None:  # noqa: ANN401 - a class
    """Return the text of a field as the parameter class that it is from has it."""
    sections = (each.__dict__.get("__pydantic_fields__", {}) for each in settings.__mro__)
    return next((each[name].description for each in sections if name in each), None)


def _texts(settings: type[Any]) -> dict[str, str]:
    """Read the docstrings below the fields of a class; empty where it has no source."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(settings)))
    except (OSError, TypeError, SyntaxError):
        return {}
    body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
    return {
        named.target.id: inspect.cleandoc(str(text.value.value))
        for named, text in pairwise(body)
        if isinstance(named, ast.AnnAssign) and isinstance(named.target, ast.Name)
        and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
    }  # fmt: skip
