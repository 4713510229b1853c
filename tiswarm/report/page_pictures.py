"""The pictures within a page: figures as SVG in the colors of the page, renders as WebP."""

import base64
import io
import re
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from html import escape
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from PIL import Image

from tiswarm.base.errors import InputError
from tiswarm.records.io import run_file
from tiswarm.report.captions import caption_of
from tiswarm.report.figure_style import NARROW, TRUE_BLUE

LARGEST = 7_900_000
"""Largest page [bytes]; pictures beyond it remain in files of their own."""

_FIRST = (
    "price",
    "grades",
    "accuracy",
    "convergence",
    "structure",
    "truth-and-estimate",
    "error",
    "sd",
    "contact",
)
"""Beginnings of the names of the first pictures; others follow by name."""

_SUFFIXES = {".png", ".gif", ".webp", ".mp4"}
_RENDER_SHARE = 0.5  # width on the page over that of the file
_MOVIE_WIDTH = 420  # of an animation on the page
_FIGURE_SHARE = 0.42  # of a figure without SVG, as runs of earlier versions have
_PIXELS = 96.0 / 72.0  # of a point of an SVG

_TAGS = {"svg", "g", "defs", "path", "use", "clipPath", "rect", "image", "text", "tspan"}
_ATTRIBUTES = {
    "viewBox", "id", "d", "style", "clip-path", "transform", "href", "x", "y", "width", "height",
}  # fmt: skip
_HREF = re.compile(r"#\w+|data:image/png;base64,[A-Za-z0-9+/=\s]+")
_STYLE = re.compile(r"[\w\s:;,.%#'-]*")
_CLIP = re.compile(r"url\(#\w+\)")
_COLORS = {
    "#000000": "currentColor",
    "#ffffff": "var(--page)",
    "#595959": "var(--soft)",
    "#666666": "var(--soft)",
    "#ebebeb": "var(--rule)",
    TRUE_BLUE.lower(): "var(--true)",
}
"""Color of a figure's file, and that on the page, which differs in the dark."""


class Shown(NamedTuple):
    """A picture within the page; sizes in pixels."""

    source: str  # the picture as a data URL, or the path of its file
    file: str
    caption: str
    width: int
    height: int
    wide: int  # width on the page
    drawing: str = ""  # instead of the source, an element <svg>
    narrow: str = ""  # the same figure, drawn for narrow screens

    @property
    def is_film(self) -> bool:
        """Whether it is a film, which the reader starts."""
        return self.file.endswith(".mp4")

    @property
    def size(self) -> int:
        """What it adds to the page [bytes]."""
        return len(self.source) + len(self.drawing) + len(self.narrow)


def show_pictures(folder: Path, room: int = LARGEST, *, case: str = "") -> list[Shown]:
    """Embed the pictures of a folder that fit into the room [bytes]; link the others.

    `case` is what pictures show whose names do not say it.
    """
    pictures = []
    paths = sorted([path for path in folder.glob("*") if path.suffix in _SUFFIXES], key=_place)
    with warnings.catch_warnings(), ThreadPoolExecutor() as pool:
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        shown = list(pool.map(_shown, paths))
    for path, picture in zip(paths, shown, strict=True):
        file, caption = f"{folder.name}/{path.name}", caption_of(path.stem, case)
        room -= picture.size
        if room <= 0:
            caption = f"{caption} Separate file {file}: page size limit."
            pictures.append(
                picture._replace(source=file, drawing="", narrow="", file=file, caption=caption)
            )
        else:
            pictures.append(picture._replace(file=file, caption=caption))
    return pictures


def show_drawing(file: str, caption: str, drawing: bytes, narrow: bytes) -> Shown:
    """Embed a figure that was encoded as SVG, and the same one for narrow screens.

    `file` is the name that the page gives it.
    """
    wide, width = _drawn(Path(file), drawing)
    column, _ = _drawn(Path(file), narrow)
    return Shown("", file, caption, 0, 0, wide=round(width), drawing=wide, narrow=column)


def _place(path: Path) -> tuple[int, str]:
    """Return the place of a picture among others: first the ones that show most."""
    first = (place for place, name in enumerate(_FIRST) if path.stem.startswith(name))
    return next(first, len(_FIRST)), path.name


def _shown(path: Path) -> Shown:
    """Read a picture, or the SVG beside it, without its caption."""
    vector = path.with_suffix(".svg")
    if path.parent.name == "figures" and vector.exists():
        drawing, width = _drawn(vector, _read(vector))
        column = path.with_name(f"{path.stem}{NARROW}.svg")
        narrow = _drawn(column, _read(column))[0] if column.exists() else ""
        return Shown("", "", "", 0, 0, wide=round(width), drawing=drawing, narrow=narrow)
    kind, data, (width, height) = _encoded(path)
    share = {"renders": _RENDER_SHARE}.get(path.parent.name, _FIGURE_SHARE)
    source = f"data:{kind};base64,{base64.b64encode(data).decode()}"
    wide = round(width * share) if path.suffix == ".png" else _MOVIE_WIDTH
    return Shown(source, "", "", width, height, wide=wide)


def _encoded(path: Path) -> tuple[str, bytes, tuple[int, int]]:
    """Read a picture; returns its format on the page, its data and its size [pixels]."""
    form = path.suffix[1:].upper()
    run_file(path)
    if form == "MP4":
        return "video/mp4", path.read_bytes(), (0, 0)
    try:
        with Image.open(path, formats=[form]) as image:
            if form != "PNG":
                return f"image/{form.lower()}", path.read_bytes(), image.size
            stream = io.BytesIO()
            image.convert("RGB").save(stream, "WEBP", quality=85, method=2)
            return "image/webp", stream.getvalue(), image.size
    except Exception as error:  # a damaged picture can raise any error
        raise _unreadable(path, error) from error


def _read(vector: Path) -> bytes:
    """Read a file of an SVG."""
    return run_file(vector, LARGEST).read_bytes()


def _drawn(path: Path, data: bytes) -> tuple[str, float]:
    """Write an SVG as an element of the page, in its colors; returns its width too [pixels].

    What a figure does not need, such as a script, is left out: others may have made the file.
    """
    try:
        root = ET.fromstring(data)  # noqa: S314 - expat limits expansion
        width = float(root.attrib["viewBox"].split()[2]) * _PIXELS
        return "".join(_written(root)), width
    except (ET.ParseError, LookupError, ValueError) as error:
        raise _unreadable(path, error) from error


def _written(element: ET.Element) -> Iterator[str]:
    """Write an element of an SVG and what is in it."""
    tag = element.tag.rpartition("}")[2]
    if tag not in _TAGS:
        return
    given = {name.rpartition("}")[2]: value for name, value in element.attrib.items()}
    kept = {name: value for name, value in given.items() if _is_kept(tag, name, value)}
    if style := re.sub(r"font-family:[^;]*;? ?", "", kept.pop("style", "")):
        kept["style"] = re.sub(r"#[0-9a-f]{6}\b", _on_page, style)
    if given.get("id", "").startswith("PathCollection"):
        kept["class"] = "dots"
    attributes = [f' {name}="{escape(value)}"' for name, value in kept.items()]
    yield f"<{tag}{''.join(attributes)}>"
    yield escape((element.text or "").strip())
    for child in element:
        yield from _written(child)
    yield f"</{tag}>"


def _is_kept(tag: str, name: str, value: str) -> bool:
    """Whether the page needs an attribute; names of groups occur in each figure."""
    if name not in _ATTRIBUTES or (tag == "svg" and name != "viewBox"):
        return False
    patterns = {"href": _HREF, "style": _STYLE, "clip-path": _CLIP}
    if name == "id":
        return tag in {"path", "clipPath"}
    return name not in patterns or patterns[name].fullmatch(value) is not None


def _on_page(color: re.Match[str]) -> str:
    """Return the color on the page of one in a file."""
    return _COLORS.get(color[0], color[0])


def _unreadable(path: Path, error: Exception) -> InputError:
    form = path.suffix[1:].upper()
    problem = f"is no {form} picture that can be shown: {error}; delete it, or draw it again"
    return InputError(problem, path=path)
