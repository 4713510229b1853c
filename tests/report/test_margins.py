"""Margins of robots and loads of contacts, as readers of pages and pictures see them."""

import math
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from tests.browser import probe
from tiswarm.report.figure_style import MARGIN_COLORS, UNKNOWN_GRAY, rgb
from tiswarm.report.page import Page
from tiswarm.report.page_tables import weakest_contacts
from tiswarm.report.pictures.pictures import add_legend, build_pictures
from tiswarm.report.pictures.scene import paint
from tiswarm.report.run_data import load_run
from tiswarm.report.swarm_view import build_view, read_case_view

MARGINS = [1.0, 1.5, 2.0, 10.0**0.5, 5.0, 9.9, 10.0, 80.0, 1e9, math.nan, math.nan, 3.0]
"""Margins of the twelve robots of a case; two have no contact with load."""


@pytest.fixture
def loaded_run(run_folder):
    """A run whose first case has margins, as where docks have a strength."""
    path = run_folder / "cases" / "0-baseline" / "robots.csv"
    pd.read_csv(path).assign(margin=MARGINS).to_csv(path, index=False)
    return run_folder


def test_equal_ratios_of_margins_are_equal_steps_of_color(loaded_run):
    """Oracle: the place of log10(margin) from 1 to 10, color by color; beyond 10, the last one."""
    view = read_case_view(load_run(loaded_run).cases[0])
    colors = [rgb(color) for color in MARGIN_COLORS]

    painted = paint(view.margin_coloring)

    for margin, color in zip(MARGINS, painted, strict=True):
        if math.isnan(margin):
            assert color.tolist() == rgb(UNKNOWN_GRAY).tolist()
            continue
        place = min(math.log10(margin), 1.0) * (len(colors) - 1)
        k = min(int(place), len(colors) - 2)
        expected = colors[k] + (place - k) * (colors[k + 1] - colors[k])
        assert np.allclose(color, expected, atol=1e-6)


def test_contacts_without_load_give_robots_no_color(loaded_run):
    """Structures in Python have infinite margins there; files have none."""
    view = read_case_view(load_run(loaded_run).cases[0])
    margin = np.where(np.isnan(MARGINS), np.inf, MARGINS)

    endless = replace(view, margin=margin).margin_coloring

    np.testing.assert_array_equal(endless.value, view.margin_coloring.value)
    assert endless.gray == "no load"


def test_pictures_state_what_a_margin_is(loaded_run):
    """The legend has the quantity, both ends, the scale, and what gray robots are."""
    view = read_case_view(load_run(loaded_run).cases[0])

    legend = build_pictures(view)["margin"].legend

    assert (legend.colors, legend.low, legend.high) == (MARGIN_COLORS, "margin  1", "10 or more")
    keys = [text for _, text in legend.keys]
    assert keys == ["weakest contact: strength / load, log scale", "no load"]


def test_the_legend_of_a_narrow_picture_is_whole(loaded_run):
    """Pictures are at least 450 pixels wide; what does not fit beside the bar is below it."""
    legend = build_pictures(read_case_view(load_run(loaded_run).cases[0]))["margin"].legend

    picture = add_legend(Image.new("RGB", (450, 10), "white"), legend)

    assert np.asarray(picture)[:, -3:].min() == 255


def test_pictures_and_views_have_margins_only_where_docks_have_a_strength(loaded_run):
    """The other cases have no column of margins."""
    run = load_run(loaded_run)
    first, *_, last = [case for case in run.cases if case.done]

    labels = [[c["label"] for c in case["colors"]] for case in build_view(run).data["cases"]]

    assert labels == [["error", "sensed force", "margin"], ["error", "sensed force"]]
    assert "margin" in build_pictures(read_case_view(first))
    assert "margin" not in build_pictures(read_case_view(last))


PROBE = """
quantity.value = "margin";
quantity.dispatchEvent(new Event("change"));
const { cases } = JSON.parse(document.getElementById("data").textContent);
const margins = coloringsOf(cases[0]).find(({ label }) => label === "margin");
found.shares = margins.value.map((margin) => margin === null ? null : shareOf(margins, margin));
found.marks = marksOf(margins);
found.written = [];
const write = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (text, ...rest) {
  found.written.push(text);
  write.call(this, text, ...rest);
};
dispatchEvent(new Event("afterprint")); // draws at once
const box = view.getBoundingClientRect();
for (let place = 0; place < 1e4 && !found.pointed; place++) {
  const [x, y] = [8 * (place % 100), 8 * Math.floor(place / 100)];
  const at = { clientX: box.left + x, clientY: box.top + y };
  view.dispatchEvent(new PointerEvent("pointermove", at));
  found.pointed = document.getElementById("pointed").textContent;
}
document.body.dataset.found = JSON.stringify(found);
"""


def test_the_page_draws_margins_as_pictures_do(loaded_run, tmp_path):
    """Shares of the scale, marks along it, words of the legend and of the robot pointed at."""
    run = load_run(loaded_run)
    page = Page(name="loaded", view=build_view(run)).html()
    view = read_case_view(run.cases[0])

    found = probe(page, PROBE, tmp_path, more=("--window-size=800,900",))

    assert found["troubles"] == []
    shares = [math.nan if share is None else share for share in found["shares"]]
    np.testing.assert_allclose(shares, view.margin_coloring.share, atol=1e-3)
    assert found["marks"] == [1, 2, 5, 10]
    legend = {"margin (weakest contact: strength / load)", "no load", "1", "2", "5", "≥ 10"}
    assert legend <= {*found["written"]}
    assert re.search(r"margin ([\d.]+|no load)\.$", found["pointed"])


def test_the_weakest_contacts_have_their_units():
    """Names of columns become headings with brackets; numbers are rounded, words are not."""
    loads = pd.DataFrame(
        {
            "robot": [4, 2],
            "dock": [0, 1],
            "neighbor": ["3", "ground"],
            "neighbor_dock": pd.Series([2, None], dtype="Int64"),
            "axial_N": [-12.34567, 3.0],
            "bending_N_m": [0.51234, 0.25],
            "stress_W_per_R2": [170.2, 9.0],
            "margin": [1.48061, np.nan],
        }
    )

    table = weakest_contacts(loads, "tower, seed 0")

    names = ["robot", "dock", "neighbor", "neighbor dock"]
    units = ["axial [N]", "bending [N m]", "stress [W / R^2]", "margin"]
    assert table.columns == names + units
    assert table.frame.to_numpy().tolist() == [
        ["4", "0", "3", "2", "-12.3", "0.512", "170", "1.48"],
        ["2", "1", "ground", "", "3", "0.250", "9", ""],
    ]
    assert "Case tower, seed 0" in table.note
