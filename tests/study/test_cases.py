"""Order of cases, and their series, points and kinds."""

import json

import pandas as pd

from tests.runs import REPOSITORY
from tiswarm import study
from tiswarm.base.progress import Progress
from tiswarm.report.run_data import load_run
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study.cases import batches, plan


def test_small_structures_are_computed_first():
    """Batches are ordered by size, in any order of the sweep, with all conditions together."""
    overrides = ["seeds=2", 'sweep={"robots, structure.movers": [[30, 3], [4, 1], [100, 10]]}']
    scenario = load_scenario(REPOSITORY / "tests" / "tower.yaml", overrides)

    robots = [[case.settings.robots for case in batch] for batch in batches(plan(scenario))]

    assert robots == [[4] * 6, [30] * 6, [100] * 6]


def test_series_point_and_kind_of_each_case_are_stated(tmp_path):
    """A report reads them from `summary.csv`, since the names of folders may be cut."""
    climb = {
        "max_flips": 999,
        "max_spawns": 99,
        "max_flip_deg": 200.5,
        "contact_gap": 0.0001,
        "patience": 3,
    }
    structures = [
        {"mechanics": {"model": model}, "climb": climb, "force_threshold": 8.25, "kind": kind}
        for kind, model in (("tower", "flexible"), ("chain", "rigid"))
    ]
    overrides = [
        f"sweep={{structure: {json.dumps(structures)}, robots: [4, 5]}}",
        "conditions={a: {}, b-c: {localization.iterations: 2}}",
        "seeds=[7]",
    ]
    small = load_scenario(REPOSITORY / "tests" / "tower.yaml", overrides)

    folder = study.run(small, tmp_path, progress=Progress()).folder

    cases = load_run(folder).cases
    assert max(len(case.name) for case in cases) > 150
    assert [case.kind for case in cases] == ["tower"] * 4 + ["chain"] * 4
    assert [case.point[-10:] for case in cases] == [", robots=4"] * 2 + [", robots=5"] * 2 + (
        [", robots=4"] * 2 + [", robots=5"] * 2
    )
    assert [case.series for case in cases] == [f"{c.point}, {c.condition}" for c in cases]
    assert len({case.point for case in cases}) == 4
    assert len(pd.read_csv(folder / "table.csv")) == 8
