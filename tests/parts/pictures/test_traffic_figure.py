"""The figure of traffic has a marker for robots that send, and a line for all others."""

import numpy as np
import pandas as pd
import pytest

from tests.report.conftest import require_alike
from tiswarm.parts.pictures.swarm_figures import label_offsets, painters
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
    [axes] = painters(run)["traffic"](run).axes

    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    [bars] = axes.containers
    assert (bars[0].get_xdata()[0], bars[0].get_ydata()[0]) == (1000.0, 0.5)
    lines = {line.get_label(): line.get_ydata() for line in axes.lines}
    assert list(lines["joint"]) == [0.2, 0.2]
    assert bars.get_label() == "1 touch"
    assert [text.get_text() for text in axes.texts] == ["1"]


def test_points_of_a_sweep_are_kept_apart(run):
    """A mean over structures that differ compares nothing."""
    rows = run.summary
    points = [rows.assign(point=f"gap {k} R", rmse_R=k * rows["rmse_R"]) for k in range(1, 11)]

    figure = painters(run)["traffic"](RunData(run.folder, pd.concat(points))).axes[0].figure

    assert [axes.get_title() for axes in figure.axes] == [f"gap {k} R" for k in range(1, 10)]
    errors = [axes.containers[0][0].get_ydata()[0] for axes in figure.axes]
    assert errors == [0.5 * k for k in range(1, 10)]
    assert "1 more panel not drawn" in figure.texts[-1].get_text()


def test_numbers_keep_apart_from_markers_and_each_other():
    """Also where markers are closer to each other than numbers may be."""
    points = np.array([[0.0, 0.0], [3.0, 1.0], [1.0, 4.0], [5.0, 5.0], [40.0, 9.0]])

    labels = points + label_offsets(points)

    every = np.concatenate([points, labels])
    apart = np.linalg.norm(labels[:, None] - every, axis=2)
    apart[np.arange(5), 5 + np.arange(5)] = np.inf
    assert apart.min() > 7.5


def test_runs_in_which_nobody_sends_have_no_such_figure(run):
    """It would have nothing to show."""
    silent = run.summary.assign(sent_B=np.nan)

    assert painters(RunData(run.folder, silent)) == {}
    assert painters(RunData(run.folder, silent.drop(columns="sent_B"))) == {}


def test_it_is_the_same_in_a_narrow_page(run):
    """Another width changes neither limits nor series."""
    require_alike(painters(run)["traffic"], run)


def test_only_conditions_that_no_other_beats_have_names(run):
    """Ten names within a thumb are none; the rest is gray."""
    touch = run.summary[run.summary["condition"] == "touch"]
    more = [
        touch.assign(condition=name, series=name, rmse_R=error, sent_B=sent)
        for name, error, sent in (("less", 0.9, 10.0), ("worse", 0.6, 2000.0), ("same", 0.5, 3e3))
    ]

    [axes] = painters(run)["traffic"](RunData(run.folder, pd.concat([run.summary, *more]))).axes

    _, labels = axes.get_legend_handles_labels()
    assert sorted(labels) == ["1 touch", "3 less", "joint", "others"]
    [envelope] = [line for line in axes.lines if line.get_color() == "0.8"]
    np.testing.assert_allclose(envelope.get_xydata(), [[10.0, 0.9], [1000.0, 0.5]])
    [others] = [line for line in axes.lines if line.get_label() == "others"]
    np.testing.assert_allclose(others.get_xydata(), [[3000.0, 0.5], [2000.0, 0.6]])
