"""Animates the growth of a structure, join by join, as GIF or MP4."""

import io
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from tiswarm.base.errors import EnvironmentTroubleError
from tiswarm.base.params import Movie
from tiswarm.base.progress import Progress
from tiswarm.records.io import write_bytes
from tiswarm.report.figure_style import JOIN_COLORS, colors_along
from tiswarm.report.render.pictures import Rendered, Scale, add_legend
from tiswarm.report.render.raycast import draw_scenes
from tiswarm.report.render.scene import TRUE_SIZE, build_scene
from tiswarm.report.run_data import RunData
from tiswarm.report.swarm_view import read_case_view

LAST_MS = 2_500
"""Duration of the last frame, which shows the whole structure [ms]."""

_FRAME_MS = 90  # duration of a frame
_MOST_FRAMES = 60
_SHRINK = 2  # size of a picture over that of a frame
_GRAYS = np.array([*range(0, 200, 8), *range(200, 256)], np.uint8)  # of a GIF, for the ground
_GRAY = 8  # range of red, green and blue up to which a pixel is gray
_BAR_HEIGHT = 60  # rows of the legend's colors that count when a GIF's are chosen [pixels]


def animate_run(
    run: RunData,
    form: Movie,
    *,
    progress: Progress,
    renderer: str | None = None,
    case: str | None = None,
) -> Rendered:
    """Animate the growth of a case into `renders/growth.gif` or `renders/growth.mp4`.

    Every frame has the camera and the ground of the whole structure. Renderer, case and file name
    are chosen as in `render_run`.

    Raises:
        InputError: the renderer or the case is unknown, or the run is damaged.
        EnvironmentTroubleError: the renderer does not work here, or the library for MP4 is missing.
    """
    view = read_case_view(run.choose(case))
    robots = len(view.pose)
    joined = np.linspace(1, robots, min(robots, _MOST_FRAMES)).round().astype(int).tolist()
    whole = view.robots(view.pose, view.color_by_join, TRUE_SIZE)
    scenes = []
    for n in joined:
        part = replace(whole, center=whole.center[:n], dock=whole.dock[:n], color=whole.color[:n])
        scene = build_scene(part, view.terrain, around=whole.dock.reshape(-1, 3))
        scenes.append(scene.shrunk(_SHRINK))
    with progress.task("animate", len(scenes)) as advance:
        pictures, used, reason = draw_scenes(scenes, renderer, advance)
    frames = [
        _with_legend(Image.fromarray(picture), count, robots)
        for picture, count in zip(pictures, joined, strict=True)
    ]
    suffix = "" if case is None else f"-{case}"
    path = run.subfolder("renders") / f"growth{suffix}.{form}"
    write_bytes(path, _gif(frames) if form == "gif" else _mp4(frames))
    because = f" ({reason})" if reason else ""
    progress.info(f"renders/{path.name}: {len(frames)} frames, drawn by {used}{because}")
    return Rendered(path=path, renderer=used, reason=reason)


def _with_legend(picture: Image.Image, count: int, robots: int) -> Image.Image:
    """Add a legend to a frame, and make its size even, as MP4 requires."""
    legend = Scale(JOIN_COLORS, "join index  0", f"{robots - 1}    {count} of {robots} robots")
    band = add_legend(Image.new("RGB", (_SHRINK * picture.width, 0)), legend)
    band = band.resize((picture.width, band.height // _SHRINK), Image.Resampling.LANCZOS)
    height = picture.height + band.height
    frame = Image.new("RGB", (picture.width // 2 * 2, height // 2 * 2), "white")
    frame.paste(band, (0, 0))
    frame.paste(picture, (0, band.height))
    return frame


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
    durations = [_FRAME_MS] * len(rest) + [LAST_MS]
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
        problem = "MP4 needs imageio and imageio-ffmpeg; pip install 'tiswarm[video]', or use GIF"
        raise EnvironmentTroubleError(problem) from error
    pictures = [np.asarray(frame) for frame in frames]
    pictures += pictures[-1:] * (LAST_MS // _FRAME_MS)
    try:
        with tempfile.TemporaryDirectory(prefix="tiswarm-movie-") as place:
            path = Path(place, "growth.mp4")
            iio.imwrite(path, pictures, plugin="FFMPEG", fps=1000 / _FRAME_MS, macro_block_size=2)
            iio.immeta(path, plugin="FFMPEG")  # ffmpeg does not report a full disk
            return path.read_bytes()
    except (OSError, RuntimeError, ValueError, IndexError) as error:
        problem = f"{tempfile.gettempdir()}: no movie can be written; check the free space"
        raise EnvironmentTroubleError(problem) from error
