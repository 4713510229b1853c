"""One picture of several structures, side by side at one scale."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageChops, ImageDraw, ImageFont

from tiswarm.base.aliases import Reals
from tiswarm.records.messages import counted, three_digits
from tiswarm.report.figure_style import ERROR_COLORS, colors_along
from tiswarm.report.render.raycast import Picture, draw_scenes
from tiswarm.report.render.scene import TRUE_SIZE, Camera, Scene, build_scene
from tiswarm.report.run_data import RunData, StoredCase
from tiswarm.report.swarm_view import SwarmView, read_case_view

_MOST_SIZES = 8
_WIDTH, _HEIGHT = 1870, 1000  # of the picture at most, approximately [pixels]
_AROUND = 10.0  # room around a structure, where its ground fades [R]
_LEAST_WIDTH = 187  # for a label [pixels]
_LETTERS, _LABEL_HEIGHT = 19, 65  # of labels [pixels]
_INK = (40, 40, 40)


class Tile(NamedTuple):
    """A structure among others."""

    scene: Scene
    level: Reals  # point that all structures have at one height of the picture [R], shape (3,)
    label: str


def build_sizes(run: RunData, like: StoredCase) -> tuple[list[Tile], float]:
    """Build a tile for each size of a kind and condition, colored by error, and the greatest error.

    There are none unless a study swept the size.
    """
    cases: dict[int, StoredCase] = {}
    for case in run.cases if run.sweeps_robots else []:
        if case.done and (case.kind, case.condition) == (like.kind, like.condition):
            cases.setdefault(case.robots, case)
    sizes = sorted(cases)[-_MOST_SIZES:] if len(cases) > 1 else []
    views = [read_case_view(cases[robots]) for robots in sizes]
    greatest = max((float(np.nanmax(view.error, initial=1e-9)) for view in views), default=0.0)
    tiles = []
    for view in views:
        color = colors_along(np.nan_to_num(view.error) / greatest, ERROR_COLORS)
        scene = build_scene(view.robots(view.pose, color, TRUE_SIZE), view.terrain)
        level = np.nanmean(view.pose[:, :3], axis=0)
        level[2] = view.terrain.ground_z if view.terrain else np.nanmin(view.pose[:, 2])
        tiles.append(Tile(scene, level, _label(view)))
    return tiles, greatest


def _label(view: SwarmView) -> str:
    """State size and RMSE."""
    error = view.error[np.isfinite(view.error)]
    rmse = f"RMSE {three_digits(math.sqrt(np.mean(error**2)))} R" if len(error) else "no estimate"
    return f"{counted(len(view.pose), 'robot')}\n{rmse}"


def draw_side_by_side(tiles: list[Tile], renderer: str) -> Image.Image:
    """Draw structures at one scale, with labels below."""
    cameras = [tile.scene.camera for tile in tiles]
    scales = [
        camera.pixels_per_slope / camera.project(tile.level[None])[0, 2]
        for camera, tile in zip(cameras, tiles, strict=True)
    ]
    wide = sum(camera.width / scale for camera, scale in zip(cameras, scales, strict=True))
    tall = max(camera.height / scale for camera, scale in zip(cameras, scales, strict=True))
    common = min(_WIDTH / (wide + _AROUND * len(tiles)), _HEIGHT / tall)  # pixels per R
    room = round(_AROUND * common)
    scenes = [
        tile.scene.seen_by(_enlarged(camera, common / scale, room))
        for tile, camera, scale in zip(tiles, cameras, scales, strict=True)
    ]
    pictures, _, _ = draw_scenes(scenes, renderer)
    rows = [
        float(scene.camera.frame(tile.level[None])[0, 1])
        for scene, tile in zip(scenes, tiles, strict=True)
    ]
    return _lay_out(pictures, rows, [tile.label for tile in tiles], room)


def _enlarged(camera: Camera, times: float, room: int) -> Camera:
    """Scale a camera's picture, and add room on all sides [pixels]."""
    height = round(times * camera.height) + 2 * room
    return replace(
        camera,
        width=round(times * camera.width) + 2 * room,
        height=height,
        half_height=camera.half_height * height / (times * camera.height),
    )


def _lay_out(
    pictures: Sequence[Picture], rows: Sequence[float], labels: Sequence[str], room: int
) -> Image.Image:
    """Put pictures side by side, with these rows at one height; their room overlaps [pixels]."""
    above = max(rows)
    below = max(len(picture) - row for picture, row in zip(pictures, rows, strict=True))
    steps = [max(picture.shape[1] - room, _LEAST_WIDTH) for picture in pictures]
    middles = [sum(steps[:k]) + (step + room) // 2 for k, step in enumerate(steps)]
    size = (sum(steps) + room, round(above + below))
    whole = Image.new("RGB", size, "white")
    for picture, row, middle in zip(pictures, rows, middles, strict=True):
        tile = Image.new("RGB", size, "white")
        tile.paste(Image.fromarray(picture), (middle - picture.shape[1] // 2, round(above - row)))
        whole = ImageChops.multiply(whole, tile)
    content = ImageChops.invert(whole).getbbox() or (0, 0, *size)
    whole = whole.crop((0, content[1], size[0], content[3] + _LABEL_HEIGHT))
    pen, font = ImageDraw.Draw(whole), ImageFont.load_default(_LETTERS)
    pen.rectangle((0, whole.height - _LABEL_HEIGHT, *whole.size), "white")
    for middle, label in zip(middles, labels, strict=True):
        place = (middle, whole.height - _LABEL_HEIGHT // 2)
        pen.multiline_text(place, label, _INK, font, anchor="mm", align="center")
    return whole
