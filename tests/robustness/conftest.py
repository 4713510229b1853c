"""Trials: many random attempts at one promise. Each is counted; the files that fail are kept.

A trial is a function of its seed. It is marked `slow` and ends with a row of a table. Environment
variables: TISWARM_TRIAL_SHARE is the share of the attempts to make, 1 by default, and
TISWARM_TRIAL_SEED another seed than 0.
"""

import os
import random
import shutil
import signal
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tiswarm.report import figure_style
from tiswarm.report.pictures import pictures

SHARE = float(os.environ.get("TISWARM_TRIAL_SHARE", "1"))
SEED = int(os.environ.get("TISWARM_TRIAL_SEED", "0"))
LIMITS_S = {
    signal.SIGPROF: (signal.ITIMER_PROF, "processor", 30.0),
    signal.SIGALRM: (signal.ITIMER_REAL, "wall", 180.0),  # for what only waits
}
"""By signal: its timer, the kind of time, and how much of it an attempt may take [s]."""

LARGEST = 2**24
"""Size below which a file is kept [byte]."""

ROW = "trial"
"""Name of the property by which a report carries the row of its trial."""


class Trial:
    """Attempts of one kind: what came of each, and which failed."""

    def __init__(self, name: str, folder: Path) -> None:
        """Start without attempts; `folder` receives the files that fail."""
        self.name = name
        self.folder = folder
        self.outcomes: Counter[str] = Counter()
        self.failures: list[str] = []

    def numbers(self, attempts: int) -> range:
        """Number the attempts that this session makes of so many."""
        return range(max(1, round(attempts * SHARE)))

    def random(self, number: int = 0) -> random.Random:
        """Return the random numbers of an attempt; they depend on the seed and the name alone."""
        return random.Random(f"{SEED} {self.name} {number}")  # noqa: S311 - no secrets

    @contextmanager
    def attempt(self, number: int, *files: Path, what: str = "") -> Iterator[None]:
        """Run an attempt at something; if it raises or takes too long, note why; keep its files."""
        try:
            with _limited():
                yield
        except (Exception, _TooLong) as error:  # noqa: BLE001 - the end of the session shows it
            at = traceback.extract_tb(error.__traceback__)[-1]
            why = f"{type(error).__name__} at {Path(at.filename).name}:{at.lineno}: {error}"
            kept = self.folder / str(number)
            kept.mkdir(exist_ok=True)
            for file in files:
                if file.is_file() and file.stat().st_size < LARGEST:
                    shutil.copy(file, kept)
            self.outcomes["failed"] += 1
            self.failures.append(f"seed {SEED}, attempt {number} in {kept}: {what}: {why[:400]}")


class _TooLong(BaseException):
    """An attempt took too long; no `except Exception` of the package hides it."""


@contextmanager
def _limited() -> Iterator[None]:
    def give_up(number: int, _: object) -> None:
        _, kind, limit = LIMITS_S[number]
        raise _TooLong(f"took more than {limit:g} s of {kind} time")

    before = {number: signal.signal(number, give_up) for number in LIMITS_S}
    for timer, _, limit in LIMITS_S.values():
        signal.setitimer(timer, limit)
    try:
        yield
    finally:
        for number, (timer, _, _) in LIMITS_S.items():
            signal.setitimer(timer, 0.0)
            signal.signal(number, before[number])


@pytest.fixture
def coarse_pictures(monkeypatch) -> None:
    """Draw figures coarsely and pictures empty, so that an attempt is quick."""
    new_figure = figure_style.new_figure

    def coarse(width, height):
        figure = new_figure(width, height)
        figure.set_dpi(20)
        return figure

    def blank(scenes, *_):
        assert all(np.isfinite(scene.start).all() for scene in scenes)
        return [np.zeros((s.camera.height, s.camera.width, 3), np.uint8) for s in scenes], "-", ""

    monkeypatch.setattr(figure_style, "new_figure", coarse)
    monkeypatch.setattr(pictures, "draw_scenes", blank)


@pytest.fixture
def trial(request, record_property, tmp_path_factory) -> Iterator[Trial]:
    """Trial of one test, whose row the session prints."""
    name = request.node.name.removeprefix("test_").replace("_", " ")
    trial = Trial(name, tmp_path_factory.mktemp("failed"))
    yield trial
    outcomes = [[what, count] for what, count in trial.outcomes.most_common() if what != "failed"]
    record_property(ROW, [name, trial.outcomes.total(), trial.failures, outcomes])


def pytest_terminal_summary(terminalreporter) -> None:
    """Print a table of all trials, as `docs/promises.md` has it."""
    rows = [
        value
        for reports in terminalreporter.stats.values()
        for report in reports
        if getattr(report, "when", "") == "teardown"
        for key, value in report.user_properties
        if key == ROW
    ]
    if not rows:
        return
    terminalreporter.section(f"trials, seed {SEED}")
    terminalreporter.line("| trial | tried | failed | outcomes |\n|---|---|---|---|")
    for name, tried, failures, outcomes in rows:
        text = ", ".join(f"{count} {what}" for what, count in outcomes)
        terminalreporter.line(f"| {name} | {tried} | {len(failures)} | {text} |")
    for _, _, failures, _ in rows:
        for failure in failures:
            terminalreporter.line(failure)
