"""Points of a sweep have short names, which never identify anything."""

import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.runs import REPOSITORY
from tiswarm.base.errors import InputError
from tiswarm.records.run_folder import cell_of
from tiswarm.scenario.expansion import load_scenario, variants
from tiswarm.scenario.labels import LENGTHS, SELECTORS, SYMBOLS, row_labels
from tiswarm.scenario.model import scenario_hash, scenario_schema
from tiswarm.scenario.validation import DISCRIMINATORS

SCENARIOS = sorted((REPOSITORY / "scenarios").glob("*.yaml"))
VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(0, 10**6), st.floats(0.0, 1e6),
    st.sampled_from(["tower", "truth", "f32"]), st.lists(st.integers(0, 9), max_size=4),
)  # fmt: skip
ROWS = st.one_of(
    VALUES,
    st.dictionaries(st.sampled_from(["kind", "gap", "anchor", "climb.settle"]), VALUES, max_size=3),
)


@settings(max_examples=50)
@given(rows=st.lists(ROWS, min_size=2, max_size=6, unique_by=cell_of))
def test_labels_keep_all_rows_apart_in_words(rows):
    """No label is a piece of Python, and no two are the same."""
    labels = row_labels({"structure": rows})["structure"]

    assert list(labels) == [*map(cell_of, rows)]
    assert len({*labels.values()}) == len(rows)
    assert not any(re.search(r"[{}'\"=\[\]]|None|True|False", label) for label in labels.values())


def test_what_all_points_share_is_in_no_label():
    """A label has what differs: values that are numbers with their units or symbols."""
    bridges = [{"kind": "bridge", "plane": True, "gap": gap} for gap in (20.0, 30.0)]
    sweep = {
        "structure": [{"kind": "tower", "plane": True}, *bridges],
        "structure.force_threshold": [3.5, 10],
        "structure.navigate_by": ["truth", "estimate"],
        "sensing.tilt_noise_deg": [1],
        "robots, structure.movers": [[100, 1], [10_000, 100]],
    }

    assert [[*each.values()] for each in row_labels(sweep).values()] == [
        ["tower", "bridge gap 20 R", "bridge gap 30 R"],
        ["F 3.5", "F 10"],
        ["by truth", "by estimate"],
        [""],
        ["100 robots", "10,000 robots"],
    ]


def test_a_label_changes_no_name_and_no_hash(tmp_path):
    """Folders of cases and of runs stay what they were before a label was given."""
    plain = {"name": "a", "localization": {"method": "joint"}, "structure": {"kind": "tower"}}
    rows = [{"kind": "tower"}, {"kind": "chain"}]
    before = load_scenario(plain | {"sweep": {"structure": rows}})

    after = load_scenario(
        plain | {"sweep": {"structure": [{"label": "high", "kind": "tower"}, rows[1]]}}
    )

    assert [each.label for each in variants(after)] == [each.label for each in variants(before)]
    assert [each.settings for each in variants(after)] == [
        each.settings for each in variants(before)
    ]
    assert scenario_hash(after) == scenario_hash(before)
    assert row_labels(after.sweep)["structure"] == {
        "{kind: tower}": "high",
        "{kind: chain}": "chain",
    }


@pytest.mark.parametrize(
    ("labels", "problem"),
    [
        (("high", "high"), "two rows have the label high; give each its own"),
        ((3, "b"), "label 3: give a text of 1 to 60 letters"),
    ],
)
def test_labels_that_name_nothing_are_refused(labels, problem):
    """Two points of one name could not be told apart on a page."""
    rows = [
        {"label": label, "kind": kind}
        for label, kind in zip(labels, ("tower", "chain"), strict=True)
    ]

    with pytest.raises(InputError, match=problem):
        load_scenario(
            {
                "name": "a",
                "localization": {"method": "joint"},
                "structure": {"kind": "tower"},
                "sweep": {"structure": rows},
            }
        )


def test_symbols_and_units_are_those_of_the_schema():
    """Pages know them without the rooms that define the settings."""
    symbols, lengths = {}, set()
    for section in scenario_schema()["$defs"].values():
        for name, key in section.get("properties", {}).items():
            types = {form.get("type") for form in key.get("anyOf", [key])}
            if types & {"number", "integer"} and "array" not in types:
                meaning = key.get("description", "")
                lengths |= {name} if "[R]" in meaning else set()
                symbols |= {name: meaning[0]} if re.match("[A-Z]: ", meaning) else {}
                assert ("[deg]" in meaning) <= name.endswith("_deg")

    assert (symbols, lengths) == (SYMBOLS | {"iterations": "T"}, LENGTHS)
    assert {*SELECTORS} == {*DISCRIMINATORS.values()}


@pytest.mark.parametrize("path", SCENARIOS, ids=[path.stem for path in SCENARIOS])
def test_labels_of_shipped_scenarios_have_no_comma(path: Path):
    """Names of series are cells of tables, options of commands and parts of sentences."""
    scenario = load_scenario(path)
    points = [label for rows in row_labels(scenario.sweep).values() for label in rows.values()]
    conditions = [str(entries.get("label", "")) for entries in scenario.conditions.values()]

    assert [label for label in points + conditions if ", " in label] == []


@pytest.mark.parametrize("path", SCENARIOS, ids=[path.stem for path in SCENARIOS])
def test_points_of_shipped_scenarios_have_short_labels(path: Path):
    """They are titles of panels and rows of tables."""
    labels = [
        label for rows in row_labels(load_scenario(path).sweep).values() for label in rows.values()
    ]

    assert all(len(label) <= 24 for label in labels)
