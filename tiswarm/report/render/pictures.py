"""Draws the pictures of a run with the first renderer that works on this machine."""

import io
import pickle
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tiswarm.errors import EnvironmentTroubleError, InputError
from tiswarm.progress import Progress
from tiswarm.records.io import write_bytes
from tiswarm.report.folder import choose_case, read_cases, subfolder
from tiswarm.report.render.legend import add_legend
from tiswarm.report.render.packages import installation_advice
from tiswarm.report.render.raycast import draw
from tiswarm.report.render.scene import Scene
from tiswarm.report.render.tiles import tile_tracer

RENDERERS = ("open3d", "open3d-raycast", "taichi")
"""Best first; the last needs nothing but the engine itself."""

CHILD = (sys.executable, "-m", "tiswarm.report.render.child")
TIME_LIMIT = 60.0
"""Time that a child may take to start and to draw small scenes [s]."""

CAPSULES_PER_SECOND = 2_000.0
"""Slowest drawing that a child is granted more time for."""

BLANK_SHARE = 0.001
"""Share of pixels that must differ from the corner in a picture that shows something."""


@dataclass(frozen=True, kw_only=True)
class Rendered:
    """A picture that was drawn."""

    path: Path
    renderer: str
    reason: str
    """Why better renderers did not, or nothing."""


class RendererError(Exception):
    """A renderer gave no picture; the text says why."""


def render_run(
    folder: Path, *, progress: Progress, renderer: str | None = None, case: str | None = None
) -> list[Rendered]:
    """Draw every picture of one case of a run into `renders/`.

    Of the first case with most robots, unless `case` names one, then part of the file names too;
    by the best renderer that works, unless `renderer` names one.

    Raises:
        InputError: for an unknown renderer or case, or a damaged run.
        EnvironmentTroubleError: where the renderer asked for does not work here.
    """
    from tiswarm.report.render.subjects import build_pictures  # noqa: PLC0415 - slow to import

    planned = build_pictures(choose_case(read_cases(folder), case, folder))
    suffix = "" if case is None else f"-{case}"
    place = subfolder(folder, "renders")
    scenes = [plan.scene for plan in planned.values()]
    pictures, used, reason = draw_scenes(scenes, renderer, place)
    progress.info(f"drawn by {used}" + (f" because {reason}" if reason else ""))
    drawn = []
    for (name, plan), picture in zip(planned.items(), pictures, strict=True):
        stream = io.BytesIO()
        add_legend(Image.fromarray(picture), plan.legend).save(stream, format="PNG")
        path = place / f"{name}{suffix}.png"
        write_bytes(path, stream.getvalue())
        progress.info(f"renders/{path.name}")
        drawn.append(Rendered(path=path, renderer=used, reason=reason))
    return drawn


def draw_scenes(
    scenes: list[Scene], only: str | None, place: Path | None = None
) -> tuple[list[NDArray[np.uint8]], str, str]:
    """Try the renderers in turn, or the only one that is wanted.

    Args:
        scenes: What to draw.
        only: The only renderer to use, if any.
        place: Folder for files on the way; the system's if None.

    Returns:
        The pictures, who drew them, and why no better renderer did.

    Raises:
        InputError: for an unknown renderer.
        EnvironmentTroubleError: where the renderer asked for does not work here.
    """
    if only is not None and only not in RENDERERS:
        msg = f"unknown renderer {only!r}; choose one of {', '.join(RENDERERS)}"
        raise InputError(msg, key="--renderer")
    failures: list[str] = []
    for name in RENDERERS if only is None else (only,):
        try:
            if name == "taichi":  # safe enough for this process, where it may be compiled already
                pictures = [draw(scene, tile_tracer(scene)) for scene in scenes]
            else:
                pictures = draw_in_child(scenes, name, place)
        except RendererError as error:
            failures.append(f"{name}: {error}")
        else:
            advice = installation_advice() if failures else []
            return pictures, name, "; ".join([*failures, *advice])
    remedies = ", or ".join([*installation_advice(), "leave the choice of the renderer open"])
    msg = f"cannot draw with {failures[0]}; {remedies}"
    raise EnvironmentTroubleError(msg)


def draw_in_child(
    scenes: list[Scene], renderer: str, folder: Path | None = None
) -> list[NDArray[np.uint8]]:
    """Draw scenes in a process of their own, and trust nothing it says.

    Raises:
        RendererError: if it dies, takes too long, or its pictures are missing or blank.
    """
    capsules = sum(len(scene.radius) for scene in scenes)
    time_limit = TIME_LIMIT + capsules / CAPSULES_PER_SECOND
    with tempfile.TemporaryDirectory(prefix=".", suffix=".tmp", dir=folder) as place:
        files = []
        for index, scene in enumerate(scenes):
            files += [str(Path(place, f"{index}{suffix}")) for suffix in ("", ".png")]
            Path(place, str(index)).write_bytes(pickle.dumps(scene))
        command = [*CHILD, *files, "--renderer", renderer]
        try:
            done = subprocess.run(  # noqa: S603 - our own module
                command, stdin=subprocess.DEVNULL, capture_output=True, timeout=time_limit,
                check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired as error:
            msg = f"no picture within {time_limit:.0f} s"
            raise RendererError(msg) from error
        if done.returncode:
            raise RendererError(_last_words(done))
        return [_read(Path(file), scene) for file, scene in zip(files[1::2], scenes, strict=True)]


def _last_words(done: subprocess.CompletedProcess[bytes]) -> str:
    """Tell how a child ended."""
    if done.returncode < 0:
        return f"killed by {signal.Signals(-done.returncode).name}"
    lines = done.stderr.decode(errors="replace").strip().splitlines()
    return lines[-1].strip() if lines else f"exit status {done.returncode}"


def _read(path: Path, scene: Scene) -> NDArray[np.uint8]:
    """Read a child's picture and check that it shows something."""
    try:
        with Image.open(path) as image:
            picture = np.asarray(image.convert("RGB"))
    except OSError as error:
        msg = "it wrote no picture"
        raise RendererError(msg) from error
    if picture.shape[:2] != (scene.camera.height, scene.camera.width):
        msg = f"its picture has the wrong size, {picture.shape[1]} x {picture.shape[0]}"
        raise RendererError(msg)
    if is_blank(picture):
        msg = "its picture is blank"
        raise RendererError(msg)
    return picture


def is_blank(picture: NDArray[np.uint8]) -> bool:
    """Tell whether nearly all pixels look like the top left one."""
    difference = np.abs(picture.astype(np.int16) - picture[0, 0]).max(axis=2)
    return bool((difference > 12).mean() < BLANK_SHARE)  # noqa: PLR2004 - visible at all
