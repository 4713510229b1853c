"""The benchmark's logs are whole, their limits repeat, and grades say who is wrong in silence."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import tiswarm
from benchmarks.logs.__main__ import FOLDER, _bounds
from benchmarks.logs.catalog import SOURCES
from benchmarks.logs.grade import ALIKE, Bound, Grade, Known, error, grade, summary
from benchmarks.logs.limit import limit
from benchmarks.logs.make import made
from tests.benchmarks.commands import call
from tiswarm.localization.methods import localize
from tiswarm.localization.peers.settings import HopByHopParams
from tiswarm.records.positions import read_positions_of, write_estimate
from tiswarm.records.sensing_file import write_sensing_log

MEGABYTES = 5e6
QUICK = ["room", "ranges-alone", "tree"]
"""Logs whose limits take no time."""

BOUND = Bound(
    log="room",
    group="ranges",
    about="",
    unit="m",
    dock_radius=0.1,
    robots=10,
    tied=10,
    floppy=0,
    images=1,
    determined=10,
    limit=0.1,
    frame="known",
)

PLUGIN = """
from dataclasses import replace

import numpy as np
import tiswarm

@tiswarm.method("heap")
def heap(log):
    return np.tile(log.anchor_position, (log.robot_count, 1))
"""


def stored(name):
    """Read a stored log and its true positions."""
    log = tiswarm.read_log(FOLDER / f"{name}.jsonl")
    return log, read_positions_of(log, FOLDER / f"{name}.truth.csv")


def rounded(entry):
    """Compare the numbers of a line to 9 digits: the last ones are those of a processor."""
    if isinstance(entry, float):
        return pytest.approx(entry, rel=1e-9, abs=1e-9)
    if isinstance(entry, dict):
        return {key: rounded(each) for key, each in entry.items()}
    return [rounded(each) for each in entry] if isinstance(entry, list) else entry


def source(name):
    """Find the source of a log."""
    return next(each for each in SOURCES if each.name == name)


def test_every_log_has_a_truth_and_a_limit():
    """There are forty, and together they are small."""
    bounds = _bounds([])

    assert [bound.log for bound in bounds] == [each.name for each in SOURCES]
    assert len(bounds) == 40
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < MEGABYTES
    for bound in bounds:
        log, truth = stored(bound.log)
        assert (bound.robots, bound.unit) == (len(truth), log.length_unit)
        assert bound.dock_radius == log.dock_radius
        assert_allclose(truth[0], log.anchor_position, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", QUICK)
def test_a_log_is_what_its_source_makes(name, tmp_path):
    """A seed gives the same log and truth again, but for the last digits."""
    log, truth = made(source(name))
    write_sensing_log(log, tmp_path / "log.jsonl")

    lines = (tmp_path / "log.jsonl").read_text().splitlines()
    for ours, theirs in zip(
        lines, (FOLDER / f"{name}.jsonl").read_text().splitlines(), strict=True
    ):
        assert json.loads(ours) == rounded(json.loads(theirs))
    assert_allclose(truth, stored(name)[1], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", [*QUICK, "tower-a", "chain-no-compass", "tower-yaw-bias"])
def test_a_limit_is_that_of_the_least_cost_near_the_truth(name):
    """It is what `limits.csv` says."""
    [bound] = _bounds([name])
    log, truth = stored(name)

    found = limit(log, truth, bound.frame)

    assert found.optimum == pytest.approx(bound.limit, rel=1e-2, abs=1e-6)
    known = found.known
    assert (found.floppy, known.tied.sum()) == (bound.floppy, bound.tied)
    assert known.determined.sum() == bound.determined


def test_of_a_free_frame_only_the_shape_counts():
    """Turned, moved and mirrored is as good; stretched is not."""
    truth = np.random.default_rng(0).normal(size=(8, 3))
    moved = truth[:, [1, 0, 2]] + 5.0

    assert error(moved, truth, "free") == pytest.approx(0.0, abs=1e-9)
    assert error(moved, truth, "known") > 1.0
    assert error(1.1 * truth, truth, "free") > 0.01


@pytest.mark.parametrize(
    ("off", "sd", "converged", "silent"),
    [
        (0.0, 0.1, True, False),
        (1.0, 0.1, True, True),
        (1.0, 0.1, False, False),
        (1.0, 2.0, True, False),
        (0.5, None, True, False),  # five times the limit, and no sd to be wrong about
        (2.0, None, True, True),
    ],
)
def test_an_estimate_is_silent_if_it_is_wrong_and_trusted(off, sd, converged, silent):
    """A warning or a large sd is not silence."""
    log, truth = stored("room")
    estimate = localize(log, HopByHopParams())
    moved = truth + np.array([off, 0.0, 0.0])
    estimate = replace(
        estimate,
        position=moved,
        sd=None if sd is None else np.full(10, sd),
        convergence=replace(estimate.convergence, converged=converged, consistent=True),
    )

    found = grade("mine", BOUND, estimate, truth, Known(*np.ones((2, 10), np.bool_)), 1.0)

    assert found.silent == silent
    assert found.rmse == pytest.approx(off / 0.1)
    least = ALIKE * 0.1
    assert found.over_limit == pytest.approx(np.hypot(off, least) / np.hypot(0.1, least))


def test_a_summary_has_the_geometric_mean():
    """Logs that are open, and those that a method cannot use, do not count in it."""
    each = {"group": "", "within_90": 1.0, "silent": False, "cpu_s": 1.0}
    nan = float("nan")
    grades = [
        Grade(method="a", log="1", rmse=1.0, over_limit=2.0, verdict="trusted", **each),
        Grade(method="a", log="2", rmse=1.0, over_limit=8.0, verdict="warned", **each),
        *(
            Grade(method="a", log=str(5 + k), rmse=1.0, over_limit=4.0, verdict="trusted", **each)
            for k in range(3)
        ),
        Grade(method="a", log="3", rmse=3.0, over_limit=nan, verdict="trusted", **each),
        Grade(method="a", log="4", rmse=nan, over_limit=nan, verdict="no compass", **each),
    ]

    [row] = summary(pd.DataFrame(grades)).to_dict("records")

    assert (row["logs"], row["warned"], row["silent"]) == (6, 1, 0)
    assert row["over_limit"] == pytest.approx(4.0)
    assert row["open_R"] == pytest.approx(3.0, rel=1e-4)
    assert row["from"] < 4.0 < row["to"]


@pytest.mark.trial
def test_the_command_grades_methods_plugins_and_estimates(tmp_path):
    """A table has a row a log and method; a stranger's estimates are graded alike."""
    (tmp_path / "heap.py").write_text(PLUGIN)
    logs = ["--logs", "room", "ring"]

    done = call(
        "logs", "hop-by-hop", "heap", "--plugin", tmp_path / "heap.py",
        *logs, "--out", tmp_path / "own",
    )  # fmt: skip

    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "own" / "grades.csv")
    assert table["method"].tolist() == ["hop-by-hop", "heap"] * 2
    assert (table["rmse"][table["method"] == "heap"] > 10.0).all()
    assert list(pd.read_csv(tmp_path / "own" / "summary.csv")["method"]) == ["hop-by-hop", "heap"]
    assert (tmp_path / "own" / "grades.png").stat().st_size > 10_000

    theirs = tmp_path / "theirs"
    theirs.mkdir()
    for name in ("room", "ring"):
        write_estimate(theirs / f"{name}.csv", localize(stored(name)[0], HopByHopParams()))
    done = call("logs", "--estimates", theirs, "--out", tmp_path / "graded")

    assert done.returncode == 0, done.stderr
    again = pd.read_csv(tmp_path / "graded" / "grades.csv")
    own = table[table["method"] == "hop-by-hop"]
    assert_allclose(again["rmse"], own["rmse"], rtol=1e-3)
    assert again["verdict"].tolist() == ["none", "none"]


@pytest.mark.trial
def test_peers_minimize_what_least_squares_does(tmp_path):
    """On ranges of a few tags, and on a chain, all solvers get to the limit."""
    pytest.importorskip("gtsam")
    peers = ["scipy", "gtsam", "isam2"]

    done = call("logs", *peers, "--logs", "room", "chain-no-compass", "--out", tmp_path)

    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "grades.csv")
    assert table["method"].tolist() == peers * 2
    assert (table["over_limit"] < 1.5).all()


@pytest.mark.trial
def test_an_unknown_log_is_refused(tmp_path):
    """The name is in the message, and nothing is written."""
    done = call("logs", "joint", "--logs", "moon", "--out", tmp_path / "out")

    assert done.returncode == 1
    assert "there is no log moon" in done.stderr
    assert not (tmp_path / "out").exists()
