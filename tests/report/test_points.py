"""No point of a figure lies outside its axes, whatever the numbers are."""

import numpy as np
import pandas as pd
import pytest

from tests.report.conftest import require_alike, write_case, write_summary, write_table
from tiswarm.app.comparison import rows_drawing
from tiswarm.records.frames import read_frame
from tiswarm.report import error_figures, figures
from tiswarm.report.curve_figures import PROFILED, SCALING_PANELS
from tiswarm.report.run_data import load_run, with_points

CONDITIONS = ("baseline", "no-z", "joint")
MEASURES = (
    "rmse_R", "procrustes_disparity", "floppy_modes", "contacts_per_robot", "height_R",
)  # fmt: skip


def outside(figure):
    """List the points of lines and dots that a figure's panels do not show."""
    found = []
    for axes in figure.axes:
        for line in axes.lines:
            if line.get_transform() == axes.transData:
                found += _beyond(axes, np.asarray(line.get_xydata(), float))
        for dots in axes.collections:
            if len(dots.get_offsets()) and dots.get_offset_transform() == axes.transData:
                found += _beyond(axes, np.asarray(dots.get_offsets(), float))
    return found


def _beyond(axes, points):
    """Points outside the limits; a logarithmic axis has no place for what is not positive."""
    ends = np.array([sorted(axes.get_xlim()), sorted(axes.get_ylim())])
    is_log = np.array([axes.get_xscale() == "log", axes.get_yscale() == "log"])
    points = points[np.isfinite(points).all(axis=1) & ((points > 0.0) | ~is_log).all(axis=1)]
    slack = 1e-9 * np.abs(ends).max(axis=1)
    is_out = (points < ends[:, 0] - slack) | (points > ends[:, 1] + slack)
    return [(axes.get_xlabel(), *point) for point in points[is_out.any(axis=1)].tolist()]


def _write_run(folder, kind, width, random):
    """Write a run with every table, whose numbers spread over `width` factors of e."""

    def drawn(*shape):
        return random.lognormal(0.0, width, shape)

    names = [(seed, name) for name in CONDITIONS for seed in range(3)]
    for seed, name in names:
        case = folder / "cases" / f"{seed}-{name}"
        write_case(case, seed=seed)
        robots = pd.read_csv(case / "robots.csv")
        robots["error_R"] = drawn(len(robots))
        robots.to_csv(case / "robots.csv", index=False)
        trace = zip([0, 10, 400], drawn(3), strict=True)
        write_table(case / "convergence.csv", "iteration,rmse_R", trace)
    scores = [[f"{s}-{n}", "done", n, n, "", kind, 1.5, *drawn(2)] for s, n in names]
    header = "case,status,condition,series,point,kind,robot.rho,rmse_R,procrustes_disparity"
    write_summary(folder, header, scores)
    columns = [f"{name}_{part}" for name in MEASURES for part in ("mean", "ci95")]
    header = "condition,robot.rho,cases,paper_rmse_radii,paper_procrustes_disparity"
    rounds = "round_every,round_recent,round_sweeps,steps_per_robot_mean"
    rows = [
        [name, 1.5, 3, *drawn(2 + len(columns)), *every, *drawn(1)]
        for name, every in zip(CONDITIONS, (["", "", ""], [5, "", 100], [10, 3, 100]), strict=True)
    ]
    write_table(folder / "table.csv", ",".join([header, *columns, rounds]), rows)
    header = "run,condition,cases,rmse_R_mean,rmse_R_ci95"
    header += ",procrustes_disparity_mean,procrustes_disparity_ci95"
    write_table(folder / "comparison.csv", header, [["a", n, 3, *drawn(4)] for n in CONDITIONS])
    header = "condition,suite,way,needs,cases,usd_100,rmse_R_mean,rmse_R_ci95"
    rows = [[name, f"suite {name}", "joint", "none", 3, *drawn(3)] for name in CONDITIONS]
    write_table(folder / "suites.csv", header, rows)
    rows = [
        [name, measure, size, mean, 1.0, 1.0]
        for name in CONDITIONS
        for measure in SCALING_PANELS
        for size, mean in zip((10, 100, 1000), drawn(3), strict=True)
    ]
    write_table(folder / "scaling.csv", "series,measure,robots,mean,exponent,slope", rows)
    rows = [
        [name, by, low, low + 1, count, 1.0, *drawn(1), *np.sort(drawn(2))]
        for name in CONDITIONS
        for by in PROFILED
        for low, count in ((1, 20), (2, 20), (4, 2))
    ]
    header = "condition,by,low,high,count,mean_error_R,rmse_R,p10_R,p90_R"
    write_table(folder / "profiles.csv", header, rows)


@pytest.mark.parametrize(
    ("kind", "width"),
    [
        ("tower", 0.1),
        ("cantilever", 1.0),
        *(
            pytest.param(kind, width, marks=pytest.mark.trial)
            for kind, width in (
                ("tower", 1.0),
                ("tower", 4.0),
                ("cantilever", 0.1),
                ("cantilever", 4.0),
            )
        ),
    ],
)
def test_no_point_lies_outside_its_axes(tmp_path, kind, width):
    """A quarter of the robots of cantilevers were drawn over the title, others nowhere."""
    _write_run(tmp_path, kind, width, np.random.default_rng(round(10 * width)))
    run = load_run(tmp_path)

    drawn = {name: drawing.draw() for name, drawing in figures.drawings_of(run).items()}
    compared = rows_drawing(with_points(read_frame(tmp_path / "comparison.csv", ["run"]))).draw()

    errors = "error-against-height" if kind == "tower" else "error-along-growth"
    several = ["accuracy", "shape", "scaling", "back-propagation", "profiles", "price-and-error"]
    assert [*drawn] == ["convergence", errors, *several]
    assert {name: outside(figure) for name, figure in drawn.items()} == {name: [] for name in drawn}
    assert outside(compared) == []


def test_a_narrow_figure_shows_what_the_wide_one_shows(tmp_path):
    """Axes of phones ran from 1e-5 to 1e5 for errors of 0.05 to 5 R, with TeX as labels."""
    _write_run(tmp_path, "tower", 4.0, np.random.default_rng(0))
    run = load_run(tmp_path)

    drawings = figures.drawings_of(run)

    assert len(drawings) > 1
    for drawing in drawings.values():
        require_alike(drawing)


def test_a_structure_that_grows_outward_is_drawn_along_it(tmp_path):
    """Robots of a cantilever are at nearly the same height; errors add up along the arm."""
    _write_run(tmp_path, "cantilever", 1.0, np.random.default_rng(0))

    figure = error_figures.errors_drawing(load_run(tmp_path)).draw()

    assert figure.get_supxlabel() == "True distance out from the edge [R]"
    x = figure.axes[0].collections[0].get_offsets()[:, 0]
    np.testing.assert_allclose(np.unique(x), np.arange(12.0))  # `write_case` steps 1 R along x
