"""Answers the lines of a log one by one, as the robots join.

Each line of the input has one answer. Nothing is stored: the same lines give the same answers, byte
for byte, so a stream that was stopped is fed again from its header on.
"""

import json
import math
from collections.abc import Callable, Iterable
from pathlib import Path

from tiswarm.base.errors import InputError
from tiswarm.localization.params import OnlineParams
from tiswarm.parts.online.tracker import Change, Tracker
from tiswarm.records.io import at_line, decode

_DIGITS = 6
"""Decimals of lengths in an answer."""


def follow(
    lines: Iterable[tuple[int, bytes]],
    name: Path,
    *,
    params: OnlineParams | None = None,
    on_answer: Callable[[str], object],
    on_refused: Callable[[str], None],
) -> Tracker:
    """Track the robots of a stream to its end.

    Args:
        lines: Lines with their numbers, the header first, as `log_lines` yields them.
        name: Name of the input in messages.
        params: Settings of `online`; its defaults if None.
        on_answer: Called with the answer of each line, a JSON object that ends in a newline, before
            the next line is read.
        on_refused: Called with the mistake of a line that is skipped.

    Raises:
        InputError: the header is malformed, or the input cannot be read.
    """
    tracker: Tracker | None = None
    for number, raw in lines:
        if tracker is None:
            with at_line(name, number):
                tracker = Tracker(decode(raw, name, number), params)
            answer: dict[str, object] = {"line": number, "robots": 0}
        else:
            answer = _answered(tracker, number, raw.rstrip(b"\r\n"), name, on_refused)
        on_answer(f"{json.dumps(answer)}\n")
    if tracker is None:
        raise InputError("the input is empty; start it with a header line", path=name, line=1)
    return tracker


def _answered(
    tracker: Tracker, number: int, raw: bytes, name: Path, on_refused: Callable[[str], None]
) -> dict[str, object]:
    """Take a line, and say what changed; or say why the line is refused."""
    try:
        with at_line(name, number):
            change = tracker.take(decode(raw, name, number))
    except InputError as mistake:
        on_refused(f"{mistake}; skipped")
        return {"line": number, "refused": ": ".join(filter(None, (mistake.key, mistake.problem)))}
    return {"line": number, "robots": len(tracker.names), **_changed(change)}


def _changed(change: Change) -> dict[str, object]:
    """Write a change as JSON values; a robot that joined has null in place of a way."""
    columns = zip(
        change.robot.tolist(), change.position.tolist(), change.moved.tolist(), change.sd.tolist(),
        strict=True,
    )  # fmt: skip
    return {
        "annealed": change.annealed,
        "moved": [
            {
                "robot": robot,
                "position": [round(part, _DIGITS) for part in position],
                "moved": None if math.isnan(moved) else round(moved, _DIGITS),
                "sd": round(sd, _DIGITS),
            }
            for robot, position, moved, sd in columns
        ],
    }
