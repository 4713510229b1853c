"""A scenario survives its file; its hash stands for what it says, not how."""

import re
from dataclasses import replace

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.structures import SUITES
from tiswarm.base.errors import InputError
from tiswarm.base.robot import SHAPES, RobotGeometry
from tiswarm.localization.settings import VirtualForceParams
from tiswarm.scenario.expansion import load_scenario, variants
from tiswarm.scenario.model import Scenario, dump_scenario, scenario_hash, scenario_schema
from tiswarm.sensing import SensingParams
from tiswarm.world.params import ClimbParams, TowerParams

CORNERS = [(x, y, z) for x in (-1.5, 4.0) for y in (-1.0, 3.5) for z in (-1.25, 2.0)]
slugs = st.from_regex(r"[A-Za-z0-9_]([A-Za-z0-9._-]{0,20}[A-Za-z0-9_-])?", fullmatch=True)
slugs |= st.sampled_from(["1e3", "0x1", "0o7", "no", "null", "010", "1.5", "true", "_", "1_0"])
texts = st.text(st.characters(codec="utf-8"), max_size=40)
texts |= st.sampled_from(["1e-3", "0o17", ".inf", "~", "", "on", "=", "a: b", " x", "x\n", "\x85"])
positive = st.floats(1e-300, 1e300)
angles = st.just(0.0) | st.floats(1e-9, 90.0)
conditions = st.fixed_dictionaries(
    {},
    optional={
        "localization.z_correction": st.booleans(),
        "localization.attraction_gain": positive | st.integers(0, 10**20),
        "localization.initial_offset_axis": st.sampled_from(["world", "body"]),
        "sensing.yaw_noise_deg": angles,
    },
)
sweeps = st.fixed_dictionaries(
    {},
    optional={
        "robots": st.lists(st.integers(2, 999), min_size=1, max_size=2, unique=True).map(tuple),
        "precision": st.just(("f64", "f32")),
        "structure": st.just(({"kind": "tower"}, {"kind": "tower", "climb": {"patience": 1}})),
    },
)
DEFAULTS = {"robots": 100, "precision": "auto"}
"""Values that a sweep may replace: others would have no effect, and are refused."""

robots = st.builds(RobotGeometry, rho=st.floats(1.2, 10.0))
robots |= st.builds(RobotGeometry, shape=st.sampled_from([*SHAPES]), rho=st.floats(1.8, 10.0))
robots |= st.builds(
    RobotGeometry,
    docks=st.lists(st.sampled_from(CORNERS), min_size=2, max_size=8, unique=True).map(tuple),
)
scenarios = st.builds(
    Scenario,
    name=slugs,
    description=texts,
    robots=st.integers(2, 10**6),
    seeds=st.integers(1, 99)
    | st.lists(st.integers(0, 2**63 - 1), min_size=1, max_size=4, unique=True).map(tuple),
    precision=st.sampled_from(["f64", "f32"]),
    robot=robots,
    structure=st.builds(
        TowerParams,
        goal_height=positive,
        climb=st.builds(ClimbParams, max_flips=st.integers(1, 10**25)),
    ),
    sensing=st.builds(SensingParams, suite=st.sampled_from(sorted(SUITES)), tilt_noise_deg=angles),
    localization=st.builds(VirtualForceParams, initial_offset=positive, z_correction=st.booleans()),
    conditions=st.dictionaries(slugs.map(str.lower), conditions, min_size=1, max_size=3),
    sweep=sweeps,
).map(lambda made: replace(made, **{key: DEFAULTS[key] for key in DEFAULTS if key in made.sweep}))


@settings(max_examples=30)
@given(scenario=scenarios)
def test_a_scenario_loads_back_from_its_text(scratch, scenario):
    """Whatever it says, its YAML says too, written the same way each time."""
    text = dump_scenario(scenario)
    scratch.write_bytes(text.encode())

    back = load_scenario(scratch)

    assert back == scenario
    assert dump_scenario(back) == text
    assert scenario_hash(back) == scenario_hash(scenario)
    assert variants(back) == variants(scenario)


def test_the_text_is_plain_yaml_with_every_default():
    """Other readers understand it too; equal values are written out, not referred to.

    Keys of the command line that a scenario may have, too, stand there if they are set.
    """
    shared = {"localization.iterations": 5}
    text = dump_scenario(
        Scenario(
            name="x",
            structure=TowerParams(),
            localization=VirtualForceParams(),
            conditions={"a": shared, "b": shared},
        )
    )

    data = yaml.safe_load(text)

    keys = list(scenario_schema()["properties"])
    assert list(data) == [key for key in keys if key not in {"arch", "threads", "workers"}]
    assert data["structure"]["climb"]["patience"] == 3
    assert data["conditions"] == {"a": shared, "b": shared}
    assert "&" not in text


def test_the_hash_ignores_how_a_scenario_is_written(tmp_path):
    """Order, comments, description and defaults written out make no difference."""
    path = tmp_path / "scenario.yaml"
    path.write_text(
        "name: x\nstructure: {kind: tower, goal_height: 65}\nrobots: 30\n"
        "localization: {method: joint}\n"
    )
    one = load_scenario(path)
    path.write_text(
        "# a comment\nrobots: 30\nstructure:\n  goal_height: 65.0\n  kind: tower\n"
        "localization:\n  method: joint\nname: x\ndescription: other words\nsensing: {}\n"
    )

    other = load_scenario(path)

    assert re.fullmatch("[0-9a-f]{8}", scenario_hash(one))
    assert scenario_hash(one) == scenario_hash(other)


@pytest.mark.parametrize("option", ["robots=31", "name=y", "seeds=2", "structure.climb.patience=1"])
def test_different_scenarios_have_different_hashes(tmp_path, option):
    """Whatever changes the study changes its hash."""
    path = tmp_path / "scenario.yaml"
    path.write_text(
        "name: x\nstructure: {kind: tower}\nrobots: 30\nlocalization: {method: joint}\n"
    )

    assert scenario_hash(load_scenario(path)) != scenario_hash(load_scenario(path, [option]))


def _fields(section):
    yield from section.get("properties", {}).values()
    for definition in section.get("$defs", {}).values():
        yield from _fields(definition)


def test_the_schema_describes_every_key():
    """An editor can show what each key means."""
    schema = scenario_schema()

    assert "2020-12" in schema["$schema"]
    assert all(field.get("description") for field in _fields(schema))
    assert set(schema["required"]) == {"name", "localization"}  # the engine has no structure


def test_a_question_changes_neither_hash_nor_settings(tmp_path):
    """A run that is asked another question keeps its folder and its cases."""
    path = tmp_path / "asking.yaml"
    path.write_text("name: a\nstructure: {kind: tower}\nlocalization: {method: joint}\n")

    asking = load_scenario(path, ["question=traffic"])

    assert asking.question == "traffic"
    assert load_scenario(path).question == "least-error"
    assert scenario_hash(asking) == scenario_hash(load_scenario(path))


def test_a_label_changes_neither_hash_nor_settings(tmp_path):
    """A run keeps its folder and its cases when a condition is named better for readers."""
    path = tmp_path / "labeled.yaml"
    path.write_text(
        "name: a\nstructure: {kind: tower}\nlocalization: {method: virtual-force}\n"
        "conditions: {plain: {}, no-z: {localization.z_correction: false}}\n"
    )
    labeled = load_scenario(path, ["conditions.no-z.label=Without heights"])

    assert labeled.conditions["no-z"]["label"] == "Without heights"
    assert scenario_hash(labeled) == scenario_hash(load_scenario(path))
    assert [v.settings for v in variants(labeled)] == [
        v.settings for v in variants(load_scenario(path))
    ]


@pytest.mark.parametrize(
    ("label", "problem"),
    [
        ("[1]", "label .1.: give a text of 1 to 60 letters"),
        ("''", "label '': give a text"),
        ("plain", "two conditions have the label plain; give each its own"),
    ],
)
def test_labels_are_texts_that_differ(tmp_path, label, problem):
    """Lines of a figure that share a name cannot be told apart."""
    path = tmp_path / "labeled.yaml"
    path.write_text(
        "name: a\nstructure: {kind: tower}\nlocalization: {method: virtual-force}\n"
        f"conditions:\n  plain: {{}}\n  no-z: {{label: {label}}}\n"
    )

    with pytest.raises(InputError, match=rf"labeled\.yaml:4: conditions: {problem}"):
        load_scenario(path)
