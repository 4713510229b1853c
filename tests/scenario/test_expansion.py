"""Every point of the sweep under every condition, by a name fit for a folder."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest
from pydantic.dataclasses import dataclass

from tests.runs import REPOSITORY
from tiswarm.base import plugins, registry
from tiswarm.base.errors import InputError
from tiswarm.base.params import STRICT
from tiswarm.localization.settings import JointParams, MethodParams, VirtualForceParams
from tiswarm.records.run_folder import MAX_VARIANT_NAME
from tiswarm.scenario.expansion import find_mistakes, load_scenario, plan, variants
from tiswarm.scenario.model import Scenario, dump_scenario, from_plain, to_plain
from tiswarm.scenario.yaml_source import shipped_scenarios
from tiswarm.world.params import TowerParams


def scenario(**settings):
    """Make a scenario in Python rather than from a file."""
    method = {"localization": VirtualForceParams()}
    return Scenario(name="tower", structure=TowerParams(), **method | settings)


def labels(**settings):
    """Names of all cases of a scenario."""
    return [variant.label for variant in variants(scenario(**settings))]


def test_without_conditions_and_sweep_there_is_one_case():
    """It is the scenario itself, called baseline."""
    plain = scenario(robots=7)

    (only,) = variants(plain)

    assert only.label == only.condition == "baseline"
    assert only.settings == plain


def test_conditions_run_at_every_point_of_the_sweep():
    """The last swept key turns fastest, and conditions faster still."""
    names = labels(
        sweep={"robots": (10, 20), "structure.goal_height": (5, 6.5)},
        conditions={"baseline": {}, "no-z": {"localization.z_correction": False}},
    )

    assert names == [
        "robots=10,structure.goal_height=5,baseline",
        "robots=10,structure.goal_height=5,no-z",
        "robots=10,structure.goal_height=6.5,baseline",
        "robots=10,structure.goal_height=6.5,no-z",
        "robots=20,structure.goal_height=5,baseline",
        "robots=20,structure.goal_height=5,no-z",
        "robots=20,structure.goal_height=6.5,baseline",
        "robots=20,structure.goal_height=6.5,no-z",
    ]


@pytest.mark.parametrize("name", shipped_scenarios())
def test_variants_are_as_if_checked_as_a_whole(name):
    """Only sections that a variant changes are checked anew, which must make no difference."""
    for variant in variants(load_scenario(Path(name))):
        assert from_plain(to_plain(variant.settings)) == variant.settings


@pytest.mark.parametrize(
    "sweep",
    [
        {"seeds": (4, [1, 2])},
        {"structure": ({"kind": "tower"}, {"kind": "bridge", "gap": 8})},
        {"localization": ({"method": "joint", "steps": 9}, {"method": "online"})},
        {"robot.shape": ("triangle", "tetrahedron")},
        {"sensing.tilt_noise_deg": (0, 1.5)},
    ],
    ids=lambda sweep: next(iter(sweep)),
)
def test_values_of_any_type_are_as_if_checked_as_a_whole(sweep):
    """Lists of a file are tuples of a scenario, and whole numbers may be real."""
    for variant in variants(scenario(sweep=sweep)):
        assert from_plain(to_plain(variant.settings)) == variant.settings
        assert isinstance(variant.settings.seed_list, tuple)


def test_keys_of_one_entry_change_together():
    """Row by row, and the first key alone names the point, so that the others may follow it."""
    base = scenario(
        sweep={
            "robots, structure.movers": ([100, 1], [1000, 10]),
            "precision": ("f64", "f32"),
        },
        conditions={"joint": {"localization.method": "joint"}},
    )

    cases = variants(base)

    assert [case.label for case in cases] == [
        "robots=100,precision=f64,joint",
        "robots=100,precision=f32,joint",
        "robots=1000,precision=f64,joint",
        "robots=1000,precision=f32,joint",
    ]
    assert [case.settings.structure.movers for case in cases] == [1, 1, 10, 10]
    assert cases[2].point == {"robots": 1000, "precision": "f64"}


@pytest.mark.parametrize(
    ("sweep", "problem"),
    [
        ("{'robots, structure.movers': [[10, 1], [20]]}", "should be a row of 2 values"),
        ("{'robots, structure.movers': [10]}", "should be a row of 2 values"),
        (
            "{'robots, structure.movers': [[10, 1], [20, 0]]}",
            "should be greater than or equal to 1",
        ),
        ("{robots: [10], 'structure.movers, robots': [[1, 20]]}", "or set sweep={robots: [...]}"),
        ("{'robots, question': [[10, 1]]}", "cannot be swept"),
        ("{'robots, threads': [[10, 0]]}", "should be greater than or equal to 1"),
        ("{'robots, arch': [[10, auto]]}", "should be 'cpu', 'cuda', 'vulkan' or 'metal'"),
    ],
)
def test_rows_that_do_not_fit_are_reported_with_their_line(tmp_path, sweep, problem):
    """So are a key in two places, and a value that is wrong in itself."""
    path = tmp_path / "rows.yaml"
    path.write_text(
        f"name: rows\nstructure: {{kind: tower}}\nsweep: {sweep}\nlocalization: {{method: joint}}\n"
    )

    (mistake,) = find_mistakes(path)

    assert problem in mistake.problem
    assert mistake.line == 3


def test_a_case_is_settled_to_the_last_value():
    """Swept values and conditions are applied; nothing is left to vary."""
    base = scenario(
        sweep={"robots": (10,), "sensing.tilt_noise_deg": (1,)},
        conditions={"no-z": {"localization.z_correction": False}},
    )

    (case,) = variants(base)

    assert case.condition == "no-z"
    assert case.point == {"robots": 10, "sensing.tilt_noise_deg": 1}
    assert case.settings.robots == 10
    assert case.settings.sensing.tilt_noise_deg == 1.0
    assert case.settings.localization == VirtualForceParams(z_correction=False)
    assert variants(case.settings)[0].settings == case.settings
    assert base.robots == 100


def test_a_condition_may_replace_a_section():
    """Another method needs none of the settings of the first."""
    base = scenario(
        localization=VirtualForceParams(initial_offset=2.0),
        conditions={"a": {}, "b": {"localization": {"method": "joint", "chains": 3}}},
    )

    cases = {case.condition: case.settings.localization for case in variants(base)}

    assert cases == {"a": VirtualForceParams(initial_offset=2.0), "b": JointParams(chains=3)}


def test_a_condition_has_the_last_word():
    """Where sweep and condition set the same key, the condition holds."""
    (case,) = variants(
        scenario(
            sweep={"localization.iterations": (5,)},
            conditions={"long": {"localization.iterations": 50}},
        )
    )

    assert case.settings.localization.iterations == 50


def test_labels_are_fit_for_folders():
    """Sections and odd characters become plain text; long names are cut and kept apart."""
    sections = tuple({"kind": "tower", "goal_height": 1.5 + k} for k in range(2))
    heights = {
        "twists": 1,
        "max_flips": 400,
        "max_spawns": 100,
        "patience": 2,
        "min_flip_deg": 1e-5,
    }
    long = tuple({"kind": "tower", "climb": {**heights, "max_flip_deg": 100 + k}} for k in range(2))

    short_names = labels(sweep={"structure": sections, "sensing.tilt_noise_deg": (1e-5,)})
    long_names = labels(sweep={"structure": long, "localization.initial_offset": (-1.5,)})

    assert short_names == [
        "structure=kind-tower-goal_height-1.5,sensing.tilt_noise_deg=1e-05,baseline",
        "structure=kind-tower-goal_height-2.5,sensing.tilt_noise_deg=1e-05,baseline",
    ]
    assert len(set(long_names)) == 2
    assert all(len(name) <= MAX_VARIANT_NAME for name in long_names)


def test_cases_that_a_file_system_may_mix_up_are_refused():
    """Names that differ by capitals only are the same folder on many machines."""
    with pytest.raises(InputError, match="two cases would have the name A; rename a condition"):
        variants(scenario(conditions={"a": {}, "A": {}}))


def test_a_wrong_condition_made_in_python_is_reported():
    """Without a file, the error names the key."""
    wrong = scenario(conditions={"a": {"localization.iterations": 0}})

    with pytest.raises(
        InputError, match=r"^conditions.a.localization.iterations: 0 should be greater"
    ):
        variants(wrong)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class OtherMethod(MethodParams):
    """Another method, one of whose settings has a name that virtual-force knows too."""

    method: Literal["other"] = "other"
    iterations: int = 9
    chains: int = 1


@pytest.fixture
def two_methods():
    """A scenario with a choice of another method."""
    registry.register("method", "other", OtherMethod, scenario)
    yield scenario()
    plugins.forget()


def test_another_method_starts_from_its_own_defaults(two_methods):
    """Settings of the old method do not leak into the new one, even under the same name."""
    entries = {"localization.chains": 3, "localization.method": "other"}

    old, new = variants(replace(two_methods, conditions={"old": {}, "new": entries}))

    assert old.settings.localization == VirtualForceParams()
    assert new.settings.localization == OtherMethod(chains=3)


def test_settings_are_not_dropped_unseen(two_methods, tmp_path):
    """A condition that would drop settings of another method is refused at its line."""
    path = tmp_path / "scenario.yaml"
    path.write_text(
        "name: x\nstructure: {kind: tower}\nlocalization: {method: virtual-force, iterations: 5}\n"
        "conditions:\n  new:\n    localization.method: other\n"
    )

    (mistake,) = find_mistakes(path)

    assert str(mistake) == (
        f"{path}:6: conditions.new.localization.method: would drop iterations, set for "
        "virtual-force; sweep localization as a whole, or give localization as a whole in the "
        "condition"
    )


def test_whole_sections_can_be_swept(two_methods):
    """Every method with its own settings, side by side."""
    sections = ({"method": "virtual-force", "iterations": 5}, {"method": "other", "iterations": 6})

    first, second = variants(replace(two_methods, sweep={"localization": sections}))

    assert first.settings.localization == VirtualForceParams(iterations=5)
    assert second.settings.localization == OtherMethod(iterations=6)


def test_a_mistake_of_two_together_names_the_case(two_methods):
    """A mistake of two changes together is reported for the case in which it happens."""
    wrong = replace(
        two_methods,
        sweep={"localization": ({"method": "virtual-force"}, {"method": "other"})},
        conditions={"a": {"localization.trace_every": 3}},
    )

    with pytest.raises(InputError, match=r"^conditions.a.localization.trace_every: unknown key"):
        variants(wrong)


def test_points_have_their_own_seeds():
    """Large structures may be fewer; cases of other points stay as they are."""
    rows = {"robots, seeds": [[10, 3], [20, [7]]]}
    tower = REPOSITORY / "tests" / "tower.yaml"
    few = load_scenario(tower, [f"sweep={rows}", "conditions={a: {}}"])

    assert [(case.settings.robots, case.seed) for case in plan(few).cases] == [
        *((10, seed) for seed in range(3)),
        (20, 7),
    ]


def test_threads_and_devices_make_cases_of_their_own():
    """A device shares the structures of others; growth is timed at each number of threads."""
    swept = {"threads": [1, 2], "arch": ["cpu", "cuda"]}
    tower = REPOSITORY / "tests" / "tower.yaml"
    four = plan(load_scenario(tower, [f"sweep={swept}", "seeds=1", "conditions={a: {}}"]))

    assert [case.name for case in four.cases] == [
        f"0-threads={n},arch={arch},a" for n in (1, 2) for arch in ("cpu", "cuda")
    ]
    assert [len(group) for group in four.structures] == [2, 2]
    assert "threads" not in dump_scenario(load_scenario(tower))  # folders keep their names


def test_a_key_that_an_optional_section_requires_can_be_swept():
    """The section is not valid without a value, which the sweep then replaces."""
    data = {
        "name": "x", "robots": 5, "seeds": 1, "localization": {"method": "joint"},
        "structure": {"kind": "tower", "strength": {"limit": 250.0}},
        "sweep": {"structure.strength.limit": [150.0, 400.0]},
    }  # fmt: skip

    limits = [
        variant.settings.structure.strength.limit for variant in variants(load_scenario(data))
    ]

    assert limits == [150.0, 400.0]
