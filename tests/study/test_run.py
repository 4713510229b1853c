"""Whole runs: their files, their repetition, and their continuation after a break."""

import dataclasses
import filecmp
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from tests.recorder import Recorder
from tests.runs import MEASURED, REPOSITORY
from tiswarm import study
from tiswarm.localization import virtual_force
from tiswarm.progress import Progress
from tiswarm.report.run_data import load_run
from tiswarm.scenario import load_scenario
from tiswarm.study import provenance, runner, store, tables
from tiswarm.study.cases import batches, plan
from tiswarm.study.runner import SAMPLE_ROBOTS, failure
from tiswarm.study.store import RunFolder
from tiswarm.version import code_digest
from tiswarm.world.growth import grow

SMALL = ("--set", "robots=12", "--set", "seeds=2", "--no-pictures")
SCENARIOS = sorted((REPOSITORY / "scenarios").glob("*.yaml"))


def _files(folder: Path) -> set[Path]:
    """Return all files that must repeat: those that are neither measured nor drawn."""
    return {
        path.relative_to(folder)
        for path in folder.rglob("*")
        if path.is_file()
        and path.name not in MEASURED
        and not {"figures", "renders"} & set(path.parts)
    }


def _assert_same_bytes(a: Path, b: Path) -> None:
    assert _files(a) == _files(b)
    same, different, missing = filecmp.cmpfiles(a, b, _files(a), shallow=False)
    assert same
    assert not different
    assert not missing


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda path: path.stem)
def test_every_shipped_scenario_runs(tmp_path, scenario):
    """Each scenario finishes every case at small size."""
    sizes = {
        "scaling": ["sweep={robots: [6, 7, 8]}"],
        "large-swarm": [
            "robots=1000",
            "structure.movers=10",
            "structure.solve_every=20",
            "conditions.joint.localization.steps=200",
        ],
        "yaw": ["robots=8", "sweep={sensing.yaw_bias_deg: [0, 5]}"],
    }.get(scenario.stem, ["robots=8"])
    small = load_scenario(scenario, [*sizes, "seeds=1"])

    result = study.run(small, tmp_path, progress=Progress())

    assert (pd.read_csv(result.folder / "summary.csv")["status"] == "done").all()


@pytest.mark.parametrize("kind", ["tower", "cantilever", "bridge", "chain"])
def test_logs_of_every_kind_are_read_back(tiswarm, tmp_path, kind):
    """The stored log of any kind gives the bytes of the stored estimate."""
    ran = tiswarm(
        "run", f"scenarios/{kind}.yaml", "--set", "robots=15", "--set", "seeds=[2]",
        "--no-pictures", "--out", tmp_path,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    case = next(tmp_path.glob("*/cases/2-baseline"))

    done = tiswarm("localize", case / "sensing.jsonl", "--out", tmp_path / "estimate.csv")

    assert done.returncode == 0, done.stderr
    assert (tmp_path / "estimate.csv").read_bytes() == (case / "estimate.csv").read_bytes()


def test_a_run_leaves_everything_behind(small_run):
    """Tables, cases, manifest and pictures exist, with the expected content."""
    summary = pd.read_csv(small_run / "summary.csv")
    table = pd.read_csv(small_run / "table.csv")
    manifest = json.loads((small_run / "manifest.json").read_text())

    assert len(summary) == 6
    assert summary["rmse_R"].between(0, 50).all()
    assert table["condition"].tolist() == ["baseline", "no-z", "no-z-no-undock"]
    assert table["paper_rmse_radii"].isna().all()  # it has no structures of 12 robots
    np.testing.assert_allclose(
        table["rmse_R_mean"], summary.groupby("condition", sort=False)["rmse_R"].mean()
    )
    assert set(manifest["stages"]) == {"grow", "sense", "localize", "evaluate and store"}
    assert {"tiswarm", "backend", "machine", "libraries", "peak_memory_MB"} <= set(manifest)
    assert {"structure.png", "truth-and-estimate.png"} <= set(manifest["renders"])


@pytest.mark.parametrize(
    ("changed", "published"),
    [
        ("description=the same", [1.64, 1.84, 2.36, 2.36, np.nan, 3.91, 5.26, 5.12, 5.12, np.nan]),
        ("structure.climb.settle=true", [1.64]),  # the paper leaves open how flips end
        ("robots=99", [np.nan]),
        ("structure.movers=2", [np.nan]),
        ("sensing.yaw_noise_deg=1", [np.nan]),
        ("localization.method=joint", [np.nan]),
    ],
)
def test_published_numbers_stand_beside_their_own_setting_only(changed, published):
    """Rows of the paper's settings have its numbers; rows of other settings have none."""
    only = () if len(published) > 1 else ("sweep={}", "conditions={baseline: {}}")
    paper = load_scenario(REPOSITORY / "scenarios" / "paper.yaml", ["seeds=1", *only, changed])
    cases = study.plan(paper)
    records = [replace(failure(case, ""), status="done", scores={"rmse_R": 3.0}) for case in cases]

    table = tables.table(records, [case.settings for case in cases])

    np.testing.assert_equal(table["paper_rmse_radii"].to_numpy(), published)
    np.testing.assert_allclose(table["rmse_R_to_paper"], 3.0 / np.array(published))


def test_what_a_case_says_is_what_its_files_say(small_run):
    """Errors by robot, the last iteration and the summary agree."""
    summary = pd.read_csv(small_run / "summary.csv").set_index("case")
    for folder in (small_run / "cases").iterdir():
        robots = pd.read_csv(folder / "robots.csv")
        convergence = pd.read_csv(folder / "convergence.csv")
        truth = pd.read_csv(folder / "truth.csv")
        estimate = pd.read_csv(folder / "estimate.csv")
        places = ["x_R", "y_R", "z_R"]
        error = np.linalg.norm(estimate[places] - truth[places], axis=1)

        np.testing.assert_allclose(robots["error_R"], error, atol=1e-12)
        rmse = summary.loc[folder.name, "rmse_R"]
        assert rmse == pytest.approx(np.sqrt(np.mean(error**2)))
        assert rmse == pytest.approx(convergence["rmse_R"].iloc[-1])


def test_every_picture_shows_something(small_run):
    """Figures and renders are pictures with more than one color."""
    pictures = [*small_run.glob("figures/*.png"), *small_run.glob("renders/*.png")]

    assert len(pictures) >= 5
    for path in pictures:
        pixels = np.asarray(Image.open(path).convert("RGB"))
        assert min(pixels.shape[:2]) >= 300
        assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 50


def test_threads_and_repetition_do_not_change_a_byte(tiswarm, tmp_path):
    """One thread, two threads and a repetition give the same bytes."""
    for name, threads in (("one", 1), ("two", 2), ("again", 2)):
        done = tiswarm(
            "run", "scenarios/tower.yaml", *SMALL, "--threads", threads, "--out", tmp_path / name
        )
        assert done.returncode == 0, done.stderr

    _assert_same_bytes(tmp_path / "one", tmp_path / "two")
    _assert_same_bytes(tmp_path / "one", tmp_path / "again")


def test_localize_gives_the_bytes_of_the_run(tiswarm, small_run, tmp_path):
    """A stored log localized on its own gives the stored estimate, for every condition."""
    options = {
        "baseline": (),
        "no-z": ("--set", "z_correction=false"),
        "no-z-no-undock": ("--set", "z_correction=false", "--set", "undocked_repulsion=false"),
    }
    for condition, settings in options.items():
        case = small_run / "cases" / f"1-{condition}"
        out = tmp_path / f"{condition}.csv"

        done = tiswarm("localize", case / "sensing.jsonl", *settings, "--out", out)

        assert done.returncode == 0, done.stderr
        assert out.read_bytes() == (case / "estimate.csv").read_bytes()


def test_any_method_is_run_and_called_alike(tiswarm, tmp_path):
    """The same settings in a scenario and on the command line give the same bytes."""
    scenario = tmp_path / "squares.yaml"
    scenario.write_text(
        "name: squares\nrobots: 10\nstructure: {kind: tower}\n"
        "localization: {method: least-squares, rounds: 2, non_overlap: false,\n"
        "  ground: false, walk_contacts: false, odometry: false}\n"
    )
    ran = tiswarm("run", scenario, "--no-pictures", "--out", tmp_path)
    assert ran.returncode == 0, ran.stderr
    case = next(tmp_path.glob("*/cases/0-baseline"))

    done = tiswarm(
        "localize", case / "sensing.jsonl", "--method", "least-squares",
        "--cues", "contacts,height", "--set", "rounds=2", "--out", tmp_path / "estimate.csv",
    )  # fmt: skip

    assert done.returncode == 0, done.stderr
    assert "contacts, height: " in done.stdout
    assert (tmp_path / "estimate.csv").read_bytes() == (case / "estimate.csv").read_bytes()


def test_the_localizer_is_blind_to_the_truth(tiswarm, small_run, tmp_path):
    """With noise in place of the truth, the estimate keeps every byte."""
    run = tmp_path / "run"
    shutil.copytree(small_run, run)
    rng = np.random.default_rng(0)
    for path in run.rglob("truth.csv"):
        truth = pd.read_csv(path)
        truth[["x_R", "y_R", "z_R"]] = rng.normal(size=(len(truth), 3))
        truth.to_csv(path, index=False)
    case = run / "cases" / "0-baseline"

    done = tiswarm("localize", case / "sensing.jsonl", "--out", tmp_path / "blind.csv")

    assert done.returncode == 0, done.stderr
    assert (tmp_path / "blind.csv").read_bytes() == (case / "estimate.csv").read_bytes()


def test_a_finished_run_is_not_computed_again(tiswarm, small_run):
    """The same command finds every case stored and changes nothing."""
    before = {path: path.stat().st_mtime_ns for path in (small_run / "cases").rglob("*")}

    done = tiswarm(
        "run", "scenarios/tower.yaml", "--set", "robots=12", "--set", "seeds=2",
        "--out", small_run.parent,
    )  # fmt: skip

    assert done.returncode == 0
    assert "6 of 6 cases are already stored" in done.stderr
    assert before == {path: path.stat().st_mtime_ns for path in (small_run / "cases").rglob("*")}


def test_cases_of_other_code_are_computed_again(tmp_path, capsys, monkeypatch):
    """A run never mixes results of two states of the code, and reports what it replaces."""
    small = load_scenario(REPOSITORY / "scenarios" / "tower.yaml", ["robots=5", "seeds=2"])
    progress = Recorder()
    for module in (provenance, store):
        monkeypatch.setattr(module, "CODE", "0123456789ab")
    old = study.run(small, tmp_path, progress=progress)
    record = json.loads((old.folder / "cases" / "1-no-z" / "case.json").read_text())
    monkeypatch.undo()

    new = study.run(small, tmp_path, progress=progress)

    assert (new.found, new.computed) == (0, 6)
    assert "6 cases were computed by other code; computing them again" in progress.lines
    assert record["code"] == "0123456789ab"
    record = json.loads((old.folder / "cases" / "1-no-z" / "case.json").read_text())
    assert record["code"] == code_digest()
    assert json.loads((new.folder / "manifest.json").read_text())["code"] == code_digest()
    assert study.run(small, tmp_path, progress=progress).found == 6


def test_damaged_cases_are_computed_again(tiswarm, small_run, tmp_path):
    """A case that is half-written, changed or empty is computed again, to the same bytes."""
    run = tmp_path / small_run.name
    shutil.copytree(small_run, run)
    cases = run / "cases"
    shutil.rmtree(cases / "0-baseline")
    (cases / "1-baseline" / "estimate.csv").write_text("robot,x_R,y_R,z_R\n")
    (cases / "0-no-z" / "case.json").write_text("{")
    (cases / ".1-no-z.part").mkdir()
    (run / "renders" / ".scenes.tmp").mkdir()
    (run / "renders" / ".structure.png.tmp").touch()

    done = tiswarm("run", "scenarios/tower.yaml", *SMALL, "--out", tmp_path)

    assert done.returncode == 0, done.stderr
    assert "3 of 6 cases are already stored" in done.stderr
    _assert_same_bytes(run, small_run)
    assert not (run / "report.html").exists()  # it showed another state
    assert not [*run.rglob(".*.part"), *run.rglob(".*.tmp")]


def test_a_run_that_was_killed_at_its_end_is_made_whole(tmp_path, monkeypatch):
    """All cases were stored, but neither all costs nor the manifest."""
    small = load_scenario(REPOSITORY / "scenarios" / "tower.yaml", ["robots=6", "seeds=1"])
    progress = Progress()
    monkeypatch.setattr(RunFolder, "store_cost", lambda *_: None)
    folder = study.run(small, tmp_path, progress=progress).folder
    (folder / "manifest.json").unlink()

    again = study.run(small, tmp_path, progress=progress)

    assert again.computed == 0
    manifest = json.loads((folder / "manifest.json").read_text())
    assert set(manifest["stages"]) == {"grow", "sense", "localize"}


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
        load_scenario(REPOSITORY / "scenarios" / "tower.yaml", sets), tmp_path, progress=Progress()
    )

    assert events == [
        ("virtual-force", SAMPLE_ROBOTS), ("joint", SAMPLE_ROBOTS), "grow", "sense", "localize",
        ("joint", 8), "evaluate and store", "localize", ("virtual-force", 8), "evaluate and store",
    ]  # fmt: skip


def test_what_took_long_to_grow_is_grown_once(tmp_path, monkeypatch):
    """A run that is stopped in its second method keeps its structures and finished cases."""
    sets = ["robots=8", "seeds=2", "conditions={a: {}, b: {localization.method: joint}}"]
    small = load_scenario(REPOSITORY / "scenarios" / "tower.yaml", sets)
    progress = Progress()
    whole = study.run(small, tmp_path / "whole", progress=progress)
    monkeypatch.setattr(runner, "KEPT_FROM_S", 0.0)

    with monkeypatch.context() as patched:
        patched.setattr(virtual_force, "localize_in_join_order", _interrupt)
        with pytest.raises(KeyboardInterrupt):
            study.run(small, tmp_path / "stopped", progress=progress)
    monkeypatch.setattr(runner, "grow", _grow_samples_only)
    stopped = study.run(small, tmp_path / "stopped", progress=progress)

    assert (whole.computed, stopped.computed, stopped.found) == (4, 2, 2)
    _assert_same_bytes(whole.folder, stopped.folder)
    manifest = json.loads((stopped.folder / "manifest.json").read_text())
    assert manifest["stages"]["grow"]["cpu_s"] > 0.0


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
    small = load_scenario(REPOSITORY / "scenarios" / "tower.yaml", overrides)

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


def test_small_structures_are_computed_first():
    """Batches are ordered by size, in any order of the sweep, with all conditions together."""
    overrides = ["seeds=2", 'sweep={"robots, structure.movers": [[30, 3], [4, 1], [100, 10]]}']
    scenario = load_scenario(REPOSITORY / "scenarios" / "tower.yaml", overrides)

    robots = [[case.settings.robots for case in batch] for batch in batches(plan(scenario))]

    assert robots == [[4] * 6, [30] * 6, [100] * 6]


def test_a_kept_structure_is_read_back_or_grown_again(tmp_path, monkeypatch):
    """It is read as it was, unless its file is damaged or other code grew it."""
    scenario = load_scenario(REPOSITORY / "scenarios" / "bridge.yaml", ["robots=30", "seeds=1"])
    [case] = plan(scenario)[:1]
    settings = case.settings
    [history] = grow(settings.structure, robots=30, seeds=[case.seed], robot=settings.robot)
    folder = RunFolder.of(scenario, tmp_path)
    cost = {"wall_s": 1.5, "cpu_s": 1.0, "peak_memory_MB": 3.0}
    assert folder.read_structure(case) is None

    folder.keep_structure(case, history, cost)

    read, share = folder.read_structure(case)
    assert share == cost
    assert (read.seed, read.terrain, read.spawns) == (history.seed, history.terrain, history.spawns)
    np.testing.assert_equal(
        [dataclasses.asdict(part) for part in (*read.walks, *read.loads)],
        [dataclasses.asdict(part) for part in (*history.walks, *history.loads)],
    )
    np.testing.assert_array_equal(read.sensed, history.sensed)
    with monkeypatch.context() as patched:
        patched.setattr(store, "CODE", "0123456789ab")
        assert folder.read_structure(case) is None
    [kept] = (folder.path / "structures").glob("*.npz")
    data = bytearray(kept.read_bytes())
    data[len(data) // 2] ^= 1
    kept.write_bytes(data)
    assert folder.read_structure(case) is None
    kept.write_bytes(data[:100])
    assert folder.read_structure(case) is None
    kept.write_bytes(b"")
    assert folder.read_structure(case) is None
    np.savez(kept, facts="{}")
    assert folder.read_structure(case) is None


def _interrupt(*_args, **_settings):
    raise KeyboardInterrupt


def _grow_samples_only(*settings, robots, **others):
    assert robots == SAMPLE_ROBOTS
    return grow(*settings, robots=robots, **others)


def test_report_and_render_need_the_folder_alone(tiswarm, small_run, tmp_path):
    """Tables, figures and renders come back from the stored cases, byte for byte."""
    run = tmp_path / "moved"
    shutil.copytree(small_run, run)
    for name in ("summary.csv", "table.csv"):
        (run / name).unlink()
    for name in ("figures", "renders"):
        shutil.rmtree(run / name)

    reported = tiswarm("report", run)
    rendered = tiswarm("render", run)

    assert reported.returncode == 0, reported.stderr
    assert rendered.returncode == 0, rendered.stderr
    for path in [*small_run.glob("*.csv"), *small_run.glob("figures/*.png")]:
        assert (run / path.relative_to(small_run)).read_bytes() == path.read_bytes()
    assert {path.name for path in (run / "renders").iterdir()} == {
        path.name for path in (small_run / "renders").iterdir()
    }


def test_failed_cases_are_reported(tiswarm, tmp_path):
    """Cases whose robots never arrive fail with the reason, and the exit status is 3."""
    done = tiswarm(
        "run", "scenarios/tower.yaml", *SMALL, "--out", tmp_path,
        "--set", "structure.spawn_min=300", "--set", "structure.spawn_max=310",
        "--set", "structure.climb.max_flips=2", "--set", "structure.climb.max_spawns=2",
    )  # fmt: skip

    assert done.returncode == 3
    assert "max_spawns" in done.stderr
    run = next(tmp_path.iterdir())
    summary = (run / "summary.csv").read_text()
    assert (pd.read_csv(run / "summary.csv")["status"] == "failed").all()
    assert tiswarm("report", run).returncode == 0
    assert (run / "summary.csv").read_text() == summary


def test_methods_stand_side_by_side(tiswarm, tmp_path):
    """Conditions of different methods share structures, and their logs localize alone."""
    joint = "{localization.method: joint, localization.chains: 2, localization.steps: 800}"

    done = tiswarm(
        "run", "scenarios/tower.yaml", *SMALL, "--out", tmp_path,
        "--set", "sensing.tilt_noise_deg=1.0",
        "--set", f"conditions={{paper: {{}}, joint: {joint}}}",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    folder = next(tmp_path.iterdir())
    rmse = pd.read_csv(folder / "table.csv").set_index("condition")["rmse_R_mean"]
    alone = tiswarm(
        "localize", folder / "cases" / "0-joint" / "sensing.jsonl", "--method", "joint",
        "--set", "chains=2", "--set", "steps=800", "--out", tmp_path / "estimate.csv",
    )  # fmt: skip

    assert rmse["joint"] < rmse["paper"]
    assert alone.returncode == 0, alone.stderr
    stored = (folder / "cases" / "0-joint" / "estimate.csv").read_bytes()
    assert (tmp_path / "estimate.csv").read_bytes() == stored
    assert b"sd_R" in stored
