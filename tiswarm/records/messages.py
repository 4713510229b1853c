"""Messages for users: what is wrong in a file and how to fix it, and counts of things."""

import difflib
import json
import re
from collections.abc import Collection, Iterable, Sequence

import numpy as np
from pydantic_core import ErrorDetails

from tiswarm.base.errors import did_you_mean

Part = str | int
"""One step of the path to a value: a key, or an index into a list."""

UNKNOWN_KEY = frozenset({"extra_forbidden", "unexpected_keyword_argument"})
_SECTION = frozenset({"dataclass_type", "model_type", "dict_type"})  # a value in place of one
MISSING_KEY = frozenset({"missing", "missing_keyword_only_argument", "union_tag_not_found"})
_PLAIN_WORDS = {
    "a valid integer": "a whole number",
    "a valid number": "a number",
    "a valid string": "text",
    "a valid boolean": "true or false",
    "a valid array": "a list",
    "a valid list": "a list",
    "a valid tuple": "a list",
    "a valid dictionary": "keys with values",
    "an object": "keys with values",
}
"""Words of pydantic and what files call them."""


def explain(error: ErrorDetails, allowed: Collection[str] = ()) -> str:
    """Write one pydantic error as a message; `allowed` are the keys of the section at fault."""
    kind = error["type"]
    message = error["msg"]
    context = error.get("ctx", {})
    if kind in UNKNOWN_KEY:
        near = difflib.get_close_matches(str(error["loc"][-1]), allowed, n=1)
        keys = f"the keys here are {', '.join(allowed)}" if allowed else "leave it out"
        return f"unknown key; did you mean {near[0]}?" if near else f"unknown key; {keys}"
    if kind in MISSING_KEY:
        return "is missing; add it"
    if kind == "value_error":
        return str(context["error"])
    if kind == "union_tag_invalid":
        meant = did_you_mean(context["tag"], re.findall("'(.+?)'", context["expected_tags"]))
        return f"{shown(context['tag'])} should be one of {context['expected_tags']}{meant}"
    if kind in _SECTION:
        near = difflib.get_close_matches(str(error["loc"][-1]), allowed, n=2)[1:]
        meant = f"; did you mean {near[0]}?" if near else ""
        return f"{shown(error['input'])} should be keys with values{meant}"
    subject = re.match(r"(Input|Tuple|List|Dictionary|String) should", message)
    if subject:
        message = shown(error["input"]) + message.removeprefix(subject[1])
    for word, plain in _PLAIN_WORDS.items():
        message = message.replace(word, plain)
    if kind == "literal_error":
        choices = re.findall("'(.+?)'", context["expected"])
        message = re.sub(r"\b(True|False)\b", lambda match: match[0].lower(), message)
        message += did_you_mean(error["input"], choices)
    if kind == "too_long" and [type(item) for item in list(error["input"])[-2:]] == [str, str]:
        message += "; name one source, and add the variance of the other to the sd"
    return message.replace(" after validation", "")


def shown(value: object) -> str:
    """Write a value on one short line, as it would stand in a file."""
    text = json.dumps(value, default=repr)
    return text if len(text) <= 40 else f"{text[:37]}..."  # noqa: PLR2004


def dotted(path: Sequence[Part]) -> str:
    """Write the path to a value as `stances[2].contacts[0]`."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
            continue
        name = part if part.isprintable() else json.dumps(part)
        text += f".{name}" if text else name
    return text


def counted(number: int, noun: str) -> str:
    """Write a number with its noun: 1 robot, 2 robots."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


MISSING = "\N{EN DASH}"
"""What tables for people show in place of a number that is not known."""


def percent(share: float) -> str:
    """Write a share in percent, without the sign; one that is nearly all is less than 100.

    >>> percent(0.714), percent(0.004), percent(0.9999), percent(1.0)
    ('71', '0.4', '> 99', '100')
    """
    if 0.995 <= share < 1.0:  # noqa: PLR2004 - would be rounded to 100
        return "> 99"
    return f"{100.0 * share:.0f}" if share >= 0.095 else f"{100.0 * share:.2g}"  # noqa: PLR2004


def three_digits(number: float) -> str:
    """Write a number with three significant digits, zeros included.

    >>> three_digits(2.6), three_digits(123.4), three_digits(0.00012)
    ('2.60', '123', '0.000120')
    """
    return f"{number:#.3g}".rstrip(".")


def two_digits(number: float) -> str:
    """Write a number with up to two significant digits, without an exponent.

    >>> two_digits(2.0), two_digits(123.4), two_digits(0.00012)
    ('2', '120', '0.00012')
    """
    return np.format_float_positional(float(f"{number:.2g}"), trim="-")


def decimals_for(sd: float) -> int:
    """Return the decimals at which a value with this uncertainty is written.

    >>> decimals_for(0.02), decimals_for(0.015), decimals_for(3.0)
    (3, 3, 1)
    """
    return max(0, int(np.ceil(1.0 - np.log10(max(sd, 1e-12)) - 0.3)))


def with_sd(value: float, sd: float) -> str:
    """Write a value with its standard deviation, as many decimals as this one allows.

    >>> with_sd(49.5471, 0.018)
    '49.547 +- 0.018'
    """
    decimals = decimals_for(sd)
    return f"{value:.{decimals}f} +- {sd:.{decimals}f}"


def exact_text(numbers: Iterable[float]) -> str:
    """Write numbers in the shortest form that reads back as the same ones.

    >>> exact_text([0.1, 2])
    '0.1 2.0'
    """
    return " ".join(repr(float(number)) for number in numbers)
