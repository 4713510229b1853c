"""Draws the pictures of the README into docs/images.

for kind in tower cantilever bridge chain; do tiswarm run scenarios/$kind.yaml --set seeds=1; done
python -m benchmarks.images reports/tower-* reports/cantilever-* reports/bridge-* reports/chain-*

`python -m benchmarks.images --large` grows a tower of 10,000 robots, and draws picture and film. It
takes some five minutes of processor time.
`python -m benchmarks.images --grounds reports/terrain-*` draws a structure on each ground alone.
`python -m benchmarks.images --repair repair.py` draws only the film of robots that leave, with the
rule of docs/guides/repair.md in that file.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import tiswarm
from tiswarm.base.aliases import Reals
from tiswarm.base.robot import RobotGeometry
from tiswarm.compute import backend
from tiswarm.compute.math import dock_offsets
from tiswarm.records.messages import three_digits
from tiswarm.records.terrain import Terrain
from tiswarm.report.figure_style import ERROR_COLORS, FORCE_COLORS, JOIN_COLORS, colors_along
from tiswarm.report.pictures.pictures import (
    FRAME_MS,
    INK,
    LAST_MS,
    NOTHING,
    Keys,
    Scale,
    Tile,
    add_legend,
    build_pictures,
    draw_side_by_side,
    draw_states,
    encode_webp,
)
from tiswarm.report.pictures.raycast import Pixels, draw_scenes
from tiswarm.report.pictures.scene import TRUE_SIZE, Camera, build_scene
from tiswarm.report.run_data import RunData, StoredCase, load_run
from tiswarm.report.swarm_view import DrawnRobots, SwarmView, read_case_view

_IMAGES = Path("docs/images")
_COMPARED = {"joint": "joint", "algorithm-1": "Algorithm 1 of the paper"}
"""Conditions of the tower with equal measurements, and what the picture calls them."""

_IN_FILM = {
    "joint-with-walks": "joint / walk contacts",
    "algorithm-1": "Algorithm 1 / final contacts",
}
"""Conditions of the tower in its film, each with all measurements that its method takes."""

_WIDTH = 1200  # [pixels]
_FRAMES = 58
_FRAME = (420, 480)  # most columns and rows of a structure in the animation [pixels]
_BELOW = 64  # rows for its title [pixels]
_QUALITY = 70
_ROBOTS, _LEFT_SEED = 100, 0
"""Size and seed of the structure that loses robots."""
_LARGE_TOWER = {
    "kind": "tower", "goal_height": 340.0, "force_threshold": 200.0, "climb": {"patience": 64},
    "movers": 100, "solve_every": 200, "mechanics": {"model": "rigid"},
}  # fmt: skip
"""Settings of the large structure. At the default force threshold it would be a heap."""
_LARGE_STAGES = (500, 4_500, 10_000)
"""Robots of the structures in its picture, which begin alike."""
_LARGE_SEED = 1
_LARGE_FRAME = (1200, 1000)
_LARGE_FRAMES = 60
_FIRST_FRAME = 10  # robots in the first frame of its film
_LOAD_COLORS = ("#3d2f7a", "#8a2f8f", "#d8456c", "#f98e52", "#fde3a0")
"""From a small load to the greatest: a glow that stands out on white and on dark pages."""
_CLOSE = 430  # width of the picture of single robots [pixels]
_CLOSE_RADIUS = 7.5  # distance within which robots are in it [R]
_BAR = 100.0  # length of the bar that shows the scale [R]


def draw_methods(run: RunData, renderer: str) -> Image.Image:
    """Draw the truth and the estimates of two methods of the first structure."""
    tiles: list[Tile] = []
    keys: Keys | Scale = ()
    for condition, title in _COMPARED.items():
        view = read_case_view(_case_of(run, condition))
        picture = build_pictures(view)["truth-and-estimate"]
        keys = picture.legend
        rmse = three_digits(float(np.sqrt(np.nanmean(view.error**2))))
        level = np.array([*view.pose[:, :2].mean(axis=0), 0.0])
        tiles.append(Tile(picture.scene, level, f"{title}\nRMSE {rmse} R"))
    return add_legend(draw_side_by_side(tiles, renderer), keys)


def draw_growing(run: RunData, renderer: str) -> bytes:
    """Animate the first structure beside the estimates of two methods, as WebP."""
    views = [read_case_view(_case_of(run, condition)) for condition in _IN_FILM]
    truth = views[0].robots(views[0].pose, views[0].color_by_join, TRUE_SIZE)
    greatest = max(float(np.nanmax(view.error)) for view in views)
    columns = [("true structure", truth)]
    for view, title in zip(views, _IN_FILM.values(), strict=True):
        color = colors_along(np.nan_to_num(view.error) / greatest, ERROR_COLORS)
        columns.append((title, view.robots(view.estimated_pose, color, TRUE_SIZE)))
    around = np.concatenate([robots.dock.reshape(-1, 3) for _, robots in columns])
    joined = np.linspace(1, len(views[0].pose), _FRAMES).round().astype(int).tolist()
    drawn = [
        draw_states(
            robots, views[0].terrain, [*map(np.arange, joined)], _FRAME, renderer, around=around
        )[0]
        for _, robots in columns
    ]
    legend = Scale(ERROR_COLORS, "error [R]  0", f"{three_digits(greatest)}")
    frames = []
    for count, *pictures in zip(joined, *drawn, strict=True):
        errors = [np.nan, *(float(np.sqrt(np.mean(v.error[:count] ** 2))) for v in views)]
        titles = [title for title, _ in columns]
        frames.append(_beside(pictures, titles, errors, legend))
    durations = [FRAME_MS] * (len(frames) - 1) + [LAST_MS]
    return encode_webp(frames, durations, _QUALITY)


def draw_large(renderer: str) -> tuple[Image.Image, bytes]:
    """Draw stages of a large structure colored by load, and animate its growth as WebP."""
    stages = [
        tiswarm.grow(_LARGE_TOWER, robots=count, seeds=[_LARGE_SEED])[0] for count in _LARGE_STAGES
    ]
    return _draw_stages(stages, renderer), _film(stages[-1], renderer)


def _film(grown: Any, renderer: str) -> bytes:  # noqa: ANN401 - one of `Swarms`
    """Animate the growth of a structure, colored by join order."""
    last = grown.robot_count
    robots = _drawn(grown, colors_along(np.linspace(0.0, 1.0, last), JOIN_COLORS))
    # The first robots change its shape most.
    joined = np.geomspace(_FIRST_FRAME, last, _LARGE_FRAMES).round().astype(int).tolist()
    drawn, _, _ = draw_states(robots, Terrain(), [*map(np.arange, joined)], _LARGE_FRAME, renderer)
    frames = []
    for count, picture in zip(joined, drawn, strict=True):
        half = (picture.shape[1] // 2, picture.shape[0] // 2)
        small = Image.fromarray(picture).resize(half, Image.Resampling.LANCZOS)
        wide = Image.new("RGBA", (max(half[0], round(0.4 * _LARGE_FRAME[0])), half[1]), NOTHING)
        wide.paste(small, ((wide.width - half[0]) // 2, 0))
        legend = Scale(JOIN_COLORS, "join index  0", f"{last - 1:,}    {count:,} robots")
        frames.append(add_legend(wide, legend))
    durations = [FRAME_MS] * (len(frames) - 1) + [LAST_MS]
    return encode_webp(frames, durations, _QUALITY)


def _draw_stages(stages: Sequence[Any], renderer: str) -> Image.Image:
    """Draw structures side by side at one scale, with a few robots of the last one enlarged."""
    loads = [np.nan_to_num(stage.sensed_load) for stage in stages]
    greatest = max(load.max() for load in loads)
    colors = [
        colors_along(np.log(np.maximum(load, 1.0)) / np.log(greatest), _LOAD_COLORS)
        for load in loads
    ]
    robots = [_drawn(stage, color) for stage, color in zip(stages, colors, strict=True)]
    around = robots[-1].dock.reshape(-1, 3)
    camera = build_scene(robots[-1], Terrain(), around=around).within(*_LARGE_FRAME).camera
    scenes = [build_scene(group, Terrain(), around=around).seen_by(camera) for group in robots]
    enlarged, center = _enlarged(robots[-1], camera)
    *pictures, close = draw_scenes([*scenes, build_scene(enlarged, None).within(_CLOSE, _CLOSE)],
                                   renderer)[0]  # fmt: skip
    height, width, _ = pictures[0].shape
    whole = Image.new("RGBA", (len(pictures) * width + _CLOSE + 50, height + _BELOW), NOTHING)
    pen = ImageDraw.Draw(whole)
    font = ImageFont.load_default(30)
    for place, picture in enumerate(pictures):
        whole.paste(Image.fromarray(picture), (place * width, 0))
        middle = ((place + 0.5) * width, height + _BELOW / 2)
        pen.text(middle, f"{len(robots[place].center):,} robots", INK, font, anchor="mm")
    left = len(pictures) * width + 25
    column, row = camera.frame(center[None])[0]
    _add_close_up(whole, close, (left, 60), (column + left - 25 - width, row), font)
    side = around[:, 0].max()
    ends = np.array([[side, 0.0, 0.0], [side, 0.0, _BAR]])
    (_, top), (_, bottom) = camera.frame(ends)
    across = left + 40
    for y in (top, bottom):
        pen.line((across - 10, y, across + 10, y), INK, 4)
    pen.line((across, top, across, bottom), INK, 4)
    words = f"{_BAR:g} R\nR: radius of a dock"
    pen.text((across + 20, (top + bottom) / 2), words, INK, font, anchor="lm")
    low = "sensed load [dock weights, logarithmic]  1 or less"
    return add_legend(whole, Scale(_LOAD_COLORS, low, f"{greatest:,.0f}"), 1.6)


def _enlarged(robots: DrawnRobots, camera: Camera) -> tuple[DrawnRobots, Reals]:
    """Choose robots in front at half the height; returns them, and the center of one [R]."""
    height = robots.center[:, 2]
    right, _, forward = camera.project(robots.center).T
    is_at_half = np.abs(height / height.max() - 0.5) < 0.04  # noqa: PLR2004 - a narrow band
    first = np.flatnonzero(is_at_half)[np.argmin((forward + 0.3 * right)[is_at_half])]
    center: Reals = robots.center[first]
    is_near = np.linalg.norm(robots.center - center, axis=1) < _CLOSE_RADIUS
    chosen = replace(
        robots, center=robots.center[is_near], dock=robots.dock[is_near],
        color=robots.color[is_near],
    )  # fmt: skip
    return chosen, center


def _add_close_up(
    whole: Image.Image,
    picture: Pixels,
    corner: tuple[int, int],
    seen: tuple[float, float],
    font: Any,  # noqa: ANN401 - one of two kinds of fonts
) -> None:
    """Paste a picture in a circle, with a line to where its robots are [pixels]."""
    width, height = picture.shape[1], picture.shape[0]
    tile = Image.new("RGBA", (_CLOSE, _CLOSE), NOTHING)
    tile.paste(Image.fromarray(picture), ((_CLOSE - width) // 2, (_CLOSE - height) // 2))
    circle = Image.new("L", (4 * _CLOSE, 4 * _CLOSE), 0)
    ImageDraw.Draw(circle).ellipse((0, 0, 4 * _CLOSE - 1, 4 * _CLOSE - 1), fill=255)
    circle = circle.resize(tile.size, Image.Resampling.LANCZOS)
    mask = Image.composite(tile.getchannel("A"), Image.new("L", tile.size, 0), circle)
    whole.paste(tile, corner, mask)
    pen = ImageDraw.Draw(whole)
    radius = _CLOSE / 2
    middle = np.array(corner) + radius
    place = np.array(seen)
    pen.ellipse((*(middle - radius), *(middle + radius)), outline=INK, width=3)
    pen.ellipse((*(place - 14), *(place + 14)), outline=INK, width=3)
    toward = (place - middle) / np.linalg.norm(place - middle)
    pen.line((*(place - 14 * toward), *(middle + radius * toward)), INK, 3)
    below = (float(middle[0]), float(middle[1]) + radius + 30)
    pen.text(below, "each robot has three docks", INK, font, anchor="mm")


def _drawn(structure: Any, color: Reals) -> DrawnRobots:  # noqa: ANN401 - one of `Swarms`
    """Make the solids of a structure's robots, in these colors."""
    turned = dock_offsets(structure.orientation_wxyz, RobotGeometry().dock_offset_body)
    return DrawnRobots(
        center=structure.position,
        dock=structure.position[:, None] + turned,
        color=color,
        look=TRUE_SIZE,
    )


def draw_departures(rule: Path, renderer: str) -> bytes:
    """Animate a tower that loses robots by ReactiveBuild and by the rule `repair`, as WebP."""
    structure = {"kind": "tower", "departures": {"rate": 0.1}}
    grown = {"ReactiveBuild": tiswarm.grow(structure, robots=_ROBOTS, seeds=[_LEFT_SEED])[0]}
    grown["repair"] = tiswarm.grow(
        structure, robots=_ROBOTS, seeds=[_LEFT_SEED], rule="repair", plugins=[rule]
    )[0]
    color = colors_along(np.linspace(0.0, 1.0, _ROBOTS), JOIN_COLORS)
    robots = [_drawn(each, color) for each in grown.values()]
    around = np.concatenate([each.dock.reshape(-1, 3) for each in robots])
    legend = Scale(JOIN_COLORS, "join index  0", f"{_ROBOTS - 1}")
    drawn, counts = [], range(2, _ROBOTS + 1, 2)
    for structure_of, all_robots in zip(grown.values(), robots, strict=True):
        joined, there = structure_of.departures[:, 1], []
        for count in counts:
            gone = structure_of.departures[joined <= count, 0]
            there.append(np.setdiff1d(np.arange(count), gone))
        states = draw_states(all_robots, Terrain(), there, _FRAME, renderer, around=around)
        drawn.append(states[0])
    frames = []
    for count, *pictures in zip(counts, *drawn, strict=True):
        titles = []
        for name, each in grown.items():
            left = np.count_nonzero(each.departures[:, 1] <= count)
            titles.append(f"{name}\n{count} joined, {left} gone")
        frames.append(_beside(pictures, titles, [np.nan, np.nan], legend))
    return encode_webp(frames, [FRAME_MS] * (len(frames) - 1) + [LAST_MS], _QUALITY)


def _beside(
    pictures: Sequence[Pixels],
    titles: Sequence[str],
    errors: Sequence[float],
    legend: Scale,
) -> Image.Image:
    """Put pictures side by side, each with its title and RMSE [R] below."""
    height, width, _ = pictures[0].shape
    frame = Image.new("RGBA", (len(pictures) * width, height + _BELOW), NOTHING)
    pen, font = ImageDraw.Draw(frame), ImageFont.load_default(20)
    for place, (picture, title, error) in enumerate(zip(pictures, titles, errors, strict=True)):
        frame.paste(Image.fromarray(picture), (place * width, 0))
        text = title if np.isnan(error) else f"{title}\nRMSE {three_digits(error)} R"
        middle = ((place + 0.5) * width, height + _BELOW / 2)
        pen.multiline_text(middle, text, INK, font, anchor="mm", align="center")
    return add_legend(frame, legend)


def draw_kinds(runs: list[RunData], renderer: str) -> Image.Image:
    """Draw a structure of each kind, colored by the force that its robots sense."""
    return draw_forces(
        [(run.choose(None).kind, read_case_view(run.choose(None))) for run in runs], renderer
    )


def draw_forces(views: Sequence[tuple[str, SwarmView]], renderer: str) -> Image.Image:
    """Draw structures side by side, colored by the force that their robots sense, with names."""
    greatest = max(float(np.nanmax(view.force)) for _, view in views)
    tiles = []
    for kind, view in views:
        color = colors_along(np.nan_to_num(view.force) / greatest, FORCE_COLORS)
        robots = view.robots(view.pose, color, TRUE_SIZE)
        tiles.append(Tile(build_scene(robots, view.terrain), _middle(robots.dock), kind))
    legend = Scale(FORCE_COLORS, "sensed force [dock weights]  0", three_digits(greatest))
    return add_legend(draw_side_by_side(tiles, renderer), legend)


def draw_grounds(run: RunData, renderer: str) -> Image.Image:
    """Draw the first structure on each ground, colored by the force that its robots sense."""
    first = {case.point: case for case in reversed(run.cases) if case.done}
    points = list(dict.fromkeys(run.summary["point"]))
    return draw_forces([(point, read_case_view(first[point])) for point in points], renderer)


def _case_of(run: RunData, condition: str) -> StoredCase:
    """Find the first case of a condition, by its name in the scenario."""
    cases = (case for case in run.cases if case.done)
    return next(case for case in cases if case.name.partition("-")[2] == condition)


def _middle(dock: Reals) -> Reals:
    """Find the middle of the box around docks [R], shape (3,)."""
    place = dock.reshape(-1, 3)
    middle: Reals = (place.min(axis=0) + place.max(axis=0)) / 2.0
    return middle


def save(image: Image.Image, name: str) -> None:
    """Write a picture for the pages."""
    height = round(image.height * _WIDTH / image.width)
    small = image.resize((_WIDTH, height), Image.Resampling.LANCZOS)
    small.save(_IMAGES / f"{name}.png", optimize=True)


def main() -> None:
    """Draw all pictures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("runs", type=Path, nargs="*", help="run folders; the first is the tower")
    parser.add_argument("--large", action="store_true", help="draw a large structure alone")
    parser.add_argument("--grounds", type=Path, help="folder of a run of the scenario terrain")
    parser.add_argument("--repair", type=Path, help="file of the rule `repair`")
    parser.add_argument("--renderer", default="open3d", choices=["open3d", "taichi"])
    arguments = parser.parse_args()
    backend.start("cpu")
    if arguments.large:
        picture, film = draw_large(arguments.renderer)
        save(picture, "large")
        (_IMAGES / "large.webp").write_bytes(film)
        return
    if arguments.grounds:
        save(draw_grounds(load_run(arguments.grounds), arguments.renderer), "grounds")
        return
    if arguments.repair:
        film = draw_departures(arguments.repair, arguments.renderer)
        (_IMAGES / "repair.webp").write_bytes(film)
        return
    runs = [load_run(folder) for folder in arguments.runs]
    images = {
        "tower": draw_methods(runs[0], arguments.renderer),
        "kinds": draw_kinds(runs, arguments.renderer),
    }
    (_IMAGES / "growing.webp").write_bytes(draw_growing(runs[0], arguments.renderer))
    for name, image in images.items():
        save(image, name)


if __name__ == "__main__":
    main()
