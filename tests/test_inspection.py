"""Lines on an estimate name robots, and quantify their uncertainty."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tiswarm.inspection import (
    MOST_SHOWN,
    convergence_warning,
    describe_residual,
    describe_solutions,
    inspect,
)
from tiswarm.localization.params import VirtualForceParams
from tiswarm.localization.registry import localize
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
                chains=chains, residual=residual, residual_sd=10.0 * residual, position=position
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
        "the estimate averages all 3 chains",
    ]


def test_counts_of_one_are_singular(log):
    """Both for robots and for solutions."""
    lines = _lines(log, (8, 0.1, {}), (1, 0.2, {4: 3.0}), *[(1, 0.3, {})] * (MOST_SHOWN - 1))

    assert lines[1].endswith(": 1 robot (4)")
    assert lines[-2] == "1 more solution"


def test_a_single_solution_is_not_listed(log):
    """Methods that look for none have an empty list."""
    assert _lines(log, (8, 0.1, {})) == _lines(log) == []


def test_long_lists_are_cut(log):
    """The last line counts the rest."""
    many = [(1, 0.1 * k, {k: 3.0 * k for k in range(1, k + 1)}) for k in range(MOST_SHOWN + 3)]

    lines = _lines(log, *many)

    assert len(lines) == MOST_SHOWN + 2
    assert lines[-2] == "3 more solutions"


def test_the_outcome_sets_the_mean_beside_its_best_chain(log):
    """A mean of chains may miss contacts that each chain satisfies."""
    robots = log.robot_count
    best = Solution(chains=7, residual=0.0042, residual_sd=0.7, position=np.zeros((robots, 3)))
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
