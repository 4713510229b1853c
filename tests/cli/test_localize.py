"""`tiswarm localize` says whether to trust an estimate, of any method, and writes any solution."""

import csv
from dataclasses import replace

import numpy as np
import pytest

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
        monkeypatch.setattr(methods, "localize", lambda *_, **__: estimate)
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr("sys.argv", ["tiswarm", "localize", "log.jsonl", *options])
        with pytest.raises(SystemExit) as end:
            main()
        with (tmp_path / "estimate.csv").open() as file:
            rows = [*csv.DictReader(file)]
        return end.value.code, capsys.readouterr(), rows

    return run


def test_a_trusted_estimate_says_that_its_positions_are_a_mean(localize):
    """Beside it, the text names the solution that is consistent in itself."""
    status, printed, rows = localize(GOOD)

    assert status == 0
    assert "warning" not in printed.err
    assert printed.out.splitlines()[-2:] == [
        (
            "30 robots, converged; measurements do not determine where 19 of 30 robots are; 2 "
            "configurations fit, the likeliest has 70 %; mirrored: 2 robots (4, 6) -> estimate.csv"
        ),
        (
            "the positions are the mean of 2 solutions; --solution 1 writes the likeliest "
            "consistent configuration, --verbose lists all"
        ),
    ]
    assert [row["robot"] for row in rows if row["known"] == "mirrored"] == ["4", "6"]


def test_a_solution_is_written_with_its_own_sd(localize):
    """No robot of a single configuration is mirrored."""
    status, printed, rows = localize(GOOD, "--solution", "2")

    assert status == 0
    assert "solution 2 of 2, weight 30 %: 30 robots, converged" in printed.out
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
    assert f"30 robots, {verdict} -> estimate.csv" in printed.out
    assert len(rows) == 30
