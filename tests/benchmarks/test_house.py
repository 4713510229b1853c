"""What is counted of the package, in a small package and in ours."""

from collections import Counter
from pathlib import Path

import pytest

from benchmarks.house import CONCEPTS, House, counts, places_of
from benchmarks.walks import walk_of
from tests.runs import REPOSITORY

MODULES = {
    "__init__.py": "",
    "localization/joint.py": "from tiswarm.measurements.model import rows\n\nRANGES = 'ranges'\n",
    "localization/__init__.py": "",
    "measurements/model.py": "# Why.\ndef rows(log):\n    return log.ranges\n",
    "parts/online/tracker.py": "from tiswarm.localization.joint import (\n    RANGES,\n)\n",
    "parts/between/method.py": 'NAME = "tiswarm.parts.online.tracker"\n',
    "base/parts.py": "from importlib import import_module\n\nimport_module('os')\n",
}


@pytest.fixture
def package(tmp_path) -> Path:
    """Folder of a small package."""
    for name, text in MODULES.items():
        file = tmp_path / "tiswarm" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return tmp_path


def test_a_small_package_is_counted(package):
    """Each count is that of a reader of seven files."""
    found = counts(House(package))

    assert {
        "files": "7",
        "lines": "13",
        "lines of parts": "4",
        "files with the word `ranges`": "2",
        "files that use the key `ranges`": "2",
        "files that name a part": "1",
        "names that methods take from each other": "1",
        "lines that joint loads": "6",
        "lines that Tracker loads": "9",
        "places: doors": "0",
        "imports, of all lines": "38.5 %",
        "comments per 100 lines of numerical code": "12.5",
    }.items() <= found.items()


def test_places_of_concepts_exist():
    """Who renames a function of the table of concepts corrects the table."""
    house = House(REPOSITORY)

    lost = [p for row in CONCEPTS.values() for p in places_of(row) if not house.has(p)]

    assert lost == [], f"no such function: {', '.join(lost)}; correct benchmarks/places.csv"


def test_a_walk_is_summed_up():
    """A function is read once; a stop in a file known longer than the caller's climbs back."""
    calls = Counter({("", "a", "run"): 1, ("a", "a", "own"): 2, ("a", "b", "solve"): 9})
    calls |= Counter({("b", "a", "report"): 1, ("b", "a", "own"): 3})

    walk = walk_of(calls)

    assert walk.stops == ["a:run", "b:solve", "a:report"]
    assert (walk.files, walk.climbs, walk.names) == (2, 1, 4)
