"""Devices measure the same thing again and again; each reading counts, and sources are named."""

import json

import numpy as np
import pandas as pd
import pytest

SQUARE = [[1.5, 0.0, 0.0], [0.0, 1.5, 0.0], [-1.5, 0.0, 0.0], [0.0, -1.5, 0.0]]
HEADER = {
    "format": "tiswarm-sensing",
    "version": 2,
    "dock_radius": 1.0,
    "dock_offsets": SQUARE,
    "anchor_position": [0.0, 0.0, 1.0],
    "length_unit": "R",
    "noise": {"tilt_deg": 0.0, "yaw_deg": 0.0},
    "sources": {"radio": {"shared_sd": 0.05}, "ceiling, camera 2": {"shared_sd": 0.02}},
}
PLACES = np.array(
    [[0.0, 0.0, 1.0], [14.0, 0.0, 3.0], [0.0, 15.0, 8.0], [2.0, 3.0, 16.0], [6.0, 7.0, 9.0]]
)
"""The anchor, three robots that are known, and one that ranges tie to them."""

FIXED = np.array([20.0, 9.0, 5.0])
"""A robot that is known by two fixes along each axis."""

SAME = [[0.0, 0.1], [0.0, 0.1]]
PULLING = [[0.32, 0.2], [-0.08, 0.1]]
"""Errors of two readings with their sd; the weighted mean of either pair has none."""


def write_log(path, readings, source=()):
    """Write a log in which everything is measured by two readings, off by these errors."""
    turn = {"orientation_wxyz": [1.0, 0.0, 0.0, 0.0], "contacts": []}
    lines = [HEADER, {"robot": 0, **turn}]
    for robot in (1, 2, 3):
        fixes = [[*n, float(PLACES[robot] @ n), 0.01] for n in np.eye(3).tolist()]
        lines.append({"robot": robot, **turn, "fixes": fixes})
    apart = np.linalg.norm(PLACES[4] - PLACES[:4], axis=1).tolist()
    ranges = [
        [other, length + error, sd, *source]
        for other, length in enumerate(apart)
        for error, sd in readings
    ]
    fixes = [
        [*n, float(FIXED @ n) + error, sd, *source]
        for n in np.eye(3).tolist()
        for error, sd in readings
    ]
    lines += [{"robot": 4, **turn, "ranges": ranges}, {"robot": 5, **turn, "fixes": fixes}]
    path.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    return path


@pytest.mark.parametrize("readings", [SAME, PULLING], ids=["same", "pulling"])
@pytest.mark.parametrize("source", [[], ["radio"]], ids=["", "source"])
@pytest.mark.parametrize("method", ["joint", "least-squares", "hop-by-hop"])
def test_every_reading_counts(tiswarm, tmp_path, method, source, readings):
    """Two ranges of the same robots and two fixes along one axis place robots at their mean."""
    log, out = write_log(tmp_path / "log.jsonl", readings, source), tmp_path / "estimate.csv"

    done = tiswarm("localize", log, "--method", method, "--out", out)

    assert done.returncode == 0, done.stderr
    found = pd.read_csv(out)[["x_R", "y_R", "z_R"]].to_numpy()
    # Either reading alone would be off by 0.08 R or 0.32 R. Chains of joint have a temperature.
    np.testing.assert_allclose(found[4:], [PLACES[4], FIXED], atol=0.05)


@pytest.mark.parametrize("readings", [SAME, PULLING], ids=["same", "pulling"])
def test_check_and_advise_take_every_reading(tiswarm, tmp_path, readings):
    """Twice the same direction removes one floppy mode, not two."""
    log = write_log(tmp_path / "log.jsonl", readings, ["ceiling, camera 2"])
    out = tmp_path / "estimate.csv"
    localized = tiswarm("localize", log, "--method", "hop-by-hop", "--out", out)

    checked, advised = tiswarm("check", log), tiswarm("advise", log, out)

    for done in (localized, checked, advised):
        assert done.returncode == 0, done.stderr
    assert "fixes, ranges: 0 floppy modes (free motions) of 15 unknowns" in checked.stdout
    assert advised.stdout


def test_virtual_force_leaves_ranges_and_their_sources_out(tiswarm, tmp_path):
    """A method that does not use them reads their log all the same."""
    log, out = write_log(tmp_path / "log.jsonl", SAME, ["radio"]), tmp_path / "estimate.csv"

    done = tiswarm("localize", log, "--method", "virtual-force", "--out", out)

    assert done.returncode == 4
    assert "not converged: all positions are guesses" in done.stderr
    assert len(out.read_text().splitlines()) == 7


def test_a_source_that_the_header_lacks_is_refused_with_its_line(tiswarm, tmp_path):
    """A name with a slip of the pen would otherwise be an error of its own."""
    log = write_log(tmp_path / "log.jsonl", SAME, ["Radio"])

    checked, localized = tiswarm("check", log), tiswarm("localize", log)

    for done in (checked, localized):
        assert done.returncode == 2
        said = f'{log}:6: ranges[0]: the header has no source "Radio"; add it to sources there'
        assert said in done.stderr
