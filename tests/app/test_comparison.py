"""Comparison of runs on the structures that they share."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.browser import probe, probe_phone
from tests.runs import REPOSITORY
from tiswarm.app.comparison import compare, rows_drawing
from tiswarm.base.errors import InputError
from tiswarm.base.progress import Progress
from tiswarm.records.measures import MEASURES
from tiswarm.report import figure_style
from tiswarm.report.cases_page import cases_page
from tiswarm.report.table_page import heading_of
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

    *_, one, two, _, _ = str(found).splitlines()
    # Measurements of the runs differ, so that all names have them.
    for line, point in ((one, "one"), (two, "two")):
        assert "without heights / " in line
        assert f" {point} " in line
    assert pd.read_csv(tmp_path / "both" / "comparison.csv")["condition"].iloc[-1] == "no-z"


def test_the_page_has_all_cases_of_all_runs(small_run, other_run, both):
    """`cases.csv` has each case once, with its run and all numbers of its summary."""
    cases = pd.read_csv(both / "cases.csv")

    for folder in (small_run, other_run):
        summary = pd.read_csv(folder / "summary.csv")
        rows = cases[cases["run"] == folder.name].reset_index(drop=True)
        pd.testing.assert_series_equal(rows["rmse_R"], summary["rmse_R"])
        assert rows["case"].tolist() == summary["case"].tolist()


SUMMARY = "case,seed,series,condition,point,kind,status,reason,rmse_R"

SELECTION = """
const numbers = (id) => [...document.querySelectorAll(id)].length;
const shown = () => ({
  dots: numbers("#chart .dot"), rows: numbers("tbody tr"),
  first: document.querySelector("tbody tr")?.textContent,
  matches: document.getElementById("matches").textContent,
  x: document.getElementById("x").value, hash: location.hash,
});
const change = (id, value, kind) => {
  const control = document.getElementById(id);
  control.value = value;
  control.dispatchEvent(new Event(kind));
};
found.all = shown();
change("rows", "no-z-no", "input");
found.filtered = shown();
change("y", "height_R", "change");
const buttons = () => [...document.querySelectorAll("th button")];
for (const _ of "12") buttons().find(({ textContent }) => textContent === "RMSE [R]").click();
found.sorted = shown();
document.querySelector("#chart .dot").dispatchEvent(new MouseEvent("click", { bubbles: true }));
found.chosen = numbers("tr.chosen");
change("rows", "", "input");
location.hash = "#x=seed&rows=other";
dispatchEvent(new Event("hashchange"));
found.linked = shown();
document.body.dataset.found = JSON.stringify(found);
"""


LOOKS = """
const drawnAs = (mark) => [mark.getAttribute("d"), mark.style.fill, mark.style.stroke].join(" ");
const dots = [...document.querySelectorAll("#chart .dot")];
const nameOf = (dot) => columnOf.get("condition").cells[dot.dataset.index];
found.dots = dots.map((dot) => [nameOf(dot), drawnAs(dot)]);
const entries = [...document.querySelectorAll("#legend button")];
found.legend = entries.map((entry) => [entry.textContent, drawnAs(entry.querySelector(".dot"))]);
entries[12].click();
const shown = [...document.querySelectorAll("#chart .dot:not(.faint)")];
found.picked = [entries[12].textContent, [...new Set(shown.map(nameOf))]];
document.body.dataset.found = JSON.stringify(found);
"""


@pytest.mark.trial
def test_no_two_conditions_look_alike(tmp_path):
    """Of thirty conditions four shared a color, and nothing else distinguished their dots."""
    names = [f"condition {k}" for k in range(70)]
    cases = pd.DataFrame({"run": "a", "condition": 2 * names, "robots": 140 * [30]})
    cases = cases.assign(rmse_R=np.arange(140.0))

    found = probe(cases_page("Runs", cases, ["run", "condition"], file="c.csv"), LOOKS, tmp_path)

    assert found["troubles"] == []
    looks = dict(found["dots"])
    assert len(found["dots"]) == 140
    assert all(looks[name] == look for name, look in found["dots"])
    assert len({*looks.values()}) == len(looks) == 70
    assert dict(found["legend"]).keys() == looks.keys()
    assert found["picked"] == [found["legend"][12][0], [found["legend"][12][0]]]


@pytest.mark.trial
def test_a_comparison_fits_a_phone(tmp_path):
    """Names of any length are broken into lines, and nothing is wider than the page."""
    names = [f"condition {k} / {'walk contacts and heights ' * (k % 4)}" for k in range(12)]
    cases = pd.DataFrame({"run": "a", "condition": names, "rmse_R": np.arange(12.0)})
    page = cases_page("Comparison of 2 runs", cases, ["run", "condition"], file="c.csv")
    script = """
        found.wide = inside.documentElement.scrollWidth;
        found.legend = inside.querySelectorAll("#legend button").length;
    """

    found = probe_phone(page, script, tmp_path)

    assert found["troubles"] == []
    assert (found["wide"], found["legend"]) == (390, 12)


@pytest.mark.trial
def test_a_reader_plots_sorts_and_selects_cases(both, tmp_path):
    """The address has the selection, and a link with a selection shows it."""
    cases = pd.read_csv(both / "cases.csv")
    page = (both / "comparison.html").read_text()

    found = probe(page, SELECTION, tmp_path)

    assert found["troubles"] == []
    assert found["all"]["dots"] == found["all"]["rows"] == len(cases)
    of_condition = cases[cases["case"].str.endswith("no-z-no-undock")]
    assert found["filtered"]["dots"] == found["filtered"]["rows"] == len(of_condition)
    assert found["filtered"]["matches"] == f"{len(of_condition)} of {len(cases)}"
    assert "y=height_R" in found["sorted"]["hash"]
    assert "rows=no-z-no" in found["sorted"]["hash"]
    assert "sort=-rmse_R" in found["sorted"]["hash"]
    greatest = of_condition.loc[of_condition["rmse_R"].idxmax()]
    assert greatest["run"] in found["sorted"]["first"]
    assert f"{greatest['rmse_R']:.4g}" in found["sorted"]["first"]
    assert found["chosen"] == 1
    assert found["linked"]["x"] == "seed"
    assert found["linked"]["rows"] == cases["run"].str.contains("other").sum()


def test_texts_of_others_are_no_code_of_the_page(tmp_path):
    """Names of runs and conditions are data of the page, and nothing that it runs."""
    cases = pd.DataFrame({"run": ["</script><script>boom()</script>"], "rmse_R": [1.0]})

    page = cases_page("<b>Runs</b>", cases, ["run"], file="cases.csv")

    assert "boom()</script>" not in page
    assert "<b>" not in page


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
        case = f"{SUMMARY}\n0-a,0,a,a,,tower,done,,1\n"
        (tmp_path / name / "summary.csv").write_text(case)

    found = compare([tmp_path / "a", tmp_path / "b"], tmp_path / "both")

    assert [line.split() for line in str(found).splitlines()[1:3]] == [
        ["a", "nan", "yaw", "5", "2", "1.0", "0.1", "0.1"],
        ["b", "none", "2", "1.0", "0.1", "0.1"],
    ]
    labels = [label.get_text() for label in drawn[0].axes[0].get_yticklabels()]
    assert labels == ["yaw 5 / nan", "none"]


def _compared(runs, conditions):
    """Rows of a comparison of some runs with the same conditions."""
    rows = [(f"run {k}", name) for k in range(runs) for name in conditions]
    table = pd.DataFrame(rows, columns=["run", "condition"]).assign(point="", cases=2)
    return table.assign(rmse_R_mean=1.0, rmse_R_ci95=None, procrustes_disparity_mean=0.1)


def test_markers_of_few_runs_stand_in_the_middle_of_their_rows():
    """A row has one run: beside the line of its name, markers of the last runs seemed cut off."""
    axes = rows_drawing(_compared(3, ["a", "b"])).draw().axes[0]

    points = np.concatenate([line.get_xydata() for line in axes.lines])
    assert sorted(points[np.isfinite(points[:, 0]), 1]) == pytest.approx(range(6))


def test_each_of_many_runs_has_a_row():
    """A legend of forty runs named each, and rows had the name of a condition alone."""
    figure = rows_drawing(_compared(40, ["a", "b"])).draw()

    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert labels == [f"run {k}" for k in range(40)]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a", "b"]


def test_a_heading_keeps_the_words_of_a_column():
    """A unit is left out of the words where the column ends in it, and nothing else is."""
    assert heading_of(MEASURES["peak_stress"]) == "peak stress [dock weights/R²]"
    assert heading_of(MEASURES["sse_R2"]) == "sse [R²]"
    assert heading_of(MEASURES["rms_radius_R"]) == "rms radius [R]"
    assert heading_of(MEASURES["beyond_edge"]) == "beyond edge"
    assert heading_of(MEASURES["height_R"]) == MEASURES["height_R"].axis
