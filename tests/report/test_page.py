"""The page of a run warns of limits, and shows runs without results."""

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from tests.browser import probe
from tests.report.conftest import write_case, write_summary, write_table
from tiswarm.base.errors import InputError
from tiswarm.base.progress import Progress
from tiswarm.records.intervals import share_ci95
from tiswarm.records.measures import FEWEST
from tiswarm.records.messages import MISSING
from tiswarm.records.run_folder import Manifest, Origin
from tiswarm.report import page as page_module
from tiswarm.report import swarm_view
from tiswarm.report.figures import caption_of, draw_figures
from tiswarm.report.page import Page, Shown, show_pictures, write_page
from tiswarm.report.page_tables import (
    PageTable,
    case_table,
    console_text,
    headline_table,
    notes_of,
    paper_text,
    result_tables,
    statement_of,
    warnings_of,
)
from tiswarm.report.pictures.pictures import build_pictures
from tiswarm.report.run_data import load_run
from tiswarm.report.swarm_view import build_view, first_series, read_case_view

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
    ("name", "case", "caption"),
    [
        ("convergence", "", r"RMSE against iteration: .*\."),
        ("convergence-robots-30", "", r"RMSE against iteration: .*\. Shown: robots-30\."),
        ("error", "0-joint", r"True structure, .* Case 0-joint\."),
        ("error-1-paper", "0-joint", r"True structure, .* 1-paper\."),
        ("error-against-height", "", r"Error of each robot .* A dot is a robot.*"),
        ("foreign", "", "foreign"),
    ],
)
def test_pictures_have_captions(name, case, caption):
    """A caption says what is seen, and which case where one is drawn."""
    assert re.fullmatch(caption, caption_of(name, case))


@pytest.mark.parametrize("name", ["accuracy", "shape", "grades", "building", "traffic"])
def test_captions_of_few_structures_name_no_interval(name):
    """Captions said "Bars are 95 % CI." of two structures, which have none."""
    of_many, of_few = caption_of(name), caption_of(name, few=True)

    assert " are 95 % CI. " in f"{of_many} "
    assert "CI" not in of_few
    assert len(of_few) > len(of_many) - len(" Bars and bands are 95 % CI.") - 1


def test_every_picture_of_a_run_has_a_caption(run_folder):
    """A file name alone explains nothing; the structure comes first, as the overview."""
    view = read_case_view(load_run(run_folder).cases[0])
    robots = np.ones(len(view.robot))
    planned = build_pictures(replace(view, sd=robots, force=robots))
    renders = run_folder / "renders"
    renders.mkdir()
    for name in planned:
        Image.new("RGB", (8, 8)).save(renders / f"{name}.png")

    shown = show_pictures(renders, case="0-joint")

    assert "sd" in planned
    assert [Path(picture.file).stem for picture in shown] == [
        "structure", "truth-and-estimate", "error", "sd", "contact-graph", "sensed-force",
    ]  # fmt: skip
    assert all(picture.caption.endswith("Case 0-joint.") for picture in shown)


def test_a_figure_brings_no_script_into_the_page(run_folder):
    """A run folder can come from anybody; of an SVG, only what draws lines and letters is kept."""
    draw_figures(load_run(run_folder), Progress())
    drawing = run_folder / "figures" / "convergence.svg"
    harm = (
        '<script>boom()</script><image href="https://elsewhere.org/a.png"/>'
        '<g onclick="boom()" style="fill: url(https://elsewhere.org)"><text>Iteration</text></g>'
    )
    drawing.write_text(drawing.read_text().replace("</svg>", f"{harm}</svg>"))

    shown = show_pictures(run_folder / "figures")

    (text,) = [picture.drawing for picture in shown if "convergence" in picture.file]
    assert not re.search("script|boom|elsewhere", text)
    assert "Iteration" in text
    assert "stroke: currentColor" in text  # as light as the letters of a dark page
    assert "#000000" not in text


def test_a_damaged_figure_is_refused_by_name(run_folder):
    """Half a file, as a full disk leaves it."""
    draw_figures(load_run(run_folder), Progress())
    drawing = run_folder / "figures" / "convergence.svg"
    drawing.write_bytes(drawing.read_bytes()[:2000])

    with pytest.raises(InputError, match=r"convergence\.svg: is no SVG picture"):
        show_pictures(run_folder / "figures")


@pytest.mark.parametrize("suffix", ["png", "gif", "webp"])
def test_a_picture_beside_the_figures_needs_no_svg(run_folder, suffix):
    """Users put pictures of their own there; the page shows them, and a redraw keeps them."""
    draw_figures(load_run(run_folder), Progress())
    picture = run_folder / "figures" / f"my-setup.{suffix}"
    Image.new("RGB", (40, 20)).save(picture)

    shown = show_pictures(run_folder / "figures")

    (setup,) = [drawing for drawing in shown if "my-setup" in drawing.file]
    assert setup.source.startswith("data:image/")
    assert (setup.width, setup.height) == (40, 20)
    assert setup.caption == "my-setup"


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
    assert names == ["baseline, seed 0", "no-z, seed 0"]
    assert view.note == "The view contains 2 of 3 cases."
    for case in view.data["cases"]:
        assert case["robot"] == list(range(12))
        assert [color["label"] for color in case["colors"]] == ["error", "sensed force"]
        assert case["contacts"] == [[n, 1, n + 1, 0] for n in range(11)]
        ((face,),) = case["ground"]  # a plane
        assert len(face) == 4


@pytest.mark.parametrize(
    ("methods", "first"),
    [
        (["joint", "virtual-force", "virtual-force together", "joint"], ["c", "b"]),
        (["virtual-force", "joint", "virtual-force", "joint"], ["c", "a"]),
        (["virtual-force", "joint", "joint", "joint"], ["c", "a"]),
        (["joint", "hop-by-hop", "online", "joint"], ["c", "a"]),
        (["joint", "joint", "joint", "virtual-force"], ["d"]),
        ([""] * 4, ["c", "a"]),
    ],
    ids=["best", "best-is-algorithm-1", "first", "without", "at-another-point", "old"],
)
def test_the_view_opens_on_the_best_beside_algorithm_1(methods, first, tmp_path):
    """Readers meet the least error first, and what it is to be compared with."""
    rows = [
        [f"0-{name}", "done", name, point, method, 12, rmse]
        for name, method, rmse, point in zip(
            "abcd", methods, [2.0, 3.0, 1.0, 0.5], ["N=1", "N=1", "N=1", "N=2"], strict=True
        )
    ]
    write_summary(tmp_path, "case,status,series,point,method,robots,rmse_R", rows)

    assert first_series(load_run(tmp_path)) == first


def test_of_many_robots_the_first_to_join_are_shown(run_folder, monkeypatch):
    """The page stays small, and a note states the limit."""
    monkeypatch.setattr(swarm_view, "MOST_ROBOTS", 5)

    view = build_view(load_run(run_folder))

    (case,) = view.data["cases"]
    assert case["robot"] == [0, 1, 2, 3, 4]
    assert max(max(i, j) for i, _, j, _ in case["contacts"]) == 4
    assert "the first 5 of 12 robots" in view.note


def test_what_makes_results_wrong_is_apart_from_what_is_good_to_know():
    """Failures and disconnected robots are warnings; early ends and floppy modes are notes."""
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

    failed, disconnected = warnings_of(summary)
    ended, floppy, renderer = notes_of(summary, manifest)

    assert "1 of 3 cases failed: too few robots" in failed
    assert "No measurement that was used ties 3 robots in 1 case to the anchor" in disconnected
    assert "in 1 case: the gap is bridged" in ended
    assert "leave 4 to 12 floppy modes" in floppy
    assert "open3d: died" in renderer
    cases = case_table(summary).frame
    assert cases["status"].tolist() == ["done", "done", "failed"]
    assert cases["reason"].tolist() == ["the gap is bridged", "", "too few robots"]
    assert "reason" not in case_table(summary.assign(reason=None)).frame


def test_cases_that_did_not_converge_are_named():
    """A run whose cases all failed lacks the columns of verdicts."""
    summary = pd.DataFrame({"case": ["0-a", "1-a", "2-b"], "series": ["a", "a", "b"]})
    summary = summary.assign(status="done", reason=None)
    lost = summary.assign(converged=[False, True, None], misfit_sd=[148.2, 0.3, None])

    (warning,) = warnings_of(lost.assign(distrust=["chains disagree", None, None]))

    assert warning.startswith(
        "1 of 3 cases did not converge (seed 0 of a): chains disagree. The search found"
    )
    assert "148 sd" not in warning
    assert warnings_of(lost.assign(converged=[True, True, None])) == []
    assert warnings_of(summary) == []


def test_a_condition_that_fails_everywhere_is_named_once():
    """Algorithm 1 never states that it converged: thirty names said no more than its own."""
    summary = pd.DataFrame(
        {"condition": [*"aaaabb"], "series": ["20, a"] * 2 + ["40, a"] * 2 + ["20, b", "40, b"]}
    )
    summary = summary.assign(case=[f"{k}-x" for k in range(6)], status="done", reason=None)
    lost = summary.assign(converged=[False] * 5 + [True], distrust=None)

    (warning,) = warnings_of(lost)

    assert warning.startswith("5 of 6 cases did not converge (all of a; seed 4 of 20, b).")


def test_reasons_that_differ_in_numbers_are_one():
    """A warning for readers repeated the sentence of its author for each case."""
    summary = pd.DataFrame({"case": ["0-a", "1-a", "2-a"], "series": ["a", "a", "a"]})
    reasons = [f"their chi-square is {number} less, and noise explains 153" for number in (722, 9)]
    lost = summary.assign(
        status="done", reason=None, converged=False, distrust=[*reasons, "2 of 3 {are} outliers"]
    )

    (warning,) = warnings_of(lost)

    assert "is 9 to 722 less, and noise explains 153; 2 of 3 {are} outliers. The" in warning


def test_cases_that_are_not_consistent_are_named_with_the_reason():
    """A series of which each case is at odds stands for its cases."""
    summary = pd.DataFrame({"case": ["0-a", "1-a", "0-b", "1-b"], "series": [*"aabb"]})
    summary = summary.assign(status="done", reason=None, converged=True, distrust="wrong heights")
    found = summary.assign(
        consistent=[False, False, False, True], misfit_sd=[27.2, 9.0, 6.0, 0.1],
        sd_factor=[3.1, 1.4, 1.2, 1.0],
    )  # fmt: skip

    (warning,) = warnings_of(found)
    (too_good,) = warnings_of(found.assign(misfit_sd=-8.0, sd_factor=1.0))

    assert warning == (
        "3 of 4 cases are not consistent with the noise that their logs state (all of a; seed 0 of "
        "b): "
        "wrong heights. At most, chi-square exceeds its expectation by 27 sd and sd is multiplied "
        "by 3.1."
    )
    assert too_good.endswith("At most, chi-square is below its expectation by 8 sd.")


def test_intervals_need_some_structures():
    """A mean of fewer than five has a range; conditions are sorted by error."""
    table = pd.DataFrame({"condition": ["a", "b", "c"], "cases": [5, 4, 1]})
    table = table.assign(rmse_R_mean=[2.0, 0.5, 0.012345], rmse_R_ci95=[0.25, 1.0, np.nan])
    table = table.assign(rmse_R_least=[1.0, 0.25, 0.012345], rmse_R_most=[3.0, 0.75, 0.012345])

    shown = headline_table(table)

    assert shown.frame["condition"].tolist() == ["c", "b", "a"]
    assert shown.frame["RMSE [R]"].tolist() == [
        "0.0123", "0.500 (0.250 to 0.750)", "2.00 ± 0.25",
    ]  # fmt: skip
    assert shown.note.count("95 % CI") == 1
    assert "fewer than 5 structures" in shown.note


def test_the_first_table_has_what_a_question_asks_for():
    """Towers have heights, and bridges a share that closed; without the question neither."""
    table = pd.DataFrame({"condition": ["a", "a"], "structure.kind": ["tower", "bridge"]})
    table = table.assign(cases=[1, 2], rmse_R_mean=[1.0, 2.0], kind=["tower", "bridge"])
    table = table.assign(height_R_mean=[30.0, 9.0], crossed_mean=[np.nan, 0.5], sent_B_mean=[7, 8])
    low, high = share_ci95(np.array([0.0, 1.0])).values()
    table = table.assign(crossed_ci95_low=[np.nan, low], crossed_ci95_high=[np.nan, high])

    shown = headline_table(table, "reached")
    sent = headline_table(table, "traffic")

    assert shown.frame["height [R]"].tolist() == ["30", ""]
    assert shown.frame["bridges closed [share] (95 % CI)"].tolist() == [
        "",
        "0.500 (0.0945 to 0.905)",
    ]
    assert "Shares have their 95 % CI" in shown.note
    assert sent.frame["sent by a robot [B]"].tolist() == ["7", "8"]
    assert "height [R]" not in headline_table(table).frame


def test_a_table_states_what_all_series_measure():
    """Names of series have the rest; a condition that failed measures nothing."""
    table = pd.DataFrame(
        {"condition": [*"abc"], "cases": [2, 2, 0], "rmse_R_mean": [1.0, 2.0, None]}
    )
    used = ["contacts, height, walk_contacts", "contacts, height", None]

    shown = headline_table(table.assign(measurements=used))

    assert shown.frame["condition"].tolist() == [*"abc"]
    assert "All series use final contacts and heights." in shown.note


def test_a_table_states_what_a_point_of_a_sweep_measures_in_addition():
    """It said that all series use walk contacts where a sweep of methods has some that do not."""
    table = pd.DataFrame({"condition": "a", "localization.method": ["paper", "joint"]})
    table = table.assign(cases=2, rmse_R_mean=[1.0, 2.0])
    used = ["contacts, height", "contacts, height, walk_contacts"]

    note = headline_table(table.assign(measurements=used)).note

    assert "All series use final contacts and heights." in note
    assert "Those of joint also use walk contacts." in note


def test_a_note_lists_no_long_row_of_points():
    """Of a study of thirty points, thirteen lines stated which ones have ground contacts."""
    points = pd.DataFrame({"condition": "a", "structure.goal_height": [*map(str, range(20))]})
    used = ["contacts, ground"] * 19 + ["contacts"]

    note = headline_table(points.assign(cases=2, rmse_R_mean=1.0, measurements=used)).note

    assert "Measurements differ between points: table.csv lists them." in note
    assert "also use" not in note


def test_p_needs_five_structures():
    """Of three structures, p is .25 at best: noise beside the numbers."""
    rows = pd.DataFrame({"condition": [*"bc"], "against": "a", "measure": "rmse_R"})
    rows = rows.assign(
        structures=[4, 5], difference_mean=1.0, difference_ci95=0.5, smaller=0,
        equal_measurements=1, wilcoxon_p=[0.125, 0.0625],
    )  # fmt: skip
    table = pd.DataFrame({"condition": [*"abc"], "cases": 5, "paper_rmse_radii": None})

    some, none = (
        next(t for t in result_tables(table, pairs) if t.title.startswith("Differences"))
        for pairs in (rows, rows[:1])
    )

    assert some.note.startswith("Differences from a: negative ones are smaller. p of Wilcoxon's")
    assert none.note.startswith("Differences from a: ")
    assert some.frame["p"].tolist() == ["", "0.0625"]
    assert "p" not in none.frame
    assert "Wilcoxon" not in none.note


def test_the_error_of_all_robots_ranks_where_some_are_not_located():
    """A method that locates a fifth of the robots led tables by the errors of that fifth."""
    table = pd.DataFrame({"condition": [*"ab"], "cases": 2, "rmse_R_mean": [18.3, 17.0]})
    table = table.assign(rmse_located_R_mean=[1.5, 17.0], procrustes_disparity_mean=5.9)
    table = table.assign(located_least=[0.4, 1.0], located_most=[0.6, 1.0])

    all_located = headline_table(table.assign(located_mean=1.0))
    some = headline_table(table.assign(located_mean=[0.5, 1.0]))

    assert [*all_located.frame] == ["condition", "n", "RMSE [R]", "disparity"]
    assert "All robots are located" in all_located.note
    assert [*some.frame] == [
        "condition", "n", "RMSE [R]", "located [%]", "RMSE of located [R]",
    ]  # fmt: skip
    assert some.frame.to_numpy().tolist() == [
        ["b", "2", "17", "100", "17"],
        ["a", "2", "18.3", "50 (40 to 60)", "1.50"],
    ]
    assert "positions of others are guesses" in some.note


ENDS = {"low": 0.48, "high": 0.52}


def test_headings_tell_intervals_from_ranges():
    """Shares of structures have intervals, also of few; shares of robots have ranges then."""

    def closed(*structures):
        rows = pd.DataFrame({"condition": [*"ab"][: len(structures)], "cases": structures})
        rows = rows.assign(kind="bridge", rmse_R_mean=1.0, crossed_mean=0.5, located_mean=0.5)
        rows = rows.assign(crossed_ci95_low=0.1, crossed_ci95_high=0.9)
        rows = rows.assign(located_least=0.4, located_most=0.6)
        is_many = rows["cases"] >= FEWEST
        ends = {f"located_ci95_{end}": np.where(is_many, x, np.nan) for end, x in ENDS.items()}
        return headline_table(rows.assign(**ends), "reached")

    few, mixed, many = closed(2), closed(2, 5), closed(5)

    assert {"located [%]", "bridges closed [share] (95 % CI)"} <= {*few.frame}
    assert few.frame["located [%]"].tolist() == ["50 (40 to 60)"]
    assert "In parentheses: least and greatest" in few.note
    assert mixed.frame["located [%] (95 % CI)"].tolist() == ["50", "50 (48 to 52)"]
    assert many.frame["located [%]"].tolist() == ["50 (48 to 52)"]
    assert "Shares have their 95 % CI in parentheses" in many.note
    assert "least and greatest" not in many.note


def test_powers_stand_at_the_largest_size():
    """A power is of all sizes of a series, with its interval; two sizes have none."""
    table = pd.DataFrame({"condition": [*"abab"], "robots": ["20 robots"] * 2 + ["80 robots"] * 2})
    table = table.assign(cases=1, rmse_R_mean=[1.0, 2.0, 3.0, 4.0])
    powers = pd.DataFrame({"series": [*"ab"], "measure": "rmse_R", "robots": 80, "mean": 1.0})
    powers = powers.assign(exponent=[0.79, np.nan], exponent_ci95=[0.301, np.nan])

    shown = headline_table(table, "sizes", powers=powers)

    assert shown.frame["RMSE as N^p: p"].tolist() == ["", "", "0.79 ± 0.30", ""]
    assert "p: power of the number of robots" in shown.note


def test_doubtful_estimates_are_counted_beside_the_error():
    """A small error of estimates that did not converge is luck; a method may judge nothing."""
    table = pd.DataFrame({"condition": [*"abc"], "cases": 4, "rmse_R_mean": [1.0, 2.0, 3.0]})

    judged = table.assign(converged_mean=[0.75, 1.0, np.nan], consistent_mean=1.0)
    shown = headline_table(judged, with_verdicts=True)

    assert "converged" not in headline_table(judged).frame
    assert shown.frame["converged"].tolist() == ["3 of 4", "4 of 4", ""]
    assert "consistent" not in shown.frame


def test_verdicts_are_counted_among_the_estimates_that_have_one():
    """An estimate that cannot be tested is no consistent one, nor one that is not."""
    table = pd.DataFrame({"condition": [*"ab"], "cases": 25, "rmse_R_mean": [1.0, 2.0]})
    table = table.assign(consistent_mean=[1.0, 2.0 / 3.0], consistent_count=[3, 3])

    shown = headline_table(table, with_verdicts=True)

    assert shown.frame["consistent"].tolist() == ["3 of 3", "2 of 3"]


def test_changes_are_from_the_first_condition_of_the_same_point():
    """The first condition is that of the scenario, wherever its error puts it in the table."""
    table = pd.DataFrame(
        {
            "condition": ["all", "less"] * 2,
            "tilt": ["1 deg"] * 2 + ["2 deg"] * 2,
            "cases": 1,
            "rmse_R_mean": [1.0, 1.5, 4.0, 3.0],
        }
    )

    shown = headline_table(table, "cues")

    assert shown.frame["condition"].tolist() == ["all", "less", "less", "all"]
    assert shown.frame["change [%]"].tolist() == ["", "+50", "-25", ""]


def test_changes_are_of_the_error_that_ranks():
    """A cue without which few robots are located would seem to make errors smaller."""
    table = pd.DataFrame({"condition": ["all", "less"], "cases": 1, "rmse_R_mean": [1.0, 9.0]})
    table = table.assign(located_mean=[1.0, 0.5], rmse_located_R_mean=[1.0, 0.5])

    shown = headline_table(table, "cues")

    assert shown.frame["RMSE [R]"].tolist() == ["1", "9"]
    assert shown.frame["change [%]"].tolist() == ["", "+800"]


def test_the_console_has_the_table_in_aligned_columns():
    """Points stand above their conditions; words are on the left, numbers on the right."""
    table = pd.DataFrame(
        {
            "condition": ["all", "less"] * 2,
            "tilt": ["1 deg"] * 2 + ["2 deg"] * 2,
            "cases": 1,
            "rmse_R_mean": [1.0, 1.5, 2.0, 33.5],
        }
    )

    *_, head, first, one, two, second, three, four = console_text(
        headline_table(table)
    ).splitlines()

    assert (first, second) == ("1 deg:", "2 deg:")
    assert [row.split() for row in (one, two)] == [["all", "1", "1"], ["less", "1", "1.50"]]
    assert len({len(row) for row in (head, one, two, three, four)}) == 1


def test_calibration_is_shown_where_a_method_reports_uncertainty():
    """The table contains only the measures that the method reports."""
    silent = pd.DataFrame({"condition": ["a"], "cases": [5], "paper_rmse_radii": [None]})
    silent = silent.assign(rmse_R_mean=1.0, rmse_R_ci95=0.1, paper_procrustes_disparity=None)
    frank = silent.assign(coverage_50_mean=0.48, coverage_50_ci95=0.02, outlier_recall_mean=np.nan)

    without, tables = [result_tables(table, pd.DataFrame()) for table in (silent, frank)]

    assert len(without) + 1 == len(tables)
    assert tables[-1].title == "Calibration"
    assert tables[-1].frame.to_dict("records") == [
        {"condition": "a", "robots in their 50 % interval": "0.480 ± 0.020"}
    ]
    assert "outliers" not in tables[-1].note

    both = result_tables(pd.concat([silent, frank.assign(condition="b")]), pd.DataFrame())

    assert list(both[-1].frame["condition"]) == ["b"]


def test_an_estimate_is_consistent_only_where_it_could_not_be():
    """A chi-square without spare measurements shows no lie; one that is too large does."""
    table = pd.DataFrame({"condition": [*"abcd"], "cases": 5, "paper_rmse_radii": None})
    table = table.assign(
        rmse_R_mean=1.0, consistent_mean=[1.0, 0.5, np.nan, np.nan],
        testable_mean=[1.0, 0.4, 0.0, np.nan], spare_measurements_mean=[900.0, 60.0, 28.0, np.nan],
    )  # fmt: skip

    shown = result_tables(table, pd.DataFrame())[-1]

    assert shown.title == "Calibration"
    assert shown.frame.set_index("condition")["consistent estimates"].to_dict() == {
        "a": "1", "b": "0.500 of 0.400 testable", "c": "not testable (28 spare)",
    }  # fmt: skip


def test_suites_and_calibration_say_which_robots_they_count():
    """Two tables of a page called unlike shares of robots located."""
    table = pd.DataFrame({"condition": ["a"], "cases": 5, "rmse_R_mean": 1.79})
    table = table.assign(located_mean=1.0, rmse_located_R_mean=2.0, paper_rmse_radii=None)
    suites = table.assign(suite="s", way="joint", needs="nothing", located_mean=0.8)
    suites = suites.assign(usd_1=20.0, usd_1000=20000.0)

    shown = {t.title: t for t in result_tables(table, pd.DataFrame(), suites)}

    headings = [*shown["Table I, measured"].frame]
    assert headings[1:4] == ["1 robot [USD]", "1,000 robots [USD]", "n"]
    assert "robots located" in shown["Calibration"].frame
    assert "without anchors" in shown["Calibration"].note


def test_what_conditions_have_in_common_is_said_once():
    """All conditions localize the same structures, so the anchor's neighbors are the same."""
    table = pd.DataFrame({"condition": [*"abab"], "kind": ["tower", "tower", "chain", "chain"]})
    table = table.assign(cases=4, paper_rmse_radii=None, first_on_anchor_mean=[1.0, 1.0, 2.0, 2.0])

    shown = result_tables(table, pd.DataFrame())[-1]

    assert shown.title == "Robots on the anchor"
    assert shown.frame.to_dict("records") == [
        {"point": "tower", "first robot": "1"}, {"point": "chain", "first robot": "2"},
    ]  # fmt: skip


def test_published_numbers_have_a_table_of_their_own():
    """It has the rows of the paper's settings only, and each number beside its counterpart."""
    table = pd.DataFrame({"condition": ["a", "b"], "cases": [25, 25]})
    table = table.assign(paper_rmse_radii=[1.64, None], rmse_R_mean=[2.0, 3.0], rmse_R_ci95=0.1)
    table = table.assign(rmse_R_to_paper=[1.22, None], rmse_rho_to_paper=[0.81, None])

    found = {t.title: t.frame for t in result_tables(table, pd.DataFrame())}

    assert found["Beside the paper"].to_dict("records") == [
        {
            "condition": "a",
            "published RMSE [robot radii]": "1.64",
            "RMSE [R]": "2.00 ± 0.10",
            "to the published, radius = rho": "0.810",
            "radius = R": "1.22",
        }
    ]
    silent = result_tables(table[1:].reset_index(drop=True), pd.DataFrame())
    assert "Beside the paper" not in [t.title for t in silent]


SWEPT = """
const byId = (id) => document.getElementById(id);
const texts = (id) => [...byId(id).options].map(({ text }) => text);
const accuracy = document.querySelector("table[data-name=accuracy]");
const heads = [...accuracy.tHead.rows[0].cells];
const rmse = heads.findIndex(({ textContent }) => textContent.startsWith("RMSE"));
found.right = heads[rmse].getBoundingClientRect().right - innerWidth;
found.height = document.documentElement.scrollHeight;
found.points = texts("point");
found.shown = ["case", "beside"].map((id) => byId(id).selectedOptions[0].text);
byId("point").selectedIndex = 1;
byId("point").dispatchEvent(new Event("change"));
found.kept = ["case", "beside"].map((id) => byId(id).selectedOptions[0].text);
found.conditions = texts("case");
heads[rmse].firstChild.click();
heads[rmse].firstChild.click();
const firstOf = ({ rows }) => [...rows].map(({ cells }) => cells[0].textContent);
found.rows = [...accuracy.tBodies].map(firstOf);
const link = accuracy.closest("section").querySelector("a.csv");
link.addEventListener("click", (event) => event.preventDefault());
link.click();
found.csv = decodeURIComponent(link.href);
document.body.dataset.found = JSON.stringify(found);
"""


@pytest.fixture
def swept_run(tmp_path):
    """Two conditions at three points, with figures."""
    points = [f"structure={{kind: bridge, gap: {gap}}}" for gap in ("20.0", "25.0", "30.0")]
    rows, table = [], []
    for place, point in enumerate(points):
        for rmse, condition in ((1.0, "joint"), (2.0, "paper")):
            name = f"0-{place}-{condition}"
            write_case(tmp_path / "cases" / name, seed=place)
            series = f"{point}, {condition}"
            rows.append([name, "done", condition, series, point, "bridge", 12, place + rmse])
            table.append([condition, point.partition("=")[2], 1, place + rmse, "", 0.1, "", ""])
    header = "case,status,condition,series,point,kind,robots,rmse_R"
    write_summary(tmp_path, header, rows)
    header = "condition,structure,cases,rmse_R_mean,rmse_R_ci95,procrustes_disparity_mean"
    write_table(
        tmp_path / "table.csv", f"{header},paper_rmse_radii,paper_procrustes_disparity", table
    )
    (tmp_path / "scenario.yaml").write_text(
        "name: gaps\nconditions: {joint: {}, paper: {label: Algorithm 1}}\nsweep:\n  structure:\n"
        "  - {kind: bridge, gap: 20.0}\n  - {label: wide gap, kind: bridge, gap: 25.0}\n"
        "  - {kind: bridge, gap: 30.0}\n"
    )
    return tmp_path


@pytest.mark.parametrize("width", [1280, 500])
def test_a_page_of_a_sweep_has_a_row_group_and_a_choice_for_each_point(swept_run, width, tmp_path):
    """RMSE is within the window, and a point keeps the conditions that are compared."""
    page = write_page(load_run(swept_run), Progress()).read_text()

    found = probe(page, SWEPT, tmp_path, more=(f"--window-size={width},900",))

    assert found["troubles"] == []
    assert found["right"] < 0.0
    assert found["points"] == ["gap 20 R", "wide gap", "gap 30 R"]
    assert found["shown"] == ["joint", "Algorithm 1" if width > 960 else "no other"]
    assert found["kept"] == found["shown"]
    assert found["conditions"] == ["joint", "Algorithm 1"]
    assert found["rows"] == [[point, "Algorithm 1", "joint"] for point in found["points"]]
    assert found["csv"].splitlines()[1].startswith('"gap 20 R","Algorithm 1","1","2')
    assert not re.search(r"kind: bridge|structure=", page.partition("The scenario with all")[0])


def test_spreadsheets_compute_no_label_of_a_downloaded_table(swept_run, tmp_path):
    """Points and conditions that begin like formulas get an apostrophe; other cells stay."""
    scenario = swept_run / "scenario.yaml"
    labeled = scenario.read_text().replace("wide gap", "=wide").replace("joint: {}", "=joint: {}")
    scenario.write_text(labeled)
    for table in (swept_run / "table.csv", swept_run / "summary.csv"):
        table.write_text(re.sub(r"(?m)^joint,|(?<=,)joint,", "=joint,", table.read_text()))
    page = write_page(load_run(swept_run), Progress()).read_text()

    found = probe(page, SWEPT, tmp_path)

    rows = found["csv"].splitlines()
    assert [row.split(",")[:2] for row in rows[3:5]] == [
        ['"\'=wide"', '"Algorithm 1"'],
        ['"\'=wide"', '"\'=joint"'],
    ]
    assert rows[1].startswith('"gap 20 R","Algorithm 1","1","2')


@pytest.mark.parametrize(("rows", "is_wide"), [(14, False), (15, True)])
def test_a_long_table_has_the_whole_width(rows, is_wide):
    """Beside the view its columns were cut; some renders are then large, others folded."""
    frame = pd.DataFrame({"condition": [f"F {k}" for k in range(rows)], "RMSE [R]": "1"})
    renders = [Shown("data:,", f"renders/{k}.png", f"{k}", 10, 10, wide=10) for k in range(5)]
    table = PageTable(frame=frame, words=["condition"], title="Accuracy")
    page = Page(name="laws", result="", headline=table, renders=renders)

    assert page.is_sweep == is_wide
    before, fold, after = page.html().partition("More renders")
    assert [before.count("<img"), after.count("<img")] == ([3, 2] if is_wide else [5, 0])
    assert bool(fold) == is_wide


def test_paper_has_the_first_rows_of_a_long_table(tmp_path):
    """A study of 1,536 cases was 97 pages."""
    cells = pd.DataFrame({"case": [f"case {k}" for k in range(45)], "RMSE [R]": "1"})
    rows = PageTable(frame=cells, words=["case"], title="Cases")
    script = """
    const rows = [...document.querySelectorAll(".tall tbody tr")];
    found.shown = rows.filter((row) => row.getClientRects().length).length;
    found.note = document.querySelector(".printed").getClientRects().length;
    document.body.dataset.found = JSON.stringify(found);
    """
    html = Page(name="study", result="", rows=rows).html()

    seen = probe(html, script, tmp_path)
    paper = probe(html.replace("@media print", "@media screen"), script, tmp_path)

    assert (seen["shown"], seen["note"]) == (45, 0)
    assert (paper["shown"], paper["note"]) == (40, 1)
    assert "On paper: the first 40 of 45 rows." in html


@pytest.mark.parametrize("missing", [float("nan"), None, pd.NA, "nan", ""])
def test_a_number_that_is_missing_is_a_dash(missing):
    """Tables join rows of several sources, and some lack a number; the page failed at these."""
    frame = pd.DataFrame({"condition": ["joint", "nan"], "RMSE [R]": [missing, "1.5 ± 0.1"]})
    table = PageTable(frame=frame, words=["condition"], title="Accuracy")

    page = Page(name="laws", result="", headline=table).html()
    text = console_text(table)
    csv = paper_text(table, "csv")

    assert f"<td>{MISSING}</td>" in page
    assert '<td class="text">nan</td>' in page
    assert text.splitlines()[-2].split() == ["joint", MISSING]
    assert csv == "condition,RMSE [R]\njoint,\nnan,1.5 ± 0.1\n"


def test_latex_prints_each_letter_of_a_label():
    """Bare, < and | print as inverted marks and dashes in LaTeX's default encoding."""
    label = r"a < b | c > d & 5 % of $x_1$ #2 {e} ~f ^g \h"
    frame = pd.DataFrame({"condition": [label], "p < q": ["1.0 ± 0.5"]})

    text = paper_text(PageTable(frame=frame, words=["condition"], note=f"Of {label}."), "latex")

    escaped = (
        r"a \textless{} b \textbar{} c \textgreater{} d \& 5 \% of \$x\_1\$ \#2 \{e\} "
        r"\textasciitilde{}f \textasciicircum{}g \textbackslash{}h"
    )
    assert rf"{escaped} & 1.0 $\pm$ 0.5 \\" in text
    assert r"condition & p \textless{} q \\" in text
    assert rf"by condition. Of {escaped}.}}" in text


@pytest.mark.parametrize(
    ("cell", "written"),
    [
        ("=1+1", "'=1+1"),
        ("+a", "'+a"),
        ("-a", "'-a"),
        ("@a", "'@a"),
        ("-1.5", "-1.5"),
        ("a=1", "a=1"),
    ],
)
def test_spreadsheets_compute_no_label(cell, written):
    """A label that begins like a formula gets an apostrophe; numbers with a sign stay numbers."""
    frame = pd.DataFrame({"condition": [cell], "RMSE [R]": ["-0.5"]})

    text = paper_text(PageTable(frame=frame, words=["condition"], note=""), "csv")

    assert text == f"condition,RMSE [R]\n{written},-0.5\n"


def test_a_picture_keeps_its_levels_of_transparency(tmp_path):
    """Soft edges and shadows of renders had 16 levels, seen as rings."""
    path = tmp_path / "soft.png"
    alpha = np.tile(np.arange(256, dtype=np.uint8), (64, 1))
    picture = np.full((64, 256, 4), 128, np.uint8)
    picture[..., 3] = alpha
    Image.fromarray(picture).save(path)

    _, data, _ = page_module._encoded(path)  # noqa: SLF001 - the page holds it as text

    with Image.open(io.BytesIO(data)) as stored:
        assert np.array_equal(np.array(stored.convert("RGBA"))[..., 3], alpha)


@pytest.mark.parametrize(
    ("sure", "off", "series", "statement"),
    [
        (
            [0.8, 0.6],
            [0.0, 0.0],
            ["joint", "joint"],
            (
                "70 % of the robots are within 1 R of where they are shown with a probability of "
                "95 % or more (mean over 2 structures)."
            ),
        ),
        (
            [0.8, 0.6],
            [0.02, np.nan],
            ["joint", "online"],
            (
                "joint, the best of 2 series: 80 % of the robots are within 1 R of where they are "
                "shown with a "
                "probability of 95 % or more; 2 % of these are not."
            ),
        ),
        (
            [0.8, 0.8],
            [0.0, 0.0],
            ["joint", "online"],
            (
                "joint, one of the 2 best of 2 series: 80 % of the robots are within 1 R of where "
                "they are shown with a probability of 95 % or more."
            ),
        ),
        (
            [np.nan, 0.0],
            [np.nan, np.nan],
            ["algorithm-1", "joint"],
            (
                "joint, the only series that states errors of single robots: 0 % of the robots "
                "are within 1 R of where they are shown with a "
                "probability of 95 % or more."
            ),
        ),
        (
            [np.nan, np.nan],
            [np.nan, np.nan],
            ["a", "b"],
            "No method states the error of single robots.",
        ),
    ],
)
def test_a_run_says_first_how_many_robots_are_near_where_they_are_shown(
    sure, off, series, statement
):
    """Of several series it names that with the most as such; a failed case does not count."""
    summary = pd.DataFrame(
        {
            "status": ["done", "done", "failed"],
            "series": [*series, series[0]],
            "rmse_R": [0.1, 0.2, np.nan],
            "sure_1R": [*sure, np.nan],
            "sure_off_1R": [*off, np.nan],
        }
    )

    assert statement_of(summary) == statement
    assert statement_of(summary.drop(columns="rmse_R")) == ""
    earlier = summary.drop(columns=["sure_1R", "sure_off_1R"]).assign(coverage_90=0.9)
    assert statement_of(earlier) == ""
