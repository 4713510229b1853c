"""Draws the pictures of the README into docs/images.

for kind in tower cantilever bridge chain; do tiswarm run scenarios/$kind.yaml --set seeds=1; done
python -m benchmarks.images reports/tower-* reports/cantilever-* reports/bridge-* reports/chain-*
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from tiswarm.base.aliases import Reals
from tiswarm.compute import backend
from tiswarm.records.messages import three_digits
from tiswarm.report.figure_style import FORCE_COLORS, colors_along
from tiswarm.report.render.pictures import Keys, Scale, add_legend, build_pictures
from tiswarm.report.render.scene import TRUE_SIZE, build_scene
from tiswarm.report.render.side_by_side import Tile, draw_side_by_side
from tiswarm.report.run_data import RunData, load_run
from tiswarm.report.swarm_view import read_case_view

_IMAGES = Path("docs/images")
_COMPARED = {"joint": "joint", "algorithm-1": "Algorithm 1 of the paper"}
"""Conditions of the tower, and what the picture calls them."""

_WIDTH = 1200  # [pixels]


def draw_methods(run: RunData, renderer: str) -> Image.Image:
    """Draw the truth and the estimates of two methods of the first structure."""
    tiles: list[Tile] = []
    keys: Keys | Scale = ()
    for condition, title in _COMPARED.items():
        case = next(case for case in run.cases if case.done and case.name.partition("-")[2] == condition)
        view = read_case_view(case)
        picture = build_pictures(view)["truth-and-estimate"]
        keys = picture.legend
        rmse = three_digits(float(np.sqrt(np.nanmean(view.error**2))))
        level = np.array([*view.pose[:, :2].mean(axis=0), 0.0])
        tiles.append(Tile(picture.scene, level, f"{title}\nRMSE {rmse} R"))
    return add_legend(draw_side_by_side(tiles, renderer), keys)


def draw_kinds(runs: list[RunData], renderer: str) -> Image.Image:
    """Draw a structure of each kind, colored by the force that its robots sense."""
    views = [(run.choose(None).kind, read_case_view(run.choose(None))) for run in runs]
    greatest = max(float(np.nanmax(view.force)) for _, view in views)
    tiles = []
    for kind, view in views:
        color = colors_along(np.nan_to_num(view.force) / greatest, FORCE_COLORS)
        robots = view.robots(view.pose, color, TRUE_SIZE)
        tiles.append(Tile(build_scene(robots, view.terrain), _middle(robots.dock), kind))
    legend = Scale(FORCE_COLORS, "sensed force [dock weights]  0", three_digits(greatest))
    return add_legend(draw_side_by_side(tiles, renderer), legend)


def _middle(dock: Reals) -> Reals:
    """Find the middle of the box around docks [R], shape (3,)."""
    place = dock.reshape(-1, 3)
    middle: Reals = (place.min(axis=0) + place.max(axis=0)) / 2.0
    return middle


def main() -> None:
    """Draw both pictures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("runs", type=Path, nargs="+", help="run folders; the first is the tower")
    parser.add_argument("--renderer", default="open3d", choices=["open3d", "taichi"])
    arguments = parser.parse_args()
    backend.start("cpu")
    runs = [load_run(folder) for folder in arguments.runs]
    images = {
        "tower": draw_methods(runs[0], arguments.renderer),
        "kinds": draw_kinds(runs, arguments.renderer),
    }
    for name, image in images.items():
        height = round(image.height * _WIDTH / image.width)
        small = image.resize((_WIDTH, height), Image.Resampling.LANCZOS)
        small.save(_IMAGES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
