"""A run with a scorecard is held against every law, and says how many hold."""

from pathlib import Path

import pandas as pd
import pytest

from tiswarm.evaluation.laws import LAWS
from tiswarm.report.law_figures import LAW_FIGURES

SMALL = ("--set", "robots=8", "--set", "seeds=2", "--no-pictures")
TWO_CONDITIONS = ("--set", "conditions={a: {}, b: {localization.iterations: 2}}")


@pytest.fixture(scope="module")
def run(tiswarm, tmp_path_factory):
    """Folder of a small run, and what was printed."""
    out = tmp_path_factory.mktemp("laws")
    done = tiswarm(
        "run", "scenarios/reactivebuild-laws.yaml", *SMALL, *TWO_CONDITIONS, "--out", out
    )
    assert done.returncode == 0, done.stderr
    return next(out.iterdir()), done.stdout


def test_a_small_run_writes_every_row(run):
    """Those of 25 robots and more too, though 8 robots do not tell."""
    folder, _ = run
    laws = pd.read_csv(folder / "laws.csv", keep_default_na=False)

    large = laws["quantity"].str.contains("N = 100")
    plain = laws["law"].isin({"tower shape", "tower over J", "bridge success"})
    assert laws["law"].drop_duplicates().tolist() == list(LAWS)
    assert set(laws[large]["verdict"]) == {"not measured"}
    assert set(laws[plain]["verdict"]) == {"in band", "out of band", "reported"}


def test_a_structure_counts_once_whatever_the_conditions(run):
    """Two seeds under two conditions are two structures."""
    folder, _ = run
    laws = pd.read_csv(folder / "laws.csv").set_index(["law", "quantity"])

    assert laws.loc[("tower shape", "height [R]"), "structures"] == 2


def test_the_last_line_says_how_many_numbers_are_in_band(run):
    """What is not measured is not counted among what is judged."""
    folder, printed = run
    verdict = pd.read_csv(folder / "laws.csv")["verdict"].value_counts()

    judged = verdict["in band"] + verdict["out of band"]
    assert printed.splitlines()[-1] == (
        f"laws.csv: {verdict['in band']} of {judged} in band, {verdict['reported']} reported, "
        f"{verdict['not measured']} not measured"
    )


def test_report_writes_the_scorecard_anew_and_draws_it(tiswarm, run):
    """From the stored cases alone, to the same bytes."""
    folder, printed = run
    tables = [folder / "laws.csv", folder / "law-points.csv"]
    before = [table.read_bytes() for table in tables]
    for table in tables:
        table.unlink()

    done = tiswarm("report", folder)

    assert done.returncode == 0, done.stderr
    assert [table.read_bytes() for table in tables] == before
    assert done.stdout.splitlines()[-1] == printed.splitlines()[-1]
    assert {path.stem for path in Path(folder, "figures").iterdir()} == set(LAW_FIGURES)


def test_a_run_without_a_scorecard_has_none(small_run):
    """The tower scenario is held against nothing."""
    assert not (small_run / "laws.csv").exists()
