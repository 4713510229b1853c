"""Stored cases and structures: what is found, refused and computed again."""

import dataclasses
import json
import shutil

import numpy as np

from tests.recorder import Recorder
from tests.runs import REPOSITORY, assert_same_bytes
from tiswarm import study
from tiswarm.progress import Progress
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study import provenance, store
from tiswarm.study.cases import plan
from tiswarm.study.store import RunFolder
from tiswarm.version import code_digest
from tiswarm.world.growth import grow

SMALL = ("--set", "robots=12", "--set", "seeds=2", "--no-pictures")


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
    assert_same_bytes(run, small_run)
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
