"""The figure of closed loops shows what robots build that go by estimates, beside the truth."""

import numpy as np
import pandas as pd
import pytest

from tests.report.conftest import require_alike
from tiswarm.report.curve_figures import painters
from tiswarm.report.run_data import RunData


@pytest.fixture
def run(tmp_path):
    """Two towers and two bridges; two conditions share those of robots that know the truth."""
    rows = []
    for by, condition, height, planned in (
        ("truth", "online", 30.0, np.nan),
        ("truth", "Algorithm 1", 30.0, np.nan),
        ("estimate", "online", 29.0, 0.9),
        ("estimate", "Algorithm 1", 20.0, 0.6),
    ):
        for kind, edge in (("tower", np.nan), ("bridge", 20.0)):
            for seed in (0, 1):
                row = {
                    "case": f"{seed}-{by}-{condition}-{kind}",
                    "series": condition,
                    "condition": condition,
                    "point": "",
                    "kind": kind,
                    "status": "done",
                    "reason": "",
                    "seed": seed,
                    "structure.navigate_by": by,
                    "right_edge_R": edge,
                    "height_R": height + seed,
                    "reach_R": 1.0,
                    "crossed": seed if kind == "bridge" else 0,
                    "flips_as_planned": planned,
                }
                rows.append(row)
    return RunData(tmp_path, pd.DataFrame(rows))


def test_rows_are_the_truth_and_each_condition(run):
    """Means are over the structures of a row; those that conditions share count once."""
    figure = painters(run)["building"].draw()

    drawn = {axes.get_xlabel(): axes for axes in figure.axes}
    assert [*drawn] == ["Tower height [R]", "Bridges closed [share]", "Flips as planned [share]"]
    height = drawn["Tower height [R]"]
    assert [label.get_text() for label in height.get_yticklabels()] == [
        "the truth", "online", "Algorithm 1",
    ]  # fmt: skip
    [bars] = height.containers
    assert bars[0].get_xdata().tolist() == [30.5, 29.5, 20.5]
    [bars] = drawn["Bridges closed [share]"].containers
    assert bars[0].get_xdata().tolist() == [0.5, 0.5, 0.5]
    assert "2 structures" in figure.legends[0].get_title().get_text()


def test_bars_of_shares_end_at_one(tmp_path):
    """The interval of 63 bridges of 64 was said to extend beyond all of them."""
    rows = pd.DataFrame({"seed": range(64), "crossed": [0] + 63 * [1]})
    rows = rows.assign(case="a", series="a", condition="a", point="", kind="bridge", status="done")
    rows = rows.assign(reason="", right_edge_R=20.0, flips_as_planned=1.0, height_R=1, reach_R=1)

    figure = painters(RunData(tmp_path, rows))["building"].draw(panels=["crossed"])

    (axes,) = figure.axes
    ((segment,),) = [bar.get_segments() for bar in axes.containers[0][2]]
    assert 0.9 < segment[0, 0] < 63 / 64 < segment[1, 0] < 1.0


def test_bars_of_shares_of_flips_are_those_of_means(tmp_path):
    """All flips of 64 structures were as planned, and Wilson's interval of 64 began at 94 %."""
    rows = pd.DataFrame({"seed": range(64), "crossed": 1, "flips_as_planned": 1.0})
    rows = rows.assign(case="a", series="a", condition="a", point="", kind="bridge", status="done")
    rows = rows.assign(reason="", right_edge_R=20.0, height_R=1, reach_R=1)

    figure = painters(RunData(tmp_path, rows))["building"].draw(panels=["flips_as_planned"])

    (axes,) = figure.axes
    ((segment,),) = [bar.get_segments() for bar in axes.containers[0][2]]
    assert segment[:, 0].tolist() == [1.0, 1.0]


def test_errors_of_beliefs_have_a_row_each(run):
    """Points that build the same kind differ in what their robots believe."""
    errors = run.summary[run.summary["kind"] == "tower"].drop(columns="structure.navigate_by")
    errors = errors[errors["condition"] == "online"].assign(flips_as_planned=0.9)
    errors["point"] = errors["series"] = ["shift 1 R", "shift 1 R", "shift 3 R", "shift 3 R"]

    figure = painters(RunData(run.folder, errors))["building"].draw()

    names = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert names == ["shift 1 R", "shift 3 R"]


def test_runs_by_the_truth_have_no_such_figure(run):
    """It would have nothing to show."""
    by_truth = run.summary[run.summary["structure.navigate_by"] == "truth"]

    assert painters(RunData(run.folder, by_truth)) == {}


def test_it_is_the_same_in_a_narrow_page(run):
    """Another width changes neither limits nor series."""
    require_alike(painters(run)["building"])
