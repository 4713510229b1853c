"""The check of a log names what is unlikely or unknown, and advice what to measure next."""

import re
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from tiswarm.app.inspection import inspect
from tiswarm.base.errors import InputError
from tiswarm.measurements.advice import further as advice
from tiswarm.measurements.advice.further import AdviceTable, tabulate
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.sensing import SensingParams, observe


@pytest.fixture
def log(towers):
    """What thirty robots sensed."""
    return observe(towers[0], SensingParams())


def test_check_warns_of_unlikely_positions(log, tmp_path):
    """They are possible, unlike those that the reader refuses."""
    path = tmp_path / "SENSING.JSONL"  # names of logs may be written in any case
    write_sensing_log(log, path)
    assert "unlikely" not in inspect(path).summary

    alone = replace(log, contacts=log.contacts[:0], stances=None)
    far = np.where(np.arange(30)[:, None] == 7, 1e6, np.zeros((30, 3)))
    ranges, fixes = np.array([[9, 3, 1e5, 1, -1]]), np.array([[8, 1, 0, 0, 1e6, 1, -1]])
    found = []
    for changes in ({"spawn_position": far}, {"ranges": ranges}, {"fixes": fixes}):
        write_sensing_log(replace(alone, **changes), path)
        found.append(next(line for line in inspect(path).summary.splitlines() if str(path) in line))

    assert found == [
        f"{path}:{place} is unlikely; correct it or leave it out"
        for place in (
            "9: spawn_position: 1e+06 R from the anchor",
            "11: ranges: 1e+05 R to robot 3",
            "10: fixes: 1e+06 R from the anchor",
        )
    ]


def test_check_warns_of_lengths_in_another_unit(log, tmp_path):
    """A line names the length, how many times it is off and what to do; a column has one line."""
    path = tmp_path / "sensing.jsonl"
    high = np.where(np.arange(30) == 29, 1000.0 * log.flip_height, log.flip_height)
    for heights in (high, 25.4 * log.flip_height):
        write_sensing_log(replace(log, flip_height=heights), path)
        lines = [line for line in inspect(path).summary.splitlines() if "times too" in line]

        (line,) = lines
        assert line.startswith(f"{path}:{31 if heights is high else 2}: flip_height: ")
        assert line.endswith("; correct the unit, or leave it out")
    assert "about 25.4 times too long beside ground_docks" in line


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
        "1 floppy mode (free motion) of 3 unknowns, which move 1 robot; in 1 of them, all robots "
        "tied to the anchor move as one about its dock 2, the only one in contact"
    )


def test_check_names_a_turn_about_the_center_of_an_anchor_without_contacts(log, tmp_path):
    """A range ties the other robot, so no dock is what it turns about."""
    path = tmp_path / "sensing.jsonl"
    two = replace(
        log,
        contacts=log.contacts[:0],
        **{name: getattr(log, name)[:2] for name in ("robot_id", "orientation_wxyz")},
        flip_height=np.full(2, np.nan),
        spawn_position=np.full((2, 3), np.nan),
        ground_docks=log.ground_docks[:0],
        ranges=np.array([[1, 0, 4.0, 0.1, -1]]),
        stances=None,
    )
    write_sensing_log(two, path)

    assert inspect(path).summary.endswith(
        "in 2 of them, all robots tied to the anchor move as one about its center: none of its "
        "docks is in contact"
    )


def placed(center) -> SimpleNamespace:
    """Return an estimate of positions alone."""
    return SimpleNamespace(
        position=center, configuration=center, mirrored=None, solutions=(), turns=(), sd=None
    )


def test_advice_names_robots_and_docks(towers, monkeypatch):
    """Robots go by their names; a table of large swarms has no expected errors."""
    log, center = observe(towers[1], SensingParams()), towers[1].position
    log = replace(log, robot_id=log.robot_id + 100)

    estimate = placed(center)
    rows = tabulate(log, ["contacts", "ground"], estimate)
    lines = str(rows).splitlines()
    monkeypatch.setattr(advice, "MOST_ROBOTS", 0)
    large = tabulate(log, ["contacts", "ground"], estimate)

    assert lines[0].split("  ")[0] == "rank"
    assert len(lines) == len(rows) + 1
    assert [row["rank"] for row in rows] == [str(rank) for rank in range(1, len(rows) + 1)]
    for row, line in zip(rows, lines[1:], strict=True):
        names = re.findall(r"robot (\d+)", row["further measurement"])
        assert all(100 <= int(name) < 130 for name in names)
        assert row["further measurement"] in line
        assert float(row["with it [R]"]) <= float(row["expected RMSE [R]"])
    assert set(rows[0]) - set(large[0]) == {"expected RMSE [R]", "with it [R]"}
    assert str(AdviceTable()).startswith("no further contact, height or position")


def test_a_set_of_measurements_says_what_it_gains(towers):
    """A line states how many of which kind, and the expected error before and after."""
    log, center = observe(towers[1], SensingParams()), towers[1].position
    estimate = placed(center)

    table = tabulate(log, ["contacts", "ground"], estimate, 3, ["height"]).together

    first, last = table[0]["expected RMSE [R]"], table[-1]["with it and those above [R]"]
    assert str(table).splitlines()[0] == f"together, 3 heights: expected RMSE {first} -> {last} R"
    for above, below in pairwise(table):
        assert below["expected RMSE [R]"] == above["with it and those above [R]"]
    assert float(last) < float(first)


@pytest.mark.parametrize(
    ("budget", "kinds", "robots", "problem"),
    [
        (0, [], 1000, "budget: 0 should be at least 1"),
        (
            1,
            ["compass"],
            1000,
            "kinds: 'compass' should be one of contact, height, position, range",
        ),
        (1, [], 3, "budget: is for up to 3 robots"),
    ],
)
def test_a_set_that_cannot_be_chosen_is_refused(
    towers, monkeypatch, budget, kinds, robots, problem
):
    """The line names the argument."""
    log, center = observe(towers[1], SensingParams()), towers[1].position
    monkeypatch.setattr(advice, "MOST_ROBOTS", robots)

    with pytest.raises(InputError, match=re.escape(problem)):
        tabulate(
            log,
            ["contacts"],
            placed(center),
            budget,
            kinds,
        )
