"""Order of cases, their jobs, and their series, points and kinds."""

import json

import pandas as pd

from tests.runs import REPOSITORY
from tiswarm import study
from tiswarm.base.progress import Progress
from tiswarm.report.run_data import load_run
from tiswarm.scenario.expansion import load_scenario, plan
from tiswarm.study.runner import Job, batch
from tiswarm.study.store import RunFolder


def _jobs(out, *overrides, **settings):
    whole = plan(load_scenario(REPOSITORY / "tests" / "tower.yaml", overrides))
    return batch(whole.structures, RunFolder(out), arch="cpu", threads=1, **settings)


def _sizes(jobs: list[Job]) -> list[list[int]]:
    return [[case.settings.robots for case in job.cases] for job in jobs]


def test_small_structures_are_computed_first(tmp_path):
    """Jobs are ordered by size, in any order of the sweep, with all conditions together."""
    sweep = 'sweep={"robots, structure.movers": [[30, 3], [4, 1], [100, 10]]}'

    jobs = _jobs(tmp_path, "seeds=2", sweep)

    assert _sizes(jobs) == [[4] * 6, [30] * 6, [100] * 6]


def test_all_processes_have_jobs(tmp_path):
    """Several jobs each, so that they end at about the same time; or one job a structure.

    The first one of each process is one structure, so that progress shows early.
    """
    assert len(_jobs(tmp_path, "seeds=80")) == 1
    assert len(_jobs(tmp_path, "seeds=80", width=2)) == 10
    assert len(_jobs(tmp_path, "seeds=80", alone=True)) == 80


def test_a_job_is_split_between_structures_and_then_within_one(tmp_path):
    """No structure is grown twice before it must be, and no case is lost."""
    [job] = _jobs(tmp_path, "seeds=3")

    one, two = job.halves
    first, rest = one.halves

    assert [case.seed for case in one.cases] == [0] * 3
    assert [case.seed for case in two.cases] == [1] * 3 + [2] * 3
    assert [len(half.cases) for half in (first, rest)] == [1, 2]
    assert [*one.cases, *two.cases] == job.cases
    assert [*first.cases, *rest.cases] == one.cases


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
    assert [case.point[-11:] for case in cases] == 2 * (2 * [" / 4 robots"] + 2 * [" / 5 robots"])
    assert [case.series for case in cases] == [f"{c.point} / {c.condition}" for c in cases]
    assert len({case.point for case in cases}) == 4
    assert len(pd.read_csv(folder / "table.csv")) == 8
