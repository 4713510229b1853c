"""Whole runs: their files, their repetition, and their continuation after a break."""

import json
import re
import shutil

import numpy as np
import pandas as pd
import pytest
import yaml
from PIL import Image

from tests.runs import REPOSITORY, assert_same_bytes
from tiswarm import study
from tiswarm.app import drawing
from tiswarm.base.progress import Progress
from tiswarm.base.robot import SHAPES
from tiswarm.records.sensing_file import read_sensing_log
from tiswarm.scenario.expansion import load_scenario
from tiswarm.study.run import RunResult

SMALL = ("--set", "robots=12", "--set", "seeds=2", "--no-pictures")
ANY_VERDICT = {0, 4}
"""Exit statuses of `localize` for an estimate that can be trusted, and for one that cannot."""
SCENARIOS = sorted((REPOSITORY / "scenarios").glob("*.yaml"))
QUICK = {"bridge", "tower", "yaw"}
"""Scenarios that run in `make test`: they have several methods, kinds of structures and a sweep."""


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda path: path.stem)
def test_every_shipped_scenario_is_checked_and_planned(tiswarm, tmp_path, scenario):
    """A scenario that ships has no mistake, and says what it costs before it computes anything."""
    checked = tiswarm("check", scenario)
    planned = tiswarm("run", scenario, "--plan", "--out", tmp_path / "out")

    assert checked.returncode == 0, checked.stderr
    assert planned.returncode == 0, planned.stderr
    assert re.match(r"[\d,]+ cases?, [\d,]+ robots in all; estimate: ", planned.stdout)
    assert planned.stdout.partition("\n")[0] in checked.stdout
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda path: path.stem)
def test_shipped_conditions_have_words(scenario):
    """Figures and tables showed `walk-own-dock`, which is the name of a folder."""
    conditions = yaml.safe_load(scenario.read_text(encoding="utf-8")).get("conditions", {})

    named = [name for name, keys in conditions.items() if "-" in str(name) and "label" not in keys]

    assert not named


@pytest.mark.parametrize(
    "scenario",
    [
        pytest.param(path, marks=() if path.stem in QUICK else pytest.mark.trial, id=path.stem)
        for path in SCENARIOS
    ],
)
def test_every_shipped_scenario_runs(tmp_path, scenario):
    """Each scenario finishes every case at small size."""
    briefly = ["localization.steps=200", "localization.chains=3"]
    sizes = {
        "scaling": ["sweep={robots: [6, 7, 8]}"],
        "large-swarm": [
            "robots=300",
            "structure.movers=3",
            "structure.solve_every=6",
            "conditions.joint.localization.steps=200",
        ],
        "robot-shape": [
            "robots=6",
            "robot.rho=1.8",
            f"sweep={{robot.shape: {[*SHAPES]}}}",
            "conditions.joint.localization.steps=200",
        ],
        "ablation": ["robots=8", *briefly],
        "between": [
            "robots=8",
            "localization.chains=2",
            "localization.steps=40",
            "conditions.joint.localization.steps=200",
        ],
        "fireant2d": ["robots=8", *briefly],
        "rungs": ["robots=8", *briefly],
        "sensor-sweep": ["robots=8", *briefly],
        "failures": ["robots=8", *briefly],
        "table-1": ["robots=8", *briefly],
        "large-structures": [
            "sweep={structure: [{kind: tower}, {kind: cantilever}, {kind: bridge}]}",
            "robots=8",
        ],
        "large-located": [
            "sweep={structure: [{kind: tower}, {kind: cantilever}]}",
            "robots=8",
        ],
        "patience": [
            "sweep={structure: [{kind: bridge}, {kind: tower}], structure.climb.patience: [3, 16]}",
            "robots=8",
        ],
        "yaw": ["robots=8", "sweep={sensing.yaw_bias_deg: [0, 5]}"],
    }.get(scenario.stem, ["robots=8"])
    small = load_scenario(scenario, [*sizes, "seeds=1"])

    result = study.run(small, tmp_path, progress=Progress())

    assert (pd.read_csv(result.folder / "summary.csv")["status"] == "done").all()


@pytest.mark.parametrize("kind", ["tower", "cantilever", "bridge", "chain"])
def test_logs_of_every_kind_are_read_back(tiswarm, tmp_path, kind):
    """The stored log of any kind gives the bytes of the stored estimate."""
    ran = tiswarm(
        "run", f"scenarios/{kind}.yaml", "--set", "robots=15", "--set", "seeds=[2]",
        "--set", "conditions={a: {}}", "--no-pictures", "--out", tmp_path,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    case = next(tmp_path.glob("*/cases/2-a"))

    done = tiswarm(
        "localize", case / "sensing.jsonl", "--method", "virtual-force",
        "--out", tmp_path / "estimate.csv",
    )  # fmt: skip

    assert done.returncode in ANY_VERDICT, done.stderr
    assert (tmp_path / "estimate.csv").read_bytes() == (case / "estimate.csv").read_bytes()


def test_robots_of_any_docks_are_grown_and_localized(tiswarm, tmp_path):
    """Shapes, and docks of no shape: the log has them, contacts touch, the figure compares them."""
    docks = [[1.5, 0, 0], [-1.5, 0, 0], [0, 0, 2.5], [0, 3, 0.5]]
    robots = [{"shape": "cube", "rho": 1.8}, {"docks": docks}]
    ran = tiswarm(
        "run", "tests/tower.yaml", "--set", "robots=6", "--set", "seeds=1", "--no-pictures",
        "--set", "conditions={a: {}}", "--set", f"sweep={json.dumps({'robot': robots})}",
        "--out", tmp_path,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    [run] = tmp_path.iterdir()
    logs = sorted(
        read_sensing_log(path).dock_offset_body.tolist() for path in run.glob("*/*/sensing.jsonl")
    )
    drawn = tiswarm("redraw", run)

    assert drawn.returncode == 0, drawn.stderr
    assert (pd.read_csv(run / "summary.csv")["status"] == "done").all()
    assert docks in logs
    assert [len(offsets) for offsets in logs if offsets != docks] == [8]
    assert (run / "figures" / "shape.png").stat().st_size > 0


def test_a_run_leaves_everything_behind(small_run):
    """Tables, cases, manifest and pictures exist, with the expected content."""
    summary = pd.read_csv(small_run / "summary.csv")
    table = pd.read_csv(small_run / "table.csv")
    manifest = json.loads((small_run / "manifest.json").read_text())

    assert len(summary) == 6
    assert summary["rmse_R"].between(0, 50).all()
    assert table["condition"].tolist() == ["baseline", "no-z", "no-z-no-undock"]
    assert table["paper_rmse_radii"].isna().all()  # it has no structures of 12 robots
    np.testing.assert_allclose(
        table["rmse_R_mean"], summary.groupby("condition", sort=False)["rmse_R"].mean()
    )
    assert set(manifest["stages"]) == {"grow", "sense", "localize", "score and store"}
    assert {"tiswarm", "backend", "machine", "libraries", "peak_memory_MB"} <= set(manifest)
    assert {"structure.png", "truth-and-estimate.png"} <= set(manifest["renders"])


def test_what_a_case_says_is_what_its_files_say(small_run):
    """Errors by robot, the last iteration and the summary agree."""
    summary = pd.read_csv(small_run / "summary.csv").set_index("case")
    for folder in (small_run / "cases").iterdir():
        robots = pd.read_csv(folder / "robots.csv")
        convergence = pd.read_csv(folder / "convergence.csv")
        truth = pd.read_csv(folder / "truth.csv")
        estimate = pd.read_csv(folder / "estimate.csv")
        places = ["x_R", "y_R", "z_R"]
        error = np.linalg.norm(estimate[places] - truth[places], axis=1)

        np.testing.assert_allclose(robots["error_R"], error, atol=1e-12)
        rmse = summary.loc[folder.name, "rmse_R"]
        assert rmse == pytest.approx(np.sqrt(np.mean(error**2)))
        assert rmse == pytest.approx(convergence["rmse_R"].iloc[-1])


def test_every_picture_shows_something(small_run):
    """Figures and renders are pictures with more than one color."""
    pictures = [*small_run.glob("figures/*.png"), *small_run.glob("renders/*.png")]

    assert len(pictures) >= 5
    for path in pictures:
        with Image.open(path) as picture:
            assert min(picture.size) >= 300
            colors = picture.convert("RGB").getcolors(maxcolors=50)
        assert colors is None  # more than that


@pytest.mark.parametrize("command", ["tiswarm", pytest.param("process", marks=pytest.mark.trial)])
def test_a_repetition_does_not_change_a_byte(small_run, request, tmp_path, command):
    """A second run gives the same bytes; another process does, too, with one thread."""
    call = request.getfixturevalue(command)
    threads = ("--threads", 1) if command == "process" else ()

    done = call("run", "tests/tower.yaml", *SMALL, *threads, "--out", tmp_path)

    assert done.returncode == 0, done.stderr
    [again] = tmp_path.iterdir()
    assert_same_bytes(small_run, again)


def test_localize_gives_the_bytes_of_the_run(tiswarm, small_run, tmp_path):
    """A stored log localized on its own gives the stored estimate, for every condition."""
    options = {
        "baseline": (),
        "no-z": ("--set", "z_correction=false"),
        "no-z-no-undock": ("--set", "z_correction=false", "--set", "undocked_repulsion=false"),
    }
    for condition, settings in options.items():
        case = small_run / "cases" / f"1-{condition}"
        out = tmp_path / f"{condition}.csv"

        done = tiswarm(
            "localize", case / "sensing.jsonl", "--method", "virtual-force", *settings, "--out", out
        )

        assert done.returncode in ANY_VERDICT, done.stderr
        assert out.read_bytes() == (case / "estimate.csv").read_bytes()


@pytest.mark.parametrize(
    ("method", "setting"), [("least-squares", "rounds=2"), ("hop-by-hop", "order=join")]
)
def test_any_method_is_run_and_called_alike(tiswarm, tmp_path, method, setting):
    """The same settings in a scenario and on the command line give the same bytes.

    The truth has no part in it: the command finds noise in its place.
    """
    key, _, value = setting.partition("=")
    scenario = tmp_path / "small.yaml"
    scenario.write_text(
        "name: small\nrobots: 10\nstructure: {kind: tower}\n"
        f"localization: {{method: {method}, {key}: {value}, cues: {{\n"
        "  non_overlap: false, ground: false, walk_contacts: false, odometry: false}}\n"
    )
    ran = tiswarm("run", scenario, "--no-pictures", "--out", tmp_path)
    assert ran.returncode == 0, ran.stderr
    case = next(tmp_path.glob("*/cases/0-baseline"))
    _replace_truth(case)

    done = tiswarm(
        "localize", case / "sensing.jsonl", "--method", method,
        "--cues", "contacts,height", "--set", setting, "--out", tmp_path / "estimate.csv",
    )  # fmt: skip

    assert done.returncode in ANY_VERDICT, done.stderr
    assert "contacts, height: " in done.stdout
    assert (tmp_path / "estimate.csv").read_bytes() == (case / "estimate.csv").read_bytes()


def test_the_localizer_is_blind_to_the_truth(tiswarm, small_run, tmp_path):
    """With noise in place of the truth, the estimate keeps every byte."""
    run = tmp_path / "run"
    shutil.copytree(small_run, run)
    _replace_truth(run)
    case = run / "cases" / "0-baseline"

    done = tiswarm(
        "localize", case / "sensing.jsonl", "--method", "virtual-force",
        "--out", tmp_path / "blind.csv",
    )  # fmt: skip

    assert done.returncode in ANY_VERDICT, done.stderr
    assert (tmp_path / "blind.csv").read_bytes() == (case / "estimate.csv").read_bytes()


def _replace_truth(folder):
    """Write noise in place of each truth."""
    rng = np.random.default_rng(0)
    for path in folder.rglob("truth.csv"):
        truth = pd.read_csv(path)
        truth[["x_R", "y_R", "z_R"]] = rng.normal(size=(len(truth), 3))
        truth.to_csv(path, index=False)


def test_a_run_is_drawn_again_from_its_folder_alone(tiswarm, small_run, tmp_path, monkeypatch):
    """Tables, figures and renders come back from the stored cases, byte for byte.

    A run finds nothing to draw afterwards.
    """
    run = tmp_path / "moved"
    shutil.copytree(small_run, run)
    for name in ("summary.csv", "table.csv"):
        (run / name).unlink()
    for name in ("figures", "renders"):
        shutil.rmtree(run / name)

    done = tiswarm("redraw", run)

    assert done.returncode == 0, done.stderr
    for path in [*small_run.glob("*.csv"), *small_run.glob("figures/*.png")]:
        assert (run / path.relative_to(small_run)).read_bytes() == path.read_bytes()
    assert {path.name for path in (run / "renders").iterdir()} == {
        path.name for path in (small_run / "renders").iterdir()
    }
    monkeypatch.delattr(drawing, "draw")
    whole = RunResult(folder=run, computed=0, found=6, failed=(), missing=0)
    drawing.draw_all(whole, Progress())


def test_failed_cases_are_reported(tiswarm, tmp_path):
    """Cases whose robots never arrive fail with the reason, and the exit status is 3."""
    done = tiswarm(
        "run", "tests/tower.yaml", *SMALL, "--out", tmp_path,
        "--set", "structure.spawn_min=300", "--set", "structure.spawn_max=310",
        "--set", "structure.climb.max_flips=2", "--set", "structure.climb.max_spawns=2",
    )  # fmt: skip

    assert done.returncode == 3
    assert "max_spawns" in done.stderr
    run = next(tmp_path.iterdir())
    summary = (run / "summary.csv").read_text()
    assert (pd.read_csv(run / "summary.csv")["status"] == "failed").all()
    assert tiswarm("redraw", run).returncode == 0
    assert (run / "summary.csv").read_text() == summary


def test_methods_stand_side_by_side(tiswarm, tmp_path):
    """Conditions of different methods share structures, and their logs localize alone."""
    joint = "{localization.method: joint, localization.chains: 2, localization.steps: 800}"

    done = tiswarm(
        "run", "tests/tower.yaml", *SMALL, "--out", tmp_path,
        "--set", "sensing.tilt_noise_deg=1.0",
        "--set", f"conditions={{paper: {{}}, joint: {joint}}}",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    folder = next(tmp_path.iterdir())
    rmse = pd.read_csv(folder / "table.csv").set_index("condition")["rmse_R_mean"]
    alone = tiswarm(
        "localize", folder / "cases" / "0-joint" / "sensing.jsonl", "--method", "joint",
        "--set", "chains=2", "--set", "steps=800", "--out", tmp_path / "estimate.csv",
    )  # fmt: skip

    assert rmse["joint"] < rmse["paper"]
    assert alone.returncode == 0, alone.stderr
    stored = (folder / "cases" / "0-joint" / "estimate.csv").read_bytes()
    assert (tmp_path / "estimate.csv").read_bytes() == stored
    assert b"sd_R" in stored
