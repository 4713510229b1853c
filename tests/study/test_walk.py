"""A scenario walks through the study in one direction: plan, cases, jobs, outcomes, tables.

A *stop* of the walk is a function of another file that the study enters, counted once however often
it is called. Values (properties, constructors, functions without a name) are no stops, nor is the
floor that all rooms stand on: `base`, `compute` and `records`. What the store and the tables call
is theirs, not the study's.
"""

import inspect
import sys
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

import tiswarm
from tests.runs import REPOSITORY
from tiswarm import study
from tiswarm.base.progress import Progress
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study import provenance

PACKAGE = Path(tiswarm.__file__).parent
FLOOR = ("base", "compute", "records")
LINE = ["run", "cases", "jobs", "outcomes", "executors", "runner", "store", "tables", "scaling"]
"""Files of the study in the order in which a scenario passes through them."""
WALKING = LINE[: LINE.index("store")]


@pytest.fixture(scope="module")
def calls(tmp_path_factory) -> Counter:
    """Calls from file to file that the study makes in a small run: (from, to, function)."""
    small = load_scenario(
        REPOSITORY / "tests" / "tower.yaml",
        [
            "sweep={robots: [5, 6]}",
            "seeds=2",
            "conditions={a: {}, b: {localization.iterations: 9}}",
        ],
    )
    found: Counter = Counter()

    def note(frame, event, _):
        if event != "call" or not (to := _file(frame.f_code.co_filename)):
            return
        caller = frame.f_back
        while caller is not None and not _file(caller.f_code.co_filename):
            caller = caller.f_back
        if caller is None or (here := _file(caller.f_code.co_filename)) == to:
            return
        if not _is_value(frame):
            found[here, to, frame.f_code.co_name] += 1

    # The first run traces kernels, which takes ten times as long with a profile.
    study.run(small, tmp_path_factory.mktemp("first"), progress=Progress())
    provenance.method_code.cache_clear()
    before = sys.getprofile()
    sys.setprofile(note)
    try:
        study.run(small, tmp_path_factory.mktemp("walk"), progress=Progress())
    finally:
        sys.setprofile(before)
    return found


@cache
def _file(name: str) -> str:
    """Return the module of a file within the package, as `study/run`; empty outside of it."""
    path = Path(name)
    return path.relative_to(PACKAGE).with_suffix("").as_posix() if PACKAGE in path.parents else ""


def _is_value(frame) -> bool:
    name, owner = frame.f_code.co_name, type(frame.f_locals.get("self"))
    attribute = inspect.getattr_static(owner, name, None)
    return name.startswith(("<", "__")) or isinstance(attribute, property)


def _place(file: str) -> int | None:
    room, _, name = file.partition("/")
    return LINE.index(name) if room == "study" and name in LINE else None


def test_a_scenario_makes_at_most_25_stops(calls):
    """A reader follows it from plan to tables in one sitting."""
    walking = {f"study/{name}" for name in WALKING}

    stops = {
        (to, name) for here, to, name in calls if here in walking and to.split("/")[0] not in FLOOR
    }

    assert len(stops) <= 25, sorted(stops)


def test_each_list_is_made_once(calls):
    """The plan sorts all cases; jobs, outcomes and tables take them in its orders."""
    made = {"variants", "plan", "batch", "compute", "write_tables"}

    assert {name: n for (_, _, name), n in calls.items() if name in made} == dict.fromkeys(made, 1)


def test_nothing_climbs_back(calls):
    """No file of the line enters one before it."""
    climbs = [
        (here, to, name)
        for here, to, name in calls
        if None not in (_place(here), _place(to)) and _place(to) < _place(here)
    ]

    assert climbs == []
