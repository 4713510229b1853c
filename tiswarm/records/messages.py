"""Plain words: what is wrong in users' files and what to do about it, and how many of what."""

import difflib
import json
from collections.abc import Collection, Sequence

from pydantic_core import ErrorDetails

Part = str | int
"""One step of the way to a value: a key, or a place in a list."""

_WHOLE = ("a whole number", "write digits only, such as 3")
_NUMBER = ("a number", "write it like 0.5 or 1e-3")
_LIST = ("a list", "write it in square brackets")
_MAPPING = ("a mapping", "write keys with values")
_WANTED = {
    "int_type": _WHOLE,
    "int_from_float": _WHOLE,
    "int_parsing": _WHOLE,
    "int_parsing_size": _WHOLE,
    "float_type": _NUMBER,
    "finite_number": ("a finite number", "nan and inf are not allowed"),
    "bool_type": ("true or false", "write one of the two"),
    "string_type": ("text", "put it in quotes"),
    "list_type": _LIST,
    "tuple_type": _LIST,
    "dict_type": _MAPPING,
    "model_type": _MAPPING,
    "model_attributes_type": _MAPPING,
    "dataclass_type": _MAPPING,
}
_LIMITS = {
    "greater_than": "{shown} is too small; it must be above {gt}",
    "greater_than_equal": "{shown} is too small; it must be at least {ge}",
    "less_than": "{shown} is too large; it must be below {lt}",
    "less_than_equal": "{shown} is too large; it must be at most {le}",
    "too_short": "has {actual_length} entries; it needs at least {min_length}",
    "too_long": "has {actual_length} entries; it takes at most {max_length}",
    "string_too_short": "the text is empty; it needs at least {min_length} character",
    "literal_error": "{shown} is not a choice here; use {expected}",
    "union_tag_invalid": "'{tag}' is not a choice here; use {expected_tags}",
    "value_error": "{error}",
}
UNKNOWN_KEY = frozenset({"extra_forbidden", "unexpected_keyword_argument"})
MISSING_KEY = frozenset({"missing", "missing_keyword_only_argument", "union_tag_not_found"})


def explain(error: ErrorDetails, allowed: Collection[str] = ()) -> str:
    """Put one pydantic error into plain words; `allowed` are the keys of the section at fault."""
    kind = error["type"]
    if kind in UNKNOWN_KEY:
        return unknown_key(str(error["loc"][-1]), allowed)
    if kind in MISSING_KEY:
        return "is missing; add it"
    value = shown(error["input"])
    if kind in _WANTED:
        wanted, remedy = _WANTED[kind]
        return f"{value} is not {wanted}; {remedy}"
    if kind in _LIMITS:
        return " ".join(_LIMITS[kind].format(shown=value, **error.get("ctx", {})).split())
    return f"{error['msg']}; {value} was given"


def unknown_key(key: str, allowed: Collection[str]) -> str:
    """Point to the key that was probably meant, or list those there are."""
    near = difflib.get_close_matches(key, allowed, n=1)
    return f"unknown key; did you mean {near[0]}?" if near else f"unknown key; {keys(allowed)}"


def keys(allowed: Collection[str]) -> str:
    """List the keys that a section may hold."""
    return f"the keys here are {', '.join(allowed)}" if allowed else "leave it out"


def shown(value: object) -> str:
    """Write a value on one short line, as it would stand in a file."""
    text = json.dumps(value, default=repr)
    return text if len(text) <= 40 else f"{text[:37]}..."  # noqa: PLR2004


def dotted(path: Sequence[Part]) -> str:
    """Write the way to a value as `stances[2].contacts[0]`."""
    text = ""
    for part in path:
        name = str(part) if str(part).isprintable() else json.dumps(part)
        text += f"[{part}]" if isinstance(part, int) else f".{name}" if text else name
    return text


def counted(number: int, noun: str) -> str:
    """Write how many there are: 1 robot, 2 robots."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
