"""Scenarios load with defaults, or are refused with file, line, key and a way out."""

import re
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiswarm.base.errors import InputError
from tiswarm.cli import main
from tiswarm.localization.settings import Cues, VirtualForceParams
from tiswarm.scenario import expansion
from tiswarm.scenario.expansion import find_mistakes, load_scenario, variants
from tiswarm.scenario.validation import localization_params
from tiswarm.sensing import SensingParams

ALGORITHM_1 = "{method: virtual-force}"
SMALL = "name: tower\nstructure: {kind: tower}\n"
FULL = """\
name: tower
description: towers, without noise
precision: f64
seeds: [3, 1]
structure:
  kind: tower
  goal_height: 30
  climb: {patience: 3}
sensing:
  tilt_noise_deg: 1e-1
localization: {method: virtual-force, z_correction: true}
conditions:
  baseline: {}
  no-z: {localization.z_correction: false}
sweep:
  robots: [10, 20]
"""


@pytest.fixture
def scenario(tmp_path):
    """Write a scenario, by Algorithm 1 unless it says otherwise, and return its path."""
    path = tmp_path / "scenario.yaml"

    def write(text):
        is_whole = re.search("^localization:", text, re.MULTILINE) or not re.match(r"\w+:", text)
        path.write_text(text if is_whole else f"{text}\nlocalization: {ALGORITHM_1}\n")
        return path

    return write


@pytest.mark.parametrize(
    ("key", "section"),
    [
        ("structure.kind", {"structure": {"kind": "own"}}),
        ("structure.rule", {"structure": {"kind": "tower", "rule": "own"}}),
        ("structure.rule.name", {"structure": {"kind": "tower", "rule": {"name": "own"}}}),
        ("structure.terrain[0].kind", {"structure": {"kind": "tower", "terrain": {"kind": "own"}}}),
        (
            "structure.strength.law",
            {"structure": {"kind": "tower", "strength": {"law": "own", "limit": 1.0}}},
        ),
        ("localization.method", {"localization": {"method": "own"}}),
        ("localization.channel", {"localization": {"method": "distributed", "channel": "own"}}),
        ("localization.force", {"localization": {"method": "relax", "force": "own"}}),
        ("localization.integrator", {"localization": {"method": "relax", "integrator": "own"}}),
        ("sensing.suite", {"sensing": {"suite": "own"}}),
    ],
)
def test_each_name_that_a_plug_in_may_add_says_how_to_load_it(key, section):
    """An unknown one may be that of a plug-in that the user forgot to name."""
    usual = {"name": "x", "structure": {"kind": "tower"}, "localization": {"method": "joint"}}

    mistakes = find_mistakes(usual | section)

    [line] = [str(mistake) for mistake in mistakes if mistake.key == key]
    assert line.endswith(", or one of a plug-in that you load (--plugin FILE)")


TWO_BODIES = """\
name: ground
structure:
  kind: tower
  terrain: [{kind: plane}, {kind: sphere, position: [0, 0, -40], radius: 60}]
"""


@pytest.mark.parametrize(
    ("setting", "problem"),
    [
        ("structure.terrain[1].radius=9", "terrain[1] is an entry of a list"),
        ("structure.terrain[7].radius=9", "terrain[7] is an entry of a list"),
        ("structure.terrain[1]={kind: plane}", "terrain[1] is an entry of a list"),
        ("structure.terrain.radius=9", "terrain is a list"),
        ("structure.terrain.0.radius=9", "terrain is a list"),
        ("sweep={'structure.terrain[1].radius': [9, 8]}", "terrain[1] is an entry of a list"),
        ("sweep.structure.terrain.radius=[9, 8]", "terrain is a list"),
    ],
)
def test_a_list_is_set_as_a_whole(scenario, setting, problem):
    """The path that errors print of an entry is no key; the line says what to set."""
    with pytest.raises(InputError) as caught:
        load_scenario(scenario(TWO_BODIES), [setting])

    assert f"structure.{problem}; set structure.terrain as a whole" in str(caught.value)


def test_name_kind_and_method_are_enough(scenario):
    """Everything else has a default."""
    small = load_scenario(scenario(f"{SMALL}localization: {ALGORITHM_1}\n"))

    assert small.robots == 100
    assert small.seed_list == (0,)
    assert small.conditions == {"baseline": {}}
    assert small.localization == VirtualForceParams()


@pytest.mark.parametrize(
    ("text", "line"), [("", 1), ("localization: {}\n", 3), ("localization:\n  seed: 1\n", 3)]
)
def test_a_scenario_names_its_method(tmp_path, text, line):
    """No default decides what a study is of; the message shows what to write."""
    path = tmp_path / "scenario.yaml"
    path.write_text(SMALL + text)

    with pytest.raises(InputError) as refusal:
        load_scenario(path)

    assert str(refusal.value) == (
        f"{path}:{line}: localization.method: is missing; write it like localization: "
        "{method: joint}, one of distributed, hop-by-hop, joint, least-squares, none, online, "
        "relax, virtual-force"
    )


@pytest.mark.parametrize("text", ["", "structure: {goal_height: 9.0}\n"])
def test_a_scenario_names_its_kind_of_structure(tmp_path, text):
    """A first file of one's own has not all that it needs; the message shows what to write."""
    path = tmp_path / "scenario.yaml"
    path.write_text(f"name: mine\n{text}localization: {{method: joint}}\n")

    with pytest.raises(InputError) as refusal:
        load_scenario(path)

    assert str(refusal.value).endswith(
        ": structure.kind: is missing; write it like structure: {kind: tower}, one of bridge, "
        "cantilever, chain, tower"
    )


def test_what_is_written_is_what_is_loaded(scenario):
    """Values end up where they belong, whole numbers as floats where floats are wanted."""
    full = load_scenario(scenario(FULL))

    assert full.seed_list == (3, 1)
    assert full.structure.goal_height == 30.0
    assert isinstance(full.structure.goal_height, float)
    assert full.structure.climb.patience == 3
    assert full.sensing == SensingParams(tilt_noise_deg=0.1)
    assert full.sweep == {"robots": (10, 20)}


METHOD = "localization.method"
HUNDRED = list(range(2, 103))
REFUSED = [
    ("robots: 5\nstructure: {kind: tower}", 1, "name", "is missing; add it"),
    ("name: tower", 1, "structure.kind", "is missing; write it like structure: {kind: tower}"),
    (
        "name: tower\nstructure: {}",
        2,
        "structure.kind",
        "is missing; write it like structure: {kind: tower}",
    ),
    ("name: a/b\nstructure: {kind: tower}", 1, "name", "'a/b' cannot name a folder; use letters"),
    ("name: ..\nstructure: {kind: tower}", 1, "name", "'..' cannot name a folder; use letters"),
    ("name: 3\nstructure: {kind: tower}", 1, "name", "3 should be text"),
    ("name: x\nstructure: {kind: towr}", 2, "structure.kind", '"towr" should be one of'),
    ("name: x\nstructure: tower", 2, "structure", '"tower" should be keys with values'),
    (f"{SMALL}robot: 20", 3, "robot", "20 should be keys with values; did you mean robots?"),
    (f"{SMALL}robot: {{shape: cube}}", 3, "robot.rho", "at 1.506 the docks of a cube overlap; use"),
    (f"{SMALL}robot:\n  shape: cub", 4, "robot.shape", "\"cub\" should be 'line', 'triangle'"),
    (f"{SMALL}robot:\n  rho: 1.1", 4, "robot.rho", "docks of a triangle overlap; use 1.1548 or"),
    (f"{SMALL}robot:\n  docks: [[2, 0, 0]]", 4, "robot.docks", "has 2 to 8 docks, not 1"),
    (f"{SMALL}robot:\n  docks: {9 * [[2, 0, 0]]}", 4, "robot.docks", "2 to 8 docks, not 9"),
    (
        f"{SMALL}robot:\n  docks:\n    - [2, 0, 0]\n    - [1, 0]",
        6,
        "robot.docks[1][2]",
        "is missing; add it",
    ),
    (
        f"{SMALL}robot:\n  docks: [[2, 0, 0], [0, 0, 11]]",
        4,
        "robot.docks[1][2]",
        "11 should be less than or equal to 10",
    ),
    (
        f"{SMALL}robot:\n  docks: [[2, 0, 0], [0, 9, 9]]",
        4,
        "robot.docks",
        "dock 1 is 12.73 R from the center; place it 0.1 to 10 R away",
    ),
    (
        f"{SMALL}robot:\n  docks: [[2, 0, 0], [2, 1, 0]]",
        4,
        "robot.docks",
        "docks 0 and 1 are 1 R apart and overlap; place them 2 R apart or more",
    ),
    (
        f"{SMALL}robot:\n  rho: 2\n  docks: [[2, 0, 0], [-2, 0, 0]]",
        5,
        "robot.docks",
        "these docks take the place of shape and rho; remove those",
    ),
    (
        "name: tower\nrobot:\n  shape: tetrahedron\nstructure:\n  kind: tower\n  plane: true",
        4,
        "structure",
        "in a plane robots are flat; use another robot.shape, or plane: false",
    ),
    (f"{SMALL}robts: 20", 3, "robts", "unknown key; did you mean robots?"),
    (f"{SMALL}question: trafic", 3, "question", "did you mean traffic?"),
    (f"{SMALL}color: red", 3, "color", "unknown key; the keys here are name, description, que"),
    (f"{SMALL}robots: 1", 3, "robots", "1 should be greater than or equal to 2"),
    (f"{SMALL}robots: -5", 3, "robots", "-5 should be greater than or equal to 2"),
    (f"{SMALL}robots: 1e20", 3, "robots", "1e+20 should be a whole number"),
    (f"{SMALL}robots: 100.0", 3, "robots", "100.0 should be a whole number"),
    (f"{SMALL}robots: 1_000", 3, "robots", '"1_000" should be a whole number'),
    (f"{SMALL}robots: true", 3, "robots", "true should be a whole number"),
    (f"{SMALL}robots:", 3, "robots", "null should be a whole number"),
    (f"{SMALL}seeds: 0", 3, "seeds", "0 should be greater than or equal to 1"),
    (f"{SMALL}seeds: []", 3, "seeds", "should have at least 1 item, not 0"),
    (f"{SMALL}seeds: [-1]", 3, "seeds[0]", "-1 should be greater than or equal to 0"),
    (f"{SMALL}seeds: [1, -2]", 3, "seeds[1]", "-2 should be greater than or equal to 0"),
    (f"{SMALL}seeds: [1, 2, 1]", 3, "seeds", "1 occurs twice; give each value once"),
    (f"{SMALL}precision: f16", 3, "precision", "\"f16\" should be 'auto', 'f64' or 'f32'"),
    (
        "name: x\nstructure:\n  kind: tower\n  climb:\n    patiense: 3",
        5,
        "structure.climb.patiense",
        "unknown key; did you mean patience?",
    ),
    (
        f"{SMALL}sensing:\n  yaw_noise_deg: 181",
        4,
        "sensing.yaw_noise_deg",
        "should be less than or equal to 180",
    ),
    (
        f"{SMALL}sensing:\n  yaw_noise_deg: .nan",
        4,
        "sensing.yaw_noise_deg",
        "should be a finite number",
    ),
    (
        f"{SMALL}sensing:\n  yaw_noise_deg: 1e999",
        4,
        "sensing.yaw_noise_deg",
        "should be a finite number",
    ),
    (
        f"{SMALL}localization: {{method: virtual-force, z_correction: no}}",
        3,
        "localization.z_correction",
        "should be true or false",
    ),
    (
        f"{SMALL}localization: {{method: magic}}",
        3,
        "localization.method",
        '"magic" should be one of',
    ),
    (f"{SMALL}localization: []", 3, "localization", "[] should be keys with values"),
    (f"{SMALL}conditions: {{}}", 3, "conditions", "should have at least 1 item, not 0"),
    (f"{SMALL}conditions:\n  a b: {{}}", 4, "conditions.a b", "'a b' cannot name a folder; use"),
    (f"{SMALL}conditions:\n  a: 3", 4, "conditions.a", "3 should be keys with values"),
    (
        f"{SMALL}conditions:\n  a: {{}}\n  b:\n    robots: 3",
        6,
        "conditions.b.robots",
        "conditions change localization and sensing only; use sweep for the rest",
    ),
    (
        f"{SMALL}conditions:\n  a: {{}}\n  b:\n    localization.z_corection: false",
        6,
        "conditions.b.localization.z_corection",
        "unknown key; did you mean z_correction?",
    ),
    (
        f"{SMALL}conditions:\n  a: {{}}\n  b:\n    localization.z_correction: 1",
        6,
        "conditions.b.localization.z_correction",
        "1 should be true or false",
    ),
    (
        f"{SMALL}conditions:\n  a:\n    sensing.tilt_noise_deg.x: 1",
        5,
        "conditions.a.sensing.tilt_noise_deg.x",
        "sensing.tilt_noise_deg is a single value, not a section; correct the key",
    ),
    (f"{SMALL}sweep:\n  robots: 10", 4, "sweep.robots", "10 should be a list"),
    (f"{SMALL}sweep:\n  robots: []", 4, "sweep.robots", "should have at least 1 item, not 0"),
    (f"{SMALL}sweep:\n  robots: [3, 3]", 4, "sweep.robots", "3 occurs twice; give each value once"),
    (
        f"{SMALL}sweep:\n  robots:\n    - 3\n    - 1",
        6,
        "sweep.robots[1]",
        "1 should be greater",
    ),
    (
        f"{SMALL}conditions: {{a: {{localization.method: x}}}}\nsweep: {{localization: [3]}}",
        3,
        "conditions.a.localization.method",
        "localization is a single value, not a section; correct the key",
    ),
    (
        f"{SMALL}sweep: {{localization: [{{method: []}}]}}\nconditions: {{a: {{{METHOD}: [1]}}}}",
        4,
        "conditions.a.localization.method",
        "\"[1]\" should be one of 'virtual-force'",
    ),
    (f"{SMALL}localization: {{method: 'a\n\n  b'}}", 3, "localization.method", '"a\\nb" should'),
    (f"{SMALL}sweep:\n  question: [cues]", 4, "sweep.question", "cannot be swept; sweep robots, "),
    (f"{SMALL}sweep:\n  robot.rh: [1]", 4, "sweep.robot.rh", "unknown key; did you mean rho?"),
    (
        f"{SMALL}sweep:\n  structure:\n    - {{kind: tower}}\n    - kind: tower\n      climb: 3",
        7,
        "sweep.structure[1].climb",
        "3 should be keys with values",
    ),
    (
        f"{SMALL}sweep:\n  robots: {HUNDRED}\n  robot.rho: {HUNDRED}",
        3,
        "sweep",
        "makes 10201 cases; 10000 is the most: give fewer values",
    ),
    ("- name: tower", 1, "", "a scenario is a mapping of keys to values; start it with `name:`"),
    ("just words", 1, "", "a scenario is a mapping of keys to values; start it with `name:`"),
]


@pytest.mark.parametrize(("text", "line", "key", "problem"), REFUSED)
def test_a_mistake_is_reported_with_its_place_and_remedy(scenario, text, line, key, problem):
    """The message reads `file:line: key: what is wrong; what to do`, and there is one of it."""
    path = scenario(text)

    with pytest.raises(InputError) as refusal:
        load_scenario(path)

    assert str(refusal.value).startswith(": ".join(filter(None, [f"{path}:{line}", key, ""])))
    assert problem in str(refusal.value)
    assert "more mistake" not in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_table_is_no_scenario(tmp_path):
    """Poses are imported; the line says so."""
    (tmp_path / "poses.csv").write_text("robot,x,y,z\n0,0,0,0\n")

    with pytest.raises(InputError, match=r"poses.csv:1: .* or give a table to tiswarm import"):
        load_scenario(tmp_path / "poses.csv")


def test_all_mistakes_are_found_at_once(scenario):
    """They come in file order; loading names a wrong key first, and the number of the others."""
    path = scenario(
        "name: tower\nrobots: 1\nstructure: {kind: tower, goal: 3}\nsensing: {tilt_noise_deg: -1}\n"
        "conditions:\n  bad: {localization.iterations: 0}\nsweep: {precision: [f64, f8]}\n"
    )

    mistakes = find_mistakes(path)

    assert [mistake.line for mistake in mistakes] == [2, 3, 4, 6, 7]
    with pytest.raises(
        InputError,
        match=r":3: structure.goal: unk.* \(and 4 more mistakes; check lists all\)$",
    ) as refusal:
        load_scenario(path)
    assert (refusal.value.line, refusal.value.key) == (3, "structure.goal")


def test_options_that_cannot_be_read_hide_no_other_mistake(scenario):
    """Each is named, and an empty value gets no advice on files."""
    path = scenario(f"{SMALL}seeds: 0\n")

    mistakes = find_mistakes(path, ["robots", "robots=", "name.x=1"])

    assert [str(mistake).removeprefix(f"{path}:") for mistake in mistakes] == [
        "3: seeds: 0 should be greater than or equal to 1",
        "overrides: robots: is not KEY=VALUE; write it like robots=20",
        "overrides: robots=: is empty; write a value",
        "overrides: name.x=1: name is a single value, not a section; correct the key",
    ]


def test_a_wrong_key_is_the_first_mistake_of_settings():
    """The value of another key is not what hides it."""
    with pytest.raises(InputError, match=r"steps=x: .* should be") as alone:
        localization_params("joint", ["steps=x"])
    with pytest.raises(InputError, match=r"stepz=3: .* mean steps\? \(and 1 more mistake\)$"):
        localization_params("joint", ["steps=x", "stepz=3"])

    assert "more" not in str(alone.value)


def test_a_bad_item_does_not_make_its_list_too_short(scenario):
    """Its own line is the only one: a list with that item would be long enough."""
    mistakes = find_mistakes(scenario(f"{SMALL}seeds: [-1]\n"))

    assert [mistake.key for mistake in mistakes] == ["seeds[0]"]


def test_of_many_mistakes_twenty_are_listed(scenario, monkeypatch):
    """A file of something else has thousands; each costs time, and nobody reads them."""
    explained = []
    monkeypatch.setattr(
        "tiswarm.scenario.validation.explain", lambda *error: explained.append(error) or "is wrong"
    )
    path = scenario(SMALL + "".join(f"key{number}: 1\n" for number in range(500)))

    mistakes = find_mistakes(path)

    assert [error.line for error in mistakes[:20]] == [*range(3, 23)]
    assert str(mistakes[20]) == (
        f"{path}: has more than 20 mistakes; correct those that are listed first"
    )
    assert len(mistakes) == 21
    assert len(explained) < 50  # checks of parts explain some again


def test_conditions_with_mistakes_are_checked_up_to_the_twentieth(scenario, monkeypatch):
    """Each condition is a whole scenario to check."""
    built = count_scenarios(monkeypatch)
    wrong = "".join(f"  c{number}: {{localization.key{number}: 1}}\n" for number in range(500))

    mistakes = find_mistakes(scenario(f"{SMALL}conditions:\n{wrong}"))

    assert [error.key for error in mistakes[:2]] == [
        "conditions.c0.localization.key0", "conditions.c1.localization.key1"
    ]  # fmt: skip
    assert len(mistakes) == 21
    assert len(built) < 50


def count_scenarios(monkeypatch):
    """Return a list that gets an entry whenever a whole scenario is checked."""
    built = []
    check = expansion.from_plain
    monkeypatch.setattr(
        expansion, "from_plain", lambda data: built.append(data["name"]) or check(data)
    )
    return built


def test_a_mistake_of_all_variants_ends_their_checks(scenario, monkeypatch):
    """One wrong condition makes a mistake at each point of the sweep."""
    built = count_scenarios(monkeypatch)
    points = [*range(5, 3005)]

    mistakes = find_mistakes(
        scenario(f"{SMALL}conditions: {{a: {{localization.key: 1}}}}\nsweep: {{robots: {points}}}")
    )

    assert [error.key for error in mistakes] == ["conditions.a.localization.key"]
    assert len(built) < 1100


@pytest.mark.parametrize("key", ["robots", "structure.goal_height", "localization.iterations"])
def test_a_sweep_checks_only_what_it_changes(scenario, monkeypatch, key):
    """Else checks of thousands of values, all of them right, take seconds."""
    built = count_scenarios(monkeypatch)
    text = f"{SMALL}sweep: {{{key}: {[*range(5, 105)]}}}"

    points = variants(load_scenario(scenario(text)))

    assert len(points) == 100
    assert len(built) < 10


@pytest.mark.parametrize("count", [20, 100])
def test_a_list_of_right_values_may_be_meant_as_a_sweep(scenario, monkeypatch, count):
    """The option says so for any number of values, and checks few of them in the whole scenario."""
    built = count_scenarios(monkeypatch)
    values = [*range(5, 5 + count)]

    (mistake,) = find_mistakes(scenario(SMALL), [f"robots={values}"])

    assert "; to sweep robots, give --set 'sweep={robots: [5, 6, 7" in mistake.problem
    assert len(built) < 70


def test_a_long_list_with_a_wrong_value_is_no_sweep(scenario):
    """Advice that leads to another mistake helps nobody."""
    values = [*range(5, 105), -1]

    (mistake,) = find_mistakes(scenario(SMALL), [f"robots={values}"])

    assert "to sweep" not in mistake.problem


def test_a_misspelled_key_is_the_only_mistake():
    """The key that was meant is not missing, too."""
    data = {"name": "x", "structur": {"kind": "tower"}, "localization": {"method": "joint"}}

    mistakes = find_mistakes(data)

    assert [str(mistake) for mistake in mistakes] == [
        "structur: unknown key; did you mean structure?"
    ]


def test_wrong_keys_come_before_what_is_missing():
    """A reader mends the key, and sees the other mistake still."""
    mistakes = find_mistakes({"nam": "x", "robts": 3, "localization": {"method": "joint"}})

    assert [mistake.key for mistake in mistakes] == ["nam", "robts", "structure.kind"]


def test_two_mistakes_are_one_more(scenario):
    """The count is in good English."""
    path = scenario(f"{SMALL}robots: 1\nseeds: 0\n")

    with pytest.raises(InputError, match=r" \(and 1 more mistake; check lists all\)$"):
        load_scenario(path)


def test_a_sound_scenario_has_no_mistakes(scenario):
    """And a file that is not there has one."""
    path = scenario(FULL)

    assert find_mistakes(path) == []
    assert len(find_mistakes(path.with_name("gone"))) == 1


@pytest.mark.parametrize(
    ("option", "read", "value"),
    [
        ("robots=7", lambda s: s.robots, 7),
        ("robots=1e3", lambda s: s.robots, 1000),
        ("seeds=[2e+1]", lambda s: s.seed_list, (20,)),
        ("structure.goal_height=1e1", lambda s: s.structure.goal_height, 10.0),
        ("structure.climb.patience=9", lambda s: s.structure.climb.patience, 9),
        ("structure.climb.settle=0.3", lambda s: s.structure.climb.settle, 0.3),
        ("seeds=[3,4]", lambda s: s.seed_list, (3, 4)),
        ("description=a = b", lambda s: s.description, "a = b"),
        (
            "localization={method: virtual-force, iterations: 5}",
            lambda s: s.localization.iterations,
            5,
        ),
        ("sensing.yaw_noise_deg=2", lambda s: s.sensing.yaw_noise_deg, 2.0),
        ("sweep={}", lambda s: s.sweep, {}),
        ("sweep.structure.goal_height=[5]", lambda s: s.sweep["structure.goal_height"], (5,)),
        (
            "conditions.no-z.sensing.yaw_noise_deg=5",
            lambda s: s.conditions["no-z"],
            {"localization.z_correction": False, "sensing.yaw_noise_deg": 5},
        ),
        ("conditions.v1.2={}", lambda s: s.conditions["v1.2"], {}),
    ],
)
def test_an_option_overrides_the_file(scenario, option, read, value):
    """A dotted key reaches any value; the text after the first `=` is YAML."""
    assert read(load_scenario(scenario(FULL), [option])) == value


def test_the_last_option_wins(scenario):
    """Options apply in order."""
    assert load_scenario(scenario(FULL), ["robots=7", "robots=8"]).robots == 8


@pytest.mark.parametrize(
    ("option", "problem"),
    [
        ("robots", "is not KEY=VALUE; write it like robots=20"),
        ("=3", "is not KEY=VALUE; write it like robots=20"),
        ("robots=", "is empty; write a value"),
        ("robots=many", '"many" should be a whole number'),
        ("robots=[", "not YAML: "),
        ("robts=20", "unknown key; did you mean robots?"),
        ("structure.goal_heigth=30", "unknown key; did you mean goal_height?"),
        ("structure.kind=towr", "\"towr\" should be one of 'tower'"),
        ("precision.x=3", "precision is a single value, not a section; correct the key"),
        ("seeds=[1, x]", '"x" should be a whole number'),
        ("sweep.robots=[1]", "1 should be greater than or equal to 2"),
        ("conditions.no-z.localization.iterations=0", "0 should be greater than or equal to 1"),
        ("conditions={a: {robots: 3}}", "a.robots: conditions change localization and sensing on"),
        ("structure.departures={kind: leave}", "rate: is missing; add it"),
        ("localization={chains: 3}", "method: is missing; write it like"),
    ],
)
def test_a_wrong_option_is_named_instead_of_a_line(scenario, option, problem):
    """The message reads `overrides: KEY=VALUE: what is wrong; what to do`."""
    with pytest.raises(InputError) as refusal:
        load_scenario(scenario(FULL), ["seeds=2", option])

    assert str(refusal.value).startswith(f"overrides: {option}: {problem}")
    assert refusal.value.line is None


def test_an_option_replaces_the_sweep_of_its_key(scenario):
    """Also where a whole section sets it; all other sweeps stay."""
    path = scenario(f"{SMALL}sweep: {{robots: [30, 40], structure.goal_height: [5, 6]}}")

    one = load_scenario(path, ["robots=20"])
    both = load_scenario(path, ["robots=20", "structure={kind: tower, goal_height: 7}"])

    assert (one.robots, one.sweep) == (20, {"structure.goal_height": (5, 6)})
    assert (both.structure.goal_height, both.sweep) == (7.0, {})


@pytest.mark.parametrize(
    ("section", "option"),
    [
        ("sweep: {'robots, structure.movers': [[30, 1], [40, 2]]}", "robots=20"),
        ("sweep: {'robots, structure.movers': [[30, 1], [40, 2]]}", "structure.movers=3"),
    ],
)
def test_an_option_without_effect_is_refused(scenario, section, option):
    """A sweep of several keys keeps its rows."""
    key = option.partition("=")[0]

    with pytest.raises(InputError) as refusal:
        load_scenario(scenario(SMALL.replace("robots: 8\n", "") + section), [option])

    problem = f"has no effect, as sweep sets {key}; leave out or set sweep={{{key}: [...]}}"
    assert str(refusal.value) == f"overrides: {option}: {problem}"


def test_conditions_keep_what_they_set(scenario):
    """An option changes those that leave its key alone, and may repeat a condition."""
    text = f"{SMALL}conditions: {{a: {{}}, b: {{localization.iterations: 6}}}}"

    both = load_scenario(scenario(text), ["localization.iterations=7"])
    same = load_scenario(scenario(text.replace("a: {}, ", "")), ["localization.iterations=6"])

    iterations = [variant.settings.localization.iterations for variant in variants(both)]
    assert iterations == [7, 6]
    assert same.localization.iterations == 6


@pytest.mark.parametrize(
    ("option", "text", "problem"),
    [
        (
            "localization.method=joint",
            f"{SMALL}conditions: {{no-z: {{localization.z_correction: false}}}}",
            ":3: conditions.no-z.localization.z_correction: unknown key of joint; leave it out",
        ),
        (
            "structure={kind: chain}",
            f"{SMALL}sweep: {{structure.goal_height: [1, 2], robots: [5, 6]}}",
            ":3: sweep.structure.goal_height: unknown key of chain; leave it out",
        ),
    ],
)
def test_another_method_or_kind_names_the_keys_it_lacks(scenario, option, text, problem):
    """The message names the line that sets such a key, and what has it."""
    path = scenario(text)

    with pytest.raises(InputError) as refusal:
        load_scenario(path, [option])

    assert str(refusal.value).startswith(f"{path}{problem}")


JOINT = "name: own\nstructure: {kind: tower}\nlocalization:\n  method: joint\n"


@pytest.mark.parametrize(
    ("text", "options", "where"),
    [
        (f"{JOINT}  walk_contacts: false", [], ":5: localization.walk_contacts"),
        (
            f"{JOINT}conditions:\n  a: {{localization.walk_contacts: false}}",
            [],
            ":6: conditions.a.localization.walk_contacts",
        ),
        (
            f"{JOINT}sweep:\n  localization.walk_contacts: [false]",
            [],
            ":6: sweep.localization.walk_contacts",
        ),
        (
            JOINT,
            ["localization.walk_contacts=false"],
            "overrides: localization.walk_contacts=false",
        ),
    ],
    ids=["section", "condition", "sweep", "option"],
)
def test_a_switch_of_an_earlier_version_names_the_key_to_write(scenario, text, options, where):
    """Cues were keys of each method; they are a section of their own."""
    path = scenario(text)

    with pytest.raises(InputError) as refusal:
        load_scenario(path, options)

    problem = "the key is now localization.cues.walk_contacts; write localization.cues."
    message = str(refusal.value).removeprefix(str(path))
    assert message.startswith(f"{where}: {problem}walk_contacts: false")
    assert "\n" not in message


@pytest.mark.parametrize(
    ("text", "options"),
    [
        (f"{JOINT}  cues: {{walk_contacts: false}}", []),
        (f"{JOINT}conditions:\n  a: {{localization.cues.walk_contacts: false}}", []),
        (f"{JOINT}sweep:\n  localization.cues.walk_contacts: [false]", []),
        (JOINT, ["localization.cues.walk_contacts=false"]),
    ],
    ids=["section", "condition", "sweep", "option"],
)
def test_a_cue_is_switched_off_wherever_settings_are_set(scenario, text, options):
    """Section, condition, sweep and option: the cue is off, and all others stay on."""
    [variant] = variants(load_scenario(scenario(text), options))

    assert variant.settings.localization.cues == Cues(walk_contacts=False)


def test_a_method_without_a_cue_names_those_that_have_it(scenario):
    """Hop-by-hop finds no docks, and Algorithm 1 has settings of its own for what it uses."""
    text = "name: own\nstructure: {kind: tower}\nlocalization:\n  method: "
    touches = scenario(f"{text}hop-by-hop\n  cues: {{touches: true}}")
    [of_docks] = find_mistakes(touches)
    of_published = find_mistakes(scenario(f"{text}virtual-force\n  cues: {{height: false}}"))[0]

    assert ":5: localization.cues.touches: true should be false with hop-by-hop; " in str(of_docks)
    assert str(of_docks).endswith("or choose method joint or least-squares")
    assert ":5: localization.cues: unknown key of virtual-force; " in str(of_published)


def test_a_method_is_set_up_without_a_file():
    """Options name the method's own settings."""
    params = localization_params("virtual-force", ["iterations=7", "z_correction=false"])

    assert params == VirtualForceParams(iterations=7, z_correction=False)


@pytest.mark.parametrize(
    ("method", "option", "problem"),
    [
        ("magic", "iterations=7", "method: \"magic\" should be one of 'virtual-force'"),
        ("virtual-force", "iterations=0", "overrides: iterations=0: 0 should be greater"),
        (
            "virtual-force",
            "back_propagation={evry: 5}",
            "overrides: back_propagation={evry: 5}: evry: unk",
        ),
        (
            "virtual-force",
            "iteration=5",
            "overrides: iteration=5: unknown key; did you mean iterat",
        ),
        (
            "virtual-force",
            "max.step=5",
            "overrides: max.step=5: unknown key; the keys here are method,",
        ),
        (
            "virtual-force",
            "method.x=5",
            "overrides: method.x=5: localization.method is a single val",
        ),
    ],
)
def test_a_method_that_cannot_be_set_up_is_reported(method, option, problem):
    """The message names the option at fault."""
    with pytest.raises(InputError) as refusal:
        localization_params(method, [option])

    assert str(refusal.value).startswith(problem)


def test_an_option_repairs_the_file(scenario):
    """A mistake that is overridden is none."""
    path = scenario(f"{SMALL}robots: 1\n")

    assert load_scenario(path, ["robots=2"]).robots == 2


def test_mistakes_in_options_come_after_those_in_the_file(scenario):
    """The file is read first."""
    mistakes = find_mistakes(scenario(f"{SMALL}seeds: 0\n"), ["robots=1"])

    assert [mistake.key for mistake in mistakes] == ["seeds", "robots=1"]
    assert [mistake.argument for mistake in mistakes] == ["", "overrides"]


new_bytes = st.binary(min_size=1, max_size=3) | st.sampled_from(
    [b"&a ", b"*a", b"!!int ", b"\t", b"[", b"{", b"- ", b": ", b"\n", b"'", b"0x", b"? ", b"---\n"]
)


@settings(max_examples=400)
@given(
    edits=st.lists(
        st.tuples(st.sampled_from("dif"), st.integers(0, 500), new_bytes), min_size=1, max_size=4
    )
)
def test_a_damaged_file_is_loaded_or_refused(scratch, edits):
    """Bytes deleted, inserted or flipped end in a scenario or an InputError, never otherwise."""
    data = bytearray(FULL.encode())
    for kind, position, new in edits:
        at = position % len(data)
        data[at : at + (0 if kind == "i" else len(new))] = b"" if kind == "d" else new
    scratch.write_bytes(data)

    mistakes = find_mistakes(scratch)

    assert all(str(mistake).startswith(f"{scratch}:") for mistake in mistakes)
    if not mistakes:
        assert load_scenario(scratch).seed_list


@pytest.mark.parametrize(
    ("text", "line", "key"),
    [
        (f"{SMALL}robots: 50\nsweep: {{robots: [10, 20]}}", 3, "robots"),
        (f"{SMALL}precision: f32\nsweep:\n  precision, robots: [[f64, 5]]", 3, "precision"),
        (
            "name: x\nsweep: {structure.rest: [5]}\nstructure: {kind: tower, rest: 30}".replace(
                "rest", "goal_height"
            ),
            3,
            "structure.goal_height",
        ),
    ],
)
def test_a_value_that_the_sweep_replaces_is_refused(scenario, text, line, key):
    """Whoever wrote it expects it to matter; the same option is refused, too."""
    path = scenario(text)

    with pytest.raises(InputError) as refusal:
        load_scenario(path)

    assert str(refusal.value) == (
        f"{path}:{line}: {key}: has no effect, as sweep sets {key}; leave out or set "
        f"sweep={{{key}: [...]}}"
    )
    assert load_scenario(path, ["sweep={}"]).sweep == {}


def test_a_long_name_makes_a_short_error(tmp_path, monkeypatch, capsys):
    """The line names the trouble, whoever found it: a library, the system or tiswarm."""
    for name in ("x" * 5000, "x" * 5000 + ".yaml", "--" + "y" * 5000):
        monkeypatch.setattr(sys, "argv", ["tiswarm", "run", name])

        with pytest.raises(SystemExit):
            main()

        line, empty = capsys.readouterr().err.split("\n")
        assert len(line) <= 1000 + len("tiswarm: error: ")
        assert not empty
