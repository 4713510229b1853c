"""Pictures are drawn by the best renderer that works, and name it."""

import builtins
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tests.report.conftest import is_blank, write_case, write_summary
from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.base.progress import Progress
from tiswarm.report.pictures import raycast
from tiswarm.report.pictures.pictures import (
    build_extremes,
    build_pictures,
    build_sizes,
    draw_side_by_side,
    render_run,
)
from tiswarm.report.pictures.raycast import draw_scenes, on_white
from tiswarm.report.run_data import load_run
from tiswarm.report.swarm_view import read_case_view

PICTURES = ["structure", "truth-and-estimate", "error", "sensed-force", "contact-graph"]


@pytest.fixture
def scene(run_folder):
    """Twelve robots, to be drawn small."""
    return build_pictures(read_case_view(load_run(run_folder).cases[0]))["structure"].scene.within(
        365, 365
    )


@pytest.mark.parametrize(("wrong", "ghosts", "rods"), [(0, 0, 0), (3, 3, 0), (12, 0, 12)])
def test_true_robots_are_drawn_where_the_error_is_seen(run_folder, wrong, ghosts, rods):
    """Of many wrong robots, translucent ones hid each other."""
    view = read_case_view(load_run(run_folder).cases[0])
    error = np.where(np.arange(12) < wrong, 2.0, 0.0)
    moved = view.pose.copy()
    moved[:, 0] += error

    scene = build_pictures(replace(view, error=error, estimated_pose=moved))[
        "truth-and-estimate"
    ].scene

    assert (0 if scene.ghost is None else len(scene.ghost.radius) / 7) == ghosts
    apart = np.linalg.norm(scene.end - scene.start, axis=1)
    assert np.isclose(apart, 2.0).sum() == rods


@pytest.mark.parametrize("wrong", [0, 12])
def test_robots_that_left_are_in_no_picture(run_folder, wrong):
    """They have no pose, and their missing errors make nobody else's ghosts balls."""
    view = read_case_view(load_run(run_folder).cases[0])
    left, stays = np.arange(5, 12), 5
    pose, moved = view.pose.copy(), view.pose.copy()
    error = np.where(np.arange(12) < wrong, 2.0, 0.0)
    moved[:, 0] += error
    pose[left], moved[left], error[left] = np.nan, np.nan, np.nan

    pictures = build_pictures(replace(view, pose=pose, error=error, estimated_pose=moved))

    balls = {name: _balls(picture.scene) for name, picture in pictures.items()}
    docks = len(view.dock_offset_body)
    assert balls["structure"] == stays * (1 + docks)
    assert balls["truth-and-estimate"] == (2 * stays * 3 if wrong else stays * (1 + docks))
    assert balls["contact-graph"] == stays * 3
    for picture in pictures.values():
        assert np.isfinite(picture.scene.camera.eye).all()
        assert np.isfinite(picture.scene.start).all()
        assert np.isfinite(picture.scene.end).all()
    assert pictures["truth-and-estimate"].scene.ghost is None


def _balls(scene):
    """Count capsules without length: hubs and docks, and of a node its arm too."""
    return int((scene.start == scene.end).all(axis=1).sum())


@pytest.fixture
def broken_open3d(monkeypatch):
    """A machine that lacks a system library which open3d loads."""
    imported = builtins.__import__

    def refuse(name, *rest):
        if name == "open3d":
            message = "libodd.so.1: cannot open shared object file"
            raise ImportError(message)
        return imported(name, *rest)

    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    monkeypatch.setattr(builtins, "__import__", refuse)


def test_the_next_renderer_steps_in(run_folder, broken_open3d):
    """Without open3d, our own kernel draws, and the reason names the remedy."""
    drawn = render_run(load_run(run_folder), progress=Progress())

    assert [picture.path.stem for picture in drawn] == PICTURES
    for picture in drawn:
        assert picture.renderer == "taichi"
        assert picture.reason == (
            "open3d: libodd.so.1: cannot open shared object file; "
            "`tiswarm doctor` names what to install"
        )
        with Image.open(picture.path) as image:
            assert not is_blank(image)


def test_an_open3d_that_crashes_does_not_end_the_run(scene, tmp_path, monkeypatch):
    """It ended runs with status 134 and without a word; one that works is tried once."""
    library = tmp_path / "open3d"
    library.mkdir()
    (library / "__init__.py").write_text("import os; os.abort()\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setitem(sys.modules, "open3d", None)  # undone in the end
    del sys.modules["open3d"]
    raycast.try_in_child.cache_clear()

    _, renderer, reason = draw_scenes([scene])
    (library / "__init__.py").write_text("works = True\n")
    found = raycast.import_open3d()
    del sys.modules["open3d"]
    raycast.try_in_child.cache_clear()
    monkeypatch.setattr(raycast, "child_command", lambda _: ["false"])
    again = raycast.import_open3d()

    assert renderer == "taichi"
    assert reason.startswith("open3d: its import crashes with SIGABRT; `tiswarm doctor`")
    assert found.works
    assert again.works
    assert len([*(tmp_path / "cache" / "tiswarm" / "kernels" / "open3d").iterdir()]) == 1


def test_open3d_imports_web_servers_when_they_are_called(tmp_path, monkeypatch):
    """They bring dash, plotly and IPython, three quarters of the time of its import."""
    folder, name = tmp_path / "open3d" / "visualization", "open3d.visualization"
    folder.mkdir(parents=True)
    (tmp_path / "open3d" / "__init__.py").write_text(f"import {name}\n")
    (folder / "__init__.py").write_text("from .draw_plotly import draw_plotly\n")
    (folder / "draw_plotly.py").write_text("def draw_plotly(shown):\n    return [shown]\n")
    monkeypatch.syspath_prepend(tmp_path)
    for module in ("open3d", name, web := f"{name}.draw_plotly"):
        monkeypatch.setitem(sys.modules, module, None)  # undone in the end
        del sys.modules[module]

    found = raycast.load_open3d()
    is_loaded = web in sys.modules
    drawn = [found.visualization.draw_plotly(mesh) for mesh in "ab"]

    assert not is_loaded
    assert drawn == [["a"], ["b"]]
    assert web in sys.modules


def test_open3d_imports_data_sets_when_they_are_used(tmp_path, monkeypatch):
    """They bring scikit-learn, more than half of the time that is left."""
    data_sets = "open3d._ml3d.datasets"
    for folder in ("ml", "_ml3d"):
        (tmp_path / "open3d" / folder).mkdir(parents=True)
    (tmp_path / "open3d" / "__init__.py").write_text("import open3d.ml\n")
    (tmp_path / "open3d" / "ml" / "__init__.py").write_text("from . import datasets\n")
    (tmp_path / "open3d" / "ml" / "datasets.py").write_text(f"from {data_sets} import *\n")
    (tmp_path / "open3d" / "_ml3d" / "__init__.py").touch()
    (tmp_path / "open3d" / "_ml3d" / "datasets.py").write_text("class KITTI:\n    pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    for module in ("open3d", "open3d.ml", "open3d.ml.datasets", "open3d._ml3d", data_sets):
        monkeypatch.setitem(sys.modules, module, None)  # undone in the end
        del sys.modules[module]

    found = raycast.load_open3d()
    is_loaded = data_sets in sys.modules

    assert not is_loaded
    assert found.ml.datasets.KITTI.__module__ == data_sets
    with pytest.raises(AttributeError, match="no attribute 'Mars'"):
        _ = found.ml.datasets.Mars


def test_a_chosen_renderer_is_not_replaced(run_folder, broken_open3d):
    """It fails with advice, and nothing is drawn."""
    with pytest.raises(EnvironmentTroubleError, match=r"libodd\.so\.1.*`tiswarm doctor`"):
        render_run(load_run(run_folder), progress=Progress(), renderer="open3d")

    assert not [*run_folder.glob("renders/*")]


@pytest.mark.parametrize(
    ("choice", "problem"),
    [
        ({"renderer": "povray"}, "unknown renderer: povray; use one of open3d, taichi"),
        ({"renderer": "open3d-raycast"}, "open3d casts rays now; use one of open3d, taichi"),
        ({"case": "1-no-z"}, "choose one of 0-baseline, 1-baseline, 0-no-z"),
    ],
)
def test_an_unknown_choice_is_refused(run_folder, choice, problem):
    """The message lists what there is; a failed case is not among it."""
    with pytest.raises(InputError, match=problem):
        render_run(load_run(run_folder), progress=Progress(), **choice)


def test_pictures_of_a_chosen_case_carry_its_name(run_folder):
    """They do not overwrite the pictures of the run."""
    drawn = render_run(load_run(run_folder), progress=Progress(), renderer="taichi", case="0-no-z")

    assert all(picture.path.name.endswith("-0-no-z.png") for picture in drawn)


def test_a_picture_lets_the_page_through(scene):
    """Robots are opaque, the ground is a film, and nothing else is there: dark pages stay dark."""
    [picture] = draw_scenes([scene], "taichi")[0]

    opacity = picture[..., 3]
    assert opacity[0, 0] == 0
    assert np.count_nonzero(opacity == 255) > 0.05 * opacity.size
    bright = on_white(picture)[opacity == opacity[opacity > 0].min()]
    assert bright.min() > 230  # the ground fades into a white page
    on_black = picture[..., :3] * (opacity[..., None] / 255.0)
    film = (opacity > 10) & (opacity < 245)
    assert np.median(on_black[film]) < 40  # and into a black one


def test_both_renderers_draw_the_same_picture(scene):
    """Camera and colors are equal; only outlines differ by a fraction of a pixel."""
    reference = draw_scenes([scene], "taichi")[0][0].astype(float)
    try:
        picture = draw_scenes([scene], "open3d")[0][0]
    except EnvironmentTroubleError as error:
        pytest.skip(str(error))

    difference = np.abs(picture - reference).mean(axis=2)
    assert difference.mean() < 2.0
    assert (difference > 60.0).mean() < 0.01


def test_every_size_of_a_study_is_in_one_picture(tmp_path):
    """Sizes stand side by side at one scale; other conditions and failed cases are left out."""
    rows = [
        ["0-small", "done", "paper", "robots=4", 4],
        ["0-large", "done", "paper", "robots=12", 12],
        ["0-other", "done", "joint", "robots=9", 9],
    ]
    for name, *_ in rows:
        write_case(tmp_path / "cases" / name, seed=0)
    robots = tmp_path / "cases" / "0-small" / "robots.csv"
    robots.write_text("".join(robots.read_text().splitlines(keepends=True)[:5]))
    write_summary(tmp_path, "case,status,condition,point,robots", rows)
    run = load_run(tmp_path)
    assert build_sizes(run, run.choose(None))[0] == []  # structures ended at different sizes
    (tmp_path / "scaling.csv").touch()

    sizes, greatest = build_sizes(run, run.choose(None))

    assert [size.label.split("\n")[0] for size in sizes] == ["4 robots", "12 robots"]
    assert greatest > 0.0
    picture = draw_side_by_side(sizes, "taichi")
    assert not is_blank(picture)
    assert picture.width > picture.height


def test_the_best_condition_stands_beside_the_weakest(tmp_path):
    """All pictures of a study showed the worst of its twelve cases, and no reader knew."""
    header = "case,status,condition,series,point,rmse_R"
    rows = [
        ["0-a", "done", "a", "a", "", 3.0],
        ["0-b", "done", "b", "b", "", 1.0],
        ["0-c", "done", "c", "c", "", 2.0],
        ["1-d", "done", "d", "d", "", 0.1],  # another structure
        ["0-e", "failed", "e", "e", "", ""],
    ]
    for place, (name, *_) in enumerate(rows):
        write_case(tmp_path / "cases" / name, seed=place)
    write_summary(tmp_path, header, rows)
    run = load_run(tmp_path)

    tiles, greatest = build_extremes(run, run.choose("0-c"))

    assert [tile.label.split("\n")[0] for tile in tiles] == ["b", "a"]
    errors = [read_case_view(run.choose(name)).error.max() for name in ("0-a", "0-b")]
    assert greatest == max(errors)
    assert not is_blank(draw_side_by_side(tiles, "taichi"))
    assert build_extremes(run, run.choose("1-d")) == ([], 0.0)


def test_scenes_that_share_their_rays_look_as_if_drawn_alone(scene):
    """The second picture of the same capsules differs by its colors alone."""
    recolored = replace(scene, color=scene.color[::-1].copy())

    together = draw_scenes([scene, recolored], "taichi")[0]

    for picture, one in zip(together, [scene, recolored], strict=True):
        np.testing.assert_array_equal(picture, draw_scenes([one], "taichi")[0][0])
    assert (together[0] != together[1]).any()
