"""The colors of a picture, and the legend that says what they mean."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from tiswarm.report.render.camera import Array

TRUE_BLUE = (0.0, 0.447, 0.698)
ESTIMATE_ORANGE = (0.902, 0.624, 0.0)
JOIN_COLORS = np.array([
    [0.283, 0.141, 0.458], [0.254, 0.265, 0.530], [0.207, 0.372, 0.553], [0.164, 0.471, 0.558],
    [0.128, 0.567, 0.551], [0.135, 0.659, 0.518], [0.267, 0.749, 0.441], [0.478, 0.821, 0.318],
    [0.741, 0.873, 0.150], [0.993, 0.906, 0.144],
])  # fmt: skip
"""The viridis scale without its darkest end, from the first robot to the last."""

MARGIN = 18
BAND = 62
"""Height of the white band above the picture that holds the legend [pixels]."""

FONT = 26
INK = (40, 40, 40)

FORCE_COLORS = np.array([
    [0.65, 0.72, 0.80], [0.91, 0.80, 0.62], [0.95, 0.58, 0.33], [0.84, 0.26, 0.20],
    [0.53, 0.03, 0.15],
])  # fmt: skip
"""From idle to heavily loaded: pale gray-blue over orange to dark red."""

ERROR_COLORS = np.array(
    [[0.988, 0.941, 0.765], [0.976, 0.714, 0.298], [0.894, 0.341, 0.180], [0.549, 0.051, 0.184]]
)
"""From none to large: cream over orange to dark red."""


@dataclass(frozen=True)
class Keys:
    """What single colors mean."""

    entries: tuple[tuple[tuple[float, float, float], str], ...]


@dataclass(frozen=True)
class Scale:
    """What a range of colors means."""

    colors: Array
    """Red, green, blue along the range, shape (n, 3)."""

    low: str
    high: str


Legend = Keys | Scale


def colors_along(share: NDArray[np.floating], colors: Array) -> Array:
    """Colors at places from 0 to 1 along a range, shape (n, 3)."""
    scale = np.linspace(0.0, 1.0, len(colors))
    return np.column_stack([np.interp(share, scale, channel) for channel in colors.T])


def add_legend(picture: Image.Image, legend: Legend) -> Image.Image:
    """Put a legend above a picture."""
    whole = Image.new("RGB", (picture.width, picture.height + BAND), "white")
    whole.paste(picture, (0, BAND))
    pen = ImageDraw.Draw(whole)
    font = ImageFont.load_default(FONT)
    if isinstance(legend, Scale):
        _bar(pen, font, legend)
        return whole
    left = MARGIN
    for color, text in legend.entries:
        pen.ellipse((left, MARGIN, left + 24, MARGIN + 24), fill=_rgb(color))
        pen.text((left + 34, MARGIN + 12), text, INK, font, anchor="lm")
        left += 70 + int(pen.textlength(text, font))
    return whole


def _bar(
    pen: ImageDraw.ImageDraw, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, legend: Scale
) -> None:
    """Draw a range of colors between the meanings of its ends."""
    length = 200
    pen.text((MARGIN, MARGIN), legend.low, INK, font)
    left = MARGIN + int(pen.textlength(f"{legend.low} ", font))
    for x, color in enumerate(colors_along(np.linspace(0.0, 1.0, length), legend.colors)):
        pen.line((left + x, MARGIN + 6, left + x, MARGIN + 26), fill=_rgb(color))
    pen.text((left + length, MARGIN), f" {legend.high}", INK, font)


def _rgb(color: Iterable[float]) -> tuple[int, ...]:
    return tuple(round(255 * float(part)) for part in color)
