"""The figure of joining robots has their errors as they joined beside those at the end."""

import numpy as np
import pandas as pd
import pytest

from tests.report.conftest import require_alike
from tiswarm.report.pictures.swarm_figures import painters
from tiswarm.report.run_data import RunData

SIZES = (4, 8)


@pytest.fixture
def run(tmp_path):
    """A run of two sizes. `online` errs by 2 R as robots join and by 0.5 R later, `joint` by 1."""
    rows = []
    for condition in ("online", "joint"):
        for size in SIZES:
            case = f"{condition}-{size}"
            folder = tmp_path / "cases" / case
            folder.mkdir(parents=True)
            table = pd.DataFrame({"robot": np.arange(size), "error_R": 1.0})
            if condition == "online":
                table = table.assign(error_R=0.5, error_at_join_R=2.0)
            table.to_csv(folder / "robots.csv", index=False)
            rows.append(
                {
                    "case": case,
                    "series": case,
                    "condition": condition,
                    "point": f"robots={size}",
                    "kind": "tower",
                    "status": "done",
                    "reason": "",
                    "robots": size,
                    "rmse_at_join_R": 2.0 if condition == "online" else np.nan,
                }
            )
    return RunData(tmp_path, pd.DataFrame(rows))


def test_lines_are_errors_at_joining_and_later(run):
    """Only a method that places robots as they join has a second, dashed line."""
    figure = painters(run)["joining"].draw()

    [axes] = figure.axes
    drawn = {line.get_label(): line.get_ydata().tolist() for line in axes.lines}
    assert drawn == {
        "online, as they join": [2.0, 2.0],
        "online, later": [0.5, 0.5],
        "joint": [1.0, 1.0],
    }


def test_runs_without_joins_or_sizes_have_no_such_figure(run):
    """It would have nothing to show."""
    one_size = run.summary[run.summary["robots"] == SIZES[0]]
    offline = run.summary[run.summary["condition"] == "joint"]

    assert painters(RunData(run.folder, one_size)) == {}
    assert painters(RunData(run.folder, offline)) == {}


def test_it_is_the_same_in_a_narrow_page(run):
    """Another width changes neither limits nor series."""
    require_alike(painters(run)["joining"])
