"""Work on a log turns each of its cues into rows once."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tiswarm.evaluation.tables import outlier_scores, score
from tiswarm.localization.methods import localize
from tiswarm.localization.mixture import common_causes
from tiswarm.localization.settings import JointParams
from tiswarm.measurements import cues
from tiswarm.measurements.cues import CUES, Measured, cue_names, measure
from tiswarm.measurements.odometry import Odometry
from tiswarm.records.positions import Truth
from tiswarm.sensing import SensingParams, observe


def calls(cue):
    """Functions of a cue, by field."""
    return {name: getattr(cue, name) for name in ("rows", "walked") if getattr(cue, name)}


@pytest.fixture
def work(monkeypatch) -> Counter[str]:
    """Calls of each cue's function, and sums of flips, by name, from now on."""
    done: Counter[str] = Counter()

    def counted(name, call):
        def counting(*given, **named):
            done[name] += 1
            return call(*given, **named)

        return counting

    every = [
        replace(cue, **{each: counted(call.__name__, call) for each, call in calls(cue).items()})
        for cue in CUES
    ]
    monkeypatch.setattr(cues, "CUES", every)
    monkeypatch.setattr(Odometry, "__init__", counted("Odometry", Odometry.__init__))
    # A search for what is wrong in a log measures it anew with each change.
    without = replace(common_causes.COMMON_CAUSES, most_robots=0)
    monkeypatch.setattr(common_causes, "COMMON_CAUSES", without)
    return done


def test_a_case_turns_each_cue_that_was_sensed_into_rows_three_times(towers, work):
    """For the method, relative to the anchor; for what the log determines; and for the scores.

    Logs have millions of rows, and what is common to several uses should cost once. A cue whose key
    has no items costs nothing.
    """
    history, params = towers[0], JointParams(chains=1, steps=60, hold_steps=20)
    log = observe(history, SensingParams())

    estimate = localize(log, params)
    rows = measure(log, params.used_cues)
    truth = Truth(
        robot_id=log.robot_id,
        position=history.position,
        orientation_wxyz=history.orientation_wxyz,
    )
    score(truth, log, estimate, history.robot, rows=rows)
    outlier_scores(history, estimate, rows=rows)

    sensed = [cue for cue in CUES if len(getattr(log, cue.key, ()))]
    assert len(sensed) < len(CUES)
    assert work == dict.fromkeys(
        ["Odometry", *(call.__name__ for cue in sensed for call in calls(cue).values())], 3
    )


def test_rows_are_those_of_a_log_measured_anew(towers):
    """Sets of cues that were asked for before change nothing."""
    log = observe(towers[0], SensingParams())
    measured = Measured(log)

    for count in (*range(len(cue_names()) + 1), 2):
        some = cue_names()[:count]
        anew = measure(log, some)
        assert measured.count(some) == len(anew)
        assert len(measured.rows(some)) == len(anew)
        np.testing.assert_array_equal(measured.rows(some).arm, anew.arm)
        np.testing.assert_array_equal(measured.rows(some).variance(), anew.variance())
