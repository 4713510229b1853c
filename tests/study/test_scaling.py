"""Forecast and measured cost of a study, and their growth with its size."""

import json
import time

import numpy as np
import pandas as pd
import pytest

from tests.recorder import Recorder
from tests.runs import REPOSITORY
from tiswarm import study
from tiswarm.base.errors import EnvironmentTroubleError
from tiswarm.base.progress import Progress
from tiswarm.compute.machine import find_card
from tiswarm.report.curve_figures import SCALING_PANELS, scaling_drawing
from tiswarm.report.run_data import load_run
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study.forecast import fewer
from tiswarm.study.forecast import forecast as forecast_of

SIZES = (6, 9, 14)


def _tower(*overrides):
    small = ["robots=8", "seeds=1", "conditions={a: {localization.iterations: 20}}"]
    return load_scenario(REPOSITORY / "tests" / "tower.yaml", [*small, *overrides])


@pytest.fixture(scope="module")
def scaled(tmp_path_factory):
    """Folder of a run of three sizes, two seeds and four conditions."""
    rows = {"robots, structure.movers": [[size, size // 6] for size in SIZES]}
    small = load_scenario(
        REPOSITORY / "scenarios" / "scaling.yaml",
        [
            f"sweep={rows}",
            "seeds=2",
            "conditions.joint.localization.steps=20",
            "conditions.joint-final.localization.steps=20",
        ],
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
        joint = [c["localize"]["cpu_s"] for name, c in costs.items() if name.endswith(",joint")]
        assert len(costs) == 8
        assert mean["joint", "rmse_R", size] == pytest.approx(
            summary["rmse_R"].mean()["joint", size]
        )
        assert mean["joint", "grow_cpu_s", size] == pytest.approx(grown / 2)
        assert mean["joint", "localize_cpu_s", size] == pytest.approx(np.mean(joint))
        assert mean["paper", "grow_cpu_s", size] == mean["joint", "grow_cpu_s", size]
        assert mean["paper", "localize_cpu_s", size] != mean["together", "localize_cpu_s", size]


def test_columns_that_the_page_of_files_lists_are_in_tables(scaled):
    """Readers of a file look them up; those that need other settings are left out here."""
    page = pd.read_csv(REPOSITORY / "docs" / "columns.csv", keep_default_na=False)
    case = scaled / "cases" / "0-robots=14,paper"
    names = {
        "summary.csv": {*pd.read_csv(scaled / "summary.csv")},
        "table.csv": {*pd.read_csv(scaled / "table.csv")},
        "paired.csv": {*pd.read_csv(scaled / "paired.csv")},
        "growth.csv": {*pd.read_csv(case / "growth.csv")} | {"sent_B"},
        "estimate.csv": {*pd.read_csv(case / "estimate.csv")},
        "scaling.csv": {*pd.read_csv(scaled / "scaling.csv")["measure"]},
    }
    names["summary.csv"] |= {"left_edge_R", "right_edge_R"}
    names["table.csv"] |= {"round_every", "round_recent", "round_sweeps"}

    listed = [
        (file, column)
        for files, columns in page[["file", "column"]].itertuples(index=False)
        for file in files.split(", ")
        for column in columns.split(", ")
    ]

    of_engine = {"throughput.csv", "moves.csv", "trajectory.csv"}
    others = {"robots.csv", "loads.csv", "suites.csv", "swarms.npz", *of_engine}
    assert {file for file, _ in listed} == {*names, *others}
    assert [each for each in listed if each[0] in names and each[1] not in names[each[0]]] == []


def test_scaling_states_the_time_to_build_and_throughput(scaled):
    """Flips and rounds are those of growth.csv; rates are counts over the costs of stages."""
    table = pd.read_csv(scaled / "scaling.csv")
    mean = table[table["series"] == "paper"].set_index(["measure", "robots"])["mean"]
    folders = [scaled / "cases" / f"{seed}-robots=14,paper" for seed in (0, 1)]
    walks = [pd.read_csv(folder / "growth.csv") for folder in folders]
    longest = [sum(max(part["flips"]) for _, part in w.groupby("round")) for w in walks]
    costs = [json.loads((folder / "cost.json").read_text()) for folder in folders]
    scores = [json.loads((folder / "case.json").read_text())["scores"] for folder in folders]
    rates = [
        14 * score["steps_per_robot"] / cost["localize"]["cpu_s"]
        for score, cost in zip(scores, costs, strict=True)
    ]

    assert mean["flips", 14] == np.mean([walk["flips"].sum() for walk in walks])
    assert mean["growth_rounds", 14] == np.mean([walk["round"].nunique() for walk in walks])
    assert mean["makespan_flips", 14] == np.mean(longest) < mean["flips", 14]
    assert mean["robot_steps_per_cpu_s", 14] == pytest.approx(np.mean(rates))
    shares = [mean[f"{stage}_share", 14] for stage in ("grow", "sense", "localize")]
    assert 0.0 < sum(shares) < 1.0


def test_threads_take_the_place_of_robots(tmp_path):
    """A sweep of threads alone has costs against them, and the same estimates at each of them."""
    found = study.run(_tower("sweep={threads: [1, 2]}"), tmp_path, progress=Progress()).folder
    table = pd.read_csv(found / "scaling.csv")

    assert [*table.columns[:4]] == ["series", "measure", "threads", "mean"]
    assert set(table["threads"]) == {1, 2}
    assert {"localize_wall_s", "joins_per_wall_s", "total_cpu_s"} <= set(table["measure"])
    one, two = (found / "cases" / f"0-threads={n},a" / "estimate.csv" for n in (1, 2))
    assert one.read_bytes() == two.read_bytes()
    assert scaling_drawing(load_run(found)).draw().axes[0].get_xlabel() == "CPU threads"


@pytest.mark.trial
def test_workers_are_swept(tmp_path):
    """Each number of processes computes the structures of its point, to the same bytes."""
    swept = _tower("seeds=4", "sweep={workers: [1, 2]}")
    found = study.run(swept, tmp_path, progress=Progress()).folder
    table = pd.read_csv(found / "scaling.csv").set_index(["measure", "workers"])

    assert table["structures"]["total_wall_s", 2] == 4
    assert table["mean"]["structures_per_wall_s", 2] > 1.99 / table["mean"]["total_wall_s", 2]
    for seed in range(4):
        one, two = (found / "cases" / f"{seed}-workers={n},a" / "estimate.csv" for n in (1, 2))
        assert one.read_bytes() == two.read_bytes()


@pytest.mark.parametrize(
    ("swept", "lack"),
    [
        ("{threads: [1, 4096]}", "threads: 4096 are more than the "),
        ("{workers: [1, 4096]}", "workers: 4096 are more than the "),
        ("{arch: [cpu, cuda]}", "cuda"),
    ],
)
def test_what_the_machine_lacks_is_found_before_a_case_is_computed(tmp_path, swept, lack):
    """The folder of the run is not even made."""
    if lack == "cuda" and find_card("cuda"):
        pytest.skip("has a card")
    scenario = _tower(f"sweep={swept}", "conditions={a: {localization: {method: joint}}}")

    with pytest.raises(EnvironmentTroubleError, match=lack):
        study.run(scenario, tmp_path, progress=Progress())

    assert not [*tmp_path.iterdir()]


def test_exponents_are_slopes_on_logarithmic_axes(scaled):
    """Exponents are least-squares slopes over structures, slopes those of each step of means."""
    summary = pd.read_csv(scaled / "summary.csv")
    for (series, measure), part in pd.read_csv(scaled / "scaling.csv").groupby(
        ["series", "measure"]
    ):
        if not (part["mean"] > 0.0).all():
            assert part["slope"].isna().any()
            continue
        steps = np.diff(np.log(part["mean"])) / np.diff(np.log(part["robots"]))
        np.testing.assert_allclose(part["slope"], [np.nan, *steps], atol=1e-9)
        if measure in summary:
            rows = summary[summary["condition"] == series]
            slope, _ = np.polyfit(np.log(rows["robots"]), np.log(rows[measure]), 1)
            np.testing.assert_allclose(part["exponent"], slope, atol=1e-9)
            assert (part["exponent_ci95"] > 0.0).all()


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

    figure = scaling_drawing(load_run(scaled)).draw()

    assert names == ["paper", "together", "joint", "joint-final"]
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend[:4] == [
        "Algorithm 1 / final contacts",
        "Algorithm 1 (all at once) / final contacts",
        "joint / walk contacts",
        "joint / final contacts",
    ]
    for axes, measure in zip(figure.axes, SCALING_PANELS, strict=True):
        wanted = [means[measure, n].to_numpy() for n in names if (measure, n) in means.index]
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

    expected = "76 cases, 932800 robots in all; estimate: "
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


def test_there_are_no_more_processes_than_structures():
    """One process computes a structure, and leaves no work to others, however long it takes."""
    long = [
        "robots=1000",
        "structure.goal_height=65",
        "conditions={a: {localization: {method: joint}}}",
    ]
    eight, said = study.Execution(workers=8), Recorder()

    def workers(seeds):
        tower = [REPOSITORY / "tests" / "tower.yaml", [*long, f"seeds={seeds}"]]
        return fewer(load_scenario(*tower), eight, said).workers

    assert [workers(1), workers(3), workers(20)] == [None, 3, 8]
    assert said.lines[0].startswith("one process instead of 8: 1 structure, ")


def test_a_forecast_counts_what_robots_estimate_while_they_build():
    """Robots that go by their estimates make them at each join, for one robot or for all."""
    tower = REPOSITORY / "tests" / "tower.yaml"

    def growth(*overrides):
        return forecast_of(load_scenario(tower, ["conditions={a: {}}", *overrides])).grow_s

    by_truth, by_estimate = growth(), growth("structure.navigate_by=estimate")
    all_again = growth("structure.navigate_by=estimate", "localization.method=joint")

    assert by_truth < by_estimate < all_again / 10
