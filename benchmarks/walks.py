"""Counts where data stops on its way through the package: calls between functions, in small runs.

    python -m benchmarks.walks
    python -m benchmarks.walks "logs -> joint" --stops     # lists them, in the order of reading

A reader follows each function once, when it is first called. A stop is such a function in another
file than its caller's. It climbs back if the reader knows its file longer than that of the caller.
Values (properties, constructors, functions without a name) and kernels are no stops.
"""

import argparse
import inspect
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import tiswarm
from tiswarm import study
from tiswarm.app.drawing import draw
from tiswarm.base.progress import Progress
from tiswarm.localization.methods import localize, settings_of
from tiswarm.parts.online.tracker import Tracker
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.report.run_data import load_run
from tiswarm.scenario.expansion import load_scenario

PACKAGE = Path(tiswarm.__file__).parent
LOG = Path(__file__).parent / "logs" / "data" / "cantilever-contacts.jsonl"
SCENARIO = Path(__file__).parents[1] / "tests" / "tower.yaml"

Calls = Counter[tuple[str, str, str]]
"""How often a file calls a function: (file of the caller, file, function), first calls first."""


def calls_of(task: Callable[[], object]) -> Calls:
    """Count the calls between functions of the package that a task makes."""
    found: Calls = Counter()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event != "call" or not (to := _file(frame.f_code.co_filename)) or _is_value(frame):
            return
        caller = frame.f_back
        while caller is not None and not _file(caller.f_code.co_filename):
            caller = caller.f_back
        here = _file(caller.f_code.co_filename) if caller is not None else ""
        found[here, to, frame.f_code.co_name] += 1

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        task()
    finally:
        sys.setprofile(before)
    return found


@cache
def _file(name: str) -> str:
    """Return the module of a file within the package, as `study/run`; empty outside of it."""
    path = Path(name)
    return path.relative_to(PACKAGE).with_suffix("").as_posix() if PACKAGE in path.parents else ""


def _is_value(frame: FrameType) -> bool:
    name, owner = frame.f_code.co_name, type(frame.f_locals.get("self"))
    attribute = inspect.getattr_static(owner, name, None)
    return name.startswith(("<", "__")) or isinstance(attribute, property)


class Walk(NamedTuple):
    """What a reader meets on the way."""

    stops: list[str]
    """Functions of other files, file:function, in the order of first calls."""

    files: int
    climbs: int
    """Stops in files that the reader knows longer than that of the caller."""

    names: int
    """Functions, those of the caller's own file too."""


def walk_of(calls: Calls) -> Walk:
    """Sum up the calls of a task."""
    known: dict[str, int] = {}
    read = set[tuple[str, str]]()
    stops, climbs = [], 0
    for here, to, name in calls:
        for file in (here, to):
            known.setdefault(file, len(known))
        if (to, name) not in read and here != to:
            stops.append(f"{to}:{name}")
            climbs += known[to] < known[here]
        read.add((to, name))
    return Walk(stops, len({to for to, _ in read}), climbs, len(read))


def walks(folder: Path) -> Iterator[tuple[str, Callable[[], object]]]:
    """Yield each walk: its name, and a task that can be repeated.

    Args:
        folder: An empty folder for runs.
    """
    log, lines = read_sensing_log(LOG), LOG.read_text().splitlines()
    yield "log -> localize", lambda: localize(log, settings_of("virtual-force")())
    for method in ("joint", "online", "distributed"):
        yield f"logs -> {method}", partial(localize, log, settings_of(method)())
    yield "line -> Tracker.join", partial(_join, lines)
    scenario = load_scenario(SCENARIO, ["sweep={robots: [5, 6]}", "seeds=2"])
    yield "scenario -> study.run", lambda: study.run(scenario, _new(folder), progress=Progress())
    run = study.run(scenario, _new(folder), progress=Progress()).folder
    yield "run -> drawing", lambda: draw(load_run(run), Progress(), figures=True)


def _join(lines: Sequence[str]) -> None:
    tracker = Tracker(lines[0])
    for line in lines[1:]:
        tracker.join(line)


def _new(folder: Path) -> Path:
    return Path(tempfile.mkdtemp(dir=folder))


def main() -> None:
    """Print the table, or the stops of one walk."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("walks", nargs="*", help="some of the walks; all if none is named")
    parser.add_argument("--stops", action="store_true", help="list stops, too")
    asked = parser.parse_args()
    print("| walk | stops | files | climbs back | names |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name, task in walks(Path(folder)):
            if asked.walks and name not in asked.walks:
                continue
            task()  # compiles kernels, which is a walk of its own
            walk = walk_of(calls_of(task))
            print(f"| {name} | {len(walk.stops)} | {walk.files} | {walk.climbs} | {walk.names} |")
            if asked.stops:
                print(*walk.stops, sep="\n")


if __name__ == "__main__":
    main()
