"""A scenario walks through the study in one direction: plan, cases, jobs, outcomes, tables.

A *stop* of the walk is a function of another file that the study enters, counted once however often
it is called. Values (properties, constructors, functions without a name) are no stops, nor is the
floor that all rooms stand on: `base`, `compute` and `records`. What the store and the tables call
is theirs, not the study's.
"""

from collections import Counter

import pytest

from benchmarks.walks import calls_of
from tests.runs import REPOSITORY
from tiswarm import study
from tiswarm.base.progress import Progress
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study import provenance

FLOOR = ("base", "compute", "records")
LINE = ["run", "cases", "jobs", "outcomes", "executors", "runner", "store", "tables", "scaling"]
"""Files of the study in the order in which a scenario passes through them."""
WALKING = LINE[: LINE.index("store")]


@pytest.fixture(scope="module")
def calls(tmp_path_factory) -> Counter:
    """Calls that the study makes in a small run: (from, to, function)."""
    small = load_scenario(
        REPOSITORY / "tests" / "tower.yaml",
        [
            "sweep={robots: [5, 6]}",
            "seeds=2",
            "conditions={a: {}, b: {localization.iterations: 9}}",
        ],
    )
    # The first run traces kernels, which takes ten times as long with a profile.
    study.run(small, tmp_path_factory.mktemp("first"), progress=Progress())
    provenance.method_code.cache_clear()
    return calls_of(lambda: study.run(small, tmp_path_factory.mktemp("walk"), progress=Progress()))


def _place(file: str) -> int | None:
    room, _, name = file.partition("/")
    return LINE.index(name) if room == "study" and name in LINE else None


def test_a_scenario_makes_at_most_25_stops(calls):
    """A reader follows it from plan to tables in one sitting."""
    walking = {f"study/{name}" for name in WALKING}

    stops = {
        (to, name)
        for here, to, name in calls
        if here in walking and here != to and to.split("/")[0] not in FLOOR
    }

    assert len(stops) <= 25, sorted(stops)


def test_each_list_is_made_once(calls):
    """The plan sorts all cases; jobs, outcomes and tables take them in its orders."""
    made = {"variants", "plan", "batch", "compute", "write_tables"}

    count = Counter[str]()
    for (_, _, name), n in calls.items():
        count[name] += n if name in made else 0

    assert {name: count[name] for name in made} == dict.fromkeys(made, 1)


def test_nothing_climbs_back(calls):
    """No file of the line enters one before it."""
    climbs = [
        (here, to, name)
        for here, to, name in calls
        if None not in (_place(here), _place(to)) and _place(to) < _place(here)
    ]

    assert climbs == []
