"""Solutions are told apart by where robots are, and told from the best on."""

import numpy as np
import pytest

from tiswarm.localization.joint.solutions import MOST_LISTED, apart, listed

ROBOTS = 12
NAMES = np.arange(100, 100 + ROBOTS)


def _chains(*shifts):
    """Chains that put the last robot, and some others half as far, off by so much [R]."""
    weight = np.zeros(ROBOTS)
    weight[-1], weight[3:6] = 1.0, 0.5
    rng = np.random.default_rng(0)
    place = rng.normal(0.0, 10.0, (ROBOTS, 3))
    return np.array(
        [place + np.outer(weight, [0.6 * d, 0.8 * d, 0.0]) for d in shifts]
    ) + rng.normal(0.0, 1e-3, (len(shifts), ROBOTS, 3))


def test_chains_that_differ_by_less_than_a_dock_are_one_solution():
    """Of which nothing is told; one chain alone is one too."""
    mean, residual = _chains(0.0, 1.9, -1.9), np.array([0.3, 0.2, 0.1])

    assert apart(mean[:2], residual[:2]) == [[1, 0]]
    assert listed(mean[:2], residual[:2], NAMES, 1.0, "R") == ()
    assert listed(mean[:1], residual[:1], NAMES, 1.0, "R") == ()


def test_chains_go_with_the_best_that_they_agree_with():
    """Whatever order they come in."""
    mean, residual = _chains(0.0, 5.0, 1.5, 6.0, -1.5), np.array([0.2, 0.1, 0.3, 0.4, 0.5])
    expected = [{1, 3}, {0, 2, 4}]

    for order in (np.arange(5), np.array([4, 2, 0, 3, 1])):
        found = apart(mean[order], residual[order])
        assert [{int(order[k]) for k in chains} for chains in found] == expected
        assert [int(order[chains[0]]) for chains in found] == [1, 0]


@pytest.mark.parametrize(("radius", "unit"), [(1.0, "R"), (25.0, "mm")])
def test_each_solution_is_told_with_its_gap(radius, unit):
    """The gap of residuals, how far off it is at most, and which robots, the farthest first."""
    lines = listed(_chains(0.0, 5.0, 5.0), np.array([0.1, 0.3, 0.2]), NAMES, radius, unit)

    told, robots = lines[1].split(" from there: robots ")
    assert lines[0] == f"solution 1 of 2: 1 of 3 chains, residual {0.1 * radius:.3g} {unit}"
    assert told == (
        f"solution 2 of 2: 2 of 3 chains, residual {0.2 * radius:.3g} {unit}, "
        f"{0.1 * radius:.2g} {unit} more than solution 1; up to {5 * radius:.3g} {unit}"
    )
    assert robots.split(", ")[0] == "111"
    assert set(robots.split(", ")) == {"103", "104", "105", "111"}
    assert lines[2:] == ("the estimate is the mean of all 3 chains, which is none of these",)


def test_long_lists_are_cut():
    """And how much is left out is told."""
    many = np.random.default_rng(1).normal(0.0, 20.0, (MOST_LISTED + 3, ROBOTS, 3))

    lines = listed(many, np.arange(len(many), dtype=float), NAMES, 1.0, "R")

    assert len(lines) == MOST_LISTED + 2
    assert lines[1].endswith(f"and {ROBOTS - MOST_LISTED} more")
    assert lines[-2] == "and 3 more"
