"""Frames of GSD and trajectories of TUM RGB-D are poses over time."""

import re
import sys
from dataclasses import replace

import gsd.hoomd
import numpy as np
import pytest

from tests.formats.test_stances import BODY, assert_same_stances, rows_of, sampled
from tests.structures import exact_estimate
from tiswarm.app.formats import export_view
from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.base.progress import Progress
from tiswarm.formats.imports import import_poses
from tiswarm.formats.poses import Assumptions
from tiswarm.report.swarm_view import view_log
from tiswarm.sensing import SensingParams, observe

SHAPE = {"type": "SphereUnion", "centers": BODY.tolist(), "diameters": [2.0, 2.0, 2.0]}


@pytest.fixture(scope="module")
def exported(towers, tmp_path_factory):
    """Folder with the exports of a tower."""
    out, log = tmp_path_factory.mktemp("exported"), observe(towers[0], SensingParams())
    estimate = exact_estimate(log, towers[0].position)
    for form in ("gsd", "tum"):
        export_view(view_log(log, estimate, towers[0].position), form, out, Progress())
    return out


def write_gsd(path, rows, *, shape=SHAPE, **changes):
    """Write rows of robot, pose and frame as particles; further properties by name."""
    with gsd.hoomd.open(path, mode="w") as file:
        for step in dict.fromkeys(row[-1] for row in rows):
            now = np.array([row for row in rows if row[-1] == step])
            frame = gsd.hoomd.Frame()
            frame.configuration.step = int(step)
            frame.configuration.box = [1e4, 1e4, 1e4, 0, 0, 0]
            frame.particles.N = len(now)
            frame.particles.types = ["robot"]
            frame.particles.type_shapes = [shape]
            frame.particles.position, frame.particles.orientation = now[:, 1:4], now[:, 4:8]
            for name, value in changes.items():
                setattr(frame.particles, name, np.array(value)[: len(now)])
            file.append(frame)


def test_frames_of_particles_have_stances(towers, tmp_path):
    """All robots are in all frames from their first on; the shape says where docks are."""
    path, history = tmp_path / "walk.gsd", towers[0]
    few = replace(history, walks=history.walks[:5], loads=history.loads[:5])
    write_gsd(path, sampled(few, 3, 1, waiting=False))

    log = import_poses(path, Assumptions(ground_z=0.0))[""].log

    assert_same_stances(log, observe(few, SensingParams()))
    np.testing.assert_allclose(log.dock_offset_body, BODY, atol=1e-6)


def test_exported_particles_come_back(exported, towers):
    """Names, join order, docks and contacts are those of the log; nothing moved."""
    imported = import_poses(exported / "structure.gsd", Assumptions())[""]

    sensed = observe(towers[0], SensingParams())
    np.testing.assert_array_equal(imported.log.robot_id, sensed.robot_id)
    np.testing.assert_array_equal(imported.log.contacts, sensed.contacts)
    np.testing.assert_allclose(imported.position, towers[0].position, atol=1e-5)
    assert imported.log.stances is None
    assert "0 stances before the final poses, from 465 poses over time" in imported.notes


def test_particles_of_rigid_bodies_and_boxes(tmp_path):
    """Constituents are no robots, and images unwrap positions; a note counts what is left out."""
    path = tmp_path / "rigid.gsd"
    rows = [[0, 0, 0, 0, 1, 0, 0, 0, 0], [1, 5.0, 0, 0, 0, 0, 0, 1, 0], [2, 6, 0, 0, 1, 0, 0, 0, 0]]
    write_gsd(path, rows, body=[0, 1, 1], image=[[0, 0, 0], [1, 0, 0], [0, 0, 0]])

    imported = import_poses(path, Assumptions())[""]

    np.testing.assert_array_equal(imported.position, [[0, 0, 0], [10005.0, 0, 0]])
    assert imported.notes[0] == "1 constituent of rigid bodies left out"


def test_damaged_and_foreign_particles_are_refused(towers, tmp_path, monkeypatch):
    """A line names the file and what to do; without the library, what to install."""
    path = tmp_path / "walk.gsd"
    rows = [[*row[:-1], 0] for row in {row[0]: row for row in rows_of(towers[0])}.values()]
    write_gsd(path, rows)
    refused = {"the spheres have a radius of 1, not 0.5; give that": {"dock_radius": 0.5}}
    for problem, known in refused.items():
        with pytest.raises(InputError, match=re.escape(problem)):
            import_poses(path, Assumptions(**known))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 3])
    with pytest.raises(InputError, match=r"walk.gsd: not a whole GSD file .*; copy it again"):
        import_poses(path, Assumptions())
    with pytest.raises(InputError, match=r"none.gsd: there is no such file"):
        import_poses(tmp_path / "none.gsd", Assumptions())
    monkeypatch.setitem(sys.modules, "gsd.hoomd", None)
    with pytest.raises(EnvironmentTroubleError, match=r"pip install 'tiswarm\[gsd\]'"):
        import_poses(path, Assumptions())


def write_tum(path, rows):
    """Write rows of robot, pose and time as a trajectory."""
    lines = [" ".join(map(repr, [t, x, y, z, *q, w])) for _, x, y, z, w, *q, t in rows]
    path.write_text("\n".join(["# timestamp tx ty tz qx qy qz qw", *lines]) + "\n")


def test_a_folder_of_trajectories_has_stances(towers, tmp_path):
    """The number in the name of a file is that of the robot."""
    rows = rows_of(towers[0])
    for robot in range(30):
        write_tum(tmp_path / f"robot_{robot:03d}.tum", [row for row in rows if row[0] == robot])

    imported = import_poses(tmp_path, Assumptions(dock_offset_body=BODY, ground_z=0.0))[""]

    assert_same_stances(imported.log, observe(towers[0], SensingParams()))
    np.testing.assert_array_equal(imported.position, towers[0].position)


def test_lines_without_a_number_can_be_dropped(towers, tmp_path):
    """Trackers write NaN while they see no markers; a note names file and lines."""
    rows = [row for row in rows_of(towers[0]) if row[0] < 3]
    for robot in range(3):
        write_tum(tmp_path / f"{robot}.tum", [row for row in rows if row[0] == robot])
    known = {"dock_offset_body": BODY, "ground_z": 0.0, "drop_incomplete": True}
    whole = import_poses(tmp_path, Assumptions(**known))[""]
    file = tmp_path / "1.tum"
    lines = file.read_text().splitlines()
    gap = " ".join([lines[1].split()[0] + ".5", *["nan"] * 7])  # line 1 is a comment
    file.write_text("\n".join([*lines[:2], gap, *lines[2:]]) + "\n")

    found = import_poses(tmp_path, Assumptions(**known))[""]

    assert found.notes == ["1 incomplete row of 1.tum dropped: line 3", *whole.notes]
    assert_same_stances(found.log, whole.log)


def test_an_exported_trajectory_comes_back(exported, towers):
    """It has a robot a line, whose time is the join index."""
    imported = import_poses(exported / "structure.tum", Assumptions(dock_offset_body=BODY))[""]

    np.testing.assert_array_equal(
        imported.log.contacts, observe(towers[0], SensingParams()).contacts
    )
    assert imported.notes[0].startswith("a robot a line, numbered by time")


@pytest.mark.parametrize(
    ("name", "text", "problem"),
    [
        ("7.tum", "0 0 0 0 0 0 1\n", "7.tum:1: is not time, x, y, z, qx, qy, qz, qw; write eight"),
        ("7.tum", "# t\n0 0 0 0 0 0 x 1\n", "7.tum:2: is not time"),
        ("7.tum", "0 nan 0 0 0 0 0 1\n", "7.tum:1: no line is complete; add a pose"),
        (
            "7.tum",
            "0 0 0 0 0 0 0 1\n1 nan 0 0 0 0 0 1\n2 nan nan nan nan nan nan nan\n",
            "7.tum:2: 2 incomplete rows, empty or NaN: line 2-3; complete them, or drop them with",
        ),
        (
            "7.tum",
            "0 0 0 0 0 0 0 1\n0 1 0 0 0 0 0 1\n",
            "7.tum:2: robot 7 has a row already at time 0; keep one",
        ),
        ("7.tum", "0 0 0 0 0 0 1 1\n", "7.tum:1: the quaternion has length 1.41421; scale"),
        ("7.tum", "0 1e11 0 0 0 0 0 1\n", "7.tum:1: x: 1e+11 is too far out; move the origin"),
        ("7.tum", "# t\n", "7.tum:1: there are no poses; add a line for each"),
        ("a.tum", "0 0 0 0 0 0 0 1\n", "a.tum: the name has no number, or several; name the file"),
        (f"{10**19}.tum", "0 0 0 0 0 0 0 1\n", "000.tum: the name has no number, or several"),
        ("7.log", "", "there are no files *.tum or *.csv; add one for each robot"),
    ],
)
def test_malformed_trajectories_are_refused(tmp_path, name, text, problem):
    """A line names file and line."""
    (tmp_path / name).write_text(text)

    with pytest.raises(InputError, match=re.escape(problem)):
        import_poses(tmp_path, Assumptions())


def test_two_files_of_one_number_are_refused(tmp_path):
    """Their poses would be those of one robot wherever the times differ."""
    for time, name in enumerate(("bot_07.tum", "bot_7.tum")):
        (tmp_path / name).write_text(f"{time} 0 0 0 0 0 0 1\n")

    with pytest.raises(
        InputError, match=r"bot_7\.tum: the name has the number of bot_07\.tum; give"
    ):
        import_poses(tmp_path, Assumptions())
