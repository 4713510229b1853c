"""The fit of the law of errors finds it again, and reliability is counted by log."""

import numpy as np
import pandas as pd
import pytest

from benchmarks.estimates import assembly, lies, sets
from benchmarks.estimates.sets import NONE, TRAINING, Case
from benchmarks.within.errors import COLUMNS, errors_of
from benchmarks.within.law import fitted
from benchmarks.within.reliability import interval, tables
from tests.structures import exact_estimate
from tiswarm.records.error_law import ERRORS, ErrorLaw
from tiswarm.records.sensing_log import KNOWN_SD


@pytest.fixture(scope="module")
def ladder():
    """Build a ladder of 20 robots, without noise."""
    rng = np.random.default_rng(1)
    return assembly.built(assembly.ladder(20, rng), 4, rng)


def _errors(law, *, logs=200, robots=20, **columns):
    """Draw errors of robots by a law, each log with an sd of its own."""
    rng = np.random.default_rng(0)
    share = rng.random(logs * robots)
    grid = np.geomspace(1e-3, 1e6, 2_000)
    ratio = np.interp(share, law.probability(grid), grid)
    sd = np.repeat(rng.uniform(0.1, 3.0, logs), robots)
    table = {
        "set": "home", "number": TRAINING + np.repeat(np.arange(logs), robots), "kind": "tower",
        "lie": NONE, "method": "joint", "robot": np.tile(np.arange(robots), logs),
        "error_R": ratio * sd, "sd_R": sd, "known": "yes", "is_guess": False, "trusted": True,
    }  # fmt: skip
    return pd.DataFrame(table | columns)[[*COLUMNS]]


def test_a_fit_finds_the_law_that_errors_were_drawn_from():
    """Quantiles agree to 15 %; robots whose positions are guesses do not count."""
    law = ErrorLaw(width=0.7, dimensions=2.5, tail_share=0.1, tail_width=3.0)
    guesses = _errors(law, logs=10, is_guess=True).assign(error_R=1e3)

    record = fitted(pd.concat([_errors(law), guesses]))

    best = ErrorLaw(**record["best"])
    for share in (0.1, 0.5, 0.9, 0.95, 0.98):
        assert best.ratio(share) == pytest.approx(law.ratio(share), rel=0.15)
    assert record["robots"] == {"joint": 4_000}
    assert record["training_numbers"][0] == TRAINING


def test_probabilities_of_the_law_are_reliable_where_errors_follow_it():
    """As many robots are within R as stated, and those that are said to be are."""
    found = tables(_errors(ERRORS))

    (row,) = found["said"].query("logs == 'all without a lie'").to_dict("records")
    assert (row["count"], row["robots"]) == (200, 4_000)
    assert float(row["of these off [%], 1 R"].partition(" ")[0]) < 5.0
    (cells,) = found["reliability"].query("`x [R]` == '1'").to_dict("records")
    for name in ("0.4 to 0.6", "0.6 to 0.8", "0.8 to 0.95"):
        stated, _, right = cells[name].partition(": ")
        assert float(right.partition(" ")[0]) == pytest.approx(float(stated), abs=8.0)
    (scores,) = found["crps"].query("logs == 'home'").to_dict("records")
    of_law, climatology = (
        float(scores[f"CRPS, {name} [R]"].partition(" ")[0]) for name in ("law", "climatology")
    )
    assert of_law < climatology


def test_an_interval_is_over_logs_not_over_robots():
    """Robots of a log share errors: 30 wrong ones in one of ten logs are one event."""
    wrong = np.array([30.0, *np.zeros(9)])

    low, high = interval(wrong, np.full(10, 30.0))

    assert low == 0.0
    assert high >= 0.2


def test_an_anchor_counts_only_where_it_stands_elsewhere(ladder):
    """One of two further anchors is 2 R off, and an estimate that believes it is wrong there."""
    log, truth = ladder
    lied = lies.wrong_anchor(log, truth, np.random.default_rng(7))
    fixes = lied.fixes[lied.fixes[:, 5] == KNOWN_SD]
    anchors = np.unique(fixes[:, 0]).astype(int)
    believed = truth.copy()
    for robot, x, y, z, value, *_ in fixes:
        believed[int(robot), int(np.argmax([x, y, z]))] = value
    case = Case(kind="ladder", lie="wrong anchor", log=lied, truth=truth)
    estimate = exact_estimate(lied, believed, sd=np.full(20, 0.1))

    rows = {
        row.robot: row.error_R
        for row in errors_of(case, estimate, name="wrong", number=0, method="joint")
    }

    (off,) = (robot for robot, error in rows.items() if error > 1e-6)
    assert off in anchors
    assert rows[off] == pytest.approx(2.0)
    assert {*range(20)} - {*rows} == {0, *anchors} - {off}


def test_logs_with_lies_are_of_four_kinds_and_five_lies():
    """Twenty numbers have each once; a bridge of the sets is closed and tied to its anchor."""
    made = [sets.wrong(number) for number in (0, 6, 12, 18)]

    assert [case.kind for case in made] == ["tower", "cantilever", "planar", "bridge"]
    assert [case.lie for case in made] == [
        "exchanged names", "wrong anchor", "noise understated", "drift",
    ]  # fmt: skip
    assert all(20 <= case.log.robot_count <= 120 for case in made)
