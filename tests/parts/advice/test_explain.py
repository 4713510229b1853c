"""`tiswarm explain` says how the measurements of one robot narrow its place."""

import numpy as np
import pytest

import tiswarm as library
from tests.measurements.test_orientations import connected
from tiswarm.base.errors import InputError
from tiswarm.parts.advice.explanation import explain
from tiswarm.records.positions import write_positions
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.sensing import SensingParams, observe


def _write(folder, history):
    """Write the log and the true positions of a structure; return the log's file."""
    log = observe(history, SensingParams())
    write_sensing_log(log, folder / "sensing.jsonl")
    write_positions(folder / "truth.csv", log.robot_id, history.position)
    return folder / "sensing.jsonl"


def test_the_command_prints_what_the_call_returns(tiswarm, tmp_path, towers):
    """A line for each measurement, and a picture."""
    log = library.read_log(_write(tmp_path, towers[0]))
    found = library.explain(log, 7, tmp_path / "truth.csv")

    done = tiswarm("explain", "sensing.jsonl", 7, "truth.csv", "--out", "places.png", cwd=tmp_path)

    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{found}\n-> places.png\n"
    assert (tmp_path / "places.png").stat().st_size > 1000
    assert [*found.spread][1] == "orientation"


def test_an_unknown_robot_is_refused(tmp_path, towers):
    """The message says how many there are."""
    log = library.read_log(_write(tmp_path, towers[0]))

    with pytest.raises(InputError, match="there is no robot 99; choose one of the 30 of the log"):
        library.explain(log, 99, tmp_path / "truth.csv")


def test_a_robot_without_a_compass_is_explained_too(tmp_path, towers):
    """Its orientation follows from a connection."""
    history = towers[0]
    log = connected(history, sd_deg=0.0)
    assert np.isnan(log.orientation_wxyz[7]).all()
    whole = observe(history, SensingParams())
    estimate = library.read_log(_write(tmp_path, history)).with_estimate(tmp_path / "truth.csv")

    found = explain(log, estimate, 7)

    assert found.spread == pytest.approx(explain(whole, estimate, 7).spread, rel=1e-2)
