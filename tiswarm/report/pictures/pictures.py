"""The 3D pictures of a case, and animations of its growth as MP4, WebP or GIF.

A study that sweeps the number of robots also has one picture of all sizes, side by side.
"""

import io
import math
import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from PIL import Image, ImageDraw, ImageFont

from tiswarm.base.aliases import Bools, Ints, Reals
from tiswarm.base.errors import EnvironmentTroubleError
from tiswarm.base.params import AnyMovie
from tiswarm.base.progress import Advance, Progress, ignore
from tiswarm.measurements.observability import hops_from_anchors
from tiswarm.records.io import write_bytes
from tiswarm.records.measures import RMSE
from tiswarm.records.messages import counted, three_digits
from tiswarm.records.surface import GroundSurface
from tiswarm.records.terrain import Terrain
from tiswarm.report.figure_style import (
    ERROR_COLORS,
    ESTIMATE_ORANGE,
    JOIN_COLORS,
    SCALES,
    TRUE_BLUE,
    UNKNOWN_GRAY,
    colors_along,
    rgb,
)
from tiswarm.report.pictures.raycast import Pixels, draw_growth, draw_scenes, on_white
from tiswarm.report.pictures.scene import TRUE_SIZE, Camera, Scene, build_scene, paint
from tiswarm.report.run_data import RunData, StoredCase
from tiswarm.report.series import SEPARATOR
from tiswarm.report.swarm_view import (
    Coloring,
    DrawnRobots,
    Ground,
    Look,
    SwarmView,
    read_case_view,
)

_GHOST_BLUE = "#80B8D8"  # TRUE_BLUE, translucent over white
_NODE = Look(0.3, 0.3, 0.6)  # a robot as a node of a graph: one ball

_SEEN_ERROR = 0.3  # error from which a true robot is seen beside its estimate [R]
_MOST_GHOSTS = 0.5  # share of robots above which translucent ones would hide each other

_LETTERS = 19  # height of letters of legends and labels [pixels]
_LEGEND_HEIGHT = 44  # height of a line of a legend [pixels]
_BAR_LENGTH = 144  # length of the bar of colors of a legend [pixels]
INK = (118, 118, 118)
"""Color of letters, as far from white as from black."""

NOTHING = (*INK, 0)
"""Color where nothing is drawn: edges of letters on it are half transparent."""


Keys = tuple[tuple[str, str], ...]
"""A legend of single colors (hex), each with its meaning; a title has no color."""


class Scale(NamedTuple):
    """A legend of a range of colors (hex) and the meanings of its ends."""

    colors: tuple[str, ...]
    low: str
    high: str
    keys: Keys = ()  # behind the range


class Picture(NamedTuple):
    """A scene and the meaning of its colors."""

    scene: Scene
    legend: Keys | Scale


def build_pictures(view: SwarmView) -> dict[str, Picture]:
    """Build every picture of robots, by name; without a truth, of the estimated structure."""
    structure = view.robots(view.best_pose, view.color_by_join, TRUE_SIZE)
    around = structure.dock.reshape(-1, 3)
    by_join = Scale(JOIN_COLORS, "join index  0", f"{len(view.pose) - 1}")
    name = "structure" if view.has_truth else "estimate"
    if view.is_of_engine:
        by_join = by_join._replace(low="robot  0")
        name = "swarm"
    scene = build_scene(structure, view.terrain)
    pictures = {name: Picture(scene, by_join)}
    if view.has_truth and view.has_estimate:
        pictures["truth-and-estimate"] = _truth_and_estimate(view, around)
    for coloring in view.colorings:
        is_of_user = any(coloring is of_user for of_user in view.user_colorings)
        name = re.sub(r"\W+", "-", coloring.label)
        pictures[f"color-{name}" if is_of_user else name] = _colored(view, scene, coloring)
    if not view.is_of_engine:
        pictures["contact-graph"] = _contact_graph(view, around)
    return pictures


def _truth_and_estimate(view: SwarmView, around: Reals) -> Picture:
    """Draw the estimated robots solid, and the true ones translucent where the error is seen.

    Where it is seen of most robots, they would hide each other: balls at true and estimated centers
    stand for them, joined by rods.
    """
    keys = ((_GHOST_BLUE, "true"), (ESTIMATE_ORANGE, "estimated"))
    estimate = view.robots(view.estimated_pose, rgb(ESTIMATE_ORANGE), TRUE_SIZE)
    is_true = _has_pose(view.pose)
    is_placed = _has_pose(view.estimated_pose)
    seen = is_true & ((view.error > _SEEN_ERROR) | ~is_placed)
    if seen.sum() > _MOST_GHOSTS * is_true.sum():
        ends = np.stack([view.pose[:, :3], view.estimated_pose[:, :3]], axis=1)
        center = np.concatenate([ends[is_true, 0], ends[is_placed, 1]])
        colors = [rgb(TRUE_BLUE), rgb(ESTIMATE_ORANGE)]
        color = np.repeat(colors, [is_true.sum(), is_placed.sum()], 0)
        ends = ends[is_true & is_placed]
        nodes = DrawnRobots(center=center, dock=center[:, None], color=color, look=_NODE)
        scene = build_scene(nodes, view.terrain, rods=ends, around=around)
        return Picture(scene, ((TRUE_BLUE, "true"), *keys[1:]))
    shown = np.where(seen[:, None], view.pose, np.nan)
    ghosts = view.robots(shown, rgb(TRUE_BLUE), TRUE_SIZE) if seen.any() else None
    return Picture(build_scene(estimate, view.terrain, ghosts=ghosts, around=around), keys)


def _has_pose(pose: Reals) -> Bools:
    """Mark the robots whose pose (N, 7) is known, which that of robots that left is not."""
    return np.asarray(np.isfinite(pose).all(axis=1))


def _colored(view: SwarmView, scene: Scene, by: Coloring) -> Picture:
    """Color the structure by a value of each robot."""
    colors = SCALES[by.scale]
    gray: Keys = ()
    if np.isnan(by.value[_has_pose(view.best_pose)]).any():
        gray = ((UNKNOWN_GRAY, by.gray),)
    legend: Keys | Scale = (("", by.title), *zip(colors, by.words, strict=False), *gray)
    if not by.words:
        scale = "log scale" if by.logarithmic else ""
        meaning = ", ".join(filter(None, [by.meaning, scale]))
        keys = ((("", meaning),) if meaning else ()) + gray
        high = three_digits(by.last) if by.most is None else f"{by.last:g} or more"
        legend = Scale(colors, f"{by.title}  {by.least:.3g}", high, keys)
    return Picture(scene.painted(view.robots(view.best_pose, paint(by), TRUE_SIZE)), legend)


def _contact_graph(view: SwarmView, around: Reals) -> Picture:
    """Draw robots as balls, colored by hops from the anchor, and contacts as rods."""
    hops = hops_from_anchors(view.log)
    has_pose = _has_pose(view.best_pose)
    farthest = max(np.max(hops, initial=1.0, where=np.isfinite(hops) & has_pose), 1.0)
    color = colors_along(np.minimum(hops / farthest, 1.0), JOIN_COLORS)
    center = view.best_pose[:, :3]
    shown = center[has_pose]
    nodes = DrawnRobots(center=shown, dock=shown[:, None], color=color[has_pose], look=_NODE)
    pairs = view.log.contacts[:, [0, 2]]
    rods = center[pairs[has_pose[pairs].all(axis=1)]]
    scene = build_scene(nodes, view.terrain, rods=rods, around=around)
    return Picture(scene, Scale(JOIN_COLORS, "hops from an anchor  0", f"{farthest:.0f}"))


def add_legend(picture: Image.Image, legend: Keys | Scale, size: float = 1.0) -> Image.Image:
    """Add a band with a legend above a picture; `size` scales its letters and bar.

    The band of a picture with opacity is transparent, others are white.
    """
    font = ImageFont.load_default(size * _LETTERS)
    bar_length = round(size * _BAR_LENGTH)
    start = size * 13.0
    first_line = size * _LEGEND_HEIGHT / 2.0
    keys = legend.keys if isinstance(legend, Scale) else legend
    x = start
    y = first_line
    if isinstance(legend, Scale):
        x += font.getlength(f"{legend.low}   {legend.high}   ") + bar_length
    positions: list[tuple[float, float]] = []
    for _, text in keys:
        width = size * 50 + font.getlength(text)
        if x > start and x + width > picture.width:
            x = start
            y += size * _LEGEND_HEIGHT
        positions.append((x, y))
        x += width
    height = round(y + size * _LEGEND_HEIGHT / 2.0)
    background = NOTHING if picture.mode == "RGBA" else "white"
    whole = Image.new(picture.mode, (picture.width, picture.height + height), background)
    whole.paste(picture, (0, height))
    pen = ImageDraw.Draw(whole)
    if isinstance(legend, Scale):
        pen.text((start, first_line), legend.low, INK, font, anchor="lm")
        bar_start = start + pen.textlength(f"{legend.low}  ", font)
        _draw_bar(pen, legend.colors, bar_start, bar_length, first_line, size * 7)
        pen.text((bar_start + bar_length, first_line), f" {legend.high}", INK, font, anchor="lm")
    for (key, text), (x, y) in zip(keys, positions, strict=True):
        if key:
            pen.ellipse((x, y - size * 9, x + size * 18, y + size * 9), fill=key)
            pen.text((x + size * 25, y), text, INK, font, anchor="lm")
        else:
            pen.text((x, y), text, INK, font, anchor="lm")
    return whole


def _draw_bar(
    pen: ImageDraw.ImageDraw,
    colors: Sequence[str],
    start: float,
    length: int,
    middle: float,
    half_height: float,
) -> None:
    """Draw a bar of colors from a column on, around a row [pixels]."""
    shades = 255.0 * colors_along(np.linspace(0.0, 1.0, length), colors)
    for step, shade in enumerate(shades.round().astype(int).tolist()):
        x = start + step
        pen.line((x, middle - half_height, x, middle + half_height), tuple(shade))


class Rendered(NamedTuple):
    """A picture file."""

    path: Path
    renderer: str
    reason: str  # why a better renderer failed; empty if none did


def render_view(
    view: SwarmView, progress: Progress, renderer: str | None = None
) -> tuple[dict[str, bytes], str, str]:
    """Draw every picture of robots by a renderer, the best one that works if None.

    Returns:
        The PNGs by name, the renderer, and why a better one failed.

    Raises:
        InputError: the renderer is unknown, or the log is damaged.
        EnvironmentTroubleError: the renderer does not work on this machine.
    """
    planned = build_pictures(view)
    with progress.task("render", len(planned)) as advance:
        scenes = [plan.scene for plan in planned.values()]
        pictures, used, reason = draw_scenes(scenes, renderer, advance)
    _name_renderer(progress, used, reason)
    encoded = {
        name: _encoded(Image.fromarray(picture), plan.legend)
        for (name, plan), picture in zip(planned.items(), pictures, strict=True)
    }
    return encoded, used, reason


def _name_renderer(progress: Progress, used: str, reason: str) -> None:
    """Report which renderer drew, and why no better one did."""
    progress.info(f"drawn by {used}" + (f" ({reason})" if reason else ""))


def picture_files(
    view: SwarmView,
    progress: Progress,
    *,
    renderer: str | None = None,
    movie: AnyMovie | None = None,
) -> dict[str, bytes]:
    """Draw every picture of robots, and an animation of the growth if a format is given, by file.

    Centers are relative to the anchor: float32 resolves them well. Errors are those of
    `render_view` and `animate_view`.
    """
    near = _near_anchor(view)
    pictures, _, _ = render_view(near, progress, renderer)
    files = {f"{name}.png": data for name, data in pictures.items()}
    if movie:
        files[f"growth.{movie}"] = animate_view(near, movie, progress, renderer)[0]
    return files


def encode_png(view: SwarmView) -> dict[str, bytes]:
    """Draw every picture of robots, by file."""
    return picture_files(view, view.progress)


def _near_anchor(view: SwarmView) -> SwarmView:
    """Return a view whose origin is the place of the anchor."""
    pose, estimated, stood = map(view.from_origin, (view.pose, view.estimated_pose, view.stood))
    terrain = view.terrain
    if isinstance(terrain, GroundSurface):
        terrain = terrain.moved(-view.origin)
    elif terrain is not None:
        terrain = replace(terrain, ground_z=terrain.ground_z - float(view.origin[2]))
    return replace(view, pose=pose, estimated_pose=estimated, stood=stood, terrain=terrain)


def _encoded(picture: Image.Image, legend: Keys | Scale) -> bytes:
    """Encode a picture with its legend as PNG."""
    stream = io.BytesIO()
    add_legend(picture, legend).save(stream, format="PNG", compress_level=4)
    return stream.getvalue()


def render_run(
    run: RunData, *, progress: Progress, renderer: str | None = None, case: str | None = None
) -> list[Rendered]:
    """Draw every picture of one case of a run into `renders/`.

    The best renderer that works draws the first of the largest cases, unless they are named. File
    names contain the name of the case if it is given.

    Raises:
        InputError: the renderer or the case is unknown, or the run is damaged.
        EnvironmentTroubleError: the renderer does not work on this machine.
    """
    chosen = run.choose(case)
    pictures, used, reason = render_view(read_case_view(chosen), progress, renderer)
    if case is None:
        together = {"sizes": build_sizes(run, chosen), BESIDE: build_extremes(run, chosen)}
        for name, (tiles, greatest) in together.items():
            if tiles:
                legend = Scale(JOIN_COLORS, "join index  first", "last")
                if chosen.has_estimate:
                    words = f"    {chosen.condition}" if name == "sizes" else ""
                    high = f"{three_digits(greatest)}{words}"
                    legend = Scale(ERROR_COLORS, "error [R]  0", high)
                pictures[name] = _encoded(draw_side_by_side(tiles, used), legend)
    suffix = "" if case is None else f"-{case}"
    drawn = []
    for name, data in pictures.items():
        path = run.subfolder("renders") / f"{name}{suffix}.png"
        write_bytes(path, data)
        progress.info(f"renders/{path.name}")
        drawn.append(Rendered(path=path, renderer=used, reason=reason))
    return drawn


_MOST_SIZES = 8
_WIDTH = 1870  # of the picture at most, approximately [pixels]
_HEIGHT = 1000  # of the picture at most, approximately [pixels]
_AROUND = 10.0  # room around a structure, where its ground fades [R]
_LEAST_WIDTH = 187  # for a label [pixels]
_LABEL_LINE = 27  # height of a line of a label [pixels]
_LABEL_ROOM = 11  # room around a label [pixels]

BESIDE = "best-and-weakest"
"""Name of the picture of the conditions that err least and most."""


class Tile(NamedTuple):
    """A structure among others."""

    scene: Scene
    level: Reals  # point that all structures have at one height of the picture [R], shape (3,)
    label: str


def build_sizes(run: RunData, like: StoredCase) -> tuple[list[Tile], float]:
    """Build a tile for each size of a kind and condition, colored by error, and the greatest error.

    Structures without an estimate are colored by join index. There are none unless a study swept
    the size.
    """
    cases: dict[int, StoredCase] = {}
    for case in run.cases if run.sweeps_robots else []:
        if case.done and (case.kind, case.condition) == (like.kind, like.condition):
            cases.setdefault(case.robots, case)
    sizes = sorted(cases)[-_MOST_SIZES:] if len(cases) > 1 else []
    views = [read_case_view(cases[robots]) for robots in sizes]
    labels = [counted(len(view.pose), "robot") for view in views]
    return _tiles(views, labels, by_error=like.has_estimate)


def build_extremes(run: RunData, like: StoredCase) -> tuple[list[Tile], float]:
    """Build tiles of one structure with the errors of its best and its weakest condition.

    There are none where only one condition has estimates of the structure.

    Returns:
        The two tiles, and the greatest error of both [R].
    """
    rmse = run.summary.set_index("case").get(RMSE.column, pd.Series(dtype=float))
    seed = like.name.partition("-")[0]
    cases = [
        case
        for case in run.cases
        if case.done
        and case.has_estimate
        and (case.point, case.name.partition("-")[0]) == (like.point, seed)
        and np.isfinite(rmse.get(case.name, np.nan))
    ]
    if len(cases) < 2:  # noqa: PLR2004 - a best one and another
        return [], 0.0
    cases.sort(key=lambda case: float(rmse[case.name]))
    extremes = [cases[0], cases[-1]]
    labels = [
        "\n".join(filter(None, case.condition.rpartition(SEPARATOR)[::2])) for case in extremes
    ]
    return _tiles([read_case_view(case) for case in extremes], labels, by_error=True)


def _tiles(
    views: Sequence[SwarmView], labels: Sequence[str], *, by_error: bool
) -> tuple[list[Tile], float]:
    """Build a tile for each view, colored by error on one scale or by join; the greatest error."""
    greatest = max((float(np.nanmax(view.error, initial=1e-9)) for view in views), default=0.0)
    tiles = []
    for view, label in zip(views, labels, strict=True):
        color = view.color_by_join
        if by_error:
            color = colors_along(np.nan_to_num(view.error) / greatest, ERROR_COLORS)
        scene = build_scene(view.robots(view.pose, color, TRUE_SIZE), view.terrain)
        level = np.nanmean(view.pose[:, :3], axis=0)
        level[2] = np.nanmin(view.pose[:, 2])
        if isinstance(view.terrain, Terrain):
            level[2] = view.terrain.ground_z
        tiles.append(Tile(scene, level, _with_rmse(label, view)))
    return tiles, greatest


def _with_rmse(label: str, view: SwarmView) -> str:
    """Add the RMSE of an estimate to a label."""
    if not view.has_estimate:
        return label
    error = view.error[np.isfinite(view.error)]
    rmse = f"RMSE {three_digits(math.sqrt(np.mean(error**2)))} R" if len(error) else "no estimate"
    return f"{label}\n{rmse}"


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
    pictures: Sequence[Pixels], rows: Sequence[float], labels: Sequence[str], room: int
) -> Image.Image:
    """Put pictures side by side, with these rows at one height; their room overlaps [pixels]."""
    above = max(rows)
    below = max(len(picture) - row for picture, row in zip(pictures, rows, strict=True))
    font = ImageFont.load_default(_LETTERS)
    label_height = _LABEL_ROOM + _LABEL_LINE * max(label.count("\n") + 1 for label in labels)
    widths = [max(map(font.getlength, label.split("\n"))) for label in labels]
    steps = [
        max(picture.shape[1] - room, _LEAST_WIDTH, round(width) + _LABEL_ROOM)
        for picture, width in zip(pictures, widths, strict=True)
    ]
    middles = [sum(steps[:k]) + (step + room) // 2 for k, step in enumerate(steps)]
    size = (sum(steps) + room, round(above + below))
    whole = Image.new("RGBA", size, NOTHING)
    for picture, row, middle in zip(pictures, rows, middles, strict=True):
        tile = Image.new("RGBA", size, NOTHING)
        tile.paste(Image.fromarray(picture), (middle - picture.shape[1] // 2, round(above - row)))
        whole.alpha_composite(tile)
    content = whole.getchannel("A").getbbox() or (0, 0, *size)
    whole = whole.crop((0, content[1], size[0], content[3] + label_height))
    pen = ImageDraw.Draw(whole)
    for middle, label in zip(middles, labels, strict=True):
        position = (middle, whole.height - label_height // 2)
        pen.multiline_text(position, label, INK, font, anchor="mm", align="center")
    return whole


LAST_MS = 2_500
"""Duration of the last frame, which shows the whole structure [ms]."""

FRAME_MS = 90
"""Duration of another frame [ms]."""

_MOST_FRAMES = 60
_SIZES = {"mp4": (1920, 1080), "webp": (960, 720), "gif": (960, 720)}
"""Most columns and rows of a frame without its legend, by file format [pixels]."""

_LEGEND_WIDTH = 600  # of a frame for which the letters of a legend are made [pixels]
_QUALITY = 80  # of a WebP
_ALPHA_QUALITY = 40  # at 100 files are twice as large, and look alike
_GRAYS = np.array([*range(0, 200, 8), *range(200, 256)], np.uint8)  # of a GIF, for the ground
_GRAY = 8  # range of red, green and blue up to which a pixel is gray
_BAR_HEIGHT = 60  # rows of the legend's colors that count when a GIF's are chosen [pixels]


def best_movie() -> AnyMovie:
    """Return the best file format of an animation that can be written here."""
    return "mp4" if find_spec("imageio") and find_spec("imageio_ffmpeg") else "webp"


def animate_run(
    run: RunData,
    form: AnyMovie,
    *,
    progress: Progress,
    renderer: str | None = None,
    case: str | None = None,
) -> Rendered:
    """Animate the growth of a case into `renders/growth`, with the end of the file format.

    Every frame has the camera and the ground of the whole structure. Renderer, case and file name
    are chosen as in `render_run`.

    Raises:
        InputError: the renderer or the case is unknown, or the run is damaged.
        EnvironmentTroubleError: the renderer does not work here, or the library for MP4 is missing.
    """
    film, used, reason = animate_view(read_case_view(run.choose(case)), form, progress, renderer)
    suffix = "" if case is None else f"-{case}"
    path = run.subfolder("renders") / f"growth{suffix}.{form}"
    write_bytes(path, film)
    progress.info(f"renders/{path.name}")
    return Rendered(path=path, renderer=used, reason=reason)


def animate_view(
    view: SwarmView, form: AnyMovie, progress: Progress, renderer: str | None = None
) -> tuple[bytes, str, str]:
    """Animate the growth of a structure, or, without a truth, of the estimate.

    Returns:
        The file, the renderer, and why a better one failed.

    Raises:
        InputError: the renderer is unknown.
        EnvironmentTroubleError: the renderer does not work here, or the library for MP4 is missing.
    """
    robots = len(view.pose)
    joined = np.linspace(1, robots, min(robots, _MOST_FRAMES)).round().astype(int).tolist()
    index = np.flatnonzero(_has_pose(view.stood))
    departure = np.full(robots, robots + 1)  # robots that have joined when each one leaves
    departure[view.log.gone] = view.log.left_after
    standing = [np.flatnonzero((index < n) & (departure[index] > n)) for n in joined]
    whole = view.robots(view.stood, view.color_by_join, TRUE_SIZE)
    with progress.task("animate", len(joined)) as advance:
        pictures, used, reason = draw_states(
            whole, view.terrain, standing, _SIZES[form], renderer, advance
        )
    _name_renderer(progress, used, reason)
    ground = on_white if form != "webp" else np.asarray  # only WebP has half transparent pixels
    frames = [
        _with_legend(Image.fromarray(ground(picture)), n, robots, np.count_nonzero(departure <= n))
        for picture, n in zip(pictures, joined, strict=True)
    ]
    return _ENCODERS[form](frames), used, reason


def draw_states(
    robots: DrawnRobots,
    terrain: Ground | None,
    shown: Sequence[Ints],
    size: tuple[int, int],
    renderer: str | None = None,
    advance: Advance = ignore,
    around: Reals | None = None,
) -> tuple[list[Pixels], str, str]:
    """Draw a structure in several states, before one camera.

    Args:
        robots: All robots.
        terrain: The ground; None for no ground.
        shown: The robots of each picture; neighboring pictures share most.
        size: Most columns and rows of a picture [pixels].
        renderer: Name of the renderer; the first that works if None.
        advance: Called with the number of pictures drawn since.
        around: Docks that fit into each picture [R], shape (n, 3); those of all robots if None.

    Returns:
        The pictures, of shape (height, width, 4), the renderer, and why a better one failed.
    """
    docks = robots.dock.reshape(-1, 3) if around is None else around
    camera = build_scene(robots, terrain, around=docks).within(*size).camera
    scenes = []
    changed = []
    for before, now in zip([shown[0][:0], *shown], shown, strict=False):
        standing = replace(
            robots, center=robots.center[now], dock=robots.dock[now], color=robots.color[now]
        )
        scenes.append(build_scene(standing, terrain, around=docks).seen_by(camera))
        changed.append(robots.center[np.setxor1d(before, now)])
    return draw_growth(scenes, changed, renderer, advance)


def _with_legend(picture: Image.Image, count: int, robots: int, departed: int) -> Image.Image:
    """Add a legend to a frame, and make its size even, as MP4 requires."""
    state = f"{count} of {robots} robots"
    if departed:
        state += f", {departed} gone"
    legend = Scale(JOIN_COLORS, "join index  0", f"{robots - 1}    {state}")
    whole = add_legend(picture, legend, picture.width / _LEGEND_WIDTH)
    return whole.crop((0, 0, whole.width // 2 * 2, whole.height // 2 * 2))


def _webp(frames: Sequence[Image.Image]) -> bytes:
    """Encode frames as an animated WebP."""
    return encode_webp(frames, _durations(len(frames)), _QUALITY)


def _durations(frames: int) -> list[int]:
    """List the duration of each frame [ms]."""
    return [FRAME_MS] * (frames - 1) + [LAST_MS]


def encode_webp(frames: Sequence[Image.Image], durations: Sequence[int], quality: int) -> bytes:
    """Encode frames, each with its duration [ms], in a quality of 1 to 100."""
    stream = io.BytesIO()
    first, *rest = frames
    first.save(
        stream,
        "WEBP",
        save_all=True,
        append_images=rest,
        duration=[*durations],
        loop=0,
        quality=quality,
        method=2,
        alpha_quality=_ALPHA_QUALITY,
    )
    return stream.getvalue()


def _gif(frames: Sequence[Image.Image]) -> bytes:
    """Encode frames in one palette, to avoid flicker: colors of the last frame, and grays."""
    last = frames[-1]
    bar = colors_along(np.linspace(0.0, 1.0, last.width), JOIN_COLORS)
    bar = np.tile(np.round(255.0 * bar).astype(np.uint8), (_BAR_HEIGHT, 1, 1))
    pixels = np.concatenate([np.asarray(last), bar]).reshape(-1, 3)
    colored = pixels[np.ptp(pixels, axis=1) > _GRAY]
    count = 256 - len(_GRAYS)
    colors = Image.fromarray(colored[None]).quantize(count).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette([*colors[: 3 * count], *_GRAYS.repeat(3).tolist()])
    first, *rest = [_indexed(frame, palette, len(colors[: 3 * count]) // 3) for frame in frames]
    durations = _durations(len(frames))
    stream = io.BytesIO()
    first.save(stream, "GIF", save_all=True, append_images=rest, duration=durations, loop=0)
    return stream.getvalue()


def _indexed(frame: Image.Image, palette: Image.Image, colors: int) -> Image.Image:
    """Choose a color of the palette, which grays follow from place `colors` on, for each pixel."""
    indexed = frame.quantize(palette=palette, dither=Image.Dither.NONE)
    pixels = np.asarray(frame)
    gray = np.ptp(pixels, axis=2) <= _GRAY  # Pillow's choice is coarse; these are most of a frame
    nearest = np.abs(np.arange(256)[:, None] - _GRAYS).argmin(axis=1)
    index = np.asarray(indexed).copy()
    index[gray] = colors + nearest[pixels[gray, 1]]
    exact = Image.frombytes("P", frame.size, index.tobytes())
    exact.putpalette(palette.getpalette() or [])
    return exact


def _mp4(frames: Sequence[Image.Image]) -> bytes:
    """Encode frames as H.264."""
    try:
        import imageio.v3 as iio  # noqa: PLC0415 - an extra
        import imageio_ffmpeg  # noqa: F401, PLC0415 - what imageio calls
    except ImportError as error:
        problem = (
            "MP4 needs imageio and imageio-ffmpeg; pip install 'tiswarm[video]', or choose webp"
        )
        raise EnvironmentTroubleError(problem) from error
    pictures = [np.asarray(frame) for frame in frames]
    pictures += pictures[-1:] * (LAST_MS // FRAME_MS)
    try:
        with tempfile.TemporaryDirectory(prefix="tiswarm-movie-") as folder:
            path = Path(folder, "growth.mp4")
            iio.imwrite(
                path,
                pictures,
                plugin="FFMPEG",
                fps=1000 / FRAME_MS,
                macro_block_size=2,
                quality=None,
                output_params=["-preset", "veryfast", "-crf", "20"],
            )
            iio.immeta(path, plugin="FFMPEG")  # ffmpeg does not report a full disk
            return path.read_bytes()
    except (OSError, RuntimeError, ValueError, IndexError) as error:
        problem = f"{tempfile.gettempdir()}: no movie can be written; check the free space"
        raise EnvironmentTroubleError(problem) from error


_ENCODERS: dict[AnyMovie, Callable[[Sequence[Image.Image]], bytes]] = {
    "mp4": _mp4,
    "webp": _webp,
    "gif": _gif,
}


def _growth(form: AnyMovie, view: SwarmView) -> dict[str, bytes]:
    """Animate the growth of a structure, by file."""
    film, _, _ = animate_view(_near_anchor(view), form, view.progress)
    return {f"growth.{form}": film}


encode_growth_mp4, encode_growth_webp, encode_growth_gif = (
    partial(_growth, form) for form in _ENCODERS
)
"""Formats of an export, as functions of a view."""
