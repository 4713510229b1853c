"""What robots ask each other, what they answer, and what one that solved says of others."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.parts.between.wire import (
    Reader,
    Whereabouts,
    Writer,
    read_candidates,
    read_numbers,
    read_place,
)

CHECK = 15
"""Bits of the checksum by which a robot knows that what another one holds of it is current."""

_NO_CANDIDATES: Reals = np.empty((0, 3))


class Answer(NamedTuple):
    """What a robot says of itself, or one that solved says of it."""

    is_new: bool
    sharing: tuple[int, ...]
    place: Whereabouts | None
    candidates: Reals
    is_surprising: bool


def asking(wants_line: int, checksum: int) -> bytes:
    """Write what is asked of a robot: its line, and its place unless that has this checksum."""
    part = Writer(None)
    part.number(wants_line, 1)
    part.number(checksum, CHECK)
    return part.to_bytes()


@lru_cache(maxsize=20_000)
def read_answer(content: bytes, bits: int | None, with_candidates: bool) -> Answer:  # noqa: FBT001
    """Read what a robot says of itself."""
    answer = Reader(content, bits)
    is_new, is_placed = answer.number(1) == 1, answer.number(1)
    sharing = tuple(read_numbers(answer)) if is_new else ()
    place = read_place(answer) if is_placed else None
    candidates = read_candidates(answer) if is_placed and with_candidates else _NO_CANDIDATES
    return Answer(is_new, sharing, place, candidates, is_surprising=False)


@lru_cache(maxsize=20_000)
def read_result(content: bytes, bits: int | None) -> Answer:
    """Read what one that solved says of a robot."""
    answer = Reader(content, bits)
    has_candidates, is_surprising = answer.number(1), answer.number(1) == 1
    place = read_place(answer)
    candidates = read_candidates(answer) if has_candidates else _NO_CANDIDATES
    return Answer(
        is_new=True, sharing=(), place=place, candidates=candidates, is_surprising=is_surprising
    )
