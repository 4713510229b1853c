"""Writes named texts between marks of Markdown pages.

A mark is a comment that GitHub and the site do not show; the text between it and the mark of the
end is written by a program, all else by people. A text of one line stands within a sentence or a
cell of a table, a text of several lines between lines of their own:

    Structures reach <!-- results: height -->43.8 R<!-- end --> of 65 R.

    <!-- results: sizes -->
    | structure | height [R] |
    |---|---|
    | tower | 43.8 |
    <!-- end -->
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tiswarm.base.errors import InputError

_COMMENT = re.compile(r"<!--(.*?)-->", re.DOTALL)

_NAME = re.compile(r"results: ([\w.-]+)")
"""The comment that opens a marked text."""

_BEFORE_BLOCK = " \t>-*+.0123456789"
"""Letters after which a comment still begins a line, an item of a list or a quotation."""


@dataclass(frozen=True)
class MarkedText:
    """A text between two marks of a page."""

    name: str
    """Name of the text."""

    line: int
    """Line of the opening mark, counted from 1."""

    start: int
    """Index of the first letter after the opening mark."""

    end: int
    """Index of the first letter of the closing mark."""


def marked_texts(page: str, path: Path) -> list[MarkedText]:
    """List the marked texts of a page from top to bottom.

    Args:
        page: Text of the page.
        path: Its file, for messages.

    Raises:
        InputError: a mark is misspelled, not closed, or closes nothing.
    """
    texts = []
    opening = None
    for comment in _COMMENT.finditer(page):
        content = comment[1].strip()
        line = _line_of(page, comment.start())
        if content == "end":
            if opening is None:
                raise InputError("nothing ends here; remove this mark", path=path, line=line)
            name, opening_line, start = opening
            texts.append(MarkedText(name, opening_line, start, comment.start()))
            opening = None
        elif content.lower().startswith("result"):
            mark = _NAME.fullmatch(content)
            if mark is None:
                problem = f"not a mark: {content}; write results: NAME"
                raise InputError(problem, path=path, line=line)
            if opening is not None:
                raise _unclosed(opening[0], path, opening[1])
            opening = (mark[1], line, comment.end())
    if opening is not None:
        raise _unclosed(opening[0], path, opening[1])
    return texts


def write_texts(page: str, texts: Mapping[str, str], path: Path) -> str:
    """Return a page with named texts between its marks.

    Args:
        page: Text of the page.
        texts: Text of each name; one with several lines becomes a block.
        path: File of the page, for messages.

    Raises:
        InputError: a name is unknown, or a mark stands where Markdown would not show its text.
    """
    parts = []
    end = 0
    for marked in marked_texts(page, path):
        if marked.name not in texts:
            problem = "there is no such text; add it to benchmarks/statements.py"
            raise InputError(problem, path=path, line=marked.line, key=marked.name)
        text = texts[marked.name]
        _check_place(page, marked, path, is_block="\n" in text)
        parts.append(page[end : marked.start])
        parts.append(f"\n{text}\n" if "\n" in text else text)
        end = marked.end
    return "".join([*parts, page[end:]])


def outdated_texts(page: str, texts: Mapping[str, str], path: Path) -> list[str]:
    """List `file:line: name` of each text that `write_texts` would change.

    Args:
        page: Text of the page.
        texts: Text of each name.
        path: File of the page.

    Raises:
        InputError: as `write_texts` does.
    """
    written = write_texts(page, texts, path)
    pairs = zip(marked_texts(page, path), marked_texts(written, path), strict=True)
    return [
        f"{path}:{before.line}: {before.name}"
        for before, after in pairs
        if page[before.start : before.end] != written[after.start : after.end]
    ]


def _check_place(page: str, marked: MarkedText, path: Path, *, is_block: bool) -> None:
    """Refuse a block within a line, and a text of one line at its start.

    Markdown shows a line that begins with a comment as it stands, without links or emphasis.
    """
    before = page[: marked.start].rpartition("\n")[2].rpartition("<!--")[0]
    after = page[marked.end :].partition("\n")[0].partition("-->")[2]
    if is_block and (before.strip() or after.strip()):
        problem = "the text has several lines; give each of its two marks a line of its own"
        raise InputError(problem, path=path, line=marked.line, key=marked.name)
    if not is_block and not before.strip(_BEFORE_BLOCK):
        problem = "a mark begins the line, which Markdown shows as it stands; put a word before it"
        raise InputError(problem, path=path, line=marked.line, key=marked.name)


def _unclosed(name: str, path: Path, line: int) -> InputError:
    problem = "the mark is not closed; add <!-- end --> behind the text"
    return InputError(problem, path=path, line=line, key=name)


def _line_of(page: str, index: int) -> int:
    return page.count("\n", 0, index) + 1
