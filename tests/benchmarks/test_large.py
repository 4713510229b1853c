"""The figure of large structures is of the stored results."""

from PIL import Image

from benchmarks import statements
from tests.benchmarks.commands import call


def test_the_figure_has_the_width_of_a_page(tmp_path):
    """It is drawn without growing anything."""
    file = tmp_path / "large.png"

    call("large", "--out", file)

    with Image.open(file) as picture:
        assert picture.width > 2 * picture.height


def test_each_structure_has_a_point_by_the_law_or_by_the_defaults():
    """Points name what differs: without a law there is no force threshold."""
    for kind, robots in statements.LARGE:
        law, default = (
            statements.large_point(kind, robots, by_law=by_law) for by_law in (True, False)
        )
        assert law or default
        assert ("force_threshold" in law) == bool(law)
        assert "force_threshold" not in default
