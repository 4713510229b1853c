"""Streams of a log's lines, answered while robots join."""

from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from tiswarm.app.logs import method_params
from tiswarm.app.results import File, Overrides, as_path
from tiswarm.base.errors import warn
from tiswarm.base.parts import load
from tiswarm.records.outputs import check_outputs, output
from tiswarm.records.positions import write_estimate
from tiswarm.records.sensing_file import log_lines

if TYPE_CHECKING:
    from typing import BinaryIO

    from tiswarm.localization.online.tracker import Tracker


def track(
    source: "File | BinaryIO",
    *,
    on_answer: Callable[[str], object] | None = None,
    out: File | None = None,
    estimate: File | None = None,
    overrides: Overrides = (),
    overwrite: bool = False,
    **settings: object,
) -> "Tracker":
    """Estimate robots' positions from a stream of a log's lines, as `tiswarm track` does.

    A line that is malformed is skipped, with a warning.

    Args:
        source: Sensing file, or an open binary input.
        on_answer: Called with the answer of each line, a JSON object that ends in a newline, before
            the next line is read.
        out: File for all answers, which appears at the end of the input; none if None.
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
    follow = load("tiswarm.localization.online.stream:follow", "track")
    answers = None if out is None else as_path(out, "out")
    table = None if estimate is None else as_path(estimate, "estimate")
    check_outputs({"out": answers, "estimate": table}, [source], overwrite=overwrite)
    params = method_params("online", None, overrides, settings)
    name, stream = Path("-"), None
    if isinstance(source, (str, PathLike)):
        name = as_path(source, "source")
    else:
        stream = source
    opened = partial(output, overwrite=overwrite)
    with opened(answers) if answers else nullcontext() as file:

        def answer(text: str) -> None:
            if file is not None:
                file.write(text.encode())
            if on_answer is not None:
                on_answer(text)

        lines = log_lines(name, stream)
        tracker: Tracker = follow(lines, name, params=params, on_answer=answer, on_refused=warn)
    if table is not None:
        write_estimate(table, tracker.estimate(final=True), opened=opened)
    return tracker
