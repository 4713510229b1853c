"""Animations show the growth of a structure, and figures exist as vectors too."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import tiswarm
from tiswarm.base.errors import EnvironmentTroubleError
from tiswarm.base.progress import Progress
from tiswarm.report.figures import draw_figures
from tiswarm.report.pictures import pictures
from tiswarm.report.pictures.pictures import (
    FRAME_MS,
    LAST_MS,
    animate_run,
    best_movie,
    draw_states,
)
from tiswarm.report.pictures.raycast import draw_scenes, on_white
from tiswarm.report.pictures.scene import TRUE_SIZE, build_scene
from tiswarm.report.run_data import load_run
from tiswarm.report.swarm_view import read_case_view


def colored(frame):
    """How many pixels show a robot: the ground and the paper are gray."""
    pixels = np.asarray(frame.convert("RGB")).astype(int)
    below_legend = pixels[40:]
    return int((np.ptp(below_legend, axis=2) > 40).sum())


def test_robots_appear_one_after_the_other_and_stay(run_folder):
    """Twelve frames of twelve robots, under one camera; the last is shown for longest."""
    drawn = animate_run(load_run(run_folder), "gif", progress=Progress(), renderer="taichi")

    with Image.open(drawn.path) as movie:
        seen, shown = [], []
        for frame in range(movie.n_frames):
            movie.seek(frame)
            seen.append(colored(movie))
            shown.append(movie.info["duration"])
    assert drawn.path.name == "growth.gif"
    assert len(seen) == 12
    assert (np.diff(seen) > 0).all()
    assert seen[0] == pytest.approx(seen[-1] / 12, rel=0.5)
    assert max(shown) == shown[-1] == LAST_MS


def test_frames_look_as_if_each_were_drawn_alone(run_folder):
    """Only what robots change that join or leave is drawn again, and nobody sees it."""
    view = read_case_view(load_run(run_folder).cases[0])
    robots = view.robots(view.pose, view.color_by_join, TRUE_SIZE)
    states = [np.arange(3), np.arange(7), np.delete(np.arange(12), [2, 5, 11])]

    frames, _, _ = draw_states(robots, view.terrain, states, (300, 300), "taichi")

    around = robots.dock.reshape(-1, 3)
    camera = build_scene(robots, view.terrain).within(300, 300).camera
    for shown, frame in zip(states, frames, strict=True):
        part = replace(
            robots, center=robots.center[shown], dock=robots.dock[shown],
            color=robots.color[shown],
        )  # fmt: skip
        scene = build_scene(part, view.terrain, around=around).seen_by(camera)
        (alone,), _, _ = draw_scenes([scene], "taichi")
        off = np.abs(on_white(frame).astype(int) - on_white(alone))
        assert (off.max(axis=2) > 12).mean() < 0.01  # 5 % of the brightness, on edges of light


def test_robots_that_leave_vanish(monkeypatch, tmp_path):
    """The film shows a robot from its join until it leaves or falls, and counts those that left."""
    tower = {"kind": "tower", "departures": {"rate": 0.3}}
    [grown] = tiswarm.grow(tower, robots=15, seeds=[1], quiet=True)
    events = grown.history.departures.tolist()
    scenes = []

    def draw(given, *_):
        scenes.extend(given)
        return [np.zeros((40, 600, 4), np.uint8)] * len(given), "", ""

    monkeypatch.setattr(pictures, "draw_growth", draw)
    monkeypatch.setattr(pictures, "render_view", lambda *_: ({}, "", ""))

    grown.render(tmp_path, movie="gif", quiet=True)

    assert (len(events) > 2, len(scenes)) == (True, 15)
    for n, scene in enumerate(scenes, start=1):
        gone = [robot for robot, after, _ in events if after <= n]
        assert len({*map(tuple, scene.color)}) == 2 * (n - len(gone))  # of docks, and of arms


def test_without_a_video_library_the_best_movie_is_a_webp(run_folder, monkeypatch):
    """Every browser shows it, and it has all colors."""
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)

    form = best_movie()
    drawn = animate_run(load_run(run_folder), form, progress=Progress(), renderer="taichi")

    with Image.open(drawn.path) as movie:
        assert (movie.format, movie.n_frames) == ("WEBP", 12)
        assert movie.width <= 960


@pytest.mark.parametrize("form", ["webp", "gif"])
def test_a_page_in_the_dark_shows_through_a_webp_alone(run_folder, form):
    """Its pixels can be half transparent; other films are on white."""
    drawn = animate_run(load_run(run_folder), form, progress=Progress(), renderer="taichi")

    with Image.open(drawn.path) as movie:
        for frame in (0, 11):
            movie.seek(frame)
            pixels = np.asarray(movie.convert("RGBA"))
            corner = pixels[pixels.shape[0] // 4, 0]  # above the ground
            if form == "webp":
                assert (corner[3], pixels[..., 3].max()) == (0, 255)
            else:
                assert corner.tolist() == [255] * 4


@pytest.mark.trial
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # its reader leaks
def test_a_movie_for_slides_holds_the_same(run_folder):
    """MP4 is read back frame by frame by the library that wrote it."""
    iio = pytest.importorskip("imageio.v3")

    drawn = animate_run(
        load_run(run_folder), "mp4", progress=Progress(), renderer="taichi", case="0-no-z"
    )

    frames = iio.imread(drawn.path)
    assert drawn.path.name == "growth-0-no-z.mp4"
    assert len(frames) == 12 + LAST_MS // FRAME_MS
    assert colored(Image.fromarray(frames[11])) > 5 * colored(Image.fromarray(frames[0]))


def test_a_movie_without_its_library_is_refused(run_folder, monkeypatch):
    """The message says what to install."""
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)

    with pytest.raises(EnvironmentTroubleError, match=r"tiswarm\[video\]"):
        animate_run(load_run(run_folder), "mp4", progress=Progress(), renderer="taichi")


def test_vector_figures_hold_the_same_bytes_each_time(run_folder):
    """There is one PDF for each PNG, and it does not contain the time."""
    first = [
        path.read_bytes() for path in draw_figures(load_run(run_folder), Progress(), vector=True)
    ]

    pdfs = sorted(run_folder.glob("figures/*.pdf"))
    assert [path.stem for path in pdfs] == ["convergence", "error-against-height"]
    assert all(path.read_bytes().startswith(b"%PDF") for path in pdfs)
    assert all(b"CreationDate" not in path.read_bytes() for path in pdfs)
    assert [
        p.read_bytes() for p in draw_figures(load_run(run_folder), Progress(), vector=True)
    ] == first
