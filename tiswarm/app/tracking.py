"""Streams of a log's lines, followed while robots join."""

from pathlib import Path
from typing import TYPE_CHECKING

from tiswarm.app.console import ConsoleProgress
from tiswarm.app.logs import method_params
from tiswarm.app.results import File, Overrides, as_path
from tiswarm.base.errors import warn
from tiswarm.base.parts import load
from tiswarm.records.positions import write_estimate

if TYPE_CHECKING:
    from typing import BinaryIO

    from tiswarm.localization.online.tracker import Tracker


def track(
    source: "File | BinaryIO",
    *,
    out: File = "changes.jsonl",
    journal: File | None = None,
    estimate: File | None = None,
    overrides: Overrides = (),
    quiet: bool = True,
    **settings: object,
) -> "Tracker":
    """Estimate robots' positions from a stream of a log's lines, as `tiswarm track` does.

    A line that is malformed is skipped, with a warning. A stream that was stopped goes on where it
    was when it is called again with the same files.

    Args:
        source: Sensing file, or an open binary input, which goes on after the journal's last line.
        out: Output, a JSON object for each line of the input.
        journal: File for the lines of the input so far; the output's name and `.journal` if None.
        estimate: Table of positions to write at the end, of the final answer; none if None.
        overrides: Settings of the method `online`, as for `localize`.
        quiet: Whether to hide where a stream goes on.
        settings: Settings of the method by name.

    Returns:
        The tracker, with the positions of all robots.

    Raises:
        InputError: the header or a setting is invalid, or the journal is of another input.
    """
    follow = load("tiswarm.localization.online.stream:follow", "track")
    params = method_params("online", None, overrides, settings)
    where = as_path(out, "out")
    kept = where.with_name(f"{where.name}.journal") if journal is None else journal
    progress = ConsoleProgress(quiet=quiet)
    tracker: Tracker = follow(
        as_path(source, "source") if isinstance(source, str | Path) else source,
        where, as_path(kept, "journal"), params=params, on_refused=warn,
        on_resumed=lambda line: progress.info(f"goes on at line {line}"),
    )  # fmt: skip
    if estimate is not None:
        write_estimate(as_path(estimate, "estimate"), tracker.estimate(final=True))
    return tracker
