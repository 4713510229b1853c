"""Stages of a batch: compilation before measurement, structures grown once."""

import json

import pytest

from tests.runs import REPOSITORY, assert_same_bytes
from tiswarm import study
from tiswarm.app.console import ConsoleProgress
from tiswarm.base.progress import Progress
from tiswarm.localization.virtual_force import method
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study import provenance, runner
from tiswarm.study.runner import SAMPLE_ROBOTS
from tiswarm.world.growth import grow


def test_kernels_are_compiled_before_costs_are_measured(tmp_path, monkeypatch):
    """Each method and the growth have run once when the first stage begins."""
    events = []
    stage, localize_many = provenance.Costs.stage, runner.localize_many

    def record_stage(costs, name, cases):
        events.append(name)
        return stage(costs, name, cases)

    def record_method(logs, params, **settings):
        events.append((params[0].method, logs[0].robot_count))
        return localize_many(logs, params, **settings)

    monkeypatch.setattr(provenance.Costs, "stage", record_stage)
    monkeypatch.setattr(runner, "localize_many", record_method)
    monkeypatch.setattr(runner, "_compiled", {})
    sets = ["robots=8", "seeds=3", "conditions={a: {}, b: {localization.method: joint}}"]

    study.run(
        load_scenario(REPOSITORY / "tests" / "tower.yaml", sets), tmp_path, progress=Progress()
    )

    assert events == [
        ("virtual-force", SAMPLE_ROBOTS), ("joint", SAMPLE_ROBOTS), "grow", "sense", "localize",
        ("joint", 8), "score and store", "localize", ("virtual-force", 8), "score and store",
    ]  # fmt: skip


def test_settings_that_are_localized_apart_have_costs_of_their_own(tmp_path):
    """A study of schemes that differ in cost by a factor of ten states what each of them takes."""
    of_hops = "{localization: {method: hop-by-hop, order: hops}}"
    of_joins = "{localization: {method: hop-by-hop, order: join}}"
    sets = ["robots=6", "seeds=2", f"conditions={{hops: {of_hops}, joins: {of_joins}}}"]
    small = load_scenario(REPOSITORY / "tests" / "tower.yaml", sets)

    folder = study.run(small, tmp_path, progress=Progress()).folder

    costs = {
        name: [
            json.loads((folder / "cases" / f"{seed}-{name}" / "cost.json").read_text())["localize"]
            for seed in (0, 1)
        ]
        for name in ("hops", "joins")
    }
    assert costs["hops"][0] == costs["hops"][1]
    assert costs["hops"][0]["cpu_s"] != costs["joins"][0]["cpu_s"]


def test_what_took_long_to_grow_is_grown_once(tmp_path, monkeypatch):
    """A run that is stopped in its second method keeps its structures and finished cases."""
    sets = ["robots=8", "seeds=2", "conditions={a: {}, b: {localization.method: joint}}"]
    small = load_scenario(REPOSITORY / "tests" / "tower.yaml", sets)
    progress = Progress()
    whole = study.run(small, tmp_path / "whole", progress=progress)
    monkeypatch.setattr(runner, "KEPT_FROM_S", 0.0)

    with monkeypatch.context() as patched:
        patched.setattr(method.kernels, "localize_in_join_order", _interrupt)
        with pytest.raises(KeyboardInterrupt):
            study.run(small, tmp_path / "stopped", progress=progress)
    monkeypatch.setattr(runner, "grow", _grow_samples_only)
    stopped = study.run(small, tmp_path / "stopped", progress=progress)

    assert (whole.computed, stopped.computed, stopped.found) == (4, 2, 2)
    assert_same_bytes(whole.folder, stopped.folder)
    manifest = json.loads((stopped.folder / "manifest.json").read_text())
    assert manifest["stages"]["grow"]["cpu_s"] > 0.0


def _interrupt(*_args, **_settings):
    raise KeyboardInterrupt


def _grow_samples_only(*settings, robots, **others):
    assert robots == SAMPLE_ROBOTS
    return grow(*settings, robots=robots, **others)


def test_progress_names_conditions_and_points_as_pages_do(tmp_path, capsys):
    """Folders name a point `robots=6`; whoever watches a sweep reads its labels."""
    conditions = "{a: {label: with heights}, b: {localization.z_correction: false}}"
    sets = ["seeds=1", f"conditions={conditions}", "sweep={robots: [5, 6]}"]
    scenario = load_scenario(REPOSITORY / "tests" / "tower.yaml", sets)

    study.run(scenario, tmp_path, progress=ConsoleProgress())

    lines = capsys.readouterr().err.splitlines()
    assert [line.rpartition(":")[0] for line in lines if line.startswith("grow")] == [
        "grow (with heights, 5 robots and 1 more)", "grow (with heights, 6 robots and 1 more)",
    ]  # fmt: skip
