"""Figures show what the tables say, in any run that has results."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from tests.recorder import Recorder
from tests.report.conftest import is_blank, require_alike, write_case, write_summary, write_table
from tiswarm.base.errors import InputError
from tiswarm.base.progress import Progress
from tiswarm.records.measures import FEWEST
from tiswarm.report import curve_figures, error_figures, figure_style, figures, table_figures
from tiswarm.report.curve_figures import (
    PROFILED,
    SCALING_PANELS,
    compares_rounds,
    rounds_drawing,
    scaling_drawing,
)
from tiswarm.report.error_figures import convergence_drawing, errors_drawing
from tiswarm.report.figure_style import Drawing, png
from tiswarm.report.figures import draw_figures
from tiswarm.report.run_data import load_run
from tiswarm.report.table_figures import accuracy_drawing

COLUMNS = "case,status,condition,series,point,kind"

FIGURES = ["convergence", "error-against-height"]


def test_every_figure_is_drawn(run_folder):
    """Each figure is a PNG file that shows something, and an SVG."""
    written = draw_figures(load_run(run_folder), Progress())

    pictures = [path for path in written if path.suffix == ".png"]
    assert {path.stem for path in pictures} == set(FIGURES)
    drawings = {path.stem for path in written if path.suffix == ".svg"}
    assert drawings == {*FIGURES}
    for path in pictures:
        with Image.open(path) as image:
            assert not is_blank(image)


def _three_panels():
    """Return a figure of three panels with two series, which states what it draws."""
    drawn = []

    def paint(axes, panel, series):
        drawn.append((panel, [*series]))
        for place, name in enumerate(series):
            axes.plot([1.0, 2.0], [3.0, 4.0 + place], label=name)

    def complete(panels):
        panels.legend("mean", panels.entries(), structures=2)
        return []

    series = ["a condition with a name as long as a sentence", "another condition"]
    return drawn, Drawing(
        panels=["one", "two", "three"], series=series, paint=paint, complete=complete, share="y"
    )


def test_a_narrow_figure_has_a_panel_below_the_other():
    """A phone shows it at its size: seven points of a letter remain seven."""
    _, drawing = _three_panels()

    figure = drawing.draw(figure_style.COLUMN_WIDTH)
    figure_style.svg(figure)

    assert figure.get_size_inches()[0] == figure_style.COLUMN_WIDTH
    places = [panel.get_position() for panel in figure.axes]
    assert all(low.y1 < high.y0 for high, low in pairwise(places))
    assert all(panel.yaxis.get_tick_params()["labelleft"] for panel in figure.axes)
    assert len(figure.legends) == 1
    assert figure.get_size_inches()[1] > 3 * 2.0  # the legend has two lines


def test_a_reader_chooses_panels_series_and_width():
    """A paper needs one panel of nine, in the width of its column."""
    drawn, drawing = _three_panels()

    figure = drawing.draw(2.5, ["two"], ["another condition"])

    assert drawn == [("two", ["another condition"])]
    assert (len(figure.axes), figure.get_size_inches()[0]) == (1, 2.5)
    for wrong, problem in (
        ({"panels": ["tow"]}, "panels: there is no 'tow'; choose one of one, two, three"),
        ({"series": ["b"]}, "series: there is no 'b'"),
        ({"width": 0.0}, "width: 0.0 is no width in inches"),
        ({"width": float("nan")}, "width: nan is no width"),
    ):
        with pytest.raises(InputError, match=problem):
            drawing.draw(**wrong)
    with pytest.raises(InputError, match="this figure has no series to choose from; leave it out"):
        replace(drawing, series=[]).draw(series=["b"])


def test_letters_have_seven_points_and_lines_one(run_folder):
    """In a column of a paper, letters of 4.5 pt could not be read."""
    from matplotlib.text import Text

    for name, drawing in figures.drawings_of(load_run(run_folder)).items():
        figure = drawing.draw(figure_style.COLUMN_WIDTH)
        sizes = {text.get_fontsize() for text in figure.findobj(Text) if text.get_text()}
        assert sizes == {figure_style.TEXT_SIZE}, name
        widths = {line.get_linewidth() for axes in figure.axes for line in axes.lines}
        assert widths <= {figure_style.LINE_WIDTH}, name


def test_a_panel_is_drawn_on_given_axes(tmp_path):
    """A reader composes a figure of panels of several runs."""
    from matplotlib.figure import Figure

    _write_scaling(tmp_path, structures=6)
    axes = Figure().subplots()

    scaling_drawing(load_run(tmp_path)).paint_panel(axes, "rmse_R", ["joint"])

    (line,) = axes.lines
    assert (line.get_label(), axes.get_ylabel()) == ("joint", "RMSE [R]")
    assert line.get_color() == figure_style.PALETTE[1]  # that of the whole figure
    np.testing.assert_allclose(line.get_xydata(), [[10, 0.1], [20, 0.2], [40, 0.4]])


def _write_scaling(folder, *, structures):
    """Write the table of a study of three sizes."""
    half = 0.02 if structures >= FEWEST else ""
    rows = [
        [name, "rmse_R", robots, factor * robots, 0.05, 9.0, half, structures, 1.0, 0.2, 1.0]
        for name, factor in (("paper", 0.1), ("joint", 0.01))
        for robots in (10, 20, 40)
    ]
    header = "series,measure,robots,mean,least,most,ci95,structures,exponent,exponent_ci95,slope"
    write_table(folder / "scaling.csv", header, rows)
    write_summary(folder, "case,status", [["0-paper", "done"]])


@pytest.mark.parametrize(
    ("structures", "words", "low"),
    [
        (6, "mean and 95 % interval, 6 structures", 0.08),
        (3, "mean, least and greatest, 3 structures", 0.05),
    ],
)
def test_bands_say_what_they_are(tmp_path, structures, words, low):
    """A reader of a figure alone knows what a band is, and of how many structures."""
    _write_scaling(tmp_path, structures=structures)

    figure = scaling_drawing(load_run(tmp_path)).draw()

    (axes,) = figure.axes
    assert figure.legends[0].get_title().get_text() == words
    (corners,) = [path.vertices for path in axes.collections[1].get_paths()]
    assert corners[:, 1].min() == pytest.approx(low)
    assert [text.get_text() for text in axes.texts] == ["p = 1.00 ± 0.20"]  # of both
    assert axes.get_yscale() == axes.get_xscale() == "log"


def test_names_of_users_are_text(run_folder):
    """A name with two dollar signs was set as a formula, and one with a bad formula ended a run."""
    from matplotlib import rc_context

    with rc_context(figure_style.STYLE):
        figure = figure_style.new_figure(2.0, 2.0)
        axes = figure.subplots()
        axes.set_title(r"a $\nonsense{ b$")
        drawn = figure_style.svg(figure).decode()

    assert r"a $\nonsense{ b$</text>" in drawn


def test_an_existing_pdf_is_drawn_again(run_folder):
    """It would show earlier tables; pictures of others stay."""
    vector = run_folder / "figures" / "convergence.pdf"
    vector.parent.mkdir()
    mine = vector.with_name("mine.png")
    for path in (vector, mine):
        path.touch()

    written = draw_figures(load_run(run_folder), Progress())

    assert {*vector.parent.iterdir()} == {*written, mine}
    assert vector.stat().st_size > 0
    assert mine.stat().st_size == 0


def test_the_same_tables_give_the_same_bytes(run_folder):
    """A figure contains neither the time nor the folder."""
    first = [path.read_bytes() for path in draw_figures(load_run(run_folder), Progress())]

    assert [path.read_bytes() for path in draw_figures(load_run(run_folder), Progress())] == first


def test_failed_cases_are_left_out_and_counted_on_each_figure(run_folder, monkeypatch):
    """A note on each figure states the number of failed cases."""
    drawn = []
    monkeypatch.setattr(figure_style, "png", lambda figure: drawn.append(figure) or b"")

    draw_figures(load_run(run_folder), Progress())

    assert len(drawn) == len(FIGURES)
    for figure in drawn:
        assert "1 of 4 cases failed" in " ".join(text.get_text() for text in figure.texts)


def test_a_run_without_results_has_no_figures(tmp_path):
    """If every case failed, nothing is written, and progress says so."""
    write_summary(tmp_path, "case,status", [["0-baseline", "failed"]])
    progress = Recorder()

    assert draw_figures(load_run(tmp_path), progress) == []
    assert progress.lines == ["no figures: no case is done"]


def test_one_case_of_two_robots_is_enough(tmp_path):
    """The smallest run has all figures, even if one robot has no estimate."""
    folder = tmp_path / "cases" / "0-baseline"
    write_case(folder, seed=0)
    header, *robots = (folder / "robots.csv").read_text().splitlines()
    lost = robots[1].split(",")
    lost[8:11], lost[-1] = ["", "", ""], ""
    (folder / "robots.csv").write_text("\n".join([header, robots[0], ",".join(lost)]) + "\n")
    write_summary(tmp_path, "case,status", [["0-baseline", "done"]])

    assert len(draw_figures(load_run(tmp_path), Progress())) == 2 * len(FIGURES)


def test_a_case_that_ended_early_keeps_its_last_rmse(tmp_path):
    """The mean over seeds does not jump where one case stops."""
    long = write_case(tmp_path / "cases" / "0-baseline", seed=0, last_iteration=40)
    short = write_case(tmp_path / "cases" / "1-baseline", seed=1, last_iteration=20)
    rows = [["0-baseline", "done"], ["1-baseline", "done"]]
    write_summary(tmp_path, "case,status", rows)

    figure = convergence_drawing(load_run(tmp_path)).draw()

    extended = np.array([*short, short[-1], short[-1]])
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata(), (long + extended) / 2.0)


def test_a_method_of_many_more_iterations_is_drawn_to_its_end(tmp_path):
    """Its last RMSE is the result; a logarithmic axis leaves room for short methods."""
    last = {"baseline": 40, "no-z": 40, "joint": 400}
    for name, iteration in last.items():
        write_case(tmp_path / "cases" / f"0-{name}", seed=0, last_iteration=iteration)
    rows = [[f"0-{name}", "done", name, name] for name in last]
    write_summary(tmp_path, "case,status,condition,series", rows)

    figure = convergence_drawing(load_run(tmp_path)).draw()

    (axes,) = figure.axes
    assert axes.get_xscale() == "log"
    assert axes.get_xlim() == pytest.approx((10.0, 400.0))  # without iteration 0


def test_methods_share_no_axis_of_iterations(tmp_path):
    """Iterations of one method cost a hundred times those of another."""
    methods = {"ours": "joint", "paper": "virtual-force", "no-z": "virtual-force"}
    for name in methods:
        write_case(tmp_path / "cases" / f"0-{name}", seed=0)
    rows = [[f"0-{name}", "done", name, name, method] for name, method in methods.items()]
    write_summary(tmp_path, "case,status,condition,series,method", rows)

    figure = convergence_drawing(load_run(tmp_path)).draw()

    drawn = {axes.get_title(): [line.get_label() for line in axes.lines] for axes in figure.axes}
    assert drawn == {"ours": ["ours"], "virtual-force": ["paper", "no-z"]}


def test_only_best_and_worst_have_bands(tmp_path):
    """Three bands are mud, and twenty lines too."""
    names = [f"c{number:02}" for number in range(12)]
    for seed in (0, 1):
        for place, name in enumerate(names):
            write_case(tmp_path / "cases" / f"{seed}-{name}", seed=seed + place)
    rows = [[f"{seed}-{name}", "done", name, name] for name in names for seed in (0, 1)]
    write_summary(tmp_path, "case,status,condition,series", rows)

    figure = convergence_drawing(load_run(tmp_path)).draw()

    (axes,) = figure.axes
    assert len(axes.lines) == figure_style.MOST_SERIES
    colors = {line.get_label(): figure_style.rgb(line.get_color()) for line in axes.lines[-2:]}
    bands = [band.get_facecolor()[0][:3] for band in axes.collections]
    np.testing.assert_allclose(bands, [colors["c00"], colors["c11"]])
    assert "4 more lines not drawn" in figure.texts[-1].get_text()


@pytest.mark.parametrize(
    ("points", "conditions", "rows", "series"),
    [(3, 2, 3, 2), (2, 9, 9, 2), (9, 9, 60, 1), (1, 9, 9, 1), (9, 1, 9, 1)],
)
def test_no_axes_have_more_series_than_a_reader_can_follow(
    tmp_path, points, conditions, rows, series
):
    """Points or conditions have the rows, and what is less of them differs in color."""
    table = [
        [f"c{place}", f"{point}.0", 9, 1.0 + place, 0.1, 0.1, 0.1, "", ""]
        for point in range(points)
        for place in range(conditions)
    ]
    header = "condition,structure.gap,cases,rmse_R_mean,rmse_R_ci95,procrustes_disparity_mean"
    header += ",procrustes_disparity_ci95,paper_rmse_radii,paper_procrustes_disparity"
    write_table(tmp_path / "table.csv", header, table)
    write_summary(tmp_path, "case,status", [["0-c0", "done"]])

    rmse, _ = accuracy_drawing(load_run(tmp_path)).draw().axes

    assert len(rmse.get_yticklabels()) == rows
    assert len(rmse.containers) == series <= figure_style.MOST_SERIES


def test_errors_of_an_accurate_method_are_seen_beside_others(run_folder, monkeypatch):
    """A linear axis would draw all robots of the better method at zero."""
    tables = {"coarse": np.array([[1.0, 5.0, 0], [2.0, 8.0, 1]]), "fine": np.zeros((2, 3))}
    tables["fine"][:, 1] = 0.0, 0.01
    found = iter(tables.values())
    monkeypatch.setattr(error_figures, "_errors_at", lambda _cases, _column: next(found))

    axes = errors_drawing(load_run(run_folder)).draw().axes

    heights = [panel.collections[0].get_offsets()[:, 1] for panel in axes[:2]]
    assert axes[0].get_yscale() == "log"
    assert axes[0].get_ylim()[0] == heights[1].min()  # no error at all is at the lower edge
    assert sorted(heights[0]) == [5.0, 8.0]


def test_panels_above_an_empty_place_have_numbers(run_folder):
    """Panels share axes, and numbers are written below the last panel of each column."""
    figure = Drawing(
        panels=[*"abcde"], paint=lambda *_: None, complete=lambda _: [], share="x"
    ).draw()

    panels = [axes for axes in figure.axes if axes.axison]
    assert [panel.xaxis.get_major_ticks()[0].label1.get_visible() for panel in panels] == [
        False, False, True, True, True,
    ]  # fmt: skip


def test_a_figure_is_laid_out_once(monkeypatch):
    """The layout is half of the work; saving would repeat it."""
    figure = figure_style.new_figure(2.0, 2.0)
    figure.subplots()
    done = []
    engine = type(figure.get_layout_engine())
    lay_out = engine.execute
    monkeypatch.setattr(engine, "execute", lambda *args: done.append(0) or lay_out(*args))

    png(figure)

    assert len(done) == 1


def test_each_kind_of_structure_has_its_panel_and_picture(tmp_path, monkeypatch):
    """Kinds of structures do not share axes."""
    rows = [
        [f"0-{kind}-{condition}", "done", condition, f"{point}, {condition}", point, kind]
        for kind in ("tower", "cantilever")
        for point in [f"structure.kind={kind}"]
        for condition in ("baseline", "no-z")
    ]
    for name, *_ in rows:
        write_case(tmp_path / "cases" / name, seed=0)
    write_summary(tmp_path, COLUMNS, rows)
    drawn = []
    monkeypatch.setattr(figure_style, "png", lambda figure: drawn.append(figure) or b"")

    files = draw_figures(load_run(tmp_path), Progress())

    written = [path.stem for path in files if path.suffix == ".png"]
    assert written == ["convergence", "error-along-growth"]
    titles = [axes.get_title() for axes in drawn[0].axes]
    assert titles == ["tower", "cantilever"]
    assert [len(axes.lines) for axes in drawn[0].axes] == [2, 2]
    along = [axes.get_xlabel() for axes in drawn[1].axes]
    assert along[:2] == ["True height [R]", "True distance out from the edge [R]"]


def test_many_points_and_conditions_have_room(tmp_path):
    """Each point of a sweep has a panel, and labels appear once."""
    conditions = [f"condition-{number}" for number in range(8)]
    rows = [
        [f"0-{point},{condition}", "done", condition, f"{point}, {condition}", point, kind]
        for kind in ("tower", "cantilever")
        for settle in ("0.0", "1.0")
        for point in [f"structure.kind={kind}, structure.climb.settle={settle}"]
        for condition in conditions
    ]
    for name, *_ in rows:
        write_case(tmp_path / "cases" / name, seed=0)
    write_summary(tmp_path, COLUMNS, rows)

    figure = convergence_drawing(load_run(tmp_path)).draw()

    assert png(figure)  # without a warning that axes have no room
    assert [axes.get_title() for axes in figure.axes] == [
        "tower / settle 0", "tower / settle 1", "cantilever / settle 0", "cantilever / settle 1",
    ]  # fmt: skip
    texts = {text.get_text() for text in figure.legends[0].get_texts()}
    assert texts == {"others", "condition-0", "condition-7"}  # all are equally good here
    for axes in figure.axes:
        colors = [line.get_color() for line in axes.lines]
        assert len(colors) == 8
        assert len({color for color in colors if color != "0.75"}) <= 3


def test_of_many_series_the_first_conditions_of_all_points_are_drawn(tmp_path):
    """No point of a sweep is left out in favor of more conditions of another."""
    names = [f"0-method={method},c{k}" for method in ("a", "b") for k in range(6)]
    for name in names:
        write_case(tmp_path / "cases" / name, seed=0)
    rows = [[name, "done", name[2:], name[-2:], name[2:10]] for name in names]
    write_summary(tmp_path, "case,status,series,condition,point", rows)

    figure = errors_drawing(load_run(tmp_path)).draw()

    titles = [axes.get_title() for axes in figure.axes[:4]]
    assert titles == ["method=a,c0", "method=b,c0", "method=a,c1", "method=b,c1"]
    assert "4 more series not shown" in figure.texts[-1].get_text()


def test_published_numbers_stand_beside_ours(tmp_path):
    """Only the row of the published condition has an open marker."""
    header = (
        "condition,structure.kind,cases,rmse_R_mean,rmse_R_ci95,procrustes_disparity_mean,"
        "procrustes_disparity_ci95,paper_rmse_radii,paper_procrustes_disparity"
    )
    rows = [
        ["baseline", "tower", 25, 3.1, 0.2, 0.07, 0.01, 1.64, 0.045],
        ["back-propagation", "tower", 25, 2.4, 0.2, 0.04, 0.01, "", ""],
    ]
    write_table(tmp_path / "table.csv", header, rows)
    write_summary(tmp_path, "case,status", [["0-baseline", "done"]])

    figure = accuracy_drawing(load_run(tmp_path)).draw()

    rmse, disparity = figure.axes
    open_markers = [line for line in rmse.lines if line.get_markerfacecolor() == "white"]
    np.testing.assert_equal(open_markers[0].get_xdata(), [1.64, np.nan])
    assert [label.get_text() for label in rmse.get_yticklabels()] == [
        "baseline",
        "back-propagation",
    ]
    assert disparity.get_xlabel() == "Procrustes disparity"
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == ["mean and 95 % interval, 25 structures", "published (robot radii)"]


def test_rounds_of_back_propagation_are_drawn_against_their_cost(tmp_path):
    """Lines join rounds that move equally many robots; what has no rounds is a level."""
    header = "condition,structure.kind,cases,steps_per_robot_mean,round_every,round_recent"
    header += ",round_sweeps,rmse_R_mean,rmse_R_ci95"
    header += ",procrustes_disparity_mean,procrustes_disparity_ci95"
    rows = [
        [name, kind, 25, steps, every, recent, 2000 if every else "", rmse, 0.1, 0.1, 0.1]
        for kind in ("tower", "cantilever")
        for name, steps, every, recent, rmse in (
            ("never", 300, "", "", 3.0),
            ("every-10", 9000, 10, "", 1.0),
            ("every-50", 3000, 50, "", 2.0),
            ("every-10-last-20", 4000, 10, 20, 2.5),
            ("joint", "", "", "", 0.1),
        )
    ]
    write_table(tmp_path / "table.csv", header, rows)
    write_summary(tmp_path, "case,status", [["0-never", "done"]])
    run = load_run(tmp_path)

    figure = rounds_drawing(run).draw()

    assert compares_rounds(run)
    assert [axes.get_title() for axes in figure.axes] == ["tower", "cantilever"]
    levels, lines = figure.axes[0].lines[:2], figure.axes[0].containers
    assert [line.get_ydata()[0] for line in levels] == [3.0, 0.1]
    np.testing.assert_allclose(lines[0].lines[0].get_xydata(), [[3000, 2.0], [9000, 1.0]])
    np.testing.assert_allclose(lines[1].lines[0].get_xydata(), [[4000, 2.5]])
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == ["all", "last 20"]


def test_a_folder_without_a_run_is_refused(tmp_path):
    """The message names the folder."""
    with pytest.raises(InputError, match="name a folder that"):
        draw_figures(load_run(tmp_path), Progress())


@pytest.mark.parametrize(
    ("points", "names"),
    [
        ([], {"profiles"}),
        (["tower", "chain"], {"profiles-tower", "profiles-chain"}),
        ([10, 20, 30, 40, 50], {"profiles"}),
    ],
)
def test_profiles_of_a_few_points_are_kept_apart(run_folder, points, names):
    """Few points have a figure each, many share one; values are those of the table."""
    rows = [
        ["baseline", *point, by, low, low + 1, 4, 0.5, 1.0 + low, "", ""]
        for point in ([[value] for value in points] or [[]])
        for by in PROFILED
        for low in (1, 2, 4)
    ]
    header = "condition,swept,by,low,high,count,mean_error_R,rmse_R,p10_R,p90_R"
    write_table(
        run_folder / "profiles.csv", header if points else header.replace("swept,", ""), rows
    )

    painters = curve_figures.painters(load_run(run_folder))
    drawn = next(iter(painters.values())).draw()

    assert set(painters) == names
    np.testing.assert_allclose(
        drawn.axes[0].lines[0].get_xydata(), [[1.5, 2.0], [2.5, 3.0], [4.5, 5.0]]
    )


def test_profile_points_of_few_robots_are_open_and_apart(run_folder):
    """A point of one robot does not pull the line down."""
    rows = [
        ["baseline", by, low, low, robots, 0.5, rmse, "", ""]
        for by in PROFILED
        for low, robots, rmse in [(1, 30, 2.0), (2, 6, 1.5), (8, 1, 0.0)]
    ]
    header = "condition,by,low,high,count,mean_error_R,rmse_R,p10_R,p90_R"
    write_table(run_folder / "profiles.csv", header, rows)

    figure = curve_figures.painters(load_run(run_folder))["profiles"].draw()

    joined, few = figure.axes[0].lines
    np.testing.assert_allclose(joined.get_xydata(), [[1.0, 2.0], [2.0, 1.5]])
    np.testing.assert_allclose(few.get_xydata(), [[8.0, 0.0]])
    assert few.get_markerfacecolor() == "white"
    assert "open: fewer than 5 robots" in figure.texts[-1].get_text()


def test_profiles_show_how_errors_of_like_robots_differ(run_folder):
    """A band covers most robots of each range, where its quantiles are known."""
    rows = [
        ["baseline", by, low, low, 9, 1.0, *([0.1, 3.0] if by == "join" else ["", ""])]
        for by in PROFILED
        for low in (1, 2, 4)
    ]
    write_table(run_folder / "profiles.csv", "condition,by,low,high,count,rmse_R,p10_R,p90_R", rows)

    figure = curve_figures.painters(load_run(run_folder))["profiles"].draw()

    (band,) = figure.axes[0].collections
    (corners,) = [path.vertices for path in band.get_paths()]
    assert (corners[:, 1].min(), corners[:, 1].max()) == (0.1, 3.0)
    assert not any(axes.collections for axes in figure.axes[1:])


@pytest.mark.parametrize(
    ("points", "conditions", "panels", "lines"),
    [
        (1, 9, 9, 1),
        pytest.param(12, 2, 12, 2, marks=pytest.mark.trial),
        pytest.param(5, 9, 32, 1, marks=pytest.mark.trial),
    ],
)
def test_profiles_of_more_series_than_colors_are_small_multiples(
    run_folder, points, conditions, panels, lines
):
    """A reader tells a few lines of a panel apart, never twenty; gray ones repeat the first."""
    rows = [
        [f"c{condition}", point, by, low, low + 1, 9, 0.5, 1.0 + condition + low, "", ""]
        for condition in range(conditions)
        for point in range(points)
        for by in PROFILED
        for low in (1, 2, 4)
    ]
    header = "condition,swept,by,low,high,count,mean_error_R,rmse_R,p10_R,p90_R"
    write_table(run_folder / "profiles.csv", header, rows)

    painters = curve_figures.painters(load_run(run_folder))
    figure = next(iter(painters.values())).draw()

    shown = [axes for axes in figure.axes if axes.axison]
    assert len(shown) == panels
    colored = [[line for line in axes.lines if line.get_color() != "0.8"] for axes in shown]
    assert {len(each) for each in colored} == {lines}
    assert png(figure)


def test_grades_of_a_sensor_are_a_curve(run_folder):
    """The error is drawn against the number that conditions differ in, not a row for each name."""
    grades = ("0.3", "1", "10")
    rows = [
        [name, kind, 4, error, 0.1, error, 0.1]
        for kind in ("tower", "cantilever")
        for name, error in [
            ("neither", 2.0),
            *((f"range-{grade}", float(grade)) for grade in grades),
            *((f"tilt ({grade} deg)", 2.0 * float(grade)) for grade in reversed(grades)),
        ]
    ]
    measures = "rmse_R_mean,rmse_R_ci95,procrustes_disparity_mean,procrustes_disparity_ci95"
    write_table(run_folder / "table.csv", f"condition,structure.kind,cases,{measures}", rows)
    (run_folder / "scenario.yaml").write_text(
        "conditions:\n"
        + "".join(f"  tilt ({g} deg): {{sensing.tilt_noise_deg: {g}}}\n" for g in grades)
        + "".join(f"  range-{g}: {{sensing.range_reach: 8, sensing.range: {g}}}\n" for g in grades)
    )

    drawing = curve_figures.painters(load_run(run_folder))["grades"]
    figure = drawing.draw()

    first, second = (axes for axes in figure.axes if axes.axison)
    assert [first.get_title(), second.get_title()] == ["range", "tilt"]
    assert [first.get_xlabel(), second.get_xlabel()] == ["range", "tilt noise [deg]"]
    curves = [line for line in second.lines if len(line.get_xdata()) == 3]
    assert len(curves) == 2  # tower and cantilever
    np.testing.assert_allclose(curves[0].get_xydata(), [[0.3, 0.6], [1.0, 2.0], [10.0, 20.0]])
    assert sum(line.get_linestyle() == "--" for line in second.lines) == 2
    require_alike(drawing)


def test_grades_state_the_errors_of_all_robots(run_folder):
    """The error of all robots ranks in tables and figures, also where not all are located."""
    names = [f"mute {share} %" for share in (5, 10, 20)]
    measures = "rmse_R_mean,rmse_R_ci95,rmse_located_R_mean,rmse_located_R_ci95,located_mean"
    rows = [[name, 4, 9.0, 1.0, 0.5, 0.1, 0.8] for name in names]
    write_table(run_folder / "table.csv", f"condition,cases,{measures}", rows)
    summary = pd.read_csv(run_folder / "summary.csv").assign(located=0.8)
    summary.to_csv(run_folder / "summary.csv", index=False)
    (run_folder / "scenario.yaml").write_text(
        "conditions:\n"
        + "".join(f"  {name}: {{sensing.mute: 0.{name[5:-2]:0>2}}}\n" for name in names)
    )

    figure = curve_figures.painters(load_run(run_folder))["grades"].draw()

    axes = next(axes for axes in figure.axes if axes.axison)
    assert [*axes.lines[0].get_ydata()] == [9.0, 9.0, 9.0]
    texts = figure.findobj(lambda artist: hasattr(artist, "get_text"))
    assert "RMSE [R]" in {text.get_text() for text in texts}


def test_conditions_that_differ_in_two_numbers_are_no_grades(run_folder):
    """Nor are those of which only names have numbers."""
    measures = "rmse_R_mean,rmse_R_ci95"
    rows = [[f"{name}-{number}", 4, 1.0, 0.1] for name in ("noise", "m") for number in (1, 2, 3)]
    write_table(run_folder / "table.csv", f"condition,cases,{measures}", rows)
    (run_folder / "scenario.yaml").write_text(
        "conditions:\n"
        "  noise-1: {sensing.tilt_noise_deg: 1, sensing.yaw_noise_deg: 1}\n"
        "  noise-2: {sensing.tilt_noise_deg: 2, sensing.yaw_noise_deg: 2}\n"
        "  noise-3: {sensing.tilt_noise_deg: 2, sensing.yaw_noise_deg: 5}\n"
        + "".join(f"  m-{n}: {{localization: {{method: joint, chains: {n}}}}}\n" for n in (1, 2, 3))
    )

    assert "grades" not in curve_figures.painters(load_run(run_folder))


def test_conditions_that_differ_in_whole_settings_are_no_grades(run_folder):
    """A condition may replace the settings of a method at once."""
    rows = [[f"method-{number}", 4, 1.0, 0.1] for number in (1, 2, 3)]
    write_table(run_folder / "table.csv", "condition,cases,rmse_R_mean,rmse_R_ci95", rows)
    (run_folder / "scenario.yaml").write_text(
        "conditions:\n"
        + "".join(f"  method-{n}: {{localization: {{iterations: {n}}}}}\n" for n in (1, 2, 3))
    )

    assert "grades" not in curve_figures.painters(load_run(run_folder))


def test_shapes_are_compared_in_accuracy_and_structure(tmp_path):
    """A row for each robot; properties of the structure are the same for all conditions."""
    measures = ["rmse_R", "floppy_modes", "contacts_per_robot", "height_R"]
    header = ",".join(
        ["condition,robot.shape,cases", *(f"{name}_mean,{name}_ci95" for name in measures)]
    )
    rows = [
        [name, shape, 10, rmse, 0.1, modes, 1, 1.8, 0.1, 39, 2]
        for shape in ("line", "cube")
        for name, rmse, modes in [("joint", 0.1, 0), ("virtual-force", 3, 20)]
    ]
    write_table(tmp_path / "table.csv", header, rows)
    write_summary(tmp_path, "case,status", [["0-joint", "done"]])

    figure = table_figures.shape_drawing(load_run(tmp_path)).draw()

    rmse, modes, contacts, height = figure.axes
    assert [label.get_text() for label in rmse.get_yticklabels()] == ["line", "cube"]
    assert [line.get_xdata().tolist() for line in modes.lines] == [[0, 0], [20, 20]]
    assert modes.get_xlim()[0] < 0.0
    assert {line.get_color() for line in [*contacts.lines, *height.lines]} == {"0.4"}
    assert len({line.get_color() for line in modes.lines}) == 2


@pytest.mark.parametrize(("cases", "bars"), [(2, 0), (5, 2)])
def test_few_structures_are_drawn_instead_of_an_interval(tmp_path, cases, bars):
    """An interval over two structures says nothing; small means are visible beside great ones."""
    header = "condition,cases,paper_rmse_radii,paper_procrustes_disparity"
    for measure in ("rmse_R", "procrustes_disparity"):
        header += f",{measure}_mean,{measure}_ci95"
    names = ["paper", "joint"]
    rows = [
        [name, cases, "", "", rmse, 9, 0.1, 0.1] for name, rmse in zip(names, (3, 0.1), strict=True)
    ]
    write_table(tmp_path / "table.csv", header, rows)
    done = [[f"{k}-{name}", "done", name, k + 1] for name in names for k in range(cases)]
    write_summary(tmp_path, "case,status,condition,rmse_R", done)

    figure = accuracy_drawing(load_run(tmp_path)).draw()

    rmse = figure.axes[0]
    assert len(rmse.collections) == (1 if bars else 0)
    drawn = [line for line in rmse.lines if line.get_alpha()]
    assert [list(line.get_xdata()) for line in drawn] == ([] if bars else [[1, 2, 1, 2]])
    assert rmse.get_xscale() == "log"


def test_series_that_are_equal_are_one_line(tmp_path):
    """Growth is the same for all conditions; a second line would hide the first."""
    rows = [
        [series, measure, robots, value * robots, 1.0, 0.1, 1.0]
        for measure in SCALING_PANELS
        for series, factor in (("paper", 1.0), ("joint", 2.0))
        for robots in (10, 100)
        for value in [1.0 if measure == "grow_cpu_s" else factor]
    ]
    header = "series,measure,robots,mean,exponent,exponent_ci95,slope"
    write_table(tmp_path / "scaling.csv", header, rows)
    write_summary(tmp_path, "case,status", [["0-paper", "done"]])

    figure = scaling_drawing(load_run(tmp_path)).draw()

    lines = dict(zip(SCALING_PANELS, (len(axes.lines) for axes in figure.axes), strict=True))
    assert lines.pop("grow_cpu_s") == 1
    assert set(lines.values()) == {2}
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == ["paper", "joint"]
    assert figure.texts[-1].get_text() == "p: power of N, 95 % CI; gray: all series"

    write_table(tmp_path / "scaling.csv", header, [[*row[:4], "", "", ""] for row in rows])

    assert scaling_drawing(load_run(tmp_path)).draw().texts[-1].get_text() == "gray: all series"


@pytest.mark.parametrize(("series", "stated"), [(4, 4), (5, 0)])
def test_powers_are_stated_where_a_reader_finds_whose_they_are(tmp_path, series, stated):
    """Equal series state theirs once; of more than four, `scaling.csv` has them."""
    names = [*(f"method {k}" for k in range(series)), "like method 0"]
    rows = [
        [name, measure, robots, (1 + place % series) * robots, power, 0.1, power]
        for measure in SCALING_PANELS
        for place, name in enumerate(names)
        for robots in (10, 100)
        for power in [1.0 + place % series / 10]
    ]
    header = "series,measure,robots,mean,exponent,exponent_ci95,slope"
    write_table(tmp_path / "scaling.csv", header, rows)
    write_summary(tmp_path, "case,status", [["0-paper", "done"]])

    figure = scaling_drawing(load_run(tmp_path)).draw()

    assert {len(axes.texts) for axes in figure.axes} == {stated}
    assert "in scaling.csv" in figure.texts[-1].get_text()


def test_no_two_of_many_series_look_alike():
    """Where colors repeat, dashes or markers do not."""
    for style in (figure_style.line_style, figure_style.marker_style):
        looks = [style(place) for place in range(3 * len(figure_style.PALETTE))]
        looks = [
            tuple(sorted((k, v) for k, v in look.items() if k != "linewidth")) for look in looks
        ]

        assert len(set(looks)) == len(looks)


def test_last_digits_of_a_layout_change_no_byte():
    """The solver of layouts orders variables by memory addresses, which vary from run to run."""
    from matplotlib import rc_context

    def drawn(noise):
        figure = figure_style.new_figure(3.0, 2.0)
        axes = figure.subplots()
        axes.plot([0.0, 1.0], [0.0, 1.0])
        engine = figure.get_layout_engine()
        execute = engine.execute

        def disturbed(whole):
            execute(whole)
            bounds = np.array(axes.get_position(original=True).bounds)
            axes.set_position(bounds + noise)

        engine.execute = disturbed
        with rc_context(figure_style.STYLE):
            return figure_style.svg(figure)

    assert drawn(1e-13) == drawn(0.0)
