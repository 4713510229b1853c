"""The table of gains by threads says what was measured."""

import subprocess
import sys

import pandas as pd
import pytest


def test_gains_are_ratios_of_the_times_beside_them(tmp_path):
    """The same work on one and two threads, and twice the work on two."""
    command = [sys.executable, "-m", "benchmarks.threads", "--works", "swarm step"]
    options = ["--threads", "1", "2", "--rounds", "1", "--share", "0.002", "--out", tmp_path]

    subprocess.run([*command, *options], check=True, capture_output=True, timeout=120)

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
