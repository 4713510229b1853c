"""All methods are judged by the same rules, as far as they know what these ask for."""

from dataclasses import replace

import numpy as np
import pytest

from tests.structures import Rule, structure
from tiswarm.localization.mixture.verdict import Assessment, Evidence, judge
from tiswarm.measurements.cues import measure

ROBOTS = 12
NEARER = (
    "positions nearby fit the measurements better: their chi-square is 99 less, and noise explains "
    "73.6"
)


@pytest.fixture(scope="module")
def known() -> Evidence:
    """What a method knows of a good estimate of robots that touch only the one before."""
    log, _ = structure(Rule(kind="chain"), ROBOTS, 0)
    rows = measure(log, ["contacts"])
    return Evidence(
        log=log,
        rows=rows,
        outlier=np.zeros(len(rows), np.bool_),
        is_guess=np.zeros(ROBOTS, np.bool_),
        chi_square=40.0,
        unknowns=3 * (ROBOTS - 1),
        freedom=40,
    )


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ({}, ""),
        ({"all_failed": True}, "all chains ended out of reach of their contacts, or ran hot"),
        ({"is_alone": True}, "no two chains ended at the same least cost"),
        ({"is_guess": np.ones(ROBOTS, np.bool_)}, "all positions are guesses"),
        ({"missed": 50}, "the best chain misses 50 contacts or ranges"),
        ({"excess": 99.0}, ""),
        (
            {"excess": 99.0, "is_within": False},
            NEARER,
        ),
    ],
)
def test_a_rule_asks_for_what_a_method_knows(known, what, reason):
    """Nothing speaks against an estimate unless its method knows it."""
    found = judge(replace(known, **what))

    assert (found.converged, found.consistent) == (not reason, True)
    assert found.reason == reason


def test_robots_that_outliers_alone_tie_are_nowhere(known):
    """Without the contact in the middle of a chain, nothing says where its end is."""
    later = int(np.argmax(known.rows.robot[: len(known.rows.other)] == ROBOTS - 3))
    outlier = np.arange(len(known.rows)) == later

    found = judge(replace(known, outlier=outlier))

    assert not found.converged
    assert found.reason == "outliers alone tie 3 robots to the anchor"


def test_noise_that_explains_no_rows_widens_stated_errors_alone(known):
    """The Birge ratio is that of the chi-square to its degrees of freedom."""
    wide = replace(known, chi_square=360.0)

    found, silent = judge(wide), judge(replace(wide, has_sd=False))

    assert (found.converged, found.consistent, found.testable) == (True, False, True)
    assert found.reason == "noise as stated does not explain all rows"
    assert (found.sd_factor, silent.sd_factor) == (3.0, 1.0)


def test_a_doubt_of_a_method_ends_what_it_says_of_outliers(known):
    """Whether noise explains the rows stands."""
    good = Assessment(judge(known), None, np.empty((0, 5), int), np.empty((0, 3), int))

    found = good.doubted("robots search near each other only")

    assert (found.convergence.converged, found.convergence.consistent) == (False, True)
    assert found.outlier_contacts is found.outlier_places is None
