"""How a structure grew, join by join, as a GIF or an MP4."""

import io
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image

from tiswarm.errors import EnvironmentTroubleError
from tiswarm.progress import Progress
from tiswarm.records.io import write_bytes
from tiswarm.report.folder import choose_case, read_cases, subfolder
from tiswarm.report.render.build import Robots, build_scene
from tiswarm.report.render.legend import JOIN_COLORS, Scale, add_legend
from tiswarm.report.render.pictures import Rendered, draw_scenes
from tiswarm.report.render.scene import Scene
from tiswarm.report.render.subjects import TRUE_SIZE, Subject, read_subject

Movie = Literal["gif", "mp4"]

MOST_FRAMES = 60
SHRINK = 2
"""Frames are so many times smaller than pictures."""

FRAME_MS = 90
LAST_MS = 2_500
"""How long the whole structure is shown before the GIF starts again [ms]."""

COLORS = 192
"""Colors of a GIF, chosen from its last frame."""


def animate_run(
    folder: Path,
    form: Movie,
    *,
    progress: Progress,
    renderer: str | None = None,
    case: str | None = None,
) -> Rendered:
    """Draw how the structure of a case grew into `renders/growth.gif` or `renders/growth.mp4`.

    Camera and ground are those of the whole structure in every frame. Case and renderer are
    chosen as `render_run` does.

    Raises:
        InputError: for an unknown case, or a damaged run.
        EnvironmentTroubleError: where a renderer or the library for MP4 is missing.
    """
    subject = read_subject(choose_case(read_cases(folder), case, folder))
    joined = _joins(len(subject.pose))
    place = subfolder(folder, "renders")
    pictures, used, reason = draw_scenes(_scenes(subject, joined), renderer, place)
    frames = [
        _with_legend(Image.fromarray(picture), count, len(subject.pose))
        for picture, count in zip(pictures, joined, strict=True)
    ]
    suffix = "" if case is None else f"-{case}"
    path = place / f"growth{suffix}.{form}"
    write_bytes(path, _gif(frames) if form == "gif" else _mp4(frames))
    because = f" because {reason}" if reason else ""
    progress.info(f"renders/{path.name}: {len(frames)} frames, drawn by {used}{because}")
    return Rendered(path=path, renderer=used, reason=reason)


def _joins(robots: int) -> list[int]:
    """How many robots are there in each frame, ascending to all of them."""
    counts: list[int] = (
        np.linspace(1, robots, min(robots, MOST_FRAMES)).round().astype(int).tolist()
    )
    return counts


def _scenes(subject: Subject, joined: Sequence[int]) -> list[Scene]:
    """Build a scene for each number of robots, as small as frames are."""
    whole = subject.robots(subject.pose, subject.by_join, TRUE_SIZE)
    around = whole.dock.reshape(-1, 3)
    scenes = []
    for count in joined:
        robots = Robots(
            center=whole.center[:count],
            dock=whole.dock[:count],
            color=whole.color[:count],
            look=whole.look,
        )
        scene = build_scene([robots], subject.ground_z, around=around)
        camera = scene.camera
        small = replace(camera, width=camera.width // SHRINK, height=camera.height // SHRINK)
        scenes.append(replace(scene, camera=small))
    return scenes


def _with_legend(picture: Image.Image, count: int, robots: int) -> Image.Image:
    """Put a legend above a frame, in even numbers of pixels, as MP4 wants them."""
    legend = Scale(JOIN_COLORS, "joined first", f"last, {count} of {robots} robots")
    band = add_legend(Image.new("RGB", (SHRINK * picture.width, 0)), legend)
    band = band.resize((picture.width, band.height // SHRINK), Image.Resampling.LANCZOS)
    height = picture.height + band.height
    frame = Image.new("RGB", (picture.width // 2 * 2, height // 2 * 2), "white")
    frame.paste(band, (0, 0))
    frame.paste(picture, (0, band.height))
    return frame


def _gif(frames: Sequence[Image.Image]) -> bytes:
    """Encode frames in one palette, so that no color flickers."""
    palette = frames[-1].quantize(COLORS)
    first, *rest = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    stream = io.BytesIO()
    first.save(
        stream,
        "GIF",
        save_all=True,
        append_images=rest,
        duration=[FRAME_MS] * len(rest) + [LAST_MS],
        loop=0,
    )
    return stream.getvalue()


def _mp4(frames: Sequence[Image.Image]) -> bytes:
    """Encode frames as H.264, which browsers and slides play."""
    try:
        import imageio.v3 as iio  # noqa: PLC0415 - an extra
        import imageio_ffmpeg  # noqa: F401, PLC0415 - what imageio calls
    except ImportError as error:
        msg = "MP4 needs more libraries; pip install 'tiswarm[video]', or leave --movie out for GIF"
        raise EnvironmentTroubleError(msg) from error
    with tempfile.TemporaryDirectory(prefix="tiswarm-movie-") as place:
        path = Path(place, "growth.mp4")
        pictures = [np.asarray(frame) for frame in frames]
        pictures += pictures[-1:] * (LAST_MS // FRAME_MS)
        iio.imwrite(path, pictures, plugin="FFMPEG", fps=1000 / FRAME_MS, macro_block_size=2)
        return path.read_bytes()
