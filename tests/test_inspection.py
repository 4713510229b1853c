"""Lines on an estimate name robots, and quantify their uncertainty."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tiswarm.errors import InputError
from tiswarm.inspection import (
    MOST_SHOWN,
    advice_rows,
    convergence_warning,
    describe_advice,
    describe_residual,
    describe_solutions,
    inspect,
)
from tiswarm.localization.params import JointParams, VirtualForceParams
from tiswarm.localization.registry import localize
from tiswarm.measurements import advice
from tiswarm.records.estimate import Solution
from tiswarm.records.sensing_file import write_sensing_log
from tiswarm.sensing import SensingParams, observe


@pytest.fixture
def log(towers):
    """What thirty robots sensed."""
    return observe(towers[0], SensingParams())


def _lines(log, *solutions):
    """Lines on solutions, each given by its chains, its residual and who stands how far off."""
    found = []
    for chains, residual, off in solutions:
        position = np.zeros((log.robot_count, 3))
        position[list(off), 1] = list(off.values())
        found.append(
            Solution(
                weight=0.5,
                chi_square=residual,
                chains=chains,
                residual=residual,
                residual_sd=10.0 * residual,
                position=position,
            )
        )
    return list(describe_solutions(log, SimpleNamespace(solutions=tuple(found))))


def test_each_solution_is_listed_with_its_gap(log):
    """The gap of residuals, how far off it is at most, and which robots, the farthest first."""
    assert _lines(log, (2, 0.1, {}), (1, 0.25, {4: 2.5, 7: 5.0, 9: 1.9})) == [
        "solution 1 of 2: 2 of 3 chains, residual 0.1 R (1 sd)",
        (
            "solution 2 of 2: 1 of 3 chains, residual 0.25 R (2.5 sd), "
            "0.15 R more than solution 1; up to 5 R from there: 2 robots (7, 4)"
        ),
    ]


def test_counts_of_one_are_singular(log):
    """Both for robots and for solutions."""
    lines = _lines(log, (8, 0.1, {}), (1, 0.2, {4: 3.0}), *[(1, 0.3, {})] * (MOST_SHOWN - 1))

    assert lines[1].endswith(": 1 robot (4)")
    assert lines[-1] == "1 more solution"


def test_a_single_solution_is_not_listed(log):
    """Methods that look for none have an empty list."""
    assert _lines(log, (8, 0.1, {})) == _lines(log) == []


def test_long_lists_are_cut(log):
    """The last line counts the rest."""
    many = [(1, 0.1 * k, {k: 3.0 * k for k in range(1, k + 1)}) for k in range(MOST_SHOWN + 3)]

    lines = _lines(log, *many)

    assert len(lines) == MOST_SHOWN + 1
    assert lines[-1] == "3 more solutions"


def test_a_solution_takes_the_place_of_the_mean(log):
    """It has no standard deviation; a number that no solution has is refused."""
    found = localize(log, JointParams(chains=2, steps=200, hold_steps=50))
    second = replace(found.solutions[0], residual=0.5, position=found.position + 7.0)
    found = replace(found, solutions=(found.solutions[0], second))

    chosen = found.with_solution(2)

    np.testing.assert_array_equal(chosen.position, second.position)
    assert chosen.sd is None
    assert describe_residual(log, chosen).startswith("30 robots, residual 0.5 R rms")
    for number in (0, 3):
        with pytest.raises(
            InputError, match=f"{number}: the method found 2 solutions; choose 1 to 2"
        ):
            found.with_solution(number)
    with pytest.raises(InputError, match="found 0 solutions; leave it out"):
        replace(found, solutions=()).with_solution(1)


def test_the_outcome_sets_the_mean_beside_its_best_chain(log):
    """A mean of chains may miss contacts that each chain satisfies."""
    robots = log.robot_count
    best = Solution(
        weight=1.0,
        chi_square=1.0,
        chains=7,
        residual=0.0042,
        residual_sd=0.7,
        position=np.zeros((robots, 3)),
    )
    found = SimpleNamespace(
        robot_count=robots, residual=np.array([2.0, 0.25]), residual_sd=31.0, solutions=(best,)
    )

    expected = "30 robots, residual 0.25 R rms (31 sd), of the best chain 0.0042 R (0.7 sd)"
    assert describe_residual(log, found) == expected
    found.solutions, found.residual_sd = (), None
    assert describe_residual(log, found) == "30 robots, residual 0.25 R rms"


def test_a_method_without_a_verdict_warns_where_contacts_do_not_reach(log):
    """A height far above its contacts pulls robots off; the estimate is no good."""
    high = replace(log, flip_height=np.where(np.arange(30) == 29, 1e9, log.flip_height))

    lines = [
        convergence_warning(each, localize(each, VirtualForceParams())) for each in (log, high)
    ]

    assert lines[0] == ""
    assert lines[1].startswith("not converged: beyond the reach of their contacts are ")


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

    rows = advice_rows(log, ["contacts", "ground"], center)
    lines = [*describe_advice(rows)]
    monkeypatch.setattr(advice, "MOST_ROBOTS", 0)
    large = advice_rows(log, ["contacts", "ground"], center)

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
