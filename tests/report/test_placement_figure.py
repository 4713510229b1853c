"""The figure of a robot's places has a column for each measurement."""

import numpy as np
import pytest

from tiswarm.base.errors import InputError
from tiswarm.report.placement_figure import Panel, draw_placement, write_placement

RING = np.column_stack([np.cos(np.arange(50.0)), np.sin(np.arange(50.0)), np.zeros(50)])
PANELS = [Panel("touches robot 3", 4.0 * RING), Panel("height", RING[:1]), Panel("none", RING[:0])]
DOCKS = np.array([[0.0, 0.0, 1.0], [90.0, 0.0, 0.0]])


def test_every_place_is_within_its_axes():
    """Columns share the limits of the first one, where most places remain."""
    figure = draw_placement(PANELS, np.zeros(3), DOCKS)

    assert [axes.get_title() for axes in figure.axes[:3]] == [panel.title for panel in PANELS]
    for axes in figure.axes:
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        x, y = np.asarray(axes.collections[1].get_offsets()).reshape(-1, 2).T
        assert ((left < x) & (x < right) & (low < y) & (y < high)).all()
        assert len(axes.collections[0].get_offsets()) == 1  # the far dock is left out


def test_a_picture_is_written_as_its_name_says(tmp_path):
    """Other endings are refused before anything is drawn."""
    for name in ("places.png", "places.pdf"):
        write_placement(tmp_path / name, PANELS, np.zeros(3), DOCKS)
        assert (tmp_path / name).stat().st_size > 1000

    with pytest.raises(InputError, match=r"'places.gif' should end in .png or .pdf"):
        write_placement(tmp_path / "places.gif", PANELS, np.zeros(3), DOCKS)
