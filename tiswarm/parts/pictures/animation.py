"""Animates the growth of a structure, join by join, as MP4, WebP or GIF."""

import io
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tiswarm.base.aliases import Reals
from tiswarm.base.errors import EnvironmentTroubleError
from tiswarm.base.params import AnyMovie
from tiswarm.base.progress import Advance, Progress, ignore
from tiswarm.parts.pictures.pictures import Rendered, Scale, add_legend
from tiswarm.parts.pictures.raycast import draw_growth
from tiswarm.parts.pictures.scene import TRUE_SIZE, build_scene
from tiswarm.records.io import write_bytes
from tiswarm.records.terrain import Terrain
from tiswarm.report.figure_style import JOIN_COLORS, colors_along
from tiswarm.report.run_data import RunData
from tiswarm.report.swarm_view import DrawnRobots, read_case_view

LAST_MS = 2_500
"""Duration of the last frame, which shows the whole structure [ms]."""

FRAME_MS = 90
"""Duration of another frame [ms]."""

_MOST_FRAMES = 60
_SIZES = {"mp4": (1920, 1080), "webp": (960, 720), "gif": (960, 720)}
"""Most columns and rows of a frame without its legend, by file format [pixels]."""

_LEGEND_WIDTH = 600  # of a frame for which the letters of a legend are made [pixels]
_QUALITY = 80  # of a WebP
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
    view = read_case_view(run.choose(case))
    robots = len(view.pose)
    joined = np.linspace(1, robots, min(robots, _MOST_FRAMES)).round().astype(int).tolist()
    whole = view.robots(view.pose, view.color_by_join, TRUE_SIZE)
    with progress.task("animate", len(joined)) as advance:
        pictures, used, reason = draw_joins(
            whole, view.terrain, joined, _SIZES[form], renderer, advance
        )
    frames = [
        _with_legend(Image.fromarray(picture), count, robots)
        for picture, count in zip(pictures, joined, strict=True)
    ]
    suffix = "" if case is None else f"-{case}"
    path = run.subfolder("renders") / f"growth{suffix}.{form}"
    write_bytes(path, _ENCODERS[form](frames))
    because = f" ({reason})" if reason else ""
    progress.info(f"renders/{path.name}: {len(frames)} frames, drawn by {used}{because}")
    return Rendered(path=path, renderer=used, reason=reason)


def draw_joins(
    robots: DrawnRobots,
    terrain: Terrain | None,
    joined: Sequence[int],
    size: tuple[int, int],
    renderer: str | None = None,
    advance: Advance = ignore,
    around: Reals | None = None,
) -> tuple[list[NDArray[np.uint8]], str, str]:
    """Draw a structure when so many of its robots have joined, before one camera.

    Args:
        robots: All robots, in join order.
        terrain: The ground; None for no ground.
        joined: Number of robots of each picture, ascending.
        size: Most columns and rows of a picture [pixels].
        renderer: Name of the renderer; the first that works if None.
        advance: Called with the number of pictures drawn since.
        around: Docks that fit into each picture [R], shape (n, 3); those of all robots if None.

    Returns:
        The pictures, of shape (height, width, 3), the renderer, and why a better one failed.
    """
    docks = robots.dock.reshape(-1, 3) if around is None else around
    camera = build_scene(robots, terrain, around=docks).within(*size).camera
    scenes, added = [], []
    for before, n in zip([0, *joined], joined, strict=False):
        part = replace(
            robots, center=robots.center[:n], dock=robots.dock[:n], color=robots.color[:n]
        )
        scenes.append(build_scene(part, terrain, around=docks).seen_by(camera))
        added.append(robots.center[before:n])
    return draw_growth(scenes, added, renderer, advance)


def _with_legend(picture: Image.Image, count: int, robots: int) -> Image.Image:
    """Add a legend to a frame, and make its size even, as MP4 requires."""
    legend = Scale(JOIN_COLORS, "join index  0", f"{robots - 1}    {count} of {robots} robots")
    whole = add_legend(picture, legend, picture.width / _LEGEND_WIDTH)
    return whole.crop((0, 0, whole.width // 2 * 2, whole.height // 2 * 2))


def _webp(frames: Sequence[Image.Image]) -> bytes:
    """Encode frames as an animated WebP."""
    return encode_webp(frames, [FRAME_MS] * (len(frames) - 1) + [LAST_MS], _QUALITY)


def encode_webp(frames: Sequence[Image.Image], durations: Sequence[int], quality: int) -> bytes:
    """Encode frames, each with its duration [ms], in a quality of 1 to 100."""
    stream = io.BytesIO()
    first, *rest = frames
    first.save(
        stream, "WEBP", save_all=True, append_images=rest, duration=[*durations], loop=0,
        quality=quality, method=2,
    )  # fmt: skip
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
    durations = [FRAME_MS] * len(rest) + [LAST_MS]
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
        with tempfile.TemporaryDirectory(prefix="tiswarm-movie-") as place:
            path = Path(place, "growth.mp4")
            iio.imwrite(
                path, pictures, plugin="FFMPEG", fps=1000 / FRAME_MS, macro_block_size=2,
                quality=None, output_params=["-preset", "veryfast", "-crf", "20"],
            )  # fmt: skip
            iio.immeta(path, plugin="FFMPEG")  # ffmpeg does not report a full disk
            return path.read_bytes()
    except (OSError, RuntimeError, ValueError, IndexError) as error:
        problem = f"{tempfile.gettempdir()}: no movie can be written; check the free space"
        raise EnvironmentTroubleError(problem) from error


_ENCODERS: dict[AnyMovie, Callable[[Sequence[Image.Image]], bytes]] = {
    "mp4": _mp4, "webp": _webp, "gif": _gif,
}  # fmt: skip
