"""Programs write named texts between marks of pages, and nothing else."""

from pathlib import Path

import pytest

from benchmarks.marks import outdated_texts, write_texts
from tiswarm.base.errors import InputError

PATH = Path("docs/page.md")
TEXTS = {"height": "43.8 R", "sizes": "| kind | height |\n|---|---|\n| tower | 43.8 |"}
PAGE = """# Sizes

They reach <!-- results: height -->1 R<!-- end --> of 65 R. <!-- A remark. -->

<!-- results: sizes -->
| kind |
<!-- end -->
"""


def test_texts_are_written_between_marks():
    """A text of one line stays within its line; a table has lines of its own."""
    written = write_texts(PAGE, TEXTS, PATH)

    assert written == PAGE.replace("1 R", "43.8 R").replace("| kind |", TEXTS["sizes"])


def test_writing_a_page_again_changes_nothing():
    """The command can run at any time."""
    written = write_texts(PAGE, TEXTS, PATH)

    assert write_texts(written, TEXTS, PATH) == written
    assert outdated_texts(written, TEXTS, PATH) == []


def test_texts_that_differ_are_named_with_their_lines():
    """A failed test leads its reader to the block."""
    outdated = outdated_texts(PAGE, TEXTS, PATH)

    assert outdated == [f"{PATH}:3: height", f"{PATH}:5: sizes"]


@pytest.mark.parametrize(
    ("page", "message"),
    [
        ("\n\nby <!-- results: width -->1 R<!-- end -->", ":3: width: there is no such text; "),
        ("by <!-- results: height -->1 R", ":1: height: the mark is not closed; "),
        ("by <!-- results: height -->1 <!-- results: sizes -->", ":1: height: the mark is not "),
        ("by 1 R<!-- end -->", ":1: nothing ends here; "),
        ("by <!-- result: height -->1 R<!-- end -->", ":1: not a mark: result: height; "),
        ("by <!-- results:height -->1 R<!-- end -->", ":1: not a mark: results:height; "),
        ("\n<!-- results: height -->1 R<!-- end -->", ":2: height: a mark begins the line"),
        ("- <!-- results: height -->1 R<!-- end -->", ":1: height: a mark begins the line"),
        ("by <!-- results: sizes -->\n<!-- end -->", ":1: sizes: the text has several lines; "),
        ("<!-- results: sizes -->\n<!-- end --> R", ":1: sizes: the text has several lines; "),
    ],
)  # fmt: skip
def test_a_page_whose_marks_are_wrong_is_refused(page, message):
    """The message has file, line, name and remedy."""
    with pytest.raises(InputError) as refused:
        write_texts(page, TEXTS, PATH)

    assert str(refused.value).startswith(f"{PATH}{message}")
