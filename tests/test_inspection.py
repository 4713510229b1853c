"""The check of a log names what is unlikely or unknown, and advice what to measure next."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tiswarm.inspection import advice_rows, describe_advice, inspect
from tiswarm.measurements import advice
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.sensing import SensingParams, observe


@pytest.fixture
def log(towers):
    """What thirty robots sensed."""
    return observe(towers[0], SensingParams())


def test_check_warns_of_unlikely_positions(log, tmp_path):
    """They are possible, unlike those that the reader refuses."""
    path = tmp_path / "sensing.jsonl"
    write_sensing_log(log, path)
    assert "unlikely" not in inspect(path).summary

    far = np.where(np.arange(30)[:, None] == 7, 1e6, np.zeros((30, 3)))
    write_sensing_log(replace(log, spawn_position=far), path)

    assert f"{path}:9: spawn_position: 1e+06 R from the anchor is unlikely" in inspect(path).summary


def test_check_names_a_turn_about_the_only_dock_of_the_anchor(log, tmp_path):
    """Two contacts at one dock of the anchor leave a circle open to the other robot."""
    path = tmp_path / "sensing.jsonl"
    two = replace(
        log,
        contacts=np.array([[0, 2, 1, 0], [0, 2, 1, 1]], np.int32),
        **{name: getattr(log, name)[:2] for name in ("robot_id", "orientation_wxyz")},
        flip_height=np.full(2, np.nan),
        spawn_position=np.full((2, 3), np.nan),
        ground_docks=log.ground_docks[:0],
        stances=None,
    )
    write_sensing_log(two, path)

    assert inspect(path).summary.endswith(
        "1 floppy mode of 3 unknowns, 1 floppy robot; in 1 of them, all robots tied to the anchor "
        "move as one about its dock 2, the only one in contact"
    )


def test_advice_names_robots_and_docks(towers, monkeypatch):
    """Robots go by their names; a table of large swarms has no expected errors."""
    log, center = observe(towers[1], SensingParams()), towers[1].position
    log = replace(log, robot_id=log.robot_id + 100)

    estimate = SimpleNamespace(position=center, mirrored=None)
    rows = advice_rows(log, ["contacts", "ground"], estimate)
    lines = [*describe_advice(rows)]
    monkeypatch.setattr(advice, "MOST_ROBOTS", 0)
    large = advice_rows(log, ["contacts", "ground"], estimate)

    assert lines[0].split("  ")[0] == "rank"
    assert len(lines) == len(rows) + 1
    assert [row["rank"] for row in rows] == [str(rank) for rank in range(1, len(rows) + 1)]
    for row, line in zip(rows, lines[1:], strict=True):
        names = re.findall(r"robot (\d+)", row["further measurement"])
        assert all(100 <= int(name) < 130 for name in names)
        assert row["further measurement"] in line
        assert float(row["with it [R]"]) <= float(row["expected RMSE [R]"])
    assert set(rows[0]) - set(large[0]) == {"expected RMSE [R]", "with it [R]"}
    assert next(describe_advice([])).startswith("no further contact, height or position")
