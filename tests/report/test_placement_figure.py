"""The figure of a robot's places has a column for each measurement."""

import numpy as np
import pytest

from tiswarm.base.errors import InputError
from tiswarm.report import figure_style
from tiswarm.report.explanation import (
    Placement,
    Stage,
    draw_placement,
    show_placement,
)

RING = np.column_stack([np.cos(np.arange(50.0)), np.sin(np.arange(50.0)), np.zeros(50)])
PANELS = [Stage("touches robot 3", 4.0 * RING), Stage("height", RING[:1]), Stage("none", RING[:0])]
DOCKS = np.array([[0.0, 0.0, 1.0], [90.0, 0.0, 0.0]])
PLACEMENT = Placement(PANELS, np.zeros(3), DOCKS, radius=32.9, unit="mm")


@pytest.mark.parametrize("in_rows", [False, True])
def test_every_place_is_within_its_axes(in_rows):
    """Panels share the limits of the first one, where most places remain."""
    figure = draw_placement(PLACEMENT, in_rows=in_rows)

    titles = [words for axes in figure.axes for words in (axes.get_title(), axes.get_ylabel())]
    assert {panel.title for panel in PANELS} <= {*titles}
    assert len(figure.axes) == 2 * len(PANELS)
    for axes in figure.axes:
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        x, y = np.asarray(axes.collections[1].get_offsets()).reshape(-1, 2).T
        assert ((left < x) & (x < right) & (low < y) & (y < high)).all()
        assert len(axes.collections[0].get_offsets()) == 1  # the far dock is left out


@pytest.mark.parametrize(
    ("radius", "unit", "words"), [(32.9, "mm", "2 R = 65.8 mm"), (1.0, "R", "2 R")]
)
def test_the_scale_bar_is_as_long_as_its_words_say(radius, unit, words):
    """In R, and in the log's unit where that is another."""
    figure = draw_placement(PLACEMENT._replace(radius=radius, unit=unit))

    [bar] = [line for axes in figure.axes for line in axes.lines if line.get_gid() == "scale"]
    assert np.ptp(bar.get_xdata()) == 2.0
    assert [text.get_text() for text in bar.axes.texts] == [words]


def test_a_page_gets_a_figure_for_each_width():
    """Names are text, also where a unit has signs of formulas."""
    shown = show_placement("explain-7.svg", PLACEMENT._replace(unit="$m<m"), "a caption")

    assert shown.caption == "a caption"
    for drawing in (shown.drawing, shown.narrow):
        assert drawing.startswith("<svg") and "touches robot 3" in drawing  # noqa: PT018
        assert "$m&lt;m" in drawing


def test_a_picture_is_written_as_its_name_says(tmp_path):
    """Other endings are refused before anything is drawn."""
    for name in ("places.png", "places.pdf"):
        figure_style.write(tmp_path / name, lambda: draw_placement(PLACEMENT))
        assert (tmp_path / name).stat().st_size > 1000

    with pytest.raises(InputError, match=r"'places.gif' should end in .png or .pdf"):
        figure_style.write(tmp_path / "places.gif", lambda: pytest.fail("it is drawn"))
