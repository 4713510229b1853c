"""The colors of a picture, and the legend that says what they mean."""

from collections.abc import Iterable

import numpy as np
from PIL import Image, ImageDraw, ImageFont

TRUE_BLUE = (0.0, 0.447, 0.698)
ESTIMATE_ORANGE = (0.902, 0.624, 0.0)
JOIN_COLORS = np.array(
    [
        [0.283, 0.141, 0.458],
        [0.254, 0.265, 0.530],
        [0.207, 0.372, 0.553],
        [0.164, 0.471, 0.558],
        [0.128, 0.567, 0.551],
        [0.135, 0.659, 0.518],
        [0.267, 0.749, 0.441],
        [0.478, 0.821, 0.318],
        [0.741, 0.873, 0.150],
        [0.993, 0.906, 0.144],
    ]
)
"""The viridis scale without its darkest end, from the first robot to the last."""

MARGIN = 18
BAND = 62
"""Height of the white band above the picture that holds the legend [pixels]."""

FONT = 26
INK = (40, 40, 40)


def add_legend(picture: Image.Image, name: str) -> Image.Image:
    """Put the legend of a picture, chosen by the picture's name, above it."""
    whole = Image.new("RGB", (picture.width, picture.height + BAND), "white")
    whole.paste(picture, (0, BAND))
    pen = ImageDraw.Draw(whole)
    font = ImageFont.load_default(FONT)
    if name == "structure":
        _bar(pen, font)
        return whole
    left = MARGIN
    for color, text in ((TRUE_BLUE, "true"), (ESTIMATE_ORANGE, "estimated")):
        pen.ellipse((left, MARGIN, left + 24, MARGIN + 24), fill=_rgb(color))
        pen.text((left + 34, MARGIN + 12), text, INK, font, anchor="lm")
        left += 70 + int(pen.textlength(text, font))
    return whole


def _bar(pen: ImageDraw.ImageDraw, font: ImageFont.FreeTypeFont | ImageFont.ImageFont) -> None:
    """Draw the scale of join order."""
    length, scale = 200, np.arange(len(JOIN_COLORS))
    pen.text((MARGIN, MARGIN), "joined first", INK, font)
    left = MARGIN + int(pen.textlength("joined first ", font))
    for x in range(length):
        place = x * scale[-1] / (length - 1)
        color = [np.interp(place, scale, channel) for channel in JOIN_COLORS.T]
        pen.line((left + x, MARGIN + 6, left + x, MARGIN + 26), fill=_rgb(color))
    pen.text((left + length, MARGIN), " last", INK, font)


def _rgb(color: Iterable[float]) -> tuple[int, ...]:
    return tuple(round(255 * float(part)) for part in color)
