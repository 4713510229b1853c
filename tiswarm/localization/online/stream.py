"""A tracker fed by a stream of lines, which goes on where it was after it was stopped.

Each line of the input has one line in the output. Input that was taken is in a journal before it is
answered. A stream that was stopped at any moment reads its journal again, and answers what has no
answer yet. So the output is the same, byte for byte, however often it was stopped.
"""

import json
import math
import os
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import BinaryIO

from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.localization.online.tracker import Change, Tracker
from tiswarm.localization.params import OnlineParams
from tiswarm.records.io import MAX_LINE_BYTES, at_line, decode, unreadable

_DIGITS = 6
"""Decimals of lengths in the output."""


def follow(
    source: Path | BinaryIO,
    out: Path,
    journal: Path,
    *,
    params: OnlineParams | None = None,
    on_refused: Callable[[str], None],
    on_resumed: Callable[[int], None],
) -> Tracker:
    """Track the robots of a stream to its end.

    Args:
        source: Sensing file, or the open input, which goes on after the last line of the journal.
        out: Output, a JSON object for each line of the input.
        journal: Lines of the input so far.
        params: Settings of `online`; its defaults if None.
        on_refused: Called with the mistake of a line that is skipped.
        on_resumed: Called with the number of the first line that is not in the journal, if any is.

    Raises:
        InputError: the header is malformed, or the journal is of another input.
        EnvironmentTroubleError: a file cannot be written.
    """
    name = source if isinstance(source, Path) else Path("-")
    try:
        taken, answered = _whole_lines(journal), _whole_lines(out)
        if len(answered) > len(taken):
            problem = f"answers more lines than {journal} has; delete both to start anew"
            raise InputError(problem, path=out)
        if taken:
            on_resumed(len(taken) + 1)
        fresh = _lines(source, taken, journal)
        tracker: Tracker | None = None
        with journal.open("ab") as kept, out.open("ab") as answers:
            for number, raw in enumerate(chain(taken, fresh), start=1):
                # First the journal: a line that is answered must never be missing in it.
                if number > len(taken):
                    _append(kept, raw)
                if tracker is None:
                    with at_line(name, number):
                        tracker = Tracker(decode(raw, name, number), params)
                    answer: dict[str, object] = {"line": number, "robots": 0}
                else:
                    answer = _answered(tracker, number, raw, name, on_refused)
                if number > len(answered):
                    _append(answers, json.dumps(answer).encode())
    except OSError as error:
        problem = f"{error.filename or out} cannot be written: {error.strerror}; check its disk"
        raise EnvironmentTroubleError(problem) from error
    if tracker is None:
        raise InputError("the input is empty; start it with a header line", path=name, line=1)
    return tracker


def _answered(
    tracker: Tracker, number: int, raw: bytes, name: Path, on_refused: Callable[[str], None]
) -> dict[str, object]:
    """Take a line, and say what changed; or say why the line is refused."""
    try:
        with at_line(name, number):
            change = tracker.take(_text(raw, name, number))
    except InputError as mistake:
        on_refused(f"{mistake}; skipped")
        return {"line": number, "refused": ": ".join(filter(None, (mistake.key, mistake.problem)))}
    return {"line": number, "robots": len(tracker.names), **_changed(change)}


def _text(raw: bytes, name: Path, number: int) -> str:
    if len(raw) > MAX_LINE_BYTES:
        raise InputError("the line is longer than 64 MiB; write one robot a line")
    return decode(raw, name, number)


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


def _lines(source: Path | BinaryIO, taken: list[bytes], journal: Path) -> Iterator[bytes]:
    """Yield the lines of the input that are not in the journal yet."""
    if not isinstance(source, Path):
        yield from (raw.rstrip(b"\r\n") for raw in source)
        return
    try:
        with source.open("rb") as file:
            for number, raw in enumerate((raw.rstrip(b"\r\n") for raw in file), start=1):
                if number > len(taken):
                    yield raw
                elif raw != taken[number - 1]:
                    problem = f"differs from {journal}; delete that and the output to start anew"
                    raise InputError(problem, path=source, line=number)
    except OSError as error:
        raise unreadable(source, error) from error


def _whole_lines(path: Path) -> list[bytes]:
    """Read the lines of a file that may end in the middle of one, which is cut off."""
    if not path.exists():
        return []
    content = path.read_bytes()
    # A kill may have cut the last line; its input will be read again.
    whole = content.rfind(b"\n") + 1
    if whole < len(content):
        with path.open("r+b") as file:
            file.truncate(whole)
    return content[:whole].split(b"\n")[:-1]


def _append(file: BinaryIO, line: bytes) -> None:
    """Append a line, and return once the disk has it."""
    file.write(line + b"\n")
    file.flush()
    os.fsync(file.fileno())
