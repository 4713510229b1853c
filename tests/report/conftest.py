"""A small run folder, as a study leaves it."""

import csv
import json

import numpy as np
import pytest

from tiswarm.base.robot import RobotGeometry
from tiswarm.compute.math import dock_offsets
from tiswarm.report import figure_style

ROBOTS = 12
POSE = "x_R,y_R,z_R,qw,qx,qy,qz,x_est_R,y_est_R,z_est_R,qw_sensed,qx_sensed,qy_sensed,qz_sensed"


def is_blank(image):
    """Whether nearly all pixels of a picture look like the top left one."""
    pixels = np.asarray(image.convert("RGB")).astype(int)
    return (np.abs(pixels - pixels[0, 0]).max(axis=2) > 12).mean() < 0.001


def write_table(path, header, rows):
    """Write rows below a header of comma-separated names."""
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([header.split(","), *rows])


def write_case(folder, *, seed, last_iteration=40):
    """Write a leaning column of robots and an estimate of it; return its RMSE trace."""
    folder.mkdir(parents=True)
    robot = RobotGeometry()
    random = np.random.default_rng(seed)
    quaternion = random.normal(size=(ROBOTS, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    position = np.arange(ROBOTS)[:, None] * [1.0, 0.3, 2.5]
    lowest = (position[0] + dock_offsets(quaternion, robot.dock_offset_body)[0])[:, 2].min()
    position[:, 2] += 1.0 - lowest
    shift = random.normal(size=position.shape)
    error = np.linalg.norm(shift, axis=1)
    force = np.linspace(12.0, 0.0, ROBOTS)
    rows = np.column_stack([position, quaternion, position + shift, quaternion, error, force])
    write_table(
        folder / "robots.csv",
        f"robot,{POSE},error_R,sensed_force",
        [[name, *row] for name, row in enumerate(rows.tolist())],
    )
    rows = [[name, *place] for name, place in enumerate((position + shift).tolist())]
    write_table(folder / "estimate.csv", "robot,x_R,y_R,z_R", rows)
    iteration = np.arange(0, last_iteration + 1, 10)
    rmse = 1.0 + (seed + 3.0) * np.exp(-iteration / 20.0)
    write_table(folder / "convergence.csv", "iteration,rmse_R", zip(iteration, rmse, strict=True))
    header = {
        "format": "tiswarm-sensing",
        "version": 1,
        "dock_radius": 1.0,
        "dock_offsets": robot.dock_offset_body.tolist(),
        "anchor_position": position[0].tolist(),
        "ground_z": 0.0,
        "length_unit": "R",
    }
    robots = [
        {
            "robot": name,
            "orientation_wxyz": turn.tolist(),
            "contacts": [[0, name - 1, 1]] if name else [],
        }
        for name, turn in enumerate(quaternion)
    ]
    lines = [json.dumps(line) for line in (header, *robots)]
    (folder / "sensing.jsonl").write_text("\n".join(lines) + "\n")
    return rmse


def write_summary(folder, header, rows):
    """Write the summary of a run; columns that the header lacks are empty, but for the seed."""
    first = "case,seed,series,condition,point,kind,method,measurements,status,reason"
    names = header.split(",")
    rows = [{"seed": 0} | dict(zip(names, row, strict=True)) for row in rows]
    columns = [*first.split(","), *(name for name in names if name not in first.split(","))]
    table = [[row.get(name, "") for name in columns] for row in rows]
    write_table(folder / "summary.csv", ",".join(columns), table)


def require_alike(drawing):
    """Require that a narrow figure shows what the wide one shows, in the width of a column.

    Axes have the same limits and series, and no text has signs of formulas.
    """
    from matplotlib.text import Text

    wide, narrow = drawing.draw(), drawing.draw(figure_style.COLUMN_WIDTH)
    figure_style.lay_out(narrow)

    panels, columns = ([a for a in f.axes if a.axison and a.lines] for f in (wide, narrow))
    assert narrow.get_size_inches()[0] <= figure_style.COLUMN_WIDTH
    assert [panel.get_title().split() for panel in panels] == [
        panel.get_title().split() for panel in columns
    ]
    for one, other in zip(panels, columns, strict=True):
        assert (one.get_xlim(), one.get_ylim()) == (other.get_xlim(), other.get_ylim())
        for name in ("lines", "collections"):
            series = zip(getattr(one, name), getattr(other, name), strict=True)
            for shown, again in series:
                np.testing.assert_array_equal(_points(shown), _points(again))
        box = other.get_position()
        assert 0.0 <= box.x0 < box.x1 <= 1.0 and 0.0 <= box.y0 < box.y1 <= 1.0  # noqa: PT018
    for figure in (wide, narrow):
        words = [text.get_text() for text in figure.findobj(Text) if text.get_visible()]
        assert not [word for word in words if "$" in word or "\\" in word]


def _points(artist):
    """Return the points of a line or of dots."""
    return artist.get_xydata() if hasattr(artist, "get_xydata") else artist.get_offsets()


@pytest.fixture
def run_folder(tmp_path):
    """Two seeds under two conditions, one of them failed."""
    names = ["0-baseline", "1-baseline", "0-no-z", "1-no-z"]
    for name in names[:3]:
        write_case(tmp_path / "cases" / name, seed=int(name[0]))
    rows = [[name, "failed" if name == "1-no-z" else "done", name[2:], ROBOTS] for name in names]
    write_summary(tmp_path, "case,status,series,robots", rows)
    return tmp_path
