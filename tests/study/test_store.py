"""Stored cases and structures: what is found, refused and computed again."""

import dataclasses
import errno
import json
import os
import re
import shutil
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from tests.recorder import Recorder
from tests.runs import REPOSITORY, assert_same_bytes, assert_same_results
from tiswarm import study
from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.base.progress import Progress
from tiswarm.compute import numerics
from tiswarm.records.io import path_for
from tiswarm.records.run_folder import Manifest, write_manifest
from tiswarm.scenario.expansion import load_scenario, plan
from tiswarm.study import provenance, store
from tiswarm.study.store import RunFolder
from tiswarm.world.growth import grow

SMALL = ("--set", "robots=12", "--set", "seeds=2", "--no-pictures")


def test_a_finished_run_is_not_computed_again(tiswarm, small_run):
    """The same command finds every case stored and changes nothing."""
    before = {path: path.stat().st_mtime_ns for path in (small_run / "cases").rglob("*")}

    done = tiswarm(
        "run", "tests/tower.yaml", "--set", "robots=12", "--set", "seeds=2",
        "--out", small_run.parent,
    )  # fmt: skip

    assert done.returncode == 0
    assert "6 of 6 cases are already stored" in done.stderr
    assert before == {path: path.stat().st_mtime_ns for path in (small_run / "cases").rglob("*")}


def test_every_file_of_a_case_but_its_cost_has_a_digest(small_run):
    """Damage to any of them is seen, also to what pages alone read."""
    case = small_run / "cases" / "0-baseline"
    files = {path.name for path in case.iterdir()} - {"case.json", "cost.json"}

    assert "trace.csv" in files
    assert json.loads((case / "case.json").read_text())["files"].keys() == files


def test_cases_of_other_code_are_computed_again(tmp_path, capsys, monkeypatch):
    """A run never mixes results of two states of the code, and reports what it replaces."""
    small = load_scenario(REPOSITORY / "tests" / "tower.yaml", ["robots=5", "seeds=2"])
    progress = Recorder()
    monkeypatch.setattr(provenance, "package_code", lambda: "0123456789ab")
    old = study.run(small, tmp_path, progress=progress)
    record = json.loads((old.folder / "cases" / "1-no-z" / "case.json").read_text())
    monkeypatch.undo()

    new = study.run(small, tmp_path, progress=progress)

    assert (new.found, new.computed) == (0, 6)
    assert "6 cases were computed by other code; computing them again" in progress.lines
    assert record["code"] == "0123456789ab"
    record = json.loads((old.folder / "cases" / "1-no-z" / "case.json").read_text())
    assert record["code"] == provenance.case_code("virtual-force")
    assert (
        json.loads((new.folder / "manifest.json").read_text())["code"] == provenance.package_code()
    )
    assert study.run(small, tmp_path, progress=progress).found == 6


def test_damaged_cases_are_computed_again(tiswarm, small_run, tmp_path):
    """A case that is half-written, changed or empty is computed again, to the same bytes.

    Files that somebody else put into the folder stay.
    """
    run = tmp_path / small_run.name
    shutil.copytree(small_run, run)
    cases = run / "cases"
    shutil.rmtree(cases / "0-baseline")
    (cases / "1-baseline" / "estimate.csv").write_text("robot,x_R,y_R,z_R\n")
    (cases / "0-no-z" / "case.json").write_text("{")
    # A process that had the number of this one before it wrote these.
    ended = re.sub(r"-\w{8}-", "-01234567-", path_for(Path("x"), "part").name.split(".")[2])
    (cases / f".1-no-z.{ended}.part").mkdir()
    (run / "renders" / f".structure.png.{ended}.tmp").touch()
    mine = {run / "notes.txt", run / ".mine.tmp", cases / "0-no-z" / "plot.png"}
    for path in mine:
        path.write_text("mine")

    done = tiswarm("run", "tests/tower.yaml", *SMALL, "--out", tmp_path)

    assert done.returncode == 0, done.stderr
    assert "3 of 6 cases are already stored" in done.stderr
    assert {path.read_text() for path in mine} == {"mine"}
    for path in mine:
        path.unlink()
    assert_same_bytes(run, small_run)
    assert not (run / "report.html").exists()  # it showed another state
    assert not [*run.rglob(".*.part"), *run.rglob(".*.tmp")]


@pytest.fixture(scope="module")
def tiny():
    """A tower of five robots under one condition."""
    tower = REPOSITORY / "tests" / "tower.yaml"
    return load_scenario(tower, ["robots=5", "seeds=3", "conditions={a: {}}"])


def test_a_folder_that_no_run_made_is_refused(tiny, tmp_path):
    """Files of somebody else would be taken for results; an option takes the folder."""

    def opened(**options):
        with RunFolder.opened(tiny, tmp_path, Progress(), **options) as folder:
            return folder.path

    made = opened()
    opened()  # the scenario is that of the name
    (made / "scenario.yaml").write_text("mine")
    write_manifest(made, Manifest())
    opened()  # the manifest says so
    (made / "scenario.yaml").write_text("mine")

    for manifest in ('{"name": "a page of the user"}', "[]", ""):
        (made / "manifest.json").write_text(manifest)
        with pytest.raises(InputError, match=r"has files, and no run made it; choose another --o"):
            opened()
        assert (made / "manifest.json").read_text() == manifest
    assert (made / "scenario.yaml").read_text() == "mine"
    opened(overwrite=True)
    for name in (".lock", "scenario.yaml", "manifest.json"):
        (made / name).unlink()
    opened()  # there is nothing but empty folders


@pytest.fixture(scope="module")
def tiny_run(tiny, tmp_path_factory):
    """Folder of its run, without pictures."""
    return study.run(tiny, tmp_path_factory.mktemp("tiny"), progress=Progress()).folder


@pytest.fixture
def damaged(tiny_run, tmp_path):
    """A copy of that folder."""
    return Path(shutil.copytree(tiny_run, tmp_path / tiny_run.name))


def test_the_folder_of_a_run_is_no_parent_of_another(tiny, damaged):
    """A user who continues a run may name its own folder; a run within it would be none of both."""
    before = sorted(damaged.rglob("*"))

    with pytest.raises(InputError) as refusal:
        study.run(tiny, damaged, progress=Progress())

    problem = (
        f"--out: {damaged} is the folder of a run; name its parent {damaged.parent} to continue"
    )
    assert str(refusal.value.as_option()).startswith(problem)
    assert sorted(damaged.rglob("*")) == before


def test_a_run_that_goes_on_under_other_roundings_says_so(tiny, damaged, monkeypatch):
    """Its bytes are those of two kinds of processor; manifest and cases name both."""
    [own] = json.loads((damaged / "manifest.json").read_text())["numerics"]
    other = numerics.current()._replace(blas="numpy openblas 0.3.29 SkylakeX (269757)")
    monkeypatch.setattr(numerics, "current", lambda: other)
    shutil.rmtree(damaged / "cases" / "0-a")
    progress = Recorder()

    study.run(tiny, damaged.parent, progress=progress)

    [line] = [line for line in progress.lines if "rounded" in line]
    assert line == (
        f"stored cases may be rounded otherwise than those to come: blas {own['blas']}, here "
        f"{other.blas}; remove {damaged} to compute all alike"
    )
    manifest = json.loads((damaged / "manifest.json").read_text())
    assert manifest["numerics"] == [own, other.facts]
    assert manifest["tiswarm"]
    cases = {path.parent.name: json.loads(path.read_text()) for path in damaged.rglob("case.json")}
    on = {name: case["computed_on"] for name, case in cases.items()}
    assert on.pop("0-a") == f"cpu in f64, numerics {other.key}"
    assert {*on.values()} == {f"cpu in f64, numerics {own['key']}"}
    assert own["key"] != other.key


def test_a_killed_run_keeps_what_rounded_its_cases(damaged):
    """It has no manifest of a complete run, but it names this before the first case."""
    [own] = json.loads((damaged / "manifest.json").read_text())["numerics"]

    RunFolder(damaged).reopen(Progress(), computes=True)
    RunFolder(damaged).reopen(Progress(), computes=False)

    manifest = json.loads((damaged / "manifest.json").read_text())
    assert (manifest["tiswarm"], manifest["numerics"]) == ("", [own])


def test_no_damage_of_a_record_goes_unseen(damaged):
    """After a flipped bit or another byte, white space too, a record is not read."""
    folder, path = RunFolder(damaged), damaged / "cases" / "1-a" / "case.json"
    record, whole = folder.read_case("1-a"), path.read_bytes()
    random = np.random.default_rng(0)

    believed = []
    for _ in range(400):
        data = np.frombuffer(whole, np.uint8).copy()
        data[random.integers(data.size)] ^= random.choice([1 << random.integers(8), 255])
        path.write_bytes(data.tobytes())
        believed.append(folder.read_case("1-a"))

    assert record.is_current
    assert [read for read in believed if read] == []


@pytest.mark.parametrize(
    ("change", "believed"),
    [
        ({"reason": "the gap is bridged"}, True),
        ({"files": [1]}, False),
        ({"files": {"robots.csv": 1}}, False),
        ({"scores": [1]}, False),
        ({"scores": {"rmse_R": "<b>1"}}, False),
        ({"point": [1]}, False),
        ({"seed": "1"}, False),
        ({"status": "fine"}, False),
        ({"color": "red"}, False),
        ({"case": "../../../escaped"}, False),
        ({"case": "0-a"}, False),
    ],
)
def test_a_record_has_its_types_and_the_name_of_its_folder(damaged, change, believed):
    """A digest alone does not make a record."""
    path = damaged / "cases" / "1-a" / "case.json"
    content = json.loads(path.read_text()) | change | {"digest": ""}
    content["digest"] = sha256(json.dumps(content).encode()).hexdigest()
    path.write_text(f"{json.dumps(content, indent=1)}\n")

    assert (RunFolder(damaged).read_case("1-a") is not None) == believed


def test_a_record_without_a_digest_is_not_read(tiny, damaged):
    """Nothing shows that it is whole, so a run computes the case again."""
    path = damaged / "cases" / "1-a" / "case.json"
    content = json.loads(path.read_text())
    del content["digest"]
    path.write_text(json.dumps(content))

    assert RunFolder(damaged).read_case("1-a") is None
    assert study.run(tiny, damaged.parent, progress=Progress()).computed == 1
    assert RunFolder(damaged).read_case("1-a").is_current


def test_what_is_no_folder_of_a_case_is_replaced(tiny, tiny_run, damaged, tmp_path):
    """A file and a link to a folder do not count as cases; nothing is written through the link."""
    cases, other = damaged / "cases", tmp_path / "other"
    (cases / "1-a").rename(other)
    (cases / "1-a").symlink_to(other)
    shutil.rmtree(cases / "0-a")
    (cases / "0-a").write_text("stray")
    (other / "cost.json").unlink()
    (cases / "2-a" / "truth.csv").unlink()
    (cases / "2-a" / "truth.csv").symlink_to(tiny_run / "cases" / "2-a" / "truth.csv")

    again = study.run(tiny, tmp_path, progress=Progress())

    assert again.computed == 3
    assert not (other / "cost.json").exists()
    assert_same_bytes(damaged, tiny_run)
    assert not [path for path in damaged.rglob("*") if path.is_symlink()]
    assert not [*cases.glob(".*")]


@pytest.mark.parametrize(
    "text",
    ["[]", "null", '{"grow": 5}', '{"grow": {"wall_s": 1}}',
     '{"grow": {"wall_s": NaN, "cpu_s": 1, "peak_memory_MB": 1}}'],
)  # fmt: skip
def test_a_damaged_cost_is_unknown(tiny, damaged, text):
    """It neither stops a run nor makes it compute the case again."""
    (damaged / "cases" / "1-a" / "cost.json").write_text(text)
    (damaged / "manifest.json").write_text("[]")

    again = study.run(tiny, damaged.parent, progress=Progress())

    assert again.computed == 0
    assert RunFolder(damaged).read_cost("1-a") == {}
    assert json.loads((damaged / "manifest.json").read_text())["stages"]["grow"]["wall_s"] > 0.0


def test_nothing_is_locked_through_a_link(damaged, tmp_path):
    """Opening a lock would make the file that its link names."""
    (damaged / ".lock").unlink()
    (damaged / ".lock").symlink_to(tmp_path / "made")

    with pytest.raises(EnvironmentTroubleError, match="cannot be locked"):
        RunFolder(damaged).locked().__enter__()

    assert not (tmp_path / "made").exists()


def _flock(error=None):
    """Return a lock that excludes nobody, or that the file system refuses."""

    def flock(*_):
        if error is not None:
            raise OSError(error, os.strerror(error))

    return flock


def test_a_file_system_without_locks_takes_a_run(tiny, damaged, monkeypatch):
    """Network folders may have none; a note says what to avoid."""
    shutil.rmtree(damaged / "cases" / "1-a")
    monkeypatch.setattr(store.fcntl, "flock", _flock(errno.ENOLCK))
    progress = Recorder()

    again = study.run(tiny, damaged.parent, progress=progress)

    assert again.computed == 1
    note = f"{damaged}: no file locks here; start this run only once at a time"
    assert progress.lines.count(note) == 1


@pytest.mark.parametrize("moment", ["reopen", "_publish", "store_cost", "complete"])
def test_equal_runs_whose_locks_do_not_reach_each_other_store_the_same(
    tiny, tiny_run, tmp_path, monkeypatch, moment
):
    """Another node computes the whole run while this one is about to write."""
    monkeypatch.setattr(store.fcntl, "flock", _flock())
    method, found = getattr(RunFolder, moment), []

    def with_another_run(folder, *arguments, **settings):
        if not found:
            found.append(None)
            found.append(study.run(tiny, tmp_path, progress=Progress()))
        return method(folder, *arguments, **settings)

    monkeypatch.setattr(RunFolder, moment, with_another_run)

    mine = study.run(tiny, tmp_path, progress=Progress())

    assert not mine.failed
    assert not found[1].failed
    assert_same_results(tiny_run, mine.folder)
    assert json.loads((mine.folder / "manifest.json").read_text())["cases"] == 3


def test_what_a_living_process_writes_is_left_alone(damaged):
    """Of this machine, processes are looked up; of others, nothing stays untouched for an hour."""
    gone = subprocess.Popen([sys.executable, "-I", "-S", "-c", ""])
    gone.wait()
    host, _, here, end = path_for(Path("0-a"), "part").name.split(".")[2].split("-")
    writers = {
        "mine": f"{host}-{os.getpid()}-{here}-{end}",
        "with my number": f"{host}-{os.getpid()}-{end}-{end}",
        "alive": f"{host}-{os.getppid()}-{end}-{end}",
        "gone": f"{host}-{gone.pid}-{end}-{end}",
        "elsewhere": f"{'0' * 6}-1-{end}-{end}",
        "long gone elsewhere": f"{'0' * 6}-2-{end}-{end}",
    }
    paths = {who: damaged / "cases" / f".{who}.{name}.part" for who, name in writers.items()}
    for path in paths.values():
        path.mkdir()
    os.utime(paths["long gone elsewhere"], (0.0, 0.0))

    with RunFolder(damaged).locked():
        pass

    assert {who for who, path in paths.items() if path.exists()} == {"mine", "alive", "elsewhere"}


def test_a_report_names_what_it_lacks(damaged):
    """Tables without damaged cases say so, and are not emptied if all are damaged."""
    progress = Recorder()
    (damaged / "cases" / "1-a" / "case.json").write_text("{}")

    study.tabulate(damaged, progress)

    assert progress.lines == [
        "without 1 case, missing or damaged; run the scenario again to restore"
    ]
    summary = (damaged / "summary.csv").read_bytes()
    shutil.rmtree(damaged / "cases")
    with pytest.raises(InputError, match="no case of this run is intact; run the scenario again"):
        study.tabulate(damaged, progress)
    assert (damaged / "summary.csv").read_bytes() == summary


def test_a_run_that_was_killed_at_its_end_is_made_whole(tmp_path, monkeypatch):
    """All cases were stored, but neither all costs nor the manifest."""
    small = load_scenario(REPOSITORY / "tests" / "tower.yaml", ["robots=6", "seeds=1"])
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
    [case] = plan(scenario).cases[:1]
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
        patched.setattr(store, "structure_code", lambda *_: "0123456789ab")
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
