"""Streams of a log's lines, answered while robots join."""

from contextlib import nullcontext
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from tiswarm.app.logs import method_params
from tiswarm.app.results import File, Overrides, as_path
from tiswarm.base.errors import warn
from tiswarm.base.parts import find
from tiswarm.records import outputs
from tiswarm.records.positions import write_estimate
from tiswarm.records.sensing_file import log_lines

if TYPE_CHECKING:
    from typing import BinaryIO, TextIO

    from tiswarm.base.parts import Tracker

_NAME = (str, PathLike)


def track(
    source: "File | BinaryIO",
    *,
    out: "File | TextIO | None" = None,
    estimate: File | None = None,
    overrides: Overrides = (),
    overwrite: bool = False,
    **settings: object,
) -> "Tracker":
    """Estimate robots' positions from a stream of a log's lines, as `tiswarm track` does.

    A line that is malformed is skipped, with a warning.

    Args:
        source: Sensing file, or an open binary input.
        out: Open text output that receives the answer of each line, a JSON object, before the next
            line is read; or file for all answers, which appears at the end of the input; none if
            None.
        estimate: Table of positions to write at the end, of the final answer; none if None.
        overrides: Settings of the method `online`, as for `localize`.
        overwrite: Whether to replace files that no tiswarm command wrote.
        settings: Settings of the method by name.

    Returns:
        The tracker, with the positions of all robots.

    Raises:
        InputError: the input cannot be read, its header or a setting is invalid, or an output is an
            input, or a file that no tiswarm command wrote.
    """
    follow = find("command", "track").follow
    file, terminal = (as_path(out, "out"), None) if isinstance(out, _NAME) else (None, out)
    table = None if estimate is None else as_path(estimate, "estimate")
    outputs.check({"out": file, "estimate": table}, [source], overwrite=overwrite)
    outputs.refuse_same(terminal, source)
    params = method_params("online", None, overrides, settings)
    if isinstance(source, _NAME):
        path = as_path(source, "source")
        lines = log_lines(path)
    else:
        path = Path("-")
        lines = log_lines(path, source)
    opened = partial(outputs.opened, overwrite=overwrite)
    with opened(file) if file else nullcontext() as whole:

        def answer(text: str) -> None:
            if whole is not None:
                whole.write(text.encode())
            elif terminal is not None:
                terminal.write(text)
                terminal.flush()

        tracker: Tracker = follow(lines, path, params=params, on_answer=answer, on_refused=warn)
        final = None if table is None else tracker.estimate(final=True)
    if table is not None and final is not None:
        write_estimate(table, final, opened=opened)
    return tracker
