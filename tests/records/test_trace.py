"""The trace of an estimate is stored small, and read back."""

import numpy as np
import pytest

from tiswarm.base.errors import InputError
from tiswarm.records.estimate import Estimate
from tiswarm.records.frames import read_trace, write_trace


def estimate_of(frames, robots=3):
    """An estimate whose robots move by one along x in each iteration."""
    trace = np.zeros((frames, robots, 3))
    trace[..., 0] = np.arange(frames)[:, None]
    return Estimate(
        robot_id=np.arange(7, 7 + robots), position=trace[-1],
        disconnected=np.zeros(robots, np.bool_), iteration=10 * np.arange(frames), trace=trace,
        residual=np.zeros(frames), length_unit="R",
    )  # fmt: skip


def test_a_trace_has_its_first_and_last_iteration(tmp_path):
    """Of many iterations, some between them are left out."""
    write_trace(tmp_path / "trace.csv", estimate_of(301))

    trace = read_trace(tmp_path / "trace.csv", 3)

    assert trace.iteration[[0, -1]].tolist() == [0, 3000]
    assert len(trace.iteration) < 30
    np.testing.assert_allclose(trace.center[:, :, 0], trace.iteration[:, None] / 10 + np.zeros(3))


def test_an_estimate_that_did_not_move_has_no_trace(tmp_path):
    """There is nothing to play, and no file."""
    write_trace(tmp_path / "trace.csv", estimate_of(1))

    assert read_trace(tmp_path / "trace.csv", 3) is None


def test_a_trace_of_other_robots_is_refused(tmp_path):
    """The message names the file."""
    write_trace(tmp_path / "trace.csv", estimate_of(5))

    with pytest.raises(InputError, match=r"trace\.csv: .* 15 rows are no iterations of 4 robots"):
        read_trace(tmp_path / "trace.csv", 4)
