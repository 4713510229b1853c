"""Drawings of a run: drawn once, and again where one is missing, damaged or outdated."""

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.runs import assert_same_results
from tiswarm.app import doctor, drawing
from tiswarm.app.drawing import draw_all
from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.base.progress import Progress
from tiswarm.records.io import digest
from tiswarm.records.run_folder import read_manifest, write_manifest
from tiswarm.report.pictures import pictures
from tiswarm.report.pictures.pictures import Rendered
from tiswarm.report.run_data import load_run
from tiswarm.study.run import RunResult
from tiswarm.study.store import RunFolder


@pytest.fixture
def result(small_run, tmp_path):
    """A finished and drawn run, as the same command finds it."""
    folder = Path(shutil.copytree(small_run, tmp_path / small_run.name))
    return RunResult(folder=folder, computed=0, found=6, failed=(), missing=0)


@pytest.fixture
def drawn(monkeypatch):
    """Gathers the options of each call that draws."""
    calls = []
    monkeypatch.setattr(drawing, "draw", lambda _run, _progress, **options: calls.append(options))
    return calls


def test_a_whole_run_is_not_drawn_again(result, drawn):
    """Digests in the manifest show that nothing is missing."""
    draw_all(result, Progress())

    assert drawn == []


@pytest.mark.parametrize(
    "name", ["figures/accuracy.png", "renders/error.png", "report.html", "table.csv"]
)
@pytest.mark.parametrize("damage", ["delete", "cut", "link"])
def test_a_damaged_run_is_drawn_again(result, drawn, name, damage):
    """One missing, damaged or linked file is enough, and so is a table that was written anew."""
    path = result.folder / name
    data = path.read_bytes()
    path.unlink()
    if damage == "cut":
        path.write_bytes(data[: len(data) // 2])
    elif damage == "link":
        path.with_name("other").write_bytes(data)
        path.symlink_to("other")

    draw_all(result, Progress())

    assert [(call["figures"], call["renders"]) for call in drawn] == [(True, True)]


def test_a_run_that_was_only_animated_is_drawn(result, drawn):
    """`--no-pictures --animate` writes a page, which lacks the pictures."""
    manifest = json.loads((result.folder / "manifest.json").read_text())
    page = {"report.html": manifest["drawn"]["report.html"]}
    (result.folder / "manifest.json").write_text(json.dumps(manifest | {"drawn": page}))

    draw_all(result, Progress(), pictures=False)
    assert drawn == []
    draw_all(result, Progress())
    assert len(drawn) == 1


def test_the_same_command_restores_all_drawings(small_run, result, monkeypatch):
    """All return to the same bytes; afterwards nothing is drawn. Copies stand for renders."""

    def render(run, **_):
        paths = [run.subfolder("renders") / path.name for path in small_run.glob("renders/*")]
        for path in paths:
            shutil.copy(small_run / "renders" / path.name, path)
        return [Rendered(path=path, renderer="open3d", reason="") for path in paths]

    monkeypatch.setattr(pictures, "render_run", render)
    (result.folder / "figures" / "accuracy.png").unlink()
    (result.folder / "renders" / "error.png").write_bytes(b"\x89PNG")
    (result.folder / "report.html").write_text("<html>")

    draw_all(result, Progress())

    assert_same_results(result.folder, small_run)
    assert "renders/error.png" in (result.folder / "report.html").read_text()
    assert len(read_manifest(result.folder).renders) == 6
    monkeypatch.delattr(drawing, "draw")
    draw_all(result, Progress())


@pytest.mark.parametrize("killed", [False, True])
def test_figures_that_a_run_no_longer_has_are_removed(result, killed):
    """They show what the run had; figures of the user stay, and so do those that a user changed."""
    folder, manifest = result.folder, read_manifest(result.folder)
    stale, changed, mine = (folder / "figures" / f"{name}.pdf" for name in ("old", "own", "mine"))
    for path in (stale, changed, mine):
        path.write_bytes(b"a figure of an earlier call")
    drawn = {f"figures/{path.name}": digest(path) for path in (stale, changed)}
    changed.write_bytes(b"with a note of the user")
    write_manifest(folder, replace(manifest, drawn={**manifest.drawn, **drawn}))
    if killed:  # the next run starts with the manifest of one that was killed as it began to draw
        write_manifest(folder, replace(manifest, drawn={}, outdated=drawn))

    drawing.draw(load_run(folder), Progress(), figures=True)

    assert not stale.exists()
    assert changed.read_bytes() == b"with a note of the user"
    assert mine.read_bytes() == b"a figure of an earlier call"
    names = {path.name for path in (folder / "figures").iterdir()} - {"own.pdf", "mine.pdf"}
    assert {name for name in read_manifest(folder).ever_drawn if name.startswith("figures/")} == {
        f"figures/{name}" for name in names
    }


def test_a_run_that_goes_on_knows_its_earlier_figures(result):
    """Cases of other code are computed, and figures drawn anew, beside those of earlier ones."""
    drawn = read_manifest(result.folder).drawn

    RunFolder(result.folder).reopen(Progress(), computes=True)

    assert read_manifest(result.folder).outdated == drawn
    assert read_manifest(result.folder).drawn == {}


@pytest.mark.parametrize(
    ("chosen", "problem"), [({"case": "0-b"}, "no case '0-b'"), ({"renderer": "x"}, "unknown rend")]
)
def test_a_wrong_choice_is_refused_before_anything_is_drawn(result, monkeypatch, chosen, problem):
    """Figures were drawn again until then."""
    drawn = []
    monkeypatch.setattr(drawing, "draw_figures", lambda *_, **__: drawn.append("figures") or [])

    with pytest.raises(InputError, match=problem):
        drawing.draw(load_run(result.folder), Progress(), figures=True, renders=True, **chosen)

    assert drawn == []


@pytest.fixture
def no_open3d(monkeypatch):
    """An installation without the extra open3d."""
    monkeypatch.setitem(sys.modules, "open3d", None)


def test_commands_that_draw_work_without_open3d(tiswarm, no_open3d, tmp_path):
    """The other renderer draws, and a line says why, and what installs open3d."""
    small = ("--set", "robots=5", "--set", "seeds=1", "--out", tmp_path)

    ran = tiswarm("run", "tests/tower.yaml", *small)
    [run] = tmp_path.glob("tower-*")
    (run / "renders" / "structure.png").unlink()
    redrawn = tiswarm("redraw", run)
    log = next(run.glob("cases/*/sensing.jsonl*"))
    page = tmp_path / "view.html"
    localized = tiswarm("localize", log, "--report", page, "--out", tmp_path / "estimate.csv")

    reason = "(open3d: not installed; pip install 'tiswarm[open3d]' adds it)"
    for done in (ran, redrawn):
        assert done.returncode == 0, done.stderr
        said = (done.stdout + done.stderr).splitlines()
        assert said.count(f"drawn by taichi {reason}") == 1
    assert (run / "renders" / "structure.png").exists()
    assert localized.returncode == 0, localized.stderr
    assert page.exists()


def test_a_renderer_that_is_asked_for_and_not_installed_is_named_with_its_extra(no_open3d):
    """`tiswarm doctor` prints this line."""
    with pytest.raises(EnvironmentTroubleError) as refusal:
        doctor.draw_test_picture("open3d")

    assert str(refusal.value) == (
        "cannot draw with open3d: not installed; pip install 'tiswarm[open3d]' adds it"
    )
