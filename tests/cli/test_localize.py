"""`tiswarm localize` says whether to trust an estimate, of any method, and writes any solution."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from tests import foreign
from tiswarm.cli import main
from tiswarm.localization import methods
from tiswarm.measurements.observability import observability
from tiswarm.records.estimate import Convergence, Estimate, Solution
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.sensing import SensingParams, observe

GOOD = Convergence(converged=True, consistent=True, misfit_sd=0.3, chains=8, restarted=0)
AT_ODDS = replace(GOOD, consistent=False, misfit_sd=27.0, sd_factor=3.1, reason="heights disagree")
LOST = replace(GOOD, converged=False, reason="chains ended at different costs")


@pytest.fixture
def localize(towers, tmp_path, monkeypatch, capsys):
    """Run the command with an estimate made by hand: status, standard output and error, table."""
    log, true = observe(towers[0], SensingParams()), towers[0].position
    write_sensing_log(log, tmp_path / "log.jsonl")
    image = true * [1.0, -1.0, 1.0]
    found = Estimate(
        robot_id=log.robot_id, position=0.7 * true + 0.3 * image, disconnected=np.zeros(30, bool),
        sd=np.full(30, 2.0), mirrored=np.isin(np.arange(30), [4, 6]), convergence=GOOD,
        observability=observability(log, ["contacts", "height"], true),
        solutions=tuple(
            Solution(
                weight=weight, chi_square=cost, chains=4, residual=0.0, residual_sd=0.0,
                position=position, sd=np.full(30, 0.5),
            )
            for weight, cost, position in [(0.7, 1.0, true), (0.3, 2.7, image)]
        ),
        iteration=np.empty(0, np.int64), trace=np.empty((0, 30, 3)), residual=np.empty(0),
    )  # fmt: skip

    def run(convergence, *options):
        estimate = replace(found, convergence=convergence)
        anchor = np.arange(30) == 0
        estimate = replace(estimate, sd=np.where(anchor, 0.0, estimate.sd))
        monkeypatch.setattr(methods, "localize", lambda *_, **__: estimate)
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr("sys.argv", ["tiswarm", "localize", "log.jsonl", *options])
        with pytest.raises(SystemExit) as end:
            main()
        with (tmp_path / "estimate.csv").open() as file:
            rows = [*csv.DictReader(file)]
        return end.value.code, capsys.readouterr(), rows

    return run


def test_the_first_line_says_how_many_robots_are_near_and_the_next_ones_why_others_may_not_be(
    localize,
):
    """Below it, the text names the solution that is consistent in itself."""
    status, printed, rows = localize(GOOD)

    assert status == 0
    assert "warning" not in printed.err
    lines = printed.out.splitlines()
    assert lines[:3] == [
        (
            "1 of 30 robots is within 1 R of where it is shown (95 %); 29 may be anywhere within "
            "4.3 R; expected RMSE 2 R -> estimate.csv"
        ),
        "2 configurations fit, the likeliest has 70 %",
        (
            "mirrored: 2 robots (4, 6); configurations that fit put them farther apart than their "
            "sd, and their estimate is the mean of these; measure what would exclude all but one"
        ),
    ]
    assert lines[3].startswith("measurements do not determine where 19 of 30 robots are: ")
    assert lines[-1] == (
        "the positions are the mean of 2 solutions; --solution 1 writes the likeliest consistent "
        "configuration, --verbose lists all"
    )
    assert [row["robot"] for row in rows if row["known"] == "mirrored"] == ["4", "6"]
    assert [row["robot"] for row in rows if float(row["within_1R"]) >= 0.95] == ["0"]


def test_a_distance_of_the_user_is_that_of_the_statement_and_a_column(localize):
    """Who can live with 5 R learns that of 5 R."""
    _, printed, rows = localize(GOOD, "--within", "5")

    assert printed.out.startswith(
        "all 30 robots are within 5 R of where they are shown (95 %); expected RMSE 2 R -> "
    )
    assert all(0.95 <= float(row["within_5R"]) <= 1.0 for row in rows)
    assert [*rows[0]].index("within_5R") == [*rows[0]].index("within_1R") + 1


@pytest.mark.parametrize("length", ["0", "-1", "nan", "inf"])
def test_a_distance_that_is_none_is_refused_before_the_log_is_read(tiswarm, tmp_path, length):
    """Nothing is written."""
    out = tmp_path / "estimate.csv"

    done = tiswarm("localize", tmp_path / "none.jsonl", "--within", length, "--out", out)

    assert done.returncode == 2
    assert done.stderr == f"tiswarm: error: --within: {length} should be above 0; give a length\n"
    assert not out.exists()


@pytest.mark.parametrize("method", ["joint", "least-squares", "hop-by-hop", "online"])
@pytest.mark.parametrize(
    ("beacons", "tags", "is_testable"), [(3, 1, False), (4, 1, True), (7, 3, True)]
)
def test_a_log_that_could_show_no_mistake_is_not_called_consistent(
    tiswarm, tmp_path, method, beacons, tags, is_testable
):
    """Of the ranges of a tag to beacons all but three are spare; nothing is wrong: status 0.

    One spare range is enough to contradict the others.
    """
    corners = np.array([*np.ndindex(2, 2, 2)])[[0, 4, 2, 1, 7, 6, 5][:beacons]]
    inside = np.array([[1.0, 1.3, 0.8], [2.0, 0.6, 1.9], [0.4, 2.2, 1.4]])[:tags]
    place = np.concatenate([3.0 * corners, inside])
    log = foreign.with_places(foreign.silent(place), place, range(1, beacons))
    rows = [
        (beacons + k, j, np.linalg.norm(inside[k] - place[j]), 0.05, -1.0)
        for k in range(tags)
        for j in range(beacons)
    ]
    path = tmp_path / "log.jsonl"
    write_sensing_log(replace(log, ranges=np.array(rows)), path)

    done = tiswarm("localize", path, "--method", method, "--out", tmp_path / "estimate.csv")

    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr
    assert f" {beacons + tags} robots are within " in done.stdout
    text = "consistency not testable (0 spare measurements: too few to disagree)"
    assert (text in done.stdout) == (not is_testable)
    assert ("not testable" in done.stdout) == (not is_testable)
    assert "not consistent" not in done.stdout


def test_a_solution_is_written_with_its_own_sd(localize):
    """No robot of a single configuration is mirrored."""
    status, printed, rows = localize(GOOD, "--solution", "2")

    assert status == 0
    begin = "solution 2 of 2, weight 30 %: if it is right, none of 30 robots is known to be "
    assert printed.out.startswith(begin)
    assert {row["sd_R"] for row in rows} == {"0.5"}
    assert "mirrored" not in {row["known"] for row in rows}


@pytest.mark.parametrize(
    ("convergence", "verdict"), [(AT_ODDS, "not consistent"), (LOST, "not converged")]
)
@pytest.mark.parametrize(
    "method", ["joint", "virtual-force", "least-squares", "hop-by-hop", "online", "distributed"]
)
def test_an_estimate_that_is_not_trusted_ends_with_status_4(localize, method, convergence, verdict):
    """Scripts see it of any method; the estimate is written all the same."""
    status, printed, rows = localize(convergence, "--method", method)

    assert status == 4
    assert f"tiswarm: warning: {verdict}: {convergence.reason}" in printed.err
    statement, reason, *_ = printed.out.splitlines()
    assert statement.endswith(" R -> estimate.csv")
    assert reason == verdict
    assert len(rows) == 30
