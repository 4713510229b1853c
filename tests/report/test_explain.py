"""`tiswarm view --explain` shows how the measurements of one robot narrow its place."""

import re

import numpy as np
import pytest

import tiswarm as library
from tests.measurements.test_orientations import connected
from tiswarm.base.errors import InputError
from tiswarm.records.positions import write_positions
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.report.explanation import explain
from tiswarm.sensing import SensingParams, observe


def _write(folder, history):
    """Write the log and the true positions of a structure; return the log's file."""
    log = observe(history, SensingParams())
    write_sensing_log(log, folder / "sensing.jsonl")
    write_positions(folder / "truth.csv", log.robot_id, history.position)
    return folder / "sensing.jsonl"


def test_a_page_shows_the_robots_that_one_names(tiswarm, tmp_path, towers):
    """A figure for each, in place of that of the least certain robot; a call draws it alone."""
    log = library.read_log(_write(tmp_path, towers[0]))
    found = log.with_estimate(tmp_path / "truth.csv").explain(7)

    shown = ("view", "sensing.jsonl", "truth.csv", "--explain", 7, "--explain", 9)
    done = tiswarm(*shown, cwd=tmp_path)

    assert done.returncode == 0, done.stderr
    page = (tmp_path / "view.html").read_text()
    shown = re.findall(r"How the measurements of robot (\d+) narrow", page)
    assert [*dict.fromkeys(shown)] == ["7", "9"]
    assert [*found.spread][1] == "orientation"
    assert str(found).splitlines()[0] == "robot 7: spread of the places that remain"
    assert found.draw(tmp_path / "places.png").stat().st_size > 1000


def test_an_unknown_robot_is_refused(tmp_path, towers):
    """The message says how many there are."""
    log = library.read_log(_write(tmp_path, towers[0]))

    refused = "explain: there is no robot 99; choose one of the 30 of the log"
    with pytest.raises(InputError, match=refused):
        library.view(log, tmp_path / "truth.csv", explain=[99], out=tmp_path / "view.html")


def test_a_robot_without_a_compass_is_explained_too(tmp_path, towers):
    """Its orientation follows from a connection."""
    history = towers[0]
    log = connected(history, sd_deg=0.0)
    assert np.isnan(log.orientation_wxyz[7]).all()
    whole = observe(history, SensingParams())
    estimate = library.read_log(_write(tmp_path, history)).with_estimate(tmp_path / "truth.csv")

    found = explain(log, estimate, 7)

    assert found.spread == pytest.approx(explain(whole, estimate, 7).spread, rel=1e-2)
