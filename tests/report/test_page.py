"""The page of a run warns of limits, and shows runs without results."""

import numpy as np
import pandas as pd
import pytest

from tests.report.conftest import write_summary, write_table
from tiswarm.errors import InputError
from tiswarm.progress import Progress
from tiswarm.records.run_folder import Manifest, Origin
from tiswarm.report import page
from tiswarm.report.page import build_view, write_page
from tiswarm.report.page_tables import case_table, result_tables, warnings_of
from tiswarm.report.run_data import load_run

SUMMARY = "case,seed,condition,status,reason,rmse_R,floppy_modes,disconnected"
SCENARIO = "name: odd\ndescription: <script>boom()</script>\nstructure: {kind: tower}\n"


@pytest.fixture
def odd_run(tmp_path):
    """A run whose only case failed, and whose texts contain HTML."""
    row = ["0-baseline", 0, "baseline", "failed", "no <b>robot</b> came", "", "", ""]
    write_summary(tmp_path, SUMMARY, [row])
    write_table(tmp_path / "table.csv", "condition,cases,failed,paper_rmse_radii,"
                "paper_procrustes_disparity", [["baseline", 0, 1, "", ""]])  # fmt: skip
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    return tmp_path


def test_a_run_without_results_has_a_page(odd_run):
    """It states the reason and has no 3D view."""
    page = write_page(load_run(odd_run), Progress()).read_text()

    assert "1 of 1 cases failed" in page
    assert 'id="view"' not in page
    assert len(page) < 50_000


def test_texts_stay_texts(odd_run):
    """HTML in descriptions and reasons is escaped."""
    page = write_page(load_run(odd_run), Progress()).read_text()

    assert "<script>boom" not in page
    assert "no &lt;b&gt;robot&lt;/b&gt; came" in page


@pytest.mark.parametrize(
    ("name", "caption"),
    [
        ("convergence", "RMSE against iteration"),
        ("error-0-baseline", "True structure, colored by error, 0-baseline"),
        ("error-against-height", "Error of each robot against its true height"),
        ("foreign", "foreign"),
    ],
)
def test_pictures_have_captions(name, caption):
    """A picture of a chosen case names the case."""
    assert page.caption_of(name) == caption


@pytest.mark.parametrize("name", ["scenario.yaml", "table.csv"])
def test_a_damaged_run_is_refused_by_name(odd_run, name):
    """The message names the file."""
    (odd_run / name).unlink()

    with pytest.raises(InputError, match=f"{name}: cannot be read"):
        write_page(load_run(odd_run), Progress())


def test_the_view_shows_each_series_once(run_folder):
    """The view contains the first finished case of each series, robots in join order."""
    view = build_view(load_run(run_folder))

    names = [case["name"] for case in view.data["cases"]]
    assert names == ["0-baseline", "0-no-z"]
    assert view.note == "The view contains 2 of 3 cases."
    for case in view.data["cases"]:
        assert case["robot"] == list(range(12))
        assert case["worst"] == max(case["error"])


def test_of_many_robots_the_first_to_join_are_shown(run_folder, monkeypatch):
    """The page stays small, and a note states the limit."""
    monkeypatch.setattr(page, "MOST_ROBOTS", 5)

    view = build_view(load_run(run_folder))

    assert [case["robot"] for case in view.data["cases"]] == [[0, 1, 2, 3, 4]]
    assert "the first 5 of 12 robots" in view.note


def test_warnings_count_what_limits_a_run():
    """Failures, early ends, disconnected robots, floppy modes, and a second-best renderer."""
    summary = pd.DataFrame(
        {
            "case": ["a", "b", "c"],
            "status": ["done", "done", "failed"],
            "reason": ["the gap is bridged", None, "too few robots"],
            "floppy_modes": [4.0, 12.0, None],
            "disconnected": [0.0, 3.0, None],
        }
    )
    origin = Origin(renderer="taichi", reason="open3d: died")
    manifest = Manifest(renders={"structure.png": origin})

    warnings = " ".join(warnings_of(summary, manifest))

    assert "1 of 3 cases failed: too few robots" in warnings
    assert "Growth ended early in 1 case: the gap is bridged" in warnings
    assert "No measurement that was used ties 3 robots in 1 case to the anchor" in warnings
    assert "leave 4 to 12 floppy modes" in warnings
    assert "open3d: died" in warnings
    assert case_table(summary).frame["status"].tolist() == ["done", "done", "failed"]


def test_cases_that_did_not_converge_are_named():
    """Methods that do not report convergence leave the column empty."""
    summary = pd.DataFrame({"case": ["0-a", "1-a", "2-b"], "status": "done", "reason": None})
    lost = summary.assign(converged=[False, True, None], misfit_sd=[148.2, 0.3, None])

    warnings = warnings_of(lost, Manifest())

    assert warnings[0].startswith("1 of 3 cases did not converge (0-a). The misfit")
    assert "148 sd" in warnings[0]
    assert warnings_of(lost.assign(converged=[True, True, None]), Manifest()) == []
    assert warnings_of(summary, Manifest()) == []


def test_calibration_is_shown_where_a_method_reports_uncertainty():
    """The table contains only the measures that the method reports."""
    silent = pd.DataFrame({"condition": ["a"], "cases": [2], "paper_rmse_radii": [None]})
    silent = silent.assign(rmse_R_mean=1.0, rmse_R_ci95=0.1, paper_procrustes_disparity=None)
    frank = silent.assign(coverage_50_mean=0.48, coverage_50_ci95=0.02, outlier_recall_mean=np.nan)

    without, tables = [result_tables(table, pd.DataFrame()) for table in (silent, frank)]

    assert len(without) + 1 == len(tables)
    assert tables[-1].title == "Calibration"
    assert tables[-1].frame.to_dict("records") == [
        {"condition": "a", "robots in their 50 % interval": "0.48 ± 0.02"}
    ]


def test_published_numbers_have_a_table_of_their_own():
    """It has the rows of the paper's settings only, and each number beside its counterpart."""
    table = pd.DataFrame({"condition": ["a", "b"], "cases": [2, 2]})
    table = table.assign(
        paper_rmse_radii=[1.64, None], rmse_R_mean=[2.0, 3.0], rmse_R_ci95=0.1, rmse_mm_mean=65.8
    )

    found = {t.title: t.frame for t in result_tables(table, pd.DataFrame())}

    assert found["Beside the paper"].to_dict("records") == [
        {
            "condition": "a",
            "published RMSE [robot radii]": "1.64",
            "RMSE [R]": "2.00",
            "RMSE [mm]": "66",
        }
    ]
    silent = result_tables(table[1:].reset_index(drop=True), pd.DataFrame())
    assert "Beside the paper" not in [t.title for t in silent]
