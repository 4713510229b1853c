"""Random damage: to plain data, to the bytes of a file, and to files of a folder."""

import json
import random
from collections.abc import Callable, Iterator
from copy import deepcopy
from typing import Any

NUMBERS = [
    0, -0.0, -1, 1, 3, 0.5, 1e-300, 5e-324, 1e9, 1e19, 1e160, 1e308, -1e308, 2**31, 2**63, -(2**63),
    10**400, float("nan"), float("inf"),
]  # fmt: skip
OTHERS = [
    None, True, "", "no", "nan", "x" * 5000, "\x1b[2J", "../../escaped", "two\nlines", "\u202eleft",
    [], {}, [[]], [1, 2, 3], {"kind": "tower"}, [None] * 1000,
]  # fmt: skip
SNIPPETS = [
    b"\x00", b"\xff", b"\xef\xbb\xbf", b"\r", b"\t", b"\n", b"\n\n", b"\x1b[2J", b"'", b'"', b"{",
    b"]", b"}", b",", b": ", b"- ", b"? ", b"#", b"<<: ", b"&a ", b"*a", b"!!int ", b"\n---\n",
    b"%", b"!!python/object/apply:os.system ['true'] ", b"\\ud800", b"1e999", b"-NaN", b"[" * 2000,
    b"9" * 5000, b" " * 70_000, "\N{SNOWMAN}\u2028".encode(),
    b"\na: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]\nd: [*c, *c]\n",
    b"\n" + b"".join(b"key%d: 1\n" % n for n in range(9000)),
]  # fmt: skip

Random = random.Random


def mutated(random: Random, data: Any) -> Any:
    """Return plain data with one value, key or entry that is another, missing or one too many."""
    data = deepcopy(data)
    holder, key = random.choice([*_places(data)])
    edits = [_other_value, _other_value, _scaled, _borrowed, _removed]
    edits += [_renamed, _added] if isinstance(holder, dict) else [_repeated, _swapped]
    random.choice(edits)(random, holder, key, data)
    return data


def other_number(random: Random, data: Any) -> Any:
    """Return plain data with another number in the place of one."""
    data = deepcopy(data)
    numbers = [
        (holder, key) for holder, key in _places(data) if isinstance(holder[key], int | float)
    ]
    holder, key = random.choice(numbers)
    random.choice([_scaled, _scaled, _other_number])(random, holder, key, data)
    return data


def damaged(random: Random, raw: bytes) -> bytes:
    """Return other bytes: a bit, a digit, a place or a line is changed, too many or missing."""
    edits: list[Callable[[Random, bytes, int], bytes]] = [
        _bit_flipped, _digit_changed, _cut, _without_some, _two_swapped, _snippet_added,
        _lines_swapped, _line_repeated,
    ]  # fmt: skip
    while True:
        changed = random.choice(edits)(random, raw, random.randrange(len(raw) or 1))
        if changed != raw:
            return changed


# --- plain data ------------------------------------------------------------------------------


def _places(data: Any) -> Iterator[tuple[Any, Any]]:
    """Yield each list or mapping of some data with each of its places."""
    for key in [*data] if isinstance(data, dict) else range(len(data)):
        yield data, key
        if isinstance(data[key], dict | list):
            yield from _places(data[key])


def _other_value(random: Random, holder: Any, key: Any, data: Any) -> None:
    holder[key] = deepcopy(random.choice(random.choice([NUMBERS, OTHERS])))


def _other_number(random: Random, holder: Any, key: Any, data: Any) -> None:
    holder[key] = random.choice(NUMBERS)


def _scaled(random: Random, holder: Any, key: Any, data: Any) -> None:
    if isinstance(holder[key], int | float):
        holder[key] *= random.choice([-1, 2, 1.5, 1e-9, 1e3, 1e6, 1e12])
    else:
        holder[key] = str(holder[key])


def _borrowed(random: Random, holder: Any, key: Any, data: Any) -> None:
    other, place = random.choice([*_places(data)])
    holder[key] = deepcopy(other[place])


def _removed(random: Random, holder: Any, key: Any, data: Any) -> None:
    del holder[key]


def _renamed(random: Random, holder: Any, key: Any, data: Any) -> None:
    name = random.choice([key.upper(), key[:-1], f"{key}.{key}", *map(str, OTHERS)])
    holder[name] = holder.pop(key)


def _added(random: Random, holder: Any, key: Any, data: Any) -> None:
    _other_value(random, holder, random.choice([f"{key}s", *map(str, NUMBERS + OTHERS)]), data)


def _repeated(random: Random, holder: Any, key: Any, data: Any) -> None:
    holder += [deepcopy(holder[key])] * random.choice([1, 1, 1, 1000])


def _swapped(random: Random, holder: Any, key: Any, data: Any) -> None:
    other = random.randrange(len(holder))
    holder[key], holder[other] = holder[other], holder[key]


# --- bytes -----------------------------------------------------------------------------------


def _bit_flipped(random: Random, raw: bytes, at: int) -> bytes:
    return raw[:at] + bytes([raw[at] ^ 1 << random.randrange(8)]) + raw[at + 1 :] if raw else b"0"


def _digit_changed(random: Random, raw: bytes, at: int) -> bytes:
    digits = [place for place, byte in enumerate(raw) if chr(byte).isdigit()] or [at]
    at = random.choice(digits)
    return raw[:at] + random.choice(b"0123456789").to_bytes(1, "big") + raw[at + 1 :]


def _cut(random: Random, raw: bytes, at: int) -> bytes:
    return raw[:at]


def _without_some(random: Random, raw: bytes, at: int) -> bytes:
    return raw[:at] + raw[at + random.choice([1, 2, 10, 100]) :]


def _two_swapped(random: Random, raw: bytes, at: int) -> bytes:
    return raw[:at] + raw[at + 1 : at + 2] + raw[at : at + 1] + raw[at + 2 :]


def _snippet_added(random: Random, raw: bytes, at: int) -> bytes:
    return raw[:at] + random.choice(SNIPPETS) + raw[at:]


def _lines_swapped(random: Random, raw: bytes, at: int) -> bytes:
    lines = raw.splitlines(keepends=True)
    random.shuffle(lines)
    return b"".join(lines)


def _line_repeated(random: Random, raw: bytes, at: int) -> bytes:
    lines = raw.splitlines(keepends=True)
    return raw + random.choice(lines or [b"\n"])


def as_json_lines(entries: list[Any]) -> bytes:
    """Write plain data as a file of JSON lines, with numbers that JSON does not have."""
    return "".join(f"{json.dumps(each)}\n" for each in entries).encode()
