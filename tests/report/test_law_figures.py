"""A run that is held against laws has figures of them."""

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from tests.report.conftest import is_blank, write_table
from tiswarm.errors import InputError
from tiswarm.progress import Progress
from tiswarm.report.figures import draw_figures
from tiswarm.report.law_figures import (
    LAW_FIGURES,
    LAW_POINTS,
    draw_cross_section,
    draw_towers,
    read_law_points,
)

HEADER = "law,series,x,mean,std,structures,fitted"
SERIES = {
    "tower height over F": ([""], [1.0, 2.5, 5.0, 10.0, 25.0]),
    "tower peak over F": ([""], [1.0, 2.5, 5.0, 10.0, 25.0]),
    "tower cross-section": (["F = 5", "F = 10"], [0.0, 1.0, 2.0, 3.0, 4.0]),
    "tower height over N": (["F = 1", "F = 10"], [25.0, 50.0, 75.0, 100.0]),
    "tower height over B": (["F = 2.5", "F = 5"], [1.5, 3.0, 6.0, 10.0]),
    "tower peak over J": (["F = 2.5", "F = 5"], [1.0, 2.0, 5.0, 1000.0]),
    "cantilever reach": (["F = 1", "F = 25"], [1.0, 5.0, 50.0, 100.0]),
    "bridge success": (["F = 2.5", "F = 10"], [20.0, 25.0, 30.0]),
    "chain depth over F": ([""], [2.5, 5.0, 10.0, 25.0]),
    "chain depth over N": (["F = 2.5", "F = 25"], [25.0, 50.0, 100.0]),
}


def write_points(folder, laws):
    """Write points on straight lines; where there is one structure, there is no deviation."""
    rows = [
        [law, name, x, 0.01 * x, "" if place else 0.1, 10 - 9 * bool(place), 0.009 * x]
        for law in laws
        for name in SERIES[law][0]
        for place, x in enumerate(SERIES[law][1])
    ]
    write_table(folder / LAW_POINTS, HEADER, rows)


@pytest.mark.parametrize("laws", [list(SERIES), []], ids=["every law", "no law"])
def test_every_law_figure_is_drawn(run_folder, laws):
    """Each shows something, axes at least, in place of the figures of errors."""
    write_points(run_folder, laws)

    written = draw_figures(run_folder, Progress())

    assert {path.stem for path in written} == set(LAW_FIGURES)
    for path in written:
        with Image.open(path) as image:
            assert not is_blank(image)


def test_figures_show_the_points_and_the_published_form(tmp_path):
    """Means are where the table says; dashed is what was fitted to them."""
    write_points(tmp_path, SERIES)
    laws = read_law_points(tmp_path)

    over_f = draw_towers(laws, "").axes[0]
    section = draw_cross_section(laws, "").axes[0]

    dots, dashed = over_f.lines[0], over_f.lines[-1]
    np.testing.assert_allclose(
        dots.get_xydata(), np.outer(SERIES["tower height over F"][1], [1, 0.01])
    )
    np.testing.assert_allclose(dashed.get_ydata(), laws["tower height over F"][""].fitted)
    assert dashed.get_linestyle() == "--"
    assert section.get_xscale() == section.get_yscale() == "log"
    assert section.lines[0].get_xdata().min() == 1.0


def test_r2_is_what_the_form_explains(tmp_path):
    """The number on a figure is that of its own points."""
    write_points(tmp_path, SERIES)
    table = pd.read_csv(tmp_path / LAW_POINTS)
    chosen = table[table["law"] == "chain depth over F"]

    points = read_law_points(tmp_path)["chain depth over F"][""]

    left = ((chosen["mean"] - chosen["fitted"]) ** 2).sum()
    spread = ((chosen["mean"] - chosen["mean"].mean()) ** 2).sum()
    assert points.r2 == pytest.approx(1.0 - left / spread)


def test_damaged_points_are_refused_by_name(run_folder):
    """The message names the file."""
    (run_folder / LAW_POINTS).write_text("law,series\ntower,F\n")

    with pytest.raises(InputError, match=r"law-points\.csv: cannot be read"):
        draw_figures(run_folder, Progress())
