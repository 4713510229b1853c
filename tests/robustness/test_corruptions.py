"""Any damage to a finished run is seen, and the same command restores the same bytes."""

import json
import shutil
from pathlib import Path

import pytest

from tests.robustness.mutations import damaged
from tests.runs import assert_same_bytes, run_tower
from tiswarm.study.store import RunFolder

pytestmark = pytest.mark.slow

SMALL = ("robots=6", "seeds=3", "conditions={a: {}, b: {localization.iterations: 20}}")
RESTORED_EVERY = 40
"""To compute a case again takes a hundred times as long as to read it."""


@pytest.fixture
def finished(tmp_path) -> Path:
    """Folder of a finished run, to damage."""
    return run_tower(tmp_path / "damaged", SMALL).folder


@pytest.fixture
def whole(finished, tmp_path) -> Path:
    """Copy of the finished run."""
    return shutil.copytree(finished, tmp_path / "whole" / finished.name)


def _damage(random, path: Path, other: Path) -> str:
    """Damage a file, or put the one of another case in its place; return how."""
    kind = random.choice(["damaged"] * 8 + ["missing", "of another case"])
    if kind == "missing":
        path.unlink()
    elif kind == "of another case":
        shutil.copy(other, path)
    else:
        path.write_bytes(damaged(random, path.read_bytes()))
    return f"{path} is {kind}"


def _is_damaged(path: Path, sound: Path) -> bool:
    """Return whether a file has other bytes, or a record other content: white space is none."""
    if not path.exists():
        return True
    found, expected = path.read_bytes(), sound.read_bytes()
    if path.name != "case.json":
        return found != expected
    try:
        return json.loads(found) != json.loads(expected)
    except ValueError:
        return True


def test_each_damage_to_a_finished_case_is_seen_and_mended(trial, finished, whole):
    """A case with a damaged file, or under the name of another, is computed again, as it was."""
    folder = RunFolder(finished)
    names = [case.name for case in sorted(folder.cases.iterdir())]
    for number in trial.numbers(2500):
        random = trial.random(number)
        name, other = random.sample(names, 2)
        case, sound = folder.cases / name, whole / "cases" / name
        path = random.choice([file for file in sorted(case.iterdir()) if file.name != "cost.json"])
        if random.random() < 0.02:
            shutil.rmtree(case)
            shutil.copytree(whole / "cases" / other, case)
            what = f"{case} is {other}"
        else:
            what = _damage(random, path, whole / "cases" / other / path.name)
        if _is_damaged(path, sound / path.name):
            with trial.attempt(number, path, what=what):
                record = folder.read_case(name)
                assert record is None or not record.is_current
                if number % RESTORED_EVERY == 0:
                    assert run_tower(finished.parent, SMALL).computed == 1
                    assert_same_bytes(finished, whole)
                trial.outcomes["seen and mended" if number % RESTORED_EVERY == 0 else "seen"] += 1
        shutil.rmtree(case)
        shutil.copytree(sound, case)

    assert trial.failures == []


def test_damage_to_all_else_in_a_finished_run_is_mended(trial, finished, whole):
    """Tables and scenario are as before; the manifest is whole, a damaged cost is unknown."""
    files = [file for file in sorted(finished.rglob("[!.]*")) if file.is_file()]
    files = [file for file in files if file.parent == finished or file.name == "cost.json"]
    for number in trial.numbers(60):
        random = trial.random(number)
        path, other = random.sample(files, 2)
        sound = path.read_bytes()
        what = _damage(random, path, other)
        with trial.attempt(number, path, what=what):
            assert run_tower(finished.parent, SMALL).computed == 0
            assert_same_bytes(finished, whole)
            if path.name == "manifest.json":
                assert json.loads(path.read_bytes()).keys() == json.loads(sound).keys()
            trial.outcomes[path.name] += 1
        path.write_bytes(sound)

    assert trial.failures == []
