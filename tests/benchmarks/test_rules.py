"""The comparison of rules of growth runs the rules of the page, and the page has its rows."""

import numpy as np

from benchmarks.rules import PAGE, SHOWN, compare


def test_rules_of_the_page_are_compared():
    """The same rule in Python and as a kernel has the same values; a row states each."""
    both = ("reactive-build", "reactive-build-python")

    (kernel, grown), (python, _) = compare(both, robots=6, seeds=2)

    for name in ("height", "radius", "peak", "flips"):
        np.testing.assert_array_equal(getattr(kernel, name), getattr(python, name))
    assert grown.robot_count.tolist() == [6, 6]
    cells = kernel.row.split("|")[1:-1]
    assert cells[0] == " `reactive-build` "
    assert cells[1].strip() == f"{kernel.height.mean():.1f} ({kernel.height.std(ddof=1):.1f})"
    assert len(cells) == 6


def test_the_page_has_a_row_of_each_rule():
    """Rows of ReactiveBuild agree but for their cost."""
    rows = [line for line in PAGE.read_text().splitlines() if line.startswith("| `")]
    value = {row.split("`")[1]: row.split("|")[2:-2] for row in rows[-5:]}

    assert {*value} == {*SHOWN, "reactive-build-python"}
    assert value["reactive-build"] == value["reactive-build-python"]
