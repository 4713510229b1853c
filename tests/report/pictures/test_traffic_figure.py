"""The figure of traffic has a marker for robots that send, and a line for all others."""

import itertools

import numpy as np
import pandas as pd
import pytest

from tests.report.conftest import require_alike
from tiswarm.report.pictures.swarm_figures import label_offsets, painters
from tiswarm.report.run_data import RunData


@pytest.fixture
def run(tmp_path):
    """Two towers, by robots that send 1,000 B and err by 0.5 R, and by `joint`."""
    rows = [
        {
            "case": f"{condition}-{seed}",
            "series": condition,
            "condition": condition,
            "point": "",
            "kind": "tower",
            "robots": 100,
            "status": "done",
            "reason": "",
            "seed": seed,
            "rmse_R": error,
            "sent_B": sent,
        }
        for condition, error, sent in (("touch", 0.5, 1000.0), ("joint", 0.2, np.nan))
        for seed in (0, 1)
    ]
    return RunData(tmp_path, pd.DataFrame(rows))


def test_means_are_drawn_on_logarithmic_axes(run):
    """Who has all logs in one place sends nothing, and is a line."""
    [axes] = painters(run)["traffic"].draw().axes

    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    [bars] = axes.containers
    assert (bars[0].get_xdata()[0], bars[0].get_ydata()[0]) == (1000.0, 0.5)
    lines = {line.get_label(): line.get_ydata() for line in axes.lines}
    assert list(lines["joint"]) == [0.2, 0.2]
    assert bars.get_label() == "touch"
    assert [text.get_text() for text in axes.texts] == ["joint", "touch"]


def test_points_of_a_sweep_are_kept_apart(run):
    """A mean over structures that differ compares nothing."""
    rows = run.summary
    points = [rows.assign(point=f"gap {k} R", rmse_R=k * rows["rmse_R"]) for k in range(1, 11)]

    figure = painters(RunData(run.folder, pd.concat(points)))["traffic"].draw()

    assert [axes.get_title() for axes in figure.axes] == [f"gap {k} R" for k in range(1, 10)]
    errors = [axes.containers[0][0].get_ydata()[0] for axes in figure.axes]
    assert errors == [0.5 * k for k in range(1, 10)]
    assert "1 more panel not drawn" in figure.texts[-1].get_text()


def test_names_keep_apart_from_markers_and_each_other():
    """Also where markers are closer to each other than names are long, and within the panel."""
    points = np.array([[0.0, 0.0], [3.0, 1.0], [1.0, 4.0], [5.0, 5.0], [195.0, 9.0]])
    sizes = np.array([[80.0, 6.0], [20.0, 6.0], [50.0, 6.0], [15.0, 6.0], [60.0, 6.0]])
    low, high = np.array([-5.0, -30.0]), np.array([200.0, 60.0])
    dots = np.stack([points, np.full_like(points, 2.0)], axis=1)

    labels = points + label_offsets(points, sizes, np.array([low, high]), dots)

    gap = np.abs(labels[:, None] - labels) - (sizes[:, None] + sizes) / 2.0
    assert (gap.max(axis=2) >= -1e-9)[~np.eye(5, dtype=bool)].all()
    beside = np.abs(labels[:, None] - points) - sizes[:, None] / 2.0
    assert (beside.max(axis=2) > 1.0).all()
    assert (labels - sizes / 2.0 >= low).all()
    assert (labels + sizes / 2.0 <= high).all()


def test_long_names_have_several_lines(run):
    """In one line, names with their measurements hid each other and the lines to their markers."""
    name = "Algorithm 1 (radio) / final contacts / without ranges and non-overlap"
    long = run.summary.assign(condition=run.summary["condition"].replace("touch", name))

    [axes] = painters(RunData(run.folder, long))["traffic"].draw().axes

    lines = next(text.get_text() for text in axes.texts if "Algorithm" in text.get_text())
    assert " ".join(lines.split("\n")) == name
    assert max(map(len, lines.split("\n"))) <= 32


def test_runs_in_which_nobody_sends_have_no_such_figure(run):
    """It would have nothing to show."""
    silent = run.summary.assign(sent_B=np.nan)

    assert painters(RunData(run.folder, silent)) == {}
    assert painters(RunData(run.folder, silent.drop(columns="sent_B"))) == {}


def test_it_is_the_same_in_a_narrow_page(run):
    """Another width changes neither limits nor series."""
    require_alike(painters(run)["traffic"])


def _many(run, count):
    """Add conditions, each of which sends more than the one before, and errs by more."""
    touch = run.summary[run.summary["condition"] == "touch"]
    more = [
        touch.assign(condition=f"c{k}", series=f"c{k}", rmse_R=0.6 + 0.1 * k, sent_B=1e3 * (2 + k))
        for k in range(count)
    ]
    less = touch.assign(condition="less", series="less", rmse_R=0.9, sent_B=10.0)
    return RunData(run.folder, pd.concat([run.summary, *more, less]))


def test_at_most_eight_conditions_have_names(run):
    """Those that no other beats, the default and the first ones; the rest is gray, and counted."""
    [axes] = painters(_many(run, 12))["traffic"].draw().axes

    names = sorted(text.get_text() for text in axes.texts)
    assert names == ["c0", "c1", "c2", "c3", "c4", "joint", "less", "touch"]
    _, labels = axes.get_legend_handles_labels()
    assert "7 other conditions" in labels
    [envelope] = [line for line in axes.lines if line.get_color() == "0.8"]
    np.testing.assert_allclose(envelope.get_xydata(), [[10.0, 0.9], [1000.0, 0.5]])
    [others] = [line for line in axes.lines if line.get_label() == "7 other conditions"]
    np.testing.assert_allclose(np.sort(others.get_xdata()), 1e3 * np.arange(7, 14))


def test_the_default_has_a_name_though_others_beat_it(run):
    """All other conditions are changes of it."""
    touch = run.summary[run.summary["condition"] == "touch"]
    better = [
        touch.assign(condition=f"b{k}", series=f"b{k}", rmse_R=0.4 - 0.02 * k, sent_B=100.0 + k)
        for k in range(9)
    ]

    [axes] = painters(RunData(run.folder, pd.concat([run.summary, *better])))["traffic"].draw().axes

    assert "touch" in [text.get_text() for text in axes.texts]


@pytest.mark.parametrize("most", [None, 3.5])
def test_numbers_of_an_axis_keep_apart(run, most):
    """Five decades of bytes have numbers at most as dense as there is room for."""
    more = run.summary.assign(condition="much", series="much", sent_B=9e5, rmse_R=0.3)
    less = run.summary.assign(condition="less", series="less", sent_B=9.0, rmse_R=0.9)
    data = RunData(run.folder, pd.concat([run.summary, more, less]))
    figure = painters(data)["traffic"].draw(most)
    figure.canvas.draw()

    for axes in figure.axes:
        low, high = axes.get_xlim()
        shown = [t for t in axes.get_xticklabels() if low <= t.get_position()[0] <= high]
        boxes = [each.get_window_extent() for each in shown]
        assert len(boxes) > 2
        assert all(one.x1 < other.x0 for one, other in itertools.pairwise(boxes))
