"""Measures the 3D view of a log's page by number of robots: size, and the cost of frames.

python -m benchmarks.page_view --sizes 1e3 1e4 1e5

Robots form a block of honeycomb layers. Their estimates have errors of 0.5 R (1 sd) an axis. A
headless Chromium without a graphics card turns the view, and reads a pixel of each frame.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

import tiswarm
from tests.browser import probe
from tiswarm.app.drawing import draw_log
from tiswarm.base.aliases import Reals
from tiswarm.base.robot import RobotGeometry
from tiswarm.records.positions import read_estimate, read_positions_of

_ERROR_SD = 0.5  # of estimates [R]
_TURN = """
const turn = () => {
  view.dispatchEvent(Object.assign(new Event("keydown"), { key: "ArrowLeft" }));
  view.getContext("2d").getImageData(0, 0, 1, 1);
};
turn();
const start = performance.now();
for (let frame = 0; frame < 3; frame++) turn();
found.seconds = (performance.now() - start) / 3000;
document.body.dataset.found = JSON.stringify(found);
"""


def place(count: int) -> Reals:
    """Place robots on layers of a honeycomb whose docks touch: centers and orientations, (N, 7)."""
    robot = RobotGeometry()
    apart = 2 * robot.rho + robot.spacing
    across = np.arange(round((count / 20) ** (1 / 3)) + 1)
    height = np.arange(count // (2 * len(across) ** 2) + 1)
    z, i, j, odd = np.meshgrid(height, across, across, [0, 1], indexing="ij")
    half, long = apart * np.sqrt(0.75), 1.5 * apart
    x = long * i + apart * odd
    y = half * (2 * j + i % 2)
    turn = np.where(odd, 1.0, 0.0)  # by 180 degrees about z
    pose = [x, y, 1.0 + robot.spacing * z, 1.0 - turn, 0 * turn, 0 * turn, turn]
    return np.column_stack([values.ravel() for values in pose])[:count]


def measure(count: int, folder: Path) -> dict[str, float]:
    """Write the page of a log of N robots, and turn its view in a browser."""
    columns = ["x_R", "y_R", "z_R", "qw", "qx", "qy", "qz"]
    pd.DataFrame(place(count), columns=columns).rename_axis("robot").to_csv(folder / "poses.csv")
    (imported,) = tiswarm.import_poses(folder / "poses.csv", out=folder, ground_z=0.0).values()
    table = pd.read_csv(folder / "truth.csv")
    error = np.random.default_rng(count).normal(0.0, _ERROR_SD, (count, 3))
    table[["x_R", "y_R", "z_R"]] += error
    table.to_csv(folder / "estimate.csv", index=False)
    start = time.process_time()
    log, page = imported.log, folder / "view.html"
    estimate = read_estimate(log, folder / "estimate.csv")
    draw_log(page, log, estimate, name=page.stem, true=read_positions_of(log, folder / "truth.csv"))
    writing = time.process_time() - start
    at_once = page.read_text().replace("requestAnimationFrame(draw)", "draw()")
    return {
        "robots": count,
        "contacts": len(log.contacts),
        "page MB": page.stat().st_size / 1e6,
        "writing, processor s": writing,
        "frame, s": probe(at_once, _TURN, folder, real_time=True)["seconds"],
        "load": os.getloadavg()[0],
    }


def main() -> None:
    """Print a row for each number of robots."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=float, nargs="+", default=[1e3, 1e4, 1e5])
    for size in parser.parse_args().sizes:
        with tempfile.TemporaryDirectory() as folder:
            print(pd.Series(measure(int(size), Path(folder))).round(3).to_dict(), flush=True)


if __name__ == "__main__":
    main()
