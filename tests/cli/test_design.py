"""`tiswarm design` prints what it found, writes it where it is told, and refuses in a line."""

import json

import pandas as pd
import pytest
import yaml

TASK = """
name: task
robots: 8
structure: {kind: tower}
localization: {method: hop-by-hop}
conditions:
  plain: {}
  noisy: {sensing.tilt_noise_deg: 1.0}
"""
VARY = ("--vary", "sensing.yaw_noise_deg=1,20", "--vary", "sensing.range_reach=null,12")


@pytest.fixture
def task(tmp_path):
    """A scenario with two conditions, and prices of what varies."""
    (tmp_path / "task.yaml").write_text(TASK)
    (tmp_path / "prices.yaml").write_text(
        "sensing.yaw_noise_deg: {1: 5, 20: 1}\nsensing.range_reach: {null: 0, 12: 9}\n"
    )
    return tmp_path / "task.yaml"


def test_a_design_has_a_table_a_scenario_and_the_runs(tiswarm, task, tmp_path):
    """The condition is that of the design; the scenario that won is valid and is run again."""
    out = tmp_path / "out"
    goal = ("--condition", "noisy", "--goal", "rmse_R<20", "--seeds", 1, "--fresh", 1)

    done = tiswarm(
        "design", task, *goal, *VARY, "--price", tmp_path / "prices.yaml", "--out", out, "--quiet"
    )

    assert done.returncode == 0, done.stderr
    assert "of 4 candidates reach rmse_R<20" in done.stdout
    assert "predicted on 1 structure (seeds 2000000 to 2000000)" in done.stdout
    scenario = yaml.safe_load((out / "design.yaml").read_text())
    assert scenario["sensing"]["tilt_noise_deg"] == 1.0
    assert scenario["sensing"]["yaw_noise_deg"] == 20.0
    assert [*scenario["conditions"]] == ["baseline"]
    table = pd.read_csv(out / "design.csv")
    assert table["price"].tolist() == [1, 5, 10, 14]
    assert table["found_rmse_R"].notna().sum() == table["front"].sum() > 0
    assert (out / "design.png").stat().st_size > 5000
    page = (out / "design.html").read_text()
    data = json.loads(page.partition('id="data">')[2].partition("</script>")[0])
    column = {column["name"]: column["cells"] for column in data["columns"]}
    assert column["price"] == table["price"].tolist()
    assert column["verdict"].count("on the front") == table["front"].sum()
    assert data["first"]["x"] == "price"
    assert data["first"]["y"] == "predicted_rmse_R"
    assert tiswarm("check", out / "design.yaml").returncode == 0
    refused = tiswarm("design", task, *goal, *VARY, "--out", out)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert f"{out / 'design.yaml'}: exists already, as do design.csv, design" in refused.stderr


@pytest.mark.parametrize("options", [(), ("--out", "design")])
def test_runs_are_named_where_a_reader_can_watch_them(tiswarm, task, tmp_path, options):
    """Without a folder, runs are in a temporary one, which is gone when the command ends."""
    goal = ("--goal", "rmse_R<20", "--condition", "plain", "--seeds", 1, "--fresh", 1)

    done = tiswarm("design", task, *goal, *VARY[:2], *options, cwd=tmp_path)

    assert done.returncode == 0, done.stderr
    assert ("to watch: tiswarm view --live design/" in done.stderr) is bool(options)
    assert ("to watch" in done.stderr) is bool(options)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--goal", "rmse_R<1", *VARY), "--condition: the scenario has several; choose one of"),
        (("--goal", "rmse<1", "--condition", "plain", *VARY), "--goal: there is no 'rmse'"),
        (("--goal", "rmse_R<1e-9", "--condition", "plain", *VARY), "--goal: no candidate of 4"),
        (("--goal", "rmse_R<1", "--condition", "plain", "--vary", "robots"), "--vary: 'robots'"),
        (("--goal", "rmse_R<1", *VARY, *VARY), "--vary: sensing.yaw_noise_deg: has values twice"),
        (("--goal", "rmse_R<1", "--vary", "robots=[5"), "--vary: robots: "),
        (("--goal", "rmse_R<1", *VARY, "--price", "none.csv"), "none.csv: there is no such file"),
    ],
)
def test_a_mistake_is_a_line_with_its_option(tiswarm, task, tmp_path, arguments, message):
    """Exit status 2, one line that starts with the option, and nothing written."""
    done = tiswarm("design", task, *arguments, "--out", tmp_path / "out", "--seeds", 1, "--quiet")

    assert done.returncode == 2
    assert done.stderr.startswith(f"tiswarm: error: {message}"), done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()
