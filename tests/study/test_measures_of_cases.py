"""Measures of plug-ins ask for parts of a case by the names of their arguments."""

import re

import numpy as np
import pytest

import tiswarm as api
from tests.runs import REPOSITORY
from tiswarm.base import plugins
from tiswarm.base.errors import InputError

PAGE = (REPOSITORY / "docs" / "own-method.md").read_text()
[WALKS] = [
    code for code in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL) if "weak_share" in code
]
MEASURES = (
    WALKS
    + '''
import numpy as np


@tiswarm.measure("asked_robots", meaning="robots of the scenario")
def asked(settings):
    """Return the number that the scenario states."""
    return settings.robots


@tiswarm.measure("sensed_contacts", meaning="contacts in the log")
def sensed(log, *, estimate=None):
    """Count contacts, negative where there is an estimate."""
    return len(log.contacts) * (1 if estimate is None else -1)


@tiswarm.measure("worst_R", unit="R", meaning="largest error", better="smaller")
def worst(estimate, truth):
    """Take the largest error; arguments have any order."""
    return np.linalg.norm(estimate.position - truth.position, axis=1).max()


@tiswarm.measure("span_R", unit="R", meaning="largest error, by arguments of other names")
def span(a, b):
    """Receive truth and estimate, as measures without names of parts do."""
    return np.linalg.norm(b.position - a.position, axis=1).max()
'''
)
STRUCTURE = {"kind": "tower", "strength": {"limit": 90.0}}
DATA = {
    "name": "measured",
    "robots": 6,
    "seeds": 2,
    "structure": STRUCTURE,
    "localization": {"method": "none"},
}
BOTH = {"plain": {}, "localized": {"localization": {"method": "hop-by-hop"}}}
OWN = ["weak_share", "flips_per_robot", "sensed_contacts"]


@pytest.fixture(autouse=True)
def _forget():
    """Leave no plug-in to the next test."""
    yield
    plugins.forget()


@pytest.fixture
def own(tmp_path):
    """A file with measures."""
    file = tmp_path / "own.py"
    file.write_text(MEASURES)
    return file


def run(out, own, **changes):
    """Run the scenario with the measures, without pictures."""
    return api.run(DATA | changes, out=out, plugins=[own], pictures=False, quiet=True)


@pytest.mark.filterwarnings("ignore:.* ended before all robots joined")
def test_a_measure_of_the_history_is_that_of_the_grown_structure(tmp_path, own):
    """A study without localization has measures of walks and loads, as `tiswarm.grow` gives."""
    grown = api.grow(STRUCTURE, robots=6, seeds=2, quiet=True)

    summary = run(tmp_path, own).summary

    for structure, row in zip(grown, summary.to_dict("records"), strict=True):
        load = structure.contact_load[:, 5]
        assert row["flips_per_robot"] == structure.flips.sum() / structure.robot_count
        assert row["weak_share"] == (load > 0.5).mean()
        assert row["sensed_contacts"] > 0
        assert row["asked_robots"] == 6
    assert "worst_R" not in api.open_run(next(tmp_path.glob("measured-*"))).table
    assert not [*tmp_path.glob("measured-*/structures")]


def test_a_measure_of_an_estimate_has_no_value_without_one(tmp_path, own):
    """Conditions that are not localized have empty cells; an argument with a default is None."""
    summary = run(tmp_path, own, conditions=BOTH).summary.set_index("condition")

    plain = summary.loc["plain"]
    localized = summary.loc["localized"]

    assert np.isnan(plain[["worst_R", "span_R"]]).all(axis=None)
    assert (localized["worst_R"] > 0.0).all()
    np.testing.assert_array_equal(localized["worst_R"], localized["span_R"])
    assert (plain["sensed_contacts"] > 0).all()
    for name, sign in (("sensed_contacts", -1), ("flips_per_robot", 1)):
        np.testing.assert_array_equal(localized[name], sign * plain[name])


def test_measures_of_an_earlier_run_grow_its_structures_again(tmp_path, own):
    """A measure can be added after a run that kept no history: the structures are equal."""
    at_once = run(tmp_path / "once", own).summary[OWN]
    plugins.forget()
    later = api.run(DATA, out=tmp_path / "later", pictures=False, quiet=True)
    assert "weak_share" not in later.summary

    api.redraw(later.folder, plugins=[own], quiet=True)

    assert later.summary[OWN].equals(at_once)


def test_scores_of_grown_structures_have_the_measures(own):
    """`swarms.score` gives a measure all parts that a case has."""
    grown = api.grow("tower", robots=5, seeds=1, plugins=[own], quiet=True)

    scores = grown.score([log.localize("hop-by-hop", quiet=True) for log in grown.sense()])

    assert scores["flips_per_robot"].tolist() == [grown.flips.sum() / 5]
    assert (scores["worst_R"] > 0.0).all()


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ("truth, smell", "argument smell is none of truth, estimate, log, history, settings"),
        ("a, b, c", "argument a is none of"),
        ("", "no argument is none of"),
    ],
)
def test_a_measure_that_asks_for_something_else_is_refused(tmp_path, arguments, problem):
    """The line names the argument, before a case is computed."""
    file = tmp_path / "own.py"
    file.write_text(
        "import tiswarm\n\n\n"
        '@tiswarm.measure("own", meaning="x")\n'
        f"def own({arguments}):\n    return 1.0\n"
    )

    with pytest.raises(InputError, match=rf"own.py:\d+: measure own: {problem}"):
        run(tmp_path, file)
