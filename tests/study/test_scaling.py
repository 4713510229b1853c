"""Forecast and measured cost of a study, and their growth with its size."""

import json
import time

import numpy as np
import pandas as pd
import pytest

from tests.recorder import Recorder
from tests.runs import REPOSITORY
from tiswarm import study
from tiswarm.base.progress import Progress
from tiswarm.parts.curve_figures import SCALING_PANELS, draw_scaling
from tiswarm.parts.forecast import fewer
from tiswarm.parts.forecast import forecast as forecast_of
from tiswarm.report.run_data import load_run
from tiswarm.scenario.expansion import load_scenario

SIZES = (6, 9, 14)


@pytest.fixture(scope="module")
def scaled(tmp_path_factory):
    """Folder of a run of three sizes, two seeds and three conditions."""
    rows = {"robots, structure.movers": [[size, size // 6] for size in SIZES]}
    small = load_scenario(
        REPOSITORY / "scenarios" / "scaling.yaml",
        [f"sweep={rows}", "seeds=2", "conditions.joint.localization.steps=20"],
    )
    out = tmp_path_factory.mktemp("scaled")
    return study.run(small, out, progress=Progress()).folder


def _costs(folder, robots):
    cases = (folder / "cases").glob(f"*-robots={robots},*")
    return {case.name: json.loads((case / "cost.json").read_text()) for case in cases}


def test_scaling_tells_means_by_size(scaled):
    """Means are over cases; the growth of a structure counts once."""
    table = pd.read_csv(scaled / "scaling.csv")
    mean = table.set_index(["series", "measure", "robots"])["mean"]
    summary = pd.read_csv(scaled / "summary.csv").groupby(["condition", "robots"])

    for size in SIZES:
        costs = _costs(scaled, size)
        grown = sum(cost["grow"]["cpu_s"] for cost in costs.values())
        joint = [cost["localize"]["cpu_s"] for name, cost in costs.items() if "joint" in name]
        assert len(costs) == 6
        assert mean["joint", "rmse_R", size] == pytest.approx(
            summary["rmse_R"].mean()["joint", size]
        )
        assert mean["joint", "grow_cpu_s", size] == pytest.approx(grown / 2)
        assert mean["joint", "localize_cpu_s", size] == pytest.approx(np.mean(joint))
        assert mean["paper", "grow_cpu_s", size] == mean["joint", "grow_cpu_s", size]
        assert mean["paper", "localize_cpu_s", size] != mean["together", "localize_cpu_s", size]


def test_exponents_are_slopes_on_logarithmic_axes(scaled):
    """Exponents are least-squares slopes of log mean over log N; slopes are those of each step."""
    for _, part in pd.read_csv(scaled / "scaling.csv").groupby(["series", "measure"]):
        x, y = np.log(part["robots"]), np.log(part["mean"])
        slope = np.sum((x - x.mean()) * (y - y.mean())) / np.sum((x - x.mean()) ** 2)

        np.testing.assert_allclose(part["exponent"], slope, atol=1e-9)
        steps = np.diff(y) / np.diff(x)
        np.testing.assert_allclose(part["slope"], [np.nan, *steps], atol=1e-9)


def test_the_manifest_adds_costs_up(scaled):
    """The time of a stage is the sum over its cases."""
    stages = json.loads((scaled / "manifest.json").read_text())["stages"]
    costs = [cost for size in SIZES for cost in _costs(scaled, size).values()]

    for name, spent in stages.items():
        assert spent["cpu_s"] == pytest.approx(sum(c[name]["cpu_s"] for c in costs), abs=1e-3)


def test_the_figure_shows_every_series(scaled):
    """Each panel has a line for each condition, at the means of the table; one if all are equal."""
    table = pd.read_csv(scaled / "scaling.csv")
    names = table["series"].unique().tolist()
    means = table.set_index(["measure", "series"])["mean"].sort_index(kind="stable")

    figure = draw_scaling(load_run(scaled))

    assert names == ["paper", "together", "joint"]
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == ["Algorithm 1", "Algorithm 1, all at once", "joint", "all series"]
    for axes, measure in zip(figure.axes, SCALING_PANELS, strict=True):
        wanted = [means[measure, name].to_numpy() for name in names]
        if all(np.array_equal(mean, wanted[0]) for mean in wanted):
            wanted = wanted[:1]
        drawn = [line.get_ydata() for line in axes.lines]
        np.testing.assert_allclose(drawn, wanted)


def test_the_largest_structure_is_shown(scaled):
    """Renders are of the first case of the largest size."""
    shown = load_run(scaled).choose(None)

    assert shown.name == f"0-robots={SIZES[-1]},paper"


def test_a_plan_is_printed_and_nothing_runs(tiswarm, tmp_path):
    """`run --plan` and `check` print cases, robots and an estimate."""
    scenario = REPOSITORY / "scenarios" / "scaling.yaml"

    planned = tiswarm("run", scenario, "--plan", "--out", tmp_path / "out")
    checked = tiswarm("check", scenario)

    expected = "63 cases, 1299600 robots in all; estimate: "
    assert planned.stdout.startswith(expected)
    assert expected in checked.stdout
    assert not (tmp_path / "out").exists()


def test_a_forecast_grows_with_what_is_asked_for():
    """Twice the seeds cost twice; conditions share the growth of their structures."""
    tower = REPOSITORY / "tests" / "tower.yaml"

    def forecast(*overrides):
        return forecast_of(load_scenario(tower, overrides))

    once, twice = forecast("seeds=2"), forecast("seeds=4")
    alone = forecast("seeds=2", "conditions={baseline: {}}")

    assert twice.grow_s == pytest.approx(2 * once.grow_s)
    assert twice.localize_s == pytest.approx(2 * once.localize_s)
    assert alone.grow_s == pytest.approx(once.grow_s)
    assert alone.localize_s == pytest.approx(once.localize_s / 3)
    assert forecast("robots=20000").memory_mb > once.memory_mb


def test_a_forecast_counts_cases_instead_of_listing_them():
    """A million seeds take a fraction of a second; to list their cases takes a minute."""
    scenario = load_scenario(REPOSITORY / "tests" / "tower.yaml", ["seeds=1000000"])
    begun = time.process_time()

    forecast = forecast_of(scenario)

    assert time.process_time() - begun < 1.0
    assert (forecast.cases, forecast.robots) == (3_000_000, 300_000_000)


def test_a_forecast_tells_schemes_of_messages_apart():
    """Robots that anneal as they join took 27 times as long as Algorithm 1 by messages."""

    def per_robot(**settings):
        keys = {"localization": {"method": "distributed", **settings}, "conditions": {"a": {}}}
        tower = REPOSITORY / "tests" / "tower.yaml"
        overrides = [f"{key}={json.dumps(value)}" for key, value in keys.items()]
        return forecast_of(load_scenario(tower, overrides)).localize_s / 300

    # Processor time [s] of a robot in a tower of 100, seed 0, by `cost.json`.
    measured = {
        0.052: per_robot(),
        0.013: per_robot(chains=0),
        0.0019: per_robot(scheme="algorithm-1"),
        0.0062: per_robot(scheme="algorithm-1", back_propagation={"every": 10}),
    }
    for spent, expected in measured.items():
        assert spent / 3.0 < expected < 3.0 * spent


def test_a_forecast_counts_the_start_of_each_process():
    """Two workers start two programs: in a small study that takes longer than the study."""
    tower = load_scenario(REPOSITORY / "tests" / "tower.yaml")

    alone, apart = forecast_of(tower), forecast_of(tower, study.Execution(workers=2))

    assert apart.start_s == 3 * alone.start_s
    assert apart[3:] == alone[3:]


def test_little_work_is_done_by_one_process():
    """Two would take longer to start; a limit of time, long work and plug-ins keep them."""
    small = load_scenario(REPOSITORY / "tests" / "tower.yaml")
    large = load_scenario(REPOSITORY / "scenarios" / "paper.yaml")
    two = study.Execution(workers=2)
    limited = study.Execution(workers=2, case_limit_s=60.0)
    said = Recorder()

    assert fewer(small, two, said).workers is None
    assert fewer(large, two, said) == two
    assert fewer(small, limited, said) == limited
    assert [line.partition(":")[0] for line in said.lines] == ["one process instead of 2"]


def test_a_forecast_counts_what_robots_estimate_while_they_build():
    """Robots that go by their estimates make them at each join, for one robot or for all."""
    tower = REPOSITORY / "tests" / "tower.yaml"

    def growth(*overrides):
        return forecast_of(load_scenario(tower, ["conditions={a: {}}", *overrides])).grow_s

    by_truth, by_estimate = growth(), growth("structure.navigate_by=estimate")
    all_again = growth("structure.navigate_by=estimate", "localization.method=joint")

    assert by_truth < by_estimate < all_again / 10
