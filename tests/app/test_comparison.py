"""Comparison of runs on the structures that they share."""

import shutil
from pathlib import Path

import pandas as pd
import pytest

from tests.runs import REPOSITORY
from tiswarm.app.comparison import compare
from tiswarm.base.errors import InputError
from tiswarm.base.progress import Progress
from tiswarm.report import figure_style
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study import run


@pytest.fixture(scope="module")
def other_run(tmp_path_factory):
    """Folder of a run that has one structure in common with the small run."""
    overrides = ["robots=12", "seeds=[1, 7]", "name=other"]
    other = load_scenario(REPOSITORY / "tests" / "tower.yaml", overrides)
    return run(other, tmp_path_factory.mktemp("other"), progress=Progress()).folder


@pytest.fixture(scope="module")
def both(tiswarm, small_run, other_run, tmp_path_factory):
    """Folder of their comparison."""
    out = tmp_path_factory.mktemp("compared") / "both"
    done = tiswarm("compare", small_run, other_run, "--out", out)
    assert done.returncode == 0, done.stderr
    return out


def test_differences_are_those_of_shared_structures(small_run, both):
    """Both runs have seed 1 alone; equal conditions differ by zero."""
    summary = pd.read_csv(small_run / "summary.csv").set_index("case")["rmse_R"]
    keys = ["against_series", "series", "measure"]
    paired = pd.read_csv(both / "paired.csv").set_index(keys)
    assert (paired["structures"] == 1).all()
    assert paired.loc[("baseline", "baseline", "rmse_R"), "difference_mean"] == 0.0
    assert paired.loc[("baseline", "no-z", "rmse_R"), "difference_mean"] == pytest.approx(
        summary["1-no-z"] - summary["1-baseline"]
    )


def test_every_row_of_every_run_is_kept(small_run, other_run, both):
    """Rows keep their numbers under the name of their run, and there is a figure."""
    compared = pd.read_csv(both / "comparison.csv")

    for folder in (small_run, other_run):
        table = pd.read_csv(folder / "table.csv")
        rows = compared[compared["run"] == folder.name].reset_index(drop=True)
        pd.testing.assert_frame_equal(rows[table.columns], table)
    assert (both / "comparison.png").stat().st_size > 10_000


def test_labels_stand_where_keys_would(small_run, other_run, tmp_path):
    """The text and the figure call conditions and points as the pages of their runs do."""
    named = load_scenario(
        REPOSITORY / "tests" / "tower.yaml",
        [
            "robots=12",
            "seeds=1",
            "name=named",
            "conditions={no-z: {label: without heights}}",
            "sweep={structure: [{label: one, kind: tower}, {label: two, kind: tower, movers: 2}]}",
        ],
    )
    folder = run(named, tmp_path, progress=Progress()).folder

    found = compare([other_run, folder], tmp_path / "both")

    *_, one, two, _ = str(found).splitlines()
    # Measurements of the runs differ, so that all names have them.
    for line, point in ((one, "one"), (two, "two")):
        assert "without heights, " in line
        assert f" {point} " in line
    assert pd.read_csv(tmp_path / "both" / "comparison.csv")["condition"].iloc[-1] == "no-z"


def test_comparing_needs_two_runs(small_run, tmp_path):
    """A run given twice and a folder without a run are refused; nothing is written."""
    for runs, message in (
        ([small_run, small_run], "two or more"),
        ([small_run, tmp_path], "no table"),
    ):
        with pytest.raises(InputError, match=message):
            compare(runs, tmp_path / "both")

    assert not (tmp_path / "both").exists()


def test_names_that_a_terminal_obeys_are_refused(small_run, other_run, tmp_path):
    """A table of somebody else may hide what stands above it."""
    run = Path(shutil.copytree(other_run, tmp_path / "run"))
    table = run / "table.csv"
    table.write_text(table.read_text().replace("baseline", "\x1b[2J"))

    with pytest.raises(InputError, match=r"table.csv: cannot be read: .+2J\" is not printable"):
        compare([small_run, run], tmp_path / "out")

    assert not (tmp_path / "out").exists()


def test_rows_of_a_comparison_have_all_their_words(tmp_path, monkeypatch):
    """Only an unknown value of the sweep is left out; a condition may be called `nan`."""
    drawn = []
    monkeypatch.setattr(figure_style, "png", lambda figure: drawn.append(figure) or b"")
    measured = "cases,rmse_R_mean,rmse_R_ci95,procrustes_disparity_mean,procrustes_disparity_ci95"
    for name, first, row in (("a", "condition,yaw", "nan,5"), ("b", "condition", "none")):
        (tmp_path / name).mkdir()
        table = f"{first},{measured}\n{row},2,1,0.1,0.1,0.1\n"
        (tmp_path / name / "table.csv").write_text(table)

    found = compare([tmp_path / "a", tmp_path / "b"], tmp_path / "both")

    assert [line.split() for line in str(found).splitlines()[1:3]] == [
        ["a", "nan", "yaw", "5", "2", "1.0", "0.1", "0.1"],
        ["b", "none", "2", "1.0", "0.1", "0.1"],
    ]
    labels = [label.get_text() for label in drawn[0].axes[0].get_yticklabels()]
    assert labels == ["yaw 5, nan", "none"]
