"""The table of speed-ups is consistent."""

import pandas as pd
import pytest

from tests.benchmarks.commands import call


@pytest.mark.trial
def test_speed_ups_are_ratios_of_times(tmp_path):
    """One and two threads do the same work, and two threads do twice the work."""
    options = ["--works", "swarm step", "--threads", 1, 2, "--rounds", 1, "--share", 0.002]

    done = call("threads", *options, "--out", tmp_path)

    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "threads.csv").set_index(["scaling", "threads"])
    assert table["amount"].to_dict() == {
        ("strong", 1): 400,
        ("strong", 2): 400,
        ("weak", 1): 200,
        ("weak", 2): 400,
    }
    for scaling, threads in table.index:
        sooner = table["wall_s"][scaling, 1] / table["wall_s"][scaling, threads]
        speed_up = sooner if scaling == "strong" else threads * sooner
        assert table["speed_up"][scaling, threads] == pytest.approx(speed_up, rel=0.01)
        assert table["efficiency"][scaling, threads] == pytest.approx(speed_up / threads, rel=0.01)
    assert (tmp_path / "threads.png").stat().st_size > 0
